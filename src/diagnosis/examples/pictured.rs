//! The moving picture on made-up recordings of known effects: from where on a gain is a finding, and how often the name is right.
//!
//! `cargo run --release -p photocurrent-diagnosis --example pictured -- SEED COUNT`: for each of COUNT scenes one line without an effect and one with an effect of random kind and size.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_diagnosis::candidates::{CANDIDATES, Scales, Signs, Trial};
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::pictured::{Decision, method};
use photocurrent_diagnosis::residual::moving::{MovingSetting, moving};
use photocurrent_diagnosis::scenes::MadeUp;
use photocurrent_diagnosis::verdict::is_material;

fn main() {
    let argument = |n: usize| std::env::args().nth(n).and_then(|text| text.parse::<u64>().ok());
    let (seed, count) = (argument(1).unwrap_or(1), argument(2).unwrap_or(10));
    for index in 0..count {
        let scene = MadeUp::new(seed, index, Extent { width: 96, height: 72 }, 0.15);
        let null = scene.recording().unwrap();
        let nominal = Nominal::new(&null).unwrap();
        let scales = Scales::of(&null, &nominal);
        say(index, "none", 0.0, &null, &nominal);
        let mut random = Random::new(seed, &[index, 7]);
        let chosen = &CANDIDATES[(random.uniform() * CANDIDATES.len() as f64) as usize % CANDIDATES.len()];
        let size = 0.15 * libm::pow(10.0, random.uniform());
        let strength = if chosen.signs == Signs::Both && random.uniform() < 0.5 { -size } else { size };
        let trial = Trial::with(&nominal, chosen, strength, &scales);
        if let Ok(case) = scene.recording_through(Some(&trial)) {
            say(index, &chosen.label(), strength, &case, &nominal);
        }
    }
}

fn say(index: u64, label: &str, strength: f64, case: &Case, nominal: &Nominal) {
    match moving(case, nominal, &MovingSetting::default()) {
        Ok(found) => {
            let said = method(&found, nominal, &Decision::default());
            let best = said.proposals.iter().find(|one| one.passed && is_material(case, nominal, &CANDIDATES[one.candidate], one.value));
            let most = found.ranked.iter().chain(&found.random).filter(|one| is_material(case, nominal, &CANDIDATES[one.candidate], one.value));
            let (gain, of) = most.map(|one| (one.beyond(), one.candidate)).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
            println!(
                "{index} {label} {strength:.2} events {} share {:.2} median {:.3} left {:.3} control {:.3} white {:.2} misfit {:.2} largest {gain:.4} of {} said {} at {:.2}",
                found.events,
                found.share,
                found.median,
                found.left[0],
                found.control_median,
                found.white,
                found.misfit,
                CANDIDATES[of].label(),
                best.map_or("none".to_owned(), |one| CANDIDATES[one.candidate].label()),
                best.map_or(0.0, |one| one.probability),
            );
        }
        Err(why) => println!("{index} {label} {strength:.2} abstains: {why}"),
    }
}
