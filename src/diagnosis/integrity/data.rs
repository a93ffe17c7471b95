//! Inconsistent recordings, and those with too little data.

use photocurrent_scene::case::{Case, CaseFrames};

/// Least number of events for any statement on the event path.
pub(crate) const FEWEST_EVENTS: usize = 300;

/// With fewer frames the two paths cannot be compared.
pub(crate) const FEWEST_FRAMES: usize = 3;

/// Mean rate of a pixel from which stamps must be of another unit: the fastest read-outs give a thousand
/// events a pixel and second with all pixels firing.
const FASTEST_HZ: f64 = 5_000.0;

/// Reasons why the data cannot be used, one sentence each.
pub(crate) fn unusable_data(case: &Case) -> Vec<String> {
    let mut why = Vec::new();
    if case.events.len() >= FEWEST_EVENTS {
        why.extend(broken_events(case));
    }
    why.extend(clocks_without_overlap(case));
    if let Some(frames) = &case.frames {
        why.extend(broken_frames(case, frames));
    }
    why
}

/// Reasons why the events cannot be used.
fn broken_events(case: &Case) -> Vec<String> {
    let mut why = Vec::new();
    let events = &case.events;
    let early = events.iter().filter(|event| event.t_off_ns < event.t_in_ns).count();
    if case.has_t_in && early * 100 > events.len() {
        why.push(format!(
            "{early} of {} events leave the array before they fire: t < t_in in /events",
            events.len()
        ));
    }
    let first = events.iter().next().map_or(0, |event| event.t_off_ns);
    if events.iter().all(|event| event.t_off_ns == first) {
        why.push(format!("all {} events have one and the same time, {first} ns", events.len()));
    }
    let seconds = (case.span.1 - case.span.0) as f64 * 1e-9;
    let rate_hz = events.len() as f64 / (seconds * case.extent.pixels().max(1) as f64);
    if seconds > 0.0 && rate_hz > FASTEST_HZ {
        why.push(format!(
            "{} events in {seconds:.3e} s, {rate_hz:.0} a pixel and second, are more than any sensor \
                 gives: the stamps are of a larger unit",
            events.len()
        ));
    }
    // A pixel cannot fire twice at one instant; a coarse grid makes a few equal, a broken clock nearly
    // all.
    let pairs = events.len()
        - (0..case.events.pixels()).filter(|&pixel| !case.events.of_pixel(pixel).is_empty()).count();
    let equal: usize = (0..case.events.pixels())
        .map(|pixel| {
            case.events
                .of_pixel(pixel)
                .windows(2)
                .filter(|pair| pair[0].t_off_ns == pair[1].t_off_ns && pair[0].polarity == pair[1].polarity)
                .count()
        })
        .sum();
    if pairs >= FEWEST_EVENTS && equal * 2 > pairs {
        why.push(format!(
            "{equal} of {pairs} events repeat the time and sign of the pixel's event before: the same \
                 event twice, or stamps that stand still"
        ));
    }
    why
}

/// Reasons why the frames cannot be used.
fn broken_frames(case: &Case, frames: &CaseFrames) -> Vec<String> {
    let mut why = Vec::new();
    let known: Vec<f32> = frames.values().filter(|dn| dn.is_finite()).collect();
    let count = frames.len().max(1);
    if known.len() * 2 < count {
        why.push(format!("{} of {count} frame values are not numbers", count - known.len()));
    } else if known.iter().all(|dn| *dn == known[0]) && known.len() > 1 {
        why.push(format!("every frame value is {}: the frames hold no picture", known[0]));
    }
    let infinite = frames.values().filter(|dn| dn.is_infinite()).count();
    if infinite > 0 {
        why.push(format!("{infinite} of {count} frame values are infinite"));
    }
    let full = case.sensor.frames.saturation_dn.unwrap_or(f64::INFINITY);
    let saturated = known.iter().filter(|dn| f64::from(**dn) >= full).count();
    if saturated * 10 > known.len() * 9 {
        why.push(format!("{saturated} of {} frame values are saturated (>= {full} DN)", known.len()));
    }
    let black = case.sensor.frames.black_level_dn.unwrap_or(0.0);
    let room = if full.is_finite() { full - black } else { 1e4 };
    // Noise about a black of zero makes half of a dark frame negative, but not on average.
    let negative = known.iter().filter(|dn| **dn < 0.0).count();
    let mean = known.iter().map(|dn| f64::from(*dn)).sum::<f64>() / known.len().max(1) as f64;
    let variance = known.iter().map(|dn| (f64::from(*dn) - mean) * (f64::from(*dn) - mean)).sum::<f64>()
        / known.len().max(1) as f64;
    if negative * 2 > known.len() && mean < black.min(0.0) - 0.2 * variance.sqrt() {
        why.push(format!(
            "{negative} of {} frame values are negative, {mean:.4} on average: no light is",
            known.len()
        ));
    }
    let absurd = known
        .iter()
        .filter(|dn| f64::from(**dn) < black - room || f64::from(**dn) > black + 10.0 * room)
        .count();
    if absurd * 10 > known.len() {
        why.push(format!(
            "{absurd} of {} frame values lie outside anything that black level {black} and \
                              saturation {full} allow",
            known.len()
        ));
    }
    why
}

/// Reason where events and frames do not overlap in time: their clocks have different zeros, so they cannot
/// be compared.
fn clocks_without_overlap(case: &Case) -> Option<String> {
    let events = &case.events;
    let frames = case.frames.as_ref().and_then(|frames| frames.times.span(case.extent.height))?;
    let first = events.iter().map(|event| event.t_off_ns).min()?;
    let last = events.iter().map(|event| event.t_off_ns).max()?;
    let seconds = |ns: i64| ns as f64 * 1e-9;
    (last < frames.start.0 || first > frames.end.0).then(|| {
        format!(
            "events are stamped {:.6} to {:.6} s, frames are exposed {:.6} to {:.6} s: they share no time, \
             so one of the clocks has another zero; move one of them, or state `effects.clock_offset`",
            seconds(first),
            seconds(last),
            seconds(frames.start.0),
            seconds(frames.end.0)
        )
    })
}

/// Are there enough events and frames to compare the two paths?
pub(crate) fn is_enough(case: &Case) -> bool {
    case.events.len() >= FEWEST_EVENTS && case.frame_count() >= FEWEST_FRAMES
}

/// Data that are missing or too few, one sentence each.
pub(crate) fn insufficient_data(case: &Case) -> Vec<String> {
    let mut why = Vec::new();
    let (events, frames) = (case.events.len(), case.frame_count());
    if events < FEWEST_EVENTS {
        why.push(format!("{events} events; {FEWEST_EVENTS} are needed to say anything of the event path"));
    }
    if frames < FEWEST_FRAMES {
        why.push(format!("{frames} frames; {FEWEST_FRAMES} are needed to compare events with frames"));
    }
    why
}
