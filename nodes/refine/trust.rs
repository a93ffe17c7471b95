//! How far a predicted light may be trusted, and the hints that are left of it.
//!
//! Whoever predicts a pixel's light (its neighbours along the motion, a picture that moves) knows nothing of
//! the pixel's own events. So they are the judge of what lies between frames: seen through the sensor, the
//! predicted light must bring the voltage to a threshold when they fired, and to no frame value another one
//! than the pixel's own. What it misses them by is its error there, and so is what two sources contradict
//! each other by. All of it can only widen the error.

mod params;

pub(crate) use params::TrustParams;

use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use photocurrent_scene::film::LogTracks;
use photocurrent_sensor::conditional::{Conditional, Look, Track, conditional};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::map::{Hint, MapFrame, PixelEvent};
use photocurrent_sensor::model::Model;
use photocurrent_sensor::undo::sum;

/// What lies so many times of a pool away counts no more: it would weigh a part in 65,000.
const FAR: f64 = 16.0;
/// The sensor sees the predicted light in steps of at most this, ns.
const SEEN_NS: i64 = 100_000;

/// What is predicted for one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    pub t_ns: i64,
    pub log: f64,
    /// The variance that the contradiction of two sources shows, where there are two.
    pub contradiction: Option<f64>,
    /// The variance that comes of not knowing along which of several motions to ask.
    pub doubt: f64,
}

/// A contradiction: when, its square in terms of the variance that was expected, and what it weighs.
type Miss = (i64, f64, f64);

/// The sensor as problems are posed.
#[derive(Clone, Debug)]
pub(super) struct Posed {
    pub model: Model,
    /// What effects add to the photocurrent of the event path; measurements, hints and solutions are those of
    /// the sum.
    pub added: f64,
}

/// A pixel and what it measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured<'a> {
    /// The sensor.
    pub sensor: &'a Posed,
    pub extent: Extent,
    pub place: (usize, usize),
    pub events: &'a [PixelEvent],
    pub frames: &'a [MapFrame],
    /// How exactly the pixel knows its light by itself, natural-log units.
    pub threshold: f64,
}

/// Collects hints.
pub(super) struct Trust {
    params: TrustParams,
    said: Vec<Said>,
    /// The variance that each of them would have by itself: the floor, and what a small error of its place
    /// brings where light changes fast.
    expected: Vec<f64>,
    own: Vec<Miss>,
    /// The same of what two sources contradict each other by.
    contradicted: Vec<Miss>,
    /// The predicted light.
    t_ns: Vec<i64>,
    log: Vec<f64>,
    /// What the sensor makes of it.
    seen: Conditional,
}

impl Trust {
    /// With nothing collected.
    pub(crate) fn new(params: &TrustParams) -> Trust {
        Trust {
            params: *params,
            said: Vec::new(),
            expected: Vec::new(),
            own: Vec::new(),
            contradicted: Vec::new(),
            t_ns: Vec::new(),
            log: Vec::new(),
            seen: Conditional::default(),
        }
    }

    /// The hints of a pixel every `step_ns` of `span`, in order of time, out of what `say` predicts; none
    /// where it has nothing to say, or the pixel's measurements disagree. Where nothing is said the pixel's
    /// own `tracks` stand.
    pub(crate) fn hints(
        &mut self,
        say: impl Fn(i64) -> Option<Said>,
        tracks: &LogTracks,
        span: (i64, i64),
        step_ns: i64,
        measured: &Measured<'_>,
        hints: &mut Vec<Hint>,
    ) {
        hints.clear();
        if !self.look(say, tracks, span, step_ns, measured) {
            return;
        }
        let TrustParams { floor, pooled, wide, one_sided, most_contradiction, together, one_error, .. } =
            self.params;
        self.judge(step_ns, measured);
        self.contradicted.clear();
        self.contradicted.extend(
            self.said
                .iter()
                .filter_map(|s| s.contradiction.map(|c| (s.t_ns, (c + s.doubt) / (floor * floor), 1.0))),
        );
        let mut contradicted = Pool::new(&self.contradicted, pooled);
        let (mut own, mut widely) = (Pool::new(&self.own, pooled), Pool::new(&self.own, wide));
        for (said, expected) in self.said.iter().zip(&self.expected) {
            let contradiction = floor * floor * contradicted.at(said.t_ns);
            let own = expected * own.at(said.t_ns);
            let widely = expected * widely.at(said.t_ns);
            let trust =
                1.0 - f64::max(own, widely) / (most_contradiction * measured.threshold * measured.threshold);
            if trust <= 0.0 {
                continue;
            }
            let mut variance = expected + contradiction + own;
            variance += said.contradiction.unwrap_or(variance * (one_sided - 1.0)) + said.doubt;
            let variance = variance / (trust * trust);
            hints.push(Hint {
                t_ns: said.t_ns,
                log_photocurrent: said.log,
                variance: together * variance,
                for_sigma: variance,
            });
        }
        err_together(hints, one_error.ns());
    }

    /// Collects what is said to a pixel, and how the light would go on by that; is there anything?
    fn look(
        &mut self,
        say: impl Fn(i64) -> Option<Said>,
        tracks: &LogTracks,
        span: (i64, i64),
        step_ns: i64,
        measured: &Measured<'_>,
    ) -> bool {
        self.said.clear();
        self.t_ns.clear();
        self.log.clear();
        if measured.events.is_empty() {
            return false;
        }
        let (x, y) = measured.place;
        let mut t_ns = span.0 + step_ns / 2;
        while t_ns < span.1 {
            let said = say(t_ns).map(|said| Said { log: sum(measured.sensor.added, said.log), ..said });
            self.said.extend(said);
            if let Some(log) = said
                .map(|said| said.log)
                .or_else(|| tracks.at(x, y, t_ns).map(|log| sum(measured.sensor.added, log)))
            {
                self.t_ns.push(t_ns);
                self.log.push(log);
            }
            t_ns += step_ns;
        }
        if self.said.is_empty() || self.t_ns.len() < 2 {
            return false;
        }
        self.expect(step_ns);
        true
    }

    /// What each hint may err by.
    fn expect(&mut self, step_ns: i64) {
        let Trust { params: TrustParams { floor, late, .. }, said, expected, .. } = self;
        let late_ms = late.ns() as f64 * 1e-6;
        let variance = |k: usize| {
            let (before, after) = (&said[k.saturating_sub(1)], &said[usize::min(k + 1, said.len() - 1)]);
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
        expected.extend((0..said.len()).map(variance));
    }

    /// What the pixel's own events and frames miss the predicted light by, seen through the sensor.
    fn judge(&mut self, step_ns: i64, measured: &Measured<'_>) {
        let Trust {
            params: TrustParams { floor, frame_weight, .. },
            said,
            expected,
            own,
            t_ns,
            log,
            seen,
            ..
        } = self;
        let Measured { sensor: Posed { model: sensor, .. }, extent, place: (x, y), events, frames, .. } =
            *measured;
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
            let after = said.partition_point(|said| said.t_ns < t_ns);
            let at = [after.checked_sub(1), Some(after)]
                .into_iter()
                .flatten()
                .filter(|k| *k < said.len())
                .min_by_key(|k| (said[*k].t_ns - t_ns).abs());
            at.filter(|k| (said[*k].t_ns - t_ns).abs() <= step_ns).map(|k| expected[k])
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
            let is_said = said.iter().any(|s| (frame.start_ns..frame.end_ns).contains(&s.t_ns));
            let (there, predicted) = (frame.dn - sensor.number.black_level, dn - sensor.number.black_level);
            if is_said && there > frame.sigma_dn && predicted > 0.0 {
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

/// Lets all hints within a window of time around each count as one where the posterior variance is asked for.
fn err_together(hints: &mut [Hint], within_ns: i64) {
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

/// Means of squares around instants that are asked in rising order; each weighs less the farther away it is,
/// and a little of one is in all of them.
struct Pool<'a> {
    /// Instants, squares, weights, in order of time.
    list: &'a [Miss],
    over_ms: f64,
    /// Those before are too far away for all instants to come.
    first: usize,
}

impl Pool<'_> {
    fn new(list: &[Miss], over: Duration) -> Pool<'_> {
        Pool { list, over_ms: over.ns() as f64 * 1e-6, first: 0 }
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
    use photocurrent_scene::film::Fired;
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
        doubted(late_ms, brighter, 0.0)
    }

    fn doubted(late_ms: f64, brighter: f64, doubt: f64) -> Vec<Hint> {
        let mut sensor = Sensor::unknown("test");
        sensor.comparator.threshold_on = Some(0.4);
        sensor.comparator.threshold_off = Some(0.4);
        sensor.frames.gain = Some(GAIN);
        let sensor = Posed { model: Model::of(&sensor), added: 0.0 };
        let light: Vec<(i64, f64)> =
            (0..=4800).map(|n| (n * 10_000, libm::exp(squares(n as f64 * 0.01)))).collect();
        let mut band = TrackBand::begin(0, 1);
        band.push(light.iter().map(|(t, i)| (*t, *i as f32)));
        let tracks = LogTracks::new(EXTENT, band, &Arc::new(Fired::new(std::iter::empty())));
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
        let say = |t_ns: i64| {
            Some(Said {
                t_ns,
                log: squares(t_ns as f64 * 1e-6 - late_ms + 12.0) + brighter,
                contradiction: Some(0.0),
                doubt,
            })
        };
        let measured = Measured {
            sensor: &sensor,
            extent: EXTENT,
            place: (0, 0),
            events: &events,
            frames: &frames,
            threshold: 0.4,
        };
        let mut hints = Vec::new();
        Trust::new(&TrustParams::default()).hints(
            say,
            &tracks,
            (0, 48_000_000),
            100_000,
            &measured,
            &mut hints,
        );
        hints
    }

    #[test]
    fn edges_that_come_a_little_late_leave_what_lies_between_them_trusted() {
        let hints = hints(0.03, 0.0);
        let between = |hint: &&Hint| (2.0..5.0).contains(&(hint.t_ns as f64 * 1e-6 % 6.0));
        let (flat, steep): (Vec<&Hint>, Vec<&Hint>) = hints.iter().partition(between);
        // Four edges of eight bound at least eighteen milliseconds of rest, asked ten times a millisecond.
        assert!(flat.len() > 180, "{}", flat.len());
        let worst = flat.iter().map(|hint| hint.variance).fold(0.0, f64::max);
        assert!(worst < 0.1 * 0.1, "{worst}");
        let floor = TrustParams::default().floor;
        // Where they are steep they are off by up to 0.12.
        let is_doubted = |hint: &&&Hint| {
            (hint.log_photocurrent - squares(hint.t_ns as f64 * 1e-6)).abs() < 1e-6
                || hint.variance > 2.0 * floor * floor
        };
        assert_eq!(steep.iter().filter(is_doubted).count(), steep.len());
    }

    #[test]
    fn what_is_in_doubt_is_no_more_exact_than_its_doubt() {
        let (plain, doubted) = (hints(0.0, 0.0), doubted(0.0, 0.0, 0.04));
        assert_eq!(plain.len(), doubted.len());
        assert!(
            plain.iter().any(|hint| hint.variance < 0.01)
                && doubted.iter().all(|hint| hint.variance >= TrustParams::default().together * 0.04)
        );
    }

    #[test]
    fn hints_narrow_a_variance_no_more_than_one_of_them() {
        let hints = hints(0.0, 0.0);
        // All lie within 48 ms: the information of all together is the mean one of a single hint.
        let information = hints.iter().map(|hint| 1.0 / hint.for_sigma).sum::<f64>();
        let single = hints.iter().map(|hint| TrustParams::default().together / hint.variance).sum::<f64>()
            / hints.len() as f64;
        assert!((information / single - 1.0).abs() < 1e-9, "{information} and {single}");
        // Those who trust them more hold the light more by them, and know it no better.
        for (caution, held, known) in [(0.25, 0.25, 1.0), (4.0, 4.0, 4.0)] {
            let mut taken = hints.clone();
            crate::refine::caution::take_care(&mut taken, caution);
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
        err_together(&mut hints, 200_000_000);
        assert_eq!([0, 500, 999].map(|n: usize| hints[n].for_sigma), [101.0, 201.0, 101.0]);
    }

    #[test]
    fn what_is_too_bright_over_exposures_is_not_trusted() {
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
