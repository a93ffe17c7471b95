//! Writes frames as a folder of 16-bit PNGs with a table of their exposures, or as one HDF5 file.
//!
//! The folder holds `000000.png`, `000001.png` ... and `frames.csv`: when each frame was exposed, and how codes become digital numbers
//! (`dn = offset + scale * code`, in the first line). Values are linear DN; there is no gamma, in the pixels or in the headers. DN stand for a
//! frame of the exposure that the first line names, so that rendered and recorded frames compare directly.
//!
//! The code spans the data: offset is the lowest value (or 0, when nothing is negative), and code 65535 is the highest value, over all frames and
//! pixels. So a first pass looks for both ends, and a second one writes; a few frames are in memory at a time. `offset` and `scale`
//! can be stated instead, when several folders must share one code.
//!
//! With `format = "hdf5_u16"` the same codes go into one file, `frames.h5`, and with `"hdf5_f32"` the values themselves: \[frame, row, column\] in chunks, with
//! exposures and code beside them (docs/formats.md), for those who want thousands of frames in one piece.
//!
//! Limits: 16 bits are 1/65535 of the span between darkest and brightest pixel. A value that is not known (NaN) becomes code 0 and is counted.

use super::picture::Picture;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{Context, Decl, FrameScale, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_store::{DnCode, write_rendered};
use png::BitDepth;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

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
    /// DN per code, positive. Default: such that the highest value of all frames is code 65535.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub scale: Option<f64>,
    /// DN of code 0. Default: the lowest value of all frames, or 0 when none is negative.
    pub offset: Option<f64>,
    /// Also write 8-bit copies into the folder `preview`, beside PNGs. They are for looking only: linear, and coarser by a factor of 257.
    pub preview: bool,
}

photocurrent_core::ports! {
    /// What is written.
    pub struct In {
        /// Frames, captured or rendered, grey or RGB.
        frames: FrameSequence,
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

impl WriteFrames {
    fn code(&self, frames: &FrameSequence, cx: &Context) -> Result<DnCode, NodeError> {
        if let (Some(offset), Some(scale)) = (self.params.offset, self.params.scale) {
            return Ok(DnCode { offset, scale });
        }
        let (lowest, highest) = range(frames, cx)?.unwrap_or((0.0, 0.0));
        let offset = self.params.offset.unwrap_or(f64::from(lowest).min(0.0));
        let span = f64::from(highest) - offset;
        let scale = self.params.scale.unwrap_or(if span > 0.0 { span / DnCode::WHITE } else { 1.0 });
        Ok(DnCode { offset, scale })
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

/// `frames.csv`. A rolling shutter is stated at the end of the first line; without a statement the shutter is global.
fn csv(meta: &FramesMeta, code: DnCode) -> String {
    let row_time = if meta.times.row_time_ns == 0 { String::new() } else { format!("; row_time_ns={}", meta.times.row_time_ns) };
    // `{:?}` writes the shortest decimal that reads back as the same number.
    let DnCode { offset, scale } = code;
    let exposure_ns = nominal_exposure_ns(meta).unwrap_or(0);
    let mut text = format!("# dn = offset + scale * code; offset={offset:?} scale={scale:?}; exposure_dn_of_ns={exposure_ns}{row_time}\n");
    text += "index,t_start_ns,t_end_ns,t_mid_ns,file\n";
    for (l, exposure) in meta.times.exposures.iter().enumerate() {
        text += &format!("{l},{},{},{},{}\n", exposure.start.0, exposure.end.0, exposure.mid().0, file_name(l));
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
        revision: 1,
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
in     = { frames = "recording.frames" }
params = { preview = true }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if let Some(scale) = params.scale.filter(|scale| !(scale.is_finite() && *scale > 0.0)) {
            return Err(NodeError::usage(format!("`scale` is {scale}, and must be a positive number of DN per code")).param("scale"));
        }
        if let Some(offset) = params.offset.filter(|offset| !offset.is_finite()) {
            return Err(NodeError::usage(format!("`offset` is {offset}, and must be a number of DN")).param("offset"));
        }
        let hdf5 = "`format = \"hdf5_u16\"` or \"hdf5_f32\"";
        if params.preview && params.format != Format::Png {
            return Err(NodeError::usage(format!("`preview` writes pictures beside PNGs, and does nothing with {hdf5}"))
                .hint("take it out; write/contact_sheet shows frames in one picture")
                .param("preview"));
        }
        let stated = [("scale", params.scale.is_some()), ("offset", params.offset.is_some())];
        if let Some((name, _)) = stated.iter().find(|(_, is_stated)| *is_stated && params.format == Format::Hdf5F32) {
            return Err(NodeError::usage(format!("`{name}` is that of codes, and `format = \"hdf5_f32\"` stores values as they are"))
                .hint("take it out, or set `format = \"hdf5_u16\"`")
                .param(*name));
        }
        Ok(WriteFrames { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        if frames.times.is_empty() {
            return Err(NodeError::usage("`frames` has no frame to write").hint("look at the time window of the node that makes them"));
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, meta) = (&input.frames, &input.frames.meta);
        let folder = cx.export_dir()?;
        let found = match self.params.format {
            Format::Png => self.pictures(frames, folder, cx)?,
            Format::Hdf5U16 => self.codes(frames, folder, cx)?,
            Format::Hdf5F32 => {
                write_rendered(&folder.join(HDF5), frames, nominal_exposure_ns(meta).unwrap_or(0), None)?;
                Found::default()
            }
        };
        cx.count(found.unknown, "values are not known (NaN) and were written as code 0");
        cx.count(found.clipped, "values lie outside of what the stated code can say and were clipped");
        let times = if self.params.format == Format::Png { "frames.csv" } else { HDF5 };
        if meta.times.row_time_ns != 0 {
            cx.note(format!("rolling shutter: the times in {times} are those of row 0, each further row is {} ns later", meta.times.row_time_ns));
        }
        let lengths = meta.times.exposures.iter().map(|exposure| exposure.length_ns());
        if let (FrameScale::Captured, Some(shortest), Some(longest)) = (meta.scale, lengths.clone().min(), lengths.max())
            && shortest != longest
        {
            cx.note(format!("captured frames of {shortest} to {longest} ns: each keeps the DN of its own exposure; {times} names their median"));
        }
        if self.params.preview {
            cx.note("preview/ is for looking only: 8 bits, linear");
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
}

impl Found {
    fn in_frame(values: &[f32], code: DnCode) -> Found {
        let mut found = Found::default();
        for &dn in values {
            found.unknown += u64::from(dn.is_nan());
            found.clipped += u64::from(code.of(dn).1 && !dn.is_nan());
        }
        found
    }
}

impl WriteFrames {
    /// PNGs, previews and `frames.csv`.
    fn pictures(&self, frames: &FrameSequence, folder: &Path, cx: &Context) -> Result<Found, NodeError> {
        let meta = &frames.meta;
        let preview = folder.join("preview");
        if self.params.preview {
            std::fs::create_dir_all(&preview).map_err(|error| super::cannot_write(&preview, &error))?;
        }
        let passes = if self.params.offset.is_some() && self.params.scale.is_some() { 1 } else { 2 };
        cx.begin(passes * frames.len() as u64, "frames");
        let code = self.code(frames, cx)?;
        let (unknown, clipped) = (AtomicU64::new(0), AtomicU64::new(0));
        for batch in batches(frames) {
            let block = frames.read(batch.clone(), frames.rows())?;
            batch.into_par_iter().try_for_each(|l| {
                let codes: Vec<u16> = block.frame(l).iter().map(|&dn| code.of(dn).0).collect();
                let found = Found::in_frame(block.frame(l), code);
                unknown.fetch_add(found.unknown, Ordering::Relaxed);
                clipped.fetch_add(found.clipped, Ordering::Relaxed);
                let (width, height) = (meta.extent.width, frames.rows().len() as u32);
                let bytes: Vec<u8> = codes.iter().flat_map(|code| code.to_be_bytes()).collect();
                Picture { width, height, channels: meta.channels(), depth: BitDepth::Sixteen, bytes: &bytes, comment: None }
                    .save(&folder.join(file_name(l)))?;
                if self.params.preview {
                    let bytes: Vec<u8> = codes.iter().map(|code| (code >> 8) as u8).collect();
                    let comment = Some("For looking only: linear, 8 bits.");
                    Picture { width, height, channels: meta.channels(), depth: BitDepth::Eight, bytes: &bytes, comment }.save(&preview.join(file_name(l)))?;
                }
                cx.advance(1)
            })?;
        }
        super::save(&folder.join("frames.csv"), csv(meta, code).as_bytes())?;
        Ok(Found { unknown: unknown.into_inner(), clipped: clipped.into_inner() })
    }

    /// One file of codes.
    fn codes(&self, frames: &FrameSequence, folder: &Path, cx: &Context) -> Result<Found, NodeError> {
        cx.begin(2 * frames.len() as u64, "frames");
        let code = self.code(frames, cx)?;
        let mut found = Found::default();
        for batch in batches(frames) {
            let block = frames.read(batch.clone(), frames.rows())?;
            let more = Found::in_frame(&block.dn, code);
            found = Found { unknown: found.unknown + more.unknown, clipped: found.clipped + more.clipped };
            cx.advance(batch.len() as u64)?;
        }
        write_rendered(&folder.join(HDF5), frames, nominal_exposure_ns(&frames.meta).unwrap_or(0), Some(code))?;
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::super::picture::load;
    use super::super::testing::exporting;
    use super::*;
    use photocurrent_core::{Exposure, Extent, FrameBlock, testing};
    use std::collections::BTreeMap;

    const EXTENT: Extent = Extent { width: 5, height: 4 };

    fn exposures(count: i64) -> Vec<Exposure> {
        (0..count).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect()
    }

    fn write(frames: &FrameSequence, params: Params, look: impl FnOnce(Table, Vec<String>, &Path)) {
        let node = WriteFrames::build(params).unwrap();
        exporting(|cx| node.run(In { frames: frames.clone() }, cx).unwrap(), |out, notes, folder| look((*out.listing).clone(), notes, folder));
    }

    /// What a stranger's program reads from the folder: the numbers of the first line, and the lines of the table.
    fn read_csv(folder: &Path) -> (f64, f64, String, Vec<String>) {
        let text = std::fs::read_to_string(folder.join("frames.csv")).unwrap();
        let mut lines = text.lines().map(String::from);
        let first = lines.next().unwrap();
        let after = |key: &str| first.split(key).nth(1).unwrap().split([' ', ';']).next().unwrap().to_string();
        assert!(first.starts_with("# dn = offset + scale * code; offset="), "{first}");
        (after("offset=").parse().unwrap(), after("scale=").parse().unwrap(), after("exposure_dn_of_ns="), lines.collect())
    }

    #[test]
    fn the_formula_of_the_first_line_gives_back_the_values() {
        let frames = testing::captured(EXTENT, exposures(3), 0, |l, x, y| (l as f32 + 0.37) * (x as f32 - 1.5) * (y as f32 + 0.1) * 33.3);
        write(&frames, Params::default(), |listing, notes, folder| {
            let (offset, scale, exposure, lines) = read_csv(folder);
            assert_eq!(exposure, "4000000");
            assert_eq!(lines[0], "index,t_start_ns,t_end_ns,t_mid_ns,file");
            assert_eq!(lines[2], "1,10000000,14000000,12000000,000001.png");
            assert_eq!(lines.len(), 4);
            for l in 0..3 {
                let (codes, info) = load(&folder.join(format!("{l:06}.png")));
                assert_eq!(
                    (info.bit_depth, info.color_type, info.gamma(), info.width, info.height),
                    (BitDepth::Sixteen, png::ColorType::Grayscale, None, 5, 4)
                );
                let block = frames.read(l..l + 1, frames.rows()).unwrap();
                for (code, dn) in codes.iter().zip(&block.dn) {
                    // Half a code is the best that rounding can do.
                    assert!((offset + scale * f64::from(*code) - f64::from(*dn)).abs() <= 0.5000001 * scale, "{code} is not {dn}");
                }
            }
            assert_eq!(listing.column("file").unwrap().cell(2), "000002.png");
            assert_eq!(notes, [""; 0]);
            assert!(!folder.join("preview").exists());
        });
    }

    #[test]
    fn the_code_spans_from_zero_or_the_lowest_value_to_the_highest() {
        let frames = testing::captured(EXTENT, exposures(2), 0, |l, x, _| 10.0 + (l * 100) as f32 + x as f32);
        write(&frames, Params::default(), |_, _, folder| {
            let (offset, scale, ..) = read_csv(folder);
            assert_eq!((offset, scale), (0.0, 114.0 / 65535.0));
            assert_eq!(load(&folder.join("000001.png")).0[4], 65535);
        });
        let dark = testing::captured(EXTENT, exposures(1), 0, |_, _, _| 0.0);
        write(&dark, Params::default(), |_, _, folder| assert_eq!(read_csv(folder).1, 1.0));
    }

    #[test]
    fn unknown_and_clipped_values_are_counted() {
        let frames = testing::captured(EXTENT, exposures(1), 0, |_, x, y| match (x, y) {
            (0, 0) => f32::NAN,
            (1, 0) => -30.0,
            (2, _) => 700_000.0,
            _ => 5.0,
        });
        write(&frames, Params { scale: Some(10.0), offset: Some(0.0), ..Params::default() }, |_, notes, folder| {
            let codes = load(&folder.join("000000.png")).0;
            assert_eq!(codes[..4], [0, 0, 65535, 1]);
            // One below 0 and four in column 2 lie outside of 0 ..= 655350 DN; 5 DN are half a code and round away from zero.
            assert_eq!(
                notes,
                ["1 values are not known (NaN) and were written as code 0", "5 values lie outside of what the stated code can say and were clipped"]
            );
        });
    }

    #[test]
    fn a_rolling_shutter_is_stated_and_rendered_frames_name_their_nominal_exposure() {
        let rolling = testing::frames(4, 3, 2);
        write(&rolling, Params::default(), |_, notes, folder| {
            let text = std::fs::read_to_string(folder.join("frames.csv")).unwrap();
            assert!(text.lines().next().unwrap().ends_with("; exposure_dn_of_ns=4000000; row_time_ns=10000"), "{text}");
            assert!(notes[0].contains("those of row 0"), "{notes:?}");
        });
        let meta = FramesMeta { scale: FrameScale::Nominal { exposure_ns: 4_200_000 }, ..(*rolling.meta).clone() };
        let rendered = FrameSequence::new(Arc::new(meta), rolling.rows(), Arc::new(rolling.read_rows(rolling.rows()).unwrap()));
        write(&rendered, Params::default(), |_, _, folder| assert_eq!(read_csv(folder).2, "4200000"));
    }

    #[test]
    fn colour_is_written_as_rgb_and_a_preview_goes_to_another_folder() {
        let times = photocurrent_core::FrameTimes::new(exposures(1), 0).unwrap();
        let meta = FramesMeta { extent: Extent { width: 1, height: 1 }, colour: photocurrent_core::Colour::Rgb, times, scale: FrameScale::Captured };
        let block = FrameBlock { frames: 0..1, rows: meta.extent.rows(), row_values: 3, dn: vec![65535.0, 256.0, 0.0] };
        write(&FrameSequence::in_memory(Arc::new(meta), block), Params { preview: true, ..Params::default() }, |_, notes, folder| {
            let (codes, info) = load(&folder.join("000000.png"));
            assert_eq!((codes, info.color_type), (vec![65535, 256, 0], png::ColorType::Rgb));
            let (codes, info) = load(&folder.join("preview/000000.png"));
            assert_eq!((codes, info.bit_depth), (vec![255, 1, 0], BitDepth::Eight));
            assert!(notes[0].contains("for looking only"));
        });
    }

    #[test]
    fn what_a_format_does_not_take_is_refused_by_name() {
        let refused = |params: Params| WriteFrames::build(params).err().and_then(|error| error.param);
        let f32 = Params { format: Format::Hdf5F32, ..Params::default() };
        assert_eq!(refused(f32.clone()), None);
        assert_eq!(refused(Params { scale: Some(1.0), ..f32.clone() }).as_deref(), Some("scale"));
        assert_eq!(refused(Params { offset: Some(1.0), ..f32.clone() }).as_deref(), Some("offset"));
        assert_eq!(refused(Params { preview: true, ..f32 }).as_deref(), Some("preview"));
        assert_eq!(refused(Params { format: Format::Hdf5U16, scale: Some(1.0), ..Params::default() }), None);
    }

    #[test]
    fn one_file_of_codes_counts_what_codes_cannot_say() {
        let frames = testing::captured(EXTENT, exposures(3), 0, |l, x, _| if (l, x) == (1, 0) { f32::NAN } else { 100.0 * x as f32 });
        let params = Params { format: Format::Hdf5U16, scale: Some(1.0), offset: Some(200.0), preview: false };
        write(&frames, params, |listing, notes, folder| {
            assert_eq!(listing.column("file").unwrap().cell(2), "frames.h5");
            // Of three frames of four rows: one column unknown in one frame, and column 0 of two, column 1 of three are below code 0.
            assert_eq!(
                notes,
                ["4 values are not known (NaN) and were written as code 0", "20 values lie outside of what the stated code can say and were clipped"]
            );
            let names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
            assert_eq!(names, ["frames.h5"]);
        });
    }

    #[test]
    fn mistakes_are_refused_before_anything_is_written() {
        assert_eq!(WriteFrames::build(Params { scale: Some(0.0), ..Params::default() }).err().unwrap().param.as_deref(), Some("scale"));
        let metas = PortMetas::new(BTreeMap::from([("frames".to_string(), vec![Meta::Frames(testing::frames(2, 2, 0).meta)])]));
        let error = WriteFrames::build(Params::default()).unwrap().plan(&metas).unwrap_err();
        assert_eq!(error.message, "`frames` has no frame to write");
    }
}
