//! Frame against frame, with the events between them: rows of a linear regression.
//!
//! The light through the events ([`crate::band`]) and a frame agree but for a *closure*. From one frame of a pixel to the next, closures change when thresholds are not
//! what is stated, by `g p theta K` for each event of sign `p` whose threshold is a share `g` more, and by `-d p theta dK/dt` for each whose stamp is `d` late, where `K(t)` is how much
//! a step of light at `t` raises the second frame and not the first. That is linear in all `g` and `d`, and does not ask what the light did meanwhile.

use crate::band::Band;
use crate::case::Case;
use crate::nominal::Nominal;
use crate::sample::Sample;
use rayon::prelude::*;

/// What the catalogue's simplest effects add to a change of closure: ON and OFF thresholds, a delay, one that is inverse to light, drift, drift in light, light added,
/// light compressed, and contrast.
pub const PLAIN: usize = 9;
/// A step of light is spread over the interval before its event, but over no more than this, seconds.
const LONGEST_S: f64 = 5e-3;
/// Changes with more events than this say little: errors of their references add up.
const MOST_EVENTS: usize = 12;
/// That of one event, as a share of the threshold.
const REFERENCE: f64 = 0.15;
/// Changes of closures are cut here, natural-log units.
const LARGEST: f64 = 0.4;

/// A change of closure.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Place of the pixel in the sample.
    pub place: usize,
    /// The later of the two frames.
    pub frame: usize,
    /// What is to be explained, natural-log units.
    pub value: f64,
    /// Inverse of its variance, up to a factor.
    pub weight: f64,
    /// Start and end of the two exposures on the clock of stamps, seconds since the start: what the light does then is stamped then, but for the wait for a threshold.
    pub exposures: [(f64, f64); 2],
    /// See [`PLAIN`].
    pub plain: [f64; PLAIN],
    /// Events with what they add: number among the sample's events, for a threshold and for a stamp (a second).
    pub events: Vec<(usize, f64, f64)>,
}

impl Change {
    /// How much a step of light that is stamped at `t` raises the second frame and not the first: `K(t)`.
    pub fn rise(&self, t: f64) -> f64 {
        rise(&self.exposures, t)
    }
}

fn rise(exposures: &[(f64, f64); 2], t: f64) -> f64 {
    let share = |(start, end): (f64, f64)| ((end - t) / (end - start)).clamp(0.0, 1.0);
    share(exposures[1]) - share(exposures[0])
}

/// All changes of the pixels of a sample, in its order.
pub fn changes(case: &Case, nominal: &Nominal, sample: &Sample, bands: &[Band]) -> Vec<Change> {
    let mut first = Vec::with_capacity(sample.len());
    let mut count = 0;
    for &pixel in &sample.pixels {
        first.push(count);
        count += case.events.of(pixel as usize).len();
    }
    let parts: Vec<Vec<Change>> = (0..sample.len())
        .into_par_iter()
        .with_min_len(32)
        .map(|place| of_pixel(case, nominal, sample.pixels[place] as usize, place, first[place], &bands[place]))
        .collect();
    parts.into_iter().flatten().collect()
}

fn of_pixel(case: &Case, nominal: &Nominal, pixel: usize, place: usize, first: usize, band: &Band) -> Vec<Change> {
    let zero = case.span.0;
    let events = case.events.of(pixel);
    if !band.is_known || events.is_empty() {
        return Vec::new();
    }
    let front_end = nominal.pixel.front_end;
    let mut lights: Vec<f64> = band.frames.iter().map(|frame| frame.log_measured).collect();
    lights.sort_by(f64::total_cmp);
    let usual = libm::exp(crate::summaries::quantile(&lights, 0.5));
    let of_pair = |pair: &[crate::band::BandFrame]| {
        let (a, b) = (&pair[0], &pair[1]);
        let (light_a, light_b) = (libm::exp(a.log_measured), libm::exp(b.log_measured));
        let lag_s = front_end.tau_0_s + front_end.alpha_s / libm::sqrt(light_a * light_b);
        let exposures = [a, b].map(|frame| (frame.start_s + lag_s, frame.end_s + lag_s));
        let rise = |t: f64| rise(&exposures, t);
        let stamp = |n: usize| (events[n].t_in_ns - zero) as f64 * 1e-9;
        let from = events.partition_point(|event| ((event.t_in_ns - zero) as f64 * 1e-9) < exposures[0].0);
        let middle = |frame: &crate::band::BandFrame| 0.5 * (frame.start_s + frame.end_s);
        let seconds = middle(b) - middle(a);
        let mut plain = [0.0; PLAIN];
        let mut told = Vec::new();
        for (n, event) in events.iter().enumerate().skip(from) {
            let t = stamp(n);
            let before = if n == 0 { t - LONGEST_S } else { f64::max(stamp(n - 1), t - LONGEST_S) };
            if before > exposures[1].1 {
                break;
            }
            let step = if event.polarity > 0 { nominal.pixel.threshold_on } else { -nominal.pixel.threshold_off };
            let length = f64::max(t - before, 1e-6);
            let gain = step * [1.0, 3.0, 5.0].iter().map(|k| rise(before + k / 6.0 * length)).sum::<f64>() / 3.0;
            let delay = -step * (rise(t) - rise(t - length)) / length;
            if gain != 0.0 || delay != 0.0 {
                told.push((first + n, gain, delay));
                plain[usize::from(event.polarity < 0)] += gain;
                plain[2] += delay;
                plain[3] += delay * usual / libm::sqrt(light_a * light_b);
            }
        }
        plain[4] = seconds;
        plain[5] = seconds * libm::sqrt(light_a * light_b) / usual;
        plain[6] = usual / light_b - usual / light_a;
        plain[7] = (light_b - light_a) / usual;
        plain[8] = b.log_measured - a.log_measured;
        let value = (b.closure - a.closure).clamp(-LARGEST, LARGEST);
        let of_events = REFERENCE * 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
        let variance = 1.0 / a.weight + 1.0 / b.weight + told.len() as f64 * of_events * of_events;
        (told.len() <= MOST_EVENTS).then(|| Change { place, frame: b.frame, value, weight: 1.0 / variance, exposures, plain, events: told })
    };
    let next = |pair: &&[crate::band::BandFrame]| pair[1].frame == pair[0].frame + 1;
    band.frames.windows(2).filter(next).filter_map(of_pair).collect()
}
