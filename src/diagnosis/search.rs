//! One effect, and a second beside it.
//!
//! The effect that explains best is put on the sensor, and every other is tried beside it ([`crate::refit`]). With a second on the sensor the first is looked for once
//! more, among those that were near it: what two effects make together may look like a third.

use crate::candidates::{CANDIDATES, Scales, Trial};
use crate::case::Case;
use crate::components::Component;
use crate::deviation::unstated_frame_noise;
use crate::faithful::{Faithful, faithful};
use crate::law::Law;
use crate::linear::{Linear, Templates};
use crate::nominal::Nominal;
use crate::open::laws;
use crate::refit::{Refit, RefitSetting, Refitted};
use crate::sample::Sample;
use crate::scene::SceneSetting;
use serde::{Deserialize, Serialize};

/// So many that are seen to first order are followed to the end.
const SEEN: usize = 3;
/// When they are so many standard errors from nothing.
const LEAST_SIGNIFICANCE: f64 = 3.0;
/// So many of the first are tried again beside the second.
const AGAIN: usize = 4;

/// What one effect explains, and what a second beside it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Search {
    /// One effect.
    pub first: Refitted,
    /// One more beside the best of `first`; none when that does not explain enough.
    pub second: Option<Refitted>,
    /// The first once more, beside the best of `second`, where that is more than nothing and another effect.
    pub again: Option<Refitted>,
    /// What each effect explains to first order, most first.
    pub linear: Vec<Linear>,
    /// The same beside the best of `first`; nothing where that does not explain enough.
    pub second_linear: Vec<Linear>,
    /// Variances of what is drawn at random.
    pub components: Vec<Component>,
    /// Curves over covariates, of what effects that were found leave, best first.
    pub laws: Vec<Law>,
    /// Share of the cost of the stated sensor that knots twice as near take away: error of our own.
    pub numerical: f64,
    /// Noise of frame values that is not stated, as a share of the signal.
    pub frame_noise: f64,
    /// How well light that was estimated with the stated sensor fires the recorded events again: 1 is perfect.
    pub agreement: f64,
    /// Pixels that were looked at, and their events.
    pub pixels: usize,
    /// See there.
    pub events: usize,
}

/// What is looked at, and what counts.
#[derive(Clone, Copy, Debug)]
pub struct SearchSetting {
    /// Zones of the array, each with one block of pixels.
    pub zones: (u32, u32),
    /// Side of a block, pixels.
    pub side: u32,
    /// Blocks have a mean number of events a pixel between these.
    pub events: (f64, f64),
    /// How light is estimated.
    pub scene: SceneSetting,
    /// How candidates are tried.
    pub refit: RefitSetting,
    /// Share of the cost that an effect must take away on pixels that it was not fitted to, for a second to be looked for beside it.
    pub least_share: f64,
}

impl Default for SearchSetting {
    fn default() -> SearchSetting {
        SearchSetting { zones: (4, 4), side: 5, events: (3.0, 250.0), scene: SceneSetting::close(), refit: RefitSetting::default(), least_share: 0.15 }
    }
}

/// Looks for one effect, and for a second beside the best.
///
/// # Errors
/// When effects that the description states cannot be combined, or no block of pixels has enough events.
pub fn search(case: &Case, nominal: &Nominal, scales: &Scales, setting: &SearchSetting) -> Result<Search, String> {
    let sample = Sample::blocks(case, setting.zones, setting.side, 0, setting.events);
    if sample.is_empty() {
        let (SearchSetting { side, .. }, (least, most)) = (setting, setting.events);
        return Err(format!(
            "no block of {side} x {side} pixels has between {least} and {most} events a pixel, so nothing can be fitted; record more change, or for longer"
        ));
    }
    let frame_noise = unstated_frame_noise(case, nominal)?;
    let usual = setting.scene.frame_share;
    let scene = SceneSetting { frame_share: libm::sqrt(usual * usual + frame_noise * frame_noise), ..setting.scene };
    let Faithful { priors, agreement, .. } = faithful(case, nominal, &sample, &scene)?;
    let base = Trial::stated(nominal);
    let templates = Templates::new(case, nominal, scales, frame_noise)?;
    let linear = templates.beside(&[]);
    let seen: Vec<usize> = linear.iter().filter(|one| one.significance > LEAST_SIGNIFICANCE).take(SEEN).map(|one| one.candidate).collect();
    let refit = Refit { case, base: &base, scales, sample: &sample, scene: &scene, priors: &priors, frame_noise, turns: setting.refit.turns.0 };
    let first = refit.run(&setting.refit, &[], &seen);
    let best = first.leading().first().map(|best| (best.candidate, best.strength, best.heldout));
    let few = RefitSetting { followed: 6, finished: 3, ..setting.refit };
    let beside = |candidate: usize, strength: f64, only: &[usize]| {
        let mut base = base.clone();
        CANDIDATES[candidate].put_on(&mut base, strength, scales);
        Refit { base: &base, ..refit }.run(&few, only, &[])
    };
    let second = best.filter(|best| best.2 > setting.least_share).map(|(candidate, strength, _)| beside(candidate, strength, &[]));
    // With a second effect on the sensor, the first is looked for once more among those that were near it.
    let beside_second = second.as_ref().and_then(|second| second.leading().first().map(|one| (one.candidate, one.strength, one.heldout)));
    // Two numbers of one effect are one effect, and the first of them stays.
    let is_another = |candidate: usize| best.is_none_or(|best| CANDIDATES[best.0].id != CANDIDATES[candidate].id);
    let again = beside_second.filter(|second| second.2 > setting.least_share && is_another(second.0)).map(|(candidate, strength, _)| {
        let leading = first.leading();
        let near: Vec<usize> = leading.iter().take(AGAIN).map(|one| one.candidate).filter(|one| CANDIDATES[*one].id != CANDIDATES[candidate].id).collect();
        beside(candidate, strength, &near)
    });
    let found = [best, beside_second].into_iter().flatten().filter(|one| one.2 > setting.least_share);
    let known: Vec<(usize, f64)> = found.map(|one| (one.0, one.1)).collect();
    let numerical = refit.numerical(&setting.refit, first.stated);
    let laws = laws(case, nominal, scales, &known, frame_noise)?;
    let events = sample.pixels.iter().map(|pixel| case.events.of(*pixel as usize).len()).sum();
    let second_linear = best.filter(|best| best.2 > setting.least_share).map_or_else(Vec::new, |best| templates.beside(&[best.0]));
    Ok(Search {
        first,
        second,
        again,
        linear,
        second_linear,
        components: templates.components,
        laws,
        numerical,
        frame_noise,
        agreement,
        pixels: sample.len(),
        events,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refit::Explained;
    use crate::testing;
    use photocurrent_core::Extent;
    use serde_json::json;

    /// What is found in a small recording with effects, all of its pixels looked at.
    fn found(effects: serde_json::Value) -> Search {
        let described = effects.as_object().unwrap().iter().map(|(id, of)| (id.clone(), of.as_object().unwrap().clone())).collect();
        let case = testing::case_with(&described);
        assert_eq!(case.extent, Extent { width: 12, height: 10 });
        let nominal = case.nominal().unwrap();
        let few = RefitSetting { followed: 4, finished: 2, ..RefitSetting::default() };
        let setting = SearchSetting { zones: (3, 2), side: 4, refit: few, ..SearchSetting::default() };
        search(&case, &nominal, &Scales::of(&case, &nominal), &setting).unwrap()
    }

    fn first(found: &Search) -> &Explained {
        found.first.leading()[0]
    }

    #[test]
    fn an_offset_of_the_clock_is_found_with_its_size() {
        let found = found(json!({"clock_offset": {"offset": "-400 us"}}));
        let first = first(&found);
        assert_eq!(CANDIDATES[first.candidate].id, "clock_offset");
        assert!((first.value / -400e-6 - 1.0).abs() < 0.1 && first.heldout > 0.4, "{first:?}");
        assert!(first.nats_per_event.1 > first.nats_per_event.0);
    }

    #[test]
    fn nothing_is_found_where_nothing_is_missing() {
        let found = found(json!({}));
        assert!(found.first.explained.iter().all(|one| one.heldout < 0.14) && found.second.is_none(), "{:?}", first(&found));
    }
}
