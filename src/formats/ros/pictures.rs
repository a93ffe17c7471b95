//! Pictures of one image topic, by index.
//!
//! Their stamps are in the messages, so all image messages are gone over once, their heads only; that happens
//! when pictures are first asked for. A picture's place is kept as (piece, byte), 16 bytes; its values are
//! read when they are wanted. Stored values are given as they are. Compressed pictures
//! (`sensor_msgs/CompressedImage`) are PNG or JPEG, by their first bytes; their `format` names the mosaic
//! when it was compressed as one channel.

use super::contents::Contents;
use super::messages::{CompressedHead, ImageHead, Kind, Serial};
use super::piece::Envelope;
use super::topics::Group;
use super::walk::Walker;
use super::wire::{Stamp, label};
use crate::error::{Cause, FormatError};
use crate::losses::Losses;
use crate::pictures::decode::{self, Coding};
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::colour::Order;
use photocurrent_core::{Colour, Extent};
use std::sync::{Arc, Mutex};

/// Bytes of a message that hold all that stands before the values: names of frames are short.
const HEAD_BYTES: u64 = 4096;
/// The same of a compressed picture, whose own head can hold a profile.
const COMPRESSED_HEAD_BYTES: u64 = 1 << 16;

/// How values stand in a message: `sensor_msgs/image_encodings.h`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pixels {
    colour: Colour,
    bits: u32,
    /// Stored values of a pixel; a fourth, alpha, is left out.
    stored: usize,
    /// Is blue stored first?
    blue_first: bool,
}

/// Names of the encodings that are read, for messages.
const NAMES: &str = "mono8, mono16, 8UC1, 8UC3, 8UC4, 16UC1, 16UC3, 16UC4, 32FC1, rgb8, bgr8, rgba8, bgra8, \
                     rgb16, bgr16, rgba16, bgra16, bayer_*8, bayer_*16";

fn pixels(encoding: &[u8]) -> Option<Pixels> {
    let of = |colour, bits, stored, blue_first| Some(Pixels { colour, bits, stored, blue_first });
    match encoding {
        b"mono8" | b"8UC1" => of(Colour::Mono, 8, 1, false),
        b"mono16" | b"16UC1" => of(Colour::Mono, 16, 1, false),
        b"32FC1" => of(Colour::Mono, 32, 1, false),
        b"rgb8" => of(Colour::Rgb, 8, 3, false),
        b"bgr8" | b"8UC3" => of(Colour::Rgb, 8, 3, true),
        b"rgba8" => of(Colour::Rgb, 8, 4, false),
        b"bgra8" | b"8UC4" => of(Colour::Rgb, 8, 4, true),
        b"rgb16" => of(Colour::Rgb, 16, 3, false),
        b"bgr16" | b"16UC3" => of(Colour::Rgb, 16, 3, true),
        b"rgba16" => of(Colour::Rgb, 16, 4, false),
        b"bgra16" | b"16UC4" => of(Colour::Rgb, 16, 4, true),
        b"bayer_rggb8" => of(Colour::Bayer(Order::Rggb), 8, 1, false),
        b"bayer_bggr8" => of(Colour::Bayer(Order::Bggr), 8, 1, false),
        b"bayer_gbrg8" => of(Colour::Bayer(Order::Gbrg), 8, 1, false),
        b"bayer_grbg8" => of(Colour::Bayer(Order::Grbg), 8, 1, false),
        b"bayer_rggb16" => of(Colour::Bayer(Order::Rggb), 16, 1, false),
        b"bayer_bggr16" => of(Colour::Bayer(Order::Bggr), 16, 1, false),
        b"bayer_gbrg16" => of(Colour::Bayer(Order::Gbrg), 16, 1, false),
        b"bayer_grbg16" => of(Colour::Bayer(Order::Grbg), 16, 1, false),
        _ => None,
    }
}

/// How the values of a message stand. A driver may state `mono8` and send colour: rows are then three or four
/// times as long, and so are all values.
///
/// `davis_ros_driver` did so for every DAVIS346 with a colour filter (uzh-rpg/rpg_dvs_ros#77).
fn pixels_of(head: &ImageHead<'_>) -> Option<Pixels> {
    let stated = pixels(head.encoding)?;
    let (width, height) = (u64::from(head.extent.width), u64::from(head.extent.height));
    let is_grey = stated.stored == 1 && stated.colour == Colour::Mono && stated.bits == 8;
    let all = u64::from(head.step) * height;
    match u64::from(head.step).checked_div(width) {
        Some(stored @ (3 | 4))
            if is_grey
                && width > 1
                && u64::from(head.step) == stored * width
                && u64::from(head.length) == all =>
        {
            Some(Pixels { colour: Colour::Rgb, stored: stored as usize, blue_first: true, ..stated })
        }
        _ => Some(stated),
    }
}

/// What the length of a row shows that the encoding does not state.
fn row_note(head: &ImageHead<'_>, pixels: &Pixels) -> Option<String> {
    let (step, needed) = (u64::from(head.step), pixels.row_bytes(head.extent.width));
    let (encoding, width) = (label(head.encoding), head.extent.width);
    if Some(*pixels) != self::pixels(head.encoding) {
        let channels = pixels.stored;
        return Some(format!(
            "rows have {step} bytes, and {encoding} of {width} columns needs {}: {channels} channels under a \
             wrong name, read as {} (blue first, as ROS has it; should red stand first, \
             red and blue are exchanged and grey stays as it is)",
            u64::from(width),
            if channels == 3 { "bgr8" } else { "bgra8" },
        ));
    }
    (step != needed).then(|| {
        format!(
            "rows have {step} bytes, and {encoding} of {width} columns needs \
                                      {needed}: the others are taken as padding"
        )
    })
}

impl Pixels {
    fn row_bytes(&self, width: u32) -> u64 {
        u64::from(width) * self.stored as u64 * u64::from(self.bits / 8)
    }

    /// Are the values there that a head claims?
    fn fits(&self, head: &ImageHead<'_>, message: u64) -> bool {
        let row = self.row_bytes(head.extent.width);
        let needed = u64::from(head.step) * u64::from(head.extent.height - 1) + row;
        u64::from(head.step) >= row && u64::from(head.length) >= needed && head.at as u64 + needed <= message
    }

    /// Appends the values of a row.
    fn push_row(&self, row: &[u8], big: bool, values: &mut Vec<f32>) {
        match self.bits {
            8 => self.push(row.iter().map(|&value| f32::from(value)), values),
            16 => self.push(
                row.as_chunks::<2>()
                    .0
                    .iter()
                    .map(|&b| f32::from(if big { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) })),
                values,
            ),
            _ => self.push(
                row.as_chunks::<4>()
                    .0
                    .iter()
                    .map(|&b| if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }),
                values,
            ),
        }
    }

    fn push(&self, mut stored: impl Iterator<Item = f32>, values: &mut Vec<f32>) {
        if self.stored == 1 {
            values.extend(stored);
            return;
        }
        while let (Some(first), Some(second), Some(third)) = (stored.next(), stored.next(), stored.next()) {
            if self.stored == 4 {
                stored.next();
            }
            values.extend(if self.blue_first { [third, second, first] } else { [first, second, third] });
        }
    }
}

/// How pictures stand in messages.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    /// Value by value.
    Raw(Pixels),
    /// As PNG or JPEG, of these colours and bits.
    Packed(Coding, Colour, u32),
}

/// A picture's message, without the values.
struct Found {
    stamp: Stamp,
    extent: Extent,
    form: Form,
    /// Name of its encoding or format.
    name: String,
    /// What the length of its rows shows that the encoding does not state.
    note: Option<String>,
}

/// Why a message gives no picture.
enum Not {
    /// It is none, or is cut off: it is left out.
    Sound(Cause, &'static str, String),
    /// Its encoding, by name, is not read.
    Known(String),
}

/// Looks at a message, of which `body` is the beginning.
fn found(kind: Kind, serial: Option<Serial>, envelope: Envelope, body: &[u8]) -> Result<Found, Not> {
    let none = || {
        Not::Sound(
            Cause::Damage,
            "messages that are no picture",
            "the message is no picture; it is left out".into(),
        )
    };
    let wire = serial.and_then(|serial| serial.wire(body)).ok_or_else(none)?;
    if kind == Kind::Image {
        let head = ImageHead::read(wire).ok_or_else(none)?;
        let pixels = pixels_of(&head).ok_or_else(|| Not::Known(label(head.encoding)))?;
        if !pixels.fits(&head, envelope.length) {
            let what = "the picture claims more values than the message holds; it is left out";
            return Err(Not::Sound(Cause::Cut, "pictures that are cut off", what.into()));
        }
        let note = row_note(&head, &pixels);
        return Ok(Found {
            stamp: head.stamp,
            extent: head.extent,
            form: Form::Raw(pixels),
            name: label(head.encoding),
            note,
        });
    }
    let head = CompressedHead::read(wire).ok_or_else(none)?;
    let start = body.get(head.at..).unwrap_or_default();
    let coding = Coding::of(start).filter(|_| !is_depth(head.format)).ok_or_else(|| match head.format {
        b"" => Not::Known("unnamed".into()),
        format => Not::Known(label(format)),
    })?;
    if head.at as u64 + u64::from(head.length) > envelope.length {
        return Err(Not::Sound(
            Cause::Cut,
            "pictures that are cut off",
            "the picture claims more bytes than the message holds; it is left out".into(),
        ));
    }
    let start = &start[..start.len().min(head.length as usize)];
    let inner = decode::head_of(coding, start, head.length.into());
    let inner = inner.map_err(|error| {
        Not::Sound(
            Cause::Damage,
            "pictures that cannot be read",
            format!("the picture cannot be read ({error}); it is left out"),
        )
    })?;
    // One channel of a mosaic, as its format says.
    let mosaic = head
        .format
        .split(|byte| *byte == b';')
        .next()
        .and_then(|name| pixels(name.trim_ascii()))
        .filter(|pixels| pixels.colour.is_mosaic());
    let colour = mosaic.filter(|_| inner.colour == Colour::Mono).map_or(inner.colour, |pixels| pixels.colour);
    Ok(Found {
        stamp: head.stamp,
        extent: inner.extent,
        form: Form::Packed(coding, colour, inner.bits),
        name: format!("{} ({coding:?})", label(head.format)),
        note: None,
    })
}

/// Depth in its own form, which is no picture of a camera.
fn is_depth(format: &[u8]) -> bool {
    format.windows(b"compressedDepth".len()).any(|window| window == b"compressedDepth")
}

/// The pictures of a topic.
pub(crate) struct Images {
    contents: Arc<Contents>,
    group: Group,
    form: Form,
    about: FramesAbout,
    /// Piece and byte of every message.
    places: Vec<(u32, u64)>,
    walker: Mutex<Walker>,
}

impl Images {
    /// Goes over all messages of the topic; `note` joins those on the pictures. `None` when none holds a
    /// picture.
    ///
    /// # Errors
    /// When the file has gone, or its pictures have an encoding that is not read.
    pub(crate) fn survey(
        contents: &Arc<Contents>,
        group: &Group,
        note: Option<String>,
    ) -> Result<(Option<Images>, Losses), FormatError> {
        let head_bytes = if group.kind == Kind::Image { HEAD_BYTES } else { COMPRESSED_HEAD_BYTES };
        let mut walker = Walker::new(contents, &group.ids()).heads(head_bytes);
        let mut images: Option<Images> = None;
        let (mut stampless, mut others) = (0_u64, 0_u64);
        let mut losses = Losses::default();
        while let Some(envelope) = walker.advance()? {
            let at = || format!("message received at {} ns on {}", envelope.received, group.name);
            let head = match found(group.kind, group.serial(envelope.id), envelope, &walker.body) {
                Ok(head) => head,
                Err(Not::Known(name)) if images.is_none() => {
                    return Err(unknown_encoding(contents, group, &name));
                }
                Err(Not::Known(_)) => {
                    others += 1;
                    continue;
                }
                Err(Not::Sound(cause, kind, what)) => {
                    losses.add_by(cause, kind, 1, at, || what);
                    continue;
                }
            };
            let images = images.get_or_insert_with(|| Images::new(contents, group, &head));
            if images.about.extent != head.extent || images.form != head.form {
                others += 1;
                continue;
            }
            let stamped = head.stamp.is_sound() && head.stamp.ns != 0;
            stampless += u64::from(!stamped);
            images.about.stamps.push(FrameStamp {
                at: if stamped { head.stamp.ns } else { envelope.received },
                exposure: None,
            });
            images.places.push((u32::try_from(walker.piece()).unwrap_or(u32::MAX), envelope.offset));
        }
        losses.append(walker.losses, |at| at);
        if let Some(images) = &mut images {
            images.about.notes.extend(note);
            if stampless > 0 {
                images.about.notes.push(format!(
                    "{stampless} pictures have no `header.stamp`; the time when \
                                                 their message was received stands in"
                ));
            }
            if others > 0 {
                images.about.notes.push(format!(
                    "{others} pictures differ from the first in size or encoding; they are left out"
                ));
            }
        }
        Ok((images, losses))
    }

    fn new(contents: &Arc<Contents>, group: &Group, head: &Found) -> Images {
        let (colour, bits) = match head.form {
            Form::Raw(pixels) => (pixels.colour, pixels.bits),
            Form::Packed(_, colour, bits) => (colour, bits),
        };
        let mut notes = vec![format!(
            "pictures are those of {}, as {}; their stamps are `header.stamp`",
            group.name, head.name
        )];
        notes.extend(head.note.clone());
        let about = FramesAbout {
            extent: head.extent,
            colour,
            bits,
            stamps: Vec::new(),
            stamp_role: None,
            row_time_ns: None,
            transfer: None,
            notes,
        };
        let walker = Mutex::new(Walker::new(contents, &group.ids()));
        Images {
            contents: contents.clone(),
            group: group.clone(),
            form: head.form,
            about,
            places: Vec::new(),
            walker,
        }
    }
}

/// The refusal of pictures in an encoding that is not read.
fn unknown_encoding(contents: &Contents, group: &Group, encoding: &str) -> FormatError {
    let found = format!("pictures of {} have the encoding `{encoding}`", group.name);
    if group.kind == Kind::CompressedImage {
        let hint = match is_depth(encoding.as_bytes()) {
            true => "depth is no picture of a camera: choose another topic by `frame_camera`",
            false => {
                "republish the topic as raw (`image_transport republish compressed raw`), or choose \
                      another by `frame_camera`"
            }
        };
        return FormatError::new(&contents.path, found, hint)
            .expected("PNG or JPEG in sensor_msgs/CompressedImage");
    }
    FormatError::new(
        &contents.path,
        found,
        "convert the topic with image_proc or cv_bridge, or choose another by `frame_camera`",
    )
    .expected(NAMES)
}

impl Pictures for Images {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let refuse = |what: &str| {
            FormatError::new(&self.contents.path, what.to_string(), "record or copy the file again")
                .at(format!("picture {frame}"))
        };
        values.clear();
        let &(piece, offset) = self.places.get(frame).ok_or_else(|| refuse("there is no such picture"))?;
        let mut walker = self.walker.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let envelope = walker.fetch(piece as usize, offset)?.map_err(|what| refuse(&what))?;
        let wire = self.group.serial(envelope.id).and_then(|serial| serial.wire(&walker.body));
        let changed = || refuse("the message has changed since the file was opened");
        match self.form {
            Form::Raw(pixels) => {
                let fits = |head: &ImageHead<'_>| {
                    head.extent == self.about.extent && pixels.fits(head, walker.body.len() as u64)
                };
                let head = wire.and_then(ImageHead::read).filter(fits).ok_or_else(changed)?;
                let row = pixels.row_bytes(head.extent.width) as usize;
                values.reserve_exact(head.extent.pixels() * pixels.stored.min(3));
                for y in 0..head.extent.height as usize {
                    let at = head.at + y * head.step as usize;
                    pixels.push_row(walker.body.get(at..at + row).unwrap_or_default(), head.big, values);
                }
            }
            Form::Packed(coding, colour, bits) => {
                let head = wire.and_then(CompressedHead::read).ok_or_else(changed)?;
                let bytes = walker
                    .body
                    .get(head.at..)
                    .and_then(|bytes| bytes.get(..head.length as usize))
                    .ok_or_else(changed)?;
                let read = decode::read_of(coding, bytes, values);
                let read = read.and_then(|inner| {
                    let same = inner.extent == self.about.extent
                        && inner.colour.channels() == colour.channels()
                        && inner.bits == bits;
                    same.then_some(()).ok_or_else(|| "it has changed since the file was opened".into())
                });
                if let Err(error) = read {
                    values.clear();
                    return Err(refuse(&format!("the picture cannot be read: {error}")));
                }
            }
        }
        Ok(())
    }
}
