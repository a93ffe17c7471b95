//! A layered drawing as SVG: columns from left to right, boxes in a column ordered so that few arrows cross.
//!
//! The layout is the simple form of Sugiyama's: the layer of a node is its longest way from a source, and a few sweeps put every box
//! near the middle of its neighbours. A long arrow is routed through an empty slot in every column it passes, so that it does not
//! run behind boxes. Pipelines have tens of nodes; nothing here is meant for thousands.

use super::{Edge, Model, colour};

const BOX_WIDTH: f64 = 170.0;
const BOX_HEIGHT: f64 = 44.0;
const COLUMN_GAP: f64 = 130.0;
const ROW_GAP: f64 = 26.0;
const MARGIN: f64 = 24.0;
const TITLE: f64 = 30.0;

/// Text that cannot be taken for markup.
pub(super) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Control characters are not allowed in XML at all.
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

/// A box, or the place where a long arrow passes a column.
struct Slot {
    layer: usize,
    /// Places in `slots` of the neighbours to the left and to the right.
    left: Vec<usize>,
    right: Vec<usize>,
    y: f64,
}

struct Layout {
    /// The first ones are the nodes, in their order.
    slots: Vec<Slot>,
    /// For each edge, the slots it runs through, ends included.
    routes: Vec<Vec<usize>>,
}

fn lay_out(model: &Model) -> Layout {
    let mut slots: Vec<Slot> = model.nodes.iter().map(|node| Slot { layer: node.layer, left: Vec::new(), right: Vec::new(), y: 0.0 }).collect();
    let mut routes = Vec::new();
    for edge in &model.edges {
        let mut route = vec![edge.from];
        for layer in model.nodes[edge.from].layer + 1..model.nodes[edge.to].layer {
            slots.push(Slot { layer, left: Vec::new(), right: Vec::new(), y: 0.0 });
            route.push(slots.len() - 1);
        }
        route.push(edge.to);
        for pair in route.windows(2) {
            slots[pair[0]].right.push(pair[1]);
            slots[pair[1]].left.push(pair[0]);
        }
        routes.push(route);
    }
    let layers = slots.iter().map(|slot| slot.layer + 1).max().unwrap_or(0);
    let mut columns: Vec<Vec<usize>> = (0..layers).map(|layer| (0..slots.len()).filter(|&at| slots[at].layer == layer).collect()).collect();
    for sweep in 0..8 {
        let forward = sweep % 2 == 0;
        for step in 0..layers {
            let column = &mut columns[if forward { step } else { layers - 1 - step }];
            order(column, &mut slots, forward);
        }
    }
    Layout { slots, routes }
}

/// Sorts a column by the middle of its neighbours on one side, and spaces it evenly around zero.
fn order(column: &mut [usize], slots: &mut [Slot], from_left: bool) {
    let middle = |at: usize| {
        let neighbours = if from_left { &slots[at].left } else { &slots[at].right };
        // What has no neighbour on this side stays where it is.
        if neighbours.is_empty() { slots[at].y } else { neighbours.iter().map(|&n| slots[n].y).sum::<f64>() / neighbours.len() as f64 }
    };
    let mut keyed: Vec<(f64, usize)> = column.iter().map(|&at| (middle(at), at)).collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let top = -(keyed.len() as f64 - 1.0) / 2.0;
    for (place, (_, at)) in keyed.into_iter().enumerate() {
        column[place] = at;
        slots[at].y = (top + place as f64) * (BOX_HEIGHT + ROW_GAP);
    }
}

/// Draws the model.
pub(super) fn draw(model: &Model) -> String {
    let layout = lay_out(model);
    let layers = layout.slots.iter().map(|slot| slot.layer + 1).max().unwrap_or(1) as f64;
    let top = layout.slots.iter().map(|slot| slot.y).fold(0.0, f64::min);
    let bottom = layout.slots.iter().map(|slot| slot.y).fold(0.0, f64::max);
    let width = (2.0 * MARGIN + layers * BOX_WIDTH + (layers - 1.0) * COLUMN_GAP).max(2.0 * MARGIN + 7.5 * model.title.chars().count() as f64);
    let height = 2.0 * MARGIN + TITLE + bottom - top + BOX_HEIGHT;
    let x = |at: usize| MARGIN + layout.slots[at].layer as f64 * (BOX_WIDTH + COLUMN_GAP);
    let y = |at: usize| MARGIN + TITLE + BOX_HEIGHT / 2.0 + layout.slots[at].y - top;

    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<title>{title}</title>\n\
         <defs><marker id=\"arrow\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\">\
         <path d=\"M0,0 L8,4 L0,8 z\" fill=\"#555\"/></marker></defs>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n<text x=\"{MARGIN}\" y=\"{MARGIN}\" font-weight=\"bold\">{title}</text>\n",
        title = escape(&model.title)
    );
    for (at, (edge, route)) in model.edges.iter().zip(&layout.routes).enumerate() {
        // Several arrows may join the same two boxes directly: each gets a place of its own.
        let twin = layout.routes[..at].iter().filter(|other| *other == route).count();
        svg += &arrow(edge, route, twin, &x, &y, &layout);
    }
    for (at, node) in model.nodes.iter().enumerate() {
        let (left, middle) = (x(at), y(at));
        svg += &format!(
            "<g><rect x=\"{left:.1}\" y=\"{:.1}\" width=\"{BOX_WIDTH}\" height=\"{BOX_HEIGHT}\" rx=\"7\" fill=\"{}\" stroke=\"#555\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-weight=\"bold\">{}</text>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"11\" fill=\"#444\">{}</text></g>\n",
            middle - BOX_HEIGHT / 2.0,
            colour(node.family()),
            left + BOX_WIDTH / 2.0,
            middle - 3.0,
            escape(&node.id),
            left + BOX_WIDTH / 2.0,
            middle + 13.0,
            escape(node.kind),
        );
    }
    svg + "</svg>\n"
}

fn arrow(edge: &Edge, route: &[usize], twin: usize, x: &dyn Fn(usize) -> f64, y: &dyn Fn(usize) -> f64, layout: &Layout) -> String {
    // Arrows that end at one box end at different heights, so that their labels can be told apart.
    let spread = |at: usize, neighbours: &[usize], other: usize| {
        let mut sorted: Vec<usize> = neighbours.to_vec();
        sorted.sort_by(|a, b| y(*a).total_cmp(&y(*b)));
        let place = (sorted.iter().position(|&n| n == other).unwrap_or(0) + twin) as f64 + 1.0;
        y(at) + BOX_HEIGHT * (place / (sorted.len() as f64 + 1.0) - 0.5)
    };
    let last = route.len() - 1;
    let (mut from_x, mut from_y) = (x(route[0]) + BOX_WIDTH, spread(route[0], &layout.slots[route[0]].right, route[1]));
    let mut path = format!("M{from_x:.1},{from_y:.1}");
    for (step, &slot) in route.iter().enumerate().skip(1) {
        let (to_x, to_y) = (x(slot), if step == last { spread(slot, &layout.slots[slot].left, route[step - 1]) } else { y(slot) });
        let half = (from_x + to_x) / 2.0;
        path += &format!(" C{half:.1},{from_y:.1} {half:.1},{to_y:.1} {to_x:.1},{to_y:.1}");
        (from_x, from_y) = (to_x, to_y);
        if step != last {
            from_x += BOX_WIDTH;
            path += &format!(" L{from_x:.1},{from_y:.1}");
        }
    }
    let (label_x, label_y) = (from_x - 10.0, from_y - 4.0);
    format!(
        "<path d=\"{path}\" fill=\"none\" stroke=\"#555\" marker-end=\"url(#arrow)\"/>\
         <text x=\"{label_x:.1}\" y=\"{label_y:.1}\" text-anchor=\"end\" font-size=\"10\" fill=\"#333\">{}</text>\n",
        escape(&edge.label())
    )
}
