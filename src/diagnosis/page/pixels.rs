//! Example pixels: what was recorded, and the light with the description as stated and as fitted.

use super::svg::{COLOURS, Plot};
use crate::case::Case;
use crate::diagnose::Diagnosis;
use crate::nominal::Nominal;
use crate::scene::Scene;
use std::fmt::Write;

/// Three pixels: from those whose kept frames fit badly, as usual, and well.
pub fn examples(html: &mut String, case: &Case, found: &Diagnosis) {
    let (Some(before), Some(sample), Ok(nominal)) = (&found.predictions.0, &found.sample, Nominal::new(case)) else { return };
    let mut ranked: Vec<usize> =
        (0..sample.len()).filter(|&n| before.by_pixel[n].is_finite() && case.events.of(sample.pixels[n] as usize).len() >= 5).collect();
    if ranked.is_empty() {
        return;
    }
    ranked.sort_by(|&a, &b| before.by_pixel[b].total_cmp(&before.by_pixel[a]).then(a.cmp(&b)));
    html.push_str(
        "<h2>Three pixels</h2>\n<p class=\"note\">Bars: frames, as light. Ticks: events, ON up, OFF down. Curves: the light that explains both.</p>\n",
    );
    for (share, word) in [(0.02, "fits badly"), (0.5, "fits as usual"), (0.98, "fits well")] {
        let n = ranked[((ranked.len() as f64 * share) as usize).min(ranked.len() - 1)];
        let pixel = sample.pixels[n] as usize;
        let (x, y) = case.place(pixel);
        let _ = writeln!(html, "<h3>column {x}, row {y}: {word}</h3>");
        let curve = |scene: &Scene| -> Vec<(f64, f64)> {
            let (t, u) = scene.pixel(n);
            t.iter().zip(u).map(|(t, u)| (*t as f64 * 1e-6, *u)).collect()
        };
        let stated = curve(&before.scene);
        let fitted = found.predictions.1.as_ref().map(|after| curve(&after.scene));
        let frames: Vec<(f64, f64, f64)> = (0..case.frame_count()).filter_map(|l| level(case, &nominal, l, pixel)).collect();
        let ends = frames.iter().map(|(from, _, level)| (*from, *level));
        let all = stated.iter().copied().chain(fitted.iter().flatten().copied()).chain(ends);
        let mut plot = Plot::new(all, 640.0, 220.0);
        frames.iter().for_each(|(from, to, value)| plot.level(*from, *to, *value, "#b8c0c8"));
        for event in case.events.of(pixel) {
            let colour = if event.polarity > 0 { "#d00000" } else { "#0040d0" };
            plot.tick(event.t_in_ns as f64 * 1e-6, event.polarity > 0, colour);
        }
        plot.line(&stated, COLOURS[0], "as stated", 0);
        if let Some(fitted) = &fitted {
            plot.line(fitted, COLOURS[1], "as fitted", 1);
        }
        html.push_str(&plot.close("ms", "ln light"));
    }
}

/// A frame as log light: from, to (ms), level.
fn level(case: &Case, nominal: &Nominal, frame: usize, pixel: usize) -> Option<(f64, f64, f64)> {
    let exposure = case.frames.as_ref()?.times.exposure(frame, case.place(pixel).1);
    let seconds = (exposure.end.0 - exposure.start.0) as f64 * 1e-9;
    let signal = case.dn(frame, pixel) - nominal.number.black_level;
    (signal > 0.0 && seconds > 0.0).then(|| (exposure.start.0 as f64 * 1e-6, exposure.end.0 as f64 * 1e-6, libm::log(signal / (nominal.number.gain * seconds))))
}
