//! What the report of a run is made of.

use serde::Serialize;

/// The report of one run or of several.
#[derive(Clone, Debug, Default)]
pub struct RunPage {
    /// Heading.
    pub title: String,
    /// What the pipelines are for, in their own words.
    pub about: Vec<String>,
    /// Facts in one line each: name and text.
    pub facts: Vec<(String, String)>,
    /// Nodes that failed or were skipped, in whole sentences.
    pub failures: Vec<String>,
    /// Bounds on scores, what is broken first.
    pub bounds: Vec<BoundRow>,
    /// Tables of scores.
    pub verdicts: Vec<Verdict>,
    /// Sequences that show the same scene.
    pub groups: Vec<Group>,
    /// What was left out of the pictures to keep the budget, or why there are none; in whole sentences.
    pub picture_notes: Vec<String>,
    /// Scores over time.
    pub curves: Vec<Panel>,
    /// Do the curves have a glitch score?
    pub has_glitch: bool,
    /// Edge profiles, widths over a parameter.
    pub edges: Vec<Panel>,
    /// Why there are no edges, or fewer, and how to get them.
    pub edge_notes: Vec<String>,
    /// Pixels of the first group of which more is known than pictures show.
    pub pixels: Vec<Pixel>,
    /// What is missing for the probe and how to get it, in whole sentences.
    pub pixel_notes: Vec<String>,
    /// The pipelines.
    pub graphs: Vec<Graph>,
    /// A diagnosis that was part of the run, as HTML; empty where there was none.
    pub diagnosis: String,
    /// What is suspicious about the data, and what nodes said.
    pub hazards: Vec<Hazard>,
    /// Names and texts that say where the numbers come from.
    pub provenance: Vec<(String, String)>,
    /// How the numbers were measured.
    pub cards: Vec<Card>,
}

/// What a cell is among those that it compares with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Nothing special.
    Plain,
    /// The best.
    Best,
    /// The second of three or more.
    Second,
    /// No number: it failed, or was not run.
    Missing,
}

/// How a score came out that has a bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoundMark {
    /// Inside.
    Pass,
    /// Inside, and near enough for a warning.
    Warn,
    /// Outside, or not measured.
    Fail,
    /// The run has no result of its node.
    Unchecked,
}

/// A bound on a score.
#[derive(Clone, Debug, PartialEq)]
pub struct BoundRow {
    /// Which score.
    pub name: String,
    /// What was measured, with its unit.
    pub measured: String,
    /// `at least 35`; empty without one.
    pub bound: String,
    /// Where a warning begins, `below 36`; empty without one.
    pub warning: String,
    /// How it came out.
    pub mark: BoundMark,
}

/// A cell of a verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The number as text, or why there is none.
    pub text: String,
    /// How it is marked.
    pub mark: Mark,
    /// The whole reason, or all digits.
    pub title: String,
}

/// A row of a verdict: names, then numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct VerdictRow {
    /// Levels of the row.
    pub names: Vec<String>,
    /// One for each column.
    pub cells: Vec<Cell>,
}

/// A text that a button copies.
#[derive(Clone, Debug, PartialEq)]
pub struct Copy {
    /// `Markdown`.
    pub name: String,
    /// The text.
    pub text: String,
}

/// A table of scores.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// What it shows.
    pub caption: String,
    /// Headings of the names.
    pub names: Vec<String>,
    /// Headings of the numbers.
    pub columns: Vec<String>,
    /// The rows.
    pub rows: Vec<VerdictRow>,
    /// The same table in other forms.
    pub copies: Vec<Copy>,
}

/// Sequences that show the same scene with the same number of pixels, at common instants.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Group {
    /// Its name.
    pub name: String,
    /// Columns of its pictures.
    pub width: u32,
    /// Rows of its pictures.
    pub height: u32,
    /// Pixels of the sensor that one pixel of a picture stands for, along each side.
    pub shrink: u32,
    /// DN that are black in the pictures.
    pub black: f64,
    /// DN that are white in the pictures.
    pub white: f64,
    /// Middles of exposures at which the sequences are compared, ns.
    pub instants_ns: Vec<i64>,
    /// The sequences that are shown first, left and right.
    pub first: [usize; 2],
    /// Are the pixels of the report those of this group?
    pub holds_pixels: bool,
    /// The sequences.
    pub sequences: Vec<Film>,
}

/// One sequence of a group.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Film {
    /// Its name.
    pub label: String,
    /// `truth`, `captured` or `method`.
    pub kind: &'static str,
    /// Number of its colour and dashes.
    pub style: usize,
    /// Its pictures, each once.
    pub frames: Vec<Picture>,
    /// Place in `frames` of what is shown at each instant.
    pub at: Vec<usize>,
}

/// One picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Picture {
    /// Number of the frame in its sequence.
    pub frame: usize,
    /// Middle of its exposure, ns.
    pub t_ns: i64,
    /// Its file as an address.
    pub src: String,
}

/// Curves in one pair of axes.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Panel {
    /// Text above.
    pub title: String,
    /// Text below the axis to the right.
    pub x: String,
    /// Text next to the axis upwards.
    pub y: String,
    /// Is x the recording's time in ms?
    #[serde(rename = "isTime")]
    pub is_time: bool,
    /// Is x, all of it positive, shown by its logarithm?
    #[serde(rename = "isLog")]
    pub is_log: bool,
    /// Is y = 0 shown in any case?
    #[serde(rename = "hasZero")]
    pub has_zero: bool,
    /// The part of x that is shown; all of it without one.
    #[serde(rename = "xRange", skip_serializing_if = "Option::is_none")]
    pub x_range: Option<[f64; 2]>,
    /// The curves.
    pub series: Vec<Curve>,
    /// Level bars: from, to, their y, and what they are.
    pub bars: Vec<(f64, f64, f64, String)>,
    /// Events at x: ON?
    pub ticks: Vec<(f64, bool)>,
}

impl Panel {
    /// Adds the place where it is drawn to a page, and itself to the `charts` of the page's data.
    pub fn put(self, html: &mut String, charts: &mut Vec<Panel>) {
        html.push_str(&format!("<figure><div data-chart=\"{}\"></div></figure>\n", charts.len()));
        charts.push(self);
    }
}

/// One curve.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Curve {
    /// Its name.
    pub label: String,
    /// Number of its colour and dashes.
    pub style: usize,
    /// Are points marked?
    pub dots: bool,
    /// x and y; none where nothing was measured.
    pub points: Vec<(f64, Option<f64>)>,
    /// x, lower and upper end of an interval.
    pub band: Vec<(f64, f64, f64)>,
    /// Is the band drawn as a bar at each point?
    pub whiskers: bool,
}

/// A pixel and what is known of it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Pixel {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Its events.
    pub events: Vec<Event>,
    /// Exposures of captured frames.
    pub exposures: Vec<Bar>,
    /// What solvers made of it.
    pub solved: Vec<Solved>,
}

/// An event.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Event {
    /// In-pixel time where it was recorded, else off-pixel time; ns.
    pub t_ns: i64,
    /// Brighter?
    pub on: bool,
}

/// One exposure of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bar {
    /// Number of the frame.
    pub frame: usize,
    /// Start, ns.
    pub from_ns: i64,
    /// End, ns.
    pub to_ns: i64,
    /// What was read.
    pub dn: f64,
    /// The same as if it had been exposed as long as the pictures' frames.
    pub shown_dn: f64,
}

/// A residual.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Residual {
    /// When, ns.
    pub t_ns: i64,
    /// DN, or natural logarithm of photocurrent.
    pub value: f64,
}

/// A pixel's photocurrent as a solver found it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Solved {
    /// Name of the method.
    pub label: String,
    /// Number of its colour and dashes.
    pub style: usize,
    /// Does a value hold until the next knot?
    pub is_held: bool,
    /// Time in ns and V_DC = ln i.
    pub knots: Vec<(i64, f64)>,
    /// Time in ns, lower and upper end of the 95 % interval of V_DC; empty when the solver gives none.
    pub band: Vec<(i64, f64, f64)>,
    /// Time in ns and V_FE; empty when the description does not state the front end.
    pub front_end: Vec<(i64, f64)>,
    /// Captured minus predicted DN.
    pub frame_residuals: Vec<Residual>,
    /// Step of V_FE minus threshold.
    pub event_residuals: Vec<Residual>,
}

/// A pipeline as a picture and as a table.
#[derive(Clone, Debug, Default)]
pub struct Graph {
    /// Its name.
    pub name: String,
    /// The picture.
    pub svg: String,
    /// The nodes in running order.
    pub nodes: Vec<NodeRow>,
}

/// One node of a pipeline.
#[derive(Clone, Debug, Default)]
pub struct NodeRow {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: String,
    /// How it ended.
    pub end: String,
    /// How long it ran, as text.
    pub time: String,
    /// Size of what is stored, as text.
    pub size: String,
    /// The start of its key in the cache; empty when it never became known.
    pub key: String,
    /// The parameters that differ from their defaults.
    pub changed: String,
}

/// Something to know about the data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hazard {
    /// Where: a file or a node.
    pub at: String,
    /// What, in whole sentences.
    pub text: String,
    /// Does it put numbers in doubt?
    pub is_serious: bool,
}

/// How numbers were measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Card {
    /// The metrics and where they stand.
    pub metrics: String,
    /// Definition and version.
    pub definition: String,
    /// Names and texts.
    pub fields: Vec<(String, String)>,
}
