//! Simulates one pixel of a described sensor and estimates its light from what it recorded.
#![allow(clippy::print_stdout)]

use photocurrent_sensor::forward::{FrameReadout, LinearLight, Noiseless, read_frames, simulate_events};
use photocurrent_sensor::{effects::Site, model::Model};
use photocurrent_solve::{Exposure, Polarity, Sensor, SolveOptions, Source, solve_pixel};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("data/sensors/hybrid.toml")?;
    let sensor =
        Sensor::parse(&Source::new("hybrid.toml", "", text)).map_err(|problems| format!("{problems:?}"))?;
    let model = Model::of(&sensor);

    // Light that rises from 40 to 120 within 20 ms and falls again.
    let (t_ns, photocurrent) = ([0, 10_000_000, 30_000_000, 50_000_000], [40.0, 40.0, 120.0, 50.0]);
    let light = LinearLight::new(&t_ns, &photocurrent);
    let events = simulate_events(&model.pixel, &light, 0, 50_000_000, &mut Noiseless);
    let exposures: Vec<Exposure> =
        (0..6).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 6_500_000)).collect();
    let readout = FrameReadout { number: model.number, saturation: model.saturation_dn, row_time_ns: 0 };
    let site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
    let dn = read_frames(&readout, &[], &site, &light, &exposures);

    let polarity = |sign: i8| if sign > 0 { Polarity::On } else { Polarity::Off };
    let events: Vec<(i64, Polarity)> =
        events.iter().map(|event| (event.t_in_ns, polarity(event.polarity))).collect();
    let frames: Vec<(Exposure, f64)> = exposures.into_iter().zip(dn).collect();
    let track = solve_pixel(&sensor, &events, &frames, &SolveOptions::default())?;

    let miss = |(t, i): (&i64, &f64)| libm::log(i / light.at(*t));
    let squares: f64 = track.t_ns.iter().zip(&track.photocurrent).map(miss).map(|miss| miss * miss).sum();
    let rms = (squares / track.t_ns.len() as f64).sqrt();
    println!("{} events, {} frames: log light to {rms:.4} rms", events.len(), frames.len());
    Ok(())
}
