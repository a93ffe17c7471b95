//! Eight pixels, interleaved: what is given at each step, and how light at the steps becomes predictions.

use super::super::prior::{FIRST_SLOPE_VARIANCE, Prior, Segments};
use super::super::segment::{Ramp, Slopes, fill_pieces};
use super::passes::{Expected, Line, WideOffsets};
use super::stream::{BOUND, EVENT, EXPOSE, FRAME, LATCH, LIGHT, MOVE, NO_EVENT, RISE, SEGMENT, Stream};
use crate::elementary::exp;
use crate::front_end::FrontEnd;
use crate::misfit::Misfit;
use crate::wide::{Flags, Wide};
use multiversion::multiversion;

/// Steps whose segments are computed at once: they stay in the nearest cache.
const BLOCK: usize = 16;

/// Stands for the length of a segment that is not there, seconds: what is computed from it is thrown away,
/// but must not be slow as subnormal numbers are.
const NO_SEGMENT_S: f64 = 1e-5;

/// What is given at a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Given<const W: usize> {
    pub length_s: Wide<W>,
    /// One over it.
    pub per_s: Wide<W>,
    pub target: Wide<W>,
    pub variance: Wide<W>,
    /// One over it.
    pub information: Wide<W>,
    pub exposure: Wide<W>,
}

/// What the prior's local variance is made of, at a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearby<const W: usize> {
    /// How far a slope takes light; of an integrated walk, how far segments are apart.
    pub reach_s: Wide<W>,
    pub per_nearby: Wide<W>,
    /// The steps between whose energies the nearby slopes lie.
    pub low: [u32; W],
    pub high: [u32; W],
}

impl<const W: usize> Default for Nearby<W> {
    fn default() -> Nearby<W> {
        Nearby { reach_s: Wide::ZERO, per_nearby: Wide::ZERO, low: [0; W], high: [0; W] }
    }
}

/// What all pixels of a group have in common, and what each lane has for all steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Common<const W: usize> {
    pub front_end: FrontEnd,
    pub on: Wide<W>,
    pub off: Wide<W>,
    pub stamp_sigma_s: Wide<W>,
    pub family: Family<W>,
    pub advances: bool,
}

/// The prior's family, and its constants in each lane.
#[derive(Clone, Copy, Debug)]
pub(super) enum Family<const W: usize> {
    /// Square of the floor.
    Local(Wide<W>),
    /// Degrees of freedom times the variance per second, and one more degree.
    Walk(Wide<W>, Wide<W>),
    /// The same of slopes.
    IntegratedWalk(Wide<W>, Wide<W>),
}

impl<const W: usize> Default for Family<W> {
    fn default() -> Family<W> {
        Family::Local(Wide::ZERO)
    }
}

impl<const W: usize> Family<W> {
    /// That of these priors, one a lane, which are of one family.
    pub(super) fn of(priors: [Prior; W]) -> Family<W> {
        let wide = |of: fn(&Prior) -> f64| Wide(std::array::from_fn(|l| of(&priors[l])));
        let tails = |prior: &Prior| match *prior {
            Prior::Walk { nu, .. } | Prior::IntegratedWalk { nu, .. } => nu + 1.0,
            Prior::Local(_) => 0.0,
        };
        let spread = |prior: &Prior| match *prior {
            Prior::Local(local) => local.floor_per_s * local.floor_per_s,
            Prior::Walk { per_s, nu } => nu * per_s,
            Prior::IntegratedWalk { per_s3, nu } => nu * per_s3,
        };
        match priors[0] {
            Prior::Local(_) => Family::Local(wide(spread)),
            Prior::Walk { .. } => Family::Walk(wide(spread), wide(tails)),
            Prior::IntegratedWalk { .. } => Family::IntegratedWalk(wide(spread), wide(tails)),
        }
    }
}

/// The given of a group.
#[derive(Clone, Debug, Default)]
pub(super) struct Columns<const W: usize> {
    pub given: Vec<Given<W>>,
    /// What is at each step, of the bits of [`super::stream`].
    pub what: Vec<Flags<W>>,
    pub nearby: Vec<Nearby<W>>,
    pub expected: Vec<Expected<W>>,
    energy: Vec<Wide<W>>,
}

/// A pixel of a group.
pub(super) struct Pixel<'a> {
    pub stream: &'a Stream,
    pub segments: &'a Segments,
    pub u: &'a [f64],
}

/// Twice the negative log of the posterior density, less constants, in parts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cost<const W: usize> {
    pub measured: Wide<W>,
    pub no_event_square: Wide<W>,
    pub prior: Wide<W>,
}

impl<const W: usize> Columns<W> {
    /// Interleaves the pixels; `u` becomes their start. Gives the number of steps.
    pub(super) fn fill(
        &mut self,
        common: &Common<W>,
        pixels: &[Pixel<'_>; W],
        u: &mut Vec<Wide<W>>,
    ) -> usize {
        let steps = pixels.iter().map(|pixel| pixel.stream.steps.len()).max().unwrap_or(0);
        let Columns { given, what, nearby, expected, energy } = self;
        given.resize(steps, Given::default());
        what.resize(steps, Flags::default());
        nearby.resize(steps, Nearby::default());
        expected.resize(steps, Expected::default());
        energy.resize(steps, Wide::ZERO);
        u.resize(steps, Wide::ZERO);
        for s in 0..steps {
            let (given, what, nearby, expected, u) =
                (&mut given[s], &mut what[s], &mut nearby[s], &mut expected[s], &mut u[s]);
            // Behind the end and at steps without a segment nothing moves.
            *given = Given { length_s: Wide::splat(NO_SEGMENT_S), variance: Wide::ONE, ..Given::default() };
            (*what, *nearby) = (Flags::default(), Nearby::default());
            *expected = Expected { correlation: Wide::ONE, ..Expected::default() };
            for l in 0..W {
                let pixel = &pixels[l];
                let Some(step) = pixel.stream.steps.get(s) else {
                    u.0[l] = pixel.u[pixel.u.len() - 1];
                    continue;
                };
                let k = step.knot as usize;
                u.0[l] = pixel.u[k];
                (what.0[l], given.target.0[l], given.exposure.0[l], given.variance.0[l]) =
                    (step.what, step.target, step.exposure, step.variance);
                if step.what & SEGMENT != 0 && s > 0 {
                    let segments = pixel.segments;
                    (given.length_s.0[l], given.per_s.0[l]) = (segments.length_s[k], segments.per_s[k]);
                    match common.family {
                        Family::Local(_) => {
                            (nearby.reach_s.0[l], nearby.per_nearby.0[l]) =
                                (segments.reach_s[k], segments.per_nearby[k]);
                            let (low, high) = segments.nearby[k];
                            (nearby.low[l], nearby.high[l]) = (
                                pixel.stream.first_step[low as usize - 1],
                                pixel.stream.first_step[high as usize],
                            );
                        }
                        Family::Walk(..) => {}
                        Family::IntegratedWalk(..) => {
                            nearby.reach_s.0[l] =
                                if k > 1 { segments.middle_s[k] - segments.middle_s[k - 1] } else { 0.0 }
                        }
                    }
                    (expected.correlation.0[l], expected.fresh.0[l]) =
                        (segments.correlation[k], segments.fresh[k]);
                }
            }
            given.information = Wide::ONE / given.variance;
            expected.per_fresh = expected.fresh.above(Wide::ZERO, Wide::ONE / expected.fresh, Wide::ZERO);
        }
        steps
    }
}

/// Takes the prior's variances from the slopes of `u`, then its surprises and its cost: twice the negative
/// log of its density at `u`, less constants.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn adapt<const W: usize>(columns: &mut Columns<W>, common: &Common<W>, u: &[Wide<W>]) -> Wide<W> {
    let steps = u.len();
    let Columns { given, what, nearby, expected, energy } = columns;
    let (given, what, nearby) = (&given[..steps], &what[..steps], &nearby[..steps]);
    let (expected, energy) = (&mut expected[..steps], &mut energy[..steps]);
    match common.family {
        Family::Local(floor) => {
            let mut sum = Wide::ZERO;
            energy[0] = sum;
            for s in 1..steps {
                let w = u[s] - u[s - 1];
                sum = sum + w * w * given[s].per_s;
                energy[s] = sum;
            }
            for s in 1..steps {
                let near = &nearby[s];
                let mut between = Wide::ZERO;
                for l in 0..W {
                    between.0[l] = energy[near.high[l] as usize].0[l] - energy[near.low[l] as usize].0[l];
                }
                let mean_square = between.above(Wide::ZERO, between, Wide::ZERO) * near.per_nearby;
                let scale = near.reach_s * (floor + mean_square).sqrt();
                (expected[s].scale, expected[s].per_scale) = (scale, Wide::ONE / scale);
            }
        }
        Family::Walk(spread, tails) => {
            for s in 1..steps {
                let w = u[s] - u[s - 1];
                let scale = ((spread * given[s].length_s + w * w) / tails).sqrt();
                let scale = what[s].choose(SEGMENT, scale, Wide::ZERO);
                (expected[s].scale, expected[s].per_scale) = (scale, Wide::ONE / scale);
            }
        }
        Family::IntegratedWalk(spread, tails) => {
            let mut before = Wide::ZERO;
            for s in 1..steps {
                let is = |value: Wide<W>, or: Wide<W>| what[s].choose(SEGMENT, value, or);
                let slope = is((u[s] - u[s - 1]) * given[s].per_s, before);
                let (change, apart_s) = (slope - before, nearby[s].reach_s);
                let fresh = (spread * apart_s + change * change) / tails;
                // The first slope of a pixel has none before it.
                let fresh =
                    is(apart_s.above(Wide::ZERO, fresh, Wide::splat(FIRST_SLOPE_VARIANCE)), Wide::ZERO);
                (expected[s].fresh, expected[s].per_fresh) = (fresh, is(Wide::ONE / fresh, Wide::ZERO));
                (expected[s].scale, expected[s].per_scale) =
                    (is(given[s].length_s, Wide::ZERO), given[s].per_s);
                before = slope;
            }
        }
    }
    let (mut cost, mut z_before) = (Wide::ZERO, Wide::ZERO);
    for s in 1..steps {
        let (z, surprise, part) = surprise(what[s], &expected[s], u[s] - u[s - 1], z_before);
        expected[s].surprise = surprise;
        z_before = z;
        cost = cost + part;
    }
    cost
}

/// z, its surprise and what that costs.
#[inline(always)]
fn surprise<const W: usize>(
    what: Flags<W>,
    expected: &Expected<W>,
    w: Wide<W>,
    z_before: Wide<W>,
) -> (Wide<W>, Wide<W>, Wide<W>) {
    let z = what.choose(SEGMENT, w * expected.per_scale, z_before);
    let surprise = z - expected.correlation * z_before;
    (z, surprise, surprise * surprise * expected.per_fresh)
}

/// Moves `u` by a share of its change, within plus and minus `limit`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn moved<const W: usize>(
    u: &[Wide<W>],
    change: &[Wide<W>],
    share: Wide<W>,
    limit: Wide<W>,
    trial: &mut [Wide<W>],
) {
    for ((trial, u), change) in trial.iter_mut().zip(u).zip(change) {
        let to = *u + share * *change;
        let to = (-limit).above(to, -limit, to);
        *trial = to.above(limit, limit, to);
    }
}

/// Pieces of the segments of a block.
#[repr(C, align(64))]
struct Block<const W: usize> {
    u: [[f64; W]; BLOCK + 1],
    root: [[f64; W]; BLOCK + 1],
    length_s: [[f64; W]; BLOCK],
    pieces: [[[f64; W]; BLOCK]; 6],
}

/// Runs the pixels at `u` with these offsets. The prior's cost is that of the
/// scales and correlations that stand in `columns`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn run<const W: usize>(
    columns: &Columns<W>,
    common: &Common<W>,
    u: &[Wide<W>],
    offsets: &WideOffsets<W>,
    lines: &mut [Line<W>],
) -> Cost<W> {
    let steps = u.len();
    let (given, what, expected, lines) =
        (&columns.given[..steps], &columns.what[..steps], &columns.expected[..steps], &mut lines[..steps]);
    let zero = [[0.0; W]; BLOCK];
    let mut block =
        Block { u: [[0.0; W]; BLOCK + 1], root: [[1.0; W]; BLOCK + 1], length_s: zero, pieces: [zero; 6] };
    let mut cost = Cost::default();
    let mut voltage = u[0];
    let mut reference = voltage + offsets.reference;
    let (on, off) = (common.on + offsets.on, common.off + offsets.off);
    let mut light = Wide::ZERO;
    let mut z_before = Wide::ZERO;
    let has_stamps = common.stamp_sigma_s != Wide::ZERO;
    block.u[BLOCK] = u[0].0;
    block.root[BLOCK] = u[0].0.map(|u| exp(0.5 * u));
    for begin in (0..steps).step_by(BLOCK) {
        let length = usize::min(BLOCK, steps - begin);
        block.u[0] = block.u[BLOCK];
        block.root[0] = block.root[BLOCK];
        for k in 0..length {
            block.u[k + 1] = u[begin + k].0;
            block.length_s[k] = given[begin + k].length_s.0;
        }
        fill(&mut block, &common.front_end);
        for k in 0..length {
            let s = begin + k;
            let (given, then, line) = (&given[s], what[s], &mut lines[s]);
            let here = u[s];
            if s > 0 {
                let is = |value: Wide<W>, or: Wide<W>| then.choose(SEGMENT, value, or);
                let piece = |n: usize| Wide(block.pieces[n][k]);
                let (left, follows) = (is(piece(0), Wide::ONE), is(Wide::ONE - piece(1), Wide::ZERO));
                let before = Wide(block.u[k]);
                let gap = voltage - before;
                let through_tau = is(piece(2) * gap + piece(3), Wide::ZERO);
                let ramp = Ramp::of(voltage, gap, here - before, left, follows, through_tau);
                voltage = ramp.voltage;
                let light_by_both = given.exposure * piece(4);
                light = light + light_by_both;
                line.slopes = Slopes {
                    by_voltage: ramp.by_voltage,
                    by_both: ramp.by_both,
                    by_last: ramp.by_last,
                    light_by_both,
                    light_by_last: given.exposure * piece(5),
                };
                let (z, _, part) = surprise(then, &expected[s], here - before, z_before);
                z_before = z;
                cost.prior = cost.prior + part;
            } else {
                line.slopes = Slopes { by_voltage: Wide::ONE, ..Slopes::default() };
            }
            let is = |what: u64, value: Wide<W>, or: Wide<W>| then.choose(what, value, or);
            let level = reference + is(RISE, on, -off) + is(EVENT | MOVE, given.target, Wide::ZERO);
            let dark = given.target - light;
            let change = voltage - reference;
            let above = change.above(on, on - change, Wide::ZERO);
            let below = (-off).above(change, -off - change, Wide::ZERO);
            let broken = is(NO_EVENT, above + below, Wide::ZERO);
            for l in 0..W {
                // More light than a lower bound is no contradiction, and a no-event constraint that is not
                // broken none either.
                let beyond = if dark.0[l] < 0.0 { BOUND } else { 0 };
                let unbroken = if broken.0[l] == 0.0 { NO_EVENT } else { 0 };
                let counts = if then.0[l] & (beyond | unbroken) == 0 {
                    EVENT | FRAME | LIGHT | NO_EVENT | RISE
                } else {
                    0
                };
                // Too high a voltage is too high for the ON threshold.
                let rises = if broken.0[l] < 0.0 { RISE } else { 0 };
                line.sight.0[l] = (then.0[l] & counts) | rises;
            }
            line.residual =
                is(EVENT, level - voltage, is(LIGHT, given.target - here, is(NO_EVENT, broken, dark)));
            line.variance = given.variance;
            let mut information = given.information;
            if has_stamps {
                let current = Wide(block.root[k + 1]) * Wide(block.root[k + 1]);
                let tau_light =
                    Wide::splat(common.front_end.tau_0_s) * current + Wide::splat(common.front_end.alpha_s);
                let slope = tau_light.above(Wide::ZERO, (here - voltage) * current / tau_light, Wide::ZERO);
                let stamp = slope * common.stamp_sigma_s;
                line.variance = is(EVENT, given.variance + stamp * stamp, given.variance);
                information = Wide::ONE / line.variance;
            }
            let part = line.residual * line.residual * information;
            cost.measured = cost.measured + line.sight.choose(EVENT | FRAME | LIGHT, part, Wide::ZERO);
            cost.no_event_square = cost.no_event_square + broken * broken;
            light = is(EXPOSE, Wide::ZERO, light);
            if common.advances {
                reference = is(MOVE, level, reference);
            }
            reference = is(LATCH, voltage, reference);
        }
    }
    cost
}

/// How far each pixel's events and frames are from the predictions, and the largest of the squares that are
/// summed up with its step; those that carry no information
/// (unarmed events, lower bounds that hold) are left away.
pub(super) fn misfits<const W: usize>(lines: &[Line<W>]) -> [(Misfit, f64, usize); W] {
    let mut misfits = [(Misfit::default(), 0.0, 0); W];
    for (j, line) in lines.iter().enumerate() {
        for (l, (misfit, largest, at)) in misfits.iter_mut().enumerate() {
            let sight = line.sight.0[l];
            if sight & (EVENT | FRAME) == 0 {
                continue;
            }
            let square = line.residual.0[l] * line.residual.0[l] * (1.0 / line.variance.0[l]);
            if square > *largest {
                (*largest, *at) = (square, j);
            }
            misfit.add(&if sight & EVENT != 0 {
                Misfit { event_square: square, events: 1, ..Misfit::default() }
            } else {
                Misfit { frame_square: square, frames: 1, ..Misfit::default() }
            });
        }
    }
    misfits
}

#[inline(always)]
fn fill<const W: usize>(block: &mut Block<W>, front_end: &FrontEnd) {
    let Block { u, root, length_s, pieces } = block;
    let (u, root, length_s) = (u.as_flattened(), root.as_flattened_mut(), length_s.as_flattened());
    for k in W..u.len() {
        root[k] = exp(0.5 * u[k]);
    }
    let [left, lag, gap, rise, light, light_by_last] = pieces;
    let into = [
        left.as_flattened_mut(),
        lag.as_flattened_mut(),
        gap.as_flattened_mut(),
        rise.as_flattened_mut(),
        light.as_flattened_mut(),
        light_by_last.as_flattened_mut(),
    ];
    let behind = length_s.len();
    fill_pieces(front_end, length_s, (&u[..behind], &u[W..]), (&root[..behind], &root[W..]), into);
}
