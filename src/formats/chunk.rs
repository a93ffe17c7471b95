//! Events as columns, a piece at a time; and edges of trigger lines.

/// How many events a cursor gives at a time, about: 13 bytes each, so one piece stays in a second-level
/// cache.
pub(crate) const CHUNK_EVENTS: usize = 1 << 16;

/// A piece of an event stream, in file order: columns of one length.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EventChunk {
    /// Off-pixel time, ns on the file's own clock.
    pub t: Vec<i64>,
    /// Column.
    pub x: Vec<u16>,
    /// Row.
    pub y: Vec<u16>,
    /// 1 = ON, 0 = OFF.
    pub on: Vec<u8>,
    /// In-pixel time, ns; of every event or of none. Only this project's own recordings have it.
    pub t_in: Option<Vec<i64>>,
}

impl EventChunk {
    /// Number of events.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// No event at all?
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Forgets the events and keeps the memory.
    pub fn clear(&mut self) {
        self.t.clear();
        self.x.clear();
        self.y.clear();
        self.on.clear();
        if let Some(t_in) = &mut self.t_in {
            t_in.clear();
        }
    }

    /// Adds one event without an in-pixel time.
    #[inline]
    pub fn push(&mut self, t: i64, x: u16, y: u16, on: bool) {
        self.t.push(t);
        self.x.push(x);
        self.y.push(y);
        self.on.push(u8::from(on));
    }
}

/// Which way a trigger line went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// Up.
    Rising,
    /// Down.
    Falling,
}

/// An edge on a trigger line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trigger {
    /// When, ns on the file's own clock.
    pub t: i64,
    /// Which line, as the file numbers them.
    pub line: u16,
    /// Which way.
    pub edge: Edge,
}
