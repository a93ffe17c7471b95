//! Batches of pixels on the card.

use crate::adapter::{self, Opened};
use crate::layout::{Batch, Cut, batches, cells_of, cut, variant};
use crate::structs::{Params, Pixel, State};
use crate::template::{BINDINGS, LARGEST_BINDING, Real, Variant, columns, descend, last};
use photocurrent_core::NodeError;
use photocurrent_sensor::map::laid::{ATTEMPTS, Laid};
use photocurrent_sensor::map::{Elsewhere, MapSolution, MapTask};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How a card is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CardOptions {
    /// Bytes of the card's memory that are taken, at most. What does not fit at once is done in parts.
    pub pool_bytes: u64,
    /// Variances in double precision where the card has it; otherwise, and where it has none, in pairs of
    /// numbers of single precision.
    pub with_double: bool,
}

impl Default for CardOptions {
    /// 768 MiB: some 18,000 pixels of 100 ms at once.
    fn default() -> CardOptions {
        CardOptions { pool_bytes: 768 << 20, with_double: true }
    }
}

/// Threads of a workgroup, as the shaders state them.
const WORKGROUP: u32 = 64;
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

/// A card that solves pixels.
///
/// Several threads may use it at once: they lay out pixels side by side, and take turns on the card.
pub struct Card {
    opened: Opened,
    options: CardOptions,
    turn: Mutex<Turn>,
    /// Nanoseconds.
    busy: AtomicU64,
}

/// What one thread at a time has.
#[derive(Default)]
struct Turn {
    programs: BTreeMap<Variant, Program>,
    memory: Option<Memory>,
}

/// The pipelines of a variant.
struct Program {
    begin: wgpu::ComputePipeline,
    descend: wgpu::ComputePipeline,
    last: wgpu::ComputePipeline,
}

/// The card's buffers.
struct Memory {
    cells: u32,
    pixels: u64,
    /// In the order of the bindings.
    buffers: Vec<wgpu::Buffer>,
    fetched: wgpu::Buffer,
}

impl Elsewhere for Card {
    fn solve(
        &self,
        tasks: &[MapTask<'_>],
        take: &mut dyn FnMut(usize, MapSolution<'_>),
    ) -> Result<Vec<usize>, NodeError> {
        let left = Card::solve(self, tasks, true, take)?;
        Ok(left.into_iter().map(|(n, _)| n).collect())
    }
}

/// What is wanted besides log light.
#[derive(Clone, Copy)]
struct Wanted {
    evidence: bool,
    variance: bool,
}

impl Card {
    /// Opens the card that [`ADAPTER_VARIABLE`] names, or the first.
    ///
    /// # Errors
    /// When there is none, it lacks what the shaders need, or its driver refuses.
    pub fn open(options: CardOptions) -> Result<Card, NodeError> {
        let opened = Opened::open(&adapter::chosen(adapter::wanted().as_deref())?, options.with_double)?;
        Ok(Card { opened, options, turn: Mutex::default(), busy: AtomicU64::new(0) })
    }

    /// Name, driver and version.
    pub fn name(&self) -> &str {
        &self.opened.name
    }

    /// Are variances computed in double precision?
    pub fn has_double(&self) -> bool {
        self.opened.has_double
    }

    /// How long the card was at work or data went to it and back, since it was opened.
    pub fn busy(&self) -> Duration {
        Duration::from_nanos(self.busy.load(Ordering::Relaxed))
    }

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
            let wanted = Wanted { evidence: with_evidence || with_sigma, variance: with_sigma };
            for batch in batches(cuts, most_cells) {
                let (states, fetched) = self.guarded(|turn| self.run(turn, variant, &batch, wanted))?;
                batch.answers(&states, &fetched, |_| with_sigma, take);
            }
        }
        left.sort_by_key(|(n, _)| *n);
        Ok(left)
    }

    /// Cells that fit in the pool and in the largest binding.
    fn most_cells(&self) -> u32 {
        let by_binding = LARGEST_BINDING / (4 * u64::from(columns::WORK));
        u32::try_from(u64::min(self.options.pool_bytes / CELL_BYTES, by_binding)).unwrap_or(u32::MAX)
    }

    /// What `work` does on the card; a failure of the driver, which may end in a panic below, is an error.
    fn guarded<T>(&self, work: impl FnOnce(&mut Turn) -> Result<T, NodeError>) -> Result<T, NodeError> {
        self.opened.check()?;
        let mut turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let begun = Instant::now();
        let done = catch_unwind(AssertUnwindSafe(|| work(&mut turn)));
        self.busy.fetch_add(begun.elapsed().as_nanos() as u64, Ordering::Relaxed);
        self.opened.check()?;
        let done = done.unwrap_or_else(|_| Err(self.opened.failed("its driver failed")));
        if let Err(error) = &done {
            self.opened.spoil(&error.message);
        }
        done
    }

    /// Solves a batch: its states, and what is fetched of it.
    fn run(
        &self,
        turn: &mut Turn,
        variant: Variant,
        batch: &Batch,
        wanted: Wanted,
    ) -> Result<(Vec<State>, Vec<f32>), NodeError> {
        let Turn { programs, memory } = turn;
        let program = match programs.entry(variant) {
            Entry::Occupied(program) => program.into_mut(),
            Entry::Vacant(place) => place.insert(self.program(variant)?),
        };
        let count = batch.pixels.len() as u64;
        if memory.as_ref().is_none_or(|memory| memory.cells < batch.cells || memory.pixels < count) {
            let before = memory.take().map_or((0, 0), |memory| (memory.cells, memory.pixels));
            *memory = Some(self.memory(batch.cells.max(before.0), count.max(before.1))?);
        }
        let memory = memory.as_ref().ok_or_else(|| self.opened.failed("it has no memory"))?;
        let params = Params {
            end: batch.pixels.len() as u32,
            cells: batch.cells,
            with_evidence: wanted.evidence.into(),
            with_variance: wanted.variance.into(),
            ..Params::default()
        };
        let queue = &self.opened.queue;
        queue.write_buffer(&memory.buffers[0], 0, bytemuck::bytes_of(&params));
        queue.write_buffer(&memory.buffers[1], 0, bytemuck::cast_slice(&batch.pixels));
        queue.write_buffer(&memory.buffers[3], 0, bytemuck::cast_slice(&batch.given));
        queue.write_buffer(&memory.buffers[4], 0, bytemuck::cast_slice(&batch.whats));
        let longest: usize = batch.pixels.iter().map(|pixel| pixel.most_steps()).max().unwrap_or(0);
        self.dispatch(memory, &[&program.begin], params.end)?;
        for _burst in 0..(longest * ATTEMPTS).div_ceil(BURST) {
            if self.dispatch(memory, &[&program.descend; BURST], params.end)? == 0 {
                break;
            }
        }
        self.dispatch(memory, &[&program.last], params.end)?;
        self.fetch(memory, batch, wanted)
    }

    fn dispatch(
        &self,
        memory: &Memory,
        pipelines: &[&wgpu::ComputePipeline],
        pixels: u32,
    ) -> Result<u32, NodeError> {
        let Opened { device, queue, .. } = &self.opened;
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

    /// The states, and the columns of increments and, where wanted, variances.
    fn fetch(
        &self,
        memory: &Memory,
        batch: &Batch,
        wanted: Wanted,
    ) -> Result<(Vec<State>, Vec<f32>), NodeError> {
        let Opened { device, queue, .. } = &self.opened;
        let cells = u64::from(batch.cells);
        let columns = if wanted.variance { 2 } else { 1 };
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

    /// The first `count` numbers of a buffer, when all that was submitted is done.
    fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>, NodeError> {
        let slice = buffer.slice(..(count * size_of::<T>()) as u64);
        slice.map_async(wgpu::MapMode::Read, |_| {});
        let waited = self.opened.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|error| self.opened.failed(&error.to_string()))?;
        self.opened.check()?;
        let view = slice.get_mapped_range().map_err(|error| self.opened.failed(&error.to_string()))?;
        let numbers = bytemuck::pod_collect_to_vec(&view);
        drop(view);
        buffer.unmap();
        Ok(numbers)
    }

    fn program(&self, variant: Variant) -> Result<Program, NodeError> {
        let device = &self.opened.device;
        let real = if self.opened.has_double { Real::Double } else { Real::Pair };
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
        self.opened.check()?;
        Ok(program)
    }

    fn memory(&self, cells: u32, pixels: u64) -> Result<Memory, NodeError> {
        use wgpu::BufferUsages as Use;
        let device = &self.opened.device;
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
            return Err(self.opened.failed(&format!("it lacks memory: {error}")));
        }
        self.opened.check()?;
        Ok(Memory { cells, pixels, buffers, fetched })
    }
}
