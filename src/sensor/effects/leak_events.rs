//! Leak events: ON events appear in a scene that does not change, one after another at a nearly regular pace.
//!
//! The switch that resets the reference leaks, so the reference sinks and the voltage seems to rise. A static
//! pixel then fires ON events every `1 / rate` seconds; in a moving scene ON events come early and OFF events
//! late, in proportion to the time since the last event. Typical: 0.05 to 0.2 Hz.
//!
//! Source: Nozaki and Delbruck, "Temperature and parasitic photocurrent effects in dynamic vision sensors"
//! (2017). Limits: constant; the part that grows with light is `parasitic_leak`.

use super::sought::{RATE, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, Leak, ParameterDecl, Parameters, Site, Stage, Thresholds, Unit};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "leak_events",
        stage: Stage::Reset,
        about: "The stored reference leaks: ON events appear without a change of light",
        equation: "dV_ref/dt = -rate * threshold_on",
        parameters: &[ParameterDecl {
            name: "rate",
            unit: Unit::Rate,
            null: Some(0.0),
            allowed: (0.0, 1e4),
            plausible: (0.01, 10.0),
            about: "ON events per second in a static scene; the voltage seems to rise by rate x \
                    threshold_on per second",
        }],
        covariate: "time_since_last_event",
        signature: "static pixels fire ON at a regular pace; elsewhere ON is early and OFF late, linear in \
                    the time since the last event",
        confused_with: &["parasitic_leak", "threshold_asymmetry", "slow brightening of the scene"],
        source: "Nozaki and Delbruck 2017",
        apart: &[
            (
                "parasitic_leak",
                "a static scene in dim and in bright light: only a parasitic leak fires more in bright light",
            ),
            ("threshold_asymmetry", "a static scene: a leak fires without motion, an asymmetry does not"),
            (
                "background_activity",
                "a static scene: a leak fires ON only and regularly, noise both signs and irregularly",
            ),
        ],
        search: Search::For(&[Sought {
            typical: Size::Fixed(12.0),
            material: RATE,
            is_counted: true,
            ..Sought::positive("rate")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(LeakEvents { rate_hz: parameters.need("rate")? }))
}

/// A constant leak of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeakEvents {
    /// ON events per second in a static scene, at least zero.
    pub rate_hz: f64,
}

impl Effect for LeakEvents {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn leak(&self, _site: &Site, stated: &Thresholds) -> Leak {
        Leak { constant_per_s: self.rate_hz * stated.on, per_photocurrent_per_s: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::*;
    use super::*;
    use crate::forward::Pixel;

    fn leak() -> Vec<Box<dyn Effect>> {
        vec![Box::new(LeakEvents { rate_hz: 5.0 })]
    }

    #[test]
    fn a_static_pixel_fires_on_at_the_rate_and_regularly() {
        for i in [0.01, 100.0] {
            let events = recorded(ideal_pixel(), leak(), &Samples::constant(i), 1_010 * MS);
            assert_eq!((count(&events, 1), count(&events, -1)), (5, 0));
            for (k, event) in events.iter().enumerate() {
                assert!((event.t_in_ns - 200 * MS * (k as i64 + 1)).abs() <= 1);
            }
        }
    }

    #[test]
    fn blind_time_lengthens_the_pace() {
        let pixel = Pixel { latency_ns: 3 * MS, refractory_ns: 7 * MS, ..ideal_pixel() };
        let events = recorded(pixel, leak(), &Samples::constant(1.0), 1_000 * MS);
        assert_eq!(events.len(), 4); // 200, 410, 620, 830 ms
        assert!(intervals_s(&events).iter().all(|interval| (interval - 0.210).abs() < 2e-9));
    }

    #[test]
    fn on_comes_early_and_off_late_by_the_leak() {
        let step = |slope: f64| {
            let ramp = Samples::of_log(100 * MS, |t| -1.0 + slope * t);
            intervals_s(&recorded(ideal_pixel(), leak(), &ramp, 100 * MS))[0]
        };
        assert!((step(20.0) - 0.2 / 21.0).abs() < 1e-6);
        assert!((step(-20.0) - 0.2 / 19.0).abs() < 1e-6);
    }
}
