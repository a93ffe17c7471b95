//! How long each knot's hold lies inside each exposure.
//!
//! The predicted digital number is `black_level + gain * sum_k i_k T_lk`, with `T_lk` this table: it depends
//! on times only, so it is filled once per pixel and every iteration is then a sum. Source: Eq. (5) with the
//! zero-order hold of Section 4.1; the first knot also holds before itself, the last one for ever.

use super::problem::PixelProblem;

/// Seconds of overlap, one row per frame sample, one column per knot.
#[derive(Clone, Debug, Default)]
pub(super) struct Overlap {
    seconds: Vec<f64>,
    knots: usize,
    /// Per row, how many leading columns can differ from zero. Gradients beyond are zero too: the sweep skips
    /// them.
    used: Vec<usize>,
}

impl Overlap {
    /// Fills the table for `problem`, reusing its storage. A problem without knots gets one column.
    pub(super) fn fill(&mut self, problem: &PixelProblem<'_>) {
        let knots = problem.t_s.len().max(1);
        self.knots = knots;
        self.seconds.clear();
        self.used.clear();
        for frame in problem.frames {
            let row_start = self.seconds.len();
            let mut used = 1;
            for k in 0..knots {
                let from = if k == 0 { f64::NEG_INFINITY } else { problem.t_s[k] };
                let to = if k + 1 < knots { problem.t_s[k + 1] } else { f64::INFINITY };
                let from = if from > frame.start_s { from } else { frame.start_s };
                let to = if to < frame.end_s { to } else { frame.end_s };
                let seconds = if to > from { to - from } else { 0.0 };
                if seconds > 0.0 {
                    used = k + 1;
                }
                self.seconds.push(seconds);
            }
            debug_assert_eq!(self.seconds.len(), row_start + knots);
            self.used.push(used);
        }
    }

    /// The overlaps of frame sample `l` with every knot that can matter, from the first one on.
    pub(super) fn row(&self, l: usize) -> &[f64] {
        let start = l * self.knots;
        &self.seconds[start..start + self.used[l]]
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::problem;
    use super::super::{FrameSample, PixelProblem};
    use super::*;
    use crate::exposure::HeldTrack;
    use photocurrent_core::Exposure;

    #[test]
    fn overlaps_agree_with_the_exact_exposure_integral() {
        let frames = [(0.0, 1e-3), (2.5e-3, 4e-3), (4e-3, 9e-3)].map(|(start_s, end_s)| FrameSample {
            start_s,
            end_s,
            dn: 0.0,
            weight: 1.0,
        });
        let t_s = [5e-4, 3e-3, 5e-3];
        let problem = PixelProblem { t_s: &t_s, steps: &[0.0; 3], frames: &frames, ..problem() };
        let photocurrent = [2.0, 0.5, 7.0];
        let mut overlap = Overlap::default();
        overlap.fill(&problem);
        for (l, (start_ns, end_ns)) in
            [(0, 1_000_000), (2_500_000, 4_000_000), (4_000_000, 9_000_000)].iter().enumerate()
        {
            let exposure = Exposure::new(*start_ns, *end_ns);
            let exact = HeldTrack::new(&[500_000, 3_000_000, 5_000_000], &photocurrent).integral(exposure);
            let sum: f64 = overlap.row(l).iter().zip(photocurrent).map(|(seconds, i)| seconds * i).sum();
            assert!((sum - exact).abs() < 1e-17);
        }
    }

    #[test]
    fn columns_after_the_exposure_are_left_out() {
        let frames = [FrameSample { start_s: 0.0, end_s: 1e-3, dn: 0.0, weight: 1.0 }];
        let t_s = [5e-4, 3e-3, 5e-3];
        let mut overlap = Overlap::default();
        overlap.fill(&PixelProblem { t_s: &t_s, steps: &[0.0; 3], frames: &frames, ..problem() });
        assert_eq!(overlap.row(0), [1e-3]);
    }
}
