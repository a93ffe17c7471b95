//! The photocurrent command: arguments, exit codes, what the terminal shows. Nothing numerical.
//!
//! Data go to stdout, talk to stderr. Exit codes: 0 done, 1 a node failed, 2 manifest or usage error (nothing
//! ran), 3 input data failed a check, 4 an ablation finished with failed variants, 5 a score is outside its
//! bound (`expect`), 130 interrupted (artefacts intact).

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod args;
mod cache;
mod case;
mod check;
mod common;
mod convert;
mod declared;
mod diagnose;
mod effects;
pub mod embed;
mod expect;
mod failure;
mod file_kind;
mod graph;
mod help;
mod init;
mod inspect;
mod nodes;
mod numbers;
mod pack;
mod parts;
mod plan;
mod play;
mod problems;
mod progress;
mod report;
mod run;
mod run_record;
mod runs;
mod table;
mod tables;
mod terminal;
mod unpack;

use crate::terminal::say;
use args::{Args, Command};
use clap::FromArgMatches;
use failure::{Done, Failure};
use std::ffi::OsString;

/// Runs one command to its end and returns the exit code. `arguments` begin with the name of the program;
/// wrong ones, `--help` and `--version` end the process.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let args = Args::from_arg_matches(&help::command().get_matches_from(arguments))
        .unwrap_or_else(|error| error.exit());
    code_of(execute(&args.command))
}

fn execute(command: &Command) -> Done {
    match command {
        Command::Init(options) => init::init(options),
        Command::Convert(options) => convert::convert(options),
        Command::Run(options) => run::run(options),
        Command::Merge(options) => run::merge(options),
        Command::Plan(options) => plan::plan(options),
        Command::Explain(options) => plan::explain(options),
        Command::Check(options) => check::check(options),
        Command::Table(options) => table::table(options),
        Command::Report(options) => report::report(options),
        Command::Runs(options) => runs::runs(options),
        Command::Play(options) => play::play(options),
        Command::Graph(options) => graph::graph(options),
        Command::Inspect(options) => inspect::inspect(options),
        Command::Diagnose(options) => diagnose::diagnose(options),
        Command::Nodes(options) => nodes::nodes(options),
        Command::Effects(options) => effects::effects(options),
        Command::Schema(options) => nodes::schema(options),
        Command::Man(options) => help::man(options),
        Command::Completions(options) => help::completions(options),
        Command::Cache(options) => cache::cache(options),
    }
}

/// The exit code; why there is no other is reported on stderr.
fn code_of(done: Done) -> u8 {
    match done {
        Ok(code) => code,
        Err(Failure::Problems(found)) => {
            problems::show(&found);
            2
        }
        Err(Failure::Other { message, code }) => {
            say!("error: {message}");
            code
        }
    }
}
