//! `solve/frames`: sharp frames from events and frame values, without tracks in between.
//!
//! `solve/map` and `render/rows` in one node, for pipelines in which nobody else takes the tracks: these are
//! neither stored nor handed on. On this processor frames are those of the two nodes, bit by bit. On a
//! graphics card light stays in the card's memory from the first step to the picture: knots go there, means
//! over the exposures come back. Nothing is thinned then, so frames differ from those of the two nodes by
//! what thinning allows (2e-4 of light, 5 % of a standard deviation).
//!
//! Limits: effects that add to the light, and effects on frames rendered `at` captured ones, are undone on
//! tracks; with them, tracks come back and are rendered as by `render/rows`.

use super::host::OnMachine;
use super::map::SolveMap;
use super::out;
use crate::backend::{Backend, Machine};
use crate::render::rows::{self, RenderRows};
use crate::sampling::Sampling;
use photocurrent_core::node::Working;
use photocurrent_core::{
    Context, Decl, EventStream, Exposure, FrameSequence, Grain, MapSet, Meta, Node, NodeError, PortMetas,
    Sensor,
};
use photocurrent_solve::{Pictures, Recording, SolveOptions, picture_rows, solve_rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `solve/frames`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// How pixels are solved.
    #[serde(flatten)]
    pub options: SolveOptions,
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// What solves and renders: `cpu`, this processor, or `gpu`, a graphics card, for programs built with
    /// the feature `gpu`; without either it is an error. Noise and prior are chosen, effects undone and
    /// lost events found on the processor then too.
    pub backend: Backend,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events; in-pixel times when the description has a readout.
        events: EventStream,
        /// Captured frames, as `solve/map` takes them.
        frames: FrameSequence,
        /// Thresholds, gain, and what the chosen models need.
        sensor: Arc<Sensor>,
        /// Frames whose exposures, row time and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The rendered frames, linear DN.
        frames: FrameSequence,
        /// Standard deviation of every value, DN; absent without `sigma`.
        sigma: Option<FrameSequence>,
        /// How the solution went: as that of `solve/map`.
        map: MapSet,
    }
}

/// The node.
pub struct SolveFrames {
    options: SolveOptions,
    solve: SolveMap,
    render: RenderRows,
    machine: Machine,
}

impl Node for SolveFrames {
    const DECL: Decl = Decl {
        kind: "solve/frames",
        about: "Sharp frames from events and frame values: `solve/map` and `render/rows` in one.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &[
            "Jiang et al., CVPR 2024, Eqs. (1)-(12) and section 4.1",
            "docs/physics.md: the prior and the reset",
        ],
        example: r#"
[nodes.sharp]
kind   = "solve/frames"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { rate = "10 kHz", exposure = "100 us" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(Params { options, sampling, backend }: Params) -> Result<Self, NodeError> {
        Ok(SolveFrames {
            options,
            solve: SolveMap::build(options.into())?,
            render: RenderRows::build(rows::Params { sampling, backend, ..rows::Params::default() })?,
            machine: Machine::new(backend)?,
        })
    }

    fn machine(&self) -> Option<String> {
        self.machine.name().map(String::from)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let [Meta::Tracks(tracks), map] = &self.solve.plan(inputs)?[..] else {
            return Err(NodeError::failed("solve/map gives tracks and a map"));
        };
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        let mut planned = self.render.planned(tracks, inputs.sensor("sensor")?, at.map(|at| &**at))?;
        planned.push(map.clone());
        Ok(planned)
    }

    fn grain(&self, inputs: &PortMetas) -> Grain {
        self.solve.grain(inputs)
    }

    fn working(&self, inputs: &PortMetas) -> Working {
        let tracks = || self.options.tracks_meta(inputs.events("events")?, inputs.frames("frames")?);
        let Ok(tracks) = tracks() else { return Working::default() };
        let working = self.machine.working(Some(&tracks));
        // Tracks, or means before they are pictures.
        Working { banded: Meta::Tracks(Arc::new(tracks)).estimated_bytes(), ..working }
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let In { events, frames, sensor, at } = input;
        cx.begin(cx.rows().len() as u64, "rows");
        let host = OnMachine::new(cx, &self.machine)?;
        let recording = Recording { events: &events, frames: &frames, sensor: &sensor };
        let of = self.options.tracks_meta(&events.meta, &frames.meta)?;
        let meta = self.render.frames(&of, at.as_ref().map(|at| &*at.meta), &sensor)?;
        if !rows::has_readout(&sensor, meta.scale)? {
            let exposures = |row: u32| -> Vec<Exposure> {
                (0..meta.times.len()).map(|frame| meta.times.exposure(frame, row)).collect()
            };
            if let Some(solved) = picture_rows(&recording, &self.options, cx.rows(), &exposures, &host)? {
                let Pictures { rows, map, report, not_modelled } = solved;
                super::note(not_modelled, &report, self.options.plausible_range, cx);
                let with_sigma = of.has_sigma && cx.wants("sigma");
                let rows::Out { frames, sigma } = rows::developed(&rows, &meta, &sensor, with_sigma, cx)?;
                return Ok(Out { frames, sigma, map });
            }
        }
        let solution = solve_rows(&recording, &self.options, cx.rows(), &host)?;
        let super::Out { tracks, map } = out(solution, self.options.plausible_range, cx);
        let rows::Out { frames, sigma } = self.render.run(rows::In { tracks, sensor, at }, cx)?;
        Ok(Out { frames, sigma, map })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::map;
    use photocurrent_core::document::Source;
    use photocurrent_core::quantity::Rate;
    use photocurrent_core::{Extent, Rows, testing};

    const EXTENT: Extent = Extent { width: 11, height: 6 };
    const ROWS: Rows = Rows { start: 1, end: 6 };

    fn sensor() -> Arc<Sensor> {
        let text = "format = \"photocurrent-sensor/1\"\n[front_end]\ntau_0 = \"20 us\"\nalpha = \"1 ms\"\n\
                    [comparator]\nthreshold_on = 0.2\nthreshold_off = 0.2\n\
                    [readout]\nrefractory = \"10 us\"\n[frames]\ngain = 1000.0\n";
        Arc::new(Sensor::parse(&Source::new("s.toml", "", text)).unwrap())
    }

    /// Values of frames, of their standard deviations and of the map.
    type Values = [Vec<f32>; 3];

    fn values(frames: &FrameSequence, sigma: &FrameSequence, map: &MapSet) -> Values {
        let of = |frames: &FrameSequence| frames.read_rows(ROWS).unwrap().dn;
        [of(frames), of(sigma), map.read(ROWS).unwrap().values]
    }

    fn sampling() -> Sampling {
        Sampling { rate: Rate::new(2_000.0), ..Sampling::default() }
    }

    fn in_one(backend: Backend) -> (Values, Vec<String>) {
        let node = SolveFrames::build(Params { sampling: sampling(), backend, ..Params::default() }).unwrap();
        let (events, frames) = (testing::events(EXTENT.width, 6), testing::frames(EXTENT.width, 6, 9));
        let input = In { events, frames, sensor: sensor(), at: None };
        let wanted = ["frames", "sigma", "map"];
        let (out, notes) = testing::with_context(ROWS, &wanted, |cx| node.run(input, cx));
        let Out { frames, sigma, map } = out.unwrap();
        (values(&frames, &sigma.unwrap(), &map), notes)
    }

    fn in_two(backend: Backend) -> Values {
        let solve = SolveMap::build(map::Params { backend, ..map::Params::default() }).unwrap();
        let (events, frames) = (testing::events(EXTENT.width, 6), testing::frames(EXTENT.width, 6, 9));
        let input = crate::solve::In { events, frames, sensor: sensor() };
        let (out, _) = testing::with_context(ROWS, &["tracks", "map"], |cx| solve.run(input, cx));
        let crate::solve::Out { tracks, map } = out.unwrap();
        let params = rows::Params { sampling: sampling(), backend, ..rows::Params::default() };
        let render = RenderRows::build(params).unwrap();
        let input = rows::In { tracks, sensor: sensor(), at: None };
        let (out, _) = testing::with_context(ROWS, &["frames", "sigma"], |cx| render.run(input, cx));
        let rows::Out { frames, sigma } = out.unwrap();
        values(&frames, &sigma.unwrap(), &map)
    }

    #[test]
    fn frames_are_those_of_the_two_nodes() {
        let bits = |values: &Values| values.concat().iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
        assert_eq!(bits(&in_one(Backend::Cpu).0), bits(&in_two(Backend::Cpu)));
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn on_a_card_they_differ_by_what_thinning_allows() {
        if !crate::backend::testing::has_card() {
            return;
        }
        let (([light, sigma, map], notes), [of_tracks, sigma_of_tracks, map_of_tracks]) =
            (in_one(Backend::Gpu), in_two(Backend::Gpu));
        let apart = |a: &[f32], b: &[f32]| {
            assert_eq!(a.len(), b.len());
            a.iter().zip(b).map(|(a, b)| ((a - b) / b).abs()).fold(0.0, f32::max)
        };
        assert!(light.iter().any(|dn| *dn > 100.0));
        let (of_light, of_sigma) = (apart(&light, &of_tracks), apart(&sigma, &sigma_of_tracks));
        assert!(of_light < 4e-4 && of_sigma < 0.08, "{of_light}, {of_sigma}");
        let bits = |map: &[f32]| map.iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
        assert_eq!(bits(&map), bits(&map_of_tracks));
        assert!(notes.iter().any(|note| note.starts_with("solved on ")), "{notes:?}");
    }
}
