//! The first page of help, `photocurrent man`, `completions`: the arguments as text, for people and shells.
//!
//! clap lists commands in one column without groups; the page here groups them by what a person wants and
//! fits a screen of 80 by 24.

use crate::args::{Args, CompletionOptions, ManOptions};
use crate::failure::{Done, Failure, write_whole};
use crate::terminal::{print, say};
use clap::CommandFactory;
use photocurrent_core::document::Problem;
use std::fmt::Write;
use std::path::Path;

/// The commands by what a person wants.
const GROUPS: [(&str, &[&str]); 4] = [
    ("Run pipelines", &["init", "run", "plan", "explain", "check", "merge", "cache"]),
    ("See results", &["report", "table", "runs", "graph"]),
    ("Recordings", &["inspect", "play", "convert", "diagnose"]),
    ("Reference", &["nodes", "effects", "schema", "man", "completions"]),
];

/// The arguments, with the commands grouped in the first page of help.
pub fn command() -> clap::Command {
    let plain = Args::command();
    let page = page(&plain);
    plain.help_template(page)
}

fn page(command: &clap::Command) -> String {
    let mut text = format!(
        "{}\nUsage: photocurrent <COMMAND>; what one takes: photocurrent help <COMMAND>\n",
        command.get_about().map(ToString::to_string).unwrap_or_default()
    );
    for (group, names) in GROUPS {
        for (at, name) in names.iter().enumerate() {
            let about = command
                .find_subcommand(name)
                .and_then(clap::Command::get_about)
                .map(ToString::to_string)
                .unwrap_or_default();
            let _ = writeln!(text, "{:<15}{name:<13}{about}", if at == 0 { group } else { "" });
        }
    }
    text + "\nFirst steps: photocurrent run pipelines/quickstart.toml; photocurrent init FILE"
}

/// Prints a manual page, or writes all of them.
pub fn man(options: &ManOptions) -> Done {
    let mut whole = Args::command();
    whole.build();
    if let Some(folder) = &options.out {
        return write_all(&whole, folder);
    }
    let chosen = match &options.command {
        None => whole,
        Some(name) => {
            let names: Vec<String> =
                whole.get_subcommands().map(|command| command.get_name().to_string()).collect();
            whole.find_subcommand(name).cloned().ok_or_else(|| {
                Failure::Problems(vec![
                    Problem::new(format!("there is no command `{name}`"))
                        .did_you_mean(name, names.iter().map(String::as_str)),
                ])
            })?
        }
    };
    print(&roff(&chosen)?)?;
    Ok(0)
}

fn roff(command: &clap::Command) -> Result<String, Failure> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    Ok(String::from_utf8_lossy(&page).into_owned())
}

/// `photocurrent.1` and a page for each command: `photocurrent-run.1`.
fn write_all(whole: &clap::Command, folder: &Path) -> Done {
    let commands: Vec<&clap::Command> = std::iter::once(whole)
        .chain(whole.get_subcommands().filter(|command| command.get_name() != "help"))
        .collect();
    for command in &commands {
        let name = command.get_display_name().unwrap_or(command.get_name());
        write_whole(&folder.join(format!("{name}.1")), roff(command)?.as_bytes())?;
    }
    say!(
        "{} pages in {}; read one with `man {}`",
        commands.len(),
        folder.display(),
        folder.join("photocurrent-run.1").display()
    );
    Ok(0)
}

/// Prints completions for a shell.
pub fn completions(options: &CompletionOptions) -> Done {
    let mut script = Vec::new();
    clap_complete::generate(options.shell, &mut Args::command(), "photocurrent", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_first_page_of_help_fits_a_screen() {
        let page = command().render_help().to_string();
        assert!(page.lines().count() <= 24, "{page}");
        let long: Vec<&str> = page.lines().filter(|line| line.chars().count() > 80).collect();
        assert!(long.is_empty(), "{long:#?}");
    }

    #[test]
    fn every_command_stands_in_one_group() {
        let listed: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let there = Args::command();
        let there: BTreeSet<&str> = there.get_subcommands().map(clap::Command::get_name).collect();
        assert_eq!(listed.iter().copied().collect::<BTreeSet<_>>(), there);
        assert_eq!(listed.len(), there.len(), "none twice");
    }

    #[test]
    fn a_manual_page_names_every_option_of_its_command() {
        let mut whole = Args::command();
        whole.build();
        let run = whole.find_subcommand("run").expect("run");
        let page = roff(run).ok().expect("a page").replace("\\-", "-");
        assert!(page.starts_with(".ie") && page.contains(".TH photocurrent-run 1"), "{page}");
        for option in run.get_arguments().filter_map(clap::Arg::get_long) {
            assert!(page.contains(&format!("--{option}")), "--{option} is in\n{page}");
        }
    }
}
