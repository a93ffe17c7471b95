//! Batches of pixels on the card: Gauss-Newton steps, second starts and variances.

use crate::adapter::Opened;
use crate::card::{Card, Turn, WORKGROUP};
use crate::layout::{Batch, Cut, batches, cells_of, cut, variant};
use crate::structs::{Params, Pixel, State};
use crate::template::{BINDINGS, LARGEST_BINDING, Real, Variant, columns, descend, last};
use photocurrent_core::NodeError;
use photocurrent_sensor::map::laid::{ATTEMPTS, Laid};
use photocurrent_sensor::map::{MapSolution, MapTask};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// Attempts at steps after which the pixels that are still on their way are counted.
const BURST: usize = 5;
/// Bytes of a cell: what is given and happens, work, and what steps keep at seven states.
const CELL_BYTES: u64 = 4 * (columns::GIVEN as u64 + 1 + columns::WORK as u64 + columns::MOVE as u64 + 3 * 8);

/// Why a task was left to the processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsolved {
    /// Its light is known from elsewhere.
    HasHints,
    /// It has more steps than the card's memory holds of a group of pixels.
    TooLong,
}

/// The pipelines of each variant.
#[derive(Default)]
struct Programs(BTreeMap<Variant, Program>);

/// The pipelines of a variant.
struct Program {
    begin: wgpu::ComputePipeline,
    descend: wgpu::ComputePipeline,
    last: wgpu::ComputePipeline,
}

/// The card's buffers.
pub(crate) struct Memory {
    cells: u32,
    pixels: u64,
    /// In the order of the bindings.
    pub(crate) buffers: Vec<wgpu::Buffer>,
    pub(crate) fetched: wgpu::Buffer,
}

/// What is wanted besides log light.
#[derive(Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) evidence: bool,
    pub(crate) variance: bool,
}

impl Card {
    /// Does the card take a task of this kind?
    pub fn takes(&self, task: &MapTask<'_>) -> bool {
        task.problem.hints.is_empty()
    }

    /// Solves `tasks` and gives each answer, with its place in `tasks`, to `take`, in any order; gives the
    /// places of those that are left to the processor, with the reason.
    ///
    /// # Errors
    /// When the card is lost, lacks memory or its driver fails. Answers that were given by then are right.
    pub fn solve(
        &self,
        tasks: &[MapTask<'_>],
        with_evidence: bool,
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) -> Result<Vec<(usize, Unsolved)>, NodeError> {
        self.batched(tasks, &mut |variant, with_sigma, batch| {
            let wanted = Wanted { evidence: with_evidence || with_sigma, variance: with_sigma };
            let (states, fetched) = self.guarded(|turn| {
                let memory = self.descend(turn, variant, &batch, wanted)?;
                let fetched = self.fetch(&memory, &batch, if with_sigma { 2 } else { 1 })?;
                turn.keep(memory);
                Ok(fetched)
            })?;
            batch.answers(&states, &fetched, |_| with_sigma, take);
            Ok(())
        })
    }

    /// Lays out `tasks` in batches and gives each, with its shaders and whether variances are wanted, to
    /// `work`; gives the places of the tasks that are left to the processor, rising.
    pub(crate) fn batched(
        &self,
        tasks: &[MapTask<'_>],
        work: &mut dyn FnMut(Variant, bool, Batch) -> Result<(), NodeError>,
    ) -> Result<Vec<(usize, Unsolved)>, NodeError> {
        let most_cells = self.most_cells();
        let mut left = Vec::new();
        let mut by_variant: BTreeMap<(Variant, bool), Vec<usize>> = BTreeMap::new();
        for (n, task) in tasks.iter().enumerate() {
            if self.takes(task) {
                by_variant.entry((variant(task), task.options.with_sigma)).or_default().push(n);
            } else {
                left.push((n, Unsolved::HasHints));
            }
        }
        for ((variant, with_sigma), places) in by_variant {
            let cut = |laid: &mut Laid, &n: &usize| cut(n, &tasks[n], laid).ok_or(n);
            let all: Vec<Result<Cut, usize>> = places.par_iter().map_init(Laid::default, cut).collect();
            let mut cuts = Vec::with_capacity(all.len());
            for one in all {
                match one {
                    Ok(cut) if cells_of(cut.len()) <= most_cells => cuts.push(cut),
                    Ok(cut) => left.push((cut.place, Unsolved::TooLong)),
                    Err(n) => left.push((n, Unsolved::TooLong)),
                }
            }
            batches(cuts, most_cells).into_iter().try_for_each(|batch| work(variant, with_sigma, batch))?;
        }
        left.sort_by_key(|(n, _)| *n);
        Ok(left)
    }

    /// Cells that fit in the pool and in the largest binding.
    fn most_cells(&self) -> u32 {
        let by_binding = LARGEST_BINDING / (4 * u64::from(columns::WORK));
        u32::try_from(u64::min(self.pool_bytes() / CELL_BYTES, by_binding)).unwrap_or(u32::MAX)
    }

    /// Solves a batch: its answers are in that memory then, which is to be kept.
    pub(crate) fn descend(
        &self,
        turn: &mut Turn,
        variant: Variant,
        batch: &Batch,
        wanted: Wanted,
    ) -> Result<Memory, NodeError> {
        let mut programs: Programs = turn.take().unwrap_or_default();
        let program = match programs.0.entry(variant) {
            Entry::Occupied(program) => program.into_mut(),
            Entry::Vacant(place) => place.insert(self.program(variant)?),
        };
        let count = batch.pixels.len() as u64;
        let memory = match turn.take::<Memory>() {
            Some(memory) if memory.cells >= batch.cells && memory.pixels >= count => memory,
            before => {
                let (cells, pixels) = before.map_or((0, 0), |memory| (memory.cells, memory.pixels));
                self.memory(batch.cells.max(cells), count.max(pixels))?
            }
        };
        let params = Params {
            end: batch.pixels.len() as u32,
            cells: batch.cells,
            with_evidence: wanted.evidence.into(),
            with_variance: wanted.variance.into(),
            ..Params::default()
        };
        let queue = &self.opened().queue;
        queue.write_buffer(&memory.buffers[0], 0, bytemuck::bytes_of(&params));
        queue.write_buffer(&memory.buffers[1], 0, bytemuck::cast_slice(&batch.pixels));
        queue.write_buffer(&memory.buffers[3], 0, bytemuck::cast_slice(&batch.given));
        queue.write_buffer(&memory.buffers[4], 0, bytemuck::cast_slice(&batch.whats));
        let longest: usize = batch.pixels.iter().map(|pixel| pixel.most_steps()).max().unwrap_or(0);
        self.dispatch(&memory, &[&program.begin], params.end)?;
        for _burst in 0..(longest * ATTEMPTS).div_ceil(BURST) {
            if self.dispatch(&memory, &[&program.descend; BURST], params.end)? == 0 {
                break;
            }
        }
        self.dispatch(&memory, &[&program.last], params.end)?;
        turn.keep(programs);
        Ok(memory)
    }

    fn dispatch(
        &self,
        memory: &Memory,
        pipelines: &[&wgpu::ComputePipeline],
        pixels: u32,
    ) -> Result<u32, NodeError> {
        let Opened { device, queue, .. } = self.opened();
        let mut encoder = device.create_command_encoder(&Default::default());
        let left = &memory.buffers[10];
        for pipeline in pipelines {
            encoder.clear_buffer(left, 0, None);
            let entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
                .zip(&memory.buffers)
                .map(|(binding, buffer)| wgpu::BindGroupEntry {
                    binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(pixels.div_ceil(WORKGROUP), 1, 1);
        }
        encoder.copy_buffer_to_buffer(left, 0, &memory.fetched, 0, 4);
        queue.submit([encoder.finish()]);
        Ok(self.read::<u32>(&memory.fetched, 1)?[0])
    }

    /// The states, and so many columns: increments of log light, then variances.
    pub(crate) fn fetch(
        &self,
        memory: &Memory,
        batch: &Batch,
        columns: u64,
    ) -> Result<(Vec<State>, Vec<f32>), NodeError> {
        let Opened { device, queue, .. } = self.opened();
        let cells = u64::from(batch.cells);
        let states = batch.pixels.len() * size_of::<State>();
        let mut encoder = device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&memory.buffers[2], 0, &memory.fetched, 0, states as u64);
        encoder.copy_buffer_to_buffer(
            &memory.buffers[5],
            4 * cells * u64::from(columns::SAVED),
            &memory.fetched,
            states as u64,
            4 * cells * columns,
        );
        queue.submit([encoder.finish()]);
        let words = self.read::<u32>(&memory.fetched, states / 4 + (cells * columns) as usize)?;
        let (of_states, of_columns) = words.split_at(states / 4);
        Ok((bytemuck::cast_slice(of_states).to_vec(), bytemuck::cast_slice(of_columns).to_vec()))
    }

    fn program(&self, variant: Variant) -> Result<Program, NodeError> {
        let device = &self.opened().device;
        let real = if self.opened().has_double { Real::Double } else { Real::Pair };
        let module = |source: String| {
            let source = wgpu::ShaderSource::Wgsl(source.into());
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source })
        };
        let entries: Vec<wgpu::BindGroupLayoutEntry> = (0..=BINDINGS)
            .map(|binding| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: match binding {
                        0 => wgpu::BufferBindingType::Uniform,
                        1 | 3 => wgpu::BufferBindingType::Storage { read_only: true },
                        _ => wgpu::BufferBindingType::Storage { read_only: false },
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let layout = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries });
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let (steps, variances) = (module(descend(variant)), module(last(variant, real)));
        let pipeline = |module: &wgpu::ShaderModule, entry: &str| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: Some(&layout),
                module,
                entry_point: Some(entry),
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let program = Program {
            begin: pipeline(&steps, "begin"),
            descend: pipeline(&steps, "descend"),
            last: pipeline(&variances, "last"),
        };
        self.opened().check()?;
        Ok(program)
    }

    fn memory(&self, cells: u32, pixels: u64) -> Result<Memory, NodeError> {
        use wgpu::BufferUsages as Use;
        let device = &self.opened().device;
        let scope = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let column = 4 * u64::from(cells);
        let (of_pixels, of_states) = (pixels * size_of::<Pixel>() as u64, pixels * size_of::<State>() as u64);
        let buffer = |size: u64, usage: Use| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size: size.next_multiple_of(16),
                usage,
                mapped_at_creation: false,
            })
        };
        let storage = |size: u64| buffer(size, Use::STORAGE | Use::COPY_DST | Use::COPY_SRC);
        let buffers = vec![
            buffer(size_of::<Params>() as u64, Use::UNIFORM | Use::COPY_DST),
            storage(of_pixels),
            storage(of_states),
            storage(column * u64::from(columns::GIVEN)),
            storage(column),
            storage(column * u64::from(columns::WORK)),
            storage(column * 8),
            storage(column * 8),
            storage(column * u64::from(columns::MOVE)),
            storage(column * 8),
            storage(16),
        ];
        let fetched = buffer(of_states + 2 * column, Use::MAP_READ | Use::COPY_DST);
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(self.opened().failed(&format!("it lacks memory: {error}")));
        }
        self.opened().check()?;
        Ok(Memory { cells, pixels, buffers, fetched })
    }
}
