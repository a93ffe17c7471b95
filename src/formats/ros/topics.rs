//! Which topic the events come from, and which the pictures: the only one, or the one that the user names.

use super::contents::Contents;
use super::messages::{EventArray, EventPacket, Kind, Serial, kind_of};
use super::packets::{self, Encoding};
use super::walk::Walker;
use super::wire::label;
use crate::error::FormatError;
use photocurrent_core::Extent;
use std::sync::Arc;

/// A topic: all its connections.
#[derive(Clone, Debug)]
pub(crate) struct Group {
    /// Its name.
    pub name: String,
    /// Type of its messages.
    pub type_name: String,
    /// What they are.
    pub kind: Kind,
    /// Its connections and how their messages are serialised.
    pub connections: Vec<(u32, Serial)>,
    /// How many messages, when known.
    pub messages: Option<u64>,
}

impl Group {
    /// Numbers of its connections.
    pub(crate) fn ids(&self) -> Vec<u32> {
        self.connections.iter().map(|(id, _)| *id).collect()
    }

    /// How messages of a connection are serialised.
    pub(crate) fn serial(&self, id: u32) -> Option<Serial> {
        self.connections.iter().find(|(known, _)| *known == id).map(|(_, serial)| *serial)
    }

    /// For people: "/dvs/events (dvs_msgs/EventArray, 12 messages)".
    pub(crate) fn describe(&self) -> String {
        let count = self.messages.map(|count| format!(", {count} messages")).unwrap_or_default();
        format!("{} ({}{count})", self.name, self.type_name)
    }
}

/// All topics of a file, in the order in which they appear.
pub(crate) fn groups(contents: &Contents) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for topic in &contents.topics {
        let kind = if topic.serial == Serial::Other { Kind::Other } else { kind_of(&topic.type_name) };
        match groups.iter_mut().find(|group| group.name == topic.name && group.type_name == topic.type_name) {
            Some(group) => {
                group.connections.push((topic.id, topic.serial));
                group.messages = group.messages.zip(topic.messages).map(|(a, b)| a.saturating_add(b));
            }
            None => groups.push(Group {
                name: topic.name.clone(),
                type_name: topic.type_name.clone(),
                kind,
                connections: vec![(topic.id, topic.serial)],
                messages: topic.messages,
            }),
        }
    }
    groups
}

/// A topic that was chosen, and a note that names the others where it was not the only one.
pub(crate) type Chosen<'a> = Option<(&'a Group, Option<String>)>;

/// Chooses among topics: the one that is `named`; the only one; of several with events the first by name; of
/// several with pictures the one of the camera whose events are read, which shares the beginning of its name
/// with them ([`kin`]). `None` when there is none and none is named.
///
/// # Errors
/// When no topic with pictures shares a name with the events more than the others, or when the named one is
/// not there.
pub(crate) fn choose<'a>(
    contents: &Contents,
    groups: &'a [Group],
    named: Option<&str>,
    events: Option<&Group>,
    field: &'static str,
    what: &str,
) -> Result<Chosen<'a>, FormatError> {
    let list = || groups.iter().take(32).map(Group::describe).collect::<Vec<_>>().join("; ");
    let trim = |name: &str| name.trim_start_matches('/').to_string();
    match (named, groups) {
        (Some(name), _) => match groups.iter().find(|group| trim(&group.name) == trim(name)) {
            Some(group) => Ok(Some((group, None))),
            None if groups.is_empty() => Err(FormatError::new(
                &contents.path,
                format!("the file has no topic with {what}"),
                format!("leave `{field}` out"),
            )),
            None => {
                let found = format!("no topic with {what} is called `{name}`; there are: {}", list());
                Err(FormatError::new(&contents.path, found, format!("name one of them as `{field}`"))
                    .undeclared(field))
            }
        },
        (None, []) => Ok(None),
        (None, [only]) => Ok(Some((only, None))),
        (None, _) => {
            let first = match field {
                "camera" => groups.iter().min_by(|a, b| a.name.cmp(&b.name)),
                _ => events.and_then(|events| kin(groups, &events.name)),
            };
            let Some(group) = first else {
                let found = format!("{} topics have {what}: {}", groups.len(), list());
                return Err(FormatError::new(
                    &contents.path,
                    found,
                    format!("name one of them as `{field}`"),
                )
                .undeclared(field));
            };
            let others: Vec<&str> = groups
                .iter()
                .map(|group| group.name.as_str())
                .filter(|name| *name != group.name)
                .take(32)
                .collect();
            Ok(Some((group, Some(crate::recording::not_read(what, &group.name, &others, field)))))
        }
    }
}

/// The topic with most parts of its name in front equal to those of another: /davis/left/image_raw of
/// /davis/left/events. Of several alike the one that ends in `image_raw`, as drivers call what comes from the
/// camera; `None` when that is not one either, or when no part is equal.
fn kin<'a>(groups: &'a [Group], name: &str) -> Option<&'a Group> {
    let parts = |name: &str| {
        name.trim_start_matches('/')
            .rsplit_once('/')
            .map_or(Vec::new(), |(front, _)| front.split('/').map(String::from).collect())
    };
    let of = parts(name);
    let shared = |group: &Group| parts(&group.name).iter().zip(&of).take_while(|(a, b)| a == b).count();
    let most = groups.iter().map(shared).max().filter(|most| *most > 0)?;
    let best: Vec<&Group> = groups.iter().filter(|group| shared(group) == most).collect();
    let raw: Vec<&&Group> = best.iter().filter(|group| group.name.ends_with("/image_raw")).collect();
    match (best.as_slice(), raw.as_slice()) {
        ([only], _) => Some(only),
        (_, [only]) => Some(only),
        _ => None,
    }
}

/// Depth in a form of its own, by the name that `image_transport` gives the topic.
pub(crate) fn is_depth(group: &Group) -> bool {
    group.kind == Kind::CompressedImage && group.name.ends_with("/compressedDepth")
}

/// The topics with pictures among which one is chosen: depth, and compressed copies of pictures that are
/// there as they were, only when they are named.
pub(crate) fn with_pictures(groups: &[Group], named: Option<&str>) -> Vec<Group> {
    let is_sent = |group: &&Group| {
        matches!(group.kind, Kind::Image | Kind::CompressedImage) && group.messages != Some(0)
    };
    let all: Vec<&Group> = groups.iter().filter(is_sent).collect();
    let is_named = |group: &Group| {
        named.is_some_and(|named| named.trim_start_matches('/') == group.name.trim_start_matches('/'))
    };
    let is_copy = |group: &Group| {
        let original = group.name.strip_suffix("/compressed");
        group.kind == Kind::CompressedImage
            && all.iter().any(|other| other.kind == Kind::Image && Some(other.name.as_str()) == original)
    };
    all.iter()
        .filter(|group| is_named(group) || !is_depth(group) && !is_copy(group))
        .map(|group| (*group).clone())
        .collect()
}

/// What the first message of an event topic says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum First {
    /// Events one by one.
    Array(Option<Extent>),
    /// Packets in this encoding.
    Packet(Encoding, Option<Extent>),
    /// Packets in another encoding, by its name.
    Unknown(String),
    /// No message can be read.
    Nothing,
}

/// Looks at the first message of a topic that can be read.
///
/// # Errors
/// When the file has gone.
pub(crate) fn first(contents: &Arc<Contents>, group: &Group) -> Result<First, FormatError> {
    let mut walker = Walker::new(contents, &group.ids());
    while let Some(envelope) = walker.advance()? {
        let Some(wire) = group.serial(envelope.id).and_then(|serial| serial.wire(&walker.body)) else {
            continue;
        };
        if group.kind == Kind::EventArray {
            if let Some(array) = EventArray::read(wire) {
                return Ok(First::Array(array.extent));
            }
        } else if let Some(packet) = EventPacket::read(wire) {
            return Ok(match Encoding::named(packet.encoding) {
                Some(encoding) => First::Packet(encoding, packet.extent),
                None => First::Unknown(label(packet.encoding)),
            });
        }
    }
    Ok(First::Nothing)
}

/// The refusal of packets in an encoding that is not read.
pub(crate) fn unknown_encoding(contents: &Contents, group: &Group, encoding: &str) -> FormatError {
    let found = format!("packets of {} have the encoding `{encoding}`", group.name);
    FormatError::new(
        &contents.path,
        found,
        "convert the topic with event_camera_tools, or record it in one of these encodings",
    )
    .expected(packets::NAMES)
}
