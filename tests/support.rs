//! Runs the command in a folder of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The project's root.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every file below a folder, by its path from there, with its bytes.
pub fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn walk(top: &Path, folder: &Path, found: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                walk(top, &path, found);
            } else {
                found.insert(
                    path.strip_prefix(top).expect("below").to_path_buf(),
                    std::fs::read(&path).expect("a file"),
                );
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(folder, folder, &mut found);
    found
}

/// The same without `run.json`, in which a run says how it went: its results.
pub fn results(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = files(folder);
    found.retain(|path, _| path.file_name().is_none_or(|name| name != "run.json"));
    found
}

/// A folder of its own with a cache and an output folder, gone afterwards.
pub struct Bench {
    folder: tempfile::TempDir,
}

/// What a command did.
pub struct Done {
    /// Exit code; -1 when a signal ended it.
    pub code: i32,
    /// Its data.
    pub stdout: String,
    /// Its talk.
    pub stderr: String,
}

impl Bench {
    /// Empty.
    pub fn new() -> Bench {
        Bench { folder: tempfile::tempdir().expect("a temporary folder") }
    }

    /// A path in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file in it.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a file has a folder")).expect("a folder");
        std::fs::write(&path, text).expect("a file");
        path
    }

    /// The command with arguments, ready to start, in this folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_photocurrent"));
        command.args(arguments).current_dir(self.folder.path()).env("NO_COLOR", "1");
        command
    }

    /// Runs the command to its end.
    pub fn run(&self, arguments: &[&str]) -> Done {
        let Output { status, stdout, stderr } = self.command(arguments).output().expect("the command starts");
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Done { code: status.code().unwrap_or(-1), stdout: text(stdout), stderr: text(stderr) }
    }

    /// Runs the command with an address space of so many bytes at most: what it takes more of, it does not
    /// get.
    pub fn run_within(&self, bytes: u64, arguments: &[&str]) -> Done {
        use std::os::unix::process::CommandExt;
        let mut command = self.command(arguments);
        // Stacks of many threads are address space too.
        command.env("RAYON_NUM_THREADS", "2");
        let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
        // SAFETY: between fork and exec only setrlimit is called, which is safe there.
        unsafe {
            command.pre_exec(move || {
                if libc::setrlimit(libc::RLIMIT_AS, &limit) == 0 {
                    Ok(())
                } else {
                    Err(std::io::Error::last_os_error())
                }
            });
        }
        let Output { status, stdout, stderr } = command.output().expect("the command starts");
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Done { code: status.code().unwrap_or(-1), stdout: text(stdout), stderr: text(stderr) }
    }

    /// Runs a pipeline with `--json` and gives the outcome; fails the test when the command fails.
    pub fn outcome(&self, arguments: &[&str]) -> serde_json::Value {
        let mut all = vec!["run", "--json"];
        all.extend(arguments);
        let done = self.run(&all);
        assert_eq!(done.code, 0, "{}", done.stderr);
        serde_json::from_str(&done.stdout).expect("--json prints JSON")
    }
}

/// The names of the nodes that ran, in alphabetical order.
pub fn executed(outcome: &serde_json::Value) -> Vec<String> {
    let tasks = outcome["tasks"].as_array().expect("tasks");
    let mut names: Vec<String> = tasks
        .iter()
        .filter(|task| task["end"] == "executed")
        .map(|task| task["node"].as_str().expect("a name").to_string())
        .collect();
    names.sort();
    names
}

/// The content digest of every output, by `node.port`.
pub fn digests(outcome: &serde_json::Value) -> std::collections::BTreeMap<String, String> {
    let tasks = outcome["tasks"].as_array().expect("tasks");
    let of = |task: &serde_json::Value| {
        let outputs = task["outputs"].as_object().expect("outputs").clone();
        let node = task["node"].as_str().expect("a name").to_string();
        outputs.into_iter().map(move |(port, output)| {
            (format!("{node}.{port}"), output["digest"].as_str().expect("a digest").to_string())
        })
    };
    tasks.iter().flat_map(of).collect()
}

/// A small pipeline that has every family: simulated, split, solved, rendered, scored, written. Takes under a
/// second.
pub fn small_pipeline() -> String {
    let sensor = root().join("data/sensors/hybrid.toml");
    format!(
        r#"format = 1
[pipeline]
seed = 7
[nodes.sensor]
kind = "read/sensor"
params = {{ path = {sensor:?} }}
[nodes.scene]
kind = "simulate/scene"
in = {{ sensor = "sensor" }}
params = {{ scene = "pellet", width = 32, height = 24, duration = "40 ms", illuminance = "800 lx", pellet = {{ pellets = 2, speed = 4.0 }} }}
[nodes.recording]
kind = "simulate/sensor"
in = {{ light = "scene.light", sensor = "sensor" }}
[nodes.solve]
kind = "solve/paper"
in = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
params = {{ cis_weight = 1.0, evs_weight = 1000.0 }}
[nodes.render]
kind = "render/rows"
in = {{ tracks = "solve.tracks", sensor = "sensor" }}
[nodes.edi]
kind = "baseline/edi"
in = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
[nodes.psnr]
kind = "score/psnr"
in = {{ frames = "render", truth = "scene.truth" }}
[nodes.psnr_edi]
kind = "score/psnr"
in = {{ frames = "edi", truth = "scene.truth" }}
[nodes.table]
kind = "write/table"
in = {{ tables = ["psnr", "psnr_edi"] }}
params = {{ labels = ["ours", "EDI"] }}
[nodes.frames]
kind = "write/frames"
in = {{ frames = "render" }}
"#
    )
}
