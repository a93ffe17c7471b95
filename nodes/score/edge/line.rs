//! Where an edge is: the centroid of the derivative of every line, and a straight line or a parabola through
//! them.

use super::types::{Direction, Fit, Lines, Refusal};

/// Positions that scatter more than this about the fitted line are no straight edge, pixels.
const MOST_SCATTER: f64 = 2.0;
/// The edge's ends stay so far from the region's border, pixels.
const LEAST_DISTANCE: f64 = 5.0;
/// The derivative is looked at so far to both sides of the edge at least, pixels.
const LEAST_WINDOW: f64 = 6.0;

/// `position = middle + slope n + bend n^2`, n = line - middle line, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Position on the middle line, pixels from the first pixel's middle.
    pub middle: f64,
    /// Pixels per line, on the middle line.
    pub slope: f64,
    /// Half the change of the slope from line to line; 0 for a straight edge.
    pub bend: f64,
    half: f64,
}

impl Line {
    /// The edge of some lines. For a profile along rows the edge is taken as it is on average, without slope.
    ///
    /// # Errors
    /// When the positions scatter, or the edge comes too close to the border.
    pub(crate) fn find(lines: &Lines, direction: Direction, fit: Fit) -> Result<Line, Refusal> {
        // The first estimate looks at the whole line; the next ones only near the edge, where there is less
        // noise to collect.
        let mut line =
            Line::through(&lines.iter().map(|line| centroid(line, None)).collect::<Vec<_>>(), direction, fit)
                .0;
        let mut scatter = f64::INFINITY;
        for _ in 0..2 {
            let window = line.window(lines);
            let positions: Vec<f64> = lines
                .iter()
                .enumerate()
                .map(|(j, values)| centroid(values, Some((line.at(j), window))))
                .collect();
            (line, scatter) = Line::through(&positions, direction, fit);
        }
        if scatter.is_nan() || scatter > MOST_SCATTER {
            return Err(Refusal::NotStraight);
        }
        // A parabola may lie nearer to the border between its ends.
        if (0..lines.len())
            .map(|j| line.at(j))
            .any(|at| !(LEAST_DISTANCE..=lines.across as f64 - 1.0 - LEAST_DISTANCE).contains(&at))
        {
            return Err(Refusal::AtTheBorder);
        }
        Ok(line)
    }

    /// Position on a line.
    pub fn at(&self, j: usize) -> f64 {
        let n = j as f64 - self.half;
        self.middle + self.slope * n + self.bend * n * n
    }

    /// Distance along the normal of a pixel `along` the edge on line `j`.
    ///
    /// A bent edge is taken as its circle of curvature there, to second order: the tangent's distance less
    /// the sagitta at the foot of the normal.
    pub fn distance(&self, j: usize, along: f64) -> f64 {
        let slope = self.slope + 2.0 * self.bend * (j as f64 - self.half);
        let stretch = 1.0 + slope * slope;
        let tangent = along / stretch.sqrt();
        if self.bend == 0.0 {
            tangent
        } else {
            tangent - self.bend / (stretch * stretch.sqrt()) * (tangent * slope) * (tangent * slope)
        }
    }

    /// Counts its lines by the quarter-pixel phase that the edge has on them.
    pub fn count_phases(&self, lines: usize, seen: &mut [usize; 4]) {
        (0..lines).for_each(|j| seen[(((self.at(j) - self.at(j).floor()) * 4.0) as usize).min(3)] += 1);
    }

    /// Half width of the window: six times the spread of the derivative, but inside the region.
    fn window(&self, lines: &Lines) -> f64 {
        let (mut sum, mut second) = (0.0, 0.0);
        for (j, line) in lines.iter().enumerate() {
            for (i, pair) in line.windows(2).enumerate() {
                let d = i as f64 + 0.5 - self.at(j);
                // Clipped, so that noise far away does not widen the window without end.
                sum += pair[1] - pair[0];
                second += (pair[1] - pair[0]) * (d * d).min(400.0);
            }
        }
        let spread = (second / sum).max(0.0).sqrt();
        let room = self.middle.min(lines.across as f64 - 1.0 - self.middle);
        (3.0 * spread).max(LEAST_WINDOW).min(room.max(LEAST_WINDOW))
    }

    /// A robust fit and the standard deviation about it: least squares, four times, far points weighing less.
    fn through(positions: &[f64], direction: Direction, fit: Fit) -> (Line, f64) {
        let half = (positions.len() as f64 - 1.0) / 2.0;
        let mut sorted = positions.to_vec();
        sorted.sort_by(f64::total_cmp);
        let mut line =
            Line { middle: photocurrent_core::table::percentile(&sorted, 0.5), slope: 0.0, bend: 0.0, half };
        let mut weights = vec![1.0; positions.len()];
        for _ in 0..4 {
            // Sums of the weights times powers of n, and of those times the positions.
            let (mut of_n, mut of_positions) = ([0.0; 5], [0.0; 3]);
            for (j, (position, weight)) in positions.iter().zip(&weights).enumerate() {
                let mut power = *weight;
                for (k, of_n) in of_n.iter_mut().enumerate() {
                    *of_n += power;
                    if let Some(of_positions) = of_positions.get_mut(k) {
                        *of_positions += power * position;
                    }
                    power *= j as f64 - half;
                }
            }
            let terms = match (direction, fit) {
                (Direction::Row, _) => 1,
                (Direction::Normal, Fit::Straight) => 2,
                (Direction::Normal, Fit::Quadratic) => 3,
            };
            [line.middle, line.slope, line.bend] =
                least_squares(&of_n, &of_positions, terms).unwrap_or([of_positions[0] / of_n[0], 0.0, 0.0]);
            let mut errors: Vec<f64> =
                positions.iter().enumerate().map(|(j, position)| (position - line.at(j)).abs()).collect();
            let each = errors.clone();
            errors.sort_by(f64::total_cmp);
            // Huber's weights at 1.5 standard deviations, these from the median; never tighter than a tenth
            // of a pixel.
            let bound = (1.5 * 1.4826 * photocurrent_core::table::percentile(&errors, 0.5)).max(0.1);
            weights
                .iter_mut()
                .zip(&each)
                .for_each(|(weight, error)| *weight = if *error <= bound { 1.0 } else { bound / error });
        }
        let square = |(j, position): (usize, &f64)| (position - line.at(j)) * (position - line.at(j));
        let scatter = positions.iter().enumerate().map(square).sum::<f64>() / positions.len() as f64;
        (line, if direction == Direction::Row { 0.0 } else { scatter.sqrt() })
    }
}

/// Coefficients of the polynomial of `terms` terms from the sums of powers; the others are 0. `None` where
/// the points do not determine it.
fn least_squares(of_n: &[f64; 5], of_positions: &[f64; 3], terms: usize) -> Option<[f64; 3]> {
    let mut rows = [[0.0; 4]; 3];
    for (i, row) in rows.iter_mut().take(terms).enumerate() {
        row[..terms].copy_from_slice(&of_n[i..i + terms]);
        row[3] = of_positions[i];
    }
    // The matrix is positive definite: its pivots need no search.
    for i in 0..terms {
        if rows[i][i].is_nan() || rows[i][i] <= 0.0 {
            return None;
        }
        let pivot = rows[i];
        for row in rows.iter_mut().take(terms).skip(i + 1) {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(pivot).for_each(|(value, above)| *value -= factor * above);
        }
    }
    let mut found = [0.0; 3];
    for i in (0..terms).rev() {
        let known: f64 = (i + 1..terms).map(|k| rows[i][k] * found[k]).sum();
        found[i] = (rows[i][3] - known) / rows[i][i];
    }
    Some(found)
}

/// Centroid of the derivative of a line, all of it or under a Hann window (middle, half width).
fn centroid(line: &[f64], window: Option<(f64, f64)>) -> f64 {
    let (mut sum, mut first) = (0.0, 0.0);
    for (i, pair) in line.windows(2).enumerate() {
        let at = i as f64 + 0.5;
        let weight = match window {
            None => 1.0,
            Some((middle, half)) if (at - middle).abs() < half => {
                0.5 + 0.5 * libm::cos(std::f64::consts::PI * (at - middle) / half)
            }
            Some(_) => 0.0,
        };
        sum += weight * (pair[1] - pair[0]);
        first += weight * (pair[1] - pair[0]) * at;
    }
    // A line without rise has no position: it stands at the middle, and scatters.
    if sum > 0.0 {
        (first / sum).clamp(0.0, line.len() as f64 - 1.0)
    } else {
        0.5 * (line.len() as f64 - 1.0)
    }
}
