//! Example pixels: recorded events and frames, and the estimated light with the nominal and with the fitted
//! description.

use crate::diagnose::Diagnosis;
use crate::heldout::HeldOutScore;
use crate::report::six_digits;
use crate::sample::PixelSample;
use photocurrent_page::{Curve, Panel};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use std::fmt::Write;

/// Fewest events of an example.
const FEWEST: usize = 5;

/// Three pixels: from those whose held-out frames the nominal description predicts worst, as usual, and best.
pub(super) fn examples(html: &mut String, charts: &mut Vec<Panel>, case: &Case, found: &Diagnosis) {
    let (Ok(nominal), Some(before), Some(sample)) =
        (case.nominal(), &found.predictions.nominal, &found.sample)
    else {
        return;
    };
    let after = found.predictions.fitted.as_ref();
    let is_example = |n: &usize| {
        before.by_pixel[*n].is_finite() && case.events.of_pixel(sample.pixels[*n] as usize).len() >= FEWEST
    };
    let mut ranked: Vec<usize> = (0..sample.len()).filter(is_example).collect();
    if ranked.is_empty() {
        return;
    }
    ranked.sort_by(|&a, &b| before.by_pixel[b].total_cmp(&before.by_pixel[a]).then(a.cmp(&b)));
    html.push_str(
        "<p class=\"note\">Level bars: frames, as photocurrent; every third one was held out. \
                   Curves: the photocurrent that is estimated from the others and the ",
    );
    html.push_str("events. Triangles: events, ON above, OFF below.</p>\n");
    for (share, word) in [(0.02, "predicted worst"), (0.5, "predicted as usual"), (0.98, "predicted best")] {
        let n = ranked[((ranked.len() as f64 * share) as usize).min(ranked.len() - 1)];
        let (x, y) = case.pixel_place(sample.pixels[n] as usize);
        let fitted = after.map_or_else(String::new, |after| {
            format!(", by {:.1} % with the fitted one", 100.0 * after.by_pixel[n])
        });
        let _ = writeln!(
            html,
            "<h3>Column {x}, row {y}, {word}: held-out frames err by {:.1} % with the nominal \
             description{fitted}</h3>",
            100.0 * before.by_pixel[n]
        );
        pixel_panel(case, &nominal, sample, described(before, after, n), n).put(html, charts);
    }
}

/// The estimated light of pixel `n` of the sample, with each description.
fn described(before: &HeldOutScore, after: Option<&HeldOutScore>, n: usize) -> Vec<Curve> {
    let curve = |of: &HeldOutScore, label: &str, style| {
        let (t, u) = of.light.pixel(n);
        let points = t.iter().zip(u).map(|(t, u)| (six_digits(*t as f64 * 1e-6), Some(six_digits(*u))));
        Curve { label: label.into(), style, points: points.collect(), ..Curve::default() }
    };
    std::iter::once(curve(before, "nominal", 0)).chain(after.map(|of| curve(of, "fitted", 1))).collect()
}

fn pixel_panel(case: &Case, nominal: &Nominal, sample: &PixelSample, series: Vec<Curve>, n: usize) -> Panel {
    let pixel = sample.pixels[n] as usize;
    let ms = |t_ns: i64| six_digits(t_ns as f64 * 1e-6);
    let bar = |frame: usize| {
        let (from, to, level) = level(case, nominal, frame, pixel)?;
        Some((six_digits(from), six_digits(to), six_digits(level), format!("frame {frame}")))
    };
    Panel {
        x: "time, ms".into(),
        y: "ln i".into(),
        x_range: Some([ms(case.span.0), ms(case.span.1)]),
        series,
        bars: (0..case.frame_count()).filter_map(bar).collect(),
        ticks: case
            .events
            .of_pixel(pixel)
            .iter()
            .map(|event| (ms(event.t_in_ns), event.polarity > 0))
            .collect(),
        ..Panel::default()
    }
}

/// A frame as log light: from, to (ms), level.
fn level(case: &Case, nominal: &Nominal, frame: usize, pixel: usize) -> Option<(f64, f64, f64)> {
    let exposure = case.frames.as_ref()?.times.exposure(frame, case.pixel_place(pixel).1);
    let seconds = (exposure.end.0 - exposure.start.0) as f64 * 1e-9;
    let charge = nominal.number.integral(case.dn(frame, pixel));
    (charge > 0.0 && seconds > 0.0)
        .then(|| (exposure.start.0 as f64 * 1e-6, exposure.end.0 as f64 * 1e-6, libm::log(charge / seconds)))
}
