//! `simulate/sensor`: what a described sensor records of a given light: events and frames.
//!
//! The light of every pixel, linear between its instants, goes through the forward model
//! ([`photocurrent_sensor::forward`]): logarithm, low-pass, comparator, readout latency, refractory period,
//! reset, with every effect that the description's `[effects]` names; and through the exposure of each frame.
//! Crossing times are solved, not stepped, so events do not clump on the light's instants.
//!
//! Light of colours or behind a mosaic gives such frames; with `pixels_per_event_pixel`, each event pixel
//! lies on several pixels and sees their mixture ([`super::pooled`]), by the weights that the description
//! states (`optics.event_weights`).
//!
//! Works row by row, with as many rows of halo as the effects that mix neighbours need. An effect that
//! couples all pixels (a queue on the readout bus) makes it work on the whole array instead, in several
//! passes ([`super::load`]). Limit: light from further than [`HALO_ROWS`] rows away is refused.

use super::camera::{Camera, Timing};
use super::load;
use super::pixel_light::PixelLight;
use super::pooled::Pooling;
use photocurrent_core::events::Event;
use photocurrent_core::light::{Light, LightMeta};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::{
    Context, Decl, EventBand, EventStream, Extent, FrameBlock, FrameSequence, Grain, Meta, Node, NodeError,
    PortMetas, Rows, Sensor,
};
use photocurrent_sensor::effects::Kernel;
use photocurrent_sensor::forward::neighbours::joined;
use photocurrent_solve::co_located::event_weights;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Rows above and below that effects may reach.
pub const HALO_ROWS: u32 = 16;

/// Rows whose light is in memory at once when the array is simulated as a whole.
const BLOCK_ROWS: u32 = 64;

/// Parameters of `simulate/sensor`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Captured frames per second.
    #[schemars(extend("x-min" = "1 Hz", "x-max" = "10 kHz"))]
    pub frame_rate: Rate,
    /// Exposure of a captured frame.
    #[schemars(extend("x-min" = "1 us"))]
    pub exposure: Duration,
    /// Mean of the random part of the readout latency, beyond the sensor's smallest.
    #[schemars(extend("x-min" = "0 ns"))]
    pub latency_spread: Duration,
    /// Pixels of the light, and of the frames, along the side of an event pixel; it sees their mixture.
    #[schemars(range(min = 1, max = 16))]
    pub pixels_per_event_pixel: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            frame_rate: Rate::new(120.0),
            exposure: Duration::new(6_500_000),
            latency_spread: Duration::new(40_000),
            pixels_per_event_pixel: 1,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The light on the sensor.
        light: Light,
        /// The sensor that looks at it.
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
    }
}

/// The node.
pub struct SimulateSensor {
    params: Params,
}

const WHO: &str = "simulate/sensor";

impl SimulateSensor {
    fn pooling(&self, sensor: &Sensor) -> Result<Pooling, NodeError> {
        Ok(Pooling { ratio: self.params.pixels_per_event_pixel, seen: event_weights(sensor)? })
    }

    fn camera(
        &self,
        light: &LightMeta,
        sensor: &Sensor,
        seed: u64,
    ) -> Result<(Camera, Option<Kernel>), NodeError> {
        let timing = Timing {
            frame_rate: self.params.frame_rate,
            exposure: self.params.exposure,
            latency_spread: self.params.latency_spread,
        };
        let extents = (self.pooling(sensor)?.extent(light)?, light.extent, light.colour);
        let camera = Camera::new(sensor, &timing, extents, light.span, seed, WHO)?;
        if camera.halo() > HALO_ROWS {
            return Err(NodeError::usage(format!(
                "the effects of the description reach {} rows, {WHO} at most {HALO_ROWS}",
                camera.halo()
            ))
            .hint("make the blur or shift smaller"));
        }
        let kernel = joined(camera.effects()).map_err(|why| {
            NodeError::usage(why.to_string()).hint("leave one of them out of the description")
        })?;
        Ok((camera, kernel))
    }
}

impl Node for SimulateSensor {
    const DECL: Decl = Decl {
        kind: "simulate/sensor",
        about: "What a described sensor records of a given light: events and frames, with the effects of \
                its description.",
        revision: 3,
        grain: Grain::Row { halo: HALO_ROWS },
        draws: true,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (1)-(5), forward"],
        example: r#"
[nodes.recording]
kind   = "simulate/sensor"
in     = { light = "scene.light", sensor = "sensor" }
params = { frame_rate = "120 fps", exposure = "6.5 ms" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(SimulateSensor { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (camera, _) = self.camera(inputs.light("light")?, inputs.sensor("sensor")?, 0)?;
        Ok(vec![Meta::Events(Arc::new(camera.events)), Meta::Frames(Arc::new(camera.frames))])
    }

    fn grain(&self, inputs: &PortMetas) -> Grain {
        let camera = inputs.light("light").and_then(|light| self.camera(light, inputs.sensor("sensor")?, 0));
        match camera {
            Ok((camera, _)) if camera.couples().is_some() => Grain::Whole,
            _ => Self::DECL.grain,
        }
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (mut camera, kernel) = self.camera(&input.light.meta, &input.sensor, cx.seed())?;
        let rows = cx.rows();
        // A description that a node worked out is planned as the one that it was given: what couples pixels
        // may be in it only now.
        if camera.couples().is_some() && input.light.rows() != input.light.meta.extent.rows() {
            return Err(NodeError::failed(
                "the description couples all pixels, and that was not known when \
                                          the recording was cut into row bands",
            )
            .hint("write the description to a file, and read it with read/sensor"));
        }
        let block_rows = if camera.couples().is_some() { BLOCK_ROWS } else { rows.len() as u32 };
        let seen = self.pooling(&input.sensor)?.light(&input.light)?;
        load::settle(&mut camera, kernel.as_ref(), &seen, block_rows, cx)?;
        cx.begin(rows.len() as u64, "rows");
        let scenery = Scenery {
            seen,
            own: (!self.pooling(&input.sensor)?.is_plain(&input.light.meta)).then_some(input.light),
        };
        let frame_rows = scenery.frame_rows(&camera, rows);
        let (mut events, mut frames) = (
            Vec::new(),
            FrameBlock::zeros(0..camera.frames.times.len(), frame_rows, camera.frames.row_values()),
        );
        for block in rows.bands(block_rows) {
            for (row_events, row_frames) in simulate_rows(&camera, kernel.as_ref(), &scenery, block, cx)? {
                events.extend(row_events);
                for (l, y) in
                    row_frames.frames.clone().flat_map(|l| row_frames.rows.iter().map(move |y| (l, y)))
                {
                    frames.row_mut(l, y).copy_from_slice(row_frames.row(l, y));
                }
            }
        }
        let mut band = EventBand::from_events(rows, events)?;
        band.t_in.get_or_insert_default();
        Ok(Out {
            events: EventStream::in_memory(Arc::new(camera.events), band),
            frames: FrameSequence::in_memory(Arc::new(camera.frames), frames),
        })
    }
}

/// Pixels of a row that one thread simulates at a time.
const SHARED_OUT: u32 = 64;

/// What the camera looks at.
struct Scenery {
    /// The light of event pixels.
    seen: Light,
    /// The light of frame pixels, when it is another.
    own: Option<Light>,
}

impl Scenery {
    /// Rows of the frames that lie on rows of the events.
    fn frame_rows(&self, camera: &Camera, rows: Rows) -> Rows {
        let ratio = camera.frames.extent.height / camera.events.extent.height;
        Rows { start: rows.start * ratio, end: rows.end * ratio }
    }
}

/// Events and frame values of some rows of the events, each row by itself.
fn simulate_rows(
    camera: &Camera,
    kernel: Option<&Kernel>,
    scenery: &Scenery,
    rows: Rows,
    cx: &Context,
) -> Result<Vec<(Vec<Event>, FrameBlock)>, NodeError> {
    let extent = camera.events.extent;
    let light = scenery.seen.read(rows.with_halo(camera.halo(), extent.rows()))?;
    let own = scenery.own.as_ref().map(|own| own.read(scenery.frame_rows(camera, rows))).transpose()?;
    let values = Extent { width: camera.frames.row_values() as u32, ..camera.frames.extent };
    let simulate_row = |y: u32| -> Result<(Vec<Event>, FrameBlock), NodeError> {
        let frame_rows = scenery.frame_rows(camera, Rows { start: y, end: y + 1 });
        let mut frames =
            FrameBlock::zeros(0..camera.frames.times.len(), frame_rows, camera.frames.row_values());
        let some = |first: u32| -> Result<(Vec<Event>, Vec<Vec<f64>>), NodeError> {
            let (mut events, mut values, mut pixel) = (Vec::new(), Vec::new(), PixelLight::default());
            for x in first..extent.width.min(first + SHARED_OUT) {
                pixel.take(&light, extent, kernel, x, y);
                camera.record(x, y, &pixel.seen()?, &mut events);
                if own.is_none() {
                    values.push(camera.frame_values(x, y, &pixel.own()?));
                }
            }
            Ok((events, values))
        };
        // A band may be a single row, so its pixels are shared out as well.
        let firsts: Vec<u32> = (0..extent.width).step_by(SHARED_OUT as usize).collect();
        let parts = firsts.par_iter().map(|first| some(*first)).collect::<Result<Vec<_>, NodeError>>()?;
        let (events, captured): (Vec<Vec<Event>>, Vec<Vec<Vec<f64>>>) = parts.into_iter().unzip();
        let events = events.concat();
        captured.into_iter().flatten().zip(0..).for_each(|(values, x)| put(&mut frames, x, y, values));
        let mut pixel = PixelLight::default();
        for (own, (value, y)) in own.iter().flat_map(|own| {
            frame_rows.iter().flat_map(move |y| (0..values.width).map(move |value| (own, (value, y))))
        }) {
            pixel.take(own, values, None, value, y);
            put(&mut frames, value, y, camera.frame_values(value, y, &pixel.own()?));
        }
        cx.advance(1)?;
        Ok((events, frames))
    };
    rows.iter().into_par_iter().map(simulate_row).collect()
}

fn put(frames: &mut FrameBlock, value: u32, y: u32, all: Vec<f64>) {
    for (l, dn) in all.into_iter().enumerate() {
        frames.row_mut(l, y)[value as usize] = dn as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::light::LightBand;
    use photocurrent_core::{Colour, TimeSpan, testing};
    use serde_json::json;

    const EXTENT: Extent = Extent { width: 6, height: 5 };
    const LENGTH_NS: i64 = 100_000_000;

    fn sensor(effects: serde_json::Value) -> Sensor {
        let mut sensor = Sensor::unknown("test");
        sensor.front_end.tau_0 = Some(Duration::new(0));
        sensor.front_end.alpha = Some(Duration::new(0));
        sensor.comparator.threshold_on = Some(0.2);
        sensor.comparator.threshold_off = Some(0.2);
        sensor.readout.refractory = Some(Duration::new(0));
        sensor.frames.gain = Some(1000.0);
        sensor.frames.row_time = Some(Duration::new(10_000));
        sensor.effects = serde_json::from_value(effects).unwrap();
        sensor
    }

    /// Column x holds 10 (x + 1) until 20 ms, rises linearly to twice that at 60 ms, and stays.
    fn light() -> Light {
        let mut band = LightBand::begin(0, EXTENT.width);
        for pixel in 0..EXTENT.pixels() {
            let i = 10.0 * (pixel as u32 % EXTENT.width + 1) as f32;
            band.push([(0, i), (20_000_000, i), (60_000_000, 2.0 * i)]);
        }
        Light::in_memory(
            Arc::new(LightMeta {
                extent: EXTENT,
                span: TimeSpan::new(0, LENGTH_NS),
                colour: Colour::Mono,
                count_hint: None,
            }),
            band,
        )
    }

    fn node() -> SimulateSensor {
        SimulateSensor { params: Params { latency_spread: Duration::new(0), ..Params::default() } }
    }

    fn run(effects: serde_json::Value, rows: Rows) -> Result<Out, NodeError> {
        let node = node();
        let input = In {
            light: light().cut(rows.with_halo(HALO_ROWS, EXTENT.rows())),
            sensor: Arc::new(sensor(effects)),
        };
        testing::with_context(rows, &["events", "frames"], |cx| node.run(input, cx)).0
    }

    #[test]
    fn a_doubling_is_three_events_of_a_fifth_at_the_times_of_the_closed_form() {
        let out = run(json!({}), EXTENT.rows()).unwrap();
        let band = out.events.read(EXTENT.rows()).unwrap();
        assert_eq!(band.len(), 3 * EXTENT.pixels());
        let row = band.row(2);
        for (k, &event) in row.by_pixel(EXTENT.width).pixel(4).iter().enumerate() {
            // i(t) = i (1 + (t - 20 ms) / 40 ms) reaches exp(0.2 (k + 1)) i.
            let expected = 20e6 + 40e6 * (libm::exp(0.2 * (k + 1) as f64) - 1.0);
            assert!((row.t[event] as f64 - expected).abs() < 1000.0, "{} against {expected}", row.t[event]);
        }
        // The first frame is exposed for 6.5 ms of constant light: DN = 1000 x 10 (x + 1) x 6.5 ms.
        let frames = out.frames.read(0..1, EXTENT.rows()).unwrap();
        assert_eq!(frames.row(0, 3), [65.0, 130.0, 195.0, 260.0, 325.0, 390.0]);
    }

    #[test]
    fn effects_of_the_description_act() {
        let count = |effects| run(effects, EXTENT.rows()).unwrap().events.read(EXTENT.rows()).unwrap().len();
        // 60 ON events per second and pixel on top of the scene's: 100 ms of them are about six.
        let leaky = count(json!({ "leak_events": { "rate": "60 Hz" } }));
        assert!((8 * EXTENT.pixels()..=10 * EXTENT.pixels()).contains(&leaky), "{leaky}");
        let late = run(json!({ "clock_offset": { "offset": "6 ms" } }), EXTENT.rows()).unwrap().events;
        let plain = run(json!({}), EXTENT.rows()).unwrap().events;
        let (late, plain) = (late.read(EXTENT.rows()).unwrap(), plain.read(EXTENT.rows()).unwrap());
        assert!(late.t.iter().zip(&plain.t).all(|(late, plain)| late - plain == 6_000_000));
    }

    #[test]
    fn bands_are_rows_of_the_whole() {
        let effects = json!({ "leak_events": { "rate": "60 Hz" } });
        let whole = run(effects.clone(), EXTENT.rows()).unwrap();
        for rows in EXTENT.rows().bands(2) {
            let band = run(effects.clone(), rows).unwrap();
            assert_eq!(whole.events.read(rows).unwrap(), band.events.read(rows).unwrap());
            assert_eq!(whole.frames.read_rows(rows).unwrap(), band.frames.read_rows(rows).unwrap());
        }
    }

    /// Light like [`light`], of pixels with `ratio` of them along an event pixel's side, all of one event
    /// pixel alike.
    fn fine_light(ratio: u32, colour: Colour) -> Light {
        let extent = Extent { width: EXTENT.width * ratio, height: EXTENT.height * ratio };
        let copies = ratio * colour.channels();
        let mut band = LightBand::begin(0, EXTENT.width * copies);
        for value in (0..extent.height).flat_map(|_| 0..EXTENT.width * copies) {
            let i = 10.0 * (value / copies + 1) as f32;
            band.push([(0, i), (20_000_000, i), (60_000_000, 2.0 * i)]);
        }
        Light::in_memory(
            Arc::new(LightMeta { extent, span: TimeSpan::new(0, LENGTH_NS), colour, count_hint: None }),
            band,
        )
    }

    #[test]
    fn grey_light_fires_the_same_events_whatever_the_frames_pixels_and_colours() {
        let plain = run(json!({}), EXTENT.rows()).unwrap();
        for (ratio, name) in [(1, "rgb"), (2, "mono"), (2, "bayer_gbrg"), (4, "quad_bayer_rggb")] {
            let colour = Colour::named(name).unwrap();
            let node = SimulateSensor { params: Params { pixels_per_event_pixel: ratio, ..node().params } };
            let mut sensor = sensor(json!({}));
            (sensor.optics.event_weights, sensor.frames.channel_gain) =
                (Some([0.3, 0.6, 0.1]), Some([1.0, 2.0, 3.0]));
            // A row of the frames is as long after the one before as a row of the events is, so only the
            // first has plain exposures.
            sensor.frames.row_time = Some(Duration::new(0));
            let input = In { light: fine_light(ratio, colour), sensor: Arc::new(sensor) };
            let out = testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| node.run(input, cx))
                .0
                .unwrap();
            let (found, expected) =
                (out.events.read(EXTENT.rows()).unwrap(), plain.events.read(EXTENT.rows()).unwrap());
            assert_eq!((&found.x, &found.on, found.len()), (&expected.x, &expected.on, expected.len()));
            // Weights add up to 1 but for rounding, and light is f32.
            assert!(
                found.t.iter().zip(&expected.t).all(|(found, expected)| (found - expected).abs() < 10_000)
            );
            let frames = out.frames.read(0..1, out.frames.rows()).unwrap();
            assert_eq!((frames.rows.len() as u32, out.frames.meta.colour), (EXTENT.height * ratio, colour));
            for y in frames.rows.iter() {
                for (value, dn) in (0u32..).zip(frames.row(0, y)) {
                    let gain = colour.channel(value, y).map_or(1.0, |channel| [1.0, 2.0, 3.0][channel]);
                    assert_eq!(*dn, gain * 65.0 * (value / (ratio * colour.channels()) + 1) as f32);
                }
            }
        }
    }

    #[test]
    fn crosstalk_between_columns_that_double_alike_moves_no_event() {
        let plain = run(json!({}), EXTENT.rows()).unwrap().events;
        let soft = run(json!({ "crosstalk": { "fraction": 0.2 } }), EXTENT.rows()).unwrap();
        let (plain, soft_events) =
            (plain.read(EXTENT.rows()).unwrap(), soft.events.read(EXTENT.rows()).unwrap());
        // All columns double alike, so their weighted sums do too: the same times everywhere, and the frames
        // see no crosstalk.
        assert!(
            plain.t.iter().zip(&soft_events.t).all(|(a, b)| (a - b).abs() < 1000)
                && plain.len() == soft_events.len()
        );
        assert_eq!(
            soft.frames.read(0..1, EXTENT.rows()).unwrap().row(0, 3),
            [65.0, 130.0, 195.0, 260.0, 325.0, 390.0]
        );
    }

    /// What pixels record, in the order of rows and columns, when the logarithm of the light of all rises by
    /// 20 a second: a threshold in 10 ms.
    fn ramped(effects: serde_json::Value, refractory_ns: i64) -> Vec<Vec<i64>> {
        let mut band = LightBand::begin(0, EXTENT.width);
        for _ in 0..EXTENT.pixels() {
            band.push((0..=250).map(|k| (400_000 * k, (10.0 * libm::exp(0.008 * k as f64)) as f32)));
        }
        let light = Light::in_memory(
            Arc::new(LightMeta {
                extent: EXTENT,
                span: TimeSpan::new(0, LENGTH_NS),
                colour: Colour::Mono,
                count_hint: None,
            }),
            band,
        );
        let mut sensor = sensor(effects);
        sensor.readout.refractory = Some(Duration::new(refractory_ns));
        let input = In { light, sensor: Arc::new(sensor) };
        let (out, notes) =
            testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| node().run(input, cx));
        assert_eq!(notes, [""; 0]);
        let band = out.unwrap().events.read(EXTENT.rows()).unwrap();
        let pixels = |y| {
            let row = band.row(y);
            let by_pixel = row.by_pixel(EXTENT.width);
            (0..EXTENT.width as usize)
                .map(|x| by_pixel.pixel(x).iter().map(|&event| row.t[event]).collect())
                .collect::<Vec<Vec<i64>>>()
        };
        EXTENT.rows().iter().flat_map(pixels).collect()
    }

    #[test]
    fn pixels_that_cross_at_once_leave_one_after_the_other_and_are_blind_from_then_on() {
        let (service_ns, refractory_ns) = (90_000, 1_000_000);
        let pixels = ramped(json!({ "readout_queue": { "service": "90 us" } }), refractory_ns);
        for (k, pixel) in (0..).zip(&pixels) {
            // All ask at 10 ms. The k-th leaves k services later, is then blind for its refractory period,
            // and needs 10 ms for the next threshold. From then on the pixels ask one service after the
            // other, and nobody waits.
            let expected = (0..pixel.len() as i64)
                .map(|n| 10_000_000 * (n + 1) + refractory_ns * n + if n > 0 { k * service_ns } else { 0 });
            assert!(
                pixel.iter().zip(expected).all(|(t, expected)| (t - expected).abs() < 500),
                "pixel {k}: {pixel:?}"
            );
            assert_eq!(pixel.len(), if 98_000_000 + k * service_ns < LENGTH_NS { 9 } else { 8 });
        }
    }

    #[test]
    fn events_that_are_lost_behind_the_queue_load_it() {
        let all = ramped(json!({ "readout_queue": { "service": "90 us" } }), 1_000_000);
        let some = ramped(
            json!({ "readout_queue": { "service": "90 us" }, "event_loss": { "fraction": 0.5 } }),
            1_000_000,
        );
        let count = |pixels: &[Vec<i64>]| pixels.iter().map(Vec::len).sum::<usize>();
        assert!((count(&all) / 3..count(&all) * 2 / 3).contains(&count(&some)));
        assert!(all.iter().zip(&some).all(|(all, some)| some.iter().all(|t| all.contains(t))));
    }

    #[test]
    fn the_array_is_simulated_as_a_whole_when_its_pixels_are_coupled_and_else_by_rows() {
        let grain = |effects| {
            let light = Meta::Light(light().meta);
            let inputs = PortMetas::new(
                [
                    ("light".to_string(), vec![light]),
                    ("sensor".to_string(), vec![Meta::Sensor(Arc::new(sensor(effects)))]),
                ]
                .into(),
            );
            node().grain(&inputs)
        };
        assert_eq!(grain(json!({ "readout_queue": { "service": "80 ns" } })), Grain::Whole);
        assert_eq!(
            grain(json!({ "readout_queue": { "service": "0 ns" }, "crosstalk": { "fraction": 0.2 } })),
            Grain::Row { halo: HALO_ROWS }
        );
    }
}
