//! The period of a series sampled at arbitrary instants: its strongest Fourier component.

/// Instants are counted in bins of this, ns: a hundredth of the shortest period at 40 Hz, a quarter at 1 kHz.
const BIN_NS: i64 = 250_000;
/// The highest frequency that is searched, Hz.
const FASTEST_HZ: f64 = 1000.0;
/// Least number of periods in a recording.
const FEWEST_PERIODS: f64 = 3.0;
/// Frequencies lie this share of a period in the whole recording apart.
const SPACING: f64 = 0.25;
/// Multiples of the frame rate that are attributed to the frames.
const MULTIPLES: i64 = 4;

/// A periodic component of the residuals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ResidualRhythm {
    /// Its period, ns.
    pub period_ns: i64,
    /// Is its phase that of the reset that the event followed, as of thresholds, which are taken there?
    /// Otherwise it is that of the event.
    pub is_at_reset: bool,
}

/// The period at which `values` (instant, value) swing most, ns, and by how much, squared; rhythms of period
/// `apart_from_ns` and its fractions are left out. None where the recording is too short for any.
pub(crate) fn strongest_period_ns(
    values: impl Iterator<Item = (i64, f64)>,
    span: (i64, i64),
    apart_from_ns: Option<i64>,
) -> Option<(i64, f64)> {
    let length_ns = span.1 - span.0;
    let bins = usize::try_from(length_ns / BIN_NS + 1).ok()?;
    let mut sums = vec![(0.0, 0.0); bins];
    for (t_ns, value) in values {
        if let Some(sum) = usize::try_from((t_ns - span.0) / BIN_NS).ok().and_then(|bin| sums.get_mut(bin)) {
            *sum = (sum.0 + 1.0, sum.1 + value);
        }
    }
    let (count, total) = sums.iter().fold((0.0, 0.0), |all, sum| (all.0 + sum.0, all.1 + sum.1));
    if count == 0.0 {
        return None;
    }
    let mean = total / count;
    let length_s = length_ns as f64 * 1e-9;
    let step_hz = SPACING / length_s;
    let mut best: Option<(f64, f64)> = None;
    let mut hz = FEWEST_PERIODS / length_s;
    while hz <= FASTEST_HZ {
        let is_of_frames = apart_from_ns.is_some_and(|period_ns| {
            let frame_hz = 1e9 / period_ns as f64;
            (1..=MULTIPLES).any(|k| (hz - k as f64 * frame_hz).abs() < 1.0 / length_s)
        });
        if !is_of_frames {
            let per_bin = 2.0 * std::f64::consts::PI * hz * BIN_NS as f64 * 1e-9;
            let (mut cosine, mut sine) = (0.0, 0.0);
            for (n, (count, sum)) in sums.iter().enumerate() {
                let swing = sum - mean * count;
                let (s, c) = libm::sincos(per_bin * n as f64);
                cosine += swing * c;
                sine += swing * s;
            }
            let power = cosine * cosine + sine * sine;
            if best.is_none_or(|(most, _)| power > most) {
                best = Some((power, hz));
            }
        }
        hz += step_hz;
    }
    best.filter(|(power, _)| *power > 0.0).map(|(power, hz)| ((1e9 / hz) as i64, power))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Random instants over 150 ms, with a value that swings at `hz` among noise of its size.
    fn values(hz: f64) -> Vec<(i64, f64)> {
        let mut random = Random::new(5, &[]);
        let one = |_| {
            let t_s = 0.15 * random.uniform();
            ((t_s * 1e9) as i64, 0.3 + libm::sin(2.0 * std::f64::consts::PI * hz * t_s) + random.normal())
        };
        (0..4000).map(one).collect()
    }

    #[test]
    fn a_swing_is_found_with_its_period_and_that_of_the_frames_is_passed_over() {
        for hz in [61.0, 180.0, 700.0] {
            let found =
                1e9 / strongest_period_ns(values(hz).into_iter(), (0, 150_000_000), None).unwrap().0 as f64;
            assert!((found - hz).abs() < 0.15 / 0.15, "{found} for {hz}");
        }
        let frames = 1e9 / 180.0;
        let other = 1e9
            / strongest_period_ns(values(180.0).into_iter(), (0, 150_000_000), Some(frames as i64)).unwrap().0
                as f64;
        assert!((other - 180.0).abs() > 5.0, "{other}");
        assert!(strongest_period_ns(std::iter::empty(), (0, 150_000_000), None).is_none());
    }
}
