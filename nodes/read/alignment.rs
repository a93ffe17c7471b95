//! `read/alignment`: where the pixels of an event array lie on the frames of another camera.
//!
//! A sequence of HS-ERGB or BS-ERGB has events that were warped onto its pictures: their distinct places
//! give the event array's own grid back. A calibration (kalibr's camchain, DSEC's `cam_to_cam.yaml`) states
//! how both cameras project and how they stand to each other.
//!
//! Limits: of a calibration, places of what is very far, or at one stated distance; of cameras side by side,
//! what is nearer or farther than that is seen elsewhere.

use photocurrent_core::quantity::InputPath;
use photocurrent_core::{Context, Decl, FileRef, Grain, MapSet, Meta, Node, NodeError, PortMetas};
use photocurrent_formats::places::{self, Array};
use photocurrent_scene::alignment::Alignment;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `read/alignment`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// A sequence of HS-ERGB or BS-ERGB (a folder), or a calibration (a YAML file of kalibr or DSEC);
    /// relative to the manifest that names it.
    pub path: InputPath,
    /// Of a calibration: the camera that sees events, such as `"cam0"`.
    pub events: Option<String>,
    /// Of a calibration: the camera of the frames, such as `"cam1"`, or `"camRect1"` for DSEC's rectified
    /// ones.
    pub frames: Option<String>,
    /// Of a calibration: how far away what is seen is, m. Absent = very far.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub distance_m: Option<f64>,
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

impl ReadAlignment {
    fn array(&self) -> Result<Array, NodeError> {
        let Params { events, frames, distance_m, .. } = &self.params;
        let path = self.params.path.path();
        let refused = |error| NodeError::from(error).param("path");
        match (events, frames) {
            (Some(events), Some(frames)) => {
                return places::of_calibration(path, (events, frames), *distance_m).map_err(refused);
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
        super::need_path(&params.path, "sequence")?;
        if params.distance_m.is_some_and(|distance| !(distance > 0.0 && distance.is_finite())) {
            return Err(NodeError::usage("`distance_m` must be more than 0 m").param("distance_m"));
        }
        Ok(ReadAlignment { params })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Map(Arc::new(Alignment::meta(self.array()?.extent)))])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
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
        };
        assert!(plan(both(None)).message.contains("cam0 has no intrinsics"), "{:?}", plan(both(None)));
        assert_eq!(plan(both(Some(-1.0))).param.as_deref(), Some("distance_m"));
        let error = plan(Params { path: InputPath::new(folder.path()), ..Params::default() });
        assert_eq!(error.param.as_deref(), Some("path"), "{error:?}");
    }
}
