//! Size and gain of an effect, by the residuals of events: Student-t noise with a threshold part and a part that grows with the slope.

/// Degrees of freedom of the residuals' Student-t distribution.
pub const NU: f64 = 3.0;

/// Standard deviation of residuals: `a` natural-log units (threshold), and `b` seconds times the slope (stamps).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EventNoise {
    /// Threshold part, natural-log units.
    pub a: f64,
    /// Stamp part, seconds.
    pub b: f64,
}

impl EventNoise {
    /// Scale of an event's residual.
    #[inline]
    pub fn sigma(&self, slope_per_s: f64) -> f64 {
        libm::sqrt(self.a * self.a + self.b * self.b * slope_per_s * slope_per_s)
    }

    /// From residuals: robust scales in eight bins of slope, fitted by `a^2 + b^2 slope^2`; at least `least`.
    pub fn estimate(residual: &[f64], slope_per_s: &[f64], least: f64) -> EventNoise {
        const BINS: usize = 8;
        let mut order: Vec<usize> = (0..residual.len()).collect();
        order.sort_by(|&i, &j| slope_per_s[i].abs().total_cmp(&slope_per_s[j].abs()));
        let mut points: Vec<(f64, f64)> = Vec::new();
        for bin in order.chunks(residual.len().div_ceil(BINS).max(1)) {
            let mut sizes: Vec<f64> = bin.iter().map(|&k| residual[k].abs()).collect();
            let middle = sizes.len() / 2;
            sizes.select_nth_unstable_by(middle, f64::total_cmp);
            // The median of |t| with three degrees of freedom is 0.765 of its scale.
            let scale = sizes[middle] / 0.765;
            let slope = slope_per_s[bin[bin.len() / 2]];
            points.push((slope * slope, scale * scale));
        }
        // Relative errors: weights of one over the variance's square, two rounds.
        let (mut a2, mut b2) = (points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min), 0.0);
        for _ in 0..4 {
            let (mut s, mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for &(x, y) in &points {
                let variance = f64::max(a2 + b2 * x, 1e-12);
                let w = 1.0 / (variance * variance);
                s += w;
                sx += w * x;
                sxx += w * x * x;
                sy += w * y;
                sxy += w * x * y;
            }
            let determinant = s * sxx - sx * sx;
            let slope = if determinant > 1e-12 * s * sxx { (s * sxy - sx * sy) / determinant } else { 0.0 };
            b2 = slope.max(0.0);
            a2 = ((sy - b2 * sx) / s).max(least * least);
        }
        EventNoise { a: libm::sqrt(a2), b: libm::sqrt(b2) }
    }

    /// Log density of residuals.
    pub fn log_density(&self, residual: &[f64], slope_per_s: &[f64]) -> f64 {
        residual.iter().zip(slope_per_s).map(|(r, slope)| log_t(r / self.sigma(*slope)) - libm::log(self.sigma(*slope))).sum()
    }
}

/// Log density of Student's t with three degrees of freedom.
#[inline]
fn log_t(z: f64) -> f64 {
    const CONSTANT: f64 = -1.000_888_8;
    CONSTANT - 0.5 * (NU + 1.0) * libm::log1p(z * z / NU)
}

/// What stands beside residuals: events first, then frame values (of a scene that does not hang on them), each kind with a noise of its own.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// How fast the voltage moves at events, ln/s; how bright frame values are, DN.
    pub slope: &'a [f64],
    /// Block of pixels; the last bit is the half that it belongs to.
    pub block: &'a [u32],
    /// Rows before this one are events.
    pub events: usize,
    /// Least noise, natural-log units.
    pub least: f64,
}

/// Least noise of frame values, DN: that of whole numbers.
const LEAST_DN: f64 = 0.3;

/// Noise of both kinds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    events: EventNoise,
    frames: EventNoise,
}

impl Noise {
    /// Of events.
    pub fn of_events(&self) -> EventNoise {
        self.events
    }
}

impl Rows<'_> {
    /// Of chosen rows, rising, with their residuals.
    fn noise(&self, chosen: &[usize], residual: &[f64]) -> Noise {
        let slopes: Vec<f64> = chosen.iter().map(|&k| self.slope[k]).collect();
        let at = chosen.partition_point(|&k| k < self.events);
        let events = EventNoise::estimate(&residual[..at], &slopes[..at], self.least);
        let frames = if at < chosen.len() { EventNoise::estimate(&residual[at..], &slopes[at..], LEAST_DN) } else { events };
        Noise { events, frames }
    }

    #[inline]
    fn sigma(&self, noise: &Noise, k: usize) -> f64 {
        if k < self.events { noise.events.sigma(self.slope[k]) } else { noise.frames.sigma(self.slope[k]) }
    }

    fn log(&self, noise: &Noise, k: usize, residual: f64) -> f64 {
        let sigma = self.sigma(noise, k);
        log_t(residual / sigma) - libm::log(sigma)
    }

    fn blocks(&self) -> usize {
        self.block.iter().copied().max().map_or(0, |last| last as usize + 1)
    }
}

/// Columns, fitted together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fitted {
    /// Sizes, each in units of its column's own.
    pub size: Vec<f64>,
    /// Standard errors: half of what two halves of the blocks differ by.
    pub error: Vec<f64>,
    /// Held-out gain, nats per event.
    pub gain: f64,
    /// Standard error of the gain, by blocks.
    pub gain_error: f64,
}

/// Fits columns together by iteratively reweighted least squares; gives sizes and noise.
pub fn fit(residual: &[f64], rows: &Rows<'_>, columns: &[&[f32]], use_row: impl Fn(usize) -> bool) -> (Vec<f64>, Noise) {
    let chosen: Vec<usize> = (0..residual.len()).filter(|&k| use_row(k)).collect();
    let mut sizes = vec![0.0; columns.len()];
    let left = |sizes: &[f64]| -> Vec<f64> {
        chosen.iter().map(|&k| residual[k] + columns.iter().zip(sizes).map(|(column, size)| f64::from(column[k]) * size).sum::<f64>()).collect()
    };
    let mut noise = rows.noise(&chosen, &left(&sizes));
    if columns.is_empty() {
        return (sizes, noise);
    }
    for _ in 0..8 {
        let now = left(&sizes);
        let n = columns.len();
        let mut normal = nalgebra::DMatrix::<f64>::zeros(n, n);
        let mut right = nalgebra::DVector::<f64>::zeros(n);
        for (&k, r) in chosen.iter().zip(&now) {
            let sigma = rows.sigma(&noise, k);
            let z = r / sigma;
            let weight = (NU + 1.0) / (NU + z * z) / (sigma * sigma);
            for i in 0..n {
                let a = f64::from(columns[i][k]);
                right[i] -= weight * a * r;
                for j in 0..=i {
                    normal[(i, j)] += weight * a * f64::from(columns[j][k]);
                }
            }
        }
        for i in 0..n {
            normal[(i, i)] *= 1.0 + 1e-9;
            normal[(i, i)] += 1e-12;
            for j in 0..i {
                normal[(j, i)] = normal[(i, j)];
            }
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&right)) else { break };
        sizes.iter_mut().zip(step.iter()).for_each(|(size, step)| *size += step);
        if sizes.iter().zip(step.iter()).all(|(size, step)| step.abs() < 1e-3 * size.abs()) {
            break;
        }
        noise = rows.noise(&chosen, &left(&sizes));
    }
    (sizes, noise)
}

/// Held-out gain of residuals `left` over `before`, nats per event, and its standard error by blocks: noise is fitted to the other half of the blocks.
pub fn gain_of(before: &[f64], left: &[f64], rows: &Rows<'_>) -> (f64, f64) {
    let blocks = rows.blocks();
    let (mut gains, mut counts) = (vec![0.0; blocks], vec![0.0; blocks]);
    for half in 0..2_u32 {
        let train = |k: usize| rows.block[k] % 2 == half;
        let noise = |residual: &[f64]| fit(residual, rows, &[], train).1;
        let (with, plain) = (noise(left), noise(before));
        for k in (0..before.len()).filter(|&k| !train(k)) {
            gains[rows.block[k] as usize] += rows.log(&with, k, left[k]) - rows.log(&plain, k, before[k]);
            counts[rows.block[k] as usize] += f64::from(u8::from(k < rows.events));
        }
    }
    mean_of_blocks(&gains, &counts)
}

/// Mean per event and its standard error.
fn mean_of_blocks(gains: &[f64], counts: &[f64]) -> (f64, f64) {
    let all: f64 = counts.iter().sum::<f64>().max(1.0);
    let gain = gains.iter().sum::<f64>() / all;
    let spread: f64 = gains.iter().zip(counts).map(|(g, n)| (g - gain * n) * (g - gain * n)).sum();
    (gain, libm::sqrt(spread) / all)
}

/// Gain of columns over none, on the half of the blocks that sizes and noise were not fitted to, nats an event; size from all rows.
pub fn heldout(residual: &[f64], rows: &Rows<'_>, column: &[&[f32]]) -> Fitted {
    let blocks = rows.blocks();
    let mut gains = vec![0.0; blocks];
    let mut counts = vec![0.0; blocks];
    let mut halves = [Vec::new(), Vec::new()];
    for half in 0..2_u32 {
        let train = |k: usize| rows.block[k] % 2 == half;
        let (sizes, noise) = fit(residual, rows, column, train);
        let (_, plain) = fit(residual, rows, &[], train);
        for k in (0..residual.len()).filter(|&k| !train(k)) {
            let left = residual[k] + column.iter().zip(&sizes).map(|(column, size)| f64::from(column[k]) * size).sum::<f64>();
            gains[rows.block[k] as usize] += rows.log(&noise, k, left) - rows.log(&plain, k, residual[k]);
            counts[rows.block[k] as usize] += f64::from(u8::from(k < rows.events));
        }
        halves[half as usize] = sizes;
    }
    let (size, _) = fit(residual, rows, column, |_| true);
    let (gain, gain_error) = mean_of_blocks(&gains, &counts);
    let error = halves[0].iter().zip(&halves[1]).map(|(a, b)| 0.5 * (a - b).abs()).collect();
    Fitted { size, error, gain, gain_error }
}
