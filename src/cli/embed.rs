//! The command in a program of somebody else's: its streams as texts, a flag instead of signals, an observer
//! instead of bars, and the results of a run to read. `src/python` calls it.

use crate::args::{Args, Command};
pub use crate::run::Ran;
use crate::terminal;
use crate::{code_of, execute, help, problems, run};
use clap::FromArgMatches;
use photocurrent_core::document::Problem;
use photocurrent_engine::{Observer, Unobserved};
use std::ffi::OsString;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What the program offers a command.
#[derive(Default)]
pub struct Host {
    /// Set by the program, from any thread, to stop the command: running nodes stop at their next step.
    pub cancel: Arc<AtomicBool>,
    /// Watches runs; nobody does without.
    pub observer: Option<Arc<dyn Observer + Send + Sync>>,
}

/// What came of a command.
pub struct Heard {
    /// The exit code that the process would have.
    pub code: u8,
    /// What it would have written to stdout.
    pub out: String,
    /// What it would have written to stderr: mistakes, notes.
    pub err: String,
    /// The results of `run`.
    pub ran: Option<Ran>,
}

/// Runs one command in this thread. `arguments` begin with the name of the program; nothing ends the process
/// or listens for its signals.
pub fn command(arguments: impl IntoIterator<Item = OsString>, host: Host) -> Heard {
    let parsed = help::command().try_get_matches_from(arguments);
    let args = match parsed.and_then(|matches| Args::from_arg_matches(&matches)) {
        Ok(args) => args,
        Err(error) => {
            let text = error.render().to_string();
            let (out, err) = if error.use_stderr() { (String::new(), text) } else { (text, String::new()) };
            return Heard { code: error.exit_code() as u8, out, err, ran: None };
        }
    };
    let Host { cancel, observer } = host;
    let observer = Some(observer.unwrap_or_else(|| Arc::new(Unobserved)));
    let host = terminal::Host { cancel, observer, ..terminal::Host::default() };
    let ((code, ran), host) = terminal::hosted(host, || match &args.command {
        Command::Run(options) => match run::run_and_keep(options) {
            Ok(done) => done,
            Err(failure) => (code_of(Err(failure)), None),
        },
        other => (code_of(execute(other)), None),
    });
    Heard { code, out: host.out, err: host.err, ran }
}

/// Mistakes of a text as the command shows them.
pub fn mistakes(problems: &[Problem]) -> String {
    terminal::hosted(terminal::Host::default(), || problems::render(problems)).1.err
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(arguments: &[&str]) -> Heard {
        command(
            std::iter::once("photocurrent").chain(arguments.iter().copied()).map(Into::into),
            Host::default(),
        )
    }

    #[test]
    fn streams_are_texts_and_codes_are_those_of_the_process() {
        let listed = heard(&["nodes", "solve/map"]);
        assert!(listed.code == 0 && listed.out.contains("solve/map") && listed.err.is_empty());
        let unknown = heard(&["nodes", "solve/mapp"]);
        assert!(unknown.code == 2 && unknown.out.is_empty() && unknown.err.contains("solve/map"));
        let wrong = heard(&["nodes", "--no-such-option"]);
        assert!(wrong.code == 2 && wrong.err.contains("--no-such-option"), "{}", wrong.err);
        let version = heard(&["--version"]);
        assert_eq!((version.code, version.err.as_str()), (0, ""));
        assert!(version.out.contains(env!("CARGO_PKG_VERSION")));
    }

    #[test]
    fn a_run_gives_its_results() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        std::fs::write(at("s.toml"), "format = \"photocurrent-sensor/1\"\nname = \"s\"\n").unwrap();
        let manifest = "format = 1\n[nodes.sensor]\nkind = \"read/sensor\"\nparams = { path = \"s.toml\" }\n";
        std::fs::write(at("m.toml"), manifest).unwrap();
        let run = ["run", &at("m.toml"), "--cache", &at("cache"), "--out", &at("out")];
        let Ran { outcome, cache, out_dir, .. } = heard(&run).ran.unwrap();
        let value = outcome.value(&cache, "base", "sensor", "sensor").unwrap();
        assert!(matches!(value, Some(photocurrent_core::Value::Sensor(_))));
        assert!(out_dir.join("run.json").exists());
        let failed = heard(&["run", &at("none.toml")]);
        assert!(failed.code == 2 && failed.ran.is_none() && failed.err.contains("none.toml"));
    }

    #[test]
    fn a_set_flag_stops_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let cancel = Arc::new(AtomicBool::new(true));
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        let arguments = ["photocurrent".into(), "run".into(), root.join("pipelines/quickstart.toml").into()];
        let more = ["--cache".into(), folder.path().join("cache").into()];
        let out = ["--out".into(), folder.path().join("out").into()];
        let host = Host { cancel, observer: None };
        assert_eq!(command(arguments.into_iter().chain(more).chain(out), host).code, 130);
    }
}
