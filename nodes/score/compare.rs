//! Frames with their true frames: the inputs, the loop, the peak and the rows of scores that full-reference
//! metrics share.

use super::matching::match_frames;
use super::region::Region;
use crate::crop::Crop;
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{Context, FrameSequence, Meta, NodeError, PortMetas, Sensor, Truth};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of metrics of whole pictures.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// DN that counts as full scale, above black; absent = saturation of the connected sensor, else the
    /// largest true value.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub peak_dn: Option<f64>,
    /// Which pixels count; windows reach beyond them.
    pub region: Region,
    /// Only pixels in this rectangle count; absent = the whole picture.
    pub roi: Option<Crop>,
    /// How far apart the middles of two exposures may lie.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params { peak_dn: None, region: Region::All, roi: None, tolerance: Duration::new(1000) }
    }
}

impl Params {
    /// Refuses, before any data, frames that are of other instants than the true ones, or not as large as
    /// `roi`; scores otherwise.
    ///
    /// # Errors
    /// When they are such.
    pub fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        match_frames(frames, inputs.truth("truth")?, self.tolerance.ns())?;
        self.roi.map_or(Ok(()), |roi| roi.check("roi", "frames", frames.extent))?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames to judge.
        frames: FrameSequence,
        /// What they should be.
        truth: Truth,
        /// For the peak and the black level.
        sensor: Option<Arc<Sensor>>,
    }
}

/// Frames, and for each the true frame that it is compared with.
pub struct Pairs<'a> {
    frames: &'a FrameSequence,
    reference: &'a FrameSequence,
    pairs: Vec<(usize, usize)>,
    tolerance: Duration,
}

impl<'a> Pairs<'a> {
    /// Matches by middle of exposure.
    ///
    /// # Errors
    /// As [`match_frames`].
    pub fn new(
        frames: &'a FrameSequence,
        reference: &'a FrameSequence,
        tolerance: Duration,
    ) -> Result<Pairs<'a>, NodeError> {
        Ok(Pairs {
            frames,
            reference,
            pairs: match_frames(&frames.meta, &reference.meta, tolerance.ns())?,
            tolerance,
        })
    }

    /// What `compare` says about (frame, true frame), each as [row][x * channels + channel], in the order of
    /// the frames.
    ///
    /// # Errors
    /// When a frame cannot be read, `compare` fails, or the user interrupts.
    pub fn map<T: Send>(
        &self,
        cx: &Context,
        compare: impl Fn(&[f32], &[f32]) -> Result<T, NodeError> + Sync,
    ) -> Result<Vec<T>, NodeError> {
        self.each(cx, |_, picture, reference| compare(picture, reference))
    }

    /// The same with the frame of the same place in a third sequence, of the same size and length as the
    /// frames: (frame, true frame, third).
    ///
    /// # Errors
    /// As [`Pairs::map`].
    pub fn map_with<T: Send>(
        &self,
        cx: &Context,
        third: &FrameSequence,
        compare: impl Fn(&[f32], &[f32], &[f32]) -> Result<T, NodeError> + Sync,
    ) -> Result<Vec<T>, NodeError> {
        self.each(cx, |l, picture, reference| {
            compare(picture, reference, &third.read(l..l + 1, third.rows())?.dn)
        })
    }

    fn each<T: Send>(
        &self,
        cx: &Context,
        compare: impl Fn(usize, &[f32], &[f32]) -> Result<T, NodeError> + Sync,
    ) -> Result<Vec<T>, NodeError> {
        cx.begin(self.pairs.len() as u64, "frames");
        let one = |&(l, reference): &(usize, usize)| {
            let picture = self.frames.read(l..l + 1, self.frames.rows())?;
            let true_picture = self.reference.read(reference..reference + 1, self.reference.rows())?;
            let compared = compare(l, &picture.dn, &true_picture.dn)?;
            cx.advance(1)?;
            Ok(compared)
        };
        self.pairs.par_iter().map(one).collect()
    }

    /// One score a frame, and their mean; frames that were not measured (NaN) do not enter it.
    pub fn scores(&self, metric: &str, unit: &str, values: &[f64]) -> Vec<Score> {
        let score =
            |frame, t_ns, value| Score { metric: metric.into(), frame, t_ns, value, unit: unit.into() };
        let exposures = &self.frames.meta.times.exposures;
        let mut scores: Vec<Score> = self
            .pairs
            .iter()
            .zip(values)
            .map(|((l, _), value)| score(*l as i64, exposures[*l].mid().0, *value))
            .collect();
        scores.push(score(-1, 0, mean_of_measured(values)));
        scores
    }

    /// For the card.
    pub fn describe(&self) -> String {
        format!(
            "{} of {} matched by middle of exposure within {}",
            self.pairs.len(),
            self.frames.len(),
            self.tolerance
        )
    }
}

/// Mean of the values that are not NaN; NaN when all are.
pub fn mean_of_measured(values: &[f64]) -> f64 {
    let measured = || values.iter().filter(|value| !value.is_nan());
    measured().sum::<f64>() / measured().count() as f64
}

/// What counts as full scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Peak {
    /// DN above black, positive.
    pub dn: f64,
    /// Where it comes from, for the card.
    pub from: String,
}

impl Peak {
    /// What was stated; else saturation above black of the description, else the largest value of `frames`;
    /// `whose` says in messages what these are: "true".
    ///
    /// # Errors
    /// When the frames are black, or lie above a stated peak for the most part: then it belongs to another
    /// range of values.
    pub fn find(
        stated: Option<f64>,
        sensor: Option<&Sensor>,
        frames: &FrameSequence,
        whose: &str,
    ) -> Result<Peak, NodeError> {
        let (dn, from) = match (stated, sensor.and_then(saturation_above_black)) {
            (Some(peak), _) => (peak, "stated".to_string()),
            (None, Some(peak)) => (peak, "saturation of the sensor above black".to_string()),
            (None, None) => (largest(frames)?, format!("largest {whose} value")),
        };
        // A sequence without any finite value has an infinitely small largest one.
        if !(dn > 0.0 && dn.is_finite()) {
            return Err(NodeError::input(format!("the {whose} frames are black: there is no peak"))
                .hint("state `peak_dn`"));
        }
        // Nothing exceeds the largest value.
        if !from.starts_with("largest") {
            check_range(dn, frames, whose)?;
        }
        Ok(Peak { dn, from })
    }

    /// For the card.
    pub fn describe(&self) -> String {
        format!("peak {:.3} DN ({})", self.dn, self.from)
    }
}

/// Refuses a peak that most of the values exceed: it is of another range, such as 255 for values of 12 bits.
fn check_range(peak: f64, frames: &FrameSequence, whose: &str) -> Result<(), NodeError> {
    let (mut above, mut all) = (0u64, 0u64);
    for l in 0..frames.len() {
        let picture = frames.read(l..l + 1, frames.rows())?;
        above += picture.dn.iter().filter(|dn| f64::from(**dn) > peak).count() as u64;
        all += picture.dn.len() as u64;
    }
    if 2 * above <= all {
        return Ok(());
    }
    Err(NodeError::input(format!(
        "{above} of {all} {whose} values lie above the peak of {peak} DN: it is of another range of values"
    ))
    .note(format!("the largest {whose} value is {} DN", largest(frames)?))
    .hint("state `peak_dn`, or correct `frames.saturation_dn` of the sensor description"))
}

/// Saturation above black, when the description states a saturation.
fn saturation_above_black(sensor: &Sensor) -> Option<f64> {
    sensor.frames.saturation_dn.map(|saturation| saturation - sensor.frames.black_level_dn.unwrap_or(0.0))
}

/// Largest finite value of a sequence.
fn largest(frames: &FrameSequence) -> Result<f64, NodeError> {
    let mut peak = f64::NEG_INFINITY;
    for l in 0..frames.len() {
        let picture = frames.read(l..l + 1, frames.rows())?;
        peak = picture.dn.iter().filter(|dn| dn.is_finite()).fold(peak, |peak, dn| peak.max(f64::from(*dn)));
    }
    Ok(peak)
}

/// A value for metrics that cannot leave out a pixel: one that is not known (NaN) counts as 0 DN, so that a
/// method gains nothing by it.
pub fn known(value: f32) -> f64 {
    if value.is_finite() { f64::from(value) } else { 0.0 }
}

/// How many values were not known, for the note.
pub fn unknown(picture: &[f32]) -> u64 {
    picture.iter().filter(|value| !value.is_finite()).count() as u64
}

/// What users read about [`unknown`].
pub const UNKNOWN: &str = "values were not known (NaN) and counted as 0 DN";
