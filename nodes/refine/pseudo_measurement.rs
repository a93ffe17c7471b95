//! Estimates the variance of predicted light, and turns predictions into pseudo-measurements.
//!
//! A prediction of a pixel's light (by its neighbours along the motion, by a moving picture) does not use the
//! pixel's own events, so they test it between frames. Seen through the sensor, the predicted light must
//! bring the voltage to a threshold when they fired, and give the pixel's own frame values. The misfit is an
//! error of the prediction, and so is the difference of two sources. Both only increase its variance.

mod params;

pub(crate) use params::PseudoMeasurementParams;

use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use photocurrent_scene::film::LogTracks;
use photocurrent_sensor::conditional::{Conditional, Look, Track, conditional};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::map::{Hint, MapFrame, PixelEvent};
use photocurrent_sensor::model::Model;
use photocurrent_sensor::undo::sum;

/// Distance in pooling times beyond which an innovation has no weight: it would weigh a part in 65,000.
const FAR: f64 = 16.0;
/// The sensor sees the predicted light in steps of at most this, ns.
const SEEN_NS: i64 = 100_000;

/// The predicted light at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictedLight {
    pub t_ns: i64,
    pub log: f64,
    /// Variance by the difference of two sources, where there are two.
    pub innovation: Option<f64>,
    /// Ambiguity variance: variance by the choice between several motions.
    pub ambiguity: f64,
}

/// An innovation: instant (ns), its square over the expected variance, and its weight.
type Innovation = (i64, f64, f64);

/// The sensor as modelled by the solver.
#[derive(Clone, Debug)]
pub(super) struct SolverSensor {
    pub model: Model,
    /// Photocurrent that effects add on the event path; measurements, pseudo-measurements and solutions are
    /// those of the sum.
    pub added: f64,
}

/// A pixel and its measurements.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredPixel<'a> {
    /// The sensor.
    pub sensor: &'a SolverSensor,
    pub extent: Extent,
    pub place: (usize, usize),
    pub events: &'a [PixelEvent],
    pub frames: &'a [MapFrame],
    /// Accuracy of the pixel's own estimate, natural-log units.
    pub threshold: f64,
}

/// Predictions of a pixel's light, and their conversion to pseudo-measurements.
pub(super) struct PseudoMeasurements {
    params: PseudoMeasurementParams,
    predictions: Vec<PredictedLight>,
    /// Expected variance of each prediction: the floor, and the effect of a small error of its place where
    /// light changes fast.
    expected: Vec<f64>,
    own_innovations: Vec<Innovation>,
    /// The same by the differences of two sources.
    source_innovations: Vec<Innovation>,
    /// The predicted light.
    t_ns: Vec<i64>,
    log: Vec<f64>,
    /// The sensor's response to it.
    response: Conditional,
}

impl PseudoMeasurements {
    /// Without predictions.
    pub(crate) fn new(params: &PseudoMeasurementParams) -> PseudoMeasurements {
        PseudoMeasurements {
            params: *params,
            predictions: Vec::new(),
            expected: Vec::new(),
            own_innovations: Vec::new(),
            source_innovations: Vec::new(),
            t_ns: Vec::new(),
            log: Vec::new(),
            response: Conditional::default(),
        }
    }

    /// Pseudo-measurements of a pixel every `step_ns` of `span`, in order of time, from the predictions of
    /// `predict`. None where it predicts nothing, or where the pixel's measurements disagree. Without a
    /// prediction the pixel's own `tracks` are used.
    pub(crate) fn hints(
        &mut self,
        predict: impl Fn(i64) -> Option<PredictedLight>,
        tracks: &LogTracks,
        span: (i64, i64),
        step_ns: i64,
        measured: &MeasuredPixel<'_>,
        hints: &mut Vec<Hint>,
    ) {
        hints.clear();
        if !self.collect_predictions(predict, tracks, span, step_ns, measured) {
            return;
        }
        let PseudoMeasurementParams {
            floor,
            pooled,
            wide,
            one_sided,
            most_innovation,
            together,
            one_error,
            ..
        } = self.params;
        self.collect_innovations(step_ns, measured);
        self.source_innovations.clear();
        self.source_innovations.extend(
            self.predictions
                .iter()
                .filter_map(|s| s.innovation.map(|c| (s.t_ns, (c + s.ambiguity) / (floor * floor), 1.0))),
        );
        let mut differences = WindowMeans::new(&self.source_innovations, pooled);
        let (mut own, mut widely) =
            (WindowMeans::new(&self.own_innovations, pooled), WindowMeans::new(&self.own_innovations, wide));
        for (predicted, expected) in self.predictions.iter().zip(&self.expected) {
            let difference = floor * floor * differences.at(predicted.t_ns);
            let own = expected * own.at(predicted.t_ns);
            let widely = expected * widely.at(predicted.t_ns);
            let weight =
                1.0 - f64::max(own, widely) / (most_innovation * measured.threshold * measured.threshold);
            if weight <= 0.0 {
                continue;
            }
            let mut variance = expected + difference + own;
            variance += predicted.innovation.unwrap_or(variance * (one_sided - 1.0)) + predicted.ambiguity;
            let variance = variance / (weight * weight);
            hints.push(Hint {
                t_ns: predicted.t_ns,
                log_photocurrent: predicted.log,
                variance: together * variance,
                for_sigma: variance,
            });
        }
        share_information(hints, one_error.ns());
    }

    /// Collects the predictions for a pixel, and the light that they imply; returns whether there are any.
    fn collect_predictions(
        &mut self,
        predict: impl Fn(i64) -> Option<PredictedLight>,
        tracks: &LogTracks,
        span: (i64, i64),
        step_ns: i64,
        measured: &MeasuredPixel<'_>,
    ) -> bool {
        self.predictions.clear();
        self.t_ns.clear();
        self.log.clear();
        if measured.events.is_empty() {
            return false;
        }
        let (x, y) = measured.place;
        let mut t_ns = span.0 + step_ns / 2;
        while t_ns < span.1 {
            let predicted = predict(t_ns).map(|predicted| PredictedLight {
                log: sum(measured.sensor.added, predicted.log),
                ..predicted
            });
            self.predictions.extend(predicted);
            if let Some(log) = predicted
                .map(|predicted| predicted.log)
                .or_else(|| tracks.at(x, y, t_ns).map(|log| sum(measured.sensor.added, log)))
            {
                self.t_ns.push(t_ns);
                self.log.push(log);
            }
            t_ns += step_ns;
        }
        if self.predictions.is_empty() || self.t_ns.len() < 2 {
            return false;
        }
        self.expected_variances(step_ns);
        true
    }

    /// Expected variance of each prediction.
    fn expected_variances(&mut self, step_ns: i64) {
        let PseudoMeasurements {
            params: PseudoMeasurementParams { floor, late, .. },
            predictions: predicted,
            expected,
            ..
        } = self;
        let late_ms = late.ns() as f64 * 1e-6;
        let variance = |k: usize| {
            let (before, after) =
                (&predicted[k.saturating_sub(1)], &predicted[usize::min(k + 1, predicted.len() - 1)]);
            let apart_ns = after.t_ns - before.t_ns;
            let slope = if apart_ns > 0 && apart_ns <= 2 * step_ns {
                (after.log - before.log) / (apart_ns as f64 * 1e-6)
            } else {
                0.0
            };
            let off = slope * late_ms;
            *floor * *floor + off * off
        };
        expected.clear();
        expected.extend((0..predicted.len()).map(variance));
    }

    /// Innovations of the pixel's own events and frames against the predicted light, seen through the sensor.
    fn collect_innovations(&mut self, step_ns: i64, measured: &MeasuredPixel<'_>) {
        let PseudoMeasurements {
            params: PseudoMeasurementParams { floor, frame_weight, .. },
            predictions: predicted,
            expected,
            own_innovations: own,
            t_ns,
            log,
            response: seen,
            ..
        } = self;
        let MeasuredPixel {
            sensor: SolverSensor { model: sensor, .. },
            extent,
            place: (x, y),
            events,
            frames,
            ..
        } = *measured;
        own.clear();
        let track = Track::new(t_ns, log, SEEN_NS);
        let site = Site { x: x as u32, y: y as u32, width: extent.width, height: extent.height, seed: 0 };
        conditional(
            sensor,
            &[],
            &Look { site, track: &track, seen: None, events, frames, quiet_ns: &[] },
            seen,
        );
        let near = |t_ns: i64| {
            let after = predicted.partition_point(|predicted| predicted.t_ns < t_ns);
            let at = [after.checked_sub(1), Some(after)]
                .into_iter()
                .flatten()
                .filter(|k| *k < predicted.len())
                .min_by_key(|k| (predicted[*k].t_ns - t_ns).abs());
            at.filter(|k| (predicted[*k].t_ns - t_ns).abs() <= step_ns).map(|k| expected[k])
        };
        // Thresholds jump from event to event, as far as that is stated.
        let noise = sensor.threshold_noise * sensor.threshold_noise;
        let mut last: Option<(i64, f64)> = None;
        for (k, event) in events.iter().enumerate() {
            let here = near(event.t_in_ns).map(|expected| (event.t_in_ns, expected));
            // From the event before, when the reference was taken, to this one.
            if let (Some((before_ns, before)), Some((t_ns, expected))) = (last, here)
                && seen.is_armed[k]
                && seen.excess[k].is_finite()
            {
                let square = f64::max(seen.excess[k] * seen.excess[k] - noise, 0.0);
                own.push((i64::midpoint(before_ns, t_ns), square / (before + expected), 1.0));
            }
            last = here;
        }
        for (frame, dn) in frames.iter().zip(&seen.dn).filter(|(frame, _)| !frame.saturated) {
            let is_predicted = predicted.iter().any(|s| (frame.start_ns..frame.end_ns).contains(&s.t_ns));
            let (there, predicted) = (frame.dn - sensor.number.black_level, dn - sensor.number.black_level);
            if is_predicted && there > frame.sigma_dn && predicted > 0.0 {
                let (off, noise) = (libm::log(predicted / there), frame.sigma_dn / there);
                // An edge that is a little late changes little over an exposure: a frame allows for the floor
                // alone, and for its noise.
                own.push((
                    i64::midpoint(frame.start_ns, frame.end_ns),
                    f64::max(off * off - noise * noise, 0.0) / (*floor * *floor),
                    *frame_weight,
                ));
            }
        }
        own.sort_by_key(|(t_ns, ..)| *t_ns);
    }
}

/// Reduces the information of pseudo-measurements in the posterior variance: all within a window count as
/// one.
fn share_information(hints: &mut [Hint], within_ns: i64) {
    let half_ns = within_ns / 2;
    let (mut from, mut to) = (0, 0);
    for n in 0..hints.len() {
        let t_ns = hints[n].t_ns;
        while hints[from].t_ns < t_ns - half_ns {
            from += 1;
        }
        while to < hints.len() && hints[to].t_ns <= t_ns + half_ns {
            to += 1;
        }
        hints[n].for_sigma *= (to - from) as f64;
    }
}

/// Weighted means of squares around instants in rising order. Weights fall with the distance, and a small
/// prior is included.
struct WindowMeans<'a> {
    /// Instants, squares, weights, in order of time.
    list: &'a [Innovation],
    over_ms: f64,
    /// Index of the first innovation near enough for the instants to come.
    first: usize,
}

impl WindowMeans<'_> {
    fn new(list: &[Innovation], over: Duration) -> WindowMeans<'_> {
        WindowMeans { list, over_ms: over.ns() as f64 * 1e-6, first: 0 }
    }

    fn at(&mut self, t_ns: i64) -> f64 {
        const START: f64 = 0.1;
        let far_ns = (FAR * self.over_ms * 1e6) as i64;
        while self.list.get(self.first).is_some_and(|(t, ..)| *t < t_ns - far_ns) {
            self.first += 1;
        }
        let mut sum = (START, START);
        for (t, square, weight) in self.list[self.first..].iter().take_while(|(t, ..)| *t <= t_ns + far_ns) {
            let apart = (t - t_ns) as f64 * 1e-6 / self.over_ms;
            let weight = weight / (1.0 + apart * apart * apart * apart);
            sum = (sum.0 + weight * square, sum.1 + weight);
        }
        sum.0 / sum.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Sensor, TrackBand};
    use photocurrent_scene::film::EventTimes;
    use photocurrent_sensor::forward::LinearLight;
    use std::sync::Arc;

    const EXTENT: Extent = Extent { width: 1, height: 1 };
    const GAIN: f64 = 1000.0;

    /// Dark and bright by turns, 6 ms each; from one to the other in half a millisecond.
    fn squares(ms: f64) -> f64 {
        let place = (ms / 12.0).fract();
        let up = (place * 24.0).clamp(0.0, 1.0);
        let down = ((place - 0.5) * 24.0).clamp(0.0, 1.0);
        4.0 + 2.0 * (up - down)
    }

    /// Of a pixel that sees these squares with thresholds of 0.4, when they are predicted late and too
    /// bright.
    fn hints(late_ms: f64, brighter: f64) -> Vec<Hint> {
        hints_with_ambiguity(late_ms, brighter, 0.0)
    }

    fn hints_with_ambiguity(late_ms: f64, brighter: f64, ambiguity: f64) -> Vec<Hint> {
        let mut sensor = Sensor::unknown("test");
        sensor.comparator.threshold_on = Some(0.4);
        sensor.comparator.threshold_off = Some(0.4);
        sensor.frames.gain = Some(GAIN);
        let sensor = SolverSensor { model: Model::of(&sensor), added: 0.0 };
        let light: Vec<(i64, f64)> =
            (0..=4800).map(|n| (n * 10_000, libm::exp(squares(n as f64 * 0.01)))).collect();
        let mut band = TrackBand::begin(0, 1);
        band.push(light.iter().map(|(t, i)| (*t, *i as f32)));
        let tracks = LogTracks::new(EXTENT, band, &Arc::new(EventTimes::new(std::iter::empty())));
        // Each edge is 2 high: a crossing of 0.4 every tenth of a millisecond.
        let edges = (0..8).flat_map(|edge| {
            [0.1, 0.2, 0.3, 0.4]
                .map(|ms| (((6.0 * f64::from(edge) + ms) * 1e6) as i64, if edge % 2 == 0 { 1 } else { -1 }))
        });
        let event =
            |(t_in_ns, polarity): (i64, i8)| PixelEvent { t_in_ns, t_off_ns: t_in_ns + 1_000, polarity };
        let events: Vec<PixelEvent> = edges.map(event).collect();
        let (t, i): (Vec<i64>, Vec<f64>) = light.into_iter().unzip();
        let light = LinearLight::new(&t, &i);
        let frame = |l: i64| {
            let exposure = Exposure::new(l * 9_000_000, l * 9_000_000 + 6_000_000);
            MapFrame {
                start_ns: exposure.start.0,
                end_ns: exposure.end.0,
                dn: GAIN * light.integral(exposure),
                sigma_dn: 1.0,
                saturated: false,
            }
        };
        let frames: Vec<MapFrame> = (0..5).map(frame).collect();
        let predict = |t_ns: i64| {
            Some(PredictedLight {
                t_ns,
                log: squares(t_ns as f64 * 1e-6 - late_ms + 12.0) + brighter,
                innovation: Some(0.0),
                ambiguity,
            })
        };
        let measured = MeasuredPixel {
            sensor: &sensor,
            extent: EXTENT,
            place: (0, 0),
            events: &events,
            frames: &frames,
            threshold: 0.4,
        };
        let mut hints = Vec::new();
        PseudoMeasurements::new(&PseudoMeasurementParams::default()).hints(
            predict,
            &tracks,
            (0, 48_000_000),
            100_000,
            &measured,
            &mut hints,
        );
        hints
    }

    #[test]
    fn edges_that_come_a_little_late_keep_the_variance_between_them() {
        let hints = hints(0.03, 0.0);
        let between = |hint: &&Hint| (2.0..5.0).contains(&(hint.t_ns as f64 * 1e-6 % 6.0));
        let (flat, steep): (Vec<&Hint>, Vec<&Hint>) = hints.iter().partition(between);
        // Four edges of eight bound at least eighteen milliseconds of rest, sampled ten times a millisecond.
        assert!(flat.len() > 180, "{}", flat.len());
        let worst = flat.iter().map(|hint| hint.variance).fold(0.0, f64::max);
        assert!(worst < 0.1 * 0.1, "{worst}");
        let floor = PseudoMeasurementParams::default().floor;
        // Where they are steep they are off by up to 0.12.
        let is_widened = |hint: &&&Hint| {
            (hint.log_photocurrent - squares(hint.t_ns as f64 * 1e-6)).abs() < 1e-6
                || hint.variance > 2.0 * floor * floor
        };
        assert_eq!(steep.iter().filter(is_widened).count(), steep.len());
    }

    #[test]
    fn an_ambiguous_prediction_has_at_least_its_ambiguity_variance() {
        let (plain, with_ambiguity) = (hints(0.0, 0.0), hints_with_ambiguity(0.0, 0.0, 0.04));
        assert_eq!(plain.len(), with_ambiguity.len());
        assert!(
            plain.iter().any(|hint| hint.variance < 0.01)
                && with_ambiguity
                    .iter()
                    .all(|hint| hint.variance >= PseudoMeasurementParams::default().together * 0.04)
        );
    }

    #[test]
    fn hints_narrow_a_variance_no_more_than_one_of_them() {
        let hints = hints(0.0, 0.0);
        // All lie within 48 ms: the information of all together is the mean one of a single hint.
        let information = hints.iter().map(|hint| 1.0 / hint.for_sigma).sum::<f64>();
        let single =
            hints.iter().map(|hint| PseudoMeasurementParams::default().together / hint.variance).sum::<f64>()
                / hints.len() as f64;
        assert!((information / single - 1.0).abs() < 1e-9, "{information} and {single}");
        // A smaller variance pulls the estimate harder but must not narrow its posterior.
        for (factor, held, known) in [(0.25, 0.25, 1.0), (4.0, 4.0, 4.0)] {
            let mut taken = hints.clone();
            crate::refine::variance_factor::scale_variances(&mut taken, factor);
            assert!(
                taken.iter().zip(&hints).all(|(now, then)| now.variance == held * then.variance
                    && now.for_sigma == known * then.for_sigma)
            );
        }
    }

    #[test]
    fn hints_far_apart_have_errors_of_their_own() {
        // A second of hints, one each millisecond: 100 on either side of one in the middle, and none before
        // the first.
        let mut hints: Vec<Hint> = (0..1000)
            .map(|k| Hint { t_ns: k * 1_000_000, log_photocurrent: 4.0, variance: 1.0, for_sigma: 1.0 })
            .collect();
        share_information(&mut hints, 200_000_000);
        assert_eq!([0, 500, 999].map(|n: usize| hints[n].for_sigma), [101.0, 201.0, 101.0]);
    }

    #[test]
    fn predictions_too_bright_over_exposures_are_rejected() {
        assert!(hints(0.0, 0.9).is_empty());
        assert!(!hints(0.0, 0.0).is_empty());
    }

    #[test]
    fn events_between_frames_judge_what_frames_cannot_see() {
        // Half a millisecond early or late: exposures collect nearly the same, but events do not fire in
        // time.
        let (right, late) = (hints(0.0, 0.0), hints(0.5, 0.0));
        let usual = |hints: &[Hint]| {
            hints.iter().map(|hint| libm::sqrt(hint.variance)).sum::<f64>() / hints.len().max(1) as f64
        };
        assert!(
            late.len() < right.len() / 2 || usual(&late) > 3.0 * usual(&right),
            "{} of {}: {} and {}",
            late.len(),
            right.len(),
            usual(&late),
            usual(&right)
        );
    }
}
