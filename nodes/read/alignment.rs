//! `read/alignment`: where the pixels of an event array lie on the frames of another camera.
//!
//! A sequence of HS-ERGB or BS-ERGB has events that were warped onto its pictures: their distinct places give
//! the event array's own grid back. A calibration (kalibr's camchain, DSEC's `cam_to_cam.yaml`, a stereo
//! calibration of OpenCV, whose camera 1 is `cam0` and camera 2 `cam1`) states how both cameras project and
//! how they stand to each other. A homography is stated by itself.
//!
//! Limits: of a calibration, places of what is very far, or at one stated distance; of cameras side by side,
//! what is nearer or farther than that is seen elsewhere.

use photocurrent_core::quantity::InputPath;
use photocurrent_core::{Context, Decl, Extent, FileRef, Grain, MapSet, Meta, Node, NodeError, PortMetas};
use photocurrent_formats::places::{self, Array};
use photocurrent_scene::alignment::Alignment;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `read/alignment`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// A sequence of HS-ERGB or BS-ERGB (a folder), or a calibration (a YAML file of kalibr, DSEC or OpenCV);
    /// relative to the manifest that names it. Absent where `homography` is stated.
    pub path: InputPath,
    /// Of a calibration: the camera that sees events, such as `"cam0"`.
    pub events: Option<String>,
    /// Of a calibration: the camera of the frames, such as `"cam1"`, or `"camRect1"` for DSEC's rectified
    /// ones.
    pub frames: Option<String>,
    /// Of a calibration: how far away what is seen is, m (in OpenCV's files, the unit of `T`). Absent =
    /// very far.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub distance_m: Option<f64>,
    /// In place of `path`: three rows of three numbers that take (column, row, 1) of an event pixel to its
    /// place on the frames, up to a factor; an affine map has the last row 0, 0, 1.
    pub homography: Option<[[f64; 3]; 3]>,
    /// Columns of the event array: with `homography`, or of a calibration that states none.
    #[schemars(range(min = 2, max = 16384))]
    pub width: Option<u32>,
    /// Rows of it.
    #[schemars(range(min = 2, max = 16384))]
    pub height: Option<u32>,
}

photocurrent_core::ports! {
    /// Inputs: none.
    pub struct In {}
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// For each event pixel its column and row on the frames, pixels: planes `x [px]` and `y [px]`.
        alignment: MapSet,
    }
}

/// The node.
pub struct ReadAlignment {
    params: Params,
}

/// The places that a homography gives.
fn projected(homography: [[f64; 3]; 3], extent: Extent) -> Result<Alignment, NodeError> {
    let row = |row: usize, column: f64, line: f64| {
        homography[row][0] * column + homography[row][1] * line + homography[row][2]
    };
    let place = |at: usize| {
        let (column, line) = ((at % extent.width as usize) as f64, (at / extent.width as usize) as f64);
        let depth = row(2, column, line);
        (row(0, column, line) / depth, row(1, column, line) / depth, depth)
    };
    let all: Vec<(f64, f64, f64)> = (0..extent.pixels()).map(place).collect();
    let side = all[0].2.signum();
    if all.iter().any(|(x, y, depth)| !x.is_finite() || !y.is_finite() || depth.signum() != side) {
        return Err(NodeError::usage("the homography takes pixels of the event array to no place")
            .hint("it maps (column, row, 1) to the frames; an affine map has the last row 0, 0, 1")
            .param("homography"));
    }
    let places = |of: fn(&(f64, f64, f64)) -> f64| all.iter().map(|place| of(place) as f32).collect();
    Ok(Alignment { events: extent, x: places(|place| place.0), y: places(|place| place.1) })
}

impl ReadAlignment {
    /// The stated homography, if there is one.
    fn stated(&self) -> Result<Option<Alignment>, NodeError> {
        let Params { homography, width, height, path, .. } = &self.params;
        match (homography, width, height) {
            (None, None, None) => Ok(None),
            // Of a calibration that states no resolution.
            (None, Some(_), Some(_)) => Ok(None),
            (Some(homography), Some(width), Some(height)) if path.path().as_os_str().is_empty() => {
                projected(*homography, Extent { width: *width, height: *height }).map(Some)
            }
            (Some(_), Some(_), Some(_)) => {
                Err(NodeError::usage("`path` and `homography` both state where event pixels lie")
                    .hint("keep one of them")
                    .param("homography"))
            }
            (homography, width, _) => {
                let stated = if width.is_some() { "width" } else { "height" };
                let param = if homography.is_some() { "homography" } else { stated };
                Err(NodeError::usage("`width` and `height` state the size of the event array together")
                    .hint("state both; a `homography` needs them")
                    .param(param))
            }
        }
    }

    fn array(&self) -> Result<Array, NodeError> {
        let Params { events, frames, distance_m, width, height, .. } = &self.params;
        let path = self.params.path.path();
        let refused = |error| NodeError::from(error).param("path");
        match (events, frames) {
            (Some(events), Some(frames)) => {
                let size = width.zip(*height).map(|(width, height)| Extent { width, height });
                return places::of_calibration(path, (events, frames), *distance_m, size).map_err(refused);
            }
            (None, None) if path.is_dir() => {}
            _ => {
                return Err(NodeError::usage("a calibration needs the names of both cameras")
                    .hint(
                        "state `events = \"cam0\"` and `frames = \"cam1\"`, or name the folder of a sequence",
                    )
                    .param(if events.is_some() { "frames" } else { "events" }));
            }
        }
        let array = places::of_sequence(path).map_err(refused)?;
        array.ok_or_else(|| {
            NodeError::input(format!("{} has events on whole pixels of its pictures", path.display()))
                .note("an alignment is recovered from places with fractions, as events that were warped have")
                .hint("leave read/alignment and align/* out: events and frames have the same pixels")
                .param("path")
        })
    }
}

impl Node for ReadAlignment {
    const DECL: Decl = Decl {
        kind: "read/alignment",
        about: "Reads where the pixels of an event array lie on the frames of another camera.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Tulyakov et al., Time Lens, CVPR 2021: HS-ERGB",
            "Gehrig et al., DSEC: A Stereo Event Camera Dataset, RA-L 2021: calibration",
        ],
        example: r#"
[nodes.alignment]
kind   = "read/alignment"
params = { path = "sequence" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.homography.is_none() {
            super::need_path(&params.path, "sequence")?;
        }
        if params.distance_m.is_some_and(|distance| !(distance > 0.0 && distance.is_finite())) {
            return Err(NodeError::usage("`distance_m` must be more than 0 m").param("distance_m"));
        }
        let node = ReadAlignment { params };
        node.stated()?;
        Ok(node)
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        if let Some(stated) = self.stated()? {
            return Ok(vec![Meta::Map(Arc::new(Alignment::meta(stated.events)))]);
        }
        Ok(vec![Meta::Map(Arc::new(Alignment::meta(self.array()?.extent)))])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
        if let Some(stated) = self.stated()? {
            return Ok(Out { alignment: stated.into_map() });
        }
        let array = self.array()?;
        if self.params.events.is_none() {
            cx.note(format!(
                "an event array of {}, whose events lie {:.4} pixels off its places",
                array.extent, array.residual
            ));
        }
        let places = |of: fn(&(f64, f64)) -> f64| array.places.iter().map(|place| of(place) as f32).collect();
        let (x, y) = (places(|place| place.0), places(|place| place.1));
        Ok(Out { alignment: Alignment { events: array.extent, x, y }.into_map() })
    }

    fn files(&self) -> Vec<FileRef> {
        if self.params.homography.is_some() {
            return Vec::new();
        }
        // What cannot be read is reported by the plan.
        let files = self.array().map(|array| array.files).unwrap_or_default();
        files.into_iter().map(|path| FileRef { param: "path".into(), path }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_or_wrong_is_refused_by_its_parameter() {
        let folder = tempfile::tempdir().unwrap();
        let calibration = folder.path().join("camchain.yaml");
        std::fs::write(&calibration, "cam0:\n  resolution: [4, 3]\n").unwrap();
        let path = InputPath::new(calibration);
        let plan = |params: Params| {
            ReadAlignment::build(params).and_then(|node| node.plan(&PortMetas::default())).err().unwrap()
        };
        let error = plan(Params { path: path.clone(), ..Params::default() });
        assert_eq!(error.param.as_deref(), Some("events"), "{error:?}");
        let error = plan(Params { path: path.clone(), events: Some("cam0".into()), ..Params::default() });
        assert_eq!(error.param.as_deref(), Some("frames"), "{error:?}");
        let both = |distance_m| Params {
            path: path.clone(),
            events: Some("cam0".into()),
            frames: Some("cam0".into()),
            distance_m,
            ..Params::default()
        };
        assert!(plan(both(None)).message.contains("cam0 has no intrinsics"), "{:?}", plan(both(None)));
        // A homography has a size, and no file.
        let turned = Some([[1.1, 0.0, 2.0], [0.0, 1.2, 3.0], [0.0, 0.0, 2.0]]);
        let error = plan(Params { homography: turned, ..Params::default() });
        assert!(error.message.contains("the size of the event array"), "{error:?}");
        let sized = Params { homography: turned, width: Some(4), height: Some(3), ..Params::default() };
        let error = plan(Params { path: path.clone(), ..sized.clone() });
        assert!(error.message.contains("both state"), "{error:?}");
        let folds = Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0]]);
        assert!(plan(Params { homography: folds, ..sized.clone() }).message.contains("to no place"));
        let stated = ReadAlignment::build(sized).unwrap().stated().unwrap().unwrap();
        assert_eq!((stated.x[5], stated.y[5]), (1.55, 2.1));
        assert_eq!(plan(both(Some(-1.0))).param.as_deref(), Some("distance_m"));
        let error = plan(Params { path: InputPath::new(folder.path()), ..Params::default() });
        assert_eq!(error.param.as_deref(), Some("path"), "{error:?}");
    }
}
