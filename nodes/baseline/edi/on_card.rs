//! The double integral with its means taken on a graphics card.
//!
//! Events become held light here; the card takes its means over the blur of the captured frames and over the
//! exposures of the output; levels, chains and digital numbers are made here of both.

use super::{Job, Levels, RelativeLight};
use crate::backend::BATCH_BYTES;
use crate::held::TILE;
use crate::reconstruct::{nearest_frame, rows_of};
use crate::sampling::scale_seconds;
use photocurrent_core::{Context, Exposure, FrameBlock, FrameSequence, NodeError};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::integrate::{Columns, ExposedRow, Integrate, RowMeans};
use photocurrent_solve::co_located::CoLocatedEvents;
use rayon::prelude::*;
use std::sync::Arc;

/// A row of all frames, to write.
type RowOut<'a> = (u32, Vec<&'a mut [f32]>);

/// A row on its way: exposures of the captured frames, then of the output.
struct Row {
    captured: Vec<Exposure>,
    /// The captured frame that each output frame starts from, and the seconds for which its mean counts.
    starts: Vec<(usize, f64)>,
    /// Mean relative light over the blur of each captured frame.
    blurred: Vec<f32>,
    /// What one of relative light is, of each captured frame and pixel; empty until all blurs are there.
    levels: Vec<f64>,
}

/// All frames of the context's rows. Rows that the card does not take are done here, and counted.
///
/// # Errors
/// When the card fails, or the user interrupts.
pub(super) fn frames(
    job: &Job<'_>,
    card: &dyn Integrate,
    events: &CoLocatedEvents,
    frames: &FrameBlock,
    cx: &Context,
) -> Result<FrameSequence, NodeError> {
    let (rows, meta) = (cx.rows(), job.output);
    cx.begin(rows.len() as u64, "rows");
    let mut block = FrameBlock::zeros(0..meta.times.len(), rows, meta.row_values());
    let mut out = rows_of(&mut block);
    let exposures = job.captured.times.len() + meta.times.len();
    let bytes = 4 * exposures * meta.row_values();
    out.par_chunks_mut((BATCH_BYTES / bytes.max(1)).max(1)).try_for_each(|out| {
        together(job, card, events, frames, out, cx)?;
        cx.advance(out.len() as u64)
    })?;
    drop(out);
    Ok(FrameSequence::in_memory(Arc::new(meta.clone()), block))
}

/// Rows that go to the card together.
fn together(
    job: &Job<'_>,
    card: &dyn Integrate,
    events: &CoLocatedEvents,
    frames: &FrameBlock,
    out: &mut [RowOut<'_>],
    cx: &Context,
) -> Result<(), NodeError> {
    let width = job.captured.row_values();
    let mut lights: Vec<RelativeLight> = Vec::new();
    for (row, _) in out.iter() {
        let mut light = RelativeLight::default();
        events.with_row(*row, |events| {
            light.fill(&job.rule, &events, &events.by_pixel(width as u32), width, 1.0);
        })?;
        lights.push(light);
    }
    let (mut offsets, mut t_ns, mut light) = (vec![0], Vec::new(), Vec::new());
    for of_row in lights {
        offsets.extend(of_row.offsets[1..].iter().map(|offset| offset + t_ns.len()));
        t_ns.extend(of_row.t);
        light.extend(of_row.light.iter().map(|light| *light as f32));
    }
    let (mut rows, mut exposed) = (Vec::new(), Vec::new());
    for (n, (row, _)) in out.iter().enumerate() {
        let (of_row, exposures) = Row::new(job, *row);
        rows.push(of_row);
        exposed.push(ExposedRow { pixels: n * width..(n + 1) * width, exposures });
    }
    let columns = Columns { offsets: &offsets, t_ns: &t_ns, light: &light, sigma: &[], is_linear: false };
    let mut take = |means: RowMeans<'_>| {
        let (row, out) = (&mut rows[means.row], &mut out[means.row]);
        row.take(job, frames, out, means.exposure, means.light);
    };
    let left = card.means(columns, &exposed, &mut take)?;
    for &n in &left {
        let (row, out) = &mut out[n];
        events.with_row(*row, |events| job.row(*row, &events, frames, out))?;
    }
    cx.count(
        left.len() as u64,
        "rows were done on the processor: too long for the card's memory, or too bright",
    );
    Ok(())
}

impl Row {
    fn new(job: &Job<'_>, row: u32) -> (Row, Vec<Exposure>) {
        let of = |times: &photocurrent_core::FrameTimes| -> Vec<Exposure> {
            (0..times.len()).map(|l| times.exposure(l, row)).collect()
        };
        let (captured, outputs) = (of(&job.captured.times), of(&job.output.times));
        let start =
            |e: &Exposure| (nearest_frame(job.captured, row, e.mid().0), scale_seconds(job.output.scale, *e));
        let starts = outputs.iter().map(start).collect();
        let exposures = captured.iter().map(|e| job.blurred_over(*e)).chain(outputs).collect();
        (Row { captured, starts, blurred: Vec::new(), levels: Vec::new() }, exposures)
    }

    /// Takes means over an exposure, which come in order.
    fn take(
        &mut self,
        job: &Job<'_>,
        frames: &FrameBlock,
        out: &mut RowOut<'_>,
        exposure: usize,
        means: &[f32],
    ) {
        let Some(l) = exposure.checked_sub(self.captured.len()) else {
            self.blurred.extend_from_slice(means);
            return;
        };
        if self.levels.is_empty() {
            self.measure(job, frames, out.0, means.len());
        }
        let (frame, seconds) = self.starts[l];
        let levels = &self.levels[frame * means.len()..];
        for ((value, mean), level) in out.1[l].iter_mut().zip(means).zip(levels) {
            let number = DigitalNumber { black_level: job.black, gain: *level };
            *value = number.of(f64::from(*mean) * seconds) as f32;
        }
    }

    /// Levels of all pixels, now that the means over all blurs are there.
    fn measure(&mut self, job: &Job<'_>, frames: &FrameBlock, row: u32, width: usize) {
        self.levels.resize(self.captured.len() * width, f64::NAN);
        let mut levels = Levels::default();
        for left in (0..width).step_by(TILE) {
            let tile = left..width.min(left + TILE);
            levels.of_frames.clear();
            for (l, blurred) in self.blurred.chunks_exact(width).enumerate() {
                let mut mean = [f64::NAN; TILE];
                mean.iter_mut().zip(&blurred[tile.clone()]).for_each(|(mean, of)| *mean = f64::from(*of));
                let dn = |l: usize| &frames.row(l, row)[tile.clone()];
                levels.measure(l, &self.captured, dn, job.black, &[mean]);
            }
            if job.params.chain > 0.0 {
                levels.chain(job.params.chain);
            }
            for (l, level) in levels.of_frames.iter().enumerate() {
                let of = &mut self.levels[l * width..][tile.clone()];
                of.iter_mut().zip(level).for_each(|(to, level)| *to = *level);
            }
        }
    }
}

#[cfg(test)]
#[cfg(feature = "gpu")]
mod tests {
    use crate::backend::Backend;
    use crate::backend::testing::has_card;
    use crate::baseline::edi::{BaselineEdi, In, Params};
    use crate::sampling::Sampling;
    use photocurrent_core::quantity::{Duration, Rate};
    use photocurrent_core::table::Column;
    use photocurrent_core::{Node, Rows, Table, testing};
    use std::sync::Arc;

    fn frames(backend: Backend, params: &Params, contrast: Option<&Arc<Table>>) -> (Vec<f32>, Vec<String>) {
        let node = BaselineEdi::build(Params { backend, ..params.clone() }).unwrap();
        let input = In {
            events: testing::events(21, 9),
            frames: testing::frames(21, 9, 8),
            sensor: None,
            contrast: contrast.cloned(),
            at: None,
        };
        let rows = Rows { start: 2, end: 9 };
        let (out, notes) = testing::with_context(rows, &["frames"], |cx| node.run(input, cx));
        (out.unwrap().frames.read_rows(rows).unwrap().dn, notes)
    }

    #[test]
    fn pictures_are_those_of_the_processor() {
        if !has_card() {
            return;
        }
        let sampling =
            Sampling { rate: Rate::new(3_000.0), exposure: Duration::new(200_000), ..Sampling::default() };
        let plain = Params { threshold: Some(0.2), sampling, ..Params::default() };
        let blur = Some(Duration::new(9_000_000));
        for params in [
            plain.clone(),
            Params { chain: 0.7, ..plain.clone() },
            Params { blur, latency: Duration::new(40_000), ..plain.clone() },
        ] {
            let ((on_card, notes), (here, _)) =
                (frames(Backend::Gpu, &params, None), frames(Backend::Cpu, &params, None));
            assert!(here.iter().any(|dn| *dn > 100.0));
            let apart = |(a, b): (&f32, &f32)| ((a - b) / f32::max(b.abs(), 1.0)).abs();
            let most = on_card.iter().zip(&here).map(apart).fold(0.0, f32::max);
            assert!(most < 1e-5, "{most}");
            assert!(notes.len() == 1 && notes[0].starts_with("rendered on "), "{notes:?}");
        }
        // A threshold for each frame: done here.
        let thresholds = (0..8).map(|l| 0.2 + 0.01 * f64::from(l)).collect();
        let contrast = Arc::new(Table::default().with("contrast", Column::Numbers(thresholds)));
        let params = Params { threshold: None, ..plain };
        let ((on_card, notes), (here, _)) =
            (frames(Backend::Gpu, &params, Some(&contrast)), frames(Backend::Cpu, &params, Some(&contrast)));
        assert_eq!(on_card, here);
        assert!(notes.iter().any(|note| note.starts_with("7 rows were done on the processor")), "{notes:?}");
    }
}
