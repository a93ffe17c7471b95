//! The length of the exposure from how frames are blurred.
//!
//! A frame is the mean of the light over its exposure. Events say how the light went meanwhile, so for each
//! length of the exposure they predict how much the logarithm of the mean differs from the logarithm in the
//! middle, and with it the change from one frame to the next. The length with the smallest residual is the
//! exposure.
//!
//! Limits: the middle of the exposure must be right ([`super::offset()`] gives it up to the latency of
//! events). Only light that bends within an exposure shows its length: slow scenes have none. Noise of events
//! is smoothed by a mean over any time, so that some length always explains noisy events a little better, the
//! wrong one: only a length that explains much is given. Dark places are left out, as for thresholds.

use super::draw::{Estimate, by_draws, top};
use super::panel::{Panel, Stretch};

/// Lengths that are tried, from 0 on.
const LENGTHS: usize = 17;
/// Instants of an exposure whose mean is taken.
const INSTANTS: usize = 12;
/// The residual must fall by this share from the shortest length, and from the longest, to the best: noise
/// alone makes it fall by up to a fifth.
const LEAST_GAIN: f64 = 0.33;
/// Places with less light change over a pair of frames, in events a pixel, are left out.
const FEWEST_A_PIXEL: f32 = 2.0;

/// Lengths that explain nearly as much belong to the interval: the front end and lost events are not in the
/// model. As a share of what the best explains beyond the better end.
const NEARLY: f64 = 0.15;
/// What thresholds are multiplied by, to try: those that come from blurred frames are too small, as a blurred
/// edge changes less than its events say.
const SCALES: [f64; 8] = [0.7, 0.8, 0.9, 1.0, 1.12, 1.25, 1.4, 1.6];

/// Why no length is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unclear {
    /// Nothing moves in bright places while frames are exposed, or there are too few pairs of frames.
    NoChange,
    /// No length explains the frames much better than the shortest and the longest: the residual falls by
    /// this share of them only.
    Flat {
        /// From the shortest length to the best, 0 to 1.
        from_shortest: f64,
        /// From the longest.
        from_longest: f64,
    },
    /// The best length hangs on how late events are, or on the thresholds: it goes to an end within what is
    /// known of these.
    AtAnEnd,
}

/// Length of the exposure, ns, with thresholds of about `(on, off)` and events so much later than frames, ns.
/// At each length the thresholds are those of [`SCALES`] that explain the frames best. The interval holds the
/// draws, the interval of the offset, and lengths that explain nearly as much.
///
/// # Errors
/// When the length is not clear, and why.
pub fn exposure(panel: &Panel, thresholds: (f64, f64), offset_ns: &Estimate) -> Result<Estimate, Unclear> {
    let curve = Curve::of(panel, thresholds, offset_ns.value).ok_or(Unclear::NoChange)?;
    let all = curve.residuals(&vec![1.0; curve.units]);
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let gain = |from: f64| 1.0 - least / from;
    let (from_shortest, from_longest) = (gain(all[0]), gain(all[LENGTHS - 1]));
    if from_shortest < LEAST_GAIN || from_longest < LEAST_GAIN {
        return Err(Unclear::Flat { from_shortest, from_longest });
    }
    let found = by_draws(curve.units, |weights| curve.best(weights)).ok_or(Unclear::AtAnEnd)?;
    let (mut low, mut high) = found.ci95;
    let enough = least + NEARLY * (all[0].min(all[LENGTHS - 1]) - least);
    for length in (0..LENGTHS).filter(|n| all[*n] <= enough).map(|n| n as f64 * curve.step_ns) {
        (low, high) = (low.min(length), high.max(length));
    }
    for end_ns in [offset_ns.ci95.0, offset_ns.ci95.1].into_iter().filter(|end_ns| *end_ns != offset_ns.value)
    {
        let curve = Curve::of(panel, thresholds, end_ns).ok_or(Unclear::NoChange)?;
        let other = curve.best(&vec![1.0; curve.units]).ok_or(Unclear::AtAnEnd)?;
        (low, high) = (low.min(other), high.max(other));
    }
    Ok(Estimate { value: found.value, ci95: (low, high) })
}

/// The residual at each length.
struct Curve {
    /// From one length to the next, ns.
    step_ns: f64,
    /// Pairs of frames and parts of the picture in which something changes.
    units: usize,
    /// [scale][length][unit].
    sums: Vec<f64>,
}

impl Curve {
    /// None where too little changes.
    fn of(panel: &Panel, thresholds: (f64, f64), offset_ns: f64) -> Option<Curve> {
        let (step_ns, bright) = (panel.period_ns()? as f64 / (LENGTHS - 1) as f64, panel.bright());
        let parts = panel.part_count();
        let units = panel.pairs() * parts;
        let mut sums = vec![0.0; SCALES.len() * LENGTHS * units];
        let mut pair = 0;
        for stretch in &panel.stretches {
            let counted = stretch.summed(1.0, -1.0);
            let frames = stretch.mids_ns.len();
            let mids: Vec<f64> = stretch.mids_ns.iter().map(|mid| *mid as f64 + offset_ns).collect();
            let scaled: Vec<Vec<f32>> = SCALES
                .iter()
                .map(|scale| stretch.summed((scale * thresholds.0) as f32, (scale * thresholds.1) as f32))
                .collect();
            for n in 0..SCALES.len() * LENGTHS {
                let (summed, length) = (&scaled[n / LENGTHS], (n % LENGTHS) as f64 * step_ns);
                // None where the exposure leaves the stretch.
                let means: Vec<Option<Vec<f32>>> =
                    mids.iter().map(|mid| log_mean(panel, stretch, summed, *mid, length)).collect();
                for frame in 1..frames {
                    let (Some(before), Some(after)) = (&means[frame - 1], &means[frame]) else { continue };
                    let mut events = vec![0.0; panel.places()];
                    stretch.add_at(&counted, mids[frame], 1.0, &mut events);
                    stretch.add_at(&counted, mids[frame - 1], -1.0, &mut events);
                    for place in 0..panel.places() {
                        let (log_before, log_after) =
                            (stretch.logs(frame - 1)[place], stretch.logs(frame)[place]);
                        let change = log_after - log_before;
                        if change.is_finite()
                            && log_before.min(log_after) >= bright
                            && events[place] >= FEWEST_A_PIXEL * panel.pixels[place] as f32
                        {
                            let left = f64::from((change - (after[place] - before[place])).clamp(-2.0, 2.0));
                            sums[n * units + (pair + frame - 1) * parts + usize::from(panel.parts[place])] +=
                                left * left;
                        }
                    }
                }
            }
            pair += frames.saturating_sub(1);
        }
        let some: Vec<usize> = (0..units)
            .filter(|unit| (0..SCALES.len() * LENGTHS).all(|n| sums[n * units + unit] > 0.0))
            .collect();
        let sums = (0..SCALES.len() * LENGTHS)
            .flat_map(|n| some.iter().map(move |unit| (n, *unit)))
            .map(|(n, unit)| sums[n * units + unit])
            .collect();
        (some.len() >= 2).then_some(Curve { step_ns, units: some.len(), sums })
    }

    /// Residual at each length, with the best thresholds for it, of units by weight.
    fn residuals(&self, weights: &[f64]) -> Vec<f64> {
        let of = |sums: &[f64]| sums.iter().zip(weights).map(|(sum, weight)| sum * weight).sum::<f64>();
        let all: Vec<f64> = self.sums.chunks(self.units).map(of).collect();
        (0..LENGTHS)
            .map(|length| all.iter().skip(length).step_by(LENGTHS).copied().fold(f64::INFINITY, f64::min))
            .collect()
    }

    /// The length with the smallest residual, ns; none at an end.
    fn best(&self, weights: &[f64]) -> Option<f64> {
        let residuals: Vec<f64> = self.residuals(weights).iter().map(|residual| -residual).collect();
        top(&residuals).map(|at| at * self.step_ns)
    }
}

/// Logarithm of the mean over an exposure of what events say of the light, at every place; none where the
/// exposure leaves the stretch.
fn log_mean(panel: &Panel, stretch: &Stretch, summed: &[f32], mid: f64, length: f64) -> Option<Vec<f32>> {
    let places = panel.places();
    let mut middle = vec![0.0; places];
    if !stretch.add_at(summed, mid, 1.0, &mut middle) {
        return None;
    }
    let mut mean = vec![0.0f32; places];
    let mut now = vec![0.0f32; places];
    for n in 0..INSTANTS {
        now.fill(0.0);
        let at = mid + ((n as f64 + 0.5) / INSTANTS as f64 - 0.5) * length;
        if !stretch.add_at(summed, at, 1.0, &mut now) {
            return None;
        }
        for (((mean, now), middle), pixels) in mean.iter_mut().zip(&now).zip(&middle).zip(&panel.pixels) {
            *mean += libm::expf((now - middle) / *pixels as f32) / INSTANTS as f32;
        }
    }
    Some(
        mean.iter()
            .zip(&middle)
            .zip(&panel.pixels)
            .map(|((mean, middle), pixels)| libm::logf(*mean) + middle / *pixels as f32)
            .collect(),
    )
}
