//! From instants to stamps: clocks, rows, jitter, steps, and the order in which a recorder gets the events.

use crate::array::Event;
use crate::random::Random;
use crate::sensor::Physics;

/// An event as recorded, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamped {
    pub t: i64,
    pub t_in: i64,
    pub pixel: usize,
    pub on: bool,
}

/// Stamps all events in steps of `resolution` ns, sorted by off-pixel time.
pub fn stamp(
    events: &[Event],
    physics: &Physics,
    width: usize,
    height: usize,
    resolution: i64,
    random: &mut Random,
) -> Vec<Stamped> {
    let rows: Vec<f64> =
        (0..height).map(|y| physics.skew_per_row * y as f64 + physics.skew_sigma * random.normal()).collect();
    let mut stamped: Vec<Stamped> = events
        .iter()
        .map(|event| {
            let mut late = rows[event.pixel / width] + physics.clock_offset;
            if physics.jitter > 0.0 {
                late += physics.jitter * random.normal().clamp(-4.0, 4.0);
            }
            let nanoseconds = |t: f64| {
                let mut t = t * (1.0 + physics.clock_rate) + late;
                if physics.quantum > 0.0 {
                    t = physics.quantum * (t / physics.quantum).floor();
                }
                ((t * 1e9).round() as i64).div_euclid(resolution) * resolution
            };
            Stamped {
                t: nanoseconds(event.t_off),
                t_in: nanoseconds(event.t_in),
                pixel: event.pixel,
                on: event.on,
            }
        })
        .collect();
    stamped.sort();
    stamped
}
