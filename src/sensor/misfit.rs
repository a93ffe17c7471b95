//! How far the measurements of a pixel are from what its solution predicts.

/// How far one pixel's measurements are from what its solution predicts: sums of squares of whitened
/// residuals, apart for events and frames.
///
/// Where noise is as large as assumed, the root mean squares are near 1, and smaller by what the solution has
/// taken up of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misfit {
    /// Of events: the sum of squares, each over its variance.
    pub event_square: f64,
    /// How many events that are.
    pub events: usize,
    /// Of frame values: the sum of squares, each over its variance.
    pub frame_square: f64,
    /// How many frame values that are.
    pub frames: usize,
}

impl Misfit {
    /// Counts the measurements of `other` as well.
    pub fn add(&mut self, other: &Misfit) {
        self.event_square += other.event_square;
        self.events += other.events;
        self.frame_square += other.frame_square;
        self.frames += other.frames;
    }

    /// Root mean square of the events' residuals, in standard deviations; NaN where there is no event.
    pub fn event_rms(&self) -> f64 {
        root_mean(self.event_square, self.events)
    }

    /// Root mean square of the frames' residuals, in standard deviations; NaN where there is no frame.
    pub fn frame_rms(&self) -> f64 {
        root_mean(self.frame_square, self.frames)
    }
}

fn root_mean(square: f64, count: usize) -> f64 {
    if count > 0 { (square / count as f64).sqrt() } else { f64::NAN }
}
