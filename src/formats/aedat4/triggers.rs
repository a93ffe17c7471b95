//! Trigger signals of an AEDAT4 file.
//!
//! A packet (`TRIG`) is one vector of tables: stamp in microseconds (i64), kind (i8). Kinds 1 and 2 are edges
//! on the input of the camera, 4 and 5 edges of its own signal generator; 6 to 9 are begin and end of frames
//! and exposures: signals of the camera about itself, no edges of a line.

use super::chain::{Chain, Packet};
use super::flat::Table;
use super::shared::Inner;
use crate::chunk::{Edge, Trigger};
use crate::error::FormatError;
use crate::losses::Losses;
use std::sync::Arc;

/// The kinds, as the format numbers them.
const KINDS: [&str; 10] = [
    "resets of the clock",
    "rising edges on the input",
    "falling edges on the input",
    "pulses on the input",
    "rising edges of the generator",
    "falling edges of the generator",
    "begins of frames",
    "ends of frames",
    "begins of exposures",
    "ends of exposures",
];

/// All trigger signals of a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Triggers {
    /// Edges: line 0 is the input, line 1 the generator.
    pub edges: Vec<Trigger>,
    /// How many of each kind.
    counts: [u64; KINDS.len()],
    /// What was damaged.
    pub losses: Losses,
}

impl Triggers {
    /// Reads them.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn new(file: &Arc<Inner>, stream: u32) -> Result<Triggers, FormatError> {
        let mut chain = Chain::new(&file.path, &file.header, file.index.end, 1 << 12)?;
        let mut found = Triggers::default();
        match &file.index.triggers {
            Some(packets) => packets.iter().try_for_each(|packet| found.add(&mut chain, packet))?,
            None => {
                let mut losses = Losses::default();
                while let Some(packet) = chain.next(&mut losses)? {
                    if packet.stream == stream {
                        found.add(&mut chain, &packet)?;
                    }
                }
            }
        }
        Ok(found)
    }

    fn add(&mut self, chain: &mut Chain, packet: &Packet) -> Result<(), FormatError> {
        if !chain.load(packet, usize::MAX, &mut self.losses)? {
            return Ok(());
        }
        let content = chain.content();
        // Pointers to one and the same table would be more triggers than the packet can hold: each takes
        // sixteen bytes.
        let root = Table::root(content, b"TRIG")
            .filter(|table| table.vector(0, 4).is_some_and(|pointers| 4 * pointers.len() <= content.len()));
        let Some(root) = root.filter(|table| table.tables(0).all(|signal| signal.is_some())) else {
            chain.spoiled(packet, "it is not the table of triggers that it should be", &mut self.losses);
            return Ok(());
        };
        for signal in root.tables(0).flatten() {
            let kind = signal.i8(1);
            let known = usize::try_from(kind).ok().filter(|&kind| kind < KINDS.len());
            let (Some(t), Some(kind)) = (signal.i64(0).checked_mul(1000), known) else {
                self.losses.add(
                    "packets with impossible triggers",
                    || packet.place(),
                    || format!("a trigger of kind {kind} is left out"),
                );
                continue;
            };
            self.counts[kind] += 1;
            let (line, edge) = match kind {
                1 => (0, Edge::Rising),
                2 => (0, Edge::Falling),
                4 => (1, Edge::Rising),
                5 => (1, Edge::Falling),
                _ => continue,
            };
            self.edges.push(Trigger { t, line, edge });
        }
        chain.proven();
        Ok(())
    }

    /// For people: "59 begins of frames, 59 ends of frames"; `None` without any.
    pub(super) fn describe(&self) -> Option<String> {
        let some: Vec<String> = self
            .counts
            .iter()
            .zip(KINDS)
            .filter(|(count, _)| **count > 0)
            .map(|(count, kind)| format!("{count} {kind}"))
            .collect();
        (!some.is_empty()).then(|| some.join(", "))
    }
}
