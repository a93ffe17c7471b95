//! Places of an event array's pixels on frames of another camera.
//!
//! Each event pixel has a place on the frames, in pixels: by a calibration, or recovered from events that
//! were warped there. Frames are resampled to event pixels as means over what each covers. Values solved on
//! the event array are interpolated to the frames' pixels, bilinear between the four event pixels around
//! each.
//!
//! Limits: places are a smooth map that turns by less than a right angle and does not fold. Beyond the event
//! array a pixel has the value of the nearest event pixel, up to one pitch, and none further out.

use crate::image::{Image, bracketing_index};
use photocurrent_core::{Extent, MapBand, MapMeta, MapSet, NodeError};
use rayon::prelude::*;
use std::sync::Arc;

/// Names of the two planes of a map of places: column and row on the frames, pixels.
pub const PLANES: [&str; 2] = ["x [px]", "y [px]"];

/// Samples per pixel along either side.
const SAMPLES: usize = 3;
/// Steps of the inverse, at most.
const STEPS: usize = 30;
/// The inverse has been found to this, event pixels.
const FOUND: f64 = 1e-4;

/// Places of the pixels of an event array on frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Size of the event array.
    pub events: Extent,
    /// Column of each event pixel's place, row by row, pixels of the frames.
    pub x: Vec<f32>,
    /// Row of it.
    pub y: Vec<f32>,
}

/// The parts of an event pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelParts(Vec<(f64, f64)>);

/// Bilinear weights of the event pixels around a pixel of the frames; all 0 where there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BilinearWeights {
    /// Numbers of the event pixels, row by row.
    pub at: [usize; 4],
    /// They sum to 1.
    pub weights: [f32; 4],
}

impl Alignment {
    /// From a map with the planes [`PLANES`].
    ///
    /// # Errors
    /// When the map cannot be read, or holds a number that is no place.
    pub fn from_map(map: &MapSet) -> Result<Alignment, NodeError> {
        Alignment::check(&map.meta)?;
        let (events, band) = (map.meta.extent, map.read(map.meta.extent.rows())?);
        let plane = |plane: usize| -> Vec<f32> {
            events.rows().iter().flat_map(|row| band.row(plane, row).to_vec()).collect()
        };
        let alignment = Alignment { events, x: plane(0), y: plane(1) };
        if alignment.x.iter().chain(&alignment.y).any(|place| !place.is_finite()) {
            return Err(NodeError::input("the map has event pixels without a place (NaN or infinite)")
                .hint("connect the output of read/alignment"));
        }
        Ok(alignment)
    }

    /// Refuses a map that is none of places.
    ///
    /// # Errors
    /// When its planes have other names, or it has less than two rows or columns.
    pub fn check(map: &MapMeta) -> Result<(), NodeError> {
        if map.planes != PLANES {
            return Err(NodeError::usage(format!(
                "the map has the planes {}, and an alignment has {}",
                map.planes.join(", "),
                PLANES.join(", ")
            ))
            .hint("connect the output of read/alignment"));
        }
        if map.extent.width < 2 || map.extent.height < 2 {
            return Err(NodeError::usage(format!("an event array of {} has no lattice", map.extent)));
        }
        Ok(())
    }

    /// Metadata of its map.
    pub fn meta(events: Extent) -> MapMeta {
        MapMeta { extent: events, planes: PLANES.map(String::from).to_vec() }
    }

    /// The map of these places.
    pub fn into_map(self) -> MapSet {
        let meta = Alignment::meta(self.events);
        let mut band = MapBand::zeros(self.events.rows(), &meta);
        let width = self.events.width as usize;
        let rows = self.x.chunks_exact(width).zip(self.y.chunks_exact(width));
        for (row, (x, y)) in (0..).zip(rows) {
            band.row_mut(0, row).copy_from_slice(x);
            band.row_mut(1, row).copy_from_slice(y);
        }
        MapSet::in_memory(Arc::new(meta), band)
    }

    fn frame_place(&self, column: usize, row: usize) -> (f64, f64) {
        let at = row * self.events.width as usize + column;
        (f64::from(self.x[at]), f64::from(self.y[at]))
    }

    /// The place of a fractional column and row, bilinear; extrapolated beyond the array.
    pub fn place_at(&self, column: f64, row: f64) -> (f64, f64) {
        let (columns, lines) = (self.events.width as usize, self.events.height as usize);
        let ((i, s), (j, t)) = (bracketing_index(column, columns), bracketing_index(row, lines));
        let (a, b) = (self.frame_place(i, j), self.frame_place(i + 1, j));
        let (c, d) = (self.frame_place(i, j + 1), self.frame_place(i + 1, j + 1));
        let mix = |a: f64, b: f64, c: f64, d: f64| {
            (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
        };
        (mix(a.0, b.0, c.0, d.0), mix(a.1, b.1, c.1, d.1))
    }

    /// Steps from one event pixel to the next in columns and in rows, in the middle of the array.
    fn basis(&self) -> [(f64, f64); 2] {
        let (column, row) = (self.events.width as f64 / 2.0, self.events.height as f64 / 2.0);
        let (at, right, below) =
            (self.place_at(column, row), self.place_at(column + 1.0, row), self.place_at(column, row + 1.0));
        [(right.0 - at.0, right.1 - at.1), (below.0 - at.0, below.1 - at.1)]
    }

    /// Distance of event pixels in the middle of the array along columns and rows, pixels of the frames.
    pub fn pitch(&self) -> [f64; 2] {
        self.basis().map(|(x, y)| libm::hypot(x, y))
    }

    /// The fractions of a column and row whose place this is; none where the inverse does not converge.
    pub fn inverse(&self, place: (f64, f64), from: (f64, f64)) -> Option<(f64, f64)> {
        let (mut column, mut row) = from;
        for _ in 0..STEPS {
            let at = self.place_at(column, row);
            let (off_x, off_y) = (place.0 - at.0, place.1 - at.1);
            // Jacobian by differences over a pixel, which is exact within a cell.
            let right = self.place_at(column + 0.5, row);
            let left = self.place_at(column - 0.5, row);
            let below = self.place_at(column, row + 0.5);
            let above = self.place_at(column, row - 0.5);
            let (a, b) = (right.0 - left.0, below.0 - above.0);
            let (c, d) = (right.1 - left.1, below.1 - above.1);
            let determinant = a * d - b * c;
            if determinant.abs() < 1e-9 {
                return None;
            }
            let step = ((d * off_x - b * off_y) / determinant, (a * off_y - c * off_x) / determinant);
            (column, row) = (column + step.0, row + step.1);
            if !(column.is_finite() && row.is_finite()) {
                return None;
            }
            if step.0.abs() < FOUND && step.1.abs() < FOUND {
                return Some((column, row));
            }
        }
        None
    }

    /// The event pixels around each pixel of frames of a size, row by row.
    pub fn bilinear_weights(&self, frames: Extent) -> Vec<BilinearWeights> {
        let none = BilinearWeights { at: [0; 4], weights: [0.0; 4] };
        let (columns, lines) = (self.events.width as usize, self.events.height as usize);
        let middle = (columns as f64 / 2.0, lines as f64 / 2.0);
        let of_line = |y: usize| {
            let mut last = middle;
            let of = |x: usize| {
                let place = (x as f64, y as f64);
                let Some(found) = self.inverse(place, last).or_else(|| self.inverse(place, middle)) else {
                    return none;
                };
                last = found;
                let inside = |at: f64, count: usize| (-1.0..=count as f64).contains(&at);
                if !inside(found.0, columns) || !inside(found.1, lines) {
                    return none;
                }
                let cell = |at: f64, count: usize| {
                    let (cell, rest) = bracketing_index(at.clamp(0.0, (count - 1) as f64), count);
                    (cell, rest as f32)
                };
                let ((i, s), (j, t)) = (cell(found.0, columns), cell(found.1, lines));
                let at = j * columns + i;
                BilinearWeights {
                    at: [at, at + 1, at + columns, at + columns + 1],
                    weights: [(1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s],
                }
            };
            (0..frames.width as usize).map(of).collect::<Vec<BilinearWeights>>()
        };
        let lines: Vec<Vec<BilinearWeights>> =
            (0..frames.height as usize).into_par_iter().map(of_line).collect();
        lines.concat()
    }

    /// The pixel of frames of a size at which an event pixel's place lies; none beyond them.
    pub fn nearest(&self, at: usize, frames: Extent) -> Option<(usize, usize)> {
        let whole = |place: f32| (place + 0.5).floor() as usize;
        self.is_seen(at, frames).then(|| (whole(self.x[at]), whole(self.y[at])))
    }

    /// Whether an event pixel's place lies on frames of a size.
    pub fn is_seen(&self, at: usize, frames: Extent) -> bool {
        let inside = |place: f32, count: u32| (-0.5..count as f32 - 0.5).contains(&place);
        inside(self.x[at], frames.width) && inside(self.y[at], frames.height)
    }

    /// Resamples a picture of the frames to the event pixels: means over what each covers. Beyond the frames
    /// the border value is used.
    pub fn to_events(&self, picture: &Image) -> Image {
        let (columns, lines) = (self.events.width as usize, self.events.height as usize);
        let frames = Extent { width: picture.width as u32, height: picture.height as u32 };
        let cell = self.pixel_parts();
        let read = |at: usize| {
            let mut sum = 0.0;
            self.covered(&cell, at, frames, |pixel, share| sum += share * f64::from(picture.values[pixel]));
            sum as f32
        };
        let values = (0..columns * lines).into_par_iter().map(read).collect();
        Image { width: columns, height: lines, values }
    }

    /// Offsets of the parts of an event pixel from its place, pixels of the frames.
    pub fn pixel_parts(&self) -> PixelParts {
        let basis = self.basis();
        let share = |n: usize| (n as f64 + 0.5) / SAMPLES as f64 - 0.5;
        let of = |n: usize, m: usize| {
            // Pixels of the frames are means over a pixel already: what is wider is sampled.
            let (u, v) = (self.extra_width(0) * share(n), self.extra_width(1) * share(m));
            (u * basis[0].0 + v * basis[1].0, u * basis[0].1 + v * basis[1].1)
        };
        if self.extra_width(0) == 0.0 && self.extra_width(1) == 0.0 {
            return PixelParts(vec![(0.0, 0.0)]);
        }
        PixelParts(
            (0..SAMPLES).flat_map(|n| (0..SAMPLES).map(move |m| (n, m))).map(|(n, m)| of(n, m)).collect(),
        )
    }

    /// Calls `each` with the pixels of frames that an event pixel covers, and their shares; a pixel may come
    /// several times, and shares sum to 1.
    pub fn covered(&self, cell: &PixelParts, at: usize, frames: Extent, mut each: impl FnMut(usize, f64)) {
        let (x, y) = (f64::from(self.x[at]), f64::from(self.y[at]));
        let width = frames.width as usize;
        let part = 1.0 / cell.0.len() as f64;
        let split =
            |at: f64, count: u32| bracketing_index(at.clamp(0.0, f64::from(count - 1)), count as usize);
        for (right, down) in &cell.0 {
            let ((i, s), (j, t)) = (split(x + right, frames.width), split(y + down, frames.height));
            let corners =
                [(0, 0, (1.0 - s) * (1.0 - t)), (1, 0, s * (1.0 - t)), (0, 1, (1.0 - s) * t), (1, 1, s * t)];
            for (right, down, share) in corners.into_iter().filter(|(.., share)| *share > 0.0) {
                each((j + down) * width + i + right, part * share);
            }
        }
    }

    /// Width of an event pixel beyond a pixel of the frames, as a share of its pitch; 0 where it is no
    /// larger.
    fn extra_width(&self, axis: usize) -> f64 {
        let pitch = self.pitch()[axis];
        f64::max(pitch * pitch - 1.0, 0.0).sqrt() / f64::max(pitch, f64::MIN_POSITIVE)
    }
}

impl BilinearWeights {
    /// The value at a pixel of the frames, interpolated from values of the event pixels.
    pub fn interpolate(&self, values: &[f32]) -> f32 {
        self.at.iter().zip(self.weights).map(|(at, weight)| weight * values[*at]).sum()
    }

    /// Has it event pixels?
    pub fn is_known(&self) -> bool {
        self.weights.iter().any(|weight| *weight > 0.0)
    }

    /// Index of the event pixel with the largest weight.
    pub fn nearest(&self) -> usize {
        let first = (self.at[0], self.weights[0]);
        let pairs = self.at.into_iter().zip(self.weights);
        pairs.fold(first, |best, one| if one.1 > best.1 { one } else { best }).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVENTS: Extent = Extent { width: 40, height: 30 };

    /// A pitch of 1.2, turned by 3 degrees, bent a little.
    fn bent() -> Alignment {
        let place = |at: usize| {
            let (c, r) = ((at % 40) as f64, (at / 40) as f64);
            (1.2 * c - 0.06 * r + 0.002 * c * r + 2.3, 1.2 * r + 0.06 * c - 0.001 * c * c + 1.7)
        };
        let all: Vec<(f64, f64)> = (0..EVENTS.pixels()).map(place).collect();
        Alignment {
            events: EVENTS,
            x: all.iter().map(|place| place.0 as f32).collect(),
            y: all.iter().map(|place| place.1 as f32).collect(),
        }
    }

    #[test]
    fn the_inverse_of_a_place_is_its_pixel() {
        let alignment = bent();
        for (column, row) in [(0.0, 0.0), (12.3, 20.8), (38.9, 28.5), (5.5, 0.2)] {
            let place = alignment.place_at(column, row);
            let found = alignment.inverse(place, (20.0, 15.0)).expect("it converges");
            assert!((found.0 - column).abs() < 1e-3 && (found.1 - row).abs() < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn a_plane_goes_to_the_event_pixels_and_back_unchanged() {
        let (alignment, frames) = (bent(), Extent { width: 46, height: 36 });
        let plane = |x: f64, y: f64| 3.0 + 0.4 * x - 0.7 * y;
        let values =
            (0..frames.pixels()).map(|at| plane((at % 46) as f64, (at / 46) as f64) as f32).collect();
        let picture = Image { width: 46, height: 36, values };
        let seen = alignment.to_events(&picture);
        for (at, value) in seen.values.iter().enumerate() {
            let (x, y) = (f64::from(alignment.x[at]), f64::from(alignment.y[at]));
            if (1.0..44.0).contains(&x) && (1.0..34.0).contains(&y) {
                assert!((f64::from(*value) - plane(x, y)).abs() < 1e-3, "{at}");
            }
        }
        for (at, around) in alignment.bilinear_weights(frames).iter().enumerate() {
            let (x, y) = ((at % 46) as f64, (at / 46) as f64);
            if (6.0..40.0).contains(&x) && (6.0..28.0).contains(&y) {
                let sum: f32 = around.weights.iter().sum();
                assert!((sum - 1.0).abs() < 1e-5);
                // Places between are bilinear, and the map bends little within a cell.
                assert!((f64::from(around.interpolate(&seen.values)) - plane(x, y)).abs() < 5e-3, "{x} {y}");
            }
        }
    }

    #[test]
    fn far_beyond_the_array_nothing_is_known() {
        let around = bent().bilinear_weights(Extent { width: 80, height: 60 });
        assert!(!around[79].is_known() && !around[59 * 80].is_known() && around[20 * 80 + 20].is_known());
    }
}
