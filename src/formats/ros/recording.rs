//! A bag, MCAP file or database as a recording: its event topic, its image topic, what else it has.

use super::clock::{self, Shift};
use super::contents::Contents;
use super::events::{Cursor, Stream};
use super::messages::Kind;
use super::packets::Encoding;
use super::pictures::Images;
use super::topics::{self, First, Group};
use crate::chunk::{EventChunk, Trigger};
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use photocurrent_core::Extent;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

/// A recording of ROS.
struct Ros {
    contents: Arc<Contents>,
    stream: Option<Stream>,
    about: Option<EventsAbout>,
    /// Topics with packets of the encoding `trigger`.
    trigger_topics: Vec<Group>,
    image_topic: Option<Group>,
    /// Which other topics have pictures.
    picture_note: Option<String>,
    images: OnceLock<Survey>,
    facts: Vec<(String, String)>,
    losses: Vec<Loss>,
}

/// What going over the image topic gave.
#[derive(Default)]
struct Survey {
    images: Option<Arc<Images>>,
    losses: Losses,
}

/// Chooses topics and looks at their first messages.
///
/// # Errors
/// When it is not clear which topics are meant, or when events or pictures are in an encoding that is not
/// read.
pub(crate) fn open(contents: Contents, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let contents = Arc::new(contents);
    let groups = topics::groups(&contents);
    let mut facts = facts_of(&contents, &groups);
    let (candidates, firsts, trigger_topics) = event_topics(&contents, &groups)?;
    let (chosen, which) =
        topics::choose(&contents, &candidates, declared.camera.as_deref(), None, "camera", "events")?.unzip();
    let first = chosen.and_then(|chosen| {
        candidates.iter().zip(&firsts).find(|(group, _)| std::ptr::eq(*group, chosen)).map(|(_, first)| first)
    });
    let mut stream = None;
    let mut about = None;
    if let (Some(group), Some(first)) = (chosen, first) {
        if let First::Unknown(encoding) = first {
            return Err(topics::unknown_encoding(&contents, group, encoding));
        }
        let (made, mut known) = event_stream(&contents, group, first, declared.extent)?;
        known.notes.extend(which.flatten());
        facts.push(("events".into(), format!("{} ({})", group.name, known.stamps)));
        (stream, about) = (Some(made), Some(known));
    }

    let with_pictures = topics::with_pictures(&groups, declared.frame_camera.as_deref());
    let chosen = topics::choose(
        &contents,
        &with_pictures,
        declared.frame_camera.as_deref(),
        chosen,
        "frame_camera",
        "pictures",
    )?;
    let (image_topic, picture_note) = chosen.map(|(group, note)| (group.clone(), note)).unzip();
    let picture_note = picture_note.flatten();
    if let Some(group) = &image_topic {
        facts.push(("pictures".into(), group.name.clone()));
    }
    for group in groups.iter().filter(|group| topics::is_depth(group)).filter(has_messages) {
        facts.push((
            "not read".into(),
            format!("{}: depth, which is no picture of a camera", group.describe()),
        ));
    }
    if stream.is_none() && image_topic.is_none() {
        return Err(nothing_to_read(&contents, &groups));
    }
    let losses = contents.losses.list();
    let recording = Ros {
        contents,
        stream,
        about,
        trigger_topics,
        image_topic,
        picture_note,
        images: OnceLock::new(),
        facts,
        losses,
    };
    // Without events the pictures are all there is: then what is wrong with them is a reason to refuse the
    // file.
    if recording.stream.is_none()
        && let Some(group) = &recording.image_topic
    {
        let (images, losses) = Images::survey(&recording.contents, group, recording.picture_note.clone())?;
        let _ = recording.images.set(Survey { images: images.map(Arc::new), losses });
    }
    Ok(Box::new(recording))
}

/// What the file states of itself, its topics, and when messages were received.
fn facts_of(contents: &Contents, groups: &[Group]) -> Vec<(String, String)> {
    let mut facts = contents.facts.clone();
    facts.push(("topics".into(), groups.iter().take(64).map(Group::describe).collect::<Vec<_>>().join("; ")));
    let received = contents.pieces.iter().map(|piece| piece.received).filter(|received| *received != (0, 0));
    if let Some((first, last)) = received.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) {
        facts.push((
            "received".into(),
            format!("from {first} to {last} ns, {:.6} s", last.saturating_sub(first) as f64 * 1e-9),
        ));
    }
    facts
}

/// Has the topic messages, as far as is known?
fn has_messages(group: &&Group) -> bool {
    group.messages != Some(0)
}

/// Topics with events, the first message of each, and topics with triggers.
type Topics = (Vec<Group>, Vec<First>, Vec<Group>);

/// Topics with events, their first messages, and topics with triggers.
fn event_topics(contents: &Arc<Contents>, groups: &[Group]) -> Result<Topics, FormatError> {
    let mut candidates: Vec<Group> = Vec::new();
    let mut firsts: Vec<First> = Vec::new();
    let mut trigger_topics = Vec::new();
    let has_events = |group: &&Group| matches!(group.kind, Kind::EventArray | Kind::EventPacket);
    for group in groups.iter().filter(has_events).filter(has_messages) {
        match topics::first(contents, group)? {
            First::Packet(Encoding::Trigger, _) => trigger_topics.push(group.clone()),
            First::Nothing => {}
            first => {
                candidates.push(group.clone());
                firsts.push(first);
            }
        }
    }
    Ok((candidates, firsts, trigger_topics))
}

/// The error of a file whose topics have neither events nor pictures.
fn nothing_to_read(contents: &Contents, groups: &[Group]) -> FormatError {
    let found = format!(
        "no topic has events or pictures; there are: {}",
        groups.iter().take(32).map(Group::describe).collect::<Vec<_>>().join("; ")
    );
    let expected = "dvs_msgs/EventArray, prophesee_event_msgs/EventArray, \
                        event_camera_msgs/EventPacket, sensor_msgs/Image or sensor_msgs/CompressedImage";
    let lost = contents
        .losses
        .list()
        .first()
        .map(|loss| format!("; {}: {}", loss.at, loss.what))
        .unwrap_or_default();
    FormatError::new(&contents.path, found + &lost, "record those topics, or check that the file is whole")
        .expected(expected)
}

/// What is known of an event topic from its first messages.
fn event_stream(
    contents: &Arc<Contents>,
    group: &Group,
    first: &First,
    declared: Option<Extent>,
) -> Result<(Stream, EventsAbout), FormatError> {
    let mut notes = Vec::new();
    let mut shift_ns = 0;
    let (extent, encoding) = match first {
        First::Array(extent) => (*extent, None),
        First::Packet(encoding, extent) => (*extent, Some(*encoding)),
        First::Unknown(_) | First::Nothing => (None, None),
    };
    if let Some(encoding) = encoding.filter(|encoding| encoding.has_sensor_clock()) {
        match clock::shift(contents, group, encoding)? {
            Some(Shift { ns, spread_ns, packets }) => {
                shift_ns = ns;
                notes.push(format!(
                    "{ns} ns added to the sensor's time, which brings events to the clock of ROS: the \
                     smallest of `header.stamp` minus time of the first event \
                     over the first {packets} packets, which spread by {spread_ns} ns"
                ));
            }
            None => notes.push(
                "no packet at the start has both a stamp and an event: times are those of \
                                the sensor, not of ROS"
                    .into(),
            ),
        }
    }
    if extent.is_none() && declared.is_none() {
        notes.push("the messages do not state the size of the pixel array".into());
    }
    let stamps = match encoding {
        None => "u32 seconds and u32 nanoseconds".to_string(),
        Some(Encoding::Mono) => "mono: nanoseconds of the sensor's clock".into(),
        Some(encoding) => format!(
            "{}: microseconds of the {} clock",
            encoding.name(),
            if encoding.has_sensor_clock() { "sensor's" } else { "ROS" }
        ),
    };
    let extent = declared.or(extent);
    let tick_ns = encoding.map_or(1, Encoding::tick_ns);
    let about = EventsAbout { extent, tick_ns, count: None, has_t_in: false, stamps, notes };
    Ok((Stream { contents: contents.clone(), group: group.clone(), encoding, extent, shift_ns }, about))
}

impl Ros {
    fn survey(&self) -> Option<&Survey> {
        let group = self.image_topic.as_ref()?;
        Some(self.images.get_or_init(|| {
            match Images::survey(&self.contents, group, self.picture_note.clone()) {
                Ok((images, losses)) => Survey { images: images.map(Arc::new), losses },
                Err(error) => {
                    let mut survey = Survey::default();
                    survey.losses.add(
                        "topics whose pictures are not read",
                        || group.name.clone(),
                        || format!("{}; no picture is read", error.found),
                    );
                    survey
                }
            }
        }))
    }
}

impl Recording for Ros {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let stream = self.stream.clone().ok_or_else(|| {
            FormatError::new(
                &self.contents.path,
                "the file has no topic with events",
                "use its pictures only",
            )
        })?;
        Ok(Box::new(Cursor::new(stream)))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        let images = self.survey()?.images.clone()?;
        Some(images)
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        let packets = self.stream.as_ref().filter(|stream| stream.encoding.is_some());
        let shift_ns = packets.map_or(0, |stream| stream.shift_ns);
        let of_topic = |group: &Group| Stream {
            contents: self.contents.clone(),
            group: group.clone(),
            encoding: Some(Encoding::Trigger),
            extent: None,
            shift_ns,
        };
        let streams = packets.cloned().into_iter().chain(self.trigger_topics.iter().map(of_topic));
        let mut triggers = Vec::new();
        for stream in streams {
            let mut cursor = Cursor::new(stream);
            let mut chunk = EventChunk::default();
            loop {
                let more = cursor.next(&mut chunk)?;
                triggers.append(&mut cursor.triggers);
                if !more {
                    break;
                }
            }
        }
        Ok(triggers)
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }

    fn losses(&self) -> Vec<Loss> {
        let found = self.images.get().map(|survey| survey.losses.list()).unwrap_or_default();
        self.losses.iter().cloned().chain(found).collect()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.contents.files.clone()
    }
}
