//! Fits a moving picture to recordings and says how well it meets their events. For people who work on the estimator.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::likelihood::conditional::{Conditional, Look, Track, conditional};
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::picture::{Picture, PictureSetting};
use photocurrent_diagnosis::scene::{SceneSetting, pixel_data};
use photocurrent_store::Recording;
use rayon::prelude::*;
use std::path::Path;

fn main() {
    for path in std::env::args().skip(1) {
        let recording = Recording::open(Path::new(&path)).unwrap();
        let sensor = Sensor::parse(&Source::new(path.clone(), Path::new("."), recording.sensor_text().unwrap())).unwrap();
        let row_time = recording.row_time_ns().unwrap_or(0);
        let case = Case::read(recording.events().as_ref(), recording.frames(row_time).as_ref(), &sensor).unwrap();
        let nominal = Nominal::new(&case).unwrap();
        let begun = std::time::Instant::now();
        let picture = match Picture::fit(&case, &nominal, &PictureSetting::default()) {
            Ok(picture) => picture,
            Err(why) => {
                println!("{path} {why}");
                continue;
            }
        };
        let fitted = begun.elapsed().as_secs_f64();
        let grid: Vec<i64> = (0..=(case.span.1 - case.span.0) / 100_000).map(|k| case.span.0 + k * 100_000).collect();
        let maps: Vec<_> = grid.iter().map(|t| picture.motion.at(*t)).collect();
        let theta = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
        let setting = SceneSetting::default();
        let mut excess: Vec<f64> = (0..case.extent.pixels())
            .into_par_iter()
            .flat_map_iter(|pixel| {
                let (x, y) = case.place(pixel);
                let mut out = Conditional::default();
                let mut found = Vec::new();
                if let Some(log) = picture.log_light(x as usize, y as usize, &maps) {
                    let track = Track::new(&grid, &log, 100_000);
                    let (events, frames) = pixel_data(&case, &nominal, &setting, pixel);
                    let look = Look { site: Nominal::site(&case, pixel, 0), track: &track, seen: None, events: &events, frames: &frames };
                    conditional(&nominal, &[], &look, &mut out);
                    found.extend((1..events.len()).filter(|&k| out.is_armed[k]).map(|k| out.excess[k] / theta));
                }
                found.into_iter()
            })
            .collect();
        let near = excess.iter().filter(|e| e.abs() < 0.2).count() as f64 / excess.len().max(1) as f64;
        excess.sort_by(f64::total_cmp);
        let middle = excess.get(excess.len() / 2).copied().unwrap_or(f64::NAN);
        let mut far: Vec<f64> = excess.iter().map(|e| (e - middle).abs()).collect();
        far.sort_by(f64::total_cmp);
        if std::env::var("POSES").is_ok() {
            for l in 0..case.frame_count() {
                let e = case.frames.as_ref().unwrap().times.exposure(l, case.extent.height / 2);
                println!("{l} {:.2?}", picture.motion.pose(e.start.0));
            }
            println!("{:.3?}", picture.shading);
        }
        let correlation = picture.report.correlation.iter().copied().fold(1.0, f64::min);
        println!(
            "{} events {} median {:.3} MAD {:.3} near {:.4} fit {:.1}s all {:.1}s grid {}x{} corr {:.3} misfit {:.2?}",
            Path::new(&path).file_stem().unwrap().to_string_lossy(),
            excess.len(),
            middle,
            far.get(far.len() / 2).copied().unwrap_or(f64::NAN),
            near,
            fitted,
            begun.elapsed().as_secs_f64(),
            picture.grid.width,
            picture.grid.height,
            correlation,
            picture.report.misfit
        );
    }
}
