//! `render/rows`: frames from tracks, at any instant and for any exposure.
//!
//! Idea: once the photocurrent of every pixel is known as a function of time, a frame is its integral over an exposure that is chosen
//! freely, Eq. (5). Exposing all rows at once removes the rolling shutter; exposing for 100 us removes the blur; doing so 10,000 times a
//! second is the interpolation. Integrals are exact, of held tracks and of those whose logarithm is linear between knots.
//!
//! Tracks of colours become frames of the same colours, a mosaic a mosaic (`render/demosaic` makes colour pictures of it).
//!
//! Limits: a pixel without any knot is unknown and comes out as NaN.

use crate::co_located::{channel_gains, gain_of};
use crate::held::{Exposures, HeldMeans, Knots, TILE, develop};
use crate::reconstruct::in_rows;
use crate::sampling::{Sampling, scale_seconds, virtual_frames};
use photocurrent_core::{Between, Colour, Context, Decl, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, TrackBand, TrackSet};
use photocurrent_sensor::exposure::{DigitalNumber, ExposureCursor, LogLinearTrack};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `render/rows`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Photocurrent of every pixel.
        tracks: TrackSet,
        /// Gain and black level; row time for a rolling shutter.
        sensor: Arc<Sensor>,
        /// Frames whose exposures, row time and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The rendered frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct RenderRows {
    params: Params,
}

impl Node for RenderRows {
    const DECL: Decl = Decl {
        kind: "render/rows",
        about: "Frames from tracks: sharp, free of rolling shutter, at any rate and for any exposure.",
        revision: 2,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eq. (5) and section 4.1"],
        example: r#"
[nodes.render]
kind   = "render/rows"
in     = { tracks = "solve.tracks", sensor = "sensor" }
params = { rate = "10 kHz", exposure = "100 us", shutter = "global" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(RenderRows { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let tracks = inputs.tracks("tracks")?;
        let sensor = inputs.sensor("sensor")?;
        DigitalNumbers::new(sensor, tracks.colour)?;
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        let meta =
            virtual_frames(&self.params.sampling, at.map(|at| &**at), (tracks.extent, tracks.colour), tracks.span, tracks.nominal_exposure_ns, Some(sensor))?;
        Ok(vec![Meta::Frames(Arc::new(meta))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let tracks = &input.tracks;
        let at = input.at.as_ref().map(|at| &*at.meta);
        let of = &*tracks.meta;
        let meta = virtual_frames(&self.params.sampling, at, (of.extent, of.colour), of.span, of.nominal_exposure_ns, Some(&input.sensor))?;
        let dn = DigitalNumbers::new(&input.sensor, of.colour)?;
        let band = tracks.read(cx.rows())?;
        let frames = in_rows(cx, meta.clone(), |row, frames| {
            let exposures = Exposures::new((0..meta.times.len()).map(|frame| meta.times.exposure(frame, row)).collect());
            let seconds: Vec<f64> = exposures.all().iter().map(|exposure| scale_seconds(meta.scale, *exposure)).collect();
            match of.between {
                Between::Hold => render_held(&band, row, &exposures, &seconds, dn, frames),
                Between::LogLinear => render_log_linear(&band, row, &exposures, &seconds, dn, frames),
            }
            Ok(())
        })?;
        Ok(Out { frames })
    }
}

/// One row of all frames, from held tracks.
fn render_held(band: &TrackBand, row: u32, exposures: &Exposures, seconds: &[f64], dn: DigitalNumbers, out: &mut [&mut [f32]]) {
    let width = out.first().map_or(0, |values| values.len());
    let mut means = HeldMeans::default();
    for left in (0..width).step_by(TILE) {
        let tile = left..width.min(left + TILE);
        let mut gain = [0.0; TILE];
        gain.iter_mut().zip(tile.clone()).for_each(|(gain, x)| *gain = dn.at(x as u32, row).gain);
        for frames in Exposures::pieces(0..exposures.len()) {
            let knots = tile.clone().map(|x| {
                let track = band.pixel(x as u32, row);
                Knots { t: track.t, value: track.photocurrent }
            });
            let means = means.of(exposures, frames.clone(), knots);
            develop(means, &seconds[frames.clone()], dn.black_level, &gain, &mut out[frames], left);
        }
    }
}

/// Pixels whose log-linear tracks are integrated before they go to the frames together.
const COLUMNS: usize = 16;

/// One row of all frames, from tracks whose logarithm is linear between knots.
fn render_log_linear(band: &TrackBand, row: u32, exposures: &Exposures, seconds: &[f64], dn: DigitalNumbers, out: &mut [&mut [f32]]) {
    let width = out.first().map_or(0, |values| values.len());
    let mut tile = vec![[f32::NAN; COLUMNS]; exposures.len()];
    for left in (0..width).step_by(COLUMNS) {
        let used = COLUMNS.min(width - left);
        for n in 0..used {
            let track = band.pixel((left + n) as u32, row);
            let dn = dn.at((left + n) as u32, row);
            if track.t.is_empty() {
                tile.iter_mut().for_each(|values| values[n] = f32::NAN);
                continue;
            }
            let mut cursor = ExposureCursor::new(LogLinearTrack::new(track.t, track.photocurrent));
            for ((values, exposure), seconds) in tile.iter_mut().zip(exposures.all()).zip(seconds) {
                values[n] = dn.of(cursor.integral(*exposure) / exposure.seconds() * seconds) as f32;
            }
        }
        for (values, out) in tile.iter().zip(out.iter_mut()) {
            out[left..left + used].copy_from_slice(&values[..used]);
        }
    }
}

/// From charge to DN for every value of a row.
#[derive(Clone, Copy)]
struct DigitalNumbers {
    colour: Colour,
    black_level: f64,
    gain: f64,
    channels: [f64; 3],
}

impl DigitalNumbers {
    fn new(sensor: &Sensor, colour: Colour) -> Result<DigitalNumbers, NodeError> {
        let gain = sensor.need(sensor.frames.gain, "frames.gain", "render/rows")?;
        Ok(DigitalNumbers { colour, black_level: sensor.frames.black_level_dn.unwrap_or(0.0), gain, channels: channel_gains(sensor)? })
    }

    fn at(&self, value: u32, row: u32) -> DigitalNumber {
        DigitalNumber { black_level: self.black_level, gain: gain_of(self.gain, &self.channels, self.colour, value, row) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Shutter;
    use photocurrent_core::quantity::{Duration, Rate};
    use photocurrent_core::{Exposure, Extent, FrameScale, Ports, Rows, TimeSpan, TracksMeta, testing};

    fn sensor() -> Arc<Sensor> {
        let mut sensor = Sensor::unknown("test");
        sensor.frames.gain = Some(1000.0);
        sensor.frames.black_level_dn = Some(10.0);
        sensor.frames.row_time = Some(Duration::new(1_000_000));
        Arc::new(sensor)
    }

    /// Every pixel jumps from 1 to 3 at 5 ms; pixel (1, 0) is unknown.
    fn tracks() -> TrackSet {
        tracks_joined(Between::Hold)
    }

    fn tracks_joined(between: Between) -> TrackSet {
        let extent = Extent { width: 2, height: 3 };
        let mut band = TrackBand::begin(0, 2);
        for pixel in 0..6 {
            band.push([(0, 1.0), (5_000_000, 3.0)].into_iter().filter(|_| pixel != 1));
        }
        let meta = TracksMeta { extent, span: TimeSpan::new(0, 10_000_000), nominal_exposure_ns: 4_000_000, between, colour: Colour::Mono, count_hint: None };
        TrackSet::in_memory(Arc::new(meta), band)
    }

    fn render(sampling: Sampling, at: Option<FrameSequence>) -> FrameSequence {
        let node = RenderRows { params: Params { sampling } };
        let (out, _) = testing::with_context(Rows { start: 0, end: 3 }, &["frames"], |cx| node.run(In { tracks: tracks(), sensor: sensor(), at }, cx));
        out.unwrap().frames
    }

    fn values(frames: &FrameSequence, x: usize, row: u32) -> Vec<f32> {
        let block = frames.read_rows(frames.rows()).unwrap();
        (0..frames.len()).map(|frame| block.row(frame, row)[x]).collect()
    }

    #[test]
    fn a_short_exposure_shows_the_instant_at_the_nominal_scale() {
        // DN = 10 + 1000 x 4 ms x current; the frame around 5 ms straddles the jump.
        let frames = render(Sampling { rate: Rate::new(400.0), ..Sampling::default() }, None);
        assert_eq!(frames.meta.scale, FrameScale::Nominal { exposure_ns: 4_000_000 });
        assert_eq!(values(&frames, 0, 2), [14.0, 14.0, 18.0, 22.0]);
    }

    #[test]
    fn log_linear_tracks_rise_between_their_knots() {
        let at = testing::captured(Extent { width: 2, height: 3 }, vec![Exposure::new(0, 5_000_000)], 0, |_, _, _| 0.0);
        let node = RenderRows { params: Params::default() };
        let input = In { tracks: tracks_joined(Between::LogLinear), sensor: sensor(), at: Some(at) };
        let (out, _) = testing::with_context(Rows { start: 0, end: 3 }, &["frames"], |cx| node.run(input, cx));
        // The mean of 3^(t / 5 ms) over 5 ms is 2 / ln 3; DN = 10 + 1000 x 5 ms x that.
        assert!((values(&out.unwrap().frames, 0, 0)[0] - (10.0 + 5.0 * 2.0 / libm::log(3.0) as f32)).abs() < 1e-4);
    }

    #[test]
    fn a_rolling_shutter_sees_lower_rows_later() {
        let sampling = Sampling { rate: Rate::new(400.0), shutter: Shutter::Rolling, ..Sampling::default() };
        // Row 1 is 1 ms later: its frame at 5 ms lies behind the jump.
        assert_eq!(values(&render(sampling, None), 0, 1), [14.0, 14.0, 22.0, 22.0]);
    }

    #[test]
    fn imitated_frames_integrate_over_their_own_exposure() {
        let at = testing::captured(Extent { width: 2, height: 3 }, vec![Exposure::new(3_000_000, 7_000_000)], 1_000_000, |_, _, _| 0.0);
        let frames = render(Sampling::default(), Some(at));
        assert_eq!(frames.meta.scale, FrameScale::Captured);
        // Row 2 is exposed from 5 to 9 ms: all of it after the jump.
        assert_eq!((values(&frames, 0, 0), values(&frames, 0, 2)), (vec![10.0 + 8.0], vec![10.0 + 12.0]));
    }

    #[test]
    fn an_unknown_pixel_stays_unknown() {
        assert!(values(&render(Sampling::default(), None), 1, 0).iter().all(|dn| dn.is_nan()));
    }

    #[test]
    fn unknown_parameters_are_refused_although_the_sampling_is_flattened() {
        let kind = photocurrent_core::Kind::of::<RenderRows>();
        assert!(kind.schema["properties"]["rate"].is_object(), "{}", kind.schema);
        assert!(kind.schema["unevaluatedProperties"] == false || kind.schema["additionalProperties"] == false);
        assert_eq!(In::specs().len(), 3);
    }
}
