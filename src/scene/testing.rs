//! Small recordings for tests: a texture of waves that drifts across an array, written out in closed form.

use crate::case::{Case, CaseFrames, PixelEvent, PixelEvents};
use crate::free::{PixelPrediction, PredictedEvent, PredictedFrame};
use crate::light::LogLight;
use crate::nominal::Nominal;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Exposure, Extent, FrameTimes, Sensor};
use photocurrent_sensor::conditional::{Conditional, Look, Quiet, Track, conditional};

/// Time between frames, ns; half of it is exposed.
const PERIOD_NS: i64 = 8_000_000;
/// Delay from row to row, ns.
const ROW_NS: i64 = 20_000;
/// Light is summed and compared this often, ns.
const STEP_NS: i64 = 100_000;

/// A sensor with thresholds of 0.2 and a gain of 1000 DN.
pub(crate) fn sensor() -> Sensor {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(30_000));
    sensor.front_end.alpha = Some(Duration::new(5_000_000));
    sensor.comparator.threshold_on = Some(0.2);
    sensor.comparator.threshold_off = Some(0.2);
    sensor.readout.latency_min = Some(Duration::new(1_000));
    sensor.frames.gain = Some(1000.0);
    sensor
}

/// Log photocurrent of the texture on a pixel: four waves that drift by 60 and -35 pixels a second.
pub(crate) fn log_light(x: f64, y: f64, t_ns: i64) -> f64 {
    let (x, y) = (x + 60e-9 * t_ns as f64, y - 35e-9 * t_ns as f64);
    let waves = [(0.61, 0.25, 0.3), (-0.29, 0.57, 1.1), (0.43, -0.49, 2.0), (1.01, -0.32, 0.7)];
    4.0 + 0.2 * waves.iter().map(|(a, b, c)| libm::sin(a * x + b * y + c)).sum::<f64>()
}

/// A recording of the texture with so many frames, without noise: events where the log light has moved by
/// 0.2, frames that collect it behind a rolling shutter.
pub(crate) fn texture(extent: Extent, frames: usize) -> Case {
    recorded(extent, frames, STEP_NS, log_light)
}

/// The same of stripes that drift as the texture does, with edges of 0.4 pixels to either side; the events
/// are within 10 us.
pub(crate) fn stripes(extent: Extent, frames: usize) -> Case {
    recorded(extent, frames, STEP_NS / 10, |x, y, t_ns| {
        let (x, y) = (x + 60e-9 * t_ns as f64, y - 35e-9 * t_ns as f64);
        let wave =
            |a: f64, b: f64, c: f64| libm::tanh(libm::sin(a * x + b * y + c) / (0.4 * libm::hypot(a, b)));
        4.0 + 0.3 * (wave(0.61, 0.25, 0.3) + wave(-0.29, 0.57, 1.1))
    })
}

/// A disc with the texture, 8 pixels around the middle of the array half way through, that drifts as the
/// texture does before a still ground of darker waves ([`ground`]); its edge is soft over a pixel or two.
pub(crate) fn disc(extent: Extent, frames: usize) -> Case {
    let middle_ns = PERIOD_NS * frames as i64 / 2;
    let middle = (0.5 * f64::from(extent.width - 1), 0.5 * f64::from(extent.height - 1));
    recorded(extent, frames, STEP_NS / 10, move |x, y, t_ns| {
        let t_s = 1e-9 * (t_ns - middle_ns) as f64;
        let radius = libm::hypot(x - middle.0 + 60.0 * t_s, y - middle.1 - 35.0 * t_s);
        let hidden = 0.5 - 0.5 * libm::tanh(radius - 8.0);
        libm::log(hidden * libm::exp(log_light(x, y, t_ns)) + (1.0 - hidden) * ground(x, y))
    })
}

/// Photocurrent of the ground behind a disc.
pub(crate) fn ground(x: f64, y: f64) -> f64 {
    libm::exp(3.4 + 0.1 * libm::sin(0.7 * x + 0.4 * y))
}

/// A recording of log light at a place, pixels, and an instant, ns.
fn recorded(extent: Extent, frames: usize, step_ns: i64, log_light: impl Fn(f64, f64, i64) -> f64) -> Case {
    let end_ns = PERIOD_NS * frames as i64;
    let exposures: Vec<Exposure> =
        (0..frames as i64).map(|l| Exposure::new(l * PERIOD_NS, l * PERIOD_NS + PERIOD_NS / 2)).collect();
    let times = FrameTimes::new(exposures, ROW_NS).expect("exposures are in order");
    let pixels = || (0..extent.height).flat_map(|y| (0..extent.width).map(move |x| (x, y)));
    let at = |(x, y): (u32, u32), t_ns: i64| log_light(x.into(), y.into(), t_ns);
    let events = pixels().map(|pixel| {
        let (mut events, mut reference) = (Vec::new(), at(pixel, 0));
        for t_in_ns in (0..end_ns).step_by(step_ns as usize) {
            let moved = at(pixel, t_in_ns) - reference;
            if moved.abs() >= 0.2 {
                events.push(PixelEvent {
                    t_in_ns,
                    t_off_ns: t_in_ns + 1_000,
                    polarity: if moved > 0.0 { 1 } else { -1 },
                });
                reference = at(pixel, t_in_ns);
            }
        }
        events
    });
    let collected = |(l, (x, y)): (usize, (u32, u32))| {
        let Exposure { start, end } = times.exposure(l, y);
        let middles = (start.0..end.0).step_by(STEP_NS as usize).map(|t| t + STEP_NS / 2);
        (1000.0 * middles.map(|t| libm::exp(at((x, y), t))).sum::<f64>() * (STEP_NS as f64 * 1e-9)) as f32
    };
    let dn: Vec<f32> =
        (0..frames).flat_map(|l| pixels().map(move |pixel| (l, pixel))).map(collected).collect();
    Case {
        extent,
        span: (0, end_ns),
        events: PixelEvents::new(events),
        has_t_in: true,
        t_resolution_ns: 1,
        frames: Some(CaseFrames::new(times.clone(), dn)),
        sensor: sensor(),
    }
}

/// A recording of 12 x 10 pixels, 7 frames.
pub(crate) fn case() -> Case {
    Case { span: (0, 60_000_000), ..texture(Extent { width: 12, height: 10 }, 7) }
}

/// The described sensor's predictions for pixels, with an additional event midway between events that the
/// recording does not have.
pub(crate) fn predicted(
    case: &Case,
    nominal: &Nominal,
    pixels: &[u32],
    light: &LogLight,
) -> Vec<PixelPrediction> {
    let times = &case.frames.as_ref().unwrap().times;
    let instants: Vec<i64> = (0..light.count).map(|k| light.instant(k)).collect();
    let of = |pixel: &u32| {
        let pixel = *pixel as usize;
        let log: Vec<f64> = light.log[pixel].iter().map(|u| f64::from(*u)).collect();
        let track = Track::new(&instants, &log, light.step_ns);
        let events = case.events.of_pixel(pixel);
        let site = case.site(pixel, 0);
        let between: Vec<i64> =
            events.windows(2).map(|two| i64::midpoint(two[0].t_in_ns, two[1].t_in_ns)).collect();
        let look = Look { site, track: &track, seen: None, events, frames: &[], quiet_ns: &between };
        let mut out = Conditional::default();
        conditional(nominal, &[], &look, &mut out);
        let event = |k: usize| PredictedEvent {
            t_ns: out.fired_ns[k],
            reference_ns: out.reference_ns[k],
            polarity: f64::from(events[k].polarity),
            threshold: 0.2,
            excess: out.excess[k],
            slope_per_s: libm::hypot(out.slope_per_s[k], out.slope_per_s[k - 1]),
            rise_per_s: f64::from(events[k].polarity) * out.slope_per_s[k],
        };
        let quiet = |quiet: &Quiet| PredictedEvent {
            t_ns: quiet.t_ns,
            reference_ns: quiet.reference_ns,
            polarity: 1.0,
            threshold: 0.2,
            excess: quiet.level - 0.2,
            slope_per_s: quiet.slope_per_s,
            rise_per_s: quiet.slope_per_s,
        };
        let row = case.pixel_place(pixel).1;
        let frame = |l: usize| {
            let exposure = times.exposure(l, row);
            let dn = nominal.number.of(track.collected_in(exposure));
            PredictedFrame {
                start_ns: exposure.start.0,
                end_ns: exposure.end.0,
                residual_dn: dn - case.dn(l, pixel),
                signal_dn: case.dn(l, pixel),
            }
        };
        PixelPrediction {
            low_pass: nominal.pixel.front_end,
            gain: nominal.number.gain,
            frames: (0..case.frame_count()).map(frame).collect(),
            events: (1..events.len()).map(event).collect(),
            quiet: out.quiet.iter().map(quiet).collect(),
        }
    };
    pixels.iter().map(of).collect()
}
