//! What a reader left out: a list that stays short, however damaged a file is.

use crate::error::{Cause, Loss};

/// Places of one kind that are listed one by one.
const LISTED: u64 = 20;

/// Losses, by kind: the first twenty places of a kind are listed, one line counts the others.
///
/// A file of a million damaged lines must not become a million messages, nor take the time to write them:
/// place and sentence are made only of those that are listed.
#[derive(Clone, Debug, Default)]
pub(crate) struct Losses {
    /// Listed losses with the index of their kind, in the order in which they were found.
    listed: Vec<(usize, Loss)>,
    kinds: Vec<Kind>,
}

/// What is known of one kind.
#[derive(Clone, Debug)]
struct Kind {
    name: &'static str,
    cause: Cause,
    listed: u64,
    /// Places that are not listed.
    more_places: u64,
    /// What was lost at those places: events, words.
    more_items: u64,
}

impl Losses {
    /// Adds one loss. `kind` is a phrase in the plural that says what was lost: "lines without a number were
    /// left out".
    pub(crate) fn add(
        &mut self,
        kind: &'static str,
        at: impl FnOnce() -> String,
        what: impl FnOnce() -> String,
    ) {
        self.add_items(kind, 1, at, what);
    }

    /// Adds `items` losses of one place, such as events of one packet; none for 0. A listed one that is met
    /// again is not added again.
    pub(crate) fn add_items(
        &mut self,
        kind: &'static str,
        items: u64,
        at: impl FnOnce() -> String,
        what: impl FnOnce() -> String,
    ) {
        self.add_by(Cause::Damage, kind, items, at, what);
    }

    /// As [`Losses::add_items`], of a cause other than damage.
    pub(crate) fn add_by(
        &mut self,
        cause: Cause,
        kind: &'static str,
        items: u64,
        at: impl FnOnce() -> String,
        what: impl FnOnce() -> String,
    ) {
        if items == 0 {
            return;
        }
        let k = self.kind(kind, cause);
        if self.kinds[k].listed >= LISTED {
            self.kinds[k].more_places += 1;
            self.kinds[k].more_items += items;
            return;
        }
        let loss = Loss::new(at(), what()).by(cause);
        if !self.listed.iter().any(|(_, known)| *known == loss) {
            self.kinds[k].listed += 1;
            self.listed.push((k, loss));
        }
    }

    /// Adds the losses of a part of the recording; `place` makes a place in the recording of a place in the
    /// part.
    pub(crate) fn append(&mut self, part: Losses, place: impl Fn(String) -> String) {
        let Losses { listed, kinds } = part;
        for (kind, loss) in listed {
            self.add_by(kinds[kind].cause, kinds[kind].name, 1, || place(loss.at), || loss.what);
        }
        for more in kinds.iter().filter(|kind| kind.more_places > 0) {
            let k = self.kind(more.name, more.cause);
            self.kinds[k].more_places += more.more_places;
            self.kinds[k].more_items += more.more_items;
        }
    }

    /// The index of a kind.
    fn kind(&mut self, name: &'static str, cause: Cause) -> usize {
        self.kinds.iter().position(|known| known.name == name).unwrap_or_else(|| {
            self.kinds.push(Kind { name, cause, listed: 0, more_places: 0, more_items: 0 });
            self.kinds.len() - 1
        })
    }

    /// All of them; behind the last listed one of a kind, how many more there are.
    pub(crate) fn list(&self) -> Vec<Loss> {
        let mut left: Vec<u64> = self.kinds.iter().map(|kind| kind.listed).collect();
        let mut list = Vec::with_capacity(self.listed.len() + self.kinds.len());
        for (k, loss) in &self.listed {
            list.push(loss.clone());
            left[*k] -= 1;
            let kind = &self.kinds[*k];
            if left[*k] == 0 && kind.more_places > 0 {
                let places = if kind.more_places == 1 { "place" } else { "places" };
                let what = format!("{} more of this kind: {}", kind.more_items, kind.name);
                list.push(Loss {
                    more: kind.more_places,
                    ..Loss::new(format!("{} more {places}", kind.more_places), what).by(kind.cause)
                });
            }
        }
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(count: usize) -> Losses {
        let mut losses = Losses::default();
        (1..=count).for_each(|line| {
            losses.add("lines without a number", || format!("line {line}"), || "no number".into())
        });
        losses
    }

    #[test]
    fn twenty_of_a_kind_are_listed_and_the_others_counted() {
        let mut losses = lines(1000);
        losses.add("cut ends", || "line 1001".into(), || "the last line is cut off".into());
        let list = losses.list();
        assert_eq!((list.len(), list[19].at.as_str(), list[21].at.as_str()), (22, "line 20", "line 1001"));
        assert_eq!(
            (list[20].at.as_str(), list[20].what.as_str()),
            ("980 more places", "980 more of this kind: lines without a number")
        );
        assert_eq!(list.iter().map(Loss::places).sum::<u64>(), 1001, "every place is counted once");
    }

    #[test]
    fn items_of_one_place_are_counted_and_none_is_no_loss() {
        let mut losses = Losses::default();
        (0..21).for_each(|packet| {
            losses.add_items("events outside", 3, || format!("packet {packet}"), || "3 events".into())
        });
        losses.add_items("unknown words", 0, || unreachable!("no place"), || unreachable!("no words"));
        let list = losses.list();
        assert_eq!(
            (list.len(), list[20].at.as_str(), list[20].what.as_str()),
            (21, "1 more place", "3 more of this kind: events outside")
        );
    }

    #[test]
    fn a_place_that_is_read_again_is_listed_once() {
        let mut losses = lines(2);
        losses.append(lines(2), |at| at);
        assert_eq!(losses.list().len(), 2);
    }

    #[test]
    fn parts_add_up() {
        let mut all = lines(3);
        all.append(lines(30), |at| format!("000001.npz, {at}"));
        all.append(lines(2), |at| format!("000002.npz, {at}"));
        let list = all.list();
        assert_eq!((list.len(), list[3].at.as_str()), (21, "000001.npz, line 1"));
        assert!(list[20].what.starts_with("15 more"), "35 in all: {}", list[20].what);
    }
}
