//! The sheet itself: where things stand on it, and how a value becomes dots.

use super::super::font;
use super::shown::Shown;
use crate::crop::Crop;

/// Dots between things.
pub(super) const GAP: u32 = 6;
/// The width that a row of pictures should have.
const WIDTH_WANTED: u32 = 1600;
/// Exponent of the display: a screen shows `value ^ GAMMA`.
const GAMMA: f64 = 2.2;

/// Where things stand on the sheet.
pub(super) struct Layout {
    pub(super) crop: Crop,
    pub(super) zoom: u32,
    /// Size of a dot of the font.
    pub(super) dot: u32,
    pub(super) cell_width: u32,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl Layout {
    /// `widest` is the width of the widest time label in dots of the font.
    pub(super) fn new(crop: Crop, scale: Option<u32>, columns: usize, rows: usize, widest: u32) -> Layout {
        let across = (crop.width as u64 * columns as u64).max(1);
        let zoom = scale.unwrap_or((u64::from(WIDTH_WANTED) / across).clamp(1, 64) as u32);
        let dot = if across * u64::from(zoom) >= 1000 { 2 } else { 1 };
        let cell_width = (crop.width * zoom).max(widest * dot);
        Layout { crop, zoom, dot, cell_width, columns, rows }
    }

    pub(super) fn text_height(&self) -> u32 {
        font::CELL_HEIGHT * self.dot
    }

    pub(super) fn x(&self, column: usize) -> u32 {
        GAP + column as u32 * (self.cell_width + GAP)
    }

    /// Top of a row's label.
    pub(super) fn y(&self, row: usize) -> u32 {
        let one = GAP + self.text_height() + GAP / 2 + self.crop.height * self.zoom;
        GAP + self.text_height() + row as u32 * (one + GAP)
    }

    /// Top of a row's pictures.
    pub(super) fn picture_y(&self, row: usize) -> u32 {
        self.y(row) + GAP + self.text_height() + GAP / 2
    }

    pub(super) fn width(&self) -> u64 {
        u64::from(GAP) + self.columns as u64 * u64::from(self.cell_width + GAP)
    }

    pub(super) fn height(&self) -> u64 {
        let one = u64::from(2 * GAP + self.text_height() + GAP / 2)
            + u64::from(self.crop.height) * u64::from(self.zoom);
        u64::from(GAP + self.text_height()) + self.rows as u64 * one
    }
}

/// The sheet while it is drawn: white, `channels` bytes a dot.
pub(super) struct Sheet {
    pub(super) width: u32,
    pub(super) channels: u32,
    pub(super) bytes: Vec<u8>,
}

impl Sheet {
    pub(super) fn set(&mut self, x: u32, y: u32, value: &[u8]) {
        let at = (y as usize * self.width as usize + x as usize) * self.channels as usize;
        for c in 0..self.channels as usize {
            self.bytes[at + c] = value[c.min(value.len() - 1)];
        }
    }

    /// Draws the line above a row, and its label.
    pub(super) fn begin_row(&mut self, layout: &Layout, row: usize, label: &str) {
        (GAP..self.width - GAP).for_each(|x| self.set(x, layout.y(row) + GAP / 2, &[200]));
        self.text(GAP, layout.y(row) + GAP, layout.dot, self.width - 2 * GAP, label);
    }

    /// Draws a picture of the crop's size into a cell, `layout.zoom` dots a pixel.
    pub(super) fn picture(
        &mut self,
        layout: &Layout,
        (column, row): (usize, usize),
        pixels: impl Iterator<Item = [u8; 3]>,
    ) {
        let (left, top, zoom) = (layout.x(column), layout.picture_y(row), layout.zoom);
        for (pixel, value) in pixels.enumerate() {
            let (x, y) = (pixel as u32 % layout.crop.width * zoom, pixel as u32 / layout.crop.width * zoom);
            for (dx, dy) in (0..zoom).flat_map(|dy| (0..zoom).map(move |dx| (dx, dy))) {
                self.set(left + x + dx, top + y + dy, &value);
            }
        }
    }

    /// Writes a text, cut off at `limit` dots.
    pub(super) fn text(&mut self, x: u32, y: u32, dot: u32, limit: u32, text: &str) {
        font::dots(text, |column, row| {
            if (column + 1) * dot <= limit {
                for (dx, dy) in (0..dot).flat_map(|dy| (0..dot).map(move |dx| (dx, dy))) {
                    self.set(x + column * dot + dx, y + row * dot + dy, &[0]);
                }
            }
        });
    }
}

/// The 0.5 and 99.5 percentile of all known values.
pub(super) fn grey_range(row: &[Shown]) -> (f32, f32) {
    let mut values: Vec<f32> =
        row.iter().flat_map(|shown| shown.dn.iter().copied()).filter(|dn| dn.is_finite()).collect();
    if values.is_empty() {
        return (0.0, 1.0);
    }
    let last = (values.len() - 1) as f64;
    let mut at = |part: f64| *values.select_nth_unstable_by((last * part).round() as usize, f32::total_cmp).1;
    let (dark, bright) = (at(0.005), at(0.995));
    (dark, if bright > dark { bright } else { dark + 1.0 })
}

/// What a screen has to be sent to show a value: NaN is black.
fn display((dark, bright): (f32, f32), dn: f32) -> u8 {
    let linear = f64::from((dn - dark) / (bright - dark)).clamp(0.0, 1.0);
    (255.0 * libm::pow(linear, 1.0 / GAMMA)).round() as u8
}

/// Red, green and blue of a pixel of one or three channels.
pub(super) fn displayed(range: (f32, f32), dn: &[f32]) -> [u8; 3] {
    [0, 1, 2].map(|channel| display(range, dn[channel.min(dn.len() - 1)]))
}
