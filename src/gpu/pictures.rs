//! Pixels that are solved and integrated without leaving the card: only means come back.

use crate::adapter::Opened;
use crate::card::{Card, Turn, WORKGROUP};
use crate::descent::{Memory, Unsolved, Wanted};
use crate::layout::Batch;
use crate::means::{EXPOSURES_ROOM, Integrator, LIGHT, OFFSETS, SIGMA, TIMES, grown, halves};
use crate::structs::{MeansCall, Track};
use crate::template::{LARGEST_BINDING, settle};
use photocurrent_core::{Exposure, NodeError};
use photocurrent_sensor::map::{Elsewhere, MapMeans, MapSolution, MapTask, Pictured};
use wgpu::BufferUsages as Use;

/// Makes tracks of answers, on the card.
pub(crate) struct Settler {
    pipeline: wgpu::ComputePipeline,
    tracks: Option<wgpu::Buffer>,
    brightest: Option<wgpu::Buffer>,
}

/// What comes back of a batch.
struct Fetched {
    states: Vec<crate::structs::State>,
    brightest: Vec<f32>,
    /// By exposures that were integrated together: how many, and their means.
    parts: Vec<(usize, Vec<f32>)>,
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

    fn pictures(
        &self,
        tasks: &[MapTask<'_>],
        pictured: &[Pictured],
        exposures: &[Vec<Exposure>],
        take: &mut dyn FnMut(usize, MapMeans<'_>),
    ) -> Result<Vec<usize>, NodeError> {
        let left = self.solve_pictures(tasks, pictured, exposures, take)?;
        Ok(left.into_iter().map(|(n, _)| n).collect())
    }
}

impl Card {
    /// Solves tasks and gives means of their light over the exposures of their rows; gives the places of
    /// those that are left to the processor, with the reason.
    pub(crate) fn solve_pictures(
        &self,
        tasks: &[MapTask<'_>],
        pictured: &[Pictured],
        exposures: &[Vec<Exposure>],
        take: &mut dyn FnMut(usize, MapMeans<'_>),
    ) -> Result<Vec<(usize, Unsolved)>, NodeError> {
        let (mut light, mut spread) = (Vec::new(), Vec::new());
        self.batched(tasks, &mut |variant, with_sigma, batch| {
            let wanted = Wanted { evidence: true, variance: with_sigma };
            let fetched = self.guarded(|turn| {
                let memory = self.descend(turn, variant, &batch, wanted)?;
                let fetched = self.integrated(turn, &memory, &batch, wanted, pictured, exposures)?;
                turn.keep(memory);
                Ok(fetched)
            })?;
            let (pixels, factor) = (batch.pixels.len(), if with_sigma { 2 } else { 1 });
            for (n, (cut, state)) in batch.cuts.iter().zip(&fetched.states).enumerate() {
                light.clear();
                spread.clear();
                for (count, numbers) in &fetched.parts {
                    let mut of = numbers.chunks_exact(pixels).map(|of_exposure| of_exposure[n]);
                    light.extend(of.by_ref().take(*count));
                    spread.extend(of.take((factor - 1) * count));
                }
                let (outcome, brightest) = (state.outcome(cut), f64::from(fetched.brightest[n]));
                take(cut.place, MapMeans { outcome, brightest, light: &light, spread: &spread });
            }
            Ok(())
        })
    }

    /// Tracks and means of a batch that is solved.
    fn integrated(
        &self,
        turn: &mut Turn,
        memory: &Memory,
        batch: &Batch,
        wanted: Wanted,
        pictured: &[Pictured],
        exposures: &[Vec<Exposure>],
    ) -> Result<Fetched, NodeError> {
        let opened = self.opened();
        let mut integrator = match turn.take() {
            Some(integrator) => integrator,
            None => Integrator::new(opened)?,
        };
        let mut settler = match turn.take() {
            Some(settler) => settler,
            None => Settler::new(opened)?,
        };
        let states = self.fetch(memory, batch, 0)?.0;
        let mut offsets = vec![0_u32];
        let mut t_ns: Vec<i64> = Vec::new();
        for cut in &batch.cuts {
            t_ns.extend(cut.t_ns());
            offsets.push(t_ns.len() as u32);
        }
        let row_of: Vec<u32> = batch.cuts.iter().map(|cut| pictured[cut.place].row as u32).collect();
        integrator.place(opened, &offsets, &row_of)?;
        integrator.write(opened, TIMES, &t_ns)?;
        let knots = t_ns.len() as u64;
        integrator.room(opened, LIGHT, 4 * knots)?;
        integrator.room(opened, SIGMA, if wanted.variance { 4 * knots } else { 0 })?;
        settler.run(opened, memory, &integrator, batch, pictured)?;
        let pixels = batch.pixels.len();
        let brightest = self.read::<f32>(&memory.fetched, pixels)?;
        let factor = if wanted.variance { 2 } else { 1 };
        let count = exposures.first().map_or(0, Vec::len);
        let at_once =
            (u64::min(EXPOSURES_ROOM, LARGEST_BINDING) / (4 * factor * pixels as u64).max(1)).max(1);
        let mut parts = Vec::new();
        for from in (0..count).step_by(at_once as usize) {
            let part = from..usize::min(from + at_once as usize, count);
            let of_rows: Vec<[[u32; 2]; 2]> =
                exposures.iter().flat_map(|of_row| &of_row[part.clone()]).map(halves).collect();
            let call = MeansCall {
                pixels: pixels as u32,
                exposures: part.len() as u32,
                is_linear: 1,
                with_spread: wanted.variance.into(),
                ..MeansCall::default()
            };
            parts.push((part.len(), integrator.integrate(self, &of_rows, call)?));
        }
        turn.keep(integrator);
        turn.keep(settler);
        Ok(Fetched { states, brightest, parts })
    }
}

impl Settler {
    fn new(opened: &Opened) -> Result<Settler, NodeError> {
        let source = wgpu::ShaderSource::Wgsl(settle().into());
        let module = opened.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        let pipeline = opened.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("settle"),
            layout: None,
            module: &module,
            entry_point: Some("settle"),
            compilation_options: Default::default(),
            cache: None,
        });
        opened.check()?;
        Ok(Settler { pipeline, tracks: None, brightest: None })
    }

    /// Makes tracks, and brings the brightest light of each pixel to where it is read.
    fn run(
        &mut self,
        opened: &Opened,
        memory: &Memory,
        integrator: &Integrator,
        batch: &Batch,
        pictured: &[Pictured],
    ) -> Result<(), NodeError> {
        let tracks: Vec<Track> = batch.cuts.iter().map(|cut| Track::of(&pictured[cut.place])).collect();
        let count = tracks.len() as u64;
        let storage = Use::STORAGE | Use::COPY_DST | Use::COPY_SRC;
        let of_tracks = grown(opened, &mut self.tracks, 16 * count, storage)?;
        let brightest = grown(opened, &mut self.brightest, 4 * count, storage)?;
        opened.queue.write_buffer(of_tracks, 0, bytemuck::cast_slice(&tracks));
        let of = |place: usize| integrator.buffer(opened, place);
        let [call, pixels, states, _, whats, work, ..] = &memory.buffers[..] else {
            return Err(opened.failed("it has no memory"));
        };
        let bound =
            [call, pixels, states, whats, work, of(OFFSETS)?, of_tracks, of(LIGHT)?, of(SIGMA)?, brightest];
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
        pass.dispatch_workgroups((count as u32).div_ceil(WORKGROUP), 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(brightest, 0, &memory.fetched, 0, 4 * count);
        opened.queue.submit([encoder.finish()]);
        Ok(())
    }
}

impl Track {
    fn of(pictured: &Pictured) -> Track {
        Track {
            ratio: pictured.ratio as f32,
            // Beyond what single precision has, all is plausible.
            most: f64::min(pictured.most, 1e30) as f32,
            sigma_factor: pictured.sigma_factor as f32,
            unused: 0.0,
        }
    }
}
