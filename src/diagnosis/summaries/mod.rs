//! A recording in some three hundred numbers, in fixed order and with names.
//!
//! Three families: *closure*, how frames differ from the light that thresholds through the events give, against what every effect would add to it; *event*, how single
//! events differ from what their neighbours and the frames foretell; *native*, what the stream is like without any model. No number alone says much. Their difference
//! to the same numbers of the nominal sensor's recording of the same scene ([`crate::deviation`]) is what effects are recognised by.
//!
//! All are finite for any input, of order 0.01 to 10, and depend on no order of threads.

mod closure;
mod event;
mod native;

use crate::band::Band;
use crate::candidates::Scales;
use crate::case::{Case, PixelEvents};
use crate::nominal::Nominal;
use crate::sample::Sample;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Extent, Sensor};
use serde::{Deserialize, Serialize};

/// Numbers with names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summaries {
    /// `closure.leak_on`, `event.jackknife.gap_2` ...
    pub names: Vec<String>,
    /// As many.
    pub values: Vec<f64>,
}

impl Summaries {
    fn put(&mut self, name: impl Into<String>, value: f64) {
        self.names.push(name.into());
        self.values.push(if value.is_finite() { value.clamp(-1e3, 1e3) } else { 0.0 });
    }
}

/// What a recording is looked at with.
pub struct View<'a> {
    /// The recording.
    pub case: &'a Case,
    /// Its sensor as stated.
    pub nominal: &'a Nominal,
    /// Which pixels.
    pub sample: &'a Sample,
    /// Their light.
    pub bands: &'a [Band],
    /// How bright, fast and busy the *recording* is: the same scales for all that is simulated of it.
    pub scales: &'a Scales,
}

/// All summaries of a view.
pub fn summaries(view: &View<'_>) -> Summaries {
    let mut all = Summaries::default();
    closure::put(view, &mut all);
    event::put(view, &mut all);
    native::put(view, &mut all);
    all
}

/// The names of all summaries, which no recording changes.
///
/// # Errors
/// Never, but for the message of a sensor that is not stated.
pub fn names() -> Result<Vec<String>, String> {
    let extent = Extent { width: 1, height: 1 };
    let mut sensor = Sensor::unknown("none");
    sensor.front_end.tau_0 = Some(Duration::new(0));
    sensor.front_end.alpha = Some(Duration::new(0));
    sensor.comparator.threshold_on = Some(1.0);
    sensor.comparator.threshold_off = Some(1.0);
    sensor.readout.refractory = Some(Duration::new(0));
    let events = PixelEvents::new([Vec::new()]);
    let case = Case { extent, span: (0, 1_000_000), events, has_t_in: true, t_resolution_ns: 1, frames: None, sensor };
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let sample = Sample::spread(&case, 1);
    let bands = Band::all(&case, &nominal, &sample);
    Ok(summaries(&View { case: &case, nominal: &nominal, sample: &sample, bands: &bands, scales: &Scales::of(&case, &nominal) }).names)
}

/// Numbers that say what kind of recording it is: which nulls are like it.
pub fn context(view: &View<'_>, of: &Summaries) -> Vec<f64> {
    let (nominal, scales) = (view.nominal, view.scales);
    let value = |name: &str| of.names.iter().position(|n| n == name).map_or(0.0, |at| of.values[at]);
    let tau = nominal.pixel.front_end.tau_0_s + nominal.pixel.front_end.alpha_s / scales.light;
    let is = |yes: bool| if yes { 1.0 } else { 0.0 };
    use photocurrent_core::sensor::Reset;
    vec![
        libm::log(scales.rate_hz * scales.duration_s / view.case.extent.pixels() as f64 + 0.1),
        libm::log(scales.threshold),
        libm::log(tau + 1e-5),
        libm::log(scales.slope_per_s),
        libm::log(nominal.pixel.refractory_ns as f64 * 1e-9 + 1e-5),
        is(nominal.reset == Reset::Resample),
        libm::log10(view.case.t_resolution_ns as f64 + 1.0),
        value("native.silent"),
        value("native.reversals"),
        value("closure.scatter.sure"),
        value("closure.scatter.doubtful"),
        value("native.runs_3"),
        value("closure.light_spread"),
    ]
}

/// Mean and count of values by bin.
#[derive(Clone, Debug)]
pub(crate) struct Bins {
    sum: Vec<f64>,
    square: Vec<f64>,
    weight: Vec<f64>,
}

impl Bins {
    pub(crate) fn new(n: usize) -> Bins {
        Bins { sum: vec![0.0; n], square: vec![0.0; n], weight: vec![0.0; n] }
    }

    pub(crate) fn add(&mut self, bin: usize, value: f64) {
        let bin = bin.min(self.sum.len() - 1);
        self.sum[bin] += value;
        self.square[bin] += value * value;
        self.weight[bin] += 1.0;
    }

    pub(crate) fn merge(&mut self, other: &Bins) {
        for n in 0..self.sum.len() {
            self.sum[n] += other.sum[n];
            self.square[n] += other.square[n];
            self.weight[n] += other.weight[n];
        }
    }

    /// Mean of a bin, drawn to zero where there are few values.
    pub(crate) fn mean(&self, bin: usize) -> f64 {
        self.sum[bin] / (self.weight[bin] + 20.0)
    }

    /// Root mean square of a bin.
    pub(crate) fn rms(&self, bin: usize) -> f64 {
        libm::sqrt(self.square[bin] / (self.weight[bin] + 20.0))
    }
}

/// The bin of a value among rising edges.
pub(crate) fn bin(value: f64, edges: &[f64]) -> usize {
    edges.iter().take_while(|edge| value >= **edge).count()
}

/// Value at a share of the way through sorted numbers; 0 of none.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    if sorted.is_empty() { 0.0 } else { sorted[((sorted.len() - 1) as f64 * share).round() as usize] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn of(case: &Case) -> Summaries {
        let nominal = case.nominal().unwrap();
        let sample = Sample::spread(case, 3);
        let bands = Band::all(case, &nominal, &sample);
        let scales = Scales::of(case, &nominal);
        summaries(&View { case, nominal: &nominal, sample: &sample, bands: &bands, scales: &scales })
    }

    #[test]
    fn names_are_apart_and_the_same_for_every_recording() {
        let case = testing::case();
        let full = of(&case);
        let silent = Case { events: crate::case::PixelEvents::new(vec![Vec::new(); case.extent.pixels()]), frames: None, ..case };
        let empty = of(&silent);
        assert_eq!(full.names, empty.names);
        assert_eq!(full.names, names().unwrap());
        let mut apart = full.names.clone();
        apart.sort();
        apart.dedup();
        assert_eq!(apart.len(), full.names.len());
        assert!(full.values.iter().chain(&empty.values).all(|value| value.is_finite()));
    }

    #[test]
    fn thresholds_that_differ_by_sign_show_as_drifts_of_opposite_sign() {
        let more = |fraction: f64| {
            let effect = [("threshold_asymmetry".to_owned(), [("fraction".to_owned(), serde_json::json!(fraction))].into_iter().collect())];
            let all = of(&testing::case_with(&effect.into_iter().collect()));
            let at = all.names.iter().position(|name| name == "closure.drift.corr").unwrap();
            all.values[at]
        };
        // ON events are worth more than stated: light summed with the stated thresholds falls behind the frames, so frames rise against it.
        assert!(more(0.2) > 0.2 && more(-0.2) < -0.2, "{} {}", more(0.2), more(-0.2));
    }
}
