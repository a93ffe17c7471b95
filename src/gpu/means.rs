//! Means of light over exposures on the card.
//!
//! Columns go to the card as they are: whole nanoseconds of 64 bits, so that limits and overlaps are exact,
//! and only light is in single precision. A row's pixels are together in a batch; a batch has as many rows as
//! fit, or some exposures of one row.

use crate::adapter::Opened;
use crate::card::Card;
use crate::structs::MeansCall;
use crate::template::{LARGEST_BINDING, means};
use photocurrent_core::{Exposure, NodeError};
use photocurrent_sensor::integrate::{Columns, ExposedRow, Integrate, RowMeans};
use std::ops::Range;
use wgpu::BufferUsages as Use;

/// The part of the pool that knots take, and that means take.
const PART_OF_POOL: u64 = 16;
/// Bytes of a knot: an instant, light and its spread.
const KNOT_BYTES: u64 = 16;
/// Exposures that a thread integrates: with them, many more threads than pixels are at work.
const PIECE: u32 = 16;
/// Threads of a workgroup, as the shader states them.
const WORKGROUP: u32 = 64;

/// Bytes of means of pixels that were solved on the card that come back at once.
pub(crate) const EXPOSURES_ROOM: u64 = 48 << 20;

/// The bindings of the shader, in order.
const CALL: usize = 0;
pub(crate) const OFFSETS: usize = 1;
const ROW_OF: usize = 2;
pub(crate) const TIMES: usize = 3;
pub(crate) const LIGHT: usize = 4;
pub(crate) const SIGMA: usize = 5;
const EXPOSURES: usize = 6;
const MEANS: usize = 7;
/// What comes back; no binding.
const FETCHED: usize = 8;

/// The shader's pipeline and buffers, which grow.
pub(crate) struct Integrator {
    pipeline: wgpu::ComputePipeline,
    buffers: Vec<Option<wgpu::Buffer>>,
}

/// Rows that go to the card together, and which of their exposures.
struct Batch {
    rows: Vec<usize>,
    exposures: Range<usize>,
    pixels: u64,
    knots: u64,
}

impl Integrate for Card {
    fn means(
        &self,
        columns: Columns<'_>,
        rows: &[ExposedRow],
        take: &mut dyn FnMut(RowMeans<'_>),
    ) -> Result<Vec<usize>, NodeError> {
        let (batches, left) = batches(columns, rows, self.pool_bytes() / PART_OF_POOL);
        for batch in batches {
            let call = call(&batch, &columns);
            let numbers = self.guarded(|turn| {
                let mut integrator = match turn.take() {
                    Some(integrator) => integrator,
                    None => Integrator::new(self.opened())?,
                };
                integrator.give(self.opened(), columns, rows, &batch)?;
                let numbers = integrator.run(self, rows, &batch, call)?;
                turn.keep(integrator);
                Ok(numbers)
            })?;
            hand_out(&numbers, rows, &batch, call, take);
        }
        Ok(left)
    }
}

/// Bytes of a number of each pixel and exposure.
fn mean_bytes(columns: &Columns<'_>) -> u64 {
    if columns.sigma.is_empty() { 4 } else { 8 }
}

fn call(batch: &Batch, columns: &Columns<'_>) -> MeansCall {
    MeansCall {
        pixels: batch.pixels as u32,
        exposures: batch.exposures.len() as u32,
        is_linear: columns.is_linear.into(),
        with_spread: (!columns.sigma.is_empty()).into(),
        ..MeansCall::default()
    }
}

/// Rows together as they fit in `room` bytes, for knots and for means; and the rows that are not taken.
fn batches(columns: Columns<'_>, rows: &[ExposedRow], room: u64) -> (Vec<Batch>, Vec<usize>) {
    let most_knots = u64::min(room / KNOT_BYTES, LARGEST_BINDING / 8);
    let most_means = u64::min(room, LARGEST_BINDING) / mean_bytes(&columns);
    let (mut batches, mut left): (Vec<Batch>, Vec<usize>) = (Vec::new(), Vec::new());
    for (n, row) in rows.iter().enumerate() {
        let (pixels, count) = (row.pixels.len() as u64, row.exposures.len());
        let range = knots_of(&columns, row);
        let knots = range.len() as u64;
        let is_finite =
            |values: &[f32]| values.get(range.clone()).unwrap_or(&[]).iter().all(|x| x.is_finite());
        if knots > most_knots || pixels > most_means || !is_finite(columns.light) || !is_finite(columns.sigma)
        {
            left.push(n);
            continue;
        }
        if pixels == 0 || count == 0 {
            continue;
        }
        let is_joined = |batch: &mut Batch| {
            let (all, of_all) = (batch.pixels + pixels, batch.knots + knots);
            let fits =
                batch.exposures == (0..count) && of_all <= most_knots && all * count as u64 <= most_means;
            if fits {
                batch.rows.push(n);
                (batch.pixels, batch.knots) = (all, of_all);
            }
            fits
        };
        if batches.last_mut().is_some_and(is_joined) {
            continue;
        }
        let at_once = usize::max((most_means / pixels) as usize, 1);
        batches.extend((0..count).step_by(at_once).map(|from| Batch {
            rows: vec![n],
            exposures: from..usize::min(from + at_once, count),
            pixels,
            knots,
        }));
    }
    (batches, left)
}

fn knots_of(columns: &Columns<'_>, row: &ExposedRow) -> Range<usize> {
    columns.offsets[row.pixels.start]..columns.offsets[row.pixels.end]
}

/// Gives what came back, row by row.
fn hand_out(
    numbers: &[f32],
    rows: &[ExposedRow],
    batch: &Batch,
    call: MeansCall,
    take: &mut dyn FnMut(RowMeans<'_>),
) {
    let (all, count) = (call.pixels as usize, call.exposures as usize);
    let mut first = 0;
    for &row in &batch.rows {
        let width = rows[row].pixels.len();
        for n in 0..count {
            let of = |n: usize| numbers.get(n * all + first..n * all + first + width).unwrap_or(&[]);
            let exposure = batch.exposures.start + n;
            take(RowMeans { row, exposure, light: of(n), spread: of(count + n) });
        }
        first += width;
    }
}

/// Start and end in halves of 32 bits, the low one first.
pub(crate) fn halves(exposure: &Exposure) -> [[u32; 2]; 2] {
    [exposure.start.0, exposure.end.0].map(|t| [t as u32, (t >> 32) as u32])
}

/// A buffer of at least so many bytes.
///
/// # Errors
/// When the card lacks memory.
pub(crate) fn grown<'a>(
    opened: &Opened,
    buffer: &'a mut Option<wgpu::Buffer>,
    bytes: u64,
    usage: Use,
) -> Result<&'a wgpu::Buffer, NodeError> {
    if buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
        // The old one is given back first.
        *buffer = None;
        let scope = opened.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        *buffer = Some(opened.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes.max(32).next_multiple_of(16),
            usage,
            mapped_at_creation: false,
        }));
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(opened.failed(&format!("it lacks memory: {error}")));
        }
    }
    buffer.as_ref().ok_or_else(|| opened.failed("it has no memory"))
}

impl Integrator {
    pub(crate) fn new(opened: &Opened) -> Result<Integrator, NodeError> {
        let device = &opened.device;
        let source = wgpu::ShaderSource::Wgsl(means().into());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("integrate"),
            layout: None,
            module: &module,
            entry_point: Some("integrate"),
            compilation_options: Default::default(),
            cache: None,
        });
        opened.check()?;
        Ok(Integrator { pipeline, buffers: (0..=FETCHED).map(|_| None).collect() })
    }

    /// A buffer of at least so many bytes.
    ///
    /// # Errors
    /// When the card lacks memory.
    pub(crate) fn room(
        &mut self,
        opened: &Opened,
        place: usize,
        bytes: u64,
    ) -> Result<&wgpu::Buffer, NodeError> {
        let usage = match place {
            CALL => Use::UNIFORM | Use::COPY_DST,
            FETCHED => Use::MAP_READ | Use::COPY_DST,
            _ => Use::STORAGE | Use::COPY_DST | Use::COPY_SRC,
        };
        grown(opened, &mut self.buffers[place], bytes, usage)
    }

    /// A buffer that is there.
    ///
    /// # Errors
    /// When it is not.
    pub(crate) fn buffer(&self, opened: &Opened, place: usize) -> Result<&wgpu::Buffer, NodeError> {
        self.buffers[place].as_ref().ok_or_else(|| opened.failed("it has no memory"))
    }

    pub(crate) fn write<T: bytemuck::NoUninit>(
        &mut self,
        opened: &Opened,
        place: usize,
        values: &[T],
    ) -> Result<(), NodeError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let buffer = self.room(opened, place, bytes.len() as u64)?;
        opened.queue.write_buffer(buffer, 0, bytes);
        Ok(())
    }

    /// Brings the knots of a batch to the card.
    fn give(
        &mut self,
        opened: &Opened,
        columns: Columns<'_>,
        rows: &[ExposedRow],
        batch: &Batch,
    ) -> Result<(), NodeError> {
        self.room(opened, TIMES, 8 * batch.knots)?;
        self.room(opened, LIGHT, 4 * batch.knots)?;
        self.room(opened, SIGMA, if columns.sigma.is_empty() { 0 } else { 4 * batch.knots })?;
        // Rows that follow each other go together.
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for &row in &batch.rows {
            let range = knots_of(&columns, &rows[row]);
            match ranges.last_mut() {
                Some(last) if last.end == range.start => last.end = range.end,
                _ => ranges.push(range),
            }
        }
        let mut at = 0;
        for range in ranges {
            let columns: [(usize, u64, &[u8]); 3] = [
                (TIMES, 8, bytemuck::cast_slice(&columns.t_ns[range.clone()])),
                (LIGHT, 4, bytemuck::cast_slice(&columns.light[range.clone()])),
                (SIGMA, 4, bytemuck::cast_slice(columns.sigma.get(range.clone()).unwrap_or(&[]))),
            ];
            for (place, size, bytes) in columns {
                if let Some(buffer) = &self.buffers[place] {
                    opened.queue.write_buffer(buffer, size * at, bytes);
                }
            }
            at += range.len() as u64;
        }
        let (mut offsets, mut row_of, mut at) = (vec![0_u32], Vec::new(), 0);
        for (n, &row) in batch.rows.iter().enumerate() {
            let pixels = &rows[row].pixels;
            for pixel in columns.offsets[pixels.start..=pixels.end].windows(2) {
                at += (pixel[1] - pixel[0]) as u32;
                offsets.push(at);
                row_of.push(n as u32);
            }
        }
        self.place(opened, &offsets, &row_of)
    }

    /// States where the knots of each pixel begin, and in which row it is.
    pub(crate) fn place(
        &mut self,
        opened: &Opened,
        offsets: &[u32],
        row_of: &[u32],
    ) -> Result<(), NodeError> {
        self.write(opened, OFFSETS, offsets)?;
        self.write(opened, ROW_OF, row_of)
    }

    /// Integrates what is on the card.
    fn run(
        &mut self,
        card: &Card,
        rows: &[ExposedRow],
        batch: &Batch,
        call: MeansCall,
    ) -> Result<Vec<f32>, NodeError> {
        let of_rows = batch.rows.iter().flat_map(|&row| &rows[row].exposures[batch.exposures.clone()]);
        let exposures: Vec<[[u32; 2]; 2]> = of_rows.map(halves).collect();
        self.integrate(card, &exposures, call)
    }

    /// Integrates pixels that are on the card over exposures, by row.
    pub(crate) fn integrate(
        &mut self,
        card: &Card,
        exposures: &[[[u32; 2]; 2]],
        call: MeansCall,
    ) -> Result<Vec<f32>, NodeError> {
        let opened = card.opened();
        let count = u64::from(call.pixels) * u64::from(call.exposures) * u64::from(1 + call.with_spread);
        self.write(opened, CALL, &[MeansCall { piece: PIECE, ..call }])?;
        self.write(opened, EXPOSURES, exposures)?;
        self.room(opened, MEANS, 4 * count)?;
        self.room(opened, FETCHED, 4 * count)?;
        let buffers: Vec<&wgpu::Buffer> = self.buffers.iter().flatten().collect();
        let [bound @ .., fetched] = &buffers[..] else { return Err(opened.failed("it has no memory")) };
        let entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
            .zip(bound)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let group = opened.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = opened.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(call.pixels.div_ceil(WORKGROUP), call.exposures.div_ceil(PIECE), 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(bound[MEANS], 0, fetched, 0, 4 * count);
        opened.queue.submit([encoder.finish()]);
        card.read::<f32>(fetched, count as usize)
    }
}
