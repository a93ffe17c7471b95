//! `render/colour`: grey pictures get the hue of captured frames, carried along the motion.
//!
//! Events see the mixture of a pixel's colours (`render/grey`); how it divides between them is known where
//! frames were captured. So the mixture is solved, refined and rendered as any grey recording, and here each
//! picture is divided as the frames before and after state it at the places that the motion leads to
//! ([`photocurrent_scene::hue`]). The mixture of what comes out is the grey picture.
//!
//! Of an event array on another grid (`align/recording`, `align/tracks`) the mixture is coarser than the
//! frames. With its alignment connected, what the array does not resolve moves along as the hue does, of grey
//! frames too; the mixture of what comes out is then the grey picture as the array sees it.
//!
//! Limits: hue of long exposures is blurred, while the mixture is sharp; what no frame shows has the hue of
//! its neighbourhood. All pictures of a part of the recording are in memory at once.

use crate::reconstruct::check_sigma;
use crate::sampling::scale_seconds;
use crate::spans::check_steps;
use photocurrent_core::{
    Between, Colour, Context, DataType, Decl, EventStream, FrameBlock, FrameScale, FrameSequence, FrameTimes,
    FramesMeta, Grain, MapSet, Meta, Node, NodeError, PortMetas, Sensor, TrackSet, TracksMeta,
};
use photocurrent_scene::activity::Activity;
use photocurrent_scene::alignment::Alignment;
use photocurrent_scene::film::{EventTimes, LogTracks, STEP_NS};
use photocurrent_scene::flow::{Flow, MotionParams};
use photocurrent_scene::grey::GreyFrames;
use photocurrent_scene::hue::{Hues, MotionPath};
use photocurrent_scene::image::Image;
use photocurrent_solve::pixel_events::clock_offset;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `render/colour`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Grey pictures of the event pixels: of `render/rows`, a refinement or a baseline.
        frames: FrameSequence,
        /// The captured frames in their colours.
        captured: FrameSequence,
        /// Grey tracks, of which the motion is estimated: of `solve/map` or a refinement.
        tracks: TrackSet,
        /// Events, on the pixels of the grey pictures or of the array of `alignment`: where they are,
        /// something may move.
        events: EventStream,
        /// What an event pixel sees of each colour, gains of the channels, black level, clock offset.
        sensor: Arc<Sensor>,
        /// Places of the event pixels on the frames, where tracks and pictures were brought to the pixels of
        /// the frames by `align/tracks`.
        alignment: Option<MapSet>,
        /// Standard deviations of the grey pictures, DN.
        sigma: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The pictures in the colours, and with the pixels, of the captured frames.
        frames: FrameSequence,
        /// Standard deviations of their values by those of the grey pictures, DN: that of hue is not in
        /// them. Absent without the input.
        sigma: Option<FrameSequence>,
    }
}

/// The node.
pub struct RenderColour;

/// The least pictures between whose pixels light can be interpolated.
const LEAST_SIDE: u32 = 2;

impl RenderColour {
    fn plan_of(
        frames: &FramesMeta,
        captured: &FramesMeta,
        tracks: &TracksMeta,
        (sensor, is_aligned): (&Sensor, bool),
    ) -> Result<(GreyFrames, FramesMeta), NodeError> {
        if frames.colour != Colour::Mono || tracks.colour != Colour::Mono {
            let found = if frames.colour == Colour::Mono { tracks.colour } else { frames.colour };
            return Err(NodeError::usage(format!("render/colour gives grey a colour, and this is {found}"))
                .hint("solve the frames of `render/grey`, and connect what was solved of them"));
        }
        if tracks.extent != frames.extent {
            return Err(NodeError::usage(format!(
                "tracks are {}, the grey frames are {}",
                tracks.extent, frames.extent
            ))
            .hint("connect tracks and pictures of one solution, whole"));
        }
        if tracks.between != Between::LogLinear {
            return Err(NodeError::usage(
                "the tracks hold their values between knots; render/colour needs log-linear ones",
            )
            .hint("connect tracks of solve/map"));
        }
        if captured.scale != FrameScale::Captured || captured.times.is_empty() {
            return Err(NodeError::usage("hue is taken from captured frames, and there are none")
                .hint("connect the recording's frames to `captured`"));
        }
        if frames.extent.width < LEAST_SIDE || frames.extent.height < LEAST_SIDE {
            return Err(NodeError::usage(format!(
                "frames of {} are too small: render/colour needs {LEAST_SIDE} x {LEAST_SIDE} pixels or more",
                frames.extent
            )));
        }
        let grey = GreyFrames::new(frames.extent, captured, sensor)?;
        if is_aligned && grey.ratio != 1 {
            return Err(NodeError::usage(format!(
                "tracks are {}, frames are {}: with an alignment both have the same pixels",
                tracks.extent, captured.extent
            ))
            .hint("connect tracks of align/tracks"));
        }
        if (grey.values() == 1 && !is_aligned) || grey.is_behind_filters() {
            return Err(NodeError::usage(format!(
                "the captured frames are {} with one colour on each event pixel: there is no mixture to \
                 divide",
                captured.colour
            ))
            .hint("leave render/colour out"));
        }
        let times = FrameTimes {
            exposures: frames.times.exposures.clone(),
            row_time_ns: frames.times.row_time_ns / i64::from(grey.ratio),
        };
        let meta =
            FramesMeta { extent: captured.extent, colour: captured.colour, times, scale: frames.scale };
        Ok((grey, meta))
    }

    /// The tracks as functions of time, and their motion.
    fn motion(input: &In, array: Option<&Alignment>, cx: &Context) -> Result<(LogTracks, Flow), NodeError> {
        let tracks = &input.tracks.meta;
        let (extent, span) = (tracks.extent, (tracks.span.start.0, tracks.span.end.0));
        let shift_ns = clock_offset(&input.sensor)?.offset_ns;
        let events = input.events.meta.extent;
        let band = input.events.read(events.rows())?;
        let place = |x: u16, y: u32| match array.filter(|_| events != extent) {
            Some(array) => array.nearest(y as usize * events.width as usize + usize::from(x), extent),
            None => Some((usize::from(x), y as usize)),
        };
        let places = events.rows().iter().flat_map(|y| {
            let row = band.row(y);
            let at = |(x, t): (&u16, &i64)| place(*x, y).map(|(x, y)| (x, y, t - shift_ns));
            row.x.iter().zip(row.t).filter_map(at).collect::<Vec<_>>()
        });
        let activity = Activity::new(extent, span, places);
        let fired = Arc::new(EventTimes::new((0..extent.pixels()).map(|_| Vec::new())));
        cx.advance(0)?;
        let log = LogTracks::new(extent, input.tracks.read(extent.rows())?, &fired);
        let flow = Flow::estimate(&log, span, &activity, (&MotionParams::default(), false));
        Ok((log, flow))
    }
}

impl Node for RenderColour {
    const DECL: Decl = Decl {
        kind: "render/colour",
        about: "Gives grey pictures the hue of captured colour frames, carried along the motion.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Lucas and Kanade, An iterative image registration technique with an application to stereo \
             vision, IJCAI 1981: the motion",
            "Tomasi and Manduchi, Bilateral filtering for gray and color images, ICCV 1998: noise of hue",
        ],
        example: r#"
[nodes.grey]
kind = "render/grey"
in   = { frames = "recording.frames", events = "recording.events", sensor = "sensor" }

[nodes.solve]
kind = "solve/map"
in   = { events = "recording.events", frames = "grey", sensor = "sensor" }

[nodes.render]
kind = "render/rows"
in   = { tracks = "solve.tracks", sensor = "sensor" }

[nodes.colour]
kind = "render/colour"

[nodes.colour.in]
frames   = "render.frames"
captured = "recording.frames"
tracks   = "solve.tracks"
events   = "recording.events"
sensor   = "sensor"
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(_: Params) -> Result<Self, NodeError> {
        Ok(RenderColour)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (frames, captured) = (inputs.frames("frames")?, inputs.frames("captured")?);
        let tracks = inputs.tracks("tracks")?;
        let events = inputs.events("events")?.extent;
        let is_of_array = inputs.has("alignment") && inputs.map("alignment")?.extent == events;
        if events != frames.extent && !is_of_array {
            return Err(NodeError::usage(format!(
                "events are {events}, the grey frames are {}",
                frames.extent
            )));
        }
        check_steps(tracks.span, STEP_NS, "pictures", Self::DECL.kind)?;
        let sensor = inputs.sensor("sensor")?;
        sensor.need(sensor.frames.gain, "frames.gain", Self::DECL.kind)?;
        let is_aligned = inputs.has("alignment");
        if is_aligned {
            Alignment::check(inputs.map("alignment")?)?;
        }
        if inputs.has("sigma") {
            check_sigma(inputs.frames("sigma")?, frames)?;
        }
        let (_, meta) = Self::plan_of(frames, captured, tracks, (sensor, is_aligned))?;
        let meta = Arc::new(meta);
        let sigma = if inputs.has("sigma") {
            Meta::Frames(meta.clone())
        } else {
            let why = "`sigma` of the grey pictures is not connected".into();
            Meta::Absent { data_type: DataType::Frames, why }
        };
        Ok(vec![Meta::Frames(meta), sigma])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let own = &input.frames.meta;
        let array = input.alignment.as_ref().map(Alignment::from_map).transpose()?;
        let (grey, meta) =
            Self::plan_of(own, &input.captured.meta, &input.tracks.meta, (&input.sensor, array.is_some()))?;
        cx.begin(input.frames.len() as u64, "pictures");
        let gain = input.sensor.need(input.sensor.frames.gain, "frames.gain", Self::DECL.kind)?;
        let (tracks, flow) = Self::motion(&input, array.as_ref(), cx)?;
        let path = MotionPath::new(&flow);
        let hues = Hues::new(grey, &input.captured, (&tracks, gain), &path, array.as_ref())?;
        let (count, size) = (input.frames.len(), meta.extent.height as usize * meta.row_values());
        let mut block = FrameBlock::zeros(0..count, meta.extent.rows(), meta.row_values());
        let mut sigma = input
            .sigma
            .as_ref()
            .filter(|_| cx.wants("sigma"))
            .map(|stated| (stated, FrameBlock::zeros(0..count, meta.extent.rows(), meta.row_values())));
        let spreads: Vec<_> = match &mut sigma {
            Some((stated, block)) => {
                block.dn.chunks_exact_mut(size).map(|spread| Some((&**stated, spread))).collect()
            }
            None => (0..count).map(|_| None).collect(),
        };
        let pictures = block.dn.chunks_exact_mut(size).zip(spreads);
        pictures.enumerate().collect::<Vec<_>>().into_par_iter().try_for_each(
            |(l, (picture, spread))| -> Result<(), NodeError> {
                let read = |frames: &FrameSequence| frames.read(l..l + 1, own.extent.rows());
                let grey = Picture { own, l, dn: read(&input.frames)?.dn };
                let spread = spread
                    .map(|(stated, spread)| Ok::<_, NodeError>((read(stated)?.dn, spread)))
                    .transpose()?;
                grey.divide(&hues, &path, picture, spread);
                cx.advance(1)
            },
        )?;
        let meta = Arc::new(meta);
        let sigma = sigma.map(|(_, block)| FrameSequence::in_memory(meta.clone(), block));
        Ok(Out { frames: FrameSequence::in_memory(meta, block), sigma })
    }
}

/// A grey picture.
struct Picture<'a> {
    own: &'a FramesMeta,
    /// Its number.
    l: usize,
    dn: Vec<f32>,
}

impl Picture<'_> {
    /// Writes it in colour, and its standard deviations, DN, with the ratios of the colours.
    fn divide(
        &self,
        hues: &Hues,
        path: &MotionPath<'_>,
        picture: &mut [f32],
        mut sigma: Option<(Vec<f32>, &mut [f32])>,
    ) {
        let (own, grey) = (self.own, hues.grey());
        let (width, height) = (own.extent.width as usize, own.extent.height as usize);
        let exposures: Vec<_> = (0..own.extent.height).map(|row| own.times.exposure(self.l, row)).collect();
        let per_second: Vec<f64> = exposures.iter().map(|e| 1.0 / scale_seconds(own.scale, *e)).collect();
        let above = |k: usize| grey.above(f64::from(self.dn[k]));
        let light = Image {
            width,
            height,
            values: (0..width * height).map(|k| (above(k) * per_second[k / width]) as f32).collect(),
        };
        let mids: Vec<i64> = exposures.iter().map(|exposure| exposure.mid().0).collect();
        let row_values = picture.len() / (height * grey.ratio as usize);
        for (n, ratios) in hues.ratios(&light, &mids, path).iter().enumerate() {
            for k in 0..width * height {
                let (value, row) = grey.value_place(n, ((k % width) as u32, (k / width) as u32));
                let (at, ratio) = (row as usize * row_values + value as usize, f64::from(ratios.values[k]));
                picture[at] = grey.dn(above(k) * ratio, value, row) as f32;
                if let Some((stated, spread)) = &mut sigma {
                    // DN above black are in proportion to the grey ones.
                    spread[at] = (f64::from(stated[k]) * ratio * grey.gain(value, row)) as f32;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, TimeSpan, TrackBand, testing};
    use photocurrent_scene::grey::SaturatedMean;

    const EVENTS: Extent = Extent { width: 6, height: 5 };
    const END_NS: i64 = 12_000_000;

    fn sensor() -> Arc<Sensor> {
        let mut sensor = Sensor::unknown("test");
        (sensor.frames.gain, sensor.frames.black_level_dn) = (Some(1000.0), Some(10.0));
        sensor.frames.channel_gain = Some([0.5, 1.0, 2.0]);
        sensor.optics.event_weights = Some([1.0, 2.0, 1.0]);
        Arc::new(sensor)
    }

    fn input(colour: &str, ratio: u32) -> In {
        let colour = Colour::named(colour).unwrap();
        let extent = Extent { width: ratio * EVENTS.width, height: ratio * EVENTS.height };
        let exposures = vec![Exposure::new(0, 1_000_000), Exposure::new(10_000_000, 11_000_000)];
        let meta = testing::captured(extent, exposures, 0, |_, _, _| 0.0).meta;
        let meta = FramesMeta { colour, ..(*meta).clone() };
        let mut block = FrameBlock::zeros(0..2, extent.rows(), meta.row_values());
        block.dn.iter_mut().enumerate().for_each(|(k, dn)| *dn = 10.0 + ((k * 37) % 53) as f32);
        let grey = testing::captured(EVENTS, vec![Exposure::new(4_000_000, 4_500_000)], 0, |_, x, y| {
            (12 + 3 * x + 5 * y) as f32
        });
        let mut band = TrackBand::begin(0, EVENTS.width);
        (0..EVENTS.pixels()).for_each(|k| band.push([(0, 1.0 + k as f32), (END_NS, 1.0 + k as f32)]));
        let tracks = TracksMeta {
            extent: EVENTS,
            span: TimeSpan::new(0, END_NS),
            nominal_exposure_ns: 1_000_000,
            between: Between::LogLinear,
            colour: Colour::Mono,
            has_sigma: false,
            count_hint: None,
        };
        In {
            frames: grey,
            captured: FrameSequence::in_memory(Arc::new(meta), block),
            tracks: TrackSet::in_memory(Arc::new(tracks), band),
            events: testing::stream(EVENTS, Vec::new()),
            sensor: sensor(),
            alignment: None,
            sigma: None,
        }
    }

    #[test]
    fn the_mixture_of_what_comes_out_is_what_went_in() {
        for (colour, ratio) in
            [("rgb", 1), ("rgb", 2), ("bayer_rggb", 2), ("mono", 3), ("quad_bayer_rggb", 4)]
        {
            let input = input(colour, ratio);
            let (grey, captured) = (input.frames.clone(), input.captured.meta.clone());
            let (out, _) =
                testing::with_context(captured.extent.rows(), &["frames"], |cx| RenderColour.run(input, cx));
            let frames = out.unwrap().frames;
            assert_eq!((frames.meta.extent, frames.meta.colour), (captured.extent, captured.colour));
            assert_eq!(frames.meta.times, grey.meta.times);
            let mixture = GreyFrames::new(EVENTS, &frames.meta, &sensor()).unwrap();
            let (found, stated) = (
                mixture.read(&frames, SaturatedMean::Mean).unwrap(),
                grey.read_rows(EVENTS.rows()).unwrap().dn,
            );
            for (found, stated) in found.iter().zip(&stated) {
                assert!((found - stated).abs() < 2e-4 * stated, "{colour}: {found} for {stated}");
            }
        }
    }

    /// A picture that is larger by its standard deviation comes out larger by those in colour: hue does not
    /// change with the light of a whole picture.
    #[test]
    fn standard_deviations_are_divided_as_the_light_is() {
        let with = |dn: f32| {
            let share = 0.25_f32;
            let scaled = |frames: &FrameSequence, black: f32, factor: f32| {
                let mut block = frames.read(0..1, EVENTS.rows()).unwrap();
                block.dn.iter_mut().for_each(|dn| *dn = black + factor * (*dn - 10.0));
                FrameSequence::in_memory(frames.meta.clone(), block)
            };
            let mut input = input("rgb", 2);
            input.sigma = Some(scaled(&input.frames, 0.0, share));
            input.frames = scaled(&input.frames, 10.0, dn);
            let rows = input.captured.meta.extent.rows();
            let run = testing::with_context(rows, &["frames", "sigma"], |cx| RenderColour.run(input, cx));
            let out = run.0.unwrap();
            (
                out.frames.read_rows(rows).unwrap().dn,
                out.sigma.map(|sigma| sigma.read_rows(rows).unwrap().dn).unwrap_or_default(),
            )
        };
        let ((once, sigma), (more, _)) = (with(1.0), with(1.25));
        for ((once, sigma), more) in once.iter().zip(&sigma).zip(&more) {
            assert!((once + sigma - more).abs() < 1e-3 * more, "{once} and {sigma}, not {more}");
        }
        let input = input("rgb", 1);
        let run =
            testing::with_context(EVENTS.rows(), &["frames", "sigma"], |cx| RenderColour.run(input, cx));
        assert!(run.0.unwrap().sigma.is_none());
    }

    #[test]
    fn what_has_no_mixture_or_is_not_grey_is_refused() {
        let refused = |input: &In| {
            let In { frames, captured, tracks, sensor, .. } = input;
            RenderColour::plan_of(&frames.meta, &captured.meta, &tracks.meta, (sensor, false))
                .err()
                .unwrap()
                .message
        };
        let alone = "with one colour on each event pixel: there is no mixture to divide";
        assert!(
            refused(&input("mono", 1)).contains(alone) && refused(&input("bayer_rggb", 1)).contains(alone)
        );
        let mut coloured = input("rgb", 1);
        coloured.frames = coloured.captured.clone();
        assert_eq!(refused(&coloured), "render/colour gives grey a colour, and this is rgb");
        let mut other = input("rgb", 1);
        other.frames = testing::frames(3, 2, 1);
        assert_eq!(refused(&other), "tracks are 6 x 5, the grey frames are 3 x 2");
    }
}
