//! How the motion of a picture begins: frames for registration, and splines through the poses that it finds.

use super::motion::{AffineMap, AffinePose, DEGREES, PictureMotion, pose_of};
use super::setting::{FRAME_NOISE, PictureSetting, ROBUST};
use crate::case::Case;
use crate::image::Image;
use crate::nominal::Nominal;
use nalgebra::DMatrix;

/// Log frames; what is missing or dark is the median.
pub(crate) fn images(case: &Case, nominal: &Nominal) -> Vec<Image> {
    let pixels = case.extent.pixels();
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    (0..case.frame_count())
        .map(|l| {
            let signal = |pixel: usize| case.dn(l, pixel) - nominal.number.black_level;
            let mut known: Vec<f64> = (0..pixels).map(signal).filter(|s| s.is_finite() && *s > 0.0).collect();
            known.sort_by(f64::total_cmp);
            let middle = known.get(known.len() / 2).copied().unwrap_or(1.0);
            let value = |pixel: usize| {
                let s = signal(pixel);
                libm::log(f64::max(if s.is_finite() { s } else { middle }, 0.02 * middle)) as f32
            };
            Image { width, height, values: (0..pixels).map(value).collect() }
        })
        .collect()
}

/// Which values of a recording's frames differ from the frame before or behind by more than `moves` standard
/// deviations of one value.
pub(crate) fn moving(case: &Case, nominal: &Nominal, noise: (f64, f64), moves: f64) -> Vec<bool> {
    let (count, pixels) = (case.frame_count(), case.extent.pixels());
    let differs = |l: usize, k: usize, pixel: usize| {
        let (a, b) = (case.dn(l, pixel), case.dn(k, pixel));
        let sigma = nominal.frame_sigma_dn(f64::max(0.5 * (a + b) - nominal.number.black_level, 0.0), noise);
        (a - b).abs() > moves * sigma
    };
    (0..count * pixels)
        .map(|n| {
            let (l, pixel) = (n / pixels, n % pixels);
            (l > 0 && differs(l, l - 1, pixel)) || (l + 1 < count && differs(l, l + 1, pixel))
        })
        .collect()
}

/// The share of frame values that are those of the frame before, within a few standard deviations of one.
pub(super) fn unchanged(case: &Case, nominal: &Nominal) -> f64 {
    let changes = moving(case, nominal, FRAME_NOISE, ROBUST);
    changes.iter().filter(|changes| !**changes).count() as f64 / changes.len().max(1) as f64
}

/// Length of a row's exposure, s.
pub(super) fn exposure_s(case: &Case, l: usize, y: u32) -> f64 {
    let exposure = case.frames.as_ref().expect("frames are there").times.exposure(l, y);
    f64::max((exposure.end.0 - exposure.start.0) as f64 * 1e-9, 1e-9)
}

/// Splines through the poses of the frames.
pub(crate) fn begin_motion(case: &Case, poses: &[AffineMap], setting: &PictureSetting) -> PictureMotion {
    let (width, height) = (f64::from(case.extent.width), f64::from(case.extent.height));
    let half = 0.5 * (f64::max(width, height) - 1.0);
    let times = &case.frames.as_ref().expect("frames are there").times;
    let period_ns = times.mean_period_ns().map_or(setting.knot.ns(), |period| period as i64);
    let knot_ns = i64::max(setting.knot.ns(), period_ns * 6 / 5);
    let mut motion = PictureMotion::at_rest(case.span, knot_ns, half);
    let knots = motion.knots.len();
    let mut normal = DMatrix::<f64>::zeros(knots, knots);
    let mut right = DMatrix::<f64>::zeros(knots, DEGREES);
    let mut turned = 0.0;
    for (l, pose) in poses.iter().enumerate() {
        let mut target: AffinePose = pose_of(pose, half);
        // Turns go on where the angle starts again.
        let whole = std::f64::consts::TAU * half;
        target[2] += whole * ((turned - target[2]) / whole).round();
        turned = target[2];
        let exposure = times.exposure(l, case.extent.height / 2);
        let (first, weights) = motion.weights(i64::midpoint(exposure.start.0, exposure.end.0));
        for (a, wa) in weights.iter().enumerate() {
            for (b, wb) in weights.iter().enumerate() {
                normal[(first + a, first + b)] += wa * wb;
            }
            for (d, target) in target.iter().enumerate() {
                right[(first + a, d)] += wa * target;
            }
        }
    }
    let hold = 1e-4;
    for k in 1..knots - 1 {
        for (m, fm) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
            for (n, fn_) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
                normal[(m, n)] += hold * fm * fn_;
            }
        }
    }
    for k in 0..knots {
        normal[(k, k)] += 1e-12;
    }
    if let Some(factor) = normal.cholesky() {
        let found = factor.solve(&right);
        for (k, knot) in motion.knots.iter_mut().enumerate() {
            *knot = std::array::from_fn(|d| found[(k, d)]);
        }
    }
    motion
}
