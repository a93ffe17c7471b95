//! A card, opened: its memory and errors, and threads that take turns on it.

use crate::adapter::{self, Opened};
use photocurrent_core::NodeError;
use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How a card is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CardOptions {
    /// Bytes of the card's memory that a solution takes, at most; means of light take an eighth of it
    /// besides. What does not fit at once is done in parts.
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

/// What one thread at a time has: pipelines and buffers on the card, one of each kind.
#[derive(Default)]
pub(crate) struct Turn(HashMap<TypeId, Box<dyn Any + Send>>);

impl Turn {
    /// What was kept of a kind. It is kept again when work with it is done; where that failed, nothing is
    /// computed any more.
    pub(crate) fn take<T: Any>(&mut self) -> Option<T> {
        let kept = self.0.remove(&TypeId::of::<T>())?;
        (kept as Box<dyn Any>).downcast().ok().map(|kept: Box<T>| *kept)
    }

    /// Keeps it for who has the next turn.
    pub(crate) fn keep<T: Any + Send>(&mut self, kept: T) {
        self.0.insert(TypeId::of::<T>(), Box::new(kept));
    }
}

/// Threads of a workgroup, as the shaders state them.
pub(crate) const WORKGROUP: u32 = 64;

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

    pub(crate) fn opened(&self) -> &Opened {
        &self.opened
    }

    /// [`CardOptions::pool_bytes`].
    pub(crate) fn pool_bytes(&self) -> u64 {
        self.options.pool_bytes
    }

    /// What `work` does on the card; a failure of the driver, which may end in a panic below, is an error.
    pub(crate) fn guarded<T>(
        &self,
        work: impl FnOnce(&mut Turn) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
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

    /// The first `count` numbers of a buffer, when all that was submitted is done.
    pub(crate) fn read<T: bytemuck::Pod>(
        &self,
        buffer: &wgpu::Buffer,
        count: usize,
    ) -> Result<Vec<T>, NodeError> {
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
}
