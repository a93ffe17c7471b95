//! Ranks effects by event residuals on a moving picture. For people who work on the diagnosis.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use photocurrent_diagnosis::candidates::CANDIDATES;
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::residual::moving::{MovingSetting, Ranked, moving};
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
        match moving(&case, &nominal, &MovingSetting::default()) {
            Ok(found) => {
                println!(
                    "{name} events {} share {:.2} median {:.3} left {:.3?} control {:.3} white {:.2} misfit {:.2} {:.1}s",
                    found.events,
                    found.share,
                    found.median,
                    found.left,
                    found.control_median,
                    found.white,
                    found.misfit,
                    begun.elapsed().as_secs_f64()
                );
                let show = |mark: &str, one: &Ranked| {
                    println!(
                        "  {mark} {:32} beyond {:8.4} gain {:8.4} +- {:.4} control {:7.4} strength {:8.4} +- {:.4} control {:8.4} value {:.6}{}",
                        CANDIDATES[one.candidate].label(),
                        one.beyond(),
                        one.gain,
                        one.gain_error,
                        one.control_gain,
                        one.strength,
                        one.error,
                        one.control_strength,
                        one.value,
                        if one.is_exact { " exact" } else { "" }
                    );
                };
                found.ranked.iter().take(5).for_each(|one| show("1", one));
                found.random.iter().take(3).for_each(|one| show("r", one));
                found.random_second.iter().take(3).for_each(|one| show("R", one));
                found.second.iter().take(3).for_each(|one| show("2", one));
            }
            Err(why) => println!("{name} {why} {:.1}s", begun.elapsed().as_secs_f64()),
        }
    }
}
