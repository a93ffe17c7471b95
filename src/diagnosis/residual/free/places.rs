//! What there is without an effect, and where an effect gains beyond it.

use super::super::Residuals;
use super::super::laid::{Laid, lay};
use super::super::located::{Ground as Gains, Located, LocatedSetting, Values};
use super::super::setting::EvidenceSetting;
use super::super::table::block_of;
use super::fit::{Fit, Ground};
use crate::candidates::CANDIDATES;
use crate::covariates::Surroundings;
use photocurrent_scene::free::{FreeScene, Predicted};

/// A fit that an effect is held against, and the events that gains are measured on.
pub(super) struct Level {
    /// Log density of each pixel's events, nats.
    pub left_out: Vec<f64>,
    predicted: Vec<Predicted>,
    events: Residuals,
    block: Vec<u32>,
    laid: Vec<Laid>,
}

impl Level {
    /// Of a fit as it stands.
    ///
    /// # Errors
    /// When its sensor cannot be applied.
    pub(super) fn of<L: FreeScene>(fit: &mut Fit<'_, L>) -> Result<Level, String> {
        let ground = fit.ground;
        let (case, side) = (ground.case, EvidenceSetting::default().block);
        let prediction = fit.predict()?;
        let predicted = fit.predicted()?;
        let left_out = fit.light.left_out(&predicted);
        let (mut events, mut block) = (Residuals::default(), Vec::new());
        for (place, numbers) in
            ground.events.iter().enumerate().filter(|(place, _)| ground.is_measured(*place))
        {
            let pixel = fit.light.pixels()[place];
            let of_pixel = case.events.of(pixel as usize);
            for k in numbers {
                let (event, before) = (&of_pixel[*k], &of_pixel[k - 1]);
                events.pixel.push(pixel);
                events.t_ns.push(event.t_in_ns);
                events.polarity.push(event.polarity);
                events.previous.push(before.polarity);
                events.since_ns.push(event.t_in_ns - before.t_in_ns);
                events.log_light.push(prediction.light.at(pixel as usize, event.t_in_ns).unwrap_or(f64::NAN));
                block.push(block_of(case, side, pixel as usize));
            }
        }
        let light = Box::new(|pixel: usize, t_ns: i64| prediction.light.at(pixel, t_ns));
        let front_end = ground.nominal.pixel.front_end;
        let constants = (front_end.tau_0_s, front_end.alpha_s);
        let surroundings = Surroundings::of(case, light, case.extent.pixels(), constants);
        let laid = lay(&events, &surroundings, None);
        Ok(Level { left_out, predicted, events, block, laid })
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
        let Residuals { pixel, t_ns, polarity, log_light, .. } = &self.events;
        let on = Values { pixel, t_ns, polarity, log_light, block: &self.block };
        let own = CANDIDATES[candidate].decl().covariate;
        Gains::new(ground.case, on, &self.laid, &LocatedSetting::default()).locate(&gains, own)
    }
}
