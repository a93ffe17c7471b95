//! Background activity: single events of both signs at random instants, also where nothing happens.
//!
//! The photocurrent is made of electrons, so the voltage trembles; now and then it trembles across a
//! threshold. In a static scene each pixel then fires ON and OFF events alike, at the instants of a Poisson
//! process; each one resets its pixel, so that the true events around it come at other times. Typical: 0.01
//! to 0.5 Hz a pixel by day, 5 to 10 Hz in the dark.
//!
//! Sources: Graca and Delbruck, "Unraveling the paradox of intensity-dependent DVS pixel noise" (2021); Hu,
//! Liu, Delbruck 2021 (v2e). Limits: one rate in all light, although shot noise grows in the dark; no ON-OFF
//! pairs. One-sided activity is `leak_events`.

use super::sought::{RATE, Search, Size, Sought};
use super::{
    Chance, Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, Site, Spontaneous, Stage, Unit,
};
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "background_activity",
        stage: Stage::Comparator,
        about: "Noise fires single ON and OFF events at random instants, without a change of light",
        equation: "events of a Poisson process of this rate in each pixel, ON or OFF with equal chance",
        parameters: &[ParameterDecl {
            name: "rate",
            unit: Unit::Rate,
            null: Some(0.0),
            allowed: (0.0, 1e4),
            plausible: (0.01, 30.0),
            about: "noise events per second and pixel, both signs together",
        }],
        covariate: "time_since_last_event",
        signature: "static pixels fire both signs at exponentially distributed intervals; some intervals \
                    are far shorter than the light allows",
        confused_with: &["leak_events", "hot_pixels", "hot_rows", "threshold_noise", "flicker of the scene"],
        source: "Graca and Delbruck 2021; Hu, Liu, Delbruck 2021",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Fixed(6.0),
            material: RATE,
            ..Sought::random("rate")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(BackgroundActivity { rate_hz: parameters.need("rate")? }))
}

/// Noise events of both signs in every pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BackgroundActivity {
    /// Events per second and pixel, at least zero.
    pub rate_hz: f64,
}

impl Effect for BackgroundActivity {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn spontaneous(
        &self,
        _site: &Site,
        random: &mut Random,
        start_ns: i64,
        end_ns: i64,
        out: &mut Vec<Spontaneous>,
    ) {
        poisson(self.rate_hz, random, start_ns, end_ns, either, out);
    }

    fn chance(&self) -> Option<Chance> {
        Some(Chance::default())
    }
}

/// ON or OFF with equal chance.
pub(super) fn either(random: &mut Random) -> i8 {
    if random.bits() >> 63 == 0 { 1 } else { -1 }
}

/// Events of a Poisson process from `start_ns` on and before `end_ns`. The process has no memory, so a span
/// may be cut anywhere.
pub(super) fn poisson(
    rate_hz: f64,
    random: &mut Random,
    start_ns: i64,
    end_ns: i64,
    polarity: impl Fn(&mut Random) -> i8,
    out: &mut Vec<Spontaneous>,
) {
    if rate_hz <= 0.0 || end_ns <= start_ns {
        return;
    }
    let span_ns = (end_ns - start_ns) as f64;
    let mut waited_ns = random.exponential() * 1e9 / rate_hz;
    while waited_ns < span_ns {
        // Rounding to f64 could carry a long span's last instant to its end.
        let t_ns = (start_ns + waited_ns as i64).min(end_ns - 1);
        out.push(Spontaneous { t_ns, polarity: polarity(random) });
        waited_ns += random.exponential() * 1e9 / rate_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{MS, Samples, count, ideal_pixel, recorded};
    use super::super::testing::{described, moments, sites};
    use super::*;
    use serde_json::json;

    #[test]
    fn counts_are_those_of_a_poisson_process_and_both_signs_are_equally_frequent() {
        let effect = described("background_activity", json!({ "rate": "2 Hz" }));
        let (mut counts, mut halves, mut signs) = (Vec::new(), [0.0; 2], 0.0);
        for site in sites() {
            let mut random = site.random("test");
            let mut out = Vec::new();
            // Two calls that go on from each other, as the simulator makes them.
            effect.spontaneous(&site, &mut random, 0, 700_000_000, &mut out);
            effect.spontaneous(&site, &mut random, 700_000_000, 2_000_000_000, &mut out);
            assert!(out.iter().all(|event| (0..2_000_000_000).contains(&event.t_ns)));
            counts.push(out.len() as f64);
            for event in &out {
                halves[usize::from(event.t_ns >= 1_000_000_000)] += 1.0;
                signs += f64::from(event.polarity);
            }
        }
        // 2 Hz for 2 s: mean 4, sigma 2; five standard errors with 20,000 pixels. Variance of a Poisson
        // variance: (2 + 1/4) x 4^2 / n.
        let (mean, sigma) = moments(&counts);
        assert!((mean - 4.0).abs() < 0.071, "{mean}");
        assert!((sigma * sigma - 4.0).abs() < 5.0 * (36.0 / 20_000f64).sqrt(), "{sigma}");
        let total = 80_000f64;
        assert!(f64::abs(halves[0] - halves[1]) < 5.0 * total.sqrt(), "constant in time: {halves:?}");
        assert!(f64::abs(signs) < 5.0 * total.sqrt(), "both signs: {signs}");
    }

    #[test]
    fn no_rate_is_no_event() {
        let mut out = Vec::new();
        described("background_activity", json!({ "rate": "0 Hz" })).spontaneous(
            &sites().next().unwrap(),
            &mut Random::new(1, &[]),
            0,
            i64::MAX,
            &mut out,
        );
        assert!(out.is_empty());
    }

    #[test]
    fn a_static_pixel_fires_both_signs_at_exponential_intervals() {
        let effects = vec![described("background_activity", json!({ "rate": "100 Hz" }))];
        let events = recorded(ideal_pixel(), effects, &Samples::constant(1.0), 10_000 * MS);
        let (on, off) = (count(&events, 1) as f64, count(&events, -1) as f64);
        // Poisson with mean 500 each; five sigma.
        assert!((on - 500.0).abs() < 112.0 && (off - 500.0).abs() < 112.0, "{on} {off}");
        let (mean, sigma) = moments(&super::super::simulated::intervals_s(&events));
        // An exponential has sigma = mean; the ratio scatters by 1 / sqrt(n).
        assert!((sigma / mean - 1.0).abs() < 0.16, "{}", sigma / mean);
    }
}
