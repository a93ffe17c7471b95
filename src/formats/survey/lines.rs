//! Trigger lines: do edges come in pairs, and at even times?
//!
//! A line that follows a shutter goes up and down in turn. Two edges of one kind in a row mean that one was
//! missed; a pair that is far from the usual period means that a whole pulse was.

use super::pictures::Spread;
use crate::chunk::{Edge, Trigger};
use serde::Serialize;
use std::collections::BTreeMap;

/// One trigger line.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LineSurvey {
    /// Its number in the file.
    pub line: u16,
    /// Edges up.
    pub rising: u64,
    /// Edges down.
    pub falling: u64,
    /// Edges that follow one of their own kind, where the line has both kinds.
    pub unpaired: u64,
    /// Times from one rising edge to the next (falling ones, on a line without rising ones).
    pub period: Option<Spread>,
    /// Times from a rising edge to the falling one after it.
    pub high: Option<Spread>,
    /// Periods of more than one and a half times the middle one.
    pub gaps: u64,
    /// First and last edge, ns.
    pub span_ns: (i64, i64),
}

/// Every line that has an edge, by number.
pub fn survey(triggers: &[Trigger]) -> Vec<LineSurvey> {
    let mut lines: BTreeMap<u16, Vec<Trigger>> = BTreeMap::new();
    triggers.iter().for_each(|trigger| lines.entry(trigger.line).or_default().push(*trigger));
    lines.into_iter().map(|(line, edges)| one(line, edges)).collect()
}

fn one(line: u16, mut edges: Vec<Trigger>) -> LineSurvey {
    edges.sort_by_key(|trigger| trigger.t);
    let of = |edge: Edge| {
        edges.iter().filter(|trigger| trigger.edge == edge).map(|trigger| trigger.t).collect::<Vec<i64>>()
    };
    let (rising, falling) = (of(Edge::Rising), of(Edge::Falling));
    let beats = if rising.is_empty() { &falling } else { &rising };
    let periods: Vec<i64> = beats.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    let period = Spread::of(periods.clone());
    let usual = period.map_or(i64::MAX, |period| period.median_ns) as f64;
    let has_both = !rising.is_empty() && !falling.is_empty();
    let highs = edges
        .windows(2)
        .filter(|pair| (pair[0].edge, pair[1].edge) == (Edge::Rising, Edge::Falling))
        .map(|pair| pair[1].t.saturating_sub(pair[0].t));
    LineSurvey {
        line,
        rising: rising.len() as u64,
        falling: falling.len() as u64,
        unpaired: if has_both {
            edges.windows(2).filter(|pair| pair[0].edge == pair[1].edge).count() as u64
        } else {
            0
        },
        period,
        high: Spread::of(highs.collect()),
        gaps: periods.iter().filter(|period| **period as f64 > 1.5 * usual).count() as u64,
        span_ns: (edges.first().map_or(0, |edge| edge.t), edges.last().map_or(0, |edge| edge.t)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_edge_and_a_missed_pulse_show() {
        let mut edges: Vec<Trigger> = (0..10)
            .flat_map(|k| [(k * 100, Edge::Rising), (k * 100 + 20, Edge::Falling)])
            .map(|(t, edge)| Trigger { t, line: 3, edge })
            .collect();
        assert_eq!(survey(&edges)[0].unpaired, 0);
        edges.drain(10..12);
        edges.remove(3);
        let found = &survey(&edges)[0];
        assert_eq!((found.line, found.rising, found.falling, found.unpaired, found.gaps), (3, 9, 8, 1, 1));
        assert_eq!((found.period.unwrap().median_ns, found.high.unwrap().max_ns), (100, 20));
    }
}
