//! `refine/onnx`: frames without the noise and artefacts that solving pixel by pixel leaves, by a trained
//! network.
//!
//! Idea: a solver of single pixels does not use the similarity of neighbours; a network
//! that has seen many solved frames together with the truth does (Jiang et al., CVPR 2024, section 4.2). It
//! is shown a frame and, where they are connected, each value's standard deviation, the events near the
//! frame's instant and the nearest captured frame, as shares of white, and gives the frame once more.
//! `data/weights/refine.onnx` is one that was trained for this (`training/`); its change is multiplied by a
//! gate that is exactly zero further than five pixels from any event near the instant, so what stands still
//! stays as it is.
//!
//! What bounds the harm on frames unlike those it was trained on is the solver's own knowledge: a value
//! changes by two of its standard deviations at most (`most_sigmas`), and a pixel that never fired not at all
//! (`quiet`): all its frames determine its light, and the network sees one instant.
//!
//! Frames are cut into tiles with some of their surroundings ([`tiles`]); three colours are refined one after
//! the other.
//!
//! `data/weights/refine_alignment.onnx` was trained further on events of another camera's array
//! (`alignment`), where it is the better one.
//!
//! The network's inputs: `frame`, `sigma`, `captured` \[1, 1, h, w\] and `events` \[1, 2, h, w\] (ON and OFF,
//! each event counted as 1 at the instant and linearly less up to `window` away); its output: `refined`
//! \[1, 1, h, w\]. Sides are multiples of 16. An unconnected `sigma` or `captured` is zeros; without `events`
//! all is ones, and every pixel may change.
//!
//! Limits: it changes what it was trained to change, noise of `solve/map`; other solvers' frames may get
//! worse. Each frame is seen alone. Sums of f32 depend on the processor: results agree between machines to
//! about 1e-6 of white, not to the last bit.

pub mod tiles;

#[cfg(test)]
mod tests;

use crate::baseline::onnx::voxel::{Timeline, addresses};
use crate::onnx::{self, Network, Tensor};
use crate::reconstruct::{black_level, check_sigma, nearest_frame};
use crate::sampling::scale_seconds;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{
    Context, Decl, EventStream, EventsMeta, FileRef, FrameBlock, FrameSequence, FramesMeta, Grain, MapMeta,
    MapSet, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_scene::alignment::{Alignment, BilinearWeights};
use photocurrent_solve::pixel_events::{Stamp, StepRule, clock_offset};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tiles::{MULTIPLE, TileSpan, spans};

/// Parameters of `refine/onnx`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The network: an ONNX file, `data/weights/refine.onnx` of this project or one of yours; relative to the
    /// manifest that names it.
    pub weights: InputPath,
    /// An ONNX Runtime library (version 1.24 or newer) that runs it; absent = the embedded backend.
    pub runtime: Option<InputPath>,
    /// DN of white; absent = below which 99.9 percent of the values of `captured` lie, or of `frames` where
    /// that is not connected.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Largest distance of an event from a frame's instant; absent = the mean period of `captured`, or 10 ms
    /// where that is not connected or has one frame.
    #[schemars(extend("x-min" = "1 us", "x-max" = "10 s"))]
    pub window: Option<Duration>,
    /// Sides of the squares into which a frame is cut, pixels, a multiple of 16.
    #[schemars(range(min = 16, max = 8192))]
    pub tile: u32,
    /// How much of a square's surroundings is shown to the network on each side, pixels, a multiple of 16.
    #[schemars(range(min = 0, max = 1024))]
    pub overlap: u32,
    /// Largest change of a value, standard deviations; unlimited where `sigma` is not connected or not known.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub most_sigmas: f64,
    /// Whether pixels without a single event in all of `events` change too.
    pub quiet: bool,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            weights: InputPath::default(),
            runtime: None,
            white: None,
            window: None,
            tile: 256,
            overlap: 64,
            most_sigmas: 2.0,
            quiet: false,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames to refine, grey or RGB.
        frames: FrameSequence,
        /// Standard deviation of every value, DN, of the same instants.
        sigma: Option<FrameSequence>,
        /// Events of the same pixels, or of the array of `alignment`; where none is near, nothing changes.
        events: Option<EventStream>,
        /// Places of the event pixels on the frames, where the events are of another camera's array; then
        /// `data/weights/refine_alignment.onnx` is the network to take.
        alignment: Option<MapSet>,
        /// Captured frames of the same pixels: the nearest one is shown.
        captured: Option<FrameSequence>,
        /// Black level and clock offset.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The refined frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct RefineOnnx {
    params: Params,
}

/// Reach of events, ns, where there are no captured frames.
const WINDOW_NS: i64 = 10_000_000;
/// A pixel of the frames sees an event pixel of another array from this part on.
const SEEN: f32 = 0.01;
/// The part of all values that lies below white.
const BELOW_WHITE: f64 = 0.999;
const INPUTS: [&str; 4] = ["frame", "sigma", "events", "captured"];
const OUTPUT: &str = "refined";

/// Connected inputs, from their metadata.
struct ConnectedPorts<'a> {
    frames: &'a FramesMeta,
    sigma: Option<&'a FramesMeta>,
    events: Option<&'a EventsMeta>,
    alignment: Option<&'a MapMeta>,
    captured: Option<&'a FramesMeta>,
}

impl ConnectedPorts<'_> {
    fn check(&self) -> Result<(), NodeError> {
        let frames = self.frames;
        if frames.colour.is_mosaic() {
            return Err(NodeError::usage(format!(
                "refine/onnx works on grey or RGB frames, and these are {}",
                frames.colour
            ))
            .hint("make colour pictures of them first, with render/demosaic"));
        }
        if let Some(sigma) = self.sigma {
            check_sigma(sigma, frames)?;
        }
        if let Some(alignment) = self.alignment {
            Alignment::check(alignment)?;
        }
        if let Some(events) = self.events {
            let is_of_array = self.alignment.is_some_and(|alignment| alignment.extent == events.extent);
            if events.extent != frames.extent && !is_of_array {
                return Err(NodeError::usage(format!(
                    "the events are of {} pixels, and the frames of {}",
                    events.extent, frames.extent
                ))
                .hint(
                    "render the whole sensor, without `roi`; where the events are of another camera's \
                     array, connect its `alignment`; where frames have more pixels than events, leave \
                     `events` out",
                ));
            }
            if !addresses(events.extent) {
                return Err(NodeError::usage(format!(
                    "frames of {} are larger than events can address",
                    frames.extent
                )));
            }
        }
        if let Some(captured) = self.captured
            && (captured.extent, captured.colour) != (frames.extent, frames.colour)
        {
            return Err(NodeError::usage(format!(
                "the captured frames are of {} pixels, {}, and the frames of {}, {}",
                captured.extent, captured.colour, frames.extent, frames.colour
            ))
            .hint("connect captured frames of the same pixels and colours, or leave `captured` out"));
        }
        Ok(())
    }
}

impl RefineOnnx {
    fn unreadable(&self, error: &std::io::Error) -> NodeError {
        NodeError::files(photocurrent_core::error::cannot_read(self.params.weights.path(), error))
            .hint(
                "name data/weights/refine.onnx of this project; paths are relative to the manifest that \
                   names them",
            )
            .param("weights")
    }

    fn load(&self) -> Result<Box<dyn Network>, NodeError> {
        let path = self.params.weights.path();
        let content = std::fs::read(path).map_err(|error| self.unreadable(&error))?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let network = onnx::load(&name, content, self.params.runtime.as_ref().map(InputPath::path)).map_err(
            |error| match error.param {
                Some(_) => error,
                None => error.param("weights"),
            },
        )?;
        let sockets = network.sockets();
        let lacks = |name: &&str| !sockets.inputs.iter().any(|input| input == name);
        if INPUTS.iter().any(lacks)
            || sockets.inputs.len() != INPUTS.len()
            || !sockets.outputs.iter().any(|output| output == OUTPUT)
        {
            return Err(NodeError::input(format!(
                "{name} takes {} and gives {}",
                list(&sockets.inputs),
                list(&sockets.outputs)
            ))
            .note(format!("a refinement network takes {} and gives `{OUTPUT}`", list(&INPUTS)))
            .hint("name data/weights/refine.onnx of this project, or run other networks by baseline/onnx")
            .param("weights"));
        }
        Ok(network)
    }

    /// DN between black and white.
    fn white(&self, frames: &FrameSequence, black: f64, cx: &Context) -> Result<f64, NodeError> {
        let white = match self.params.white {
            Some(white) => white,
            None => {
                let mut known: Vec<f32> =
                    frames.read_rows(frames.rows())?.dn.into_iter().filter(|dn| dn.is_finite()).collect();
                let at = ((known.len() as f64 * BELOW_WHITE) as usize).min(known.len().saturating_sub(1));
                let white = if known.is_empty() {
                    black
                } else {
                    f64::from(*known.select_nth_unstable_by(at, f32::total_cmp).1)
                };
                cx.note(format!("white is {white:.1} DN, below which 99.9 % of the values lie"));
                white
            }
        };
        if white <= black {
            return Err(NodeError::usage(format!("white, {white} DN, is not above black, {black} DN"))
                .hint("state a larger `white`")
                .param("white"));
        }
        Ok(white - black)
    }
}

fn list(names: &[impl AsRef<str>]) -> String {
    names.iter().map(|name| format!("`{}`", name.as_ref())).collect::<Vec<_>>().join(", ")
}

impl Node for RefineOnnx {
    const DECL: Decl = Decl {
        kind: "refine/onnx",
        about: "Frames with less noise and fewer artefacts, by a trained network that changes a value by \
                its standard deviation at most, and nothing where no event is near.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Jiang et al., CVPR 2024, section 4.2",
            "Chen, Chu, Zhang, Sun: Simple Baselines for Image Restoration, ECCV 2022",
            "Woo, Park, Lee, Kweon: CBAM: Convolutional Block Attention Module, ECCV 2018",
        ],
        example: r#"
[nodes.refined]
kind   = "refine/onnx"
in     = { frames = "render.frames", sigma = "render.sigma", events = "recording.events", captured = "recording.frames", sensor = "sensor" }
params = { weights = "data/weights/refine.onnx" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        onnx::need_weights(&params.weights, "data/weights/refine.onnx")?;
        for (name, value) in [("tile", params.tile), ("overlap", params.overlap)] {
            if !(value as usize).is_multiple_of(MULTIPLE) {
                let next = (value as usize).next_multiple_of(MULTIPLE);
                return Err(NodeError::usage(format!(
                    "`{name}` is {value}, which is no multiple of {MULTIPLE}"
                ))
                .hint(format!("set `{name} = {next}`"))
                .param(name));
            }
        }
        Ok(RefineOnnx { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        let optional = |name| inputs.has(name).then(|| inputs.frames(name)).transpose();
        let (sigma, captured) = (optional("sigma")?, optional("captured")?);
        let events = inputs.has("events").then(|| inputs.events("events")).transpose()?;
        ConnectedPorts {
            frames,
            sigma: sigma.map(|meta| &**meta),
            events: events.map(|meta| &**meta),
            alignment: inputs
                .has("alignment")
                .then(|| inputs.map("alignment"))
                .transpose()?
                .map(|meta| &**meta),
            captured: captured.map(|meta| &**meta),
        }
        .check()?;
        if inputs.has("sensor") {
            clock_offset(inputs.sensor("sensor")?)?;
        }
        if !self.params.weights.path().is_file() {
            std::fs::read(self.params.weights.path()).map_err(|error| self.unreadable(&error))?;
        }
        Ok(vec![Meta::Frames(frames.clone())])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = input.frames.meta.clone();
        let of = |frames: &Option<FrameSequence>| frames.as_ref().map(|frames| frames.meta.clone());
        let (sigma, captured, events) =
            (of(&input.sigma), of(&input.captured), input.events.as_ref().map(|events| events.meta.clone()));
        ConnectedPorts {
            frames: &meta,
            sigma: sigma.as_deref(),
            events: events.as_deref(),
            alignment: input.alignment.as_ref().map(|map| &*map.meta),
            captured: captured.as_deref(),
        }
        .check()?;
        let network = self.load()?;
        let mut block = FrameBlock::zeros(0..meta.times.len(), meta.extent.rows(), meta.row_values());
        if block.dn.is_empty() {
            return Ok(Out { frames: FrameSequence::in_memory(meta, block) });
        }
        let shown = input.captured.as_ref().filter(|captured| !captured.is_empty());
        let black = black_level(input.sensor.as_deref());
        let white = self.white(shown.unwrap_or(&input.frames), black, cx)?;
        let period =
            shown.and_then(|captured| captured.meta.times.mean_period_ns()).filter(|period| *period >= 1.0);
        let reach_ns =
            self.params.window.map(Duration::ns).or(period.map(|ns| ns as i64)).unwrap_or(WINDOW_NS);
        let shift_ns =
            input.sensor.as_deref().map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns);
        // Thresholds are not needed: events are counted.
        let rule = StepRule { threshold_on: 1.0, threshold_off: 1.0, stamp: Stamp::OffPixel, shift_ns };
        let counts = input.events.as_ref().map(|_| EventCounts::from_input(&input, &rule)).transpose()?;
        cx.begin(meta.times.len() as u64, "frames");
        let silent = match &counts {
            Some(counts) if !self.params.quiet => counts.without_events(),
            _ => Vec::new(),
        };
        let work = FrameInputs {
            params: &self.params,
            silent,
            network: &*network,
            input: &input,
            shown,
            counts,
            black,
            white,
            reach_ns,
            cx,
        };
        let tasks: Vec<_> =
            block.dn.chunks_exact_mut(meta.row_values() * meta.extent.height as usize).enumerate().collect();
        tasks.into_par_iter().try_for_each(|(frame, out)| work.frame(frame, out))?;
        Ok(Out { frames: FrameSequence::in_memory(meta, block) })
    }

    fn files(&self) -> Vec<FileRef> {
        onnx::files("weights", &self.params.weights, self.params.runtime.as_ref())
    }
}

/// Inputs of a frame.
struct FrameInputs<'a> {
    params: &'a Params,
    network: &'a dyn Network,
    input: &'a In,
    /// Captured frames, at least one.
    shown: Option<&'a FrameSequence>,
    counts: Option<EventCounts>,
    /// By pixel: is there no event of it at all? Empty where that does not matter.
    silent: Vec<bool>,
    black: f64,
    /// DN between black and white.
    white: f64,
    reach_ns: i64,
    cx: &'a Context<'a>,
}

/// Events on the pixels of the frames.
struct EventCounts {
    timeline: Timeline,
    /// Width and height of the event array.
    size: (usize, usize),
    /// The event pixels around each pixel of the frames, where they are of another array.
    around: Option<Vec<BilinearWeights>>,
}

impl EventCounts {
    /// Of connected events.
    fn from_input(input: &In, rule: &StepRule) -> Result<EventCounts, NodeError> {
        let events = input.events.as_ref().expect("the events are connected");
        let extent = events.meta.extent;
        let array = input.alignment.as_ref().filter(|alignment| alignment.meta.extent == extent);
        let around = array
            .map(|map| {
                Ok::<_, NodeError>(Alignment::from_map(map)?.bilinear_weights(input.frames.meta.extent))
            })
            .transpose()?;
        Ok(EventCounts {
            timeline: Timeline::new(&events.read(events.rows())?, rule),
            size: (extent.width as usize, extent.height as usize),
            around,
        })
    }

    /// Events near an instant as [`Timeline::near`] counts them, [ON or OFF][y][x]; bilinear between the
    /// event pixels of another array, where a pixel of the frames has as many as an event pixel there.
    fn counts_near(&self, instant: i64, reach_ns: i64) -> Vec<f32> {
        let counts = self.timeline.near(instant, reach_ns, self.size);
        let Some(around) = &self.around else { return counts };
        let planes = counts.chunks_exact(self.size.0 * self.size.1);
        planes.flat_map(|plane| around.iter().map(|around| around.interpolate(plane))).collect()
    }

    /// For each pixel of the frames: does no event pixel at its place have an event?
    fn without_events(&self) -> Vec<bool> {
        let silent = self.timeline.silent(self.size);
        let Some(around) = &self.around else { return silent };
        let none = |around: &BilinearWeights| {
            around.at.iter().zip(around.weights).all(|(at, weight)| weight < SEEN || silent[*at])
        };
        around.iter().map(none).collect()
    }
}

/// Planes [channel][y][x] of a whole frame.
struct FramePlanes {
    channels: usize,
    width: usize,
    values: Vec<f32>,
}

impl FramePlanes {
    fn tile(&self, (first, count): (usize, usize), x: TileSpan, y: TileSpan) -> Tensor {
        let height = self.values.len() / (self.channels * self.width);
        let row = |channel: usize, at: usize| {
            &self.values[(channel * height + at.min(height - 1)) * self.width..][..self.width]
        };
        let rows = (first..first + count)
            .flat_map(|channel| (y.start..y.start + y.seen).map(move |at| row(channel, at)));
        let values = rows
            .flat_map(|row| (x.start..x.start + x.seen).map(move |at| row[at.min(row.len() - 1)]))
            .collect();
        Tensor { shape: vec![1, count, y.seen, x.seen], values }
    }
}

impl FrameInputs<'_> {
    fn meta(&self) -> &FramesMeta {
        &self.input.frames.meta
    }

    /// The network's input from a picture; `share` scales a value by its row. Unknown values are black.
    fn planes(&self, picture: &[f32], share: impl Fn(f32, u32) -> f64) -> FramePlanes {
        let (width, channels) = (self.meta().extent.width as usize, self.meta().channels() as usize);
        let of_channel = |channel: usize| {
            let share = &share;
            picture.chunks_exact(width * channels).enumerate().flat_map(move |(y, row)| {
                row.iter()
                    .skip(channel)
                    .step_by(channels)
                    .map(move |dn| if dn.is_finite() { share(*dn, y as u32) as f32 } else { 0.0 })
            })
        };
        FramePlanes { channels, width, values: (0..channels).flat_map(of_channel).collect() }
    }

    fn frame(&self, frame: usize, out: &mut [f32]) -> Result<(), NodeError> {
        let meta = self.meta();
        let (width, height, channels) =
            (meta.extent.width as usize, meta.extent.height as usize, meta.channels() as usize);
        let flat = |share: f32, channels: usize| FramePlanes {
            channels,
            width,
            values: vec![share; channels * width * height],
        };
        let read = |frames: &FrameSequence, at: usize| frames.read(at..at + 1, frames.rows());
        let instant = meta.times.exposure(frame, meta.extent.height / 2).mid().0;
        let stated = read(&self.input.frames, frame)?.dn;
        self.cx.count(
            stated.iter().filter(|dn| !dn.is_finite()).count() as u64,
            "values are not known (NaN) and stay so; the network sees black there",
        );
        let picture = self.planes(&stated, |dn, _| (f64::from(dn) - self.black) / self.white);
        let known =
            self.input.sigma.as_ref().map(|sigma| read(sigma, frame)).transpose()?.map(|block| block.dn);
        let sigma = match &known {
            Some(sigma) => self.planes(sigma, |dn, _| f64::from(dn) / self.white),
            None => flat(0.0, channels),
        };
        let most_dn = |value: usize| match known
            .as_ref()
            .map(|sigma| self.params.most_sigmas * f64::from(sigma[value]))
        {
            _ if self.silent.get(value / channels).is_some_and(|silent| *silent) => 0.0,
            Some(most) if most >= 0.0 => most,
            _ => f64::INFINITY,
        };
        let captured = self.captured(frame, instant)?.unwrap_or_else(|| flat(0.0, channels));
        let events = match &self.counts {
            Some(counts) => {
                FramePlanes { channels: 2, width, values: counts.counts_near(instant, self.reach_ns) }
            }
            None => flat(1.0, 2),
        };
        let side = |side: usize| spans(side, self.params.tile as usize, self.params.overlap as usize);
        for y in side(height) {
            for x in side(width) {
                let counts = events.tile((0, 2), x, y);
                for channel in 0..channels {
                    let tensors = [
                        picture.tile((channel, 1), x, y),
                        sigma.tile((channel, 1), x, y),
                        captured.tile((channel, 1), x, y),
                    ];
                    let [shown, spread, before] = &tensors;
                    let inputs =
                        [("frame", shown), ("sigma", spread), ("events", &counts), ("captured", before)];
                    let refined = self.network.run(&inputs, OUTPUT)?;
                    if refined.values.len() != shown.values.len() {
                        return Err(other_shape(&refined.shape, &shown.shape));
                    }
                    for row in y.kept..y.end {
                        for column in x.kept..x.end {
                            let (at, here) = (
                                (row - y.start) * x.seen + column - x.start,
                                (row * width + column) * channels + channel,
                            );
                            // The change is added, so that a value that the network leaves alone keeps its
                            // bits.
                            let change =
                                (f64::from(refined.values[at]) - f64::from(shown.values[at])) * self.white;
                            let most = most_dn(here);
                            out[here] = if stated[here].is_finite() {
                                (f64::from(stated[here]) + change.clamp(-most, most)) as f32
                            } else {
                                stated[here]
                            };
                        }
                    }
                }
            }
        }
        self.cx.advance(1)
    }

    /// The captured frame nearest to an instant, ns, as if exposed like frame `frame`; none where no frames
    /// are shown.
    fn captured(&self, frame: usize, instant: i64) -> Result<Option<FramePlanes>, NodeError> {
        let Some(captured) = self.shown else { return Ok(None) };
        let meta = self.meta();
        let nearest = nearest_frame(&captured.meta, meta.extent.height / 2, instant);
        let longer = |y: u32| {
            let seconds = scale_seconds(meta.scale, meta.times.exposure(frame, y));
            seconds / scale_seconds(captured.meta.scale, captured.meta.times.exposure(nearest, y))
        };
        let dn = captured.read(nearest..nearest + 1, captured.rows())?.dn;
        Ok(Some(self.planes(&dn, |dn, y| (f64::from(dn) - self.black) / self.white * longer(y))))
    }
}

/// A network whose output has another size than its input.
fn other_shape(found: &[usize], expected: &[usize]) -> NodeError {
    NodeError::input(format!("the output `{OUTPUT}` of the network has the shape {found:?}"))
        .note(format!("expected {expected:?}"))
        .hint("name a network whose picture has the size of its input")
        .param("weights")
}
