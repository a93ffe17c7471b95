//! Facts about cameras from calibration files: kalibr's camchain, DSEC's `cam_to_cam.yaml`, and what OpenCV's
//! stereo calibration stores.
//!
//! Every field may be missing, and what is missing stays unknown. The lengths of lists are checked, their
//! values only for being finite. Sources: kalibr's wiki, "Yaml formats"; the data format page of DSEC;
//! OpenCV's sample `stereo_calib.cpp`, whose two files are read as one after the other in one file. Limits:
//! the extrinsic matrices are given as they stand in the file. Kalibr states `line_delay` and
//! `timeshift_cam_imu` in seconds.

use crate::error::FormatError;
use photocurrent_core::Extent;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Largest file that is read; calibrations have a few kilobytes.
const LARGEST: u64 = 1 << 20;

/// A 4 x 4 (or 3 x 3) matrix by rows.
pub type Matrix = Vec<Vec<f64>>;

/// What a file says about one camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFacts {
    /// As the file names it: `cam0`, `camRect1`.
    pub name: String,
    /// The topic of its images or events.
    pub topic: Option<String>,
    /// Size of its pixel array.
    pub extent: Option<Extent>,
    /// Model of the projection: `pinhole`.
    pub camera_model: Option<String>,
    /// fx, fy, cx, cy of a pinhole, pixels; others as their model has them.
    pub intrinsics: Option<Vec<f64>>,
    /// Model of the distortion: `radtan`, `equidistant`.
    pub distortion_model: Option<String>,
    /// Its coefficients.
    pub distortion: Option<Vec<f64>>,
    /// Seconds to add to this camera's stamps to get those of the inertial sensor.
    pub timeshift_cam_imu_s: Option<f64>,
    /// Delay from one row to the next, seconds.
    pub line_delay_s: Option<f64>,
    /// Pose of the inertial sensor in this camera.
    pub t_cam_imu: Option<Matrix>,
    /// Pose of the camera before in this one.
    pub t_cn_cnm1: Option<Matrix>,
}

/// What a file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Its cameras, sorted by name.
    pub cameras: Vec<CameraFacts>,
    /// Transforms between cameras by the file's names: `T_10`, `R_rect0`.
    pub transforms: Vec<(String, Matrix)>,
}

/// A camera as both layouts write it; DSEC's names for the same things stand as aliases.
#[derive(Debug, Deserialize)]
struct Camera {
    rostopic: Option<String>,
    resolution: Option<Vec<f64>>,
    camera_model: Option<String>,
    #[serde(alias = "camera_matrix")]
    intrinsics: Option<Vec<f64>>,
    distortion_model: Option<String>,
    distortion_coeffs: Option<Vec<f64>>,
    timeshift_cam_imu: Option<f64>,
    line_delay: Option<f64>,
    #[serde(rename = "T_cam_imu")]
    t_cam_imu: Option<Matrix>,
    #[serde(rename = "T_cn_cnm1")]
    t_cn_cnm1: Option<Matrix>,
}

#[derive(Debug, Deserialize)]
struct Dsec {
    intrinsics: BTreeMap<String, Camera>,
    extrinsics: Option<BTreeMap<String, Matrix>>,
}

/// A matrix as OpenCV stores it.
#[derive(Debug, Deserialize)]
struct OpenCvMatrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

/// Cameras 1 and 2 as OpenCV's samples name their matrices, and where the second stands from the first.
#[derive(Debug, Deserialize)]
struct OpenCv {
    #[serde(rename = "M1", alias = "K1", alias = "cameraMatrix1")]
    first: OpenCvMatrix,
    #[serde(rename = "D1", alias = "distCoeffs1")]
    first_distortion: Option<OpenCvMatrix>,
    #[serde(rename = "M2", alias = "K2", alias = "cameraMatrix2")]
    second: OpenCvMatrix,
    #[serde(rename = "D2", alias = "distCoeffs2")]
    second_distortion: Option<OpenCvMatrix>,
    #[serde(rename = "R")]
    turn: OpenCvMatrix,
    #[serde(rename = "T")]
    step: OpenCvMatrix,
}

/// Camera 1 is `cam0`, camera 2 `cam1`.
fn of_opencv(text: &str) -> Result<Calibration, String> {
    // Documents that follow each other state one calibration together; types stand in each matrix itself.
    let plain = text.replace("!!opencv-matrix", "");
    let is_header = |line: &&str| line.starts_with("%YAML") || ["---", "..."].contains(&line.trim());
    let joined: String =
        plain.lines().filter(|line| !is_header(line)).flat_map(|line| [line, "\n"]).collect();
    let found: OpenCv = serde_saphyr::from_str(&joined).map_err(|error| first_line(&error.to_string()))?;
    let sized = |name: &str, matrix: &OpenCvMatrix, sizes: &[(usize, usize)]| {
        let is_whole = matrix.rows.checked_mul(matrix.cols) == Some(matrix.data.len());
        if is_whole
            && sizes.contains(&(matrix.rows, matrix.cols))
            && matrix.data.iter().all(|v| v.is_finite())
        {
            return Ok(());
        }
        Err(format!("`{name}` is {} x {} with {} values", matrix.rows, matrix.cols, matrix.data.len()))
    };
    sized("R", &found.turn, &[(3, 3)])?;
    sized("T", &found.step, &[(3, 1), (1, 3)])?;
    let camera = |name: &str, matrix: OpenCvMatrix, distortion: Option<OpenCvMatrix>| {
        sized(name, &matrix, &[(3, 3)])?;
        let k = matrix.data;
        Ok::<CameraFacts, String>(CameraFacts {
            name: name.into(),
            camera_model: Some("pinhole".into()),
            intrinsics: Some(vec![k[0], k[4], k[2], k[5]]),
            distortion_model: distortion.as_ref().map(|_| "radtan".into()),
            distortion: distortion.map(|matrix| matrix.data),
            ..CameraFacts::default()
        })
    };
    let (r, t) = (&found.turn.data, &found.step.data);
    let mut transform: Matrix = (0..3).map(|n| vec![r[3 * n], r[3 * n + 1], r[3 * n + 2], t[n]]).collect();
    transform.push(vec![0.0, 0.0, 0.0, 1.0]);
    Ok(Calibration {
        cameras: vec![
            camera("cam0", found.first, found.first_distortion)?,
            camera("cam1", found.second, found.second_distortion)?,
        ],
        transforms: vec![("T_10".into(), transform)],
    })
}

/// Reads a calibration file of any of these layouts.
///
/// # Errors
/// When it is neither, or too large, or a value has another form.
pub fn read(path: &Path) -> Result<Calibration, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > LARGEST {
        return Err(FormatError::new(
            path,
            format!("{bytes} bytes"),
            "name a kalibr camchain or DSEC's cam_to_cam.yaml",
        )
        .expected("a calibration of at most 1 MiB"));
    }
    parse(path, &std::fs::read_to_string(path).map_err(io)?)
}

/// As [`read`], of the file's text.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str) -> Result<Calibration, FormatError> {
    let wrong = |what: String| {
        FormatError::new(
            path,
            what,
            "name a kalibr camchain (cam0: ...) or DSEC's cam_to_cam.yaml (intrinsics: cam0: ...)",
        )
    };
    if text.contains("!!opencv-matrix") {
        return of_opencv(text).map_err(|why| {
            wrong(format!("it is no stereo calibration of OpenCV: {why}"))
                .expected("the matrices M1, D1, M2, D2, R, T")
        });
    }
    // OpenCV writes a line that newer YAML does not know.
    let text = text.strip_prefix("%YAML:1.0").unwrap_or(text);
    let is_dsec = text.lines().any(|line| line.trim_end() == "intrinsics:");
    let (cameras, transforms) = if is_dsec {
        let dsec: Dsec = serde_saphyr::from_str(text).map_err(|error| {
            wrong(format!("it is no DSEC calibration: {}", first_line(&error.to_string())))
        })?;
        (dsec.intrinsics, dsec.extrinsics.unwrap_or_default())
    } else {
        let cameras: BTreeMap<String, Camera> = serde_saphyr::from_str(text)
            .map_err(|error| wrong(format!("it is no camchain: {}", first_line(&error.to_string()))))?;
        (cameras, BTreeMap::new())
    };
    if !cameras.keys().any(|name| name.starts_with("cam")) {
        return Err(wrong("it names no camera".into()).expected("a camera `cam0`"));
    }
    let mut calibration = Calibration::default();
    for (name, camera) in cameras.into_iter().filter(|(name, _)| name.starts_with("cam")) {
        calibration.cameras.push(facts(name, camera).map_err(wrong)?);
    }
    calibration.transforms = transforms.into_iter().collect();
    Ok(calibration)
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_string()
}

fn facts(name: String, camera: Camera) -> Result<CameraFacts, String> {
    let extent = match camera.resolution.as_deref() {
        None => None,
        Some(&[width, height])
            if [width, height].iter().all(|side| side.fract() == 0.0 && (1.0..=65_536.0).contains(side)) =>
        {
            Some(Extent { width: width as u32, height: height as u32 })
        }
        Some(other) => {
            return Err(format!("the resolution of {name} is {other:?}, and must be width and height"));
        }
    };
    for (what, value) in [("timeshift_cam_imu", camera.timeshift_cam_imu), ("line_delay", camera.line_delay)]
    {
        if value.is_some_and(|value| !value.is_finite()) {
            return Err(format!("{what} of {name} is not finite"));
        }
    }
    if let Some(bad) =
        camera.intrinsics.iter().chain(&camera.distortion_coeffs).flatten().find(|value| !value.is_finite())
    {
        return Err(format!("an intrinsic or distortion value of {name} is {bad}"));
    }
    for matrix in [&camera.t_cam_imu, &camera.t_cn_cnm1].into_iter().flatten() {
        if matrix.len() != 4 || matrix.iter().any(|row| row.len() != 4) {
            return Err(format!("a transform of {name} is no matrix of 4 x 4"));
        }
    }
    Ok(CameraFacts {
        name,
        topic: camera.rostopic,
        extent,
        camera_model: camera.camera_model,
        intrinsics: camera.intrinsics,
        distortion_model: camera.distortion_model,
        distortion: camera.distortion_coeffs,
        timeshift_cam_imu_s: camera.timeshift_cam_imu,
        line_delay_s: camera.line_delay,
        t_cam_imu: camera.t_cam_imu,
        t_cn_cnm1: camera.t_cn_cnm1,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2847798, 0.08245052, -1.0946e-06, 4.78701e-06]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  T_cam_imu:
  - [0.01, -0.99, 0.00, 0.02]
  - [0.99, 0.01, 0.00, -0.06]
  - [0.00, 0.00, 1.00, 0.00]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -8.1210e-05
  line_delay: 2.5e-5
cam1:
  intrinsics: [1.0, 2.0, 3.0, 4.0]
";

    const DSEC: &str = "extrinsics:
  T_10:
  - [1.0, 0.0, 0.0, 0.05]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
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
  cam1:
    resolution: [1440, 1080]
disparity_to_depth:
  cams_03:
  - [1.0, 0.0, 0.0, -1.0]
";

    #[test]
    fn a_camchain_gives_its_facts_and_leaves_the_rest_unknown() {
        let calibration = parse(Path::new("camchain.yaml"), KALIBR).unwrap();
        let [first, second] = calibration.cameras.as_slice() else { panic!("{calibration:?}") };
        assert_eq!(first.extent, Some(Extent { width: 752, height: 480 }));
        assert_eq!((first.timeshift_cam_imu_s, first.line_delay_s), (Some(-8.1210e-05), Some(2.5e-5)));
        assert_eq!(first.topic.as_deref(), Some("/cam0/image_raw"));
        assert_eq!(first.t_cam_imu.as_ref().map(|matrix| matrix[1][3]), Some(-0.06));
        assert_eq!(second.intrinsics, Some(vec![1.0, 2.0, 3.0, 4.0]));
        assert_eq!((second.extent, second.line_delay_s, second.timeshift_cam_imu_s), (None, None, None));
    }

    #[test]
    fn dsec_gives_cameras_and_transforms() {
        let calibration = parse(Path::new("cam_to_cam.yaml"), DSEC).unwrap();
        assert_eq!(calibration.cameras[0].intrinsics, Some(vec![553.46, 553.39, 346.65, 216.52]));
        assert_eq!(calibration.cameras[1].extent, Some(Extent { width: 1440, height: 1080 }));
        assert_eq!(
            calibration.transforms.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
            ["R_rect0", "T_10"]
        );
    }

    #[test]
    fn a_stereo_calibration_of_opencv_gives_two_cameras_and_their_transform() {
        let matrix = |name: &str, rows: usize, cols: usize, data: &str| {
            format!(
                "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"
            )
        };
        let first = matrix("M1", 3, 3, "500., 0., 320., 0.,\n       510., 240., 0., 0., 1.");
        let second = matrix("M2", 3, 3, "900., 0., 700., 0., 910., 500., 0., 0., 1.");
        let (d1, d2) =
            (matrix("D1", 1, 5, "-1.0e-01, 0.02, 0., 0., 0."), matrix("D2", 1, 5, "0., 0., 0., 0., 0."));
        let stands =
            matrix("R", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.") + &matrix("T", 3, 1, "-5., 0.1, 0.");
        let text = format!("%YAML 1.2\n---\n{first}{d1}{second}{d2}...\n%YAML:1.0\n---\n{stands}");
        let found = parse(Path::new("stereo.yml"), &text).unwrap();
        assert_eq!(found.cameras[1].intrinsics, Some(vec![900.0, 910.0, 700.0, 500.0]));
        assert_eq!(found.cameras[0].distortion.as_deref(), Some(&[-0.1, 0.02, 0.0, 0.0, 0.0][..]));
        assert_eq!(found.transforms[0].1[0], [1.0, 0.0, 0.0, -5.0]);
        let error = parse(Path::new("stereo.yml"), &text.replace("cols: 1\n", "cols: 2\n")).unwrap_err();
        assert!(error.found.contains("`T` is 3 x 2 with 3 values"), "{}", error.found);
    }

    #[test]
    fn what_is_no_calibration_is_refused_with_the_reason() {
        for text in [
            "",
            "a: 1",
            "cam0: [1, 2]",
            "cam0:\n  resolution: [1.5, 2]",
            "cam0:\n  T_cam_imu: [[1]]",
            "- 1",
            "\u{0}",
            "cam0:\n  line_delay: .nan",
        ] {
            let error = parse(Path::new("x.yaml"), text).unwrap_err();
            assert!(error.hint.contains("camchain"), "{text}: {error}");
        }
    }

    #[test]
    fn aliases_of_aliases_do_not_fill_the_memory() {
        let mut text = String::from("a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n");
        for level in 1..12 {
            let list = vec![format!("*a{}", level - 1); 10].join(", ");
            text += &format!("a{level}: &a{level} [{list}]\n");
        }
        assert!(parse(Path::new("x.yaml"), &text).is_err());
    }

    proptest::proptest! {
        #[test]
        fn damaged_text_does_not_panic(at in 0..KALIBR.len(), byte in 0_u8..128) {
            let mut text = KALIBR.as_bytes().to_vec();
            text[at] = byte;
            let _ = parse(Path::new("x.yaml"), &String::from_utf8_lossy(&text));
        }
    }
}
