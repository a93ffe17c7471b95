//! The light of a scene: log photocurrent of pixels at steady instants.

use crate::case::Case;
use crate::nominal::Nominal;
use photocurrent_sensor::conditional::Track;
use rayon::prelude::*;

/// The light of a pixel: instants, ns, and photocurrent, linear between; empty where it is not known.
pub type LightKnots = (Vec<i64>, Vec<f64>);

/// Log photocurrent of an array at steady instants, natural-log units.
#[derive(Clone, Debug)]
pub struct LogLight {
    /// The first instant, ns.
    pub start_ns: i64,
    /// Time between instants, ns.
    pub step_ns: i64,
    /// Number of instants.
    pub count: usize,
    /// Pixel after pixel; empty where a pixel's light is not known.
    pub log: Vec<Vec<f32>>,
}

impl LogLight {
    /// Instants over a recording, every `step_ns`, with no pixel's light known.
    ///
    /// # Panics
    /// When `step_ns` is not positive.
    pub fn blank(case: &Case, step_ns: i64) -> LogLight {
        assert!(step_ns > 0, "steps of light are positive");
        let count = LogLight::instants(case, step_ns).count();
        LogLight { start_ns: case.span.0, step_ns, count, log: vec![Vec::new(); case.extent.pixels()] }
    }

    /// The instants of [`LogLight::blank`], ns.
    pub fn instants(case: &Case, step_ns: i64) -> impl Iterator<Item = i64> {
        let (start, end) = case.span;
        (0..(end - start) / step_ns + 2).map(move |k| start + k * step_ns)
    }

    /// Instant number `k`, ns.
    pub fn instant(&self, k: usize) -> i64 {
        self.start_ns + k as i64 * self.step_ns
    }

    /// Log photocurrent of a pixel at any instant, by straight lines; none where it is not known.
    pub fn at(&self, pixel: usize, t_ns: i64) -> Option<f64> {
        log_between(self.log.get(pixel)?, (self.start_ns, self.step_ns), t_ns)
    }

    /// Frames of this light, without noise and saturation, DN as [frame][y][x]; NaN where it is not known.
    pub fn frames(&self, case: &Case, nominal: &Nominal) -> Vec<f32> {
        let (pixels, count) = (case.extent.pixels(), case.frame_count());
        let instants: Vec<i64> = (0..self.count).map(|k| self.instant(k)).collect();
        let of = |pixel: usize| -> Vec<f32> {
            let log: Vec<f64> = self.log[pixel].iter().map(|u| f64::from(*u)).collect();
            let Some(times) = case.frames.as_ref().map(|frames| &frames.times).filter(|_| !log.is_empty())
            else {
                return vec![f32::NAN; count];
            };
            let track = Track::new(&instants, &log, self.step_ns);
            let row = case.pixel_place(pixel).1;
            (0..count).map(|l| nominal.number.of(track.collected_in(times.exposure(l, row))) as f32).collect()
        };
        let found: Vec<Vec<f32>> = (0..pixels).into_par_iter().map(of).collect();
        (0..count * pixels).map(|k| found[k % pixels][k / pixels]).collect()
    }
}

/// Log photocurrent of one pixel, known at steady instants, at any instant; none where it is not known. No
/// search, unlike [`photocurrent_core::time::between`].
pub fn log_between(log: &[f32], (start_ns, step_ns): (i64, i64), t_ns: i64) -> Option<f64> {
    let last = log.len().checked_sub(1)?;
    let place = ((t_ns - start_ns) as f64 / step_ns as f64).clamp(0.0, last as f64);
    let k = (place as usize).min(last.saturating_sub(1));
    let (a, b) = (f64::from(log[k]), f64::from(log[(k + 1).min(last)]));
    Some(a + (b - a) * (place - k as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use photocurrent_core::Extent;

    #[test]
    fn frames_are_integrals_of_the_light() {
        let case = testing::texture(Extent { width: 8, height: 8 }, 6);
        let nominal = case.nominal().unwrap();
        let mut light = LogLight::blank(&case, 100_000);
        // ln i = 4 + 9 (t - start), t in seconds, in every pixel but the first.
        let ramp: Vec<f32> = (0..light.count)
            .map(|k| (4.0 + 9.0 * (light.instant(k) - light.start_ns) as f64 * 1e-9) as f32)
            .collect();
        light.log.iter_mut().skip(1).for_each(|log| log.clone_from(&ramp));
        let frames = light.frames(&case, &nominal);
        let times = &case.frames.as_ref().unwrap().times;
        for (k, dn) in frames.iter().enumerate() {
            let (l, pixel) = (k / 64, k % 64);
            if pixel == 0 {
                assert!(dn.is_nan());
                continue;
            }
            let exposure = times.exposure(l, (pixel / 8) as u32);
            let at = |t: i64| libm::exp(4.0 + 9.0 * (t - light.start_ns) as f64 * 1e-9);
            let expected = nominal.number.black_level
                + nominal.number.gain * (at(exposure.end.0) - at(exposure.start.0)) / 9.0;
            assert!((f64::from(*dn) - expected).abs() < 1e-4 * expected, "{dn} is {expected}");
        }
    }
}
