//! Intervals between events of a pixel: far shorter than any scene causes (noise events, jitter), or
//! concentrated at their minimum (blind time).
//!
//! The scene's shortest intervals follow from the distribution itself: a nominal sensor has none below 0.3
//! times the 2nd percentile, whatever moves.

use super::departure::Departure;
use super::stamps;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::quantile;

/// Too short is below this share of the 2nd percentile.
const SHORT: f64 = 0.3;
/// This share of the reversals (events of the other sign than the one before) must be too short for noise
/// events.
const NOISE_REVERSALS: f64 = 0.003;
/// Least share of all intervals: leaks cause short reversals alone.
const NOISE_ALL: f64 = 0.0003;
/// This share of the intervals must be too short for jitter, while reversals are not.
const JITTER_ALL: f64 = 0.002;
/// This share of the intervals must be shorter than the stated blind time.
const BLIND: f64 = 0.02;
/// This share of the intervals must lie within 3 % of the shortest one for a blind time.
const PILE: f64 = 0.03;

/// Findings from intervals; pixels of `masked` are left out.
pub(super) fn findings(case: &Case, nominal: Option<&Nominal>, masked: &[u32]) -> Vec<Departure> {
    let (mut all, mut reversals, mut blind) = (Vec::new(), Vec::new(), Vec::new());
    let mut events = 0;
    for pixel in (0..case.events.pixels()).filter(|&pixel| masked.binary_search(&(pixel as u32)).is_err()) {
        let of_pixel = case.events.of_pixel(pixel);
        events += of_pixel.len();
        for pair in of_pixel.windows(2) {
            let interval = pair[1].t_in_ns - pair[0].t_in_ns;
            all.push(interval);
            blind.push(pair[1].t_in_ns - pair[0].t_off_ns);
            if pair[1].polarity != pair[0].polarity {
                reversals.push(interval);
            }
        }
    }
    for values in [&mut all, &mut reversals, &mut blind] {
        values.sort_unstable();
    }
    if all.len() < 1000 || reversals.len() < 300 {
        return Vec::new();
    }
    let noise = noise(&all, &reversals, events);
    let is_noisy = noise.is_some();
    let mut found: Vec<Departure> = noise.into_iter().collect();
    if !is_noisy {
        found.extend(jitter(case, &all, &reversals));
        found.extend(nominal.and_then(|nominal| blind_time(case, nominal, &blind)));
    }
    found
}

/// Share of sorted intervals below 0.3 times their 2nd percentile, and that limit, ns.
fn too_short(sorted: &[i64]) -> (f64, f64) {
    let limit = SHORT * quantile(sorted, 0.02) as f64;
    (sorted.partition_point(|interval| (*interval as f64) < limit) as f64 / sorted.len() as f64, limit)
}

/// Noise events: some follow an event of the scene at once, with the other sign.
fn noise(all: &[i64], reversals: &[i64], events: usize) -> Option<Departure> {
    let ((share_all, _), (share, limit)) = (too_short(all), too_short(reversals));
    if share < NOISE_REVERSALS || share_all < NOISE_ALL {
        return None;
    }
    // After each event, within the limit, half of the noise events are of the other sign.
    let short = share * reversals.len() as f64;
    let rate = 2.0 * short / (events as f64 * limit * 1e-9);
    Some(Departure {
        id: "background_activity",
        parameters: vec![("rate", rate)],
        statistic: share,
        threshold: NOISE_REVERSALS,
        share,
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "{:.2} % of the reversals come within {:.0} us, where the scene has none: events without light, \
             about {rate:.1} Hz a pixel",
            100.0 * share,
            limit * 1e-3
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Intervals of one sign that are too short, while reversals are not: the events are right and their stamps
/// are not.
fn jitter(case: &Case, all: &[i64], reversals: &[i64]) -> Option<Departure> {
    let ((share, limit), (other, _)) = (too_short(all), too_short(reversals));
    // Below a few steps of the stamps a share means nothing.
    if share < JITTER_ALL || other > 0.1 * share || limit < case.t_resolution_ns as f64 * 0.3 {
        return None;
    }
    Some(Departure {
        id: "timestamp_jitter",
        parameters: vec![("sigma", stamps::jitter_s(case))],
        statistic: share,
        threshold: JITTER_ALL,
        share,
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "{:.2} % of the intervals are below {:.0} us, a third of what the scene asks for, and only \
             between events of one sign",
            100.0 * share,
            limit * 1e-3
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Events before the stated blind time is over, or piled up at a longer one.
fn blind_time(case: &Case, nominal: &Nominal, blind: &[i64]) -> Option<Departure> {
    let (stated, step) = (nominal.pixel.refractory_ns, case.t_resolution_ns.max(1));
    let early = blind.partition_point(|interval| *interval < stated - 2 * step) as f64 / blind.len() as f64;
    let finding = |value_ns: i64, statistic: f64, threshold: f64, seen: String| Departure {
        id: "refractory",
        parameters: vec![("refractory", value_ns as f64 * 1e-9)],
        statistic,
        threshold,
        share: statistic,
        polarity: "both",
        pixels: Vec::new(),
        seen,
        heldout: None,
        ci95: Vec::new(),
    };
    if early > BLIND {
        let shortest = quantile(blind, 0.002).max(0);
        let text = format!(
            "{:.1} % of the events come before the stated blind time of {:.1} us is over",
            100.0 * early,
            stated as f64 * 1e-3
        );
        return Some(finding(shortest, early, BLIND, text));
    }
    let shortest = quantile(blind, 0.001);
    if shortest < stated + 4 * step || shortest < 8 * step {
        return None;
    }
    let below = |factor: f64| {
        blind.partition_point(|interval| (*interval as f64) < shortest as f64 * factor) as f64
            / blind.len() as f64
    };
    let (near, next) = (below(1.03), below(1.2) - below(1.03));
    // As dense again in the next fifth would be a scene that is fast, not a pixel that is blind.
    let is_sharp = near / 0.03 > 3.0 * next / 0.17;
    let seen = format!(
        "{:.1} % of the intervals lie within 3 % of the shortest, {:.1} us: pixels are blind that long",
        100.0 * near,
        shortest as f64 * 1e-3
    );
    (near > PILE && is_sharp).then(|| finding(shortest, near, PILE, seen))
}
