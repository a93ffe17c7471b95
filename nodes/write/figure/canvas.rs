//! A picture to draw on: pixels in memory, letters from the dot font.

use super::super::font;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontTransform,
};
use std::convert::Infallible;

/// Pixels in red, green and blue.
pub(crate) struct Canvas<'a> {
    width: u32,
    height: u32,
    bytes: &'a mut [u8],
}

impl Canvas<'_> {
    /// Draws on `3 * width * height` bytes: three a pixel, rows from the top.
    pub(crate) fn new(width: u32, height: u32, bytes: &mut [u8]) -> Canvas<'_> {
        Canvas { width, height, bytes }
    }

    /// Pixels of the picture for a dot of a letter.
    fn dot(size: f64) -> u32 {
        // Letters of 8 dots stand for those of a font of 12.
        ((size / 12.0).round() as u32).max(1)
    }
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn ensure_prepared(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn present(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn draw_pixel(
        &mut self,
        (x, y): BackendCoord,
        colour: BackendColor,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        if x < 0 || y < 0 || x as u32 >= self.width || y as u32 >= self.height {
            return Ok(());
        }
        let at = 3 * (y as usize * self.width as usize + x as usize);
        let (red, green, blue) = colour.rgb;
        for (byte, new) in self.bytes[at..at + 3].iter_mut().zip([red, green, blue]) {
            *byte = (f64::from(*byte) * (1.0 - colour.alpha) + f64::from(new) * colour.alpha).round() as u8;
        }
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        style: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let dot = Canvas::dot(style.size());
        Ok((dot * font::width(text), dot * font::CELL_HEIGHT))
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (x, y): BackendCoord,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        let dot = Canvas::dot(style.size()) as i32;
        let (width, height) = (dot * font::width(text) as i32, dot * font::CELL_HEIGHT as i32);
        let left = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Center => -width / 2,
            HPos::Right => -width,
        };
        let top = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let mut places = Vec::new();
        font::dots(text, |column, row| places.push((left + dot * column as i32, top + dot * row as i32)));
        for (right, down) in places {
            for (i, j) in (0..dot * dot).map(|k| (right + k % dot, down + k / dot)) {
                let place = match style.transform() {
                    FontTransform::None => (x + i, y + j),
                    FontTransform::Rotate90 => (x - j, y + i),
                    FontTransform::Rotate180 => (x - i, y - j),
                    FontTransform::Rotate270 => (x + j, y - i),
                };
                self.draw_pixel(place, style.color())?;
            }
        }
        Ok(())
    }
}
