//! A list of what was lost that stays short, however damaged a file is.

use crate::error::Loss;

/// Losses of one kind that are listed one by one.
const MOST_OF_A_KIND: u64 = 20;

/// Losses in the order in which they were found; after some of a kind, one entry counts the rest.
#[derive(Clone, Debug, Default)]
pub struct LossList {
    list: Vec<Loss>,
    kinds: Vec<Tally>,
}

#[derive(Clone, Debug)]
struct Tally {
    kind: &'static str,
    seen: u64,
    /// Where the entry stands that counts the rest.
    rest: Option<usize>,
}

impl LossList {
    /// Adds a loss; its words are made only if it is listed.
    pub fn add(&mut self, kind: &'static str, words: impl FnOnce() -> Loss) {
        let index = self.kinds.iter().position(|tally| tally.kind == kind).unwrap_or_else(|| {
            self.kinds.push(Tally { kind, seen: 0, rest: None });
            self.kinds.len() - 1
        });
        let tally = &mut self.kinds[index];
        tally.seen += 1;
        if tally.seen <= MOST_OF_A_KIND {
            self.list.push(words());
            return;
        }
        let at = *tally.rest.get_or_insert(self.list.len());
        let rest = Loss { at: "further on".into(), what: format!("{} more of this kind: {kind}", tally.seen - MOST_OF_A_KIND) };
        match self.list.get_mut(at) {
            Some(entry) => *entry = rest,
            None => self.list.push(rest),
        }
    }

    /// All entries.
    pub fn as_slice(&self) -> &[Loss] {
        &self.list
    }
}

/// Text of a file for a message: no control characters, not longer than a line.
pub fn label(bytes: &[u8]) -> String {
    const MOST: usize = 120;
    let clean = |c: char| if c.is_control() { '?' } else { c };
    // No character has more than four bytes: this many hold what is shown.
    let start = bytes.get(..4 * MOST).unwrap_or(bytes);
    let mut text: String = String::from_utf8_lossy(start).chars().map(clean).take(MOST).collect();
    if bytes.len() > text.len() {
        text.push_str("...");
    }
    text
}
