//! The engine: from a manifest's text to results in the cache. It knows graphs, not sensors: node kinds come
//! in as a catalogue.
//!
//! Stages as types, in reading order:
//!
//! - `manifest`: the text as written, every key with its line.
//! - `resolve`, `ablation`, `pipeline`: overlays laid over each other; [`Project`] holds one [`Pipeline`] per
//!   variant.
//! - `typed`, `planner`, `plan`: kinds, sockets and metas checked; a [`Plan`] holds every task once, whatever
//!   number of variants share it.
//! - `blocks`: a long recording cut in time, and what its blocks give joined.
//! - `lacking`: what sensor descriptions do not state, reported in one piece.
//! - `key`, `mod@status`, `mod@explain`: what a result depends on, whether the cache has it, and why not.
//! - `schedule`, `export`, `observer`, `outcome`: [`run`] it, watch it, see what came of it.
//! - `expect`: bounds on scores, and whether they hold.
//! - `parts`: some rows by themselves, and their union.
//! - [`mod@graph`], `schema`: pictures of a pipeline, and the manifest's JSON Schema for editors.
//!
//! Every mistake of a manifest is reported at its place, all at once, before anything runs:
//!
//! ```
//! use photocurrent_core::Catalogue;
//! use photocurrent_engine::{Plan, Selection};
//! let folder = tempfile::tempdir().unwrap();
//! let path = folder.path().join("m.toml");
//! let text = "format = 1\n[nodes.a]\nkind = \"read/nothing\"\n[nodes.b]\nkind = 7\n";
//! std::fs::write(&path, text).unwrap();
//! let (catalogue, all) = (Catalogue::new(Vec::new()), Selection::default());
//! let problems = Plan::load(&path, &[], &catalogue, &all).err().unwrap();
//! let line = |problem: &photocurrent_core::document::Problem| problem.at.as_ref().unwrap().line_column().0;
//! let lines: Vec<usize> = problems.iter().map(line).collect();
//! assert_eq!(lines, [5, 3], "{problems:?}");
//! ```

#![cfg_attr(not(test), warn(unreachable_pub))]

mod ablation;
mod blocks;
mod budget;
mod expect;
mod explain;
mod export;
pub mod graph;
mod key;
mod lacking;
mod manifest;
mod observer;
mod outcome;
mod overlay;
mod parts;
mod pipeline;
mod plan;
mod planner;
mod resolve;
mod schedule;
mod schema;
mod status;
mod task;
mod typed;

#[cfg(test)]
mod tests;

pub use ablation::Ablation;
pub use blocks::{Blocks, Extract, Source, node_of};
pub use budget::machine_memory;
pub use expect::{Bound, Judged, Statistic, Verdict};
pub use explain::{Explanation, explain};
pub use export::{STAMP, read_stamp};
pub use graph::{Drawing, GraphFormat, graph};
pub use manifest::ManifestFile;
pub use observer::{End, Observer, Unobserved};
pub use outcome::{Outcome, TaskOutcome};
pub use parts::{PartEnd, join, run_part};
pub use pipeline::Pipeline;
pub use plan::{Plan, Selection};
pub use resolve::{Project, manifest_id};
pub use schedule::{Keep, Options, run};
pub use schema::manifest_schema;
pub use status::{State, TaskStatus, status};
pub use task::{LeftOut, PlannedVariant, Task, TaskId, TaskInput};
