//! Example pixels: what was recorded, and the light that the sensor must have seen, with the nominal and with
//! the fitted description.

use super::plot::{Plot, Scale};
use super::svg::COLOURS;
use crate::diagnose::Diagnosis;
use crate::heldout::Prediction;
use crate::sample::Sample;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use std::fmt::Write;

/// Fewest events of an example.
const FEWEST: usize = 5;

/// Three pixels: from those whose held-out frames the nominal description predicts worst, as usual, and best.
pub(super) fn examples(html: &mut String, case: &Case, found: &Diagnosis) {
    let (Ok(nominal), Some(before), Some(sample)) =
        (case.nominal(), &found.predictions.nominal, &found.sample)
    else {
        return;
    };
    let after = found.predictions.fitted.as_ref();
    let is_example = |n: &usize| {
        before.by_pixel[*n].is_finite() && case.events.of(sample.pixels[*n] as usize).len() >= FEWEST
    };
    let mut ranked: Vec<usize> = (0..sample.len()).filter(is_example).collect();
    if ranked.is_empty() {
        return;
    }
    ranked.sort_by(|&a, &b| before.by_pixel[b].total_cmp(&before.by_pixel[a]).then(a.cmp(&b)));
    html.push_str(
        "<p class=\"note\">Grey bars: frames, as photocurrent; every third one was held out. \
                   Curves: the photocurrent that is estimated from the others and the ",
    );
    html.push_str("events. Ticks: events, ON up, OFF down.</p>\n");
    for (share, word) in [(0.02, "predicted worst"), (0.5, "predicted as usual"), (0.98, "predicted best")] {
        let n = ranked[((ranked.len() as f64 * share) as usize).min(ranked.len() - 1)];
        let (x, y) = case.place(sample.pixels[n] as usize);
        let fitted = after.map_or_else(String::new, |after| {
            format!(", by {:.1} % with the fitted one", 100.0 * after.by_pixel[n])
        });
        let _ = writeln!(
            html,
            "<h3>Column {x}, row {y}, {word}: held-out frames err by {:.1} % with the nominal \
             description{fitted}</h3>",
            100.0 * before.by_pixel[n]
        );
        html.push_str(&one(case, &nominal, sample, (before, after), n));
    }
}

fn one(
    case: &Case,
    nominal: &Nominal,
    sample: &Sample,
    (before, after): (&Prediction, Option<&Prediction>),
    n: usize,
) -> String {
    let pixel = sample.pixels[n] as usize;
    let described: Vec<(&Prediction, &str, &str)> = std::iter::once((before, "nominal", COLOURS[0]))
        .chain(after.map(|after| (after, "fitted", COLOURS[1])))
        .collect();
    let curve = |of: &Prediction| -> Vec<(f64, f64)> {
        let (t, u) = of.light.pixel(n);
        t.iter().zip(u).map(|(t, u)| (*t as f64 * 1e-6, *u)).collect()
    };
    let frames: Vec<(f64, f64, f64)> =
        (0..case.frame_count()).filter_map(|l| level(case, nominal, l, pixel)).collect();
    let ends = [case.span.0, case.span.1].map(|t| (t as f64 * 1e-6, f64::NAN));
    let all: Vec<(f64, f64)> = described
        .iter()
        .flat_map(|one| curve(one.0))
        .chain(frames.iter().map(|(from, _, level)| (*from, *level)))
        .chain(ends)
        .collect();
    let mut plot = Plot::with_rows(all.into_iter(), 700.0, 240.0, Scale::Linear, &["recorded"]);
    frames.iter().for_each(|(from, to, value)| plot.level(*from, *to, *value, "var(--edge)"));
    for event in case.events.of(pixel) {
        plot.tick(
            0,
            event.t_in_ns as f64 * 1e-6,
            event.polarity > 0,
            if event.polarity > 0 { "var(--c1)" } else { "var(--c0)" },
        );
    }
    for (of, name, colour) in described {
        plot.line(&curve(of), colour, None);
        plot.name(colour, name);
    }
    plot.close("time, ms", "ln i")
}

/// A frame as log light: from, to (ms), level.
fn level(case: &Case, nominal: &Nominal, frame: usize, pixel: usize) -> Option<(f64, f64, f64)> {
    let exposure = case.frames.as_ref()?.times.exposure(frame, case.place(pixel).1);
    let seconds = (exposure.end.0 - exposure.start.0) as f64 * 1e-9;
    let charge = nominal.number.integral(case.dn(frame, pixel));
    (charge > 0.0 && seconds > 0.0)
        .then(|| (exposure.start.0 as f64 * 1e-6, exposure.end.0 as f64 * 1e-6, libm::log(charge / seconds)))
}
