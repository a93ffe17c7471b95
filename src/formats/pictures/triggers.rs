//! Edges of a trigger line as pulses: the times at which frames were exposed.
//!
//! One edge opens the shutter and the other closes it ([`Strobe`]). A pulse of which one edge is missing
//! keeps its place in the order, since its frame may be there, and has no exposure. A line with edges of one
//! kind alone has stamps without a length.

use crate::chunk::{Edge, Trigger};
use crate::declared::Strobe;

/// A pulse of a trigger line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// When it opened, ns; of a pulse whose opening edge is missing, the usual length before it closed.
    pub at: i64,
    /// Start and end of the exposure; none of a pulse of which one edge is missing, and on a line with edges
    /// of one kind.
    pub exposure: Option<(i64, i64)>,
    /// Are all of its edges there?
    pub is_whole: bool,
}

/// The pulses of a line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pulses {
    /// In file order.
    pub all: Vec<Pulse>,
    /// Has the line edges of both kinds?
    pub has_both: bool,
    /// What was missing or spurious.
    pub notes: Vec<String>,
}

impl Pulses {
    /// How many have all their edges.
    pub fn whole(&self) -> usize {
        self.all.iter().filter(|pulse| pulse.is_whole).count()
    }
}

/// Of so many edges of one kind, one of the other kind is spurious.
const RARE: usize = 20;

/// Pairs the edges of a line: its pulses in file order, and what was missing or spurious.
///
/// Two opening edges in a row mean that a closing one is missing, and the other way round. An edge that
/// repeats within a hundredth of the usual period (and at most 50 us) is spurious: a contact that bounced.
/// Edges of the other kind that are fewer than one in twenty are spurious too.
pub fn pulses(triggers: &[Trigger], line: u16, strobe: Strobe) -> Pulses {
    let edges: Vec<&Trigger> = triggers.iter().filter(|trigger| trigger.line == line).collect();
    if edges.is_empty() {
        let mut lines: Vec<u16> = triggers.iter().map(|trigger| trigger.line).collect();
        lines.sort_unstable();
        lines.dedup();
        let note = format!(
            "trigger line {line} has no edges; lines with edges: {}",
            if lines.is_empty() { "none".into() } else { format!("{lines:?}") }
        );
        return Pulses { notes: vec![note], ..Pulses::default() };
    }
    let (edges, bounce, spurious) = without_bounces(edges);
    let rising = edges.iter().filter(|edge| edge.edge == Edge::Rising).count();
    let falling = edges.len() - rising;
    let mut pulses = if rising.min(falling) * RARE < rising.max(falling) {
        of_one_kind(&edges, line, rising, falling)
    } else {
        paired(&edges, line, strobe)
    };
    pulses.notes.extend(bounced(&spurious, line, bounce));
    pulses
}

/// Pulses of a line with edges of one kind: stamps without a length.
fn of_one_kind(edges: &[&Trigger], line: u16, rising: usize, falling: usize) -> Pulses {
    let (kind, name, other) =
        if rising > falling { (Edge::Rising, "rising", falling) } else { (Edge::Falling, "falling", rising) };
    let but =
        if other > 0 { format!(", but for {other} that were left out as spurious") } else { String::new() };
    let note = format!(
        "line {line} has {name} edges only{but}: one for each frame, without the length of its exposure"
    );
    let all = edges
        .iter()
        .filter(|edge| edge.edge == kind)
        .map(|edge| Pulse { at: edge.t, exposure: None, is_whole: true })
        .collect();
    Pulses { all, has_both: false, notes: vec![note] }
}

/// Pulses of a line whose edges open and close the shutter.
fn paired(edges: &[&Trigger], line: u16, strobe: Strobe) -> Pulses {
    let mut notes = Vec::new();
    let opens = if strobe == Strobe::ActiveHigh { Edge::Rising } else { Edge::Falling };
    let (opening, closing) =
        if strobe == Strobe::ActiveHigh { ("rising", "falling") } else { ("falling", "rising") };
    let mut all: Vec<Pulse> = Vec::new();
    let mut unopened: Vec<usize> = Vec::new();
    let mut open: Option<i64> = None;
    let (mut no_close, mut no_open, mut first_odd) = (0_u64, 0_u64, None);
    let broken = |at: i64| Pulse { at, exposure: None, is_whole: false };
    for (n, edge) in edges.iter().enumerate() {
        match (edge.edge == opens, open) {
            (true, None) => open = Some(edge.t),
            (true, Some(start)) => {
                no_close += 1;
                first_odd.get_or_insert(edge.t);
                all.push(broken(start));
                open = Some(edge.t);
            }
            (false, Some(start)) if start <= edge.t => {
                all.push(Pulse { at: start, exposure: Some((start, edge.t)), is_whole: true });
                open = None;
            }
            (false, _) => {
                // Before the first opening edge the recording began inside an exposure: nothing is missing
                // then.
                if n > 0 {
                    no_open += 1;
                    first_odd.get_or_insert(edge.t);
                } else {
                    notes.push(format!(
                        "the first edge of line {line} is a {closing} one: the recording \
                                        begins inside an exposure, which was left out"
                    ));
                }
                unopened.push(all.len());
                all.push(broken(edge.t));
                open = None;
            }
        }
    }
    if let Some(start) = open {
        notes.push(format!(
            "the last edge of line {line} is a {opening} one: the recording ends inside an \
                            exposure, which was left out"
        ));
        all.push(broken(start));
    }
    let mut lengths: Vec<i64> =
        all.iter().filter_map(|pulse| pulse.exposure).map(|(start, end)| end.saturating_sub(start)).collect();
    lengths.sort_unstable();
    let usual = lengths.get(lengths.len() / 2).copied().unwrap_or(0);
    unopened.into_iter().for_each(|n| all[n].at = all[n].at.saturating_sub(usual));
    let place = first_odd.map(|t| format!(" (the first at {t} ns)")).unwrap_or_default();
    if no_close > 0 {
        notes.push(format!(
            "{no_close} {closing} edges of line {line} are missing{place}; these exposures were left out"
        ));
    }
    if no_open > 0 {
        notes.push(format!(
            "{no_open} {opening} edges of line {line} are missing{place}; these exposures were left out"
        ));
    }
    Pulses { all, has_both: true, notes }
}

fn bounced(spurious: &[i64], line: u16, bounce: i64) -> Option<String> {
    let first = spurious.first()?;
    Some(format!(
        "{} edges of line {line} repeat within {bounce} ns and were left out as spurious (the \
                  first at {first} ns)",
        spurious.len()
    ))
}

/// Edges without those that repeat too soon, how soon that is (ns), and the times of those.
fn without_bounces(edges: Vec<&Trigger>) -> (Vec<&Trigger>, i64, Vec<i64>) {
    let bounce = bounce(&edges);
    let (mut kept, mut spurious): (Vec<&Trigger>, Vec<i64>) = (Vec::with_capacity(edges.len()), Vec::new());
    for edge in edges {
        match kept.last() {
            Some(before)
                if before.edge == edge.edge && edge.t.abs_diff(before.t) <= bounce.unsigned_abs() =>
            {
                spurious.push(edge.t)
            }
            _ => kept.push(edge),
        }
    }
    (kept, bounce, spurious)
}

/// How soon an edge of the same direction cannot be another exposure, ns.
fn bounce(edges: &[&Trigger]) -> i64 {
    let of =
        |kind: Edge| edges.iter().filter(|edge| edge.edge == kind).map(|edge| edge.t).collect::<Vec<i64>>();
    let (rising, falling) = (of(Edge::Rising), of(Edge::Falling));
    let beats = if rising.len() < falling.len() { falling } else { rising };
    let mut steps: Vec<i64> =
        beats.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).filter(|step| *step > 0).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).map_or(0, |period| (period / 100).min(50_000))
}
