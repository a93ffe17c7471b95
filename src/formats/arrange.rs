//! A file's streams as the rest of the program takes them: one clock that begins at zero, a window,
//! exposures, linear digital numbers.
//!
//! Nothing is guessed here. The zero of time is the earliest stamp (an event's, or the start of an exposure)
//! unless it is given; a frame whose exposure is not recorded needs a stated length and a stated meaning of
//! its stamp; values that are not known to be linear need a stated transfer; rows whose delay is not recorded
//! need a row time. What is missing is reported with the name of the parameter that states it.
//!
//! Limits: the extent of events that no file states is the smallest that holds every coordinate, with a note;
//! state `extent` to be sure.

use crate::declared::{Declared, StampRole, Transfer};
use crate::error::{FormatError, Loss};
use crate::gather::{Gathered, Scan, Wanted, gather, scan};
use crate::recording::{EventCursor, EventsAbout, FramesAbout, Pictures, Recording};
use crate::trim::{Crop, InOrder, Trim, Trimmed};
use photocurrent_core::frames::FrameSource;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    DataError, EventStream, EventsMeta, Exposure, Extent, FrameBlock, FrameScale, FrameSequence, FrameTimes,
    FramesMeta, Rows, TimeSpan,
};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What is wanted of a file, in addition to what the user declares of it.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// What the file cannot say.
    pub declared: Declared,
    /// The file's time that becomes 0; the earliest stamp unless given.
    pub zero: Option<Duration>,
    /// Only what is stamped at or after this, from zero.
    pub start: Option<Duration>,
    /// Only events before this, and frames whose exposure ends by it, from zero.
    pub end: Option<Duration>,
    /// Added to every stamp of a frame: for clocks that begin apart.
    pub frame_offset: Option<Duration>,
    /// Delay from one row to the next, where it is not recorded; goes before what is recorded.
    pub row_time: Option<Duration>,
    /// Only these event pixels, numbered from 0, and the frame pixels that lie on them.
    pub crop: Option<Crop>,
}

/// A recording on one clock. Pictures and events are read later.
pub struct Arranged {
    /// The file's time that became 0, ns.
    pub zero_ns: i64,
    /// The events, or why there are none.
    pub events: Result<Arc<EventsMeta>, String>,
    /// The frames, or why there are none.
    pub frames: Result<Arc<FramesMeta>, String>,
    /// What was done, for the user.
    pub notes: Vec<String>,
    /// How many of something, for the user: (31, "events are stamped earlier than the event ahead; sorted by
    /// time").
    pub counts: Vec<(u64, String)>,
    /// What was damaged.
    pub losses: Vec<Loss>,
    order: Vec<usize>,
    pictures: Option<Arc<dyn Pictures>>,
    transfer: Transfer,
    crop: Option<Crop>,
    /// Size of the whole array of event pixels.
    array: Option<Extent>,
    /// First column and row of the frames' part.
    corner: (u32, u32),
    start_ns: i64,
    end_ns: i64,
    ordered: bool,
    drop_duplicates: bool,
    /// What the pass over all events found; `None` without an event stream.
    pub scan: Option<Scan>,
}

/// Memory for events before a temporary file is used: about 10 million.
pub const EVENTS_BUDGET: usize = 128 << 20;

/// Brings a recording onto one clock. Reads all events once (for their span), no pictures. `advance` as in
/// [`scan`].
///
/// # Errors
/// When the file cannot be read, or something must be stated that is not.
pub fn arrange<E: From<FormatError> + From<DataError>>(
    path: &Path,
    recording: &dyn Recording,
    settings: &Settings,
    advance: impl FnMut(&dyn EventCursor) -> Result<(), E>,
) -> Result<Arranged, E> {
    let (mut notes, mut counts, mut losses) = (Vec::new(), Vec::new(), recording.losses());
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let events = match recording.events_about() {
        None => None,
        Some(about) => {
            let found = scan(&mut *recording.events()?, advance)?;
            notes.extend(about.notes.iter().cloned());
            counts.push((
                found.disordered,
                format!("events in {name} are stamped earlier than the event before; sorted by time"),
            ));
            // What was found damaged while opening is met again by the cursor.
            losses.extend(found.losses.iter().filter(|loss| !recording.losses().contains(loss)).cloned());
            Some((about, found))
        }
    };
    let pictures = recording.pictures();
    let offset_ns = settings.frame_offset.map_or(0, Duration::ns);
    let frames = match &pictures {
        None => None,
        Some(pictures) => {
            let about = pictures.about();
            notes.extend(about.notes.iter().cloned());
            Some(exposures(path, about, &settings.declared, offset_ns)?)
        }
    };
    let earliest = events
        .iter()
        .filter_map(|(_, found)| found.span)
        .map(|span| span.0)
        .chain(frames.iter().flatten().map(|exposure| exposure.0))
        .min();
    let zero_ns = settings.zero.map_or(earliest.unwrap_or(0), Duration::ns);
    if zero_ns != 0 {
        notes.push(format!("t = 0 is {} on the clock of {name}", in_microseconds(zero_ns)));
    }
    let (start_ns, end_ns) =
        (settings.start.map_or(i64::MIN, Duration::ns), settings.end.map_or(i64::MAX, Duration::ns));
    let mut arranged = Arranged {
        zero_ns,
        events: Err(format!("{name} has no event stream")),
        frames: Err(format!("{name} has no frame stream")),
        notes,
        counts,
        losses,
        order: Vec::new(),
        pictures: None,
        transfer: Transfer::Linear,
        crop: settings.crop,
        array: None,
        corner: (0, 0),
        start_ns,
        end_ns,
        ordered: events.as_ref().is_some_and(|(_, found)| found.disordered == 0),
        drop_duplicates: settings.declared.drop_duplicates.unwrap_or(false),
        scan: None,
    };
    if let Some((about, found)) = events {
        let frames = pictures.as_ref().map(|pictures| pictures.about().extent);
        arranged.events =
            Ok(Arc::new(arranged.events_meta(path, about, &found, frames, &settings.declared)?));
        arranged.scan = Some(found);
    }
    if arranged.drop_duplicates {
        arranged.notes.push(
            "events that are there twice, of one time, pixel and sign, are read once, as stated".into(),
        );
    }
    if let (Some(pictures), Some(exposures)) = (pictures, frames) {
        arranged.take_frames(path, &name, pictures, &exposures, settings)?;
    }
    Ok(arranged)
}

/// A time in microseconds, exact: "1234.567 us".
fn in_microseconds(ns: i64) -> String {
    let (whole, rest) = (ns / 1000, (ns % 1000).abs());
    if rest == 0 {
        format!("{whole} us")
    } else {
        format!("{}{}.{rest:03} us", if ns < 0 && whole == 0 { "-" } else { "" }, whole)
    }
}

/// The size of event array that frames suggest where the largest coordinates do not fit them: the frames'
/// own, or that of which they are a multiple, the smallest that holds every event and of which events use
/// more than half each way. `None` where frames are a whole multiple of what events reach, or hold them not
/// at all.
fn extent_of_frames(frames: Extent, (x, y): (u16, u16)) -> Option<Extent> {
    let (width, height) = (u32::from(x) + 1, u32::from(y) + 1);
    if frames.multiple_of(Extent { width, height }).is_some()
        || frames.width < width
        || frames.height < height
    {
        return None;
    }
    let part = |times: u32| Extent { width: frames.width / times, height: frames.height / times };
    let fits = |times: &u32| {
        let size = part(*times);
        frames.width.is_multiple_of(*times)
            && frames.height.is_multiple_of(*times)
            && size.width >= width
            && size.height >= height
    };
    const MOST_TIMES: u32 = 8;
    let is_used = |times: &u32| 2 * width > part(*times).width && 2 * height > part(*times).height;
    Some(part((1..=MOST_TIMES).rev().filter(fits).find(is_used).unwrap_or(1)))
}

/// Share of the events that decide how far an array reaches: single events far outside are a decoder's or a
/// sensor's fault.
const REACH: f64 = 0.999;

/// The size of event array that frames suggest where what events reach does not fit them; `None` where it
/// does, or most events lie outside of the frames.
pub fn likely_extent(frames: Extent, found: &Scan) -> Option<Extent> {
    let corner = found.corner?;
    if u32::from(corner.0) < frames.width && u32::from(corner.1) < frames.height {
        return extent_of_frames(frames, corner);
    }
    let reach = found.reach(REACH)?;
    let whole = Extent { width: u32::from(reach.0) + 1, height: u32::from(reach.1) + 1 };
    extent_of_frames(frames, reach).or_else(|| frames.multiple_of(whole).map(|_| whole))
}

/// A stamp less another, or an error when they are further apart than the clock counts.
fn since(path: &Path, stamp: i64, zero: i64) -> Result<i64, FormatError> {
    stamp.checked_sub(zero).filter(|t| t.abs() < i64::MAX / 4).ok_or_else(|| {
        FormatError::new(
            path,
            format!(
                "the stamps {} and {} cannot belong to one recording",
                in_microseconds(zero),
                in_microseconds(stamp)
            ),
            "check the unit of the stamps and the clocks of both streams",
        )
    })
}

/// Start and end of every frame's exposure on the file's clock, `offset_ns` later.
fn exposures(
    path: &Path,
    about: &FramesAbout,
    declared: &Declared,
    offset_ns: i64,
) -> Result<Vec<(i64, i64)>, FormatError> {
    let role = declared.stamp.or(about.stamp_role);
    let mut all = Vec::with_capacity(about.stamps.len());
    for (frame, stamp) in about.stamps.iter().enumerate() {
        let exposure = match (declared.exposure.map(Duration::ns), stamp.exposure, role) {
            (None, Some(recorded), _) => recorded,
            (Some(length), _, Some(StampRole::Start)) => (stamp.at, stamp.at.saturating_add(length)),
            (Some(length), _, Some(StampRole::Middle)) => {
                (stamp.at.saturating_sub(length / 2), stamp.at.saturating_add(length - length / 2))
            }
            (Some(length), _, Some(StampRole::End)) => (stamp.at.saturating_sub(length), stamp.at),
            (None, None, _) => {
                let hint = "state it: `exposure = \"5 ms\"`, and `stamp = \"start\"`, \"middle\" or \"end\" \
                            for what a frame's stamp means; photocurrent init proposes values";
                return Err(FormatError::new(path, "the exposure of the frames is not recorded", hint)
                    .at(format!("frame {frame}"))
                    .undeclared("exposure"));
            }
            (Some(_), _, None) => {
                let hint = "state it: `stamp = \"start\"`, \"middle\" or \"end\" of the exposure; a wrong \
                            one shifts every frame against the events";
                return Err(FormatError::new(path, "what a frame's stamp means is not recorded", hint)
                    .at(format!("frame {frame}"))
                    .undeclared("stamp"));
            }
        };
        if exposure.1 <= exposure.0 {
            let found = format!(
                "an exposure from {} to {}",
                in_microseconds(exposure.0),
                in_microseconds(exposure.1)
            );
            let hint = "without the begin and the end of its exposure a frame cannot be compared with \
                        events: state `exposure` and `stamp`";
            return Err(FormatError::new(path, found, hint)
                .at(format!("frame {frame}"))
                .undeclared("exposure"));
        }
        all.push((exposure.0.saturating_add(offset_ns), exposure.1.saturating_add(offset_ns)));
    }
    Ok(all)
}

impl Arranged {
    /// The size of the event array: stated, recorded, or what events reach.
    fn array_extent(
        &mut self,
        path: &Path,
        about: &EventsAbout,
        found: &Scan,
        frames: Option<Extent>,
        declared: &Declared,
    ) -> Result<Extent, FormatError> {
        match (declared.extent.or(about.extent), found.corner) {
            (Some(extent), _) => Ok(extent),
            // What events reach is no size of an array: where frames state another that holds them, it has to
            // be stated.
            (None, Some(corner))
                if let Some(likely) = frames.and_then(|frames| likely_extent(frames, found)) =>
            {
                let outside = found.outside(likely.width, likely.height);
                let few = if outside > 0 {
                    format!("{outside} of {} events lie outside of it", found.count)
                } else {
                    "it holds the events".into()
                };
                let reach = format!(
                    "events reach column {} and row {}, frames have {} pixels",
                    corner.0,
                    corner.1,
                    frames.unwrap_or(likely)
                );
                let hint = format!(
                    "state it: `extent = {{ width = {}, height = {} }}` fits the frames, and {few}",
                    likely.width, likely.height
                );
                Err(FormatError::new(
                    path,
                    format!("the size of the event array is not recorded, and {reach}"),
                    hint,
                )
                .undeclared("extent"))
            }
            (None, Some((x, y))) => {
                let extent = Extent { width: u32::from(x) + 1, height: u32::from(y) + 1 };
                self.notes.push(format!(
                    "the size of the sensor is not recorded: {extent} pixels hold every \
                                         event; state `extent` to be sure"
                ));
                Ok(extent)
            }
            (None, None) => {
                let hint = "state the sensor's size: `extent = { width = 640, height = 480 }`";
                Err(FormatError::new(
                    path,
                    "there is no event, and the size of the sensor is not recorded",
                    hint,
                )
                .undeclared("extent"))
            }
        }
    }

    fn events_meta(
        &mut self,
        path: &Path,
        about: &EventsAbout,
        found: &Scan,
        frames: Option<Extent>,
        declared: &Declared,
    ) -> Result<EventsMeta, FormatError> {
        let extent = self.array_extent(path, about, found, frames, declared)?;
        if let Some(crop) = self.crop
            && (crop.x.saturating_add(crop.width) > extent.width
                || crop.y.saturating_add(crop.height) > extent.height)
        {
            let found = format!(
                "a part of {} x {} pixels from ({}, {}) reaches beyond the {extent} pixels of the sensor",
                crop.width, crop.height, crop.x, crop.y
            );
            return Err(FormatError::new(
                path,
                found,
                "give a smaller part, or one further to the left or up",
            ));
        }
        self.array = Some(extent);
        let extent = self.crop.map_or(extent, |crop| Extent { width: crop.width, height: crop.height });
        let span = match found.span {
            None => None,
            Some((first, last)) => {
                let (first, last) = (since(path, first, self.zero_ns)?, since(path, last, self.zero_ns)?);
                let (start, end) = (first.max(self.start_ns), last.saturating_add(1).min(self.end_ns));
                (start < end).then(|| TimeSpan::new(start, end))
            }
        };
        let whole = self.start_ns == i64::MIN && self.end_ns == i64::MAX;
        // A part is about as dense as the whole.
        let share = match (found.span, span) {
            (Some((first, last)), Some(span)) if !whole => {
                span.length_ns() as f64 / (last - first + 1) as f64
            }
            _ => 1.0,
        };
        let count_hint = Some((found.count as f64 * share) as u64);
        Ok(EventsMeta {
            extent,
            span,
            has_t_in: about.has_t_in,
            has_step: false,
            t_resolution_ns: Some(about.tick_ns),
            count_hint,
        })
    }

    fn take_frames(
        &mut self,
        path: &Path,
        name: &str,
        pictures: Arc<dyn Pictures>,
        exposures: &[(i64, i64)],
        settings: &Settings,
    ) -> Result<(), FormatError> {
        let about = pictures.about();
        let mut frames = Vec::new();
        for (index, &(start, end)) in exposures.iter().enumerate() {
            let exposure = Exposure::new(since(path, start, self.zero_ns)?, since(path, end, self.zero_ns)?);
            if exposure.start.0 >= self.start_ns && exposure.end.0 <= self.end_ns {
                frames.push((exposure, index));
            }
        }
        let disordered = exposures.windows(2).filter(|pair| pair[1].0 < pair[0].0).count() as u64;
        self.counts.push((
            disordered,
            format!("frames in {name} begin earlier than the frame before; sorted by time"),
        ));
        frames.sort_by_key(|(exposure, _)| exposure.start);
        if frames.is_empty() {
            let window =
                if settings.start.is_some() || settings.end.is_some() { " in the window" } else { "" };
            self.frames = Err(format!("{name} has no frame{window}"));
            return Ok(());
        }
        let row_time_ns = settings.row_time.map(Duration::ns).or(about.row_time_ns).ok_or_else(|| {
            let hint = "state it: `row_time = \"0 us\"` for a global shutter, the delay from one row to the \
                        next for a rolling one";
            FormatError::new(path, "the row time of the frames is not recorded", hint).undeclared("row_time")
        })?;
        self.transfer = settings.declared.transfer.or(about.transfer).ok_or_else(|| {
            let hint = "state it: `transfer = \"linear\"` for raw values, \"srgb\" for ordinary pictures, \
                        `{ gamma = 2.2 }` for another curve";
            FormatError::new(path, "whether the values of the frames are linear is not recorded", hint)
                .undeclared("transfer")
        })?;
        let times = FrameTimes::new(frames.iter().map(|(exposure, _)| *exposure).collect(), row_time_ns)
            .map_err(|error| FormatError::new(path, error.message, "check the stamps of the frames"))?;
        let mut extent = about.extent;
        if let Some(crop) = self.crop {
            // Without events the part is one of frame pixels.
            let times = self.array.map_or(Some(1), |array| about.extent.multiple_of(array)).ok_or_else(|| {
                let found = format!(
                    "frames of {} pixels do not lie on the {} event pixels, so a part of one is no part of \
                     the other",
                    about.extent,
                    self.array.unwrap_or(about.extent)
                );
                FormatError::new(path, found, "take the whole array")
            })?;
            let [x, y, width, height] =
                [crop.x, crop.y, crop.width, crop.height].map(|size| size.saturating_mul(times));
            self.corner = (x, y);
            extent = Extent { width, height };
            if self.corner.0.saturating_add(extent.width) > about.extent.width
                || self.corner.1.saturating_add(extent.height) > about.extent.height
            {
                return Err(FormatError::new(
                    path,
                    format!("a part of {extent} pixels reaches beyond the frames' {}", about.extent),
                    "give a smaller part",
                ));
            }
        }
        self.frames =
            Ok(Arc::new(FramesMeta { extent, colour: about.colour, times, scale: FrameScale::Captured }));
        self.order = frames.into_iter().map(|(_, index)| index).collect();
        self.pictures = Some(pictures);
        Ok(())
    }

    /// Reads the events. `None` without an event stream.
    ///
    /// # Errors
    /// When the file cannot be read, or `advance` says so.
    pub fn gather<E: From<FormatError> + From<DataError>>(
        &self,
        recording: &dyn Recording,
        budget: usize,
        advance: impl FnMut(&dyn EventCursor) -> Result<(), E>,
    ) -> Result<Option<(EventStream, u64)>, E> {
        let Ok(meta) = &self.events else { return Ok(None) };
        let (extent, t_in) = (meta.extent, meta.has_t_in);
        let wanted = Wanted {
            extent,
            crop: self.crop,
            zero_ns: self.zero_ns,
            start_ns: self.start_ns,
            end_ns: self.end_ns,
            ordered: self.ordered,
            t_in,
            budget,
            drop_duplicates: self.drop_duplicates,
        };
        let all: Gathered = gather(&mut *recording.events()?, wanted, advance)?;
        let outside = all.outside;
        Ok(Some((EventStream::new(meta.clone(), extent.rows(), Arc::new(all)), outside)))
    }

    /// The events in the window as a stream in order of time, on the file's clock or from zero.
    ///
    /// # Errors
    /// When the file cannot be read, or its events are out of order and too many to sort in memory.
    pub fn cursor(
        &self,
        recording: &dyn Recording,
        from_zero: bool,
    ) -> Result<Box<dyn EventCursor>, FormatError> {
        let trimmed = Box::new(self.trimmed(recording, from_zero)?);
        if self.ordered { Ok(trimmed) } else { Ok(Box::new(InOrder::new(trimmed)?)) }
    }

    /// The events in the window in the order of the file, on the file's clock.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn cursor_as_stored(&self, recording: &dyn Recording) -> Result<Box<dyn EventCursor>, FormatError> {
        Ok(Box::new(self.trimmed(recording, false)?))
    }

    /// Are events that are there twice read once? By [`Arranged::gather`] only.
    pub fn drops_duplicates(&self) -> bool {
        self.drop_duplicates
    }

    /// The frames in the window by their numbers in the file, in order of time.
    pub fn frames_read(&self) -> &[usize] {
        &self.order
    }

    fn trimmed(&self, recording: &dyn Recording, from_zero: bool) -> Result<Trimmed, FormatError> {
        let bound =
            |ns: i64| if ns == i64::MIN || ns == i64::MAX { ns } else { ns.saturating_add(self.zero_ns) };
        let trim = Trim {
            crop: self.crop,
            start_ns: bound(self.start_ns),
            end_ns: bound(self.end_ns),
            ordered: self.ordered,
            zero_ns: if from_zero { self.zero_ns } else { 0 },
        };
        Trimmed::new(recording.events()?, trim)
    }

    /// Are the frames' linear values whole numbers of at most 16 bits?
    pub fn whole_numbers(&self) -> bool {
        self.transfer == Transfer::Linear
            && self.pictures.as_ref().is_some_and(|pictures| pictures.about().bits <= 16)
    }

    /// The frames, decoded when they are read. `None` without any.
    pub fn frame_sequence(&self) -> Option<FrameSequence> {
        let (meta, pictures) = (self.frames.as_ref().ok()?, self.pictures.as_ref()?);
        let source = LinearPictures {
            pictures: pictures.clone(),
            order: self.order.clone(),
            transfer: self.transfer,
            corner: self.corner,
            meta: meta.clone(),
        };
        Some(FrameSequence::new(meta.clone(), meta.extent.rows(), Arc::new(source)))
    }
}

/// Pictures in time order, as linear digital numbers.
struct LinearPictures {
    pictures: Arc<dyn Pictures>,
    order: Vec<usize>,
    transfer: Transfer,
    corner: (u32, u32),
    meta: Arc<FramesMeta>,
}

impl FrameSource for LinearPictures {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        let row_values = self.meta.row_values();
        let mut block = FrameBlock::zeros(frames.clone(), rows, row_values);
        let about = self.pictures.about();
        let stored_row = about.extent.width as usize * self.meta.channels() as usize;
        let skipped = self.corner.0 as usize * self.meta.channels() as usize;
        let mut values = Vec::new();
        for (at, frame) in frames.enumerate() {
            self.pictures.read(self.order[frame], &mut values)?;
            let found = values.len();
            if found != stored_row * about.extent.height as usize {
                return Err(DataError::new(format!(
                    "frame {frame} has {found} values, and {} pixels are needed",
                    about.extent
                )));
            }
            for (k, row) in rows.iter().enumerate() {
                let from = (row + self.corner.1) as usize * stored_row + skipped;
                let begin = (at * rows.len() + k) * row_values;
                block.dn[begin..begin + row_values].copy_from_slice(&values[from..from + row_values]);
            }
        }
        self.transfer.linearise(&mut block.dn, about.bits);
        Ok(block)
    }
}
