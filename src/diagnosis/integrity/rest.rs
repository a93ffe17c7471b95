//! A camera at rest before a static scene: its events are noise, with as many ON as OFF events, or a leak,
//! which causes ON events alone.

use super::departure::Departure;
use crate::units::readable;
use photocurrent_scene::case::{Case, PixelEvent};

/// Least share of still pixels for a camera at rest.
const AT_REST: f64 = 0.9;
/// Least number of events of the rarer sign.
const FEWEST: usize = 30;
/// Share of these with neighbouring events above which something moves: an event of another pixel this
/// near, pixels in rows and columns, within this time, ns.
const WITH_NEIGHBOURS: f64 = 0.2;
const NEAR: usize = 2;
const NEAR_NS: i64 = 10_000_000;
/// Number of parts of the recording, nearly all of which must have events.
const PARTS: usize = 12;
const STEADY: usize = 9;

/// Are nearly all pixels still? Pixels of `out` are not counted.
pub(super) fn is_at_rest(case: &Case, still: &[u32], out: &[u32]) -> bool {
    still.len() as f64 >= AT_REST * (case.extent.pixels() - out.len()) as f64
}

/// Noise of a camera at rest: twice as many events as there are of the rarer sign.
pub(super) fn noise(case: &Case, still: &[u32], out: &[u32]) -> Option<Departure> {
    if !is_at_rest(case, still, out) {
        return None;
    }
    let of = |polarity: i8| -> Vec<(i64, u32)> {
        let events = still.iter().flat_map(|pixel| {
            let of_pixel = case.events.of_pixel(*pixel as usize).iter();
            of_pixel.filter(move |event| event.polarity == polarity).map(|event| (event.t_in_ns, *pixel))
        });
        events.collect()
    };
    let [on, off] = [of(1), of(-1)];
    let rarer = if on.len() < off.len() { on } else { off };
    let length = ((case.span.1 - case.span.0) / PARTS as i64).max(1);
    let part = |t_ns: i64| (((t_ns - case.span.0) / length).max(0) as usize).min(PARTS - 1);
    let mut parts = [false; PARTS];
    rarer.iter().for_each(|(t_ns, _)| parts[part(*t_ns)] = true);
    let with_neighbours =
        rarer.iter().filter(|(t_ns, pixel)| has_neighbouring_event(case, *t_ns, *pixel)).count();
    if rarer.len() < FEWEST
        || with_neighbours as f64 > WITH_NEIGHBOURS * rarer.len() as f64
        || parts.iter().filter(|part| **part).count() < STEADY
    {
        return None;
    }
    let seconds = (case.span.1 - case.span.0) as f64 * 1e-9;
    let rate = 2.0 * rarer.len() as f64 / (still.len() as f64 * seconds);
    Some(Departure {
        id: "background_activity",
        parameters: vec![("rate", rate)],
        statistic: (rarer.len() as f64).sqrt(),
        threshold: (FEWEST as f64).sqrt(),
        share: (2 * rarer.len()) as f64 / case.events.len() as f64,
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "{} of {} pixels are still and have {} events of the rarer sign, {} of them near no other in \
             place and time: {} a pixel of both signs",
            still.len(),
            case.extent.pixels(),
            rarer.len(),
            rarer.len() - with_neighbours,
            readable(rate, "Hz")
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Does another pixel near an event fire at about the same time?
fn has_neighbouring_event(case: &Case, t_ns: i64, pixel: u32) -> bool {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (x, y) = (pixel as usize % width, pixel as usize / width);
    let near = |at: usize, size: usize| at.saturating_sub(NEAR)..(at + NEAR + 1).min(size);
    near(y, height).flat_map(|v| near(x, width).map(move |u| v * width + u)).any(|other| {
        let is_near = |event: &PixelEvent| (event.t_in_ns - t_ns).abs() < NEAR_NS;
        other != pixel as usize && case.events.of_pixel(other).iter().any(is_near)
    })
}
