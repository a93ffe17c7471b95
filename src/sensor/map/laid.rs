//! A pixel's problem laid out for a solver on another processor: where its unknowns stand, what happens
//! there, what the prior expects of them and where the iteration starts.
//!
//! It is what [`super::MapGroup`] works on, made by the same code: a solver elsewhere states the steps of the
//! iteration again, and nothing of what comes before them.

use super::group::stream::{self, Stream};
pub use super::group::{
    ATTEMPTS, FIRST_DAMPING, FIRST_VARIANCE, LOG_LIMIT, LOG_TWO_PI, LONGEST_STEP, NO_EVENT_FROM,
};
use super::knots::Knots;
use super::options::MapTask;
pub use super::prior::FIRST_SLOPE_VARIANCE;
use super::prior::{Prior, Segments};
use super::problem::brightest;
use super::start::Start;

/// An event: voltage is reference plus or minus a threshold, plus the target.
pub const EVENT: u32 = stream::EVENT as u32;
/// A frame value: collected light is the target.
pub const FRAME: u32 = stream::FRAME as u32;
/// No event: voltage and reference are less than a threshold apart.
pub const NO_EVENT: u32 = stream::NO_EVENT as u32;
/// With [`FRAME`]: the value is a lower bound.
pub const BOUND: u32 = stream::BOUND as u32;
/// No measurement: the reference moves by a threshold, plus the target.
pub const MOVE: u32 = stream::MOVE as u32;
/// After the measurement an exposure begins.
pub const EXPOSE: u32 = stream::EXPOSE as u32;
/// After it the reference becomes the voltage of now.
pub const LATCH: u32 = stream::LATCH as u32;
/// The step is the first of a knot; unless it is the first of all, a segment ends there.
pub const SEGMENT: u32 = stream::SEGMENT as u32;
/// With [`EVENT`] and [`MOVE`]: the polarity is ON.
pub const RISE: u32 = stream::RISE as u32;
/// The step is the last of a knot.
pub const LAST: u32 = 1024;

/// A step of a pixel: at most a segment, then at most one measurement, then at most a new exposure and a new
/// reference.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// The bits above.
    pub what: u32,
    /// The knot it belongs to.
    pub knot: usize,
    /// Of a measurement: frame values in standard deviations, what an event is beyond its threshold.
    pub target: f64,
    /// Frame values in standard deviations, per light on the segment; 0 between exposures.
    pub exposure: f64,
    /// Of the segment that ends here, s; 0 for none. The same of what follows.
    pub length_s: f64,
    /// How far a slope takes light over the segment, s; of the prior with local variance.
    pub reach_s: f64,
    /// The steps between whose energies the slopes nearby lie.
    pub nearby: (u32, u32),
    /// One over the time between them, 1/s.
    pub per_nearby: f64,
}

/// A pixel, laid out; kept from pixel to pixel for its memory.
#[derive(Clone, Debug, Default)]
pub struct Laid {
    knots: Knots,
    segments: Segments,
    start: Start,
    stream: Stream,
    u: Vec<f64>,
    is_local: bool,
    brightest: f64,
}

impl Laid {
    /// Lays out a pixel.
    pub fn lay(&mut self, task: &MapTask<'_>) {
        let MapTask { problem, options } = task;
        self.knots.lay(problem, options.spacing_ns);
        self.start.fill(problem, &self.knots, &mut self.u);
        self.segments.lay(&self.knots.t_ns, &options.prior);
        self.stream.fill(problem, &self.knots);
        self.is_local = matches!(options.prior, Prior::Local(_));
        self.brightest = brightest(problem);
    }

    /// The knots, ns, rising.
    pub fn t_ns(&self) -> &[i64] {
        &self.knots.t_ns
    }

    /// Log light at the knots from which the iteration starts.
    pub fn start(&self) -> &[f64] {
        &self.u
    }

    /// Log light that is implausible: an answer with brighter light is replaced by the start.
    pub fn brightest(&self) -> f64 {
        self.brightest
    }

    /// How many steps there are.
    pub fn len(&self) -> usize {
        self.stream.steps.len()
    }

    /// Has it no step? Never once it is laid.
    pub fn is_empty(&self) -> bool {
        self.stream.steps.is_empty()
    }

    /// The last step of each knot.
    pub fn last_steps(&self) -> impl Iterator<Item = usize> + '_ {
        let ends = self.stream.first_step.iter().skip(1).map(|first| *first as usize);
        ends.chain([self.len()]).map(|end| end - 1)
    }

    /// The steps, in order of time.
    pub fn steps(&self) -> impl Iterator<Item = Step> + '_ {
        (0..self.len()).map(|s| self.step(s))
    }

    fn step(&self, s: usize) -> Step {
        let step = &self.stream.steps[s];
        let is_last = self.stream.steps.get(s + 1).is_none_or(|next| next.what & stream::SEGMENT != 0);
        let k = step.knot as usize;
        let mut laid = Step {
            what: step.what as u32 | if is_last { LAST } else { 0 },
            knot: k,
            target: step.target,
            exposure: step.exposure,
            ..Step::default()
        };
        if step.what & stream::SEGMENT != 0 && s > 0 {
            laid.length_s = self.segments.length_s[k];
            if self.is_local {
                let (low, high) = self.segments.nearby[k];
                let first_step = |knot: u32| self.stream.first_step[knot as usize];
                laid.nearby = (first_step(low - 1), first_step(high));
                (laid.reach_s, laid.per_nearby) = (self.segments.reach_s[k], self.segments.per_nearby[k]);
            }
        }
        laid
    }
}
