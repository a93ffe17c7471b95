//! Selects the part of the array, and the pitch, of a joint picture: details that a coarse grid cannot
//! represent need a fine one, on a part of the array.

use super::fields::GridFields;
use crate::block::Block;
use crate::case::Case;
use crate::moving::MovingPicture;

/// Most coefficients of a picture, of the whole array and of a part.
const MOST_COEFFICIENTS: f64 = 20_000.0;
const MOST_OF_PART: usize = 26_000;
/// Finest and coarsest pitch on the whole array, pixels.
const PITCHES: (f64, f64) = (0.8, 1.3);
/// No picture has more coefficients than this.
pub(super) const LARGEST: usize = 45_000;
/// Sides of a part are a share of the array's: each tried is this much of the one before.
const SMALLER: f64 = 0.93;
/// Shortest side of a part, pixels.
const LEAST_SIDE: usize = 12;

/// A part of the array, and how finely the picture is estimated there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayPart {
    /// Its pixels.
    pub block: Block,
    /// Distance of coefficients, pixels.
    pub pitch: f64,
}

impl ArrayPart {
    /// The whole array as finely as coefficients allow, or else the busiest part.
    pub fn first(case: &Case, scene: &MovingPicture, weight: &[usize]) -> Option<ArrayPart> {
        let grid = scene.picture.grid;
        let fields = GridFields::from_picture(&scene.picture).count;
        let area = fields as f64 * (grid.width as f64 * grid.pitch) * (grid.height as f64 * grid.pitch);
        let pitch = (area / MOST_COEFFICIENTS).sqrt().clamp(PITCHES.0, PITCHES.1);
        let block = Block::whole_array(case.extent);
        match fields * scene.picture.covering(case, &block, pitch).coefficients() <= LARGEST {
            true => Some(ArrayPart { block, pitch }),
            false => ArrayPart::of_most_weight(case, scene, PITCHES.0, weight),
        }
    }

    /// The largest part that coefficients of a pitch allow, where the sum of `weight`, a number for each
    /// pixel of the array, is largest; none where that is less than 12 pixels wide or high.
    pub fn of_most_weight(
        case: &Case,
        scene: &MovingPicture,
        pitch: f64,
        weight: &[usize],
    ) -> Option<ArrayPart> {
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let sums = IntegralSums::integrate(weight, width);
        let mut share = 1.0;
        loop {
            let side = |of: usize| (of as f64 * share).round() as usize;
            let (w, h) = (side(width), side(height));
            if w.min(h) < LEAST_SIDE {
                return None;
            }
            let places = (0..=height - h).flat_map(|y| (0..=width - w).map(move |x| (x, y)));
            let fields = GridFields::from_picture(&scene.picture).count;
            let fits = |block: &Block| {
                fields * scene.picture.covering(case, block, pitch).coefficients() <= MOST_OF_PART
            };
            let block = places
                .map(|(x, y)| Block { x, y, width: w, height: h })
                .filter(fits)
                .max_by_key(|block| (sums.within(block), std::cmp::Reverse((block.y, block.x))));
            if let Some(block) = block {
                return Some(ArrayPart { block, pitch });
            }
            share *= SMALLER;
        }
    }
}

/// Sums of numbers over everything above and left of a place.
struct IntegralSums {
    width: usize,
    sums: Vec<usize>,
}

impl IntegralSums {
    fn integrate(values: &[usize], width: usize) -> IntegralSums {
        let stride = width + 1;
        let mut sums = vec![0; stride * (values.len() / width + 1)];
        for (n, value) in values.iter().enumerate() {
            let at = (n / width + 1) * stride + n % width + 1;
            sums[at] = value + sums[at - 1] + sums[at - stride] - sums[at - stride - 1];
        }
        IntegralSums { width: stride, sums }
    }

    fn within(&self, block: &Block) -> usize {
        let at = |x: usize, y: usize| self.sums[y * self.width + x];
        let (right, below) = (block.x + block.width, block.y + block.height);
        at(right, below) + at(block.x, block.y) - at(block.x, below) - at(right, block.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::PictureSetting;
    use crate::testing;
    use photocurrent_core::Extent;

    #[test]
    fn the_largest_part_that_fits_is_where_the_weight_is() {
        let case = testing::texture(Extent { width: 40, height: 32 }, 5);
        let nominal = case.nominal().unwrap();
        let scene = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
        // All of it in the corner.
        let weight: Vec<usize> = (0..40 * 32).map(|n| usize::from(n % 40 > 30 && n / 40 > 24)).collect();
        let [coarse, fine] = [0.5, 0.2]
            .map(|pitch| ArrayPart::of_most_weight(&case, &scene, pitch, &weight).expect("a part fits"));
        assert_eq!(coarse.block, Block::whole_array(case.extent));
        // On the finest pitch of the whole array that is still all of it.
        assert_eq!(ArrayPart::first(&case, &scene, &weight).map(|part| part.block), Some(coarse.block));
        let Block { x, y, width, height } = fine.block;
        assert!(width < 40 && x + width == 40 && y + height == 32, "{fine:?}");
        // A part a step larger would be too much.
        let count = |width: usize, height: usize| {
            let block = Block { x: 40 - width, y: 32 - height, width, height };
            scene.picture.covering(&case, &block, 0.2).coefficients()
        };
        assert!(count(width, height) <= MOST_OF_PART && count(width + 3, height + 3) > MOST_OF_PART);
        assert!(ArrayPart::of_most_weight(&case, &scene, 0.01, &weight).is_none());
    }

    #[test]
    fn sums_over_rectangles_are_those_of_their_pixels() {
        let values: Vec<usize> = (0..35).map(|n| n * n % 11).collect();
        let sums = IntegralSums::integrate(&values, 7);
        for (x, y, width, height) in [(0, 0, 7, 5), (2, 1, 3, 4), (6, 4, 1, 1), (1, 2, 5, 1)] {
            let sum: usize = (y..y + height)
                .flat_map(|y| (x..x + width).map(move |x| (x, y)))
                .map(|(x, y)| values[y * 7 + x])
                .sum();
            assert_eq!(sums.within(&Block { x, y, width, height }), sum);
        }
    }
}
