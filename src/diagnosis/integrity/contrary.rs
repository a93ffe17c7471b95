//! Noise events against the direction of light: one event of the other sign between two of a pixel, while all
//! pixels around it fire with the first sign only.
//!
//! Where a pixel fires twice with the same sign, and its eight neighbours fired so too in between and never
//! otherwise, the light changed in one direction. An event of the other sign there has no light: it is noise.
//! The time between such pairs is the observation time, so the rate of contrary events is the noise rate, for
//! each sign separately.
//!
//! Limits: textures finer than three pixels, and scenes with little motion, give little observation time, and
//! the test abstains. Noise in the direction of light is not detected. It need not be: its rate is the same.

use super::departure::Departure;
use photocurrent_scene::case::Case;

/// The eight around must have fired so often between the two.
const NEIGHBOURS: usize = 8;
/// Least number of contrary events.
const FEWEST: usize = 25;
/// As a share of all events.
const SHARE: f64 = 6e-4;
/// And as a rate, Hz a pixel: small objects cross a pixel alone now and then.
const LEAST_RATE_HZ: f64 = 2.0;
/// Least number of different pixels, as a share of the contrary events,
const PIXELS: f64 = 0.5;
/// and in so many of [`PARTS`] parts of the recording.
const STEADY: usize = 9;
const PARTS: usize = 12;

/// Times of the events of one sign, pixel by pixel.
struct OfSign {
    first: Vec<usize>,
    t_ns: Vec<i64>,
}

impl OfSign {
    fn new(case: &Case, sign: i8) -> OfSign {
        let pixels = case.events.pixels();
        let (mut first, mut t_ns) = (Vec::with_capacity(pixels + 1), Vec::new());
        for pixel in 0..pixels {
            first.push(t_ns.len());
            t_ns.extend(
                case.events
                    .of_pixel(pixel)
                    .iter()
                    .filter(|event| event.polarity.signum() == sign)
                    .map(|event| event.t_in_ns),
            );
        }
        first.push(t_ns.len());
        OfSign { first, t_ns }
    }

    /// Number of events of a pixel between two instants, both included.
    fn count_between(&self, pixel: usize, (from, to): (i64, i64)) -> usize {
        let of_pixel = &self.t_ns[self.first[pixel]..self.first[pixel + 1]];
        let rest = &of_pixel[of_pixel.partition_point(|t_ns| *t_ns < from)..];
        rest.iter().take_while(|t_ns| **t_ns <= to).count()
    }
}

/// Contrary events of one sign (instant, pixel), and the observation time, s.
#[derive(Default)]
struct ContraryEvents {
    events: Vec<(i64, usize)>,
    seconds: f64,
}

impl ContraryEvents {
    fn rate_hz(&self) -> f64 {
        if self.seconds > 0.0 { self.events.len() as f64 / self.seconds } else { 0.0 }
    }
}

/// Random events, counted where light changes in one direction. Pixels of `masked` are left out.
pub(super) fn noise(case: &Case, masked: &[u32]) -> Option<Departure> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let is_masked = |pixel: usize| masked.binary_search(&(pixel as u32)).is_ok();
    let signs = [OfSign::new(case, -1), OfSign::new(case, 1)];
    let (mut off, mut on) = (ContraryEvents::default(), ContraryEvents::default());
    for pixel in (0..width * height).filter(|&pixel| !is_masked(pixel)) {
        let (x, y) = (pixel % width, pixel / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let around: Vec<usize> = rows
            .flat_map(|row| columns.clone().map(move |column| row * width + column))
            .filter(|&other| other != pixel && !is_masked(other))
            .collect();
        let events = case.events.of_pixel(pixel);
        for (at, start) in events.iter().enumerate() {
            // The next of the same sign, with one of the other sign between them at most.
            let Some(ahead) = (1..=2)
                .find(|ahead| events.get(at + ahead).is_some_and(|event| event.polarity == start.polarity))
            else {
                continue;
            };
            let span = (start.t_in_ns, events[at + ahead].t_in_ns);
            let (with, other) =
                if start.polarity > 0 { (&signs[1], &signs[0]) } else { (&signs[0], &signs[1]) };
            let goes_one_way = around.iter().map(|&near| with.count_between(near, span)).sum::<usize>()
                >= NEIGHBOURS
                && around.iter().all(|&near| other.count_between(near, span) == 0);
            if goes_one_way {
                let against = if start.polarity > 0 { &mut off } else { &mut on };
                against.seconds += (span.1 - span.0) as f64 * 1e-9;
                if ahead == 2 {
                    against.events.push((events[at + 1].t_in_ns, pixel));
                }
            }
        }
    }
    finding(case, &on, &off)
}

fn finding(case: &Case, on: &ContraryEvents, off: &ContraryEvents) -> Option<Departure> {
    let all: Vec<(i64, usize)> = on.events.iter().chain(&off.events).copied().collect();
    let share = all.len() as f64 / case.events.len().max(1) as f64;
    let rate = on.rate_hz() + off.rate_hz();
    let mut pixels: Vec<usize> = all.iter().map(|event| event.1).collect();
    pixels.sort_unstable();
    pixels.dedup();
    let length = ((case.span.1 - case.span.0) / PARTS as i64).max(1);
    let mut parts = [false; PARTS];
    all.iter()
        .for_each(|event| parts[(((event.0 - case.span.0) / length).max(0) as usize).min(PARTS - 1)] = true);
    let is_steady = parts.iter().filter(|part| **part).count() >= STEADY;
    if all.len() < FEWEST
        || share < SHARE
        || rate < LEAST_RATE_HZ
        || (pixels.len() as f64) < PIXELS * all.len() as f64
        || !is_steady
    {
        return None;
    }
    let polarity = if on.rate_hz() > 0.9 * rate {
        "on"
    } else if off.rate_hz() > 0.9 * rate {
        "off"
    } else {
        "both"
    };
    Some(Departure {
        id: "background_activity",
        parameters: vec![("rate", rate)],
        statistic: share,
        threshold: SHARE,
        share: (rate * case.events.pixels() as f64 * (case.span.1 - case.span.0) as f64 * 1e-9
            / case.events.len() as f64)
            .min(1.0),
        polarity,
        pixels: Vec::new(),
        seen: format!(
            "{} events of {} pixels come against the light, between two of the other sign while all around \
             goes their way: {:.1} ON and {:.1} OFF a second and pixel",
            all.len(),
            pixels.len(),
            on.rate_hz(),
            off.rate_hz()
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}
