//! Toys in time: a film, a node that says how much of it it sees, and one that writes down what it was given.

use super::toys::{Nothing, decl, head, meta};
use photocurrent_core::{
    Context, Decl, Exposure, Extent, FrameBlock, FrameSequence, Grain, MapBand, MapSet, Meta, Node,
    NodeError, PortMetas, testing,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 3, height: 5 };

photocurrent_core::ports! {
    /// Frames.
    pub struct Film {
        /// The frames.
        frames: FrameSequence,
    }
}

photocurrent_core::ports! {
    /// Frames, and a plane of their number.
    pub struct SeenOut {
        /// The frames.
        frames: FrameSequence,
        /// Their number.
        plane: MapSet,
    }
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilmParams {
    /// Number of frames.
    count: usize,
}

impl Default for FilmParams {
    fn default() -> Self {
        FilmParams { count: 12 }
    }
}

/// Frames of 4 ms every 5 ms, ten times their number in every pixel.
pub struct ReadFilm(FilmParams);

impl ReadFilm {
    fn film(&self) -> FrameSequence {
        let exposures = (0..self.0.count as i64)
            .map(|l| Exposure::new(l * 5_000_000, l * 5_000_000 + 4_000_000))
            .collect();
        testing::captured(EXTENT, exposures, 0, |l, _, _| 10.0 * l as f32)
    }
}

impl Node for ReadFilm {
    const DECL: Decl = decl("read/film", Grain::Whole);
    head!(ReadFilm(FilmParams), Nothing => Film);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(self.film().meta)])
    }
    fn run(&self, _: Nothing, _: &Context) -> Result<Film, NodeError> {
        Ok(Film { frames: self.film() })
    }
}

/// Adds the number of frames that it was given to every pixel.
pub struct Seen;

impl Node for Seen {
    const DECL: Decl = decl("solve/seen", Grain::Pixel);
    const LOCAL_IN_TIME: bool = true;
    head!(Seen, Film => SeenOut);
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![
            Meta::Frames(inputs.frames("frames")?.clone()),
            Meta::Map(Arc::new(meta(EXTENT.width, EXTENT.height))),
        ])
    }
    fn run(&self, input: Film, cx: &Context) -> Result<SeenOut, NodeError> {
        let block = input.frames.read_rows(cx.rows())?;
        let count = block.frames.len() as f32;
        let seen = FrameBlock { dn: block.dn.iter().map(|dn| dn + count).collect(), ..block };
        let mut band = MapBand::zeros(cx.rows(), &meta(EXTENT.width, EXTENT.height));
        band.values.fill(count);
        let plane = MapSet::in_memory(Arc::new(meta(EXTENT.width, EXTENT.height)), band);
        Ok(SeenOut { frames: FrameSequence::in_memory(input.frames.meta.clone(), seen), plane })
    }
}

/// Writes one pixel of every frame.
pub struct WriteLast;

impl Node for WriteLast {
    const DECL: Decl = Decl { exports: true, ..decl("write/last", Grain::Whole) };
    head!(WriteLast, Film => Nothing);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(Vec::new())
    }
    fn run(&self, input: Film, cx: &Context) -> Result<Nothing, NodeError> {
        let block = input.frames.read_rows(EXTENT.rows())?;
        let text: String =
            block.frames.clone().map(|l| format!("{}\n", block.row(l, EXTENT.height - 1)[1])).collect();
        std::fs::write(cx.export_dir()?.join("frames.txt"), text)
            .map_err(|error| NodeError::files(error.to_string()))?;
        Ok(Nothing {})
    }
}
