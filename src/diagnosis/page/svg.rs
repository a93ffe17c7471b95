//! Small charts as SVG text: bars, maps of pixels.

use crate::report::four_digits;
use photocurrent_page::escaped;
use std::fmt::Write;

/// A bar of a chart.
pub(super) struct ChartBar {
    /// Next to it.
    pub label: String,
    /// Its length, in multiples of the detection threshold.
    pub value: f64,
    /// Over its detection threshold?
    pub is_marked: bool,
}

/// Colours that colour-blind readers can distinguish, as the style of the page has them for light and dark.
pub(super) const COLOURS: [&str; 2] = ["var(--c0)", "var(--c1)"];

/// Horizontal bars on a logarithmic axis from a tenth of the detection threshold up, with a line at that
/// threshold.
pub(super) fn bars(bars: &[ChartBar]) -> String {
    const LEFT: f64 = 220.0;
    const WIDTH: f64 = 420.0;
    const ROW: f64 = 22.0;
    let most = bars.iter().map(|bar| bar.value).fold(10.0, f64::max);
    let decades = libm::log10(most) + 1.0;
    let x = |value: f64| LEFT + WIDTH * (libm::log10(f64::max(value, 0.1)) + 1.0) / decades;
    let height = ROW * bars.len() as f64 + 8.0;
    let mut svg = open_svg("Evidence of each test", LEFT + WIDTH + 80.0, height);
    for (row, bar) in bars.iter().enumerate() {
        let y = ROW * row as f64 + 4.0;
        let colour = if bar.is_marked { COLOURS[0] } else { "var(--edge)" };
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 8.0,
            y + 13.0,
            escaped(&bar.label)
        );
        let _ = write!(
            svg,
            "<rect x=\"{LEFT:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"16\" fill=\"{colour}\"/>",
            f64::max(x(bar.value) - LEFT, 1.0)
        );
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\">{:.2}</text>",
            x(bar.value) + 6.0,
            y + 13.0,
            bar.value
        );
    }
    let threshold = x(1.0);
    let _ = writeln!(
        svg,
        "<line x1=\"{threshold:.1}\" x2=\"{threshold:.1}\" y1=\"0\" y2=\"{height:.1}\" \
                       stroke=\"var(--bad)\" stroke-dasharray=\"4 3\"/></svg>"
    );
    svg
}

/// A map with its title: a value for each pixel of an array, NaN = not known.
pub(super) type TitledMap = (&'static str, Vec<f64>);

/// Maps of one array side by side, on one scale from white (0) to dark red (the 98th percentile of all and
/// more); what is not known stays grey. Pixels of a large array are put together. `what` names value and
/// unit.
pub(super) fn maps(all: &[TitledMap], width: usize, height: usize, what: &str) -> String {
    const MOST: usize = 128;
    const GAP: f64 = 20.0;
    const TOP: f64 = 20.0;
    let side = width.max(height).div_ceil(MOST).max(1);
    let (across, down) = (width.div_ceil(side), height.div_ceil(side));
    let cells: Vec<Vec<(f64, f64)>> = all
        .iter()
        .map(|(_, values)| {
            let mut cells = vec![(0.0, 0.0); across * down];
            for (pixel, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
                let cell = &mut cells[pixel / width / side * across + pixel % width / side];
                *cell = (cell.0 + value, cell.1 + 1.0);
            }
            cells
        })
        .collect();
    let mut known: Vec<f64> =
        cells.iter().flatten().filter(|cell| cell.1 > 0.0).map(|cell| cell.0 / cell.1).collect();
    known.sort_by(f64::total_cmp);
    let most = f64::max(photocurrent_scene::statistics::quantile(&known, 0.98), 1e-9);
    let size = ((700.0 - GAP) / all.len().max(2) as f64 / across as f64).min(8.0);
    let (wide, high) = (size * across as f64, size * down as f64);
    let mut svg = open_svg(what, f64::max((wide + GAP) * all.len() as f64, 460.0), TOP + high + 26.0);
    let colour = |share: f64| {
        let shade = (255.0 - 225.0 * share.clamp(0.0, 1.0)) as u8;
        format!("rgb(255,{shade},{})", shade / 2 + 60)
    };
    for (n, ((title, _), cells)) in all.iter().zip(&cells).enumerate() {
        let left = (wide + GAP) * n as f64;
        let _ = write!(svg, "<text x=\"{left:.1}\" y=\"13\">{}</text>", escaped(title));
        let _ = write!(
            svg,
            "<rect x=\"{left:.1}\" y=\"{TOP}\" width=\"{wide:.1}\" height=\"{high:.1}\" fill=\"#e6e8eb\"/>"
        );
        for (k, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.1 > 0.0) {
            let (x, y) = (left + size * (k % across) as f64, TOP + size * (k / across) as f64);
            let fill = colour(cell.0 / cell.1 / most);
            let _ = write!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{size:.1}\" height=\"{size:.1}\" fill=\"{fill}\"/>"
            );
        }
    }
    let y = TOP + high + 8.0;
    for step in 0..10 {
        let _ = write!(
            svg,
            "<rect x=\"{}\" y=\"{y:.1}\" width=\"10\" height=\"12\" fill=\"{}\"/>",
            14 + 10 * step,
            colour((f64::from(step) + 0.5) / 10.0)
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"0\" y=\"{:.1}\">0</text><text x=\"120\" y=\"{0:.1}\">{} {}</text></svg>",
        y + 10.0,
        four_digits(most),
        escaped(what)
    );
    svg
}

/// Opening tag of an SVG picture; `what` is its accessible name.
pub(super) fn open_svg(what: &str, width: f64, height: f64) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"figure\" role=\"img\" aria-label=\"{}\" \
         viewBox=\"0 0 {width:.1} {height:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
         font-size=\"12\" font-family=\"sans-serif\">",
        escaped(what)
    )
}
