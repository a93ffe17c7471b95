//! `refine/steered`: tracks smoothed along the motion, without solving anything again.
//!
//! Idea: what moves draws lines of equal light through space and time. The structure tensor of the film of
//! log light, the mean of its gradients' squares around a point, measures how much light changes in every
//! direction there: large across such a line, nothing along it. So each pixel's light is averaged under a
//! Gaussian that reaches as far as light changes by no more than the noise: along an edge and its motion, not
//! across them. Where light is the same in no direction the Gaussian closes by itself, and the pixel keeps
//! what it has.
//!
//! Only moving pixels are touched, and knots stay where they are: each gets the film's correction at its
//! instant (of a held value, the mean over the hold).
//!
//! Limits: it uses neither events nor frames, so it removes noise and with it whatever is finer than the
//! Gaussian. It is meant for rough solutions; `pipelines/ablations/steered.toml` shows what it does to better
//! ones. Motion of more than about a pixel in a step of the film is not seen. The film takes eight bytes for
//! each pixel and step of the rows that are worked on.

#[cfg(test)]
mod tests;

use crate::spans::check_steps;
use photocurrent_core::handle::Band;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Between, Colour, Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Rows, TrackBand, TrackSet,
    TracksMeta,
};
use photocurrent_sensor::elementary::exp;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `refine/steered`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How far tracks are off, natural-log units: the Gaussian ends where light changes by about as much.
    #[schemars(range(min = 0.001, max = 1.0))]
    pub noise: f64,
    /// Standard deviation of the Gaussian where nothing changes, pixels; it is cut at two pixels.
    #[schemars(range(min = 0.1, max = 3.0))]
    pub reach: f64,
    /// The same in time; it is cut at four steps of the film.
    #[schemars(extend("x-min" = "10 us", "x-max" = "1 s"))]
    pub reach_time: Duration,
    /// Pictures of the film lie so far apart: about the time in which things move by half a pixel.
    #[schemars(extend("x-min" = "10 us", "x-max" = "1 s"))]
    pub step: Duration,
    /// Range of light, natural-log units, below which a pixel counts as still and its track is unchanged:
    /// less than a threshold of the sensor.
    #[schemars(range(min = 0.0))]
    pub least_change: f64,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            noise: 0.035,
            reach: 1.5,
            reach_time: Duration::new(800_000),
            step: Duration::new(250_000),
            least_change: 0.15,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// A rough solution: tracks of `solve/paper`.
        tracks: TrackSet,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The same knots, with smoothed values.
        tracks: TrackSet,
    }
}

/// The node.
pub struct RefineSteered {
    params: Params,
}

impl Node for RefineSteered {
    const DECL: Decl = Decl {
        kind: "refine/steered",
        about: "Smooths the rough tracks of the paper's solver along the motion, without solving again.",
        revision: 2,
        grain: Grain::Row { halo: HALO },
        draws: false,
        exports: false,
        sources: &[
            "Bigun and Granlund, Optimal orientation detection of linear symmetry, ICCV 1987: the structure \
             tensor",
            "Takeda, Farsiu and Milanfar, Kernel regression for image processing and reconstruction, IEEE \
             Trans. Image Processing 16 (2), 2007: steering",
        ],
        example: r#"
[nodes.solve]
kind   = "solve/paper"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { evs_weight = 1000.0 }

[nodes.steered]
kind = "refine/steered"
in   = { tracks = "solve.tracks" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(RefineSteered { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let tracks = inputs.tracks("tracks")?;
        check(tracks)?;
        check_steps(tracks.span, self.params.step.ns(), "pictures", Self::DECL.kind)?;
        Ok(vec![Meta::Tracks(Arc::new(without_sigma(tracks)))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = input.tracks.meta.clone();
        check(&meta)?;
        cx.begin(cx.rows().len() as u64, "rows");
        let band = input.tracks.read(cx.rows().with_halo(HALO, meta.extent.rows()))?;
        let film = RowFilm::new(&band, &meta, self.params.step.ns());
        let kernel = SteeredKernel::new(&self.params);
        let rows: Result<Vec<TrackBand>, NodeError> = cx
            .rows()
            .iter()
            .into_par_iter()
            .map(|row| self.smooth_row(&film, &kernel, &band, row, &meta, cx))
            .collect();
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(without_sigma(&meta)), TrackBand::concat(rows?)) })
    }
}

/// Rows next to a row that its values depend on: gradients reach one further than they are pooled.
const HALO: u32 = POOLED as u32 + 1;

/// Metadata of smoothed tracks: their standard deviations are not known.
fn without_sigma(tracks: &TracksMeta) -> TracksMeta {
    TracksMeta { has_sigma: false, ..tracks.clone() }
}

/// Refuses colours: one film of log light is smoothed.
fn check(tracks: &TracksMeta) -> Result<(), NodeError> {
    if tracks.colour == Colour::Mono {
        return Ok(());
    }
    Err(NodeError::usage(format!("refine/steered works on grey tracks, and these are {}", tracks.colour))
        .hint("leave the node out"))
}

impl RefineSteered {
    fn smooth_row(
        &self,
        film: &RowFilm,
        kernel: &SteeredKernel,
        band: &TrackBand,
        row: u32,
        meta: &TracksMeta,
        cx: &Context,
    ) -> Result<TrackBand, NodeError> {
        let mut out = TrackBand::begin(row, meta.extent.width);
        let y = (row - film.rows.start) as usize;
        let tensors = RowTensors::from_film(film, y);
        let mut corrections = vec![0.0; film.count];
        for x in 0..meta.extent.width {
            let track = band.pixel(x, row);
            if !film.moves(x as usize, y, self.params.least_change) {
                out.push(track.t.iter().copied().zip(track.photocurrent.iter().copied()));
                continue;
            }
            for (n, correction) in corrections.iter_mut().enumerate() {
                *correction = kernel.weighted_mean(film, &tensors.at(x as usize, n), (x as usize, y, n))
                    - film.at(x as usize, y)[n];
            }
            let knot = |k: usize| {
                let t = track.t[k];
                let correction = match meta.between {
                    Between::LogLinear => film.interpolate(&corrections, t),
                    Between::Hold => film.mean_over_span(
                        &corrections,
                        t,
                        track.t.get(k + 1).copied().unwrap_or(meta.span.end.0),
                    ),
                };
                (t, (f64::from(track.photocurrent[k]) * exp(correction)) as f32)
            };
            out.push((0..track.t.len()).map(knot));
        }
        cx.advance(1)?;
        Ok(out)
    }
}

/// Log light of some rows at steady instants, a pixel's instants side by side. Its rows count from 0.
struct RowFilm {
    rows: Rows,
    width: usize,
    start_ns: i64,
    step_ns: i64,
    count: usize,
    values: Vec<f64>,
    /// Pixels with a track; the others are skipped.
    known: Vec<bool>,
}

impl RowFilm {
    /// Of tracks over their span.
    fn new(band: &TrackBand, meta: &TracksMeta, step_ns: i64) -> RowFilm {
        let count = (meta.span.end.0.saturating_sub(meta.span.start.0) / step_ns + 1) as usize;
        let (start_ns, width) = (meta.span.start.0, meta.extent.width);
        let row_of = |y: u32| -> Vec<f64> {
            let mut values = Vec::with_capacity(width as usize * count);
            for x in 0..width {
                let track = band.pixel(x, y);
                let log: Vec<f64> = track
                    .photocurrent
                    .iter()
                    .map(|&i| libm::log(f64::max(f64::from(i), f64::MIN_POSITIVE)))
                    .collect();
                let mut after = 0;
                for n in 0..count {
                    let t = start_ns + n as i64 * step_ns;
                    while after < track.t.len() && track.t[after] <= t {
                        after += 1;
                    }
                    values.push(match (after, meta.between) {
                        _ if log.is_empty() => 0.0,
                        (0, _) => log[0],
                        (after, Between::LogLinear) if after < log.len() => {
                            let share = (t - track.t[after - 1]) as f64
                                / (track.t[after] - track.t[after - 1]) as f64;
                            log[after - 1] + share * (log[after] - log[after - 1])
                        }
                        (after, _) => log[after - 1],
                    });
                }
            }
            values
        };
        let values: Vec<Vec<f64>> = band.rows().iter().into_par_iter().map(row_of).collect();
        let known = band.offsets().windows(2).map(|pixel| pixel[0] < pixel[1]).collect();
        RowFilm {
            rows: band.rows(),
            width: width as usize,
            start_ns,
            step_ns,
            count,
            values: values.concat(),
            known,
        }
    }

    fn pixel(&self, x: usize, y: usize) -> usize {
        y * self.width + x
    }

    fn at(&self, x: usize, y: usize) -> &[f64] {
        let pixel = self.pixel(x, y);
        &self.values[pixel * self.count..(pixel + 1) * self.count]
    }

    /// Does a pixel's log light range over more than `least`?
    fn moves(&self, x: usize, y: usize, least: f64) -> bool {
        let (low, high) = self.at(x, y).iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &u| {
            (f64::min(low, u), f64::max(high, u))
        });
        self.known[self.pixel(x, y)] && high - low > least
    }

    /// Values of the film's instants at any instant, linear between.
    fn interpolate(&self, values: &[f64], t_ns: i64) -> f64 {
        let place = ((t_ns - self.start_ns) as f64 / self.step_ns as f64).clamp(0.0, (self.count - 1) as f64);
        let (before, share) = (place as usize, place - (place as usize) as f64);
        let after = usize::min(before + 1, self.count - 1);
        values[before] + share * (values[after] - values[before])
    }

    /// Their mean from an instant to another: of the two ends and of all instants in the middle, by
    /// trapezoids.
    fn mean_over_span(&self, values: &[f64], from_ns: i64, to_ns: i64) -> f64 {
        if to_ns <= from_ns {
            return self.interpolate(values, from_ns);
        }
        let next = (from_ns - self.start_ns).max(-1).div_euclid(self.step_ns) + 1;
        let inside =
            (next..self.count as i64).map(|n| self.start_ns + n * self.step_ns).take_while(|&t| t < to_ns);
        let mut last = (from_ns, self.interpolate(values, from_ns));
        let mut sum = 0.0;
        for t in inside.chain([to_ns]) {
            let value = self.interpolate(values, t);
            sum += 0.5 * (last.1 + value) * (t - last.0) as f64;
            last = (t, value);
        }
        sum / (to_ns - from_ns) as f64
    }
}

/// Pixels to each side over which gradients are pooled,
const POOLED: usize = 2;
/// and steps of the film.
const POOLED_STEPS: usize = 2;

/// A symmetric 3 x 3 matrix: xx, xy, yy, xt, yt, tt.
type StructureTensor = [f64; 6];

/// The structure tensors of a row: mean products of gradients, natural-log units per pixel and per step of
/// the film.
struct RowTensors {
    count: usize,
    values: Vec<StructureTensor>,
}

impl RowTensors {
    fn from_film(film: &RowFilm, y: usize) -> RowTensors {
        let (width, height, count) = (film.width, film.rows.len(), film.count);
        // Products summed over the neighbouring rows, and over neighbouring instants.
        let mut columns: Vec<Vec<StructureTensor>> = Vec::with_capacity(width);
        let (top, bottom) = (y.saturating_sub(POOLED), usize::min(y + POOLED, height - 1));
        for x in 0..width {
            let mut column = vec![[0.0; 6]; count];
            for row in top..=bottom {
                add_products(film, x, row, &mut column);
            }
            let pooled = |n: usize| {
                mean_tensor(&column[n.saturating_sub(POOLED_STEPS)..usize::min(n + POOLED_STEPS + 1, count)])
            };
            columns.push((0..count).map(pooled).collect());
        }
        let rows = (bottom - top + 1) as f64;
        let mut values = Vec::with_capacity(width * count);
        for x in 0..width {
            let around = &columns[x.saturating_sub(POOLED)..usize::min(x + POOLED + 1, width)];
            for n in 0..count {
                let mut tensor = [0.0; 6];
                around.iter().for_each(|column| {
                    tensor.iter_mut().zip(column[n]).for_each(|(sum, value)| *sum += value)
                });
                values.push(tensor.map(|sum| sum / (rows * around.len() as f64)));
            }
        }
        RowTensors { count, values }
    }

    fn at(&self, x: usize, n: usize) -> StructureTensor {
        self.values[x * self.count + n]
    }
}

fn mean_tensor(tensors: &[StructureTensor]) -> StructureTensor {
    let mut sum = [0.0; 6];
    tensors.iter().for_each(|tensor| sum.iter_mut().zip(tensor).for_each(|(sum, value)| *sum += value));
    sum.map(|sum| sum / tensors.len() as f64)
}

/// Adds the products of a pixel's gradients at all instants; a pixel next to an unknown one has no gradient
/// in that direction.
fn add_products(film: &RowFilm, x: usize, y: usize, column: &mut [StructureTensor]) {
    let (width, height, count) = (film.width, film.rows.len(), film.count);
    if !film.known[film.pixel(x, y)] {
        return;
    }
    let sides = |low: (usize, usize), high: (usize, usize)| {
        let known = |at: (usize, usize)| if film.known[film.pixel(at.0, at.1)] { at } else { (x, y) };
        let (low, high) = (known(low), known(high));
        let apart = (high.0 - low.0) + (high.1 - low.1);
        (film.at(low.0, low.1), film.at(high.0, high.1), 1.0 / usize::max(apart, 1) as f64)
    };
    let across = sides((x.saturating_sub(1), y), (usize::min(x + 1, width - 1), y));
    let down = sides((x, y.saturating_sub(1)), (x, usize::min(y + 1, height - 1)));
    let own = film.at(x, y);
    for (n, tensor) in column.iter_mut().enumerate() {
        let (before, after) = (n.saturating_sub(1), usize::min(n + 1, count - 1));
        let gx = (across.1[n] - across.0[n]) * across.2;
        let gy = (down.1[n] - down.0[n]) * down.2;
        let gt = (own[after] - own[before]) / usize::max(after - before, 1) as f64;
        for (sum, product) in tensor.iter_mut().zip([gx * gx, gx * gy, gy * gy, gx * gt, gy * gt, gt * gt]) {
            *sum += product;
        }
    }
}

/// Radius of the Gaussian, pixels,
const PIXELS: usize = 2;
/// and steps of the film.
const STEPS: usize = 4;
/// Weights below exp(-half of this) count as 0.
const NEGLIGIBLE: f64 = 18.0;

/// The Gaussian `exp(-D' (J / noise^2 + window) D / 2)` over distances D in pixels and steps.
struct SteeredKernel {
    per_noise: f64,
    window: f64,
    window_steps: f64,
}

impl SteeredKernel {
    fn new(params: &Params) -> SteeredKernel {
        let steps = params.step.ns() as f64 / params.reach_time.ns() as f64;
        SteeredKernel {
            per_noise: 1.0 / (params.noise * params.noise),
            window: 1.0 / (params.reach * params.reach),
            window_steps: steps * steps,
        }
    }

    /// Mean log light around a pixel and instant.
    fn weighted_mean(
        &self,
        film: &RowFilm,
        tensor: &StructureTensor,
        (x, y, n): (usize, usize, usize),
    ) -> f64 {
        let [xx, xy, yy, xt, yt, tt] = tensor.map(|j| j * self.per_noise);
        let (xx, yy, tt) = (xx + self.window, yy + self.window, tt + self.window_steps);
        let (mut sum, mut weights) = (0.0, 0.0);
        for row in y.saturating_sub(PIXELS)..usize::min(y + PIXELS + 1, film.rows.len()) {
            for column in x.saturating_sub(PIXELS)..usize::min(x + PIXELS + 1, film.width) {
                if !film.known[film.pixel(column, row)] {
                    continue;
                }
                let (dx, dy) = (column as f64 - x as f64, row as f64 - y as f64);
                let (space, mixed) =
                    (dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy, 2.0 * (dx * xt + dy * yt));
                // What is least over all instants is already too far.
                if space - mixed * mixed / (4.0 * tt) > NEGLIGIBLE {
                    continue;
                }
                let track = film.at(column, row);
                for m in n.saturating_sub(STEPS)..usize::min(n + STEPS + 1, film.count) {
                    let dt = m as f64 - n as f64;
                    let square = space + mixed * dt + dt * dt * tt;
                    if square <= NEGLIGIBLE {
                        let weight = exp(-0.5 * square);
                        (sum, weights) = (sum + weight * track[m], weights + weight);
                    }
                }
            }
        }
        // The pixel itself always weighs 1.
        sum / weights
    }
}
