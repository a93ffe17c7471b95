//! When virtual frames are exposed: at a steady rate, or like frames that exist.
//!
//! A renderer and every method that is compared with it must sample alike, or their scores compare different
//! pictures. So the parameters, their checks and the list of exposures stand here once. Frame `k` of a steady
//! rate has the middle of its exposure at `k / rate` on the recording's clock (rounded to the nanosecond):
//! with any two rates that divide each other, common instants fall together.

use crate::spans::{MOST_STEPS, rounded};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::time::{NS_PER_S, in_seconds};
use photocurrent_core::{
    Colour, Exposure, Extent, FrameScale, FrameTimes, FramesMeta, NodeError, Sensor, TimeSpan,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which rows of a virtual frame are exposed when.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shutter {
    /// All rows at once: the rolling shutter's skew is gone.
    #[default]
    Global,
    /// Row after row with the sensor's row time.
    Rolling,
}

/// Steady sampling. Not used when frames are connected to `at`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Sampling {
    /// Frames per second, up to 10 kHz and beyond.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "1 MHz"))]
    pub rate: Rate,
    /// Length of the virtual exposure; the picture is the mean light over it.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// Which rows are exposed when.
    pub shutter: Shutter,
    /// First instant, on the recording's clock; absent = the recording's start.
    pub start: Option<Duration>,
    /// First instant no longer rendered; absent = the recording's end.
    pub end: Option<Duration>,
}

impl Default for Sampling {
    fn default() -> Self {
        Sampling {
            rate: Rate::new(1000.0),
            exposure: Duration::new(100_000),
            shutter: Shutter::Global,
            start: None,
            end: None,
        }
    }
}

impl Sampling {
    /// The exposures inside `span`.
    ///
    /// # Errors
    /// When the window holds no instant, or a rolling shutter is asked of a sensor whose row time is unknown.
    pub fn times(&self, span: TimeSpan, sensor: Option<&Sensor>) -> Result<FrameTimes, NodeError> {
        let (start, end) = self.window(span)?;
        let shown = |ns: i64| Duration::new(ns);
        let covered = covered(span);
        let period = 1e9 / self.rate.hz();
        let count = (end as f64 - start as f64) / period;
        if count > MOST_STEPS as f64 {
            let message = format!(
                "this would render {} frames, from {} to {} at {}, and {MOST_STEPS} are the most",
                rounded(count),
                in_seconds(start),
                in_seconds(end),
                self.rate
            );
            return Err(NodeError::usage(message)
                .note(covered)
                .hint(
                    "set `start` and `end` around what you want to see, or lower `rate`; is the recording \
                       that long, or is one stamp far from all others?",
                )
                .param("rate"));
        }
        let first = (start as f64 / period).ceil() as i64;
        let instants = (first..)
            .map(|k| (k as f64 * period).round() as i64)
            .skip_while(|&t| t < start)
            .take_while(|&t| t < end);
        let half = self.exposure.ns() / 2;
        let exposures: Vec<Exposure> =
            instants.map(|t| Exposure::new(t - half, t - half + self.exposure.ns())).collect();
        if exposures.is_empty() {
            return Err(NodeError::usage(format!(
                "no frame lies between {} and {} at {}",
                shown(start),
                shown(end),
                self.rate
            ))
            .note(covered)
            .hint("move `start` and `end` apart, or raise `rate`")
            .param(if self.start.is_some() { "start" } else { "rate" }));
        }
        let row_time_ns = match (self.shutter, sensor) {
            (Shutter::Global, _) => 0,
            (Shutter::Rolling, Some(sensor)) => {
                sensor.need(sensor.frames.row_time, "frames.row_time", "a rolling shutter")?.ns()
            }
            (Shutter::Rolling, None) => {
                return Err(NodeError::usage("`shutter = \"rolling\"` needs a sensor description")
                    .hint("connect `sensor`")
                    .param("shutter"));
            }
        };
        FrameTimes::new(exposures, row_time_ns).map_err(NodeError::from)
    }

    /// First and last instant, ns, of what is rendered of `span`; refuses a window that is empty.
    fn window(&self, span: TimeSpan) -> Result<(i64, i64), NodeError> {
        let start = self.start.map_or(span.start.0, Duration::ns);
        let end = self.end.map_or(span.end.0, Duration::ns);
        let shown = |ns: i64| Duration::new(ns);
        let (message, param) = match (self.start, self.end) {
            _ if end > start => return Ok((start, end)),
            (None, None) => return Ok((start, end)),
            (Some(_), Some(_)) if end == start => {
                (format!("the window ends at {}, where it begins", shown(end)), "end")
            }
            (Some(_), Some(_)) => {
                (format!("the window ends at {}, before it begins at {}", shown(end), shown(start)), "end")
            }
            (Some(_), None) => {
                (format!("the window begins at {}, when the recording is over", shown(start)), "start")
            }
            (None, Some(_)) => {
                (format!("the window ends at {}, before the recording begins", shown(end)), "end")
            }
        };
        let hint = "`start` comes first, and both lie in the recording";
        Err(NodeError::usage(message).note(covered(span)).hint(hint).param(param))
    }
}

/// What a recording covers, as a sentence.
fn covered(span: TimeSpan) -> String {
    format!("the recording covers {} to {}", Duration::new(span.start.0), Duration::new(span.end.0))
}

/// What virtual frames of a size and colours will look like: like `at` when it is connected, else steadily
/// sampled and scaled to the recording's ordinary exposure.
///
/// # Errors
/// As [`Sampling::times`]; and when `at` has another size than the pictures.
pub fn virtual_frames(
    sampling: &Sampling,
    at: Option<&FramesMeta>,
    (extent, colour): (Extent, Colour),
    span: TimeSpan,
    nominal_exposure_ns: i64,
    sensor: Option<&Sensor>,
) -> Result<FramesMeta, NodeError> {
    match at {
        Some(at) if at.extent != extent => {
            Err(NodeError::usage(format!("frames to imitate are {}, the sensor's are {extent}", at.extent)))
        }
        Some(at) => Ok(FramesMeta { colour, ..at.clone() }),
        None => Ok(FramesMeta {
            extent,
            colour,
            times: sampling.times(span, sensor)?,
            scale: FrameScale::Nominal { exposure_ns: nominal_exposure_ns },
        }),
    }
}

/// The exposure, in seconds, whose charge a DN of `exposure` stands for under `scale`.
pub fn scale_seconds(scale: FrameScale, exposure: Exposure) -> f64 {
    match scale {
        FrameScale::Captured => exposure.seconds(),
        FrameScale::Nominal { exposure_ns } => exposure_ns as f64 / NS_PER_S,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::Timestamp;

    fn mids(sampling: &Sampling, span: TimeSpan) -> Vec<i64> {
        let times = sampling.times(span, None).unwrap();
        times.exposures.iter().map(|e| e.mid().0).collect()
    }

    #[test]
    fn instants_are_multiples_of_the_period_whatever_the_start() {
        let sampling = Sampling { rate: Rate::new(1000.0), ..Sampling::default() };
        assert_eq!(mids(&sampling, TimeSpan::new(-500_000, 2_500_000)), [0, 1_000_000, 2_000_000]);
        assert_eq!(
            mids(&Sampling { start: Some(Duration::new(1)), ..sampling }, TimeSpan::new(0, 3_000_000)),
            [1_000_000, 2_000_000]
        );
    }

    #[test]
    fn a_faster_rate_visits_the_slower_ones_instants() {
        let span = TimeSpan::new(0, 50_000_000);
        let at = |hz| mids(&Sampling { rate: Rate::new(hz), ..Sampling::default() }, span);
        let fast = at(10_000.0);
        assert_eq!(fast.len(), 500);
        assert!(at(1000.0).iter().all(|t| fast.contains(t)));
    }

    #[test]
    fn an_empty_window_says_what_the_recording_covers() {
        let sampling = Sampling { start: Some(Duration::new(10_000_000)), ..Sampling::default() };
        let error = sampling.times(TimeSpan { start: Timestamp(0), end: Timestamp(5) }, None).unwrap_err();
        assert!(error.to_string().contains("covers 0 ns to 5 ns"));
    }

    #[test]
    fn more_frames_than_can_be_are_refused_before_they_are_listed() {
        let sampling = Sampling { rate: Rate::new(1000.0), ..Sampling::default() };
        let decades = TimeSpan::new(0, 1_700_000_000_000_000_000);
        let error = sampling.times(decades, None).unwrap_err();
        assert!(
            error.message.starts_with("this would render 1.7e12 frames, from 0 s to 1700000000 s at 1 kHz"),
            "{}",
            error.message
        );
        assert!(error.hint.unwrap().contains("set `start` and `end`"));
        let part =
            Sampling { start: Some(Duration::new(0)), end: Some(Duration::new(5_000_000)), ..sampling };
        assert_eq!(mids(&part, decades).len(), 5);
        assert!(part.times(TimeSpan::new(i64::MIN, i64::MAX), None).is_ok());
    }

    #[test]
    fn an_empty_window_says_which_end_is_wrong() {
        let ms = |ms: i64| Some(Duration::new(ms * 1_000_000));
        let refused = |start, end, span_end_ms: i64| {
            let sampling = Sampling { start, end, ..Sampling::default() };
            let error = sampling.times(TimeSpan::new(0, span_end_ms * 1_000_000), None).unwrap_err();
            (error.message, error.param.unwrap())
        };
        assert_eq!(
            refused(ms(30), ms(10), 60),
            ("the window ends at 10 ms, before it begins at 30 ms".into(), "end".into())
        );
        assert_eq!(
            refused(ms(30), ms(30), 60),
            ("the window ends at 30 ms, where it begins".into(), "end".into())
        );
        assert_eq!(
            refused(ms(90), None, 60),
            ("the window begins at 90 ms, when the recording is over".into(), "start".into())
        );
        assert_eq!(
            refused(None, ms(-5), 60),
            ("the window ends at -5 ms, before the recording begins".into(), "end".into())
        );
        assert_eq!(
            refused(None, None, 0),
            ("no frame lies between 0 ns and 0 ns at 1 kHz".into(), "rate".into())
        );
    }
}
