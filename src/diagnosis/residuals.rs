//! What the stated sensor makes of estimated light, against the recording: event by event, frame value by frame value, interval by interval.
//!
//! Events and frame values are paired with those of a simulation ([`crate::differences`]). Intervals are rescaled exactly ([`photocurrent_sensor::likelihood`]): under
//! the model, `uniform` is uniform between 0 and 1, and the compensators sum to the number of events.
//!
//! Limits: the light was fitted to the same events, so the residuals of a recording without any fault are too small to be uniform; they are to be held against those of
//! a simulated recording that was treated alike.

use crate::case::Case;
use crate::differences::{EventDifference, Fate, FrameDifference, of_events, of_frames};
use crate::nominal::Nominal;
use crate::record::{Conditions, Described, record};
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting, pixel_data};
use photocurrent_core::random::Random;
use photocurrent_sensor::likelihood::{BaseNoise, Interval, intervals, ks_uniform};
use rayon::prelude::*;

/// Threshold noise where none is stated, as a share of the ON threshold.
const USUAL_SIGMA: f64 = 0.1;

/// All residuals of a sample.
#[derive(Clone, Debug, Default)]
pub struct Residuals {
    /// Recorded and simulated events.
    pub events: Vec<EventDifference>,
    /// Recorded and simulated frame values.
    pub frames: Vec<FrameDifference>,
    /// Intervals by pixel of the array, pixel by pixel in order of time.
    pub intervals: Vec<(u32, Interval)>,
}

/// Residuals of a recording under light and the sensor as described. `sigma` is the threshold's standard deviation at each reset, natural-log units; none takes what is
/// stated, or a tenth of the ON threshold.
///
/// # Errors
/// When the description's effects are not understood.
pub fn residuals(case: &Case, nominal: &Nominal, sample: &Sample, scene: &Scene, sigma: Option<f64>, seed: u64) -> Result<Residuals, String> {
    let again = record(case, nominal, sample, scene, &Described::new(), &Conditions { seed, ..Conditions::default() })?;
    let stated = Some(nominal.threshold_noise).filter(|sigma| *sigma > 0.0);
    let noise = BaseNoise {
        sigma: sigma.or(stated).unwrap_or(USUAL_SIGMA * nominal.pixel.threshold_on),
        shared: false,
        background_hz: 0.0,
        stamp_width_ns: case.t_resolution_ns,
    };
    let setting = SceneSetting::default();
    let one = |n: usize| -> Vec<(u32, Interval)> {
        let pixel = sample.pixels[n];
        let (events, _) = pixel_data(case, nominal, &setting, pixel as usize);
        let mut random = Random::new(seed, &[u64::from(pixel), 0x1e51]);
        intervals(scene.pixel(n), &nominal.map_sensor(), &noise, &events, case.span, &mut random).into_iter().map(|interval| (pixel, interval)).collect()
    };
    Ok(Residuals {
        events: of_events(case, &again, sample),
        frames: of_frames(case, &again, sample, nominal.number.black_level, nominal.saturation_dn),
        intervals: (0..sample.len()).into_par_iter().with_min_len(16).flat_map_iter(one).collect(),
    })
}

/// Residuals in a few numbers; NaN where there is nothing to count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Digested {
    /// Share of recorded events that the simulation has not.
    pub extra: f64,
    /// Share of simulated events that the recording has not.
    pub missing: f64,
    /// Median of recorded less simulated time of pairs, seconds.
    pub delay_s: f64,
    /// Median distance of delays from their median, seconds.
    pub delay_spread_s: f64,
    /// Root mean square of the log of recorded over simulated frame values.
    pub frame_log_ratio: f64,
    /// Largest distance between the distribution of rescaled intervals and the uniform one.
    pub ks: f64,
    /// Events that the model expects under the light, over those recorded.
    pub expected_over_recorded: f64,
}

impl Residuals {
    /// In a few numbers.
    pub fn digested(&self) -> Digested {
        let mut delays: Vec<f64> =
            self.events.iter().filter_map(|event| if let Fate::Paired(by) = event.fate { Some(by as f64 * 1e-9) } else { None }).collect();
        let paired = delays.len() as f64;
        let count = |fate: Fate| self.events.iter().filter(|event| event.fate == fate).count() as f64;
        let (extra, missing) = (count(Fate::Extra), count(Fate::Missing));
        let delay_s = median(&mut delays);
        let mut apart: Vec<f64> = delays.iter().map(|delay| (delay - delay_s).abs()).collect();
        let squares: f64 = self.frames.iter().map(|frame| frame.log_ratio * frame.log_ratio).sum();
        let ended: Vec<&Interval> = self.intervals.iter().map(|(_, interval)| interval).filter(|interval| interval.event.is_some()).collect();
        // An event inside the blind time has an interval of no length, which says nothing of light.
        let mut uniform: Vec<f64> = ended.iter().filter(|interval| interval.compensator > 0.0).map(|interval| interval.uniform).collect();
        Digested {
            extra: extra / (paired + extra),
            missing: missing / (paired + missing),
            delay_s,
            delay_spread_s: median(&mut apart),
            frame_log_ratio: libm::sqrt(squares / self.frames.len() as f64),
            ks: if uniform.is_empty() { f64::NAN } else { ks_uniform(&mut uniform) },
            expected_over_recorded: self.intervals.iter().map(|(_, interval)| interval.compensator).sum::<f64>() / ended.len() as f64,
        }
    }
}

/// The median; sorts. NaN of none.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() { f64::NAN } else { crate::integrity::median(values) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    /// The true light of a small recording, and what the stated sensor leaves of a recording with effects.
    fn left(effects: &Described) -> Digested {
        let case = testing::case_with(effects);
        let nominal = case.nominal().unwrap();
        residuals(&case, &nominal, &Sample::all(&case, 4), &testing::scene(&case), None, 1).unwrap().digested()
    }

    #[test]
    fn under_the_true_light_a_sound_sensor_leaves_nothing() {
        let found = left(&Described::new());
        assert!(found.extra == 0.0 && found.missing == 0.0 && found.delay_s == 0.0, "{found:?}");
        assert!(found.frame_log_ratio < 1e-6, "{found:?}");
    }

    #[test]
    fn a_clock_that_runs_ahead_shows_as_its_delay() {
        let offset = serde_json::json!({"offset": "-300 us"});
        let found = left(&[("clock_offset".to_owned(), offset.as_object().unwrap().clone())].into_iter().collect());
        assert!((found.delay_s + 300e-6).abs() < 2e-6, "{found:?}");
    }

    #[test]
    fn lost_events_are_missing_at_the_rate_they_are_lost() {
        let loss = serde_json::json!({"fraction": 0.2});
        let found = left(&[("event_loss".to_owned(), loss.as_object().unwrap().clone())].into_iter().collect());
        // Of a thousand events, a fifth is good to two hundredths.
        assert!((found.missing - 0.2).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn of_nothing_nothing_is_known() {
        let found = Residuals::default().digested();
        assert!(found.extra.is_nan() && found.delay_s.is_nan() && found.ks.is_nan() && found.frame_log_ratio.is_nan());
    }
}
