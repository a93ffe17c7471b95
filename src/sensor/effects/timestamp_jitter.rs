//! Timestamp jitter: the stamp misses the instant of the event by a random amount.
//!
//! Between the comparator and the clock lie an arbiter and its wires, and how long they take differs from
//! event to event. Both stamps of an event move together, so none leaves before it fired. Unlike threshold
//! noise the scatter does not depend on how fast the light changes. Typical: 0.1 to 10 us; more through a
//! loaded arbiter.
//!
//! Source: the latency measurements in Lichtsteiner, Posch, Delbruck 2008. Limits: normal, cut off at four
//! sigma, so two events of a pixel more than eight sigma apart keep their order; nearer ones can change
//! places.

use super::sought::{Search, Size, Sought, TIME};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, PixelEvent, Site, Stage, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "timestamp_jitter",
        stage: Stage::Time,
        about: "Stamps scatter around the instants of their events",
        equation: "t_recorded = t_true + sigma * z, z ~ N(0, 1) for each event, |z| <= 4",
        parameters: &[ParameterDecl {
            name: "sigma",
            unit: Unit::Time,
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (1e-7, 1e-3),
            about: "standard deviation of a stamp",
        }],
        covariate: "slope",
        signature: "the voltage at the stamp scatters in proportion to the slope, event by event; the \
                    scatter in time is the same at any slope",
        confused_with: &["threshold_noise", "timestamp_quantization", "readout_queue"],
        source: "Lichtsteiner, Posch, Delbruck 2008",
        apart: &[(
            "threshold_noise",
            "the same scene at three times the speed: jitter matters three times \
                                      as much, threshold noise as before",
        )],
        search: Search::For(&[Sought {
            typical: Size::Fixed(60e-6),
            material: TIME,
            ..Sought::random("sigma")
        }]),
    },
    build,
};

/// No stamp is off by more than this many sigma.
const MOST_SIGMAS: f64 = 4.0;

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(TimestampJitter { sigma_ns: 1e9 * parameters.need("sigma")? }))
}

/// Stamps that scatter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TimestampJitter {
    /// Standard deviation, nanoseconds, at least zero.
    pub sigma_ns: f64,
}

impl Effect for TimestampJitter {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn stamp(&self, _site: &Site, random: &mut Random, event: &mut PixelEvent) {
        let mut z = random.normal();
        while z.abs() > MOST_SIGMAS {
            z = random.normal();
        }
        let shift_ns = (self.sigma_ns * z).round() as i64;
        event.t_in_ns += shift_ns;
        event.t_off_ns += shift_ns;
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance { of_stamps_s: self.sigma_ns * 1e-9, ..Chance::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{correlation, described, moments, site};
    use super::*;
    use serde_json::json;

    #[test]
    fn stamps_scatter_with_the_stated_sigma_and_keep_their_order() {
        let effect = described("timestamp_jitter", json!({ "sigma": "5 us" }));
        let mut random = Random::new(7, &[1]);
        // 41 us apart: just more than eight sigma.
        let mut stamped = |k: i64| {
            let mut event = PixelEvent { t_in_ns: 41_000 * k, t_off_ns: 41_000 * k + 1_000, polarity: 1 };
            effect.stamp(&site(3, 4), &mut random, &mut event);
            event
        };
        let events: Vec<PixelEvent> = (0..20_000).map(&mut stamped).collect();
        let errors: Vec<f64> =
            events.iter().zip(0..).map(|(event, k)| (event.t_in_ns - 41_000 * k) as f64).collect();
        let (mean, sigma) = moments(&errors);
        // Five standard errors; the cut lowers sigma by 0.05 %.
        assert!(mean.abs() < 177.0, "{mean}");
        assert!((sigma - 5_000.0).abs() < 125.0, "{sigma}");
        assert!(correlation(&errors[1..], &errors[..errors.len() - 1]).abs() < 5.0 / 20_000f64.sqrt());
        assert!(
            events.iter().all(|event| event.t_off_ns - event.t_in_ns == 1_000),
            "an event does not leave before it fired"
        );
        assert!(
            events.is_sorted_by(|a, b| a.t_in_ns < b.t_in_ns),
            "events more than eight sigma apart keep their order"
        );
    }
}
