//! Code, messages, manifests, pages and docs use the field's words (docs/vocabulary.md); those of a private
//! language do not come back.
//!
//! A text is searched in lower case, with `snake_case` and `CamelCase` taken apart, so that an identifier is
//! read as its words. What can only be judged by its meaning (`light` for the photocurrent, `hint` for a
//! pseudo-measurement, `floor` of a null distribution) is not searched for.

use crate::support::root;
use std::process::Command;

/// What is not said, and what is said instead.
const RETIRED: [(&[&str], &str); 31] = [
    (&["most probable light"], "MAP estimate (of the photocurrent)"),
    (&["told", "tell", "tells", "telling"], "reported, stated, given, distinguished"),
    (
        &["believe", "believes", "believed", "believing", "belief", "beliefs"],
        "assumed standard deviation; posterior probability; trusted",
    ),
    (&["foretell", "foretells", "foretold"], "predict, predicted"),
    (&["kept back", "keep back", "keeps back", "keeping back"], "held out"),
    (&["description as stated", "noise as stated", "as fitted"], "nominal; fitted"),
    (&["another road", "roads"], "method (of inference)"),
    (&["contest"], "model selection on held-out pixels"),
    (&["closures"], "frame-event log residuals"),
    (&["law", "laws"], "dependence, response curve; rule; distribution"),
    (&["kick", "kicks", "kicked"], "impulse"),
    (&["came again", "comes again", "come again"], "matched events"),
    (&["strength", "strengths"], "effect size"),
    (&["silence", "silences"], "no-event constraint; time without events"),
    (&["glide", "glides"], "integrated random walk"),
    (&["alarm", "alarms"], "detection threshold"),
    (&["says nothing", "say nothing"], "is not identifiable from it; does not constrain; decides nothing"),
    (&["safe estimate"], "double-integral estimate"),
    (
        &["put on", "puts on", "take off", "takes off", "taken off", "take away", "takes away", "taken away"],
        "apply; remove, undo, subtract",
    ),
    (&["mend", "mends", "mended"], "correct, corrected, repaired"),
    (&["put back", "puts back"], "recovered, restored"),
    (&["beside"], "with, in addition to; next to"),
    (&["sealed", "edition", "editions"], "concealed, blind; version 1, 2"),
    (&["next to nothing", "next to none", "good to a", "good to the"], "a number with its unit"),
    (&["caution", "cautions", "cautious", "take care", "takes care"], "variance factor"),
    (&["contradictions"], "innovations; inconsistencies"),
    (&["from when on"], "threshold"),
    (&["nothing is decided"], "abstains; no decision"),
    (&["as posed"], "as modelled by the solver"),
    (&["what the events say", "nobody asks"], "evidence; evaluated"),
    (&["worth a word"], "material"),
];

/// Where a word means something else: what stands around it is taken out before the search.
const ORDINARY: [(&str, &str); 12] = [
    ("false alarm", "the standard term"),
    ("CAUTION_QUARTERS", "a reserve of the schedule's estimate of memory"),
    ("cos^4 law", "the name of natural vignetting's formula"),
    ("sealed physics, ", "the seeds of the concealed recordings, which make their content"),
    (" edition\"", "the ends of those seeds"),
    (" edition`", "the same in Markdown"),
    ("photocurrent-sealed-answers/1", "the name of a form, which readers compare"),
    ("edition = \"20", "a key of Cargo"),
    ("edition.workspace", "a key of Cargo"),
    ("`law`", "a field of the answers to the concealed recordings"),
    ("`law.rs`", "a file of their generator"),
    ("(\"law\")", "that field, read"),
];

/// Left out: a program of its own whose answers are data.
const OTHERS: [&str; 1] = ["data/concealed/generator/"];

/// The words of a text in lower case, a space between them.
fn plain(line: &str) -> String {
    let mut text = String::with_capacity(line.len() + 16);
    let mut last = ' ';
    for c in line.chars() {
        if c.is_ascii_uppercase() && (last.is_ascii_lowercase() || last.is_ascii_digit()) {
            text.push(' ');
        }
        text.push(if c == '_' { ' ' } else { c.to_ascii_lowercase() });
        last = c;
    }
    text
}

/// The retired words of a line.
fn retired(line: &str) -> Vec<&'static str> {
    let line = ORDINARY.iter().fold(
        line.replace("False alarm", "false alarm").replace("false_alarms", "").replace("false_alarm", ""),
        |line, (around, _)| line.replace(around, " "),
    );
    let text = plain(&line);
    let is_word = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    let stands = |word: &str| {
        text.match_indices(word).any(|(at, _)| {
            !is_word(text[..at].chars().next_back()) && !is_word(text[at + word.len()..].chars().next())
        })
    };
    RETIRED.iter().flat_map(|(words, _)| words.iter()).copied().filter(|word| stands(word)).collect()
}

#[test]
fn retired_words_do_not_come_back() {
    let git = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root())
        .output();
    let Some(listed) = git.ok().filter(|output| output.status.success()) else {
        println!("skipped: no git here to list the project's files");
        return;
    };
    let endings = ["rs", "md", "toml", "py", "js", "css", "html", "m", "sh", "form", "stderr"];
    let mut found = Vec::new();
    for name in String::from_utf8_lossy(&listed.stdout).split('\0') {
        let is_text = name.rsplit_once('.').is_some_and(|(_, ending)| endings.contains(&ending))
            || ["Makefile", "pipelines/cluster/Snakefile"].contains(&name);
        if !is_text || name == "tests/words.rs" || OTHERS.iter().any(|folder| name.starts_with(folder)) {
            continue;
        }
        let Ok(text) = std::fs::read_to_string(root().join(name)) else { continue };
        for (at, line) in text.lines().enumerate() {
            found.extend(
                retired(line)
                    .into_iter()
                    .map(|word| format!("{name}:{}: `{word}` in: {}", at + 1, line.trim())),
            );
        }
    }
    let instead = RETIRED
        .iter()
        .map(|(words, instead)| format!("  {}: {instead}\n", words.join(", ")))
        .collect::<String>();
    assert!(
        found.is_empty(),
        "the field has words for these (docs/vocabulary.md):\n{}\n\nsay instead\n{instead}",
        found.join("\n")
    );
}

#[test]
fn words_are_found_in_sentences_and_in_identifiers() {
    assert_eq!(retired("light that is told to nobody"), ["told"]);
    assert_eq!(retired("let frame_kick = KickTarget::Comparator;"), ["kick"]);
    assert_eq!(retired("fn put_on(&self)"), ["put on"]);
    assert_eq!(retired("/// Silences are kept back."), ["kept back", "silences"]);
    // Parts of other words, standard terms and seeds are none.
    assert!(
        retired("no flaw, 3 false alarms, `false_alarm`, comes against it, unsealed, the expedition")
            .is_empty()
    );
    assert!(
        retired("--seed \"sealed physics, sixth edition\" and `photocurrent-sealed-answers/1`").is_empty()
    );
}
