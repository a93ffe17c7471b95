//! The report as one page of HTML that needs nothing else, in the style of all pages (`photocurrent-page`):
//! text first, then charts, which its script draws, and pictures as inline SVG.
//!
//! The page has the content of `diagnosis.json`, and in addition the evaluated parts, the evidence of every
//! test, and where and when held-out frames differ from what the nominal and the fitted description predict.
//! The same diagnosis gives the same bytes. Files have names that the stages do not have; who writes the page
//! adds them ([`with_names`]).

mod curve;
mod located;
mod overview;
mod pixels;
mod svg;

use crate::candidates::CANDIDATES;
use crate::dependence::Dependence;
use crate::diagnose::Diagnosis;
use crate::heldout::HeldOutScore;
use crate::report::{
    BeforeAfter, Finding, MinimumDetectable, Parameter, Report, SceneEstimate, SceneProperty, Verdict,
    four_digits as number, six_digits,
};
use crate::stages::{DecisionOutcome, EffectProposal};
use crate::units::{name_of, readable};
use photocurrent_page::{Curve, Page, Panel, Script, Section, escaped};
use photocurrent_scene::case::Case;
use std::fmt::Write;
use svg::{ChartBar, TitledMap, bars, maps};

/// The title of a page without names, and the place where names go.
const TITLE: &str = "Diagnosis";
const SLOT: &str = "<!-- names -->";

/// The page of a report. Pictures need the recording and the diagnosis' result.
pub fn page(report: &Report, case: Option<&Case>, found: Option<&Diagnosis>) -> String {
    let both = case.zip(found);
    let mut charts = Vec::new();
    let part = |id, title: &str, write: &mut dyn FnMut(&mut String)| {
        let mut html = String::new();
        write(&mut html);
        Section { id, title: title.into(), html }
    };
    let mut lead = String::new();
    append_head(&mut lead, report);
    let sections = vec![
        part("missing", "What the description lacks", &mut |html| effects(html, report)),
        part("estimated", "Estimated with the scene", &mut |html| estimated(html, report)),
        part("before-after", "Before and after", &mut |html| fits(html, report)),
        part("looked-at", "Evaluated parts", &mut |html| {
            if let Some(case) = case {
                overview::overview(html, case, report, found);
            }
        }),
        part("curve", "The curve without a name", &mut |html| {
            if let Some(dependence) = found.and_then(|found| unexplained_curve(report, found)) {
                curve::append_unexplained(html, &mut charts, dependence);
            }
        }),
        part("where", "Where it is", &mut |html| {
            if let Some((case, found)) = both {
                append_locations(html, &mut charts, case, found);
            }
        }),
        part("held-out", "Held-out frames", &mut |html| {
            if let Some((case, found)) = both {
                append_held_out_frames(html, &mut charts, report, case, found);
            }
        }),
        part("pixels", "Three pixels", &mut |html| {
            if let Some((case, found)) = both {
                pixels::examples(html, &mut charts, case, found);
            }
        }),
        part("evidence", "Evidence per test", &mut |html| {
            if let Some(found) = found {
                scores(html, found);
            }
        }),
        part("limits", "Detection limits", &mut |html| detectable(html, report)),
        part("not-identifiable", "Not identifiable from this recording", &mut |html| {
            not_testable(html, report)
        }),
        part("next", "What to record next", &mut |html| append_next_steps(html, report)),
        part("provenance", "Provenance", &mut |html| provenance(html, report)),
    ];
    Page {
        generator: "photocurrent diagnose".into(),
        title: TITLE.into(),
        lead,
        sections,
        data: serde_json::json!({ "copies": [], "charts": charts }),
        scripts: vec![Script::Chart],
    }
    .html()
}

/// The page with the names of the files that it is about: recording, and description where it is a file of
/// its own.
pub fn with_names(page: &str, recording: Option<&str>, description: Option<&str>) -> String {
    let Some(recording) = recording else { return page.to_owned() };
    let title = escaped(&format!("{TITLE}: {recording}"));
    let description = description.map_or_else(|| "in the recording".to_owned(), escaped);
    let names = format!(
        "<dl><dt>recording</dt><dd>{}</dd><dt>sensor description</dt><dd>{description}</dd></dl>",
        escaped(recording)
    );
    page.replacen(&format!("<title>{TITLE}</title>"), &format!("<title>{title}</title>"), 1)
        .replacen(&format!("<h1>{TITLE}</h1>"), &format!("<h1>{title}</h1>"), 1)
        .replacen(SLOT, &names, 1)
}

/// Verdict, summary and effects as HTML, for a page of another kind; it has no pictures.
pub fn section(report: &Report) -> String {
    let mut html = String::new();
    append_head(&mut html, report);
    effects(&mut html, report);
    fits(&mut html, report);
    append_next_steps(&mut html, report);
    html
}

fn append_head(html: &mut String, report: &Report) {
    let _ = writeln!(
        html,
        "{SLOT}\n<p><span class=\"badge\">{}</span></p>",
        escaped(&report.verdict.name().replace('_', " "))
    );
    let class = if report.verdict == Verdict::BrokenData { " class=\"failed\"" } else { "" };
    let _ = writeln!(html, "<p{class}>{}</p>", escaped(&report.summary));
    for property in &report.scene {
        let text = format!(
            "A property of the scene, not of the sensor: {} at {:.0} Hz, depth {:.2}{}.",
            property.property,
            property.frequency_hz,
            property.depth,
            for_a_while(property)
        );
        let _ = writeln!(html, "<p class=\"note\">{}</p>", escaped(&text));
    }
}

/// Where and when a property is there for a while, as the end of a sentence.
fn for_a_while(property: &SceneProperty) -> String {
    let (Some(time_ns), Some(rows), Some(columns)) = (property.time_ns, property.rows, property.columns)
    else {
        return String::new();
    };
    let [from, to] = time_ns.map(|t_ns| t_ns as f64 * 1e-6);
    format!(
        ", from {from:.1} to {to:.1} ms in rows {} to {} and columns {} to {}",
        rows[0], rows[1], columns[0], columns[1]
    )
}

/// The curve of the uncatalogued dependence that is reported.
fn unexplained_curve<'a>(report: &Report, found: &'a Diagnosis) -> Option<&'a Dependence> {
    let is_reported = report.effects.iter().any(|effect| effect.id == "unnamed");
    let decided =
        || found.proposed.decided().and_then(|decided| decided.unexplained.as_ref()?.dependence.as_ref());
    found.integrity.dependences.first().or_else(decided).filter(|_| is_reported)
}

fn effects(html: &mut String, report: &Report) {
    if report.effects.is_empty() {
        return;
    }
    for effect in &report.effects {
        let _ = writeln!(
            html,
            "<div class=\"missing\"><h3>{}</h3>\n<p>{}</p>",
            escaped(&effect.id),
            escaped(&effect.plain)
        );
        let _ = writeln!(
            html,
            "<p><code>{}</code> <span class=\"note\">(enters at: {})</span></p>",
            escaped(&effect.equation),
            escaped(&effect.insertion)
        );
        if !effect.parameters.is_empty() {
            let _ = write!(
                html,
                "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Parameters of {}\">",
                escaped(&effect.id)
            );
            html.push_str(
                "<table><thead><tr><th scope=\"col\">parameter</th><th scope=\"col\" \
                           class=\"number\">estimate</th><th scope=\"col\" class=\"number\">95 % \
                           interval</th><th scope=\"col\" class=\"number\">nominal</th></tr></thead>\n",
            );
            effect.parameters.iter().for_each(|(key, parameter)| parameter_row(html, key, parameter));
            html.push_str("</table></div>\n");
        }
        if !effect.also_possible.is_empty() {
            let _ = writeln!(
                html,
                "<p>This recording does not distinguish it from: {}.</p>",
                escaped(&effect.also_possible.join(", "))
            );
        }
        location(html, effect);
        html.push_str("</div>\n");
    }
}

/// Where the effects are that were located.
fn append_locations(html: &mut String, charts: &mut Vec<Panel>, case: &Case, found: &Diagnosis) {
    if found.located.is_empty() {
        return;
    }
    html.push_str(
        "<p class=\"note\">What an event gains in log-likelihood by the effect, both without and \
                   with it under the noise that is left with it: an ",
    );
    html.push_str(
        "event that the effect changes nothing of gains nothing. Orange: gain, blue: loss; bars: \
                   95 %, by blocks of pixels; level bars: the part with the gain; dashed ",
    );
    html.push_str("frame: rows and columns of it.</p>\n");
    found.located.iter().for_each(|(id, of)| located::located(html, charts, case, id, of));
}

fn parameter_row(html: &mut String, key: &str, parameter: &Parameter) {
    let shown = |value: f64| readable(value, &parameter.unit);
    let interval = parameter.ci95.map_or_else(
        || "not estimated".to_owned(),
        |[low, high]| format!("{} to {}", shown(low), shown(high)),
    );
    let nominal = parameter.nominal.map_or_else(|| "-".to_owned(), shown);
    let cells: String = [shown(parameter.estimate), interval, nominal]
        .iter()
        .map(|cell| format!("<td class=\"number\">{}</td>", escaped(cell)))
        .collect();
    let _ = writeln!(html, "<tr><th scope=\"row\">{}</th>{cells}</tr>", escaped(name_of(key)));
}

fn location(html: &mut String, effect: &Finding) {
    let (place, evidence) = (&effect.location, &effect.evidence);
    let mut text = format!(
        "{}, {} polarity, rows {}-{}, columns {}-{}, {} pixels; depends on {}. ",
        place.stream,
        place.polarity,
        place.rows[0],
        place.rows[1],
        place.columns[0],
        place.columns[1],
        place.pixels,
        place.covariate
    );
    if let Some(shape) = &place.shape {
        text.truncate(text.len() - 2);
        let _ = write!(text, " ({shape}). ");
    }
    let _ = write!(
        text,
        "Found by: {}; {:.1} times its detection threshold.",
        evidence.found_by.join(", "),
        evidence.statistic
    );
    match (evidence.heldout_nats_per_event, evidence.heldout_nats) {
        (Some(nats), _) => {
            let _ = write!(
                text,
                " On held-out events the predictive log-likelihood gains {} nats an event.",
                number(nats)
            );
        }
        (None, Some(nats)) => {
            let interval = evidence
                .heldout_nats_ci95
                .map_or_else(String::new, |[low, high]| format!(" (95 % interval {low:.0} to {high:.0})"));
            let _ = write!(
                text,
                " On all held-out events together the predictive log-likelihood gains \
                                  {nats:.0} nats{interval}."
            );
        }
        (None, None) => {}
    }
    let _ = writeln!(html, "<p class=\"note\">{}</p>", escaped(&text));
}

/// How far over or under its detection threshold each candidate is.
fn scores(html: &mut String, found: &Diagnosis) {
    html.push_str(
        "<p class=\"note\">Statistic over its detection threshold (dashed line), on a logarithmic \
                   axis; dark bars are reported.</p>\n",
    );
    let direct: Vec<ChartBar> = found
        .integrity
        .findings
        .iter()
        .map(|finding| ChartBar {
            label: finding.id.to_owned(),
            value: finding.statistic / finding.threshold,
            is_marked: true,
        })
        .collect();
    let mut groups = vec![("direct tests".to_owned(), direct)];
    if let Some(decided) = found.proposed.decided() {
        let bars = |all: &[EffectProposal]| {
            all.iter()
                .take(10)
                .map(|one| ChartBar {
                    label: CANDIDATES[one.candidate].label(),
                    value: one.score * one.probability,
                    is_marked: one.passed,
                })
                .collect()
        };
        groups.push((decided.name.clone(), bars(&decided.proposals)));
        if !decided.second.is_empty() {
            groups.push((format!("{}, in addition to the first", decided.name), bars(&decided.second)));
        }
    }
    for (name, group) in groups {
        let _ = writeln!(html, "<h3>{}</h3>", escaped(&name));
        if group.is_empty() {
            html.push_str("<p>No test came near.</p>\n");
        } else {
            html.push_str(&bars(&group));
        }
    }
    if let DecisionOutcome::Nothing(why) = &found.proposed {
        let _ = writeln!(html, "<p>Nothing was decided on the scene: {}.</p>", escaped(why));
    }
}

/// Held-out frames: before and after, where, when.
fn append_held_out_frames(
    html: &mut String,
    charts: &mut Vec<Panel>,
    report: &Report,
    case: &Case,
    found: &Diagnosis,
) {
    let Some(before) = &found.predictions.nominal else { return };
    html.push_str(
        "<p>Every third frame is held out and predicted from the events and the other frames, as \
                   <code>solve/map</code> would.</p>\n",
    );
    html.push_str(
        "<table><thead><tr><th scope=\"col\">measure</th><th scope=\"col\" \
                   class=\"number\">nominal</th><th scope=\"col\" \
                   class=\"number\">fitted</th></tr></thead>\n",
    );
    let after = found.predictions.fitted.as_ref();
    let fitted = after.map_or_else(|| "-".to_owned(), |after| format!("{:.2} dB", after.psnr_db()));
    let _ = writeln!(
        html,
        "<tr><th scope=\"row\">PSNR of held-out frames</th><td class=\"number\">{:.2} dB</td><td \
         class=\"number\">{fitted}</td></tr>",
        before.psnr_db()
    );
    html.push_str("</table>\n");
    if after.is_none() && !report.effects.is_empty() {
        html.push_str(
            "<p class=\"note\">What was found has no number that a description could state, so \
                       there is no fitted one.</p>\n",
        );
    }
    if let Some(sample) = &found.sample {
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let map = |of: &HeldOutScore| {
            let mut map = vec![f64::NAN; width * height];
            sample.pixels.iter().zip(&of.by_pixel).for_each(|(&pixel, value)| map[pixel as usize] = *value);
            map
        };
        html.push_str("<h3>Where: error of a held-out frame as a share of the pixel's mean</h3>\n");
        let all: Vec<TitledMap> = std::iter::once(("nominal", map(before)))
            .chain(after.map(|after| ("fitted", map(after))))
            .collect();
        html.push_str(&maps(&all, width, height, "of the mean, and more; grey: not evaluated"));
    }
    html.push_str("<h3>When: error by frame</h3>\n");
    let curve = |of: &HeldOutScore, label: &str, style| {
        let points = of.by_frame.iter().map(|(frame, error)| (*frame as f64, Some(six_digits(*error))));
        Curve { label: label.into(), style, dots: true, points: points.collect(), ..Curve::default() }
    };
    let fitted = after.map(|after| curve(after, "fitted", 1));
    let panel = Panel {
        x: "frame".into(),
        y: "root mean square error, DN".into(),
        has_zero: true,
        series: std::iter::once(curve(before, "nominal", 0)).chain(fitted).collect(),
        ..Panel::default()
    };
    panel.put(html, charts);
}

/// Fit of the nominal and the fitted description to measurements that no earlier step used.
fn fits(html: &mut String, report: &Report) {
    let fit = &report.fit;
    let rows = [
        (
            "events: predictive log-likelihood on held-out events",
            "nats an event, more is better",
            fit.heldout_nats_per_event,
        ),
        ("frames: PSNR of held-out frames", "dB, more is better", fit.heldout_frame_psnr_db),
        (
            "calibration: distance of residuals from uniform (Kolmogorov-Smirnov)",
            "0 to 1, less is better",
            fit.calibration_ks,
        ),
    ];
    if rows.iter().all(|(.., both)| both.is_none()) {
        return;
    }
    html.push_str(
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Before and \
                   after\"><table><thead><tr><th scope=\"col\">measure</th>",
    );
    html.push_str(
        "<th scope=\"col\" class=\"number\">nominal</th><th scope=\"col\" \
                   class=\"number\">fitted</th><th scope=\"col\">unit</th></tr></thead>\n",
    );
    for (name, unit, both) in rows {
        let cells = both.map_or_else(
            || "<td class=\"number\" colspan=\"2\">not measured</td>".to_owned(),
            |BeforeAfter { before, after }| {
                format!(
                    "<td class=\"number\">{}</td><td class=\"number\">{}</td>",
                    number(before),
                    number(after)
                )
            },
        );
        let _ = writeln!(html, "<tr><th scope=\"row\">{name}</th>{cells}<td>{unit}</td></tr>");
    }
    html.push_str("</table></div>\n");
}

/// Estimated parameters of the description.
fn estimated(html: &mut String, report: &Report) {
    let row = |one: &SceneEstimate| {
        let value = |value: f64| readable(value, &one.unit);
        let [least, most] = one.range;
        let interval = format!("{} to {}", value(one.ci95[0]), value(one.ci95[1]));
        let stated = format!("{} to {}", value(least), value(most));
        (one.field.clone(), None, vec![value(one.estimate), interval, stated])
    };
    let rows = report.estimated.iter().map(row).collect();
    table(
        html,
        "Numbers that the description leaves open",
        &["field"],
        &["estimate", "95 % interval", "stated"],
        rows,
    );
}

/// Minimum detectable effects.
fn detectable(html: &mut String, report: &Report) {
    let row = |one: &MinimumDetectable| {
        let cell =
            |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| readable(value, &one.unit));
        let cells = vec![
            cell(one.estimate),
            cell(one.standard_error),
            readable(one.minimal_detectable, &one.unit),
            cell(one.of_known_light),
            cell(one.usual),
        ];
        (one.id.clone(), Some(name_of(&one.parameter).to_owned()), cells)
    };
    let rows = report.detectability.iter().map(row).collect();
    let numbers = [
        "estimate",
        "standard error",
        "minimum detectable effect",
        "were the light known",
        "usual where a sensor has it",
    ];
    table(html, "Detection limits", &["effect", "parameter"], &numbers, rows);
}

/// A row of a table: label, second label, numbers.
type TableRow = (String, Option<String>, Vec<String>);

/// A table of numbers; nothing without rows.
fn table(html: &mut String, label: &str, names: &[&str], numbers: &[&str], rows: Vec<TableRow>) {
    if rows.is_empty() {
        return;
    }
    let _ = write!(
        html,
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"{label}\"><table><thead><tr>"
    );
    for name in names {
        let _ = write!(html, "<th scope=\"col\">{name}</th>");
    }
    for name in numbers {
        let _ = write!(html, "<th scope=\"col\" class=\"number\">{name}</th>");
    }
    html.push_str("</tr></thead>\n");
    for (of, what, cells) in rows {
        let what = what.map_or_else(String::new, |what| format!("<td>{}</td>", escaped(&what)));
        let cells: String =
            cells.iter().map(|cell| format!("<td class=\"number\">{}</td>", escaped(cell))).collect();
        let _ = writeln!(html, "<tr><th scope=\"row\">{}</th>{what}{cells}</tr>", escaped(&of));
    }
    html.push_str("</table></div>\n");
}

fn not_testable(html: &mut String, report: &Report) {
    if report.not_testable.is_empty() {
        return;
    }
    html.push_str("<dl>\n");
    for (why, ids) in report.not_testable_by_reason() {
        let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escaped(why), escaped(&ids.join(", ")));
    }
    html.push_str("</dl>\n");
}

fn append_next_steps(html: &mut String, report: &Report) {
    if report.next_experiment.is_empty() {
        return;
    }
    html.push_str("<ul>\n");
    report.next_experiment.iter().for_each(|advice| {
        let _ = writeln!(html, "<li>{}</li>", escaped(advice));
    });
    html.push_str("</ul>\n");
}

fn provenance(html: &mut String, report: &Report) {
    let from = &report.provenance;
    html.push_str("<dl>\n");
    let rows = [
        ("content of the recording (BLAKE3)", from.recording_digest.clone()),
        ("content of the description (BLAKE3)", from.sensor_digest.clone()),
        ("seed", from.seed.to_string()),
        ("program", format!("photocurrent {}", from.version)),
        ("stages", from.stages.join(", ")),
    ];
    for (name, value) in rows {
        let _ = writeln!(html, "<dt>{name}</dt><dd>{}</dd>", escaped(&value));
    }
    html.push_str("</dl>\n");
}

#[cfg(test)]
mod tests;
