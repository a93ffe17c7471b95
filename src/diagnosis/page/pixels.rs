//! Example pixels: what was recorded, the light with the description as stated and as fitted, and what each of them fires at its own light.

use super::plot::{Plot, Scale};
use super::svg::COLOURS;
use crate::case::{Case, Recorded};
use crate::comparison::{Comparison, Step};
use crate::nominal::Nominal;
use std::fmt::Write;

/// Fewest events of an example.
const FEWEST: usize = 5;

/// Three pixels: from those that agree least with the description as stated, as usual, and best.
pub fn examples(html: &mut String, case: &Case, found: &Comparison) {
    let Ok(nominal) = case.nominal() else { return };
    let (before, sample) = (found.before(), &found.sample);
    let cost = |n: usize| before.by_pixel[n].events / f64::max(before.by_pixel[n].count, 1.0);
    let is_example = |n: &usize| before.light.is_known[*n] && case.events.of(sample.pixels[*n] as usize).len() >= FEWEST;
    let mut ranked: Vec<usize> = (0..sample.len()).filter(is_example).collect();
    if ranked.is_empty() {
        return;
    }
    ranked.sort_by(|&a, &b| cost(b).total_cmp(&cost(a)).then(a.cmp(&b)));
    html.push_str("<h2>Three pixels</h2>\n<p class=\"note\">Grey bars: frames, as light. Curves: the light that the sensor must have seen. Ticks: events, ON up and red, ");
    html.push_str("OFF down and blue; those recorded, and those that the described sensor fires at its own light.</p>\n");
    for (share, word) in [(0.02, "agrees least"), (0.5, "agrees as usual"), (0.98, "agrees best")] {
        let n = ranked[((ranked.len() as f64 * share) as usize).min(ranked.len() - 1)];
        let (x, y) = case.place(sample.pixels[n] as usize);
        let after = found.after().map_or_else(String::new, |after| {
            let own = after.by_pixel[n];
            format!(", {:.2} as fitted", own.events / f64::max(own.count, 1.0))
        });
        let _ = writeln!(html, "<h3>Column {x}, row {y}, {word}: mismatch an event {:.2} as stated{after}</h3>", cost(n));
        html.push_str(&one(case, &nominal, found, n));
    }
}

fn one(case: &Case, nominal: &Nominal, found: &Comparison, n: usize) -> String {
    let pixel = found.sample.pixels[n] as usize;
    let described: Vec<(&Step, &str, &str)> =
        std::iter::once((found.before(), "as stated", COLOURS[0])).chain(found.after().map(|after| (after, "as fitted", COLOURS[1]))).collect();
    let curve = |step: &Step| -> Vec<(f64, f64)> {
        let (t, u) = step.light.pixel(n);
        t.iter().zip(u).map(|(t, u)| (*t as f64 * 1e-6, *u)).collect()
    };
    let frames: Vec<(f64, f64, f64)> = (0..case.frame_count()).filter_map(|l| level(case, nominal, l, pixel)).collect();
    let ends = [case.span.0, case.span.1].map(|t| (t as f64 * 1e-6, f64::NAN));
    let all: Vec<(f64, f64)> = described.iter().flat_map(|one| curve(one.0)).chain(frames.iter().map(|(from, _, level)| (*from, *level))).chain(ends).collect();
    let rows: Vec<&str> = std::iter::once("recorded").chain(described.iter().map(|one| one.1)).collect();
    let mut plot = Plot::with_rows(all.into_iter(), 700.0, 240.0, Scale::Linear, &rows);
    frames.iter().for_each(|(from, to, value)| plot.level(*from, *to, *value, "#b8c0c8"));
    let mut ticks = |row: usize, events: &[Recorded]| {
        for event in events {
            plot.tick(row, event.t_in_ns as f64 * 1e-6, event.polarity > 0, if event.polarity > 0 { "#d00000" } else { "#0040d0" });
        }
    };
    ticks(0, case.events.of(pixel));
    described.iter().enumerate().for_each(|(row, one)| ticks(row + 1, one.0.fired.of(pixel)));
    for (step, name, colour) in described {
        plot.line(&curve(step), colour, None);
        plot.name(colour, name);
    }
    plot.close("time, ms", "ln light")
}

/// A frame as log light: from, to (ms), level.
fn level(case: &Case, nominal: &Nominal, frame: usize, pixel: usize) -> Option<(f64, f64, f64)> {
    let exposure = case.frames.as_ref()?.times.exposure(frame, case.place(pixel).1);
    let seconds = (exposure.end.0 - exposure.start.0) as f64 * 1e-9;
    let charge = nominal.number.integral(case.dn(frame, pixel));
    (charge > 0.0 && seconds > 0.0).then(|| (exposure.start.0 as f64 * 1e-6, exposure.end.0 as f64 * 1e-6, libm::log(charge / seconds)))
}
