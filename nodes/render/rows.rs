//! `render/rows`: frames from tracks, at any instant and for any exposure.
//!
//! Idea: once the photocurrent of every pixel is known as a function of time, a frame is its integral over an
//! exposure that is chosen freely, Eq. (5). Exposing all rows at once removes the rolling shutter; exposing
//! for 100 us removes the blur; doing so 10,000 times a second is the interpolation. Integrals are exact, of
//! held tracks and of those whose logarithm is linear between knots.
//!
//! `between` says how tracks that are held between knots are read: as they are, or as the light that rises or
//! falls from knot to knot. The paper leaves open what its pixels do between two events; a track of
//! `solve/map` says so itself.
//!
//! With `roi` only a part of the sensor is rendered, so that ten thousand frames a second need no more memory
//! than they must.
//!
//! Tracks of colours become frames of the same colours, a mosaic a mosaic (`render/demosaic` makes colour
//! pictures of it).
//!
//! Where the tracks carry standard deviations, `sigma` is that of every value, in DN:
//! `gain x integral of sigma(t) i(t)`, with the standard deviation `sigma(t)` of `ln i`. That is exact for
//! short exposures; over long ones, where errors average out, it is an upper bound. It is rounded to 16 bits
//! (0.4 %).
//!
//! Frames `at` captured ones are what the described camera would have read there, its `[effects]` on frames
//! included ([`super::reading`]); all others show the light.
//!
//! Limits: a pixel without any knot is unknown and comes out as NaN.

use super::reading::Readout;
use crate::crop::Crop;
use crate::held::{Exposures, HeldMeans, Knots, TILE, develop};
use crate::reconstruct::in_rows;
use crate::sampling::{Sampling, scale_seconds, virtual_frames};
use photocurrent_core::series::to_bfloat16;
use photocurrent_core::{
    Between, Colour, Context, DataType, Decl, Exposure, Extent, FrameScale, FrameSequence, FrameTimes,
    FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Rows, Sensor, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::exposure::{DigitalNumber, LogLinearTrack, ManyExposures};
use photocurrent_solve::co_located::{channel_gains, gain_of};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How tracks that are held between knots are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// The value of the earlier knot, as they are.
    #[default]
    Hold,
    /// Linear in the logarithm from knot to knot.
    Linear,
}

impl Reading {
    /// What happens between the knots of tracks that say `between` of themselves.
    fn of(self, between: Between) -> Between {
        match (self, between) {
            (Reading::Hold, Between::Hold) => Between::Hold,
            (Reading::Linear, _) | (_, Between::LogLinear) => Between::LogLinear,
        }
    }
}

/// Parameters of `render/rows`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// Only pixels in this rectangle are rendered, and frames have its size; absent = the whole sensor.
    pub roi: Option<Crop>,
    /// How tracks that are held between knots are read; those that are log-linear already are not changed by
    /// it.
    pub between: Reading,
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
        /// Standard deviation of every value, DN; absent where the tracks carry none.
        sigma: Option<FrameSequence>,
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
        revision: 6,
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
    const LOCAL_IN_TIME: bool = true;
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
        Readout::new(sensor, FrameScale::Captured)?;
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        let frames = Meta::Frames(Arc::new(self.frames(tracks, at.map(|at| &**at), sensor)?));
        let why = || "the tracks carry no standard deviation (those of `solve/map` do)".to_string();
        let sigma = if tracks.has_sigma {
            frames.clone()
        } else {
            Meta::Absent { data_type: DataType::Frames, why: why() }
        };
        Ok(vec![frames, sigma])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let tracks = &input.tracks;
        let at = input.at.as_ref().map(|at| &*at.meta);
        let of = &*tracks.meta;
        let meta = self.frames(of, at, &input.sensor)?;
        let Crop { x: left, y: top, .. } = self.params.roi.unwrap_or(Crop::whole(of.extent));
        let dn = DigitalNumbers::new(&input.sensor, of.colour)?;
        let band = tracks.read(Rows { start: top + cx.rows().start, end: top + cx.rows().end })?;
        let readout = Readout::new(&input.sensor, meta.scale)?;
        let frames = in_rows(cx, meta.clone(), |row, frames| {
            let first = (left * of.colour.channels(), top + row);
            let render = |exposures: Vec<Exposure>, frames: &mut [&mut [f32]]| {
                let exposures = Exposures::new(exposures);
                let seconds: Vec<f64> =
                    exposures.all().iter().map(|exposure| scale_seconds(meta.scale, *exposure)).collect();
                match self.params.between.of(of.between) {
                    Between::Hold => render_held(&band, first, &exposures, &seconds, dn, frames),
                    Between::LogLinear => render_log_linear(&band, first, &exposures, &seconds, dn, frames),
                }
            };
            let stated: Vec<Exposure> =
                (0..meta.times.len()).map(|frame| meta.times.exposure(frame, row)).collect();
            let Some(readout) = &readout else {
                render(stated, frames);
                return Ok(());
            };
            let exposed: Vec<Exposure> = stated
                .iter()
                .enumerate()
                .map(|(frame, exposure)| readout.exposure((first.1, of.extent.height), frame, *exposure))
                .collect();
            let before: Vec<Exposure> =
                exposed.iter().map(|exposure| exposure.delayed(-exposure.length_ns())).collect();
            let mut previous: Vec<Vec<f32>> = frames.iter().map(|values| vec![0.0; values.len()]).collect();
            render(exposed, frames);
            render(before, &mut previous.iter_mut().map(Vec::as_mut_slice).collect::<Vec<_>>());
            for (frame, (values, before)) in frames.iter_mut().zip(&previous).enumerate() {
                for (x, (value, before)) in values.iter_mut().zip(before).enumerate() {
                    let at = first.0 + x as u32;
                    let site = Site {
                        x: at / of.colour.channels(),
                        y: first.1,
                        width: of.extent.width,
                        height: of.extent.height,
                        seed: 0,
                    };
                    *value =
                        readout.read(dn.at(at, first.1), &site, frame, f64::from(*value), f64::from(*before))
                            as f32;
                }
            }
            Ok(())
        })?;
        let sigma = (of.has_sigma && cx.wants("sigma")).then(|| {
            in_rows(cx, meta.clone(), |row, frames| {
                let exposures: Vec<Exposure> =
                    (0..meta.times.len()).map(|frame| meta.times.exposure(frame, row)).collect();
                let seconds: Vec<f64> =
                    exposures.iter().map(|exposure| scale_seconds(meta.scale, *exposure)).collect();
                let first = (left * of.colour.channels(), top + row);
                render_sigma(&band, first, &exposures, &seconds, dn, frames);
                Ok(())
            })
        });
        Ok(Out { frames, sigma: sigma.transpose()? })
    }
}

/// One row of the standard deviations of all frames, rounded to 16 bits.
fn render_sigma(
    band: &TrackBand,
    (left, row): (u32, u32),
    exposures: &[Exposure],
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut spread: Vec<f32> = Vec::new();
    let mut many = ManyExposures::default();
    for x in 0..width {
        let track = band.pixel(left + x as u32, row);
        let gain = dn.at(left + x as u32, row).gain;
        spread.clear();
        spread.extend(
            track.photocurrent.iter().zip(track.sigma).map(|(photocurrent, sigma)| photocurrent * sigma),
        );
        if spread.is_empty() {
            out.iter_mut().for_each(|values| values[x] = f32::NAN);
            continue;
        }
        let integrals = many.of(&LogLinearTrack::new(track.t, &spread), exposures);
        for (((values, exposure), seconds), integral) in
            out.iter_mut().zip(exposures).zip(seconds).zip(integrals)
        {
            let sigma = gain * integral / exposure.seconds() * seconds;
            values[x] = to_bfloat16(sigma as f32);
        }
    }
}

impl RenderRows {
    /// The frames to come: of the whole sensor, or of a part of it with the exposures of its own rows.
    fn frames(
        &self,
        tracks: &TracksMeta,
        at: Option<&FramesMeta>,
        sensor: &Sensor,
    ) -> Result<FramesMeta, NodeError> {
        let size = (tracks.extent, tracks.colour);
        let whole = virtual_frames(
            &self.params.sampling,
            at,
            size,
            tracks.span,
            tracks.nominal_exposure_ns,
            Some(sensor),
        )?;
        let Some(roi) = self.params.roi else { return Ok(whole) };
        roi.check("roi", "frames", tracks.extent)?;
        let cell = tracks.colour.cell();
        if roi.x % cell != 0 || roi.y % cell != 0 {
            return Err(NodeError::usage(format!(
                "`roi` begins at ({}, {}), inside a cell of the mosaic {}",
                roi.x, roi.y, tracks.colour
            ))
            .hint(format!(
                "let `x` and `y` be multiples of {cell}, so that the frames begin with the same filter"
            ))
            .param("roi"));
        }
        let later_ns = whole.times.row_time_ns * i64::from(roi.y);
        let exposures: Vec<Exposure> =
            whole.times.exposures.iter().map(|exposure| exposure.delayed(later_ns)).collect();
        let times = FrameTimes::new(exposures, whole.times.row_time_ns)?;
        Ok(FramesMeta { extent: Extent { width: roi.width, height: roi.height }, times, ..whole })
    }
}

/// One row of all frames, from held tracks; `first` is the value and the row of the sensor that it begins
/// with.
fn render_held(
    band: &TrackBand,
    first: (u32, u32),
    exposures: &Exposures,
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut means = HeldMeans::default();
    for left in (0..width).step_by(TILE) {
        let tile = left..width.min(left + TILE);
        let mut gain = [0.0; TILE];
        gain.iter_mut()
            .zip(tile.clone())
            .for_each(|(gain, x)| *gain = dn.at(first.0 + x as u32, first.1).gain);
        for frames in Exposures::pieces(0..exposures.len()) {
            let knots = tile.clone().map(|x| {
                let track = band.pixel(first.0 + x as u32, first.1);
                Knots { t: track.t, value: track.photocurrent }
            });
            let means = means.of(exposures, frames.clone(), knots);
            develop(means, &seconds[frames.clone()], dn.black_level, &gain, &mut out[frames], left);
        }
    }
}

/// Pixels whose log-linear tracks are integrated before they go to the frames together.
const COLUMNS: usize = 16;

/// The same from tracks whose logarithm is linear between knots.
fn render_log_linear(
    band: &TrackBand,
    first: (u32, u32),
    exposures: &Exposures,
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut tile = vec![[f32::NAN; COLUMNS]; exposures.len()];
    let mut many = ManyExposures::default();
    for left in (0..width).step_by(COLUMNS) {
        let used = COLUMNS.min(width - left);
        for n in 0..used {
            let value = first.0 + (left + n) as u32;
            let track = band.pixel(value, first.1);
            let dn = dn.at(value, first.1);
            if track.t.is_empty() {
                tile.iter_mut().for_each(|values| values[n] = f32::NAN);
                continue;
            }
            let integrals = many.of(&LogLinearTrack::new(track.t, track.photocurrent), exposures.all());
            for (((values, exposure), seconds), integral) in
                tile.iter_mut().zip(exposures.all()).zip(seconds).zip(integrals)
            {
                values[n] = dn.of(integral / exposure.seconds() * seconds) as f32;
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
        Ok(DigitalNumbers {
            colour,
            black_level: sensor.frames.black_level_dn.unwrap_or(0.0),
            gain,
            channels: channel_gains(sensor)?,
        })
    }

    fn at(&self, value: u32, row: u32) -> DigitalNumber {
        DigitalNumber {
            black_level: self.black_level,
            gain: gain_of(self.gain, &self.channels, self.colour, value, row),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Shutter;
    use photocurrent_core::quantity::{Duration, Rate};
    use photocurrent_core::{Ports, TimeSpan, testing};

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
        let meta = TracksMeta {
            extent,
            span: TimeSpan::new(0, 10_000_000),
            nominal_exposure_ns: 4_000_000,
            between,
            colour: Colour::Mono,
            has_sigma: false,
            count_hint: None,
        };
        TrackSet::in_memory(Arc::new(meta), band)
    }

    fn render(sampling: Sampling, at: Option<FrameSequence>) -> FrameSequence {
        let node = RenderRows { params: Params { sampling, ..Params::default() } };
        let (out, _) = testing::with_context(Rows { start: 0, end: 3 }, &["frames"], |cx| {
            node.run(In { tracks: tracks(), sensor: sensor(), at }, cx)
        });
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
        let at = testing::captured(
            Extent { width: 2, height: 3 },
            vec![Exposure::new(0, 5_000_000)],
            0,
            |_, _, _| 0.0,
        );
        let dn = |tracks: Between, between: Reading| {
            let node = RenderRows { params: Params { between, ..Params::default() } };
            let input = In { tracks: tracks_joined(tracks), sensor: sensor(), at: Some(at.clone()) };
            let (out, _) =
                testing::with_context(Rows { start: 0, end: 3 }, &["frames"], |cx| node.run(input, cx));
            let frames = out.unwrap().frames;
            assert!(values(&frames, 1, 0)[0].is_nan(), "a pixel without a knot is unknown either way");
            values(&frames, 0, 0)[0]
        };
        // The mean of 3^(t / 5 ms) over 5 ms is 2 / ln 3; DN = 10 + 1000 x 5 ms x that. Held, it is 1.
        let risen = 10.0 + 5.0 * 2.0 / libm::log(3.0) as f32;
        assert!(
            [Reading::Hold, Reading::Linear]
                .iter()
                .all(|between| (dn(Between::LogLinear, *between) - risen).abs() < 1e-4)
        );
        assert!((dn(Between::Hold, Reading::Linear) - risen).abs() < 1e-4);
        assert_eq!(dn(Between::Hold, Reading::Hold), 15.0);
    }

    #[test]
    fn a_rolling_shutter_sees_lower_rows_later() {
        let sampling = Sampling { rate: Rate::new(400.0), shutter: Shutter::Rolling, ..Sampling::default() };
        // Row 1 is 1 ms later: its frame at 5 ms lies behind the jump.
        assert_eq!(values(&render(sampling, None), 0, 1), [14.0, 14.0, 22.0, 22.0]);
    }

    #[test]
    fn imitated_frames_integrate_over_their_own_exposure() {
        let at = testing::captured(
            Extent { width: 2, height: 3 },
            vec![Exposure::new(3_000_000, 7_000_000)],
            1_000_000,
            |_, _, _| 0.0,
        );
        let frames = render(Sampling::default(), Some(at));
        assert_eq!(frames.meta.scale, FrameScale::Captured);
        // Row 2 is exposed from 5 to 9 ms: all of it after the jump.
        assert_eq!((values(&frames, 0, 0), values(&frames, 0, 2)), (vec![10.0 + 8.0], vec![10.0 + 12.0]));
    }

    /// Tracks that differ from pixel to pixel.
    fn uneven(extent: Extent, colour: Colour, between: Between) -> TrackSet {
        let series = extent.width * colour.channels();
        let mut band = TrackBand::begin(0, series);
        for n in 0..series * extent.height {
            band.push([
                (0, 1.0 + n as f32),
                (i64::from(1 + n % 100) * 40_000, 3.0),
                (6_000_000, 2.0 + 0.5 * n as f32),
            ]);
        }
        let meta = TracksMeta {
            extent,
            span: TimeSpan::new(0, 10_000_000),
            nominal_exposure_ns: 4_000_000,
            between,
            colour,
            has_sigma: false,
            count_hint: None,
        };
        TrackSet::in_memory(Arc::new(meta), band)
    }

    #[test]
    fn standard_deviations_are_rendered_with_the_frames() {
        let mut band = TrackBand::begin(0, 2);
        // Light e^0.1 times brighter and known half as well after 10 ms; the second pixel is unknown.
        let known = [(0, 2.0, 0.1), (10_000_000, 2.0 * libm::exp(0.1) as f32, 0.2)];
        for pixel in 0..6 {
            band.push_with_sigma(known.into_iter().filter(|_| pixel != 1));
        }
        let meta = TracksMeta { has_sigma: true, ..(*tracks_joined(Between::LogLinear).meta).clone() };
        let input = In { tracks: TrackSet::in_memory(Arc::new(meta), band), sensor: sensor(), at: None };
        let node = RenderRows {
            params: Params {
                sampling: Sampling { rate: Rate::new(400.0), ..Sampling::default() },
                ..Params::default()
            },
        };
        let (out, _) =
            testing::with_context(Rows { start: 0, end: 3 }, &["frames", "sigma"], |cx| node.run(input, cx));
        let (frames, sigma) = out.map(|out| (out.frames, out.sigma.unwrap())).unwrap();
        assert_eq!(frames.meta, sigma.meta);
        for (l, (dn, sigma)) in values(&frames, 0, 1).into_iter().zip(values(&sigma, 0, 1)).enumerate() {
            // As a part of the light: from 0.1 to 0.2 in 10 ms, on a logarithmic scale, at the middle of a
            // short exposure, rounded to 8 bits.
            let middle_ms = frames.meta.times.exposure(l, 1).mid().0 as f64 * 1e-6;
            let expected = 0.1 * libm::exp2(middle_ms / 10.0);
            assert!(
                (f64::from(sigma / (dn - 10.0)) / expected - 1.0).abs() < 1.0 / 256.0,
                "{sigma} of {dn}, expected {expected}"
            );
        }
        assert!(values(&sigma, 1, 0)[0].is_nan());
    }

    #[test]
    fn a_part_of_the_sensor_is_cut_out_of_the_whole() {
        let extent = Extent { width: 40, height: 6 };
        let roi = Crop { x: 4, y: 2, width: 19, height: 3 };
        let sampling = Sampling {
            rate: Rate::new(10_000.0),
            shutter: Shutter::Rolling,
            start: Some(Duration::new(3_000_000)),
            ..Sampling::default()
        };
        let cases = [
            (Colour::Mono, Between::Hold),
            (Colour::Rgb, Between::LogLinear),
            (Colour::named("bayer_rggb").unwrap(), Between::Hold),
        ];
        for (colour, between) in cases {
            let tracks = uneven(extent, colour, between);
            let mut sensor = (*sensor()).clone();
            sensor.frames.channel_gain = Some([0.5, 1.0, 2.0]);
            let sensor = Arc::new(sensor);
            let render = |roi: Option<Crop>, rows: Rows| {
                let node =
                    RenderRows { params: Params { sampling: sampling.clone(), roi, ..Params::default() } };
                let input = In { tracks: tracks.clone(), sensor: sensor.clone(), at: None };
                testing::with_context(rows, &["frames"], |cx| node.run(input, cx)).0.unwrap().frames
            };
            let (whole, part) = (render(None, extent.rows()), render(Some(roi), Rows { start: 0, end: 3 }));
            assert_eq!(part.meta.extent, Extent { width: 19, height: 3 });
            let (all, cut) = (whole.read_rows(whole.rows()).unwrap(), part.read_rows(part.rows()).unwrap());
            let channels = colour.channels() as usize;
            for frame in 0..whole.len() {
                for row in 0..3 {
                    assert_eq!(
                        part.meta.times.exposure(frame, row),
                        whole.meta.times.exposure(frame, row + 2)
                    );
                    assert_eq!(cut.row(frame, row), &all.row(frame, row + 2)[4 * channels..23 * channels]);
                }
            }
            // A band of the part is a part of it.
            let band = render(Some(roi), Rows { start: 1, end: 2 });
            assert_eq!(
                band.read_rows(Rows { start: 1, end: 2 }).unwrap(),
                cut.slice(0..whole.len(), Rows { start: 1, end: 2 })
            );
        }
    }

    #[test]
    fn a_part_outside_the_sensor_or_inside_a_mosaics_cell_is_refused() {
        let refused = |roi: Crop| {
            let node = RenderRows { params: Params { roi: Some(roi), ..Params::default() } };
            node.frames(
                &uneven(Extent { width: 8, height: 6 }, Colour::named("bayer_rggb").unwrap(), Between::Hold)
                    .meta,
                None,
                &sensor(),
            )
            .unwrap_err()
        };
        let odd = refused(Crop { x: 2, y: 1, width: 4, height: 2 });
        assert_eq!(
            (odd.message.as_str(), odd.param.as_deref()),
            ("`roi` begins at (2, 1), inside a cell of the mosaic bayer_rggb", Some("roi"))
        );
        assert!(odd.hint.unwrap().contains("multiples of 2"));
        assert!(refused(Crop { x: 4, y: 0, width: 6, height: 2 }).message.contains("the frames have 8 x 6"));
    }

    #[test]
    fn an_unknown_pixel_stays_unknown() {
        assert!(values(&render(Sampling::default(), None), 1, 0).iter().all(|dn| dn.is_nan()));
    }

    #[test]
    fn unknown_parameters_are_refused_although_the_sampling_is_flattened() {
        let kind = photocurrent_core::Kind::of::<RenderRows>();
        assert!(kind.schema["properties"]["rate"].is_object(), "{}", kind.schema);
        assert!(
            kind.schema["unevaluatedProperties"] == false || kind.schema["additionalProperties"] == false
        );
        assert_eq!(In::specs().len(), 3);
    }
}
