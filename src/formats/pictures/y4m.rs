//! YUV4MPEG2 (Y4M): uncompressed video with a line of text before it and before every frame.
//!
//! Planar Y'CbCr with 4:2:0, 4:2:2, 4:1:1, 4:4:0 or 4:4:4 chroma, or grey; 8 to 16 bits (above 8 in two
//! bytes, low byte first). A chroma sample counts for all pixels that share it; it is not interpolated, and
//! alpha is left out. Colour is that of BT.709 ([`crate::ycbcr`] says why), and a note says so. As pictures,
//! grey streams give their luma and colour streams R'G'B'. The range is the `XCOLORRANGE` of the header;
//! without one that of colour is limited (16 to 235), as the tools that write such files take it, grey is
//! taken as it is, and a note says so.
//!
//! The rate of the header is one number: frames that came at other times are not seen in it. What a cut or
//! damaged file still has is read; who needs all of it asks [`Y4m::whole`]. Source: the `yuv4mpeg(5)` manual
//! of mjpegtools; `XCOLORRANGE` as FFmpeg writes it.

use crate::error::{Cause, FormatError, Loss};
use crate::ycbcr::{Levels, MATRIX, Range};
use photocurrent_core::{Colour, Extent, Rows};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// What every file begins with.
pub const MAGIC: &[u8] = b"YUV4MPEG2 ";

/// How samples stand in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sampling {
    /// Luma samples of a chroma sample, across and down; `None` without chroma.
    chroma: Option<(u32, u32)>,
    bits: u32,
    has_alpha: bool,
}

/// Where a file stops being what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Broken {
    /// The last bytes begin the line of a frame.
    Head,
    /// The file ends within a frame, which needs the bytes up to this one.
    Frame(u64),
    /// Bytes that begin no frame.
    Other,
}

/// An opened file.
pub struct Y4m {
    path: PathBuf,
    file: File,
    bytes: u64,
    extent: Extent,
    rate: Option<(u64, u64)>,
    range: Option<Range>,
    interlaced: Option<String>,
    /// Words of the header about colour that nobody agreed on.
    unknown: Vec<String>,
    /// Where the values of every frame begin.
    frames: Vec<u64>,
    /// At which byte no frame begins or is whole, and why.
    broken: Option<(u64, Broken)>,
    sampling: Sampling,
}

/// Longest line that is read.
const LONGEST: u64 = 4096;

const COPY_AGAIN: &str = "copy it again, or write it again from where it was made";

fn line(reader: &mut impl BufRead, into: &mut Vec<u8>) -> std::io::Result<bool> {
    into.clear();
    reader.take(LONGEST).read_until(b'\n', into)?;
    Ok(into.pop_if(|last| *last == b'\n').is_some())
}

/// What the words of a header state.
struct Header {
    extent: Extent,
    rate: Option<(u64, u64)>,
    range: Option<Range>,
    interlaced: Option<String>,
    unknown: Vec<String>,
    sampling: Sampling,
}

impl Header {
    /// From the first line of the file.
    fn of(path: &Path, header: &str) -> Result<Header, FormatError> {
        let wrong = |what: String, hint: &str| FormatError::new(path, what, hint).at("the header");
        let (mut width, mut height, mut rate, mut range, mut interlaced, mut unknown) =
            (None, None, None, None, None, Vec::new());
        let mut sampling = Sampling { chroma: Some((2, 2)), bits: 8, has_alpha: false };
        for word in header.split(' ').skip(1).filter(|word| !word.is_empty()) {
            let mut letters = word.chars();
            let letter = letters.next();
            let value = letters.as_str();
            match letter {
                Some('W') => width = value.parse().ok(),
                Some('H') => height = value.parse().ok(),
                Some('F') => {
                    rate = value
                        .split_once(':')
                        .and_then(|(a, b)| Some((a.parse::<u64>().ok()?, b.parse::<u64>().ok()?)))
                }
                Some('I') if !["p", "?"].contains(&value) => {
                    interlaced = Some(word.escape_debug().to_string())
                }
                Some('C') => {
                    let hint = "8 to 16 bits of 4:2:0, 4:2:2, 4:1:1, 4:4:0, 4:4:4 or mono are read: such as \
                                `ffmpeg -i in.y4m -pix_fmt yuv420p out.y4m`";
                    sampling = Sampling::named(value).ok_or_else(|| {
                        wrong(format!("it names the colour space `{}`", value.escape_debug()), hint)
                    })?;
                }
                Some('X') if value.eq_ignore_ascii_case("COLORRANGE=FULL") => range = Some(Range::Full),
                Some('X') if value.eq_ignore_ascii_case("COLORRANGE=LIMITED") => range = Some(Range::Limited),
                Some('X') if value.to_ascii_uppercase().starts_with("COLOR") => {
                    unknown.push(word.escape_debug().to_string())
                }
                _ => {}
            }
        }
        let side = |side: Option<u32>| side.filter(|side| (1..=1 << 16).contains(side));
        let (Some(width), Some(height)) = (side(width), side(height)) else {
            let what = format!("it states no size that can be: `{}`", header.escape_debug());
            return Err(wrong(what, "it has `W` and `H`, such as `YUV4MPEG2 W640 H480 F1000:1`"));
        };
        let (extent, rate) = (Extent { width, height }, rate.filter(|&(a, b)| a > 0 && b > 0));
        Ok(Header { extent, rate, range, interlaced, unknown, sampling })
    }
}

impl Y4m {
    /// Reads the header, and where the frames begin.
    ///
    /// # Errors
    /// When the file cannot be read, or its header states no size, or a colour space that is not read.
    pub fn open(path: &Path) -> Result<Y4m, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut reader = BufReader::new(file);
        let mut text = Vec::new();
        let whole = line(&mut reader, &mut text).map_err(io)?;
        let header = String::from_utf8_lossy(&text).into_owned();
        if !text.starts_with(MAGIC) {
            let shown =
                |byte: &u8| if byte.is_ascii_graphic() || *byte == b' ' { char::from(*byte) } else { '.' };
            let found = format!(
                "it is no Y4M file: it begins with `{}`",
                text.iter().take(12).map(shown).collect::<String>()
            );
            let hint = "name a folder of pictures, or convert it: such as `ffmpeg -i film.mp4 film.y4m`";
            return Err(FormatError::new(path, found, hint).expected("`YUV4MPEG2 W... H...`"));
        }
        if !whole {
            return Err(FormatError::new(
                path,
                format!("it is cut off: its header has no end within {} bytes", text.len()),
                COPY_AGAIN,
            ));
        }
        let Header { extent, rate, range, interlaced, unknown, sampling } = Header::of(path, &header)?;
        let again = File::open(path).map_err(io)?;
        let mut y4m = Y4m {
            path: path.into(),
            file: again,
            bytes,
            extent,
            rate,
            range,
            interlaced,
            unknown,
            frames: Vec::new(),
            broken: None,
            sampling,
        };
        y4m.index(&mut reader, text.len() as u64 + 1).map_err(io)?;
        Ok(y4m)
    }

    /// Size of every frame.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Grey, or colour of three channels.
    pub fn colour(&self) -> Colour {
        if self.sampling.chroma.is_some() { Colour::Rgb } else { Colour::Mono }
    }

    /// Bits of a sample, 8 to 16.
    pub fn bits(&self) -> u32 {
        self.sampling.bits
    }

    /// Number of whole frames.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Frames a second, as a fraction; `None` when the header says that it is not known.
    pub fn rate(&self) -> Option<(u64, u64)> {
        self.rate
    }

    /// The range that the header states.
    pub fn range(&self) -> Option<Range> {
        self.range
    }

    /// Are there samples of alpha, which are left out?
    pub fn has_alpha(&self) -> bool {
        self.sampling.has_alpha
    }

    /// The word by which the header says that frames are interlaced: two half pictures of two instants.
    pub fn interlaced(&self) -> Option<&str> {
        self.interlaced.as_deref()
    }

    /// The range, as pictures take it.
    fn taken(&self) -> Range {
        self.range.unwrap_or(if self.sampling.chroma.is_some() { Range::Limited } else { Range::Full })
    }

    /// What the header leaves open, and what was taken for it.
    pub fn notes(&self) -> Vec<String> {
        let [low, high] = Levels::new(Range::Limited, self.bits()).ends();
        let range = match (self.range, self.taken()) {
            (Some(Range::Full), _) => "full range, as the header says".to_string(),
            (Some(Range::Limited), _) => format!(
                "limited range, as the header says: {low} to {high} were stretched to the whole scale"
            ),
            (None, Range::Full) => "the header states no range; grey values are taken as they are".into(),
            (None, Range::Limited) => format!(
                "the header states no range; limited was taken: {low} to \
                                               {high} were stretched to the whole scale"
            ),
        };
        let mut notes = vec![range];
        if self.sampling.chroma.is_some() {
            let unknown = if self.unknown.is_empty() {
                String::new()
            } else {
                format!(" (`{}` is not known)", self.unknown.join("`, `"))
            };
            notes.push(format!(
                "YCbCr was converted to RGB by {MATRIX}: the header states no matrix{unknown}"
            ));
        }
        if let Some(word) = &self.interlaced {
            notes.push(format!(
                "the header says that frames are interlaced (`{word}`): every second row is \
                                of another instant"
            ));
        }
        notes
    }

    /// Bytes of a frame's values.
    fn frame_bytes(&self) -> u64 {
        let luma = u64::from(self.extent.width) * u64::from(self.extent.height);
        let chroma =
            self.chroma_extent().map_or(0, |extent| 2 * u64::from(extent.width) * u64::from(extent.height));
        (luma + chroma + if self.sampling.has_alpha { luma } else { 0 }) * self.sampling.sample_bytes()
    }

    fn chroma_extent(&self) -> Option<Extent> {
        self.sampling.chroma.map(|(across, down)| Extent {
            width: self.extent.width.div_ceil(across),
            height: self.extent.height.div_ceil(down),
        })
    }

    fn index(&mut self, reader: &mut BufReader<File>, mut at: u64) -> std::io::Result<()> {
        let size = self.frame_bytes();
        let mut text = Vec::new();
        while at < self.bytes {
            let whole = line(reader, &mut text)?;
            let start = at + text.len() as u64 + 1;
            if !whole || !(text == b"FRAME" || text.starts_with(b"FRAME ")) {
                let begins = b"FRAME ".starts_with(&text) || text.starts_with(b"FRAME ");
                self.broken = Some((
                    at,
                    if !whole && begins && self.bytes - at < LONGEST { Broken::Head } else { Broken::Other },
                ));
                break;
            }
            if start + size > self.bytes {
                self.broken = Some((at, Broken::Frame(start + size)));
                break;
            }
            self.frames.push(start);
            at = start + size;
            reader.seek(SeekFrom::Start(at))?;
        }
        Ok(())
    }

    /// What was left out.
    pub fn losses(&self) -> Vec<Loss> {
        let loss = self.broken.map(|(at, broken)| match broken {
            Broken::Other => {
                Loss::new(format!("byte {at}"), "no `FRAME` line stands here; the rest of the file is lost")
            }
            Broken::Head | Broken::Frame(_) => Loss::new(
                format!("bytes {at} to {}", self.bytes),
                format!("frame {} is cut off; it was left out", self.frames.len()),
            )
            .by(Cause::Cut),
        });
        loss.into_iter().collect()
    }

    /// Refuses a file of which something is lost.
    ///
    /// # Errors
    /// When it is cut off or damaged: the error says where.
    pub fn whole(&self) -> Result<(), FormatError> {
        let Some((at, broken)) = self.broken else { return Ok(()) };
        let (k, bytes) = (self.frames.len(), self.bytes);
        let (what, hint) = match broken {
            Broken::Head => (
                format!(
                    "it is cut off: it ends at the head of frame {k}, which begins at byte {at} of {bytes}"
                ),
                COPY_AGAIN,
            ),
            Broken::Frame(needed) => (
                format!(
                    "it is cut off: frame {k} begins at byte {at} and needs the bytes up to {needed}, \
                          and the file has {bytes}"
                ),
                COPY_AGAIN,
            ),
            Broken::Other => (
                format!(
                    "it has no frame where one should begin: at byte {at}; a frame of {} pixels has {} \
                     bytes by the header",
                    self.extent,
                    self.frame_bytes()
                ),
                "the file is damaged, or its header states another size or colour space than its frames have",
            ),
        };
        Err(FormatError::new(&self.path, format!("{what}; whole frames before it: {k}"), hint))
    }

    /// Calls `each` with the stored luma, chroma of blue and chroma of red of every pixel of a row, for some
    /// rows of a frame from top to bottom. Grey has the chroma of no colour.
    ///
    /// # Errors
    /// When there is no such frame, or the file cannot be read.
    pub fn rows(
        &self,
        frame: usize,
        rows: Rows,
        each: &mut dyn FnMut(&[[u16; 3]]),
    ) -> Result<(), FormatError> {
        let start = *self.frames.get(frame).ok_or_else(|| {
            FormatError::new(&self.path, format!("there is no frame {frame}"), "ask for one of its frames")
        })?;
        let size = self.sampling.sample_bytes();
        let mut bytes = Vec::new();
        let mut samples =
            |plane: u64, extent: Extent, row: u32, into: &mut Vec<u16>| -> Result<(), FormatError> {
                let length = u64::from(extent.width) * size;
                bytes.resize(length as usize, 0);
                let read = self.file.read_exact_at(&mut bytes, start + plane + u64::from(row) * length);
                read.map_err(|error| FormatError::io(&self.path, &error).at(format!("frame {frame}")))?;
                into.clear();
                match size {
                    1 => into.extend(bytes.iter().map(|byte| u16::from(*byte))),
                    _ => {
                        into.extend(bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])))
                    }
                }
                Ok(())
            };
        let (mut luma, mut blue, mut red, mut row) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let middle = Levels::new(Range::Full, self.bits()).middle();
        let plane_bytes = |extent: Extent| u64::from(extent.width) * u64::from(extent.height) * size;
        for y in rows.iter() {
            samples(0, self.extent, y, &mut luma)?;
            row.clear();
            match self.sampling.chroma.zip(self.chroma_extent()) {
                None => row.extend(luma.iter().map(|luma| [*luma, middle, middle])),
                Some(((across, down), chroma)) => {
                    let first = plane_bytes(self.extent);
                    samples(first, chroma, y / down, &mut blue)?;
                    samples(first + plane_bytes(chroma), chroma, y / down, &mut red)?;
                    let of = |x: usize| x / across as usize;
                    row.extend(luma.iter().enumerate().map(|(x, luma)| [*luma, blue[of(x)], red[of(x)]]));
                }
            }
            each(&row);
        }
        Ok(())
    }

    /// Replaces `values` by those of a frame, as a picture: black is 0, white the largest number of its bits.
    pub(crate) fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clear();
        let levels = Levels::new(self.taken(), self.bits());
        let most = levels.most();
        let colour = self.sampling.chroma.is_some();
        let clipped = |share: f64| (share * most).clamp(0.0, most) as f32;
        self.rows(frame, self.extent.rows(), &mut |row| match (colour, self.taken()) {
            (true, _) => values.extend(row.iter().flat_map(|pixel| levels.rgb(*pixel).map(clipped))),
            (false, Range::Full) => values.extend(row.iter().map(|[luma, ..]| f32::from(*luma))),
            (false, Range::Limited) => {
                values.extend(row.iter().map(|[luma, ..]| clipped(levels.luma(*luma))))
            }
        })
    }

    /// When frame `k` would stand at the header's rate, ns after the first.
    pub(crate) fn at(&self, frame: usize) -> Option<i64> {
        let (frames, seconds) = self.rate?;
        let ns = frame as u128 * u128::from(seconds) * 1_000_000_000 + u128::from(frames) / 2;
        i64::try_from(ns / u128::from(frames)).ok()
    }
}

impl Sampling {
    /// From the text after `C`.
    fn named(name: &str) -> Option<Sampling> {
        let of = |chroma, bits| Some(Sampling { chroma, bits, has_alpha: false });
        if let Some(bits) = name.strip_prefix("mono") {
            return of(
                None,
                if bits.is_empty() { 8 } else { bits.parse().ok().filter(|bits| (9..=16).contains(bits))? },
            );
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

    fn sample_bytes(self) -> u64 {
        if self.bits > 8 { 2 } else { 1 }
    }
}
