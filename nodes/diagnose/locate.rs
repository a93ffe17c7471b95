//! `diagnose/locate`: in which rows, columns, instants, light, at which speed, load and history a recording differs from what its sensor should give.
//!
//! The shares of extra and missing events, the delay of paired ones and the log of frame values are averaged over bins of twenty covariates, less the same of a control:
//! a simulated recording of the same light, treated alike. A p-value is family-wise: how often the largest statistic over all bins, covariates and channels is as large
//! when signs of whole squares of pixels are flipped.
//!
//! Limits: light is estimated, and a recording's is rougher than its control's, so that the two differ in more than their sensor: in sound recordings of fast textures the
//! shares of extra and missing events depend on speed and load (p = 0.005). With 199 draws no p-value is below 0.005. The phase of the mains is not among the covariates.

use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{Context, DataError, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, TrackSet};
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::covariates::Surroundings;
use photocurrent_diagnosis::light::from_tracks;
use photocurrent_diagnosis::locate::{Channel, Curve, Side, scan};
use photocurrent_diagnosis::sample::Sample;
use photocurrent_diagnosis::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/locate`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Curves whose chance is at most this are told as notes; 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub significance: f64,
}

impl Default for Params {
    fn default() -> Params {
        Params { significance: 0.01 }
    }
}

photocurrent_core::ports! {
    /// A recording and its control, each with light and residuals.
    pub struct In {
        /// The events of the recording.
        events: EventStream,
        /// The frames of the recording.
        frames: FrameSequence,
        /// The description as stated.
        sensor: Arc<Sensor>,
        /// The light of the recording.
        tracks: TrackSet,
        /// Residuals of the recording's events.
        event_residuals: Arc<Table>,
        /// Residuals of the recording's frames.
        frame_residuals: Arc<Table>,
        /// The events of the control.
        control_events: EventStream,
        /// The frames of the control.
        control_frames: FrameSequence,
        /// The light of the control.
        control_tracks: TrackSet,
        /// Residuals of the control's events.
        control_event_residuals: Arc<Table>,
        /// Residuals of the control's frames.
        control_frame_residuals: Arc<Table>,
    }
}

photocurrent_core::ports! {
    /// Where it differs.
    pub struct Out {
        /// One row a curve, the most significant first: `channel`, `covariate`, `statistic`, `p_value`, `explained` (share of the variance that is not error), `bins`.
        curves: Arc<Table>,
        /// One row a bin: `channel`, `covariate`, `at` (mean of the covariate), `value` (recording less control), `error`.
        bins: Arc<Table>,
    }
}

/// The node.
pub struct DiagnoseLocate {
    params: Params,
}

impl Node for DiagnoseLocate {
    const DECL: Decl = Decl {
        kind: "diagnose/locate",
        about: "Scans residuals over place, time, light, speed, load and history against a control, with family-wise significance.",
        revision: 1,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md", "P. H. Westfall and S. S. Young, Resampling-based multiple testing, 1993 (largest statistic of all tests)"],
        example: r#"
[nodes.locate]
kind = "diagnose/locate"

[nodes.locate.in]
events                  = "recording.events"
frames                  = "recording.frames"
sensor                  = "recording.sensor"
tracks                  = "fit.tracks"
event_residuals         = "residuals.events"
frame_residuals         = "residuals.frames"
control_events          = "control.events"
control_frames          = "control.frames"
control_tracks          = "control_fit.tracks"
control_event_residuals = "control_residuals.events"
control_frame_residuals = "control_residuals.frames"
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseLocate { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::empty(inputs)?;
        Ok([false, false].map(|scores| Meta::Table(Arc::new(TableMeta { scores }))).to_vec())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let recording = Lit::new(&input.events, &input.frames, &input.sensor, &input.tracks)?;
        let control = Lit::new(&input.control_events, &input.control_frames, &input.sensor, &input.control_tracks)?;
        let width = recording.case.extent.width;
        let (events, control_events) = (
            super::residuals::read_events(&input.event_residuals, width, "event_residuals")?,
            super::residuals::read_events(&input.control_event_residuals, width, "control_event_residuals")?,
        );
        let (frames, control_frames) = (
            super::residuals::read_frames(&input.frame_residuals, width, "frame_residuals")?,
            super::residuals::read_frames(&input.control_frame_residuals, width, "control_frame_residuals")?,
        );
        let (here, there) = (recording.surroundings(), control.surroundings());
        let curves = scan(
            &Side { events: &events, frames: &frames, surroundings: &here },
            &Side { events: &control_events, frames: &control_frames, surroundings: &there },
            cx.seed(),
        );
        for curve in curves.iter().filter(|curve| curve.p_value <= self.params.significance) {
            cx.note(format!("{} over {}: {:.1} standard errors, p = {:.3}", channel(curve.channel), curve.covariate.name(), curve.statistic, curve.p_value));
        }
        Ok(Out { curves: Arc::new(ranking(&curves)), bins: Arc::new(bins(&curves)) })
    }
}

/// A recording and its light.
struct Lit {
    case: Case,
    sample: Sample,
    scene: Scene,
    tau: (f64, f64),
}

impl Lit {
    fn new(events: &EventStream, frames: &FrameSequence, sensor: &Sensor, tracks: &TrackSet) -> Result<Lit, NodeError> {
        let case = super::case(Some(events), Some(frames), sensor)?;
        let front_end = case.nominal()?.pixel.front_end;
        let (sample, scene): (Sample, Scene) = from_tracks(&case, tracks).map_err(|error: DataError| NodeError::from(error))?;
        Ok(Lit { case, sample, scene, tau: (front_end.tau_0_s, front_end.alpha_s) })
    }

    fn surroundings(&self) -> Surroundings<'_> {
        Surroundings::new(&self.case, &self.sample, &self.scene, self.tau)
    }
}

fn channel(channel: Channel) -> &'static str {
    match channel {
        Channel::Extra => "extra",
        Channel::Missing => "missing",
        Channel::Delay => "delay",
        Channel::Frames => "frames",
        // Told by the refit that wants them.
    }
}

fn ranking(curves: &[Curve]) -> Table {
    let numbers = |of: fn(&Curve) -> f64| Column::Numbers(curves.iter().map(of).collect());
    Table::default()
        .with("channel", Column::Texts(curves.iter().map(|curve| channel(curve.channel).into()).collect()))
        .with("covariate", Column::Texts(curves.iter().map(|curve| curve.covariate.name().into()).collect()))
        .with("statistic", numbers(|curve| curve.statistic))
        .with("p_value", numbers(|curve| curve.p_value))
        .with("explained", numbers(|curve| curve.explained))
        .with("bins", Column::Integers(curves.iter().map(|curve| curve.at.len() as i64).collect()))
}

fn bins(curves: &[Curve]) -> Table {
    let texts = |of: fn(&Curve) -> &'static str| Column::Texts(curves.iter().flat_map(|curve| curve.at.iter().map(move |_| of(curve).into())).collect());
    let numbers = |of: fn(&Curve) -> &Vec<f64>| Column::Numbers(curves.iter().flat_map(|curve| of(curve).iter().copied()).collect());
    Table::default()
        .with("channel", texts(|curve| channel(curve.channel)))
        .with("covariate", texts(|curve| curve.covariate.name()))
        .with("at", numbers(|curve| &curve.at))
        .with("value", numbers(|curve| &curve.value))
        .with("error", numbers(|curve| &curve.error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_diagnosis::covariates::Covariate;

    #[test]
    fn a_curve_is_a_row_and_its_bins_are_rows() {
        let curve = |covariate, at: &[f64]| Curve {
            channel: Channel::Delay,
            covariate,
            at: at.to_vec(),
            value: at.iter().map(|at| 2.0 * at).collect(),
            error: vec![0.5; at.len()],
            statistic: 7.0,
            p_value: 0.005,
            explained: 0.9,
        };
        let curves = [curve(Covariate::Row, &[1.0, 2.0, 3.0]), curve(Covariate::Polarity, &[-1.0, 1.0])];
        let (ranking, bins) = (ranking(&curves), bins(&curves));
        assert_eq!(ranking.column("bins"), Some(&Column::Integers(vec![3, 2])));
        assert_eq!(bins.column("value"), Some(&Column::Numbers(vec![2.0, 4.0, 6.0, -2.0, 2.0])));
        let covariates = ["row", "row", "row", "polarity", "polarity"].map(String::from).to_vec();
        assert_eq!(bins.column("covariate"), Some(&Column::Texts(covariates)));
    }
}
