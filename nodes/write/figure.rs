//! Figures: curves over labelled axes, as SVG text and as a picture.
//!
//! `plotters` lays out axes, grid, legend and curves; it needs no font for SVG, and on a picture the letters are those of [`super::font`], so nothing
//! depends on what is installed. Axis ticks are chosen here ([`axis`]), and a curve is one `<polyline>` for each stretch without a gap.

mod axis;
mod canvas;

use super::picture::Picture;
use axis::Axis;
use canvas::Canvas;
use plotters::coord::Shift;
use plotters::prelude::*;

/// A curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Places in the units of the axes; a place that is not finite breaks the curve.
    pub points: Vec<(f64, f64)>,
    /// What the others are held against: drawn first, black and broad.
    pub is_reference: bool,
}

/// A pair of axes with its curves.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// Below it, with the unit: `time [ms]`.
    pub x_label: String,
    /// Next to it, with the unit.
    pub y_label: String,
    /// Are equal ratios of x equally far apart? Ignored where an x is not positive.
    pub is_log: bool,
    /// The curves, in the order of the legend.
    pub series: Vec<Series>,
}

/// Panels one below the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// From the top.
    pub panels: Vec<Panel>,
    /// Pixels.
    pub width: u32,
    /// Pixels of one panel.
    pub height: u32,
}

/// Colours that colour-blind readers can distinguish (Okabe and Ito), dark enough for white paper.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
];

/// A curve of no more points than this shows each as a mark.
const MOST_MARKS: usize = 24;

/// The unit of coordinates in SVG is a quarter of a pixel, as `plotters` rounds to whole ones.
const SVG_FINENESS: u32 = 4;
/// A picture has twice the pixels, for high screens and print.
const PICTURE_FINENESS: u32 = 2;

impl Figure {
    /// As SVG, the same text for the same figure.
    ///
    /// # Errors
    /// When it cannot be laid out, in the words of `plotters`.
    pub fn svg(&self) -> Result<String, String> {
        let (width, height) = (self.width, self.height * self.panels.len() as u32);
        let mut text = String::new();
        let size = (SVG_FINENESS * width, SVG_FINENESS * height);
        self.draw(SVGBackend::with_string(&mut text, size).into_drawing_area(), SVG_FINENESS)?;
        let fine = format!("width=\"{}\" height=\"{}\"", size.0, size.1);
        Ok(text.replacen(&fine, &format!("width=\"{width}\" height=\"{height}\""), 1))
    }

    /// As a picture: width, height, and three bytes (red, green, blue) a pixel, rows from the top.
    ///
    /// # Errors
    /// When it cannot be laid out, in the words of `plotters`.
    pub fn picture(&self) -> Result<(u32, u32, Vec<u8>), String> {
        let size = (PICTURE_FINENESS * self.width, PICTURE_FINENESS * self.height * self.panels.len() as u32);
        let mut bytes = vec![255; 3 * size.0 as usize * size.1 as usize];
        self.draw(Canvas::new(size.0, size.1, &mut bytes).into_drawing_area(), PICTURE_FINENESS)?;
        Ok((size.0, size.1, bytes))
    }

    /// [`Figure::picture`] as a PNG file.
    ///
    /// # Errors
    /// As [`Figure::picture`].
    pub fn png(&self) -> Result<Vec<u8>, String> {
        let (width, height, bytes) = self.picture()?;
        let mut file = Vec::new();
        let picture = Picture { width, height, channels: 3, depth: png::BitDepth::Eight, bytes: &bytes, comment: None };
        picture.encode(&mut file).map_err(|error| error.to_string())?;
        Ok(file)
    }

    fn draw<B: DrawingBackend>(&self, area: DrawingArea<B, Shift>, unit: u32) -> Result<(), String> {
        let failed = |error: DrawingAreaErrorKind<B::ErrorType>| error.to_string();
        area.fill(&WHITE).map_err(failed)?;
        for (panel, area) in self.panels.iter().zip(area.split_evenly((self.panels.len(), 1))) {
            panel.draw(&area, unit as i32).map_err(failed)?;
        }
        area.present().map_err(failed)
    }
}

impl Panel {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, unit: i32) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let all = || self.series.iter().flat_map(|series| &series.points).filter(|(x, y)| x.is_finite() && y.is_finite());
        let text = |size: i32| ("sans-serif", size * unit).into_font();
        let (x_axis, y_axis) = (Axis::tight(all().map(|point| point.0), self.is_log), Axis::wide(all().map(|point| point.1)));
        let mut chart = ChartBuilder::on(area)
            .margin(10 * unit)
            .caption(&self.title, text(16))
            .x_label_area_size(42 * unit)
            .y_label_area_size(62 * unit)
            .build_cartesian_2d(x_axis, y_axis)?;
        chart
            .configure_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .axis_desc_style(text(14))
            .label_style(text(12))
            .bold_line_style(RGBColor(225, 225, 225).stroke_width(unit as u32))
            .light_line_style(TRANSPARENT)
            .axis_style(BLACK.stroke_width(unit as u32))
            .set_all_tick_mark_size(4 * unit)
            .draw()?;
        // The reference lies below the others, wherever it stands in the legend.
        let mut order: Vec<usize> = (0..self.series.len()).collect();
        order.sort_by_key(|&i| !self.series[i].is_reference);
        let mut colours = COLOURS.iter().cycle();
        for series in order.iter().map(|&i| &self.series[i]) {
            let (colour, width) = if series.is_reference { (BLACK, 4) } else { (*colours.next().unwrap_or(&BLACK), 2) };
            let style = colour.stroke_width((width * unit) as u32);
            let mut is_first = true;
            for stretch in series.points.split(|(x, y)| !(x.is_finite() && y.is_finite())).filter(|stretch| !stretch.is_empty()) {
                let line = chart.draw_series(LineSeries::new(stretch.iter().copied(), style))?;
                if is_first {
                    // Letters are broader than `plotters` guesses: without room behind them they would run over the legend's border.
                    line.label(format!("{}  ", series.label)).legend(move |(x, y)| PathElement::new([(x, y), (x + 18 * unit, y)], style));
                    is_first = false;
                }
                if series.points.len() <= MOST_MARKS || stretch.len() == 1 {
                    chart.draw_series(stretch.iter().map(|&place| Circle::new(place, (3 * unit) as u32, colour.filled())))?;
                }
            }
        }
        if self.series.len() > 1 {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .margin((6 * unit) as u32)
                .legend_area_size((24 * unit) as u32)
                .label_font(text(12))
                .background_style(WHITE.mix(0.85))
                .border_style(RGBColor(160, 160, 160).stroke_width(unit as u32))
                .draw()?;
        }
        Ok(())
    }
}
