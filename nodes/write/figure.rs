//! Figures: curves over labelled axes, as SVG text and as a picture.
//!
//! `plotters` lays out axes, grid, legend and curves; it needs no font for SVG, and on a picture the letters
//! are those of [`super::font`], so nothing depends on what is installed. Axis ticks are chosen here
//! ([`axis`]), and a curve is one `<polyline>` for each stretch without a gap.

mod axis;
mod canvas;

use super::picture::Picture;
use axis::Axis;
use canvas::Canvas;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

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

/// Room that a letter of the legend takes at most, pixels.
const LETTER: u32 = 8;
/// The sample of a curve in the legend, and room around it, pixels.
const SAMPLE: (u32, u32) = (24, 6);
/// Lines of the legend, pixels from one to the next.
const LINE: u32 = 16;
/// Where colours recur curves are dashed: pixels of a dash, and from one to the next.
const DASHES: (u32, u32) = (6, 4);

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
        let picture =
            Picture { width, height, channels: 3, depth: png::BitDepth::Eight, bytes: &bytes, comment: None };
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
    fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        unit: i32,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let all = || {
            self.series
                .iter()
                .flat_map(|series| &series.points)
                .filter(|(x, y)| x.is_finite() && y.is_finite())
        };
        let text = |size: i32| ("sans-serif", size * unit).into_font();
        // To the right of the axes, so that it covers no curve.
        let letters = self
            .series
            .iter()
            .map(|series| series.label.chars().count())
            .max()
            .filter(|_| self.series.len() > 1);
        let legend = letters.map(|letters| (SAMPLE.0 + 2 * SAMPLE.1 + LETTER * letters as u32) as i32 * unit);
        let (area, legend) = match legend {
            Some(width) => {
                let (axes, legend) = area.split_horizontally(area.dim_in_pixel().0 as i32 - width);
                (axes, Some(legend))
            }
            None => (area.clone(), None),
        };
        let (x_axis, y_axis) =
            (Axis::tight(all().map(|point| point.0), self.is_log), Axis::wide(all().map(|point| point.1)));
        let mut chart = ChartBuilder::on(&area)
            .margin(10 * unit)
            // The last number below may be half as long again as the margin.
            .margin_right(20 * unit)
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
        let strokes = self.strokes();
        // The reference lies below the others, wherever it stands in the legend.
        let mut order: Vec<usize> = (0..self.series.len()).collect();
        order.sort_by_key(|&i| !self.series[i].is_reference);
        for i in order {
            let (series, stroke) = (&self.series[i], strokes[i]);
            for stretch in series
                .points
                .split(|(x, y)| !(x.is_finite() && y.is_finite()))
                .filter(|stretch| !stretch.is_empty())
            {
                let points = stretch.iter().copied();
                match stroke.dashes(unit) {
                    None => chart.draw_series(LineSeries::new(points, stroke.style(unit)))?,
                    Some((long, gap)) => {
                        chart.draw_series(DashedLineSeries::new(points, long, gap, stroke.style(unit)))?
                    }
                };
                if series.points.len() <= MOST_MARKS || stretch.len() == 1 {
                    chart.draw_series(
                        stretch
                            .iter()
                            .map(|&place| Circle::new(place, (3 * unit) as u32, stroke.colour.filled())),
                    )?;
                }
            }
        }
        legend.map_or(Ok(()), |legend| self.draw_legend(&legend, &strokes, unit))
    }

    /// A sample of every stroke with its label.
    fn draw_legend<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        strokes: &[Stroke],
        unit: i32,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        for (n, (series, stroke)) in self.series.iter().zip(strokes).enumerate() {
            let y = (LINE * (n as u32 + 2)) as i32 * unit;
            let x = [SAMPLE.1, SAMPLE.1 + SAMPLE.0].map(|x| x as i32 * unit);
            let line = vec![(x[0], y), (x[1], y)];
            match stroke.dashes(unit) {
                None => area.draw(&PathElement::new(line, stroke.style(unit)))?,
                Some((long, gap)) => {
                    area.draw(&plotters::element::DashedPathElement::new(
                        line,
                        long,
                        gap,
                        stroke.style(unit),
                    ))?;
                }
            }
            let font = ("sans-serif", 12 * unit).into_font();
            let anchored = font.into_text_style(area).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.label.clone(), (x[1] + SAMPLE.1 as i32 * unit, y), anchored))?;
        }
        Ok(())
    }

    /// How each curve is drawn: the reference black and broad, the others in colours, dashed where these
    /// recur.
    fn strokes(&self) -> Vec<Stroke> {
        let mut number = 0..;
        let mut stroke = |series: &Series| match series.is_reference {
            true => Stroke { colour: BLACK, width: 4, is_dashed: false },
            false => {
                let n = number.next().unwrap_or(0);
                Stroke { colour: COLOURS[n % COLOURS.len()], width: 2, is_dashed: n / COLOURS.len() % 2 == 1 }
            }
        };
        self.series.iter().map(&mut stroke).collect()
    }
}

/// How a curve is drawn.
#[derive(Clone, Copy)]
struct Stroke {
    colour: RGBColor,
    /// Pixels.
    width: i32,
    is_dashed: bool,
}

impl Stroke {
    fn style(&self, unit: i32) -> ShapeStyle {
        self.colour.stroke_width((self.width * unit) as u32)
    }

    /// Length of a dash and of a gap, where there are any.
    fn dashes(&self, unit: i32) -> Option<(u32, u32)> {
        self.is_dashed.then_some((DASHES.0 * unit as u32, DASHES.1 * unit as u32))
    }
}
