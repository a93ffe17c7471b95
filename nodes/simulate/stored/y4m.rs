//! A Y4M file (YUV4MPEG2) as a film: a text header, then uncompressed frames, each with a line of its own.
//!
//! Planar Y'CbCr with 4:2:0, 4:2:2, 4:1:1 or 4:4:4 chroma, or grey; 8 to 16 bits (above 8 in two bytes, low byte first). Y'CbCr becomes R'G'B' by the
//! matrix of BT.709, each channel becomes light by the transfer curve, and their sum is luminance; a pixel without colour is exactly its luma. A chroma
//! sample counts for all pixels that share it. Black and white are 16 and 235 (of 8 bits) unless the header says `XCOLORRANGE=FULL`: then 0 and 255.
//!
//! Limits: progressive frames only, no alpha. Chroma is not interpolated, and the header cannot say that its matrix is another one (BT.601).
//! The format: mjpegtools, yuv4mpeg(5); `XCOLORRANGE` as FFmpeg writes it.

use super::{Film, LUMINANCE, Transfer, cannot_read, short_name};
use photocurrent_core::{Extent, NodeError, Rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// What every file begins with.
const MAGIC: &[u8] = b"YUV4MPEG2";

/// No header line is longer, bytes.
const LONGEST_LINE: usize = 4096;

/// Which stored luma is black and white.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// 16 to 235 of 8 bits, chroma 16 to 240.
    Limited,
    /// 0 to 255 of 8 bits.
    Full,
}

/// What the header says.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    extent: Extent,
    /// Frames per second; `None` when the header has none.
    pub rate: Option<f64>,
    /// `None` when the header does not say.
    pub range: Option<Range>,
    layout: Layout,
}

/// How samples stand in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Layout {
    /// Pixels that share a chroma sample, across and down; `None` is grey.
    chroma: Option<(u32, u32)>,
    bits: u32,
}

impl Layout {
    /// From the text after `C`.
    fn named(name: &str) -> Option<Layout> {
        if let Some(bits) = name.strip_prefix("mono") {
            let bits = if bits.is_empty() { 8 } else { bits.parse().ok().filter(|bits| (9..=16).contains(bits))? };
            return Some(Layout { chroma: None, bits });
        }
        if ["420jpeg", "420mpeg2", "420paldv"].contains(&name) {
            return Some(Layout { chroma: Some((2, 2)), bits: 8 });
        }
        let (chroma, rest) = [("420", (2, 2)), ("422", (2, 1)), ("411", (4, 1)), ("444", (1, 1))]
            .into_iter()
            .find_map(|(prefix, chroma)| Some((chroma, name.strip_prefix(prefix)?)))?;
        let bits = if rest.is_empty() { 8 } else { rest.strip_prefix('p')?.parse().ok().filter(|bits| (9..=16).contains(bits))? };
        Some(Layout { chroma: Some(chroma), bits })
    }

    fn sample_bytes(self) -> usize {
        if self.bits > 8 { 2 } else { 1 }
    }

    /// Size of one chroma plane: enough samples for every pixel.
    fn chroma_extent(self, luma: Extent) -> Extent {
        self.chroma.map_or(Extent { width: 0, height: 0 }, |(x, y)| Extent { width: luma.width.div_ceil(x), height: luma.height.div_ceil(y) })
    }

    fn frame_bytes(self, luma: Extent) -> u64 {
        (luma.pixels() + 2 * self.chroma_extent(luma).pixels()) as u64 * self.sample_bytes() as u64
    }
}

impl Header {
    /// From the file's first line, without its end.
    fn parse(line: &str, name: &str) -> Result<Header, NodeError> {
        let refuse = |what: String, hint: &str| NodeError::input(format!("the header of {name} {what}")).hint(hint.to_string()).param("path");
        let (mut width, mut height, mut rate, mut range) = (None, None, None, None);
        let mut layout = Layout { chroma: Some((2, 2)), bits: 8 };
        for word in line.split(' ').skip(1).filter(|word| !word.is_empty()) {
            let (tag, value) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
            match tag {
                "W" => width = value.parse::<u32>().ok().filter(|width| (1..=65_536).contains(width)),
                "H" => height = value.parse::<u32>().ok().filter(|height| (1..=65_536).contains(height)),
                "F" => rate = parse_rate(value),
                "I" if !["p", "?"].contains(&value) => {
                    let hint = "make it progressive first, such as `ffmpeg -i in.y4m -vf yadif out.y4m`: half a frame is no picture of one instant";
                    return Err(refuse(format!("says that its frames are interlaced (`{word}`)"), hint));
                }
                "C" => {
                    let hint = "8 to 16 bits of 4:2:0, 4:2:2, 4:1:1, 4:4:4 or mono are read: such as `ffmpeg -i in.y4m -pix_fmt yuv420p out.y4m`";
                    layout = Layout::named(value).ok_or_else(|| refuse(format!("names the colour space `{value}`"), hint))?;
                }
                "X" if value == "COLORRANGE=FULL" => range = Some(Range::Full),
                "X" if value == "COLORRANGE=LIMITED" => range = Some(Range::Limited),
                _ => {}
            }
        }
        let (Some(width), Some(height)) = (width, height) else {
            return Err(refuse(format!("states no size that can be: `{line}`"), "it has `W` and `H`, such as `YUV4MPEG2 W640 H480 F1000:1`"));
        };
        Ok(Header { extent: Extent { width, height }, rate, range, layout })
    }
}

/// `30000:1001` in frames per second; `0:0` and `0:1` stand for unknown.
fn parse_rate(text: &str) -> Option<f64> {
    let (count, seconds) = text.split_once(':')?;
    let (count, seconds): (f64, f64) = (count.parse().ok()?, seconds.parse().ok()?);
    Some(count / seconds).filter(|rate| rate.is_finite() && *rate > 0.0)
}

/// A file, with where its frames are.
pub struct Y4m {
    path: PathBuf,
    file: File,
    header: Header,
    range: Range,
    transfer: Transfer,
    /// Light of every luma value of a pixel without colour.
    grey: Vec<f64>,
    /// Where each frame's samples begin, bytes.
    begins: Vec<u64>,
}

/// Does a file begin as Y4M? Otherwise how it begins, for messages.
///
/// # Errors
/// When it cannot be read.
pub fn begins_as_one(path: &Path) -> Result<Result<(), String>, NodeError> {
    let file = File::open(path).map_err(|error| cannot_read(path, &error))?;
    let start = read_up_to(&file, 0, 12).map_err(|error| cannot_read(path, &error))?;
    if start.starts_with(MAGIC) {
        return Ok(Ok(()));
    }
    Ok(Err(start.iter().map(|&byte| if byte.is_ascii_graphic() || byte == b' ' { byte as char } else { '.' }).collect()))
}

fn read_up_to(file: &File, at: u64, most: usize) -> std::io::Result<Vec<u8>> {
    let (mut bytes, mut length) = (vec![0; most], 0);
    while length < most {
        match file.read_at(&mut bytes[length..], at + length as u64)? {
            0 => break,
            more => length += more,
        }
    }
    bytes.truncate(length);
    Ok(bytes)
}

impl Y4m {
    /// Reads the header and walks over all frames by their lengths. `range` wins over the header's word.
    ///
    /// # Errors
    /// When the file cannot be read, is cut off, or has frames of a form that is not read.
    pub fn open(path: &Path, transfer: Transfer, range: Option<Range>) -> Result<Y4m, NodeError> {
        let (name, trouble) = (short_name(path), |error: std::io::Error| cannot_read(path, &error));
        let file = File::open(path).map_err(trouble)?;
        let size = file.metadata().map_err(trouble)?.len();
        let line = |at: u64| -> Result<Option<String>, NodeError> {
            let bytes = read_up_to(&file, at, LONGEST_LINE.min((size - at) as usize)).map_err(trouble)?;
            Ok(bytes.iter().position(|byte| *byte == b'\n').map(|end| String::from_utf8_lossy(&bytes[..end]).into_owned()))
        };
        let cut = |what: String| {
            NodeError::input(format!("{name} is cut off: {what}"))
                .note(format!("the file has {size} bytes"))
                .hint("copy it again, or write it again from where it was made")
                .param("path")
        };
        let first = line(0)?.ok_or_else(|| cut(format!("its header has no end within {} bytes", size.min(LONGEST_LINE as u64))))?;
        let header = Header::parse(&first, &name)?;
        let (length, mut at, mut begins) = (header.layout.frame_bytes(header.extent), first.len() as u64 + 1, Vec::new());
        while at < size {
            let k = begins.len();
            let head = line(at)?;
            let Some(head) = head.filter(|head| head.starts_with("FRAME")) else {
                // The last bytes may be the beginning of a frame's line.
                let rest = read_up_to(&file, at, 6).map_err(trouble)?;
                if b"FRAME ".starts_with(&rest) || (rest.starts_with(b"FRAME") && size - at < LONGEST_LINE as u64) {
                    return Err(cut(format!("it ends at the head of frame {k}, which begins at byte {at}; whole frames before it: {k}")));
                }
                return Err(NodeError::input(format!("{name} has no frame where one should begin: at byte {at}; whole frames before it: {k}"))
                    .note(format!("a frame of {} pixels has {length} bytes by the header", header.extent))
                    .hint("the file is damaged, or its header states another size or colour space than its frames have")
                    .param("path"));
            };
            let begin = at + head.len() as u64 + 1;
            if begin + length > size {
                let needed = begin + length;
                return Err(cut(format!("frame {k} begins at byte {at} and needs the bytes up to {needed}; whole frames before it: {k}")));
            }
            begins.push(begin);
            at = begin + length;
        }
        let range = range.or(header.range).unwrap_or(Range::Limited);
        let most = if header.layout.bits > 8 { 65_535 } else { 255 };
        let grey = (0..=most).map(|luma| transfer.light(luma_share(range, header.layout.bits, luma))).collect();
        Ok(Y4m { path: path.into(), file, header, range, transfer, grey, begins })
    }

    /// What the header says.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// One row of a plane that begins at byte `at`, as whole numbers.
    fn samples(&self, at: u64, width: u32, row: u32, bytes: &mut Vec<u8>, values: &mut Vec<u16>) -> Result<(), NodeError> {
        let length = width as usize * self.header.layout.sample_bytes();
        bytes.resize(length, 0);
        self.file.read_exact_at(bytes, at + u64::from(row) * length as u64).map_err(|error| cannot_read(&self.path, &error))?;
        values.clear();
        match self.header.layout.sample_bytes() {
            1 => values.extend(bytes.iter().map(|byte| u16::from(*byte))),
            _ => values.extend(bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]))),
        }
        Ok(())
    }

    /// Luminance of a pixel with colour.
    fn light(&self, luma: u16, blue: u16, red: u16) -> f64 {
        let bits = self.header.layout.bits;
        let middle = 1 << (bits - 1);
        if blue == middle && red == middle {
            return self.grey[usize::from(luma)];
        }
        let luma = luma_share(self.range, bits, luma.into());
        let scale = match self.range {
            Range::Limited => f64::from(224u32 << (bits - 8)),
            Range::Full => f64::from((1u32 << bits) - 1),
        };
        let chroma = |stored: u16| (f64::from(stored) - f64::from(middle)) / scale;
        let [weight_red, weight_green, weight_blue] = LUMINANCE;
        let red = luma + 2.0 * (1.0 - weight_red) * chroma(red);
        let blue = luma + 2.0 * (1.0 - weight_blue) * chroma(blue);
        let green = (luma - weight_red * red - weight_blue * blue) / weight_green;
        weight_red * self.transfer.light(red) + weight_green * self.transfer.light(green) + weight_blue * self.transfer.light(blue)
    }
}

/// Stored luma as a share of white; below black is less than 0, above white more than 1.
fn luma_share(range: Range, bits: u32, luma: u32) -> f64 {
    match range {
        Range::Limited => (f64::from(luma) - f64::from(16u32 << (bits - 8))) / f64::from(219u32 << (bits - 8)),
        Range::Full => f64::from(luma) / f64::from((1u32 << bits) - 1),
    }
}

impl Film for Y4m {
    fn extent(&self) -> Extent {
        self.header.extent
    }

    fn frames(&self) -> usize {
        self.begins.len()
    }

    fn read(&self, frame: usize, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
        let (extent, layout) = (self.header.extent, self.header.layout);
        let chroma_extent = layout.chroma_extent(extent);
        let plane = |extent: Extent| (extent.pixels() * layout.sample_bytes()) as u64;
        let luma_at = self.begins[frame];
        let (blue_at, red_at) = (luma_at + plane(extent), luma_at + plane(extent) + plane(chroma_extent));
        let (mut bytes, mut luma, mut blue, mut red, mut light) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for y in rows.iter() {
            self.samples(luma_at, extent.width, y, &mut bytes, &mut luma)?;
            light.clear();
            match layout.chroma {
                None => light.extend(luma.iter().map(|luma| self.grey[usize::from(*luma)])),
                Some((across, down)) => {
                    self.samples(blue_at, chroma_extent.width, y / down, &mut bytes, &mut blue)?;
                    self.samples(red_at, chroma_extent.width, y / down, &mut bytes, &mut red)?;
                    let colour = |x: usize| (blue[x / across as usize], red[x / across as usize]);
                    light.extend(luma.iter().enumerate().map(|(x, luma)| self.light(*luma, colour(x).0, colour(x).1)));
                }
            }
            each(&light);
        }
        Ok(())
    }
}
