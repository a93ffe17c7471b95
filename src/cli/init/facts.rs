//! What is found in the files, and what has to be proposed because they do not state it.

use super::fill::Fill;
use super::hazards::{Acts, Evidence, act};
use super::units::DENSE;
use super::window::Window;
use super::{pairing, readings, units, window};
use crate::declared::DeclaredOptions;
use crate::failure::{Failure, usage};
use crate::parts::Parts;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{FramesMeta, TimeSpan};
use photocurrent_formats::arrange::{self, Arranged, EVENTS_BUDGET, arrange};
use photocurrent_formats::hazard::{self, Limits};
use photocurrent_formats::placed::PartOf;
use photocurrent_formats::places;
use photocurrent_formats::survey::{Most, survey};
use photocurrent_formats::{EventCursor, Format, FormatError, Recording, StampRole, Transfer, joined};
use photocurrent_nodes::estimate::held_out::HeldOut;
use photocurrent_nodes::estimate::{Estimate, SensorEstimates, proposals};
use photocurrent_nodes::read::foreign::{All, Size};
use photocurrent_nodes::read::formats::takes;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Thresholds by frames that are held out are proposed where the interval of those by the change of frames is
/// so many times as wide, on a logarithmic scale: at 2 a disk that turns, whose first frame has no stamp,
/// loses 1.6 dB.
const FAR_WIDER: f64 = 3.0;

/// The format whose reader takes no window.
pub const OWN: &str = "recording";

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
    pub window: Option<Window>,
    /// Frames per second that are rendered.
    pub rate_hz: f64,
    /// Were events warped from an array of their own onto the frames?
    pub is_warped: bool,
    /// Does a blend of neighbouring frames predict frames that are held out better than any solution?
    pub is_blend_better: bool,
    /// Is there a description in the file?
    pub sensor_text: Option<String>,
    /// What calibration and bias files say, a line each.
    pub camera: Vec<String>,
    /// Findings that no parameter holds, a line each.
    pub marks: Vec<String>,
    pub notes: Vec<String>,
    pub losses: Vec<String>,
}

impl Facts {
    /// How many lines are marked.
    pub fn open(&self) -> usize {
        let fills = self
            .reader
            .iter()
            .chain(self.sensor_text.is_none().then_some(&self.sensor).into_iter().flatten());
        fills.filter(|fill| fill.is_open).count() + self.marks.len()
    }

    /// Length of a frame's exposure, s.
    pub fn exposure_s(&self) -> f64 {
        self.frames.times.nominal_exposure_ns().unwrap_or(1) as f64 / 1e9
    }
}

/// Reads the files, and proposes what they do not state.
pub fn collect(files: &[PathBuf], declared: &DeclaredOptions, accepted: &[String]) -> Result<Facts, Failure> {
    let (mut draft, inputs) = Draft::new(Parts::sort(files)?, declared);
    let stated = draft.stated()?;
    draft.reader = units::propose(&draft.parts, &mut draft.all);
    let mut opened = draft.settle()?;
    let (events_span, part) = common_part(&opened, &draft.parts.recording)?;
    if let Some(window) = &part {
        (draft.all.start, draft.all.end) = (Some(window.start), Some(window.end));
        opened = draft.open().map_err(refused)?;
    }
    let mut acts = draft.act_on_findings(&mut opened, accepted)?;
    let (found, offset_why) = draft.measure(&mut acts)?;
    // A better exposure moves the frames' times.
    if found.exposure_ns.is_some() {
        opened = draft.open().map_err(refused)?;
    }
    let (recording, arranged) = opened;
    let frames = frames_of(&arranged)?;
    let events = arranged.events.as_ref().map_err(usage)?;
    let (short, rate_hz) =
        window::to_render(&frames, events.span.unwrap_or(events_span), events.count_hint.unwrap_or(0));
    let window = match (part, short) {
        (Some(part), Some(short)) => Some(Window { why: format!("{}; {}", part.why, short.why), ..short }),
        (part, short) => short.or(part),
    };
    // Only such sequences have places with fractions, and only a global shutter has one time for all rows.
    let is_warped = draft.parts.format.id == "hs_ergb"
        && frames.times.row_time_ns == 0
        && places::of_sequence(draft.all.path.path()).is_ok_and(|array| array.is_some());
    Ok(Facts {
        is_warped,
        is_blend_better: found.held_out.as_ref().is_some_and(|held| held.blend.1),
        format: draft.parts.format,
        all: draft.all,
        inputs,
        stated,
        reader: draft.reader,
        sensor: describe(&found, &offset_why),
        frames,
        bits: recording.pictures().map_or(8, |pictures| pictures.about().bits),
        window,
        rate_hz,
        sensor_text: recording.sensor_text().map(String::from),
        camera: draft.parts.camera,
        marks: acts.marks,
        losses: arranged.losses.iter().map(|loss| format!("{}: {}", loss.at, loss.what)).collect(),
        notes: arranged.notes,
    })
}

/// A recording as it was opened, and what its reader makes of it.
type Opened = (Box<dyn Recording>, Arranged);

/// The frames, or a refusal.
fn frames_of(arranged: &Arranged) -> Result<Arc<FramesMeta>, Failure> {
    arranged.frames.clone().map_err(|why| {
        let hint = "hint: name the frames too: a folder of pictures next to the event file; events alone do \
                    not state the light's level";
        usage(format!("{why}: frames are needed for a picture of known brightness\n  {hint}"))
    })
}

/// The time from the first to the last event, and the part that has frames where that is shorter: what lies
/// outside is in nobody's picture.
fn common_part((recording, arranged): &Opened, path: &Path) -> Result<(TimeSpan, Option<Window>), Failure> {
    let events = arranged.events.as_ref();
    let events = events.map_err(|why| usage(format!("{why}: there is nothing to reconstruct from")))?;
    let frames = frames_of(arranged)?;
    let span = events.span.ok_or_else(|| usage(format!("{}: there is no event in it", path.display())))?;
    // A few strays are no overlap.
    let dense = arranged.scan.as_ref().and_then(|scan| scan.dense_span(DENSE));
    let dense = dense.map_or(span, |(first, last)| {
        TimeSpan::new(first.saturating_sub(arranged.zero_ns), last.saturating_sub(arranged.zero_ns))
    });
    overlap(path, dense, &frames)?;
    let part = window::with_frames(recording.as_ref(), arranged, &frames, span).map_err(refused)?;
    Ok((span, part))
}

/// A reader's parameters while they are put together.
struct Draft {
    parts: Parts,
    /// All parameters as they stand.
    all: All,
    /// Those of them that were proposed.
    reader: Vec<Fill>,
}

impl Draft {
    /// What was stated, and the paths that a manifest names.
    fn new(parts: Parts, declared: &DeclaredOptions) -> (Draft, Vec<PathBuf>) {
        let mut all = declared.parameters(&parts.recording);
        all.frames = parts.frames.as_ref().map(InputPath::new).or(all.frames);
        all.stamps = parts.stamps.as_ref().map(InputPath::new).or(all.stamps);
        let inputs = [Some(&parts.recording), parts.frames.as_ref(), parts.stamps.as_ref()];
        let inputs = inputs.into_iter().flatten().cloned().collect();
        (Draft { parts, all, reader: Vec::new() }, inputs)
    }

    /// What was stated on the command line, as lines of a manifest; paths stand elsewhere.
    fn stated(&self) -> Result<Vec<(String, String)>, Failure> {
        let value = toml::Table::try_from(&self.all).map_err(|error| Failure::other(error.to_string()))?;
        let is_path = |name: &str| ["path", "frames", "stamps"].contains(&name);
        let lines = value.into_iter().filter(|(name, _)| !is_path(name));
        let stated: Vec<_> = lines.map(|(name, value)| (name, value.to_string())).collect();
        let format = self.parts.format;
        if let Some((name, _)) = stated.iter().find(|(name, _)| !takes(format.id, name)) {
            return Err(usage(format!(
                "--{} is nothing that can be stated of {}: it is recorded, or has no meaning there\n  hint: \
                 photocurrent nodes read/{} lists what can be stated of it",
                name.replace('_', "-"),
                format.name,
                format.id
            )));
        }
        Ok(stated)
    }

    /// Acts on what a survey of the part that is read finds. Another size of the array changes what
    /// everything else is compared on: the findings are those of that size.
    fn act_on_findings(&mut self, opened: &mut Opened, accepted: &[String]) -> Result<Acts, Failure> {
        let mut acts = Acts::default();
        for _ in 0..2 {
            let before = self.all.extent;
            acts = self.surveyed(opened, accepted)?;
            if acts.parameters.is_empty() {
                break;
            }
            self.reader.append(&mut acts.parameters);
            *opened = self.settle()?;
            if self.all.extent == before {
                break;
            }
        }
        Ok(acts)
    }

    fn surveyed(&mut self, (recording, arranged): &Opened, accepted: &[String]) -> Result<Acts, Failure> {
        let part = PartOf::new(recording.as_ref(), arranged);
        let survey = survey(&part, self.parts.format.id, &Most::default(), |_| ()).map_err(refused)?;
        let findings = hazard::findings(&survey, &Limits::default());
        let mut numbers = arranged.frames_read().to_vec();
        numbers.sort_unstable();
        let pictures = part.pictures();
        let frames = pictures.as_deref().map(|pictures| (pictures, numbers.as_slice()));
        let reading = if (self.all.mirror, self.all.shift) == (None, None) {
            readings::best(&part, &survey, &findings).map_err(refused)?
        } else {
            None
        };
        let evidence =
            Evidence { survey: &survey, format: self.parts.format, frames, reading: reading.as_ref() };
        act(&evidence, &findings, accepted, &mut self.all)
    }

    /// Thresholds, exposure and offset by the streams themselves, of everything that was recorded, whichever
    /// part is rendered; and what an offset explains. A lag without a proposed offset is marked.
    fn measure(&mut self, acts: &mut Acts) -> Result<(SensorEstimates, String), Failure> {
        let (start, end) = (self.all.start.take(), self.all.end.take());
        let (recording, arranged) = self.open().map_err(refused)?;
        let mut found = self.proposals(recording.as_ref(), &arranged)?;
        let mut offset_why = String::new();
        let by_finding = acts.late.as_ref().map(|(late, _)| Estimate { value: late.value, ci95: late.ci95 });
        found.offset_ns = found.offset_ns.filter(is_an_offset).or(by_finding.filter(is_an_offset));
        let by_frames = found.held_out.as_ref().and_then(|held| Some((held.late_ns?, held.error)));
        if let Some((late, error)) = by_frames {
            found.offset_ns = is_an_offset(&late).then_some(late);
            let within = 100.0 * error;
            offset_why =
                format!("with this one frames that are held out are predicted best, within {within:.1} %");
        } else if found.offset_ns.is_some() {
            let part = PartOf::new(recording.as_ref(), &arranged);
            let (helps, why) = readings::offset_helps(&part).map_err(refused)?;
            (found.offset_ns, offset_why) = (found.offset_ns.filter(|_| helps), why);
        }
        if let (None, Some((_, mark))) = (&found.offset_ns, &acts.late) {
            acts.marks.push(format!("{mark}; no offset was proposed: {offset_why}"));
        }
        if let Some(HeldOut { error, blend: (of_blend, true), .. }) = &found.held_out {
            acts.marks.push(format!(
                "a blend of the frames before and after predicts frames that are held out within {:.1} %, a \
                 solution with the best thresholds within {:.1} %: events gain nothing with this \
                 description, and refine/motion falls back to blends; check the exposure, what a stamp \
                 means, and the offset of the clocks",
                100.0 * of_blend,
                100.0 * error
            ));
        }
        (self.all.start, self.all.end) = (start, end);
        Ok((found, offset_why))
    }

    /// What the streams themselves say; of a long recording, its first part.
    fn proposals(
        &mut self,
        recording: &dyn Recording,
        arranged: &Arranged,
    ) -> Result<SensorEstimates, Failure> {
        let gathered =
            arranged.gather(recording, EVENTS_BUDGET, |_: &dyn EventCursor| Ok::<(), FormatError>(()));
        let (Some((events, _)), Some(frames)) = (gathered.map_err(refused)?, arranged.frame_sequence())
        else {
            return Ok(SensorEstimates::default());
        };
        let is_open = self.reader.iter().any(|fill| fill.name == "exposure");
        let anchor = is_open.then_some(match self.all.stamp {
            Some(StampRole::Start) => 0.0,
            Some(StampRole::End) => 1.0,
            Some(StampRole::Middle) | None => 0.5,
        });
        let mut found = proposals(&events, &frames, anchor)
            .map_err(|error| Failure::Other { message: error.to_string(), code: 3 })?;
        // An exposure that is recorded or stated is no question.
        let Some(fill) = self.reader.iter_mut().find(|fill| fill.name == "exposure") else {
            found.exposure_ns = None;
            return Ok(found);
        };
        let by_frames = found.held_out.as_ref().and_then(|held| held.exposure_ns);
        found.exposure_ns = by_frames.or(found.exposure_ns).filter(|exposure| exposure.value >= 1e4);
        if let Some(exposure) = &found.exposure_ns {
            let rounded = Duration::new((exposure.value / 1e4).round() as i64 * 10_000);
            self.all.exposure = Some(rounded);
            fill.value = format!("\"{rounded}\"");
            let (low, high) = (exposure.ci95.0 / 1e6, exposure.ci95.1 / 1e6);
            let of = self.parts.format.name;
            let why = match by_frames {
                Some(_) => format!("with this length frames of {of} that are held out are predicted best"),
                None => format!("this length explains the blur of the frames of {of} best"),
            };
            fill.why = format!("the exposure is not recorded; {why} (95 %: {low:.2} to {high:.2} ms)");
        } else if let Some(why) = &found.exposure_unclear {
            fill.why = format!("{}; it was not measured: {why}", fill.why);
        }
        Ok(found)
    }

    /// Opens and arranges; what is missing is proposed until nothing is.
    fn settle(&mut self) -> Result<Opened, Failure> {
        let mut is_paired = false;
        for _ in 0..16 {
            let opened = self.open();
            let Draft { parts, all, reader } = self;
            if !is_paired && pairing::is_open(all, opened.as_ref().err()) {
                is_paired = true;
                let mut proposed = pairing::proposed(parts, all)?;
                if proposed.is_empty() && opened.is_err() {
                    proposed.extend(pairing::by_trial(parts, all)?);
                }
                if !proposed.is_empty() {
                    reader.extend(proposed);
                    continue;
                }
            }
            let error = match opened {
                Ok(found) => return Ok(found),
                Err(error) => error,
            };
            let fill = error.undeclared.and_then(|name| propose(name, parts, all));
            let Some(fill) = fill else { return Err(refused(error)) };
            reader.push(fill);
        }
        Err(usage(format!("{}: more is missing than can be proposed", self.parts.recording.display())))
    }

    fn open(&self) -> Result<Opened, FormatError> {
        let mut settings = self.all.settings();
        if self.parts.format.id == OWN {
            // The reader of our own recordings keeps their clock.
            settings.zero = Some(Duration::new(0));
        }
        let path = &self.parts.recording;
        let recording = joined::open(self.parts.format, path, &settings.declared)?;
        let arranged =
            arrange(path, recording.as_ref(), &settings, |_: &dyn EventCursor| Ok::<(), FormatError>(()))?;
        Ok((recording, arranged))
    }
}

/// A refusal of a reader.
fn refused(error: FormatError) -> Failure {
    crate::declared::refused(&error)
}

/// A value for a parameter that no file states, put into `all`; `None` where nothing sensible can be
/// proposed.
fn propose(name: &str, parts: &Parts, all: &mut All) -> Option<Fill> {
    let pictures = || {
        joined::open(parts.format, &parts.recording, &all.settings().declared)
            .ok()
            .and_then(|recording| recording.pictures())
    };
    match name {
        "extent" if all.extent.is_none() => {
            let (size, reach) = extent_of_frames(parts, all)?;
            all.extent = Some(size);
            let why = format!(
                "the size of the event array is not recorded; {reach}: the frames' size, or a \
                               whole part of it, was taken"
            );
            Some(Fill::open("extent", format!("{{ width = {}, height = {} }}", size.width, size.height), why))
        }
        "stamps" if all.trigger_line.is_none() => pairing::line(parts, all),
        "coordinate_scale" if all.coordinate_scale.is_none() => {
            all.coordinate_scale = Some(32);
            Some(Fill::open(
                "coordinate_scale",
                "32",
                "coordinates exceed the pictures; the authors of HS-ERGB store 32 times the pixel",
            ))
        }
        "exposure" if all.exposure.is_none() => {
            let pictures = pictures()?;
            let stamps: Vec<i64> = pictures.about().stamps.iter().map(|stamp| stamp.at).collect();
            let mut periods: Vec<i64> =
                stamps.windows(2).map(|pair| pair[1] - pair[0]).filter(|period| *period > 0).collect();
            periods.sort_unstable();
            // Round to a tenth of a millisecond: more digits would look like knowledge.
            let half = periods
                .get(periods.len() / 2)
                .map_or(5_000_000, |period| (period / 2 / 100_000).max(1) * 100_000);
            let exposure = Duration::new(half);
            all.exposure = Some(exposure);
            let why = "the exposure is not recorded; half the time between frames is no more than a guess. \
                       Too long blurs what is sharp, too short leaves blur";
            Some(Fill::open("exposure", format!("\"{exposure}\""), why))
        }
        "stamp" if all.stamp.is_none() && all.trigger_line.is_some() => Some(pairing::stamp(all)),
        "stamp" if all.stamp.is_none() => {
            all.stamp = Some(StampRole::Middle);
            let why = "what a frame's stamp means is not recorded: start, middle or end of its exposure. A \
                       wrong one shifts frames against events";
            Some(Fill::open("stamp", "\"middle\"", why))
        }
        "row_time" if all.row_time.is_none() && parts.line_delay_s.is_some() => {
            let delay = Duration::new((parts.line_delay_s? * 1e9).round() as i64);
            all.row_time = Some(delay);
            Some(Fill::open(
                "row_time",
                format!("\"{delay}\""),
                "the calibration's line delay, taken as seconds",
            ))
        }
        "row_time" if all.row_time.is_none() => {
            all.row_time = Some(Duration::new(0));
            let why = "the delay from row to row is not recorded; 0 is a global shutter. A rolling shutter \
                       left at 0 leaves its skew in the picture";
            Some(Fill::open("row_time", "\"0 us\"", why))
        }
        "transfer" if all.transfer.is_none() => {
            let linear = pictures().is_some_and(|pictures| pictures.about().bits != 8);
            all.transfer = Some(if linear { Transfer::Linear } else { Transfer::Srgb });
            let word = if linear { "linear" } else { "srgb" };
            let why = "whether values are linear is not recorded; 8-bit pictures mostly are not, raw ones \
                       are. A wrong curve makes events and frames disagree";
            Some(Fill::open("transfer", format!("\"{word}\""), why))
        }
        _ => None,
    }
}

/// The size of the event array that the frames suggest, and what events reach.
fn extent_of_frames(parts: &Parts, all: &All) -> Option<(Size, String)> {
    let recording = joined::open(parts.format, &parts.recording, &all.settings().declared).ok()?;
    let frames = recording.pictures()?.about().extent;
    let found =
        photocurrent_formats::gather::scan(&mut *recording.events().ok()?, |_| Ok::<(), FormatError>(()))
            .ok()?;
    let (corner, size) = (found.corner?, arrange::likely_extent(frames, &found)?);
    let outside = found.outside(size.width, size.height);
    let few = if outside > 0 {
        format!(", {outside} of {} events outside of them", found.count)
    } else {
        String::new()
    };
    let reach =
        format!("events reach column {} and row {}, frames have {frames} pixels{few}", corner.0, corner.1);
    Some((Size { width: size.width, height: size.height }, reach))
}

/// Streams that share no time are refused, with both spans and the likely offset.
fn overlap(path: &Path, events: TimeSpan, frames: &FramesMeta) -> Result<(), Failure> {
    let Some(span) = frames.times.span(frames.extent.height) else { return Ok(()) };
    if span.start < events.end && events.start < span.end {
        return Ok(());
    }
    let offset = Duration::new(events.start - span.start);
    // Clocks that begin apart last equally long; other units do not.
    let ratio = span.length_ns().max(1) as f64 / events.length_ns().max(1) as f64;
    let hint = if (0.01..100.0).contains(&ratio) {
        format!(
            "their clocks begin apart; state the offset: --frame-offset \"{offset}\"; or the units of \
                 both: --time-unit, --stamps-unit"
        )
    } else {
        format!(
            "frames last {ratio:.3e} times as long as events: one of the two is in another unit; state it: \
             --time-unit for the events, --stamps-unit for the frames"
        )
    };
    Err(Failure::Other {
        message: format!(
            "{}: events from {} to {} and frames from {} to {} share no time\n  hint: {hint}",
            path.display(),
            events.start,
            events.end,
            span.start,
            span.end
        ),
        code: 3,
    })
}

/// An offset below this is no matter: a latency of the front end is of that size.
const SMALL_OFFSET_NS: f64 = 5e5;

/// Is a shift between events and frames worth a line?
fn is_an_offset(offset: &Estimate) -> bool {
    offset.value.abs() > SMALL_OFFSET_NS && !offset.holds(0.0)
}

/// Fields of the description that no file states.
fn describe(found: &SensorEstimates, offset_why: &str) -> Vec<Fill> {
    let matters = "Too small a value gives pale motion, too large a value ghosts";
    let usual = |estimate: &Estimate| (0.02..2.0).contains(&estimate.value);
    let both = found.thresholds.filter(|(on, off)| usual(on) && usual(off));
    let width = |(on, off): &(Estimate, Estimate)| {
        let of = |one: &Estimate| one.ci95.1 / f64::max(one.ci95.0, f64::MIN_POSITIVE);
        libm::log(f64::max(of(on), of(off)))
    };
    // What the change of the frames gives stands unless it is open by far: frames that are held out are
    // blurred, and do not show how sharp a solution is.
    let is_better = |held: &HeldOut| {
        both.as_ref().is_none_or(|both| width(both) > FAR_WIDER * width(&(held.threshold, held.threshold)))
    };
    let held = found.held_out.as_ref().filter(|held| is_better(held));
    let threshold = |name: &'static str, of: fn(&(Estimate, Estimate)) -> Estimate| {
        let stated = |Estimate { value, ci95: (low, high) }: Estimate, what: String| {
            let why = format!("never recorded; {what} (95 %: {low:.3} to {high:.3}). {matters}");
            Fill::open(name, format!("{value:.3}"), why)
        };
        match (held, both) {
            (Some(held), _) => {
                let than = held.given.map_or(String::new(), |error| {
                    format!("; with what the change of the frames gives, {:.1} %", 100.0 * error)
                });
                let error = 100.0 * held.error;
                let what = format!(
                    "with this one frames that are held out are predicted best, within {error:.1} %{than}"
                );
                stated(held.threshold, what)
            }
            (None, Some(both)) => {
                stated(of(&both), "this one explains the change of the frames by their events".to_owned())
            }
            (None, None) => Fill::open(
                name,
                "0.25",
                format!(
                    "never recorded, and too little moves to measure it; usual settings lie between 0.15 and \
                     0.5. {matters}"
                ),
            ),
        }
    };
    let mut fills = vec![
        threshold("threshold_on", |both| both.0),
        threshold("threshold_off", |both| both.1),
        Fill::open(
            "refractory",
            "\"100 us\"",
            "the blind time after an event is a bias of the camera; the shortest interval between events of \
             one pixel bounds it",
        ),
    ];
    if let Some(Estimate { value, ci95: (low, high) }) = found.offset_ns {
        let why = format!(
            "events lag the frames by so much (95 %: {:.2} to {:.2} ms): clocks, or the latency of the \
             pixels; {offset_why}. 0 if you know better",
            low / 1e6,
            high / 1e6
        );
        fills.push(Fill::open("clock_offset", format!("{{ offset = \"{:.2} ms\" }}", value / 1e6), why));
    }
    fills
}
