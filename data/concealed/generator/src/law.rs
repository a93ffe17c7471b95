//! Laws that no catalogue lists: what a threshold, a stamp or a reset may depend on that nobody named.

use serde_json::{Value, json};

/// A law and its strengths. Thresholds of both polarities are multiplied alike unless it says otherwise.
#[derive(Clone, Debug, PartialEq)]
pub enum Law {
    /// Threshold x (1 + rise exp(-since / decay)), `since` the pixel's last event: hard to fire twice soon.
    Hysteresis { rise: f64, decay: f64 },
    /// Threshold x (1 + rise exp(-since / decay)), `since` the end of this row's exposure.
    FrameKick { rise: f64, decay: f64 },
    /// Threshold x (1 +- skew), + in even rows.
    RowParity { skew: f64 },
    /// Threshold x (1 + rise min(k, most)), k events before within `gap` of each other.
    Fatigue { rise: f64, most: usize, gap: f64 },
    /// Threshold x one factor for each block of columns.
    ColumnBlock { width: usize, factors: Vec<f64> },
    /// Stamps late by `delay` when one of the 8 neighbours fired within `window` before.
    NeighbourDelay { delay: f64, window: f64 },
    /// Threshold x (1 + depth sin(2 pi f t + phase)).
    Ripple { depth: f64, frequency: f64, phase: f64 },
    /// The reference is renewed later by `per_row` x row; stamps do not show it.
    RowReset { per_row: f64 },
    /// Threshold x (1 + rise min(|grad ln i| / scale, 2)).
    SpatialGradient { rise: f64, scale: f64 },
    /// Threshold x (1 + rise R / mean R), R the array's event rate of the last `memory` seconds.
    GlobalRate { rise: f64, memory: f64, mean: f64 },
    /// The same of the pixel's own row.
    RowRate { rise: f64, memory: f64, mean: f64 },
    /// OFF events are stamped late by `delay`.
    PolarityDelay { delay: f64 },
    /// Threshold x (1 + rise ln(i / middle)).
    Light { rise: f64, middle: f64 },
    /// Threshold x (1 + rise (2 r^2 - 1)), r from 0 (centre) to 1 (corner).
    Radius { rise: f64 },
    /// The comparator takes `strength / sqrt(|dV/dt|)` to decide, at most `most`; stamp and reset come that
    /// much later.
    SlowComparator { strength: f64, most: f64 },
    /// In a share of the pixels the threshold jumps between x (1 + jump) and x (1 - jump), each state lasting
    /// `dwell` on average.
    Telegraph { share: f64, jump: f64, dwell: f64 },
    /// Threshold x (1 + rise min(|ln i - V|, 0.3) / 0.1).
    Lag { rise: f64 },
    /// Threshold x (1 + rise) from `at` on.
    TimeStep { rise: f64, at: f64 },
    /// Threshold x (1 + rise exp(-t / decay)).
    Warming { rise: f64, decay: f64 },
    /// Threshold x (1 + rise) in the rows from `first` up to `last`.
    RowBand { rise: f64, first: usize, last: usize },
    /// Threshold x (1 + depth sin(2 pi x / period + phase)), `period` in columns.
    ColumnWave { depth: f64, period: f64, phase: f64 },
    /// OFF threshold x (1 + rise (2 r^2 - 1)), r from 0 (centre) to 1 (corner).
    RadiusOff { rise: f64 },
    /// A leak that grows in proportion to the row, `rate` ON events a second in the last one.
    RowLeak { rate: f64 },
    /// Events are lost with a chance that grows in proportion to the row, to `most` in the last one.
    RowLoss { most: f64 },
    /// In addition threshold noise of `share` of a threshold x sqrt(middle / i), at most three times `share`.
    DimNoise { share: f64, middle: f64 },
    /// Stamps of odd rows are late by `delay`.
    ParityDelay { delay: f64 },
    /// Stamps are late by depth (1 + sin(2 pi f t + phase)) / 2.
    DelayWave { depth: f64, frequency: f64, phase: f64 },
    /// Frame signal x (1 + slope (2 x / (width - 1) - 1)).
    ColumnGain { slope: f64 },
}

impl Law {
    /// What the law is called in the list of answers, in words, the covariates that are right, where it acts,
    /// and its numbers.
    pub fn answer(&self) -> Value {
        let (words, covariates, insertion, parameters): (&str, &[&str], &str, Value) = match self {
            Self::Hysteresis { rise, decay } => (
                "both thresholds are raised after an event of the pixel and relax exponentially with the \
                 time since it",
                &["time_since_last_event"],
                "comparator",
                json!({ "rise": rise, "decay_s": decay }),
            ),
            Self::FrameKick { rise, decay } => (
                "both thresholds are raised after each frame's readout of the pixel's row and relax \
                 exponentially",
                &["frame_phase"],
                "comparator",
                json!({ "rise": rise, "decay_s": decay }),
            ),
            Self::RowParity { skew } => (
                "both thresholds are higher in even rows and lower in odd ones",
                &["row_parity", "row"],
                "comparator",
                json!({ "skew": skew }),
            ),
            Self::Fatigue { rise, most, gap } => (
                "both thresholds rise with the index of the event in its burst, up to a limit",
                &["burst_index"],
                "comparator",
                json!({ "rise_per_event": rise, "most_events": most, "gap_s": gap }),
            ),
            Self::ColumnBlock { width, factors } => (
                "both thresholds are multiplied by a factor of the pixel's block of columns",
                &["column_block", "column"],
                "comparator",
                json!({ "block_width": width, "factors": factors }),
            ),
            Self::NeighbourDelay { delay, window } => (
                "stamps come late by a constant when one of the eight neighbours fired shortly before",
                &["neighbour_event", "local_rate"],
                "time",
                json!({ "delay_s": delay, "window_s": window }),
            ),
            Self::Ripple { depth, frequency, phase } => (
                "both thresholds swing as a sine of time, all pixels in phase; the light does not",
                &["ac_phase", "time"],
                "comparator",
                json!({ "depth": depth, "frequency_hz": frequency, "phase": phase }),
            ),
            Self::RowReset { per_row } => (
                "the reference is renewed later in later rows, by an amount linear in the row; stamps do \
                 not show it",
                &["row*slope", "row"],
                "reset",
                json!({ "per_row_s": per_row }),
            ),
            Self::SpatialGradient { rise, scale } => (
                "both thresholds rise with the local gradient of the log picture",
                &["spatial_gradient"],
                "comparator",
                json!({ "rise": rise, "scale_per_px": scale }),
            ),
            Self::GlobalRate { rise, memory, mean } => (
                "both thresholds rise with the event rate of the whole array in the last milliseconds",
                &["global_rate"],
                "comparator",
                json!({ "rise": rise, "memory_s": memory, "mean_rate_hz": mean }),
            ),
            Self::RowRate { rise, memory, mean } => (
                "both thresholds rise with the event rate of the pixel's row in the last milliseconds",
                &["row_rate"],
                "comparator",
                json!({ "rise": rise, "memory_s": memory, "mean_rate_hz": mean }),
            ),
            Self::PolarityDelay { delay } => (
                "OFF events are stamped late by a constant",
                &["polarity"],
                "time",
                json!({ "delay_s": delay }),
            ),
            Self::Light { rise, middle } => (
                "both thresholds grow with the logarithm of the light",
                &["photocurrent", "dn"],
                "comparator",
                json!({ "rise_per_ln": rise, "middle": middle }),
            ),
            Self::Radius { rise } => (
                "both thresholds grow with the square of the distance from the centre",
                &["radius"],
                "comparator",
                json!({ "rise": rise }),
            ),
            Self::SlowComparator { strength, most } => (
                "the comparator decides late by a constant over the root of the voltage's slope; stamp and \
                 reset come later by it",
                &["slope"],
                "comparator",
                json!({ "strength": strength, "most_s": most }),
            ),
            Self::Telegraph { share, jump, dwell } => (
                "in a share of the pixels both thresholds jump to and fro between two values at random \
                 instants",
                &["pixel", "pixel*time", "time"],
                "comparator",
                json!({ "share": share, "jump": jump, "dwell_s": dwell }),
            ),
            Self::Lag { rise } => (
                "both thresholds rise with the distance of the front-end voltage from its settled value",
                &["lag", "slope"],
                "comparator",
                json!({ "rise_per_tenth": rise }),
            ),
            Self::TimeStep { rise, at } => (
                "both thresholds are higher or lower from an instant on",
                &["time"],
                "comparator",
                json!({ "rise": rise, "at_s": at }),
            ),
            Self::Warming { rise, decay } => (
                "both thresholds relax exponentially with the time since the recording began",
                &["time"],
                "comparator",
                json!({ "rise": rise, "decay_s": decay }),
            ),
            Self::RowBand { rise, first, last } => (
                "both thresholds are higher or lower in a band of rows",
                &["row"],
                "comparator",
                json!({ "rise": rise, "first": first, "last": last }),
            ),
            Self::ColumnWave { depth, period, phase } => (
                "both thresholds swing as a sine of the column",
                &["column", "column_block"],
                "comparator",
                json!({ "depth": depth, "period_columns": period, "phase": phase }),
            ),
            Self::RadiusOff { rise } => (
                "the OFF threshold grows with the square of the distance from the centre",
                &["radius"],
                "comparator",
                json!({ "rise": rise }),
            ),
            Self::RowLeak { rate } => (
                "a leak of the reference grows in proportion to the row",
                &["row"],
                "reset",
                json!({ "rate_of_last_row_hz": rate }),
            ),
            Self::RowLoss { most } => (
                "events are lost with a chance that grows in proportion to the row",
                &["row"],
                "readout",
                json!({ "share_of_last_row": most }),
            ),
            Self::DimNoise { share, middle } => (
                "noise of the thresholds grows as one over the root of the light",
                &["photocurrent", "dn"],
                "comparator",
                json!({ "share": share, "middle": middle }),
            ),
            Self::ParityDelay { delay } => (
                "stamps of odd rows are late by a constant",
                &["row_parity", "row"],
                "time",
                json!({ "delay_s": delay }),
            ),
            Self::DelayWave { depth, frequency, phase } => (
                "stamps are late by a sine of time",
                &["ac_phase", "time"],
                "time",
                json!({ "depth_s": depth, "frequency_hz": frequency, "phase": phase }),
            ),
            Self::ColumnGain { slope } => (
                "the gain of the frames is linear in the column",
                &["column"],
                "frame",
                json!({ "slope": slope }),
            ),
        };
        json!({
            "id": "unnamed", "law": words, "covariates": covariates, "insertion": insertion,
            "parameters": parameters,
        })
    }

    /// What the dependence is as a function of its covariate, by the names of the diagnosis' formulas; none
    /// where it is none of them, or only nearly one.
    pub fn form(&self) -> Option<&'static str> {
        Some(match self {
            Self::Hysteresis { .. } | Self::FrameKick { .. } | Self::Warming { .. } => "relaxation",
            Self::RowParity { .. }
            | Self::PolarityDelay { .. }
            | Self::NeighbourDelay { .. }
            | Self::TimeStep { .. }
            | Self::ParityDelay { .. } => "step",
            Self::Ripple { .. } | Self::DelayWave { .. } => "sine",
            Self::RowReset { .. }
            | Self::GlobalRate { .. }
            | Self::RowRate { .. }
            | Self::RowLeak { .. }
            | Self::RowLoss { .. }
            | Self::ColumnGain { .. }
            | Self::Light { .. } => "linear",
            Self::Radius { .. } | Self::RadiusOff { .. } => "power",
            Self::Fatigue { .. } | Self::SpatialGradient { .. } | Self::Lag { .. } => "saturation",
            Self::SlowComparator { .. } | Self::DimNoise { .. } => "power",
            Self::ColumnBlock { .. }
            | Self::Telegraph { .. }
            | Self::RowBand { .. }
            | Self::ColumnWave { .. } => return None,
        })
    }

    /// Does the factor of the thresholds change while nothing fires?
    pub fn moves(&self) -> bool {
        !matches!(
            self,
            Self::RowParity { .. }
                | Self::ColumnBlock { .. }
                | Self::NeighbourDelay { .. }
                | Self::RowReset { .. }
                | Self::PolarityDelay { .. }
                | Self::Radius { .. }
                | Self::SlowComparator { .. }
                | Self::RowBand { .. }
                | Self::ColumnWave { .. }
                | Self::RadiusOff { .. }
                | Self::RowLeak { .. }
                | Self::RowLoss { .. }
                | Self::DimNoise { .. }
                | Self::ParityDelay { .. }
                | Self::DelayWave { .. }
                | Self::ColumnGain { .. }
        )
    }
}
