//! Thresholds from frames: the number of events per change of log light between two frames.
//!
//! The net events of bright pixels between frames are fitted on the frames' change
//! ([`photocurrent_sensor::estimate::thresholds`]). Events per change is one over the threshold. The gain of
//! other thresholds than stated is computed on the other half of the picture.
//!
//! Limits: frames of short exposure and little skew only. Events lost at strong changes make thresholds look
//! larger, and nonlinear frames give the thresholds of their curve, within a tenth. So only more than that is
//! a finding.

use super::changes::LONGEST_EXPOSURE;
use super::departure::{Departure, NATS};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::estimate::{
    Centring, NOWHERE, Panel, Steps, Stretch, offset, step_gains, thresholds,
};

/// Thresholds that differ by less than this are within the estimate's own error.
const LEAST: f64 = 0.12;
/// Rows may be exposed one after the other for this share of the period.
const MOST_SKEW: f64 = 0.1;
/// Number of evaluated pixels, in bands of rows: the busiest, less one in this many that may be hot.
const PIXELS: usize = 4096;
/// See there.
const BANDS: usize = 16;
/// See there.
const HOT: usize = 200;
/// Steps of time from frame to frame.
const STEPS: i64 = 32;
/// Frame values from this share of saturation on are unknown.
const FULL: f64 = 0.98;
/// Signals below this share of the largest one count as so dark.
const DARK: f64 = 0.002;

/// Thresholds that differ significantly from the stated ones.
pub(super) fn findings(case: &Case, nominal: &Nominal, masked: &[u32]) -> Vec<Departure> {
    let Some(panel) = busiest_pixels_panel(case, nominal, masked) else { return Vec::new() };
    let late_ns = offset(&panel).map_or(0.0, |shift| shift.ns.value);
    let stated = (nominal.pixel.threshold_on, nominal.pixel.threshold_off);
    let (Some(found), Some(gains)) = (thresholds(&panel, late_ns), step_gains(&panel, late_ns, stated))
    else {
        return Vec::new();
    };
    let Steps { on, off, measured, .. } = found;
    let ratios = (on.value / stated.0, off.value / stated.1);
    let (scale, asymmetry) =
        (0.5 * (ratios.0 + ratios.1) - 1.0, (ratios.0 - ratios.1) / (ratios.0 + ratios.1));
    let is_off = !(on.holds(stated.0) && off.holds(stated.1)) && (ratios.0 - 1.0) * (ratios.1 - 1.0) > 0.0;
    // The estimate's own intervals hold what tests without parts of the array do not see: how far behind a
    // pixel is after a reversal.
    let (low, high) =
        ((on.ci95.0 / stated.0, off.ci95.0 / stated.1), (on.ci95.1 / stated.0, off.ci95.1 / stated.1));
    let apart = |on: f64, off: f64| (on - off) / (on + off);
    let one = |id: &'static str, fraction: f64, ci95: [f64; 2], nats: f64| {
        let seen = format!(
            "in {measured} places and pairs of frames an ON event comes for a change of {:.3} ({:.3} to \
             {:.3}) of the log light and an OFF event for {:.3} ({:.3} to {:.3})",
            on.value, on.ci95.0, on.ci95.1, off.value, off.ci95.0, off.ci95.1
        );
        Departure {
            ci95: vec![("fraction", ci95)],
            ..Departure::from_halves(id, ("fraction", fraction), nats, gains.measured, seen)
        }
    };
    let mut all = Vec::new();
    if is_off && scale.abs() > LEAST && gains.scale > NATS {
        all.push(one(
            "threshold_scale",
            scale,
            [0.5 * (low.0 + low.1) - 1.0, 0.5 * (high.0 + high.1) - 1.0],
            gains.scale,
        ));
    }
    if asymmetry.abs() > LEAST && gains.apart > NATS {
        all.push(one(
            "threshold_asymmetry",
            asymmetry,
            [apart(low.0, high.1), apart(high.0, low.1)],
            gains.apart,
        ));
    }
    all
}

/// Events and frames of the busiest pixels; none where exposures are long or frames few.
fn busiest_pixels_panel(case: &Case, nominal: &Nominal, masked: &[u32]) -> Option<Panel> {
    let frames = case.frames.as_ref().filter(|frames| frames.times.len() >= 5)?;
    let period_ns = frames.times.mean_period_ns()?;
    let skew_ns = f64::from(case.extent.height) * frames.times.row_time_ns.abs() as f64;
    if frames.times.nominal_exposure_ns()? as f64 > LONGEST_EXPOSURE * period_ns
        || skew_ns > MOST_SKEW * period_ns
    {
        return None;
    }
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let mut place_of = vec![NOWHERE; width * height];
    let mut next = 0;
    let band = height.div_ceil(BANDS);
    for rows in (0..height).step_by(band) {
        let pixels = rows * width..(rows + band).min(height) * width;
        let mut order: Vec<usize> = pixels
            .filter(|pixel| {
                !case.events.of_pixel(*pixel).is_empty() && masked.binary_search(&(*pixel as u32)).is_err()
            })
            .collect();
        order.sort_unstable_by_key(|pixel| (std::cmp::Reverse(case.events.of_pixel(*pixel).len()), *pixel));
        let hot = order.len() / HOT;
        for pixel in order.into_iter().skip(hot).take(PIXELS / BANDS) {
            place_of[pixel] = next;
            next += 1;
        }
    }
    let mut panel = Panel::new(&place_of, case.extent.width, case.extent.height);
    let mids: Vec<i64> = (0..frames.times.len()).map(|l| frames.times.exposure(l, 0).mid().0).collect();
    if !mids.is_sorted_by(|a, b| a < b) || panel.places() == 0 {
        return None;
    }
    let period = period_ns as i64;
    let mut stretch = Stretch::new(mids, period + period / 4, (period / STEPS).max(1), panel.places());
    let largest = (0..place_of.len())
        .filter(|pixel| place_of[*pixel] != NOWHERE)
        .flat_map(|pixel| (0..frames.times.len()).map(move |l| case.dn(l, pixel)));
    let least = DARK * (largest.filter(|dn| dn.is_finite()).fold(0.0, f64::max) - nominal.number.black_level);
    let mut centring = Centring::new(place_of.len(), period / 4);
    for (pixel, &place) in place_of.iter().enumerate().filter(|(_, place)| **place != NOWHERE) {
        for l in 0..frames.times.len() {
            let dn = case.dn(l, pixel);
            let signal = (dn - nominal.number.black_level).max(least);
            stretch.frame_mut(l)[place as usize] =
                if dn < FULL * nominal.saturation_dn { libm::log(signal) as f32 } else { f32::NAN };
        }
        for event in case.events.of_pixel(pixel) {
            if let Some((t, is_on)) = centring.next(pixel, event.t_in_ns, event.polarity > 0) {
                stretch.event(t, place as usize, is_on);
            }
        }
    }
    for (pixel, t, is_on) in centring.rest() {
        stretch.event(t, place_of[pixel] as usize, is_on);
    }
    panel.stretches.push(stretch);
    Some(panel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use photocurrent_core::{Exposure, Timestamp};
    use photocurrent_scene::case::{CaseFrames, PixelEvent, PixelEvents};

    /// Waves over the array, seen by an ideal pixel with these thresholds, and frames of 1 ms every 20 ms;
    /// the description is that of the test's recording.
    fn waves(on: f64, off: f64) -> Case {
        let plain = testing::case();
        let nominal = plain.nominal().unwrap();
        let (frames, period, step) = (12, 20_000_000_i64, 100_000_i64);
        let end = frames as i64 * period;
        let log = |pixel: usize, t: i64| {
            let (x, y) = plain.pixel_place(pixel);
            let phase = 0.35 * f64::from(x) + 0.5 * f64::from(y) - 9.0 * t as f64 / 1e8;
            4.0 + 0.9 * libm::sin(phase) + 0.4 * libm::sin(1.7 * phase + 1.0)
        };
        let events = PixelEvents::new((0..plain.extent.pixels()).map(|pixel| {
            let mut reference = log(pixel, 0);
            let mut fired = Vec::new();
            for t in (0..end).step_by(step as usize) {
                let v = log(pixel, t);
                let polarity = if v - reference >= on { 1 } else { -i8::from(reference - v >= off) };
                if polarity != 0 {
                    reference += if polarity > 0 { on } else { -off };
                    fired.push(PixelEvent { t_in_ns: t, t_off_ns: t, polarity });
                }
            }
            fired
        }));
        let mut times = plain.frames.as_ref().unwrap().times.clone();
        times.row_time_ns = 0;
        times.exposures = (0..frames)
            .map(|l| Exposure {
                start: Timestamp(l as i64 * period + 9_500_000),
                end: Timestamp(l as i64 * period + 10_500_000),
            })
            .collect::<Vec<Exposure>>()
            .into();
        let dn = |l: usize, pixel: usize| {
            nominal.number.of(libm::exp(log(pixel, l as i64 * period + 10_000_000)) * 1e-3) as f32
        };
        let dn = (0..frames * plain.extent.pixels())
            .map(|k| dn(k / plain.extent.pixels(), k % plain.extent.pixels()))
            .collect();
        Case { events, frames: Some(CaseFrames::new(times, dn)), span: (0, end), ..plain }
    }

    #[test]
    fn thresholds_that_frames_contradict_are_found_and_stated_ones_are_not() {
        let nominal = testing::case().nominal().unwrap();
        let (on, off) = (nominal.pixel.threshold_on, nominal.pixel.threshold_off);
        assert_eq!(findings(&waves(on, off), &nominal, &[]), []);
        let found = findings(&waves(0.7 * on, 0.7 * off), &nominal, &[]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].id, "threshold_scale");
        assert!((found[0].parameters[0].1 + 0.3).abs() < 0.06, "{found:?}");
    }
}
