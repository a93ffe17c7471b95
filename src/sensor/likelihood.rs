//! How probable a pixel's events are, given its light: residuals that have an exact distribution when the model is right.
//!
//! The base noise is a threshold drawn anew at each reset, normal around the stated one. From the end of the blind time on, with D the voltage above the
//! reference and M+ and M- the largest D and -D so far, the pixel is still silent with probability `S = Q(z+) Q(z-)`, where `z = (M - threshold) / sigma` and Q is the
//! upper tail of the normal distribution; when one draw moves both thresholds, `S = Q(max(z+, z-))`. Hence, exactly:
//!
//! - `Lambda = -ln S` at the next event is exponential with mean 1, and `1 - S` is uniform ([`Interval::uniform`]);
//! - the sum of Lambda over all intervals, the silent end of the recording included, expects the number of events ([`Interval::compensator`]): time without events counts as much
//!   as events;
//! - an event's polarity is that of the side that is advancing ([`Interval::mark`]).
//!
//! Background events of a constant rate add to Lambda in proportion to time. A stamp that is only known to an interval gives a uniform number between the
//! values at the ends of that interval (randomised, so that it stays exact).
//!
//! The naive residual `(D - threshold) / sigma` at events does not have mean zero even when everything is right: low thresholds fire before the light turns round.
//!
//! Source: the time-rescaling theorem (Brown et al., Neural Computation 14, 2002) with the threshold's normal distribution. Limits: noise of the voltage itself is not
//! modelled; light that was fitted to the same events makes residuals too small.

use crate::map::{MapEvent, MapSensor, ramp_voltage};
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;

/// Voltage is followed in steps of at most this, ns.
const STEP_NS: i64 = 20_000;
/// Below this, a survival is taken as this: its logarithm is needed.
const LEAST_SURVIVAL: f64 = 1e-300;

/// What is random in a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseNoise {
    /// Standard deviation of a threshold at each reset, natural-log units, positive.
    pub sigma: f64,
    /// Does one draw move both thresholds? Else each has its own.
    pub shared: bool,
    /// Background events of both polarities together, Hz.
    pub background_hz: f64,
    /// Width of a stamp's interval, around the stamp, ns; 0 = exact.
    pub stamp_width_ns: i64,
}

/// What one interval has of its own, beyond what the sensor says: the thresholds of that moment, what the reset left, and what happens to the reference since then.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Since {
    /// ON and OFF threshold, natural-log units, both positive.
    pub thresholds: [f64; 2],
    /// The reference is this much higher than the voltage at the reset, natural-log units.
    pub left: f64,
    /// The reference falls by this much a second: a leak.
    pub drift_per_s: f64,
    /// The voltage steps at these instants (ns, rising) by so much.
    pub impulses: Vec<(i64, f64)>,
    /// From when on drift and impulses count, ns.
    pub reset_ns: i64,
}

impl Since {
    /// What the comparator sees beyond the voltage at an instant.
    fn added(&self, t_ns: i64) -> f64 {
        let drift = self.drift_per_s * f64::max((t_ns - self.reset_ns) as f64 * 1e-9, 0.0);
        let by_impulses: f64 =
            self.impulses.iter().filter(|(impulse_ns, _)| *impulse_ns >= self.reset_ns && *impulse_ns < t_ns).map(|(_, change)| change).sum();
        drift + by_impulses - self.left
    }
}

/// From one arming of the pixel to its next event, or to the end of the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// When the pixel was armed, ns.
    pub armed_ns: i64,
    /// When it fired, or the end, ns.
    pub end_ns: i64,
    /// Number of the event that ends it; none for the silent end.
    pub event: Option<usize>,
    /// Lambda: expects 1 event.
    pub compensator: f64,
    /// Uniform between 0 and 1 under the model; of a silent end, what has been used up of it.
    pub uniform: f64,
    /// Probability of the event's polarity, given that there was an event then; 1 for the silent end.
    pub mark: f64,
}

/// The intervals of one pixel's events (in order of in-pixel time) under `log_light` at `t_ns`, linear between and constant beyond.
///
/// An event inside the blind time of the one before has an interval of no length: it counts as an event with compensator 0.
///
/// # Panics
/// When there is no knot of light.
pub fn intervals(light: (&[i64], &[f64]), sensor: &MapSensor, noise: &BaseNoise, events: &[MapEvent], span: (i64, i64), random: &mut Random) -> Vec<Interval> {
    let usual = Since { thresholds: [sensor.threshold_on, sensor.threshold_off], reset_ns: i64::MAX, ..Since::default() };
    intervals_since(light, sensor, noise, events, |_| &usual, span, random)
}

/// The same with what each interval has of its own: `since` gives it for the interval before an event (by its number), and of the silent end (by the number of events).
///
/// # Panics
/// When there is no knot of light.
pub fn intervals_since<'a>(
    (t_ns, log_light): (&[i64], &[f64]),
    sensor: &MapSensor,
    noise: &BaseNoise,
    events: &[MapEvent],
    since: impl Fn(usize) -> &'a Since,
    (start_ns, end_ns): (i64, i64),
    random: &mut Random,
) -> Vec<Interval> {
    let mut pixel = Pixel { light: Light { t_ns, log_light, at: 0 }, sensor, now_ns: start_ns, voltage: 0.0 };
    pixel.voltage = pixel.light.at(start_ns);
    let mut reference = pixel.voltage;
    let mut armed_ns = start_ns;
    let mut found = Vec::with_capacity(events.len() + 1);
    for (k, event) in events.iter().enumerate() {
        let own = since(k);
        let mut watch = Watch::new(noise, own, reference);
        let half = noise.stamp_width_ns / 2;
        pixel.go_to(armed_ns, |_, _| {});
        let (before, after) = (i64::max(event.t_in_ns - half, armed_ns), i64::max(event.t_in_ns + half, armed_ns));
        watch.see(armed_ns, pixel.voltage);
        pixel.go_to(before, |t, voltage| watch.see(t, voltage));
        let first = watch;
        let mut at_stamp = watch;
        if after > before {
            // What comes after the stamp belongs to this interval only as far as the stamp is uncertain.
            let mut beyond = pixel.clone();
            beyond.go_to(event.t_in_ns, |t, voltage| watch.see(t, voltage));
            at_stamp = watch;
            beyond.go_to(after, |t, voltage| watch.see(t, voltage));
        }
        let (low, high) = (first.survival(before - armed_ns), watch.survival(after - armed_ns));
        let survival = low + (high - low) * random.uniform();
        found.push(Interval {
            armed_ns,
            end_ns: event.t_in_ns,
            event: Some(k),
            compensator: -libm::log(f64::max(survival, LEAST_SURVIVAL)),
            uniform: 1.0 - survival,
            mark: at_stamp.mark(event.polarity),
        });
        let latch_ns = i64::max(event.t_off_ns + sensor.refractory_ns, event.t_in_ns);
        pixel.go_to(event.t_in_ns, |_, _| {});
        let fired = if event.polarity > 0 { own.thresholds[0] } else { -own.thresholds[1] };
        pixel.go_to(latch_ns, |_, _| {});
        reference = if sensor.reset == Reset::Resample { pixel.voltage } else { reference + fired - own.added(event.t_in_ns) };
        armed_ns = latch_ns;
    }
    if armed_ns < end_ns {
        let mut watch = Watch::new(noise, since(events.len()), reference);
        pixel.go_to(armed_ns, |_, _| {});
        watch.see(armed_ns, pixel.voltage);
        pixel.go_to(end_ns, |t, voltage| watch.see(t, voltage));
        let survival = watch.survival(end_ns - armed_ns);
        let compensator = -libm::log(f64::max(survival, LEAST_SURVIVAL));
        found.push(Interval { armed_ns, end_ns, event: None, compensator, uniform: 1.0 - survival, mark: 1.0 });
    }
    found
}

/// The largest distance between the distribution of numbers and the uniform one (Kolmogorov and Smirnov); sorts them. 0 for none.
///
/// ```
/// use photocurrent_sensor::likelihood::ks_uniform;
/// assert_eq!(ks_uniform(&mut [0.75, 0.25]), 0.25);
/// assert_eq!(ks_uniform(&mut [1.0, 1.0]), 1.0);
/// ```
pub fn ks_uniform(numbers: &mut [f64]) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let n = numbers.len() as f64;
    let gap = |(k, u): (usize, &f64)| f64::max(u - k as f64 / n, (k + 1) as f64 / n - u);
    numbers.iter().enumerate().map(gap).fold(0.0, f64::max)
}

/// Upper tail of the standard normal distribution.
///
/// ```
/// use photocurrent_sensor::likelihood::normal_tail;
/// assert!((normal_tail(0.0) - 0.5).abs() < 1e-16 && (normal_tail(1.959964) - 0.025).abs() < 1e-8);
/// ```
pub fn normal_tail(z: f64) -> f64 {
    0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2)
}

#[derive(Clone, Copy)]
struct Light<'a> {
    t_ns: &'a [i64],
    log_light: &'a [f64],
    at: usize,
}

impl Light<'_> {
    fn at(&mut self, t: i64) -> f64 {
        let (times, values) = (self.t_ns, self.log_light);
        while self.at + 1 < times.len() && times[self.at + 1] <= t {
            self.at += 1;
        }
        match times.get(self.at + 1) {
            Some(&next) if t > times[self.at] => {
                values[self.at] + (values[self.at + 1] - values[self.at]) * (t - times[self.at]) as f64 / (next - times[self.at]) as f64
            }
            _ => values[self.at],
        }
    }

    /// The first knot after `t`.
    fn next_knot(&self, t: i64) -> i64 {
        self.t_ns[self.at..].iter().copied().find(|&knot| knot > t).unwrap_or(i64::MAX)
    }
}

#[derive(Clone)]
struct Pixel<'a> {
    light: Light<'a>,
    sensor: &'a MapSensor,
    now_ns: i64,
    voltage: f64,
}

impl Pixel<'_> {
    /// Lets time pass until `t_ns`, reporting the voltage after every step; does nothing when it has passed.
    fn go_to(&mut self, t_ns: i64, mut report: impl FnMut(i64, f64)) {
        while self.now_ns < t_ns {
            let first = self.light.at(self.now_ns);
            let next = t_ns.min(self.light.next_knot(self.now_ns)).min(self.now_ns + STEP_NS);
            let last = self.light.at(next);
            self.voltage = ramp_voltage(&self.sensor.front_end, self.voltage, first, last, (next - self.now_ns) as f64 * 1e-9);
            self.now_ns = next;
            report(next, self.voltage);
        }
    }
}

/// How near both thresholds have been since the pixel was armed.
#[derive(Clone, Copy)]
struct Watch<'a> {
    noise: BaseNoise,
    since: &'a Since,
    reference: f64,
    /// The largest voltage above the reference, and the largest below it.
    most: [f64; 2],
    /// What they were a step earlier, and how long that step was.
    before: [f64; 2],
    now_ns: i64,
    step_ns: i64,
}

impl<'a> Watch<'a> {
    fn new(noise: &BaseNoise, since: &'a Since, reference: f64) -> Watch<'a> {
        let none = [f64::NEG_INFINITY; 2];
        Watch { noise: *noise, since, reference, most: none, before: none, now_ns: i64::MIN, step_ns: 0 }
    }

    fn see(&mut self, t_ns: i64, voltage: f64) {
        let change = voltage - self.reference + self.since.added(t_ns);
        self.before = self.most;
        self.most = [f64::max(self.most[0], change), f64::max(self.most[1], -change)];
        self.step_ns = if self.now_ns == i64::MIN { 0 } else { t_ns - self.now_ns };
        self.now_ns = t_ns;
    }

    fn z(&self, most: &[f64; 2]) -> [f64; 2] {
        std::array::from_fn(|side| (most[side] - self.since.thresholds[side]) / self.noise.sigma)
    }

    fn survival(&self, waited_ns: i64) -> f64 {
        let [on, off] = self.z(&self.most);
        let silent = if self.noise.shared { normal_tail(f64::max(on, off)) } else { normal_tail(on) * normal_tail(off) };
        silent * libm::exp(-self.noise.background_hz * waited_ns.max(0) as f64 * 1e-9)
    }

    /// Probability that the event that comes now is of `polarity`, by the hazards over the last step.
    fn mark(&self, polarity: i8) -> f64 {
        let (now, before) = (self.z(&self.most), self.z(&self.before));
        let used = |side: usize| {
            let (was, is) = (normal_tail(before[side]), normal_tail(now[side]));
            f64::max(libm::log(f64::max(was, LEAST_SURVIVAL)) - libm::log(f64::max(is, LEAST_SURVIVAL)), 0.0)
        };
        let background = 0.5 * self.noise.background_hz * self.step_ns as f64 * 1e-9;
        let hazards = [used(0) + background, used(1) + background];
        let sum = hazards[0] + hazards[1];
        if sum > 0.0 { hazards[usize::from(polarity < 0)] / sum } else { 0.5 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::{LOG_STEP, LinearLight, Pixel as ForwardPixel, PixelNoise, simulate_events};
    use crate::front_end::FrontEnd;

    const SENSOR: MapSensor = MapSensor {
        front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 5e-3 },
        threshold_on: 0.2,
        threshold_off: 0.22,
        reset: Reset::Resample,
        refractory_ns: 60_000,
        gain: 1.0,
        black_level_dn: 0.0,
        saturation_dn: f64::INFINITY,
    };
    const SPAN: (i64, i64) = (0, 4_000_000_000);

    struct Noise(Random, f64);

    impl PixelNoise for Noise {
        fn threshold_offset(&mut self) -> f64 {
            self.1 * self.0.normal()
        }
    }

    fn light() -> (Vec<i64>, Vec<f64>) {
        let t: Vec<i64> = (0..=16_000).map(|k| k * 250_000).collect();
        let u = t.iter().map(|&t| {
            let s = t as f64 * 1e-9;
            4.0 + 0.5 * libm::sin(60.0 * s) + 0.4 * libm::sin(37.0 * s + 1.0) + 0.2 * libm::sin(171.0 * s)
        });
        let u = u.collect();
        (t, u)
    }

    /// Events of the simulator, which is another program text than the residuals: light linear instead of log-linear, crossings solved for.
    fn events(sigma: f64, seed: u64) -> Vec<MapEvent> {
        let (t, u) = light();
        let i: Vec<f64> = u.iter().map(|u| libm::exp(*u)).collect();
        let pixel = ForwardPixel {
            front_end: SENSOR.front_end,
            threshold_on: SENSOR.threshold_on,
            threshold_off: SENSOR.threshold_off,
            latency_ns: 1000,
            latency_spread_ns: 0.0,
            refractory_ns: SENSOR.refractory_ns,
            log_step: LOG_STEP,
        };
        let fired = simulate_events(&pixel, &LinearLight::new(&t, &i), SPAN.0, SPAN.1, &mut Noise(Random::new(seed, &[]), sigma));
        fired.iter().map(|event| MapEvent { t_in_ns: event.t_in_ns, t_off_ns: event.t_off_ns, polarity: event.polarity, is_lone: false }).collect()
    }

    fn noise(sigma: f64) -> BaseNoise {
        BaseNoise { sigma, shared: true, background_hz: 0.0, stamp_width_ns: 0 }
    }

    fn found(sensor: &MapSensor, noise: &BaseNoise, events: &[MapEvent]) -> Vec<Interval> {
        let (t, u) = light();
        intervals((&t, &u), sensor, noise, events, SPAN, &mut Random::new(3, &[]))
    }

    fn ks(found: &[Interval]) -> f64 {
        let mut uniform: Vec<f64> = found.iter().filter(|interval| interval.event.is_some()).map(|interval| interval.uniform).collect();
        ks_uniform(&mut uniform)
    }

    #[test]
    fn residuals_are_uniform_when_the_model_is_right_and_not_when_it_is_wrong() {
        let sigma = 0.02;
        let all: Vec<Vec<MapEvent>> = (0..4).map(|seed| events(sigma, seed)).collect();
        let together = |sensor: &MapSensor, sigma: f64| all.iter().flat_map(|events| found(sensor, &noise(sigma), events)).collect::<Vec<Interval>>();
        let right = together(&SENSOR, sigma);
        let events: usize = all.iter().map(Vec::len).sum();
        assert!(events > 1500, "{events}");
        // 1.63 over the root of n is exceeded once in a hundred times.
        let limit = 1.63 / libm::sqrt(events as f64);
        assert!(ks(&right) < limit, "{} of {limit}", ks(&right));
        assert!(ks(&together(&SENSOR, 2.0 * sigma)) > 2.0 * limit);
        assert!(ks(&together(&MapSensor { threshold_on: 0.21, ..SENSOR }, sigma)) > 2.0 * limit);
        assert!(ks(&together(&MapSensor { refractory_ns: 400_000, ..SENSOR }, sigma)) > 2.0 * limit);
        // Time without events counts: all intervals together expect as many events as there are.
        let expected: f64 = right.iter().map(|interval| interval.compensator).sum();
        assert!((expected - events as f64).abs() < 3.0 * libm::sqrt(events as f64), "{expected} for {events}");
        // The side that advances is the one that fires.
        assert!(right.iter().all(|interval| interval.mark > 0.5));
    }

    #[test]
    fn a_leak_and_thresholds_of_the_moment_are_uniform_when_they_are_stated() {
        // The light stands still: a reference that falls at a constant rate reaches a threshold drawn at each reset after (threshold / rate), in closed form.
        let (rate, sigma) = (8.0, 0.02);
        let threshold = |k: usize| 0.2 + 0.05 * (k % 3) as f64;
        let mut random = Random::new(9, &[]);
        let (mut events, mut all, mut reset_ns) = (Vec::new(), Vec::new(), 0_i64);
        for k in 0..2000 {
            let since = Since { thresholds: [threshold(k), 0.3], drift_per_s: rate, left: 0.03, reset_ns, ..Since::default() };
            all.push(since);
            let drawn = threshold(k) + sigma * random.normal();
            let t_in_ns = reset_ns + ((drawn + 0.03) / rate * 1e9) as i64;
            events.push(MapEvent { t_in_ns, t_off_ns: t_in_ns, polarity: 1, is_lone: false });
            reset_ns = t_in_ns;
        }
        all.push(Since { thresholds: [0.2, 0.3], drift_per_s: rate, reset_ns, ..Since::default() });
        let (t, u) = ([0_i64], [4.0]);
        let sensor = MapSensor { refractory_ns: 0, ..SENSOR };
        let with = |since: &[Since]| intervals_since((&t, &u), &sensor, &noise(sigma), &events, |k| &since[k], (0, reset_ns), &mut Random::new(3, &[]));
        let limit = 1.63 / libm::sqrt(events.len() as f64);
        assert!(ks(&with(&all)) < limit, "{} of {limit}", ks(&with(&all)));
        let slower: Vec<Since> = all.iter().map(|since| Since { drift_per_s: 0.98 * rate, ..since.clone() }).collect();
        assert!(ks(&with(&slower)) > 2.0 * limit);
        // An impulse stands for the drift of the whole interval.
        let pushed: Vec<Since> = all
            .iter()
            .zip(&events)
            .map(|(since, event)| Since {
                drift_per_s: 0.0,
                impulses: vec![(event.t_in_ns - 1, rate * (event.t_in_ns - since.reset_ns) as f64 * 1e-9)],
                ..since.clone()
            })
            .collect();
        assert!(ks(&with(&pushed)) < limit);
    }

    #[test]
    fn rounded_stamps_stay_uniform_when_that_is_stated() {
        let (sigma, step_ns) = (0.004, 300_000);
        let rounded = |seed: u64| {
            let mut events = events(sigma, seed);
            for event in &mut events {
                event.t_in_ns = (event.t_in_ns as f64 / step_ns as f64).round() as i64 * step_ns;
            }
            events
        };
        let all: Vec<Vec<MapEvent>> = (10..16).map(rounded).collect();
        let with = |noise: BaseNoise| all.iter().flat_map(|events| found(&SENSOR, &noise, events)).collect::<Vec<Interval>>();
        let limit = 1.63 / libm::sqrt(all.iter().map(Vec::len).sum::<usize>() as f64);
        let stated = ks(&with(BaseNoise { stamp_width_ns: step_ns, ..noise(sigma) }));
        let unstated = ks(&with(noise(sigma)));
        assert!(stated < limit && unstated > 1.5 * limit, "{stated} and {unstated} of {limit}");
    }

    #[test]
    fn background_events_fill_quiet_times() {
        // No light changes: only the background fires, at its rate.
        let (t, u) = ([0_i64], [4.0]);
        let rate = 25.0;
        let mut random = Random::new(5, &[]);
        let mut now = 0.0;
        let mut events = Vec::new();
        loop {
            now += random.exponential() / rate;
            let t_in_ns = (now * 1e9) as i64;
            if t_in_ns >= 40_000_000_000 {
                break;
            }
            events.push(MapEvent { t_in_ns, t_off_ns: t_in_ns, polarity: if random.uniform() < 0.5 { 1 } else { -1 }, is_lone: false });
        }
        let sensor = MapSensor { refractory_ns: 0, ..SENSOR };
        let noise = BaseNoise { background_hz: rate, ..noise(0.02) };
        let found = intervals((&t, &u), &sensor, &noise, &events, (0, 40_000_000_000), &mut random);
        assert!(ks(&found) < 1.63 / libm::sqrt(events.len() as f64));
        assert!(found.iter().take(events.len()).all(|interval| (interval.mark - 0.5).abs() < 1e-9));
    }
}
