//! Before and after: what the description explains as stated and as fitted, where, when and on what.

use super::plot::{Plot, Scale};
use super::svg::{COLOURS, Map, Range, maps, ranges};
use super::{escaped, number};
use crate::case::Case;
use crate::comparison::dependence::{Dependence, Point, Quantity};
use crate::comparison::{Comparison, Step, TIME_BINS};
use crate::covariates::Covariate;
use crate::law::{Law, Moved};
use std::fmt::Write;

const GREY: &str = "#787878";
const BAND: &str = "#e6e8eb";

/// All of it.
pub fn before_and_after(html: &mut String, case: &Case, found: &Comparison) {
    html.push_str(if found.after().is_some() { "<h2>Before and after</h2>\n" } else { "<h2>How the description fares</h2>\n" });
    let pixels = if found.is_apart { "of blocks at which no refit looked" } else { "at which refits looked as well, as the array has no others" };
    let _ = writeln!(
        html,
        "<p class=\"note\">The light is estimated as the described sensor must have seen it, the sensor looks at that light, and what it fires is held against what was \
         recorded: {} pixels, {pixels}. An event costs 0 when it comes again at its instant, 1 when it does not.</p>",
        found.sample.len()
    );
    table(html, found);
    if found.after().is_some() {
        steps(html, found);
    }
    calibration(html, found);
    places(html, case, found);
    times(html, case, found);
    found.dependences.iter().for_each(|one| dependence(html, one));
}

fn table(html: &mut String, found: &Comparison) {
    let row = |html: &mut String, name: &str, of: &dyn Fn(&Step) -> Option<f64>| {
        let cell = |step: Option<&Step>| step.and_then(of).map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
        let (before, after) = (cell(Some(found.before())), cell(found.after()));
        let _ = writeln!(html, "<tr><td>{name}</td><td class=\"n\">{before}</td><td class=\"n\">{after}</td></tr>");
    };
    html.push_str("<table><tr><th></th><th>as stated</th><th>as fitted</th></tr>\n");
    row(html, "mismatch an event, 0 to 1", &|step| Some(step.cost_per_event()));
    row(html, "frame values: residual in standard deviations, root mean square", &|step| Some(step.frame_residual()));
    row(html, "frames that were kept back: peak signal to noise, dB", &|step| step.kept_psnr_db);
    row(html, "log of how well an event is foretold, nats", &|step| Some(step.nats_per_event()));
    row(html, "calibration: distance of intervals from those of the described sensor, 0 to 1", &|step| step.calibration.as_ref().map(|one| one.ks));
    html.push_str("</table>\n");
}

/// What each effect takes away of what those before it leave.
fn steps(html: &mut String, found: &Comparison) {
    html.push_str("<h3>Gain of each effect: share of the mismatch of events and frames that it takes away</h3>\n");
    html.push_str("<p class=\"note\">Beyond the effects above it; bars: 95 %, from block to block.</p>\n");
    let mut rows: Vec<Range> = Vec::new();
    let row = |label: String, from: usize, to: usize| {
        let gain = found.gain(from, to);
        let note = format!("{:.0} % ({:.0} to {:.0}), {:+.0} nats", 100.0 * gain.share, 100.0 * gain.share_ci95[0], 100.0 * gain.share_ci95[1], gain.nats);
        Range { label, value: Some((gain.share, gain.share_ci95)), note }
    };
    for (n, step) in found.steps.iter().enumerate().skip(1) {
        let id = step.id.unwrap_or("");
        if step.is_random {
            rows.push(Range { label: id.to_owned(), value: None, note: "random: shows in the calibration alone".into() });
        } else {
            rows.push(row(id.to_owned(), n - 1, n));
        }
    }
    if found.steps.len() > 2 && found.steps.iter().skip(1).any(|step| !step.is_random) {
        rows.push(row("all together".into(), 0, found.steps.len() - 1));
    }
    html.push_str(&ranges(&rows));
}

/// Ranks of rescaled intervals against uniform ones.
fn calibration(html: &mut String, found: &Comparison) {
    let described = [(Some(found.before()), "as stated", COLOURS[0]), (found.after(), "as fitted", COLOURS[1])];
    let known: Vec<_> = described.iter().filter_map(|(step, name, colour)| Some(((*step)?.calibration.as_ref()?, *name, *colour))).collect();
    let Some((last, name, _)) = known.last() else { return };
    html.push_str("<h3>Calibration: rescaled intervals between events</h3>\n");
    let _ = writeln!(
        html,
        "<p class=\"note\">Ranks of {} intervals among those of a simulated recording of the described sensor: on the diagonal where the description is right. \
         Grey: where 95 % of such recordings lie ({name}).</p>",
        last.count
    );
    let mut plot = Plot::new([(0.0, 0.0), (1.0, 1.0)].into_iter(), 420.0, 400.0);
    let band: Vec<(f64, f64, f64)> = last.expected.iter().zip(&last.half_width).map(|(at, half)| (*at, at - half, at + half)).collect();
    plot.band(&band, BAND);
    plot.line(&[(0.0, 0.0), (1.0, 1.0)], GREY, Some("4 3"));
    for (calibration, name, colour) in &known {
        let points: Vec<(f64, f64)> = calibration.expected.iter().copied().zip(calibration.found.iter().copied()).collect();
        plot.line(&points, colour, None);
        plot.name(colour, &format!("{name}: {:.3}", calibration.ks));
    }
    html.push_str(&plot.close("uniform quantile", "quantile of the ranks"));
}

fn places(html: &mut String, case: &Case, found: &Comparison) {
    html.push_str("<h3>Where: mismatch of the events by pixel</h3>\n");
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let map = |step: &Step| {
        let mut map = vec![f64::NAN; width * height];
        for (&pixel, of) in found.sample.pixels.iter().zip(&step.by_pixel).filter(|(_, of)| of.count > 0.0) {
            map[pixel as usize] = of.events / of.count;
        }
        map
    };
    let all: Vec<Map> = std::iter::once(("as stated", map(found.before()))).chain(found.after().map(|after| ("as fitted", map(after)))).collect();
    html.push_str(&maps(&all, width, height, "an event, and more; grey: not looked at"));
}

fn times(html: &mut String, case: &Case, found: &Comparison) {
    html.push_str("<h3>When: mismatch of the events over time</h3>\n");
    let (start, end) = (case.span.0 as f64 * 1e-6, case.span.1 as f64 * 1e-6);
    let curve = |step: &Step| -> Vec<(f64, f64)> {
        let bin = |k: usize| start + (end - start) * (k as f64 + 0.5) / TIME_BINS as f64;
        step.by_time.iter().enumerate().filter(|(_, of)| of.1 > 0.0).map(|(k, of)| (bin(k), of.0 / of.1)).collect()
    };
    let (before, after) = (curve(found.before()), found.after().map(curve));
    let mut plot = Plot::new(before.iter().chain(after.iter().flatten()).copied().chain([(start, 0.0), (end, 0.0)]), 700.0, 200.0);
    let named = [(Some(&before), "as stated", COLOURS[0]), (after.as_ref(), "as fitted", COLOURS[1])];
    for (points, name, colour) in named.into_iter().filter_map(|(points, name, colour)| Some((points?, name, colour))) {
        plot.line(points, colour, None);
        plot.name(colour, name);
    }
    html.push_str(&plot.close("time, ms", "mismatch an event"));
}

fn dependence(html: &mut String, of: &Dependence) {
    let name = of.covariate.name();
    let (what, unit, note) = match of.quantity {
        Quantity::Cost => ("mismatch of an event", "mismatch an event", "dashed: without any dependence"),
        Quantity::Delay => ("recorded less simulated time of events", "us", "dashed: a sensor that is as described"),
        Quantity::Frames => ("recorded over simulated frame values, less 1", "%", "dashed: a sensor that is as described"),
    };
    let _ = writeln!(html, "<h3>What it depends on: {what} over {}</h3>\n<p class=\"note\">Bars: 95 %, from block to block; {note}.</p>", escaped(name));
    let mean = of.before.iter().map(|point| point.value).sum::<f64>() / of.before.len() as f64;
    let flat = if of.quantity == Quantity::Cost { mean } else { 0.0 };
    let sets = [(&of.before[..], "as stated", COLOURS[0]), (&of.after[..], "as fitted", COLOURS[1])];
    html.push_str(&over(of.covariate, &sets, flat, unit));
}

/// The curve of what has no name.
pub fn unnamed(html: &mut String, law: &Law) {
    let (what, unit, factor) = match law.moved {
        Moved::Stamps => ("how much later stamps are", "us", 1e6),
        Moved::Threshold => ("how much higher thresholds are", "%", 100.0),
        Moved::Rate => ("how many more ON than OFF events without light a pixel fires", "Hz", 1.0),
        Moved::EventRate => ("how much more often events come", "%", 100.0),
    };
    let rhythm = law.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", number(1.0 / period_s)));
    let (name, measured) = (escaped(law.covariate.name()), number(law.significance));
    let note = if law.moved == Moved::EventRate {
        format!(
            "{what} than around, over {name}; bars: 95 %. No scene knows of this. It takes away {:.1} % of the squares of what counts differ in, is {measured} {}, and foretells \
             what it was not measured on by {} nats an event.",
            100.0 * law.taken,
            if law.covariate == Covariate::FramePhase { "times the strength of chance" } else { "standard errors from nothing" },
            number(law.nats_per_change)
        )
    } else {
        format!(
            "{what} than described, over {name}{rhythm}; bars: 95 %, from what two halves of the pixels say; dashed: the description as stated. It takes away {:.1} % of the \
             squares of what frames and events disagree in, on pixels that it was not fitted to: {measured} standard errors from nothing.",
            100.0 * law.taken
        )
    };
    let _ = writeln!(html, "<h2>The curve without a name</h2>\n<p class=\"note\">{note}</p>");
    let points: Vec<Point> = (0..law.at.len()).map(|k| Point { at: law.at[k], value: factor * law.value[k], error: factor * law.error[k] }).collect();
    html.push_str(&over(law.covariate, &[(&points, "measured", COLOURS[0])], 0.0, unit));
}

/// Sets of points with bars over a covariate, joined by lines, and a flat one.
fn over(covariate: Covariate, sets: &[(&[Point], &str, &str)], flat: f64, unit: &str) -> String {
    let all = || sets.iter().flat_map(|set| set.0.iter());
    let ends = all().fold((f64::INFINITY, f64::NEG_INFINITY), |ends, point| (ends.0.min(point.at), ends.1.max(point.at)));
    // Intervals and loads lie over decades.
    let is_of_a_clock = matches!(covariate, Covariate::Time | Covariate::FramePhase);
    let scale = if !is_of_a_clock && ends.0 > 0.0 && ends.1 > 8.0 * ends.0 { Scale::Logarithmic } else { Scale::Linear };
    // Room on both sides, so that points of a class do not stand on the axis.
    let room = if scale == Scale::Linear { 0.06 * (ends.1 - ends.0) } else { 0.0 };
    let rims = [(ends.0 - room, flat), (ends.1 + room, flat)];
    let reach = all().flat_map(|point| [(point.at, point.value - 1.96 * point.error), (point.at, point.value + 1.96 * point.error)]);
    let mut plot = Plot::with_rows(reach.chain(rims), 700.0, 230.0, scale, &[]);
    plot.line(&rims, GREY, Some("4 3"));
    for (n, (points, name, colour)) in sets.iter().enumerate() {
        let line: Vec<(f64, f64)> = points.iter().map(|point| (point.at, point.value)).collect();
        plot.line(&line, colour, Some("1 3"));
        let bars: Vec<(f64, f64, f64)> = points.iter().map(|point| (point.at, point.value, 1.96 * point.error)).collect();
        plot.points(&bars, colour, 3.0 * n as f64);
        plot.name(colour, name);
    }
    plot.close(&axis(covariate), unit)
}

/// A covariate with its unit, as the name of an axis.
fn axis(covariate: Covariate) -> String {
    let unit = match covariate {
        Covariate::Time | Covariate::FramePhase | Covariate::TimeSinceLastEvent | Covariate::NeighbourEvent => ", s",
        Covariate::AcPhase => ", periods",
        Covariate::Photocurrent => ", ln",
        Covariate::Slope => ", 1/s",
        Covariate::Lag => ", ln units",
        Covariate::SpatialGradient => ", 1/px",
        Covariate::LocalRate | Covariate::RowRate | Covariate::GlobalRate => ", events in a millisecond",
        Covariate::Radius => ", 1 = corner",
        _ => "",
    };
    format!("{}{unit}", covariate.name())
}
