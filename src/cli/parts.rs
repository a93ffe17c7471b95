//! Which of several files is what: the recording, its frames, their stamps, and what is known of the camera.

use crate::failure::{Failure, usage};
use photocurrent_formats::instead::{may_be_stamps, what_it_is};
use photocurrent_formats::{Declared, Format, FormatError, Probe, bias, calibration, catalog};
use std::path::{Path, PathBuf};

/// Which file is what.
pub struct Parts {
    pub recording: PathBuf,
    pub format: &'static Format,
    pub frames: Option<PathBuf>,
    pub stamps: Option<PathBuf>,
    /// What calibration and bias files say, a line each.
    pub camera: Vec<String>,
    /// Delay from row to row that a calibration states, s.
    pub line_delay_s: Option<f64>,
}

impl Parts {
    /// One file with events, at most one folder or film of pictures, at most one file of stamps.
    pub fn sort(files: &[PathBuf]) -> Result<Parts, Failure> {
        let (mut recording, mut stamps) = (None, None);
        let mut frames: Option<PathBuf> = None;
        let (mut camera, mut line_delay_s) = (Vec::new(), None);
        for path in files {
            if let Some(delay) = camera_facts(path, &mut camera)? {
                line_delay_s = delay.or(line_delay_s);
                continue;
            }
            let found = catalog::recognise(path).map_err(|error| usage(error.to_string()))?;
            let (slot, what) = match found {
                Some(format) if format.id == "pictures" => {
                    if let Some(other) = frames.replace(path.clone()) {
                        return Err(usage(format!(
                            "{} and {} both hold frames: name one",
                            other.display(),
                            path.display()
                        )));
                    }
                    continue;
                }
                Some(format) => (&mut recording, format),
                None => {
                    let probe = Probe::new(path).map_err(|error| usage(error.to_string()))?;
                    if let Some(instead) = what_it_is(&probe) {
                        return Err(usage(instead.refusal(path).to_string()));
                    }
                    if stamps.is_none() && may_be_stamps(&probe) {
                        stamps = Some(path.clone());
                        continue;
                    }
                    let hint = "hint: photocurrent inspect lists what it can read; text files need columns: \
                                --columns t,x,y,p";
                    return Err(usage(format!(
                        "{}: this is no recording of a known format\n  {hint}",
                        path.display()
                    )));
                }
            };
            if let Some((other, _)) = slot.replace((path.clone(), what)) {
                let other: PathBuf = other;
                return Err(usage(format!(
                    "{} and {} both hold events: name one",
                    other.display(),
                    path.display()
                )));
            }
        }
        let (recording, format) = recording.ok_or_else(|| {
            usage(
                "no file with events among those named\n  hint: name the event \
                                           recording first, then its frames",
            )
        })?;
        Ok(Parts { recording, format, frames, stamps, camera, line_delay_s })
    }

    /// Several files that are one recording: events, their frames, and what states when these were taken.
    /// None where they are each a recording of their own.
    pub fn one_recording(files: &[PathBuf]) -> Option<Parts> {
        if files.len() < 2 { None } else { Parts::sort(files).ok().filter(|parts| parts.frames.is_some()) }
    }

    /// What is stated, with the places of frames and stamps.
    pub fn declared(&self, stated: &Declared) -> Declared {
        let mut declared = stated.clone();
        declared.frames = self.frames.clone().or(declared.frames);
        declared.stamps = self.stamps.clone().or(declared.stamps);
        declared
    }
}

/// Lines about a camera from a calibration (kalibr, DSEC's cam_to_cam) or a file of biases, and the row delay
/// that it states; `None` when the file is neither.
fn camera_facts(path: &Path, lines: &mut Vec<String>) -> Result<Option<Option<f64>>, Failure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let refused = |error: FormatError| crate::declared::refused(&error);
    match path.extension().unwrap_or_default().to_string_lossy().to_lowercase().as_str() {
        "yaml" | "yml" => {
            let found = calibration::read(path).map_err(refused)?;
            for camera in &found.cameras {
                let mut facts = Vec::new();
                facts.extend(camera.extent.map(|extent| format!("{extent} pixels")));
                facts.extend(camera.topic.clone());
                facts.extend(
                    camera
                        .camera_model
                        .as_ref()
                        .zip(camera.intrinsics.as_ref())
                        .map(|(model, numbers)| format!("{model} {numbers:?}")),
                );
                facts.extend(
                    camera
                        .distortion_model
                        .as_ref()
                        .zip(camera.distortion.as_ref())
                        .map(|(model, numbers)| format!("{model} {numbers:?}")),
                );
                facts.extend(
                    camera.timeshift_cam_imu_s.map(|seconds| format!("time shift to the IMU {seconds} s")),
                );
                facts.extend(camera.line_delay_s.map(|seconds| format!("line delay {seconds} s")));
                lines.push(format!("{name}: {}: {}", camera.name, facts.join("; ")));
            }
            Ok(Some(found.cameras.iter().find_map(|camera| camera.line_delay_s)))
        }
        "bias" => {
            // How a bias acts in volts or seconds is known by calibration alone.
            lines.extend(
                bias::read(path)
                    .map_err(refused)?
                    .iter()
                    .map(|(bias, value)| format!("{name}: {bias} = {value}")),
            );
            Ok(Some(None))
        }
        _ => Ok(None),
    }
}
