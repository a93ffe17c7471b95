//! Writes frames as a folder of 16-bit PNGs with a table of their exposures, or as one HDF5 file.
//!
//! The folder holds `000000.png`, `000001.png` ... and `frames.csv`: when each frame was exposed, and how
//! codes become digital numbers (`dn = offset_dn + scale_dn * code`, in each row and in the first line).
//! Values are linear DN; there is no gamma, in the pixels or in the headers. DN stand for a frame of the
//! exposure that the first line names, so that rendered and recorded frames compare directly.
//!
//! With the sensor description connected, code 65535 is its `saturation_dn`: folders of one camera share a
//! code, and an outlier changes nothing. There is no headroom above it: a camera could not have said more,
//! and a linear picture is dark enough on a screen. What lies above is clipped and counted; who wants it
//! states a larger `scale` or takes `format = "hdf5_f32"`. Without a saturation the code spans the data, and
//! code 65535 is the highest value over all frames and pixels. Offset is the lowest value, or 0 when nothing
//! is negative. So a first pass looks for both ends, and a second one writes; a few frames are in memory at a
//! time. `offset` and `scale` can be stated instead.
//!
//! `preview = true` adds a folder of pictures that a person can look at: 8 bits, sRGB, white by a robust
//! percentile ([`super::display`]). The pictures of the folder itself are for programs; scores take neither.
//!
//! With `format = "hdf5_u16"` the same codes go into one file, `frames.h5`, and with `"hdf5_f32"` the values
//! themselves: \[frame, row, column\] in chunks, with exposures and code next to them (docs/formats.md), for
//! those who want thousands of frames in one piece.
//!
//! Limits: 16 bits are 1/65535 of the span between darkest and brightest pixel. A value that is not known
//! (NaN) becomes code 0 and is counted.

use super::display::Look;
use super::picture::Picture;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, FrameScale, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
    Table,
};
use photocurrent_store::{DnCode, write_rendered};
use png::BitDepth;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// A picture of 16 bits for each frame, and `frames.csv`.
    #[default]
    Png,
    /// One file `frames.h5` of 16-bit codes.
    Hdf5U16,
    /// One file `frames.h5` of 32-bit floating point; NaN stays NaN.
    Hdf5F32,
}

/// Parameters of `write/frames`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Pictures, or one HDF5 file of 16-bit codes or of 32-bit floating point.
    pub format: Format,
    /// DN per code, positive. Default: such that code 65535 is the saturation of the sensor description, or
    /// without one the highest value of all frames.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub scale: Option<f64>,
    /// DN of code 0. Default: the lowest value of all frames, or 0 when none is negative; with a saturation,
    /// no further below 0 than that is above.
    pub offset: Option<f64>,
    /// Also write pictures for looking into the folder `preview`, next to PNGs: 8 bits, sRGB, with white
    /// where 99.8 percent of the values lie below it (at most saturation). A note and a comment in each file
    /// say what black and white are. Never measure with them.
    pub preview: bool,
}

photocurrent_core::ports! {
    /// What is written.
    pub struct In {
        /// Frames, captured or rendered, grey or RGB.
        frames: FrameSequence,
        /// The sensor description: its saturation is the highest code, its black level the preview's black.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// What was written.
    pub struct Out {
        /// One row per file: index, t_start_ns, t_end_ns, t_mid_ns, file.
        listing: Arc<Table>,
    }
}

/// The node.
pub struct WriteFrames {
    params: Params,
}

/// The file of `format = "hdf5_u16"` and `"hdf5_f32"`.
const HDF5: &str = "frames.h5";

/// Frames in memory at a time take about this much.
const BYTES_AT_ONCE: usize = 64 << 20;

/// Which frames are read together.
fn batches(frames: &FrameSequence) -> impl Iterator<Item = Range<usize>> + use<> {
    let bytes = 4 * frames.meta.row_values() * frames.rows().len();
    let (count, step) = (frames.len(), (BYTES_AT_ONCE / bytes.max(1)).clamp(1, 64));
    (0..count).step_by(step).map(move |start| start..(start + step).min(count))
}

/// Lowest and highest known value; `None` when nothing is known.
fn range(frames: &FrameSequence, cx: &Context) -> Result<Option<(f32, f32)>, NodeError> {
    let mut range: Option<(f32, f32)> = None;
    for batch in batches(frames) {
        let block = frames.read(batch.clone(), frames.rows())?;
        let known = block.dn.par_iter().copied().filter(|dn| dn.is_finite()).map(|dn| (dn, dn));
        let here = known.reduce_with(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        range = range.into_iter().chain(here).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        cx.advance(batch.len() as u64)?;
    }
    Ok(range)
}

/// Light this many times as bright as saturation is never plausible: the solver holds it at e^3 of the
/// brightest frame.
const NEVER_PLAUSIBLE: f64 = 20.5;
/// Where the code spans the data and this share of them lies below a sixteenth of it, an outlier sets the
/// code.
const DARK_SHARE: f64 = 0.999;

/// What sets the code, and with it what is counted.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scale {
    Stated,
    /// Code 65535 is this many DN.
    Saturation(f64),
    /// The highest value of all.
    Data,
}

impl WriteFrames {
    fn scale(&self, sensor: Option<&Sensor>) -> Scale {
        let saturation =
            sensor.and_then(|sensor| sensor.frames.saturation_dn).filter(|saturation| *saturation > 0.0);
        match (self.params.scale, saturation) {
            (Some(_), _) => Scale::Stated,
            (None, Some(saturation)) => Scale::Saturation(saturation),
            (None, None) => Scale::Data,
        }
    }

    fn code(
        &self,
        frames: &FrameSequence,
        sensor: Option<&Sensor>,
        cx: &Context,
    ) -> Result<DnCode, NodeError> {
        if let (Some(offset), Some(scale)) = (self.params.offset, self.params.scale) {
            return Ok(DnCode { offset, scale });
        }
        let (lowest, highest) = range(frames, cx)?.unwrap_or((0.0, 0.0));
        let lowest = f64::from(lowest).min(0.0);
        let (lowest, highest) = match self.scale(sensor) {
            Scale::Saturation(saturation) => (lowest.max(-saturation), saturation),
            Scale::Stated | Scale::Data => (lowest, f64::from(highest)),
        };
        let offset = self.params.offset.unwrap_or(lowest);
        let span = highest - offset;
        let scale = self.params.scale.unwrap_or(if span > 0.0 { span / DnCode::WHITE } else { 1.0 });
        Ok(DnCode { offset, scale })
    }

    /// Notes on what codes could not say.
    fn report(&self, found: &Found, frames: &FrameSequence, sensor: Option<&Sensor>, cx: &Context) {
        cx.count(found.unknown, "values are not known (NaN) and were written as code 0");
        match self.scale(sensor) {
            Scale::Saturation(saturation) => {
                cx.count(
                    found.clipped,
                    &format!(
                        "values lie outside of what the code can say, up to saturation ({saturation} \
                              DN), and were clipped: `scale` makes room"
                    ),
                );
            }
            Scale::Stated | Scale::Data => {
                cx.count(found.clipped, "values lie outside of what the stated code can say and were clipped")
            }
        }
        cx.count(
            found.implausible,
            "values are more than 20 times saturation, which no frame can vouch \
                                     for: look at the node that made them",
        );
        let known = (frames.len() * frames.rows().len() * frames.meta.row_values()) as u64 - found.unknown;
        if self.scale(sensor) == Scale::Data
            && self.params.format != Format::Hdf5F32
            && (found.dark as f64) < known as f64
            && found.dark as f64 >= DARK_SHARE * known as f64
        {
            cx.note(
                "few bright values set the code, 99.9 percent lie below a sixteenth of it and look \
                     black: connect `sensor`, whose saturation sets it, or state `scale`",
            );
        }
    }
}

/// The exposure that one DN stands for.
pub(super) fn nominal_exposure_ns(meta: &FramesMeta) -> Option<i64> {
    match meta.scale {
        FrameScale::Nominal { exposure_ns } => Some(exposure_ns),
        FrameScale::Captured => meta.times.nominal_exposure_ns(),
    }
}

fn file_name(frame: usize) -> String {
    format!("{frame:06}.png")
}

/// `frames.csv`. A rolling shutter is stated at the end of the first line; without a statement the shutter is
/// global.
fn csv(meta: &FramesMeta, code: DnCode) -> String {
    let row_time = if meta.times.row_time_ns == 0 {
        String::new()
    } else {
        format!("; row_time_ns={}", meta.times.row_time_ns)
    };
    // `{:?}` writes the shortest decimal that reads back as the same number.
    let DnCode { offset, scale } = code;
    let exposure_ns = nominal_exposure_ns(meta).unwrap_or(0);
    let mut text = format!(
        "# dn = offset + scale * code; offset={offset:?} scale={scale:?}; \
                            exposure_dn_of_ns={exposure_ns}{row_time}\n"
    );
    text += "index,t_start_ns,t_end_ns,t_mid_ns,file,offset_dn,scale_dn\n";
    for (l, exposure) in meta.times.exposures.iter().enumerate() {
        text += &format!(
            "{l},{},{},{},{},{offset:?},{scale:?}\n",
            exposure.start.0,
            exposure.end.0,
            exposure.mid().0,
            file_name(l)
        );
    }
    text
}

fn listing(meta: &FramesMeta, file: impl Fn(usize) -> String) -> Table {
    let exposures = &meta.times.exposures;
    Table::default()
        .with("index", Column::Integers((0..exposures.len() as i64).collect()))
        .with("t_start_ns", Column::Integers(exposures.iter().map(|e| e.start.0).collect()))
        .with("t_end_ns", Column::Integers(exposures.iter().map(|e| e.end.0).collect()))
        .with("t_mid_ns", Column::Integers(exposures.iter().map(|e| e.mid().0).collect()))
        .with("file", Column::Texts((0..exposures.len()).map(file).collect()))
}

impl Node for WriteFrames {
    const DECL: Decl = Decl {
        kind: "write/frames",
        about: "Writes frames of linear DN with their exposures, as 16-bit PNGs or as one HDF5 file.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["16-bit PNG, linear (docs/formats.md)", "photocurrent-frames/1 (docs/formats.md)"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.pictures]
kind   = "write/frames"
in     = { frames = "recording.frames", sensor = "recording.sensor" }
params = { preview = true }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if let Some(scale) = params.scale.filter(|scale| !(scale.is_finite() && *scale > 0.0)) {
            return Err(NodeError::usage(format!(
                "`scale` is {scale}, and must be a positive number of DN per code"
            ))
            .param("scale"));
        }
        if let Some(offset) = params.offset.filter(|offset| !offset.is_finite()) {
            return Err(
                NodeError::usage(format!("`offset` is {offset}, and must be a number of DN")).param("offset")
            );
        }
        let hdf5 = "`format = \"hdf5_u16\"` or \"hdf5_f32\"";
        if params.preview && params.format != Format::Png {
            return Err(NodeError::usage(format!(
                "`preview` writes pictures next to PNGs, and does nothing with {hdf5}"
            ))
            .hint("take it out; write/contact_sheet shows frames in one picture")
            .param("preview"));
        }
        let stated = [("scale", params.scale.is_some()), ("offset", params.offset.is_some())];
        if let Some((name, _)) =
            stated.iter().find(|(_, is_stated)| *is_stated && params.format == Format::Hdf5F32)
        {
            return Err(NodeError::usage(format!(
                "`{name}` is that of codes, and `format = \"hdf5_f32\"` stores values as they are"
            ))
            .hint("take it out, or set `format = \"hdf5_u16\"`")
            .param(*name));
        }
        Ok(WriteFrames { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        if frames.times.is_empty() {
            return Err(NodeError::usage("`frames` has no frame to write")
                .hint("look at the time window of the node that makes them"));
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, meta, sensor) = (&input.frames, &input.frames.meta, input.sensor.as_deref());
        let folder = cx.export_dir()?;
        let found = match self.params.format {
            Format::Png => self.pictures(frames, sensor, folder, cx)?,
            Format::Hdf5U16 => self.codes(frames, sensor, folder, cx)?,
            Format::Hdf5F32 => {
                write_rendered(&folder.join(HDF5), frames, nominal_exposure_ns(meta).unwrap_or(0), None)?;
                Found::default()
            }
        };
        self.report(&found, frames, sensor, cx);
        let times = if self.params.format == Format::Png { "frames.csv" } else { HDF5 };
        if meta.times.row_time_ns != 0 {
            cx.note(format!(
                "rolling shutter: the times in {times} are those of row 0, each further row is {} ns later",
                meta.times.row_time_ns
            ));
        }
        let lengths = meta.times.exposures.iter().map(|exposure| exposure.length_ns());
        if let (FrameScale::Captured, Some(shortest), Some(longest)) =
            (meta.scale, lengths.clone().min(), lengths.max())
            && shortest != longest
        {
            cx.note(format!(
                "captured frames of {shortest} to {longest} ns: each keeps the DN of its own \
                             exposure; {times} names their median"
            ));
        }
        let file = |l: usize| if self.params.format == Format::Png { file_name(l) } else { HDF5.into() };
        Ok(Out { listing: Arc::new(listing(meta, file)) })
    }
}

/// How many values codes could not say.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    unknown: u64,
    clipped: u64,
    /// Far beyond saturation.
    implausible: u64,
    /// Below a sixteenth of the code's span.
    dark: u64,
}

impl Found {
    fn in_frame(values: &[f32], code: DnCode, most_plausible: f32) -> Found {
        let mut found = Found::default();
        for &dn in values {
            let (value, is_clipped) = code.of(dn);
            found.unknown += u64::from(dn.is_nan());
            found.clipped += u64::from(is_clipped && !dn.is_nan());
            found.implausible += u64::from(dn > most_plausible);
            found.dark += u64::from(value < 4096 && !dn.is_nan());
        }
        found
    }

    fn and(self, other: Found) -> Found {
        Found {
            unknown: self.unknown + other.unknown,
            clipped: self.clipped + other.clipped,
            implausible: self.implausible + other.implausible,
            dark: self.dark + other.dark,
        }
    }
}

/// What more DN than these are never plausible.
fn most_plausible(sensor: Option<&Sensor>) -> f32 {
    let Some(saturation) = sensor.and_then(|sensor| sensor.frames.saturation_dn) else {
        return f32::INFINITY;
    };
    let black = sensor.and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0);
    (black + NEVER_PLAUSIBLE * (saturation - black)) as f32
}

impl WriteFrames {
    /// PNGs, previews and `frames.csv`.
    fn pictures(
        &self,
        frames: &FrameSequence,
        sensor: Option<&Sensor>,
        folder: &Path,
        cx: &Context,
    ) -> Result<Found, NodeError> {
        let meta = &frames.meta;
        let preview = folder.join("preview");
        let look = if self.params.preview { Some(Look::of(frames, sensor, None)?) } else { None };
        if let Some(look) = look {
            std::fs::create_dir_all(&preview).map_err(|error| super::cannot_write(&preview, &error))?;
            cx.note(format!("preview/ is {}", look.about()));
        }
        let shown = look.map(|look| (look.curve(), look.about()));
        let passes = if self.params.offset.is_some() && self.params.scale.is_some() { 1 } else { 2 };
        cx.begin(passes * frames.len() as u64, "frames");
        let (code, most) = (self.code(frames, sensor, cx)?, most_plausible(sensor));
        let mut found = Found::default();
        for batch in batches(frames) {
            let block = frames.read(batch.clone(), frames.rows())?;
            let write = |l: usize| -> Result<Found, NodeError> {
                let (width, height, channels) =
                    (meta.extent.width, frames.rows().len() as u32, meta.channels());
                let bytes: Vec<u8> =
                    block.frame(l).iter().flat_map(|&dn| code.of(dn).0.to_be_bytes()).collect();
                Picture { width, height, channels, depth: BitDepth::Sixteen, bytes: &bytes, comment: None }
                    .save(&folder.join(file_name(l)))?;
                if let Some((curve, about)) = &shown {
                    let bytes: Vec<u8> = block.frame(l).iter().map(|&dn| curve.of(dn)).collect();
                    Picture {
                        width,
                        height,
                        channels,
                        depth: BitDepth::Eight,
                        bytes: &bytes,
                        comment: Some(about),
                    }
                    .save(&preview.join(file_name(l)))?;
                }
                cx.advance(1)?;
                Ok(Found::in_frame(block.frame(l), code, most))
            };
            let here: Result<Vec<Found>, NodeError> = batch.into_par_iter().map(write).collect();
            found = here?.into_iter().fold(found, Found::and);
        }
        super::save(&folder.join("frames.csv"), csv(meta, code).as_bytes())?;
        Ok(found)
    }

    /// One file of codes.
    fn codes(
        &self,
        frames: &FrameSequence,
        sensor: Option<&Sensor>,
        folder: &Path,
        cx: &Context,
    ) -> Result<Found, NodeError> {
        cx.begin(2 * frames.len() as u64, "frames");
        let (code, most) = (self.code(frames, sensor, cx)?, most_plausible(sensor));
        let mut found = Found::default();
        for batch in batches(frames) {
            let block = frames.read(batch.clone(), frames.rows())?;
            found = found.and(Found::in_frame(&block.dn, code, most));
            cx.advance(batch.len() as u64)?;
        }
        write_rendered(
            &folder.join(HDF5),
            frames,
            nominal_exposure_ns(&frames.meta).unwrap_or(0),
            Some(code),
        )?;
        Ok(found)
    }
}

#[cfg(test)]
mod tests;
