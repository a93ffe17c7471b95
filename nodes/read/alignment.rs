//! `read/alignment`: where the pixels of an event array lie on the frames of another camera.
//!
//! A sequence of HS-ERGB or BS-ERGB has events that were warped onto its pictures: their distinct places give
//! the event array's own grid back.
//!
//! Limits: no other source yet; places at infinity, as behind a beam splitter.

use photocurrent_core::quantity::InputPath;
use photocurrent_core::{Context, Decl, FileRef, Grain, MapBand, MapSet, Meta, Node, NodeError, PortMetas};
use photocurrent_formats::places::{self, Array};
use photocurrent_scene::alignment::Alignment;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `read/alignment`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The sequence, a folder of HS-ERGB or BS-ERGB; relative to the manifest that names it.
    pub path: InputPath,
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
        let path = self.params.path.path();
        let array = places::of_sequence(path).map_err(|error| NodeError::from(error).param("path"))?;
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
        sources: &["Tulyakov et al., Time Lens, CVPR 2021: HS-ERGB"],
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
        Ok(ReadAlignment { params })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Map(Arc::new(Alignment::meta(self.array()?.extent)))])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
        let array = self.array()?;
        let meta = Alignment::meta(array.extent);
        let mut band = MapBand::zeros(array.extent.rows(), &meta);
        let width = array.extent.width as usize;
        for (row, places) in (0..).zip(array.places.chunks_exact(width)) {
            band.row_mut(0, row).iter_mut().zip(places).for_each(|(x, place)| *x = place.0 as f32);
            band.row_mut(1, row).iter_mut().zip(places).for_each(|(y, place)| *y = place.1 as f32);
        }
        cx.note(format!(
            "an event array of {}, whose events lie {:.4} pixels off its places",
            array.extent, array.residual
        ));
        Ok(Out { alignment: MapSet::in_memory(Arc::new(meta), band) })
    }

    fn files(&self) -> Vec<FileRef> {
        // What cannot be read is reported by the plan.
        let files = self.array().map(|array| array.files).unwrap_or_default();
        files.into_iter().map(|path| FileRef { param: "path".into(), path }).collect()
    }
}
