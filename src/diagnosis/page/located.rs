//! Location of each effect: its gain over a frame of the scene, and over rows, columns, time and light.

use super::curve::measured;
use super::svg::{COLOURS, open_svg};
use crate::covariates::Covariate;
use crate::report::{four_digits as number, six_digits};
use crate::residual::located::{GainCurve, LocatedEffect, LocatedPart, MeanGain};
use photocurrent_page::{Panel, escaped};
use photocurrent_scene::case::Case;
use photocurrent_scene::statistics::quantile;
use std::fmt::Write;

/// Cells of the frame across and down, at most.
const MOST_CELLS: usize = 96;
/// Shades of grey of the frame.
const SHADES: f64 = 15.0;
/// The strongest overlay, as opacity.
const OPAQUE: f64 = 0.8;

/// One effect.
pub(super) fn located(
    html: &mut String,
    charts: &mut Vec<Panel>,
    case: &Case,
    name: &str,
    found: &LocatedEffect,
) {
    let _ = writeln!(html, "<h3>{}</h3>\n<p>{}</p>", escaped(name), escaped(&location_text(case, found)));
    html.push_str(&map(case, found));
    let seconds = found.time_ns.range.map(|t| (t - case.span.0) as f64 * 1e-9);
    let curves = [
        (&found.over_rows, "row", Some(found.rows.range.map(f64::from))),
        (&found.over_time, "time since the start, s", Some(seconds)),
        (&found.over_light, "light: log photocurrent", Some(found.log_light.range)),
    ];
    let is_another = |of: &Covariate| !["row", "time", "photocurrent"].contains(&of.name());
    let other = found.curve_of.filter(is_another).map(|of| (&found.over, of.name(), None));
    html.push_str("<div class=\"panels\">\n");
    let curves = curves.into_iter().chain(other).filter(|(curve, ..)| !curve.at.is_empty());
    curves.for_each(|(curve, label, range)| gain_panel(curve, label, range).put(html, charts));
    html.push_str("</div>\n");
}

/// Sentence on the part with the gain, and the mean gain in it and elsewhere.
fn location_text(case: &Case, found: &LocatedEffect) -> String {
    let gain = |mean: &MeanGain| format!("{} \u{b1} {}", number(mean.gain), number(mean.error));
    let mut text = format!("An event gains {} nats in the mean of {}. ", gain(&found.all), found.all.events);
    let mut parts: Vec<String> = Vec::new();
    fn push_part_text<T: Copy>(
        parts: &mut Vec<String>,
        what: &str,
        of: &LocatedPart<T>,
        gain: &dyn Fn(&MeanGain) -> String,
        show: &dyn Fn(T) -> String,
    ) {
        if let Some(outside) = &of.outside {
            let [from, to] = of.range;
            parts.push(format!(
                "{what} {} to {} ({}; the rest {})",
                show(from),
                show(to),
                gain(&of.inside),
                gain(outside)
            ));
        }
    }
    push_part_text(&mut parts, "rows", &found.rows, &gain, &|row: u32| row.to_string());
    push_part_text(&mut parts, "columns", &found.columns, &gain, &|column: u32| column.to_string());
    push_part_text(&mut parts, "seconds", &found.time_ns, &gain, &|t: i64| {
        number((t - case.span.0) as f64 * 1e-9)
    });
    push_part_text(&mut parts, "log photocurrent", &found.log_light, &gain, &|u: f64| number(u));
    if let Some([on, off]) = found.by_polarity {
        let alone = if found.polarity == "both" {
            String::new()
        } else {
            format!("{} events alone: ", found.polarity.to_uppercase())
        };
        parts.push(format!("{alone}ON {}, OFF {}", gain(&on), gain(&off)));
    }
    if found.rows.outside.is_none() && found.columns.outside.is_none() && found.time_ns.outside.is_none() {
        text.push_str("No part of the array or of the time stands out. ");
    }
    let _ = write!(text, "{}. ", parts.join("; "));
    if found.shape == "flat" {
        text.push_str("It varies over no evaluated covariate.");
    } else {
        let _ = write!(text, "It varies over {} ({}).", found.covariate, found.shape);
    }
    text
}

/// The frame in the middle of the recording in grey, the gain per event over it, and the part in a frame of
/// its own.
fn map(case: &Case, found: &LocatedEffect) -> String {
    const TOP: f64 = 4.0;
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let size = f64::min(640.0 / width as f64, 480.0 / height as f64);
    let (wide, high) = (size * width as f64, size * height as f64);
    let mut svg = open_svg(
        "The scene with the gain of each place over it",
        f64::max(wide, 460.0) + 4.0,
        TOP + high + 28.0,
    );
    let _ =
        write!(svg, "<rect x=\"0\" y=\"{TOP}\" width=\"{wide:.1}\" height=\"{high:.1}\" fill=\"#e6e8eb\"/>");
    grey(&mut svg, case, size, TOP);
    let of = &found.map;
    let mut known: Vec<f64> = of
        .gain
        .iter()
        .zip(&of.events)
        .filter(|(_, events)| **events > 0)
        .map(|(gain, _)| gain.abs())
        .collect();
    known.sort_by(f64::total_cmp);
    let most = f64::max(quantile(&known, 0.95), 1e-9);
    let cell = |k: usize| {
        let (x, y) = (k % of.across * of.side, k / of.across * of.side);
        (x, y, usize::min(of.side, width.saturating_sub(x)), usize::min(of.side, height.saturating_sub(y)))
    };
    for k in (0..of.gain.len()).filter(|&k| of.events[k] > 0) {
        let (x, y, across, down) = cell(k);
        let share = (of.gain[k] / most).clamp(-1.0, 1.0);
        if share.abs() < 0.02 {
            continue;
        }
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\" \
             fill-opacity=\"{:.2}\"/>",
            size * x as f64,
            TOP + size * y as f64,
            size * across as f64,
            size * down as f64,
            COLOURS[usize::from(share > 0.0)],
            OPAQUE * share.abs()
        );
    }
    if found.rows.outside.is_some() || found.columns.outside.is_some() {
        let ([top, bottom], [left, right]) =
            (found.rows.range.map(f64::from), found.columns.range.map(f64::from));
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" \
             stroke=\"#000000\" stroke-width=\"2\" stroke-dasharray=\"6 3\"/>",
            size * left,
            TOP + size * top,
            size * (right + 1.0 - left),
            size * (bottom + 1.0 - top)
        );
    }
    let y = TOP + high + 8.0;
    for step in -5..=5_i32 {
        let colour = COLOURS[usize::from(step > 0)];
        let opacity = OPAQUE * f64::from(step.abs()) / 5.0;
        let x = 60 + 10 * (step + 5);
        let _ = write!(
            svg,
            "<rect x=\"{x}\" y=\"{y:.1}\" width=\"10\" height=\"12\" fill=\"{colour}\" \
                             fill-opacity=\"{opacity:.2}\"/>"
        );
    }
    let text = format!("{} nats an event; grey: the frame in the middle", number(most));
    let _ = writeln!(
        svg,
        "<text x=\"0\" y=\"{0:.1}\">-{1}</text><text x=\"176\" y=\"{0:.1}\">{2}</text></svg>",
        y + 10.0,
        number(most),
        escaped(&text)
    );
    svg
}

/// The frame in the middle of the recording, as grey runs of equal shade; nothing without frames.
pub(super) fn grey(svg: &mut String, case: &Case, size: f64, top: f64) {
    let Some(frames) = &case.frames else { return };
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let side = width.max(height).div_ceil(MOST_CELLS).max(1);
    let frame = frames.times.len() / 2;
    let mut values: Vec<Vec<f64>> = Vec::new();
    for y in (0..height).step_by(side) {
        let of = |x: usize| {
            let all = (y..usize::min(y + side, height))
                .flat_map(|y| (x..usize::min(x + side, width)).map(move |x| (x, y)));
            let (sum, count) = all
                .map(|(x, y)| case.dn(frame, y * width + x))
                .filter(|dn| dn.is_finite())
                .fold((0.0, 0.0), |(s, n), dn| (s + dn, n + 1.0));
            if count > 0.0 { sum / count } else { f64::NAN }
        };
        values.push((0..width).step_by(side).map(of).collect());
    }
    let mut sorted: Vec<f64> = values.iter().flatten().copied().filter(|dn| dn.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = (quantile(&sorted, 0.01), quantile(&sorted, 0.99));
    // Numbers of light look even as their roots.
    let shade =
        |dn: f64| (SHADES * libm::sqrt(((dn - low) / f64::max(high - low, 1e-9)).clamp(0.0, 1.0))).round();
    for (j, row) in values.iter().enumerate() {
        let y = j * side;
        let down = usize::min(side, height - y);
        let mut from = 0;
        while from < row.len() {
            let level = shade(row[from]);
            let run = row[from..]
                .iter()
                .take_while(|dn| shade(**dn) == level || (dn.is_nan() && level.is_nan()))
                .count()
                .max(1);
            let (left, right) = (from * side, usize::min((from + run) * side, width));
            from += run;
            if level.is_nan() {
                continue;
            }
            let tone = (40.0 + 200.0 * level / SHADES) as u8;
            let _ = write!(
                svg,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" \
                 fill=\"rgb({tone},{tone},{tone})\"/>",
                size * left as f64,
                top + size * y as f64,
                // A little over the next one, so that no seam shows.
                size * (right - left) as f64 + 0.3,
                size * down as f64 + 0.3
            );
        }
    }
}

/// Chart of the gain per event along an axis, with 95 % bars and the located part.
fn gain_panel(curve: &GainCurve, label: &str, range: Option<[f64; 2]>) -> Panel {
    let points: Vec<(f64, f64, f64)> =
        curve.at.iter().zip(&curve.gain).map(|(at, mean)| (*at, mean.gain, 1.96 * mean.error)).collect();
    let bar = |range: [f64; 2]| {
        let [from, to] = range.map(six_digits);
        (from, to, 0.0, "the part with the gain".to_owned())
    };
    Panel {
        x: label.into(),
        y: "nats an event".into(),
        has_zero: true,
        series: vec![measured(&points)],
        bars: range.map(bar).into_iter().collect(),
        ..Panel::default()
    }
}
