//! `solve/pixel`: the photocurrent of every pixel that explains its events and its frame values.
//!
//! Idea: a pixel's frames say how much light it collected, its events when the light changed, both through the sensor's own
//! delays. Inverting the sensor pixel by pixel undoes blur, rolling shutter and event latency at once. Each pixel is one small least-squares
//! problem; this node cuts a recording into such problems and puts the answers together.
//!
//! `method = "map"` is the MAP estimate of the photocurrent ([`photocurrent_sensor::map`]): all frames and events of the pixel at once, with knots that are finer
//! than the events, the exact reset and a prior. Gaps in which events were evidently lost are not used as constraints ([`photocurrent_sensor::map::losses`]).
//! Nothing is cut into windows there, and its tracks are log-linear between knots. What the description's `[effects]` did to events and frames is undone by the effects' own equations
//! ([`photocurrent_sensor::undo`]); a note names those that cannot be. Those that mix the photocurrent of neighbours take rounds over whole rows ([`neighbours`]), and those that depend on
//! the load of the array the events of all its pixels, so that the recording is then solved in one piece.
//!
//! `method = "paper"` is Eq. (13), solved in [`photocurrent_sensor::inverse`], with the approximations that the paper makes. Frames are taken two by two, as in the paper: the pair (l, l+1) is solved with all events from the start of exposure l to
//! the end of exposure l+1, and its answer counts until exposure l+1 starts. The first window reaches back to the recording's start, the
//! last one on to its end. `frames = "all"` solves one problem over the whole recording instead.
//!
//! Frames may have colours, a mosaic of filters, or several pixels on each event pixel: every value of a frame is then a problem of its own with the events of
//! the event pixel that it lies on, posed in that pixel's light ([`shares`]).
//!
//! Limits: colours that change are followed from problem to problem ([`photocurrent_sensor::pooling`] says where that fails). A saturated value counts as the light of saturation, which is a lower bound. A pixel whose
//! problem does not converge falls back to the double-integral estimate and is counted; the `map` output shows where. Light that no frame of its pixel
//! comes near is held, counted and shown there too ([`plausible`]).

pub(crate) mod choice;
#[cfg(test)]
mod colour_tests;
#[cfg(test)]
mod coupled_tests;
pub(crate) mod map;
pub(crate) mod neighbours;
mod paper;
mod params;
mod plausible;
pub(crate) mod row;
pub(crate) mod shares;
#[cfg(test)]
mod stamps_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod undo_tests;

use crate::co_located::{CoLocated, CoLocatedEvents, values_of};
use crate::compensate::readout::check_events;
use crate::pixel_events::{Stamp, StepRule, clock_offset, left_out};
use crate::spans::{check_covered, check_one_clock, check_steps};
use choice::Settings;
use map::FrameNoise;
pub use params::{Decisions, FirstKnot, FrontEndModel, Joint, Method, Params, Precision, ReadoutModel, TauChoice};
pub(crate) use params::{FRAME_NOISE, KNOT_SPACING};
use photocurrent_core::events::EventRow;
use photocurrent_core::handle::Band;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{
    Between, Colour, Context, Decl, EventStream, EventsMeta, Exposure, FrameBlock, FrameScale, FrameSequence, FramesMeta, Grain, MapBand, MapMeta, MapSet,
    Meta, Node, NodeError, PortMetas, Rows, Sensor, TimeSpan, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_sensor::effects::{Site, from_description};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::map::{COARSEST, MapEvent};
use photocurrent_sensor::model::Model as SensorModel;
use photocurrent_sensor::residuals::Misfit;
use photocurrent_sensor::undo::Undo;
use rayon::prelude::*;
use row::Recorded;
use shares::Colours;
use std::sync::Arc;

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events; in-pixel times when `readout = "slope"`.
        events: EventStream,
        /// Captured frames of the same pixels, or of a whole number of pixels along the side of each event pixel; grey, colour or a mosaic. At least one.
        frames: FrameSequence,
        /// Thresholds, gain, and what the chosen models need.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every value of the frames over time.
        tracks: TrackSet,
        /// How the solution went: planes `status` (0 converged, 1 double-integral estimate, 2 saturated, 3 no usable frame), `iterations` (largest), `cost` (sum), `event_residual` and `frame_residual` (root mean squares in standard deviations, NaN for none), `implausible` (0, or natural logarithm of the brightest light over that of the brightest frame where it was held: see `plausible_range`).
        map: MapSet,
    }
}

/// The node.
pub struct SolvePixel {
    params: Params,
}

/// How a pixel came out, worst window counting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Status {
    Converged = 0,
    FellBack = 1,
    Saturated = 2,
    NoFrame = 3,
}

/// More steps than this do not improve a pixel of `method = "map"`.
const MAP_STEPS: usize = 5;

const PLANES: [&str; 6] = ["status", "iterations", "cost", "event_residual", "frame_residual", "implausible"];

/// Where `implausible` stands among them.
const IMPLAUSIBLE: usize = 5;

/// What stands in [`PLANES`] for a pixel.
///
/// Residuals are measured less predicted, over the standard deviations of `method = "map"` or times the roots of the weights of `method = "paper"`: of all
/// windows, frames in two of them counting twice. Events in blind times and saturated values that are met carry no information for `map` and are left out; a safe
/// estimate of `paper` meets its events. `excess` is [`plausible::Plausible::excess`].
fn planes(status: Status, iterations: usize, cost: f64, misfit: &Misfit, excess: f64) -> [f32; PLANES.len()] {
    [status as u8 as f32, iterations as f32, cost as f32, misfit.event_rms() as f32, misfit.frame_rms() as f32, excess as f32]
}

/// Everything about the sensor that one pixel's problem needs, checked once.
pub(crate) struct Model {
    rule: StepRule,
    /// The description in numbers; its front end and refractory period as the parameters have them.
    sensor: SensorModel,
    refractory_s: f64,
    clock_offset_ns: i64,
    /// The description's `[effects]`, to be undone; none for `method = "paper"`.
    undo: Undo,
    /// How often light is solved again with what they say.
    undo_rounds: u32,
    /// Standard deviation of an event's stamp, from the width of its interval.
    stamp_sigma_s: f64,
    frame_noise: FrameNoise,
    plausible_range: f64,
}

impl Model {
    /// The sensor, with the front end that is chosen.
    pub(crate) fn sensor(&self) -> SensorModel {
        self.sensor.clone()
    }

    /// What effects add to the photocurrent of the event path: problems are posed in the sum ([`Undo::added`]).
    pub(crate) fn added(&self) -> f64 {
        self.undo.added()
    }

    /// The smaller threshold, natural-log units.
    pub(crate) fn threshold(&self) -> f64 {
        f64::min(self.rule.threshold_on, self.rule.threshold_off)
    }

    /// Takes other thresholds than the description's, natural-log units.
    pub(crate) fn set_thresholds(&mut self, (on, off): (f64, f64)) {
        (self.rule.threshold_on, self.rule.threshold_off) = (on, off);
        (self.sensor.pixel.threshold_on, self.sensor.pixel.threshold_off) = (on, off);
    }

    /// Does the event path of a pixel see photocurrent of its neighbours?
    pub(crate) fn is_mixed(&self) -> bool {
        self.undo.mixing().is_some()
    }

    /// Event `k` of a row as recorded, on the clock of the frames.
    fn event(&self, row: &EventRow<'_>, k: usize) -> MapEvent {
        let t_in_ns = self.rule.time(row, k);
        let t_off_ns = i64::max(row.t[k] - self.clock_offset_ns, t_in_ns);
        MapEvent { t_in_ns, t_off_ns, polarity: if row.on[k] == 1 { 1 } else { -1 }, is_lone: false }
    }

    /// Gives effects that depend on the load of the array the events of all its pixels.
    ///
    /// # Errors
    /// When there are such effects and only some rows are at hand: the description was not known when the recording was cut into bands.
    pub(crate) fn inform(&mut self, events: &EventStream) -> Result<(), NodeError> {
        let Some(id) = self.undo.couples() else { return Ok(()) };
        let extent = events.meta.extent;
        if events.rows() != extent.rows() {
            return Err(late_description(&format!("`effects.{id}` couples all pixels")));
        }
        let band = events.read(extent.rows())?;
        let mut undo = std::mem::replace(&mut self.undo, Undo::new(Vec::new()));
        let model: &Model = self;
        let of_row = |y: u32| {
            let row = band.row(y);
            (0..row.len()).map(move |k| (Site { x: row.x[k].into(), y, width: extent.width, height: extent.height, seed: 0 }, model.event(&row, k)))
        };
        undo.inform(extent.rows().iter().flat_map(of_row));
        self.undo = undo;
        Ok(())
    }
}

impl SolvePixel {
    pub(crate) fn params(&self) -> &Params {
        &self.params
    }

    pub(crate) fn model(&self, sensor: &Sensor, events: &EventsMeta) -> Result<Model, NodeError> {
        const WHO: &str = "solve/pixel";
        // A model that the description cannot feed can be left away, so its refusal says how.
        let or_without = |error: NodeError, param: &str, without: &str| {
            let added = error.hint.clone().unwrap_or_default();
            error.hint(format!("{added}, or set `{param} = \"{without}\"`")).param(param)
        };
        let front_end = match self.params.front_end {
            FrontEndModel::Ideal => FrontEnd::IDEAL,
            FrontEndModel::LowPass => {
                const LOW_PASS: &str = "`front_end = \"low_pass\"`";
                let (tau_0, alpha) = (sensor.front_end.tau_0, sensor.front_end.alpha);
                let fields = [("front_end.tau_0", tau_0.is_some()), ("front_end.alpha", alpha.is_some())];
                sensor.need_all(&fields, LOW_PASS).map_err(|error| or_without(error, "front_end", "ideal"))?;
                FrontEnd {
                    tau_0_s: sensor.need(tau_0, "front_end.tau_0", LOW_PASS)?.seconds(),
                    alpha_s: sensor.need(alpha, "front_end.alpha", LOW_PASS)?.seconds(),
                }
            }
        };
        let refractory_s = match (self.params.method, self.params.readout()) {
            (Method::Map, _) => {
                const MAP: &str = "`method = \"map\"`";
                if events.has_step {
                    return Err(NodeError::usage("the events carry compensated steps, and `method = \"map\"` undoes the readout itself")
                        .hint("connect the events as recorded, or set `method = \"paper\"`")
                        .param("method"));
                }
                sensor.need(sensor.readout.refractory, "readout.refractory", MAP).map_err(|error| or_without(error, "method", "paper"))?.seconds()
            }
            (Method::Paper, ReadoutModel::None) => 0.0,
            (Method::Paper, ReadoutModel::Slope) => {
                const SLOPE: &str = "`readout = \"slope\"`";
                check_events(events, SLOPE, "set `readout = \"none\"`").map_err(|error| error.param("readout"))?;
                sensor.need(sensor.readout.refractory, "readout.refractory", SLOPE).map_err(|error| or_without(error, "readout", "none"))?.seconds()
            }
        };
        sensor.need_all(&[StepRule::needs(sensor).as_slice(), &[("frames.gain", sensor.frames.gain.is_some())]].concat(), WHO)?;
        let mut stated = SensorModel::of(sensor);
        stated.pixel.front_end = front_end;
        stated.pixel.refractory_ns = (refractory_s * 1e9).round() as i64;
        let is_undone = self.params.method == Method::Map && self.params.undo_rounds != Some(0);
        let undo = if is_undone { undo(sensor)? } else { Undo::new(Vec::new()) };
        let undo_rounds = self.params.undo_rounds(undo.mixing().is_some());
        let frame_share = libm::hypot(self.params.frame_noise.unwrap_or(FRAME_NOISE), undo.chance.of_frames);
        Ok(Model {
            rule: StepRule::from_sensor(sensor, events, Stamp::Best, WHO)?,
            refractory_s,
            clock_offset_ns: clock_offset(sensor)?.offset_ns,
            undo,
            undo_rounds,
            stamp_sigma_s: events.t_resolution_ns.unwrap_or(0) as f64 * 1e-9 / libm::sqrt(12.0),
            frame_noise: FrameNoise::new(&stated, frame_share),
            sensor: stated,
            plausible_range: self.params.plausible_range,
        })
    }

    /// What is stated and not used here, as a sentence.
    fn not_modelled(&self, sensor: &Sensor, model: &Model) -> Option<String> {
        let mut used = sensor.clone();
        if self.params.method == Method::Map {
            // The reset rule is modelled there, and effects are undone.
            used.comparator.reset = Reset::Resample;
            used.effects.retain(|id, _| model.undo_rounds == 0 || model.undo.left_out.contains(&id.as_str()));
        }
        left_out(&used)
    }

    /// Refuses a span in which even quiet pixels would have more knots than can be.
    pub(crate) fn check_length(&self, span: TimeSpan) -> Result<(), NodeError> {
        match self.params.method {
            Method::Map => check_steps(span, self.params.knot_spacing().ns().saturating_mul(COARSEST), "knots a pixel", "solve/pixel"),
            Method::Paper => Ok(()),
        }
    }

    pub(crate) fn tracks_meta(&self, events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
        let lie = CoLocated::new(events, frames)?;
        if frames.scale != FrameScale::Captured {
            return Err(
                NodeError::usage("frames are rendered, not captured: their values do not belong to their exposures").hint("connect the recording's frames")
            );
        }
        let (Some(covered), Some(nominal_exposure_ns)) = (frames.times.span(frames.extent.height), frames.times.nominal_exposure_ns()) else {
            return Err(NodeError::usage("there is no frame, and events alone leave the photocurrent's level open").hint("give at least one frame"));
        };
        Ok(TracksMeta {
            extent: frames.extent,
            colour: frames.colour,
            has_sigma: self.params.method == Method::Map && self.params.sigma(),
            span: events.span.map_or(covered, |span| span.union(covered)),
            nominal_exposure_ns,
            between: match self.params.method {
                Method::Paper => Between::Hold,
                Method::Map => Between::LogLinear,
            },
            count_hint: events.count_hint.map(|n| {
                let (copies, values) = (u64::from(lie.ratio * lie.ratio * lie.colour.channels()), values_of(frames.extent, frames.colour).pixels());
                match self.params.method {
                    Method::Paper => 2 * copies * n + (frames.times.len() * values) as u64,
                    Method::Map => 4 * copies * n + 8 * (frames.times.len() * values) as u64,
                }
            }),
        })
    }
}

impl Node for SolvePixel {
    const DECL: Decl = Decl {
        kind: "solve/pixel",
        about: "Solves for the photocurrent of every pixel from its events and frame values.",
        revision: 19,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (1)-(13) and section 4.1"],
        example: r#"
[nodes.solve]
kind   = "solve/pixel"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { method = "map" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        params.check()?;
        Ok(SolvePixel { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        let sensor = inputs.sensor("sensor")?;
        check_one_clock(events, frames, Some(sensor))?;
        check_covered(Some(events), frames, Some(sensor))?;
        self.model(sensor, events)?;
        let tracks = self.tracks_meta(events, frames)?;
        self.check_length(tracks.span)?;
        Colours::new(CoLocated::new(events, frames)?, sensor)?;
        let map = map_meta(tracks.extent);
        Ok(vec![Meta::Tracks(Arc::new(tracks)), Meta::Map(Arc::new(map))])
    }

    fn grain(&self, inputs: &PortMetas) -> Grain {
        // The rows of a block share an event pixel; the MAP estimate looks at whole blocks of rows.
        let lie = inputs.events("events").and_then(|events| CoLocated::new(events, inputs.frames("frames")?));
        let mut blocks = if self.params.method == Method::Map { choice::HALO_ROWS } else { 0 };
        if let (Ok(lie), Ok(model)) = (&lie, inputs.events("events").and_then(|events| self.model(inputs.sensor("sensor")?, events))) {
            if model.undo.couples().is_some() {
                return Grain::Whole;
            }
            blocks = neighbours::halo(&model, *lie).unwrap_or(blocks);
        }
        let halo = blocks.saturating_add(lie.map_or(0, |lie| lie.ratio - 1));
        if halo > 0 { Grain::Row { halo } } else { Self::DECL.grain }
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = self.tracks_meta(&input.events.meta, &input.frames.meta)?;
        let mut model = self.model(&input.sensor, &input.events.meta)?;
        model.inform(&input.events)?;
        if let Some(note) = self.not_modelled(&input.sensor, &model) {
            cx.note(note);
        }
        let rows = cx.rows();
        let colours = Colours::new(CoLocated::new(&input.events.meta, &input.frames.meta)?, &input.sensor)?;
        let (times, all) = (&input.frames.meta.times, meta.extent.rows());
        // To the solvers, every value of a row is a pixel.
        let wide = TracksMeta { extent: values_of(meta.extent, meta.colour), colour: Colour::Mono, ..meta.clone() };
        let take_in = |rows: Rows| -> Result<(Rows, CoLocatedEvents, FrameBlock), NodeError> {
            Ok((rows, colours.lie.read(&input.events, rows)?, input.frames.read_rows(rows.with_halo(colours.halo(), all))?))
        };
        let coupled = neighbours::halo(&model, colours.lie);
        if self.params.method == Method::Map && coupled.is_none() && rows.len() < choice::BLOCK_ROWS as usize && Settings::chosen(rows, cx).is_none() {
            // Bands are this low where memory is short, so not even the rows of a block are held at once.
            let mut held: Option<(Rows, CoLocatedEvents, FrameBlock)> = None;
            Settings::choose_row_by_row(&self.params, &model, &wide, rows, cx, |data, row| {
                let company = Rows { start: row, end: row + 1 }.with_halo(choice::COMPANY_ROWS, all);
                let (rows, events, frames) = match &mut held {
                    Some(held) if held.0.contains(company) => held,
                    held => held.insert(take_in(Rows { start: row, end: row + HELD_ROWS }.with_halo(choice::COMPANY_ROWS, all))?),
                };
                data.take(&model, &Recorded { meta: &wide, times, colours: &colours, rows: *rows, events, frames }, row, 0.0)
            })?;
        }
        let at_hand = match self.params.method {
            Method::Paper => rows,
            Method::Map => {
                // Once settings are chosen, only the company of events is around.
                let around = if Settings::chosen(rows, cx).is_some() { choice::COMPANY_ROWS } else { choice::HALO_ROWS };
                rows.with_halo(coupled.unwrap_or(around), all)
            }
        };
        if !input.events.rows().contains(colours.lie.event_rows(at_hand)) {
            return Err(late_description("the description mixes the light of neighbouring pixels"));
        }
        let (at_hand, events, frames) = take_in(at_hand)?;
        let recorded = Recorded { meta: &wide, times, colours: &colours, rows: at_hand, events: &events, frames: &frames };
        let known = neighbours::known(&self.params, &model, &recorded, rows, cx)?;
        let settings = match self.params.method {
            Method::Paper => None,
            Method::Map => Some(Settings::choose_once(&self.params, &model, &recorded, rows, known.as_ref(), cx)?),
        };
        cx.begin(rows.len() as u64, "rows");
        let shared_out = rows.len() < choice::BLOCK_ROWS as usize;
        let solve_row = |(workspace, finer): &mut (paper::RowSolver, map::RowSolver), row: u32| -> Result<(TrackBand, MapBand), NodeError> {
            let (tracks, map) = match &settings {
                None => {
                    let exposures: Vec<Exposure> = (0..times.len()).map(|l| times.exposure(l, row)).collect();
                    let shares = colours.row(&model, &frames, row);
                    events.with_row(row, |events| workspace.row(&self.params, &model, &wide, row, events, &frames, &exposures, &shares))??
                }
                Some(settings) => finer.row(&model, settings.of(row), &recorded, row, known.as_ref(), shared_out)?,
            };
            cx.advance(1)?;
            Ok((tracks, of_pixels(map, &meta)))
        };
        // Of a low band, the pixels of each row are shared out over the threads, one row after the other.
        let solved: Result<Vec<_>, NodeError> = if shared_out && settings.is_some() {
            let mut memory = Default::default();
            rows.iter().map(|row| solve_row(&mut memory, row)).collect()
        } else {
            rows.iter().into_par_iter().map_init(Default::default, solve_row).collect()
        };
        let (tracks, maps): (Vec<TrackBand>, Vec<MapBand>) = solved?.into_iter().unzip();
        let map = MapBand::concat(maps);
        report(&map, self.params.plausible_range, cx);
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(meta.clone()), TrackBand::concat(tracks)), map: MapSet::in_memory(Arc::new(map_meta(meta.extent)), map) })
    }
}

/// Rows that are held at a time where a block is looked at in parts.
const HELD_ROWS: u32 = 4;

/// A description that a node worked out is planned as the one that it was given: what reaches over rows may be in it only now.
fn late_description(what: &str) -> NodeError {
    NodeError::failed(format!("{what}, and that was not known when the recording was cut into row bands"))
        .hint("write the description to a file and read it with read/sensor, or set `undo_rounds = 0`")
}

/// The effects of a description, to be undone; its clock offset is subtracted with the stamps ([`StepRule`]).
fn undo(sensor: &Sensor) -> Result<Undo, NodeError> {
    let mut effects = from_description(&sensor.effects).map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
    effects.retain(|effect| effect.id() != "clock_offset");
    Ok(Undo::new(effects))
}

fn map_meta(extent: photocurrent_core::Extent) -> MapMeta {
    MapMeta { extent, planes: PLANES.map(String::from).to_vec() }
}

/// Over the values of each pixel: the worst, the largest, the sum, and root mean squares of residuals.
fn of_pixels(values: MapBand, meta: &TracksMeta) -> MapBand {
    let channels = meta.colour.channels() as usize;
    if channels == 1 {
        return values;
    }
    let mut map = MapBand::zeros(values.rows(), &map_meta(meta.extent));
    for row in values.rows().iter() {
        for (plane, name) in PLANES.iter().enumerate() {
            for (out, of_pixel) in map.row_mut(plane, row).iter_mut().zip(values.row(plane, row).chunks_exact(channels)) {
                *out = match *name {
                    "cost" => of_pixel.iter().sum(),
                    "event_residual" | "frame_residual" => {
                        let known = || of_pixel.iter().filter(|rms| !rms.is_nan());
                        (known().map(|rms| rms * rms).sum::<f32>() / known().count() as f32).sqrt()
                    }
                    _ => of_pixel.iter().copied().fold(0.0, f32::max),
                };
            }
        }
    }
    map
}

fn report(map: &MapBand, plausible_range: f64, cx: &Context) {
    let pixels = |status: Status| map.rows().iter().flat_map(|row| map.row(0, row)).filter(|value| **value == status as u8 as f32).count() as u64;
    cx.count(pixels(Status::FellBack), "pixels did not converge in some window and fell back to the double-integral estimate there");
    cx.count(pixels(Status::Saturated), "pixels were saturated in every frame of some window: their light is a lower bound there");
    cx.count(pixels(Status::NoFrame), "pixels had no usable frame value in some window (NaN): they hold their last known light there");
    cx.count(implausible(map), &plausible::note(plausible_range));
}

/// Number of pixels whose light was held somewhere.
fn implausible(map: &MapBand) -> u64 {
    map.rows().iter().flat_map(|row| map.row(IMPLAUSIBLE, row)).filter(|excess| **excess > 0.0).count() as u64
}
