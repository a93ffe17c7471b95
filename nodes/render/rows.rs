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

use super::job::{DigitalNumbers, Job};
use super::on_card;
use super::reading::Readout;
use crate::backend::{Backend, Machine};
use crate::crop::Crop;
use crate::reconstruct::in_rows;
use crate::sampling::{Sampling, virtual_frames};
use photocurrent_core::node::Working;
use photocurrent_core::{
    Between, Context, DataType, Decl, Exposure, Extent, FrameScale, FrameSequence, FrameTimes, FramesMeta,
    Grain, Meta, Node, NodeError, PortMetas, Rows, Sensor, TrackSet, TracksMeta,
};
use photocurrent_solve::RowPicture;
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
    /// What renders: `cpu`, this processor, or `gpu`, a graphics card, for programs built with the feature
    /// `gpu`; without either it is an error. Pictures are the same to 1e-5 of their light. Frames on which
    /// `[effects]` act are rendered on the processor then too.
    pub backend: Backend,
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
    machine: Machine,
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
        let machine = Machine::new(params.backend)?;
        Ok(RenderRows { params, machine })
    }

    fn machine(&self) -> Option<String> {
        self.machine.name().map(String::from)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let tracks = inputs.tracks("tracks")?;
        let sensor = inputs.sensor("sensor")?;
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        self.planned(tracks, sensor, at.map(|at| &**at))
    }

    fn working(&self, _inputs: &PortMetas) -> Working {
        self.machine.working(None)
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
        let with_sigma = of.has_sigma && cx.wants("sigma");
        let between = self.params.between.of(of.between);
        let job = Job { band: &band, meta: &meta, dn, between, first: (left * of.colour.channels(), top) };
        if let (Some(card), Some(name)) = (self.machine.open()?, self.machine.name()) {
            cx.note(format!("rendered on {name}"));
            if readout.is_none() {
                let (frames, sigma) = on_card::render(&job, card.integrator, with_sigma, cx)?;
                return Ok(Out { frames, sigma });
            }
            cx.count(
                cx.rows().len() as u64,
                "rows were rendered on the processor: effects act on their frames",
            );
        }
        let frames = in_rows(cx, meta.clone(), |row, frames| {
            match &readout {
                Some(readout) => job.read(readout, of.extent, row, frames),
                None => job.light(row, job.exposures(row), frames),
            }
            Ok(())
        })?;
        let sigma = with_sigma.then(|| {
            in_rows(cx, meta.clone(), |row, frames| {
                job.sigma(row, frames);
                Ok(())
            })
        });
        Ok(Out { frames, sigma: sigma.transpose()? })
    }
}

/// Do effects act on frames of this scale?
///
/// # Errors
/// When an effect is not understood.
pub(crate) fn has_readout(sensor: &Sensor, scale: FrameScale) -> Result<bool, NodeError> {
    Ok(Readout::new(sensor, scale)?.is_some())
}

/// Frames of means of light that another processor gave, in the order of the context's rows.
///
/// # Errors
/// When the description lacks what digital numbers need.
pub(crate) fn developed(
    rows: &[RowPicture],
    meta: &FramesMeta,
    sensor: &Sensor,
    with_sigma: bool,
    cx: &Context,
) -> Result<Out, NodeError> {
    let dn = DigitalNumbers::new(sensor, meta.colour)?;
    let (frames, sigma) = on_card::developed(rows, meta, dn, with_sigma, cx);
    Ok(Out { frames, sigma })
}

impl RenderRows {
    /// What frames and standard deviations of tracks will look like.
    ///
    /// # Errors
    /// As the plan of the node.
    pub(crate) fn planned(
        &self,
        tracks: &TracksMeta,
        sensor: &Sensor,
        at: Option<&FramesMeta>,
    ) -> Result<Vec<Meta>, NodeError> {
        DigitalNumbers::new(sensor, tracks.colour)?;
        Readout::new(sensor, FrameScale::Captured)?;
        let frames = Meta::Frames(Arc::new(self.frames(tracks, at, sensor)?));
        let why = || "the tracks carry no standard deviation (those of `solve/map` do)".to_string();
        let sigma = if tracks.has_sigma {
            frames.clone()
        } else {
            Meta::Absent { data_type: DataType::Frames, why: why() }
        };
        Ok(vec![frames, sigma])
    }

    /// The frames to come: of the whole sensor, or of a part of it with the exposures of its own rows.
    pub(crate) fn frames(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Shutter;
    use photocurrent_core::quantity::{Duration, Rate};
    use photocurrent_core::{Colour, Ports, TimeSpan, TrackBand, testing};

    fn built(params: Params) -> RenderRows {
        RenderRows::build(params).unwrap()
    }

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
        let node = built(Params { sampling, ..Params::default() });
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
            let node = built(Params { between, ..Params::default() });
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
        let node = built(Params {
            sampling: Sampling { rate: Rate::new(400.0), ..Sampling::default() },
            ..Params::default()
        });
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
                let node = built(Params { sampling: sampling.clone(), roi, ..Params::default() });
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
            let node = built(Params { roi: Some(roi), ..Params::default() });
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
