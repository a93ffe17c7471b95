//! The width of one blurred edge in a picture: `bew.v1`.
//!
//! Per line the edge is found as the centroid of the windowed derivative, a straight line is fitted through
//! these, and all pixels are projected on one axis: their distance along the edge's normal. Averages in bins
//! of a quarter pixel are the edge spread function (ESF). Between the plateaus (medians of the outer fifths)
//! its 10 % and 90 % crossings nearest the 50 % crossing are the width.
//!
//! An ideal step seen by square pixels has a width of 0.80 pixels along the normal; a smaller one comes from
//! sharpening, and shows as overshoot. The source of the definition: edge spread functions as in ISO 12233,
//! 10 to 90 % rise distance. What cannot be measured is refused with a reason.

pub mod fit;
pub mod line;
pub mod spread;
mod types;

#[cfg(test)]
mod tests;

pub(crate) use types::Lines;
pub use types::{Direction, Fit, Refusal};

use fit::{gaussian_width, mtf50};
use line::Line;
use photocurrent_core::random::Random;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spread::{Spread, crossings};

/// Narrowest width of an unsharpened edge: 10 to 90 % of an ideal step under square pixels.
pub const FLOOR_PX: f64 = 0.8;
/// Fewest pixels across the edge.
pub const LEAST_ACROSS: usize = 20;
/// Fewest pixels along it, for a profile along the normal.
pub const LEAST_ALONG: usize = 12;
/// Least contrast, as a share of full scale.
pub const LEAST_CONTRAST: f64 = 0.05;
/// Least ratio of contrast to noise.
pub const LEAST_SNR: f64 = 20.0;
/// How often lines are drawn anew for the interval.
pub const BOOTSTRAPS: usize = 200;

/// Between which shares of the contrast the width is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Thresholds {
    /// 10 to 90 %.
    #[default]
    #[serde(rename = "10-90")]
    TenNinety,
    /// 20 to 80 %.
    #[serde(rename = "20-80")]
    TwentyEighty,
}

impl Thresholds {
    /// The lower share.
    pub fn low(self) -> f64 {
        match self {
            Thresholds::TenNinety => 0.1,
            Thresholds::TwentyEighty => 0.2,
        }
    }
}

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub struct Question {
    /// Between which shares.
    pub thresholds: Thresholds,
    /// Along what.
    pub direction: Direction,
    /// What is laid through the edge.
    pub fit: Fit,
    /// DN of full scale.
    pub full_scale: f64,
    /// DN at which the sensor saturates, where that is known.
    pub saturation: Option<f64>,
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// What was found, even where there is no width. Lengths in pixels; NaN what was not measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Why there is no width.
    pub refusal: Option<Refusal>,
    /// The width.
    pub width: f64,
    /// 95 % interval of the width over lines drawn anew.
    pub interval: [f64; 2],
    /// 10-90 % width of the fitted Gaussian edge, 2.563 sigma.
    pub gaussian_width: f64,
    /// Beyond the bright plateau, % of contrast.
    pub overshoot: f64,
    /// Beyond the dark plateau, % of contrast.
    pub undershoot: f64,
    /// Where the modulation transfer is one half, cycles per pixel.
    pub mtf50: f64,
    /// Angle of the edge to the pixel grid, degrees.
    pub angle: f64,
    /// The edge's middle, pixels from the region's corner.
    pub middle: [f64; 2],
    /// Crossings of 50 % besides the first.
    pub ghosts: u32,
    /// From the first to the last of them.
    pub ghost_spacing: f64,
    /// Bright less dark plateau, DN.
    pub contrast: f64,
    /// Standard deviation on the plateaus, DN.
    pub noise: f64,
    /// The profile: distance and share of the contrast.
    pub profile: Vec<(f64, f64)>,
}

impl Edge {
    fn nothing() -> Edge {
        Edge {
            refusal: None,
            width: f64::NAN,
            interval: [f64::NAN; 2],
            gaussian_width: f64::NAN,
            overshoot: f64::NAN,
            undershoot: f64::NAN,
            mtf50: f64::NAN,
            angle: f64::NAN,
            middle: [f64::NAN; 2],
            ghosts: 0,
            ghost_spacing: f64::NAN,
            contrast: f64::NAN,
            noise: f64::NAN,
            profile: Vec::new(),
        }
    }
}

/// Measures the one edge in a plane of linear DN, row-major.
pub fn measure(plane: &[f64], width: usize, question: &Question) -> Edge {
    let (edge, located) = locate(plane, width, question);
    match located {
        Some(located) => judged(edge, &located, question),
        None => edge,
    }
}

/// Measures an edge in every one of several planes, and once more in all of them together, each by its own
/// position: pictures of a moving edge fill the sub-pixel phases that one of them lacks. The joint edge is
/// that of the planes in which the edge was found; the last value is their number.
pub fn measure_all<'a>(
    planes: impl Iterator<Item = &'a [f64]>,
    width: usize,
    question: &Question,
) -> (Vec<Edge>, Edge, usize) {
    let (mut edges, mut kept) = (Vec::new(), Vec::new());
    for plane in planes {
        let (edge, located) = locate(plane, width, question);
        edges.push(match located {
            None => edge,
            Some(located) => {
                let edge = judged(edge, &located, question);
                kept.push((located.lines, located.line, located.plateaus, edge.angle));
                edge
            }
        });
    }
    let joint = joined(&edges, &kept, question);
    (edges, joint, kept.len())
}

/// The edge of several pictures together: lines, position, levels and angle of each.
fn joined(edges: &[Edge], kept: &[(Lines, Line, spread::Plateaus, f64)], question: &Question) -> Edge {
    let mut edge = Edge::nothing();
    if kept.is_empty() {
        // The commonest reason stands for all.
        let times = |reason: Refusal| edges.iter().filter(|edge| edge.refusal == Some(reason)).count();
        edge.refusal = edges.iter().filter_map(|edge| edge.refusal).max_by_key(|&reason| times(reason));
        return edge;
    }
    let typical = |values: &mut dyn Iterator<Item = f64>| {
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        photocurrent_core::table::percentile(&values, 0.5)
    };
    edge.angle = typical(&mut kept.iter().map(|(.., angle)| *angle));
    let contrast = typical(&mut kept.iter().map(|(_, _, plateaus, _)| plateaus.contrast()));
    let spread = Spread::joined(
        kept.iter().map(|(lines, line, plateaus, _)| (lines, line, plateaus)),
        question.direction,
    );
    let mut phases = [0; 4];
    kept.iter().for_each(|(lines, line, ..)| line.count_phases(lines.len(), &mut phases));
    let judged = spread.plateaus().and_then(|plateaus| {
        (edge.contrast, edge.noise) = (contrast * plateaus.contrast(), contrast * plateaus.noise);
        judge(&mut edge, &spread, &plateaus, phases, question)
    });
    edge.refusal = judged.err();
    edge
}

/// An edge that was found in a picture.
struct Located {
    lines: Lines,
    line: Line,
    spread: Spread,
    plateaus: spread::Plateaus,
}

fn locate(plane: &[f64], width: usize, question: &Question) -> (Edge, Option<Located>) {
    let mut edge = Edge::nothing();
    match locate_into(&mut edge, plane, width, question) {
        Ok(located) => (edge, Some(located)),
        Err(refusal) => {
            edge.refusal = Some(refusal);
            (edge, None)
        }
    }
}

fn judged(mut edge: Edge, located: &Located, question: &Question) -> Edge {
    let mut phases = [0; 4];
    located.line.count_phases(located.lines.len(), &mut phases);
    edge.refusal = judge(&mut edge, &located.spread, &located.plateaus, phases, question).err();
    edge
}

/// Turns the plane so that lines run across the edge from dark to bright; says whether it was transposed and
/// whether mirrored.
fn oriented(plane: &[f64], width: usize, direction: Direction) -> (Lines, bool, bool) {
    let height = plane.len() / width;
    // The change from border to border is that of the edge; noise and texture cancel in the sums.
    let rise_x: f64 =
        plane.chunks_exact(width).map(|row| row[width - 1] + row[width - 2] - row[0] - row[1]).sum::<f64>()
            / height as f64;
    let rise_y: f64 =
        (0..width).map(|x| plane[plane.len() - width + x] - plane[x]).sum::<f64>() * 2.0 / width as f64;
    let transposed = direction == Direction::Normal && rise_y.abs() > rise_x.abs();
    let (mut values, across) = if transposed {
        ((0..width).flat_map(|x| (0..height).map(move |y| plane[y * width + x])).collect(), height)
    } else {
        (plane.to_vec(), width)
    };
    let mirrored = if transposed { rise_y < 0.0 } else { rise_x < 0.0 };
    if mirrored {
        values.chunks_exact_mut(across).for_each(<[f64]>::reverse);
    }
    (Lines { values, across }, transposed, mirrored)
}

fn locate_into(
    edge: &mut Edge,
    plane: &[f64],
    width: usize,
    question: &Question,
) -> Result<Located, Refusal> {
    if plane.iter().any(|value| !value.is_finite()) {
        return Err(Refusal::Unknown);
    }
    let least_along = if question.direction == Direction::Row { 1 } else { 2 };
    if width < 2 || plane.len() / width < least_along {
        return Err(Refusal::TooSmall);
    }
    let (lines, transposed, mirrored) = oriented(plane, width, question.direction);
    let is_small =
        lines.across < LEAST_ACROSS || (question.direction == Direction::Normal && lines.len() < LEAST_ALONG);
    if is_small {
        return Err(Refusal::TooSmall);
    }
    // Border to border first: without contrast there is no edge to look for.
    let fifth = lines.across / 5;
    let mean = |part: fn(&[f64], usize) -> &[f64]| {
        lines.iter().flat_map(|line| part(line, fifth)).sum::<f64>() / (lines.len() * fifth) as f64
    };
    edge.contrast = mean(|line, n| &line[line.len() - n..]) - mean(|line, n| &line[..n]);
    if edge.contrast < LEAST_CONTRAST * question.full_scale {
        return Err(Refusal::LowContrast);
    }
    if question.saturation.is_some_and(|saturation| is_saturated(&lines, saturation)) {
        return Err(Refusal::Saturated);
    }
    let line = Line::find(&lines, question.direction, question.fit)?;
    let at = if mirrored { lines.across as f64 - 1.0 - line.middle } else { line.middle };
    let along = (lines.len() as f64 - 1.0) / 2.0;
    edge.middle = if transposed { [along, at] } else { [at, along] };
    edge.angle = libm::atan(line.slope.abs()).to_degrees();
    let spread = Spread::new(&lines, &line, question.direction);
    let plateaus = spread.plateaus()?;
    (edge.contrast, edge.noise) = (plateaus.contrast(), plateaus.noise);
    if edge.contrast < LEAST_CONTRAST * question.full_scale {
        return Err(Refusal::LowContrast);
    }
    Ok(Located { lines, line, spread, plateaus })
}

/// What the profile says; `phases` counts the lines in each quarter-pixel phase.
fn judge(
    edge: &mut Edge,
    spread: &Spread,
    plateaus: &spread::Plateaus,
    phases: [usize; 4],
    question: &Question,
) -> Result<(), Refusal> {
    edge.profile = spread.profile(plateaus, None);
    let halves = crossings(&edge.profile, 0.5);
    edge.ghosts = (halves.len() as u32).saturating_sub(1);
    if let (Some(first), Some(last)) = (halves.first(), halves.last()) {
        edge.ghost_spacing = if edge.ghosts > 0 { last - first } else { f64::NAN };
    }
    // A ghost near the border is no plateau either, and the better reason.
    if edge.ghosts == 0 && plateaus.still_changes() {
        return Err(Refusal::NoPlateau);
    }
    if plateaus.contrast() < LEAST_SNR * plateaus.noise {
        return Err(Refusal::Noisy);
    }
    if question.direction == Direction::Normal
        && edge.angle < 2.0
        && phases.iter().filter(|lines| **lines >= 2).count() < 3
    {
        return Err(Refusal::Phases);
    }
    let rise = spread::rise(&edge.profile, question.thresholds.low())?;
    (edge.undershoot, edge.overshoot) = spread::beyond(&edge.profile, &rise);
    edge.gaussian_width = gaussian_width(&edge.profile, &rise);
    if question.direction == Direction::Normal {
        edge.mtf50 = mtf50(&edge.profile, rise.half);
    }
    if edge.ghosts > 0 {
        return Err(Refusal::Ghosts);
    }
    edge.width = rise.width();
    edge.interval = bootstrap(spread, plateaus, question);
    Ok(())
}

/// Is a tenth of the pixels on the bright fifth at saturation or above?
fn is_saturated(lines: &Lines, saturation: f64) -> bool {
    let fifth = lines.across / 5;
    let clipped = lines
        .iter()
        .flat_map(|line| &line[line.len() - fifth..])
        .filter(|value| **value >= saturation)
        .count();
    10 * clipped >= lines.len() * fifth
}

/// 95 % interval of the width when the lines are drawn anew, with replacement; NaN for a single line.
fn bootstrap(spread: &Spread, plateaus: &spread::Plateaus, question: &Question) -> [f64; 2] {
    let lines = spread.lines();
    if lines < 2 {
        return [f64::NAN; 2];
    }
    let mut random = Random::new(question.seed, &[lines as u64]);
    let mut widths = Vec::with_capacity(BOOTSTRAPS);
    for _ in 0..BOOTSTRAPS {
        let mut times = vec![0u32; lines];
        (0..lines).for_each(|_| times[(random.bits() % lines as u64) as usize] += 1);
        if let Ok(rise) = spread::rise(&spread.profile(plateaus, Some(&times)), question.thresholds.low()) {
            widths.push(rise.width());
        }
    }
    widths.sort_by(f64::total_cmp);
    [0.025, 0.975].map(|share| photocurrent_core::table::percentile(&widths, share))
}
