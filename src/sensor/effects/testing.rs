//! What the tests of effects share: effects as a description states them, many pixels, moments of samples.

use super::{Effect, Site, catalogue};
use serde_json::Value;

/// A pixel of a large array.
pub(crate) fn site(x: u32, y: u32) -> Site {
    Site { x, y, width: 200, height: 100, seed: 7 }
}

/// All 20,000 pixels of that array.
pub(crate) fn sites() -> impl Iterator<Item = Site> {
    (0..100).flat_map(|y| (0..200).map(move |x| site(x, y)))
}

fn read(id: &str, parameters: &Value) -> Result<Box<dyn Effect>, String> {
    let kind =
        catalogue().into_iter().find(|kind| kind.decl.id == id).expect("the effect is in the catalogue");
    kind.read(parameters.as_object().expect("parameters are a table"))
}

/// The effect of a description that is right.
pub(crate) fn described(id: &str, parameters: Value) -> Box<dyn Effect> {
    read(id, &parameters).expect("the description is right")
}

/// The message about a description that is wrong.
pub(crate) fn refused(id: &str, parameters: Value) -> String {
    read(id, &parameters).err().expect("the description is refused")
}

/// Mean and standard deviation.
pub(crate) fn moments(samples: &[f64]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    let variance = samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
    (mean, libm::sqrt(variance))
}

/// Pearson's correlation.
pub(crate) fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let ((mean_a, sigma_a), (mean_b, sigma_b)) = (moments(a), moments(b));
    let product: f64 = a.iter().zip(b).map(|(x, y)| (x - mean_a) * (y - mean_b)).sum();
    product / a.len() as f64 / (sigma_a * sigma_b)
}
