//! The pixels of a sample ready to be seen through effects: their light cut into short steps, and the mixtures of neighbours' light.

use crate::candidates::Trial;
use crate::case::Case;
use crate::nominal::Nominal;
use crate::record::effects_of;
use crate::sample::Sample;
use crate::scene::{PixelData, Scene, SceneSetting, pixel_data};
use photocurrent_sensor::conditional::{Conditional, Look, Track, at, conditional, frame_values};
use photocurrent_sensor::effects::{Domain, Effect, Kernel, Site};
use photocurrent_sensor::elementary::{exp, ln};
use photocurrent_sensor::forward::neighbours::{joined, stand_in};
use rayon::prelude::*;

/// The longest step of light, ns.
const STEP_NS: i64 = 500_000;
/// The grid on which neighbours' light is mixed, ns.
const GRID_NS: i64 = 200_000;

/// A trial with its effects built and told the load of the recording.
pub struct Prepared {
    /// The base fields.
    pub nominal: Nominal,
    /// The effects that the description states, and those of the trial.
    pub effects: Vec<Box<dyn Effect>>,
    kernel: Option<Kernel>,
}

impl Prepared {
    /// The base fields alone.
    pub fn plain(nominal: &Nominal) -> Prepared {
        Prepared { nominal: nominal.clone(), effects: Vec::new(), kernel: None }
    }

    /// The mixture of neighbours that the event path sees.
    pub fn kernel(&self) -> Option<&Kernel> {
        self.kernel.as_ref()
    }

    /// Of a trial on a recording.
    ///
    /// # Errors
    /// When an effect or its parameters are not understood, or effects cannot be combined.
    pub fn new(case: &Case, trial: &Trial) -> Result<Prepared, String> {
        let effects = effects_of(case, &trial.effects)?;
        let kernel = joined(&effects).map_err(|why| why.to_string())?;
        Ok(Prepared { nominal: trial.nominal.clone(), effects, kernel })
    }
}

/// Log light and light at the instants of the grid.
type OnGrid = (Vec<f64>, Vec<f64>);

/// The sampled pixels of a recording with their light.
pub struct View<'a> {
    /// The recording.
    pub case: &'a Case,
    /// Which pixels.
    pub sample: &'a Sample,
    /// Their measurements.
    pub data: Vec<PixelData>,
    /// Places in the sample that are scored: inner ones with known light and events.
    pub scored: Vec<usize>,
    tracks: Vec<Track>,
    is_known: Vec<bool>,
    /// Log light of each pixel on the common grid, and light.
    grid: Vec<OnGrid>,
}

impl<'a> View<'a> {
    /// Of a scene, in steps that are fine enough for scores.
    pub fn new(case: &'a Case, nominal: &Nominal, sample: &'a Sample, scene: &Scene, setting: &SceneSetting) -> View<'a> {
        View::in_steps(case, nominal, sample, scene, setting, STEP_NS)
    }

    /// Of a scene, its light cut into steps of at most `step_ns`.
    pub fn in_steps(case: &'a Case, nominal: &Nominal, sample: &'a Sample, scene: &Scene, setting: &SceneSetting, step_ns: i64) -> View<'a> {
        let pixels: Vec<(PixelData, Track, OnGrid)> = (0..sample.len())
            .into_par_iter()
            .with_min_len(16)
            .map(|n| {
                let (t, u) = scene.pixel(n);
                let log: Vec<f64> = grid(case).map(|instant| at(t, u, instant)).collect();
                let light = log.iter().map(|u| exp(*u)).collect();
                (pixel_data(case, nominal, setting, sample.pixels[n] as usize), Track::new(t, u, step_ns), (log, light))
            })
            .collect();
        let mut view = View { case, sample, data: Vec::new(), scored: Vec::new(), tracks: Vec::new(), is_known: scene.is_known.clone(), grid: Vec::new() };
        for (data, track, grid) in pixels {
            view.data.push(data);
            view.tracks.push(track);
            view.grid.push(grid);
        }
        view.scored = (0..sample.len()).filter(|&n| sample.is_inner[n] && scene.is_known[n] && view.data[n].0.len() > 1).collect();
        view
    }

    /// Sees pixel `n` of the sample through a trial, at the light of the scene.
    pub fn through(&self, prepared: &Prepared, n: usize, out: &mut Conditional) {
        self.at_light(prepared, &prepared.nominal, n, &self.tracks[n], out);
    }

    /// The same, frames only.
    pub fn frames_through(&self, prepared: &Prepared, n: usize, out: &mut Conditional) {
        let (events, frames) = &self.data[n];
        let look = Look { site: self.site(n), track: &self.tracks[n], seen: None, events, frames };
        frame_values(&prepared.nominal, &prepared.effects, &look, out);
    }

    /// The same at another light of the pixel and with other base fields. What its neighbours mix in is as in the scene.
    pub fn at_light(&self, prepared: &Prepared, nominal: &Nominal, n: usize, track: &Track, out: &mut Conditional) {
        let seen = prepared.kernel.as_ref().map(|kernel| self.mixed(kernel, n, track));
        let (events, frames) = &self.data[n];
        let look = Look { site: self.site(n), track, seen: seen.as_deref(), events, frames };
        conditional(nominal, &prepared.effects, &look, out);
    }

    /// The place of pixel `n` of the sample.
    pub fn site(&self, n: usize) -> Site {
        self.case.site(self.sample.pixels[n] as usize, 0)
    }

    /// Log light of the event path at the instants of a pixel's track: its own, and what neighbours change of it on the grid.
    fn mixed(&self, kernel: &Kernel, n: usize, track: &Track) -> Vec<f64> {
        let (x, y) = self.case.place(self.sample.pixels[n] as usize);
        let (width, height) = (self.case.extent.width as usize, self.case.extent.height as usize);
        let own = &self.grid[n].0;
        let mut sum = vec![0.0; own.len()];
        for tap in &kernel.taps {
            // As far towards the neighbour as the sample goes.
            let mut place = n;
            for (dx, dy) in [(tap.dx, tap.dy), (tap.dx.signum(), tap.dy.signum()), (tap.dx, 0), (0, tap.dy)] {
                let pixel = stand_in(y as usize, dy, height) * width + stand_in(x as usize, dx, width);
                if let Some(known) = self.sample.place(pixel).filter(|&place| self.is_known[place]) {
                    place = known;
                    break;
                }
            }
            let values = if kernel.domain == Domain::Log { &self.grid[place].0 } else { &self.grid[place].1 };
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += tap.weight * value);
        }
        for (sum, own) in sum.iter_mut().zip(own) {
            *sum = if kernel.domain == Domain::Log { *sum } else { ln(f64::max(*sum, f64::MIN_POSITIVE)) } - own;
        }
        let change = |t: i64| {
            let place = (t - self.case.span.0) as f64 / GRID_NS as f64;
            let k = (place as usize).min(sum.len() - 1);
            let next = (k + 1).min(sum.len() - 1);
            sum[k] + (sum[next] - sum[k]) * (place - k as f64).clamp(0.0, 1.0)
        };
        track.t_ns.iter().zip(&track.log_light).map(|(t, u)| u + change(*t)).collect()
    }
}

fn grid(case: &Case) -> impl Iterator<Item = i64> {
    let last = (case.span.1 - case.span.0).max(0) / GRID_NS + 1;
    let first = case.span.0;
    (0..=last).map(move |k| first + k * GRID_NS)
}
