//! Events whose places were warped to the pixels of the frames: each pixel has the events of the event pixel
//! that sees it ([`crate::lattice`]).
//!
//! Where pixels of the frames are smaller, several have the same event; where they are larger, they have the
//! events of the nearest event pixel, and those of others are left out.

use crate::lattice::Lattice;
use photocurrent_core::Extent;
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;

/// Places are held in this many parts of a pixel.
const FINE: f64 = 4096.0;

/// A place in parts of a pixel, of a stored number that counts `scale` to a pixel.
#[inline]
pub(crate) fn fine(stored: f64, scale: u32) -> i64 {
    let parts = stored * (FINE / f64::from(scale));
    if parts.abs() < 1e9 { libm::round(parts) as i64 } else { crate::convention::NONE }
}

fn pixels((x, y): (i64, i64)) -> (f64, f64) {
    (x as f64 / FINE, y as f64 / FINE)
}

/// An event array next to frames of another camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Columns and rows of the array.
    pub extent: Extent,
    /// Column and row on the frames of each of its pixels, row by row, pixels.
    pub places: Vec<(f64, f64)>,
    /// What the places of events lie off these, root mean square, pixels of the frames.
    pub residual: f64,
    /// The files that state it.
    pub files: Vec<PathBuf>,
}

/// Which pixels of the frames have the events of a place.
#[derive(Clone, Debug)]
pub(crate) struct Warped {
    pub(crate) lattice: Lattice,
    extent: Extent,
    /// Of each event pixel, row by row, the first of its pixels in `pixels`; one more at the end.
    first: Vec<u32>,
    /// `y * width + x`.
    pixels: Vec<u32>,
    /// Event pixels of places that were sampled.
    known: HashMap<(i64, i64), u32>,
}

impl Warped {
    /// Of sampled places, in parts of a pixel, and the size of the frames; none where the places are no
    /// lattice, or are whole pixels.
    pub(crate) fn of(sampled: &HashSet<(i64, i64)>, extent: Extent) -> Option<Warped> {
        let is_whole = |(x, y): &(i64, i64)| x % FINE as i64 == 0 && y % FINE as i64 == 0;
        if sampled.iter().all(is_whole) {
            return None;
        }
        // In order: a set has none, and sums must be the same each time.
        let mut places: Vec<(i64, i64)> = sampled.iter().copied().collect();
        places.sort_unstable();
        let lattice = Lattice::of(&places.iter().map(|place| pixels(*place)).collect::<Vec<_>>())?;
        let width = lattice.size.width;
        let number = |(column, row): (u32, u32)| row * width + column;
        let seen = lattice.seen_by(extent);
        let count = lattice.size.pixels();
        let mut first = vec![0; count + 1];
        for pixel in seen.iter().flatten() {
            first[number(*pixel) as usize + 1] += 1;
        }
        for n in 0..count {
            first[n + 1] += first[n];
        }
        let mut next = first.clone();
        let mut of_pixels = vec![0; first[count] as usize];
        for (n, pixel) in (0..).zip(&seen) {
            let Some(pixel) = pixel else { continue };
            let place = &mut next[number(*pixel) as usize];
            of_pixels[*place as usize] = n;
            *place += 1;
        }
        let known = places
            .iter()
            .filter_map(|place| Some((*place, number(lattice.pixel(pixels(*place))?))))
            .collect();
        Some(Warped { lattice, extent, first, pixels: of_pixels, known })
    }

    /// Pixels, `y * width + x`, that have the events of a place; none where it is no event pixel's.
    pub(crate) fn pixels_of(&self, place: (i64, i64)) -> &[u32] {
        let width = self.lattice.size.width;
        let found = self.known.get(&place).copied().or_else(|| {
            let (column, row) = self.lattice.pixel(pixels(place))?;
            Some(row * width + column)
        });
        found.map_or(&[], |n| {
            &self.pixels[self.first[n as usize] as usize..self.first[n as usize + 1] as usize]
        })
    }

    /// Size of the frames.
    pub(crate) fn extent(&self) -> Extent {
        self.extent
    }

    /// For people.
    pub(crate) fn note(&self) -> String {
        let Lattice { size, pitch, residual, .. } = &self.lattice;
        format!(
            "places of events have fractions: they are a lattice of {size} with a pitch of {:.3} x {:.3} \
             pixels ({residual:.4} off it); each pixel has the events of the event pixel that sees it",
            pitch.0, pitch.1
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of an array of 60 x 40 with a pitch of 1.2, turned a little, in 32nds of a pixel.
    fn place(column: u32, row: u32) -> (i64, i64) {
        let (x, y) = (1.2 * f64::from(column), 1.2 * f64::from(row));
        let of = |value: f64| fine(libm::round(32.0 * value), 32);
        (of(x - 0.02 * y + 0.8), of(y + 0.02 * x - 0.3))
    }

    #[test]
    fn every_pixel_of_the_frames_has_the_events_of_one_event_pixel() {
        let extent = Extent { width: 70, height: 46 };
        let array = || (0..60).flat_map(|column| (0..40).map(move |row| (column, row)));
        // Every ninth has no event.
        let is_there = |(column, row): &(u32, u32)| (column + 7 * row) % 9 != 0;
        let sampled = array().filter(is_there).map(|(column, row)| place(column, row)).collect();
        let warped = Warped::of(&sampled, extent).expect("a lattice");
        assert_eq!(warped.lattice.size, Extent { width: 60, height: 40 });
        let mut owners = vec![0; extent.pixels()];
        for (column, row) in array() {
            for pixel in warped.pixels_of(place(column, row)) {
                owners[*pixel as usize] += 1;
                let (x, y) = pixels(place(column, row));
                let at = (f64::from(pixel % 70), f64::from(pixel / 70));
                // Half the diagonal of a cell, and the parts that places are held in.
                assert!(
                    libm::hypot(x - at.0, y - at.1) < 0.6 * 2.0_f64.sqrt() + 0.05,
                    "{column} {row} {at:?}"
                );
            }
        }
        // Of the inner ones each has exactly one, and none has two.
        let mut inner = (5..40 * 70).filter(|n| n / 70 >= 5 && (5..60).contains(&(n % 70)));
        assert!(inner.all(|n| owners[n] == 1) && owners.iter().all(|count| *count <= 1));
    }

    #[test]
    fn places_cover_the_frames_also_where_nothing_moved() {
        // Events in a part of the array alone.
        let extent = Extent { width: 70, height: 46 };
        let part = (20..45).flat_map(|column| (10..30).map(move |row| place(column, row))).collect();
        let warped = Warped::of(&part, extent).expect("a lattice");
        assert_eq!(warped.lattice.size, Extent { width: 25, height: 20 });
        let (size, places) = warped.lattice.places(extent);
        let at = |column: usize, row: usize| places[row * size.width as usize + column];
        let last = (size.width as usize - 1, size.height as usize - 1);
        let corners = [at(0, 0), at(last.0, 0), at(0, last.1), at(last.0, last.1)];
        assert!(corners[0].0 < 0.0 && corners[0].1 < 0.0, "{corners:?}");
        assert!(corners[3].0 > 69.0 && corners[3].1 > 45.0, "{corners:?}");
        // Each is the place of a pixel of the array, whole columns and rows away.
        let (x, y) = places[0];
        let (x, y) = (x - 0.8, y + 0.3);
        let (row, column) = ((y - 0.02 / 1.0 * x) / (1.2 * 1.0004), (x + 0.02 * y) / (1.2 * 1.0004));
        assert!((row - row.round()).abs() < 0.1 && (column - column.round()).abs() < 0.1, "{row} {column}");
    }

    #[test]
    fn whole_pixels_stay_as_they_are() {
        let whole =
            (0..50).flat_map(|x| (0..50).map(move |y| (fine(x.into(), 1), fine(y.into(), 1)))).collect();
        assert!(Warped::of(&whole, Extent { width: 50, height: 50 }).is_none());
    }
}
