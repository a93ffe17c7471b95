//! A camera at rest before a still scene: what fires there is noise, of which as many events go either way,
//! or a leak, which makes ON events alone.

use super::departure::Departure;
use crate::units::readable;
use photocurrent_scene::case::{Case, PixelEvent};

/// The camera is at rest when this share of the pixels that count is still.
const AT_REST: f64 = 0.9;
/// So few events of the rarer sign decide nothing.
const FEWEST: usize = 30;
/// Something moves, after all, where more than this share of them has company: an event of another pixel this
/// near, pixels in rows and columns, within this time, ns.
const IN_COMPANY: f64 = 0.2;
const NEAR: usize = 2;
const NEAR_NS: i64 = 10_000_000;
/// All the time: in so many of so many parts of the recording.
const PARTS: usize = 12;
const STEADY: usize = 9;

/// Is nearly everything still, of `out` pixels that do not count?
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
            let of_pixel = case.events.of(*pixel as usize).iter();
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
    let in_company = rarer.iter().filter(|(t_ns, pixel)| has_company(case, *t_ns, *pixel)).count();
    if rarer.len() < FEWEST
        || in_company as f64 > IN_COMPANY * rarer.len() as f64
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
            rarer.len() - in_company,
            readable(rate, "Hz")
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Does another pixel near an event fire at about the same time?
fn has_company(case: &Case, t_ns: i64, pixel: u32) -> bool {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (x, y) = (pixel as usize % width, pixel as usize / width);
    let near = |at: usize, size: usize| at.saturating_sub(NEAR)..(at + NEAR + 1).min(size);
    near(y, height).flat_map(|v| near(x, width).map(move |u| v * width + u)).any(|other| {
        let is_near = |event: &PixelEvent| (event.t_in_ns - t_ns).abs() < NEAR_NS;
        other != pixel as usize && case.events.of(other).iter().any(is_near)
    })
}
