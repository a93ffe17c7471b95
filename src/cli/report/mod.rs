//! `photocurrent report`: one page of HTML out of finished runs, of what they left in their folders and in
//! the cache. Nothing is run, nothing calculated.
//!
//! [`run`] reads what a run says of itself, [`films`] picks and encodes pictures within the size that is
//! allowed, [`scores`] lays out numbers, [`pixels`] follows single pixels, [`nodes`] draws graphs and says
//! where it all comes from. The page itself is that of `photocurrent-page`.

mod films;
mod nodes;
mod pixels;
pub mod run;
mod scores;

pub use films::sensor;
pub use scores::best;

use crate::args::ReportOptions;
use crate::failure::{Done, Failure, write_whole};
use crate::numbers::human_bytes;
use crate::terminal::{print, say};
use photocurrent_page::RunPage;
use run::Run;
use std::path::{Path, PathBuf};

/// Room for everything but pictures, bytes; what is more is taken from the pictures on a second try.
const REST: u64 = 200_000;
/// The page may be so large where nobody says otherwise, bytes: the default of --max-size.
const MAX_SIZE: u64 = 12_000_000;
/// So often the pictures are made smaller.
const TRIES: usize = 4;

/// Writes the page and prints its path.
pub fn report(options: &ReportOptions) -> Done {
    let output = write(options)?;
    print(&output.display().to_string())?;
    Ok(0)
}

/// The page of a run into `folder` that has just ended.
pub fn of_run(folder: &Path, cache: &Path, quiet: bool) -> Result<PathBuf, Failure> {
    write(&ReportOptions {
        runs: vec![folder.into()],
        output: None,
        variants: Vec::new(),
        pixels: Vec::new(),
        max_size: MAX_SIZE,
        cache: Some(cache.into()),
        quiet,
    })
}

/// Writes the page and gives its path.
fn write(options: &ReportOptions) -> Result<PathBuf, Failure> {
    let open = |source| Run::open(source, "report", &options.variants, options.cache.as_deref());
    let runs = options.runs.iter().map(|source| open(source)).collect::<Result<Vec<_>, _>>()?;
    let output = options.output.clone().unwrap_or_else(|| runs[0].folder.join("report.html"));
    let mut budget = options.max_size.saturating_sub(REST);
    for _ in 0..TRIES {
        let page = page(&runs, options, budget)?;
        let html = page.html();
        let over = (html.len() as u64).saturating_sub(options.max_size);
        if over == 0 {
            write_whole(&output, html.as_bytes())?;
            if !options.quiet {
                page.picture_notes
                    .iter()
                    .chain(&page.pixel_notes)
                    .for_each(|note| say!("note: {}", note.replace('`', "")));
                say!("{} in one file; open it in a browser", human_bytes(html.len() as u64));
            }
            return Ok(output);
        }
        budget = budget.saturating_sub(over + over / 10 + 1000);
    }
    let hint = "hint: give more, such as --max-size 12MB, or show fewer variants with --variant";
    Err(Failure::Other {
        message: format!("the page cannot be made as small as {}\n  {hint}", human_bytes(options.max_size)),
        code: 2,
    })
}

fn page(runs: &[Run], options: &ReportOptions, budget: u64) -> Result<RunPage, Failure> {
    let mut page = RunPage {
        title: runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>().join(", "),
        ..RunPage::default()
    };
    let mut styles = run::Styles::default();
    scores::verdict(runs, &mut page)?;
    films::pictures(runs, &mut styles, budget, &mut page)?;
    scores::curves(runs, &mut styles, &mut page)?;
    scores::edges(runs, &mut styles, &mut page)?;
    pixels::follow(&runs[0], &options.pixels, &mut styles, &mut page)?;
    nodes::describe(runs, &mut page);
    Ok(page)
}
