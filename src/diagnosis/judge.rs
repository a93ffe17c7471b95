//! What pairs of frames propose (`integrity::means`), judged by frames that were held out.
//!
//! A delay, thresholds and a dark current that make events and frames agree on average may still be the wrong
//! physics: events that a fast edge loses make thresholds look larger. With a right one the solver predicts
//! held-out frames better; so that decides, and only where no scene is evidence: on a scene there is more to
//! go by. Of 106 simulated recordings of other people's simulators four would be given a wrong name
//! (thresholds for a blur, twice, and for a reset with memory; a dark current for compressed frames), and
//! none of the 38 without a fault. That was measured with an assumed event noise of a tenth of the threshold
//! in place of the one that `solve/map` chooses, and could not be repeated: the recordings are not kept.

use crate::candidates::Scales;
use crate::fitted::amended;
use crate::heldout::predict;
use crate::integrity::again::add_intervals;
use crate::integrity::{Departure, Integrity, can_compare, joined, means};
use crate::sample::Sample;
use photocurrent_core::NodeError;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_solve::SolveOptions;

/// Adds to the findings what is proposed and stands: first an offset of the clock, then the best of what
/// contrast says; each must predict held-out frames better by `least_better_db`. Nothing that the description
/// states.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn judged(
    case: &Case,
    nominal: &Nominal,
    least_better_db: f64,
    options: &SolveOptions,
    integrity: &mut Integrity,
) -> Result<(), NodeError> {
    if !can_compare(case, integrity) {
        return Ok(());
    }
    let means::Proposed { late, contrast } = means::proposed(case, nominal, &integrity.masked);
    let is_new = |finding: &Departure| {
        !case.sensor.effects.contains_key(finding.id)
            && integrity.findings.iter().all(|found| found.id != finding.id)
    };
    let steps: [Vec<Vec<Departure>>; 2] = [late.into_iter().map(|finding| vec![finding]).collect(), contrast]
        .map(|alternatives| {
            let new =
                |findings: Vec<Departure>| findings.into_iter().filter(is_new).collect::<Vec<Departure>>();
            alternatives.into_iter().map(new).filter(|findings| !findings.is_empty()).collect()
        });
    if steps.iter().all(Vec::is_empty) {
        return Ok(());
    }
    let (scales, sample) = (Scales::of(case, nominal), Sample::of_proof(case));
    let psnr_db = |findings: &[Departure]| -> Result<Option<f64>, NodeError> {
        let with =
            Integrity { findings: [integrity.findings.as_slice(), findings].concat(), ..integrity.clone() };
        let amended = amended(case, nominal, &scales, &with);
        Ok(predict(&amended, &amended.sensor, &sample, options)?.map(|prediction| prediction.psnr_db()))
    };
    let mut accepted: Vec<Departure> = Vec::new();
    let Some(mut best) = psnr_db(&accepted)? else { return Ok(()) };
    for alternatives in steps {
        let (mut least, mut better) = (best + least_better_db, None);
        for findings in alternatives {
            let with = [accepted.as_slice(), &findings].concat();
            if let Some(db) = psnr_db(&with)?.filter(|db| *db > least) {
                least = db;
                better = Some((db, with));
            }
        }
        if let Some((db, with)) = better {
            (best, accepted) = (db, with);
        }
    }
    let masked = &integrity.masked;
    let is_dark = |findings: &[Departure]| findings.iter().any(|finding| finding.id == "dark_current");
    let with_dark = is_dark(&accepted);
    add_intervals(case, &mut accepted, &|case, out| {
        let means::Proposed { late, contrast } = means::proposed(case, nominal, &joined(masked, out));
        late.into_iter()
            .chain(contrast.into_iter().filter(|alternative| is_dark(alternative) == with_dark).flatten())
            .collect()
    });
    integrity.findings.extend(accepted);
    Ok(())
}
