//! Curves and points over labelled axes, as SVG text.

use super::svg::open;
use crate::report::short;
use photocurrent_page::escaped;
use std::fmt::Write;

/// Space on the left, right, top and bottom of the axes, pixels.
const MARGIN: (f64, f64, f64, f64) = (64.0, 12.0, 24.0, 38.0);
/// Height of a row of ticks under the axes.
const ROW: f64 = 22.0;
/// About so many pixels of a letter.
const LETTER: f64 = 6.6;

/// Which marks an axis has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    /// Equal steps.
    Linear,
    /// Equal steps, marks at whole numbers alone.
    Whole,
    /// Equal ratios; all values are positive.
    Logarithmic,
}

/// Axes over which curves are drawn.
pub(super) struct Plot {
    svg: String,
    x: (f64, f64),
    y: (f64, f64),
    scale: Scale,
    size: (f64, f64),
    rows: usize,
    legend: Vec<(String, String)>,
}

impl Plot {
    /// Axes that hold some points (coordinates that are not finite are left out), with a scale across and
    /// named rows of ticks under the axes.
    pub(super) fn with_rows(
        points: impl Iterator<Item = (f64, f64)>,
        width: f64,
        height: f64,
        scale: Scale,
        rows: &[&str],
    ) -> Plot {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let grow = |range: (f64, f64), value: f64| {
            if value.is_finite() { (range.0.min(value), range.1.max(value)) } else { range }
        };
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
        let height = height + ROW * rows.len() as f64;
        let x = whole(x);
        let scale = if x.0 <= 0.0 && scale == Scale::Logarithmic { Scale::Linear } else { scale };
        let mut plot = Plot {
            svg: open("Curves; the axes name what they show", width, height),
            x,
            y: whole(y),
            scale,
            size: (width, height),
            rows: rows.len(),
            legend: Vec::new(),
        };
        let (left, bottom) = (MARGIN.0, plot.bottom());
        let _ = write!(
            plot.svg,
            "<path d=\"M{left} {}V{bottom:.1}H{:.1}\" fill=\"none\" stroke=\"#787878\"/>",
            MARGIN.2,
            width - MARGIN.1
        );
        for (row, name) in rows.iter().enumerate() {
            let y = plot.row(row);
            let _ = write!(
                plot.svg,
                "<line x1=\"{left}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#d0d7de\"/>",
                width - MARGIN.1
            );
            let _ = write!(
                plot.svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"11\">{}</text>",
                left - 6.0,
                y + 4.0,
                escaped(name)
            );
        }
        plot
    }

    /// The lower end of the axes.
    fn bottom(&self) -> f64 {
        self.size.1 - MARGIN.3 - ROW * self.rows as f64
    }

    /// The middle of a row of ticks.
    fn row(&self, row: usize) -> f64 {
        self.size.1 - MARGIN.3 - ROW * (self.rows - row) as f64 + 0.5 * ROW
    }

    /// Where a point stands on the page.
    pub(super) fn place(&self, point: (f64, f64)) -> (f64, f64) {
        let (width, height) = (self.size.0 - MARGIN.0 - MARGIN.1, self.bottom() - MARGIN.2);
        let share = |value: f64, range: (f64, f64)| (value - range.0) / (range.1 - range.0);
        let across = match self.scale {
            Scale::Linear | Scale::Whole => share(point.0, self.x),
            Scale::Logarithmic => {
                libm::log(f64::max(point.0, self.x.0) / self.x.0) / libm::log(self.x.1 / self.x.0)
            }
        };
        (MARGIN.0 + width * across, MARGIN.2 + height * (1.0 - share(point.1, self.y)))
    }

    /// A name for a colour.
    pub(super) fn name(&mut self, colour: &str, name: &str) {
        self.legend.push((colour.to_owned(), name.to_owned()));
    }

    /// A curve; `dashes` as in SVG, none for a whole line.
    pub(super) fn line(&mut self, points: &[(f64, f64)], colour: &str, dashes: Option<&str>) {
        let mut path = String::new();
        for point in points.iter().filter(|point| point.0.is_finite() && point.1.is_finite()) {
            let (x, y) = self.place(*point);
            let _ = write!(path, "{x:.1},{y:.1} ");
        }
        let dashes = dashes.map(|dashes| format!(" stroke-dasharray=\"{dashes}\"")).unwrap_or_default();
        let _ = write!(
            self.svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"{dashes}/>",
            path.trim_end()
        );
    }

    /// Points with bars of `error` up and down, moved across by `shift` pixels so that two sets stand next to
    /// each other.
    pub(super) fn points(&mut self, points: &[(f64, f64, f64)], colour: &str, shift: f64) {
        for &(at, value, error) in points {
            let ((x, y), (_, high), (_, low)) =
                (self.place((at, value)), self.place((at, value + error)), self.place((at, value - error)));
            let x = x + shift;
            let _ = write!(
                self.svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{high:.1}\" y2=\"{low:.1}\" stroke=\"{colour}\"/>"
            );
            let _ = write!(self.svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\"/>");
        }
    }

    /// A level bar from one instant to another.
    pub(super) fn level(&mut self, from: f64, to: f64, value: f64, colour: &str) {
        let ((x1, y), (x2, _)) = (self.place((from, value)), self.place((to, value)));
        let _ = write!(
            self.svg,
            "<line x1=\"{x1:.1}\" x2=\"{x2:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" \
                                  stroke=\"{colour}\" stroke-width=\"3\"/>"
        );
    }

    /// A tick of a row, upwards from its middle or down.
    pub(super) fn tick(&mut self, row: usize, x: f64, up: bool, colour: &str) {
        let (x, middle) = (self.place((x, self.y.0)).0, self.row(row));
        let to = if up { middle - 9.0 } else { middle + 9.0 };
        let _ = write!(
            self.svg,
            "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{middle:.1}\" y2=\"{to:.1}\" stroke=\"{colour}\"/>"
        );
    }

    /// The finished picture, with marks and names of both axes, and of colours.
    pub(super) fn close(mut self, x_label: &str, y_label: &str) -> String {
        let (width, height) = self.size;
        let bottom = self.bottom();
        for at in marks(self.y) {
            let y = self.place((self.x.0, at)).1;
            let _ = write!(
                self.svg,
                "<line x1=\"{}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#787878\"/>",
                MARGIN.0 - 4.0,
                MARGIN.0
            );
            let _ = write!(
                self.svg,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                MARGIN.0 - 7.0,
                y + 4.0,
                short(at)
            );
        }
        let mut across = if self.scale == Scale::Logarithmic { ratios(self.x) } else { marks(self.x) };
        across.retain(|at| self.scale != Scale::Whole || at.fract() == 0.0);
        for at in across {
            let x = self.place((at, self.y.0)).0;
            let _ = write!(
                self.svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{bottom:.1}\" y2=\"{:.1}\" stroke=\"#787878\"/>",
                bottom + 4.0
            );
            let _ = write!(
                self.svg,
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                height - MARGIN.3 + 16.0,
                short(at)
            );
        }
        let middle = 0.5 * (MARGIN.0 + width - MARGIN.1);
        let _ = write!(
            self.svg,
            "<text x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            height - 6.0,
            escaped(x_label)
        );
        let _ = write!(self.svg, "<text x=\"4\" y=\"14\">{}</text>", escaped(y_label));
        let mut x = width - MARGIN.1;
        for (colour, name) in self.legend.iter().rev() {
            let _ = write!(
                self.svg,
                "<text x=\"{x:.1}\" y=\"14\" text-anchor=\"end\" fill=\"{colour}\">{}</text>",
                escaped(name)
            );
            x -= LETTER * name.chars().count() as f64 + 16.0;
        }
        self.svg.push_str("</svg>\n");
        self.svg
    }
}

/// Round numbers within a range, at equal steps.
fn marks(range: (f64, f64)) -> Vec<f64> {
    const MOST: f64 = 6.0;
    let rough = (range.1 - range.0) / MOST;
    let decade = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|of| of * decade)
        .into_iter()
        .find(|step| *step >= rough)
        .unwrap_or(10.0 * decade);
    let (first, last) = (libm::ceil(range.0 / step - 1e-9), libm::floor(range.1 / step + 1e-9));
    // Whole steps, so that nought is nought.
    (0..=(last - first).max(0.0) as usize).map(|k| (first + k as f64) * step).collect()
}

/// Round numbers within a positive range, at about equal ratios; both ends of a narrow one.
fn ratios(range: (f64, f64)) -> Vec<f64> {
    let first = libm::floor(libm::log10(range.0)) as i32;
    let last = libm::ceil(libm::log10(range.1)) as i32;
    let of = if last - first > 3 { &[1.0][..] } else { &[1.0, 2.0, 5.0] };
    let all =
        (first..=last).flat_map(|decade| of.iter().map(move |of| of * libm::pow(10.0, f64::from(decade))));
    let within: Vec<f64> =
        all.filter(|at| *at >= range.0 * (1.0 - 1e-9) && *at <= range.1 * (1.0 + 1e-9)).collect();
    if within.len() > 1 { within } else { vec![range.0, range.1] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round_and_inside() {
        assert_eq!(marks((0.0, 1.0)), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(marks((-3.0, 7.2)), [-2.0, 0.0, 2.0, 4.0, 6.0]);
        assert_eq!(ratios((0.7, 30.0)), [1.0, 2.0, 5.0, 10.0, 20.0]);
        assert_eq!(ratios((1.1, 1.3)), [1.1, 1.3]);
    }

    #[test]
    fn the_ends_of_the_axes_are_the_corners() {
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let plot =
                Plot::with_rows([(0.5, -1.0), (50.0, 3.0)].into_iter(), 640.0, 200.0, scale, &["recorded"]);
            assert_eq!(plot.place((0.5, -1.0)), (MARGIN.0, 200.0 - MARGIN.3));
            assert_eq!(plot.place((50.0, 3.0)), (640.0 - MARGIN.1, MARGIN.2));
            let (x, _) = plot.place((5.0, 0.0));
            let middle = 0.5 * (MARGIN.0 + 640.0 - MARGIN.1);
            assert_eq!((x - middle).abs() < 1e-9, scale == Scale::Logarithmic);
        }
    }
}
