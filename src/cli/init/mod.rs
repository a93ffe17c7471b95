//! `photocurrent init`: a runnable manifest and a sensor description for somebody's files, with every unknown
//! marked.
//!
//! What the files state is taken; what they cannot state is proposed, with the reason, on a line marked
//! `FILL:`. The manifest runs as it is, so that there is a picture after two commands, and what the picture
//! depends on stands in it to be corrected.

mod facts;
mod fill;
mod hazards;
mod pairing;
mod readings;
mod text;
mod units;
mod window;

use crate::args::InitOptions;
use crate::failure::{Done, usage};
use crate::terminal::say;
use std::path::{Path, PathBuf};

/// Writes `my.toml` and `my.sensor.toml`.
pub fn init(options: &InitOptions) -> Done {
    let manifest = &options.output;
    let sensor = manifest.with_extension("sensor.toml");
    if manifest.extension().is_none_or(|extension| extension != "toml") {
        return Err(usage(format!("{}: a manifest's name ends in .toml", manifest.display())));
    }
    if let Some(path) = [manifest, &sensor].into_iter().find(|path| path.exists() && !options.force) {
        return Err(usage(format!(
            "{} exists\n  hint: give another name with -o, or --force to replace it",
            path.display()
        )));
    }
    let folder = manifest.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let found = facts::collect(&options.files, &options.declared, &options.accept)?;
    for path in &found.inputs {
        crate::failure::must_be_utf8(path)?;
    }
    let relative = |path: &Path| relative_to(folder, path);
    let name = manifest.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let sensor_name = sensor.file_name().unwrap_or_default().to_string_lossy().into_owned();
    crate::failure::write_whole(manifest, text::manifest(&found, &name, &sensor_name, &relative).as_bytes())?;
    if found.sensor_text.is_none() {
        crate::failure::write_whole(&sensor, text::sensor(&found).as_bytes())?;
    }
    talk(options, &found, manifest, &sensor);
    Ok(if found.losses.is_empty() { 0 } else { 3 })
}

/// What was found, what is open, what comes next; on stderr.
fn talk(options: &InitOptions, found: &facts::Facts, manifest: &Path, sensor: &Path) {
    for note in &found.notes {
        say!("note: {note}");
    }
    for loss in &found.losses {
        say!("data lost: {loss}");
    }
    for fill in found.reader.iter().filter(|fill| !fill.is_open) {
        say!("set: {} = {}: {}", fill.name, fill.value, fill.why);
    }
    if let Some(window) = &found.window {
        say!("cut: from {} to {}: {}", window.start, window.end, window.why);
    }
    for mark in &found.marks {
        say!("check: {mark}");
    }
    let marked = found.open();
    let sensor_too =
        if found.sensor_text.is_none() { format!(" and {}", sensor.display()) } else { String::new() };
    let files = options.files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(" ");
    say!("\n{} from {files}", manifest.display().to_string() + &sensor_too);
    match marked {
        0 => say!("everything that is needed is recorded or stated"),
        1 => say!("1 line is marked FILL: the files do not state it; check it first"),
        n => say!("{n} lines are marked FILL: the files do not state them; check them first"),
    }
    say!("next: photocurrent run {}", manifest.display());
    say!("then: photocurrent diagnose {}", manifest.display());
}

/// A path as a manifest in `folder` names it: relative where both lie in one place, whole otherwise.
fn relative_to(folder: &Path, path: &Path) -> PathBuf {
    let (Ok(folder), Ok(path)) = (folder.canonicalize(), path.canonicalize()) else { return path.into() };
    let common = folder.components().zip(path.components()).take_while(|(a, b)| a == b).count();
    // Nothing in common but the root: the whole path is plainer.
    if common <= 1 {
        return path;
    }
    let up = folder.components().skip(common).map(|_| Path::new(".."));
    let mut relative: PathBuf = up.collect();
    relative.extend(path.components().skip(common));
    relative
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_named_from_the_manifests_folder() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("a/b")).unwrap();
        std::fs::create_dir_all(at("c")).unwrap();
        std::fs::write(at("c/x.raw"), "").unwrap();
        assert_eq!(relative_to(&at("a/b"), &at("c/x.raw")), Path::new("../../c/x.raw"));
        assert_eq!(relative_to(&at("c"), &at("c/x.raw")), Path::new("x.raw"));
    }
}
