//! Simulates what a sensor with effects would have recorded of an estimated scene, with the pixels, exposures
//! and stamps of the recording.
//!
//! Light is log-linear between knots in a scene and linear in the forward model. Steep pieces are split until
//! both agree to a part in a thousand. Outside the sample, the nearest pixel of the same row or column is
//! used where an effect mixes the light of neighbours. The load of a readout queue is that of the recording.
//! Stamps are rounded to the recording's grid. Frames get the stated noise and the noise that the caller
//! estimated.

use crate::curves::LogLightCurves;
use crate::sample::PixelSample;
use photocurrent_core::random::Random;
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent, PixelEvents};
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::array::{self, Array};
use photocurrent_sensor::effects::{ArrayEvent, Effect, Kernel, Tap, from_description};
use photocurrent_sensor::forward::LinearLight;
use photocurrent_sensor::forward::neighbours::{joined, mixed, stand_in};
use rayon::prelude::*;
use serde_json::{Map, Value};
use std::cell::Cell;
use std::collections::BTreeMap;

/// Log light further from zero than this is no estimate: it is held there, as the solver does.
const LOG_LIMIT: f64 = 40.0;

/// The longest piece of log-linear light that counts as linear, natural-log units: they differ by an eighth
/// of its square.
const PIECE: f64 = 0.08;

/// Mixtures of neighbours' light are evaluated at least this often, ns.
const MIXED_NS: i64 = 100_000;

/// Error allowed per step of front ends without a closed form, natural-log units: at 10 ln/s it moves an
/// event by a microsecond.
const TOLERANCE: f64 = 1e-5;

/// Conditions of a simulated recording in addition to the stated sensor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SimulatedConditions {
    /// Seed of everything random.
    pub seed: u64,
    /// Standard deviation of frame values as a share of the signal, beyond what is stated.
    pub frame_share: f64,
    /// And in DN.
    pub frame_dn: f64,
    /// The scene is light behind all mixing of neighbours.
    pub is_mixed: bool,
}

/// Effects with their parameters, by catalogue id, as `[effects]` of a sensor description states them.
pub(crate) type EffectParameters = BTreeMap<String, Map<String, Value>>;

/// Records the sampled pixels with the nominal sensor and `more` effects in addition to (or, of the same id,
/// instead of) those that the description states. Pixels outside the sample stay without events and with NaN
/// in the frames.
///
/// # Errors
/// When an effect or its parameters are not understood, or effects cannot be combined.
pub(crate) fn record(
    case: &Case,
    nominal: &Nominal,
    sample: &PixelSample,
    scene: &LogLightCurves,
    more: &EffectParameters,
    conditions: &SimulatedConditions,
) -> Result<Case, String> {
    let effects = effects_of(case, more)?;
    let kernel = joined(&effects).map_err(|why| why.to_string())?.filter(|_| !conditions.is_mixed);
    let effects: &[Box<dyn Effect>] = &effects;
    let array = Array { model: nominal, effects, tolerance: TOLERANCE, span: case.span };
    let one = |n: usize| -> (Vec<PixelEvent>, Vec<f32>) {
        let pixel = sample.pixels[n] as usize;
        let own = linear(scene, n);
        let seen = kernel
            .as_ref()
            .map_or_else(|| own.clone(), |kernel| mix_neighbours(case, sample, scene, kernel, n));
        let site = case.site(pixel, conditions.seed);
        let draws = Random::new(conditions.seed, &[pixel as u64, 1]);
        let recorded = array.recorded(&site, &LinearLight::new(&seen.0, &seen.1), draws);
        let events = recorded.map(|event| on_grid(case, nominal, &event)).collect();
        let mut random = Random::new(conditions.seed, &[pixel as u64, 2]);
        let frames = case.frames.as_ref().map_or_else(Vec::new, |frames| {
            let exposures: Vec<_> =
                (0..frames.times.len()).map(|l| frames.times.exposure(l, site.y)).collect();
            let dn = array.frame_values(&site, &LinearLight::new(&own.0, &own.1), nominal.number, &exposures);
            let noisy = |dn: f64| {
                let sigma = nominal.frame_sigma_with_dn(
                    dn,
                    [conditions.frame_share * (dn - nominal.number.black_level), conditions.frame_dn],
                );
                (dn + sigma * random.normal()).min(nominal.saturation_dn) as f32
            };
            dn.into_iter().map(noisy).collect()
        });
        (events, frames)
    };
    let recorded: Vec<(Vec<PixelEvent>, Vec<f32>)> =
        (0..sample.len()).into_par_iter().with_min_len(16).map(one).collect();
    let mut pixels = vec![Vec::new(); case.extent.pixels()];
    let frames = case.frames.as_ref().map(|frames| {
        let mut dn = vec![f32::NAN; frames.times.len() * case.extent.pixels()];
        for (&pixel, (_, values)) in sample.pixels.iter().zip(&recorded) {
            for (l, value) in values.iter().enumerate() {
                dn[l * case.extent.pixels() + pixel as usize] = *value;
            }
        }
        CaseFrames::new(frames.times.clone(), dn)
    });
    for (&pixel, (events, _)) in sample.pixels.iter().zip(recorded) {
        pixels[pixel as usize] = events;
    }
    Ok(Case { events: PixelEvents::new(pixels), frames, sensor: case.sensor.clone(), ..*case })
}

/// Effects of the description with `more` added; an id in `more` replaces the stated one. Effects that depend
/// on the load get that of the recording.
///
/// # Errors
/// When an effect or its parameters are not understood.
pub(crate) fn effects_of(case: &Case, more: &EffectParameters) -> Result<Vec<Box<dyn Effect>>, String> {
    let mut described = case.sensor.effects.clone();
    described.extend(more.iter().map(|(id, parameters)| (id.clone(), parameters.clone())));
    let mut effects = from_description(&described)?;
    set_array_load(case, &mut effects);
    Ok(effects)
}

/// Passes the event times of the recording to effects that depend on the load.
fn set_array_load(case: &Case, effects: &mut [Box<dyn Effect>]) {
    if effects.iter().all(|effect| effect.informed(&[]).is_none()) {
        return;
    }
    let mut load: Vec<ArrayEvent> = Vec::with_capacity(case.events.len());
    for pixel in 0..case.events.pixels() {
        let (x, y) = case.pixel_place(pixel);
        load.extend(case.events.of_pixel(pixel).iter().map(|&event| ArrayEvent { x, y, event }));
    }
    load.sort_by_key(|event| event.event.t_off_ns);
    array::inform(effects, &load);
}

/// Stamps as the recorder writes them: on its grid, or the in-pixel time taken from the off-pixel one where
/// it was not recorded.
fn on_grid(case: &Case, nominal: &Nominal, event: &PixelEvent) -> PixelEvent {
    let step = case.t_resolution_ns;
    let rounded = |t: i64| if step > 1 { (t as f64 / step as f64).round() as i64 * step } else { t };
    let t_off_ns = rounded(event.t_off_ns);
    let t_in_ns = if case.has_t_in { rounded(event.t_in_ns) } else { t_off_ns - nominal.pixel.latency_ns };
    PixelEvent { t_in_ns, t_off_ns, polarity: event.polarity }
}

/// Photocurrent of log light, positive and finite whatever an estimate ran to.
fn photocurrent(log_light: f64) -> f64 {
    libm::exp(if log_light.is_nan() { 0.0 } else { log_light.clamp(-LOG_LIMIT, LOG_LIMIT) })
}

/// Instants and photocurrent of a pixel of the scene, fine enough to be taken as linear.
fn linear(scene: &LogLightCurves, n: usize) -> (Vec<i64>, Vec<f64>) {
    let (t, u) = scene.pixel(n);
    let (mut instants, mut light) = (vec![t[0]], vec![photocurrent(u[0])]);
    for k in 1..t.len() {
        let pieces =
            (((u[k] - u[k - 1]).abs() / PIECE).ceil() as i64).clamp(1, i64::max(1, (t[k] - t[k - 1]) / 1000));
        for piece in 1..=pieces {
            let share = piece as f64 / pieces as f64;
            instants.push(t[k - 1] + ((t[k] - t[k - 1]) as f64 * share) as i64);
            light.push(photocurrent(u[k - 1] + (u[k] - u[k - 1]) * share));
        }
    }
    (instants, light)
}

/// The light of the event path: a mixture of the pixel and its neighbours.
fn mix_neighbours(
    case: &Case,
    sample: &PixelSample,
    scene: &LogLightCurves,
    kernel: &Kernel,
    n: usize,
) -> (Vec<i64>, Vec<f64>) {
    let (x, y) = case.pixel_place(sample.pixels[n] as usize);
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let neighbour = |tap: &Tap| {
        // As far towards the neighbour as the sample goes.
        let mut at = n;
        for (dx, dy) in [(tap.dx, tap.dy), (tap.dx.signum(), tap.dy.signum()), (tap.dx, 0), (0, tap.dy)] {
            let pixel = stand_in(y as usize, dy, height) * width + stand_in(x as usize, dx, width);
            if let Some(place) = sample.index_of(pixel).filter(|&place| scene.is_known[place]) {
                at = place;
                break;
            }
        }
        at
    };
    let lights: Vec<(Vec<i64>, Vec<f64>)> =
        kernel.taps.iter().map(|tap| linear(scene, neighbour(tap))).collect();
    // The pixel's own instants and a grid: those of all neighbours together would be tens of thousands.
    let mut instants: Vec<i64> = linear(scene, n).0;
    let (first, last) = lights
        .iter()
        .fold((i64::MAX, i64::MIN), |(first, last), (t, _)| (first.min(t[0]), last.max(t[t.len() - 1])));
    instants.extend((0..=(last - first) / MIXED_NS).map(|k| first + k * MIXED_NS));
    instants.push(last);
    instants.sort_unstable();
    instants.dedup();
    let mut cursors = vec![0_usize; lights.len()];
    let light = instants
        .iter()
        .map(|&t| {
            let mut tap_light = Vec::with_capacity(lights.len());
            for (cursor, (times, values)) in cursors.iter_mut().zip(&lights) {
                while *cursor + 1 < times.len() && times[*cursor + 1] <= t {
                    *cursor += 1;
                }
                let at = *cursor;
                let value = match times.get(at + 1) {
                    Some(&next) if t > times[at] => {
                        values[at]
                            + (values[at + 1] - values[at]) * (t - times[at]) as f64
                                / (next - times[at]) as f64
                    }
                    _ => values[at],
                };
                tap_light.push(value);
            }
            let next = Cell::new(0);
            mixed(kernel, |_| tap_light[next.replace(next.get() + 1)])
        })
        .collect();
    (instants, light)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn light_that_an_estimate_ran_away_with_is_recorded_all_the_same() {
        let case = testing::case();
        let sample = PixelSample::every_pixel(&case, 4);
        let run_away = |n: usize| [f64::NEG_INFINITY, 1e6, f64::NAN, 800.0][n % 4];
        let scene = LogLightCurves::from_pixels(
            (0..sample.len()).map(|n| (vec![0, 30_000_000], vec![4.0, run_away(n)], true)),
        );
        let recorded = record(
            &case,
            &case.nominal().unwrap(),
            &sample,
            &scene,
            &EffectParameters::new(),
            &SimulatedConditions::default(),
        )
        .unwrap();
        assert_eq!(recorded.events.pixels(), case.events.pixels());
    }
}
