//! The scene as every source of it states it: log photocurrent of pixels at steady instants.

use crate::case::Case;

/// Log photocurrent of an array at steady instants, natural-log units.
#[derive(Clone, Debug)]
pub struct Light {
    /// The first instant, ns.
    pub start_ns: i64,
    /// Time between instants, ns.
    pub step_ns: i64,
    /// Number of instants.
    pub count: usize,
    /// Pixel after pixel; empty where a pixel's light is not known.
    pub log: Vec<Vec<f32>>,
}

impl Light {
    /// Instants over a recording, every `step_ns`, with no pixel's light known.
    ///
    /// # Panics
    /// When `step_ns` is not positive.
    pub fn blank(case: &Case, step_ns: i64) -> Light {
        assert!(step_ns > 0, "steps of light are positive");
        let count = ((case.span.1 - case.span.0) / step_ns + 2) as usize;
        Light { start_ns: case.span.0, step_ns, count, log: vec![Vec::new(); case.extent.pixels()] }
    }

    /// Instant number `k`, ns.
    pub fn instant(&self, k: usize) -> i64 {
        self.start_ns + k as i64 * self.step_ns
    }

    /// Log photocurrent of a pixel at any instant, by straight lines; none where it is not known.
    pub fn at(&self, pixel: usize, t_ns: i64) -> Option<f64> {
        let log = self.log.get(pixel).filter(|log| !log.is_empty())?;
        let place = ((t_ns - self.start_ns) as f64 / self.step_ns as f64).clamp(0.0, (log.len() - 1) as f64);
        let k = (place as usize).min(log.len().saturating_sub(2));
        let (a, b) = (f64::from(log[k]), f64::from(log[(k + 1).min(log.len() - 1)]));
        Some(a + (b - a) * (place - k as f64))
    }
}
