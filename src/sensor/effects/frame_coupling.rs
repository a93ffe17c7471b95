//! Frame coupling: each readout of the frame shakes the event circuit and makes events of its own.
//!
//! Frames and events share the die, its supply and often the photodiode; when a row of the frame is reset or
//! read, the front-end voltage jumps by a small step and settles back with the front end's time constant. A
//! step above the threshold fires in every pixel of the row, a smaller one only where the light has already
//! brought the pixel close; the way back fires the other sign. Typical: 0.01 to 0.3 ln.
//!
//! Parameters: `step` (positive = towards ON), `period` between frames, `phase` (the instant of any one
//! readout of row 0) and `row_time` (0 = all rows at once). The frames' times are not known here; take
//! `phase` and `period` from the frames' exposure ends. Confused with flicker whose frequency is the frame
//! rate; that is seen by frames too.
//!
//! Source: substrate and supply coupling between the frame and event circuits of DAVIS pixels; Brandli et al.
//! (2014). Limits: strictly periodic, instantaneous, equal for all pixels of a row.

use super::sought::{Measure, SPREAD, Search, Size, Sought};
use super::{
    Effect, EffectDecl, EffectKind, Impulse, ImpulseTarget, ParameterDecl, Parameters, Site, Stage, Unit,
};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "frame_coupling",
        stage: Stage::Readout,
        about: "Reading a frame shakes the event circuit: events come in step with the frames",
        equation: "V_FE += step at t = phase + y * row_time + k * period",
        parameters: &[
            ParameterDecl {
                name: "step",
                unit: Unit::Number("ln"),
                null: Some(0.0),
                allowed: (-10.0, 10.0),
                plausible: (-0.5, 0.5),
                about: "jump of the front-end voltage at a readout; positive = towards ON",
            },
            ParameterDecl {
                name: "period",
                unit: Unit::Time,
                null: None,
                allowed: (1e-6, 1e4),
                plausible: (1e-4, 1.0),
                about: "time between readouts",
            },
            ParameterDecl {
                name: "phase",
                unit: Unit::Time,
                null: None,
                allowed: (-1e6, 1e6),
                plausible: (0.0, 1.0),
                about: "instant of one readout of row 0, any one; absent = 0",
            },
            ParameterDecl {
                name: "row_time",
                unit: Unit::Time,
                null: Some(0.0),
                allowed: (-1.0, 1.0),
                plausible: (0.0, 1e-4),
                about: "delay of the readout from one row to the next; absent = 0, all rows at once",
            },
        ],
        covariate: "frame_phase",
        signature: "too many events right after each frame readout, of one sign, then of the other; nothing \
                    in the frames",
        confused_with: &["flicker at the frame rate", "background_activity", "row_skew"],
        source: "Brandli et al. 2014 (DAVIS)",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Of(0.4, Measure::Threshold),
            material: SPREAD,
            others: &[
                ("period", Size::Of(1.0, Measure::FramePeriod)),
                ("phase", Size::Of(1.0, Measure::FramePhase)),
            ],
            is_made: false,
            ..Sought::both("step")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (phase_ns, row_time_ns) =
        (parameters.get_ns("phase").unwrap_or(0), parameters.get_ns("row_time").unwrap_or(0));
    Ok(Box::new(FrameCoupling {
        step: parameters.need("step")?,
        period_ns: parameters.need_ns("period")?,
        phase_ns,
        row_time_ns,
    }))
}

/// A periodic disturbance of the front end, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameCoupling {
    /// Jump of the voltage, natural-log units, positive towards ON.
    pub step: f64,
    /// Time between readouts, nanoseconds, positive.
    pub period_ns: i64,
    /// True instant of one readout of row 0, nanoseconds.
    pub phase_ns: i64,
    /// Delay from one row to the next, nanoseconds.
    pub row_time_ns: i64,
}

impl Effect for FrameCoupling {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    /// One impulse per readout of the row from `start_ns`, included, to `end_ns`, excluded.
    fn impulses(&self, site: &Site, start_ns: i64, end_ns: i64, out: &mut Vec<Impulse>) {
        if self.step == 0.0 {
            return;
        }
        let readout_ns = self.phase_ns + i64::from(site.y) * self.row_time_ns;
        let mut t_ns = start_ns + (readout_ns - start_ns).rem_euclid(self.period_ns);
        while t_ns < end_ns {
            out.push(Impulse { t_ns, change: self.step, target: ImpulseTarget::FrontEnd });
            t_ns += self.period_ns;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::simulated::{MS, SITE, Samples, ideal_pixel, recorded};
    use crate::forward::Pixel;
    use crate::front_end::FrontEnd;
    use serde_json::json;

    const COUPLING: FrameCoupling =
        FrameCoupling { step: -0.1, period_ns: 1_000, phase_ns: 300, row_time_ns: 10 };

    fn times(y: u32, start_ns: i64, end_ns: i64) -> Vec<i64> {
        let mut impulses = Vec::new();
        COUPLING.impulses(&Site { x: 0, y, width: 4, height: 100, seed: 1 }, start_ns, end_ns, &mut impulses);
        assert!(
            impulses
                .iter()
                .all(|impulse| impulse.change == -0.1 && impulse.target == ImpulseTarget::FrontEnd)
        );
        impulses.iter().map(|impulse| impulse.t_ns).collect()
    }

    #[test]
    fn every_frame_gives_an_impulse_at_its_phase_before_and_after_zero() {
        assert_eq!(times(0, -1_000, 2_000), [-700, 300, 1_300]);
    }

    #[test]
    fn each_row_gets_its_impulse_when_it_is_read() {
        assert_eq!(times(3, 0, 2_000), [330, 1_330]);
        assert_eq!(times(90, 0, 2_000), [200, 1_200]); // 300 + 90 x 10 is past one period
    }

    #[test]
    fn abutting_spans_lose_and_double_no_impulse() {
        let parts: Vec<i64> = (0..40).flat_map(|part| times(0, 50 * part, 50 * part + 50)).collect();
        assert_eq!(parts, times(0, 0, 2_000));
        assert_eq!(times(0, 300, 300), [0; 0]);
    }

    #[test]
    fn a_static_pixel_fires_on_at_each_readout_and_off_on_the_way_back() {
        let pixel = Pixel {
            front_end: FrontEnd { tau_0_s: 1e-3, alpha_s: 0.0 },
            threshold_off: 0.15,
            ..ideal_pixel()
        };
        let coupling = FrameCoupling { step: 0.3, period_ns: 20 * MS, phase_ns: 5 * MS, row_time_ns: 10_000 };
        let events = recorded(pixel, vec![Box::new(coupling)], &Samples::constant(2.0), 60 * MS);
        let of = |polarity: i8| -> Vec<i64> {
            events.iter().filter(|event| event.polarity == polarity).map(|event| event.t_in_ns).collect()
        };
        let first_ns = 5 * MS + 10_000 * i64::from(SITE.y);
        assert_eq!(of(1), [first_ns, first_ns + 20 * MS, first_ns + 40 * MS]);
        // The reference is then 0.2: the voltage falls from 0.3 to 0.05 with 1 ms.
        let back_ns = (1e6 * libm::log(0.3 / 0.05)) as i64;
        assert!((of(-1)[0] - first_ns - back_ns).abs() < 1_000, "{:?}", of(-1));
    }

    #[test]
    fn phase_and_row_time_may_be_left_out() {
        let effect = KIND.read(json!({ "step": 0.1, "period": "1 ms" }).as_object().unwrap()).unwrap();
        let mut impulses = Vec::new();
        effect.impulses(&Site { x: 0, y: 7, width: 9, height: 9, seed: 1 }, 0, 1_500_000, &mut impulses);
        assert_eq!(impulses.iter().map(|impulse| impulse.t_ns).collect::<Vec<_>>(), [0, 1_000_000]);
    }
}
