//! The event array's own grid, recovered from places that were warped to another one.
//!
//! Where events of one camera were moved onto the pixels of another, each event pixel has one place of its
//! own, with a fraction. Rounded, these places leave pixels of the other grid that nothing reaches, and a
//! solver finds none there: a mesh lies over every picture. Here the distinct places get back the columns and
//! rows that they have on their own array, and every pixel of the other grid is given the event pixel that
//! sees it.
//!
//! Places of a neighbourhood are a lattice: from a seed each gets its column and row by a step along one of
//! two basis vectors. Polynomials of fifth degree in column and row are fitted to all of them (a lens and a
//! homography are smooth), and places that no chain of neighbours reaches get theirs by the inverse.
//!
//! Limits: the array lies within some 40 degrees of the other grid; a mirrored one stays mirrored.

use nalgebra::{DMatrix, DVector};
use photocurrent_core::Extent;
use std::collections::HashMap;

// Not tuned: what is warped by a calibration lies within thousandths of a pixel of its polynomials, and what
// is no lattice misses these limits by far.
/// Degree of the polynomials.
const DEGREE: usize = 5;
/// Fewer places are no lattice.
const FEWEST: usize = 400;
/// A place belongs to a column and row where it lies no further from it than this share of the pitch.
const NEAR: f64 = 0.35;
/// At least this share of all places must lie so.
const LEAST_SHARE: f64 = 0.97;
/// And the rest of them no further off than this share of the pitch, root mean square.
const MOST_RESIDUAL: f64 = 0.1;
/// No event array has more columns or rows.
const LARGEST: u32 = 1 << 13;
/// Rounds of fit and assignment.
const ROUNDS: usize = 3;
/// Steps of the inverse.
const STEPS: usize = 12;

/// A grid behind places.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    /// Columns and rows that places were found in, of the event array.
    pub(crate) size: Extent,
    /// Distance of neighbouring columns and rows in the middle, pixels of the other grid.
    pub(crate) pitch: (f64, f64),
    /// What places lie off the polynomials by, root mean square, pixels of the other grid.
    pub(crate) residual: f64,
    /// Column and row of (0, 0) of the size.
    origin: (i64, i64),
    warp: Warp,
}

impl Lattice {
    /// Of distinct places; none where they are no lattice.
    pub(crate) fn of(places: &[(f64, f64)]) -> Option<Lattice> {
        if places.len() < FEWEST {
            return None;
        }
        let buckets = Buckets::new(places);
        let basis = basis(places, &buckets)?;
        let length = |step: (f64, f64)| libm::hypot(step.0, step.1);
        let mean = 0.5 * (length(basis[0]) + length(basis[1]));
        let mut found = chained(places, &buckets, basis, mean);
        let mut warp = Warp::fit(places, &found)?;
        for _ in 0..ROUNDS {
            for (place, cell) in places.iter().zip(&mut found) {
                *cell = warp.cell(*place, NEAR * mean);
            }
            warp = Warp::fit(places, &found)?;
        }
        let cells: Vec<(i64, i64)> = found.iter().flatten().copied().collect();
        let distinct: std::collections::HashSet<(i64, i64)> = cells.iter().copied().collect();
        let least = (LEAST_SHARE * places.len() as f64) as usize;
        if cells.len() < least || distinct.len() < least {
            return None;
        }
        let off: f64 = places
            .iter()
            .zip(&found)
            .filter_map(|(place, cell)| Some((place, warp.place((*cell)?))))
            .map(|(place, fitted)| {
                (place.0 - fitted.0) * (place.0 - fitted.0) + (place.1 - fitted.1) * (place.1 - fitted.1)
            })
            .sum();
        let pitch = warp.pitch();
        let residual = libm::sqrt(off / cells.len() as f64);
        let range = |of: &dyn Fn(&(i64, i64)) -> i64| {
            cells.iter().map(of).fold((i64::MAX, i64::MIN), |(low, high), n| (low.min(n), high.max(n)))
        };
        let ((left, right), (top, bottom)) = (range(&|cell| cell.0), range(&|cell| cell.1));
        let size = Extent {
            width: u32::try_from(right - left + 1).ok()?,
            height: u32::try_from(bottom - top + 1).ok()?,
        };
        let lattice = Lattice { size, pitch, residual, origin: (left, top), warp };
        let is_an_array = size.width <= LARGEST && size.height <= LARGEST;
        (is_an_array && residual < MOST_RESIDUAL * mean).then_some(lattice)
    }

    /// Column and row of the event pixel at a place; none where the place is no pixel's.
    pub(crate) fn pixel(&self, place: (f64, f64)) -> Option<(u32, u32)> {
        let mean = 0.5 * (self.pitch.0 + self.pitch.1);
        self.inside(self.warp.cell(place, NEAR * mean)?)
    }

    /// Of each pixel of the other grid, row by row, the event pixel that sees its middle: the nearest one;
    /// none beyond the event array.
    pub(crate) fn seen_by(&self, extent: Extent) -> Vec<Option<(u32, u32)>> {
        let mean = 0.5 * (self.pitch.0 + self.pitch.1);
        // From the pixel before it is a step.
        let mut last = self.warp.middle;
        let of = |n: usize| {
            let at = ((n % extent.width as usize) as f64, (n / extent.width as usize) as f64);
            let (column, row) =
                self.warp.inverse(at, last).or_else(|| self.warp.inverse(at, self.warp.middle))?;
            last = (column, row);
            // The nearest cell by distance on the other grid, which may be sheared.
            let (low, high) = (libm::floor(column) as i64, libm::floor(row) as i64);
            let near = [(low, high), (low + 1, high), (low, high + 1), (low + 1, high + 1)];
            let distance = |cell: &(i64, i64)| {
                let (x, y) = self.warp.place(*cell);
                libm::hypot(x - at.0, y - at.1)
            };
            let best = near.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
            self.inside(best).filter(|_| distance(&best) < mean)
        };
        (0..extent.pixels()).map(of).collect()
    }

    /// The size of an array that covers all of the other grid, and the place of each of its pixels, row by
    /// row. Events were seen in a part of it, where something moved; beyond that part places go on as at its
    /// border.
    pub(crate) fn places(&self, other: Extent) -> (Extent, Vec<(f64, f64)>) {
        let (left, top) = self.origin;
        let (right, bottom) = (left + i64::from(self.size.width) - 1, top + i64::from(self.size.height) - 1);
        let at = |(column, row): (i64, i64)| {
            let (c, r) = (column.clamp(left, right), row.clamp(top, bottom));
            let place = self.warp.place((c, r));
            // The step at the border, of an array that is more than one wide.
            let step = |beyond: i64, inner: (i64, i64)| {
                let next = self.warp.place(inner);
                let by = beyond.unsigned_abs() as f64;
                ((place.0 - next.0) * by, (place.1 - next.1) * by)
            };
            let across = step(column - c, (if column < c { left + 1 } else { right - 1 }, r));
            let down = step(row - r, (c, if row < r { top + 1 } else { bottom - 1 }));
            (place.0 + across.0 + down.0, place.1 + across.1 + down.1)
        };
        // Corners of the other grid, by the step in the middle of the array.
        let middle = ((left + right) / 2, (top + bottom) / 2);
        let (here, next) = (at(middle), [at((middle.0 + 1, middle.1)), at((middle.0, middle.1 + 1))]);
        let [(a, c), (b, d)] = next.map(|next| (next.0 - here.0, next.1 - here.1));
        let determinant = a * d - b * c;
        let cell = |x: f64, y: f64| {
            let (x, y) = (x - here.0, y - here.1);
            (middle.0 as f64 + (d * x - b * y) / determinant, middle.1 as f64 + (a * y - c * x) / determinant)
        };
        let (width, height) = (f64::from(other.width), f64::from(other.height));
        let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)].map(|(x, y)| cell(x, y));
        let range = |of: &dyn Fn(&(f64, f64)) -> f64, low: i64, high: i64| {
            let margin = |cells: f64| (cells.ceil().max(0.0) as i64 + 1).min(i64::from(LARGEST));
            let least = corners.iter().map(of).fold(f64::INFINITY, f64::min);
            let most = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
            (low - margin(low as f64 - least), high + margin(most - high as f64))
        };
        let (columns, rows) = (range(&|cell| cell.0, left, right), range(&|cell| cell.1, top, bottom));
        let size = Extent { width: (columns.1 - columns.0 + 1) as u32, height: (rows.1 - rows.0 + 1) as u32 };
        let places = (rows.0..=rows.1)
            .flat_map(|row| (columns.0..=columns.1).map(move |column| (column, row)))
            .map(at)
            .collect();
        (size, places)
    }

    fn inside(&self, cell: (i64, i64)) -> Option<(u32, u32)> {
        let (column, row) = (cell.0 - self.origin.0, cell.1 - self.origin.1);
        let (column, row) = (u32::try_from(column).ok()?, u32::try_from(row).ok()?);
        (column < self.size.width && row < self.size.height).then_some((column, row))
    }
}

/// Places by whole pixel.
struct Buckets<'a> {
    places: &'a [(f64, f64)],
    of: HashMap<(i64, i64), Vec<u32>>,
}

impl Buckets<'_> {
    fn new(places: &[(f64, f64)]) -> Buckets<'_> {
        let mut of: HashMap<(i64, i64), Vec<u32>> = HashMap::new();
        for (n, place) in (0..).zip(places) {
            of.entry(Buckets::key(*place)).or_default().push(n);
        }
        Buckets { places, of }
    }

    fn key((x, y): (f64, f64)) -> (i64, i64) {
        (libm::floor(x) as i64, libm::floor(y) as i64)
    }

    /// Places within `reach` pixels, with their distances.
    fn near(&self, at: (f64, f64), reach: f64) -> impl Iterator<Item = (u32, f64)> {
        let (x, y) = Buckets::key(at);
        let cells = libm::ceil(reach) as i64;
        (-cells..=cells)
            .flat_map(move |dy| (-cells..=cells).map(move |dx| (x + dx, y + dy)))
            .filter_map(|key| self.of.get(&key))
            .flatten()
            .map(move |n| {
                let place = self.places[*n as usize];
                (*n, libm::hypot(place.0 - at.0, place.1 - at.1))
            })
            .filter(move |(_, distance)| *distance <= reach)
    }

    fn nearest(&self, at: (f64, f64), reach: f64) -> Option<u32> {
        self.near(at, reach).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(n, _)| n)
    }
}

/// Steps to the next column and to the next row, medians of a sample of places.
fn basis(places: &[(f64, f64)], buckets: &Buckets<'_>) -> Option<[(f64, f64); 2]> {
    const SAMPLE: usize = 4000;
    const FARTHEST: f64 = 4.0;
    let every = places.len().div_ceil(SAMPLE);
    let mut distances: Vec<f64> = Vec::new();
    for place in places.iter().step_by(every) {
        let others = buckets.near(*place, FARTHEST).filter(|(_, distance)| *distance > 0.0);
        distances.extend(others.map(|(_, distance)| distance).min_by(f64::total_cmp));
    }
    distances.sort_by(f64::total_cmp);
    // Most pixels have a neighbour that has events.
    let pitch = *distances.get(distances.len() / 2)?;
    let mut steps: [Vec<(f64, f64)>; 2] = [Vec::new(), Vec::new()];
    for place in places.iter().step_by(every) {
        for (n, distance) in buckets.near(*place, 1.25 * pitch) {
            let other = places[n as usize];
            let (dx, dy) = (other.0 - place.0, other.1 - place.1);
            if distance > 0.5 * pitch && dx > dy.abs() {
                steps[0].push((dx, dy));
            } else if distance > 0.5 * pitch && dy > dx.abs() {
                steps[1].push((dx, dy));
            }
        }
    }
    let median = |of: &[(f64, f64)]| -> Option<(f64, f64)> {
        let middle = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Some((
            middle(of.iter().map(|step| step.0).collect())?,
            middle(of.iter().map(|step| step.1).collect())?,
        ))
    };
    Some([median(&steps[0])?, median(&steps[1])?])
}

/// Columns and rows by chains of neighbours from the place with most of them near the middle.
fn chained(
    places: &[(f64, f64)],
    buckets: &Buckets<'_>,
    basis: [(f64, f64); 2],
    pitch: f64,
) -> Vec<Option<(i64, i64)>> {
    let count = places.len() as f64;
    let middle =
        places.iter().fold((0.0, 0.0), |sum, place| (sum.0 + place.0 / count, sum.1 + place.1 / count));
    let crowded = |n: &u32| buckets.near(places[*n as usize], 3.0 * pitch).count();
    let candidates = buckets.near(middle, 20.0 * pitch).map(|(n, _)| n);
    let seed = candidates.max_by_key(crowded).unwrap_or(0);
    let mut found: Vec<Option<(i64, i64)>> = vec![None; places.len()];
    // Each with the basis of its neighbourhood, which drifts over the array.
    let mut next = std::collections::VecDeque::from([(seed, basis)]);
    found[seed as usize] = Some((0, 0));
    while let Some((n, mut basis)) = next.pop_front() {
        let (at, Some(cell)) = (places[n as usize], found[n as usize]) else { continue };
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let step = basis[axis];
            let towards = (at.0 + f64::from(sign) * step.0, at.1 + f64::from(sign) * step.1);
            let Some(other) = buckets.nearest(towards, NEAR * pitch) else { continue };
            let place = places[other as usize];
            let sign_of = f64::from(sign);
            let actual = (sign_of * (place.0 - at.0), sign_of * (place.1 - at.1));
            basis[axis] = (0.8 * step.0 + 0.2 * actual.0, 0.8 * step.1 + 0.2 * actual.1);
            if found[other as usize].is_none() {
                let by = i64::from(sign);
                found[other as usize] =
                    Some(if axis == 0 { (cell.0 + by, cell.1) } else { (cell.0, cell.1 + by) });
                next.push_back((other, basis));
            }
        }
    }
    found
}

/// Polynomials from column and row to a place.
#[derive(Clone, Debug)]
struct Warp {
    /// Columns and rows less `middle`, over `reach`, are the variables.
    middle: (f64, f64),
    reach: f64,
    x: DVector<f64>,
    y: DVector<f64>,
}

/// Numbers of a polynomial.
const COUNT: usize = (DEGREE + 1) * (DEGREE + 2) / 2;

/// Powers of both variables up to the degree in all.
fn powers(u: f64, v: f64) -> [f64; COUNT] {
    let mut all = [1.0; COUNT];
    let mut n = 1;
    for degree in 1..=DEGREE {
        // Those of the degree below times u, and the last of them times v.
        for k in 0..degree {
            all[n + k] = all[n - degree + k] * u;
        }
        all[n + degree] = all[n - 1] * v;
        n += degree + 1;
    }
    all
}

impl Warp {
    /// Least squares; none where too few places have a column and row.
    fn fit(places: &[(f64, f64)], cells: &[Option<(i64, i64)>]) -> Option<Warp> {
        let known: Vec<((f64, f64), (f64, f64))> = places
            .iter()
            .zip(cells)
            .filter_map(|(place, cell)| cell.map(|cell| (*place, (cell.0 as f64, cell.1 as f64))))
            .collect();
        if known.len() < FEWEST {
            return None;
        }
        let range = |of: &dyn Fn(&(f64, f64)) -> f64| {
            let values = known.iter().map(|(_, cell)| of(cell));
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), n| {
                (f64::min(low, n), f64::max(high, n))
            })
        };
        let (across, down) = (range(&|cell| cell.0), range(&|cell| cell.1));
        let middle = (0.5 * (across.0 + across.1), 0.5 * (down.0 + down.1));
        let reach = f64::max(0.5 * f64::max(across.1 - across.0, down.1 - down.0), 1.0);
        let mut normal = DMatrix::<f64>::zeros(COUNT, COUNT);
        let mut sides = DMatrix::<f64>::zeros(COUNT, 2);
        for (place, cell) in &known {
            let row = powers((cell.0 - middle.0) / reach, (cell.1 - middle.1) / reach);
            for (i, a) in row.iter().enumerate() {
                for (j, b) in row.iter().enumerate().skip(i) {
                    normal[(j, i)] += a * b;
                }
                sides[(i, 0)] += a * place.0;
                sides[(i, 1)] += a * place.1;
            }
        }
        // What nothing measures stays near zero.
        for i in 0..COUNT {
            normal[(i, i)] += 1e-9 * known.len() as f64;
        }
        let solved = normal.cholesky()?.solve(&sides);
        Some(Warp { middle, reach, x: solved.column(0).into_owned(), y: solved.column(1).into_owned() })
    }

    fn at(&self, (column, row): (f64, f64)) -> (f64, f64) {
        let powers = powers((column - self.middle.0) / self.reach, (row - self.middle.1) / self.reach);
        let sum = |of: &DVector<f64>| of.iter().zip(&powers).map(|(a, b)| a * b).sum();
        (sum(&self.x), sum(&self.y))
    }

    /// Distance of columns and of rows in the middle.
    fn pitch(&self) -> (f64, f64) {
        let (column, row) = self.middle;
        let between = |a: (f64, f64), b: (f64, f64)| libm::hypot(a.0 - b.0, a.1 - b.1);
        let across = between(self.at((column + 0.5, row)), self.at((column - 0.5, row)));
        (across, between(self.at((column, row + 0.5)), self.at((column, row - 0.5))))
    }

    fn place(&self, (column, row): (i64, i64)) -> (f64, f64) {
        self.at((column as f64, row as f64))
    }

    /// Column and row, with fractions, of a place, by Newton's method with differences over half a pixel,
    /// from where it may be about.
    fn inverse(&self, place: (f64, f64), begin: (f64, f64)) -> Option<(f64, f64)> {
        let mut at = begin;
        for _ in 0..STEPS {
            let here = self.at(at);
            let (off_x, off_y) = (place.0 - here.0, place.1 - here.1);
            let [(rx, ry), (dx, dy)] = [
                (self.at((at.0 + 0.5, at.1)), self.at((at.0 - 0.5, at.1))),
                (self.at((at.0, at.1 + 0.5)), self.at((at.0, at.1 - 0.5))),
            ]
            .map(|(after, before)| (after.0 - before.0, after.1 - before.1));
            let determinant = rx * dy - dx * ry;
            let step = ((off_x * dy - dx * off_y) / determinant, (rx * off_y - off_x * ry) / determinant);
            at = (at.0 + step.0, at.1 + step.1);
            if !(at.0.is_finite() && at.1.is_finite()) {
                return None;
            }
            if step.0.abs() + step.1.abs() < 1e-4 {
                return Some(at);
            }
        }
        None
    }

    /// The column and row whose place is no further than `reach` from one.
    fn cell(&self, place: (f64, f64), reach: f64) -> Option<(i64, i64)> {
        let (column, row) = self.inverse(place, self.middle)?;
        let cell = (libm::round(column) as i64, libm::round(row) as i64);
        let fitted = self.place(cell);
        (libm::hypot(fitted.0 - place.0, fitted.1 - place.1) <= reach).then_some(cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Places of an array of 90 x 60 with a pitch of 1.16, turned by two degrees, behind a lens that bends
    /// corners by two pixels; of pixels that a chance leaves, in a disc and a corner.
    fn warped(column: f64, row: f64) -> (f64, f64) {
        let (u, v) = ((column - 44.5) / 45.0, (row - 29.5) / 45.0);
        let bend = 1.0 + 0.03 * (u * u + v * v);
        let (x, y) = (1.16 * 45.0 * u * bend, 1.16 * 45.0 * v * bend);
        let (sin, cos) = (libm::sin(0.035), libm::cos(0.035));
        (52.0 + cos * x - sin * y, 34.0 + sin * x + cos * y + 0.2 * u * v)
    }

    fn places() -> Vec<((u32, u32), (f64, f64))> {
        let mut random = Random::new(3, &[]);
        let mut all = Vec::new();
        for row in 0..60_u32 {
            for column in 0..90_u32 {
                let (dx, dy) = (f64::from(column) - 40.0, f64::from(row) - 30.0);
                let is_there =
                    dx * dx + dy * dy < 900.0 || (column > 80 && row > 50) || (column < 3 && row < 3);
                if is_there && random.uniform() < 0.9 {
                    let (x, y) = warped(f64::from(column), f64::from(row));
                    // As 32-bit floats have them.
                    all.push(((column, row), (f64::from(x as f32), f64::from(y as f32))));
                }
            }
        }
        all
    }

    #[test]
    fn places_get_their_columns_and_rows_back() {
        let places = places();
        let found =
            Lattice::of(&places.iter().map(|(_, place)| *place).collect::<Vec<_>>()).expect("a lattice");
        assert!((found.pitch.0 / 1.16 - 1.0).abs() < 0.005 && found.residual < 0.01, "{found:?}");
        let (first, _) = places.iter().fold(((u32::MAX, u32::MAX), 0), |((x, y), n), ((column, row), _)| {
            ((x.min(*column), y.min(*row)), n)
        });
        for ((column, row), place) in &places {
            assert_eq!(found.pixel(*place), Some((column - first.0, row - first.1)), "{column} {row}");
        }
        // A place between pixels is no pixel's.
        let between = warped(40.5, 30.5);
        assert_eq!(found.pixel(between), None);
    }

    #[test]
    fn each_pixel_of_the_other_grid_has_the_event_pixel_that_is_nearest() {
        let places = places();
        let found =
            Lattice::of(&places.iter().map(|(_, place)| *place).collect::<Vec<_>>()).expect("a lattice");
        let extent = Extent { width: 100, height: 68 };
        let seen = found.seen_by(extent);
        let mut checked = 0;
        for y in 20..50_u32 {
            for x in 30..70_u32 {
                let all = (0..90_u32).flat_map(|column| (0..60_u32).map(move |row| (column, row)));
                let distance = |(column, row): &(u32, u32)| {
                    let place = warped(f64::from(*column), f64::from(*row));
                    libm::hypot(place.0 - f64::from(x), place.1 - f64::from(y))
                };
                let mut sorted: Vec<(f64, (u32, u32))> = all.map(|pixel| (distance(&pixel), pixel)).collect();
                sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
                // Where two are equally near, either sees it.
                if sorted[1].0 - sorted[0].0 > 0.02 {
                    assert_eq!(seen[(y * 100 + x) as usize], Some(sorted[0].1), "{x} {y}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 1000, "{checked}");
        // Nothing beyond the array, whose corner lies at 104 pixels.
        let wide = found.seen_by(Extent { width: 130, height: 2 });
        assert!(wide[..30].iter().any(Option::is_some) && wide[115..130].iter().all(Option::is_none));
    }

    #[test]
    fn places_without_an_order_are_no_lattice() {
        let mut random = Random::new(8, &[]);
        let places: Vec<(f64, f64)> =
            (0..5000).map(|_| (100.0 * random.uniform(), 80.0 * random.uniform())).collect();
        assert!(Lattice::of(&places).is_none());
    }
}
