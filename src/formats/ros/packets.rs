//! Decodes the bytes of `event_camera_msgs/EventPacket`, in every encoding that drivers write.
//!
//! `evt3`, `evt2`, `evt21`: the sensor's own words (see [`crate::evt`]). `mono`: 64-bit words of a time since
//! `time_base`, a pixel and a polarity. `trigger`: the same without a pixel, edges of a trigger line.
//! `libcaer`: DAVIS events of 8 bytes with microseconds since `time_base`. `libcaer_cmp`: those packed into
//! 16-bit words. Source: the documentation and decoders of event_camera_msgs and event_camera_codecs.
//!
//! The first five count on the sensor's clock, the last two on the ROS clock: see
//! [`Encoding::has_sensor_clock`].

use crate::chunk::{Edge, EventChunk, Trigger};
use crate::evt::{Evt2Decoder, Evt3Decoder, Evt21Decoder, Faults};
use photocurrent_core::Extent;

/// How the events of a packet are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// Prophesee EVT3.
    Evt3,
    /// Prophesee EVT2.
    Evt2,
    /// Prophesee EVT2.1.
    Evt21,
    /// Words of time, pixel and polarity.
    Mono,
    /// Words of time and edge.
    Trigger,
    /// Events as libcaer has them.
    Libcaer,
    /// Those, packed.
    LibcaerCmp,
}

/// Names of the encodings that are read, for messages.
pub(crate) const NAMES: &str = "evt3, evt2, evt21, mono, trigger, libcaer, libcaer_cmp";

impl Encoding {
    /// By the name in a packet.
    pub(crate) fn named(name: &[u8]) -> Option<Encoding> {
        Some(match name {
            b"evt3" => Encoding::Evt3,
            b"evt2" => Encoding::Evt2,
            b"evt21" => Encoding::Evt21,
            b"mono" => Encoding::Mono,
            b"trigger" => Encoding::Trigger,
            b"libcaer" => Encoding::Libcaer,
            b"libcaer_cmp" => Encoding::LibcaerCmp,
            _ => return None,
        })
    }

    /// The name in a packet.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Encoding::Evt3 => "evt3",
            Encoding::Evt2 => "evt2",
            Encoding::Evt21 => "evt21",
            Encoding::Mono => "mono",
            Encoding::Trigger => "trigger",
            Encoding::Libcaer => "libcaer",
            Encoding::LibcaerCmp => "libcaer_cmp",
        }
    }

    /// Do times count from when the sensor was started, not from the epoch of ROS?
    pub(crate) fn has_sensor_clock(self) -> bool {
        !matches!(self, Encoding::Libcaer | Encoding::LibcaerCmp)
    }

    /// After which time the stored times begin again, ns; `None` where a packet says on its own what it
    /// counts from.
    pub(crate) fn wrap_ns(self) -> Option<i64> {
        match self {
            Encoding::Evt3 => Some((1 << 24) * 1000),
            Encoding::Evt2 | Encoding::Evt21 => Some((1 << 34) * 1000),
            _ => None,
        }
    }

    /// Step of the times, ns.
    pub(crate) fn tick_ns(self) -> i64 {
        if matches!(self, Encoding::Mono | Encoding::Trigger) { 1 } else { 1000 }
    }
}

/// Decodes packets of one connection; words go on from packet to packet.
pub(crate) struct PacketDecoder {
    encoding: Encoding,
    extent: Option<Extent>,
    words: Words,
    faults: Faults,
}

enum Words {
    Evt3(Box<Evt3Decoder>),
    Evt2(Box<Evt2Decoder>),
    Evt21(Box<Evt21Decoder>),
    Own(Own),
}

/// State of the encodings that are decoded here; all but the column begins anew with a packet.
#[derive(Clone, Copy, Default)]
struct Own {
    big: bool,
    base: i64,
    /// Time of the last event in libcaer's 31 bits of us, and what its wraps add, ns.
    last: u32,
    wraps: i64,
    high: i64,
    low: i64,
    x: u16,
    y: u16,
    on: bool,
}

impl PacketDecoder {
    /// At the beginning of a stream.
    pub(crate) fn new(encoding: Encoding, extent: Option<Extent>) -> PacketDecoder {
        let words = match encoding {
            Encoding::Evt3 => Words::Evt3(Box::new(Evt3Decoder::new().with_extent(extent))),
            Encoding::Evt2 => Words::Evt2(Box::new(Evt2Decoder::new().with_extent(extent))),
            Encoding::Evt21 => Words::Evt21(Box::new(Evt21Decoder::new().with_extent(extent))),
            _ => Words::Own(Own::default()),
        };
        PacketDecoder { encoding, extent, words, faults: Faults::default() }
    }

    /// What it decodes.
    pub(crate) fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// What was left out so far.
    pub(crate) fn faults(&self) -> Faults {
        match &self.words {
            Words::Evt3(decoder) => *decoder.faults(),
            Words::Evt2(decoder) => *decoder.faults(),
            Words::Evt21(decoder) => *decoder.faults(),
            Words::Own(_) => self.faults,
        }
    }

    /// Begins a packet: what its times count from, and the order of its bytes. Words of Prophesee are
    /// little-endian whatever the machine.
    pub(crate) fn begin(&mut self, time_base: u64, big: bool) {
        if let Words::Own(own) = &mut self.words {
            // A base beyond 2^61 ns (73 years) is damaged; times must stay so small that their sums are no
            // overflow.
            let base = i64::try_from(time_base).unwrap_or(i64::MAX).min(1 << 61);
            *own = Own { big, base, x: own.x, ..Own::default() };
        }
    }

    /// Decodes the next bytes of a packet, an even number of words but at its end; appends events and edges,
    /// ns on the encoding's clock.
    pub(crate) fn decode(&mut self, bytes: &[u8], out: &mut EventChunk, triggers: &mut Vec<Trigger>) {
        match &mut self.words {
            Words::Evt3(decoder) => {
                decoder.decode(bytes, out, triggers);
            }
            Words::Evt2(decoder) => {
                decoder.decode(bytes, out, triggers);
            }
            Words::Evt21(decoder) => {
                decoder.decode(bytes, out, triggers);
            }
            Words::Own(own) => {
                let mut sink = Sink { out, extent: self.extent, outside: 0 };
                match self.encoding {
                    Encoding::Trigger => own.trigger(bytes, triggers),
                    Encoding::Libcaer => own.libcaer(bytes, &mut sink),
                    Encoding::LibcaerCmp => self.faults.unknown += own.libcaer_cmp(bytes, &mut sink),
                    _ => own.mono(bytes, &mut sink),
                }
                self.faults.outside += sink.outside;
            }
        }
    }
}

/// Takes events that lie within the extent.
struct Sink<'a> {
    out: &'a mut EventChunk,
    extent: Option<Extent>,
    outside: u64,
}

impl Sink<'_> {
    #[inline]
    fn put(&mut self, t: i64, x: u16, y: u16, on: bool) {
        if self.extent.is_none_or(|extent| u32::from(x) < extent.width && u32::from(y) < extent.height) {
            self.out.push(t, x, y, on);
        } else {
            self.outside += 1;
        }
    }
}

impl Own {
    fn word(&self, bytes: [u8; 8]) -> u64 {
        if self.big { u64::from_be_bytes(bytes) } else { u64::from_le_bytes(bytes) }
    }

    /// From the low bit: 32 of ns since the base, 16 of column, 15 of row, 1 of polarity.
    fn mono(&mut self, bytes: &[u8], sink: &mut Sink<'_>) {
        for word in bytes.as_chunks::<8>().0 {
            let word = self.word(*word);
            sink.put(
                self.base + (word & 0xffff_ffff) as i64,
                (word >> 32) as u16,
                (word >> 48) as u16 & 0x7fff,
                word >> 63 == 1,
            );
        }
    }

    /// As `mono`, with the line where the row would be.
    fn trigger(&mut self, bytes: &[u8], triggers: &mut Vec<Trigger>) {
        for word in bytes.as_chunks::<8>().0 {
            let word = self.word(*word);
            let edge = if word >> 63 == 1 { Edge::Rising } else { Edge::Falling };
            triggers.push(Trigger {
                t: self.base + (word & 0xffff_ffff) as i64,
                line: (word >> 48) as u16 & 0x7fff,
                edge,
            });
        }
    }

    /// Two words of 32 bits: from the low bit, valid, polarity, 15 of row, 15 of column; then us since the
    /// base, which begin again after 2^31.
    fn libcaer(&mut self, bytes: &[u8], sink: &mut Sink<'_>) {
        for word in bytes.as_chunks::<8>().0 {
            let word = u64::from_le_bytes(*word);
            let (data, us) = (word as u32, (word >> 32) as u32 & 0x7fff_ffff);
            if us < self.last {
                self.wraps = self.wraps.saturating_add((1 << 31) * 1000).min(1 << 61);
            }
            self.last = us;
            sink.put(
                self.base + self.wraps + i64::from(us) * 1000,
                (data >> 17) as u16,
                (data >> 2) as u16 & 0x7fff,
                data & 2 != 0,
            );
        }
    }

    /// Words of 16 bits, their kind in the upper four; a column holds until the next, and vectors run down
    /// it. Gives the number of unknown words.
    fn libcaer_cmp(&mut self, bytes: &[u8], sink: &mut Sink<'_>) -> u64 {
        let mut unknown = 0;
        for word in bytes.as_chunks::<2>().0 {
            let word = if self.big { u16::from_be_bytes(*word) } else { u16::from_le_bytes(*word) };
            let (value, on) = (word & 0x7ff, word & 0x800 != 0);
            let t = self.base + (self.high | self.low) * 1000;
            match word >> 12 {
                0 => self.high = i64::from(word & 0xfff) << 12,
                1 => self.low = i64::from(word & 0xfff),
                2 => self.x = value,
                3 => sink.put(t, self.x, value, on),
                4 => (self.y, self.on) = (value, on),
                5 => {
                    for bit in (0..8).filter(|bit| word >> bit & 1 == 1) {
                        sink.put(t, self.x, self.y.saturating_add(bit), self.on);
                    }
                    self.y = self.y.saturating_add(8);
                }
                _ => unknown += 1,
            }
        }
        unknown
    }
}
