//! The answer of direct tests and of a moving picture alone, without the proof and the page of a whole diagnosis: `name OUT RECORDING...` writes OUT/NAME/diagnosis.json with verdict and
//! effects, and prints what was measured. For people who work on the diagnosis.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use photocurrent_diagnosis::candidates::CANDIDATES;
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::diagnose::{amend, check};
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::pictured::{Decision, method};
use photocurrent_diagnosis::residual::moving::{MovingSetting, Ranked, moving};
use photocurrent_diagnosis::verdict::verdict;
use photocurrent_store::Recording;
use std::path::Path;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().unwrap();
    for path in arguments {
        let recording = Recording::open(Path::new(&path)).unwrap();
        let sensor = Sensor::parse(&Source::new(path.clone(), Path::new("."), recording.sensor_text().unwrap())).unwrap();
        let row_time = recording.row_time_ns().unwrap_or(0);
        let case = Case::read(recording.events().as_ref(), recording.frames(row_time).as_ref(), &sensor).unwrap();
        let nominal = Nominal::new(&case).unwrap();
        let begun = std::time::Instant::now();
        let name = Path::new(&path).file_stem().unwrap().to_string_lossy().into_owned();
        let integrity = check(&case).unwrap();
        let amended = amend(&case, &integrity).unwrap();
        let amended_nominal = Nominal::new(&amended).unwrap();
        let found = moving(&amended, &amended_nominal, &MovingSetting::default());
        let methods: Vec<_> = found
            .iter()
            .filter(|found| found.control_median <= Decision::default().most_control)
            .map(|found| method(found, &amended_nominal, &Decision::default()))
            .collect();
        let answer = verdict(&case, &nominal, &integrity, &methods);
        let value = |candidate: &usize, value: &f64| (CANDIDATES[*candidate].json_key().0, serde_json::json!({"estimate": value}));
        let effects: Vec<_> = answer
            .claims
            .iter()
            .map(|claim| {
                let parameters: serde_json::Map<_, _> = claim.values.iter().map(|(candidate, estimate, _)| value(candidate, estimate)).collect();
                serde_json::json!({"id": claim.id, "also_possible": claim.also_possible, "parameters": parameters, "evidence": {"found_by": claim.found_by}})
            })
            .collect();
        let folder = Path::new(&out).join(name.trim_start_matches("exam_"));
        std::fs::create_dir_all(&folder).unwrap();
        let report = serde_json::json!({"verdict": answer.verdict.name(), "effects": effects});
        std::fs::write(folder.join("diagnosis.json"), report.to_string()).unwrap();
        println!("{name} {report}");
        match found {
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
