//! The ROS messages that hold events and pictures, field by field.
//!
//! Sources: the `.msg` files of dvs_msgs, prophesee_event_msgs, event_camera_msgs and sensor_msgs. A message
//! that ends early answers `None`.

use super::wire::{Layout, Stamp, Wire};
use photocurrent_core::Extent;

/// What the messages of a topic are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Events one by one: `dvs_msgs/EventArray`, `prophesee_event_msgs/EventArray`.
    EventArray,
    /// Events in the sensor's own encoding: `event_camera_msgs/EventPacket`.
    EventPacket,
    /// A picture: `sensor_msgs/Image`.
    Image,
    /// A picture as PNG or JPEG: `sensor_msgs/CompressedImage`.
    CompressedImage,
    /// Anything else.
    Other,
}

/// What messages of a type are: `dvs_msgs/EventArray` in ROS 1, `dvs_msgs/msg/EventArray` in ROS 2.
pub(crate) fn kind_of(type_name: &str) -> Kind {
    match type_name.replace("/msg/", "/").as_str() {
        "dvs_msgs/EventArray" | "prophesee_event_msgs/EventArray" => Kind::EventArray,
        // The older name of the same message.
        "event_camera_msgs/EventPacket" | "event_array_msgs/EventArray" => Kind::EventPacket,
        "sensor_msgs/Image" => Kind::Image,
        "sensor_msgs/CompressedImage" => Kind::CompressedImage,
        _ => Kind::Other,
    }
}

/// How the messages of a topic are serialised, from what the container calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Serial {
    /// ROS 1.
    Ros1,
    /// CDR of ROS 2.
    Cdr,
    /// Neither.
    Other,
}

impl Serial {
    /// The first field of such a message; `None` when it does not begin as one.
    pub(crate) fn wire(self, bytes: &[u8]) -> Option<Wire<'_>> {
        match self {
            Serial::Ros1 => Some(Wire::ros1(bytes)),
            Serial::Cdr => Wire::cdr(bytes),
            Serial::Other => None,
        }
    }
}

/// `std_msgs/Header`: its stamp. What else it has is read over.
fn header(wire: &mut Wire<'_>) -> Option<Stamp> {
    if wire.layout() == Layout::Ros1 {
        wire.u32()?; // The number of the message, which ROS 2 has no more.
    }
    let stamp = wire.stamp()?;
    wire.string()?;
    Some(stamp)
}

/// Width and height as an extent; `None` where a driver did not fill them in, or where no pixel array is so
/// large.
fn extent(width: u32, height: u32) -> Option<Extent> {
    let sound = |side: u32| (1..=1 << 16).contains(&side);
    (sound(width) && sound(height)).then_some(Extent { width, height })
}

/// Events one by one: what stands before them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EventArray {
    /// Size of the pixel array, when stated.
    pub extent: Option<Extent>,
    /// How many events the message claims to have.
    pub count: u32,
    /// Where the first of them stands.
    pub at: usize,
    /// How they are serialised.
    pub layout: Layout,
}

impl EventArray {
    /// Bytes of an event in ROS 1: x, y, seconds, nanoseconds, polarity. CDR aligns them, and no event is
    /// shorter.
    pub(crate) const EVENT_BYTES: usize = 13;

    /// Reads what stands before the events.
    pub(crate) fn read(mut wire: Wire<'_>) -> Option<EventArray> {
        header(&mut wire)?;
        let height = wire.u32()?;
        let width = wire.u32()?;
        let count = wire.u32()?;
        Some(EventArray { extent: extent(width, height), count, at: wire.at(), layout: wire.layout() })
    }
}

/// One event of an array.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Event {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// When.
    pub stamp: Stamp,
    /// ON?
    pub on: bool,
}

impl Event {
    /// Reads the next event.
    #[inline]
    pub(crate) fn read(wire: &mut Wire<'_>) -> Option<Event> {
        Some(Event { x: wire.u16()?, y: wire.u16()?, stamp: wire.stamp()?, on: wire.u8()? != 0 })
    }
}

/// Events in the sensor's own encoding.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EventPacket<'a> {
    /// The ROS time that the driver gives to the packet.
    pub stamp: Stamp,
    /// Size of the pixel array, when stated.
    pub extent: Option<Extent>,
    /// Number of the packet.
    pub sequence: u64,
    /// What the times inside count from, in those encodings that use it.
    pub time_base: u64,
    /// Name of the encoding.
    pub encoding: &'a [u8],
    /// Were the words stored big-endian?
    pub big: bool,
    /// The encoded events.
    pub events: &'a [u8],
    /// Where they stand in the message.
    pub at: usize,
}

impl<'a> EventPacket<'a> {
    /// Reads a packet.
    pub(crate) fn read(mut wire: Wire<'a>) -> Option<EventPacket<'a>> {
        let stamp = header(&mut wire)?;
        let height = wire.u32()?;
        let width = wire.u32()?;
        let sequence = wire.u64()?;
        let time_base = wire.u64()?;
        let encoding = wire.string()?;
        let big = wire.u8()? != 0;
        let events = wire.sequence()?;
        Some(EventPacket {
            stamp,
            extent: extent(width, height),
            sequence,
            time_base,
            encoding,
            big,
            events,
            at: wire.at() - events.len(),
        })
    }
}

/// A picture: what stands before its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageHead<'a> {
    /// When it was taken, as the driver says.
    pub stamp: Stamp,
    /// Width and height.
    pub extent: Extent,
    /// Name of the layout of its values: `mono8`, `bgr8`.
    pub encoding: &'a [u8],
    /// Are 16-bit values big-endian?
    pub big: bool,
    /// Bytes from a row to the next.
    pub step: u32,
    /// Bytes of all values, as claimed.
    pub length: u32,
    /// Where the first of them stands in the message.
    pub at: usize,
}

impl<'a> ImageHead<'a> {
    /// Reads what stands before the values.
    pub(crate) fn read(mut wire: Wire<'a>) -> Option<ImageHead<'a>> {
        let stamp = header(&mut wire)?;
        let height = wire.u32()?;
        let width = wire.u32()?;
        let encoding = wire.string()?;
        let big = wire.u8()? != 0;
        let step = wire.u32()?;
        let length = wire.u32()?;
        Some(ImageHead { stamp, extent: extent(width, height)?, encoding, big, step, length, at: wire.at() })
    }
}

/// A compressed picture: what stands before its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CompressedHead<'a> {
    /// When it was taken, as the driver says.
    pub stamp: Stamp,
    /// What was compressed and how, as the driver says: `jpeg`, `bgr8; jpeg compressed bgr8`,
    /// `16UC1; png compressed`.
    pub format: &'a [u8],
    /// Bytes of the picture, as claimed.
    pub length: u32,
    /// Where the first of them stands in the message.
    pub at: usize,
}

impl<'a> CompressedHead<'a> {
    /// Reads what stands before the bytes.
    pub(crate) fn read(mut wire: Wire<'a>) -> Option<CompressedHead<'a>> {
        let stamp = header(&mut wire)?;
        let format = wire.string()?;
        let length = wire.u32()?;
        Some(CompressedHead { stamp, format, length, at: wire.at() })
    }
}
