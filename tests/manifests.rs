//! Every mistake in a manifest gives its message: file, line, what was found, what was expected, what to do.
//!
//! `manifests/bad` holds one malformed manifest per family of mistakes, named after it, and next to it what
//! `photocurrent plan` says on stderr, to the letter; `manifests/bad/parts` holds the files that they name. A
//! changed message is a changed file here, so that messages are read when they are reviewed:
//! `UPDATE_EXPECT=1 cargo test --test photocurrent manifests` writes them anew.

use crate::support::{Bench, Done, root};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Fewer would mean that a family was lost.
const FEWEST: usize = 45;

fn corpus() -> PathBuf {
    root().join("tests/manifests/bad")
}

/// Are the messages being written anew?
fn updating() -> bool {
    std::env::var_os("UPDATE_EXPECT").is_some()
}

/// The names of the corpus's files that end in `ending`, without it.
fn names(ending: &str) -> BTreeSet<String> {
    let entries = fs::read_dir(corpus())
        .expect("the corpus")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("a name"));
    entries.filter_map(|name| name.strip_suffix(ending).map(str::to_string)).collect()
}

/// A copy of the corpus that sees `data/` where the corpus sees it, so that paths in messages are short and
/// the same on every machine.
fn copied() -> Bench {
    let bench = Bench::new();
    copy(&corpus(), &bench.path("tests/manifests/bad"));
    std::os::unix::fs::symlink(root().join("data"), bench.path("data")).expect("a link to data/");
    fs::create_dir(bench.path("tmp")).expect("a folder");
    bench
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder").map(|entry| entry.expect("an entry")) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("a copy");
        }
    }
}

/// `photocurrent plan NAME.toml` where the corpus is.
fn plan(bench: &Bench, name: &str) -> Done {
    let mut command = bench.command(&["plan", &format!("{name}.toml")]);
    // Temporary files, too, are files: they go where `plan_writes_nothing_for_a_bad_manifest` looks.
    command.current_dir(bench.path("tests/manifests/bad")).env("TMPDIR", bench.path("tmp"));
    let output = command.output().expect("the command starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("messages are UTF-8");
    Done {
        code: output.status.code().unwrap_or(-1),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

/// What has to change in `old` to become `new`, line by line: `-` expected, `+` found.
fn difference(old: &str, new: &str) -> String {
    let (old, new): (Vec<&str>, Vec<&str>) = (old.lines().collect(), new.lines().collect());
    // longest[i][j]: the most lines that old[i..] and new[j..] have in common.
    let mut longest = vec![vec![0usize; new.len() + 1]; old.len() + 1];
    for i in (0..old.len()).rev() {
        for j in (0..new.len()).rev() {
            longest[i][j] = if old[i] == new[j] {
                1 + longest[i + 1][j + 1]
            } else {
                longest[i + 1][j].max(longest[i][j + 1])
            };
        }
    }
    let (mut i, mut j, mut text) = (0, 0, String::new());
    while i < old.len() || j < new.len() {
        let (mark, line) = if i < old.len() && j < new.len() && old[i] == new[j] {
            (' ', old[i])
        } else if i < old.len() && (j == new.len() || longest[i + 1][j] >= longest[i][j + 1]) {
            ('-', old[i])
        } else {
            ('+', new[j])
        };
        i += usize::from(mark != '+');
        j += usize::from(mark != '-');
        let _ = writeln!(text, "  {mark} {line}");
    }
    text
}

#[test]
fn every_bad_manifest_gives_its_message_to_the_letter() {
    let bench = copied();
    let update = updating();
    let mut differences = String::new();
    for name in names(".toml") {
        let done = plan(&bench, &name);
        if done.code != 2 || !done.stdout.is_empty() {
            let _ = writeln!(
                differences,
                "{name}: exit code {} (2 is right), stdout {:?} (empty is right)\n{}",
                done.code, done.stdout, done.stderr
            );
        }
        let path = corpus().join(format!("{name}.stderr"));
        if update {
            fs::write(&path, &done.stderr).expect("a message is written");
            continue;
        }
        let expected = fs::read_to_string(&path).unwrap_or_default();
        if expected != done.stderr {
            let _ = writeln!(differences, "{name}:\n{}", difference(&expected, &done.stderr));
        }
    }
    assert!(
        differences.is_empty(),
        "messages changed (- expected, + found):\n\n{differences}when the new ones are better: \
         UPDATE_EXPECT=1 cargo test --test photocurrent manifests"
    );
}

#[test]
fn every_bad_manifest_has_its_message_and_every_message_its_manifest() {
    let (manifests, messages) = (names(".toml"), names(".stderr"));
    assert!(manifests.len() >= FEWEST, "{} manifests, fewer than {FEWEST}", manifests.len());
    // While they are written they are not all there.
    let lonely: Vec<&String> =
        if updating() { Vec::new() } else { manifests.symmetric_difference(&messages).collect() };
    assert!(lonely.is_empty(), "without a counterpart in {}: {lonely:?}", corpus().display());
    let named =
        |name: &String| name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    assert!(manifests.iter().all(named), "a manifest is named after its mistake, in snake_case");
}

#[test]
fn every_message_names_its_file_and_says_that_nothing_ran() {
    for name in names(".stderr").into_iter().filter(|_| !updating()) {
        let message = fs::read_to_string(corpus().join(format!("{name}.stderr"))).expect("a message");
        let last = message.lines().last().unwrap_or_default();
        assert!(message.starts_with("error: "), "{name}: begins with `error: `");
        assert!(
            last.ends_with("; nothing ran"),
            "{name}: the last line says that nothing ran, and is `{last}`"
        );
        let count = message.lines().filter(|line| line.starts_with("error: ")).count();
        assert_eq!(
            last.split(' ').next(),
            Some(count.to_string().as_str()),
            "{name}: the last line counts the mistakes"
        );
        assert!(!message.contains('\u{1b}'), "{name}: no colours under NO_COLOR");
        assert!(!message.contains(env!("CARGO_MANIFEST_DIR")), "{name}: names paths as the manifest does");
        // A user without the file at hand must still know where to look. A manifest without a place of the
        // mistake is the exception to correct.
        let placed = message.lines().filter(|line| line.trim_start().starts_with("--> ")).count();
        assert!(
            placed == count || message.contains(&format!("{name}.toml")),
            "{name}: {count} mistakes, {placed} places, and the manifest is not named"
        );
    }
}

#[test]
fn many_independent_mistakes_are_reported_together() {
    let bench = copied();
    let said = plan(&bench, "many_mistakes").stderr;
    let mistakes = said.lines().filter(|line| line.starts_with("error: ")).count();
    assert!(mistakes >= 6, "only {mistakes}:\n{said}");
}

/// Every file and folder below `folder`.
fn everything(folder: &Path, found: &mut BTreeSet<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")) {
        if entry.file_type().expect("a type").is_dir() {
            everything(&entry.path(), found);
        }
        found.insert(entry.path());
    }
}

#[test]
fn plan_writes_nothing_for_a_bad_manifest() {
    let bench = copied();
    let (mut before, mut after) = (BTreeSet::new(), BTreeSet::new());
    everything(&bench.path(""), &mut before);
    for name in names(".toml") {
        plan(&bench, &name);
    }
    everything(&bench.path(""), &mut after);
    let new: Vec<&PathBuf> = after.difference(&before).collect();
    assert!(new.is_empty() && before.len() == after.len(), "plan left {new:?}");
}

/// What `photocurrent plan` says about a good manifest with `--set` texts laid over.
fn set(sets: &[&str]) -> Done {
    let base = root().join("pipelines/ablations/base.toml");
    let mut arguments = vec!["plan", base.to_str().expect("a path in UTF-8")];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    Bench::new().run(&arguments)
}

#[test]
fn a_mistake_in_set_is_shown_at_set() {
    let cases = [
        ("nodes.solve.params.cis_weight", "`--set` takes path=value", "--set:1:1"),
        (
            "nodes.solve.params.cis_weight=\"much\"",
            "expected a number, found the text \"much\"",
            "--set:1:31",
        ),
        // The shell has eaten the quotes: the value is a text all the same.
        ("nodes.solve.params.cis_weight=much", "expected a number, found the text \"much\"", "--set:1:31"),
        (
            "nodes.scene.params.duration=40",
            "expected a time with its unit, found the integer 40",
            "--set:1:29",
        ),
        ("nodes.scene.params.duration=40 parsec", "unknown unit `parsec`", "--set:1:29"),
        ("nodes.solve.params.cis_wieght=2", "`cis_wieght` is not a parameter of solve/paper", "--set:1:20"),
        ("nodes.slove.params.cis_weight=2", "there is no node `slove` to change", "--set:1:7"),
        ("node.solve.params.cis_weight=2", "`node` cannot be laid over a manifest", "--set:1:1"),
        (
            "nodes.solve.in.frames=scene.truth",
            "nodes.solve: input `frames` takes frames, and `scene.truth` is truth",
            "--set:1:23",
        ),
        ("nodes.solve.kind=solve/pixle", "there is no node kind `solve/pixle`", "--set:1:18"),
        ("pipeline.seed=-1", "`seed` must be at least 0, found -1", "--set:1:15"),
        ("nodes solve=2", "`nodes solve` is not a path of keys", "--set:1:1"),
    ];
    for (text, message, place) in cases {
        let done = set(&[text]);
        assert_eq!((done.code, done.stdout.as_str()), (2, ""), "--set {text}");
        let mut lines = done.stderr.lines();
        assert_eq!(lines.next(), Some(format!("error: {message}").as_str()), "--set {text}");
        assert_eq!(lines.next().map(str::trim), Some(format!("--> {place}").as_str()), "--set {text}");
    }
}

#[test]
fn mistakes_in_several_sets_are_reported_together() {
    let said = set(&[
        "nodes.slove.params.cis_weight=2",
        "nodes.solve.params.readout=slop",
        "nodes.scene.params.width=4",
    ])
    .stderr;
    assert!(said.ends_with("3 mistakes; nothing ran\n"), "{said}");
}

#[test]
fn set_wins_over_the_file_and_leaves_it_alone() {
    let base = root().join("pipelines/ablations/base.toml");
    let before = fs::read(&base).expect("the base");
    let done = set(&["nodes.solve.params.readout=none"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.contains("readout = \"none\""), "{}", done.stdout);
    assert_eq!(fs::read(&base).expect("the base"), before);
}

#[test]
fn a_manifest_that_is_not_there_is_named() {
    let done = Bench::new().run(&["plan", "no/such/pipeline.toml"]);
    assert_eq!((done.code, done.stdout.as_str()), (2, ""));
    assert!(done.stderr.contains("no/such/pipeline.toml"), "{}", done.stderr);
}

/// The examination without the variants whose recordings `make concealed` makes.
fn of_stored_recordings(path: &Path) -> String {
    let data = root().join("data");
    let text = fs::read_to_string(path).expect("the examination");
    let is_stored = |line: &&str| {
        let named = line.split_once("concealed/recordings/").and_then(|(_, rest)| rest.get(..11));
        named.is_none_or(|name| data.join("concealed/recordings").join(name).exists())
    };
    let lines: Vec<&str> = text.lines().filter(is_stored).collect();
    assert!(lines.len() > 50, "six recordings are stored");
    lines.join("\n").replace("../../data", data.to_str().expect("a path in UTF-8"))
}

#[test]
fn every_pipeline_passes_its_check() {
    let mut pipelines = BTreeSet::new();
    everything(&root().join("pipelines"), &mut pipelines);
    let bench = Bench::new();
    let mut checked = 0;
    for path in pipelines.iter().filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
    {
        let stored = bench.path("concealed.toml");
        let path = if path.ends_with("diagnose/concealed.toml") {
            fs::write(&stored, of_stored_recordings(path)).expect("a manifest");
            &stored
        } else {
            path
        };
        let done = bench.run(&["check", path.to_str().expect("a path in UTF-8")]);
        assert_eq!(done.code, 0, "{}:\n{}", path.display(), done.stderr);
        assert_eq!(done.stdout, "");
        checked += 1;
    }
    assert!(checked > 0, "there are pipelines to check");
}
