//! The arguments: what clap turns into help, completions and checks.

use crate::numbers::bytes;
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use photocurrent_core::Rows;
use photocurrent_core::quantity::Duration;
use photocurrent_formats::TimeUnit;
use photocurrent_formats::trim::Crop;
use std::path::PathBuf;

/// Solves for the photocurrent of every pixel of a hybrid frame and event sensor.
#[derive(Parser)]
#[command(version, about, long_about = None, max_term_width = 110)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

/// The first lines stand in the first page of help (help.rs): 52 characters at most.
#[derive(Subcommand)]
pub enum Command {
    /// Write a runnable manifest for your recording
    ///
    /// What the files do not state is proposed and marked with FILL.
    Init(InitOptions),
    /// Run a pipeline or an ablation
    ///
    /// What the cache has is not run again.
    Run(RunOptions),
    /// Show what a run would do, and why; writes nothing
    Plan(PlanOptions),
    /// Say why a node would run again
    Explain(ExplainOptions),
    /// Find mistakes in a manifest, recording, description
    ///
    /// Nothing is run, and every mistake is reported at once.
    Check(CheckOptions),
    /// Join rows that were run apart (cluster)
    ///
    /// Joins what `run --rows --part` made of some rows each, and runs the rest of the pipeline.
    Merge(MergeOptions),
    /// List, trim, verify the cache; pass results on
    Cache(CacheOptions),
    /// Make one HTML page of finished runs
    ///
    /// Scores, pictures to compare, curves, graph, provenance.
    Report(ReportOptions),
    /// Print scores: Markdown, CSV, LaTeX, JSON
    Table(TableOptions),
    /// Print past runs: when, what was set, scores
    Runs(RunsOptions),
    /// Draw the graph of a pipeline
    Graph(GraphOptions),
    /// Show what recordings hold, and their data hazards
    Inspect(InspectOptions),
    /// Make one HTML page that plays a recording or a run
    ///
    /// Events, frames and, for a run, what was reconstructed, side by side in time.
    Play(crate::play::options::PlayOptions),
    /// Write a recording, or a part, in another format
    Convert(ConvertOptions),
    /// Say where recording and sensor description differ
    ///
    /// Names the physics that the description lacks, with its evidence, or says why it cannot.
    Diagnose(DiagnoseOptions),
    /// List node kinds, or print the manual of one
    Nodes(NodesOptions),
    /// List sensor effects, or print the page of one
    Effects(EffectsOptions),
    /// Print the JSON Schema of manifests, for editors
    Schema(SchemaOptions),
    /// Print a manual page, or write all of them
    Man(ManOptions),
    /// Print completions for a shell
    Completions(CompletionOptions),
}

/// Which part of which manifest.
#[derive(ClapArgs, Clone)]
pub struct Target {
    /// The pipeline, a TOML file
    pub manifest: PathBuf,
    /// Lay a value over the manifest: nodes.solve.params.cis_weight=2
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub sets: Vec<String>,
    /// Only variants of an ablation with this name, or part of it: front_end=on
    #[arg(long = "variant", value_name = "NAME")]
    pub variants: Vec<String>,
    /// Only these nodes and what they need
    #[arg(long = "to", value_name = "NODE")]
    pub to: Vec<String>,
    /// Memory that data may take, such as 800MB or 8GiB: what needs more at a time is refused before anything
    /// runs [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub memory: Option<u64>,
    /// Where results are kept for later runs
    #[arg(long, value_name = "FOLDER", default_value = ".photocurrent")]
    pub cache: PathBuf,
    /// Where files for you are written [default: out/NAME of the manifest]
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProgressStyle {
    /// Bars on a terminal, plain lines elsewhere
    Auto,
    /// A line when a node begins and when it ends
    Plain,
    /// One JSON object a line, for programs
    Json,
    /// Nothing
    None,
}

#[derive(ClapArgs)]
pub struct InitOptions {
    /// The recording; its frames and their stamps when they lie elsewhere; calibrations (.yaml) and biases
    /// (.bias)
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// The manifest to write; the sensor description is written to the same folder
    #[arg(short, long, value_name = "FILE", default_value = "photocurrent.toml")]
    pub output: PathBuf,
    /// What the files do not say
    #[command(flatten)]
    pub declared: crate::declared::DeclaredOptions,
    /// Findings that are no reason to refuse the recording, by their id, such as one_polarity
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub accept: Vec<String>,
    /// Replace a manifest that is there
    #[arg(long)]
    pub force: bool,
}

/// What a recording is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Written {
    /// This project's HDF5 recording: events, frames, sensor description
    Recording,
    /// DSEC HDF5: events
    Dsec,
    /// Text with a header: events
    Csv,
    /// Prophesee RAW, EVT3: events
    Evt3,
}

#[derive(ClapArgs)]
pub struct ConvertOptions {
    /// The recording
    pub input: PathBuf,
    /// The file to write: .h5, .csv, .txt or .raw
    pub output: PathBuf,
    /// What to write [default: by the ending of the name]
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub to: Option<Written>,
    /// Only these pixels, numbered from 0 afterwards
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = crop)]
    pub crop: Option<Crop>,
    /// Leave out what was stamped before this time, from the earliest stamp: 250ms
    #[arg(long, value_name = "TIME")]
    pub start: Option<Duration>,
    /// Leave out what was stamped at or after this time
    #[arg(long, value_name = "TIME")]
    pub end: Option<Duration>,
    /// Unit of the stamps in a text file that is written: s, ms, us or ns
    #[arg(long, value_name = "UNIT", value_parser = crate::declared::word::<TimeUnit>, default_value = "us")]
    pub unit: TimeUnit,
    /// Count time from the earliest stamp [default: the file's clock; a recording always begins at zero]
    #[arg(long)]
    pub from_zero: bool,
    /// What the file does not say
    #[command(flatten)]
    pub declared: crate::declared::DeclaredOptions,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
}

/// How a run uses the machine, and what it says.
#[derive(ClapArgs, Clone)]
pub struct Running {
    /// Threads, for nodes side by side and inside nodes [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub threads: Option<u32>,
    /// Print the outcome as JSON
    #[arg(long)]
    pub json: bool,
    /// How progress is shown, on stderr
    #[arg(long, value_enum, default_value = "auto")]
    pub progress: ProgressStyle,
    /// Say only what went wrong
    #[arg(short, long)]
    pub quiet: bool,
}

#[derive(ClapArgs)]
pub struct RunOptions {
    #[command(flatten)]
    pub target: Target,
    /// Run these nodes even when the cache has them
    #[arg(long = "force", value_name = "NODE")]
    pub force: Vec<String>,
    /// Height of row bands, instead of what memory asks for; results do not depend on it
    #[arg(long, value_name = "ROWS", value_parser = clap::value_parser!(u32).range(1..))]
    pub band_rows: Option<u32>,
    /// Only these rows, for `merge`: 0..180, the end not included. What must be whole before them is run as
    /// ever, what must be whole after them is left to `merge`
    #[arg(long, value_name = "FIRST..END", value_parser = rows, requires = "part")]
    pub rows: Option<Rows>,
    /// Show the plan first, and run only after a yes; needs a terminal
    #[arg(long)]
    pub confirm: bool,
    /// Write the page of the run (report.html in the output folder) and print its path
    #[arg(long, conflicts_with = "part")]
    pub report: bool,
    /// Folder for what is made of these rows; a part that is there is not made again, one that was stopped
    /// goes on
    #[arg(long, value_name = "FOLDER", requires = "rows")]
    pub part: Option<PathBuf>,
    #[command(flatten)]
    pub running: Running,
}

#[derive(ClapArgs)]
pub struct MergeOptions {
    #[command(flatten)]
    pub target: Target,
    /// Folders that `run --rows --part` made; together they have all rows
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    #[command(flatten)]
    pub running: Running,
}

#[derive(ClapArgs)]
pub struct PlanOptions {
    #[command(flatten)]
    pub target: Target,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(ClapArgs)]
pub struct ExplainOptions {
    #[command(flatten)]
    pub target: Target,
    /// The node
    pub node: String,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(ClapArgs)]
pub struct CheckOptions {
    /// A manifest, a recording (with its frames and their stamps when they lie elsewhere), a sensor
    /// description, or the output folder of a run
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Lay a value over the manifest
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub sets: Vec<String>,
    /// Memory that data may take, such as 800MB or 8GiB: what needs more at a time is refused before anything
    /// runs [default: all there is]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub memory: Option<u64>,
    /// What a recording does not say
    #[command(flatten)]
    pub declared: crate::declared::DeclaredOptions,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    /// Markdown: the best in bold, the second underlined
    Md,
    /// Comma-separated values, all digits, no marks
    Csv,
    /// A LaTeX tabular for the package booktabs
    Latex,
    /// One JSON object a cell, all digits
    Jsonl,
    /// The same as one JSON array
    Json,
}

/// Among which cells the best is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Among {
    /// The cells of one row and metric
    Row,
    /// The cells of one column and metric
    Column,
    /// Nowhere
    None,
}

/// Which of the pooled numbers of a score is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Pooled {
    /// The scorer's own pooled value, mostly the mean over frames
    Value,
    /// The smallest frame
    Min,
    /// The 5th percentile of the frames
    P05,
    /// The 95th percentile of the frames
    P95,
    /// The largest frame
    Max,
}

#[derive(ClapArgs)]
pub struct TableOptions {
    /// What was run: a manifest (its scores are in out/NAME), a folder with metrics, or a .jsonl file of
    /// scores
    #[arg(required = true, value_name = "FILE|MANIFEST")]
    pub sources: Vec<PathBuf>,
    /// What makes the rows: axes of the ablation, or file, node, method, label, metric, frame, or card.FIELD
    /// of the metric card
    #[arg(long, value_name = "AXIS,...", value_delimiter = ',')]
    pub rows: Vec<String>,
    /// What makes the columns [default: what differs and is not in the rows]
    #[arg(long, alias = "cols", value_name = "AXIS,...", value_delimiter = ',')]
    pub columns: Vec<String>,
    /// Which metrics, in this order [default: all]
    #[arg(long, value_name = "METRIC,...", value_delimiter = ',')]
    pub metric: Vec<String>,
    /// Only these levels of an axis, in this order: scene=fan,texture
    #[arg(long = "where", value_name = "AXIS=LEVEL,...")]
    pub only: Vec<String>,
    /// Add up what falls into one cell, such as counts
    #[arg(long)]
    pub sum: bool,
    /// Which of the pooled numbers
    #[arg(long, value_enum, default_value = "value")]
    pub statistic: Pooled,
    /// Digits after the point, for all metrics or for one: 2, psnr_db=1,lpips=3 [default: by metric]
    #[arg(long, value_name = "N|METRIC=N,...", value_delimiter = ',')]
    pub digits: Vec<String>,
    /// Among which cells the best and the second are marked [default: where methods stand side by side]
    #[arg(long, value_enum)]
    pub best: Option<Among>,
    /// Show a name as another one: edi=EDI
    #[arg(long, value_name = "NAME=TEXT")]
    pub rename: Vec<String>,
    /// How to write it
    #[arg(long, value_enum, default_value = "md")]
    pub format: TableFormat,
    /// Print as JSON: the same as --format json
    #[arg(long, conflicts_with = "format")]
    pub json: bool,
    /// Draw it as well, the rows along the axis: levels are numbers with a unit (73rpm), the file ends in
    /// .svg or .png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

/// A pixel, `X,Y`.
fn pixel(text: &str) -> Result<(u32, u32), String> {
    let parts =
        text.split_once(',').and_then(|(x, y)| Some((x.trim().parse().ok()?, y.trim().parse().ok()?)));
    parts.ok_or_else(|| "expected column and row, counted from 0, such as 64,48".into())
}

#[derive(ClapArgs)]
pub struct ReportOptions {
    /// What was run: a manifest (its results are in out/NAME), or the folder that a run wrote to
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// The page to write [default: report.html in the folder of the first run]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Only variants of an ablation with this name, or part of it, are shown as pictures, curves and graphs
    #[arg(long = "variant", value_name = "NAME")]
    pub variants: Vec<String>,
    /// A pixel to follow with its events, exposures and voltages; may be given several times
    /// [default: eight lively ones]
    #[arg(long = "pixel", value_name = "X,Y", value_parser = pixel)]
    pub pixels: Vec<(u32, u32)>,
    /// The page may be so large: pictures are thinned out, then made smaller, until it fits
    #[arg(long, value_name = "SIZE", value_parser = bytes, default_value = "12MB")]
    pub max_size: u64,
    /// Where results are kept [default: as the run says]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Say only what went wrong
    #[arg(short, long)]
    pub quiet: bool,
}

#[derive(ClapArgs)]
pub struct RunsOptions {
    /// The pipeline, a TOML file
    pub manifest: PathBuf,
    /// Only these scores: psnr_db, or psnr.psnr_db of one node [default: all]
    #[arg(long, value_name = "METRIC,...", value_delimiter = ',')]
    pub metric: Vec<String>,
    /// Only so many runs, the last ones
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    pub last: u32,
    /// Where results are kept
    #[arg(long, value_name = "FOLDER", default_value = CACHE)]
    pub cache: PathBuf,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum GraphStyle {
    Dot,
    Mermaid,
    Svg,
    Json,
}

#[derive(ClapArgs)]
pub struct GraphOptions {
    /// The pipeline, a TOML file
    pub manifest: PathBuf,
    /// How to draw
    #[arg(long, value_enum, default_value = "dot")]
    pub format: GraphStyle,
    /// Print as JSON: the same as --format json
    #[arg(long, conflicts_with = "format")]
    pub json: bool,
    /// Lay a value over the manifest
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub sets: Vec<String>,
    /// Which variant of an ablation [default: the first]
    #[arg(long, value_name = "NAME")]
    pub variant: Option<String>,
}

#[derive(ClapArgs)]
pub struct InspectOptions {
    /// Recordings of any format, folders of a recording, or cached artefacts (.h5); events and frames that
    /// lie in several files are one recording
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// What the files do not say
    #[command(flatten)]
    pub declared: crate::declared::DeclaredOptions,
    /// Print as JSON (docs/inspect.md)
    #[arg(long)]
    pub json: bool,
}

#[derive(ClapArgs)]
pub struct DiagnoseOptions {
    /// The recording, with its frames and their stamps where they lie elsewhere; or a manifest that reads
    /// them, as `photocurrent init` writes it
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// The sensor description, TOML [default: the manifest's, or the one in the recording]
    #[arg(short, long, value_name = "FILE")]
    pub sensor: Option<PathBuf>,
    /// What the camera looked at, where that is known: a scene of `photocurrent nodes diagnose/target`, a
    /// TOML file with its parameters and with ranges of those that are to be fitted
    #[arg(long, value_name = "FILE", conflicts_with = "direct")]
    pub scene: Option<PathBuf>,
    /// Folder for diagnosis.json, sensor.fitted.toml and report.html
    /// [default: out/NAME of the recording, out/NAME.diagnosis of a manifest]
    #[arg(short, long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Only the tests that need no scene: a second, and blind for most effects
    #[arg(long)]
    pub direct: bool,
    /// Seed of everything random
    #[arg(
        long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64),
    )]
    pub seed: u64,
    /// Where results of the stages are kept for later runs
    #[arg(long, value_name = "FOLDER", default_value = ".photocurrent")]
    pub cache: PathBuf,
    /// Memory that data may take, such as 800MB or 8GiB: what needs more at a time is refused before anything
    /// runs [default: half of what is free]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub memory: Option<u64>,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub threads: Option<u32>,
    /// Print diagnosis.json instead of a summary
    #[arg(long)]
    pub json: bool,
    /// How progress is shown, on stderr
    #[arg(long, value_enum, default_value = "auto")]
    pub progress: ProgressStyle,
    /// Say only what went wrong
    #[arg(short, long)]
    pub quiet: bool,
    #[command(flatten)]
    pub declared: crate::declared::DeclaredOptions,
}

#[derive(ClapArgs)]
pub struct NodesOptions {
    /// A kind, such as solve/map
    pub kind: Option<String>,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
    /// Print all kinds as a Markdown table (docs/nodes.md)
    #[arg(long, conflicts_with_all = ["kind", "json"])]
    pub markdown: bool,
}

#[derive(ClapArgs)]
pub struct EffectsOptions {
    /// An id, such as leak_events
    pub id: Option<String>,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
    /// Print the whole catalogue as Markdown (docs/effects.md)
    #[arg(long, conflicts_with_all = ["id", "json"])]
    pub markdown: bool,
}

#[derive(ClapArgs)]
pub struct SchemaOptions {
    /// That of a line of `--progress json` instead
    #[arg(long)]
    pub progress: bool,
}

#[derive(ClapArgs)]
pub struct ManOptions {
    /// A command, such as run [default: the first page, which lists them]
    pub command: Option<String>,
    /// Write all pages to this folder instead
    #[arg(short, long, value_name = "FOLDER", conflicts_with = "command")]
    pub out: Option<PathBuf>,
}

#[derive(ClapArgs)]
pub struct CompletionOptions {
    /// The shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

#[derive(ClapArgs)]
pub struct CacheOptions {
    #[command(subcommand)]
    pub command: CacheCommand,
    /// Where results are kept
    #[arg(long, value_name = "FOLDER", default_value = CACHE, global = true)]
    pub cache: PathBuf,
    /// Print as JSON
    #[arg(long, global = true)]
    pub json: bool,
}

#[derive(Subcommand)]
pub enum CacheCommand {
    /// List what is kept
    Ls,
    /// Say how much room it takes
    Du,
    /// Remove what was not used for long, or what is over a size
    Gc {
        /// Remove what was not used for this many days
        #[arg(long, value_name = "DAYS")]
        older_than: Option<u64>,
        /// Remove the least recently used until no more than this is left, such as 20GB
        #[arg(long, value_name = "SIZE", value_parser = bytes)]
        max_size: Option<u64>,
        /// Only say what would be removed
        #[arg(long)]
        dry_run: bool,
    },
    /// Read everything and compare it with its digest
    Verify,
    /// Write a finished run into one file, to pass on
    ///
    /// The manifest with what it extends, the files that its nodes read, their results, and the files that
    /// they wrote. Whoever unpacks it runs the manifest without executing a node.
    Pack(PackOptions),
    /// Take in what `cache pack` wrote
    ///
    /// Every digest is verified before anything is placed; what is there already stays as it is.
    Unpack(UnpackOptions),
}

/// The cache of a folder that names none.
pub const CACHE: &str = ".photocurrent";

#[derive(ClapArgs)]
pub struct PackOptions {
    /// A manifest that was run (its files are in out/NAME), or the folder that a run wrote to
    #[arg(value_name = "RUN|MANIFEST")]
    pub run: PathBuf,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// What was laid over the manifest
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub sets: Vec<String>,
    /// Only variants of an ablation with this name, or part of it
    #[arg(long = "variant", value_name = "NAME")]
    pub variants: Vec<String>,
    /// Only these nodes and what they need
    #[arg(long = "to", value_name = "NODE")]
    pub to: Vec<String>,
    /// Where the run wrote files [default: out/NAME of the manifest]
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(ClapArgs)]
pub struct UnpackOptions {
    /// What `cache pack` wrote
    pub file: PathBuf,
    /// Folder for the manifest and the files that its nodes read [default: the file's name without its
    /// ending]
    #[arg(long, value_name = "FOLDER")]
    pub to: Option<PathBuf>,
    /// Folder for the files that the run wrote [default: out/NAME of the manifest]
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
}

/// `0..180`: rows of the sensor.
fn rows(text: &str) -> Result<Rows, String> {
    let ends = text
        .split_once("..")
        .and_then(|(start, end)| Some((start.trim().parse().ok()?, end.trim().parse().ok()?)));
    match ends {
        Some((start, end)) if start <= end => Ok(Rows { start, end }),
        _ => {
            Err(format!("`{text}` is no range of rows; first row and the one after the last, such as 0..180"))
        }
    }
}

/// `100,80,64,64`: a rectangle of pixels.
fn crop(text: &str) -> Result<Crop, String> {
    let numbers: Vec<Option<u32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [Some(x), Some(y), Some(width), Some(height)] if width > 0 && height > 0 => {
            Ok(Crop { x, y, width, height })
        }
        _ => Err(format!(
            "`{text}` is no rectangle; first column, first row, columns, rows, such as 100,80,64,64"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_well_formed() {
        use clap::CommandFactory;
        Args::command().debug_assert();
    }
}
