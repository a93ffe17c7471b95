//! `solve/paper`: the photocurrent of every pixel by the paper's least squares, Eq. (13), with the
//! approximations that the paper makes.
//!
//! One unknown for each event, held between events; frames two by two
//! ([`photocurrent_solve::solve_paper_rows`]). `frames = "all"` solves one problem over the whole recording
//! instead.
//!
//! Limits: `[effects]` of the description are not undone; steps and stamps are what the paper's readout model
//! makes of them. [`super::map`] has neither limit.

use super::{In, Out, out};
use crate::spans::{check_covered, check_one_clock};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas};
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{Model, PaperOptions, map_meta, solve_paper_rows};
use std::sync::Arc;

/// The node.
pub struct SolvePaper {
    options: PaperOptions,
}

impl Node for SolvePaper {
    const DECL: Decl = Decl {
        kind: "solve/paper",
        about: "Solves for the photocurrent of every pixel from its events and frame values: the paper's \
                least squares.",
        revision: 19,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (1)-(13) and section 4.1"],
        example: r#"
[nodes.solve]
kind   = "solve/paper"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { evs_weight = 1000.0 }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = PaperOptions;
    type In = In;
    type Out = Out;

    fn build(options: PaperOptions) -> Result<Self, NodeError> {
        options.check()?;
        Ok(SolvePaper { options })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames, sensor) =
            (inputs.events("events")?, inputs.frames("frames")?, inputs.sensor("sensor")?);
        check_one_clock(events, frames, Some(sensor))?;
        check_covered(Some(events), frames, Some(sensor))?;
        Model::of_paper(&self.options, sensor, events)?;
        let tracks = self.options.tracks_meta(events, frames)?;
        Colours::new(CoLocated::new(events, frames)?, sensor)?;
        let map = map_meta(tracks.extent);
        Ok(vec![Meta::Tracks(Arc::new(tracks)), Meta::Map(Arc::new(map))])
    }

    fn grain(&self, inputs: &PortMetas) -> Grain {
        // The rows of a block share an event pixel.
        let lie = inputs.events("events").and_then(|events| CoLocated::new(events, inputs.frames("frames")?));
        let halo = lie.map_or(0, |lie| lie.ratio - 1);
        if halo > 0 { Grain::Row { halo } } else { Self::DECL.grain }
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        cx.begin(cx.rows().len() as u64, "rows");
        let solution = solve_paper_rows(&input.recording(), &self.options, cx.rows(), cx)?;
        Ok(out(solution, self.options.plausible_range, cx))
    }
}
