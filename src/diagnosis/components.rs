//! What is drawn at random for each pixel or row, by how it spreads changes of closures.
//!
//! A number that a pixel or a row has for itself moves all of its changes alike: products of two of them that share no error have the variance of that number as their
//! mean ([`crate::closures`]). It is held against that of a simulated recording of the stated sensor.

use crate::case::Case;
use crate::closures::{Change, PLAIN};
use crate::nominal::Nominal;
use crate::regression::{Products, RIDGE, jackknife};
use crate::sample::Sample;
use crate::side::{PART_COUNT, part_of};
use serde::{Deserialize, Serialize};

/// What has a variance of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spread {
    /// Thresholds from pixel to pixel, natural-log units.
    ThresholdsOfPixels,
    /// Delays from row to row, seconds.
    DelaysOfRows,
}

impl Spread {
    /// All of them.
    pub const ALL: [Spread; 2] = [Spread::ThresholdsOfPixels, Spread::DelaysOfRows];
}

/// A variance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// Of what.
    pub spread: Spread,
    /// Less that of the stated sensor.
    pub variance: f64,
    /// Its standard error.
    pub error: f64,
}

impl Component {
    /// In standard errors.
    pub fn significance(&self) -> f64 {
        if self.error > 0.0 { self.variance / self.error } else { 0.0 }
    }
}

/// All variances of a recording's changes beyond those of its control's.
pub fn components(case: &Case, nominal: &Nominal, sample: &Sample, changes: &[Change], control: &[Change]) -> Vec<Component> {
    let (own, of_control) = (Residuals::new(case, nominal, sample, changes), Residuals::new(case, nominal, sample, control));
    Spread::ALL
        .iter()
        .map(|&spread| {
            let (own, of_control) = (own.variance(spread), of_control.variance(spread));
            Component { spread, variance: own.0 - of_control.0, error: libm::hypot(own.1, of_control.1) }
        })
        .collect()
}

/// Changes less what the simplest effects explain of them.
struct Residuals<'a> {
    changes: &'a [Change],
    left: Vec<f64>,
    /// ON, OFF.
    thresholds: [f64; 2],
    /// Column, row and part of each change.
    at: Vec<(u32, u32, usize)>,
}

impl<'a> Residuals<'a> {
    fn new(case: &Case, nominal: &Nominal, sample: &Sample, changes: &'a [Change]) -> Residuals<'a> {
        let mut products = Products::new(PLAIN);
        let row = |change: &Change| -> Vec<(usize, f64)> { change.plain.iter().copied().enumerate().collect() };
        changes.iter().for_each(|change| products.add(&row(change), change.value, change.weight));
        let found = products.solve(|_| true, RIDGE);
        let left = changes.iter().map(|change| change.value - change.plain.iter().zip(&found).map(|(x, c)| x * c).sum::<f64>()).collect();
        let place = |change: &Change| {
            let (x, y) = case.place(sample.pixels[change.place] as usize);
            (x, y, part_of(case.extent, x, y))
        };
        Residuals { changes, left, thresholds: [nominal.pixel.threshold_on, nominal.pixel.threshold_off], at: changes.iter().map(place).collect() }
    }

    /// A variance and its standard error.
    fn variance(&self, spread: Spread) -> (f64, f64) {
        match spread {
            Spread::ThresholdsOfPixels => ratio(&self.of_pixels()),
            Spread::DelaysOfRows => shared(&self.of_rows()),
        }
    }

    /// By part: products of changes of a pixel that share no frame.
    fn of_pixels(&self) -> Vec<(f64, f64)> {
        let mut sums = vec![(0.0, 0.0); PART_COUNT];
        let mut from = 0;
        while from < self.changes.len() {
            let place = self.changes[from].place;
            let to = from + self.changes[from..].iter().take_while(|change| change.place == place).count();
            for polarity in 0..2 {
                for n in from..to {
                    for m in n + 1..to {
                        let (a, b) = (&self.changes[n], &self.changes[m]);
                        if b.frame < a.frame + 2 {
                            continue;
                        }
                        let (x, z) = (a.plain[polarity] / self.thresholds[polarity], b.plain[polarity] / self.thresholds[polarity]);
                        let (of_x, of_z) = (a.weight * x, b.weight * z);
                        let sum = &mut sums[self.at[n].2];
                        sum.0 += of_x * self.left[n] * of_z * self.left[m];
                        sum.1 += of_x * x * of_z * z;
                    }
                }
            }
            from = to;
        }
        sums
    }

    /// By row: what two halves of its pixels say of its delay, with weights.
    fn of_rows(&self) -> Vec<[(f64, f64); 2]> {
        let mut halves: Vec<[(f64, f64); 2]> = Vec::new();
        for (n, change) in self.changes.iter().enumerate() {
            let (column, row, _) = self.at[n];
            if halves.len() <= row as usize {
                halves.resize(row as usize + 1, [(0.0, 0.0); 2]);
            }
            // Neighbours share the light's errors: halves are of blocks.
            let half = &mut halves[row as usize][((column / 4 + row / 4) % 2) as usize];
            let x = change.plain[2];
            half.0 += change.weight * x * self.left[n];
            half.1 += change.weight * x * x;
        }
        halves.retain(|halves| halves.iter().all(|half| half.1 > 0.0));
        halves
    }
}

/// A ratio of sums, and its standard error from leaving each term out.
fn ratio(sums: &[(f64, f64)]) -> (f64, f64) {
    let all = sums.iter().fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
    if all.1 <= 0.0 {
        return (0.0, f64::INFINITY);
    }
    let left_out: Vec<f64> = sums.iter().filter(|one| one.1 > 0.0).map(|one| (all.0 - one.0) / f64::max(all.1 - one.1, 1e-300)).collect();
    (all.0 / all.1, jackknife(&left_out))
}

/// Mean product of what two halves of rows say, and its standard error where they shared nothing.
fn shared(halves: &[[(f64, f64); 2]]) -> (f64, f64) {
    let (mut product, mut squares, mut weights) = (0.0, [0.0; 2], [0.0; 3]);
    for [a, b] in halves {
        product += a.0 * b.0;
        weights[2] += a.1 * b.1;
        for (n, half) in [a, b].into_iter().enumerate() {
            squares[n] += half.0 * half.0;
            weights[n] += half.1 * half.1;
        }
    }
    if halves.len() < LEAST_ROWS {
        return (0.0, f64::INFINITY);
    }
    // Fisher's transform of the correlation of both halves.
    let correlation = product / f64::max(libm::sqrt(squares[0] * squares[1]), 1e-300);
    let standard = libm::atanh(correlation.clamp(-0.999, 0.999)) * libm::sqrt(halves.len() as f64 - 3.0);
    let variance = product / f64::max(weights[2], 1e-300);
    (variance, if standard == 0.0 { f64::INFINITY } else { variance / standard })
}

/// Fewer rows than this tell no correlation.
const LEAST_ROWS: usize = 6;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::band::Band;
    use crate::closures::changes;
    use crate::record::{Conditions, record};
    use crate::scenes::MadeUp;
    use photocurrent_core::Extent;
    use serde_json::json;

    /// What a sensor with an effect records of a made-up scene, and by which variances it differs from the sensor without.
    fn found(effects: serde_json::Value) -> Vec<Component> {
        let case = MadeUp::new(1, 4, Extent { width: 72, height: 54 }, 0.15).with_edge(0.5).recording().unwrap();
        let (nominal, sample) = (case.nominal().unwrap(), Sample::all(&case, 4));
        let light = Band::scene(&case, &Band::all(&case, &nominal, &sample));
        let described =
            |effects: &serde_json::Value| effects.as_object().unwrap().iter().map(|(id, of)| (id.clone(), of.as_object().unwrap().clone())).collect();
        let of = |effects: &serde_json::Value, seed: u64| {
            let case = record(&case, &nominal, &sample, &light, &described(effects), &Conditions { seed, ..Conditions::default() }).unwrap();
            changes(&case, &nominal, &sample, &Band::all(&case, &nominal, &sample))
        };
        components(&case, &nominal, &sample, &of(&effects, 1), &of(&json!({}), 2))
    }

    #[test]
    fn thresholds_that_differ_from_pixel_to_pixel_have_their_variance() {
        let of_pixels = found(json!({"threshold_mismatch": {"sigma": 0.03}}))[0];
        assert_eq!(of_pixels.spread, Spread::ThresholdsOfPixels);
        let sigma = libm::sqrt(of_pixels.variance);
        assert!((sigma / 0.03 - 1.0).abs() < 0.4 && of_pixels.significance() > 3.0, "{of_pixels:?}");
        assert!(found(json!({})).iter().all(|one| one.significance().abs() < 3.0));
    }

    #[test]
    fn rows_that_are_late_by_chance_have_their_variance() {
        let late = found(json!({"row_skew": {"sigma": "300 us"}}));
        let sigma = libm::sqrt(late[1].variance);
        assert!((sigma / 300e-6 - 1.0).abs() < 0.4 && late[1].significance() > 2.0, "{late:?}");
        let unlike = found(json!({"threshold_mismatch": {"sigma": 0.03}}));
        assert!(unlike[1].variance.abs() < 0.3 * late[1].variance, "{unlike:?} {late:?}");
    }
}
