//! Edges of a trigger line as exposures of frames: a rising edge opens the shutter, a falling one closes it.

use crate::chunk::{Edge, Trigger};

/// Pairs the edges of a line: `(open, close)` of every whole exposure in file order, and what was missing or spurious.
///
/// Two rising edges in a row mean that a falling one is missing, and the other way round; the exposure between is left out, since its length is not
/// known. An edge that repeats within a hundredth of the usual period (and at most 50 us) is spurious: a contact that bounced.
pub fn exposures_from_triggers(triggers: &[Trigger], line: u16) -> (Vec<(i64, i64)>, Vec<String>) {
    let edges: Vec<&Trigger> = triggers.iter().filter(|trigger| trigger.line == line).collect();
    let mut notes = Vec::new();
    if edges.is_empty() {
        let mut lines: Vec<u16> = triggers.iter().map(|trigger| trigger.line).collect();
        lines.sort_unstable();
        lines.dedup();
        notes.push(format!("trigger line {line} has no edges; lines with edges: {}", if lines.is_empty() { "none".into() } else { format!("{lines:?}") }));
        return (Vec::new(), notes);
    }
    let bounce = bounce(&edges);
    let mut exposures: Vec<(i64, i64)> = Vec::new();
    let (mut open, mut last): (Option<i64>, Option<&Trigger>) = (None, None);
    let (mut spurious, mut no_close, mut no_open, mut first_odd) = (0_u64, 0_u64, 0_u64, None);
    for edge in edges {
        if let Some(before) = last
            && before.edge == edge.edge
            && edge.t.abs_diff(before.t) <= bounce.unsigned_abs()
        {
            spurious += 1;
            first_odd.get_or_insert(edge.t);
            continue;
        }
        match (edge.edge, open) {
            (Edge::Rising, None) => open = Some(edge.t),
            (Edge::Rising, Some(_)) => {
                no_close += 1;
                first_odd.get_or_insert(edge.t);
                open = Some(edge.t);
            }
            (Edge::Falling, Some(start)) if start <= edge.t => {
                exposures.push((start, edge.t));
                open = None;
            }
            (Edge::Falling, _) => {
                // Before the first rising edge the recording began inside an exposure: nothing is missing then.
                if last.is_some() {
                    no_open += 1;
                    first_odd.get_or_insert(edge.t);
                } else {
                    notes.push(format!("the first edge of line {line} is a falling one: the recording begins inside an exposure, which was left out"));
                }
                open = None;
            }
        }
        last = Some(edge);
    }
    if open.is_some() {
        notes.push(format!("the last edge of line {line} is a rising one: the recording ends inside an exposure, which was left out"));
    }
    let place = first_odd.map(|t| format!(" (the first at {t} ns)")).unwrap_or_default();
    if no_close > 0 {
        notes.push(format!("{no_close} falling edges of line {line} are missing{place}; these exposures were left out"));
    }
    if no_open > 0 {
        notes.push(format!("{no_open} rising edges of line {line} are missing{place}; these exposures were left out"));
    }
    if spurious > 0 {
        notes.push(format!("{spurious} edges of line {line} repeat within {bounce} ns and were left out as spurious{place}"));
    }
    (exposures, notes)
}

/// How soon an edge of the same direction cannot be another exposure, ns.
fn bounce(edges: &[&Trigger]) -> i64 {
    let rising: Vec<i64> = edges.iter().filter(|edge| edge.edge == Edge::Rising).map(|edge| edge.t).collect();
    let mut steps: Vec<i64> = rising.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).filter(|step| *step > 0).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).map_or(0, |period| (period / 100).min(50_000))
}
