//! A frame of the sheet.

/// A frame that is shown.
pub(super) struct Shown {
    pub(super) frame: usize,
    pub(super) t_ns: i64,
    /// Values as [row][x][channel].
    pub(super) dn: Vec<f32>,
}

impl Shown {
    /// The same light as a frame of another exposure would read it.
    pub(super) fn exposed(&mut self, from_ns: i64, to_ns: i64, black: f64) {
        if from_ns != to_ns {
            let ratio = to_ns as f64 / from_ns as f64;
            self.dn.iter_mut().for_each(|dn| *dn = (black + (f64::from(*dn) - black) * ratio) as f32);
        }
    }
}
