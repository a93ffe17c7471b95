//! That every place where an effect may enter does what the trait promises, with effects made for the
//! purpose.

use super::super::neighbours::{halo, joined};
use super::super::*;
use super::plane::event_plane;
use crate::effects::simulated::{MS, SITE, Samples, ideal_pixel, recorded};
use crate::effects::{
    Domain, Effect, Impulse, ImpulseTarget, Kernel, Latency, Reading, RowSite, Site, Spontaneous, Tap,
    Thresholds,
};
use crate::exposure::DigitalNumber;
use crate::front_end::FrontEnd;
use photocurrent_core::Exposure;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;

macro_rules! made {
    ($name:ident { $($hook:item)* }) => {
        struct $name;
        impl Effect for $name {
            fn id(&self) -> &'static str {
                stringify!($name)
            }
            $($hook)*
        }
    };
}

made!(Loses {
    fn keeps(&self, _: &Site, _: &crate::effects::History, _: &mut Random, event: &PixelEvent) -> bool {
        event.t_in_ns > 25 * MS
    }
});

#[test]
fn a_lost_event_has_reset_its_pixel() {
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let times: Vec<i64> = recorded(ideal_pixel(), vec![Box::new(Loses)], &ramp, 55 * MS)
        .iter()
        .map(|event| (event.t_in_ns + MS / 2) / MS)
        .collect();
    assert_eq!(times, [30, 40, 50]);
}

made!(Hides {
    fn latency(&self, _: &Site, _: &mut Random, _: i64) -> Latency {
        Latency { shown_ns: MS, hidden_ns: 2 * MS }
    }
});

#[test]
fn hidden_latency_delays_the_reset_and_no_stamp() {
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let events = recorded(ideal_pixel(), vec![Box::new(Hides)], &ramp, 30 * MS);
    assert_eq!(events.len(), 2);
    assert!(events.iter().all(|event| event.t_off_ns - event.t_in_ns == MS));
    assert!((events[1].t_in_ns - events[0].t_in_ns - 13 * MS).abs() < 1000);
}

made!(Pops {
    fn spontaneous(&self, _: &Site, _: &mut Random, _: i64, _: i64, out: &mut Vec<Spontaneous>) {
        out.extend([12, 5, 6].map(|ms| Spontaneous { t_ns: ms * MS, polarity: -1 }));
    }
});

#[test]
fn a_spontaneous_event_resets_an_armed_pixel_and_leaves_a_blind_one_alone() {
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let pixel = Pixel { refractory_ns: 2 * MS, ..ideal_pixel() };
    let events = recorded(pixel, vec![Box::new(Pops)], &ramp, 30 * MS);
    // At 5 it fires and is blind until 7, so 6 is silent; 12 fires and is blind until 14; 10 ms after that
    // the ramp has climbed a threshold.
    let found: Vec<(i64, i8)> =
        events.iter().map(|event| ((event.t_in_ns + MS / 2) / MS, event.polarity)).collect();
    assert_eq!(found, [(5, -1), (12, -1), (24, 1)]);
}

struct Impulses(ImpulseTarget, f64);

impl Effect for Impulses {
    fn id(&self) -> &'static str {
        "impulses"
    }

    fn impulses(&self, _: &Site, _: i64, _: i64, out: &mut Vec<Impulse>) {
        out.push(Impulse { t_ns: 5 * MS, change: self.1, target: self.0 });
    }
}

#[test]
fn an_impulse_fires_at_its_instant_and_the_front_end_settles_back() {
    let slow = Pixel { front_end: FrontEnd { tau_0_s: 1e-3, alpha_s: 0.0 }, ..ideal_pixel() };
    let light = Samples::constant(1.0);
    let of = |target, change| recorded(slow, vec![Box::new(Impulses(target, change))], &light, 20 * MS);
    // Up by 0.25: ON at once; then back from 0.05 above that reference to 0.2 below it, which is where the
    // light is: asymptotically never.
    assert_eq!(
        of(ImpulseTarget::FrontEnd, 0.25)
            .iter()
            .map(|event| (event.t_in_ns, event.polarity))
            .collect::<Vec<_>>()[0],
        (5 * MS, 1)
    );
    let events = of(ImpulseTarget::FrontEnd, -0.45);
    // Down by 0.45: two OFF at once, reference -0.4; back up through -0.2 after ln(0.45 / 0.2) ms, and 0 is
    // reached asymptotically.
    assert_eq!(events.iter().map(|event| event.polarity).collect::<Vec<_>>()[..3], [-1, -1, 1]);
    let expected_ns = 5e6 + 1e6 * libm::log(0.45 / 0.2);
    assert!((events[2].t_in_ns as f64 - expected_ns).abs() < 2.0);
    // The comparator's input stays where it was pushed.
    assert_eq!(of(ImpulseTarget::Comparator, -0.45).len(), 2);
    assert_eq!(of(ImpulseTarget::Comparator, 0.15).len(), 0);
}

made!(Stamps {
    fn stamp(&self, _: &Site, random: &mut Random, event: &mut PixelEvent) {
        event.t_in_ns += (1e3 * random.normal()) as i64;
    }
});

made!(Draws {
    fn thresholds(
        &self,
        _: &Site,
        _: &crate::effects::History,
        random: &mut Random,
        _: i64,
        thresholds: &mut Thresholds,
    ) {
        thresholds.on += 0.01 * random.normal();
    }
});

#[test]
fn an_effect_draws_from_streams_of_its_own() {
    let ramp = Samples::of_log(100 * MS, |t| -1.0 + 20.0 * t);
    let alone = recorded(ideal_pixel(), vec![Box::new(Draws)], &ramp, 100 * MS);
    let effects: Vec<Box<dyn Effect>> = vec![Box::new(Stamps), Box::new(Draws)];
    let chain = Chain {
        pixel: ideal_pixel(),
        reset: Reset::Resample,
        effects: &effects,
        tolerance: crate::forward::TOLERANCE,
    };
    let both = simulate(&chain, &SITE, &ramp.light(), 0, 100 * MS, &mut Noiseless);
    assert_eq!(
        both.iter().map(|fired| fired.event).collect::<Vec<_>>(),
        alone,
        "stamping does not disturb thresholds"
    );
    assert!(both.iter().any(|fired| fired.recorded != Some(fired.event)));
    let other = Site { x: SITE.x + 1, ..SITE };
    assert_ne!(
        simulate(&chain, &other, &ramp.light(), 0, 100 * MS, &mut Noiseless),
        both,
        "another pixel, other numbers"
    );
}

made!(Leads {
    fn kernel(&self) -> Option<Kernel> {
        Some(Kernel { domain: Domain::Linear, taps: vec![Tap { dx: 1, dy: 0, weight: 1.0 }] })
    }
    fn exposure(&self, row: &RowSite, exposure: Exposure) -> Exposure {
        exposure.delayed(i64::from(row.y) * 10)
    }
    fn charge(&self, _: &Site, reading: &Reading, charge: f64) -> f64 {
        charge + 0.5 * reading.previous_charge
    }
    fn dn(&self, _: &Site, reading: &Reading, dn: f64) -> f64 {
        dn + reading.frame as f64
    }
});

made!(Inhibits {
    fn kernel(&self) -> Option<Kernel> {
        let tap = |dy, weight| Tap { dx: 0, dy, weight };
        Some(Kernel { domain: Domain::Log, taps: vec![tap(0, 1.0), tap(-1, -0.25), tap(1, -0.25)] })
    }
});

#[test]
fn kernels_follow_one_another_and_repeat_the_edge() {
    let effects: Vec<Box<dyn Effect>> = vec![Box::new(Leads), Box::new(Inhibits)];
    assert_eq!(halo(&effects), 2);
    assert_eq!(event_plane(&effects[..0], 3, 2, &[1.0; 6]), None);
    let seen = event_plane(&effects, 3, 2, &[1.0, 2.0, 4.0, 1.0, 8.0, 16.0]).unwrap();
    // Shifted: 2 4 4 / 8 16 16. The edge repeats, so i^0.75 over the other row's i^0.25.
    for (found, expected) in
        seen.iter().zip([(2.0, 8.0), (4.0, 16.0), (4.0, 16.0), (8.0, 2.0), (16.0, 4.0), (16.0, 4.0)])
    {
        let (own, other): (f64, f64) = expected;
        assert!((found - libm::pow(own, 0.75) / libm::pow(other, 0.25)).abs() < 1e-12);
    }
}

#[test]
fn frames_take_true_exposure_then_charge_then_number() {
    let light = LinearLight::new(&[0, 1_000_000], &[1.0, 1001.0]);
    let readout = FrameReadout {
        number: DigitalNumber { black_level: 10.0, gain: 1e6 },
        saturation: f64::INFINITY,
        row_time_ns: 0,
    };
    let stated = [Exposure::new(0, 1_000), Exposure::new(1_000, 2_000)];
    let plain = read_frames(&readout, &[], &SITE, &light, &stated);
    // The photocurrent is 1 + t / us: integrals over the first two microseconds are 1.5 and 2.5.
    assert!((plain[0] - 11.5).abs() < 1e-9 && (plain[1] - 12.5).abs() < 1e-9);
    let effects: Vec<Box<dyn Effect>> = vec![Box::new(Leads)];
    let changed = read_frames(&readout, &effects, &SITE, &light, &stated);
    // Row 5 is 50 ns late: 1.55 and 2.55 + 1.55 / 2, and the frame's number on top.
    assert!((changed[0] - 11.55).abs() < 1e-9 && (changed[1] - (10.0 + 2.55 + 0.775 + 1.0)).abs() < 1e-9);
}

#[test]
fn kernels_join_by_convolution() {
    let half: Vec<Box<dyn Effect>> = crate::effects::from_description(
        &serde_json::from_value(serde_json::json!({ "misalignment": { "shift_x": 0.5 } })).unwrap(),
    )
    .unwrap();
    let once = joined(&half).unwrap().unwrap();
    let twice: Vec<Box<dyn Effect>> = half
        .into_iter()
        .chain(
            crate::effects::from_description(
                &serde_json::from_value(serde_json::json!({ "misalignment": { "shift_x": 0.5 } })).unwrap(),
            )
            .unwrap(),
        )
        .collect();
    let weights = |kernel: &crate::effects::Kernel| {
        let mut weights: Vec<f64> =
            kernel.taps.iter().map(|tap| tap.weight).filter(|weight| *weight != 0.0).collect();
        weights.sort_by(f64::total_cmp);
        weights
    };
    // Half a pixel twice: 1/2, 1/2 becomes 1/4, 1/2, 1/4.
    assert_eq!(weights(&once), [0.5, 0.5]);
    assert_eq!(weights(&joined(&twice).unwrap().unwrap()), [0.25, 0.25, 0.5]);
}
