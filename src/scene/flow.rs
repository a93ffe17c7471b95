//! Optical flow: a field of velocities over the sensor and time, from a film of log light.
//!
//! Pictures symmetric around an instant are moved towards each other until they agree (Lucas and Kanade 1981,
//! by Gauss-Newton steps): first with one affine motion of all pixels, robust against others, then with a
//! motion of every neighbourhood, in windows that shrink. A neighbourhood without contrast keeps its motion.
//! Time distances grow as windows shrink, so that the field becomes precise to a small part of a pixel. At
//! last every place may take the affine motion, or that of a place farther away, where it explains its
//! smallest neighbourhood clearly better: around a small object windows contain two motions. A second motion
//! that explains a place nearly as well is kept as its rival ([`Flow::rival_at`]).
//!
//! A long recording is evaluated in parts, and only in active blocks ([`Activity`]); elsewhere the velocity
//! is zero. Of a large sensor every second pixel of every second row is evaluated; the field is much smoother
//! than that.
//!
//! Limits: motion that is not observable (along an edge, in a flat place) is the affine one or none; speeds
//! over `fastest` are cut.

mod params;

pub use params::MotionParams;

use crate::activity::Activity;
use crate::film::{LogFilm, LogTracks, STEP_NS};
use crate::image::{Image, smooth};
use rayon::prelude::*;
use std::ops::Range;

/// Pictures between two instants of the field.
const STRIDE: usize = 4;
/// Instants of the field that are worked out together, at most.
const TOGETHER: usize = 32;
/// Most values of the pictures in memory.
const TOGETHER_VALUES: usize = 60_000_000;
/// Farthest picture from its instant that is compared.
const REACH: usize = 6;
/// Of a sensor of more pixels every second pixel of every second row is evaluated.
const LARGE: usize = 20_000;
/// Number of places from which the affine motion of all pixels is estimated.
const OF_ALL: usize = 16_384;
/// Smallest step, pixels per picture.
const NO_STEP: f64 = 1e-4;

/// Velocities in pixels per millisecond.
pub struct Flow {
    lattice: FlowLattice,
    start_ns: i64,
    step_ns: i64,
    /// One field per instant, as [line * columns + column].
    fields: Vec<Vec<[f32; 2]>>,
    /// Motions that explain a place nearly as well, laid out likewise, the same where there is none; empty
    /// where none are requested.
    rivals: Vec<Vec<[f32; 2]>>,
}

/// The pixels at which the field is known.
#[derive(Clone, Copy)]
struct FlowLattice {
    /// Pixels from one to the next.
    pitch: usize,
    columns: usize,
    lines: usize,
    /// The sensor.
    width: usize,
    height: usize,
}

impl FlowLattice {
    fn new(width: usize, height: usize) -> FlowLattice {
        let pitch = if width * height > LARGE { 2 } else { 1 };
        FlowLattice { pitch, columns: width.div_ceil(pitch), lines: height.div_ceil(pitch), width, height }
    }

    fn len(&self) -> usize {
        self.columns * self.lines
    }

    /// Instants of the field whose pictures are held at once.
    fn instants_at_once(&self) -> usize {
        let pictures = TOGETHER_VALUES / (self.width * self.height);
        (pictures.saturating_sub(2 * REACH + 1) / STRIDE + 1).clamp(1, TOGETHER)
    }

    /// Every so manyth of `places` is [`OF_ALL`] of them, spread over rows and columns.
    fn place_stride(&self, places: usize) -> usize {
        let every = usize::max(places / OF_ALL, 1);
        // A divisor of the columns takes the same ones of every row.
        every + usize::from(every > 1 && self.columns.is_multiple_of(every))
    }

    /// The pixel of a place.
    fn pixel(&self, at: usize) -> (usize, usize) {
        (at % self.columns * self.pitch, at / self.columns * self.pitch)
    }
}

/// An affine field of velocities, pixels per picture: `v_x = p0 + p1 a + p2 b`, `v_y = p3 + p4 a + p5 b`,
/// with (a, b) the place relative to
/// the sensor's middle in half widths.
type AffineFlow = [f64; 6];

impl Flow {
    /// Estimates the flow of tracks between two instants, ns; with rivals on request.
    pub fn estimate(
        tracks: &LogTracks,
        span: (i64, i64),
        activity: &Activity,
        how: (&MotionParams, bool),
    ) -> Flow {
        let size = (tracks.extent.width as usize, tracks.extent.height as usize);
        Flow::new(size, (span.0, LogFilm::count(span)), activity, how, |numbers| {
            LogFilm::new(tracks, span.0, numbers)
        })
    }

    /// From a film of `count` pictures; `film` returns those of a range of indices.
    pub fn new(
        (width, height): (usize, usize),
        (start_ns, count): (i64, usize),
        activity: &Activity,
        (params, with_rivals): (&MotionParams, bool),
        film: impl Fn(Range<usize>) -> LogFilm,
    ) -> Flow {
        let lattice = FlowLattice::new(width, height);
        let bins = count.div_ceil(STRIDE);
        let (mut fields, mut rivals) = (Vec::with_capacity(bins), Vec::with_capacity(bins));
        let together = lattice.instants_at_once();
        for first in (0..bins).step_by(together) {
            let bins = first..usize::min(first + together, bins);
            let numbers = (bins.start * STRIDE).saturating_sub(REACH)
                ..usize::min((bins.end - 1) * STRIDE + REACH + 1, count);
            let at_ns = |n: usize| start_ns + n as i64 * STEP_NS;
            let places = activity.active_places(
                (at_ns(numbers.start), at_ns(numbers.end)),
                (0..lattice.len()).map(|at| lattice.pixel(at)),
            );
            if places.is_empty() {
                fields.extend(bins.clone().map(|_| vec![[0.0; 2]; lattice.len()]));
                rivals.extend(bins.filter(|_| with_rivals).map(|_| vec![[0.0; 2]; lattice.len()]));
                continue;
            }
            let film = film(numbers);
            let estimator = FlowEstimator {
                lattice,
                coarse: &film.smoothed(2.0),
                fine: &film.smoothed(0.7),
                count,
                places: &places,
                params,
                with_rivals,
            };
            let per_ms = 1e6 / STEP_NS as f64;
            let of = |bin: usize| {
                let per_ms = |field: Vec<[f64; 2]>| -> Vec<[f32; 2]> {
                    field.iter().map(|v| v.map(|v| (v * per_ms) as f32)).collect()
                };
                let (field, rival) = estimator.estimate(bin * STRIDE);
                (per_ms(field), per_ms(rival))
            };
            let (some, their): (Vec<_>, Vec<_>) = bins.into_par_iter().map(of).unzip();
            fields.extend(some);
            rivals.extend(their.into_iter().filter(|_| with_rivals));
        }
        Flow { lattice, start_ns, step_ns: STEP_NS * STRIDE as i64, fields, rivals }
    }

    /// The same velocity everywhere and always, pixels per millisecond, and another that explains everything
    /// as well.
    pub fn uniform((width, height): (usize, usize), velocity: [f32; 2], rival: [f32; 2]) -> Flow {
        let lattice = FlowLattice::new(width, height);
        let field = |velocity: [f32; 2]| vec![vec![velocity; lattice.len()]];
        Flow { lattice, start_ns: 0, step_ns: 1, fields: field(velocity), rivals: field(rival) }
    }

    /// The fields before and after an instant, and the share of the later one.
    fn bracketing_fields(&self, t_ns: i64) -> (usize, usize, f64) {
        let last = self.fields.len() - 1;
        let bin = ((t_ns - self.start_ns) as f64 / self.step_ns as f64).clamp(0.0, last as f64);
        let before = usize::min(bin as usize, last);
        (before, usize::min(before + 1, last), bin - before as f64)
    }

    /// The velocity at a place and an instant; beyond the borders as at them.
    pub fn at(&self, x: f64, y: f64, t_ns: i64) -> [f64; 2] {
        self.interpolate(&self.fields, x, y, t_ns)
    }

    /// A velocity that explains the place nearly as well, or the same; only of a flow with rivals.
    pub fn rival_at(&self, x: f64, y: f64, t_ns: i64) -> [f64; 2] {
        self.interpolate(&self.rivals, x, y, t_ns)
    }

    fn interpolate(&self, fields: &[Vec<[f32; 2]>], x: f64, y: f64, t_ns: i64) -> [f64; 2] {
        let FlowLattice { pitch, columns, lines, .. } = self.lattice;
        let (before, after, share) = self.bracketing_fields(t_ns);
        let (i, dx) = whole_and_rest(x / pitch as f64, columns);
        let (j, dy) = whole_and_rest(y / pitch as f64, lines);
        let mut velocity = [0.0; 2];
        for (axis, value) in velocity.iter_mut().enumerate() {
            let at = |field: usize| {
                let f = &fields[field];
                let v = |i: usize, j: usize| {
                    f64::from(f[usize::min(j, lines - 1) * columns + usize::min(i, columns - 1)][axis])
                };
                (1.0 - dy) * ((1.0 - dx) * v(i, j) + dx * v(i + 1, j))
                    + dy * ((1.0 - dx) * v(i, j + 1) + dx * v(i + 1, j + 1))
            };
            *value = (1.0 - share) * at(before) + share * at(after);
        }
        velocity
    }
}

fn whole_and_rest(at: f64, count: usize) -> (usize, f64) {
    let at = at.clamp(0.0, (count - 1) as f64);
    (at as usize, at - (at as usize) as f64)
}

/// Pairs of pictures that are compared, as (middle, distance of each from it).
struct PicturePairs<'a> {
    film: &'a LogFilm,
    /// Pictures of the whole film.
    count: usize,
    /// Squared difference with half the weight.
    robust: f64,
    middle: usize,
    /// How far the middles of pairs lie from the instant, pictures.
    shifts: &'a [i64],
    distances: &'a [usize],
}

impl PicturePairs<'_> {
    /// Calls with (earlier picture, later picture, time from the middle to each).
    fn for_each_pair(&self, mut with: impl FnMut(&Image, &Image, f64, f64)) {
        for &shift in self.shifts {
            for &distance in self.distances {
                let (early, late) = (
                    self.middle as i64 + shift - distance as i64,
                    self.middle as i64 + shift + distance as i64,
                );
                if early >= 0 && (late as usize) < self.count {
                    let at = |n: i64| (n - self.middle as i64) as f64;
                    let picture = |n: i64| &self.film.pictures[n as usize - self.film.first];
                    with(picture(early), picture(late), at(early), at(late));
                }
            }
        }
    }

    /// Disagreement and its gradient by the velocity at a pixel, for a pair.
    fn disagreement(
        &self,
        pair: (&Image, &Image, f64, f64),
        x: f64,
        y: f64,
        v: [f64; 2],
    ) -> Option<(f64, f64, f64)> {
        let (early, late, t0, t1) = pair;
        let first = early.sample(x + v[0] * t0, y + v[1] * t0)?;
        let second = late.sample(x + v[0] * t1, y + v[1] * t1)?;
        Some((second.0 - first.0, t1 * second.1 - t0 * first.1, t1 * second.2 - t0 * first.2))
    }
}

/// Pictures in which motion is estimated, and where.
struct FlowEstimator<'a> {
    lattice: FlowLattice,
    coarse: &'a LogFilm,
    fine: &'a LogFilm,
    /// Pictures of the whole film.
    count: usize,
    /// Places of the lattice where something may move.
    places: &'a [usize],
    params: &'a MotionParams,
    with_rivals: bool,
}

impl FlowEstimator<'_> {
    /// The field at picture `middle` and that of the rivals, pixels per picture.
    fn estimate(&self, middle: usize) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
        let FlowEstimator { lattice, coarse, fine, count, places, params, .. } = *self;
        let middle = middle.clamp(1, usize::max(count.saturating_sub(2), 1));
        let pairs = |film, distances| PicturePairs {
            film,
            count,
            robust: params.robust * params.robust,
            middle,
            shifts: &[-2, 0, 2],
            distances,
        };
        let affine = self.affine(&pairs(coarse, &[1]), [0.0; 6], 6);
        let affine = self.affine(&pairs(fine, &[1, 2]), affine, 4);
        let affine = self.affine(&pairs(fine, &[2, 4]), affine, 3);
        let mut field = vec![[0.0; 2]; lattice.len()];
        for &at in places {
            let (x, y) = lattice.pixel(at);
            field[at] = self.velocity_of(&affine, x, y);
        }
        self.local(&pairs(coarse, &[1]), &mut field, 6.0, 3);
        self.local(&pairs(fine, &[1, 2]), &mut field, 5.0, 3);
        self.local(&pairs(fine, &[2, 4]), &mut field, 4.0, 3);
        let rivals = self.choose(&pairs(fine, &[1, 2]), &mut field, &affine);
        (field, rivals)
    }

    /// Replaces the motion of a place where another one explains a small neighbourhood clearly better: that
    /// of all pixels, or one from farther away. Where an object passes before another, windows contain both,
    /// and their estimate is neither. Returns, of the motions that are not clearly worse, the one that
    /// differs most.
    fn choose(&self, pairs: &PicturePairs<'_>, field: &mut [[f64; 2]], affine: &AffineFlow) -> Vec<[f64; 2]> {
        let FlowLattice { pitch, columns, lines, .. } = self.lattice;
        let MotionParams { clear_gain, farther, neighbourhood, .. } = self.params;
        let left = 1.0 - *clear_gain as f32;
        let cost = |candidate: &[[f64; 2]]| -> Vec<f32> {
            let mut sums = vec![0.0_f32; columns * lines];
            pairs.for_each_pair(|early, late, t0, t1| {
                for &at in self.places {
                    let (x, y) = self.lattice.pixel(at);
                    // Who leaves the sensor explains nothing.
                    let square = pairs
                        .disagreement((early, late, t0, t1), x as f64, y as f64, candidate[at])
                        .map_or(1.0, |(e, ..)| {
                            let square = e * e / pairs.robust;
                            square / (1.0 + square)
                        });
                    sums[at] += square as f32;
                }
            });
            smooth(&sums, columns, lines, *neighbourhood / pitch as f64)
        };
        let begun = field.to_vec();
        let own = cost(field);
        let mut best = own.iter().map(|cost| cost * left).collect::<Vec<f32>>();
        let mut tried = vec![(own, begun.clone())];
        let of_all: Vec<[f64; 2]> = (0..self.lattice.len())
            .map(|at| self.lattice.pixel(at))
            .map(|(x, y)| self.velocity_of(affine, x, y))
            .collect();
        let far = farther
            .iter()
            .map(|far| i64::from(*far))
            .flat_map(|far| [(far, 0), (-far, 0), (0, far), (0, -far)]);
        let shifted = far.map(|(dx, dy)| -> Vec<[f64; 2]> {
            let place = |at: usize, by: i64, count: usize| {
                (at as i64 + by / pitch as i64).clamp(0, count as i64 - 1) as usize
            };
            (0..begun.len())
                .map(|at| begun[place(at / columns, dy, lines) * columns + place(at % columns, dx, columns)])
                .collect()
        });
        for candidate in std::iter::once(of_all).chain(shifted) {
            let cost = cost(&candidate);
            for &at in self.places {
                if cost[at] < best[at] {
                    (best[at], field[at]) = (cost[at], candidate[at]);
                }
            }
            tried.push((cost, candidate));
        }
        if !self.with_rivals {
            return Vec::new();
        }
        let mut rivals = field.to_vec();
        for &at in self.places {
            let apart = |v: [f64; 2]| libm::hypot(v[0] - field[at][0], v[1] - field[at][1]);
            let of_field = tried
                .iter()
                .filter(|(_, candidate)| candidate[at] == field[at])
                .map(|(cost, _)| cost[at])
                .fold(f32::INFINITY, f32::min);
            let close = tried
                .iter()
                .filter(|(cost, _)| cost[at] * left <= of_field)
                .map(|(_, candidate)| candidate[at]);
            rivals[at] = close.fold(field[at], |most, v| if apart(v) > apart(most) { v } else { most });
        }
        rivals
    }

    /// Improves one affine motion of all places.
    fn affine(&self, pairs: &PicturePairs<'_>, mut p: [f64; 6], steps: usize) -> [f64; 6] {
        let FlowLattice { width, height, .. } = self.lattice;
        let every = self.lattice.place_stride(self.places.len());
        let places = || self.places.iter().step_by(every);
        for _step in 0..steps {
            let mut a = [[0.0; 6]; 6];
            let mut b = [0.0; 6];
            pairs.for_each_pair(|early, late, t0, t1| {
                for &at in places() {
                    let (x, y) = self.lattice.pixel(at);
                    let v = self.velocity_of(&p, x, y);
                    let Some((e, gx, gy)) = pairs.disagreement((early, late, t0, t1), x as f64, y as f64, v)
                    else {
                        continue;
                    };
                    let square = e * e / pairs.robust;
                    let w = 1.0 / ((1.0 + square) * (1.0 + square));
                    let (cx, cy) = centred(width, height, x, y);
                    let g = [gx, gx * cx, gx * cy, gy, gy * cx, gy * cy];
                    for i in 0..6 {
                        b[i] -= w * g[i] * e;
                        for j in i..6 {
                            a[i][j] += w * g[i] * g[j];
                        }
                    }
                }
            });
            for i in 0..6 {
                a[i][i] += self.params.least_contrast * places().len() as f64;
                for j in 0..i {
                    a[i][j] = a[j][i];
                }
            }
            let Some(step) = solve(a, b) else { break };
            for (p, step) in p.iter_mut().zip(step) {
                *p += step.clamp(-1.0, 1.0);
            }
            if step.iter().all(|step| step.abs() < NO_STEP) {
                break;
            }
        }
        p
    }

    /// Improves the motion of every neighbourhood of `sigma` pixels.
    fn local(&self, pairs: &PicturePairs<'_>, field: &mut [[f64; 2]], sigma: f64, steps: usize) {
        let FlowLattice { pitch, columns, lines, .. } = self.lattice;
        for _step in 0..steps {
            let mut sums: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; columns * lines]);
            pairs.for_each_pair(|early, late, t0, t1| {
                for &at in self.places {
                    let (x, y) = self.lattice.pixel(at);
                    let Some((e, gx, gy)) =
                        pairs.disagreement((early, late, t0, t1), x as f64, y as f64, field[at])
                    else {
                        continue;
                    };
                    let w = 1.0 / (1.0 + e * e / pairs.robust);
                    for (sum, value) in sums.iter_mut().zip([gx * gx, gx * gy, gy * gy, gx * e, gy * e]) {
                        sum[at] += (w * value) as f32;
                    }
                }
            });
            let sums = sums.map(|sum| smooth(&sum, columns, lines, sigma / pitch as f64));
            let mut most = 0.0;
            for &at in self.places {
                let [xx, xy, yy, xe, ye] = [0, 1, 2, 3, 4].map(|k: usize| f64::from(sums[k][at]));
                let (xx, yy) = (xx + self.params.least_contrast, yy + self.params.least_contrast);
                let determinant = xx * yy - xy * xy;
                let step = [-(yy * xe - xy * ye) / determinant, -(xx * ye - xy * xe) / determinant];
                let v = &mut field[at];
                *v = self.limit_speed([v[0] + step[0].clamp(-0.5, 0.5), v[1] + step[1].clamp(-0.5, 0.5)]);
                most = f64::max(most, f64::max(step[0].abs(), step[1].abs()));
            }
            if most < NO_STEP {
                break;
            }
        }
    }

    fn velocity_of(&self, p: &AffineFlow, x: usize, y: usize) -> [f64; 2] {
        let (a, b) = centred(self.lattice.width, self.lattice.height, x, y);
        self.limit_speed([p[0] + p[1] * a + p[2] * b, p[3] + p[4] * a + p[5] * b])
    }

    /// A velocity, pixels per picture, that is not too fast.
    fn limit_speed(&self, v: [f64; 2]) -> [f64; 2] {
        let fastest = self.params.fastest * STEP_NS as f64 * 1e-6;
        let speed = (v[0] * v[0] + v[1] * v[1]).sqrt();
        let share = if speed > fastest { fastest / speed } else { 1.0 };
        [v[0] * share, v[1] * share]
    }
}

/// Place relative to the middle, in half widths.
fn centred(width: usize, height: usize, x: usize, y: usize) -> (f64, f64) {
    let half = 0.5 * width as f64;
    ((x as f64 - 0.5 * (width - 1) as f64) / half, (y as f64 - 0.5 * (height - 1) as f64) / half)
}

/// Gaussian elimination of a symmetric positive matrix; `None` when it is not.
fn solve(mut a: [[f64; 6]; 6], mut b: [f64; 6]) -> Option<[f64; 6]> {
    for i in 0..6 {
        // Not positive, or not a number.
        if a[i][i].is_nan() || a[i][i] <= 1e-12 {
            return None;
        }
        for j in i + 1..6 {
            let factor = a[j][i] / a[i][i];
            let pivot = a[i];
            for (value, above) in a[j].iter_mut().zip(pivot) {
                *value -= factor * above;
            }
            b[j] -= factor * b[i];
        }
    }
    for i in (0..6).rev() {
        for j in i + 1..6 {
            b[i] -= a[i][j] * b[j];
        }
        b[i] /= a[i][i];
    }
    Some(b)
}

#[cfg(test)]
#[path = "flow_tests.rs"]
mod tests;
