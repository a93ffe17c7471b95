//! Where boxes and arrows stand: columns from left to right, boxes in a column ordered so that few arrows
//! cross.
//!
//! The layout is the simple form of Sugiyama's: the layer of a node is its longest way from a source; sweeps
//! put every box near the middle of its neighbours, neighbours in a column change places while that takes
//! crossings away, and the order with the fewest crossings is kept. A long arrow is routed through an empty
//! slot in every column it passes, so that it does not run behind boxes. Arrows between the same two boxes
//! are one, with all their names. What nearly every box takes (the sensor description, the truth) is written
//! into the boxes instead of drawn. Pipelines have tens of nodes; nothing here is meant for thousands.

use super::{Drawing, Edge};
use std::collections::BTreeMap;

/// Sweeps from left to right and back.
const SWEEPS: usize = 24;
/// From so many takers on, an output of such a type is named in their boxes.
const MANY: usize = 3;
const NAMED: [&str; 2] = ["sensor", "truth"];

/// An arrow between two boxes.
pub(super) struct Arrow {
    /// Names of ports and both ends.
    pub label: String,
    /// Is the label needed to know what flows?
    pub is_labelled: bool,
    /// The slots it runs through, ends included.
    pub route: Vec<usize>,
}

/// A box, or the place where a long arrow passes a column.
pub(super) struct Slot {
    /// Its column.
    pub layer: usize,
    /// Its middle in rows, from the top; rows are one apart.
    pub y: f64,
    /// Places of the neighbours to the left and to the right.
    pub left: Vec<usize>,
    /// As `left`.
    pub right: Vec<usize>,
}

pub(super) struct Layout {
    /// The first ones are the nodes, in their order.
    pub slots: Vec<Slot>,
    pub arrows: Vec<Arrow>,
    /// For each node, the outputs that its box names.
    pub named: Vec<Vec<String>>,
    pub layers: usize,
}

impl Layout {
    pub(super) fn of(drawing: &Drawing) -> Layout {
        let takers = |from: usize, port: &str| {
            drawing.edges.iter().filter(|edge| edge.from == from && edge.from_port == port).count()
        };
        let is_named = |edge: &Edge| {
            NAMED.contains(&edge.data_type.as_str()) && takers(edge.from, &edge.from_port) >= MANY
        };
        let layers = drawing.layers(|edge| !is_named(edge));
        let ports = |from: usize| {
            let mut ports: Vec<&str> = drawing
                .edges
                .iter()
                .filter(|edge| edge.from == from)
                .map(|edge| edge.from_port.as_str())
                .collect();
            ports.sort_unstable();
            ports.dedup();
            ports.len()
        };
        let mut named = vec![Vec::new(); drawing.nodes.len()];
        let mut joined: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
        for edge in &drawing.edges {
            if is_named(edge) {
                let id = &drawing.nodes[edge.from].id;
                named[edge.to].push(if *id == edge.from_port || ports(edge.from) == 1 {
                    id.clone()
                } else {
                    format!("{id}.{}", edge.from_port)
                });
            } else {
                joined.entry((edge.from, edge.to)).or_default().push(edge.label());
            }
        }
        let mut slots: Vec<Slot> =
            layers.iter().map(|&layer| Slot { layer, y: 0.0, left: Vec::new(), right: Vec::new() }).collect();
        let mut arrows = Vec::new();
        for ((from, to), labels) in joined {
            let mut route = vec![from];
            for layer in layers[from] + 1..layers[to] {
                slots.push(Slot { layer, y: 0.0, left: Vec::new(), right: Vec::new() });
                route.push(slots.len() - 1);
            }
            route.push(to);
            for pair in route.windows(2) {
                slots[pair[0]].right.push(pair[1]);
                slots[pair[1]].left.push(pair[0]);
            }
            arrows.push(Arrow { label: labels.join(", "), is_labelled: ports(from) > 1, route });
        }
        let count = slots.iter().map(|slot| slot.layer + 1).max().unwrap_or(0);
        let mut columns: Vec<Vec<usize>> = (0..count)
            .map(|layer| (0..slots.len()).filter(|&at| slots[at].layer == layer).collect())
            .collect();
        order(&mut columns, &mut slots);
        place(&columns, &mut slots);
        Layout { slots, arrows, named, layers: count }
    }

    /// How often arrows cross between columns.
    #[cfg(test)]
    pub fn crossings(&self) -> usize {
        let mut columns: Vec<Vec<usize>> = (0..self.layers)
            .map(|layer| (0..self.slots.len()).filter(|&at| self.slots[at].layer == layer).collect())
            .collect();
        columns
            .iter_mut()
            .for_each(|column| column.sort_by(|&a, &b| self.slots[a].y.total_cmp(&self.slots[b].y)));
        crossings(&columns, &self.slots)
    }
}

/// Puts every column into the order found with the fewest crossings.
fn order(columns: &mut Vec<Vec<usize>>, slots: &mut [Slot]) {
    let number = |columns: &[Vec<usize>], slots: &mut [Slot]| {
        columns.iter().for_each(|column| {
            column
                .iter()
                .enumerate()
                .for_each(|(row, &at)| slots[at].y = row as f64 - 0.5 * column.len() as f64)
        });
    };
    number(columns, slots);
    let mut best = (crossings(columns, slots), columns.clone());
    for sweep in 0..SWEEPS {
        let forward = sweep % 2 == 0;
        for step in 0..columns.len() {
            let column = if forward { step } else { columns.len() - 1 - step };
            let middle = |at: usize| {
                let neighbours = if forward { &slots[at].left } else { &slots[at].right };
                // What has no neighbour on this side stays where it is.
                if neighbours.is_empty() {
                    slots[at].y
                } else {
                    neighbours.iter().map(|&n| slots[n].y).sum::<f64>() / neighbours.len() as f64
                }
            };
            let mut keyed: Vec<(f64, usize)> = columns[column].iter().map(|&at| (middle(at), at)).collect();
            keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
            columns[column] = keyed.into_iter().map(|(_, at)| at).collect();
            number(&columns[column..=column], slots);
        }
        swap_neighbours(columns, slots);
        number(columns, slots);
        let found = crossings(columns, slots);
        if found < best.0 {
            best = (found, columns.clone());
        }
    }
    *columns = best.1;
}

/// Lets neighbours in a column change places as long as that takes crossings away.
fn swap_neighbours(columns: &mut [Vec<usize>], slots: &[Slot]) {
    let rows = |columns: &[Vec<usize>]| {
        let mut rows = vec![0; slots.len()];
        columns.iter().for_each(|column| column.iter().enumerate().for_each(|(row, &at)| rows[at] = row));
        rows
    };
    loop {
        let mut is_better = false;
        for c in 0..columns.len() {
            for r in 1..columns[c].len() {
                let (upper, lower) = (columns[c][r - 1], columns[c][r]);
                let rows = rows(columns);
                let cross = |a: &[usize], b: &[usize]| {
                    a.iter().map(|&i| b.iter().filter(|&&j| rows[i] > rows[j]).count()).sum::<usize>()
                };
                let count = |a: usize, b: usize| {
                    cross(&slots[a].left, &slots[b].left) + cross(&slots[a].right, &slots[b].right)
                };
                if count(lower, upper) < count(upper, lower) {
                    columns[c].swap(r - 1, r);
                    is_better = true;
                }
            }
        }
        if !is_better {
            return;
        }
    }
}

fn crossings(columns: &[Vec<usize>], slots: &[Slot]) -> usize {
    let mut rows = vec![0; slots.len()];
    columns.iter().for_each(|column| column.iter().enumerate().for_each(|(row, &at)| rows[at] = row));
    let between = |column: &Vec<usize>| {
        let arrows: Vec<(usize, usize)> = column
            .iter()
            .flat_map(|&from| slots[from].right.iter().map(move |&to| (from, to)))
            .map(|(a, b)| (rows[a], rows[b]))
            .collect();
        let crossing = |(i, one): (usize, &(usize, usize))| {
            arrows[i + 1..]
                .iter()
                .filter(|two| (one.0 < two.0 && one.1 > two.1) || (one.0 > two.0 && one.1 < two.1))
                .count()
        };
        arrows.iter().enumerate().map(crossing).sum::<usize>()
    };
    columns.iter().map(between).sum()
}

/// Heights: every slot as near to the middle of all its neighbours as the slots above and below it allow.
fn place(columns: &[Vec<usize>], slots: &mut [Slot]) {
    columns.iter().for_each(|column| {
        column
            .iter()
            .enumerate()
            .for_each(|(row, &at)| slots[at].y = row as f64 - 0.5 * (column.len() as f64 - 1.0))
    });
    for _ in 0..SWEEPS {
        for column in columns {
            let wish = |at: usize| {
                let all = slots[at].left.iter().chain(&slots[at].right);
                let count = slots[at].left.len() + slots[at].right.len();
                if count == 0 { slots[at].y } else { all.map(|&n| slots[n].y).sum::<f64>() / count as f64 }
            };
            let wishes: Vec<f64> = column.iter().map(|&at| wish(at)).collect();
            for (&at, y) in column.iter().zip(spaced(&wishes)) {
                slots[at].y = y;
            }
        }
    }
    let top = slots.iter().map(|slot| slot.y).fold(f64::INFINITY, f64::min);
    slots.iter_mut().for_each(|slot| slot.y -= top);
}

/// The nearest numbers to `wishes` (least squares) that keep their order and lie one or more apart: pooled
/// where they would come closer.
fn spaced(wishes: &[f64]) -> Vec<f64> {
    // Each number less its place must not fall: pools of neighbours share their mean.
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for (row, wish) in wishes.iter().enumerate() {
        let mut pool = (wish - row as f64, 1);
        while let Some(&(mean, count)) = pools.last().filter(|(mean, _)| *mean > pool.0) {
            pools.pop();
            pool = ((mean * count as f64 + pool.0 * pool.1 as f64) / (count + pool.1) as f64, count + pool.1);
        }
        pools.push(pool);
    }
    let values = pools.into_iter().flat_map(|(mean, count)| std::iter::repeat_n(mean, count));
    values.enumerate().map(|(row, value)| value + row as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Node;
    use super::*;

    fn drawing(nodes: usize, edges: &[(usize, usize, &str)]) -> Drawing {
        let node = |at: usize| Node { id: format!("n{at}"), kind: "read/x".into(), ..Node::default() };
        let edge = |&(from, to, name): &(usize, usize, &str)| Edge {
            from,
            from_port: name.into(),
            to,
            to_port: name.into(),
            data_type: name.into(),
        };
        Drawing {
            title: String::new(),
            nodes: (0..nodes).map(node).collect(),
            edges: edges.iter().map(edge).collect(),
        }
    }

    #[test]
    fn a_ladder_that_can_be_drawn_without_crossings_is() {
        // Three rails written in another order each time: 0 -> 3 -> 8, 1 -> 5 -> 6, 2 -> 4 -> 7.
        let ladder =
            drawing(9, &[(0, 3, "a"), (1, 5, "a"), (2, 4, "a"), (3, 8, "a"), (4, 7, "a"), (5, 6, "a")]);
        assert_eq!(Layout::of(&ladder).crossings(), 0);
    }

    #[test]
    fn what_nearly_all_take_is_named_in_their_boxes_and_the_rest_is_drawn() {
        let layout = Layout::of(&drawing(
            4,
            &[(0, 1, "sensor"), (0, 2, "sensor"), (0, 3, "sensor"), (1, 2, "frames"), (1, 2, "events")],
        ));
        assert_eq!(
            layout.named,
            [vec![], vec!["n0".to_string()], vec!["n0".to_string()], vec!["n0".to_string()]]
        );
        assert_eq!(
            layout.arrows.iter().map(|arrow| arrow.label.as_str()).collect::<Vec<_>>(),
            ["frames, events"]
        );
    }

    #[test]
    fn spacing_keeps_order_and_distance_and_moves_no_more_than_it_must() {
        assert_eq!(spaced(&[0.0, 5.0, 9.0]), [0.0, 5.0, 9.0]);
        assert_eq!(spaced(&[2.0, 2.0, 2.0]), [1.0, 2.0, 3.0]);
        assert_eq!(spaced(&[]), [0.0; 0]);
    }
}
