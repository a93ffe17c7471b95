//! Ranks effects by event residuals on a moving picture. For people who work on the diagnosis.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use photocurrent_diagnosis::candidates::{CANDIDATES, Scales, Signs, Trial};
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::picture::{Picture, PictureSetting};
use photocurrent_diagnosis::residual::fit::{Fitted, heldout};
use photocurrent_diagnosis::residual::gate::Gate;
use photocurrent_diagnosis::residual::light::Light;
use photocurrent_diagnosis::residual::{Residuals, View};
use photocurrent_store::Recording;
use std::path::Path;

fn main() {
    for path in std::env::args().skip(1) {
        let recording = Recording::open(Path::new(&path)).unwrap();
        let sensor = Sensor::parse(&Source::new(path.clone(), Path::new("."), recording.sensor_text().unwrap())).unwrap();
        let row_time = recording.row_time_ns().unwrap_or(0);
        let case = Case::read(recording.events().as_ref(), recording.frames(row_time).as_ref(), &sensor).unwrap();
        let nominal = Nominal::new(&case).unwrap();
        let begun = std::time::Instant::now();
        let name = Path::new(&path).file_stem().unwrap().to_string_lossy().into_owned();
        let picture = match Picture::fit(&case, &nominal, &PictureSetting::default()) {
            Ok(picture) => picture,
            Err(why) => {
                println!("{name} {why}");
                continue;
            }
        };
        let fitted = begun.elapsed().as_secs_f64();
        let light = Light::of_picture(&case, &picture, 100_000);
        let gate = Gate::new(&case, &picture.residual, 1.0, 4.5);
        let width = case.extent.width as usize;
        let block_of = |pixel: usize| {
            let (bx, by) = (pixel % width / 8, pixel / width / 8);
            (2 * (by * width.div_ceil(8) + bx) + (bx + by) % 2) as u32
        };
        // Every third pixel, shifted from row to row.
        let pixels: Vec<u32> = (0..case.extent.pixels()).filter(|p| (p % width + p / width) % 3 == 0).map(|p| p as u32).collect();
        let view = View { case: &case, light: &light, pixels };
        let scales = Scales::of(&case, &nominal);
        let chosen: Vec<_> = CANDIDATES.iter().filter(|c| !c.is_random).collect();
        let probe = |c: &photocurrent_diagnosis::candidates::Candidate| if c.signs == Signs::Switch { 1.0 } else { c.probe_strength() * 0.2 };
        let mut trials = vec![Trial::stated(&nominal)];
        trials.extend(chosen.iter().map(|c| Trial::with(&nominal, c, probe(c), &scales)));
        let all = case.events.all().len();
        let (events, of_trials): (Residuals, Vec<Vec<f32>>) = view.residuals(&trials, |pixel, t| gate.keeps(pixel, t)).unwrap();
        let theta = scales.threshold;
        let seen = begun.elapsed().as_secs_f64();
        let block: Vec<u32> = events.pixel.iter().map(|p| block_of(*p as usize)).collect();
        let mut sorted: Vec<f64> = events.excess.iter().map(|e| e.abs() / theta).collect();
        sorted.sort_by(f64::total_cmp);
        let near = sorted.iter().filter(|e| **e < 0.2).count() as f64 / sorted.len().max(1) as f64;
        println!(
            "{name} {:?} gated {:.2} MAD {:.3} near {:.4} misfit {:.2} fit {fitted:.1}s res {seen:.1}s",
            events.excess.len(),
            3.0 * events.excess.len() as f64 / all as f64,
            sorted.get(sorted.len() / 2).copied().unwrap_or(9.0),
            near,
            picture.report.misfit.last().unwrap()
        );
        if events.excess.len() < 500 {
            continue;
        }
        let mut found: Vec<(String, Fitted, f64)> = chosen
            .iter()
            .zip(&of_trials[1..])
            .map(|(c, values)| {
                let h = probe(c);
                let column: Vec<f32> = values.iter().zip(&of_trials[0]).map(|(a, b)| (a - b) / h as f32).collect();
                let fitted = heldout(&events.excess, &events.slope_per_s, &[&column], &block, 1e-4);
                let is_physics = c.signs == Signs::Both || fitted.size > 0.0;
                let fitted = if is_physics { fitted } else { Fitted { gain: 0.0, ..fitted } };
                (c.label(), fitted, c.value(fitted.size, &scales, &nominal))
            })
            .collect();
        found.sort_by(|a, b| b.1.gain.total_cmp(&a.1.gain));
        for (label, f, value) in found.iter().take(5) {
            println!("    {label:32} gain {:8.4} +- {:.4}  size {:8.4} +- {:.4}  value {value:.5}", f.gain, f.gain_error, f.size, f.error);
        }
        println!("    all {:.1}s", begun.elapsed().as_secs_f64());
    }
}
