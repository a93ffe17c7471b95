//! Confirms the proposals of frame pairs (`integrity::means`) by held-out frames.
//!
//! A delay, thresholds or a dark current may make events and frames agree on average and still be the wrong
//! physics: events lost at fast edges make thresholds look larger. With the right effect the solver predicts
//! held-out frames better, so that decides. It is used only where no scene gives evidence. Of 106 recordings
//! from other simulators four would be given a wrong name (thresholds for a blur, twice, and for a reset with
//! memory; a dark current for compressed frames), and none of the 38 without a fault. That was measured with
//! an assumed event noise of a tenth of the threshold in place of the one that `solve/map` chooses. It could
//! not be repeated: the recordings are not kept.

use crate::candidates::EffectScales;
use crate::fitted::apply_direct_findings;
use crate::heldout::predict;
use crate::integrity::again::add_intervals;
use crate::integrity::{Departure, Integrity, can_compare, means, merge_pixels};
use crate::sample::PixelSample;
use photocurrent_core::NodeError;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_solve::SolveOptions;

/// Adds confirmed proposals to the findings: first a clock offset, then the best contrast proposal. Each must
/// improve held-out frames by `least_better_db`. Proposals that the description states are skipped.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn add_confirmed_proposals(
    case: &Case,
    nominal: &Nominal,
    least_better_db: f64,
    options: &SolveOptions,
    integrity: &mut Integrity,
) -> Result<(), NodeError> {
    if !can_compare(case, integrity) {
        return Ok(());
    }
    let means::PairProposals { late, contrast } = means::proposed(case, nominal, &integrity.masked);
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
    let (scales, sample) = (EffectScales::from_case(case, nominal), PixelSample::for_held_out_frames(case));
    let psnr_db = |findings: &[Departure]| -> Result<Option<f64>, NodeError> {
        let with =
            Integrity { findings: [integrity.findings.as_slice(), findings].concat(), ..integrity.clone() };
        let amended = apply_direct_findings(case, nominal, &scales, &with);
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
        let means::PairProposals { late, contrast } =
            means::proposed(case, nominal, &merge_pixels(masked, out));
        late.into_iter()
            .chain(contrast.into_iter().filter(|alternative| is_dark(alternative) == with_dark).flatten())
            .collect()
    });
    integrity.findings.extend(accepted);
    Ok(())
}
