//! Arguments of `photocurrent play`.

use crate::declared::DeclaredOptions;
use crate::numbers::bytes;
use clap::Args as ClapArgs;
use photocurrent_core::quantity::Duration;
use std::path::PathBuf;

/// Arguments of `play`.
#[derive(ClapArgs)]
pub struct PlayOptions {
    /// A recording of any format (with its frames and their stamps where they lie elsewhere), a cached result
    /// with events or frames, a manifest that was run, or the folder that a run wrote to
    #[arg(required = true, value_name = "FILE|MANIFEST|RUN")]
    pub files: Vec<PathBuf>,
    /// The page to write [default: play.html in the folder of the run, or in out/NAME of the recording]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Leave out what is before this time, from the earliest stamp of a recording, on the clock of a run:
    /// 250ms
    #[arg(long, value_name = "TIME")]
    pub from: Option<Duration>,
    /// Leave out what is at or after this time
    #[arg(long, value_name = "TIME")]
    pub to: Option<Duration>,
    /// The page may be so large: pictures are thinned out and made smaller, and events left out at random,
    /// until it fits
    #[arg(long, value_name = "SIZE", value_parser = bytes, default_value = "25MB")]
    pub max_size: u64,
    /// Of an ablation only variants with this name, or part of it
    #[arg(long = "variant", value_name = "NAME")]
    pub variants: Vec<String>,
    /// Where results of the run are kept [default: as the run says]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Say only what went wrong
    #[arg(short, long)]
    pub quiet: bool,
    /// What the files do not say
    #[command(flatten)]
    pub declared: DeclaredOptions,
}
