//! Registers one frame to the next: an affine map, found by a search over turns and shifts and refined by
//! Gauss-Newton.
//!
//! Source: Evangelidis and Psarakis, Parametric Image Alignment Using Enhanced Correlation Coefficient
//! Maximization, PAMI 2008; Lucas and Kanade, IJCAI 1981.

use super::motion::{AffineMap as Affine, DEGREES, RIGID, apply, derivatives, map_of, pose_of};
use crate::image::Image;
use multiversion::multiversion;
use nalgebra::{SMatrix, SVector};

/// Ranges of the search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RegisterSearch {
    /// Largest turn between two frames, radians.
    pub turn: f64,
    /// Step of the search over turns, radians.
    pub turn_step: f64,
    /// Largest shift, as a share of the array's longer side.
    pub shift: f64,
    /// Correlation that a turn must add, per radian, to be preferred to none.
    pub turn_cost: f64,
    /// Correlation that a shift over the whole array's longer side must add.
    pub shift_cost: f64,
    /// Standard deviation of scale and shear from one frame to the next, pixels at the array's edge.
    pub stretch: f64,
    /// Share to which scale and shear must reduce the correlation's deficit to 1.
    pub stretched: f64,
    /// Rounds of Gauss-Newton.
    pub rounds: usize,
}

impl Default for RegisterSearch {
    fn default() -> RegisterSearch {
        RegisterSearch {
            turn: 1.05,
            turn_step: 0.07,
            shift: 0.2,
            turn_cost: 0.03,
            shift_cost: 0.1,
            stretch: 0.5,
            stretched: 0.5,
            rounds: 30,
        }
    }
}

/// Turns and shifts are searched in images that are halved until no side is longer.
const COARSE: usize = 96;
/// Of an image of more pixels every second one of every second row takes part in steps of Gauss-Newton.
const LARGE: usize = 20_000;

/// Where the places of `moved` lie on `still`, and the correlation of both there (-1 to 1).
///
/// # Panics
/// When the images differ in size or are smaller than 8 x 8.
pub(crate) fn register(
    still: &Image,
    moved: &Image,
    search: &RegisterSearch,
    begin: Option<Affine>,
) -> (Affine, f64) {
    assert!(
        still.width == moved.width && still.height == moved.height && still.width.min(still.height) >= 8,
        "two images of one size, at least 8 x 8"
    );
    let (a, b) = (still.smoothed(1), moved.smoothed(1));
    let mut best: Option<(Affine, f64)> = None;
    let half = a.centre().0.max(a.centre().1).max(1.0);
    // At least once.
    let mut halved = vec![(a.halved(), b.halved())];
    while let Some((still, moved)) = halved.last().filter(|(still, _)| still.width.max(still.height) > COARSE)
    {
        halved.push((still.halved(), moved.halved()));
    }
    let (still, moved) = halved.pop().expect("one is there");
    let mut starts = coarse(&still, &moved, 2 << halved.len(), search);
    // What lies between is no more than a pixel or two off.
    for start in &mut starts {
        for (n, (still, moved)) in halved.iter().enumerate().rev() {
            let scaled = |map: &Affine, by: f64| [map[0] * by, map[1], map[2], map[3] * by, map[4], map[5]];
            let by = (2 << n) as f64;
            *start = scaled(
                &refine(
                    &still.smoothed(2),
                    &moved.smoothed(2),
                    scaled(start, 1.0 / by),
                    search,
                    search.rounds / 2,
                ),
                by,
            );
        }
    }
    starts.extend(begin);
    for start in starts {
        let coarse = refine(&a.smoothed(2), &b.smoothed(2), start, search, search.rounds / 2);
        let stretched = refine(&a, &b, coarse, search, search.rounds);
        // Scale and shear only where they explain: a star has none of its own.
        let mut pose = pose_of(&stretched, half);
        pose[RIGID..].fill(0.0);
        let rigid =
            refine(&a, &b, map_of(&pose, half), &RegisterSearch { stretch: 1e-6, ..*search }, search.rounds);
        let left = |map: &Affine| 1.0 - correlation(&a, &b, map);
        let map = if left(&stretched) < search.stretched * left(&rigid) { stretched } else { rigid };
        let score = correlation(&a, &b, &map) - cost(&map, search, still.width);
        if best.is_none_or(|(_, least)| score > least) {
            best = Some((map, score));
        }
    }
    let (map, _) = best.unwrap_or(([0.0, 1.0, 0.0, 0.0, 0.0, 1.0], 0.0));
    (map, correlation(&a, &b, &map))
}

fn cost(map: &Affine, search: &RegisterSearch, width: usize) -> f64 {
    let turn = libm::atan2(map[4] - map[2], map[1] + map[5]).abs();
    search.turn_cost * turn + search.shift_cost * libm::hypot(map[0], map[3]) / width as f64
}

/// Turns and shifts of images that were made smaller `by` so much whose correlation is largest, in full
/// pixels.
fn coarse(a: &Image, b: &Image, by: usize, search: &RegisterSearch) -> Vec<Affine> {
    let reach = (search.shift * a.width.max(a.height) as f64).ceil() as i64;
    let steps = (search.turn / search.turn_step).floor() as i64;
    let mut found: Vec<(f64, Affine)> = Vec::new();
    let still = MaskedImage::from_image(a);
    for turn in -steps..=steps {
        let angle = turn as f64 * search.turn_step;
        let (c, s) = (libm::cos(angle), libm::sin(angle));
        let moved = MaskedImage::rotated(b, (c, s));
        let mut best: Option<(f64, Affine)> = None;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let full = [by as f64 * dx as f64, c, -s, by as f64 * dy as f64, s, c];
                let score =
                    still.correlation(&moved, dx as isize, dy as isize) - cost(&full, search, by * a.width);
                if best.is_none_or(|(least, _)| score > least) {
                    best = Some((score, full));
                }
            }
        }
        found.extend(best);
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(3);
    found.into_iter().map(|(_, map)| map).collect()
}

/// An image less its mean, and where it is: 1, and 0 elsewhere.
struct MaskedImage {
    width: usize,
    height: usize,
    values: Vec<f32>,
    mask: Vec<f32>,
}

impl MaskedImage {
    fn from_image(image: &Image) -> MaskedImage {
        MaskedImage::rotated(image, (1.0, 0.0))
    }

    /// Turned about its centre by an angle of this cosine and sine.
    fn rotated(image: &Image, (c, s): (f64, f64)) -> MaskedImage {
        let (width, height) = (image.width, image.height);
        let (cx, cy) = image.centre();
        let mean = (image.values.iter().map(|v| f64::from(*v)).sum::<f64>() / (width * height) as f64) as f32;
        let (mut values, mut mask) = (vec![0.0; width * height], vec![0.0; width * height]);
        for k in 0..width * height {
            let (x, y) = ((k % width) as f64 - cx, (k / width) as f64 - cy);
            if let Some((value, ..)) = image.sample(c * x + s * y + cx, c * y - s * x + cy) {
                (values[k], mask[k]) = (value as f32 - mean, 1.0);
            }
        }
        MaskedImage { width, height, values, mask }
    }

    /// The correlation with another one shifted by whole pixels, where both are; -1 where they share less
    /// than half of the array.
    fn correlation(&self, moved: &MaskedImage, dx: isize, dy: isize) -> f64 {
        let (w, h) = (self.width as isize, self.height as isize);
        let mut sums = [0.0_f64; 6];
        let (from, to) = (dx.max(0), (w + dx).min(w));
        if from < to {
            for y in dy.max(0)..(h + dy).min(h) {
                let still = (y * w + from) as usize..(y * w + to) as usize;
                let begun = ((y - dy) * w + from - dx) as usize;
                let of = begun..begun + still.len();
                let line = line_sums(&self.values[still], &moved.values[of.clone()], &moved.mask[of]);
                sums.iter_mut().zip(line).for_each(|(sum, of_line)| *sum += f64::from(of_line));
            }
        }
        let [n, sa, sb, saa, sbb, sab] = sums;
        let (va, vb) = (saa - sa * sa / n, sbb - sb * sb / n);
        if n < 0.5 * (w * h) as f64 || va <= 0.0 || vb <= 0.0 {
            -1.0
        } else {
            (sab - sa * sb / n) / libm::sqrt(va * vb)
        }
    }
}

/// Sums over a line: of the mask, of both, of their squares and of their product.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn line_sums(a: &[f32], b: &[f32], mask: &[f32]) -> [f32; 6] {
    const LANES: usize = 8;
    let mut sums = [[0.0_f32; LANES]; 6];
    let mut take = |lane: usize, a: f32, b: f32, mask: f32| {
        let a_there = a * mask;
        for (sum, value) in sums.iter_mut().zip([mask, a_there, b, a_there * a, b * b, a * b]) {
            sum[lane] += value;
        }
    };
    let ((a, a_end), (b, b_end), (mask, mask_end)) =
        (a.as_chunks::<LANES>(), b.as_chunks::<LANES>(), mask.as_chunks::<LANES>());
    for ((a, b), mask) in a.iter().zip(b).zip(mask) {
        for lane in 0..LANES {
            take(lane, a[lane], b[lane], mask[lane]);
        }
    }
    for (lane, ((a, b), mask)) in a_end.iter().zip(b_end).zip(mask_end).enumerate() {
        take(lane, *a, *b, *mask);
    }
    sums.map(|sum| sum.iter().sum())
}

/// The correlation where both are; -1 where they share less than half of the array.
fn correlation(a: &Image, b: &Image, map: &Affine) -> f64 {
    let (cx, cy) = a.centre();
    let mut n = 0.0;
    let (mut sa, mut sb, mut saa, mut sbb, mut sab) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for j in 0..b.height {
        for i in 0..b.width {
            let (x, y) = (i as f64 - cx, j as f64 - cy);
            let place = (map[0] + map[1] * x + map[2] * y + cx, map[3] + map[4] * x + map[5] * y + cy);
            if let Some((va, ..)) = a.sample(place.0, place.1) {
                let vb = f64::from(b.values[j * b.width + i]);
                n += 1.0;
                sa += va;
                sb += vb;
                saa += va * va;
                sbb += vb * vb;
                sab += va * vb;
            }
        }
    }
    let all = (b.width * b.height) as f64;
    let (va, vb) = (saa - sa * sa / n, sbb - sb * sb / n);
    if n < 0.5 * all || va <= 0.0 || vb <= 0.0 { -1.0 } else { (sab - sa * sb / n) / libm::sqrt(va * vb) }
}

/// Gauss-Newton on the pose and on gain and offset of the values, with Cauchy weights.
fn refine(a: &Image, b: &Image, start: Affine, search: &RegisterSearch, rounds: usize) -> Affine {
    const VALUES: usize = DEGREES + 2;
    let (cx, cy) = a.centre();
    let half = cx.max(cy).max(1.0);
    let mut pose = pose_of(&start, half);
    let (mut gain, mut offset) = (1.0, 0.0);
    let mut scale = f64::INFINITY;
    let stride = if b.values.len() > LARGE { 2 } else { 1 };
    for _ in 0..rounds {
        let map = map_of(&pose, half);
        let mut normal = SMatrix::<f64, VALUES, VALUES>::zeros();
        let mut right = SVector::<f64, VALUES>::zeros();
        let mut sizes = Vec::with_capacity(b.values.len());
        for j in (0..b.height).step_by(stride) {
            for i in (0..b.width).step_by(stride) {
                let (x, y) = (i as f64 - cx, j as f64 - cy);
                let place = apply(&map, x, y);
                let Some((value, gx, gy)) = a.sample(place.0 + cx, place.1 + cy) else { continue };
                let vb = f64::from(b.values[j * b.width + i]);
                let residual = gain * vb + offset - value;
                sizes.push(residual.abs());
                let far = residual / (2.5 * scale);
                let weight = if scale.is_finite() { 1.0 / (1.0 + far * far) } else { 1.0 };
                let moved = derivatives(&map, &pose, half, x, y).map(|(dx, dy)| gx * dx + gy * dy);
                let row = SVector::<f64, VALUES>::from_fn(|n, _| match n {
                    n if n < DEGREES => moved[n],
                    DEGREES => -vb,
                    _ => -1.0,
                });
                normal += weight * row * row.transpose();
                right += weight * residual * row;
            }
        }
        if sizes.len() < b.values.len() / (3 * stride * stride) {
            break;
        }
        let middle = sizes.len() / 2;
        sizes.select_nth_unstable_by(middle, f64::total_cmp);
        scale = f64::max(1.48 * sizes[middle], 1e-6);
        for k in 0..VALUES {
            normal[(k, k)] += 1e-6 * normal[(k, k)] + 1e-12;
        }
        for k in RIGID..DEGREES {
            let hold = scale * scale / (search.stretch * search.stretch);
            normal[(k, k)] += hold;
            right[k] -= hold * pose[k];
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&right)) else { break };
        for (k, value) in pose.iter_mut().enumerate() {
            *value += step[k];
        }
        gain += step[DEGREES];
        offset += step[DEGREES + 1];
        if (0..DEGREES).all(|k| step[k].abs() < 1e-4) {
            break;
        }
    }
    map_of(&pose, half)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(map: &Affine, (width, height): (usize, usize)) -> Image {
        let of = |k: usize| {
            let (x, y) = (
                (k % width) as f64 - 0.5 * (width as f64 - 1.0),
                (k / width) as f64 - 0.5 * (height as f64 - 1.0),
            );
            let (x, y) = (map[0] + map[1] * x + map[2] * y, map[3] + map[4] * x + map[5] * y);
            let waves = [(0.21, 0.05, 0.3), (-0.09, 0.17, 1.1), (0.13, 0.19, 2.0), (0.31, -0.22, 0.7)];
            waves.iter().map(|(a, b, c)| libm::sin(a * x + b * y + c)).sum::<f64>() as f32
        };
        Image { width, height, values: (0..width * height).map(of).collect() }
    }

    #[test]
    fn a_turned_and_shifted_image_is_found() {
        // The last one is halved twice, and compared at every second pixel.
        let (small, large) = ((60, 44), (346, 260));
        for (angle, dx, dy, size) in [
            (0.0, 2.3, -1.2, small),
            (0.3, 1.0, 0.5, small),
            (-0.75, 0.0, 3.0, small),
            (0.3, 21.3, -8.4, large),
        ] {
            let (c, s) = (libm::cos(angle), libm::sin(angle));
            let map = [dx, c, -s, dy, s, c];
            let (found, correlation) = register(
                &scene(&[0.0, 1.0, 0.0, 0.0, 0.0, 1.0], size),
                &scene(&map, size),
                &RegisterSearch::default(),
                None,
            );
            assert!(correlation > 0.99, "{correlation}");
            for k in 0..6 {
                let far = (found[k] - map[k]).abs() * if k % 3 == 0 { 1.0 } else { 20.0 };
                assert!(far < 0.15, "{angle}: {found:?} {map:?}");
            }
        }
    }
}
