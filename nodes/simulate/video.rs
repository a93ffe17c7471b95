//! `simulate/video`: light of a real film, from a folder of pictures or a Y4M file, and true frames of it.
//!
//! A high-speed film is light at the instants of its frames; between them it is taken as linear, which is all
//! that light between instants can be here. An instant without which the line is the same, to the last stored
//! bit, is dropped, so that what stands still costs one instant however long the film is. White is the stated
//! illuminance, and the darkest light is bounded, so that its logarithm is finite.
//!
//! Works by row bands; of a band, a few frames are decoded at a time (of a PNG picture, the rows above it
//! too: its rows are packed together). True frames are the film at instants, linear between its frames.
//!
//! Limits: grey, as luminance. Motion of more than about a pixel from frame to frame becomes a cross-fade and
//! not motion: choose a film that is fast enough for what moves in it. Noise of the film is light to the
//! sensor: a film of a noisy camera makes events everywhere.

use super::instants::Thinned;
use super::source::{In, Metas, Out, Scale, TruthParams};
use super::stored::folder::{self, Pictures};
use super::stored::y4m::Y4m;
use super::stored::{Film, Transfer, Window, cannot_read, short_name};
use crate::crop::Crop;
use photocurrent_core::quantity::{Duration, Illuminance, InputPath, Rate};
use photocurrent_core::{
    Context, Decl, FileRef, FrameBlock, Grain, LightBand, Meta, Node, NodeError, PortMetas, Rows, Sensor,
};
use photocurrent_formats::ycbcr::Range;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::OnceLock;

/// Parameters of `simulate/video`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The film: a folder of PNG, TIFF or JPEG pictures (grey or RGB, 8 or 16 bits, sorted by name, `f2`
    /// before `f10`), or a Y4M file; relative to the manifest that names it.
    pub path: InputPath,
    /// Frames per second at which it was taken. Needed for a folder; for a Y4M file the default is what its
    /// header says.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "10 MHz"))]
    pub rate: Option<Rate>,
    /// How stored values become linear light. Default: `srgb` for pictures, `bt709` for Y4M.
    pub transfer: Option<Transfer>,
    /// Which stored luma of a Y4M file is black and white. Default: what its header says, otherwise
    /// `limited`.
    pub range: Option<Range>,
    /// The part of the pictures that is seen. Default: everything.
    pub crop: Option<Crop>,
    /// Pixels in a row of the light: the part's width over a whole number; squares of pixels are averaged in
    /// linear light. Default: as `height` says, or all.
    #[schemars(range(min = 1, max = 65_536))]
    pub width: Option<u32>,
    /// Rows of the light: the part's height over the same whole number. Default: as `width` says, or all.
    #[schemars(range(min = 1, max = 65_536))]
    pub height: Option<u32>,
    /// Where in the film the light begins, counted from its first frame.
    #[schemars(extend("x-min" = "0 ns"))]
    pub start: Duration,
    /// Length of the light. Default: to the film's last frame.
    #[schemars(extend("x-min" = "1 us"))]
    pub duration: Option<Duration>,
    /// Light on what is stored as full white.
    #[schemars(extend("x-min" = "0.001 lx", "x-max" = "1000000 lx"))]
    pub illuminance: Illuminance,
    /// Darkest light, as a share of white's; what is stored darker counts as this. Below the default, one
    /// step of an 8-bit value is a good part of a threshold.
    #[schemars(range(min = 0.000001, max = 0.5))]
    pub black: f64,
    /// True frames per second, at multiples of the period from 0 on.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "1 MHz"))]
    pub truth_rate: Rate,
    /// Exposure that true frames are scaled to: that of the captured frames they are compared with.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// How far light may be off where an instant is dropped, as a share of it. 0 drops only what makes no
    /// difference to the stored bits.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub tolerance: f64,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            path: InputPath::default(),
            rate: None,
            transfer: None,
            range: None,
            crop: None,
            width: None,
            height: None,
            start: Duration::new(0),
            duration: None,
            illuminance: Illuminance::new(300.0),
            black: 0.01,
            truth_rate: Rate::new(1000.0),
            exposure: Duration::new(6_500_000),
            tolerance: 0.0,
        }
    }
}

/// The node.
pub struct SimulateVideo {
    params: Params,
    /// The files, listed once: what is planned, what enters the key and what is read are the same.
    files: OnceLock<Result<Files, NodeError>>,
    opened: OnceLock<Opened>,
}

const WHO: &str = "simulate/video";

/// What the path names.
enum Files {
    Pictures(Vec<PathBuf>),
    Y4m(PathBuf),
}

/// The film, and what of it is seen when.
struct Opened {
    film: Box<dyn Film>,
    window: Window,
    /// Instants of its frames, ns from the light's beginning: the first used one is at 0 or before, the last
    /// at the end or later.
    times: Vec<i64>,
    /// The number of the first used frame.
    first: usize,
    end_ns: i64,
    /// What the header leaves open.
    notes: Vec<String>,
}

/// At most so many values are decoded at a time: 32 MB.
const DECODED_VALUES: usize = 1 << 22;

impl SimulateVideo {
    fn listed(&self) -> Result<&Files, NodeError> {
        let listed = self.files.get_or_init(|| {
            let path = self.params.path.path();
            if std::fs::metadata(path).map_err(|error| cannot_read(path, &error))?.is_dir() {
                return Ok(Files::Pictures(folder::pictures(path)?));
            }
            Ok(Files::Y4m(path.into()))
        });
        listed.as_ref().map_err(Clone::clone)
    }

    fn open(&self) -> Result<&Opened, NodeError> {
        if let Some(opened) = self.opened.get() {
            return Ok(opened);
        }
        let params = &self.params;
        let (film, rate, notes): (Box<dyn Film>, Option<f64>, Vec<String>) = match self.listed()? {
            Files::Pictures(paths) => {
                if params.range.is_some() {
                    return Err(NodeError::usage("`range` is set, and pictures always use all of theirs")
                        .hint("leave `range` out")
                        .param("range"));
                }
                (
                    Box::new(Pictures::open(paths.clone(), params.transfer.unwrap_or(Transfer::Srgb))?),
                    None,
                    Vec::new(),
                )
            }
            Files::Y4m(path) => {
                let film = Y4m::open(path, params.transfer.unwrap_or(Transfer::Bt709), params.range)?;
                let (rate, notes) = (film.rate(), film.notes().to_vec());
                (Box::new(film), rate, notes)
            }
        };
        let rate = params.rate.map(Rate::hz).or(rate).ok_or_else(|| {
            NodeError::usage("`rate` is missing, and the film does not say how fast it was taken")
                .hint("state the frames per second of the camera, such as `rate = \"1 kHz\"`")
                .param("rate")
        })?;
        let window = Window::new(film.extent(), params.crop, params.width, params.height)?;
        let times = frame_times(film.frames(), rate, params)?;
        let end_ns = params.duration.map_or(times[times.len() - 1], Duration::ns);
        let first = times.partition_point(|t| *t <= 0) - 1;
        let last = times.partition_point(|t| *t < end_ns);
        let times = times[first..=last].to_vec();
        Ok(self.opened.get_or_init(|| Opened { film, window, times, first, end_ns, notes }))
    }

    fn metas(&self, opened: &Opened) -> Result<Metas, NodeError> {
        let truth = TruthParams { rate: self.params.truth_rate, exposure: self.params.exposure };
        Metas::new(opened.window.extent(), opened.end_ns, opened.times.len() as f64, truth)
    }

    fn scale(&self, sensor: &Sensor) -> Result<Scale, NodeError> {
        Scale::new(sensor, self.params.illuminance, self.params.exposure, WHO)
    }
}

/// Instants of all frames, ns from the light's beginning.
fn frame_times(frames: usize, rate: f64, params: &Params) -> Result<Vec<i64>, NodeError> {
    let name = short_name(params.path.path());
    if frames < 2 {
        let count = if frames == 1 { "one frame" } else { "no frame" };
        return Err(NodeError::input(format!("{name} has {count}, and light between frames needs two"))
            .hint("simulate/photo moves one picture")
            .param("path"));
    }
    let times: Vec<i64> =
        (0..frames).map(|k| (k as f64 * 1e9 / rate).round() as i64 - params.start.ns()).collect();
    let end = times[frames - 1];
    let film = format!(
        "{frames} frames at {}: the last is {} after the first",
        Rate::new(rate),
        Duration::new(end + params.start.ns())
    );
    if end <= 0 {
        return Err(NodeError::usage(format!("`start` is {}, and {name} is over by then", params.start))
            .note(film)
            .hint("make `start` smaller")
            .param("start"));
    }
    if params.duration.is_some_and(|duration| duration.ns() > end) {
        return Err(NodeError::usage(format!(
            "{name} is shorter than `duration` asks for: {} are left from `start` on",
            Duration::new(end)
        ))
        .note(film)
        .hint("make `duration` shorter, or leave it out for the whole film")
        .param("duration"));
    }
    Ok(times)
}

impl Node for SimulateVideo {
    const DECL: Decl = Decl {
        kind: "simulate/video",
        about: "Light of a real high-speed film, from pictures or a Y4M file, and true frames of it.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &[
            "YUV4MPEG2 (mjpegtools, yuv4mpeg(5))",
            "IEC 61966-2-1 (sRGB) and ITU-R BT.709: transfer curves, luminance",
        ],
        example: r#"
[nodes.film]
kind   = "simulate/video"
in     = { sensor = "sensor" }
params = { path = "drop/frames", rate = "5 kHz", transfer = "linear", illuminance = "1000 lx", truth_rate = "5 kHz" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.path.path().as_os_str().is_empty() {
            return Err(NodeError::usage("`path` is missing")
                .hint("name a folder of pictures or a Y4M file, such as `path = \"film.y4m\"`")
                .param("path"));
        }
        Ok(SimulateVideo { params, files: OnceLock::new(), opened: OnceLock::new() })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let opened = self.open()?;
        self.scale(inputs.sensor("sensor")?)?;
        Ok(self.metas(opened)?.planned())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let opened = self.open()?;
        let (metas, scale, rows) = (self.metas(opened)?, self.scale(&input.sensor)?, cx.rows());
        opened.notes.iter().for_each(|note| cx.note(note.clone()));
        let width = opened.window.extent().width as usize;
        let mut parts: Vec<Row> = rows
            .iter()
            .map(|y| Row::new(width, metas.truth_block(Rows { start: y, end: y + 1 }, cx)))
            .collect();
        let shown: Vec<i64> = metas.truth.times.exposures.iter().map(|exposure| exposure.start.0).collect();
        let together = (DECODED_VALUES / (rows.len() * width).max(1)).clamp(1, 32);
        let photocurrent = |light: &f64| f64::from((scale.white * light.max(self.params.black)) as f32);
        cx.begin(opened.times.len() as u64, "frames");
        for from in (0..opened.times.len()).step_by(together) {
            let frames = from..(from + together).min(opened.times.len());
            let decoded: Result<Vec<Vec<f64>>, NodeError> = frames
                .clone()
                .into_par_iter()
                .map(|k| opened.window.read(&*opened.film, opened.first + k, rows))
                .collect();
            let decoded = decoded?;
            parts.par_iter_mut().enumerate().for_each(|(at, row)| {
                for (k, light) in frames.clone().zip(&decoded) {
                    let now = light[at * width..][..width].iter().map(photocurrent);
                    row.add(
                        &Step { t: opened.times[k], end: opened.end_ns, shown: &shown },
                        now,
                        self.params.tolerance,
                        &scale,
                    );
                }
            });
            cx.advance(frames.len() as u64)?;
        }
        let parts = rows.iter().zip(parts).map(|(y, row)| row.finish(y)).collect();
        Ok(metas.out(rows, parts))
    }

    fn files(&self) -> Vec<FileRef> {
        let paths = match self.listed() {
            Ok(Files::Pictures(paths)) => paths.clone(),
            Ok(Files::Y4m(path)) => vec![path.clone()],
            // The plan reports what is wrong with it.
            Err(_) => vec![self.params.path.path().into()],
        };
        paths.into_iter().map(|path| FileRef { param: "path".into(), path }).collect()
    }
}

/// One row of pixels, on its way through the frames.
struct Row {
    pixels: Vec<Pixel>,
    /// The instant of the frame before.
    before_ns: i64,
    truth: FrameBlock,
    /// How many true frames are drawn.
    drawn: usize,
}

struct Pixel {
    /// Photocurrent in the frame before.
    before: f64,
    kept: Option<Thinned>,
}

/// The instant of a frame among others.
struct Step<'a> {
    t: i64,
    end: i64,
    /// Instants of all true frames.
    shown: &'a [i64],
}

impl Row {
    fn new(width: usize, truth: FrameBlock) -> Row {
        Row {
            pixels: (0..width).map(|_| Pixel { before: 0.0, kept: None }).collect(),
            before_ns: i64::MIN,
            truth,
            drawn: 0,
        }
    }

    /// Adds a frame: photocurrents as they are stored, in `f32`.
    fn add(&mut self, step: &Step, now: impl Iterator<Item = f64>, tolerance: f64, scale: &Scale) {
        let (y, before_ns) = (self.truth.rows.start, self.before_ns);
        let wanted = &step.shown[..self.truth.frames.len()];
        let drawn = self.drawn..wanted.partition_point(|t| *t <= step.t).max(self.drawn);
        for (x, (pixel, now)) in self.pixels.iter_mut().zip(now).enumerate() {
            let line = |t: i64| match t == step.t {
                true => now,
                false => line_at((before_ns, pixel.before), (step.t, now), t),
            };
            // The light begins and ends between frames when that is asked for.
            if step.t >= 0 && pixel.kept.is_none() {
                pixel.kept = Some(Thinned::new((0, stored(line(0))), tolerance));
            }
            if let Some(kept) = pixel.kept.as_mut().filter(|_| step.t > 0) {
                let t = step.t.min(step.end);
                let next = stored(line(t));
                kept.add_within((t, next), (tolerance * next).max(rounding(next)));
            }
            for l in drawn.clone() {
                self.truth.row_mut(l, y)[x] = scale.true_dn(line(step.shown[l]));
            }
            pixel.before = now;
        }
        (self.before_ns, self.drawn) = (step.t, drawn.end);
    }

    fn finish(self, y: u32) -> (LightBand, FrameBlock) {
        let mut light = LightBand::begin(y, self.pixels.len() as u32);
        for pixel in self.pixels {
            let kept = pixel.kept.map_or_else(Vec::new, Thinned::finish);
            light.push(kept.into_iter().map(|(t, photocurrent)| (t, photocurrent as f32)));
        }
        (light, self.truth)
    }
}

/// As it is stored.
fn stored(photocurrent: f64) -> f64 {
    f64::from(photocurrent as f32)
}

/// The line between two instants, at a third.
fn line_at(from: (i64, f64), to: (i64, f64), t: i64) -> f64 {
    let share = (t - from.0) as f64 / (to.0 - from.0) as f64;
    from.1 * (1.0 - share) + to.1 * share
}

/// A number that is off by no more than this is stored as the same `f32`: half the smaller gap to its
/// neighbours, less a little for rounding.
fn rounding(value: f64) -> f64 {
    let value = value as f32;
    0.49 * f64::from(value - value.next_down())
}

#[cfg(test)]
#[path = "video_tests.rs"]
mod tests;
