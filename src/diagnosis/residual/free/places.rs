//! Fits without an effect, and the location of an effect's gain relative to them.

use super::super::EventResiduals;
use super::super::formulas::formulas;
use super::super::laid::{CovariateColumns, covariate_columns};
use super::super::located::{GainingValues, LocatedEffect, LocatedSetting, LocationData as Gains};
use super::super::open::{CovariateCurve, apply_curve, dependences, restored};
use super::super::ranking::rhythm_of;
use super::super::setting::EvidenceSetting;
use super::super::setting::{DEPENDENCES, LEAST_NOISE};
use super::super::table::block_of;
use super::fit::{BY_CHANCE, FitData, SceneFit};
use crate::candidates::CANDIDATES;
use crate::covariates::CovariateSource;
use crate::dependence::Dependence;
use crate::formula::Formula;
use photocurrent_scene::free::{FreeScene, PixelPrediction};
use photocurrent_scene::statistics::median;

/// A reference fit for an effect, and the events on which gains are measured.
pub(super) struct BaseFit {
    /// Log density of each pixel's events, nats.
    pub left_out: Vec<f64>,
    predicted: Vec<PixelPrediction>,
    pub(super) measured: ObservedEvents,
}

/// Events of some pixels, with the values of everything that they may depend on.
pub(super) struct ObservedEvents {
    pub events: EventResiduals,
    /// Of each event, positive, natural-log units.
    threshold: Vec<f64>,
    pub block: Vec<u32>,
    pub laid: Vec<CovariateColumns>,
    /// Of each place its first event, and how many.
    pub of_places: Vec<(usize, usize)>,
}

/// Curves that no effect of the catalogue has.
#[derive(Clone, Debug)]
pub(super) struct UnexplainedCurves {
    pub list: Vec<CovariateCurve>,
    /// Median misfit of events with the best curve, as a share of their thresholds; infinite without one.
    pub left: f64,
}

impl UnexplainedCurves {
    pub(super) fn empty() -> UnexplainedCurves {
        UnexplainedCurves { list: Vec::new(), left: f64::INFINITY }
    }

    /// Gain of the best one, nats per event.
    pub(super) fn gain(&self) -> f64 {
        self.list.first().map_or(0.0, CovariateCurve::gain_beyond_control)
    }
}

impl ObservedEvents {
    /// Events of the places for which `is` returns true, on the current fit.
    ///
    /// # Errors
    /// When its sensor cannot be applied.
    pub(super) fn from_events<L: FreeScene>(
        fit: &mut SceneFit<'_, L>,
        predicted: &[PixelPrediction],
        is: impl Fn(usize) -> bool,
    ) -> Result<ObservedEvents, String> {
        let ground = fit.ground;
        let (case, side) = (ground.case, EvidenceSetting::default().block);
        let prediction = fit.predict()?;
        let (mut events, mut block, mut threshold) = (EventResiduals::default(), Vec::new(), Vec::new());
        let mut of_places = Vec::with_capacity(ground.events.len());
        for (place, numbers) in ground.events.iter().enumerate() {
            let numbers = if is(place) { &numbers[..] } else { &[] };
            of_places.push((block.len(), numbers.len()));
            let pixel = fit.light.pixels()[place];
            let of_pixel = case.events.of_pixel(pixel as usize);
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
        let mut surroundings = CovariateSource::from_light(case, light, case.extent.pixels(), constants);
        let laid = covariate_columns(&events, &mut surroundings, rhythm_of(case, &events, &events.excess));
        Ok(ObservedEvents { events, threshold, block, laid, of_places })
    }
}

impl BaseFit {
    /// From the current fit.
    ///
    /// # Errors
    /// When its sensor cannot be applied.
    pub(super) fn from_fit<L: FreeScene>(fit: &mut SceneFit<'_, L>) -> Result<BaseFit, String> {
        let ground = fit.ground;
        fit.predict()?;
        let predicted = fit.predicted()?;
        let left_out = fit.light.left_out(&predicted);
        let measured = ObservedEvents::from_events(fit, &predicted, |place| ground.is_measured(place))?;
        Ok(BaseFit { left_out, predicted, measured })
    }

    /// Uncatalogued curves of held-out events.
    pub(super) fn dependences<L: FreeScene>(&self, ground: &FitData<'_, L>) -> UnexplainedCurves {
        let threshold = ground.scales.threshold;
        let ObservedEvents { events, block, laid, .. } = &self.measured;
        let mut list = dependences(events, &events.excess, block, laid, threshold, LEAST_NOISE * threshold);
        list.iter_mut().for_each(|one| one.control_gain = BY_CHANCE * one.gain_error);
        self.finished(ground, list)
    }

    /// Curves with a positive gain, best first; the best with its formulas and location, and the median
    /// misfit with it, as a share of the thresholds.
    pub(super) fn finished<L: FreeScene>(
        &self,
        ground: &FitData<'_, L>,
        mut list: Vec<CovariateCurve>,
    ) -> UnexplainedCurves {
        let ObservedEvents { events, block, laid, threshold: thresholds, .. } = &self.measured;
        let EventResiduals { pixel, t_ns, polarity, log_light, excess, .. } = events;
        let threshold = ground.scales.threshold;
        let least = LEAST_NOISE * threshold;
        list.sort_by(|a, b| b.gain_beyond_control().total_cmp(&a.gain_beyond_control()));
        list.retain(|one| one.gain_beyond_control() > 0.0);
        list.truncate(DEPENDENCES);
        let mut left = f64::INFINITY;
        if let Some(best) = list.first_mut() {
            best.dependence.formulas =
                formulas(events, excess, block, laid, &best.dependence, threshold, least);
            let curve = &best.dependence;
            let after = apply_curve(events, excess, block, laid, curve, threshold, least);
            let setting = LocatedSetting::default();
            let on = GainingValues { pixel, t_ns, polarity, log_light, block };
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
        UnexplainedCurves { list, left }
    }

    /// Formulas of a curve that the fit's sensor has.
    pub(super) fn formulas<L: FreeScene>(&self, ground: &FitData<'_, L>, curve: &Dependence) -> Vec<Formula> {
        let threshold = ground.scales.threshold;
        let least = LEAST_NOISE * threshold;
        let ObservedEvents { events, block, laid, .. } = &self.measured;
        let plain = restored(events, &events.excess, laid, curve, threshold);
        let of = |plain: Vec<f64>| formulas(events, &plain, block, laid, curve, threshold, least);
        plain.map(of).unwrap_or_default()
    }

    /// Location of an effect's gain on a light estimated with it, and that light's prediction.
    pub(super) fn locate<L: FreeScene>(
        &self,
        ground: &FitData<'_, L>,
        candidate: usize,
        (light, predicted): (&L, &[PixelPrediction]),
    ) -> LocatedEffect {
        let of_pixels = light.event_gains(predicted, &self.predicted).into_iter().enumerate();
        let gains: Vec<f64> =
            of_pixels.filter(|(place, _)| ground.is_measured(*place)).flat_map(|(_, of)| of).collect();
        let ObservedEvents { events, block, laid, .. } = &self.measured;
        let EventResiduals { pixel, t_ns, polarity, log_light, .. } = events;
        let on = GainingValues { pixel, t_ns, polarity, log_light, block };
        let own = CANDIDATES[candidate].decl().covariate;
        Gains::new(ground.case, on, laid, &LocatedSetting::default()).locate(&gains, own)
    }
}
