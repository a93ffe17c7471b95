//! Writes events as an EVT3 RAW file.
//!
//! Time words are written for every 4,096 us, also through a gap without events: decoders know a wrap of the
//! 24 bits only by the step from one time word to the next. Events of one time, row and polarity that stand
//! within 12 columns become a vector where that saves a word.
//!
//! Limits: stamps are whole microseconds, below 16.777216 s at the first event (what was subtracted is given
//! back by [`Writer::shift_ns`]); columns and rows below 2048; events in order of time.

use crate::chunk::{Edge, EventChunk, Trigger};
use photocurrent_core::Extent;
use std::io::{Error, ErrorKind, Result, Write};

/// Microseconds after which the time of EVT3 begins again.
const PERIOD_US: i64 = 1 << 24;
/// No gap longer than this is filled with time words: 64 MB of them. Longer ones are refused.
const LONGEST_GAP_US: i64 = (1 << 25) * 4096;

/// Writes one file.
pub struct Writer<W: Write> {
    out: W,
    extent: Extent,
    words: Vec<u8>,
    /// The first stamp is below a period; this was subtracted from all. `None` before the first event.
    shift_us: Option<i64>,
    /// The time that was written last.
    us: i64,
    has_low: bool,
    y: Option<u16>,
}

fn refused(message: String) -> Error {
    Error::new(ErrorKind::InvalidInput, message)
}

impl<W: Write> Writer<W> {
    /// Begins a file: the header. `fields` are further keys and values of it, such as `serial_number`.
    ///
    /// # Errors
    /// When the extent does not fit into EVT3, a field is no single line, or the output fails.
    pub fn new(mut out: W, extent: Extent, fields: &[(&str, &str)]) -> Result<Writer<W>> {
        let Extent { width, height } = extent;
        if width > 2048 || height > 2048 || width == 0 || height == 0 {
            return Err(refused(format!("EVT3 has 2048 x 2048 pixels at most, not {extent}: crop first")));
        }
        let mut header =
            format!("% evt 3.0\n% format EVT3;height={height};width={width}\n% geometry {width}x{height}\n");
        for (key, value) in fields {
            if key.is_empty() || key.contains(char::is_whitespace) || value.contains(char::is_control) {
                return Err(refused(format!("`{key} {value}` is no line of a RAW header")));
            }
            header.push_str(&format!("% {key} {value}\n"));
        }
        header.push_str("% end\n");
        out.write_all(header.as_bytes())?;
        Ok(Writer { out, extent, words: Vec::new(), shift_us: None, us: 0, has_low: false, y: None })
    }

    /// What was subtracted from all stamps so that the first is below 16.777216 s, ns; zero before the first
    /// event.
    pub fn shift_ns(&self) -> i64 {
        self.shift_us.unwrap_or(0) * 1000
    }

    /// Writes events. Stamps are rounded down to microseconds.
    ///
    /// # Errors
    /// When an event is earlier than one before, outside the extent, or days after; or when the output fails.
    pub fn write(&mut self, chunk: &EventChunk) -> Result<()> {
        let n = chunk.t.len();
        let (xs, ys, ons) = (&chunk.x[..n], &chunk.y[..n], &chunk.on[..n]);
        let mut at = 0;
        while at < n {
            let (t, x, y, on) = (chunk.t[at], xs[at], ys[at], u16::from(ons[at] & 1));
            if u32::from(x) >= self.extent.width || u32::from(y) >= self.extent.height {
                return Err(refused(format!(
                    "an event at column {x}, row {y} lies outside {} pixels",
                    self.extent
                )));
            }
            self.write_time(t)?;
            if self.y != Some(y) {
                self.word(0, y);
                self.y = Some(y);
            }
            // Events that one vector can hold: same time, row and polarity, columns rising within 12.
            let us = t.div_euclid(1000);
            let mut set = 1_u16;
            let mut next = at + 1;
            while next < n
                && (chunk.t[next].div_euclid(1000), ys[next], u16::from(ons[next] & 1)) == (us, y, on)
                && (xs[next - 1] + 1..x + 12).contains(&xs[next])
                && u32::from(xs[next]) < self.extent.width
            {
                set |= 1 << (xs[next] - x);
                next += 1;
            }
            if next - at > 2 {
                self.word(3, x | on << 11);
                self.word(if set > 0xFF { 4 } else { 5 }, set);
                at = next;
            } else {
                self.word(2, x | on << 11);
                at += 1;
            }
        }
        self.flush()
    }

    /// Writes an edge of a trigger line (0 to 15), in order of time with the events.
    ///
    /// # Errors
    /// As [`Writer::write`].
    pub fn write_trigger(&mut self, trigger: &Trigger) -> Result<()> {
        if trigger.line > 15 {
            return Err(refused(format!("EVT3 has trigger lines 0 to 15, not {}", trigger.line)));
        }
        self.write_time(trigger.t)?;
        self.word(10, trigger.line << 8 | u16::from(trigger.edge == Edge::Rising));
        self.flush()
    }

    /// Ends the file and gives the output back.
    ///
    /// # Errors
    /// When the output fails.
    pub fn finish(mut self) -> Result<W> {
        self.flush()?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn word(&mut self, kind: u16, value: u16) {
        self.words.extend((kind << 12 | value).to_le_bytes());
    }

    fn flush(&mut self) -> Result<()> {
        self.out.write_all(&self.words)?;
        self.words.clear();
        Ok(())
    }

    fn write_time(&mut self, t: i64) -> Result<()> {
        let stated = t.div_euclid(1000);
        let shift = *self.shift_us.get_or_insert(stated.div_euclid(PERIOD_US) * PERIOD_US);
        let us = stated.saturating_sub(shift);
        if self.has_low && us == self.us {
            return Ok(());
        }
        if self.has_low && us < self.us {
            return Err(refused(format!(
                "an event at {t} ns comes after one at {} ns: sort by time first",
                (self.us + shift).saturating_mul(1000)
            )));
        }
        let (from, to) = (self.us >> 12, us >> 12);
        if !self.has_low {
            self.word(8, (to & 0xFFF) as u16);
        } else if us - self.us > LONGEST_GAP_US {
            return Err(refused(format!(
                "no event for {} hours before {t} ns: EVT3 has no room for so long a gap",
                (us - self.us) / 3_600_000_000
            )));
        }
        let mut high = if self.has_low { from } else { to };
        while high < to {
            high += 1;
            self.word(8, (high & 0xFFF) as u16);
            if self.words.len() > 1 << 16 {
                self.flush()?;
            }
        }
        self.word(6, (us & 0xFFF) as u16);
        self.us = us;
        self.has_low = true;
        Ok(())
    }
}
