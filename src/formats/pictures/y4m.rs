//! YUV4MPEG2 (Y4M): uncompressed video with a line of text before it and before every frame.
//!
//! Grey streams give their luma. Colour streams are converted to RGB by ITU-R BT.601, chroma taken from the nearest stored sample. The range is
//! the `XCOLORRANGE` of the header; without one it is limited (16 to 235), as the tools that write such files take it, and a note says so.
//! The rate of the header is one number: frames that came at other times are not seen in it. Source: the `yuv4mpeg(5)` manual of mjpegtools.

use crate::error::{Cause, FormatError, Loss};
use photocurrent_core::{Colour, Extent};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// How chroma is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sampling {
    /// Luma samples of a chroma sample, across and down; `None` without chroma.
    chroma: Option<(u32, u32)>,
    bits: u32,
    has_alpha: bool,
}

/// An opened file.
pub(crate) struct Y4m {
    path: PathBuf,
    pub(crate) extent: Extent,
    pub(crate) colour: Colour,
    pub(crate) bits: u32,
    /// Frames a second, as a fraction; `None` when the header says that it is not known.
    pub(crate) rate: Option<(u64, u64)>,
    /// Where the values of every frame begin.
    pub(crate) frames: Vec<u64>,
    pub(crate) notes: Vec<String>,
    pub(crate) losses: Vec<Loss>,
    sampling: Sampling,
    full_range: bool,
}

/// Longest line that is read.
const LONGEST: u64 = 4096;

fn line(reader: &mut impl BufRead, into: &mut Vec<u8>) -> std::io::Result<bool> {
    into.clear();
    reader.take(LONGEST).read_until(b'\n', into)?;
    Ok(into.pop() == Some(b'\n'))
}

impl Y4m {
    /// Reads the header, and where the frames begin.
    pub(crate) fn open(path: &Path) -> Result<Y4m, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let wrong = |what: String| FormatError::new(path, what, "write it again, for example with ffmpeg -pix_fmt gray");
        let file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut reader = BufReader::new(file);
        let mut text = Vec::new();
        let whole = line(&mut reader, &mut text).map_err(io)?;
        let header = String::from_utf8_lossy(&text).into_owned();
        if !whole || !header.starts_with("YUV4MPEG2 ") {
            return Err(wrong("no header of a Y4M file".into()).expected("YUV4MPEG2 W... H..."));
        }
        let (mut width, mut height, mut rate, mut colour_space, mut full_range) = (None, None, None, "420", None);
        for word in header.split(' ').skip(1) {
            let mut letters = word.chars();
            let letter = letters.next();
            let value = letters.as_str();
            match letter {
                Some('W') => width = value.parse().ok(),
                Some('H') => height = value.parse().ok(),
                Some('F') => rate = value.split_once(':').and_then(|(a, b)| Some((a.parse::<u64>().ok()?, b.parse::<u64>().ok()?))),
                Some('C') => colour_space = value,
                Some('X') if value.eq_ignore_ascii_case("COLORRANGE=FULL") => full_range = Some(true),
                Some('X') if value.eq_ignore_ascii_case("COLORRANGE=LIMITED") => full_range = Some(false),
                _ => {}
            }
        }
        let side = |side: Option<u32>| side.filter(|side| (1..=1 << 16).contains(side));
        let (Some(width), Some(height)) = (side(width), side(height)) else {
            return Err(wrong(format!("no plausible size in `{}`", header.escape_debug())));
        };
        let sampling = sampling(colour_space).ok_or_else(|| wrong(format!("the colour space C{} is not read", colour_space.escape_debug())))?;
        let mut y4m = Y4m {
            path: path.into(),
            extent: Extent { width, height },
            colour: if sampling.chroma.is_some() { Colour::Rgb } else { Colour::Mono },
            bits: sampling.bits,
            rate: rate.filter(|&(a, b)| a > 0 && b > 0),
            frames: Vec::new(),
            notes: Vec::new(),
            losses: Vec::new(),
            sampling,
            full_range: full_range.unwrap_or(sampling.chroma.is_none()),
        };
        y4m.say_range(full_range);
        y4m.index(&mut reader, bytes, text.len() as u64 + 1).map_err(io)?;
        Ok(y4m)
    }

    fn say_range(&mut self, stated: Option<bool>) {
        let (low, high) = (16 << (self.bits - 8), 235 << (self.bits - 8));
        let range = match (stated, self.full_range) {
            (Some(true), _) => "full range, as the header says".to_string(),
            (Some(false), _) => format!("limited range, as the header says: {low} to {high} were stretched to the whole scale"),
            (None, true) => "the header states no range; grey values are taken as they are".into(),
            (None, false) => format!("the header states no range; limited was taken: {low} to {high} were stretched to the whole scale"),
        };
        self.notes.push(range);
        if self.colour == Colour::Rgb {
            self.notes.push("YCbCr was converted to RGB by BT.601".into());
        }
    }

    /// Bytes of a frame's values.
    fn frame_bytes(&self) -> u64 {
        let luma = u64::from(self.extent.width) * u64::from(self.extent.height);
        let chroma = self.chroma_extent().map_or(0, |extent| 2 * u64::from(extent.width) * u64::from(extent.height));
        (luma + chroma + if self.sampling.has_alpha { luma } else { 0 }) * u64::from(self.bits.div_ceil(8))
    }

    fn chroma_extent(&self) -> Option<Extent> {
        self.sampling.chroma.map(|(across, down)| Extent { width: self.extent.width.div_ceil(across), height: self.extent.height.div_ceil(down) })
    }

    fn index(&mut self, reader: &mut BufReader<File>, bytes: u64, mut at: u64) -> std::io::Result<()> {
        let size = self.frame_bytes();
        let mut text = Vec::new();
        while at < bytes {
            let whole = line(reader, &mut text)?;
            let start = at + text.len() as u64 + 1;
            if !whole || !(text == b"FRAME" || text.starts_with(b"FRAME ")) {
                let what = "no `FRAME` line stands here; the rest of the file is lost";
                self.losses.push(Loss::new(format!("byte {at}"), what));
                break;
            }
            if start + size > bytes {
                let what = format!("frame {} is cut off; it was left out", self.frames.len());
                self.losses.push(Loss::new(format!("bytes {at} to {bytes}"), what).by(Cause::Cut));
                break;
            }
            self.frames.push(start);
            at = start + size;
            reader.seek(SeekFrom::Start(at))?;
        }
        Ok(())
    }

    /// Replaces `values` by those of a frame.
    pub(crate) fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clear();
        let io = |error: std::io::Error| FormatError::io(&self.path, &error).at(format!("frame {frame}"));
        let start = self.frames.get(frame).ok_or_else(|| FormatError::new(&self.path, format!("there is no frame {frame}"), "ask for one of its frames"))?;
        let mut file = File::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(*start)).map_err(io)?;
        let mut stored = vec![0; usize::try_from(self.frame_bytes()).unwrap_or(usize::MAX)];
        file.read_exact(&mut stored).map_err(io)?;
        let wide = self.bits > 8;
        let sample =
            |index: usize| -> f32 { if wide { f32::from(u16::from_le_bytes([stored[2 * index], stored[2 * index + 1]])) } else { f32::from(stored[index]) } };
        let full = ((1_u32 << self.bits) - 1) as f32;
        let unit = (1_u32 << (self.bits - 8)) as f32;
        let luma = |value: f32| if self.full_range { value } else { ((value - 16.0 * unit) * full / (219.0 * unit)).clamp(0.0, full) };
        let (width, height) = (self.extent.width as usize, self.extent.height as usize);
        let (Some(chroma), Some((across, down))) = (self.chroma_extent(), self.sampling.chroma) else {
            values.extend((0..width * height).map(|index| luma(sample(index))));
            return Ok(());
        };
        let plane = chroma.pixels();
        let stretch = if self.full_range { 1.0 } else { full / (224.0 * unit) };
        for y in 0..height {
            for x in 0..width {
                let at = width * height + (y / down as usize) * chroma.width as usize + x / across as usize;
                let (cb, cr) = ((sample(at) - 128.0 * unit) * stretch, (sample(at + plane) - 128.0 * unit) * stretch);
                let grey = luma(sample(y * width + x));
                // BT.601: Kr = 0.299, Kb = 0.114.
                values.extend([grey + 1.402 * cr, grey - 0.344_136_3 * cb - 0.714_136_3 * cr, grey + 1.772 * cb].map(|value| value.clamp(0.0, full)));
            }
        }
        Ok(())
    }

    /// When frame `k` would stand at the header's rate, ns after the first.
    pub(crate) fn at(&self, frame: usize) -> Option<i64> {
        let (frames, seconds) = self.rate?;
        let ns = frame as u128 * u128::from(seconds) * 1_000_000_000 + u128::from(frames) / 2;
        i64::try_from(ns / u128::from(frames)).ok()
    }
}

fn sampling(name: &str) -> Option<Sampling> {
    let of = |chroma, bits| Some(Sampling { chroma, bits, has_alpha: false });
    if let Some(bits) = name.strip_prefix("mono") {
        return of(None, if bits.is_empty() { 8 } else { bits.parse().ok().filter(|bits| (9..=16).contains(bits))? });
    }
    if name == "444alpha" {
        return Some(Sampling { chroma: Some((1, 1)), bits: 8, has_alpha: true });
    }
    let (family, bits) = match name.split_once('p') {
        // 420p10; the `p` of 420jpeg, 420paldv and 420mpeg2 is none of these.
        Some((family, bits)) if !bits.is_empty() && bits.bytes().all(|byte| byte.is_ascii_digit()) => {
            (family, bits.parse().ok().filter(|bits| (9..=16).contains(bits))?)
        }
        _ => (name, 8),
    };
    match family {
        "420" | "420jpeg" | "420paldv" | "420mpeg2" => of(Some((2, 2)), bits),
        "422" => of(Some((2, 1)), bits),
        "411" => of(Some((4, 1)), bits),
        "444" => of(Some((1, 1)), bits),
        "440" => of(Some((1, 2)), bits),
        _ => None,
    }
}
