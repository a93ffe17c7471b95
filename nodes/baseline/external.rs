//! `baseline/external`: frames that another program made, matched by time.
//!
//! For every method that is not here: its pictures lie in a folder (PNG of 8 or 16 bits, or NumPy `.npy`),
//! one file a frame, sorted by name as people count; their times stand in a text file (one number a line, or
//! a column of a CSV), or follow from a rate. With frames at `at`, each of those takes the picture whose time
//! is nearest to the middle of its exposure; the table `matches` says which, and how far off.
//!
//! A stored value of `stored_white` is `white` DN, 0 is black, and between them it is linear unless
//! `transfer` says otherwise. No scaling, no fitting, no alignment: what a method got wrong stays wrong. Next
//! to frames of three channels at `at` pictures have three (a grey one has them alike); otherwise colours
//! count as luminance. Limits: one time for all rows.

pub mod npy;
pub mod pictures;

use crate::simulate::stored::{Transfer, cannot_read, short_name};
use photocurrent_core::quantity::{Duration, InputPath, Rate};
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Colour, Context, Decl, Exposure, FileRef, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain, Meta,
    Node, NodeError, PortMetas, Sensor, Table,
};
use pictures::{Levels, extent, pictures};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Unit of the numbers in a file of times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    #[default]
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    fn ns(self) -> f64 {
        match self {
            TimeUnit::S => 1e9,
            TimeUnit::Ms => 1e6,
            TimeUnit::Us => 1e3,
            TimeUnit::Ns => 1.0,
        }
    }
}

/// What becomes of a frame at `at` without a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unmatched {
    /// The node refuses.
    #[default]
    Error,
    /// It is left out, and counted.
    LeaveOut,
}

/// Parameters of `baseline/external`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Folder of the pictures: `*.png` (8 or 16 bits) or `*.npy` ([height, width] or [height, width, 3], u1,
    /// u2, f4 or f8), one file a frame, sorted by name, `f2` before `f10`; relative to the manifest that
    /// names it.
    pub path: InputPath,
    /// Text file with one time a picture, in the pictures' order; empty lines and those that begin with `#`
    /// or a letter do not count. Default: as `rate` says.
    pub times: Option<InputPath>,
    /// Unit of the numbers in `times`.
    pub time_unit: TimeUnit,
    /// Which column of a CSV holds the times, counted from 0; columns end with a comma, a semicolon or
    /// blanks.
    #[schemars(range(max = 1000))]
    pub time_column: u32,
    /// Pictures per second, when there is no `times`.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "10 MHz"))]
    pub rate: Option<Rate>,
    /// Time of the first picture with `rate`; with `times`, what is added to each.
    pub start: Duration,
    /// How far a picture's time may lie from the middle of a frame's exposure.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
    /// What becomes of a frame at `at` without a picture.
    pub unmatched: Unmatched,
    /// Exposure that the pictures stand for, when nothing is connected to `at`.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// DN of white; absent = the sensor description's saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Stored value that is white in `.npy` files; absent = 255 or 65535 for whole numbers, 1 for others.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub stored_white: Option<f64>,
    /// How stored values of PNG pictures become linear light.
    pub transfer: Transfer,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            path: InputPath::default(),
            times: None,
            time_unit: TimeUnit::Us,
            time_column: 0,
            rate: None,
            start: Duration::default(),
            tolerance: Duration::new(1_000_000),
            unmatched: Unmatched::Error,
            exposure: Duration::new(1_000_000),
            white: None,
            stored_white: None,
            transfer: Transfer::Linear,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Black level and saturation.
        sensor: Option<Arc<Sensor>>,
        /// Frames at whose instants pictures are taken.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The pictures as frames, linear DN.
        frames: FrameSequence,
        /// One row a frame: `file`, `asked_ns`, `given_ns`, `difference_ns`.
        matches: Arc<Table>,
    }
}

/// The node.
pub struct BaselineExternal {
    params: Params,
}

/// A picture for a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Index of the picture.
    pub picture: usize,
    /// Index of the frame at `at`.
    pub frame: usize,
    /// Middle of its exposure, ns.
    pub asked_ns: i64,
    /// Time of the picture, ns.
    pub given_ns: i64,
}

struct Planned {
    pictures: Vec<PathBuf>,
    matches: Vec<Match>,
    left_out: usize,
    meta: FramesMeta,
}

impl BaselineExternal {
    fn prepare(&self, at: Option<&FramesMeta>) -> Result<Planned, NodeError> {
        let params = &self.params;
        let pictures = pictures(params.path.path())?;
        let extent = extent(&pictures[0])?;
        let given = self.times(pictures.len())?;
        let Some(at) = at else {
            let half = params.exposure.ns() / 2;
            let exposures =
                given.iter().map(|t| Exposure::new(t - half, t - half + params.exposure.ns())).collect();
            let times = FrameTimes::new(exposures, 0).map_err(|error| {
                NodeError::input(format!("the pictures' times are not in order: {error}"))
                    .hint("times stand in the order of the pictures' names")
                    .param("times")
            })?;
            let meta = FramesMeta {
                extent,
                colour: Colour::Mono,
                times,
                scale: FrameScale::Nominal { exposure_ns: params.exposure.ns() },
            };
            let matches = given
                .iter()
                .enumerate()
                .map(|(n, &t)| Match { picture: n, frame: n, asked_ns: t, given_ns: t })
                .collect();
            return Ok(Planned { pictures, matches, left_out: 0, meta });
        };
        if at.extent != extent {
            return Err(NodeError::input(format!(
                "{} has {extent} pixels, and the frames at `at` have {}",
                short_name(&pictures[0]),
                at.extent
            ))
            .hint("let the other program write pictures of the frames' size")
            .param("path"));
        }
        let asked: Vec<i64> =
            (0..at.times.len()).map(|l| at.times.exposure(l, at.extent.height / 2).mid().0).collect();
        let matches = matched(&asked, &given, params.tolerance.ns());
        let left_out = asked.len() - matches.len();
        let far = || {
            let missing = (0..asked.len()).find(|l| !matches.iter().any(|m| m.frame == *l)).unwrap_or(0);
            let nearest = given.iter().min_by_key(|t| (**t - asked[missing]).abs()).copied().unwrap_or(0);
            NodeError::input(format!(
                "{left_out} of {} frames have no picture within {}",
                asked.len(),
                params.tolerance
            ))
            .note(format!(
                "frame {missing} is asked for at {} ns; the nearest picture is at {nearest} ns",
                asked[missing]
            ))
            .note(format!("pictures: {} from {} to {} ns", given.len(), given[0], given[given.len() - 1]))
            .hint("check `time_unit` and `start`, raise `tolerance`, or state `unmatched = \"leave_out\"`")
            .param("tolerance")
        };
        if matches.is_empty() || (left_out > 0 && params.unmatched == Unmatched::Error) {
            return Err(far());
        }
        let kept: Vec<usize> = matches.iter().map(|m| m.frame).collect();
        let colour = if at.colour == Colour::Rgb { Colour::Rgb } else { Colour::Mono };
        let meta = FramesMeta { colour, times: at.times.select(&kept), ..at.clone() };
        Ok(Planned { pictures, matches, left_out, meta })
    }

    fn levels(&self, sensor: Option<&Sensor>) -> Result<Levels, NodeError> {
        Levels::new(self.params.white, self.params.stored_white, self.params.transfer, sensor)
    }

    /// Time of every picture, ns.
    fn times(&self, count: usize) -> Result<Vec<i64>, NodeError> {
        let params = &self.params;
        let start = params.start.ns();
        match (&params.times, params.rate) {
            (Some(file), _) => {
                let path = file.path();
                let text = std::fs::read_to_string(path)
                    .map_err(|error| cannot_read(path, &error).param("times"))?;
                let times =
                    parse_times(&text, params.time_column as usize, params.time_unit).map_err(|error| {
                        NodeError::input(format!("{}: {error}", short_name(path)))
                            .hint("one time a line; `time_column` says which column of a CSV")
                            .param("times")
                    })?;
                if times.len() != count {
                    return Err(NodeError::input(format!(
                        "{} has {} times, and the folder has {count} pictures",
                        short_name(path),
                        times.len()
                    ))
                    .hint("one time for each picture, in the order of their names")
                    .param("times"));
                }
                Ok(times.into_iter().map(|t| t + start).collect())
            }
            (None, Some(rate)) => {
                Ok((0..count).map(|k| start + (k as f64 * 1e9 / rate.hz()).round() as i64).collect())
            }
            (None, None) => Err(NodeError::usage("when the pictures were taken is not stated")
                .hint("name a file of times (`times`, with its `time_unit`), or state `rate` and `start`")
                .param("times")),
        }
    }
}

/// Numbers of one column, as ns.
fn parse_times(text: &str, column: usize, unit: TimeUnit) -> Result<Vec<i64>, String> {
    let mut times = Vec::new();
    for (n, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with(|c: char| c == '#' || c.is_alphabetic()) {
            continue;
        }
        let cells: Vec<&str> = line
            .split(|c: char| c == ',' || c == ';' || c.is_whitespace())
            .filter(|cell| !cell.is_empty())
            .collect();
        let cell = cells.get(column).ok_or_else(|| {
            format!("line {} has {} columns, and column {column} is asked for", n + 1, cells.len())
        })?;
        let value: f64 = cell.parse().map_err(|_| format!("line {}: \"{cell}\" is no number", n + 1))?;
        let ns = value * unit.ns();
        if !ns.is_finite() || ns.abs() > 9e18 {
            return Err(format!("line {}: {cell} is no time", n + 1));
        }
        times.push(ns.round() as i64);
    }
    Ok(times)
}

/// For each asked time the nearest given one (the earlier of two), where that is within the tolerance.
fn matched(asked: &[i64], given: &[i64], tolerance_ns: i64) -> Vec<Match> {
    let mut order: Vec<usize> = (0..given.len()).collect();
    order.sort_by_key(|&n| given[n]);
    let nearest = |t: i64| {
        let after = order.partition_point(|&n| given[n] < t);
        [after.checked_sub(1), Some(after)]
            .into_iter()
            .flatten()
            .filter_map(|k| order.get(k).copied())
            .min_by_key(|&n| (given[n] - t).abs())
    };
    let pair = |(frame, &asked_ns): (usize, &i64)| {
        let picture = nearest(asked_ns)?;
        let found = Match { picture, frame, asked_ns, given_ns: given[picture] };
        ((found.given_ns - asked_ns).abs() <= tolerance_ns).then_some(found)
    };
    asked.iter().enumerate().filter_map(pair).collect()
}

impl Node for BaselineExternal {
    const DECL: Decl = Decl {
        kind: "baseline/external",
        about: "Frames that another program made, from a folder of pictures with their times, matched by \
                time.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["whatever made the pictures"],
        example: r#"
[nodes.film]
kind   = "baseline/external"
in     = { sensor = "sensor", at = "recording.frames" }
params = { path = "film_output", times = "film_output/times.txt", time_unit = "us", tolerance = "100 us", white = 1023 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.path.path().as_os_str().is_empty() {
            return Err(NodeError::usage("`path` is missing")
                .hint("name the folder of the pictures")
                .param("path"));
        }
        if params.times.is_some() && params.rate.is_some() {
            return Err(NodeError::usage("both `times` and `rate` say when the pictures were taken")
                .hint("keep one of them")
                .param("rate"));
        }
        Ok(BaselineExternal { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        let sensor = inputs.has("sensor").then(|| inputs.sensor("sensor")).transpose()?;
        self.levels(sensor.map(|sensor| &**sensor))?;
        let planned = self.prepare(at.map(|at| &**at))?;
        Ok(vec![Meta::Frames(Arc::new(planned.meta)), Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let levels = self.levels(input.sensor.as_deref())?;
        let planned = self.prepare(input.at.as_ref().map(|at| &*at.meta))?;
        let (meta, matches) = (planned.meta, planned.matches);
        cx.count(planned.left_out as u64, "frames have no picture within the tolerance and are left out");
        cx.begin(matches.len() as u64, "pictures");
        let paths: Vec<&Path> =
            matches.iter().map(|found| planned.pictures[found.picture].as_path()).collect();
        let block = levels.frames(cx, &meta, &paths)?;
        let column = |of: &dyn Fn(&Match) -> i64| Column::Integers(matches.iter().map(of).collect());
        let table = Table::default()
            .with(
                "file",
                Column::Texts(matches.iter().map(|m| short_name(&planned.pictures[m.picture])).collect()),
            )
            .with("asked_ns", column(&|m| m.asked_ns))
            .with("given_ns", column(&|m| m.given_ns))
            .with("difference_ns", column(&|m| m.given_ns - m.asked_ns));
        Ok(Out { frames: FrameSequence::in_memory(Arc::new(meta), block), matches: Arc::new(table) })
    }

    fn files(&self) -> Vec<FileRef> {
        // A folder that cannot be listed is reported by the plan.
        let listed = pictures(self.params.path.path())
            .unwrap_or_default()
            .into_iter()
            .map(|path| FileRef { param: "path".into(), path });
        listed
            .chain(
                self.params
                    .times
                    .iter()
                    .map(|times| FileRef { param: "times".into(), path: times.path().to_path_buf() }),
            )
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Extent, testing};

    /// A version 1.0 file as NumPy writes it.
    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
        header.push_str(&" ".repeat(63 - (10 + header.len()) % 64));
        header.push('\n');
        [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes(), data]
            .concat()
    }

    fn folder(count: usize) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for n in 0..count {
            // Two pixels: 0.1 n and 0.5.
            let data: Vec<u8> = [0.1 * n as f32, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
            std::fs::write(folder.path().join(format!("f{n}.npy")), npy("<f4", "1, 2", &data)).unwrap();
        }
        folder
    }

    /// Digital numbers, the table, notes.
    type Found = (Vec<f32>, Arc<Table>, Vec<String>);

    fn run(params: Params, at: Option<FrameSequence>) -> Result<Found, NodeError> {
        let extent = Extent { width: 2, height: 1 };
        let node = BaselineExternal::build(params)?;
        let (out, notes) = testing::with_context(extent.rows(), &["frames", "matches"], |cx| {
            node.run(In { sensor: None, at }, cx)
        });
        let out = out?;
        Ok((out.frames.read_rows(extent.rows()).unwrap().dn, out.matches, notes))
    }

    fn at(mids_ms: &[i64]) -> FrameSequence {
        let exposures = mids_ms
            .iter()
            .map(|ms| Exposure::new(ms * 1_000_000 - 500_000, ms * 1_000_000 + 500_000))
            .collect();
        testing::captured(Extent { width: 2, height: 1 }, exposures, 0, |_, _, _| 0.0)
    }

    fn params(folder: &tempfile::TempDir) -> Params {
        Params {
            path: InputPath::new(folder.path()),
            rate: Some(Rate::new(1000.0)),
            white: Some(200.0),
            ..Params::default()
        }
    }

    #[test]
    fn each_frame_takes_the_picture_nearest_in_time() {
        // Twelve pictures, so that f10 and f11 come after f9.
        let folder = folder(12);
        std::fs::write(
            folder.path().join("times.txt"),
            (0..12).map(|n| format!("{}\n", 1000 * n + 3)).collect::<String>(),
        )
        .unwrap();
        let times = Some(InputPath::new(folder.path().join("times.txt")));
        let (dn, table, _) =
            run(Params { times, rate: None, ..params(&folder) }, Some(at(&[2, 11]))).unwrap();
        assert_eq!(dn, [40.0, 100.0, 220.0, 100.0]);
        assert_eq!(table.column("file"), Some(&Column::Texts(vec!["f2.npy".into(), "f11.npy".into()])));
        assert_eq!(table.column("difference_ns"), Some(&Column::Integers(vec![3000, 3000])));
    }

    #[test]
    fn a_frame_without_a_picture_is_an_error_or_left_out_as_stated() {
        let folder = folder(3);
        let error = run(params(&folder), Some(at(&[1, 9]))).unwrap_err();
        assert_eq!(
            (error.message.as_str(), error.param.as_deref()),
            ("1 of 2 frames have no picture within 1 ms", Some("tolerance"))
        );
        assert_eq!(
            error.notes[0],
            "frame 1 is asked for at 9000000 ns; the nearest picture is at 2000000 ns"
        );
        let (dn, _, notes) =
            run(Params { unmatched: Unmatched::LeaveOut, ..params(&folder) }, Some(at(&[1, 9]))).unwrap();
        assert_eq!((dn, notes.len()), (vec![20.0, 100.0], 1));
    }

    #[test]
    fn a_16_bit_picture_is_read_to_its_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let file = std::fs::File::create(folder.path().join("a.png")).unwrap();
        let mut encoder = png::Encoder::new(file, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.write_header().unwrap().write_image_data(&[0x12, 0x34, 0xff, 0xff]).unwrap();
        let (dn, _, _) = run(Params { white: Some(65535.0), ..params(&folder) }, None).unwrap();
        assert_eq!(dn, [f32::from(0x1234_u16), 65535.0]);
    }

    #[test]
    fn pictures_have_three_channels_next_to_frames_that_have_them() {
        let of = |file: &str, bytes: &[u8], colour: Colour| {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join(file), bytes).unwrap();
            let meta = FramesMeta { colour, ..(*at(&[0]).meta).clone() };
            let block = photocurrent_core::FrameBlock::zeros(0..1, meta.extent.rows(), meta.row_values());
            let at = FrameSequence::in_memory(Arc::new(meta), block);
            run(Params { white: Some(255.0), ..params(&folder) }, Some(at)).unwrap().0
        };
        let mut encoded = Vec::new();
        let mut encoder = png::Encoder::new(&mut encoded, 2, 1);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&[10, 20, 30, 40, 50, 60]).unwrap();
        assert_eq!(of("a.png", &encoded, Colour::Rgb), [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        let stored = npy("|u1", "1, 2, 3", &[10, 20, 30, 40, 50, 60]);
        assert_eq!(of("a.npy", &stored, Colour::Rgb), [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        // A grey picture has three alike; colours next to grey frames are their luminance.
        let grey = npy("|u1", "1, 2", &[10, 20]);
        assert_eq!(of("a.npy", &grey, Colour::Rgb), [10.0, 10.0, 10.0, 20.0, 20.0, 20.0]);
        let first = 0.2126 * 10.0 + 0.7152 * 20.0 + 0.0722 * 30.0;
        for (file, bytes) in [("a.png", &encoded), ("a.npy", &stored)] {
            assert!((of(file, bytes, Colour::Mono)[0] - first).abs() < 1e-3, "{file}");
        }
    }

    #[test]
    fn times_of_a_csv_have_a_column_and_a_unit() {
        let text = "# by hand\nframe, t\n0, 0.5\n1; 0.25\n";
        assert_eq!(parse_times(text, 1, TimeUnit::Ms), Ok(vec![500_000, 250_000]));
        assert_eq!(
            parse_times(text, 2, TimeUnit::Ms).unwrap_err(),
            "line 3 has 2 columns, and column 2 is asked for"
        );
        assert_eq!(parse_times("1x\n", 0, TimeUnit::S).unwrap_err(), "line 1: \"1x\" is no number");
    }

    #[test]
    fn missing_times_and_wrong_counts_are_refused() {
        let folder = folder(2);
        assert_eq!(
            run(Params { rate: None, ..params(&folder) }, None).unwrap_err().param.as_deref(),
            Some("times")
        );
        std::fs::write(folder.path().join("times.txt"), "1\n2\n3\n").unwrap();
        let times = Some(InputPath::new(folder.path().join("times.txt")));
        let error = run(Params { times, rate: None, ..params(&folder) }, None).unwrap_err();
        assert_eq!(error.message, "times.txt has 3 times, and the folder has 2 pictures");
    }

    #[test]
    fn npy_files_of_other_forms_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        for (bytes, said) in [
            (npy("<i8", "1, 2", &[0; 16]), "holds '<i8'"),
            (npy("|u1", "1, 2, 4", &[0; 8]), "has the shape (1, 2, 4)"),
            (npy("|u1", "1, 2", &[0; 1]), "2 numbers are announced"),
            (b"no".to_vec(), "is no `.npy` file"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = run(params(&folder), None).unwrap_err();
            assert!(error.message.starts_with("a.npy ") && error.message.contains(said), "{}", error.message);
        }
    }
}
