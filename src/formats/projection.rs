//! Cameras of a calibration: where a direction is seen, and what a pixel sees.
//!
//! A pinhole with the distortion `radtan` (Brown 1966: two or three radial terms and two tangential ones) or
//! `equidistant` (Kannala and Brandt 2006), or none. Directions have depth 1.
//!
//! Limits: other projections (omnidirectional, double sphere) are refused.

use crate::calibration::CameraFacts;

/// Steps of the inverse, at most.
const STEPS: usize = 50;
/// It has been found to this, in units of depth.
const FOUND: f64 = 1e-12;

/// A camera that projects directions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Projection {
    /// fx, fy, cx, cy, pixels.
    intrinsics: [f64; 4],
    distortion: Distortion,
}

#[derive(Clone, Debug, PartialEq)]
enum Distortion {
    None,
    /// k1, k2, p1, p2, k3.
    Radtan([f64; 5]),
    /// k1 to k4.
    Equidistant([f64; 4]),
}

impl Projection {
    /// Of what a calibration states; a reason where that is not enough.
    pub(crate) fn of(facts: &CameraFacts) -> Result<Projection, String> {
        let name = &facts.name;
        if let Some(model) = facts.camera_model.as_deref().filter(|model| *model != "pinhole") {
            return Err(format!("{name} is a camera `{model}`; a pinhole can be projected"));
        }
        let intrinsics = match facts.intrinsics.as_deref() {
            Some(&[fx, fy, cx, cy]) if fx > 0.0 && fy > 0.0 => [fx, fy, cx, cy],
            Some(other) => {
                return Err(format!("{name} has the intrinsics {other:?}, and needs fx, fy, cx, cy"));
            }
            None => return Err(format!("{name} has no intrinsics")),
        };
        let k = facts.distortion.as_deref().unwrap_or_default();
        let distortion = match (facts.distortion_model.as_deref(), k) {
            (None | Some("none"), []) => Distortion::None,
            (_, k) if k.iter().all(|k| *k == 0.0) => Distortion::None,
            (None | Some("radtan" | "plumb_bob"), &[k1, k2, p1, p2]) => {
                Distortion::Radtan([k1, k2, p1, p2, 0.0])
            }
            (None | Some("radtan" | "plumb_bob"), &[k1, k2, p1, p2, k3]) => {
                Distortion::Radtan([k1, k2, p1, p2, k3])
            }
            (Some("equidistant"), &[k1, k2, k3, k4]) => Distortion::Equidistant([k1, k2, k3, k4]),
            (model, k) => {
                return Err(format!(
                    "{name} has the distortion `{}` with {} coefficients; radtan with 4 or 5 and equidistant \
                     with 4 are known",
                    model.unwrap_or("none stated"),
                    k.len()
                ));
            }
        };
        Ok(Projection { intrinsics, distortion })
    }

    /// Column and row of a direction (x, y, 1).
    pub(crate) fn project(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [fx, fy, cx, cy] = self.intrinsics;
        let (x, y) = self.distorted((x, y));
        (fx * x + cx, fy * y + cy)
    }

    /// The direction (x, y, 1) that a place sees; none where no direction is seen there.
    pub(crate) fn direction(&self, (column, row): (f64, f64)) -> Option<(f64, f64)> {
        let [fx, fy, cx, cy] = self.intrinsics;
        let seen = ((column - cx) / fx, (row - cy) / fy);
        let mut at = seen;
        const BY: f64 = 1e-6;
        for _ in 0..STEPS {
            let here = self.distorted(at);
            let (off_x, off_y) = (seen.0 - here.0, seen.1 - here.1);
            if off_x.abs() < FOUND && off_y.abs() < FOUND {
                return Some(at);
            }
            let (right, below) = (self.distorted((at.0 + BY, at.1)), self.distorted((at.0, at.1 + BY)));
            let (a, c) = ((right.0 - here.0) / BY, (right.1 - here.1) / BY);
            let (b, d) = ((below.0 - here.0) / BY, (below.1 - here.1) / BY);
            let determinant = a * d - b * c;
            // Beyond the fold of a polynomial nothing is seen twice.
            if determinant.is_nan() || determinant <= 0.0 {
                return None;
            }
            at.0 += (d * off_x - b * off_y) / determinant;
            at.1 += (a * off_y - c * off_x) / determinant;
        }
        None
    }

    fn distorted(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let r2 = x * x + y * y;
        match self.distortion {
            Distortion::None => (x, y),
            Distortion::Radtan([k1, k2, p1, p2, k3]) => {
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                (
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
            Distortion::Equidistant([k1, k2, k3, k4]) => {
                let r = r2.sqrt();
                if r < 1e-9 {
                    return (x, y);
                }
                let angle = libm::atan(r);
                let a2 = angle * angle;
                let bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                (x * bent / r, y * bent / r)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(model: &str, coefficients: &[f64]) -> Projection {
        let facts = CameraFacts {
            name: "cam0".into(),
            intrinsics: Some(vec![553.46, 553.39, 346.65, 216.52]),
            distortion_model: Some(model.into()),
            distortion: Some(coefficients.to_vec()),
            ..CameraFacts::default()
        };
        Projection::of(&facts).unwrap()
    }

    #[test]
    fn places_are_those_of_opencv() {
        // cv2.projectPoints and cv2.fisheye.projectPoints of OpenCV 4.
        let close = |model: &str, coefficients: &[f64], places: [(f64, f64); 2]| {
            let camera = camera(model, coefficients);
            for (direction, place) in [(0.3, -0.2), (-0.5, 0.35)].into_iter().zip(places) {
                let found = camera.project(direction);
                assert!(
                    (found.0 - place.0).abs() < 1e-5 && (found.1 - place.1).abs() < 1e-5,
                    "{found:?}, {place:?}"
                );
            }
        };
        let four = [-0.0935, 0.1944, 7.64e-05, 0.0019];
        close("radtan", &four, [(511.536_217, 106.706_38), (72.996_284, 408.343_286)]);
        let five = [-0.0935, 0.1944, 7.64e-05, 0.0019, 0.05];
        close("radtan", &five, [(511.554_456, 106.694_222), (72.281_121, 408.843_836)]);
        let fisheye = [0.02, -0.01, 0.003, -0.001];
        close("equidistant", &fisheye, [(506.366_472, 110.055_819), (96.903_465, 391.320_463)]);
    }

    #[test]
    fn a_place_sees_the_direction_that_is_seen_there() {
        for camera in [
            camera("radtan", &[-0.0935, 0.1944, 7.64e-05, 0.0019]),
            camera("equidistant", &[0.02, -0.01, 0.003, -0.001]),
            camera("none", &[]),
        ] {
            for direction in [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.35)] {
                let found = camera.direction(camera.project(direction)).unwrap();
                assert!((found.0 - direction.0).abs() < 1e-9 && (found.1 - direction.1).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn what_is_not_known_is_refused_with_what_there_is() {
        let facts = |change: &dyn Fn(&mut CameraFacts)| {
            let mut facts = CameraFacts {
                name: "cam1".into(),
                intrinsics: Some(vec![1.0, 1.0, 0.0, 0.0]),
                ..CameraFacts::default()
            };
            change(&mut facts);
            Projection::of(&facts).unwrap_err()
        };
        assert!(facts(&|facts| facts.camera_model = Some("omni".into())).contains("a camera `omni`"));
        assert!(facts(&|facts| facts.intrinsics = None).contains("cam1 has no intrinsics"));
        assert!(facts(&|facts| facts.distortion = Some(vec![0.1])).contains("with 1 coefficients"));
    }
}
