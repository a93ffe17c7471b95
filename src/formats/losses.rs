//! A list of losses that stays short, however damaged a file is.

use crate::error::Loss;

/// How many losses of one kind are named one by one.
const NAMED: u64 = 20;

/// Losses, by kind: the first twenty of a kind stand alone, then one says how many more there are.
#[derive(Clone, Debug, Default)]
pub struct Losses {
    list: Vec<Loss>,
    kinds: Vec<Kind>,
}

/// What is known of one kind.
#[derive(Clone, Debug)]
struct Kind {
    name: &'static str,
    seen: u64,
    /// Where in the list the sum of the others stands.
    sum_at: Option<usize>,
}

impl Losses {
    /// Notes a loss. `kind` says in a few words what losses of this kind are: "packets that are damaged". One that is known already is not noted again.
    pub fn add(&mut self, kind: &'static str, at: impl Into<String>, what: impl Into<String>) {
        let loss = Loss { at: at.into(), what: what.into() };
        if self.list.contains(&loss) {
            return;
        }
        let k = self.kinds.iter().position(|known| known.name == kind).unwrap_or_else(|| {
            self.kinds.push(Kind { name: kind, seen: 0, sum_at: None });
            self.kinds.len() - 1
        });
        let known = &mut self.kinds[k];
        known.seen += 1;
        if known.seen <= NAMED {
            self.list.push(loss);
            return;
        }
        let sum = Loss { at: "further on".into(), what: format!("{} more {kind}", known.seen - NAMED) };
        match known.sum_at {
            Some(at) => self.list[at] = sum,
            None => {
                known.sum_at = Some(self.list.len());
                self.list.push(sum);
            }
        }
    }

    /// All of them.
    pub fn list(&self) -> &[Loss] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twenty_first_of_a_kind_becomes_a_count() {
        let mut losses = Losses::default();
        losses.add("lines", "line 0", "other kind");
        (1..=25).for_each(|k| losses.add("packets that are damaged", format!("packet {k}"), "damaged"));
        assert_eq!(losses.list().len(), 1 + 20 + 1);
        assert_eq!(losses.list()[21], Loss { at: "further on".into(), what: "5 more packets that are damaged".into() });
    }

    #[test]
    fn a_loss_that_is_met_twice_is_noted_once() {
        let mut losses = Losses::default();
        losses.add("lines", "line 1", "cut");
        losses.add("lines", "line 1", "cut");
        assert_eq!(losses.list().len(), 1);
    }
}
