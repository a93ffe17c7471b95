//! The scene as every source of it states it: log photocurrent of pixels at steady instants.

use crate::case::Case;
use crate::picture::Picture;
use rayon::prelude::*;

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
    /// Of a moving picture, for every pixel of the array.
    ///
    /// # Panics
    /// When `step_ns` is not positive.
    pub fn of_picture(case: &Case, picture: &Picture, step_ns: i64) -> Light {
        assert!(step_ns > 0, "steps of light are positive");
        let count = ((case.span.1 - case.span.0) / step_ns + 2) as usize;
        let maps: Vec<_> = (0..count).map(|k| picture.motion.at(case.span.0 + k as i64 * step_ns)).collect();
        let of = |pixel: usize| {
            let (x, y) = case.place(pixel);
            picture.log_light(x as usize, y as usize, &maps).map_or_else(Vec::new, |log| log.iter().map(|u| *u as f32).collect())
        };
        Light { start_ns: case.span.0, step_ns, count, log: (0..case.extent.pixels()).into_par_iter().map(of).collect() }
    }

    /// Instant number `k`, ns.
    pub fn instant(&self, k: usize) -> i64 {
        self.start_ns + k as i64 * self.step_ns
    }
}
