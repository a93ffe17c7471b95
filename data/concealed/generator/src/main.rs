//! Makes the recordings of sensors that conceal an effect, and the list of answers:
//! `cargo run --release -- --out ../recordings`.
//!
//! Nothing here is shared with the engine that the recordings examine: own scenes, own integrator, own random
//! numbers.

mod array;
mod digest;
mod draw;
mod effect;
mod field;
mod frames;
mod front_end;
mod law;
mod light;
mod limit;
mod lists;
mod observe;
mod optics;
mod plan;
mod random;
mod scene;
mod sensor;
mod stamps;
mod star;
#[cfg(test)]
mod tests;
mod texture;
mod views;
mod write;

use digest::sha256_hex;
use draw::draw;
use lists::Version;
use plan::Plan;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Part of every seed where none is named: another one gives other recordings.
const SEED: &str = "sealed physics, second edition";

const USAGE: &str =
    "usage: concealed-generator --out FOLDER [--plan short|long|target|field|outside] [--seed TEXT] \
                     [--blind] [--half open|blind] [--threads N] [--only FIRST..LAST]
  writes FOLDER/*.h5 and FOLDER/README.md, and answers.json beside FOLDER; --seed makes other recordings of \
  the same plan;
  --plan long makes recordings of a second, --plan target such of a star that FOLDER/*.target.toml state; \
  answers.json then lies in FOLDER;
  --blind writes half of the answers to FOLDER/answers.json and the other half to FOLDER/answers-blind.json;
  --half makes the recordings and answers of one of these halves alone;
  --only makes some of the recordings and no lists";

struct Options {
    version: Version,
    threads: usize,
    only: Option<std::ops::Range<usize>>,
}

fn options(mut words: impl Iterator<Item = String>) -> Result<Options, String> {
    let version =
        Version { plan: Plan::Short, seed: SEED.to_owned(), blind: false, half: None, out: PathBuf::new() };
    let mut options = Options { version, threads: 2, only: None };
    while let Some(word) = words.next() {
        if word == "--blind" {
            options.version.blind = true;
            continue;
        }
        let value = words.next().ok_or_else(|| format!("{word}: no value\n{USAGE}"))?;
        let number = |text: &str| {
            text.parse::<usize>().map_err(|_| {
                format!(
                    "{word} {value}: `{text}` is \
                                                            not a whole number\n{USAGE}"
                )
            })
        };
        match word.as_str() {
            "--out" => options.version.out = PathBuf::from(&value),
            "--plan" => {
                let plan = Plan::ALL.into_iter().find(|plan| plan.name() == value);
                options.version.plan =
                    plan.ok_or_else(|| format!("{word} {value}: no such plan\n{USAGE}"))?;
            }
            "--half" => {
                let half = ["open", "blind"].iter().position(|name| *name == value);
                let half = half.ok_or_else(|| format!("{word} {value}: neither open nor blind\n{USAGE}"))?;
                (options.version.blind, options.version.half) = (true, Some(half));
            }
            "--seed" => options.version.seed = value,
            "--threads" => options.threads = number(&value)?.max(1),
            "--only" => {
                let (first, last) = value.split_once("..").ok_or_else(|| {
                    format!(
                        "{word} {value}: not of \
                                                            the form 3..7\n{USAGE}"
                    )
                })?;
                options.only = Some(number(first)?..number(last)?);
            }
            _ => return Err(format!("{word}: no such option\n{USAGE}")),
        }
    }
    if options.version.out.as_os_str().is_empty() {
        return Err(format!("--out is missing\n{USAGE}"));
    }
    Ok(options)
}

/// The name of a recording without its ending.
fn id(version: &Version, index: usize) -> String {
    sha256_hex(format!("{}/name", version.plan.seed(&version.seed, index)).as_bytes())[..8].to_owned()
}

/// Makes one recording; gives its entry in the list of answers.
fn make(index: usize, version: &Version) -> Result<Value, String> {
    let mut draft = draw(version.plan, index, &version.seed)?;
    let [width, height] = draft.size;
    let (events, charge) =
        array::run(&draft.scene, &draft.physics, width, height, &draft.timing, &mut draft.random);
    let frames = frames::digitise(&charge, &draft.physics, width, draft.numbers, &mut draft.random);
    let stamped = stamps::stamp(&events, &draft.physics, width, height, draft.resolution, &mut draft.random);
    let id = id(version, index);
    let name = format!("{id}.h5");
    let path = version.out.join(&name);
    write::write(&path, &draft, &stamped, &frames)?;
    if let Some(target) = &draft.target {
        let path = version.out.join(format!("{id}.target.toml"));
        std::fs::write(&path, target)
            .map_err(|error| format!("{}: cannot be written: {error}", path.display()))?;
    }
    let bytes =
        std::fs::read(&path).map_err(|error| format!("{}: cannot be read back: {error}", path.display()))?;
    let mut answer = json!({
        "file": version.file(&name), "sha256": sha256_hex(&bytes), "bytes": bytes.len(),
        "events": stamped.len(),
    });
    if version.plan == Plan::Target {
        answer["width"] = width.into();
        answer["height"] = height.into();
    }
    if let (Some(answer), Some(rest)) = (answer.as_object_mut(), draft.answer.as_object()) {
        answer.extend(rest.clone());
    }
    if let Some(at_limit) = draft.at_limit.filter(|_| !version.is_plain()) {
        answer["at_limit"] = at_limit.into();
    }
    Ok(answer)
}

fn all(options: &Options) -> Result<(), String> {
    let version = &options.version;
    std::fs::create_dir_all(&version.out)
        .map_err(|error| format!("{}: cannot be made: {error}", version.out.display()))?;
    let most = version.plan.entries().len();
    let mut order: Vec<usize> =
        options.only.clone().unwrap_or(0..most).filter(|index| *index < most).collect();
    if let Some(half) = version.half {
        let names: Vec<Value> = (0..most).map(|index| json!({ "file": id(version, index) })).collect();
        let wanted = &lists::halves(&names)[half];
        order.retain(|index| wanted.contains(&names[*index]));
    }
    if version.blind {
        // Neither what is told on the way nor the files' times show the order of the plan.
        order.sort_by_key(|index| id(version, *index));
    }
    let next = AtomicUsize::new(0);
    let made: Mutex<Vec<(usize, Result<Value, String>)>> = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..options.threads {
            scope.spawn(|| {
                while let Some(index) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let answer = make(*index, version);
                    let mut made = made.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                    if let Ok(answer) = &answer {
                        eprintln!(
                            "{:3} of {} {} {} events, {} bytes",
                            made.len() + 1,
                            order.len(),
                            answer["file"],
                            answer["events"],
                            answer["bytes"]
                        );
                    }
                    made.push((*index, answer));
                }
            });
        }
    });
    let mut made = made.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    made.sort_by_key(|(index, _)| *index);
    let answers = made.into_iter().map(|(_, answer)| answer).collect::<Result<Vec<Value>, String>>()?;
    if options.only.is_some() { Ok(()) } else { lists::write(version, &answers) }
}

fn main() -> ExitCode {
    match options(std::env::args().skip(1)).and_then(|options| all(&options)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}
