//! The integration tests, as one binary. What belongs where:
//!
//! - `browser`: the pages in a real browser: the report of a run, the page of a diagnosis, one that plays.
//! - `circles`: modules that import each other.
//! - `code_map`: the tables of docs/architecture.md against the tree.
//! - `commands`: the commands in README.md and docs/ run.
//! - `conformance`: every node kind keeps the promises that all of them make.
//! - `pack`: a finished run as one file, run on another machine.
//! - `pages`: the pages of README.md and docs/, their code blocks and links.
//! - `play`: pages that play a recording or a run, by `photocurrent play`.
//! - `manifests`: every mistake in a manifest gives its message (`manifests/bad`).
//! - `pipelines`: the pipelines that people run, and their ablations, do run.
//! - `cache`: what runs again after a change, and what does not.
//! - `crash`: kills at random moments, two runs at once, damage: never a wrong artefact.
//! - `determinism`: the same bits for any number of threads, any band height, any machine.
//! - `diagnosis`: `photocurrent diagnose`, from a recording to its report.
//! - `colour`: colour frames and mosaics, from a scene to pictures by way of a recording.
//! - `files`: what a command does with a file of another kind, with mistakes in every line, with streams on
//!   two clocks.
//! - `expect`: bounds on scores, and the exit code of a run that breaks one.
//! - `examples`: the programs of `examples/`.
//! - `figures`: the tables of README.md and docs/ are what their commands print.
//! - `first_run`: `init` and `run` on files of every kind, `convert` there and back.
//! - `fuzzed`: changed files of every format through `init` and `run`.
//! - `inspect`: several files as one recording, exit codes, the form of `--json`.
//! - `instead`: files that are no recordings, recordings with unusual conventions.
//! - `films`: pictures as light, from files to events.
//! - `lengths`: lines and functions that can be read next to another file.
//! - `learned`: the manifests of methods whose networks are elsewhere.
//! - `pairing`: pictures with the pulses of a trigger line, or with stamps, of which some are missing.
//! - `parts`: rows made apart and merged are the bytes of one process.
//! - `progress`: what a run shows while it goes, and `run --report` and `--confirm`.
//! - `readers`: the Python and Octave readers of docs/readers against what the command writes.
//! - `readme`: the commands of README.md exist; the changelog has a head.
//! - `recordings`: input data that are empty, odd, damaged or wrong.
//! - `reports`: pages of finished runs, by `photocurrent report`.
//! - `runs`: past runs of a manifest in one table.
//! - `situations`: what real users met: units, sizes, pauses, strays, mirrored and shifted pictures; `disc`
//!   makes their recording.
//! - `tables`: scores as tables and figures, by `photocurrent table`.
//! - `direction`: which crate may depend on which; `tidy`: the invariants of docs/architecture.md.
//! - `words`: the words of docs/vocabulary.md, and none that were retired.

mod browser;
mod cache;
mod circles;
mod code_map;
mod colour;
mod commands;
mod conformance;
mod crash;
mod determinism;
mod diagnosis;
mod direction;
mod disc;
mod examples;
mod expect;
mod figures;
mod files;
mod films;
mod first_run;
mod fuzzed;
mod inspect;
mod instead;
mod learned;
mod lengths;
mod manifests;
mod pack;
mod pages;
mod pairing;
mod parts;
mod pipelines;
mod play;
mod progress;
mod readers;
mod readme;
mod recordings;
mod reports;
mod runs;
mod situations;
mod support;
mod tables;
mod tidy;
mod two_cameras;
mod words;
