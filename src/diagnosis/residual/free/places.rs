//! What there is without an effect, and where an effect gains beyond it.

use super::super::Residuals;
use super::super::formulas::formulas;
use super::super::laid::{Laid, lay};
use super::super::located::{Ground as Gains, Located, LocatedSetting, Values};
use super::super::open::{Open, after, dependences, restored};
use super::super::ranking::rhythm_of;
use super::super::setting::EvidenceSetting;
use super::super::setting::{DEPENDENCES, LEAST_NOISE};
use super::super::table::block_of;
use super::fit::{BY_CHANCE, Fit, Ground};
use crate::candidates::CANDIDATES;
use crate::covariates::Surroundings;
use crate::dependence::Dependence;
use crate::formula::Formula;
use photocurrent_scene::free::{FreeScene, Predicted};
use photocurrent_scene::statistics::median;

/// A fit that an effect is held against, and the events that gains are measured on.
pub(super) struct Level {
    /// Log density of each pixel's events, nats.
    pub left_out: Vec<f64>,
    predicted: Vec<Predicted>,
    pub(super) measured: Observed,
}

/// Events of some pixels, with the values of everything that they may depend on.
pub(super) struct Observed {
    pub events: Residuals,
    /// Of each event, positive, natural-log units.
    threshold: Vec<f64>,
    pub block: Vec<u32>,
    pub laid: Vec<Laid>,
    /// Of each place its first event, and how many.
    pub of_places: Vec<(usize, usize)>,
}

/// Curves that no effect of the catalogue has.
#[derive(Clone, Debug)]
pub(super) struct Dependences {
    pub list: Vec<Open>,
    /// What events miss their thresholds by with the best one, a median share of them; infinite where there
    /// is none.
    pub left: f64,
}

impl Dependences {
    pub(super) fn none() -> Dependences {
        Dependences { list: Vec::new(), left: f64::INFINITY }
    }

    /// What the best one gains, nats an event.
    pub(super) fn gain(&self) -> f64 {
        self.list.first().map_or(0.0, Open::beyond)
    }
}

impl Observed {
    /// Events of places that `is` holds for, on a fit as it stands.
    ///
    /// # Errors
    /// When its sensor cannot be applied.
    pub(super) fn of<L: FreeScene>(
        fit: &mut Fit<'_, L>,
        predicted: &[Predicted],
        is: impl Fn(usize) -> bool,
    ) -> Result<Observed, String> {
        let ground = fit.ground;
        let (case, side) = (ground.case, EvidenceSetting::default().block);
        let prediction = fit.predict()?;
        let (mut events, mut block, mut threshold) = (Residuals::default(), Vec::new(), Vec::new());
        let mut of_places = Vec::with_capacity(ground.events.len());
        for (place, numbers) in ground.events.iter().enumerate() {
            let numbers = if is(place) { &numbers[..] } else { &[] };
            of_places.push((block.len(), numbers.len()));
            let pixel = fit.light.pixels()[place];
            let of_pixel = case.events.of(pixel as usize);
            for (k, found) in numbers.iter().zip(&predicted[place].events) {
                let (event, before) = (&of_pixel[*k], &of_pixel[k - 1]);
                events.pixel.push(pixel);
                events.t_ns.push(event.t_in_ns);
                events.polarity.push(event.polarity);
                events.previous.push(before.polarity);
                events.since_ns.push(event.t_in_ns - before.t_in_ns);
                events.log_light.push(prediction.light.at(pixel as usize, event.t_in_ns).unwrap_or(f64::NAN));
                events.excess.push(found.excess);
                threshold.push(found.threshold);
                events.slope_per_s.push(found.polarity * found.rise_per_s);
                // The voltage moved in the direction of the event before when that fired.
                let before_square =
                    found.slope_per_s * found.slope_per_s - found.rise_per_s * found.rise_per_s;
                events.slope_before_per_s.push(f64::from(before.polarity) * before_square.max(0.0).sqrt());
                block.push(block_of(case, side, pixel as usize));
            }
        }
        let light = Box::new(|pixel: usize, t_ns: i64| prediction.light.at(pixel, t_ns));
        let front_end = ground.nominal.pixel.front_end;
        let constants = (front_end.tau_0_s, front_end.alpha_s);
        let mut surroundings = Surroundings::of(case, light, case.extent.pixels(), constants);
        let laid = lay(&events, &mut surroundings, rhythm_of(case, &events, &events.excess));
        Ok(Observed { events, threshold, block, laid, of_places })
    }
}

impl Level {
    /// Of a fit as it stands.
    ///
    /// # Errors
    /// When its sensor cannot be applied.
    pub(super) fn of<L: FreeScene>(fit: &mut Fit<'_, L>) -> Result<Level, String> {
        let ground = fit.ground;
        fit.predict()?;
        let predicted = fit.predicted()?;
        let left_out = fit.light.left_out(&predicted);
        let measured = Observed::of(fit, &predicted, |place| ground.is_measured(place))?;
        Ok(Level { left_out, predicted, measured })
    }

    /// What events that are held out have.
    pub(super) fn dependences<L: FreeScene>(&self, ground: &Ground<'_, L>) -> Dependences {
        let threshold = ground.scales.threshold;
        let Observed { events, block, laid, .. } = &self.measured;
        let mut list = dependences(events, &events.excess, block, laid, threshold, LEAST_NOISE * threshold);
        list.iter_mut().for_each(|one| one.control_gain = BY_CHANCE * one.gain_error);
        self.finished(ground, list)
    }

    /// Curves that gain anything, best first, the best one with its formulas and its place, and what events
    /// miss their thresholds by with it, a median share of them.
    pub(super) fn finished<L: FreeScene>(&self, ground: &Ground<'_, L>, mut list: Vec<Open>) -> Dependences {
        let Observed { events, block, laid, threshold: thresholds, .. } = &self.measured;
        let Residuals { pixel, t_ns, polarity, log_light, excess, .. } = events;
        let threshold = ground.scales.threshold;
        let least = LEAST_NOISE * threshold;
        list.sort_by(|a, b| b.beyond().total_cmp(&a.beyond()));
        list.retain(|one| one.beyond() > 0.0);
        list.truncate(DEPENDENCES);
        let mut left = f64::INFINITY;
        if let Some(best) = list.first_mut() {
            best.dependence.formulas =
                formulas(events, excess, block, laid, &best.dependence, threshold, least);
            let curve = &best.dependence;
            let after = after(events, excess, block, laid, curve, threshold, least);
            let setting = LocatedSetting::default();
            let on = Values { pixel, t_ns, polarity, log_light, block };
            let places = Gains::new(ground.case, on, laid, &setting);
            best.located = after.as_ref().map(|after| {
                places.locate(&after.gains, curve.covariate.name()).of_dependence(curve, &setting)
            });
            if let Some(after) = after {
                let of = after.residual.iter().zip(thresholds);
                let mut shares: Vec<f64> =
                    of.map(|(residual, threshold)| residual.abs() / threshold).collect();
                left = ground.beyond_stated(median(&mut shares));
            }
        }
        Dependences { list, left }
    }

    /// Formulas of a curve that the fit's sensor has.
    pub(super) fn formulas<L: FreeScene>(&self, ground: &Ground<'_, L>, curve: &Dependence) -> Vec<Formula> {
        let threshold = ground.scales.threshold;
        let least = LEAST_NOISE * threshold;
        let Observed { events, block, laid, .. } = &self.measured;
        let plain = restored(events, &events.excess, laid, curve, threshold);
        let of = |plain: Vec<f64>| formulas(events, &plain, block, laid, curve, threshold, least);
        plain.map(of).unwrap_or_default()
    }

    /// Where an effect gains on a light that was estimated with it, with what is predicted there.
    pub(super) fn locate<L: FreeScene>(
        &self,
        ground: &Ground<'_, L>,
        candidate: usize,
        (light, predicted): (&L, &[Predicted]),
    ) -> Located {
        let of_pixels = light.event_gains(predicted, &self.predicted).into_iter().enumerate();
        let gains: Vec<f64> =
            of_pixels.filter(|(place, _)| ground.is_measured(*place)).flat_map(|(_, of)| of).collect();
        let Observed { events, block, laid, .. } = &self.measured;
        let Residuals { pixel, t_ns, polarity, log_light, .. } = events;
        let on = Values { pixel, t_ns, polarity, log_light, block };
        let own = CANDIDATES[candidate].decl().covariate;
        Gains::new(ground.case, on, laid, &LocatedSetting::default()).locate(&gains, own)
    }
}
