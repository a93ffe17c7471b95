//! Hot pixels: a few pixels fire without end, whatever they see.
//!
//! A defect gives them a reset switch that leaks far too much or a threshold near zero. Each hot pixel fires
//! events of one sign only, at random instants and at a rate of hundreds a second; which pixels are hot does
//! not change. Typical: less than one pixel in a thousand, 10 Hz to 1 kHz.
//!
//! Sources: Lichtsteiner, Posch, Delbruck 2008; every driver has a filter for them. Limits: one rate for all
//! hot pixels; ON and OFF ones are equally frequent; dead pixels and those that fire in bursts are not here.

use super::background_activity::{either, poisson};
use super::sought::{SHARE, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Spontaneous, Stage, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "hot_pixels",
        stage: Stage::Comparator,
        about: "A few defective pixels fire at a high rate, whatever they see",
        equation: "a share `fraction` of the pixels fires events of one sign, a Poisson process of this rate",
        parameters: &[
            ParameterDecl {
                name: "fraction",
                unit: Unit::Number("fraction"),
                null: Some(0.0),
                allowed: (0.0, 1.0),
                plausible: (1e-5, 0.02),
                about: "share of the pixels that are hot",
            },
            ParameterDecl {
                name: "rate",
                unit: Unit::Rate,
                null: Some(0.0),
                allowed: (0.0, 1e6),
                plausible: (10.0, 2000.0),
                about: "events per second of a hot pixel, as long as it is armed",
            },
        ],
        covariate: "pixel",
        signature: "single pixels fire at a high rate all the time, events of one sign, their neighbours do \
                    not",
        confused_with: &[
            "hot_rows",
            "background_activity",
            "threshold_mismatch",
            "a blinking light in the scene",
        ],
        source: "Lichtsteiner, Posch, Delbruck 2008",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(0.005),
            material: SHARE,
            others: &[("rate", Size::Fixed(200.0))],
            is_made: false,
            ..Sought::random("fraction")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(HotPixels { fraction: parameters.need("fraction")?, rate_hz: parameters.need("rate")? }))
}

/// A share of pixels that fire by themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct HotPixels {
    /// Share of the pixels, 0 to 1.
    pub fraction: f64,
    /// Events per second of a hot pixel, at least zero.
    pub rate_hz: f64,
}

impl HotPixels {
    /// The sign of a hot pixel's events; none for a healthy pixel. The same at every call.
    pub(super) fn polarity(&self, site: &Site) -> Option<i8> {
        let mut own = site.random(KIND.decl.id);
        (own.uniform() < self.fraction).then(|| either(&mut own))
    }
}

impl Effect for HotPixels {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn spontaneous(
        &self,
        site: &Site,
        random: &mut Random,
        start_ns: i64,
        end_ns: i64,
        out: &mut Vec<Spontaneous>,
    ) {
        if let Some(polarity) = self.polarity(site) {
            poisson(self.rate_hz, random, start_ns, end_ns, |_| polarity, out);
        }
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance::default())
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, ideal_pixel, recorded_at};
    use super::super::testing::{described, moments, sites};
    use super::*;
    use serde_json::json;

    #[test]
    fn the_stated_share_fires_at_the_stated_rate_with_one_sign_each() {
        let effect = described("hot_pixels", json!({ "fraction": 0.05, "rate": "200 Hz" }));
        let (mut counts, mut on) = (Vec::new(), 0.0);
        for site in sites() {
            let mut out = Vec::new();
            effect.spontaneous(&site, &mut site.random("test"), 0, 1_000_000_000, &mut out);
            if let Some(first) = out.first() {
                assert!(out.iter().all(|event| event.polarity == first.polarity));
                counts.push(out.len() as f64);
                on += f64::from(u8::from(first.polarity > 0));
            }
        }
        // Binomial: 1000 of 20,000 with sigma sqrt(950); Poisson: 200 with sigma sqrt(200) in each; half of
        // them ON. Five sigma.
        assert!((counts.len() as f64 - 1000.0).abs() < 155.0, "{}", counts.len());
        assert!((moments(&counts).0 - 200.0).abs() < 2.5, "{}", moments(&counts).0);
        assert!((on / counts.len() as f64 - 0.5).abs() < 0.085, "{on}");
    }

    #[test]
    fn the_same_pixels_are_hot_all_the_time_and_at_any_rate() {
        let hot = |rate_hz| {
            sites()
                .filter(move |site| HotPixels { fraction: 0.01, rate_hz }.polarity(site).is_some())
                .collect::<Vec<_>>()
        };
        assert_eq!(hot(10.0), hot(1000.0));
        assert!(!hot(10.0).is_empty());
    }

    #[test]
    fn blind_time_caps_the_rate_of_a_hot_pixel() {
        let hot =
            sites().find(|site| HotPixels { fraction: 0.01, rate_hz: 1.0 }.polarity(site).is_some()).unwrap();
        let pixel = crate::forward::Pixel { refractory_ns: 5 * MS, ..ideal_pixel() };
        let effects = || vec![described("hot_pixels", json!({ "fraction": 0.01, "rate": "200 Hz" }))];
        // Each event costs 5 ms of waiting and 5 ms of blindness: 100 Hz for 10 s. Five sigma of the waiting
        // times' sum is below 80 events.
        let events = recorded_at(&hot, pixel, effects(), &Samples::constant(1.0), 10_000 * MS);
        assert!((events.len() as f64 - 1000.0).abs() < 80.0, "{}", events.len());
        let healthy =
            sites().find(|site| HotPixels { fraction: 0.01, rate_hz: 1.0 }.polarity(site).is_none()).unwrap();
        assert!(recorded_at(&healthy, pixel, effects(), &Samples::constant(1.0), 10_000 * MS).is_empty());
    }
}
