//! One pass over a recording: everything about it that a person, or [`crate::hazard`], wants to know.
//!
//! Events are read once, in pieces, frames by index; memory does not grow with the recording. What is known
//! about hazards is not decided here: this counts, and [`crate::hazard::findings`] judges.
//!
//! - [`stamps`]: the step that stamps really have, equal ones, time that goes back.
//! - [`rate`]: events over time.
//! - [`places`]: pixels, rows, columns.
//! - [`phase`]: events in step with the frames; [`readout`]: row by row.
//! - [`pictures`]: frames, their times and values.
//! - [`lines`]: trigger edges.
//! - [`grid`]: whether events and frames lie on one pixel grid.
//! - [`alternatives`]: units, offsets, mirrored pictures and pairings held against each other.
//! - [`lag`]: what frames and events say of the same change: how late events are, and whether their clocks
//!   drift apart.
//!
//! Limits: values of up to 64 frames are looked at ([`Most`]), spread over the recording; counters of single
//! pixels up to sixteen million of them.

pub mod alternatives;
pub mod grid;
pub(crate) mod interval;
pub mod lag;
pub mod lines;
pub mod phase;
pub mod pictures;
pub mod places;
pub mod rate;
pub mod readout;
pub mod stamps;

pub use interval::Interval;

use crate::chunk::EventChunk;
use crate::error::{Cause, FormatError, Loss};
use crate::recording::Convention;
use crate::recording::Recording;
use lag::{LagSurvey, Panel, Stated, StatedFrontEnd};
use lines::LineSurvey;
use phase::{Phase, PhaseSurvey};
use photocurrent_core::Sensor;
use photocurrent_core::document::Source;
use pictures::FramesSurvey;
use places::{Places, PlacesSurvey};
use rate::{Rate, RateSurvey};
use serde::Serialize;
use stamps::{Stamps, StampsSurvey};

/// How much is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Most {
    /// Frames whose values are read. More cost time, and rarely say more.
    pub frames: usize,
    /// Events that are read; more are left out, and that is said.
    pub events: u64,
}

impl Default for Most {
    fn default() -> Self {
        Most { frames: 64, events: u64::MAX }
    }
}

/// In-pixel times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct InPixelSurvey {
    /// Events that leave the array before they fire.
    pub early: u64,
    /// Least, mean and largest time from firing to leaving, ns.
    pub latency_ns: (i64, f64, i64),
}

/// Events.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EventsSurvey {
    /// How many were read.
    pub count: u64,
    /// How many the file says there are.
    pub stated_count: Option<u64>,
    /// Were events left out because there are too many?
    pub is_cut: bool,
    /// ON ones.
    pub on: u64,
    /// Earliest and latest stamp, ns.
    pub span_ns: Option<(i64, i64)>,
    /// Size of the array, where it is stated.
    pub extent: Option<(u32, u32)>,
    /// How stamps are stored.
    pub stored_as: String,
    /// What the reader did.
    pub notes: Vec<String>,
    /// Unusual ways of storing that the reader recognised.
    pub conventions: Vec<Convention>,
    /// Events over time.
    pub rate: RateSurvey,
    /// Stamps.
    pub stamps: StampsSurvey,
    /// Places.
    pub places: PlacesSurvey,
    /// In-pixel times, where they are recorded.
    pub in_pixel: Option<InPixelSurvey>,
}

impl EventsSurvey {
    /// Pixels of the array: those stated, otherwise those up to the furthest that was met.
    pub fn pixels(&self) -> u64 {
        let (width, height) = self.extent.unwrap_or((self.places.largest.0 + 1, self.places.largest.1 + 1));
        u64::from(width) * u64::from(height)
    }

    /// From the first to the last, s.
    pub fn seconds(&self) -> f64 {
        self.span_ns.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }

    /// Share of ON events.
    pub fn on_share(&self) -> f64 {
        self.on as f64 / self.count.max(1) as f64
    }

    /// Mean rate of a pixel, Hz; none without a duration.
    pub fn rate_of_pixel_hz(&self) -> Option<f64> {
        (self.seconds() > 0.0).then(|| self.count as f64 / self.seconds() / self.pixels() as f64)
    }
}

/// What is known of a recording after one pass.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Survey {
    /// The format's id.
    pub format: String,
    /// The events; none without an event stream.
    pub events: Option<EventsSurvey>,
    /// The frames; none without any.
    pub frames: Option<FramesSurvey>,
    /// Trigger lines.
    pub triggers: Vec<LineSurvey>,
    /// Events by the time since the frame before.
    pub phase: Option<PhaseSurvey>,
    /// Events against frames.
    pub lag: Option<LagSurvey>,
    /// Does a sensor description travel with it?
    pub has_sensor: bool,
    /// What else the file says.
    pub facts: Vec<(String, String)>,
    /// What is damaged and was left out.
    pub losses: Vec<LossSurvey>,
}

/// A [`Loss`], as it is reported.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LossSurvey {
    /// Where.
    pub at: String,
    /// What.
    pub what: String,
    /// Why.
    pub cause: Cause,
    /// Places that it stands for.
    pub places: u64,
}

impl From<Loss> for LossSurvey {
    fn from(loss: Loss) -> LossSurvey {
        LossSurvey { places: loss.places(), at: loss.at, what: loss.what, cause: loss.cause }
    }
}

/// Reads a recording once. `progress` is called now and then with the part of the events that is read, 0 to
/// 1.
///
/// # Errors
/// When the file cannot be read any more. What is damaged is no error: it stands in [`Survey::losses`].
pub fn survey(
    recording: &dyn Recording,
    format: &str,
    most: &Most,
    mut progress: impl FnMut(f64),
) -> Result<Survey, FormatError> {
    let mut found = Survey {
        format: format.to_owned(),
        has_sensor: recording.sensor_text().is_some(),
        facts: recording.facts(),
        ..Survey::default()
    };
    let mut losses = recording.losses();
    let (mut phase, mut panel) = (None, None);
    let extent = recording.events_about().and_then(|about| about.extent);
    if let Some(pictures) = recording.pictures() {
        let about = pictures.about();
        let mut frames = pictures::times(about);
        let chosen = pictures::chosen(about.stamps.len(), most.frames);
        let has_events = recording.events_about().is_some();
        let mut building =
            has_events.then(|| Panel::new(about, extent, &chosen, &stated(recording))).flatten();
        frames.values = pictures::read(&*pictures, &chosen, |frame, values| {
            if let Some(panel) = &mut building {
                panel.picture(frame, values);
            }
        });
        phase = has_events
            .then(|| {
                Phase::new(
                    about.stamps.iter().map(pictures::begins).collect(),
                    extent.unwrap_or(about.extent),
                )
            })
            .flatten();
        panel = building;
        found.frames = Some(frames);
    }
    if let Some(about) = recording.events_about() {
        let mut cursor = recording.events()?;
        let mut counted = Counted::new(about.tick_ns, about.has_t_in);
        let mut chunk = EventChunk::default();
        while counted.count < most.events && cursor.next(&mut chunk)? {
            counted.add(&chunk, phase.as_mut(), panel.as_mut());
            let (at, of) = cursor.position();
            progress(at as f64 / of.max(1) as f64);
        }
        losses.extend(cursor.losses());
        let mut events = counted.survey(about.extent);
        events.is_cut = events.count >= most.events;
        events.stated_count = about.count;
        events.stored_as = about.stamps.clone();
        events.notes = about.notes.clone();
        events.conventions = recording.conventions();
        found.events = Some(events);
    }
    found.triggers = lines::survey(&recording.triggers()?);
    found.phase = phase.and_then(Phase::survey);
    found.lag = panel.and_then(|panel| panel.survey());
    found.losses = losses.into_iter().map(LossSurvey::from).collect();
    Ok(found)
}

/// What the description that travels with a recording states about time; nothing of one with a mistake, which
/// its reader reports.
fn stated(recording: &dyn Recording) -> Stated {
    let parsed =
        recording.sensor_text().and_then(|text| Sensor::parse(&Source::new("sensor", "", text)).ok());
    let Some(sensor) = parsed else { return Stated::default() };
    let seconds = |of: photocurrent_core::quantity::Duration| of.ns() as f64 * 1e-9;
    // Without a photocurrent that frames show there is no light to take the time constant at.
    let front_end = sensor.front_end.alpha.zip(sensor.frames.gain).map(|(alpha, gain)| StatedFrontEnd {
        tau_0_s: sensor.front_end.tau_0.map_or(0.0, seconds),
        alpha_s: seconds(alpha),
        gain,
        black_level_dn: sensor.frames.black_level_dn.unwrap_or(0.0),
    });
    Stated { row_time_ns: sensor.frames.row_time.map(|row| row.ns()), front_end }
}

/// Events as they are counted.
struct Counted {
    count: u64,
    on: u64,
    span: Option<(i64, i64)>,
    rate: Rate,
    stamps: Stamps,
    places: Places,
    in_pixel: Option<(u64, i64, f64, i64)>,
}

impl Counted {
    fn new(tick_ns: i64, has_t_in: bool) -> Counted {
        let in_pixel = has_t_in.then_some((0, i64::MAX, 0.0, i64::MIN));
        Counted {
            count: 0,
            on: 0,
            span: None,
            rate: Rate::new(),
            stamps: Stamps::new(tick_ns),
            places: Places::new(),
            in_pixel,
        }
    }

    fn add(&mut self, chunk: &EventChunk, mut phase: Option<&mut Phase>, mut panel: Option<&mut Panel>) {
        for (((&t, &x), &y), &on) in chunk.t.iter().zip(&chunk.x).zip(&chunk.y).zip(&chunk.on) {
            self.on += u64::from(on & 1);
            let (first, last) = self.span.get_or_insert((t, t));
            (*first, *last) = ((*first).min(t), (*last).max(t));
            self.rate.add(t);
            self.stamps.add(t);
            self.places.add(t, x, y, on);
            if let Some(phase) = &mut phase {
                phase.add(t, y, on);
            }
            if let Some(panel) = &mut panel {
                panel.event(t, x, y, on);
            }
        }
        if let (Some(t_in), Some((early, least, sum, most))) = (&chunk.t_in, &mut self.in_pixel) {
            for (&t, &t_in) in chunk.t.iter().zip(t_in) {
                let latency = t.saturating_sub(t_in);
                *early += u64::from(latency < 0);
                (*least, *sum, *most) = ((*least).min(latency), *sum + latency as f64, (*most).max(latency));
            }
        }
        self.count += chunk.len() as u64;
    }

    fn survey(self, extent: Option<photocurrent_core::Extent>) -> EventsSurvey {
        let in_pixel = self.in_pixel.filter(|_| self.count > 0);
        EventsSurvey {
            count: self.count,
            on: self.on,
            span_ns: self.span,
            extent: extent.map(|extent| (extent.width, extent.height)),
            rate: self.rate.survey(),
            stamps: self.stamps.survey(),
            places: if self.count > 0 { self.places.survey(extent) } else { PlacesSurvey::default() },
            in_pixel: in_pixel.map(|(early, least, sum, most)| InPixelSurvey {
                early,
                latency_ns: (least, sum / self.count as f64, most),
            }),
            ..EventsSurvey::default()
        }
    }
}
