//! Rows of frames from tracks, integrated on a graphics card.

use super::job::{DigitalNumbers, Job};
use crate::backend::BATCH_BYTES;
use crate::reconstruct::rows_of;
use crate::sampling::scale_seconds;
use photocurrent_core::series::to_bfloat16;
use photocurrent_core::{Between, Context, FrameBlock, FrameSequence, FramesMeta, NodeError, Rows};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::integrate::{Columns, ExposedRow, Integrate, RowMeans};
use photocurrent_solve::RowPicture;
use rayon::prelude::*;
use std::sync::Arc;

/// Frames and, where they are wanted, their standard deviations.
type Pair = (FrameSequence, Option<FrameSequence>);

/// A row of all frames and, where they are wanted, of their standard deviations, to write.
struct RowOut<'a> {
    row: u32,
    frames: Vec<&'a mut [f32]>,
    sigma: Vec<&'a mut [f32]>,
}

/// All frames of the context's rows. Rows that the card does not take are rendered here, and counted.
///
/// # Errors
/// When the card fails, or the user interrupts.
pub(super) fn render(
    job: &Job<'_>,
    card: &dyn Integrate,
    with_sigma: bool,
    cx: &Context,
) -> Result<Pair, NodeError> {
    let rows = cx.rows();
    cx.begin(rows.len() as u64, "rows");
    let (mut frames, mut sigma) = blank(job.meta, rows, with_sigma);
    let mut out = rows_out(&mut frames, sigma.as_mut());
    let knots = job.band.t.len() / rows.len().max(1);
    let bytes = 16 * knots + 8 * job.meta.times.len() * job.meta.row_values();
    out.par_chunks_mut((BATCH_BYTES / bytes.max(1)).max(1)).try_for_each(|out| {
        together(job, card, with_sigma, out, cx)?;
        cx.advance(out.len() as u64)
    })?;
    drop(out);
    Ok(sequences(job.meta, frames, sigma))
}

/// Blocks of frames and, where they are wanted, of their standard deviations.
fn blank(meta: &FramesMeta, rows: Rows, with_sigma: bool) -> (FrameBlock, Option<FrameBlock>) {
    let block = || FrameBlock::zeros(0..meta.times.len(), rows, meta.row_values());
    (block(), with_sigma.then(block))
}

/// Their rows, to write.
fn rows_out<'a>(frames: &'a mut FrameBlock, sigma: Option<&'a mut FrameBlock>) -> Vec<RowOut<'a>> {
    let mut of_sigma = sigma.map(rows_of).unwrap_or_default().into_iter();
    let mut sigma = || of_sigma.next().map(|(_, sigma)| sigma).unwrap_or_default();
    rows_of(frames).into_iter().map(|(row, frames)| RowOut { row, frames, sigma: sigma() }).collect()
}

fn sequences(meta: &FramesMeta, frames: FrameBlock, sigma: Option<FrameBlock>) -> Pair {
    let sequence = |block| FrameSequence::in_memory(Arc::new(meta.clone()), block);
    (sequence(frames), sigma.map(sequence))
}

/// Frames of means that are there already, in the order of the context's rows.
pub(super) fn developed(
    rows: &[RowPicture],
    meta: &FramesMeta,
    dn: DigitalNumbers,
    with_sigma: bool,
    cx: &Context,
) -> Pair {
    let (mut frames, mut sigma) = blank(meta, cx.rows(), with_sigma);
    let width = meta.row_values();
    rows_out(&mut frames, sigma.as_mut()).into_par_iter().zip(rows).for_each(|(mut out, picture)| {
        let numbers = dn.row((0, out.row), width);
        let mut spreads = picture.spread.chunks_exact(width);
        for (exposure, light) in picture.light.chunks_exact(width).enumerate() {
            let seconds = scale_seconds(meta.scale, meta.times.exposure(exposure, out.row));
            out.take(exposure, seconds, &numbers, light, spreads.next().unwrap_or(&[]));
        }
    });
    sequences(meta, frames, sigma)
}

impl RowOut<'_> {
    /// Takes means over an exposure, which count for so many seconds.
    fn take(
        &mut self,
        exposure: usize,
        seconds: f64,
        numbers: &[DigitalNumber],
        light: &[f32],
        spread: &[f32],
    ) {
        for ((value, mean), number) in self.frames[exposure].iter_mut().zip(light).zip(numbers) {
            *value = number.of(f64::from(*mean) * seconds) as f32;
        }
        let Some(sigma) = self.sigma.get_mut(exposure) else { return };
        for ((value, mean), number) in sigma.iter_mut().zip(spread).zip(numbers) {
            *value = to_bfloat16((number.gain * f64::from(*mean) * seconds) as f32);
        }
    }
}

/// Rows that go to the card together.
fn together(
    job: &Job<'_>,
    card: &dyn Integrate,
    with_sigma: bool,
    out: &mut [RowOut<'_>],
    cx: &Context,
) -> Result<(), NodeError> {
    let band = job.band;
    let columns = Columns {
        offsets: band.offsets(),
        t_ns: &band.t,
        light: &band.photocurrent,
        sigma: if with_sigma { &band.sigma } else { &[] },
        is_linear: job.between == Between::LogLinear,
    };
    let exposed: Vec<ExposedRow> = out.iter().map(|out| job.exposed(out.row)).collect();
    let seconds: Vec<Vec<f64>> = exposed.iter().map(|row| job.seconds(&row.exposures)).collect();
    let numbers: Vec<Vec<DigitalNumber>> = out.iter().map(|out| job.numbers(out.row)).collect();
    let mut take = |means: RowMeans<'_>| {
        let RowMeans { row, exposure, light, spread } = means;
        out[row].take(exposure, seconds[row][exposure], &numbers[row], light, spread);
    };
    let left = card.means(columns, &exposed, &mut take)?;
    for &n in &left {
        let RowOut { row, frames, sigma } = &mut out[n];
        job.light(*row, job.exposures(*row), frames);
        if with_sigma {
            job.sigma(*row, sigma);
        }
    }
    cx.count(
        left.len() as u64,
        "rows were rendered on the processor: too long for the card's memory, or not finite",
    );
    Ok(())
}
