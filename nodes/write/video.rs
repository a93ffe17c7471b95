//! Writes frames as a film to look at: a Y4M file that players and encoders read, and an MP4 when the
//! manifest names an encoder.
//!
//! `video.y4m` (YUV4MPEG2) is written always, with nothing installed: 8 bits, sRGB-encoded R'G'B' as Y'CbCr
//! of BT.709 in limited range (black 16, white 235); grey as 4:2:0 with neutral chroma, which every player
//! reads, colour as 4:4:4. Black and white are those of previews ([`super::display`]), one pair for the whole
//! film. `rate` says how many frames a second are shown, whatever the time between them was: a film of 1,000
//! frames per second shown at 30 is 33 times slowed down, and a note says so.
//!
//! With `events` connected, the events around the middle of each frame's exposure are drawn over it in two
//! colours ([`super::events`]), and the film is one of colours. `counters` writes the time of that middle,
//! the number of the frame and, with events, their rate over the array into the picture. `scale` makes small
//! pictures larger.
//!
//! With `encoder = "ffmpeg"` that program then makes `video.mp4` of it, in this node's folder; other programs
//! and arguments by `arguments`. Nothing is looked for that the manifest does not name: on a machine without
//! the encoder the node fails, it does not give something else under the same key. Another version of the
//! encoder gives other bytes: `encoder_version` is a text of yours to raise then.
//!
//! Limits: for looking only, never for scores. Y4M is not compressed: 1.5 bytes a grey pixel, 3 a coloured
//! one. Middles are those of row 0: under a rolling shutter, events of lower rows are earlier than their
//! frame.

mod overlay;

use self::overlay::{Film, Overlay};
use super::display::Look;
use crate::command;
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table,
};
use photocurrent_formats::ycbcr::{Levels, Range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

/// Parameters of `write/video`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Frames shown a second.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "1 MHz"))]
    pub rate: Rate,
    /// DN of white. Default: 99.8 percent of the values lie below it, and it is at most the saturation of the
    /// sensor description.
    pub white: Option<f64>,
    /// Events are drawn over a frame from half of this before the middle of its exposure to half after it.
    /// Default: the mean time from frame to frame, so that a film has every event once; 5 ms for one frame.
    #[schemars(extend("x-min" = "1 us", "x-max" = "1000 s"))]
    pub window: Option<Duration>,
    /// Write time, frame number and event rate into the picture.
    pub counters: bool,
    /// Picture dots for each pixel along each side, 1 to 16.
    #[schemars(range(min = 1, max = 16))]
    pub scale: u32,
    /// The program that makes `video.mp4`, by its name on the path or its whole path; absent = Y4M only.
    pub encoder: Option<String>,
    /// Its arguments, each by itself; no shell sees them. `{y4m}` and `{mp4}` stand for the files. Default:
    /// those that FFmpeg needs for H.264.
    pub arguments: Option<Vec<String>>,
    /// What stands for the encoder's version; a new text runs it anew.
    pub encoder_version: String,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            rate: Rate::new(30.0),
            white: None,
            window: None,
            counters: false,
            scale: 1,
            encoder: None,
            arguments: None,
            encoder_version: String::new(),
        }
    }
}

photocurrent_core::ports! {
    /// What is written.
    pub struct In {
        /// Frames, captured or rendered, grey or RGB.
        frames: FrameSequence,
        /// Events, drawn over the frames: ON orange, OFF light blue.
        events: Option<EventStream>,
        /// The sensor description: black level and saturation; clock offset of the events.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// What was written.
    pub struct Out {
        /// One row per file: file, frames, rate_hz (shown), black_dn, white_dn.
        listing: Arc<Table>,
    }
}

/// The node.
pub struct WriteVideo {
    params: Params,
}

const Y4M: &str = "video.y4m";
const MP4: &str = "video.mp4";

/// H.264 that every player shows, of even size, without the date and the name of the machine. Range, matrix,
/// primaries and curve are those of the Y4M file: without these tags players take the matrix of BT.601 for
/// small films, and red becomes orange.
const FFMPEG: [&str; 26] = [
    "-y",
    "-loglevel",
    "error",
    "-i",
    "{y4m}",
    "-vf",
    "pad=ceil(iw/2)*2:ceil(ih/2)*2",
    "-c:v",
    "libx264",
    "-crf",
    "17",
    "-pix_fmt",
    "yuv420p",
    "-color_range",
    "tv",
    "-colorspace",
    "bt709",
    "-color_primaries",
    "bt709",
    "-color_trc",
    "iec61966-2-1",
    "-movflags",
    "+faststart",
    "-fflags",
    "+bitexact",
    "{mp4}",
];

impl Node for WriteVideo {
    const DECL: Decl = Decl {
        kind: "write/video",
        about: "Writes frames as a film for looking: Y4M, and MP4 by an encoder that the manifest names.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["YUV4MPEG2 (mjpegtools, yuv4mpeg(5)), BT.709 matrix, sRGB curve (IEC 61966-2-1)"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.film]
kind   = "write/video"
in     = { frames = "recording.frames", events = "recording.events", sensor = "recording.sensor" }
params = { rate = "25 Hz", window = "5 ms", counters = true }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let hz = params.rate.hz();
        if !(1e-3..=1e6).contains(&hz) {
            return Err(NodeError::usage(format!(
                "`rate` is {}, and must be 0.001 Hz to 1 MHz",
                params.rate
            ))
            .param("rate"));
        }
        if params.white.is_some_and(|white| !white.is_finite()) {
            return Err(NodeError::usage("`white` must be a number of DN").param("white"));
        }
        if !(1..=16).contains(&params.scale) {
            return Err(
                NodeError::usage(format!("`scale` is {}, and must be 1 to 16", params.scale)).param("scale")
            );
        }
        if let Some(window) = params.window.filter(|window| window.ns() < 1000) {
            return Err(
                NodeError::usage(format!("`window` is {window}, and must be 1 us or longer")).param("window")
            );
        }
        if params.encoder.is_none() && (params.arguments.is_some() || !params.encoder_version.is_empty()) {
            let idle = if params.arguments.is_some() { "arguments" } else { "encoder_version" };
            return Err(NodeError::usage(format!("`{idle}` does nothing without `encoder`"))
                .hint("such as encoder = \"ffmpeg\"")
                .param(idle));
        }
        if params.encoder.as_ref().is_some_and(String::is_empty) {
            return Err(NodeError::usage("`encoder` is an empty text")
                .hint("leave it out for Y4M only")
                .param("encoder"));
        }
        if let Some(arguments) = &params.arguments
            && ["{y4m}", "{mp4}"].iter().any(|file| !arguments.iter().any(|argument| argument.contains(file)))
        {
            return Err(NodeError::usage("`arguments` must name the files, as `{y4m}` and `{mp4}`")
                .param("arguments"));
        }
        Ok(WriteVideo { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        if frames.times.is_empty() {
            return Err(NodeError::usage("`frames` has no frame to write")
                .hint("look at the time window of the node that makes them"));
        }
        if frames.colour.is_mosaic() {
            return Err(NodeError::usage("a mosaic is no picture to look at")
                .hint("connect frames of render/demosaic"));
        }
        match inputs.all("events").first() {
            None if self.params.window.is_some() => {
                return Err(NodeError::usage("`window` does nothing without `events`")
                    .hint("connect the events of the recording, or leave `window` out")
                    .param("window"));
            }
            Some(Meta::Events(events)) => overlay::check(events, frames)?,
            _ => {}
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, folder) = (&input.frames, cx.export_dir()?);
        let look = Look::of(frames, input.sensor.as_deref(), self.params.white)?;
        cx.note(format!("{Y4M} is {}", look.about()));
        if let Some(slower) = slowed(frames, self.params.rate) {
            cx.note(slower);
        }
        let path = folder.join(Y4M);
        let written =
            |result: std::io::Result<()>| result.map_err(|error| super::cannot_write(&path, &error));
        let mut file =
            BufWriter::new(File::create(&path).map_err(|error| super::cannot_write(&path, &error))?);
        let film = Film::of(frames, input.events.is_some(), self.params.scale);
        let (window, sensor) = (self.params.window, input.sensor.as_deref());
        let mut overlay = Overlay::new(frames, input.events.as_ref(), sensor, window, self.params.counters)?;
        overlay.about().into_iter().for_each(|note| cx.note(note));
        written(file.write_all(header(film, self.params.rate).as_bytes()))?;
        cx.begin(frames.len() as u64, "frames");
        let curve = look.curve();
        let mut planes = Vec::new();
        for l in 0..frames.len() {
            let block = frames.read(l..l + 1, frames.rows())?;
            let codes: Vec<u8> = block.dn.iter().map(|&dn| curve.of(dn)).collect();
            let codes = overlay.draw(film, l, codes)?;
            planes.clear();
            planes.extend_from_slice(b"FRAME\n");
            if film.is_colour {
                push_444(&codes, &mut planes)
            } else {
                push_420(&codes, film.width, &mut planes)
            }
            written(file.write_all(&planes))?;
            cx.advance(1)?;
        }
        written(file.flush())?;
        drop(file);
        let mut files = vec![Y4M];
        if let Some(encoder) = &self.params.encoder {
            self.encode(encoder, folder, cx)?;
            files.push(MP4);
        }
        let all = |value: f64| Column::Numbers(vec![value; files.len()]);
        let listing = Table::default()
            .with("file", Column::Texts(files.iter().map(|file| file.to_string()).collect()))
            .with("frames", Column::Integers(vec![frames.len() as i64; files.len()]))
            .with("rate_hz", all(self.params.rate.hz()))
            .with("black_dn", all(look.black))
            .with("white_dn", all(look.white));
        Ok(Out { listing: Arc::new(listing) })
    }
}

impl WriteVideo {
    fn encode(&self, encoder: &str, folder: &Path, cx: &Context) -> Result<(), NodeError> {
        let arguments = self.params.arguments.clone().unwrap_or(FFMPEG.map(String::from).to_vec());
        let arguments: Vec<String> =
            arguments.iter().map(|argument| argument.replace("{y4m}", Y4M).replace("{mp4}", MP4)).collect();
        command::run(folder, encoder, &arguments, "encoder", cx).map_err(|error| {
            match error.message.starts_with("cannot start") {
                true => error.hint(
                    "install it, name it by its whole path, or leave `encoder` out: video.y4m needs none",
                ),
                false => error,
            }
        })?;
        if std::fs::metadata(folder.join(MP4)).map_or(0, |file| file.len()) == 0 {
            return Err(NodeError::failed(format!("\"{encoder}\" wrote no {MP4}"))
                .hint("`{mp4}` in `arguments` stands for the file that it must write")
                .param("encoder"));
        }
        Ok(())
    }
}

/// The line that the file begins with.
fn header(film: Film, rate: Rate) -> String {
    let hz = rate.hz();
    let (numerator, denominator) =
        if hz.fract() == 0.0 { (hz.round() as u64, 1) } else { ((hz * 1000.0).round() as u64, 1000) };
    let chroma = if film.is_colour { "444" } else { "420jpeg" };
    let (width, height) = (film.width, film.height);
    format!("YUV4MPEG2 W{width} H{height} F{numerator}:{denominator} Ip A1:1 C{chroma} XCOLORRANGE=LIMITED\n")
}

/// What the film does to time, when frames are equally far apart.
fn slowed(frames: &FrameSequence, rate: Rate) -> Option<String> {
    let exposures = &frames.meta.times.exposures;
    let (first, last) = (exposures.first()?.mid().0, exposures.last()?.mid().0);
    let step_s = (last - first) as f64 * 1e-9 / (exposures.len() as f64 - 1.0);
    let factor = 1.0 / (step_s * rate.hz());
    (factor.is_finite() && factor > 0.0)
        .then(|| format!("shown at {rate}, the film runs {factor:.3} times slower than the scene"))
}

/// Y'CbCr of the film, of codes of 8 bits.
fn levels() -> Levels {
    Levels::new(Range::Limited, 8)
}

/// Grey: the plane of luma, and two of neutral chroma for squares of four pixels.
fn push_420(codes: &[u8], width: u32, planes: &mut Vec<u8>) {
    let width = width as usize;
    planes.extend(codes.iter().map(|&code| levels().stored_luma(code.into(), 255.0) as u8));
    let height = codes.len() / width.max(1);
    planes.extend(std::iter::repeat_n(levels().middle() as u8, 2 * width.div_ceil(2) * height.div_ceil(2)));
}

/// Colour: three planes.
fn push_444(codes: &[u8], planes: &mut Vec<u8>) {
    let pixels: Vec<[u16; 3]> = codes
        .chunks_exact(3)
        .map(|rgb| levels().ycbcr([f64::from(rgb[0]), f64::from(rgb[1]), f64::from(rgb[2])], 255.0))
        .collect();
    (0..3).for_each(|plane| planes.extend(pixels.iter().map(|pixel| pixel[plane] as u8)));
}

#[cfg(test)]
mod tests {
    use super::super::testing::exporting;
    use super::*;
    use crate::simulate::stored::{self as simulate, Film, y4m::Y4m};
    use photocurrent_core::{
        Colour, Exposure, Extent, FrameBlock, FrameScale, FrameTimes, FramesMeta, testing,
    };
    use photocurrent_formats::pictures::PictureFiles;
    use photocurrent_formats::{Declared, Pictures, Transfer};

    fn write(
        frames: &FrameSequence,
        params: Params,
        look: impl FnOnce(Result<Out, NodeError>, Vec<String>, &Path),
    ) {
        let node = WriteVideo::build(params).unwrap();
        exporting(|cx| node.run(In { frames: frames.clone(), events: None, sensor: None }, cx), look);
    }

    fn exposures(count: i64) -> Vec<Exposure> {
        (0..count).map(|l| Exposure::new(l * 1_000_000, l * 1_000_000 + 500_000)).collect()
    }

    fn grey() -> FrameSequence {
        // 0, 21.4041 and 100 percent of white: stored as 0, 0.5 and 1 by sRGB.
        testing::captured(Extent { width: 3, height: 1 }, exposures(2), 0, |l, x, _| {
            if l == 0 { [0.0, 214.041, 1000.0][x as usize] } else { 1000.0 }
        })
    }

    #[test]
    fn grey_is_4_2_0_with_neutral_chroma_and_a_stated_rate() {
        let params = Params { rate: Rate::new(25.0), white: Some(1000.0), ..Params::default() };
        write(&grey(), params, |out, notes, folder| {
            let bytes = std::fs::read(folder.join("video.y4m")).unwrap();
            // By hand: 16 + 219 x 128 / 255 = 125.9; two chroma planes of 2 x 1.
            let mut expected =
                b"YUV4MPEG2 W3 H1 F25:1 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED\nFRAME\n".to_vec();
            expected.extend([16, 126, 235, 128, 128, 128, 128]);
            expected.extend(b"FRAME\n");
            expected.extend([235, 235, 235, 128, 128, 128, 128]);
            assert_eq!(bytes, expected);
            assert_eq!(notes[0], "shown at 25 Hz, the film runs 40.000 times slower than the scene");
            assert_eq!(
                notes[1],
                "video.y4m is for looking only: 8 bits, sRGB, black is 0 DN, white is 1000 DN"
            );
            assert_eq!(out.unwrap().listing.column("file").unwrap().cell(0), "video.y4m");
        });
    }

    #[test]
    fn colour_is_4_4_4_by_the_matrix_of_bt_709() {
        let times = FrameTimes::new(exposures(1), 0).unwrap();
        let meta = FramesMeta {
            extent: Extent { width: 2, height: 1 },
            colour: Colour::Rgb,
            times,
            scale: FrameScale::Captured,
        };
        let block = FrameBlock {
            frames: 0..1,
            rows: meta.extent.rows(),
            row_values: 6,
            dn: vec![10.0, 0.0, 0.0, 10.0, 10.0, 10.0],
        };
        let params = Params { rate: Rate::new(29.97), white: Some(10.0), ..Params::default() };
        write(&FrameSequence::in_memory(Arc::new(meta), block), params, |_, _, folder| {
            let bytes = std::fs::read(folder.join("video.y4m")).unwrap();
            let text = b"YUV4MPEG2 W2 H1 F29970:1000 Ip A1:1 C444 XCOLORRANGE=LIMITED\nFRAME\n";
            assert_eq!(bytes[..text.len()], text[..]);
            // Pure red in BT.709 of limited range is 63, 102, 240; white is 235, 128, 128.
            assert_eq!(bytes[text.len()..], [63, 235, 102, 128, 240, 128]);
        });
    }

    #[test]
    fn a_colour_film_is_read_back_with_its_colours() {
        // Every colour of seven steps a channel; white is 1000 DN.
        let steps = [0.0, 8.0, 60.0, 214.041, 400.0, 700.0, 1000.0];
        let dn: Vec<f32> = (0..343).flat_map(|k| [steps[k % 7], steps[k / 7 % 7], steps[k / 49]]).collect();
        let times = FrameTimes::new(exposures(1), 0).unwrap();
        let meta = FramesMeta {
            extent: Extent { width: 49, height: 7 },
            colour: Colour::Rgb,
            times,
            scale: FrameScale::Captured,
        };
        let block = FrameBlock { frames: 0..1, rows: meta.extent.rows(), row_values: 147, dn: dn.clone() };
        let params = Params { white: Some(1000.0), ..Params::default() };
        write(&FrameSequence::in_memory(Arc::new(meta), block), params, |_, _, folder| {
            let path = folder.join("video.y4m");
            let pictures = PictureFiles::open(&path, &Declared::default()).unwrap();
            let mut codes = Vec::new();
            pictures.read(0, &mut codes).unwrap();
            let film = Y4m::open(&path, simulate::Transfer::Srgb, None).unwrap();
            let mut light = Vec::new();
            film.read(0, film.extent().rows(), &mut |row| light.extend_from_slice(row)).unwrap();
            assert_eq!((codes.len(), light.len()), (1029, 343));
            for ((dn, codes), light) in dn.chunks(3).zip(codes.chunks(3)).zip(light) {
                let share = |code: f32| Transfer::Srgb.linear(f64::from(code) / 255.0);
                // sRGB by the standard; a step of luma is 1.2 codes of 8 bits, a step of chroma up to 2.1:
                // half of both.
                let stored = dn.iter().map(|dn| f64::from(*dn) / 1000.0).map(|dn| {
                    if dn <= 0.003_130_8 { 12.92 * dn } else { 1.055 * libm::pow(dn, 1.0 / 2.4) - 0.055 }
                });
                let stored: Vec<f64> = stored.map(|share| 255.0 * share).collect();
                let off =
                    codes.iter().zip(&stored).map(|(found, expected)| (f64::from(*found) - expected).abs());
                assert!(
                    off.clone().all(|off| off < 0.5 + 0.6 + 1.1),
                    "{dn:?}: {codes:?}, {stored:?} expected"
                );
                // Luminance: that of the colours as they are read, and that of the scene within 2 codes of
                // each channel.
                let sum = |light: [f64; 3]| 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
                let within = |by: f64| {
                    sum([0, 1, 2]
                        .map(|channel| Transfer::Srgb.linear((stored[channel] + by).max(0.0) / 255.0)))
                };
                assert!((within(-2.2)..=within(2.2)).contains(&light), "{dn:?}: {light}");
                let inside = codes.iter().all(|code| *code > 0.0 && *code < 255.0);
                assert!(
                    !inside || (sum([0, 1, 2].map(|channel| share(codes[channel]))) - light).abs() < 1e-6,
                    "{dn:?}: {codes:?}, {light}"
                );
            }
        });
    }

    #[test]
    fn the_encoder_that_the_manifest_names_makes_the_mp4() {
        let copies = |script: &str| Params {
            encoder: Some("sh".into()),
            arguments: Some(vec!["-c".into(), script.into(), "{y4m}".into(), "{mp4}".into()]),
            encoder_version: "1".into(),
            ..Params::default()
        };
        write(&grey(), copies("cp \"$0\" \"$1\""), |out, _, folder| {
            assert_eq!(
                std::fs::read(folder.join("video.mp4")).unwrap(),
                std::fs::read(folder.join("video.y4m")).unwrap()
            );
            assert_eq!(out.unwrap().listing.column("file").unwrap().cell(1), "video.mp4");
        });
        write(&grey(), copies("true"), |out, _, _| {
            assert_eq!(out.err().unwrap().message, "\"sh\" wrote no video.mp4")
        });
        write(&grey(), copies("echo no; exit 3"), |out, _, _| {
            assert_eq!(out.err().unwrap().message, "\"sh\" ended with exit code 3")
        });
        let missing = Params { encoder: Some("no-such-encoder-here".into()), ..Params::default() };
        write(&grey(), missing, |out, _, _| {
            assert!(out.err().unwrap().hint.unwrap().contains("video.y4m needs none"))
        });
    }

    /// Standard output of a program; `None` when it is not installed.
    fn output(program: &str, arguments: &[&str], folder: &Path) -> Option<Vec<u8>> {
        let made = std::process::Command::new(program).args(arguments).current_dir(folder).output().ok()?;
        assert!(made.status.success(), "{program}: {}", String::from_utf8_lossy(&made.stderr));
        Some(made.stdout)
    }

    #[test]
    fn ffmpeg_makes_an_mp4_of_the_same_colours() {
        let here = Path::new(".");
        if output("ffmpeg", &["-version"], here).is_none() || output("ffprobe", &["-version"], here).is_none()
        {
            println!("not tested: ffmpeg and ffprobe are not installed");
            return;
        }
        let times = FrameTimes::new(exposures(3), 0).unwrap();
        let meta = FramesMeta {
            extent: Extent { width: 33, height: 17 },
            colour: Colour::Rgb,
            times,
            scale: FrameScale::Captured,
        };
        let dn = [10.0, 0.0, 0.0].repeat(3 * 33 * 17);
        let red = FrameSequence::in_memory(
            Arc::new(meta.clone()),
            FrameBlock { frames: 0..3, rows: meta.extent.rows(), row_values: 99, dn },
        );
        let params = Params {
            rate: Rate::new(25.0),
            white: Some(10.0),
            encoder: Some("ffmpeg".into()),
            ..Params::default()
        };
        write(&red, params, |out, _, folder| {
            out.unwrap();
            let entries = "stream=codec_name,width,height,pix_fmt,color_range,color_space,color_transfer,colo\
                           r_primaries,r_frame_rate,nb_frames";
            let stream =
                output("ffprobe", &["-v", "error", "-show_entries", entries, "-of", "csv=p=0", MP4], folder)
                    .unwrap();
            assert_eq!(
                String::from_utf8_lossy(&stream).trim(),
                "h264,34,18,yuv420p,tv,bt709,iec61966-2-1,bt709,25/1,3"
            );
            let rgb = output(
                "ffmpeg",
                &["-v", "error", "-i", MP4, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
                folder,
            )
            .unwrap();
            assert_eq!(rgb.len(), 3 * 34 * 18 * 3);
            // Pure red; the encoder's quantisation moves it by a few codes.
            assert!(rgb[0] > 245 && rgb[1] < 10 && rgb[2] < 10, "{:?}", &rgb[..3]);
        });
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let refused = |params: Params| WriteVideo::build(params).err().and_then(|error| error.param);
        assert_eq!(refused(Params { rate: Rate::new(0.0), ..Params::default() }).as_deref(), Some("rate"));
        assert_eq!(
            refused(Params { arguments: Some(vec![]), ..Params::default() }).as_deref(),
            Some("arguments")
        );
        assert_eq!(
            refused(Params { encoder_version: "1".into(), ..Params::default() }).as_deref(),
            Some("encoder_version")
        );
        let silent =
            Params { encoder: Some("x".into()), arguments: Some(vec!["{y4m}".into()]), ..Params::default() };
        assert_eq!(refused(silent).as_deref(), Some("arguments"));
        assert_eq!(
            refused(Params { encoder: Some(String::new()), ..Params::default() }).as_deref(),
            Some("encoder")
        );
    }
}
