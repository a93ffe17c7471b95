//! Eq. (13) for sixteen pixels at once, one per lane of single precision.
//!
//! The same minimum by the same change of unknowns as [`super::solve`] (see `linear`): the steps `d_k` of the
//! front-end voltage are unknown, the EVS rows are identities, and each round solves an M x M system per
//! pixel. The rare cases are left out: a pixel that comes near a fold, or has not settled after a few rounds,
//! is handed back as unsolved, for the scalar solver. A pixel's result depends neither on the other lanes nor
//! on which lane it has.
//!
//! Layout: one [`Lanes`] per knot and quantity, knots in time order. Shorter pixels are padded with knots
//! that change nothing.

use super::problem::{LOG_PHOTOCURRENT_MAX, PixelProblem};
use crate::front_end::{FrontEnd, TauRule, settled_photocurrent, settling_rate};
use crate::lanes::{LANES, Lanes};
use crate::misfit::Misfit;
use crate::scalar::Scalar;
use multiversion::multiversion;

/// Rounds after which a pixel is left to the scalar solver; most need four to six.
const MAX_ROUNDS: usize = 16;
/// Trials of Newton's method per knot: at the start, in the first rounds, and in later ones, which move
/// little.
const START_TRIALS: usize = 4;
const EARLY_TRIALS: usize = 2;
const LATE_TRIALS: usize = 1;
/// How many rounds are early.
const EARLY_ROUNDS: usize = 3;
/// How far Newton's last trial may have moved a log photocurrent: the error left is about its square, and
/// later rounds take it away.
const SOLVED: f32 = 0.05;
/// The longest move of a log photocurrent in one trial.
const LONGEST_MOVE: f32 = 1.0;
/// Below this share of gamma the slope is too near a fold to divide by.
const FOLD_SLOPE: f32 = 0.1;
/// A pixel has converged when a whole step moves no log photocurrent by more than this.
const STEP_TOLERANCE: f32 = 1e-4;
/// Relative rise of the cost that counts as rounding.
const COST_NOISE: f32 = 1e-5;
/// What is left of a step after a refused one; below the second a pixel is given up.
const SHORTENED: f32 = 0.25;
const SHORTEST: f32 = 1e-2;
/// Length of the interval before a padding knot, seconds: everything has settled.
const PADDING_S: f32 = 1.0;

/// Up to sixteen pixels with equally many frames, and memory for their solution; reused from group to group.
#[derive(Clone, Debug, Default)]
pub struct LaneGroup {
    counts: Vec<usize>,
    given: Given,
    current: Point,
    trial: Point,
    linear: Linear,
    /// Per lane: 1 when solved, and after how many rounds.
    solved: Lanes,
    rounds: Lanes,
}

/// A solved pixel of a group.
#[derive(Clone, Copy, Debug)]
pub struct LaneSolution<'g> {
    log_photocurrent: &'g [Lanes],
    lane: usize,
    /// Eq. (13).
    pub cost: f32,
    /// The same in two parts: EVS rows as events, CIS rows as frames, each times its weight.
    pub misfit: Misfit,
    /// Steps tried.
    pub iterations: usize,
}

impl<'g> LaneSolution<'g> {
    /// ln i of every knot.
    pub fn log_photocurrent(&self) -> impl Iterator<Item = f32> + use<'g> {
        let lane = self.lane;
        self.log_photocurrent.iter().map(move |lanes| lanes.0[lane])
    }
}

/// What is measured; rows of knots where a quantity has two indices.
#[derive(Clone, Debug, Default)]
struct Given {
    knots: usize,
    frames: usize,
    front_end: FrontEnd<Lanes>,
    tau_rule: TauRule,
    /// Inverse weight of an EVS row.
    evs_variance: Lanes,
    dt_s: Vec<Lanes>,
    measured: Vec<Lanes>,
    /// DN that a knot's photocurrent adds to a frame, per unit of photocurrent.
    exposed: Vec<Lanes>,
    /// DN above black, and the inverse weight of the row.
    dn: Vec<Lanes>,
    variance: Vec<Lanes>,
}

/// One point of the search. All columns are as long as the knots, `dn` as the frames.
#[derive(Clone, Debug, Default)]
struct Point {
    step: Vec<Lanes>,
    voltage: Vec<Lanes>,
    log_photocurrent: Vec<Lanes>,
    photocurrent: Vec<Lanes>,
    /// Derivatives of the log photocurrent by the knot's step, by the voltage before it, and by the log
    /// photocurrent before it.
    by_step: Vec<Lanes>,
    by_voltage: Vec<Lanes>,
    by_before: Vec<Lanes>,
    dn: Vec<Lanes>,
    cost: Lanes,
    /// The parts of it.
    evs_cost: Lanes,
    cis_cost: Lanes,
    /// 1 where every knot was found, away from its fold and in range.
    valid: Lanes,
}

/// The problem linearised, and the step that follows.
#[derive(Clone, Debug, Default)]
struct Linear {
    /// Derivative of each DN by each unknown.
    gradient: Vec<Lanes>,
    system: Vec<Lanes>,
    pull: Vec<Lanes>,
    level_pull: Vec<Lanes>,
    level_gradient: Vec<Lanes>,
    change: Vec<Lanes>,
}

impl LaneGroup {
    /// Solves `problems`: one to sixteen pixels, each with two knots or more and the same number of frames,
    /// front end, rule, gain, black level and EVS weight.
    ///
    /// # Panics
    ///
    /// When they are none or more than sixteen, or differ in what must be equal. Every problem must have
    /// passed [`PixelProblem::check`].
    pub fn solve(&mut self, problems: &[PixelProblem<'_>]) {
        assert!((1..=LANES).contains(&problems.len()), "a group has one pixel per lane");
        let first = &problems[0];
        let is_alike = |p: &PixelProblem<'_>| {
            p.frames.len() == first.frames.len()
                && (p.front_end, p.tau_rule, p.evs_weight, p.black_level, p.gain)
                    == (first.front_end, first.tau_rule, first.evs_weight, first.black_level, first.gain)
        };
        assert!(problems.iter().all(is_alike), "the pixels of a group belong to one sensor");
        self.counts.clear();
        self.counts.extend(problems.iter().map(|problem| problem.t_s.len()));
        self.given.fill(problems);
        solve(self);
    }

    /// The solution of pixel `n` of the group, or nothing when it is left to the scalar solver.
    pub fn solution(&self, n: usize) -> Option<LaneSolution<'_>> {
        let log_photocurrent = &self.current.log_photocurrent[..self.counts[n]];
        let Point { cost, evs_cost, cis_cost, .. } = &self.current;
        let (event_square, frame_square) = (f64::from(evs_cost.0[n]), f64::from(cis_cost.0[n]));
        let misfit =
            Misfit { event_square, events: self.counts[n] - 1, frame_square, frames: self.given.frames };
        (self.solved.0[n] > 0.0).then(|| LaneSolution {
            log_photocurrent,
            lane: n,
            cost: cost.0[n],
            misfit,
            iterations: self.rounds.0[n] as usize,
        })
    }
}

fn resize(columns: &mut [&mut Vec<Lanes>], length: usize) {
    for column in columns {
        column.clear();
        column.resize(length, Lanes::ZERO);
    }
}

impl Given {
    fn fill(&mut self, problems: &[PixelProblem<'_>]) {
        let first = &problems[0];
        let (knots, frames) =
            (problems.iter().map(|problem| problem.t_s.len()).max().unwrap_or(1), first.frames.len());
        (self.knots, self.frames) = (knots, frames);
        self.front_end = first.front_end.lift();
        self.tau_rule = first.tau_rule;
        self.evs_variance = Lanes::from_f64(1.0 / first.evs_weight);
        resize(&mut [&mut self.dt_s, &mut self.measured], knots);
        resize(&mut [&mut self.dn, &mut self.variance], frames);
        resize(&mut [&mut self.exposed], knots * frames);
        for n in 0..LANES {
            // Lanes without a pixel repeat the first.
            let problem = problems.get(n).unwrap_or(first);
            let t_s = problem.t_s;
            for k in 1..knots {
                self.dt_s[k].0[n] = if k < t_s.len() { (t_s[k] - t_s[k - 1]) as f32 } else { PADDING_S };
                self.measured[k].0[n] = problem.steps.get(k).map_or(0.0, |step| *step as f32);
            }
            for (l, frame) in problem.frames.iter().enumerate() {
                self.dn[l].0[n] = (frame.dn - problem.black_level) as f32;
                self.variance[l].0[n] = (1.0 / frame.weight) as f32;
                let row = &mut self.exposed[l * knots..(l + 1) * knots];
                // The first knot also holds before itself, the last one for ever.
                let mut from = frame.start_s;
                for (k, exposed) in row.iter_mut().enumerate().take(t_s.len()) {
                    let end = t_s.get(k + 1).copied().unwrap_or(f64::INFINITY);
                    let to = if end < frame.end_s { end } else { frame.end_s };
                    if to > from {
                        exposed.0[n] = (problem.gain * (to - from)) as f32;
                        from = to;
                    }
                }
            }
        }
    }

    fn exposed(&self, l: usize) -> &[Lanes] {
        &self.exposed[l * self.knots..(l + 1) * self.knots]
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn solve(group: &mut LaneGroup) {
    let LaneGroup { given, current, trial, linear, solved, rounds, .. } = group;
    let (one, zero) = (Lanes::splat(1.0), Lanes::ZERO);
    current.resize(given);
    trial.resize(given);
    start(given, current, trial);
    (*solved, *rounds) = (zero, zero);
    let mut active = current.valid;
    let mut share = one;
    for round in 0..MAX_ROUNDS {
        *rounds = *rounds + active;
        linear.fill(given, current);
        linear.step(given, current);
        trial.move_from(
            given,
            current,
            &linear.change,
            share,
            if round < EARLY_ROUNDS { EARLY_TRIALS } else { LATE_TRIALS },
        );
        let moved = trial.distance(current);
        let is_better = (current.cost * (one + Lanes::splat(COST_NOISE))).at_least(
            trial.cost,
            trial.valid * active,
            zero,
        );
        let is_whole = share.at_least(one, active * trial.valid, zero);
        let is_small = Lanes::splat(STEP_TOLERANCE).at_least(moved, is_whole, zero);
        if is_better == one {
            std::mem::swap(current, trial);
        } else {
            current.take(trial, is_better);
        }
        *solved = solved.max(is_small);
        share = is_better.at_least(one, one, share * Lanes::splat(SHORTENED));
        active = active - is_small;
        active = share.at_least(Lanes::splat(SHORTEST), active, zero);
        if active == zero {
            break;
        }
    }
}

/// Two candidates at the level of the closed form (see `level`): the measured steps, or the closed form's
/// photocurrents; per lane the cheaper one.
#[inline(always)]
fn start(given: &Given, current: &mut Point, other: &mut Point) {
    let (mut sum, mut largest) = (Lanes::ZERO, Lanes::ZERO);
    for k in 1..given.knots {
        sum = sum + given.measured[k];
        largest = largest.max(sum);
        other.log_photocurrent[k] = sum;
    }
    other.log_photocurrent[0] = Lanes::ZERO;
    let (mut along, mut square) = (Lanes::ZERO, Lanes::splat(f32::MIN_POSITIVE));
    for l in 0..given.frames {
        let mut per_unit = Lanes::ZERO;
        for (u, exposed) in other.log_photocurrent.iter().zip(given.exposed(l)) {
            per_unit = per_unit + settled_photocurrent(*u - largest) * *exposed;
        }
        along = along + per_unit * given.dn[l] / given.variance[l];
        square = square + per_unit * per_unit / given.variance[l];
    }
    let unit = along / square;
    let is_lit = unit.at_least(Lanes::splat(f32::MIN_POSITIVE), Lanes::splat(1.0), Lanes::ZERO);
    let level = unit.max(Lanes::splat(f32::MIN_POSITIVE)).ln() - largest;
    for k in 0..given.knots {
        other.log_photocurrent[k] = other.log_photocurrent[k] + level;
        current.step[k] = given.measured[k];
        current.log_photocurrent[k] = other.log_photocurrent[k];
    }
    other.settle_towards(given);
    current.begin(level);
    current.make_steps(given, START_TRIALS);
    let is_other = (current.cost * current.valid)
        .at_least(other.cost, other.valid, Lanes::ZERO)
        .max(other.valid - current.valid);
    current.take(other, is_other);
    current.valid = current.valid * is_lit;
}

impl Point {
    fn resize(&mut self, given: &Given) {
        resize(
            &mut [&mut self.step, &mut self.voltage, &mut self.log_photocurrent, &mut self.photocurrent],
            given.knots,
        );
        resize(&mut [&mut self.by_step, &mut self.by_voltage, &mut self.by_before], given.knots);
        resize(&mut [&mut self.dn], given.frames);
    }

    #[inline(always)]
    fn begin(&mut self, level: Lanes) {
        self.log_photocurrent[0] = level;
        self.photocurrent[0] = settled_photocurrent(level);
        self.voltage[0] = level;
        self.step[0] = level;
    }

    /// Takes the log photocurrents that are there and follows Eq. (1). Its derivatives are not set: a start
    /// only.
    #[inline(always)]
    fn settle_towards(&mut self, given: &Given) {
        self.begin(self.log_photocurrent[0]);
        self.valid = Lanes::splat(1.0);
        for k in 1..given.knots {
            let (u, voltage) = (self.log_photocurrent[k], self.voltage[k - 1]);
            let lit = settled_photocurrent(u);
            let settling =
                LaneSettling::at(given, given.tau_rule.pick(self.photocurrent[k - 1], lit), given.dt_s[k]);
            let drive = u - voltage;
            self.photocurrent[k] = lit;
            self.step[k] = settling.gamma * drive;
            self.voltage[k] = voltage + self.step[k];
            if given.tau_rule == TauRule::End {
                let slope = settling.gamma + settling.slope * drive;
                self.valid =
                    slope.at_least(settling.gamma * Lanes::splat(FOLD_SLOPE), self.valid, Lanes::ZERO);
                self.by_step[k] = Lanes::splat(1.0) / slope;
                self.by_voltage[k] = settling.gamma * self.by_step[k];
            } else {
                self.by_step[k] = Lanes::splat(1.0) / settling.gamma;
                self.by_voltage[k] = Lanes::splat(1.0);
                self.by_before[k] = -(drive * settling.slope) * self.by_step[k];
            }
        }
        self.evaluate(given);
    }

    /// Finds the photocurrents that make the steps that are there; `log_photocurrent` holds guesses.
    #[inline(always)]
    fn make_steps(&mut self, given: &Given, trials: usize) {
        let one = Lanes::splat(1.0);
        self.valid = one;
        for k in 1..given.knots {
            let (voltage, step, dt_s) = (self.voltage[k - 1], self.step[k], given.dt_s[k]);
            self.voltage[k] = voltage + step;
            if given.tau_rule == TauRule::Start {
                let settling = LaneSettling::at(given, self.photocurrent[k - 1], dt_s);
                let drive = step / settling.gamma;
                let u = voltage + drive;
                self.log_photocurrent[k] = u;
                self.photocurrent[k] = settled_photocurrent(u);
                self.by_step[k] = one / settling.gamma;
                self.by_voltage[k] = one;
                self.by_before[k] = -(drive * settling.slope) * self.by_step[k];
                continue;
            }
            let mut u = self.log_photocurrent[k];
            let mut last = Lanes::ZERO;
            let (mut lit, mut slope, mut gamma) = (one, one, one);
            for _ in 0..trials {
                lit = settled_photocurrent(u);
                let settling = LaneSettling::at(given, lit, dt_s);
                let drive = u - voltage;
                gamma = settling.gamma;
                slope = gamma + settling.slope * drive;
                // Near a fold the slope vanishes: the move is limited there, and the pixel refused below.
                let move_u = (step - gamma * drive) / slope.max(gamma * Lanes::splat(FOLD_SLOPE));
                last = move_u.max(Lanes::splat(-LONGEST_MOVE)).min(Lanes::splat(LONGEST_MOVE));
                u = u + last;
            }
            self.valid = slope.at_least(gamma * Lanes::splat(FOLD_SLOPE), self.valid, Lanes::ZERO);
            self.valid = Lanes::splat(SOLVED).at_least(last.abs(), self.valid, Lanes::ZERO);
            self.log_photocurrent[k] = u;
            // exp of the last small move, to second order.
            self.photocurrent[k] = lit * (one + last * (one + Lanes::splat(0.5) * last));
            self.by_step[k] = one / slope;
            self.by_voltage[k] = gamma * self.by_step[k];
        }
        self.evaluate(given);
    }

    /// Moves every unknown of `from` by a share of `change`.
    #[inline(always)]
    fn move_from(&mut self, given: &Given, from: &Point, change: &[Lanes], share: Lanes, trials: usize) {
        let level = from.step[0] + share * change[0];
        self.begin(level);
        let mut moved = share * change[0];
        for k in 1..given.knots {
            let by = share * change[k];
            let guess = from.by_step[k] * by + from.by_voltage[k] * moved;
            let guess = guess.max(Lanes::splat(-LONGEST_MOVE)).min(Lanes::splat(LONGEST_MOVE));
            self.step[k] = from.step[k] + by;
            self.log_photocurrent[k] = from.log_photocurrent[k] + guess;
            moved = moved + by;
        }
        self.make_steps(given, trials);
    }

    /// Digital numbers above black, and Eq. (13).
    #[inline(always)]
    fn evaluate(&mut self, given: &Given) {
        let limit = Lanes::splat(LOG_PHOTOCURRENT_MAX as f32);
        let (mut square, mut most) = (Lanes::ZERO, Lanes::ZERO);
        for k in 0..given.knots {
            let miss = if k == 0 { Lanes::ZERO } else { given.measured[k] - self.step[k] };
            square = square + miss * miss;
            // Not `max`: NaN must not get lost.
            most = limit.at_least(self.log_photocurrent[k].abs(), most, Lanes::splat(1.0));
        }
        self.valid = Lanes::splat(0.5).at_least(most, self.valid, Lanes::ZERO);
        let mut cost = square / given.evs_variance;
        (self.evs_cost, self.cis_cost) = (cost, Lanes::ZERO);
        for l in 0..given.frames {
            let mut dn = Lanes::ZERO;
            for (i, exposed) in self.photocurrent.iter().zip(given.exposed(l)) {
                dn = dn + *i * *exposed;
            }
            let miss = given.dn[l] - dn;
            let part = miss * miss / given.variance[l];
            cost = cost + part;
            self.cis_cost = self.cis_cost + part;
            self.dn[l] = dn;
        }
        self.cost = cost;
    }

    /// The largest change of a log photocurrent.
    #[inline(always)]
    fn distance(&self, other: &Point) -> Lanes {
        let mut largest = Lanes::ZERO;
        for (a, b) in self.log_photocurrent.iter().zip(&other.log_photocurrent) {
            largest = (*a - *b).abs().max(largest);
        }
        largest
    }

    /// Becomes `other` in the lanes where `is_taken` is 1.
    #[inline(always)]
    fn take(&mut self, other: &Point, is_taken: Lanes) {
        let half = Lanes::splat(0.5);
        let columns = [
            (&mut self.step, &other.step),
            (&mut self.voltage, &other.voltage),
            (&mut self.log_photocurrent, &other.log_photocurrent),
            (&mut self.photocurrent, &other.photocurrent),
            (&mut self.by_step, &other.by_step),
            (&mut self.by_voltage, &other.by_voltage),
            (&mut self.by_before, &other.by_before),
            (&mut self.dn, &other.dn),
        ];
        for (mine, theirs) in columns {
            for (mine, theirs) in mine.iter_mut().zip(theirs) {
                *mine = is_taken.at_least(half, *theirs, *mine);
            }
        }
        self.cost = is_taken.at_least(half, other.cost, self.cost);
        self.evs_cost = is_taken.at_least(half, other.evs_cost, self.evs_cost);
        self.cis_cost = is_taken.at_least(half, other.cis_cost, self.cis_cost);
        self.valid = is_taken.at_least(half, other.valid, self.valid);
    }
}

/// gamma of one interval and its slope by the log photocurrent that sets the time constant; as `interval`'s,
/// without the second derivative.
struct LaneSettling {
    gamma: Lanes,
    slope: Lanes,
}

impl LaneSettling {
    #[inline(always)]
    fn at(given: &Given, photocurrent: Lanes, dt_s: Lanes) -> LaneSettling {
        let rate = settling_rate(&given.front_end, photocurrent);
        let y = dt_s * rate;
        let left = (-y).exp_m1();
        // The light-dependent share of tau is 1 - tau_0 / tau; where all has settled the slope is zero.
        let share = Lanes::splat(1.0) - given.front_end.tau_0_s * rate;
        let gamma = -left;
        let slope = (Lanes::splat(1.0) + left) * y * share;
        LaneSettling { gamma, slope }
    }
}

impl Linear {
    /// One backward sweep per frame.
    #[inline(always)]
    fn fill(&mut self, given: &Given, at: &Point) {
        let (knots, frames) = (given.knots, given.frames);
        self.gradient.resize(knots * frames, Lanes::ZERO);
        for (l, row) in self.gradient.chunks_exact_mut(knots).enumerate() {
            let exposed = given.exposed(l);
            let (mut by_voltage, mut carried) = (Lanes::ZERO, Lanes::ZERO);
            for k in (1..knots).rev() {
                let by_u = at.photocurrent[k] * exposed[k] + carried;
                row[k] = by_u * at.by_step[k] + by_voltage;
                by_voltage = by_voltage + by_u * at.by_voltage[k];
                carried = by_u * at.by_before[k];
            }
            row[0] = at.photocurrent[0] * exposed[0] + carried + by_voltage;
        }
    }

    /// The Gauss-Newton step: the Woodbury identity over the EVS rows, and the free level.
    #[inline(always)]
    fn step(&mut self, given: &Given, at: &Point) {
        let (knots, frames) = (given.knots, given.frames);
        resize(&mut [&mut self.system], frames * frames);
        resize(&mut [&mut self.pull, &mut self.level_pull], frames);
        self.change.resize(knots, Lanes::ZERO);
        for k in 1..knots {
            self.change[k] = given.measured[k] - at.step[k];
        }
        for l in 0..frames {
            let row = &self.gradient[l * knots..(l + 1) * knots];
            let mut moved = Lanes::ZERO;
            for k in 1..knots {
                moved = moved + row[k] * self.change[k];
            }
            self.pull[l] = given.dn[l] - at.dn[l] - moved;
            self.level_pull[l] = row[0];
            for m in 0..=l {
                let other = &self.gradient[m * knots..(m + 1) * knots];
                let mut sum = Lanes::ZERO;
                for k in 1..knots {
                    sum = sum + row[k] * other[k];
                }
                self.system[l * frames + m] =
                    sum * given.evs_variance + if l == m { given.variance[l] } else { Lanes::ZERO };
            }
        }
        self.factor(frames);
        // With x = S^-1 pull and y = S^-1 b: level = b x / b y, multipliers = x - level y.
        self.level_gradient.clone_from(&self.level_pull);
        substitute(&self.system, frames, &mut self.pull);
        substitute(&self.system, frames, &mut self.level_pull);
        let (mut along, mut across) = (Lanes::ZERO, Lanes::ZERO);
        for l in 0..frames {
            along = along + self.level_gradient[l] * self.pull[l];
            across = across + self.level_gradient[l] * self.level_pull[l];
        }
        let level = along / across;
        self.change[0] = level;
        for l in 0..frames {
            let multiplier = (self.pull[l] - level * self.level_pull[l]) * given.evs_variance;
            let row = &self.gradient[l * knots..(l + 1) * knots];
            for k in 1..knots {
                self.change[k] = self.change[k] + multiplier * row[k];
            }
        }
    }

    /// The system as L D L^T, in place; the diagonal holds 1 / D.
    #[inline(always)]
    fn factor(&mut self, frames: usize) {
        for l in 0..frames {
            for m in 0..=l {
                let mut sum = self.system[l * frames + m];
                for j in 0..m {
                    // The diagonal is inverted already, the row still holds L D.
                    sum = sum
                        - self.system[l * frames + j]
                            * self.system[m * frames + j]
                            * self.system[j * frames + j];
                }
                self.system[l * frames + m] = if m == l { Lanes::splat(1.0) / sum } else { sum };
            }
        }
    }
}

/// Solves L D L^T x = b in place, from the rows L D that [`Linear::factor`] leaves.
#[inline(always)]
fn substitute(system: &[Lanes], frames: usize, b: &mut [Lanes]) {
    for l in 0..frames {
        for j in 0..l {
            b[l] = b[l] - system[l * frames + j] * system[j * frames + j] * b[j];
        }
    }
    for l in (0..frames).rev() {
        b[l] = b[l] * system[l * frames + l];
        for j in l + 1..frames {
            b[l] = b[l] - system[j * frames + l] * system[l * frames + l] * b[j];
        }
    }
}
