//! Simulates a small recording of a sensor whose thresholds are larger than described, and diagnoses it with
//! the description.
#![allow(clippy::print_stdout)]

use photocurrent_core::{Extent, FrameTimes};
use photocurrent_diagnosis::{DiagnosisOptions, diagnose};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvents};
use photocurrent_sensor::forward::{FrameReadout, LinearLight, Noiseless, read_frames, simulate_events};
use photocurrent_sensor::{effects::Site, model::Model};
use photocurrent_solve::{Exposure, Sensor, Source};

/// Photocurrent of a pixel: a texture of waves that drifts to the right and down.
fn light(x: u32, y: u32, t_ns: i64) -> f64 {
    let t_s = t_ns as f64 * 1e-9;
    let (x, y) = (f64::from(x) - 90.0 * t_s, f64::from(y) - 40.0 * t_s);
    let wave = |fx: f64, fy: f64, phase: f64| libm::sin(fx * x + fy * y + phase);
    let log = wave(0.5, 0.2, 0.0) + wave(-0.3, 0.6, 1.0) + wave(0.6, -0.4, 2.0) + wave(0.2, 0.7, 3.0);
    100.0 * libm::exp(0.35 * log)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("data/sensors/hybrid.toml")?;
    let described =
        Sensor::parse(&Source::new("hybrid.toml", "", text)).map_err(|problems| format!("{problems:?}"))?;
    let mut sensor = described.clone();
    (sensor.comparator.threshold_on, sensor.comparator.threshold_off) = (Some(0.26), Some(0.273));
    let model = Model::of(&sensor);

    let (extent, span) = (Extent { width: 40, height: 32 }, (0, 120_000_000));
    let exposures: Vec<Exposure> =
        (0..12).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect();
    let times = FrameTimes::new(exposures, model.row_time_ns)?;
    let readout = FrameReadout {
        number: model.number,
        saturation: model.saturation_dn,
        row_time_ns: model.row_time_ns,
    };
    let t_ns: Vec<i64> = (span.0..=span.1).step_by(250_000).collect();
    let (mut events, mut dn) = (Vec::new(), vec![0.0; times.len() * extent.pixels()]);
    for pixel in 0..extent.pixels() {
        let (x, y) = (pixel as u32 % extent.width, pixel as u32 / extent.width);
        let photocurrent: Vec<f64> = t_ns.iter().map(|t_ns| light(x, y, *t_ns)).collect();
        let light = LinearLight::new(&t_ns, &photocurrent);
        events.push(simulate_events(&model.pixel, &light, span.0, span.1, &mut Noiseless));
        let site = Site { x, y, width: extent.width, height: extent.height, seed: 0 };
        let of_row: Vec<Exposure> = (0..times.len()).map(|l| times.exposure(l, y)).collect();
        let values = read_frames(&readout, &[], &site, &light, &of_row);
        values.iter().enumerate().for_each(|(l, value)| dn[l * extent.pixels() + pixel] = *value as f32);
    }

    let (events, frames) = (PixelEvents::new(events), Some(CaseFrames::new(times, dn)));
    let case = Case { extent, span, events, has_t_in: true, t_resolution_ns: 1, frames, sensor: described };
    let found = diagnose(&case, &DiagnosisOptions::default())?;
    println!("{}: {}", found.report.verdict.name(), found.report.summary);
    for effect in &found.report.effects {
        let sizes: Vec<String> =
            effect.parameters.iter().map(|(name, size)| format!("{name} {:.3}", size.estimate)).collect();
        println!("{}: {}", effect.id, sizes.join(", "));
    }
    Ok(())
}
