//! Keeps count of what was left out, kind by kind: the first few of a kind each with their place, then how many more there were.
//!
//! A file of a million damaged lines must not become a million messages. The sentence that counts the rest is written by [`Tally::settle`], once a
//! piece, so that counting costs nothing in the inner loop.

use crate::error::Loss;

/// Losses of one kind that are listed one by one.
const LISTED: u64 = 20;
/// The place of a sentence about the rest.
const REST: &str = "after these";

/// What was left out so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    losses: Vec<Loss>,
    /// The kind of every loss in the list.
    kind_of: Vec<usize>,
    kinds: Vec<Kind>,
}

#[derive(Clone, Debug)]
struct Kind {
    name: &'static str,
    count: u64,
    /// Where the sentence about the rest stands in the list.
    rest: Option<usize>,
    settled: u64,
}

impl Tally {
    /// Counts one loss of a kind. Place and sentence are made only for those that are listed.
    pub(crate) fn add(&mut self, kind: &'static str, at: impl FnOnce() -> String, what: impl FnOnce() -> String) {
        let index = match self.kinds.iter().position(|known| known.name == kind) {
            Some(index) => index,
            None => {
                self.kinds.push(Kind { name: kind, count: 0, rest: None, settled: 0 });
                self.kinds.len() - 1
            }
        };
        let known = &mut self.kinds[index];
        known.count += 1;
        if known.count <= LISTED {
            self.losses.push(Loss { at: at(), what: what() });
            self.kind_of.push(index);
        } else if known.rest.is_none() {
            known.rest = Some(self.losses.len());
            self.losses.push(Loss { at: REST.into(), what: String::new() });
            self.kind_of.push(index);
        }
    }

    /// Brings the sentences about the rest up to date.
    pub(crate) fn settle(&mut self) {
        for kind in &mut self.kinds {
            if let Some(rest) = kind.rest.filter(|_| kind.settled != kind.count) {
                self.losses[rest].what = format!("{} more of this kind: {}", kind.count - LISTED, kind.name);
                kind.settled = kind.count;
            }
        }
    }

    /// Adds those of a part of the recording, with the part's name before each place.
    pub(crate) fn append(&mut self, part: &str, other: Tally) {
        for (loss, kind) in other.losses.into_iter().zip(&other.kind_of) {
            let kind = &other.kinds[*kind];
            // The sentence about the rest is made again.
            if loss.at != REST {
                self.add(kind.name, || format!("{part}, {}", loss.at), || loss.what);
            }
        }
        for kind in other.kinds.iter().filter(|kind| kind.count > LISTED) {
            for known in self.kinds.iter_mut().filter(|known| known.name == kind.name) {
                // As many as there is a sentence for were added above; the last of them made room for the sentence.
                known.count += kind.count - LISTED - 1;
            }
            self.add(kind.name, String::new, String::new);
        }
    }

    /// All of them; call [`Tally::settle`] before.
    pub(crate) fn losses(&self) -> &[Loss] {
        &self.losses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twenty_are_listed_and_the_rest_is_counted() {
        let mut tally = Tally::default();
        for line in 1..=1000 {
            tally.add("a line is no event", || format!("line {line}"), || "no number".into());
        }
        tally.add("cut off", || "line 1001".into(), || "the last line is cut off".into());
        tally.settle();
        let losses = tally.losses();
        assert_eq!(losses.len(), 22);
        assert_eq!((losses[19].at.as_str(), losses[21].at.as_str()), ("line 20", "line 1001"));
        assert!(losses[20].what.starts_with("980 more"), "{}", losses[20].what);
    }

    #[test]
    fn parts_add_up() {
        let part = |count: usize| {
            let mut tally = Tally::default();
            for event in 0..count {
                tally.add("outside", || format!("event {event}"), || "outside".into());
            }
            tally
        };
        let mut all = part(3);
        all.append("000001.npz", part(30));
        all.append("000002.npz", part(2));
        all.settle();
        assert_eq!(all.losses().len(), 21);
        assert_eq!(all.losses()[3].at, "000001.npz, event 0");
        assert_eq!(all.losses()[20].what, "15 more of this kind: outside", "35 in all");
    }
}
