//! The light of a recording's sampled pixels as a value by itself: estimated, handed on as tracks, taken back.
//!
//! Tracks hold photocurrent in 32 bits, so light that was handed on differs from the estimate by some 1e-7; every stage that takes it takes the same. A pixel that was
//! not looked at, or whose light could not be estimated, has no knot.

use crate::case::Case;
use crate::faithful::{Faithful, TRIED, came_again, faithful};
use crate::nominal::Nominal;
use crate::record::{Conditions, Described, record};
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting};
use photocurrent_core::{Between, Colour, DataError, TimeSpan, TrackBand, TrackSet, TracksMeta};
use photocurrent_sensor::map::Prior;
use std::sync::Arc;

/// Names of [`TRIED`], as tables have them.
pub const PRIORS: [&str; TRIED.len()] = ["usual", "glide_slow", "glide", "glide_fast"];

/// An estimate of light.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The pixels.
    pub sample: Sample,
    /// Their light.
    pub scene: Scene,
    /// The prior of each, a place in [`PRIORS`].
    pub priors: Vec<usize>,
    /// Events that came again, twice, over recorded and simulated ones, all pixels together: 1 is perfect.
    pub agreement: f64,
}

/// The light of a sample, each pixel with the prior that fires its events again best.
///
/// # Errors
/// When the description's effects are not understood.
pub fn fit(case: &Case, nominal: &Nominal, sample: Sample, setting: &SceneSetting) -> Result<Fit, String> {
    let Faithful { scene, priors, agreement } = faithful(case, nominal, &sample, setting)?;
    let place = |prior: &Prior| TRIED.iter().position(|tried| tried == prior).unwrap_or(0);
    Ok(Fit { priors: priors.iter().map(place).collect(), sample, scene, agreement })
}

/// The light of the pixels of another fit with its priors, for a recording that is to be compared with the one of that fit.
///
/// # Errors
/// When the description's effects are not understood.
pub fn fit_like(case: &Case, nominal: &Nominal, pixels: &[(u32, usize)], setting: &SceneSetting) -> Result<Fit, String> {
    let mut pixels = pixels.to_vec();
    pixels.sort_unstable();
    pixels.dedup_by_key(|(pixel, _)| *pixel);
    let sample = Sample::of_pixels(case, pixels.iter().map(|(pixel, _)| *pixel), 6);
    let priors: Vec<usize> = pixels.iter().map(|(_, prior)| (*prior).min(TRIED.len() - 1)).collect();
    let tried: Vec<Prior> = priors.iter().map(|&prior| TRIED[prior]).collect();
    let scene = Scene::estimate_with(case, nominal, &sample, setting, &tried);
    let again = record(case, nominal, &sample, &scene, &Described::new(), &Conditions::default())?;
    let (mut came, mut all) = (0, 0);
    for &pixel in sample.pixels.iter() {
        let (recorded, simulated) = (case.events.of(pixel as usize), again.events.of(pixel as usize));
        came += 2 * came_again(recorded, simulated);
        all += recorded.len() + simulated.len();
    }
    Ok(Fit { sample, scene, priors, agreement: if all == 0 { 1.0 } else { came as f64 / all as f64 } })
}

/// What is known of a recording's tracks before they are there.
pub fn tracks_meta(case: &Case) -> TracksMeta {
    TracksMeta {
        extent: case.extent,
        span: TimeSpan::new(case.span.0, case.span.1),
        nominal_exposure_ns: case.frames.as_ref().and_then(|frames| frames.times.nominal_exposure_ns()).unwrap_or(0),
        between: Between::LogLinear,
        colour: Colour::Mono,
        has_sigma: false,
        count_hint: None,
    }
}

/// Light as tracks.
pub fn tracks(case: &Case, sample: &Sample, scene: &Scene) -> TrackSet {
    let mut band = TrackBand::begin(0, case.extent.width);
    for pixel in 0..case.extent.pixels() {
        match sample.place(pixel).filter(|&n| scene.is_known[n]) {
            Some(n) => {
                let (t, u) = scene.pixel(n);
                band.push(t.iter().zip(u).map(|(t, u)| (*t, libm::exp(*u) as f32)));
            }
            None => band.push([]),
        }
    }
    TrackSet::in_memory(Arc::new(tracks_meta(case)), band)
}

/// Tracks as light: the pixels that have a light, and it.
///
/// # Errors
/// When they cannot be read, are of another array, are not grey, or hold between knots.
pub fn from_tracks(case: &Case, tracks: &TrackSet) -> Result<(Sample, Scene), DataError> {
    let meta = &tracks.meta;
    if meta.extent != case.extent || meta.colour != Colour::Mono || meta.between != Between::LogLinear {
        let found = format!("{} tracks of {} pixels, {}", meta.colour, meta.extent, if meta.between == Between::Hold { "held" } else { "log-linear" });
        return Err(DataError::new(format!("found {found}; light for a diagnosis is grey, of {} pixels, and log-linear between knots", case.extent)));
    }
    let band = tracks.read(case.extent.rows())?;
    let (mut pixels, mut found) = (Vec::new(), Vec::new());
    for pixel in 0..case.extent.pixels() {
        let (x, y) = case.place(pixel);
        let track = band.pixel(x, y);
        if !track.t.is_empty() && track.photocurrent.iter().all(|i| i.is_finite() && *i > 0.0) {
            pixels.push(pixel as u32);
            found.push((track.t.to_vec(), track.photocurrent.iter().map(|i| libm::log(f64::from(*i))).collect(), true));
        }
    }
    Ok((Sample::of_pixels(case, pixels, 6), Scene::from_pixels(found)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn light_that_was_handed_on_is_the_same_light() {
        let case = testing::case();
        let sample = Sample::all(&case, 4);
        let mut scene = testing::scene(&case);
        scene.is_known[7] = false;
        let (again, light) = from_tracks(&case, &tracks(&case, &sample, &scene)).unwrap();
        assert_eq!(again.len(), sample.len() - 1);
        assert!(again.place(7).is_none());
        for (n, &pixel) in again.pixels.iter().enumerate() {
            let was = sample.place(pixel as usize).unwrap();
            assert_eq!(light.pixel(n).0, scene.pixel(was).0);
            assert!(light.pixel(n).1.iter().zip(scene.pixel(was).1).all(|(a, b)| (a - b).abs() < 1e-7));
        }
    }

    #[test]
    fn a_fit_like_another_has_its_pixels_priors_and_light() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let setting = SceneSetting::default();
        let found = fit(&case, &nominal, Sample::all(&case, 4), &setting).unwrap();
        let pixels: Vec<(u32, usize)> = found.sample.pixels.iter().copied().zip(found.priors.iter().copied()).collect();
        let again = fit_like(&case, &nominal, &pixels, &setting).unwrap();
        assert_eq!((&again.sample.pixels, &again.priors), (&found.sample.pixels, &found.priors));
        assert_eq!(again.scene.log_light, found.scene.log_light);
        assert!((again.agreement - found.agreement).abs() < 1e-12);
    }

    #[test]
    fn tracks_of_another_array_or_kind_are_refused() {
        let case = testing::case();
        let held = photocurrent_core::testing::tracks(case.extent.width, case.extent.height);
        assert!(from_tracks(&case, &held).unwrap_err().message.contains("held"));
        assert!(from_tracks(&case, &photocurrent_core::testing::tracks(3, 2)).is_err());
    }
}
