//! What a run shows and asks for while it goes: `--progress json` against its schema, `--report`,
//! `--confirm`.

use crate::support::{Bench, small_pipeline};
use serde_json::Value;
use std::collections::BTreeSet;

/// What a line has against a schema; the part of JSON Schema that the one of progress uses, and a panic for
/// every other key, so that none is passed over.
fn against(value: &Value, schema: &Value) -> Option<String> {
    let is = |name: &str| match name {
        "object" => value.is_object(),
        "string" => value.is_string(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "null" => value.is_null(),
        other => panic!("a type `{other}`"),
    };
    for (key, rule) in schema.as_object().expect("a schema") {
        let fits =
            match key.as_str() {
                "$schema" | "title" | "description" => true,
                "type" => match rule {
                    Value::Array(names) => names.iter().any(|name| is(name.as_str().expect("a type"))),
                    name => is(name.as_str().expect("a type")),
                },
                "const" => value == rule,
                "enum" => rule.as_array().expect("values").contains(value),
                "minimum" => value.as_f64().is_none_or(|number| number >= rule.as_f64().expect("a number")),
                "required" => rule
                    .as_array()
                    .expect("names")
                    .iter()
                    .all(|name| value.get(name.as_str().expect("a name")).is_some()),
                "additionalProperties" => {
                    assert_eq!(*rule, Value::Bool(false));
                    let known = schema["properties"].as_object().expect("properties");
                    value.as_object().is_none_or(|value| value.keys().all(|key| known.contains_key(key)))
                }
                "properties" => rule.as_object().expect("properties").iter().all(|(name, schema)| {
                    value.get(name).is_none_or(|value| against(value, schema).is_none())
                }),
                "oneOf" => {
                    let all = rule.as_array().expect("schemas");
                    all.iter().filter(|schema| against(value, schema).is_none()).count() == 1
                }
                other => panic!("a rule `{other}`"),
            };
        if !fits {
            return Some(format!("`{key}`: {value}"));
        }
    }
    None
}

fn schema() -> Value {
    let done = Bench::new().run(&["schema", "--progress"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    serde_json::from_str(&done.stdout).expect("a JSON Schema")
}

/// The events of a run, each of which has the form that the schema states.
fn events(bench: &Bench, arguments: &[&str], code: i32) -> Vec<Value> {
    let done = bench.run(&[&["run", "m.toml", "--progress", "json"], arguments].concat());
    assert_eq!(done.code, code, "{}", done.stderr);
    let schema = schema();
    let lines = done.stderr.lines().filter(|line| line.starts_with('{'));
    let events: Vec<Value> = lines.map(|line| serde_json::from_str(line).expect("JSON")).collect();
    for event in &events {
        assert_eq!(against(event, &schema), None);
    }
    events
}

fn words<'a>(events: &'a [Value], key: &str) -> BTreeSet<&'a str> {
    events.iter().filter_map(|event| event[key].as_str()).collect()
}

#[test]
fn every_event_has_the_form_of_the_schema() {
    let bench = Bench::new();
    let broken = "
[nodes.mine]
kind = \"baseline/exec\"
in = { events = \"recording.events\", frames = \"recording.frames\", sensor = \"sensor\" }
params = { command = [\"false\"], version = \"1\", white = 1023 }
[nodes.psnr_mine]
kind = \"score/psnr\"
in = { frames = \"mine\", truth = \"scene.truth\" }
";
    bench.write("m.toml", &format!("{}{broken}", small_pipeline()));
    let first = events(&bench, &[], 1);
    assert_eq!(first[0], serde_json::json!({ "event": "planned", "nodes": 12 }));
    assert!(words(&first, "event").is_superset(&BTreeSet::from(["started", "progress", "finished"])));
    assert_eq!(words(&first, "end"), BTreeSet::from(["done", "failed", "skipped"]));
    // A stored result that is damaged is made again, with a warning.
    let data = bench.path(".photocurrent/data");
    let largest = std::fs::read_dir(&data)
        .expect("contents")
        .map(|entry| entry.expect("an entry").path())
        .max_by_key(|path| std::fs::metadata(path).expect("a file").len())
        .expect("a content");
    std::fs::write(&largest, vec![0; std::fs::metadata(&largest).expect("it").len() as usize]).expect("it");
    let second = events(
        &bench,
        &["recording", "solve", "edi", "render", "psnr"].map(|node| ["--force", node]).concat(),
        1,
    );
    assert!(words(&second, "end").contains("reused"));
    let all: BTreeSet<&str> = words(&first, "event").union(&words(&second, "event")).copied().collect();
    let stated = schema();
    let stated: BTreeSet<&str> = stated["oneOf"]
        .as_array()
        .expect("events")
        .iter()
        .map(|event| event["properties"]["event"]["const"].as_str().expect("a name"))
        .collect();
    assert_eq!(all, stated, "each event was seen, and no other");
}

#[test]
fn another_form_is_refused_by_the_schema() {
    let schema = schema();
    for line in [
        r#"{"event":"planned"}"#,
        r#"{"event":"planned","nodes":-1}"#,
        r#"{"event":"planned","nodes":1,"more":1}"#,
        r#"{"event":"finished","node":"a","end":"executed","seconds":1.0,"bytes":1}"#,
        r#"{"event":"begun","node":"a","kind":"b"}"#,
    ] {
        assert!(against(&serde_json::from_str(line).expect("JSON"), &schema).is_some(), "{line}");
    }
}

#[test]
fn a_run_writes_its_page_and_prints_its_path_last() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    let done = bench.run(&["run", "m.toml", "--report"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(done.stdout.lines().last(), Some("out/m/report.html"));
    let html = std::fs::read_to_string(bench.path("out/m/report.html")).expect("the page");
    assert!(
        html.contains("psnr_db") && html.contains("data-part=\"canvas\" tabindex"),
        "scores and pictures"
    );
    // For programs it is a field.
    let outcome = bench.outcome(&["m.toml", "--report", "--out", "there"]);
    assert_eq!(outcome["report"], "there/report.html");
    assert_eq!(bench.outcome(&["m.toml"])["report"], Value::Null);
}

#[test]
fn a_run_that_nobody_can_confirm_is_refused() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    let done = bench.run(&["run", "m.toml", "--confirm"]);
    assert_eq!(done.code, 2, "{}", done.stderr);
    assert!(
        done.stderr.contains("--confirm waits for an answer, and stdin and stderr are no terminal")
            && done.stderr.contains("`photocurrent plan`"),
        "{}",
        done.stderr
    );
    assert!(!bench.path(".photocurrent").exists() && !bench.path("out").exists(), "nothing ran");
}

/// Runs the command at a terminal of its own, with an answer typed in; exit code and what the terminal shows.
fn at_a_terminal(bench: &Bench, arguments: &[&str], answer: &str) -> (i32, String) {
    use std::fs::File;
    use std::io::{Read, Write};
    use std::os::fd::{FromRawFd, OwnedFd};
    let (mut near, mut far) = (-1, -1);
    // SAFETY: openpty writes two descriptors, which are ours; the other arguments may be null.
    let opened = unsafe {
        libc::openpty(&mut near, &mut far, std::ptr::null_mut(), std::ptr::null(), std::ptr::null())
    };
    assert_eq!(opened, 0, "a terminal");
    // SAFETY: both were opened just now, and nobody else has them.
    let (mut near, far) = unsafe { (File::from_raw_fd(near), OwnedFd::from_raw_fd(far)) };
    let mut command = bench.command(arguments);
    let end = || far.try_clone().expect("a terminal");
    let mut child = command.stdin(end()).stdout(end()).stderr(end()).spawn().expect("the command starts");
    drop((command, far));
    near.write_all(answer.as_bytes()).expect("an answer");
    let (mut shown, mut piece) = (Vec::new(), [0; 4096]);
    // The system answers with an error when the command has closed its end.
    while let Ok(count) = near.read(&mut piece) {
        shown.extend_from_slice(&piece[..count]);
        if count == 0 {
            break;
        }
    }
    let code = child.wait().expect("an end").code().unwrap_or(-1);
    (code, String::from_utf8_lossy(&shown).into_owned())
}

#[test]
fn a_plan_is_shown_and_runs_after_a_yes_only() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    let run = ["run", "m.toml", "--confirm", "--progress", "none"];
    let (code, shown) = at_a_terminal(&bench, &run, "n\n");
    assert!(code == 130 && shown.contains("run? [y/N]") && shown.contains("nothing ran"), "{code}\n{shown}");
    assert!(shown.contains("at most 10 nodes to execute (for an unknown time, "), "{shown}");
    assert!(!bench.path(".photocurrent").exists(), "nothing ran");
    let (code, shown) = at_a_terminal(&bench, &run, "y\n");
    assert!(code == 0 && shown.contains("10 nodes executed"), "{code}\n{shown}");
    // Nothing to execute is nothing to confirm.
    let (code, shown) = at_a_terminal(&bench, &run, "");
    assert!(code == 0 && !shown.contains("[y/N]") && shown.contains("0 nodes executed"), "{code}\n{shown}");
    let (_, shown) = at_a_terminal(&bench, &[&run[..], &["--force", "psnr"]].concat(), "\n");
    assert!(
        shown.contains("at most 1 node to execute (about ") && shown.contains("1 of them forced"),
        "{shown}"
    );
}
