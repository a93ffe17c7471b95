//! What is known of the frame cameras behind a format, though none of its files states it: that they have a
//! global shutter, that their values are linear.
//!
//! Facts of hardware, each with its reason, in one table. They stand behind whatever a file or the user
//! states, and a note says that they were used.

use crate::chunk::Trigger;
use crate::declared::Transfer;
use crate::error::FormatError;
use crate::format::Format;
use crate::recording::{EventCursor, EventsAbout, FramesAbout, Pictures, Recording};
use std::sync::Arc;

/// What is known, and why.
struct Known {
    linear: bool,
    why: &'static str,
}

/// A DAVIS exposes all pixels together, and its converter gives values in proportion to the light.
const DAVIS: Known =
    Known { linear: true, why: "frames of a DAVIS: a global shutter (row time 0) and linear values" };

/// The pixel arrays of DAVIS cameras: DAVIS240, DAVIS346, DAVIS640, and the DAVIS208.
const DAVIS_ARRAYS: [(u32, u32); 4] = [(240, 180), (346, 260), (640, 480), (208, 192)];

fn known(format: &Format, recording: &dyn Recording) -> Option<Known> {
    let shutter = |why| Some(Known { linear: false, why });
    let has_davis_size = || {
        let pictures = recording.pictures();
        pictures.is_some_and(|pictures| {
            DAVIS_ARRAYS.contains(&(pictures.about().extent.width, pictures.about().extent.height))
        })
    };
    match format.id {
        // Simulators write these layouts too, mostly from pictures with a curve: what has another size is not
        // from the cameras of the published sequences.
        "mvsec" | "ecd" => has_davis_size().then_some(DAVIS),
        "aedat4" | "aedat3" => recording
            .facts()
            .iter()
            .any(|(name, value)| name == "camera" && value.starts_with("DAVIS"))
            .then_some(DAVIS),
        "dsec" => shutter("the frame cameras of DSEC have global shutters: row time 0"),
        "m3ed" => shutter("the frame cameras of M3ED have global shutters: row time 0"),
        "hs_ergb" => shutter("the frame cameras of HS-ERGB and BS-ERGB have global shutters: row time 0"),
        _ => None,
    }
}

/// Adds what is known of the format's cameras to a recording's frames.
pub(crate) fn with_known_camera(format: &Format, recording: Box<dyn Recording>) -> Box<dyn Recording> {
    let Some(known) = known(format, recording.as_ref()) else { return recording };
    let Some(inner) = recording.pictures() else { return recording };
    let mut about = inner.about().clone();
    if about.row_time_ns.is_some() && (about.transfer.is_some() || !known.linear) {
        return recording;
    }
    about.row_time_ns = about.row_time_ns.or(Some(0));
    if known.linear {
        about.transfer = about.transfer.or(Some(Transfer::Linear));
    }
    about.notes.push(known.why.into());
    Box::new(WithCamera { recording, pictures: Arc::new(Described { inner, about }) })
}

/// Frames with another description.
pub(crate) struct Described {
    pub(crate) inner: Arc<dyn Pictures>,
    pub(crate) about: FramesAbout,
}

impl Pictures for Described {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        self.inner.read(frame, values)
    }
}

/// A recording whose frames are described further.
struct WithCamera {
    recording: Box<dyn Recording>,
    pictures: Arc<dyn Pictures>,
}

impl Recording for WithCamera {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.recording.events_about()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.recording.events()
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        Some(self.pictures.clone())
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        self.recording.triggers()
    }

    crate::recording::forward!(recording);
}
