//! What the tests of effects share: a plain pixel, light with known logarithms, and the events that come out.

use super::{Effect, PixelEvent, Site};
use crate::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use crate::front_end::FrontEnd;
use photocurrent_core::sensor::Reset;

/// Nanoseconds in a millisecond.
pub(crate) const MS: i64 = 1_000_000;

/// A pixel of a small array.
pub(crate) const SITE: Site = Site { x: 3, y: 5, width: 16, height: 12, seed: 7 };

/// An ideal pixel with both thresholds 0.2: no delay, no latency, no blind time.
pub(crate) fn ideal_pixel() -> Pixel {
    Pixel {
        front_end: FrontEnd::IDEAL,
        threshold_on: 0.2,
        threshold_off: 0.2,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns: 0,
        log_step: LOG_STEP,
    }
}

/// Light with instants of its own.
pub(crate) struct Samples {
    pub t_ns: Vec<i64>,
    pub photocurrent: Vec<f64>,
}

impl Samples {
    /// Light whose logarithm is `log_at(seconds)`, sampled every 10 us.
    pub(crate) fn of_log(duration_ns: i64, log_at: impl Fn(f64) -> f64) -> Samples {
        let t_ns: Vec<i64> = (0..=duration_ns / 10_000).map(|n| n * 10_000).collect();
        let photocurrent = t_ns.iter().map(|&t| libm::exp(log_at(t as f64 / 1e9))).collect();
        Samples { t_ns, photocurrent }
    }

    /// Constant light.
    pub(crate) fn constant(photocurrent: f64) -> Samples {
        Samples { t_ns: vec![0], photocurrent: vec![photocurrent] }
    }

    /// `before` until 1 ms, `after` a nanosecond later.
    pub(crate) fn jump(before: f64, after: f64) -> Samples {
        Samples { t_ns: vec![0, MS, MS + 1], photocurrent: vec![before, before, after] }
    }

    /// The light.
    pub(crate) fn light(&self) -> LinearLight<'_> {
        LinearLight::new(&self.t_ns, &self.photocurrent)
    }
}

/// The events that are recorded from 0 to `end_ns`, with the paper's reset.
pub(crate) fn recorded(
    pixel: Pixel,
    effects: Vec<Box<dyn Effect>>,
    samples: &Samples,
    end_ns: i64,
) -> Vec<PixelEvent> {
    recorded_at(&SITE, pixel, effects, samples, end_ns)
}

/// [`recorded`] for another pixel of the array.
pub(crate) fn recorded_at(
    site: &Site,
    pixel: Pixel,
    effects: Vec<Box<dyn Effect>>,
    samples: &Samples,
    end_ns: i64,
) -> Vec<PixelEvent> {
    let chain =
        Chain { pixel, reset: Reset::Resample, effects: &effects, tolerance: crate::forward::TOLERANCE };
    simulate(&chain, site, &samples.light(), 0, end_ns, &mut Noiseless)
        .into_iter()
        .filter_map(|fired| fired.recorded)
        .collect()
}

/// Differences of in-pixel times of events that follow one another, seconds.
pub(crate) fn intervals_s(events: &[PixelEvent]) -> Vec<f64> {
    events.windows(2).map(|pair| (pair[1].t_in_ns - pair[0].t_in_ns) as f64 / 1e9).collect()
}

/// How many events have `polarity`.
pub(crate) fn count(events: &[PixelEvent], polarity: i8) -> usize {
    events.iter().filter(|event| event.polarity == polarity).count()
}
