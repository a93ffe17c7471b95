//! The sensor as a pixel's problem needs it: thresholds, stamps, front end and noise in numbers, and the
//! effects that are undone.

use crate::co_located::{CoLocated, values_of};
use crate::options::{FrontEndModel, LEAST_FRAME_SIGMA_DN, PaperOptions, ReadoutModel, SolveOptions};
use crate::pixel_events::{Stamp, StepRule, check_events, clock_offset, left_out};
use photocurrent_core::events::EventRow;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{
    Between, EventStream, EventsMeta, FrameScale, FramesMeta, NodeError, Sensor, TracksMeta,
};
use photocurrent_sensor::effects::{Site, from_description};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::map::PixelEvent;
use photocurrent_sensor::model::Model as SensorModel;
use photocurrent_sensor::undo::Undo;

/// Everything about the sensor that one pixel's problem needs, checked once.
pub struct Model {
    pub(crate) rule: StepRule,
    /// The description in numbers; its front end and refractory period as the parameters have them.
    pub(crate) sensor: SensorModel,
    pub(crate) refractory_s: f64,
    clock_offset_ns: i64,
    /// The description's `[effects]`, to be undone; none for Eq. (13).
    pub(crate) undo: Undo,
    /// How often light is solved again with the effects at the light found before.
    pub(crate) undo_rounds: u32,
    /// Standard deviation of an event's stamp, from the width of its interval.
    pub(crate) stamp_sigma_s: f64,
    /// Standard deviation of frame values that the description does not state, as a share of the signal.
    pub(crate) frame_share: f64,
    pub(crate) plausible_range: f64,
}

impl Model {
    /// The sensor, with the front end that is chosen.
    pub fn sensor(&self) -> SensorModel {
        self.sensor.clone()
    }

    /// Standard deviation of a frame value, `signal` DN above black, when `more_dn` is not stated.
    pub(crate) fn frame_sigma_dn(&self, signal: f64, more_dn: f64) -> f64 {
        self.sensor.frame_sigma_of_dn(signal, [LEAST_FRAME_SIGMA_DN, more_dn], self.frame_share)
    }

    /// What effects add to the photocurrent of the event path: problems are posed in the sum
    /// ([`Undo::added`]).
    pub fn added(&self) -> f64 {
        self.undo.added()
    }

    /// The smaller threshold, natural-log units.
    pub fn threshold(&self) -> f64 {
        f64::min(self.rule.threshold_on, self.rule.threshold_off)
    }

    /// Takes other thresholds than the description's, natural-log units.
    pub fn set_thresholds(&mut self, (on, off): (f64, f64)) {
        (self.rule.threshold_on, self.rule.threshold_off) = (on, off);
        (self.sensor.pixel.threshold_on, self.sensor.pixel.threshold_off) = (on, off);
    }

    /// Does the event path of a pixel see photocurrent of its neighbours?
    pub fn is_mixed(&self) -> bool {
        self.undo.mixing().is_some()
    }

    /// Event `k` of a row as recorded, on the clock of the frames.
    pub(crate) fn event(&self, row: &EventRow<'_>, k: usize) -> PixelEvent {
        let t_in_ns = self.rule.time(row, k);
        let t_off_ns = i64::max(row.t[k] - self.clock_offset_ns, t_in_ns);
        PixelEvent { t_in_ns, t_off_ns, polarity: if row.on[k] == 1 { 1 } else { -1 } }
    }

    /// Does some effect depend on the events of all pixels?
    pub fn couples(&self) -> bool {
        self.undo.couples().is_some()
    }

    /// Event `k` of a row as recorded, on the clock of the frames; and without what effects did to its
    /// stamps.
    pub fn event_undone(&self, site: &Site, row: &EventRow<'_>, k: usize) -> (PixelEvent, PixelEvent) {
        let event = self.event(row, k);
        (event, self.undo.event(site, &event))
    }

    /// Gives effects that depend on the load of the array the events of all its pixels.
    ///
    /// # Errors
    /// When there are such effects and only some rows are at hand: the description was not known when the
    /// recording was cut into bands.
    pub fn inform(&mut self, events: &EventStream) -> Result<(), NodeError> {
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
            (0..row.len()).map(move |k| {
                (
                    Site { x: row.x[k].into(), y, width: extent.width, height: extent.height, seed: 0 },
                    model.event(&row, k),
                )
            })
        };
        undo.inform(extent.rows().iter().flat_map(of_row));
        self.undo = undo;
        Ok(())
    }
}

/// The front end that is chosen.
pub(crate) fn front_end(chosen: FrontEndModel, sensor: &Sensor) -> Result<FrontEnd, NodeError> {
    const LOW_PASS: &str = "`front_end = \"low_pass\"`";
    match chosen {
        FrontEndModel::Ideal => Ok(FrontEnd::IDEAL),
        FrontEndModel::LowPass => {
            let (tau_0, alpha) = (sensor.front_end.tau_0, sensor.front_end.alpha);
            let fields = [("front_end.tau_0", tau_0.is_some()), ("front_end.alpha", alpha.is_some())];
            sensor.need_all(&fields, LOW_PASS).map_err(|error| or_without(error, "front_end", "ideal"))?;
            Ok(FrontEnd {
                tau_0_s: sensor.need(tau_0, "front_end.tau_0", LOW_PASS)?.seconds(),
                alpha_s: sensor.need(alpha, "front_end.alpha", LOW_PASS)?.seconds(),
            })
        }
    }
}

/// A model that the description cannot feed can be left away, so its refusal states how.
fn or_without(error: NodeError, param: &str, without: &str) -> NodeError {
    let added = error.hint.clone().unwrap_or_default();
    error.hint(format!("{added}, or set `{param} = \"{without}\"`")).param(param)
}

impl Model {
    /// For the MAP estimate of a recording.
    ///
    /// # Errors
    /// When the description lacks what is needed or an effect is not understood, or the events carry
    /// compensated steps.
    pub fn of_map(options: &SolveOptions, sensor: &Sensor, events: &EventsMeta) -> Result<Model, NodeError> {
        const WHO: &str = "solve/map";
        let front_end = front_end(options.front_end, sensor)?;
        if events.has_step {
            return Err(NodeError::usage(
                "the events carry compensated steps, and solve/map undoes the readout itself",
            )
            .hint("connect the events as recorded, or set `kind = \"solve/paper\"`"));
        }
        let refractory =
            sensor.need(sensor.readout.refractory, "readout.refractory", WHO).map_err(|error| {
                let added = error.hint.clone().unwrap_or_default();
                error.hint(format!("{added}, or set `kind = \"solve/paper\"` with `readout = \"none\"`"))
            })?;
        let undo = if options.undo_rounds == Some(0) { Undo::new(Vec::new()) } else { undo(sensor)? };
        let undo_rounds = options.undo_rounds(undo.mixing().is_some());
        let frame_share = libm::hypot(options.frame_noise, undo.chance.of_frames);
        Model::of(
            WHO,
            sensor,
            events,
            front_end,
            refractory.seconds(),
            (undo, undo_rounds),
            frame_share,
            options.plausible_range,
        )
    }

    /// For Eq. (13).
    ///
    /// # Errors
    /// When the description lacks what is needed, or the events cannot be compensated.
    pub fn of_paper(
        options: &PaperOptions,
        sensor: &Sensor,
        events: &EventsMeta,
    ) -> Result<Model, NodeError> {
        let front_end = front_end(options.front_end, sensor)?;
        let refractory_s = match options.readout {
            ReadoutModel::None => 0.0,
            ReadoutModel::Slope => {
                const SLOPE: &str = "`readout = \"slope\"`";
                check_events(events, SLOPE, "set `readout = \"none\"`")
                    .map_err(|error| error.param("readout"))?;
                sensor
                    .need(sensor.readout.refractory, "readout.refractory", SLOPE)
                    .map_err(|error| or_without(error, "readout", "none"))?
                    .seconds()
            }
        };
        let nothing = (Undo::new(Vec::new()), 0);
        Model::of(
            "solve/paper",
            sensor,
            events,
            front_end,
            refractory_s,
            nothing,
            crate::options::FRAME_NOISE,
            options.plausible_range,
        )
    }

    fn of(
        who: &str,
        sensor: &Sensor,
        events: &EventsMeta,
        front_end: FrontEnd,
        refractory_s: f64,
        (undo, undo_rounds): (Undo, u32),
        frame_share: f64,
        plausible_range: f64,
    ) -> Result<Model, NodeError> {
        sensor.need_all(
            &[StepRule::needs(sensor).as_slice(), &[("frames.gain", sensor.frames.gain.is_some())]].concat(),
            who,
        )?;
        let mut stated = SensorModel::of(sensor);
        stated.pixel.front_end = front_end;
        stated.pixel.refractory_ns = (refractory_s * 1e9).round() as i64;
        Ok(Model {
            rule: StepRule::from_sensor(sensor, events, Stamp::Best, who)?,
            refractory_s,
            clock_offset_ns: clock_offset(sensor)?.offset_ns,
            undo,
            undo_rounds,
            stamp_sigma_s: events.t_resolution_ns.unwrap_or(0) as f64 * 1e-9 / libm::sqrt(12.0),
            frame_share,
            sensor: stated,
            plausible_range,
        })
    }

    /// What the description states and the MAP estimate does not use, as a sentence.
    pub fn not_modelled(&self, sensor: &Sensor) -> Option<String> {
        let mut used = sensor.clone();
        // The reset rule is modelled there, and effects are undone.
        used.comparator.reset = Reset::Resample;
        used.effects.retain(|id, _| self.undo_rounds == 0 || self.undo.left_out.contains(&id.as_str()));
        left_out(&used)
    }
}

impl SolveOptions {
    /// The tracks of a recording's solution.
    ///
    /// # Errors
    /// When frames do not lie on the events' pixels, are rendered, or are not there.
    pub fn tracks_meta(&self, events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
        tracks_meta(events, frames, self.sigma, Between::LogLinear, |copies, n, values| {
            4 * copies * n + 8 * values
        })
    }
}

impl PaperOptions {
    /// The tracks of a recording's solution.
    ///
    /// # Errors
    /// When frames do not lie on the events' pixels, are rendered, or are not there.
    pub fn tracks_meta(&self, events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
        tracks_meta(events, frames, false, Between::Hold, |copies, n, values| 2 * copies * n + values)
    }
}

fn tracks_meta(
    events: &EventsMeta,
    frames: &FramesMeta,
    has_sigma: bool,
    between: Between,
    knots: impl Fn(u64, u64, u64) -> u64,
) -> Result<TracksMeta, NodeError> {
    let lie = CoLocated::new(events, frames)?;
    if frames.scale != FrameScale::Captured {
        return Err(NodeError::usage(
            "frames are rendered, not captured: their values do not belong to their exposures",
        )
        .hint("connect the recording's frames"));
    }
    let (Some(covered), Some(nominal_exposure_ns)) =
        (frames.times.span(frames.extent.height), frames.times.nominal_exposure_ns())
    else {
        return Err(NodeError::usage(
            "there is no frame, and events alone leave the photocurrent's level open",
        )
        .hint("give at least one frame"));
    };
    let (copies, values) = (
        u64::from(lie.ratio * lie.ratio * lie.colour.channels()),
        values_of(frames.extent, frames.colour).pixels(),
    );
    Ok(TracksMeta {
        extent: frames.extent,
        colour: frames.colour,
        has_sigma,
        span: events.span.map_or(covered, |span| span.union(covered)),
        nominal_exposure_ns,
        between,
        count_hint: events.count_hint.map(|n| knots(copies, n, (frames.times.len() * values) as u64)),
    })
}

/// A description that a node worked out is planned as the one that it was given: what reaches over rows may
/// be in it only now.
pub(crate) fn late_description(what: &str) -> NodeError {
    NodeError::failed(format!("{what}, and that was not known when the recording was cut into row bands"))
        .hint("write the description to a file and read it with read/sensor, or set `undo_rounds = 0`")
}

/// The effects of a description, to be undone; its clock offset is subtracted with the stamps ([`StepRule`]).
fn undo(sensor: &Sensor) -> Result<Undo, NodeError> {
    let mut effects = from_description(&sensor.effects)
        .map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
    effects.retain(|effect| effect.id() != "clock_offset");
    Ok(Undo::new(effects))
}
