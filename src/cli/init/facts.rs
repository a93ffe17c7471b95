//! What is found in the files, and what has to be proposed because they do not state it.

use super::usage;
use crate::common::Failure;
use crate::declared::DeclaredOptions;
use crate::parts::Parts;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{FramesMeta, TimeSpan};
use photocurrent_formats::arrange::{Arranged, EVENTS_BUDGET, arrange};
use photocurrent_formats::{EventCursor, Format, FormatError, Recording, StampRole, TimeUnit, Transfer, joined};
use photocurrent_nodes::estimate::{Estimate, Proposals, proposals};
use photocurrent_nodes::read::foreign::All;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A value that no file states.
pub struct Fill {
    /// The parameter.
    pub name: &'static str,
    /// As TOML.
    pub value: String,
    /// Why this value, and what depends on it.
    pub why: String,
}

/// Everything that the manifest and the description are made of.
pub struct Facts {
    pub format: &'static Format,
    /// The recording, and where frames and stamps lie when they lie elsewhere.
    pub all: All,
    /// Paths that the manifest names.
    pub inputs: Vec<PathBuf>,
    /// Parameters of the reader, as TOML, in order: those that were stated on the command line.
    pub stated: Vec<(String, String)>,
    /// Parameters of the reader that had to be proposed.
    pub reader: Vec<Fill>,
    /// Fields of the description that had to be proposed.
    pub sensor: Vec<Fill>,
    pub frames: Arc<FramesMeta>,
    /// Bits of a stored value.
    pub bits: u32,
    /// The part of the recording that is rendered, from zero.
    pub window: Option<(Duration, Duration)>,
    /// Frames per second that are rendered.
    pub rate_hz: f64,
    /// Is there a description in the file?
    pub sensor_text: Option<String>,
    /// What calibration and bias files say, a line each.
    pub camera: Vec<String>,
    pub notes: Vec<String>,
    pub losses: Vec<String>,
}

impl Facts {
    /// Everything that is marked.
    pub fn fills(&self) -> impl Iterator<Item = &Fill> {
        self.reader.iter().chain(self.sensor_text.is_none().then_some(&self.sensor).into_iter().flatten())
    }

    /// Length of a frame's exposure, s.
    pub fn exposure_s(&self) -> f64 {
        self.frames.times.nominal_exposure_ns().unwrap_or(1) as f64 / 1e9
    }
}

/// Looks at the files, and proposes what they do not state.
pub fn collect(files: &[PathBuf], declared: &DeclaredOptions) -> Result<Facts, Failure> {
    let parts = Parts::sort(files)?;
    let mut all = declared.parameters(&parts.recording);
    let stated = stated(&all)?;
    let mut inputs = vec![parts.recording.clone()];
    if let Some(frames) = &parts.frames {
        all.frames = Some(photocurrent_core::quantity::InputPath::new(frames));
        inputs.push(frames.clone());
    }
    if let Some(stamps) = &parts.stamps {
        all.stamps = Some(photocurrent_core::quantity::InputPath::new(stamps));
        inputs.push(stamps.clone());
    }
    let mut reader = Vec::new();
    let (recording, arranged) = settle(&parts, &mut all, &mut reader)?;
    let path = &parts.recording;
    let events_meta = arranged.events.clone().map_err(|why| usage(format!("{why}: there is nothing to reconstruct from")))?;
    let frames = arranged.frames.clone().map_err(|why| {
        let hint = "hint: name the frames too: a folder of pictures next to the event file; events alone do not state the light's level";
        usage(format!("{why}: frames are needed for a picture of known brightness\n  {hint}"))
    })?;
    let found = measured(recording.as_ref(), &arranged, &parts, &mut all, &mut reader)?;
    // A better exposure moves the frames' times.
    let (recording, arranged) =
        if found.exposure_ns.is_some() { open(&parts, &all).map_err(|error| crate::declared::refused(&error))? } else { (recording, arranged) };
    let frames = arranged.frames.clone().unwrap_or(frames);
    let bits = recording.pictures().map_or(8, |pictures| pictures.about().bits);
    let events_span = events_meta.span.ok_or_else(|| usage(format!("{}: there is no event in it", path.display())))?;
    overlap(path, events_span, &frames)?;
    let events = events_meta.count_hint.unwrap_or(0);
    let (window, rate_hz) = what_to_render(&frames, events_span, events);
    let losses = arranged.losses.iter().map(|loss| format!("{}: {}", loss.at, loss.what)).collect();
    let mut facts = Facts {
        format: parts.format,
        all,
        inputs,
        stated,
        reader,
        sensor: Vec::new(),
        frames,
        bits,
        window,
        rate_hz,
        sensor_text: recording.sensor_text().map(String::from),
        camera: parts.camera.clone(),
        notes: arranged.notes.clone(),
        losses,
    };
    facts.sensor = describe(&found);
    Ok(facts)
}

/// What was stated on the command line, as lines of a manifest; paths stand elsewhere.
fn stated(all: &All) -> Result<Vec<(String, String)>, Failure> {
    let value = toml::Table::try_from(all).map_err(|error| Failure::other(error.to_string()))?;
    let lines = value.into_iter().filter(|(name, _)| !["path", "frames", "stamps"].contains(&name.as_str()));
    Ok(lines.map(|(name, value)| (name, value.to_string())).collect())
}

/// Opens and arranges; what is missing is proposed until nothing is.
fn settle(parts: &Parts, all: &mut All, fills: &mut Vec<Fill>) -> Result<(Box<dyn Recording>, Arranged), Failure> {
    let mut is_paired = false;
    for _ in 0..16 {
        let opened = open(parts, all);
        if !is_paired && super::pairing::is_open(all, opened.as_ref().err()) {
            is_paired = true;
            let proposed = super::pairing::proposed(parts, all)?;
            if !proposed.is_empty() {
                fills.extend(proposed);
                continue;
            }
        }
        let error = match opened {
            Ok(found) => return Ok(found),
            Err(error) => error,
        };
        let fill = error.undeclared.and_then(|name| propose(name, parts, all));
        let Some(fill) = fill else { return Err(crate::declared::refused(&error)) };
        fills.push(fill);
    }
    Err(usage(format!("{}: more is missing than can be proposed", parts.recording.display())))
}

fn open(parts: &Parts, all: &All) -> Result<(Box<dyn Recording>, Arranged), FormatError> {
    let settings = all.settings();
    let recording = joined::open(parts.format, &parts.recording, &settings.declared)?;
    let arranged = arrange(&parts.recording, recording.as_ref(), &settings, |_: &dyn EventCursor| Ok::<(), FormatError>(()))?;
    Ok((recording, arranged))
}

/// A value for a parameter that no file states, put into `all`; `None` where nothing sensible can be proposed.
fn propose(name: &str, parts: &Parts, all: &mut All) -> Option<Fill> {
    let pictures = || joined::open(parts.format, &parts.recording, &all.settings().declared).ok().and_then(|recording| recording.pictures());
    match name {
        "time_unit" if all.time_unit.is_none() => {
            let unit = likeliest_unit(parts, all)?;
            all.time_unit = Some(unit);
            let word = format!("{unit:?}").to_lowercase();
            Some(Fill {
                name: "time_unit",
                value: format!("\"{word}\""),
                why: "the unit of the stamps is not recorded; this one gives a plausible rate of events".into(),
            })
        }
        "stamps" if all.trigger_line.is_none() => {
            super::pairing::line(parts, all)
        }
        "coordinate_scale" if all.coordinate_scale.is_none() => {
            all.coordinate_scale = Some(32);
            Some(Fill {
                name: "coordinate_scale",
                value: "32".into(),
                why: "coordinates exceed the pictures; the authors of HS-ERGB store 32 times the pixel".into(),
            })
        }
        "exposure" if all.exposure.is_none() => {
            let pictures = pictures()?;
            let stamps: Vec<i64> = pictures.about().stamps.iter().map(|stamp| stamp.at).collect();
            let mut periods: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).filter(|period| *period > 0).collect();
            periods.sort_unstable();
            // Round to a tenth of a millisecond: more digits would look like knowledge.
            let half = periods.get(periods.len() / 2).map_or(5_000_000, |period| (period / 2 / 100_000).max(1) * 100_000);
            let exposure = Duration::new(half);
            all.exposure = Some(exposure);
            let why = "the exposure is not recorded; half the time between frames is no more than a guess. Too long blurs what is sharp, too short leaves blur";
            Some(Fill { name: "exposure", value: format!("\"{exposure}\""), why: why.into() })
        }
        "stamp" if all.stamp.is_none() && all.trigger_line.is_some() => Some(super::pairing::stamp(all)),
        "stamp" if all.stamp.is_none() => {
            all.stamp = Some(StampRole::Middle);
            let why = "what a frame's stamp means is not recorded: start, middle or end of its exposure. A wrong one shifts frames against events";
            Some(Fill { name: "stamp", value: "\"middle\"".into(), why: why.into() })
        }
        "row_time" if all.row_time.is_none() && parts.line_delay_s.is_some() => {
            let delay = Duration::new((parts.line_delay_s? * 1e9).round() as i64);
            all.row_time = Some(delay);
            Some(Fill { name: "row_time", value: format!("\"{delay}\""), why: "the calibration's line delay, taken as seconds".into() })
        }
        "row_time" if all.row_time.is_none() => {
            all.row_time = Some(Duration::new(0));
            let why = "the delay from row to row is not recorded; 0 is a global shutter. A rolling shutter left at 0 leaves its skew in the picture";
            Some(Fill { name: "row_time", value: "\"0 us\"".into(), why: why.into() })
        }
        "transfer" if all.transfer.is_none() => {
            let linear = pictures().is_some_and(|pictures| pictures.about().bits != 8);
            all.transfer = Some(if linear { Transfer::Linear } else { Transfer::Srgb });
            let word = if linear { "linear" } else { "srgb" };
            let why = "whether values are linear is not recorded; 8-bit pictures mostly are not, raw ones are. A wrong curve makes events and frames disagree";
            Some(Fill { name: "transfer", value: format!("\"{word}\""), why: why.into() })
        }
        _ => None,
    }
}

/// The unit with which events come at a rate that sensors have: the nearest to 10 a second and pixel on a logarithmic scale.
fn likeliest_unit(parts: &Parts, all: &All) -> Option<TimeUnit> {
    let rate = |unit: TimeUnit| -> Option<f64> {
        let settings = All { time_unit: Some(unit), ..all.clone() }.settings();
        let recording = joined::open(parts.format, &parts.recording, &settings.declared).ok()?;
        let found = photocurrent_formats::gather::scan(&mut *recording.events().ok()?, |_| Ok::<(), FormatError>(())).ok()?;
        let (first, last) = found.span?;
        let (x, y) = found.corner?;
        let pixels = (f64::from(x) + 1.0) * (f64::from(y) + 1.0);
        (last > first).then(|| found.count as f64 / ((last - first) as f64 / 1e9) / pixels)
    };
    const USUAL_HZ: f64 = 10.0;
    let distance = |unit: TimeUnit| rate(unit).map_or(f64::INFINITY, |rate| (rate / USUAL_HZ).log10_distance());
    [TimeUnit::Us, TimeUnit::Ns, TimeUnit::S, TimeUnit::Ms].into_iter().min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
}

/// How far a ratio is from 1, in decades, without a logarithm: enough to rank four units that lie three decades apart.
trait Decades {
    fn log10_distance(self) -> f64;
}

impl Decades for f64 {
    fn log10_distance(self) -> f64 {
        let (mut ratio, mut decades) = (if self < 1.0 { 1.0 / self } else { self }, 0.0);
        while ratio >= 10.0 && decades < 400.0 {
            ratio /= 10.0;
            decades += 1.0;
        }
        decades + (ratio - 1.0) / 9.0
    }
}

/// Streams that share no time are refused, with both spans and the likely offset.
fn overlap(path: &Path, events: TimeSpan, frames: &FramesMeta) -> Result<(), Failure> {
    let Some(span) = frames.times.span(frames.extent.height) else { return Ok(()) };
    if span.start < events.end && events.start < span.end {
        return Ok(());
    }
    let offset = Duration::new(events.start - span.start);
    Err(Failure::Other {
        message: format!(
            "{}: events from {} to {} and frames from {} to {} share no time\n  hint: their clocks begin apart; state the offset: --frame-offset \"{offset}\"",
            path.display(),
            events.start,
            events.end,
            span.start,
            span.end
        ),
        code: 3,
    })
}

/// Values that are rendered, about, so that a first run takes a minute or two; pixels times frames.
const RENDERED: f64 = 1.2e8;

/// Events that are solved, about, for the same reason.
const SOLVED: f64 = 2e6;

/// A window with a few frames in which events and frames overlap, and a rate: the first run should be short.
fn what_to_render(frames: &FramesMeta, events: TimeSpan, count: u64) -> (Option<(Duration, Duration)>, f64) {
    let span = frames.times.span(frames.extent.height).unwrap_or(events);
    let (start, end) = (span.start.max(events.start).0, span.end.min(events.end).0);
    let period_ns = frames.times.mean_period_ns().unwrap_or(4e7).max(1e5);
    // Sixteen pictures for each frame; a whole number of hertz.
    let rate_hz = (16e9 / period_ns).round().clamp(10.0, 10_000.0);
    let per_ns = count as f64 / (events.length_ns().max(1)) as f64;
    let by_pictures = RENDERED / frames.extent.pixels() as f64 / rate_hz * 1e9;
    let by_events = if per_ns > 0.0 { SOLVED / per_ns } else { f64::INFINITY };
    let length = by_pictures.min(by_events).max(3.5 * period_ns);
    if (end - start) as f64 <= 1.2 * length {
        return (None, rate_hz);
    }
    // Whole milliseconds, from the first frame that is whole inside.
    let first = frames.times.exposures.iter().map(|exposure| exposure.start.0).find(|t| *t >= start).unwrap_or(start);
    let from = first.div_euclid(1_000_000) * 1_000_000;
    let to = (from as f64 + length / 1e6 * 1e6) as i64 / 1_000_000 * 1_000_000 + 1_000_000;
    (Some((Duration::new(from.max(0)), Duration::new(to))), rate_hz)
}

/// What the streams themselves say; of a long recording, its first part.
fn measured(recording: &dyn Recording, arranged: &Arranged, parts: &Parts, all: &mut All, fills: &mut [Fill]) -> Result<Proposals, Failure> {
    let failed = |error: photocurrent_core::NodeError| Failure::Other { message: error.to_string(), code: 3 };
    let gathered = arranged.gather(recording, EVENTS_BUDGET, |_: &dyn EventCursor| Ok::<(), FormatError>(()));
    let (Some((events, _)), Some(frames)) = (gathered.map_err(|error| crate::declared::refused(&error))?, arranged.frame_sequence()) else {
        return Ok(Proposals::default());
    };
    let mut found = proposals(&events, &frames).map_err(failed)?;
    // An exposure that is recorded or stated is no question.
    let Some(fill) = fills.iter_mut().find(|fill| fill.name == "exposure") else {
        found.exposure_ns = None;
        return Ok(found);
    };
    if let Some(exposure) = found.exposure_ns.filter(|exposure| exposure.value >= 1e4) {
        let rounded = Duration::new((exposure.value / 1e4).round() as i64 * 10_000);
        all.exposure = Some(rounded);
        fill.value = format!("\"{rounded}\"");
        let (low, high) = (exposure.ci95.0 / 1e6, exposure.ci95.1 / 1e6);
        fill.why =
            format!("the exposure is not recorded; this length explains the blur of the frames of {} best (95 %: {low:.2} to {high:.2} ms)", parts.format.name);
    } else {
        found.exposure_ns = None;
        if let Some(why) = &found.exposure_unclear {
            fill.why = format!("{}; it was not measured: {why}", fill.why);
        }
    }
    Ok(found)
}

/// An offset below this is no matter: a latency of the front end is of that size.
const SMALL_OFFSET_NS: f64 = 5e5;

/// Fields of the description that no file states.
fn describe(found: &Proposals) -> Vec<Fill> {
    let matters = "Too small a value gives pale motion, too large a value ghosts";
    let threshold = |name: &'static str, estimate: Option<Estimate>| match estimate.filter(|estimate| (0.02..2.0).contains(&estimate.value)) {
        Some(Estimate { value, ci95: (low, high) }) => Fill {
            name,
            value: format!("{value:.3}"),
            why: format!("never recorded; this one explains the change of the frames by their events (95 %: {low:.3} to {high:.3}). {matters}"),
        },
        None => Fill {
            name,
            value: "0.25".into(),
            why: format!("never recorded, and too little moves to measure it; usual settings lie between 0.15 and 0.5. {matters}"),
        },
    };
    let mut fills = vec![
        threshold("threshold_on", found.thresholds.map(|both| both.0)),
        threshold("threshold_off", found.thresholds.map(|both| both.1)),
        Fill {
            name: "refractory",
            value: "\"100 us\"".into(),
            why: "the blind time after an event is a bias of the camera; the shortest interval between events of one pixel bounds it".into(),
        },
    ];
    if let Some(Estimate { value, ci95: (low, high) }) = found.offset_ns.filter(|offset| offset.value.abs() > SMALL_OFFSET_NS && !offset.holds(0.0)) {
        fills.push(Fill {
            name: "clock_offset",
            value: format!("{{ offset = \"{:.2} ms\" }}", value / 1e6),
            why: format!(
                "events lag the frames by so much (95 %: {:.2} to {:.2} ms): clocks, or the latency of the pixels; 0 if you know better",
                low / 1e6,
                high / 1e6
            ),
        });
    }
    fills
}
