//! What every method that turns captured frames into frames at other instants does alike: which frames are
//! asked for, where thresholds come from, what white is, and the walk over rows.
//!
//! Methods that are compared must differ in their idea alone. So the sockets `frames`, `events`, `sensor` and
//! `at` are read here once, for planning and for running, and [`by_rows`] and [`in_rows`] cut the work into
//! rows.

use crate::sampling::{Sampling, virtual_frames};
use crate::spans::{check_covered, check_one_clock};
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::Column;
use photocurrent_core::{
    Colour, Context, EventStream, EventsMeta, Exposure, FrameBlock, FrameScale, FrameSequence, FramesMeta,
    NodeError, PortMetas, Rows, Sensor, Table,
};
use photocurrent_solve::co_located::{CoLocated, CoLocatedEvents};
use photocurrent_solve::pixel_events::{Stamp, StepRule, clock_offset};
use rayon::prelude::*;
use std::sync::Arc;

photocurrent_core::ports! {
    /// Inputs of methods that step by thresholds.
    pub struct In {
        /// Events; compensated steps are used where a node before made them.
        events: EventStream,
        /// Captured frames.
        frames: FrameSequence,
        /// Thresholds, black level, clock offset; saturation, where white counts.
        sensor: Option<Arc<Sensor>>,
        /// A table with the column `contrast`, from `baseline/contrast` (with `white`, where white counts):
        /// one threshold; for `baseline/edi` also one for each captured frame.
        contrast: Option<Arc<Table>>,
        /// Frames whose exposures, row time and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

impl In {
    /// What is connected.
    pub(crate) fn request(&self) -> Request<'_> {
        Request::connected(&self.frames, Some(&self.events), &self.at, &self.sensor)
    }
}

/// What is connected to a method's sockets, as far as it is known before the data.
#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    /// At `frames`: captured ones.
    pub frames: &'a FramesMeta,
    /// At `events`, when the method has the socket.
    pub events: Option<&'a EventsMeta>,
    /// At `at`: frames to imitate.
    pub at: Option<&'a FramesMeta>,
    /// At `sensor`.
    pub sensor: Option<&'a Sensor>,
}

impl<'a> Request<'a> {
    /// While planning.
    ///
    /// # Errors
    /// When nothing is connected to `frames`, or the frames' size is no whole multiple of the events', or the
    /// two have no moment in common.
    pub(crate) fn planned(inputs: &'a PortMetas) -> Result<Request<'a>, NodeError> {
        let request = Request {
            frames: inputs.frames("frames")?,
            events: inputs
                .has("events")
                .then(|| inputs.events("events"))
                .transpose()?
                .map(|events| &**events),
            at: inputs.has("at").then(|| inputs.frames("at")).transpose()?.map(|at| &**at),
            sensor: inputs
                .has("sensor")
                .then(|| inputs.sensor("sensor"))
                .transpose()?
                .map(|sensor| &**sensor),
        };
        request.lie()?;
        if let Some(events) = request.events {
            check_one_clock(events, request.frames, request.sensor)?;
        }
        check_covered(request.events, request.frames, request.sensor)?;
        Ok(request)
    }

    /// How the frames lie on the events; `None` without events.
    ///
    /// # Errors
    /// When they are of other pixels.
    pub(crate) fn lie(&self) -> Result<Option<CoLocated>, NodeError> {
        self.events.map(|events| CoLocated::new(events, self.frames)).transpose()
    }

    /// Pixels of the frames along a side of an event pixel.
    ///
    /// # Errors
    /// When they are of other pixels.
    pub(crate) fn ratio(&self) -> Result<u32, NodeError> {
        Ok(self.lie()?.map_or(1, |lie| lie.ratio))
    }

    /// Refuses frames with colours or of more pixels than the events, for methods that look at neighbours;
    /// `who` is the asker.
    ///
    /// # Errors
    /// When they are such.
    pub(crate) fn need_plain(&self, who: &str) -> Result<(), NodeError> {
        let frames = CoLocated { ratio: 1, colour: self.frames.colour };
        self.lie()?.unwrap_or(frames).need_plain(who)
    }

    /// The same, but for frames of three channels.
    ///
    /// # Errors
    /// When they are a mosaic, or of more pixels than the events.
    pub(crate) fn need_plain_or_colour(&self, who: &str) -> Result<(), NodeError> {
        if self.frames.colour == Colour::Rgb && self.ratio()? == 1 { Ok(()) } else { self.need_plain(who) }
    }

    /// While running.
    pub(crate) fn connected(
        frames: &'a FrameSequence,
        events: Option<&'a EventStream>,
        at: &'a Option<FrameSequence>,
        sensor: &'a Option<Arc<Sensor>>,
    ) -> Request<'a> {
        Request {
            frames: &frames.meta,
            events: events.map(|events| &*events.meta),
            at: at.as_ref().map(|at| &*at.meta),
            sensor: sensor.as_deref(),
        }
    }

    /// What the method gives: sampled as `sampling` says, or like `at`.
    ///
    /// # Errors
    /// When there is no captured frame, or the sampling does not fit.
    pub(crate) fn output(&self, sampling: &Sampling) -> Result<FramesMeta, NodeError> {
        let frames = self.frames;
        if frames.scale != FrameScale::Captured {
            return Err(NodeError::usage("the method works on captured frames")
                .hint("connect the recording's frames"));
        }
        let (Some(span), Some(nominal_ns)) =
            (frames.times.span(frames.extent.height), frames.times.nominal_exposure_ns())
        else {
            return Err(NodeError::usage("there is no captured frame to start from"));
        };
        let covered = self.events.and_then(|events| events.span).map_or(span, |events| events.union(span));
        virtual_frames(sampling, self.at, (frames.extent, frames.colour), covered, nominal_ns, self.sensor)
    }

    /// Times and steps of events: one stated threshold for both polarities, else a searched one, else the
    /// description's two; `latency` is subtracted every stamp.
    ///
    /// # Errors
    /// When no threshold is known, or the description cannot be read.
    pub(crate) fn step_rule(
        &self,
        who: &str,
        threshold: Option<f64>,
        searched: Option<f64>,
        stamp: Stamp,
        latency: Duration,
    ) -> Result<StepRule, NodeError> {
        let mut rule = match (threshold.or(searched), self.sensor, self.events) {
            (Some(threshold), sensor, _) => {
                let shift_ns = sensor.map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns);
                StepRule { threshold_on: threshold, threshold_off: threshold, stamp, shift_ns }
            }
            (None, Some(sensor), Some(events)) => {
                StepRule::from_sensor(sensor, events, stamp, who).map_err(or_state_threshold)?
            }
            _ => {
                return Err(NodeError::usage(
                    "no threshold: neither `threshold` nor a sensor description nor `contrast` is given",
                )
                .hint("connect `sensor`, or state `threshold`")
                .param("threshold"));
            }
        };
        rule.shift_ns += latency.ns();
        Ok(rule)
    }

    /// Digital numbers as intensities, 0 for black and 1 for white of an ordinary exposure.
    ///
    /// # Errors
    /// When white is neither stated nor in the description, or lies not above black.
    pub(crate) fn intensity(&self, who: &str, white: Option<f64>) -> Result<Intensity, NodeError> {
        let black = black_level(self.sensor);
        let Some(white) = white.or_else(|| self.sensor.and_then(|sensor| sensor.frames.saturation_dn)) else {
            return Err(NodeError::usage(format!(
                "{who} works on intensities from 0 to 1, and the DN of white is not known"
            ))
            .hint(
                "state `white` (255 for 8-bit frames), or connect a sensor description with \
                       `frames.saturation_dn`",
            )
            .param("white"));
        };
        if white <= black {
            return Err(NodeError::usage(format!("white, {white} DN, is not above black, {black} DN"))
                .hint("state a larger `white`")
                .param("white"));
        }
        let nominal_s = self.frames.times.nominal_exposure_ns().map_or(1.0, |ns| ns as f64 * 1e-9);
        Ok(Intensity { black, white, nominal_s })
    }
}

/// A threshold that the description does not state can be stated at the node.
fn or_state_threshold(error: NodeError) -> NodeError {
    match (&error.blamed_input, &error.hint) {
        (Some(_), Some(hint)) => {
            let hint = format!("{hint}, or state `threshold`");
            error.hint(hint)
        }
        _ => error,
    }
}

/// Intensities as the public event-camera methods use them: 0 is black, 1 is white.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Intensity {
    black: f64,
    white: f64,
    /// The exposure for which 1 is white; a longer one of the same light is not brighter.
    nominal_s: f64,
}

/// Darker intensities than this, of frames whose noise lies below the black level, count as this: log(1 + I)
/// stays finite.
const DARKEST: f64 = -0.5;

impl Intensity {
    /// Of a captured digital number.
    pub(crate) fn of(&self, dn: f32, exposure: Exposure) -> f64 {
        let value =
            (f64::from(dn) - self.black) / (self.white - self.black) * (self.nominal_s / exposure.seconds());
        // `max` would turn an unknown value into the bound.
        if value < DARKEST { DARKEST } else { value }
    }

    /// Digital number of an intensity, for an exposure of `seconds`.
    pub(crate) fn dn(&self, intensity: f64, seconds: f64) -> f32 {
        (self.black + intensity * (self.white - self.black) * (seconds / self.nominal_s)) as f32
    }
}

/// The threshold in a table made by `baseline/contrast`.
///
/// # Errors
/// When there is none.
pub(crate) fn contrast_of(table: &Table) -> Result<&[f64], NodeError> {
    match table.column("contrast") {
        Some(Column::Numbers(values)) if !values.is_empty() && values.iter().all(|c| *c > 0.0) => Ok(values),
        _ => Err(NodeError::input("the table at `contrast` has no positive number in a column `contrast`")
            .hint("connect baseline/contrast")),
    }
}

/// The one threshold in such a table, for `who`, which takes no more.
///
/// # Errors
/// When there is none, or one for each frame.
pub(crate) fn one_contrast_of(table: &Table, who: &str) -> Result<f64, NodeError> {
    match contrast_of(table)? {
        [one] => Ok(*one),
        values => Err(NodeError::input(format!(
            "{who} takes one threshold for all frames, and `contrast` has {}",
            values.len()
        ))
        .hint("search with `per = \"sequence\"`")),
    }
}

/// Black level of the description; 0 when there is none.
pub(crate) fn black_level(sensor: Option<&Sensor>) -> f64 {
    sensor.and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0)
}

/// Refuses standard deviations of other frames.
///
/// # Errors
/// When size, colours or exposures of `sigma` are not those of `frames`.
pub(crate) fn check_sigma(sigma: &FramesMeta, frames: &FramesMeta) -> Result<(), NodeError> {
    if (sigma.extent, sigma.colour, &sigma.times) == (frames.extent, frames.colour, &frames.times) {
        return Ok(());
    }
    Err(NodeError::usage(format!(
        "`sigma` has {} frames of {} pixels, {}, and `frames` {} of {} pixels, {}, or their exposures differ",
        sigma.times.len(),
        sigma.extent,
        sigma.colour,
        frames.times.len(),
        frames.extent,
        frames.colour
    ))
    .hint("connect `sigma` of the node that `frames` come from, or leave it out"))
}

/// Index of the captured frame whose exposure of `row` has its middle nearest to `t`; the earlier of two.
pub(crate) fn nearest_frame(frames: &FramesMeta, row: u32, t: i64) -> usize {
    let mid = |l: usize| frames.times.exposure(l, row).mid().0;
    let after = frames
        .times
        .exposures
        .partition_point(|e| e.delayed(frames.times.row_time_ns * i64::from(row)).mid().0 < t);
    match after {
        0 => 0,
        n if n == frames.times.len() => n - 1,
        n if t - mid(n - 1) <= mid(n) - t => n - 1,
        n => n,
    }
}

/// The events of some rows of the frames, at every value of theirs ([`CoLocatedEvents::with_row`]).
///
/// # Errors
/// When they are of other pixels or cannot be read.
pub(crate) fn events_of(
    events: &EventStream,
    frames: &FramesMeta,
    rows: Rows,
) -> Result<CoLocatedEvents, NodeError> {
    CoLocated::new(&events.meta, frames)?.read(events, rows)
}

/// Frames of the context's rows, one call per row side by side; a call gives all frames of its row as
/// [frame][value].
///
/// # Errors
/// When a call fails, or the user interrupts.
pub(crate) fn by_rows(
    cx: &Context,
    meta: FramesMeta,
    row: impl Fn(u32) -> Result<Vec<f32>, NodeError> + Sync,
) -> Result<FrameSequence, NodeError> {
    let width = meta.row_values();
    in_rows(cx, meta, |y, frames| {
        let picture = row(y)?;
        frames
            .iter_mut()
            .zip(picture.chunks_exact(width))
            .for_each(|(out, values)| out.copy_from_slice(values));
        Ok(())
    })
}

/// The same without a copy: a call gets its row of every frame, all 0, to write.
///
/// # Errors
/// When a call fails, or the user interrupts.
pub(crate) fn in_rows(
    cx: &Context,
    meta: FramesMeta,
    row: impl Fn(u32, &mut [&mut [f32]]) -> Result<(), NodeError> + Sync,
) -> Result<FrameSequence, NodeError> {
    let rows = cx.rows();
    cx.begin(rows.len() as u64, "rows");
    let mut block = FrameBlock::zeros(0..meta.times.len(), rows, meta.row_values());
    rows_of(&mut block).into_par_iter().try_for_each(|(y, mut frames)| -> Result<(), NodeError> {
        row(y, &mut frames)?;
        cx.advance(1)
    })?;
    Ok(FrameSequence::in_memory(Arc::new(meta), block))
}

/// Every row of a block, of each of its frames, to write.
pub(crate) fn rows_of(block: &mut FrameBlock) -> Vec<(u32, Vec<&mut [f32]>)> {
    let (count, width) = (block.frames.len(), block.row_values);
    let mut of_rows: Vec<(u32, Vec<&mut [f32]>)> =
        block.rows.iter().map(|y| (y, Vec::with_capacity(count))).collect();
    for frame in block.dn.chunks_exact_mut((block.rows.len() * width).max(1)) {
        of_rows
            .iter_mut()
            .zip(frame.chunks_exact_mut(width))
            .for_each(|((_, frames), values)| frames.push(values));
    }
    of_rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Extent, testing};

    #[test]
    fn white_of_half_an_exposure_is_half_of_white() {
        let frames = testing::captured(
            Extent { width: 1, height: 1 },
            vec![Exposure::new(0, 1_000_000), Exposure::new(2_000_000, 2_500_000)],
            0,
            |_, _, _| 0.0,
        );
        let mut sensor = Sensor::unknown("test");
        sensor.frames.black_level_dn = Some(16.0);
        let request = Request { frames: &frames.meta, events: None, at: None, sensor: Some(&sensor) };
        assert_eq!(request.intensity("x", None).unwrap_err().param.as_deref(), Some("white"));
        // The ordinary exposure is the lower median: 0.5 ms.
        let intensity = request.intensity("x", Some(116.0)).unwrap();
        assert_eq!(intensity.of(116.0, Exposure::new(0, 1_000_000)), 0.5);
        assert_eq!(intensity.dn(0.5, 1e-3), 116.0);
        assert!(intensity.of(f32::NAN, Exposure::new(0, 1_000_000)).is_nan());
    }

    #[test]
    fn one_threshold_is_distinguished_from_one_for_each_frame() {
        let table = |values: &[f64]| Table::default().with("contrast", Column::Numbers(values.to_vec()));
        assert_eq!(one_contrast_of(&table(&[0.2]), "x"), Ok(0.2));
        let error = one_contrast_of(&table(&[0.2, 0.3]), "x").unwrap_err();
        assert_eq!(error.message, "x takes one threshold for all frames, and `contrast` has 2");
        assert!(one_contrast_of(&table(&[-0.2]), "x").unwrap_err().message.contains("no positive number"));
    }

    #[test]
    fn rows_are_put_where_they_belong() {
        let frames = testing::frames(2, 3, 2);
        let (out, _) = testing::with_context(frames.rows(), &["frames"], |cx| {
            by_rows(cx, (*frames.meta).clone(), |y| Ok((0..4).map(|i| (10 * y + i) as f32).collect()))
        });
        let block = out.unwrap().read_rows(frames.rows()).unwrap();
        assert_eq!(block.row(1, 2), [22.0, 23.0]);
    }
}
