//! What a cursor left out, one line for each kind, however many events it is.

use crate::error::Loss;

/// Damaged pieces that are named one by one.
const MOST_PIECES: usize = 20;

/// Kinds of events that are left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Outside,
    Fraction,
    Stamp,
    Polarity,
}

/// Losses of one cursor.
#[derive(Default)]
pub(super) struct Losses {
    all: Vec<Loss>,
    /// Where in `all` a kind stands, how many, and its example.
    kinds: Vec<(Kind, usize, u64, String)>,
    pieces: usize,
    /// Where in `all` the pieces beyond the named ones are counted.
    more: Option<usize>,
}

impl Losses {
    pub fn all(&self) -> &[Loss] {
        &self.all
    }

    /// One more event of a kind, at an index.
    pub fn event(&mut self, kind: Kind, index: usize, example: impl FnOnce() -> String) {
        let found = self.kinds.iter_mut().find(|(other, ..)| *other == kind);
        let (_, at, count, example) = match found {
            Some(found) => found,
            None => {
                self.all.push(Loss { at: format!("event {index}"), what: String::new() });
                self.kinds.push((kind, self.all.len() - 1, 0, example()));
                let last = self.kinds.len() - 1;
                &mut self.kinds[last]
            }
        };
        *count += 1;
        let (events, were) = if *count == 1 { ("event", "was") } else { ("events", "were") };
        let why = match kind {
            Kind::Outside => "outside the pixel array",
            Kind::Fraction => "between pixels",
            Kind::Stamp => "with a stamp that is no time",
            Kind::Polarity => "with a polarity that is none of 1, 0, -1",
        };
        self.all[*at].what = format!("{count} {events} {why} {were} left out, the first here ({example})");
    }

    /// A piece that cannot be read.
    pub fn piece(&mut self, at: String, what: String) {
        self.pieces += 1;
        if self.pieces <= MOST_PIECES {
            self.all.push(Loss { at, what });
            return;
        }
        let loss = Loss { at, what: format!("{} more damaged pieces up to here; their events are lost", self.pieces - MOST_PIECES) };
        match self.more {
            Some(more) => self.all[more] = loss,
            None => {
                self.more = Some(self.all.len());
                self.all.push(loss);
            }
        }
    }
}
