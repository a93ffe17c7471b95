//! Makes the recordings of sensors that conceal an effect, and the list of answers: `cargo run --release -- --out ../recordings`.
//!
//! Nothing here is shared with the engine that the recordings examine: own scenes, own integrator, own random numbers.

mod array;
mod digest;
mod draw;
mod effect;
mod frames;
mod front_end;
mod law;
mod light;
mod optics;
mod plan;
mod random;
mod scene;
mod sensor;
mod stamps;
#[cfg(test)]
mod tests;
mod texture;
mod write;

use digest::sha256_hex;
use draw::{HEIGHT, WIDTH, draw};
use plan::PLAN;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Part of every seed where none is named: another one gives other recordings.
const SEED: &str = "sealed physics, second edition";

const USAGE: &str = "usage: sealed-generator --out FOLDER [--seed TEXT] [--threads N] [--only FIRST..LAST]
  writes FOLDER/*.h5 and FOLDER/README.md, and answers.json beside FOLDER; --seed makes other recordings of the same plan;
  --only makes some of the recordings and no lists";

struct Options {
    out: PathBuf,
    seed: String,
    threads: usize,
    only: Option<std::ops::Range<usize>>,
}

fn options() -> Result<Options, String> {
    let mut options = Options { out: PathBuf::new(), seed: SEED.to_owned(), threads: 2, only: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word}: no value\n{USAGE}"))?;
        let number = |text: &str| text.parse::<usize>().map_err(|_| format!("{word} {value}: `{text}` is not a whole number\n{USAGE}"));
        match word.as_str() {
            "--out" => options.out = PathBuf::from(&value),
            "--seed" => options.seed = value,
            "--threads" => options.threads = number(&value)?.max(1),
            "--only" => {
                let (first, last) = value.split_once("..").ok_or_else(|| format!("{word} {value}: not of the form 3..7\n{USAGE}"))?;
                options.only = Some(number(first)?..number(last)?.min(PLAN.len()));
            }
            _ => return Err(format!("{word}: no such option\n{USAGE}")),
        }
    }
    if options.out.as_os_str().is_empty() {
        return Err(format!("--out is missing\n{USAGE}"));
    }
    Ok(options)
}

/// Makes one recording; gives its entry in the list of answers.
fn make(index: usize, seed: &str, out: &Path) -> Result<Value, String> {
    let mut draft = draw(index, &PLAN[index], seed)?;
    let (events, charge) = array::run(&draft.scene, &draft.physics, WIDTH, HEIGHT, &draft.timing, &mut draft.random);
    let frames = frames::digitise(&charge, &draft.physics, WIDTH, draft.numbers, &mut draft.random);
    let stamped = stamps::stamp(&events, &draft.physics, WIDTH, HEIGHT, draft.resolution, &mut draft.random);
    let name = format!("{}.h5", &sha256_hex(format!("{seed}/{index}/name").as_bytes())[..8]);
    let path = out.join(&name);
    write::write(&path, &draft, &stamped, &frames)?;
    let bytes = std::fs::read(&path).map_err(|error| format!("{}: cannot be read back: {error}", path.display()))?;
    let mut answer = json!({ "file": format!("recordings/{name}"), "sha256": sha256_hex(&bytes), "bytes": bytes.len(), "events": stamped.len() });
    if let (Some(answer), Some(rest)) = (answer.as_object_mut(), draft.answer.as_object()) {
        answer.extend(rest.clone());
    }
    Ok(answer)
}

/// The list of recordings beside them; it says nothing about what they conceal.
fn list(answers: &[Value]) -> String {
    let mut rows: Vec<String> = answers
        .iter()
        .map(|answer| {
            let file = answer["file"].as_str().unwrap_or_default().trim_start_matches("recordings/");
            format!("| `{file}` | {} | {} | `{}` |\n", answer["bytes"], answer["events"], answer["sha256"].as_str().unwrap_or_default())
        })
        .collect();
    rows.sort();
    format!(
        "# Recordings\n\nWritten by [the generator](../generator) together with the recordings; do not edit.\nWhat they are, how they are made and under which licence: [README.md](../README.md).\n\n| file | bytes | events | SHA-256 |\n| --- | --- | --- | --- |\n{}",
        rows.concat()
    )
}

fn all(options: &Options) -> Result<(), String> {
    std::fs::create_dir_all(&options.out).map_err(|error| format!("{}: cannot be made: {error}", options.out.display()))?;
    let range = options.only.clone().unwrap_or(0..PLAN.len());
    let next = AtomicUsize::new(range.start);
    let made: Mutex<Vec<(usize, Result<Value, String>)>> = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..options.threads {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= range.end {
                        break;
                    }
                    let answer = make(index, &options.seed, &options.out);
                    if let Ok(answer) = &answer {
                        eprintln!("{index:3} {} {} events, {} bytes", answer["file"], answer["events"], answer["bytes"]);
                    }
                    made.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((index, answer));
                }
            });
        }
    });
    let mut made = made.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    made.sort_by_key(|(index, _)| *index);
    let answers = made.into_iter().map(|(_, answer)| answer).collect::<Result<Vec<Value>, String>>()?;
    if options.only.is_some() {
        return Ok(());
    }
    let document = json!({ "schema": "photocurrent-sealed-answers/1", "seed": options.seed, "width": WIDTH, "height": HEIGHT, "recordings": answers });
    let text = serde_json::to_string_pretty(&document).map_err(|error| format!("answers: {error}"))?;
    let beside = options.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")).join("answers.json");
    std::fs::write(&beside, text + "\n").map_err(|error| format!("{}: cannot be written: {error}", beside.display()))?;
    let readme = options.out.join("README.md");
    std::fs::write(&readme, list(&answers)).map_err(|error| format!("{}: cannot be written: {error}", readme.display()))
}

fn main() -> ExitCode {
    match options().and_then(|options| all(&options)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}
