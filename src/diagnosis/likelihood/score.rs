//! Scores of effects on residuals, with the scene projected out pixel by pixel.
//!
//! A column of an effect is what a small strength of it changes of every prediction at the estimated light, by finite differences of the conditional model. Both residuals and
//! columns go through the solver's own linear problem ([`whiten`]); products of what comes out are scores and information, of every pair of
//! effects and of every pixel.
//!
//! Source: score tests with nuisance parameters (efficient scores), C. R. Rao 1948; the nuisance is the pixel's light with its prior.

use super::view::{Prepared, View};
use crate::candidates::{CANDIDATES, Candidate, Scales, Signs, Trial};
use crate::nominal::Nominal;
use crate::scene::{Scene, SceneSetting, task};
use photocurrent_sensor::conditional::Conditional;
use photocurrent_sensor::effects::Stage;
use photocurrent_sensor::map::{Column, MapWorkspace, Prior, Whitened, whiten};
use rayon::prelude::*;

/// An effect of the catalogue seen through which a column is made.
pub struct Probe {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Strength of the finite difference.
    pub strength: f64,
    prepared: Prepared,
    /// It leaves events alone.
    is_of_frames: bool,
}

impl Candidate {
    /// The strength at which its derivative is taken: small, but for what has no small strength.
    pub fn probe_strength(&self) -> f64 {
        match (self.signs, self.id) {
            (Signs::Switch, _) | (_, "slew_limit" | "high_pass_front_end") => 1.0,
            _ => 0.25,
        }
    }
}

/// Candidates that have a column on this recording, on top of a sensor with `base` effects already.
pub fn probes(view: &View<'_>, base: &Trial, scales: &Scales) -> Vec<Probe> {
    let of = |(candidate, kind): (usize, &Candidate)| {
        let strength = kind.probe_strength();
        let mut trial = base.clone();
        kind.put_on(&mut trial, strength, scales);
        let prepared = Prepared::new(view.case, &trial).ok()?;
        (!kind.is_random).then_some(Probe { candidate, strength, prepared, is_of_frames: kind.decl().stage == Stage::Exposure })
    };
    CANDIDATES.iter().enumerate().filter_map(of).collect()
}

/// What one pixel says.
#[derive(Clone, Debug, Default)]
pub struct PixelScore {
    /// Place in the sample.
    pub place: usize,
    /// Number of measurements.
    pub count: usize,
    /// Squared residual in standard deviations, scene projected out.
    pub square: f64,
    /// The part of it that is of frames.
    pub frame_square: f64,
    /// Number of measurements that are frames.
    pub frames: usize,
    /// Sum of products of an event's residual, in standard deviations, and that of the event before.
    pub lagged: f64,
    /// Scores of the probes.
    pub score: Vec<f64>,
    /// Information, all pairs of probes, the lower half with the diagonal line by line.
    pub information: Vec<f64>,
    /// Information of each probe if the scene were known.
    pub raw: Vec<f64>,
}

/// What all scored pixels say.
#[derive(Clone, Debug, Default)]
pub struct Scores {
    /// Candidates of the columns.
    pub candidates: Vec<usize>,
    /// The pixels.
    pub pixels: Vec<PixelScore>,
}

/// Where a pair stands in the lower half of a matrix.
pub fn pair(a: usize, b: usize) -> usize {
    let (low, high) = (a.min(b), a.max(b));
    high * (high + 1) / 2 + low
}

/// Scores of probes on the residuals of a scene that was estimated with `nominal` and a prior for each pixel.
pub fn scores(view: &View<'_>, nominal: &Nominal, base: &Prepared, scene: &Scene, priors: &[Prior], setting: &SceneSetting, probes: &[Probe]) -> Scores {
    let one = |workspace: &mut MapWorkspace, &n: &usize| -> PixelScore {
        let data = &view.data[n];
        let mut task = task(view.case, setting, data, nominal.map_sensor(), &[]);
        task.options.prior = priors[n];
        let (mut plain, mut with) = (Conditional::default(), Conditional::default());
        view.through(base, n, &mut plain);
        let columns: Vec<(Vec<f64>, Vec<f64>)> = probes
            .iter()
            .map(|probe| {
                if probe.is_of_frames {
                    view.frames_through(&probe.prepared, n, &mut with);
                    with.excess.clone_from(&plain.excess);
                } else {
                    view.through(&probe.prepared, n, &mut with);
                }
                let differ = |with: &[f64], plain: &[f64]| with.iter().zip(plain).map(|(a, b)| (a - b) / probe.strength).collect();
                (differ(&with.excess, &plain.excess), differ(&with.dn, &plain.dn))
            })
            .collect();
        let columns: Vec<Column<'_>> = columns.iter().map(|(events, frames)| Column { events, frames }).collect();
        let mut whitened = Whitened::default();
        whiten(&task, scene.pixel(n).1, Column::default(), &columns, workspace, &mut whitened);
        summed(n, data.0.len(), &columns, &whitened)
    };
    let pixels: Vec<PixelScore> = view.scored.par_iter().with_min_len(4).map_init(MapWorkspace::default, one).collect();
    Scores { candidates: probes.iter().map(|probe| probe.candidate).collect(), pixels: pixels.into_iter().filter(|pixel| pixel.count > 0).collect() }
}

fn summed(place: usize, events: usize, columns: &[Column<'_>], whitened: &Whitened) -> PixelScore {
    let m = columns.len();
    let mut pixel = PixelScore {
        place,
        count: whitened.measurement.len(),
        score: vec![0.0; m],
        information: vec![0.0; m * (m + 1) / 2],
        raw: vec![0.0; m],
        ..PixelScore::default()
    };
    let mut before = 0.0;
    for (line, (measurement, sigma)) in whitened.lines().zip(whitened.measurement.iter().zip(&whitened.sigma)) {
        let (residual, of) = (line[0], &line[1..]);
        pixel.square += residual * residual;
        let mut at = 0;
        for a in 0..m {
            pixel.score[a] += of[a] * residual;
            for b in 0..=a {
                pixel.information[at] += of[a] * of[b];
                at += 1;
            }
        }
        let measurement = *measurement as usize;
        if measurement < events {
            pixel.lagged += residual * before;
            before = residual;
        } else {
            pixel.frame_square += residual * residual;
            pixel.frames += 1;
        }
        for (raw, column) in pixel.raw.iter_mut().zip(columns) {
            let says = if measurement < events { column.events[measurement] } else { column.frames[measurement - events] } / sigma;
            *raw += says * says;
        }
    }
    pixel
}

/// Scores summed over pixels.
#[derive(Clone, Debug, Default)]
pub struct Summed {
    /// Over-dispersion: by how much residuals are larger than they are believed to, at least 1.
    pub dispersion: f64,
    /// Measurements.
    pub count: usize,
    /// Scores.
    pub score: Vec<f64>,
    /// Information, as in [`PixelScore::information`].
    pub information: Vec<f64>,
    /// Information if the scene were known.
    pub raw: Vec<f64>,
}

impl Scores {
    /// Sums, without the worst pixels: a share `dropped` of them, by their residuals.
    pub fn summed(&self, dropped: f64, keep: impl Fn(&PixelScore) -> bool) -> Summed {
        let m = self.candidates.len();
        let mut sum = Summed { score: vec![0.0; m], information: vec![0.0; m * (m + 1) / 2], raw: vec![0.0; m], ..Summed::default() };
        let chi = |pixel: &PixelScore| pixel.square / pixel.count as f64;
        let mut all: Vec<f64> = self.pixels.iter().map(chi).collect();
        all.sort_by(f64::total_cmp);
        let limit = all.get(((1.0 - dropped) * all.len() as f64) as usize).copied().unwrap_or(f64::INFINITY);
        sum.dispersion = f64::max(all.get(all.len() / 2).copied().unwrap_or(1.0), 1.0);
        for pixel in self.pixels.iter().filter(|pixel| chi(pixel) <= limit && keep(pixel)) {
            sum.count += pixel.count;
            sum.score.iter_mut().zip(&pixel.score).for_each(|(sum, value)| *sum += value);
            sum.information.iter_mut().zip(&pixel.information).for_each(|(sum, value)| *sum += value);
            sum.raw.iter_mut().zip(&pixel.raw).for_each(|(sum, value)| *sum += value);
        }
        sum
    }
}
