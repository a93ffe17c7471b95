//! Stamps in another unit than their format has: files lie about their units.
//!
//! Formats that leave the unit open read the stated one themselves. The others define it; where a user states
//! another ([`Declared::time_unit`] for events and triggers, [`Declared::stamps_unit`] for frames in the same
//! file), stamps are multiplied by the ratio of both.
//!
//! Limits: stamps that the format's own unit cannot hold (microseconds since 1970 read as seconds) are
//! refused before.

use crate::chunk::{EventChunk, Trigger};
use crate::declared::{Declared, TimeUnit};
use crate::error::FormatError;
use crate::evidence::unit_name;
use crate::known::Described;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use std::sync::Arc;

/// The unit that a format defines for events; `None` where the reader takes the stated one.
fn of_events(format: &str) -> Option<TimeUnit> {
    match format {
        "aedat4" | "aedat3" | "aedat2" | "event_stream" | "evt2" | "evt21" | "evt3" | "dat"
        | "prophesee_hdf5" | "m3ed" => Some(TimeUnit::Us),
        "mvsec" => Some(TimeUnit::S),
        "rosbag" | "rosbag2" | "mcap" => Some(TimeUnit::Ns),
        _ => None,
    }
}

/// The same for frames in the file.
fn of_frames(format: &str, declared: &Declared) -> Option<TimeUnit> {
    match format {
        "aedat4" | "aedat3" | "m3ed" | "v2e_hdf5" => Some(TimeUnit::Us),
        "mvsec" => Some(TimeUnit::S),
        "rosbag" | "rosbag2" | "mcap" => Some(TimeUnit::Ns),
        "event_utils_hdf5" | "memmap" => Some(declared.time_unit.unwrap_or(TimeUnit::S)),
        _ => None,
    }
}

/// A ratio of two units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ratio {
    times: i64,
    divides: i64,
}

impl Ratio {
    /// `None` for equal units.
    fn of(stated: TimeUnit, read: TimeUnit) -> Option<Ratio> {
        (stated != read).then(|| Ratio { times: stated.ns(), divides: read.ns() })
    }

    #[inline]
    fn apply(self, t: i64) -> i64 {
        let scaled = i128::from(t) * i128::from(self.times) / i128::from(self.divides);
        scaled.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
    }

    fn undo(self, t: i64) -> i64 {
        Ratio { times: self.divides, divides: self.times }.apply(t)
    }
}

/// Applies stated units; a recording of which none is stated stays as it is.
pub(crate) fn restamped(
    format: &str,
    recording: Box<dyn Recording>,
    declared: &Declared,
) -> Box<dyn Recording> {
    let events = declared.time_unit.zip(of_events(format)).and_then(|(stated, read)| Ratio::of(stated, read));
    let is_inside = declared.frames.is_none();
    let frames = declared
        .stamps_unit
        .filter(|_| is_inside)
        .zip(of_frames(format, declared))
        .and_then(|(stated, read)| Ratio::of(stated, read));
    if events.is_none() && frames.is_none() {
        return recording;
    }
    let about = recording.events_about().cloned().map(|mut about| {
        if let (Some(ratio), Some(unit)) = (events, declared.time_unit) {
            about.tick_ns = ratio.apply(about.tick_ns).max(1);
            about.notes.push(format!("stamps of events were read in {}, as stated", unit_name(unit)));
        }
        about
    });
    let pictures = recording.pictures().map(|inner| match (frames, declared.stamps_unit) {
        (Some(ratio), Some(unit)) => {
            let mut about = inner.about().clone();
            for stamp in &mut about.stamps {
                stamp.at = ratio.apply(stamp.at);
                stamp.exposure = stamp.exposure.map(|(start, end)| (ratio.apply(start), ratio.apply(end)));
            }
            about.notes.push(format!("stamps of frames were read in {}, as stated", unit_name(unit)));
            Arc::new(Described { inner, about })
        }
        _ => inner,
    });
    Box::new(InOtherUnits { recording, events, about, pictures })
}

struct InOtherUnits {
    recording: Box<dyn Recording>,
    events: Option<Ratio>,
    about: Option<EventsAbout>,
    pictures: Option<Arc<dyn Pictures>>,
}

impl Recording for InOtherUnits {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let inner = self.recording.events()?;
        Ok(match self.events {
            Some(ratio) => Box::new(RestampedCursor { inner, ratio }),
            None => inner,
        })
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.pictures.clone()
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        let mut triggers = self.recording.triggers()?;
        if let Some(ratio) = self.events {
            triggers.iter_mut().for_each(|trigger| trigger.t = ratio.apply(trigger.t));
        }
        Ok(triggers)
    }

    crate::recording::forward!(recording);
}

struct RestampedCursor {
    inner: Box<dyn EventCursor>,
    ratio: Ratio,
}

impl EventCursor for RestampedCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        let more = self.inner.next(chunk)?;
        chunk.t.iter_mut().for_each(|t| *t = self.ratio.apply(*t));
        Ok(more)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        self.inner.seek(self.ratio.undo(t_ns))
    }

    crate::recording::forward_cursor!(inner);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_exact_and_stays_within_64_bits() {
        let ms_as_us = Ratio::of(TimeUnit::Ms, TimeUnit::Us).unwrap();
        assert_eq!((ms_as_us.apply(1_424_000), ms_as_us.undo(1_424_000_000)), (1_424_000_000, 1_424_000));
        assert_eq!(
            Ratio::of(TimeUnit::Ns, TimeUnit::S).unwrap().apply(1_500_000_000_000_000_000),
            1_500_000_000
        );
        assert_eq!(ms_as_us.apply(i64::MAX), i64::MAX);
        assert_eq!(Ratio::of(TimeUnit::Us, TimeUnit::Us), None);
    }
}
