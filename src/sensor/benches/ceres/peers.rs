//! Builds the programs of the peers, hands them problems and takes their answers: plain text files in the
//! target folder.

use crate::cases::Case;
use crate::ours::{Answer, Repeat};
use photocurrent_sensor::front_end::TauRule;
use photocurrent_sensor::residuals::cost;
use std::fmt::Write;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Why there is nothing to compare with.
pub enum Unbuilt {
    /// A compiler or a header is not installed: what.
    Missing(&'static str),
    /// Something else went wrong: what.
    Failed(String),
}

/// The two programs, built.
pub struct Peers {
    folder: PathBuf,
}

/// What the sources say, as `#error`, when a header is not there.
const MARK: &str = "PEER_MISSING";

impl Peers {
    /// Builds both programs with g++.
    pub fn build() -> Result<Peers, Unbuilt> {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ceres");
        fs::create_dir_all(&folder)
            .map_err(|error| Unbuilt::Failed(format!("{}: {error}", folder.display())))?;
        let peers = Peers { folder };
        // The header-only solver is built for this processor. The library is as its package has it; flags
        // that differ would break its ABI.
        peers.compile("tiny", &["-march=native"], &["-lglog"])?;
        peers.compile("library", &[], &["-lceres", "-lglog"])?;
        Ok(peers)
    }

    fn compile(&self, name: &str, flags: &[&str], libraries: &[&str]) -> Result<(), Unbuilt> {
        let source =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/ceres").join(name).with_extension("cpp");
        // Without pkg-config or without Eigen the source says itself what is missing.
        let eigen = Command::new("pkg-config").args(["--cflags", "eigen3"]).output();
        let eigen =
            eigen.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default();
        let mut command = Command::new("g++");
        command.args(["-std=c++17", "-O3"]).args(flags).args(eigen.split_whitespace());
        command.arg(source).arg("-o").arg(self.folder.join(name)).args(libraries);
        let output = match command.output() {
            Err(error) if error.kind() == ErrorKind::NotFound => return Err(Unbuilt::Missing("g++")),
            Err(error) => return Err(Unbuilt::Failed(format!("g++ does not start: {error}"))),
            Ok(output) => output,
        };
        let said = String::from_utf8_lossy(&output.stderr);
        if output.status.success() {
            Ok(())
        } else if said.contains(MARK) {
            Err(Unbuilt::Missing("the headers of Ceres or Eigen"))
        } else {
            Err(Unbuilt::Failed(format!("g++ on {name}.cpp:\n{said}")))
        }
    }

    /// Every peer's answers, one per case, by the name of its method.
    pub fn solve(&self, cases: &[Case], repeat: Repeat) -> Result<Vec<(&'static str, Vec<Answer>)>, String> {
        let (given, found) = (self.folder.join("problems.txt"), self.folder.join("results.txt"));
        let file =
            |error: std::io::Error| format!("exchange of problems in {}: {error}", self.folder.display());
        fs::write(&given, cases.iter().map(text).collect::<String>()).map_err(file)?;
        let mut answers = Vec::new();
        for (program, methods) in [("tiny", &["tiny"][..]), ("library", &["dense", "qr", "chain"])] {
            let mut command = Command::new(self.folder.join(program));
            // One thread, whichever BLAS the library finds.
            command.env("OMP_NUM_THREADS", "1").env("OPENBLAS_NUM_THREADS", "1");
            command.arg(&given).arg(&found).args([repeat.least.to_string(), repeat.seconds.to_string()]);
            let output = command.output().map_err(file)?;
            if !output.status.success() {
                return Err(format!(
                    "{program} stopped with {}:\n{}",
                    output.status,
                    String::from_utf8_lossy(&output.stderr)
                ));
            }
            let results = fs::read_to_string(&found).map_err(file)?;
            for &method in methods {
                answers.push((method, read(&results, method, cases)?));
            }
        }
        Ok(answers)
    }
}

/// A problem in numbers, in the order that `statement.h` reads.
fn text(case: &Case) -> String {
    let problem = case.problem();
    let mut text = format!(
        "{} {} {} ",
        problem.t_s.len(),
        problem.frames.len(),
        i32::from(problem.tau_rule == TauRule::End)
    );
    let front_end = problem.front_end;
    let frames = problem.frames.iter().flat_map(|frame| [frame.start_s, frame.end_s, frame.dn, frame.weight]);
    let numbers =
        [problem.evs_weight, front_end.tau_0_s, front_end.alpha_s, problem.black_level, problem.gain]
            .into_iter();
    let columns = problem.t_s.iter().chain(problem.steps).chain(&case.start).copied();
    for number in numbers.chain(columns).chain(frames) {
        // The shortest digits that give the same bits back. Writing to a string cannot fail.
        let _ = write!(text, "{number:e} ");
    }
    text + "\n"
}

/// One method's lines; costs are restated here, not taken from the peer.
fn read(results: &str, method: &str, cases: &[Case]) -> Result<Vec<Answer>, String> {
    let mut answers = Vec::new();
    for line in results.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.get(1) != Some(&method) {
            continue;
        }
        let numbers: Result<Vec<f64>, _> = words[2..].iter().map(|word| word.parse::<f64>()).collect();
        let numbers = numbers.map_err(|error| format!("{method}: {error} in {line:?}"))?;
        let problem = cases
            .get(answers.len())
            .map(Case::problem)
            .filter(|problem| numbers.len() == 3 + problem.t_s.len());
        let Some(problem) = problem else {
            return Err(format!("{method}: line {} does not fit its problem", answers.len() + 1));
        };
        answers.push(Answer {
            setup_s: numbers[0],
            solve_s: numbers[1],
            iterations: numbers[2],
            cost: cost(&problem, &numbers[3..]),
        });
    }
    if answers.len() == cases.len() {
        Ok(answers)
    } else {
        Err(format!("{method}: {} answers to {} problems", answers.len(), cases.len()))
    }
}
