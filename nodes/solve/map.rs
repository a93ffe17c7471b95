//! `solve/map`: the photocurrent of every pixel that explains its events and its frame values, as a MAP
//! estimate.
//!
//! All frames and events of a pixel at once, with knots that are finer than the events, the exact reset and a
//! prior ([`photocurrent_solve::solve_rows`]); events, frames and tracks as in [`photocurrent_solve`].

use super::host::OnMachine;
use super::{In, Out, out};
use crate::backend::{Backend, Machine};
use crate::spans::{check_covered, check_one_clock, check_steps};
use photocurrent_core::node::Working;
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, TimeSpan};
use photocurrent_sensor::map::COARSEST;
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{Model, SolveOptions, halo, map_meta, solve_rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `solve/map`.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// How pixels are solved.
    #[serde(flatten)]
    pub options: SolveOptions,
    /// What solves them: `cpu`, this processor, or `gpu`, a graphics card, for programs built with the
    /// feature `gpu`; without either it is an error. Noise and prior are chosen, effects undone and lost
    /// events found on the processor then too.
    pub backend: Backend,
}

impl From<SolveOptions> for Params {
    fn from(options: SolveOptions) -> Params {
        Params { options, backend: Backend::Cpu }
    }
}

/// The node.
pub struct SolveMap {
    options: SolveOptions,
    machine: Machine,
}

/// Refuses a span in which even quiet pixels would have more knots than can be.
///
/// # Errors
/// When they would.
pub(crate) fn check_length(options: &SolveOptions, span: TimeSpan) -> Result<(), NodeError> {
    check_steps(span, options.knot_spacing.ns().saturating_mul(COARSEST), "knots a pixel", "solve/map")
}

impl Node for SolveMap {
    const DECL: Decl = Decl {
        kind: "solve/map",
        about: "Solves for the photocurrent of every pixel from its events and frame values: the MAP \
                estimate.",
        revision: 22,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &[
            "Jiang et al., CVPR 2024, Eqs. (1)-(12): the sensor",
            "docs/physics.md: the prior and the reset",
        ],
        example: r#"
[nodes.solve]
kind = "solve/map"
in   = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(Params { options, backend }: Params) -> Result<Self, NodeError> {
        options.check()?;
        Ok(SolveMap { options, machine: Machine::new(backend)? })
    }

    fn machine(&self) -> Option<String> {
        self.machine.name().map(String::from)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames, sensor) =
            (inputs.events("events")?, inputs.frames("frames")?, inputs.sensor("sensor")?);
        check_one_clock(events, frames, Some(sensor))?;
        check_covered(Some(events), frames, Some(sensor))?;
        Model::of_map(&self.options, sensor, events)?;
        let tracks = self.options.tracks_meta(events, frames)?;
        check_length(&self.options, tracks.span)?;
        Colours::new(CoLocated::new(events, frames)?, sensor)?;
        let map = map_meta(tracks.extent);
        Ok(vec![Meta::Tracks(Arc::new(tracks)), Meta::Map(Arc::new(map))])
    }

    fn grain(&self, inputs: &PortMetas) -> Grain {
        let halo = || {
            halo(&self.options, inputs.sensor("sensor")?, inputs.events("events")?, inputs.frames("frames")?)
        };
        match halo() {
            Ok(Some(halo)) => Grain::Row { halo },
            Ok(None) => Grain::Whole,
            // The plan refuses it.
            Err(_) => Self::DECL.grain,
        }
    }

    fn working(&self, inputs: &PortMetas) -> Working {
        let tracks = || self.options.tracks_meta(inputs.events("events")?, inputs.frames("frames")?);
        self.machine.working(tracks().ok().as_ref())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        cx.begin(cx.rows().len() as u64, "rows");
        let host = OnMachine::new(cx, &self.machine)?;
        let solution = solve_rows(&input.recording(), &self.options, cx.rows(), &host)?;
        Ok(out(solution, self.options.plausible_range, cx))
    }
}
