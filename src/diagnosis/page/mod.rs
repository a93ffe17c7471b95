//! The report as one page of HTML that needs nothing beside it: text first, then pictures as inline SVG.
//!
//! The page says what `diagnosis.json` says, and shows what that cannot hold: how strongly each candidate was supported, and where and when held-out frames disagree with the
//! description as stated and as fitted. The same diagnosis gives the same bytes.

mod curve;
mod located;
mod pixels;
mod plot;
mod svg;

use crate::candidates::CANDIDATES;
use crate::case::Case;
use crate::diagnose::{Diagnosis, Proposed};
use crate::heldout::Prediction;
use crate::law::Law;
use crate::report::{EffectReport, Parameter, Report, Verdict, short as number};
use crate::verdict::Proposal;
use plot::{Plot, Scale};
use std::fmt::Write;
use svg::{Bar, COLOURS, Map, bars, maps};

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24;background:#fff}\
h1{font-size:1.5rem;margin:0}h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #d0d7de;padding-bottom:.2rem}\
h3{font-size:1rem;margin:1rem 0 .3rem}table{border-collapse:collapse;margin:.5rem 0}td,th{padding:.15rem .8rem .15rem 0;text-align:left;vertical-align:top}\
th{color:#57606a;font-weight:600}td.n{text-align:right;font-variant-numeric:tabular-nums}code{background:#f3f4f6;padding:.1rem .3rem;border-radius:3px}\
.badge{display:inline-block;padding:.15rem .7rem;border-radius:1rem;color:#fff;font-weight:600}.note{color:#57606a}svg{max-width:100%;height:auto}\
.effect{border-left:4px solid #0072b2;padding:.1rem 0 .1rem 1rem;margin:1rem 0}";

/// The page of a report; pictures need the recording and what came of its diagnosis.
pub fn page(report: &Report, case: Option<&Case>, found: Option<&Diagnosis>) -> String {
    let mut html = String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>Diagnosis</title>\n");
    let _ = write!(html, "<style>{STYLE}</style>\n</head>\n<body>\n");
    head(&mut html, report);
    effects(&mut html, report);
    if let Some(law) = found.and_then(|found| unnamed(report, found)) {
        curve::unnamed(&mut html, law);
    }
    if let (Some(case), Some(found)) = (case, found) {
        places(&mut html, case, found);
    }
    if let (Some(case), Some(found)) = (case, found) {
        proof(&mut html, report, case, found);
        pixels::examples(&mut html, case, found);
    }
    if let Some(found) = found {
        scores(&mut html, found);
    }
    limits(&mut html, report);
    provenance(&mut html, report);
    html.push_str("</body>\n</html>\n");
    html
}

fn head(html: &mut String, report: &Report) {
    let colour = match report.verdict {
        Verdict::Consistent => "#1a7f37",
        Verdict::Named => "#0072b2",
        Verdict::Ambiguous | Verdict::Unnamed => "#bf5b00",
        Verdict::Numerical | Verdict::Insufficient => "#57606a",
        Verdict::BrokenData => "#b00020",
    };
    let _ = writeln!(html, "<h1>Diagnosis <span class=\"badge\" style=\"background:{colour}\">{}</span></h1>", report.verdict.name());
    let _ = writeln!(html, "<p>{}</p>", escaped(&report.summary));
    for property in &report.scene {
        let text = format!("The light itself: {} at {:.0} Hz, depth {:.2}; no fault of the sensor.", property.property, property.frequency_hz, property.depth);
        let _ = writeln!(html, "<p class=\"note\">{}</p>", escaped(&text));
    }
}

/// The curve of what is reported without a name.
fn unnamed<'a>(report: &Report, found: &'a Diagnosis) -> Option<&'a Law> {
    let is_reported = report.effects.iter().any(|effect| effect.id == "unnamed");
    let decided = || found.proposed.decided().and_then(|decided| decided.unexplained.as_ref()?.law.as_ref());
    found.integrity.laws.first().or_else(decided).filter(|_| is_reported)
}

fn effects(html: &mut String, report: &Report) {
    if report.effects.is_empty() {
        return;
    }
    html.push_str("<h2>What is missing in the description</h2>\n");
    for effect in &report.effects {
        let _ = writeln!(html, "<div class=\"effect\"><h3>{}</h3>\n<p>{}</p>", escaped(&effect.id), escaped(&effect.plain));
        let _ = writeln!(html, "<p><code>{}</code> <span class=\"note\">(enters at: {})</span></p>", escaped(&effect.equation), escaped(&effect.insertion));
        if !effect.parameters.is_empty() {
            html.push_str("<table><tr><th>parameter</th><th>estimate</th><th>95 %</th><th>stated</th><th>unit</th></tr>\n");
            effect.parameters.iter().for_each(|(key, parameter)| parameter_row(html, key, parameter));
            html.push_str("</table>\n");
        }
        if !effect.also_possible.is_empty() {
            let _ = writeln!(html, "<p>This recording cannot tell it from: {}.</p>", escaped(&effect.also_possible.join(", ")));
        }
        location(html, effect);
        html.push_str("</div>\n");
    }
}

/// Where the effects are that were located.
fn places(html: &mut String, case: &Case, found: &Diagnosis) {
    if found.located.is_empty() {
        return;
    }
    html.push_str("<h2>Where it is</h2>\n<p class=\"note\">What an event gains in log-likelihood by the effect, both without and with it under the noise that is left with it: an ");
    html.push_str("event that the effect changes nothing of gains nothing. Orange: gain, blue: loss; bars: 95 %, by blocks of pixels; green: the part that holds the gain; dashed ");
    html.push_str("frame: rows and columns of it.</p>\n");
    found.located.iter().for_each(|(id, of)| located::located(html, case, id, of));
}

fn parameter_row(html: &mut String, key: &str, parameter: &Parameter) {
    let interval = parameter.ci95.map_or_else(|| "-".to_owned(), |[low, high]| format!("{} to {}", number(low), number(high)));
    let nominal = parameter.nominal.map_or_else(|| "-".to_owned(), number);
    let cells = [number(parameter.estimate), interval, nominal];
    let cells: String = cells.iter().map(|cell| format!("<td class=\"n\">{cell}</td>")).collect();
    let _ = writeln!(html, "<tr><td>{}</td>{cells}<td>{}</td></tr>", escaped(key), escaped(&parameter.unit));
}

fn location(html: &mut String, effect: &EffectReport) {
    let (place, evidence) = (&effect.location, &effect.evidence);
    let mut text = format!(
        "{}, {} polarity, rows {}-{}, columns {}-{}, {} pixels; depends on {}. ",
        place.stream, place.polarity, place.rows[0], place.rows[1], place.columns[0], place.columns[1], place.pixels, place.covariate
    );
    if let Some(shape) = &place.shape {
        text.truncate(text.len() - 2);
        let _ = write!(text, " ({shape}). ");
    }
    let _ = write!(text, "Found by: {}; {:.1} times its alarm.", evidence.found_by.join(", "), evidence.statistic);
    if let Some(nats) = evidence.heldout_nats {
        let interval = evidence.heldout_nats_ci95.map_or_else(String::new, |[low, high]| format!(" ({low:.0} to {high:.0})"));
        let _ = write!(text, " On held-out events it gains {nats:.0} nats{interval}.");
    }
    let _ = writeln!(html, "<p class=\"note\">{}</p>", escaped(&text));
}

/// How far over or under its alarm each candidate is.
fn scores(html: &mut String, found: &Diagnosis) {
    html.push_str("<h2>Who speaks for what</h2>\n<p class=\"note\">Statistic over the value from which it counts; the line is the alarm.</p>\n");
    let direct: Vec<Bar> = found
        .integrity
        .findings
        .iter()
        .map(|finding| Bar { label: finding.id.to_owned(), value: finding.statistic / finding.threshold, is_marked: true })
        .collect();
    let mut groups = vec![("direct tests".to_owned(), direct)];
    if let Some(decided) = found.proposed.decided() {
        let bars = |all: &[Proposal]| {
            all.iter().take(10).map(|one| Bar { label: CANDIDATES[one.candidate].label(), value: one.score * one.probability, is_marked: one.passed }).collect()
        };
        groups.push((decided.name.clone(), bars(&decided.proposals)));
        if !decided.second.is_empty() {
            groups.push((format!("{}, beside the first", decided.name), bars(&decided.second)));
        }
    }
    for (name, group) in groups {
        let _ = writeln!(html, "<h3>{}</h3>", escaped(&name));
        if group.is_empty() {
            html.push_str("<p>nothing</p>\n");
        } else {
            html.push_str(&bars(&group));
        }
    }
    if let Proposed::Nothing(why) = &found.proposed {
        let _ = writeln!(html, "<p>The scene is no evidence: {}.</p>", escaped(why));
    }
}

/// Held-out frames: before and after, where, when.
fn proof(html: &mut String, report: &Report, case: &Case, found: &Diagnosis) {
    let Some(before) = &found.predictions.0 else { return };
    html.push_str("<h2>Held-out frames</h2>\n");
    html.push_str("<p>Every third frame is held out and predicted from the events and the other frames, as <code>solve/pixel</code> would.</p>\n");
    html.push_str("<table><tr><th></th><th>as stated</th><th>as fitted</th></tr>\n");
    let after = found.predictions.1.as_ref();
    let fitted = after.map_or_else(|| "-".to_owned(), |after| format!("{:.2} dB", after.psnr_db()));
    let _ = writeln!(html, "<tr><td>peak signal to noise</td><td class=\"n\">{:.2} dB</td><td class=\"n\">{fitted}</td></tr>", before.psnr_db());
    html.push_str("</table>\n");
    if after.is_none() && !report.effects.is_empty() {
        html.push_str("<p class=\"note\">What was found has no number that a description could state, so there is no fitted one.</p>\n");
    }
    if let Some(sample) = &found.sample {
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let map = |of: &Prediction| {
            let mut map = vec![f64::NAN; width * height];
            sample.pixels.iter().zip(&of.by_pixel).for_each(|(&pixel, value)| map[pixel as usize] = *value);
            map
        };
        html.push_str("<h3>Where: error of a held-out frame as a share of the pixel's mean</h3>\n");
        let all: Vec<Map> = std::iter::once(("as stated", map(before))).chain(after.map(|after| ("as fitted", map(after)))).collect();
        html.push_str(&maps(&all, width, height, "of the mean, and more; grey: not looked at"));
    }
    html.push_str("<h3>When: error by frame</h3>\n");
    let all: Vec<(&Prediction, &str, &str)> =
        std::iter::once((before, "as stated", COLOURS[0])).chain(after.map(|after| (after, "as fitted", COLOURS[1]))).collect();
    let curve = |of: &Prediction| -> Vec<(f64, f64)> { of.by_frame.iter().map(|(frame, error)| (*frame as f64, *error)).collect() };
    let mut plot = Plot::with_rows(all.iter().flat_map(|one| curve(one.0)).chain([(f64::NAN, 0.0)]), 700.0, 200.0, Scale::Whole, &[]);
    for (of, name, colour) in all {
        plot.line(&curve(of), colour, None);
        plot.name(colour, name);
    }
    html.push_str(&plot.close("frame", "root mean square error, DN"));
}

fn limits(html: &mut String, report: &Report) {
    if !report.detectability.is_empty() {
        html.push_str("<h2>What would have been seen</h2>\n<table><tr><th>effect</th><th>parameter</th><th>estimate</th><th>standard error</th>");
        html.push_str("<th>smallest that is found</th><th>unit</th></tr>\n");
        let cell = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), number);
        for one in &report.detectability {
            let cells = [cell(one.estimate), cell(one.standard_error), number(one.minimal_detectable)];
            let cells: String = cells.iter().map(|cell| format!("<td class=\"n\">{cell}</td>")).collect();
            let _ = writeln!(html, "<tr><td>{}</td><td>{}</td>{cells}<td>{}</td></tr>", escaped(&one.id), escaped(&one.parameter), escaped(&one.unit));
        }
        html.push_str("</table>\n");
    }
    if !report.not_testable.is_empty() {
        html.push_str("<h2>What this recording says nothing about</h2>\n<table>\n");
        let mut reasons: Vec<&str> = Vec::new();
        report.not_testable.iter().map(|one| one.why.as_str()).for_each(|why| {
            if !reasons.contains(&why) {
                reasons.push(why);
            }
        });
        for why in reasons {
            let ids: Vec<&str> = report.not_testable.iter().filter(|one| one.why == why).map(|one| one.id.as_str()).collect();
            let _ = writeln!(html, "<tr><td>{}</td><td class=\"note\">{}</td></tr>", escaped(&ids.join(", ")), escaped(why));
        }
        html.push_str("</table>\n");
    }
    if !report.next_experiment.is_empty() {
        html.push_str("<h2>What to record next</h2>\n<ul>\n");
        report.next_experiment.iter().for_each(|advice| {
            let _ = writeln!(html, "<li>{}</li>", escaped(advice));
        });
        html.push_str("</ul>\n");
    }
}

fn provenance(html: &mut String, report: &Report) {
    let from = &report.provenance;
    html.push_str("<h2>Where this comes from</h2>\n<table>\n");
    let rows = [
        ("recording", from.recording_digest.clone()),
        ("description", from.sensor_digest.clone()),
        ("seed", from.seed.to_string()),
        ("version", from.version.clone()),
        ("stages", from.stages.join(", ")),
    ];
    for (name, value) in rows {
        let _ = writeln!(html, "<tr><th>{name}</th><td>{}</td></tr>", escaped(&value));
    }
    html.push_str("</table>\n");
}

/// Text in HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests;
