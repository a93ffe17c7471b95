//! From where on something is a finding: one place for all limits, each with its reason.

/// The limits. [`Limits::default`] holds the values that the reasons are about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// With fewer events nothing is said of rates and stamps: shares of a handful mean nothing.
    pub fewest_events: u64,
    /// Mean rate of a pixel, Hz, from which stamps must be of another unit. The fastest read-out known gives
    /// a thousand events a pixel and second with every pixel firing; simulators have no read-out, and five
    /// times that still has room. Microseconds that are taken for nanoseconds make a thousandfold.
    pub fastest_pixel_hz: f64,
    /// Rate of the whole array, events per second, from which stamps must be of another unit: three times the
    /// fastest read-out known.
    pub fastest_array_hz: f64,
    /// Mean rate of a pixel, Hz, below which stamps may be of another unit: the darkest noise known is a
    /// thousandth of a hertz, and a thousandth of that is none.
    pub slowest_pixel_hz: f64,
    /// Time from an event of a pixel to its next of the same sign, ns, below which one in a hundred may lie:
    /// blind times are tens of nanoseconds at least in fiction, microseconds in silicon.
    pub shortest_interval_ns: f64,
    /// Frames per second that no camera of whole pictures makes with events.
    pub fastest_frames_hz: f64,
    /// Share of ON events above which (or of OFF events) one polarity is as good as missing.
    pub one_polarity: f64,
    /// Share of equal stamps from which they count as clumps, where also the middle step is `clump_step_ns`.
    /// A read-out that gives a row one stamp has nine in ten equal and steps of microseconds: that is its
    /// resolution. Clumps a tenth of a millisecond apart are a simulator's frames or a poll.
    pub clump_share: f64,
    /// See `clump_share`, ns.
    pub clump_step_ns: i64,
    /// Share of equal stamps that is reported as a fact: latencies below the step cannot be seen.
    pub equal_share: f64,
    /// Steps of stamps that are reported when this many times the format's own.
    pub coarse_times: i64,
    /// Time going back further than this, ns, is no jitter of a read-out: packets of a driver are a few
    /// milliseconds.
    pub back_ns: i64,
    /// A step back within this share of a counter's range is that counter starting again.
    pub wrap_share: f64,
    /// Share of stamps on the grid of single-precision seconds from which they were such: by chance it is
    /// three in eight.
    pub float_share: f64,
    /// Stamps that decide that, at least.
    pub float_fewest: u64,
    /// Share of all events within `stray_span` of the span from which the others are strays: more of them,
    /// further away, are a second part of the recording.
    pub stray_share: f64,
    /// See there.
    pub stray_span: f64,
    /// Share of events of hot pixels from which they are a hazard: below they only cost time.
    pub hot_share: f64,
    /// Share of events that are there twice from which it is no chance.
    pub duplicate_share: f64,
    /// Share of in-pixel times after their off-pixel ones that is no rounding.
    pub early_share: f64,
    /// Coordinates that reach less than this share of the stated width and height are of another size.
    pub used_share: f64,
    /// Share of values that are not numbers from which frames are useless; fewer may be marked so (NaN = not
    /// known).
    pub nan_share: f64,
    /// Share of values below zero from which frames cannot be light: noise about black makes half of a dark
    /// frame negative at most.
    pub negative_share: f64,
    /// Share of values below zero that is reported.
    pub some_negative: f64,
    /// Share of clipped values that is reported: clipped light is lost.
    pub clipped_share: f64,
    /// Share of one and the same frame value from which frames hold no picture.
    pub clipped_most: f64,
    /// Frames that repeat the one before, as a share, from which the film was made from another rate.
    pub repeated_share: f64,
    /// Shortest overlap of events and frames, as a share of the shorter span, that is no hazard.
    pub overlap_share: f64,
    /// A peak of the rate at one phase of the frame period, over the mean, that is reported where it is sure:
    /// a tenth more is nothing that a method would notice.
    pub phase_peak: f64,
    /// And one that is a hazard.
    pub phase_strong: f64,
    /// How sure the peak must be, in standard errors from frame to frame: the best of 64 bins of ten frames
    /// is that far off once in a thousand recordings.
    pub phase_sigma: f64,
    /// How sure events in step with the readout of the rows must be, in standard errors over eight groups of
    /// frames: chance is that far off once in a thousand recordings.
    pub readout_sigma: f64,
    /// Frames that decide that, at least: in three frames much is in step by chance.
    pub phase_fewest: u64,
    /// Events later than frames by more than this share of the frame period are reported as a hazard: a shift
    /// of a twentieth of a period is visible. Simulated recordings without an offset, whose row time and
    /// front end are stated, stay below it (`pipelines/calibration/inspect.py`, docs/inspect.md).
    pub late_share: f64,
    /// And by more than this, ns, where no front end is stated: front ends in dim light are late by
    /// milliseconds, and that is physics which a description states.
    pub late_ns: f64,
    /// And by more than this part of what a stated front end explains: light that steps comes ln 2 of the
    /// time constant late, light that rises steadily all of it, and a scene has both.
    pub late_explained: f64,
    /// Correlation below which half of the exposure is added to that.
    pub late_correlation: f64,
    /// Correlation of events and frames from which their shift is reported.
    pub correlation: f64,
    /// Change of the shift over the recording, as a share of the frame period, that is reported
    /// (`pipelines/calibration/inspect.py`, docs/inspect.md).
    pub drift_share: f64,
    /// And beyond this part of the front end's delay, or of `late_ns` where none is stated: when something
    /// dark moves after something bright, events are later by what physics delays.
    pub drift_explained: f64,
    /// Pairs of frames that decide that, at least: with fewer, what moves early and what moves late are other
    /// things, with other latencies.
    pub drift_pairs: usize,
    /// By how much the correlation with the drift must exceed the one without: of a drift below a twentieth
    /// of a period there is no more to gain than chance gains.
    pub drift_gain: f64,
    /// Event pixels from which a shift of the frames against the events is a hazard: less is a matter of the
    /// middle of a pixel.
    pub displaced_px: f64,
    /// By how much the correlation there must exceed the one without a shift, each at the offset in time that
    /// suits it best, and both at the one that suits no shift (`pipelines/calibration/inspect.py`,
    /// docs/inspect.md).
    pub displaced_gain: f64,
    /// By how much the correlation with a mirrored picture must exceed the one as it is.
    pub mirrored: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            fewest_events: 1000,
            fastest_pixel_hz: 5_000.0,
            fastest_array_hz: 4e9,
            slowest_pixel_hz: 1e-6,
            shortest_interval_ns: 50.0,
            fastest_frames_hz: 30_000.0,
            one_polarity: 0.999,
            clump_share: 0.9,
            clump_step_ns: 100_000,
            equal_share: 0.05,
            coarse_times: 2,
            back_ns: 100_000_000,
            wrap_share: 0.02,
            float_share: 0.99,
            float_fewest: 1000,
            stray_share: 0.98,
            stray_span: 0.02,
            hot_share: 0.05,
            duplicate_share: 0.01,
            early_share: 0.01,
            used_share: 0.5,
            nan_share: 0.5,
            negative_share: 0.5,
            some_negative: 0.01,
            clipped_share: 0.01,
            clipped_most: 0.9,
            repeated_share: 0.1,
            overlap_share: 0.5,
            phase_peak: 1.2,
            phase_strong: 1.5,
            phase_sigma: 6.5,
            readout_sigma: 5.0,
            phase_fewest: 6,
            late_share: 0.06,
            late_ns: 2.5e6,
            late_explained: 0.35,
            late_correlation: 0.75,
            correlation: 0.3,
            drift_share: 0.05,
            drift_explained: 0.5,
            drift_pairs: 12,
            drift_gain: 0.0003,
            displaced_px: 0.75,
            displaced_gain: 0.02,
            mirrored: 0.2,
        }
    }
}
