//! Small charts as SVG text: bars, a map of pixels, curves.

use super::escaped;
use std::fmt::Write;

/// A bar of a chart.
pub struct Bar {
    /// Beside it.
    pub label: String,
    /// Its length, in multiples of the alarm.
    pub value: f64,
    /// Over its alarm?
    pub is_marked: bool,
}

/// Colours that colour-blind readers tell apart (Okabe and Ito).
pub const COLOURS: [&str; 4] = ["#0072b2", "#d55e00", "#009e73", "#787878"];

/// Horizontal bars on a logarithmic axis from a tenth of the alarm up, with a line at the alarm.
pub fn bars(bars: &[Bar]) -> String {
    const LEFT: f64 = 220.0;
    const WIDTH: f64 = 420.0;
    const ROW: f64 = 22.0;
    let most = bars.iter().map(|bar| bar.value).fold(10.0, f64::max);
    let decades = libm::log10(most) + 1.0;
    let x = |value: f64| LEFT + WIDTH * (libm::log10(f64::max(value, 0.1)) + 1.0) / decades;
    let height = ROW * bars.len() as f64 + 8.0;
    let mut svg = open(LEFT + WIDTH + 80.0, height);
    for (row, bar) in bars.iter().enumerate() {
        let y = ROW * row as f64 + 4.0;
        let colour = if bar.is_marked { COLOURS[0] } else { "#b8c0c8" };
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", LEFT - 8.0, y + 13.0, escaped(&bar.label));
        let _ = write!(svg, "<rect x=\"{LEFT:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"16\" fill=\"{colour}\"/>", f64::max(x(bar.value) - LEFT, 1.0));
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\">{:.2}</text>", x(bar.value) + 6.0, y + 13.0, bar.value);
    }
    let alarm = x(1.0);
    let _ = writeln!(svg, "<line x1=\"{alarm:.1}\" x2=\"{alarm:.1}\" y1=\"0\" y2=\"{height:.1}\" stroke=\"#b00020\" stroke-dasharray=\"4 3\"/></svg>");
    svg
}

/// Values of an array of pixels, from white (0) to dark (the 98th percentile and more); what is not known stays grey. Pixels of a large array are put together.
pub fn heat(values: &[f64], width: usize, height: usize) -> String {
    const MOST: usize = 128;
    let side = width.max(height).div_ceil(MOST).max(1);
    let (across, down) = (width.div_ceil(side), height.div_ceil(side));
    let mut cells = vec![(0.0, 0.0); across * down];
    for (pixel, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
        let cell = &mut cells[pixel / width / side * across + pixel % width / side];
        *cell = (cell.0 + value, cell.1 + 1.0);
    }
    let mut known: Vec<f64> = cells.iter().filter(|cell| cell.1 > 0.0).map(|cell| cell.0 / cell.1).collect();
    known.sort_by(f64::total_cmp);
    let most = f64::max(crate::integrity::quantile(&known, 0.98), 1e-9);
    let size = (640.0 / across as f64).min(8.0);
    let mut svg = open(size * across as f64, size * down as f64 + 20.0);
    let _ = write!(svg, "<rect width=\"{:.1}\" height=\"{:.1}\" fill=\"#e6e8eb\"/>", size * across as f64, size * down as f64);
    for (k, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.1 > 0.0) {
        let shade = (255.0 - 225.0 * (cell.0 / cell.1 / most).clamp(0.0, 1.0)) as u8;
        let (x, y) = (size * (k % across) as f64, size * (k / across) as f64);
        let _ = write!(svg, "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{size:.1}\" height=\"{size:.1}\" fill=\"rgb(255,{shade},{})\"/>", shade / 2 + 60);
    }
    let _ = writeln!(svg, "<text x=\"0\" y=\"{:.1}\">white 0, red {most:.3} and more, grey not looked at</text></svg>", size * down as f64 + 15.0);
    svg
}

/// A named curve.
pub type Line = (String, Vec<(f64, f64)>);

/// Curves over common axes, from zero up.
pub fn steps(lines: &[Line], x_label: &str, y_label: &str) -> String {
    let mut plot = Plot::new(lines.iter().flat_map(|line| line.1.iter().copied()).chain([(f64::NAN, 0.0)]), 640.0, 180.0);
    for (k, (name, points)) in lines.iter().enumerate() {
        plot.line(points, COLOURS[k % COLOURS.len()], name, k);
    }
    plot.close(x_label, y_label)
}

/// Axes over which curves are drawn.
pub struct Plot {
    svg: String,
    x: (f64, f64),
    y: (f64, f64),
    size: (f64, f64),
}

const MARGIN: (f64, f64) = (60.0, 30.0);

impl Plot {
    /// Axes that hold some points; coordinates that are not finite are left out.
    pub fn new(points: impl Iterator<Item = (f64, f64)>, width: f64, height: f64) -> Plot {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let grow = |range: (f64, f64), value: f64| if value.is_finite() { (range.0.min(value), range.1.max(value)) } else { range };
        let (x, y) = points.fold((none, none), |(x, y), point| (grow(x, point.0), grow(y, point.1)));
        let whole = |range: (f64, f64)| {
            if range.1 > range.0 {
                range
            } else if range.0.is_finite() {
                (range.0 - 0.5, range.0 + 0.5)
            } else {
                (0.0, 1.0)
            }
        };
        let mut plot = Plot { svg: open(width, height), x: whole(x), y: whole(y), size: (width, height) };
        let (left, bottom) = (MARGIN.0, height - MARGIN.1);
        let _ = write!(plot.svg, "<path d=\"M{left} 8V{bottom}H{:.1}\" fill=\"none\" stroke=\"#787878\"/>", width - 8.0);
        plot
    }

    /// Where a point stands on the page.
    pub fn place(&self, point: (f64, f64)) -> (f64, f64) {
        let (width, height) = (self.size.0 - MARGIN.0 - 8.0, self.size.1 - MARGIN.1 - 8.0);
        let share = |value: f64, range: (f64, f64)| (value - range.0) / (range.1 - range.0);
        (MARGIN.0 + width * share(point.0, self.x), 8.0 + height * (1.0 - share(point.1, self.y)))
    }

    /// A curve with its name, the `row`th of the legend.
    pub fn line(&mut self, points: &[(f64, f64)], colour: &str, name: &str, row: usize) {
        let mut path = String::new();
        for point in points.iter().filter(|point| point.0.is_finite() && point.1.is_finite()) {
            let (x, y) = self.place(*point);
            let _ = write!(path, "{x:.1},{y:.1} ");
        }
        let _ = write!(self.svg, "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>", path.trim_end());
        let (x, y) = (self.size.0 - 16.0, 20.0 + 16.0 * row as f64);
        let _ = write!(self.svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"end\" fill=\"{colour}\">{}</text>", escaped(name));
    }

    /// A level bar from one instant to another.
    pub fn level(&mut self, from: f64, to: f64, value: f64, colour: &str) {
        let ((x1, y), (x2, _)) = (self.place((from, value)), self.place((to, value)));
        let _ = write!(self.svg, "<line x1=\"{x1:.1}\" x2=\"{x2:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"{colour}\" stroke-width=\"3\"/>");
    }

    /// A tick on the lower axis (`up`) or under it.
    pub fn tick(&mut self, x: f64, up: bool, colour: &str) {
        let (x, bottom) = (self.place((x, self.y.0)).0, self.size.1 - MARGIN.1);
        let to = if up { bottom - 8.0 } else { bottom + 8.0 };
        let _ = write!(self.svg, "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{bottom:.1}\" y2=\"{to:.1}\" stroke=\"{colour}\"/>");
    }

    /// The finished picture, with the ends of both axes.
    pub fn close(mut self, x_label: &str, y_label: &str) -> String {
        let (width, height) = self.size;
        let bottom = height - 6.0;
        let _ = write!(self.svg, "<text x=\"{}\" y=\"{bottom:.1}\">{:.4}</text>", MARGIN.0, self.x.0);
        let _ = write!(self.svg, "<text x=\"{:.1}\" y=\"{bottom:.1}\" text-anchor=\"end\">{:.4} {}</text>", width - 8.0, self.x.1, escaped(x_label));
        let _ = write!(self.svg, "<text x=\"{:.1}\" y=\"18\" text-anchor=\"end\">{:.3}</text>", MARGIN.0 - 6.0, self.y.1);
        let _ = write!(self.svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{:.3}</text>", MARGIN.0 - 6.0, height - MARGIN.1, self.y.0);
        let _ = writeln!(self.svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text></svg>", MARGIN.0 - 6.0, height / 2.0, escaped(y_label));
        self.svg
    }
}

fn open(width: f64, height: f64) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.1} {height:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" font-size=\"12\" font-family=\"sans-serif\">"
    )
}
