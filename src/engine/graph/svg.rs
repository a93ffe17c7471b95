//! The layered drawing as SVG: boxes with names, kinds and a note, arrows between them. Every part has a
//! class, so that a page can give it other colours.

use super::layout::{Arrow, Layout};
use super::{Drawing, colour};

const BOX_WIDTH: f64 = 170.0;
const COLUMN_GAP: f64 = 96.0;
const ROW_GAP: f64 = 18.0;
const MARGIN: f64 = 16.0;
const TITLE: f64 = 30.0;
/// A character of a line of text is so wide, about; a line has room for so many.
const LINE_CHARS: usize = 27;

/// Text that cannot be taken for markup.
fn escape(text: &str) -> String {
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

/// At most `LINE_CHARS` characters, an ellipsis for the rest.
fn cut(text: &str) -> String {
    if text.chars().count() <= LINE_CHARS {
        text.to_string()
    } else {
        text.chars().take(LINE_CHARS - 1).chain(['\u{2026}']).collect()
    }
}

/// Draws the pipeline.
pub(super) fn draw(drawing: &Drawing) -> String {
    let layout = Layout::of(drawing);
    let extra: Vec<Vec<String>> =
        drawing.nodes.iter().zip(&layout.named).map(|(node, named)| lines(&node.note, named)).collect();
    let box_height = 44.0 + 15.0 * extra.iter().map(Vec::len).max().unwrap_or(0) as f64;
    let bottom = layout.slots.iter().map(|slot| slot.y).fold(0.0, f64::max) * (box_height + ROW_GAP);
    let layers = layout.layers.max(1) as f64;
    let width = (2.0 * MARGIN + layers * BOX_WIDTH + (layers - 1.0) * COLUMN_GAP)
        .max(2.0 * MARGIN + 7.5 * drawing.title.chars().count() as f64);
    let height = 2.0 * MARGIN + TITLE + bottom + box_height;
    let places = Places { layout: &layout, box_height };

    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 \
         {width:.0} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<title>{title}</title>\n\
         <defs><marker id=\"arrow\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" \
         markerHeight=\"7\" orient=\"auto\">\
         <path class=\"head\" d=\"M0,0 L8,4 L0,8 z\" fill=\"#555\"/></marker></defs>\n\
         <rect class=\"page\" width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n<text x=\"{MARGIN}\" \
                       y=\"{y}\" font-weight=\"bold\">{title}</text>\n",
        title = escape(&drawing.title),
        y = MARGIN + 6.0,
    );
    for arrow in &layout.arrows {
        svg += &places.arrow(arrow);
    }
    for (at, node) in drawing.nodes.iter().enumerate() {
        let (left, middle) = (places.x(at), places.y(at));
        let (centre, top) = (left + BOX_WIDTH / 2.0, middle - box_height / 2.0);
        svg += &format!(
            "<g class=\"{}\"><title>{}, {}</title>",
            escape(&format!("node {}", node.state)).trim_end(),
            escape(&node.id),
            escape(&node.kind)
        );
        svg += &format!(
            "<rect class=\"box {}\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{BOX_WIDTH}\" \
             height=\"{box_height}\" rx=\"7\" fill=\"{}\" stroke=\"#555\"/>",
            escape(node.family()),
            colour(node.family())
        );
        svg += &format!(
            "<text x=\"{centre:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-weight=\"bold\">{}</text>",
            top + 19.0,
            escape(&node.id)
        );
        let below = std::iter::once(&node.kind).chain(&extra[at]);
        for (line, text) in below.enumerate() {
            let y = top + 35.0 + 15.0 * line as f64;
            svg += &format!(
                "<text class=\"soft\" x=\"{centre:.1}\" y=\"{y:.1}\" text-anchor=\"middle\" \
                 font-size=\"11\" fill=\"#444\">{}</text>",
                escape(&cut(text))
            );
        }
        svg += "</g>\n";
    }
    svg + "</svg>\n"
}

/// What stands below the kind: the note, and what the node takes that is not drawn as an arrow.
fn lines(note: &str, named: &[String]) -> Vec<String> {
    let takes = if named.is_empty() { String::new() } else { format!("+ {}", named.join(", ")) };
    [note.to_string(), takes].into_iter().filter(|line| !line.is_empty()).collect()
}

struct Places<'a> {
    layout: &'a Layout,
    box_height: f64,
}

impl Places<'_> {
    fn x(&self, at: usize) -> f64 {
        MARGIN + self.layout.slots[at].layer as f64 * (BOX_WIDTH + COLUMN_GAP)
    }

    fn y(&self, at: usize) -> f64 {
        MARGIN + TITLE + self.box_height / 2.0 + self.layout.slots[at].y * (self.box_height + ROW_GAP)
    }

    /// Arrows at one side of a box stand at different heights, in the order of where they lead.
    fn spread(&self, at: usize, neighbours: &[usize], other: usize) -> f64 {
        let mut sorted: Vec<usize> = neighbours.to_vec();
        sorted.sort_by(|a, b| self.y(*a).total_cmp(&self.y(*b)));
        let place = sorted.iter().position(|&n| n == other).unwrap_or(0) as f64 + 1.0;
        self.y(at) + self.box_height * (place / (sorted.len() as f64 + 1.0) - 0.5)
    }

    fn arrow(&self, arrow: &Arrow) -> String {
        let (route, slots) = (&arrow.route, &self.layout.slots);
        let last = route.len() - 1;
        let (mut from_x, mut from_y) =
            (self.x(route[0]) + BOX_WIDTH, self.spread(route[0], &slots[route[0]].right, route[1]));
        let mut path = format!("M{from_x:.1},{from_y:.1}");
        for (step, &slot) in route.iter().enumerate().skip(1) {
            let (to_x, to_y) = (
                self.x(slot),
                if step == last {
                    self.spread(slot, &slots[slot].left, route[step - 1])
                } else {
                    self.y(slot)
                },
            );
            let half = (from_x + to_x) / 2.0;
            path += &format!(" C{half:.1},{from_y:.1} {half:.1},{to_y:.1} {to_x:.1},{to_y:.1}");
            (from_x, from_y) = (to_x, to_y);
            if step != last {
                from_x += BOX_WIDTH;
                path += &format!(" L{from_x:.1},{from_y:.1}");
            }
        }
        let label = escape(&arrow.label);
        let mut svg = format!(
            "<path class=\"wire\" d=\"{path}\" fill=\"none\" stroke=\"#555\" \
                               marker-end=\"url(#arrow)\"><title>{label}</title></path>"
        );
        if arrow.is_labelled {
            let (x, y) = (from_x - 10.0, from_y - 4.0);
            svg += &format!(
                "<text class=\"soft\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"end\" \
                             font-size=\"10\" fill=\"#333\">{label}</text>"
            );
        }
        svg + "\n"
    }
}
