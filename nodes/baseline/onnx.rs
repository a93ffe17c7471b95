//! `baseline/onnx`: frames by a network of yours, such as a learned interpolator that its owner exported to
//! an ONNX file.
//!
//! The layout says what each input of the network is: a captured frame on either side of the wanted instant
//! (`frames`), events as a voxel grid ([`voxel`]) of a window (`voxels`), the instant's place between the two
//! frames (`time`), or what the network remembers (`states`). All tensors are \[1, channels, height, width\].
//! With `states` pictures are made one after the other, from states of zeros; without, side by side.
//!
//! With `halvings` a network that was made for the middle between two frames gives other instants as well:
//! the interval is halved again and again, with the pictures before.
//!
//! The instant is the middle of the wanted exposure, at the middle row; captured frames stand at the middles
//! of theirs. A network that looks at frames or at windows that end at them has nothing to look at before the
//! first and after the last one: such instants are left out and counted.
//!
//! Colour: frames of three channels need a network of three, red first. Grey frames are given three times to
//! such a network, and what comes back is averaged. A mosaic is interpolated first (`render/demosaic`).
//!
//! Limits: frames of the events' pixels; one time for all rows; all events in memory, 16 bytes each. Sums of
//! f32 depend on the processor: pictures agree between machines to about 1e-6, not to the last bit.

pub mod layout;
pub mod voxel;

#[cfg(test)]
mod tests;

use crate::onnx::{self, Network, Tensor};
use crate::reconstruct::{Intensity, Request};
use crate::sampling::{Sampling, scale_seconds};
use crate::score::lpips::Encoding;
use layout::{FrameInput, Layout, Moment, Side, StateInput, VoxelInput};
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{
    Colour, Context, Decl, EventStream, FileRef, FrameBlock, FrameSequence, FramesMeta, Grain, Meta, Node,
    NodeError, PortMetas, Sensor,
};
use photocurrent_solve::pixel_events::{Stamp, StepRule};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use voxel::Timeline;

/// Red, green and blue.
const CHANNELS: usize = 3;

/// Parameters of `baseline/onnx`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// The network: an ONNX file, relative to the manifest that names it.
    pub network: InputPath,
    /// An ONNX Runtime library (version 1.24 or newer) that runs it; absent = the embedded backend.
    pub runtime: Option<InputPath>,
    /// Its inputs that are captured frames: `input` (the name), `take` (`"before"` or `"after"` the instant),
    /// `channels` (1 to 3, each the grey frame; 3 of frames in colour; 1), `range` (values of black and
    /// white; `[0.0, 1.0]`).
    pub frames: Vec<FrameInput>,
    /// Its inputs that are voxel grids of events: `input`, `bins` (5), `window` (`"between"` the frames,
    /// `"before_to_instant"`, `"instant_to_after"`, `"exposures"` from the start of the one before to the end
    /// of the one after, or `"since_last"` picture), `polarity` (`"signed"`, or `"separate"`: channels of ON,
    /// then of OFF), `normalise` (`"none"`, `"std"` or `"max"`), `stretch` (bins over the `"window"` or over
    /// its `"events"`), `reversed` (false).
    pub voxels: Vec<VoxelInput>,
    /// Its input that is the instant's place between the frames before (0) and after (1); absent = none.
    pub time: Option<String>,
    /// Dimensions of `time`, each of length 1.
    #[schemars(range(min = 1, max = 4))]
    pub time_dimensions: u32,
    /// How often the interval between the two frames is halved with the picture in its middle (`time` is then
    /// 1/2); the picture nearest to the instant is taken, one of 2^halvings an interval. 0 = the network is
    /// asked for the instant itself.
    #[schemars(range(max = 10))]
    pub halvings: u32,
    /// What it remembers from picture to picture: `input`, `output` (of the picture before; 0 at first),
    /// `channels`, `downscale` (the frames' width over the state's; 1).
    pub states: Vec<StateInput>,
    /// Its output that is the picture: one channel or three, of the frames' size.
    pub output: String,
    /// Values of black and of white in `output`.
    pub output_range: [f64; 2],
    /// In which encoding the network sees frames and gives its picture.
    pub encoding: Encoding,
    /// DN of white; absent = the sensor description's saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Width and height become multiples of this: frames are continued beyond their right and lower border,
    /// and the picture is cut.
    #[schemars(range(min = 1, max = 1024))]
    pub multiple: u32,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// Subtracted from every stamp besides the description's clock offset.
    pub latency: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            sampling: Sampling::default(),
            network: InputPath::default(),
            runtime: None,
            frames: Vec::new(),
            voxels: Vec::new(),
            time: None,
            time_dimensions: 1,
            halvings: 0,
            states: Vec::new(),
            output: String::new(),
            output_range: [0.0, 1.0],
            encoding: Encoding::Linear,
            white: None,
            multiple: 1,
            stamp: Stamp::Best,
            latency: Duration::default(),
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Captured frames.
        frames: FrameSequence,
        /// Events; needed for `voxels`.
        events: Option<EventStream>,
        /// Black level, saturation and clock offset.
        sensor: Option<Arc<Sensor>>,
        /// Frames whose exposures and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The network's pictures as frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct BaselineOnnx {
    params: Params,
}

/// What is known before the data.
struct Planned {
    meta: FramesMeta,
    moments: Vec<Moment>,
    left_out: usize,
    intensity: Intensity,
    rule: StepRule,
}

impl BaselineOnnx {
    const WHO: &'static str = "baseline/onnx";

    fn layout(&self) -> Layout<'_> {
        let Params { frames, voxels, time, states, .. } = &self.params;
        Layout { frames, voxels, time: time.as_deref(), states }
    }

    fn prepare(&self, request: &Request) -> Result<Planned, NodeError> {
        let params = &self.params;
        self.check_colour(request)?;
        if !params.voxels.is_empty() && request.events.is_none() {
            return Err(NodeError::usage("`voxels` asks for events, and nothing is connected to `events`")
                .hint("connect the recording's events")
                .param("voxels"));
        }
        let wanted = request.output(&params.sampling)?;
        if !voxel::addresses(wanted.extent) {
            return Err(NodeError::usage(format!(
                "frames of {} are larger than events can address",
                wanted.extent
            )));
        }
        let intensity = request.intensity(Self::WHO, params.white)?;
        // The threshold is not asked for: events are counted.
        let rule = request.step_rule(Self::WHO, Some(1.0), None, params.stamp, params.latency)?;
        let all = layout::moments(request.frames, &wanted);
        let moments: Vec<Moment> = if self.layout().needs_pairs() {
            all.iter().filter(|moment| moment.pair.is_some()).copied().collect()
        } else {
            all.clone()
        };
        if moments.is_empty() {
            return Err(NodeError::input("no wanted instant lies between two captured frames")
                .note(
                    "the network looks at the captured frames on either side of the instant, or at events \
                       between them",
                )
                .hint(
                    "give two frames or more, and instants between the middles of the first exposure and \
                       the last",
                ));
        }
        let kept: Vec<usize> = moments.iter().map(|moment| moment.wanted).collect();
        let meta = FramesMeta { times: wanted.times.select(&kept), ..wanted };
        Ok(Planned { meta, left_out: all.len() - moments.len(), moments, intensity, rule })
    }

    /// Frames in colour, of the events' pixels, need a network of three channels.
    fn check_colour(&self, request: &Request) -> Result<(), NodeError> {
        request.need_plain_or_colour(Self::WHO)?;
        if request.frames.colour != Colour::Rgb {
            return Ok(());
        }
        let other = self.params.frames.iter().find(|frame| frame.channels != CHANNELS as u32);
        other.map_or(Ok(()), |frame| {
            Err(NodeError::usage(format!(
                "frames are in colour, and the network is shown {} of their channels in `{}`",
                frame.channels, frame.input
            ))
            .hint("state `channels = 3` for a network that sees red, green and blue, or connect grey frames")
            .param("frames"))
        })
    }

    /// Halving puts pictures in the place of frames: they must be alike, and nothing else may depend on the
    /// instant.
    fn check_halvings(&self) -> Result<(), NodeError> {
        let Params { halvings, frames, voxels, states, output_range, .. } = &self.params;
        let refuse = |what: &str, hint: &str| {
            Err(NodeError::usage(format!("`halvings` {what}")).hint(hint.to_string()).param("halvings"))
        };
        match frames.as_slice() {
            _ if *halvings == 0 => Ok(()),
            _ if !(voxels.is_empty() && states.is_empty()) => refuse(
                "is for networks that see two frames and nothing else",
                "take `voxels` and `states` out, or `halvings`",
            ),
            [one, other] if one.take != other.take && one.channels == other.channels => {
                match [one, other].iter().all(|frame| frame.range == *output_range) {
                    true => Ok(()),
                    false => refuse(
                        "gives pictures back as frames, and their values of black and white differ",
                        "let `range` of both frames be `output_range`",
                    ),
                }
            }
            _ => refuse(
                "needs one frame before and one after the instant, of as many channels",
                "state both in `frames`",
            ),
        }
    }

    fn load(&self) -> Result<Box<dyn Network>, NodeError> {
        let path = self.params.network.path();
        let content = std::fs::read(path).map_err(|error| self.unreadable(&error))?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let network = onnx::load(&name, content, self.params.runtime.as_ref().map(InputPath::path)).map_err(
            |error| match error.param {
                Some(_) => error,
                None => error.param("network"),
            },
        )?;
        self.layout().check(&name, &network.sockets(), &self.params.output)?;
        Ok(network)
    }

    fn unreadable(&self, error: &std::io::Error) -> NodeError {
        NodeError::files(photocurrent_core::error::cannot_read(self.params.network.path(), error))
            .hint("name the ONNX file of the network; paths are relative to the manifest that names them")
            .param("network")
    }
}

impl Node for BaselineOnnx {
    const DECL: Decl = Decl {
        kind: "baseline/onnx",
        about: "Frames by a network of yours in an ONNX file, from captured frames and voxel grids of \
                events.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "whatever made the network",
            "voxel grids: Zhu, Yuan, Chaney, Daniilidis: Unsupervised Event-Based Learning of Optical Flow, \
             Depth, and Egomotion, CVPR 2019",
        ],
        example: r#"
[nodes.interpolated]
kind = "baseline/onnx"
in   = { frames = "recording.frames", events = "recording.events", sensor = "sensor" }

[nodes.interpolated.params]
network  = "interpolator.onnx"
frames   = [{ input = "before", take = "before", channels = 3 }, { input = "after", take = "after", channels = 3 }]
voxels   = [{ input = "voxel", bins = 5, window = "between", normalise = "std" }]
time     = "t"
output   = "image"
encoding = "srgb"
multiple = 8
rate     = "1 kHz"
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let needed = |what: &str, hint: &str, param: &str| {
            Err(NodeError::usage(format!("`{param}` is missing: {what}")).hint(hint.to_string()).param(param))
        };
        if params.network.path().as_os_str().is_empty() {
            return needed("the file of the network", "name an ONNX file", "network");
        }
        if params.output.is_empty() {
            return needed(
                "which output of the network is the picture",
                "name it: output = \"image\"",
                "output",
            );
        }
        if params.frames.is_empty() && params.voxels.is_empty() {
            return needed(
                "the network would be shown neither events nor frames",
                "say what its inputs are: voxels = [{ input = \"voxel\" }]",
                "voxels",
            );
        }
        let [black, white] = params.output_range;
        if !(black.is_finite() && white.is_finite() && black != white) {
            return Err(NodeError::usage(format!("black and white of the output are {black} and {white}"))
                .hint("state two different numbers: output_range = [0.0, 1.0]")
                .param("output_range"));
        }
        if let Some(state) =
            params.states.iter().find(|state| !params.multiple.is_multiple_of(state.downscale))
        {
            return Err(NodeError::usage(format!(
                "`{}` is smaller than the frames by {}, which does not divide `multiple`, {}",
                state.input, state.downscale, params.multiple
            ))
            .hint(format!("set `multiple = {}`, or a multiple of it", state.downscale))
            .param("multiple"));
        }
        let node = BaselineOnnx { params };
        node.check_halvings()?;
        node.layout().check_names()?;
        Ok(node)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let planned = self.prepare(&Request::planned(inputs)?)?;
        if !self.params.network.path().is_file() {
            std::fs::read(self.params.network.path()).map_err(|error| self.unreadable(&error))?;
        }
        Ok(vec![Meta::Frames(Arc::new(planned.meta))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = Request::connected(&input.frames, input.events.as_ref(), &input.at, &input.sensor);
        let Planned { meta, moments, left_out, intensity, rule } = self.prepare(&request)?;
        let network = self.load()?;
        cx.count(left_out as u64, "wanted instants do not lie between two captured frames, and are left out");
        let timeline = match &input.events {
            Some(events) if !self.params.voxels.is_empty() => {
                Timeline::new(&events.read(events.rows())?, &rule)
            }
            _ => Timeline::default(),
        };
        cx.begin(moments.len() as u64, "pictures");
        let work = Work {
            node: self,
            network: &*network,
            frames: &input.frames,
            timeline: &timeline,
            meta: &meta,
            intensity,
            cx,
        };
        let mut block = FrameBlock::zeros(0..moments.len(), meta.extent.rows(), meta.row_values());
        let pictures = block.dn.chunks_exact_mut(meta.row_values() * meta.extent.height as usize);
        if self.params.states.is_empty() {
            let tasks: Vec<_> = moments.iter().enumerate().zip(pictures).collect();
            tasks
                .into_par_iter()
                .try_for_each(|((n, _), out)| work.picture(&moments, n, &mut BTreeMap::new(), out))?;
        } else {
            let mut states = work.first_states();
            moments
                .iter()
                .enumerate()
                .zip(pictures)
                .try_for_each(|((n, _), out)| work.picture(&moments, n, &mut states, out))?;
        }
        Ok(Out { frames: FrameSequence::in_memory(Arc::new(meta), block) })
    }

    fn files(&self) -> Vec<FileRef> {
        onnx::files("network", &self.params.network, self.params.runtime.as_ref())
    }
}

/// All that a picture is made of.
struct Work<'a> {
    node: &'a BaselineOnnx,
    network: &'a dyn Network,
    frames: &'a FrameSequence,
    timeline: &'a Timeline,
    meta: &'a FramesMeta,
    intensity: Intensity,
    cx: &'a Context<'a>,
}

impl Work<'_> {
    fn params(&self) -> &Params {
        &self.node.params
    }

    /// Width and height that the network sees.
    fn size(&self) -> (usize, usize) {
        let padded = |side: u32| (side.div_ceil(self.params().multiple) * self.params().multiple) as usize;
        (padded(self.meta.extent.width), padded(self.meta.extent.height))
    }

    fn first_states(&self) -> BTreeMap<String, Tensor> {
        let (width, height) = self.size();
        let zeros = |state: &StateInput| {
            let shape = vec![
                1,
                state.channels as usize,
                height / state.downscale as usize,
                width / state.downscale as usize,
            ];
            Tensor { values: vec![0.0; shape.iter().product()], shape }
        };
        self.params().states.iter().map(|state| (state.input.clone(), zeros(state))).collect()
    }

    /// Makes picture `n`; `states` go in and come out.
    fn picture(
        &self,
        moments: &[Moment],
        n: usize,
        states: &mut BTreeMap<String, Tensor>,
        out: &mut [f32],
    ) -> Result<(), NodeError> {
        let (params, moment, (width, height)) = (self.params(), &moments[n], self.size());
        if params.halvings > 0 {
            self.develop(&self.halved(moment)?, n, out)?;
            return self.cx.advance(1);
        }
        let mut given: Vec<(&str, Tensor)> = Vec::new();
        for frame in &params.frames {
            given.push((&frame.input, self.frame(frame, moment)?));
        }
        for voxel in &params.voxels {
            let grid = voxel.grid();
            let before = n.checked_sub(1).map(|before| moments[before].t);
            let (values, count) = self.timeline.grid(
                voxel.window.of(moment, before, self.timeline.span()),
                grid,
                (width, height),
            );
            self.cx.count(u64::from(count == 0), &format!("pictures saw no event in `{}`", voxel.input));
            given.push((&voxel.input, Tensor { shape: vec![1, grid.channels(), height, width], values }));
        }
        if let Some(time) = &params.time {
            given.push((time, self.time(moment.share())));
        }
        let inputs: Vec<(&str, &Tensor)> = given
            .iter()
            .map(|(name, tensor)| (*name, tensor))
            .chain(states.iter().map(|(name, state)| (name.as_str(), state)))
            .collect();
        let outputs: Vec<&str> = std::iter::once(params.output.as_str())
            .chain(params.states.iter().map(|state| state.output.as_str()))
            .collect();
        let mut results = self.network.run_all(&inputs, &outputs)?.into_iter();
        let picture = results.next().ok_or_else(|| NodeError::failed("the network gave no picture"))?;
        let carried: BTreeMap<String, Tensor> =
            params.states.iter().map(|state| state.input.clone()).zip(results).collect();
        *states = carried;
        self.develop(&picture, n, out)?;
        self.cx.advance(1)
    }

    /// An instant's place between the frames, as the network sees it.
    fn time(&self, share: f64) -> Tensor {
        Tensor { shape: vec![1; self.params().time_dimensions as usize], values: vec![share as f32] }
    }

    /// The picture nearest to the moment of those that halving the interval makes.
    fn halved(&self, moment: &Moment) -> Result<Tensor, NodeError> {
        let params = self.params();
        let of = |side: Side| {
            params
                .frames
                .iter()
                .find(|frame| frame.take == side)
                .ok_or_else(|| NodeError::failed("halving without two frames"))
        };
        let (before, after) = (of(Side::Before)?, of(Side::After)?);
        let (mut low, mut high) = (self.frame(before, moment)?, self.frame(after, moment)?);
        let (mut from, mut to) = (0, 1_u32 << params.halvings);
        let wanted = (moment.share() * f64::from(to)).round() as u32;
        let time = self.time(0.5);
        while from != wanted && to != wanted {
            let mut given = vec![(before.input.as_str(), &low), (after.input.as_str(), &high)];
            given.extend(params.time.iter().map(|name| (name.as_str(), &time)));
            let middle = self.network.run(&given, &params.output)?;
            if middle.shape != low.shape {
                return Err(NodeError::input(format!(
                    "the output `{}` has the shape {:?}, and frames have {:?}",
                    params.output, middle.shape, low.shape
                ))
                .hint(
                    "with `halvings` pictures are frames again: let `channels` of both frames be \
                           those of the picture",
                )
                .param("halvings"));
            }
            let at = (from + to) / 2;
            if wanted < at {
                (high, to) = (middle, at);
            } else {
                (low, from) = (middle, at);
            }
        }
        Ok(if from == wanted { low } else { high })
    }

    /// A captured frame as the network sees it.
    fn frame(&self, input: &FrameInput, moment: &Moment) -> Result<Tensor, NodeError> {
        let (width, height) = self.size();
        let captured = &self.frames.meta;
        let Some(pair) = moment.pair else {
            return Err(NodeError::failed("a wanted instant without a captured frame on either side"));
        };
        let l = match input.take {
            Side::Before => pair.before,
            Side::After => pair.before + 1,
        };
        let block = self.frames.read(l..l + 1, self.frames.rows())?;
        let (mut unknown, mut clipped) = (0, 0);
        let [low, high] = input.range;
        let channels = captured.channels() as usize;
        let mut planes = Vec::with_capacity(channels * width * height);
        for (channel, y) in (0..channels).flat_map(|channel| (0..height).map(move |y| (channel, y))) {
            let y = u32::min(y as u32, captured.extent.height - 1);
            let exposure = captured.times.exposure(l, y);
            let row = block.row(l, y);
            planes.extend((0..width).map(|x| {
                let x = usize::min(x, captured.extent.width as usize - 1);
                let share = self.intensity.of(row[channels * x + channel], exposure);
                unknown += u64::from(share.is_nan());
                clipped += u64::from(!(0.0..=1.0).contains(&share) && !share.is_nan());
                let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
                (low + (high - low) * self.params().encoding.of(share)) as f32
            }));
        }
        self.cx.count(unknown, "frame values are not known (NaN): the network sees black there");
        self.cx.count(clipped, "frame values lay below black or above white and were clipped");
        // A grey frame as often as the network has channels.
        let values = planes.repeat(input.channels as usize / channels);
        Ok(Tensor { shape: vec![1, input.channels as usize, height, width], values })
    }

    /// What the network gave as linear DN, the continued border cut off.
    fn develop(&self, picture: &Tensor, n: usize, out: &mut [f32]) -> Result<(), NodeError> {
        let (params, (width, height)) = (self.params(), self.size());
        let channels = picture.values.len() / (width * height).max(1);
        let of_pixel = self.meta.channels() as usize;
        let fits = picture.shape.ends_with(&[height, width])
            && (channels == CHANNELS || channels == of_pixel)
            && picture.values.len() == channels * width * height;
        if !fits {
            return Err(NodeError::input(format!(
                "the output `{}` of the network has the shape {:?}",
                params.output, picture.shape
            ))
            .note(match of_pixel {
                1 => format!("expected [1, 1, {height}, {width}] or [1, 3, {height}, {width}]"),
                _ => format!("expected [1, 3, {height}, {width}], as frames are in colour"),
            })
            .hint(
                "name the output that is the picture, or state in `multiple` what width and height \
                       have to be divisible by",
            )
            .param("output"));
        }
        let [black, white] = params.output_range;
        let plane = width * height;
        for (y, row) in out.chunks_exact_mut(self.meta.row_values()).enumerate() {
            let seconds = scale_seconds(self.meta.scale, self.meta.times.exposure(n, y as u32));
            for (x, pixel) in row.chunks_exact_mut(of_pixel).enumerate() {
                let at = y * width + x;
                let light = |channel: usize| {
                    params
                        .encoding
                        .undone((f64::from(picture.values[channel * plane + at]) - black) / (white - black))
                };
                match pixel {
                    // Light is averaged, not its encoding.
                    [grey] => {
                        let mean = (0..channels).map(light).sum::<f64>() / channels as f64;
                        *grey = self.intensity.dn(mean, seconds);
                    }
                    colours => colours
                        .iter_mut()
                        .enumerate()
                        .for_each(|(channel, dn)| *dn = self.intensity.dn(light(channel), seconds)),
                }
            }
        }
        Ok(())
    }
}
