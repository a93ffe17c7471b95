//! The light of the sampled pixels, estimated with the nominal sensor: log light at knots, linear between.

use crate::case::Case;
use crate::nominal::Nominal;
use crate::sample::Sample;
use photocurrent_sensor::map::{MapEvent, MapFrame, MapGroup, MapOptions, MapProblem, MapSensor, MapStatus, MapTask, Noise, Prior};
use rayon::prelude::*;

/// Most steps of an estimate: the local variance of the prior has not settled by then, and light errs less between events than after more steps.
const STEPS: usize = 5;

/// How the light is estimated.
#[derive(Clone, Copy, Debug)]
pub struct SceneSetting {
    /// Assumed standard deviation of events.
    pub noise: Noise,
    /// Frame values are assumed good to this share of the signal, beyond their stated noise.
    pub frame_share: f64,
    /// And to this, DN.
    pub frame_dn: f64,
    /// Softness of the no-event constraint, natural-log units; 0 = not used.
    pub no_event_sigma: f64,
    /// Prior, spacing of knots, steps.
    pub options: MapOptions,
}

impl Default for SceneSetting {
    fn default() -> SceneSetting {
        let noise = Noise { event: 0.03, ..Noise::default() };
        let options = MapOptions { max_iterations: STEPS, ..MapOptions::default() };
        SceneSetting { noise, frame_share: 0.005, frame_dn: 0.5, no_event_sigma: 0.03, options }
    }
}

impl SceneSetting {
    /// Events are trusted closely and more steps are taken: more of them match events of such light.
    pub fn close() -> SceneSetting {
        let usual = SceneSetting::default();
        SceneSetting { noise: Noise { event: 0.01, ..usual.noise }, options: MapOptions { max_iterations: 8, ..usual.options }, ..usual }
    }
}

/// Knots, log light, and whether it is known.
pub type Found = (Vec<i64>, Vec<f64>, bool);

/// Log light of the pixels of a sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    first: Vec<usize>,
    /// Knots, ns, pixel after pixel.
    pub t_ns: Vec<i64>,
    /// Log light at each.
    pub log_light: Vec<f64>,
    /// Which pixels of the sample have an estimate; the others have no usable frame or did not converge, and carry one constant knot.
    pub is_known: Vec<bool>,
    /// How well the prior predicted each pixel's measurements; 0 where the light was not estimated.
    pub log_evidence: Vec<f64>,
}

impl Scene {
    /// The light of every pixel of a sample, with the setting's prior.
    pub fn estimate(case: &Case, nominal: &Nominal, sample: &Sample, setting: &SceneSetting) -> Scene {
        Scene::estimate_with(case, nominal, sample, setting, &vec![setting.options.prior; sample.len()])
    }

    /// The light of every pixel of a sample, with a prior for each.
    ///
    /// Each pixel by itself, so it does not matter which others are in the sample.
    ///
    /// # Panics
    /// When there is not one prior for each pixel.
    pub fn estimate_with(case: &Case, nominal: &Nominal, sample: &Sample, setting: &SceneSetting, priors: &[Prior]) -> Scene {
        let given = |n: usize| Given { data: pixel_data(case, nominal, setting, sample.pixels[n] as usize), sensor: nominal.map_sensor(), beyond: Vec::new() };
        Scene::estimate_from(sample, priors, given, |given| task(case, setting, &given.data, given.sensor, &given.beyond), case.span.0)
    }

    /// The light of every pixel of a sample, from measurements and sensor of each (by its place in the sample) and the problem that they make.
    ///
    /// # Panics
    /// When there is not one prior for each pixel.
    pub fn estimate_from(
        sample: &Sample,
        priors: &[Prior],
        given: impl Fn(usize) -> Given + Sync,
        task: impl for<'a> Fn(&'a Given) -> MapTask<'a> + Sync,
        start_ns: i64,
    ) -> Scene {
        const CHUNK: usize = 64;
        assert_eq!(priors.len(), sample.len(), "one prior for each pixel");
        let places: Vec<usize> = (0..sample.len()).collect();
        let parts: Vec<Vec<(Found, f64)>> = places
            .par_chunks(CHUNK)
            .map_init(MapGroup::default, |group, places| {
                let given: Vec<Given> = places.iter().map(|&n| given(n)).collect();
                let mut found = vec![((vec![start_ns], vec![0.0], false), 0.0); places.len()];
                let lit: Vec<usize> = (0..places.len()).filter(|&n| given[n].data.1.iter().any(|frame| !frame.saturated)).collect();
                let tasks: Vec<MapTask<'_>> = lit
                    .iter()
                    .map(|&n| {
                        let task = task(&given[n]);
                        MapTask { options: MapOptions { prior: priors[places[n]], ..task.options }, ..task }
                    })
                    .collect();
                group.solve(&tasks, |n, solution| {
                    let is_known = solution.status != MapStatus::Failed;
                    found[lit[n]] = ((solution.t_ns.to_vec(), solution.log_photocurrent.to_vec(), is_known), solution.log_evidence);
                });
                found
            })
            .collect();
        let (pixels, log_evidence): (Vec<Found>, Vec<f64>) = parts.into_iter().flatten().unzip();
        Scene { log_evidence, ..Scene::from_pixels(pixels) }
    }

    /// From knots, log light, and whether it is known, of each pixel in turn.
    pub fn from_pixels(pixels: impl IntoIterator<Item = Found>) -> Scene {
        let mut scene = Scene { first: vec![0], ..Scene::default() };
        for (t_ns, log_light, is_known) in pixels {
            scene.t_ns.extend(t_ns);
            scene.log_light.extend(log_light);
            scene.first.push(scene.t_ns.len());
            scene.is_known.push(is_known);
            scene.log_evidence.push(0.0);
        }
        scene
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.is_known.len()
    }

    /// No pixel at all?
    pub fn is_empty(&self) -> bool {
        self.is_known.is_empty()
    }

    /// Knots and log light of pixel `n` of the sample.
    pub fn pixel(&self, n: usize) -> (&[i64], &[f64]) {
        let range = self.first[n]..self.first[n + 1];
        (&self.t_ns[range.clone()], &self.log_light[range])
    }

    /// Log light of pixel `n` of the sample at an instant: linear between knots, constant beyond them.
    pub fn at(&self, n: usize, t_ns: i64) -> f64 {
        let (t, u) = self.pixel(n);
        let after = t.partition_point(|&knot| knot <= t_ns);
        match (after.checked_sub(1), t.get(after)) {
            (None, _) => u[0],
            (Some(last), None) => u[last],
            (Some(before), Some(&next)) => u[before] + (u[after] - u[before]) * (t_ns - t[before]) as f64 / (next - t[before]) as f64,
        }
    }
}

/// A pixel's measurements as the solver takes them.
pub type PixelData = (Vec<MapEvent>, Vec<MapFrame>);

/// What the solver gets of a pixel.
#[derive(Clone, Debug)]
pub struct Given {
    /// What was measured.
    pub data: PixelData,
    /// By which sensor.
    pub sensor: MapSensor,
    /// See [`MapProblem::beyond`].
    pub beyond: Vec<f64>,
}

/// A pixel's measurements as the solver takes them.
pub fn pixel_data(case: &Case, nominal: &Nominal, setting: &SceneSetting, pixel: usize) -> PixelData {
    let event = |event: &crate::case::Recorded| MapEvent {
        t_in_ns: event.t_in_ns,
        t_off_ns: event.t_off_ns.max(event.t_in_ns),
        polarity: event.polarity,
        is_lone: false,
    };
    let events = case.events.of(pixel).iter().map(event).collect();
    let (_, y) = case.place(pixel);
    let frame = |l: usize| -> Option<MapFrame> {
        let dn = case.dn(l, pixel);
        let exposure = case.frames.as_ref()?.times.exposure(l, y);
        let signal = f64::max(dn - nominal.number.black_level, 0.0);
        let sigma_dn = nominal.frame_sigma_with_dn(dn, [setting.frame_share * signal, setting.frame_dn]);
        dn.is_finite().then_some(MapFrame { start_ns: exposure.start.0, end_ns: exposure.end.0, dn, sigma_dn, saturated: dn >= nominal.saturation_dn })
    };
    (events, (0..case.frame_count()).filter_map(frame).collect())
}

/// The problem of one pixel.
pub fn task<'a>(case: &Case, setting: &SceneSetting, data: &'a PixelData, sensor: MapSensor, beyond: &'a [f64]) -> MapTask<'a> {
    let problem = MapProblem {
        events: &data.0,
        frames: &data.1,
        hints: &[],
        start_ns: case.span.0,
        end_ns: case.span.1,
        sensor,
        noise: setting.noise,
        stamp_sigma_s: case.t_resolution_ns as f64 * 1e-9 / libm::sqrt(12.0),
        no_event_sigma: setting.no_event_sigma,
        lost_before: &[],
        beyond,
    };
    MapTask { problem, options: setting.options }
}
