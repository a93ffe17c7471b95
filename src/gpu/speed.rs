//! How quickly a card moves bytes: what its solutions and pictures cannot be quicker than.

use crate::card::Card;
use photocurrent_core::NodeError;
use std::time::{Duration, Instant};
use wgpu::BufferUsages as Use;

/// Bytes a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CopySpeeds {
    /// Read and written on the card, from one of its buffers to another.
    pub on_card: f64,
    /// From the processor's memory to the card.
    pub to_card: f64,
    /// Back, into memory of our own.
    pub from_card: f64,
}

impl Card {
    /// Copies `bytes`, a multiple of 16, until each way took `long`.
    ///
    /// # Errors
    /// When the card is lost, lacks memory or its driver fails.
    pub fn copy_speeds(&self, bytes: u64, long: Duration) -> Result<CopySpeeds, NodeError> {
        self.guarded(|_| {
            let opened = self.opened();
            let buffer = |usage: Use| {
                opened.device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size: bytes,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let (one, two) = (buffer(Use::COPY_SRC | Use::COPY_DST), buffer(Use::COPY_SRC | Use::COPY_DST));
            let (fetched, host) = (buffer(Use::MAP_READ | Use::COPY_DST), vec![1_u8; bytes as usize]);
            opened.check()?;
            let copy = |from: &wgpu::Buffer, to: &wgpu::Buffer, times: usize| {
                let mut encoder = opened.device.create_command_encoder(&Default::default());
                (0..times).for_each(|_| encoder.copy_buffer_to_buffer(from, 0, to, 0, bytes));
                opened.queue.submit([encoder.finish()]);
            };
            let wait = || -> Result<(), NodeError> {
                let waited = opened.device.poll(wgpu::PollType::wait_indefinitely());
                waited.map_err(|error| opened.failed(&error.to_string()))?;
                opened.check()
            };
            const AT_ONCE: usize = 16;
            let on_card = rate(2 * AT_ONCE as u64 * bytes, long, &mut || {
                copy(&one, &two, AT_ONCE);
                wait()
            })?;
            let to_card = rate(bytes, long, &mut || {
                opened.queue.write_buffer(&one, 0, &host);
                copy(&one, &two, 1);
                wait()
            })?;
            let from_card = rate(bytes, long, &mut || {
                copy(&one, &fetched, 1);
                self.read::<u8>(&fetched, bytes as usize).map(|_| ())
            })?;
            Ok(CopySpeeds { on_card, to_card, from_card })
        })
    }
}

/// Bytes a second of what moves so many each time, without the first time.
fn rate(
    bytes: u64,
    long: Duration,
    work: &mut dyn FnMut() -> Result<(), NodeError>,
) -> Result<f64, NodeError> {
    work()?;
    let (begun, mut times) = (Instant::now(), 0);
    while times == 0 || begun.elapsed() < long {
        work()?;
        times += 1;
    }
    Ok(bytes as f64 * f64::from(times) / begun.elapsed().as_secs_f64())
}
