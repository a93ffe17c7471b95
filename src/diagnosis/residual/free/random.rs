//! Random effects, from the misfits of held-out events.

use super::super::EventResiduals;
use super::super::chance::RandomEffects;
use super::super::components::{ComponentData as OfParts, MISMATCH, white_share};
use super::super::evidence::RankedEffect;
use super::super::fit::EventNoise;
use super::super::setting::{LEAST_NOISE, LEAST_SPREAD};
use super::super::table::{OF_PIXELS, probe};
use super::exact::ExactFit;
use super::fit::{PixelRows, SceneFit};
use super::own::PixelThresholds;
use crate::candidates::{CANDIDATES, Candidate};
use photocurrent_scene::free::{FreeScene, LEAST_SHARE, PixelPrediction};

/// Thresholds of pixels and the scene are estimated alternately until the misfit falls by less than this
/// ratio, at most this many times.
const SETTLED: f64 = 1.1;
const MOST_TURNS: usize = 12;

/// Is an effect that of thresholds which differ from pixel to pixel?
pub(super) fn is_mismatch(candidate: usize) -> bool {
    CANDIDATES[candidate].id == MISMATCH
}

/// Events that are held out, as far as random effects need them.
#[derive(Default)]
struct HeldOut {
    events: EventResiduals,
    residual: Vec<f64>,
    /// Columns of [`OF_PIXELS`].
    columns: [Vec<f32>; 2],
}

impl<L: FreeScene> SceneFit<'_, L> {
    /// Misfits of held-out events.
    fn held_out(&self, predicted: &[PixelPrediction], rows: &[Vec<PixelRows>]) -> HeldOut {
        let mut all = HeldOut::default();
        for (place, of) in predicted.iter().enumerate().filter(|(place, _)| self.ground.is_measured(*place)) {
            for (k, event) in of.events.iter().enumerate() {
                all.events.pixel.push(self.light.pixels()[place]);
                all.events.polarity.push(if event.polarity > 0.0 { 1 } else { -1 });
                all.events.slope_per_s.push(event.slope_per_s);
                all.residual.push(event.excess);
                for (n, column) in all.columns.iter_mut().enumerate() {
                    let change = rows[1 + n][place].excess[k] - rows[0][place].excess[k];
                    column.push((change / probe_of(n)) as f32);
                }
            }
        }
        all
    }

    /// Share of the squared misfits that is noise of single events, from all evaluated events, as few share a
    /// place; `None` where no two pixels share one.
    pub(super) fn white_share(&self, predicted: &[PixelPrediction]) -> Option<f64> {
        let (mut pixel, mut polarity, mut residual, mut cells) = (vec![], vec![], vec![], vec![]);
        for (place, of) in predicted.iter().enumerate() {
            let at = self.light.pixels()[place];
            for event in &of.events {
                cells.push(self.light.cell(self.ground.case, at as usize, event.t_ns)?);
                pixel.push(at);
                polarity.push(if event.polarity > 0.0 { 1 } else { -1 });
                residual.push(event.excess / event.threshold);
            }
        }
        Some(white_share((&pixel, &polarity), &residual, &cells))
    }

    /// Random effects, best first, without those that the description states: their expected size is not
    /// known. `None` on a scene without shared places.
    pub(super) fn random(&self) -> Result<Vec<RankedEffect>, String> {
        let (case, nominal, scales) = (self.ground.case, self.ground.nominal, self.ground.scales);
        let mut prepared = vec![self.prepared(&self.trial)?];
        for (n, (id, parameter)) in OF_PIXELS.iter().enumerate() {
            let with = Candidate::number(id, parameter)
                .map(|candidate| self.trial_with(candidate, self.size_of(candidate) + probe_of(n)));
            // One that cannot be combined with what is there has no column.
            prepared.push(
                self.prepared(with.as_ref().unwrap_or(&self.trial))
                    .or_else(|_| self.prepared(&self.trial))?,
            );
        }
        let rows = self.rows(&prepared, &self.prediction()?.light);
        let predicted = self.predicted()?;
        let Some(white) = self.white_share(&predicted) else { return Ok(Vec::new()) };
        let HeldOut { events, residual, columns } = self.held_out(&predicted, &rows);
        let slopes = &mut events.slope_per_s.clone();
        let slope_per_s = super::super::median_of(slopes);
        // As stated, and as sharp as the scene is: no sharper.
        let a = f64::max(nominal.threshold_noise, LEAST_SHARE * scales.threshold);
        let stamp_s = case.t_resolution_ns as f64 * 1e-9 / libm::sqrt(6.0);
        let chance = RandomEffects {
            case,
            scales,
            nominal,
            is_known: false,
            slope_per_s,
            noise: EventNoise { a, b: stamp_s },
            control: Vec::new(),
        };
        let (mut found, _) = chance.rank_beyond_control(&OfParts {
            events: &events,
            residual: &residual,
            columns: [&columns[0], &columns[1]],
            white,
            threshold: scales.threshold,
            errs: true,
            least: LEAST_NOISE * scales.threshold,
            least_spread: LEAST_SPREAD,
        });
        let is_stated = |one: &RankedEffect| case.sensor.effects.contains_key(CANDIDATES[one.candidate].id);
        found.retain(|one| !is_stated(one));
        found.iter_mut().for_each(|one| {
            one.is_material = CANDIDATES[one.candidate].is_material(case, nominal, one.value);
        });
        Ok(found)
    }
}

impl<'a, L: FreeScene> SceneFit<'a, L> {
    /// The scene with thresholds of each pixel's own, `begin` the effect size of their spread to begin with.
    pub(super) fn with_own(
        &self,
        candidate: usize,
        begin: f64,
        corrections: usize,
    ) -> Result<ExactFit<'a, L>, String> {
        let (scales, nominal) = (self.ground.scales, self.ground.nominal);
        let kind = &CANDIDATES[candidate];
        let mut fit = self.clone();
        fit.own = Some(PixelThresholds { spread: kind.value(begin, scales, nominal) / scales.threshold });
        let mut before = f64::INFINITY;
        for turn in 0..MOST_TURNS {
            // What is left falls by a factor, and a factor of the normal matrix with it.
            fit.release();
            fit.rounds(1)?;
            fit.settled(1)?;
            let left = fit.median_event_misfit()?;
            if turn + 1 >= corrections && before < SETTLED * left {
                break;
            }
            before = left;
        }
        let spread = fit.own.map_or(0.0, |own| own.spread);
        let effect_size = kind.effect_size(spread * scales.threshold, scales, nominal);
        ExactFit::from_fit(candidate, (effect_size, 0.0), fit)
    }
}

/// Effect size of the finite difference of a column of [`OF_PIXELS`].
fn probe_of(n: usize) -> f64 {
    let (id, parameter) = OF_PIXELS[n];
    Candidate::number(id, parameter).map_or(1.0, probe)
}
