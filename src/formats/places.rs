//! Where the pixels of an event array lie on the frames, by what files state.

use crate::calibration::{self, CameraFacts, Matrix};
use crate::declared::Declared;
use crate::error::FormatError;
use crate::hs_ergb::HsErgb;
use crate::projection::Projection;
use nalgebra::{Matrix3, Vector3};
use photocurrent_core::Extent;
use std::path::Path;

pub use crate::warped::Array;

/// The array of a sequence of HS-ERGB or BS-ERGB whose events were warped onto its pictures; none where their
/// places are whole pixels, or no lattice.
///
/// # Errors
/// When the folder is no such sequence, or cannot be read.
pub fn of_sequence(path: &Path) -> Result<Option<Array>, FormatError> {
    Ok(HsErgb::open(path, &Declared::default())?.array())
}

/// The array of camera `events` of a calibration file (kalibr's camchain, DSEC's `cam_to_cam.yaml`, a stereo
/// calibration of OpenCV), on frames of camera `frames`: places of what lies `distance_m` away (in the unit
/// of the file's translations), or very far where that is not stated. `size` is that of the array where the
/// file states none. DSEC's rectified cameras (`camRect1`) are those turned by `R_rect1`.
///
/// # Errors
/// When the file is no calibration, lacks a camera or what it takes to project, or pixels see no direction
/// that the other camera has.
pub fn of_calibration(
    path: &Path,
    (events, frames): (&str, &str),
    distance_m: Option<f64>,
    size: Option<Extent>,
) -> Result<Array, FormatError> {
    let calibration = calibration::read(path)?;
    let wrong = |what: String| {
        FormatError::new(path, what, "name two of its cameras whose projection and transforms it states")
    };
    let camera = |name: &str| {
        calibration.cameras.iter().find(|camera| camera.name == name).ok_or_else(|| {
            let names: Vec<&str> = calibration.cameras.iter().map(|camera| camera.name.as_str()).collect();
            wrong(format!("it has no camera `{name}`; it has {}", names.join(", ")))
        })
    };
    let (array, picture) = (camera(events)?, camera(frames)?);
    let extent = array.extent.or(size).ok_or_else(|| {
        wrong(format!("it states no resolution of {events}"))
            .expected("`width` and `height` of the event array")
    })?;
    let (from, to) = (Projection::of(array).map_err(wrong)?, Projection::of(picture).map_err(wrong)?);
    let turned = |camera: &CameraFacts| rectified(&calibration.transforms, camera).map_err(wrong);
    let (first, last) = (turned(array)?, turned(picture)?);
    let (turn, step) = between(&calibration, (first.0, last.0)).map_err(wrong)?;
    let turn = last.1 * turn * first.1.transpose();
    // What is far away moves by the turn alone.
    let step = distance_m.map_or(Vector3::zeros(), |distance| last.1 * step / distance);
    let place = |(column, row): (u32, u32)| {
        let (x, y) = from.direction((column.into(), row.into()))?;
        let seen = turn * Vector3::new(x, y, 1.0) + step;
        (seen.z > 1e-3).then(|| to.project((seen.x / seen.z, seen.y / seen.z)))
    };
    let all = (0..extent.height).flat_map(|row| (0..extent.width).map(move |column| (column, row)));
    let places: Option<Vec<(f64, f64)>> = all.map(place).collect();
    let places = places.ok_or_else(|| {
        wrong(format!("a pixel of {events} sees no direction before {frames}: the distortion folds"))
    })?;
    Ok(Array { extent, places, residual: 0.0, files: vec![path.into()] })
}

/// The number of a camera, and how it is turned from the one that was calibrated.
fn rectified(transforms: &[(String, Matrix)], camera: &CameraFacts) -> Result<(usize, Matrix3<f64>), String> {
    let name = &camera.name;
    let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
    let number = digits.parse().map_err(|_| format!("the camera `{name}` has no number"))?;
    if !name.starts_with("camRect") {
        return Ok((number, Matrix3::identity()));
    }
    let key = format!("R_rect{number}");
    let found = transforms.iter().find(|(other, _)| *other == key);
    let (_, matrix) = found.ok_or_else(|| format!("it has no `{key}`, by which {name} is turned"))?;
    Ok((number, rotation(&key, matrix)?))
}

/// The turn and step from one numbered camera to another, over those between.
fn between(
    calibration: &calibration::Calibration,
    (from, to): (usize, usize),
) -> Result<(Matrix3<f64>, Vector3<f64>), String> {
    let (mut turn, mut step) = (Matrix3::identity(), Vector3::zeros());
    for number in usize::min(from, to) + 1..=usize::max(from, to) {
        let key = format!("T_{number}{}", number - 1);
        let named = calibration.transforms.iter().find(|(name, _)| *name == key).map(|(_, matrix)| matrix);
        let own = format!("cam{number}");
        let chained = calibration.cameras.iter().find(|camera| camera.name == own);
        let matrix = named.or_else(|| chained.and_then(|camera| camera.t_cn_cnm1.as_ref()));
        let matrix = matrix.ok_or_else(|| {
            format!("it has neither `{key}` nor `T_cn_cnm1` of {own}: where the cameras stand is not stated")
        })?;
        let (r, t) = (rotation(&key, matrix)?, translation(&key, matrix)?);
        (turn, step) = (r * turn, r * step + t);
    }
    // From the higher to the lower it is the inverse.
    Ok(if from <= to { (turn, step) } else { (turn.transpose(), -(turn.transpose() * step)) })
}

fn rotation(name: &str, matrix: &Matrix) -> Result<Matrix3<f64>, String> {
    if matrix.len() < 3 || matrix.iter().take(3).any(|row| row.len() < 3) {
        return Err(format!("`{name}` is no matrix of 3 x 3 or 4 x 4"));
    }
    let turn = Matrix3::from_fn(|row, column| matrix[row][column]);
    let off = (turn * turn.transpose() - Matrix3::identity()).norm();
    if off.is_nan() || off > 1e-3 {
        return Err(format!("`{name}` is no rotation: it is {off:.3} off"));
    }
    Ok(turn)
}

fn translation(name: &str, matrix: &Matrix) -> Result<Vector3<f64>, String> {
    if matrix.iter().take(3).any(|row| row.len() < 4) {
        return Err(format!("`{name}` states no translation"));
    }
    Ok(Vector3::from_fn(|row, _| matrix[row][3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turned by the rotation vector (0.01, -0.02, 0.03), 5 cm aside.
    const CALIBRATION: &str = "extrinsics:
  T_10:
  - [0.9993500758297945, -0.030092988823861425, -0.01984535115917247, 0.05]
  - [0.029893012156105903, 0.9995000583306112, -0.010297631831627843, 0.0]
  - [0.020145316160805754, 0.00969770182836127, 0.9997500291653056, 0.0]
  - [0, 0, 0, 1]
  R_rect0:
  - [1.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0]
  - [0.0, 0.0, 1.0]
intrinsics:
  cam0:
    camera_matrix: [553.46, 553.39, 346.65, 216.52]
    distortion_coeffs: [-0.0935, 0.1944, 7.64e-05, 0.0019]
    distortion_model: radtan
    resolution: [640, 480]
  camRect0:
    camera_matrix: [500.0, 500.0, 320.0, 240.0]
    resolution: [640, 480]
  cam1:
    camera_matrix: [1100.0, 1100.0, 720.0, 540.0]
    distortion_coeffs: [-0.1, 0.05, 0.001, -0.002]
    distortion_model: radtan
    resolution: [1440, 1080]
  cam2:
    camera_matrix: [1100.0, 1100.0, 720.0, 540.0]
    resolution: [1440, 1080]
";

    fn places(cameras: (&str, &str), distance_m: Option<f64>) -> Result<Array, FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cam_to_cam.yaml");
        std::fs::write(&path, CALIBRATION).unwrap();
        of_calibration(&path, cameras, distance_m, None)
    }

    fn close(array: &Array, places: [((usize, usize), (f64, f64)); 3]) {
        for ((column, row), (x, y)) in places {
            let found = array.places[row * array.extent.width as usize + column];
            assert!((found.0 - x).abs() < 1e-3 && (found.1 - y).abs() < 1e-3, "{found:?}, {x} {y}");
        }
    }

    #[test]
    fn places_of_two_cameras_are_those_of_opencv() {
        // cv2.undistortPoints, then cv2.projectPoints of OpenCV 4.
        let far = places(("cam0", "cam1"), None).unwrap();
        close(
            &far,
            [
                ((100, 80), (215.2422, 243.0626)),
                ((320, 240), (643.7378, 573.7886)),
                ((600, 400), (1175.1801, 897.5864)),
            ],
        );
        let near = places(("cam0", "cam1"), Some(5.0)).unwrap();
        close(
            &near,
            [
                ((100, 80), (225.8114, 242.862)),
                ((320, 240), (654.7412, 573.7902)),
                ((600, 400), (1185.4403, 897.3619)),
            ],
        );
    }

    #[test]
    fn a_camera_lies_on_itself() {
        let array = places(("cam0", "cam0"), None).unwrap();
        let close = |n: usize, place: &(f64, f64)| {
            let (column, row) = ((n % 640) as f64, (n / 640) as f64);
            (place.0 - column).abs() < 1e-6 && (place.1 - row).abs() < 1e-6
        };
        assert!(array.places.iter().enumerate().all(|(n, place)| close(n, place)));
        // And the rectified one on what it was made of: the middle of both is the axis.
        let rectified = places(("camRect0", "cam0"), None).unwrap();
        let (x, y) = rectified.places[240 * 640 + 320];
        assert!((x - 346.65).abs() < 1e-6 && (y - 216.52).abs() < 1e-6);
    }

    #[test]
    fn what_a_calibration_lacks_is_named() {
        let found = |cameras| places(cameras, None).unwrap_err().found;
        assert_eq!(found(("cam0", "cam7")), "it has no camera `cam7`; it has cam0, cam1, cam2, camRect0");
        assert!(found(("cam1", "cam2")).contains("neither `T_21` nor `T_cn_cnm1` of cam2"));
    }
}
