//! What a user states of how both streams lie on each other: a mirrored picture, a shift by whole pixels,
//! exchanged polarity, frames to leave out.
//!
//! Events are moved to where the frames see the same ([`Declared::mirror`] first, then [`Declared::shift`]);
//! events that are moved off the array are left out. Frames are left out by their number in the file
//! ([`Declared::skip_frames`]).

use crate::arrange::Arranged;
use crate::chunk::{EventChunk, Trigger};
use crate::declared::{Declared, Mirror, Shift};
use crate::error::FormatError;
use crate::recording::{EventCursor, EventsAbout, FramesAbout, Pictures, Recording};
use photocurrent_core::Extent;
use std::path::Path;
use std::sync::Arc;

/// Applies what is declared; a recording of which nothing of this is declared stays as it is.
///
/// # Errors
/// When a mirrored picture has no known size, or a frame that is left out is not there.
pub fn placed(
    path: &Path,
    recording: Box<dyn Recording>,
    declared: &Declared,
) -> Result<Box<dyn Recording>, FormatError> {
    let mut about = recording.events_about().cloned();
    let mut places = None;
    let inverts = declared.invert_polarity == Some(true);
    if declared.mirror.is_some() || declared.shift.is_some() || inverts {
        let extent = declared.extent.or(about.as_ref().and_then(|about| about.extent));
        if declared.mirror.is_some() && about.is_some() && extent.is_none() {
            let hint = "state the size of the event array too: `extent = { width = 640, height = 480 }`";
            return Err(FormatError::new(
                path,
                "a mirrored picture needs the size of the event array, which is not recorded",
                hint,
            )
            .undeclared("extent"));
        }
        if let Some(about) = &mut about {
            if let Some(mirror) = declared.mirror {
                about.notes.push(format!("events were mirrored, {}", mirror.name()));
            }
            if let Some(Shift { right, down }) = declared.shift {
                about
                    .notes
                    .push(format!("events were moved {right} pixels to the left and {down} up, as stated"));
            }
        }
        if let Some(about) = about.as_mut().filter(|_| inverts) {
            about.notes.push("ON and OFF were exchanged, as stated".into());
        }
        places = Some(Places {
            inverts,
            mirror: declared.mirror,
            shift: declared.shift.unwrap_or(Shift { right: 0, down: 0 }),
            extent,
        });
    }
    let mut pictures = recording.pictures();
    if let (Some(skipped), Some(inner)) = (&declared.skip_frames, &pictures) {
        pictures = Some(Arc::new(Fewer::new(path, inner.clone(), skipped)?));
    } else if places.is_none() {
        return Ok(recording);
    }
    Ok(Box::new(Placed { recording, about, places, pictures }))
}

impl Mirror {
    /// For people: "left to right".
    pub fn name(self) -> &'static str {
        match self {
            Mirror::LeftRight => "left to right",
            Mirror::TopBottom => "top to bottom",
            Mirror::Both => "both ways",
        }
    }
}

#[derive(Clone, Copy)]
struct Places {
    inverts: bool,
    mirror: Option<Mirror>,
    shift: Shift,
    extent: Option<Extent>,
}

impl Places {
    /// Where an event goes; `None` when that is off the array.
    #[inline]
    fn of(&self, x: u16, y: u16) -> Option<(u16, u16)> {
        let (mut x, mut y) = (i64::from(x), i64::from(y));
        if let (Some(mirror), Some(extent)) = (self.mirror, self.extent) {
            if mirror != Mirror::TopBottom {
                x = i64::from(extent.width) - 1 - x;
            }
            if mirror != Mirror::LeftRight {
                y = i64::from(extent.height) - 1 - y;
            }
        }
        let (x, y) = (x - i64::from(self.shift.right), y - i64::from(self.shift.down));
        let inside = self.extent.is_none_or(|extent| x < extent.width.into() && y < extent.height.into());
        Some((u16::try_from(x).ok()?, u16::try_from(y).ok()?)).filter(|_| inside)
    }
}

/// A recording whose events are moved, or of whose frames some are left out.
struct Placed {
    recording: Box<dyn Recording>,
    about: Option<EventsAbout>,
    places: Option<Places>,
    pictures: Option<Arc<dyn Pictures>>,
}

impl Recording for Placed {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let inner = self.recording.events()?;
        Ok(match self.places {
            Some(places) => Box::new(PlacedCursor { inner, places, piece: EventChunk::default() }),
            None => inner,
        })
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.pictures.clone()
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        self.recording.triggers()
    }

    crate::recording::forward!(recording);
}

struct PlacedCursor {
    inner: Box<dyn EventCursor>,
    places: Places,
    piece: EventChunk,
}

impl EventCursor for PlacedCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        let more = self.inner.next(&mut self.piece)?;
        let piece = &self.piece;
        let mut t_in = piece.t_in.as_ref().map(|column| Vec::with_capacity(column.len()));
        for i in 0..piece.len() {
            let Some((x, y)) = self.places.of(piece.x[i], piece.y[i]) else { continue };
            chunk.push(piece.t[i], x, y, (piece.on[i] != 0) != self.places.inverts);
            if let (Some(kept), Some(column)) = (&mut t_in, &piece.t_in) {
                kept.push(column[i]);
            }
        }
        chunk.t_in = t_in;
        Ok(more)
    }

    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError> {
        self.inner.seek(t_ns)
    }

    crate::recording::forward_cursor!(inner);
}

/// Pictures without some.
struct Fewer {
    inner: Arc<dyn Pictures>,
    about: FramesAbout,
    kept: Vec<usize>,
}

impl Fewer {
    fn new(path: &Path, inner: Arc<dyn Pictures>, skipped: &[u32]) -> Result<Fewer, FormatError> {
        let mut about = inner.about().clone();
        let count = about.stamps.len();
        if let Some(absent) = skipped.iter().find(|frame| **frame as usize >= count) {
            let hint = "number them from 0 in the order of the file: `skip_frames`";
            return Err(FormatError::new(
                path,
                format!("frame {absent} is to be left out, and there are {count}"),
                hint,
            )
            .undeclared("skip_frames"));
        }
        let kept: Vec<usize> = (0..count).filter(|frame| !skipped.contains(&(*frame as u32))).collect();
        about.notes.push(format!("{} of {count} frames were left out, as stated", count - kept.len()));
        Ok(Fewer::of(inner, about, kept))
    }

    fn of(inner: Arc<dyn Pictures>, mut about: FramesAbout, kept: Vec<usize>) -> Fewer {
        about.stamps = kept.iter().map(|frame| about.stamps[*frame]).collect();
        Fewer { inner, about, kept }
    }
}

impl Pictures for Fewer {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        match self.kept.get(frame) {
            Some(inner) => self.inner.read(*inner, values),
            None => Err(FormatError::new(
                Path::new(""),
                format!("there is no frame {frame}"),
                "read one of those that are there",
            )),
        }
    }
}

/// The part of a recording that an arrangement reads: its window of time, its part of the array, exposures as
/// they are arranged; times stay on the events' clock.
pub struct PartOf<'a> {
    recording: &'a dyn Recording,
    arranged: &'a Arranged,
    about: Option<EventsAbout>,
    pictures: Option<Arc<dyn Pictures>>,
}

impl<'a> PartOf<'a> {
    /// Of an arranged recording.
    pub fn new(recording: &'a dyn Recording, arranged: &'a Arranged) -> PartOf<'a> {
        let mut about = recording.events_about().cloned();
        if let Some(about) = &mut about {
            // The number that the file states is that of the whole.
            about.count = None;
        }
        let pictures = recording.pictures().map(|inner| {
            let mut kept: Vec<(usize, usize)> = arranged.frames_read().iter().copied().zip(0..).collect();
            kept.sort_unstable();
            let about = inner.about().clone();
            let mut fewer = Fewer::of(inner, about, kept.iter().map(|(frame, _)| *frame).collect());
            // As they are arranged: with what was stated of exposures, stamps and clocks.
            if let Ok(frames) = &arranged.frames {
                let of = |place: usize| {
                    frames.times.exposures.get(place).map(|exposure| {
                        exposure.start.0.saturating_add(arranged.zero_ns)
                            ..exposure.end.0.saturating_add(arranged.zero_ns)
                    })
                };
                for (stamp, (_, place)) in fewer.about.stamps.iter_mut().zip(&kept) {
                    stamp.exposure = of(*place).map(|exposure| (exposure.start, exposure.end));
                }
            }
            Arc::new(fewer) as Arc<dyn Pictures>
        });
        PartOf { recording, arranged, about, pictures }
    }
}

impl Recording for PartOf<'_> {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.arranged.cursor_as_stored(self.recording)
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.pictures.clone()
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        self.recording.triggers()
    }

    crate::recording::forward!(recording);
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 8, height: 6 };

    #[test]
    fn a_place_is_mirrored_first_and_moved_then_and_nothing_leaves_the_array() {
        let of = |mirror, right, down| Places {
            inverts: false,
            mirror,
            shift: Shift { right, down },
            extent: Some(EXTENT),
        };
        assert_eq!(of(Some(Mirror::LeftRight), 0, 0).of(1, 2), Some((6, 2)));
        assert_eq!(of(Some(Mirror::TopBottom), 0, 0).of(1, 2), Some((1, 3)));
        assert_eq!(of(Some(Mirror::Both), 2, -1).of(1, 2), Some((4, 4)));
        assert_eq!(
            (of(None, 1, 0).of(0, 0), of(None, -1, 0).of(7, 0), of(None, -1, 0).of(6, 5)),
            (None, None, Some((7, 5)))
        );
        // Mirrored twice is as it was.
        let mirrored = of(Some(Mirror::Both), 0, 0);
        assert_eq!(mirrored.of(3, 5).and_then(|(x, y)| mirrored.of(x, y)), Some((3, 5)));
    }
}
