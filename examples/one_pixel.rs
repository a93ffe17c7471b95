//! The light of one pixel from its events and two frame values.
#![allow(clippy::print_stdout)]

use photocurrent_solve::{Exposure, Polarity, Sensor, SolveOptions, Source, solve_pixel};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("data/sensors/hybrid.toml")?;
    let sensor =
        Sensor::parse(&Source::new("hybrid.toml", "", text)).map_err(|problems| format!("{problems:?}"))?;
    let events: Vec<(i64, Polarity)> = (1..6).map(|k| (k * 1_500_000, Polarity::On)).collect();
    let frames = [(Exposure::new(0, 4_000_000), 200.0), (Exposure::new(6_000_000, 10_000_000), 420.0)];
    let track = solve_pixel(&sensor, &events, &frames, &SolveOptions::default())?;
    track
        .t_ns
        .iter()
        .zip(&track.photocurrent)
        .step_by(8)
        .for_each(|(t, i)| println!("{:7.3} ms {i:8.2}", *t as f64 / 1e6));
    Ok(())
}
