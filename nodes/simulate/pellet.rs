//! `simulate/pellet`: a small recording with truth: fast pellets over a textured background, seen by a described sensor.
//!
//! Round pellets fly straight and bounce off the borders; the background is smooth random texture. Light is known in closed form at every instant, is
//! sampled every few microseconds where a pellet passes, and goes through [`photocurrent_sensor::forward`]: events with in-pixel and off-pixel times, rolling-shutter
//! frames with noise as the description states it, and true frames at instants. Every pixel has its own random numbers, so row bands do not matter.
//!
//! Limits: grey, no photon noise in the event path, readout latency drawn per event (no queue). Light sampled in steps of [`LIGHT_STEP_NS`].

use super::camera::{Camera, Timing};
use super::scenes::pellet::{Flights, fits};
use photocurrent_core::events::Event;
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::random::Random;
use photocurrent_core::{
    Context, Decl, EventBand, EventStream, Exposure, Extent, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain, Meta, Node, NodeError,
    PortMetas, Rows, Sensor, TimeSpan, Truth,
};
use photocurrent_sensor::forward::LinearLight;
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

const WHO: &str = "simulate/pellet";

/// The node.
pub struct SimulatePellet {
    params: Params,
}

impl SimulatePellet {
    fn extent(&self) -> Extent {
        Extent { width: self.params.width, height: self.params.height }
    }

    fn timing(&self) -> Timing {
        Timing { frame_rate: self.params.frame_rate, exposure: self.params.exposure, latency_spread: self.params.latency_spread }
    }

    fn camera(&self, sensor: &Sensor, seed: u64) -> Result<Camera, NodeError> {
        let camera = Camera::new(sensor, &self.timing(), self.extent(), TimeSpan::new(0, self.params.duration.ns()), seed, WHO)?;
        if camera.halo() > 0 {
            return Err(NodeError::usage(format!("the description has effects that mix neighbouring pixels, and {WHO} simulates each pixel alone"))
                .hint("leave them out, or simulate with simulate/scene and simulate/sensor"));
        }
        self.check_brightness(sensor, &camera)?;
        Ok(camera)
    }

    /// Refuses a scene that is far beyond what the sensor can read.
    fn check_brightness(&self, sensor: &Sensor, camera: &Camera) -> Result<(), NodeError> {
        let saturation = sensor.frames.saturation_dn.unwrap_or(f64::INFINITY);
        let brightest = camera.exact_dn(self.params.pellet_photocurrent.max(self.params.background_high) * self.params.exposure.seconds());
        if brightest >= 2.0 * saturation {
            return Err(NodeError::usage(format!("the scene reads {brightest:.0} DN where the sensor saturates at {saturation:.0}"))
                .hint("shorten `exposure` or dim the scene")
                .param("exposure"));
        }
        Ok(())
    }

    /// The true frames that belong to captured ones.
    fn truth(&self, frames: &FramesMeta) -> Result<FramesMeta, NodeError> {
        let period = 1e9 / self.params.truth_rate.hz();
        let instants = (0..).map(|k| (f64::from(k) * period).round() as i64).take_while(|t| *t < self.params.duration.ns());
        Ok(FramesMeta {
            times: FrameTimes::new(instants.map(|t| Exposure::new(t, t + 1)).collect(), 0)?,
            scale: FrameScale::Nominal { exposure_ns: self.params.exposure.ns() },
            ..frames.clone()
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
        if !fits(params.radius, Extent { width: params.width, height: params.height }) {
            return Err(NodeError::usage(format!("a pellet of radius {} does not fit into {} x {} pixels", params.radius, params.width, params.height))
                .hint("make `radius` smaller, or `width` and `height` larger")
                .param("radius"));
        }
        Ok(SimulatePellet { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let camera = self.camera(inputs.sensor("sensor")?, 0)?;
        let truth = self.truth(&camera.frames)?;
        Ok(vec![Meta::Events(Arc::new(camera.events)), Meta::Frames(Arc::new(camera.frames)), Meta::Truth(Arc::new(truth))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let camera = self.camera(&input.sensor, cx.seed())?;
        let truth_meta = self.truth(&camera.frames)?;
        let scene = Scene::new(&self.params, cx.seed());
        let rows = cx.rows();
        cx.begin(rows.len() as u64, "rows");
        let simulate_row = |y: u32| -> Result<RowData, NodeError> {
            let mut row = RowData::new(y, &camera.frames, &truth_meta);
            for x in 0..self.params.width {
                let (t, current) = scene.light(x, y);
                let light = LinearLight::new(&t, &current);
                for (l, dn) in camera.pixel(x, y, &light, &light, &mut row.events)?.into_iter().enumerate() {
                    row.frames.row_mut(l, y)[x as usize] = dn as f32;
                }
                for l in 0..truth_meta.times.len() {
                    let charge = light.at(truth_meta.times.exposures[l].start.0) * self.params.exposure.seconds();
                    row.truth.row_mut(l, y)[x as usize] = camera.exact_dn(charge) as f32;
                }
            }
            cx.advance(1)?;
            Ok(row)
        };
        let simulated: Result<Vec<RowData>, NodeError> = rows.iter().into_par_iter().map(simulate_row).collect();
        let (mut events, mut frames, mut truth) = (
            Vec::new(),
            FrameBlock::zeros(0..camera.frames.times.len(), rows, camera.frames.row_values()),
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
            events: EventStream::in_memory(Arc::new(camera.events), band),
            frames: FrameSequence::in_memory(Arc::new(camera.frames), frames),
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

/// Pellets and background in closed form.
struct Scene {
    seed: u64,
    low: f64,
    high: f64,
    pellet: f64,
    flights: Flights,
    /// Centres of all pellets at each light step, one pellet after the other.
    centres: Vec<(f64, f64)>,
    pellets: usize,
}

/// Spacing of the background's random grid, pixels, and its weight: coarse relief with fine grain on it.
const OCTAVES: [(f64, f64); 3] = [(16.0, 0.55), (7.0, 0.3), (2.5, 0.15)];

impl Scene {
    fn new(params: &Params, seed: u64) -> Scene {
        let extent = Extent { width: params.width, height: params.height };
        let flights = Flights::new(params.pellets, params.radius, params.speed, extent, seed);
        let steps = params.duration.ns() / LIGHT_STEP_NS + 1;
        let centres = (0..steps).flat_map(|step| flights.centres(step * LIGHT_STEP_NS)).collect();
        Scene {
            seed,
            low: params.background_low,
            high: params.background_high,
            pellet: params.pellet_photocurrent,
            centres,
            pellets: params.pellets as usize,
            flights,
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

    /// The pixel's light as instants and photocurrents; one instant when nothing passes.
    fn light(&self, x: u32, y: u32) -> (Vec<i64>, Vec<f64>) {
        let background = self.background(x, y);
        let (mut times, mut light) = (Vec::new(), Vec::new());
        let (mut held, mut t) = (f64::NAN, 0);
        for centres in self.centres.chunks_exact(self.pellets) {
            let covered = self.flights.coverage(f64::from(x), f64::from(y), centres.iter().copied());
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

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::events::Polarity;
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
    fn effects_that_mix_neighbours_are_refused_and_not_left_out_silently() {
        let mut soft = sensor();
        soft.effects.insert("blur".into(), serde_json::json!({ "sigma": 1.0 }).as_object().unwrap().clone());
        assert!(SimulatePellet::build(small()).unwrap().camera(&soft, 0).err().unwrap().message.contains("mix neighbouring pixels"));
    }

    #[test]
    fn a_scene_far_beyond_saturation_is_refused() {
        let mut sensor = sensor();
        sensor.frames.saturation_dn = Some(100.0);
        let node = SimulatePellet::build(Params::default()).unwrap();
        assert!(node.camera(&sensor, 0).err().unwrap().message.contains("saturates at 100"));
    }
}
