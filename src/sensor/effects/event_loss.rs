//! Event loss: some events never reach the recording.
//!
//! A full buffer, a rate limiter or a dropped packet takes events away after their pixel has fired and reset.
//! The pixel's own chain goes on, so the next event that arrives seems to have needed two thresholds (or
//! three): a comb at whole multiples. Typical: none at a moderate rate, some to tens of per cent where
//! buffers overflow.
//!
//! Sources: manuals of event cameras (event rate control, overflow of FIFOs); Prophesee's knowledge base on
//! back-pressure. Limits: each event is lost independently with one chance; real buffers lose whole
//! microseconds or rows, above a rate.

use super::sought::{SHARE, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "event_loss",
        stage: Stage::Readout,
        about: "Some events are lost on their way out, after their pixel has reset",
        equation: "each event is lost with chance `fraction`",
        parameters: &[ParameterDecl {
            name: "fraction",
            unit: Unit::Number("fraction"),
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (0.005, 0.5),
            about: "share of the events that is lost",
        }],
        covariate: "burst_index",
        signature: "the change between two events is a whole multiple of the threshold: a comb at one, two, \
                    three thresholds",
        confused_with: &["refractory", "threshold_scale", "readout_queue"],
        source: "manuals of event cameras; Prophesee knowledge base",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.4),
            material: SHARE,
            ..Sought::random("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(EventLoss { fraction: parameters.need("fraction")? }))
}

/// Events that are lost one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EventLoss {
    /// Share of the events, 0 to 1.
    pub fraction: f64,
}

impl Effect for EventLoss {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn keeps(&self, _site: &Site, _history: &History, random: &mut Random, _event: &PixelEvent) -> bool {
        random.uniform() >= self.fraction
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance::default())
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, intervals_s, recorded};
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn kept(fraction: f64) -> Vec<bool> {
        let effect = described("event_loss", json!({ "fraction": fraction }));
        let mut random = Random::new(7, &[1]);
        (0..20_000)
            .map(|t| {
                effect.keeps(
                    &site(3, 4),
                    &History::default(),
                    &mut random,
                    &PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 },
                )
            })
            .collect()
    }

    #[test]
    fn the_stated_share_is_lost_whatever_happened_to_the_event_before() {
        let kept = kept(0.2);
        let lost = kept.iter().filter(|&&kept| !kept).count() as f64;
        let twice = kept.windows(2).filter(|pair| !pair[0] && !pair[1]).count() as f64;
        // Five sigma of the binomials 20,000 x 0.2 and (pairs overlap: somewhat wider) 20,000 x 0.04.
        assert!((lost - 4000.0).abs() < 283.0, "{lost}");
        assert!((twice - 800.0).abs() < 180.0, "{twice}");
    }

    #[test]
    fn nothing_and_everything_are_exact() {
        assert!(kept(0.0).into_iter().all(|kept| kept));
        assert!(!kept(1.0).into_iter().any(|kept| kept));
    }

    #[test]
    fn intervals_on_a_ramp_are_whole_multiples_of_the_pace() {
        let ramp = Samples::of_log(5_000 * MS, |t| 20.0 * (t - 2.5));
        let events = recorded(
            ideal_pixel(),
            vec![described("event_loss", json!({ "fraction": 0.3 }))],
            &ramp,
            5_000 * MS,
        );
        let steps: Vec<f64> = intervals_s(&events).iter().map(|interval| interval * 20.0 / 0.2).collect();
        assert!(steps.iter().all(|step| (step - step.round()).abs() < 1e-4));
        // 499 or 500 fired; the share of single steps is that of kept events. Five sigma.
        assert!((events.len() as f64 - 0.7 * 500.0).abs() < 53.0, "{}", events.len());
        let single = steps.iter().filter(|step| step.round() == 1.0).count() as f64 / steps.len() as f64;
        assert!((single - 0.7).abs() < 0.13, "{single}");
    }
}
