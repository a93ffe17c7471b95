//! `simulate/pellet`: a small recording with truth: fast pellets over a textured background, seen by a described sensor.
//!
//! Round pellets fly straight and bounce off the borders; the background is smooth random texture. Light is known in closed form at every instant, is
//! sampled every few microseconds where a pellet passes, and goes through [`photocurrent_sensor::forward`]: events with in-pixel and off-pixel times, rolling-shutter
//! frames with noise as the description states it, and true frames at instants. Every pixel has its own random numbers, so row bands do not matter.
//!
//! Limits: grey, no photon noise in the event path, readout latency drawn per event (no queue). Light sampled in steps of [`LIGHT_STEP_NS`].

use crate::pixel_events::{StepRule, clock_offset, left_out};
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::random::Random;
use photocurrent_core::{
    Context, Decl, EventBand, EventStream, EventsMeta, Exposure, Extent, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain, Meta, Node,
    NodeError, PortMetas, Rows, Sensor, TimeSpan, Truth,
};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::forward::{LinearLight, Pixel, PixelNoise, simulate_events};
use photocurrent_sensor::front_end::FrontEnd;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Light is sampled this often where it changes.
pub const LIGHT_STEP_NS: i64 = 10_000;

/// Parameters of `simulate/pellet`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Pixels in a row.
    #[schemars(range(min = 8, max = 4096))]
    pub width: u32,
    /// Rows.
    #[schemars(range(min = 8, max = 4096))]
    pub height: u32,
    /// Length of the recording.
    #[schemars(extend("x-min" = "1 ms", "x-max" = "10 s"))]
    pub duration: Duration,
    /// Captured frames per second.
    #[schemars(extend("x-min" = "1 Hz", "x-max" = "10 kHz"))]
    pub frame_rate: Rate,
    /// Exposure of a captured frame.
    #[schemars(extend("x-min" = "1 us"))]
    pub exposure: Duration,
    /// True frames per second.
    #[schemars(extend("x-min" = "1 Hz", "x-max" = "100 kHz"))]
    pub truth_rate: Rate,
    /// Number of pellets.
    #[schemars(range(min = 1, max = 100))]
    pub pellets: u32,
    /// Radius of a pellet, pixels.
    #[schemars(range(min = 0.5, max = 1000.0))]
    pub radius: f64,
    /// Speed of the fastest pellet, pixels per millisecond; the others are down to half as fast.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
    /// Photocurrent of a pellet.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub pellet_photocurrent: f64,
    /// Lowest photocurrent of the background.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub background_low: f64,
    /// Highest photocurrent of the background.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub background_high: f64,
    /// Mean of the random part of the readout latency, beyond the sensor's smallest.
    #[schemars(extend("x-min" = "0 ns"))]
    pub latency_spread: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            width: 96,
            height: 72,
            duration: Duration::new(60_000_000),
            frame_rate: Rate::new(120.0),
            exposure: Duration::new(6_500_000),
            truth_rate: Rate::new(1000.0),
            pellets: 3,
            radius: 4.0,
            speed: 4.0,
            pellet_photocurrent: 150.0,
            background_low: 15.0,
            background_high: 75.0,
            latency_spread: Duration::new(40_000),
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The sensor that looks at the scene.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Events with in-pixel and off-pixel times.
        events: EventStream,
        /// Captured frames.
        frames: FrameSequence,
        /// The picture at instants, scaled as a frame of the stated exposure.
        truth: Truth,
    }
}

/// The node.
pub struct SimulatePellet {
    params: Params,
}

impl SimulatePellet {
    fn extent(&self) -> Extent {
        Extent { width: self.params.width, height: self.params.height }
    }

    /// Exposures of the frames whose last row ends inside the recording.
    fn frame_times(&self, sensor: &Sensor) -> Result<FrameTimes, NodeError> {
        let row_time_ns = sensor.need(sensor.frames.row_time, "frames.row_time", "simulate/pellet")?.ns();
        let (exposure, period) = (self.params.exposure.ns(), 1e9 / self.params.frame_rate.hz());
        if exposure as f64 > period {
            return Err(NodeError::usage(format!("an exposure of {} does not fit the frame period of {:.0} us", self.params.exposure, period / 1e3))
                .note(format!("the period is one over `frame_rate = \"{}\"`", self.params.frame_rate))
                .hint("make `exposure` shorter or `frame_rate` lower")
                .param("exposure"));
        }
        let last_row = row_time_ns * i64::from(self.params.height - 1);
        let starts = (0..).map(|l| (f64::from(l) * period).round() as i64).take_while(|start| start + exposure + last_row <= self.params.duration.ns());
        let exposures: Vec<Exposure> = starts.map(|start| Exposure::new(start, start + exposure)).collect();
        if exposures.is_empty() {
            return Err(NodeError::usage(format!("no frame fits into {}", self.params.duration))
                .hint("make `duration` longer or `exposure` shorter")
                .param("duration"));
        }
        Ok(FrameTimes::new(exposures, row_time_ns)?)
    }

    fn metas(&self, sensor: &Sensor) -> Result<(EventsMeta, FramesMeta, FramesMeta), NodeError> {
        let extent = self.extent();
        let duration = self.params.duration.ns();
        let events = EventsMeta {
            extent,
            span: Some(TimeSpan::new(0, duration).moved(clock_offset(sensor)?.offset_ns)),
            has_t_in: true,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        let frames = FramesMeta { extent, channels: 1, times: self.frame_times(sensor)?, scale: FrameScale::Captured };
        let period = 1e9 / self.params.truth_rate.hz();
        let instants = (0..).map(|k| (f64::from(k) * period).round() as i64).take_while(|t| *t < duration);
        let truth = FramesMeta {
            times: FrameTimes::new(instants.map(|t| Exposure::new(t, t + 1)).collect(), 0)?,
            scale: FrameScale::Nominal { exposure_ns: self.params.exposure.ns() },
            ..frames.clone()
        };
        Ok((events, frames, truth))
    }

    fn pixel(&self, sensor: &Sensor) -> Result<Pixel, NodeError> {
        const WHO: &str = "simulate/pellet";
        if let Some(left_out) = left_out(sensor) {
            return Err(NodeError::usage(left_out).hint("simulate with a description that states only what is modelled"));
        }
        Ok(Pixel {
            front_end: FrontEnd {
                tau_0_s: sensor.need(sensor.front_end.tau_0, "front_end.tau_0", WHO)?.seconds(),
                alpha_s: sensor.need(sensor.front_end.alpha, "front_end.alpha", WHO)?.seconds(),
            },
            threshold_on: sensor.need(sensor.comparator.threshold_on, "comparator.threshold_on", WHO)?,
            threshold_off: sensor.need(sensor.comparator.threshold_off, "comparator.threshold_off", WHO)?,
            latency_ns: sensor.readout.latency_min.map_or(0, Duration::ns),
            latency_spread_ns: self.params.latency_spread.ns() as f64,
            refractory_ns: sensor.need(sensor.readout.refractory, "readout.refractory", WHO)?.ns(),
            // Light changes in pieces of LIGHT_STEP_NS; where it stands still, a step of any length is exact.
            max_step_ns: self.params.duration.ns(),
        })
    }
}

impl Node for SimulatePellet {
    const DECL: Decl = Decl {
        kind: "simulate/pellet",
        about: "A small recording with truth: fast pellets over a textured background, seen by a described sensor.",
        revision: 1,
        grain: Grain::Pixel,
        draws: true,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (1)-(5), forward"],
        example: r#"
[nodes.scene]
kind   = "simulate/pellet"
in     = { sensor = "sensor" }
params = { duration = "60 ms", frame_rate = "120 fps", truth_rate = "1 kHz", speed = 4.0 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.background_low > params.background_high {
            return Err(NodeError::usage(format!("the background goes from {} down to {}", params.background_low, params.background_high))
                .hint(format!("exchange them: `background_low = {:?}`, `background_high = {:?}`", params.background_high, params.background_low))
                .param("background_low"));
        }
        if 2.0 * params.radius + 1.0 >= f64::from(params.width.min(params.height)) {
            return Err(NodeError::usage(format!("a pellet of radius {} does not fit into {} x {} pixels", params.radius, params.width, params.height))
                .hint("make `radius` smaller, or `width` and `height` larger")
                .param("radius"));
        }
        Ok(SimulatePellet { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = inputs.sensor("sensor")?;
        let stated = [
            ("front_end.tau_0", sensor.front_end.tau_0.is_some()),
            ("front_end.alpha", sensor.front_end.alpha.is_some()),
            ("readout.refractory", sensor.readout.refractory.is_some()),
            ("frames.gain", sensor.frames.gain.is_some()),
            ("frames.row_time", sensor.frames.row_time.is_some()),
        ];
        sensor.need_all(&[StepRule::needs(sensor).as_slice(), &stated].concat(), "simulate/pellet")?;
        self.pixel(sensor)?;
        clock_offset(sensor)?;
        let (events, frames, truth) = self.metas(sensor)?;
        Ok(vec![Meta::Events(Arc::new(events)), Meta::Frames(Arc::new(frames)), Meta::Truth(Arc::new(truth))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let sensor = &*input.sensor;
        let (events_meta, frames_meta, truth_meta) = self.metas(sensor)?;
        let pixel = self.pixel(sensor)?;
        let scene = Scene::new(&self.params, cx.seed());
        let capture = Capture::new(sensor, &self.params)?;
        let offset = clock_offset(sensor)?;
        let rows = cx.rows();
        cx.begin(rows.len() as u64, "rows");
        let simulate_row = |y: u32| -> Result<RowData, NodeError> {
            let mut row = RowData::new(y, &frames_meta, &truth_meta);
            for x in 0..self.params.width {
                let (t, current) = scene.light(x, y);
                let light = LinearLight::new(&t, &current);
                if t.len() > 1 {
                    let mut noise =
                        ThresholdNoise { random: Random::new(cx.seed(), &[x.into(), y.into(), 1]), sigma: sensor.comparator.threshold_noise.unwrap_or(0.0) };
                    let fired = simulate_events(&pixel, &light, 0, self.params.duration.ns(), &mut noise);
                    for event in fired.iter().filter(|event| event.t_off_ns < self.params.duration.ns()) {
                        let mut stamps = [event.t_in_ns, event.t_off_ns];
                        offset.record(&mut stamps).map_err(|error| NodeError::failed(error.to_string()))?;
                        let polarity = if event.polarity > 0 { Polarity::On } else { Polarity::Off };
                        row.events.push(Event { x: x as u16, y: y as u16, polarity, t: stamps[1], t_in: Some(stamps[0]) });
                    }
                }
                let mut random = Random::new(cx.seed(), &[x.into(), y.into(), 2]);
                for l in 0..frames_meta.times.len() {
                    let integral = light.integral(frames_meta.times.exposure(l, y));
                    row.frames.row_mut(l, y)[x as usize] = capture.dn(integral, &mut random) as f32;
                }
                for l in 0..truth_meta.times.len() {
                    let integral = light.at(truth_meta.times.exposures[l].start.0) * self.params.exposure.seconds();
                    row.truth.row_mut(l, y)[x as usize] = capture.scale.of(integral) as f32;
                }
            }
            cx.advance(1)?;
            Ok(row)
        };
        let simulated: Result<Vec<RowData>, NodeError> = rows.iter().into_par_iter().map(simulate_row).collect();
        let (mut events, mut frames, mut truth) = (
            Vec::new(),
            FrameBlock::zeros(0..frames_meta.times.len(), rows, frames_meta.row_values()),
            FrameBlock::zeros(0..truth_meta.times.len(), rows, truth_meta.row_values()),
        );
        for (y, row) in rows.iter().zip(simulated?) {
            events.extend(row.events);
            copy_row(&row.frames, &mut frames, y);
            copy_row(&row.truth, &mut truth, y);
        }
        let mut band = EventBand::from_events(rows, events)?;
        band.t_in.get_or_insert_default();
        Ok(Out {
            events: EventStream::in_memory(Arc::new(events_meta), band),
            frames: FrameSequence::in_memory(Arc::new(frames_meta), frames),
            truth: Truth(FrameSequence::in_memory(Arc::new(truth_meta), truth)),
        })
    }
}

fn copy_row(from: &FrameBlock, to: &mut FrameBlock, y: u32) {
    for l in from.frames.clone() {
        to.row_mut(l, y).copy_from_slice(from.row(l, y));
    }
}

struct RowData {
    events: Vec<Event>,
    frames: FrameBlock,
    truth: FrameBlock,
}

impl RowData {
    fn new(y: u32, frames: &FramesMeta, truth: &FramesMeta) -> RowData {
        let block = |meta: &FramesMeta| FrameBlock::zeros(0..meta.times.len(), Rows { start: y, end: y + 1 }, meta.row_values());
        RowData { events: Vec::new(), frames: block(frames), truth: block(truth) }
    }
}

struct ThresholdNoise {
    random: Random,
    sigma: f64,
}

impl PixelNoise for ThresholdNoise {
    fn uniform(&mut self) -> f64 {
        self.random.uniform()
    }
    fn threshold_offset(&mut self) -> f64 {
        if self.sigma == 0.0 { 0.0 } else { self.sigma * self.random.normal() }
    }
}

/// From charge to a recorded digital number: shot noise, read noise, saturation, whole numbers.
struct Capture {
    scale: DigitalNumber,
    saturation_dn: f64,
    read_noise_dn: f64,
    /// Electrons per DN; 0 = no shot noise.
    electrons_per_dn: f64,
}

impl Capture {
    fn new(sensor: &Sensor, params: &Params) -> Result<Capture, NodeError> {
        let frames = &sensor.frames;
        let scale = DigitalNumber { black_level: frames.black_level_dn.unwrap_or(0.0), gain: sensor.need(frames.gain, "frames.gain", "simulate/pellet")? };
        let saturation_dn = frames.saturation_dn.unwrap_or(f64::INFINITY);
        let brightest = scale.of(params.pellet_photocurrent.max(params.background_high) * params.exposure.seconds());
        if brightest >= 2.0 * saturation_dn {
            return Err(NodeError::usage(format!("the scene reads {brightest:.0} DN where the sensor saturates at {saturation_dn:.0}"))
                .hint("shorten `exposure` or dim the scene")
                .param("exposure"));
        }
        let electrons_per_dn = frames.full_well_e.unwrap_or(0.0) / (saturation_dn - scale.black_level);
        Ok(Capture { scale, saturation_dn, read_noise_dn: frames.read_noise_dn.unwrap_or(0.0), electrons_per_dn })
    }

    fn dn(&self, integral: f64, random: &mut Random) -> f64 {
        let exact = self.scale.of(integral);
        // Photon counts are large enough here for the normal limit of the Poisson law.
        let shot = if self.electrons_per_dn > 0.0 { ((exact - self.scale.black_level) / self.electrons_per_dn).sqrt() * random.normal() } else { 0.0 };
        let read = self.read_noise_dn * random.normal();
        (exact + shot + read).round().clamp(0.0, self.saturation_dn)
    }
}

/// Pellets and background in closed form.
struct Scene {
    seed: u64,
    low: f64,
    high: f64,
    pellet: f64,
    radius: f64,
    /// Centres of all pellets at each light step, one pellet after the other.
    centres: Vec<(f64, f64)>,
    pellets: usize,
}

/// Spacing of the background's random grid, pixels, and its weight: coarse relief with fine grain on it.
const OCTAVES: [(f64, f64); 3] = [(16.0, 0.55), (7.0, 0.3), (2.5, 0.15)];

impl Scene {
    fn new(params: &Params, seed: u64) -> Scene {
        let mut random = Random::new(seed, &[0]);
        let (width, height) = (f64::from(params.width), f64::from(params.height));
        // Straight flights, reflected by the borders: start and velocity in pixels and pixels per nanosecond.
        let flights: Vec<[f64; 4]> = (0..params.pellets)
            .map(|_| {
                let speed = params.speed * (0.5 + 0.5 * random.uniform()) * 1e-6;
                let angle = std::f64::consts::TAU * random.uniform();
                [random.uniform() * width, random.uniform() * height, speed * libm::cos(angle), speed * libm::sin(angle)]
            })
            .collect();
        let steps = params.duration.ns() / LIGHT_STEP_NS + 1;
        let inside = |size: f64| size - 1.0 - params.radius;
        let centre = |step: i64, [x, y, vx, vy]: &[f64; 4]| {
            let t = (step * LIGHT_STEP_NS) as f64;
            (bounce(x + vx * t, params.radius, inside(width)), bounce(y + vy * t, params.radius, inside(height)))
        };
        let centres = (0..steps).flat_map(|step| flights.iter().map(move |flight| centre(step, flight))).collect();
        Scene {
            seed,
            low: params.background_low,
            high: params.background_high,
            pellet: params.pellet_photocurrent,
            radius: params.radius,
            centres,
            pellets: flights.len(),
        }
    }

    fn background(&self, x: u32, y: u32) -> f64 {
        let relief: f64 = OCTAVES
            .iter()
            .enumerate()
            .map(|(octave, (spacing, weight))| weight * self.smooth_noise(octave as u64, f64::from(x) / spacing, f64::from(y) / spacing))
            .sum();
        self.low + (self.high - self.low) * relief
    }

    /// Random values on a grid, blended smoothly between; in (0, 1).
    fn smooth_noise(&self, octave: u64, x: f64, y: f64) -> f64 {
        let blend = |f: f64| f * f * (3.0 - 2.0 * f);
        let (fx, fy) = (blend(x.fract()), blend(y.fract()));
        let node = |dx: u64, dy: u64| Random::new(self.seed, &[3 + octave, x as u64 + dx, y as u64 + dy]).uniform();
        let top = node(0, 0) * (1.0 - fx) + node(1, 0) * fx;
        let bottom = node(0, 1) * (1.0 - fx) + node(1, 1) * fx;
        top * (1.0 - fy) + bottom * fy
    }

    /// How much of a pixel pellets cover at a light step, 0 to 1; the rim is one pixel wide.
    fn coverage(&self, x: f64, y: f64, centres: &[(f64, f64)]) -> f64 {
        let reach = (self.radius + 0.5) * (self.radius + 0.5);
        let mut seen_through = 1.0;
        for (cx, cy) in centres {
            let squared = (x - cx) * (x - cx) + (y - cy) * (y - cy);
            if squared < reach {
                seen_through *= 1.0 - (self.radius + 0.5 - squared.sqrt()).min(1.0);
            }
        }
        1.0 - seen_through
    }

    /// The pixel's light as instants and photocurrents; one instant when nothing passes.
    fn light(&self, x: u32, y: u32) -> (Vec<i64>, Vec<f64>) {
        let background = self.background(x, y);
        let (mut times, mut light) = (Vec::new(), Vec::new());
        let (mut held, mut t) = (f64::NAN, 0);
        for centres in self.centres.chunks_exact(self.pellets) {
            let covered = self.coverage(f64::from(x), f64::from(y), centres);
            let now = background * (1.0 - covered) + self.pellet * covered;
            if now != held {
                // Where a constant stretch ends, its last instant closes it: light is linear between instants.
                if times.last().is_some_and(|last| *last < t - LIGHT_STEP_NS) {
                    times.push(t - LIGHT_STEP_NS);
                    light.push(held);
                }
                times.push(t);
                light.push(now);
                held = now;
            }
            t += LIGHT_STEP_NS;
        }
        (times, light)
    }
}

/// A coordinate that runs on for ever, reflected between two walls.
fn bounce(at: f64, low: f64, high: f64) -> f64 {
    let span = high - low;
    let phase = (at - low).rem_euclid(2.0 * span);
    low + if phase > span { 2.0 * span - phase } else { phase }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::testing;

    fn sensor() -> Sensor {
        let mut sensor = Sensor::unknown("test");
        sensor.front_end.tau_0 = Some(Duration::new(0));
        sensor.front_end.alpha = Some(Duration::new(0));
        sensor.comparator.threshold_on = Some(0.2);
        sensor.comparator.threshold_off = Some(0.2);
        sensor.readout.refractory = Some(Duration::new(0));
        sensor.frames.gain = Some(1000.0);
        sensor.frames.row_time = Some(Duration::new(30_000));
        sensor
    }

    fn small() -> Params {
        Params { width: 24, height: 16, duration: Duration::new(20_000_000), latency_spread: Duration::new(0), ..Params::default() }
    }

    fn run(params: Params, rows: Rows) -> Out {
        let node = SimulatePellet::build(params).unwrap();
        testing::with_context(rows, &["events", "frames", "truth"], |cx| node.run(In { sensor: Arc::new(sensor()) }, cx)).0.unwrap()
    }

    #[test]
    fn a_coordinate_bounces_between_its_walls() {
        assert_eq!([5.0, 12.0, 15.0, 21.0].map(|at| bounce(at, 2.0, 10.0)), [5.0, 8.0, 5.0, 5.0]);
    }

    #[test]
    fn bands_are_rows_of_the_whole() {
        let whole = run(small(), Rows { start: 0, end: 16 });
        let band = run(small(), Rows { start: 5, end: 9 });
        let rows = Rows { start: 5, end: 9 };
        assert_eq!(whole.events.read(rows).unwrap(), band.events.read(rows).unwrap());
        assert_eq!(whole.frames.read_rows(rows).unwrap(), band.frames.read_rows(rows).unwrap());
    }

    #[test]
    fn with_an_ideal_front_end_each_event_is_one_threshold_of_true_log_light() {
        let out = run(small(), Rows { start: 0, end: 16 });
        let band = out.events.read(out.events.rows()).unwrap();
        assert!(band.len() > 500, "{} events", band.len());
        let scene = Scene::new(&small(), 7);
        let mut checked = 0;
        for y in 0..16 {
            let row = band.row(y);
            let index = row.by_pixel(24);
            for x in 0..24_u32 {
                let (t, current) = scene.light(x, y);
                let light = LinearLight::new(&t, &current);
                let mut net = 0.0;
                for &k in index.pixel(x as usize) {
                    net += 0.2 * Polarity::from_bit(row.on[k]).sign();
                    // Within one light step the log is taken as linear: far below a hundredth of a threshold.
                    let change = libm::log(light.at(row.t[k]) / light.at(0));
                    assert!((net - change).abs() < 0.02, "({x}, {y}): {net} against {change}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 500);
    }

    #[test]
    fn a_clock_offset_moves_every_stamp_and_nothing_else() {
        let rows = Rows { start: 0, end: 16 };
        let mut late = sensor();
        late.effects.insert("clock_offset".into(), serde_json::json!({ "offset": "6 ms" }).as_object().unwrap().clone());
        let node = SimulatePellet::build(small()).unwrap();
        let moved = testing::with_context(rows, &["events"], |cx| node.run(In { sensor: Arc::new(late) }, cx)).0.unwrap().events;
        let plain = run(small(), rows).events;
        let (moved, plain) = (moved.read(rows).unwrap(), plain.read(rows).unwrap());
        assert!(moved.t.iter().zip(&plain.t).all(|(a, b)| a - b == 6_000_000) && moved.x == plain.x);
    }

    #[test]
    fn what_the_simulation_does_not_model_is_refused() {
        let mut leaky = sensor();
        leaky.effects.insert("leak_events".into(), serde_json::Map::new());
        assert!(SimulatePellet::build(small()).unwrap().pixel(&leaky).unwrap_err().message.contains("effects.leak_events"));
    }

    #[test]
    fn a_scene_far_beyond_saturation_is_refused() {
        let mut sensor = sensor();
        sensor.frames.saturation_dn = Some(100.0);
        assert!(Capture::new(&sensor, &Params::default()).err().unwrap().message.contains("saturates at 100"));
    }
}
