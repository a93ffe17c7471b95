//! `baseline/exec`: frames that a command of yours makes, as a node like any other: planned, cached,
//! explained.
//!
//! The command runs in an empty folder that becomes this node's output folder. It finds there `recording.h5`
//! (events, frames, sensor, in the layout of docs/formats.md), and `times_us.txt`, one line a wanted picture:
//! the middle of its exposure in us. It writes one picture a line into `pictures/` (`*.png`, or `*.npy` of
//! [height, width] or [height, width, 3]), in the order of their names: of three channels where the captured
//! frames have three. What it prints goes to `stdout.txt` and `stderr.txt` next
//! to them.
//!
//! It runs again when its inputs, parameters or `files` change, and when `version` does: that text is yours
//! to raise, for everything that cannot be seen from here (the interpreter, weights, a library). No shell
//! takes part unless `command` names one. Limits: what a command does besides, nobody here knows; one that
//! draws random numbers needs a seed of its own.

use super::external::pictures::{Levels, pictures};
use crate::command;
use crate::reconstruct::Request;
use crate::sampling::Sampling;
use crate::simulate::stored::Transfer;
use crate::write::recording::{self, WriteRecording};
use photocurrent_core::quantity::InputPath;
use photocurrent_core::{
    Context, Decl, EventStream, FileRef, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
    Sensor,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Parameters of `baseline/exec`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// The program and its arguments, each by itself; no shell sees them. `{file0}`, `{file1}` .. stand for
    /// the whole paths of `files`.
    pub command: Vec<String>,
    /// What stands for everything that the result depends on and that is not seen from here; a new text runs
    /// the command anew.
    pub version: String,
    /// Scripts and other files of the command, relative to the manifest that names them; their content is
    /// part of the key.
    pub files: Vec<InputPath>,
    /// DN of the pictures' white; absent = the sensor description's saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Stored value that is white in `.npy` files; absent = 255 or 65535 for whole numbers, 1 for others.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub stored_white: Option<f64>,
    /// How stored values of PNG pictures become linear light; absent = linear.
    pub transfer: Option<Transfer>,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Captured frames.
        frames: FrameSequence,
        /// Events.
        events: Option<EventStream>,
        /// The sensor description; its black level and saturation.
        sensor: Option<Arc<Sensor>>,
        /// Frames whose exposures and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The command's pictures as frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct BaselineExec {
    params: Params,
}

impl BaselineExec {
    fn prepare(&self, request: &Request) -> Result<(FramesMeta, Levels), NodeError> {
        let params = &self.params;
        let levels = Levels::new(
            params.white,
            params.stored_white,
            params.transfer.unwrap_or(Transfer::Linear),
            request.sensor,
        )?;
        request.need_plain_or_colour("baseline/exec")?;
        Ok((request.output(&params.sampling)?, levels))
    }

    /// The arguments with the places of files filled in.
    fn arguments(&self) -> Result<Vec<String>, NodeError> {
        let mut arguments = self.params.command.clone();
        for (n, file) in self.params.files.iter().enumerate() {
            let path = std::path::absolute(file.path()).map_err(|error| {
                NodeError::files(format!("{}: {error}", file.path().display())).param("files")
            })?;
            let path = path.to_string_lossy();
            arguments
                .iter_mut()
                .for_each(|argument| *argument = argument.replace(&format!("{{file{n}}}"), &path));
        }
        Ok(arguments)
    }

    /// Runs the command in `folder` to its end.
    fn run_command(&self, folder: &Path, cx: &Context) -> Result<(), NodeError> {
        let arguments = self.arguments()?;
        command::run(folder, &arguments[0], &arguments[1..], "command", cx).map_err(|error| {
            match error.message.starts_with("cannot start") {
                true => error.hint(
                    "name a program on the path or by its whole path; a script stands in \
                                `files`, as `{file0}` in `command`",
                ),
                false => error,
            }
        })
    }
}

impl Node for BaselineExec {
    const DECL: Decl = Decl {
        kind: "baseline/exec",
        about: "Frames made by a command of yours, with declared inputs and version, cached like any node.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["whatever the command runs"],
        example: r#"
[nodes.mine]
kind   = "baseline/exec"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor", at = "recording.frames" }
params = { command = ["python3", "{file0}"], files = ["my_method.py"], version = "1", white = 1023 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.command.is_empty() {
            return Err(NodeError::usage("`command` is missing")
                .hint("such as command = [\"python3\", \"{file0}\"]")
                .param("command"));
        }
        if params.version.is_empty() {
            return Err(NodeError::usage("`version` is missing: the cache cannot see into a command")
                .hint("any text, such as version = \"1\"; change it when the command changes")
                .param("version"));
        }
        Ok(BaselineExec { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(Arc::new(self.prepare(&Request::planned(inputs)?)?.0))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = Request::connected(&input.frames, input.events.as_ref(), &input.at, &input.sensor);
        let (meta, levels) = self.prepare(&request)?;
        let folder = cx.export_dir()?;
        let written = |what: &str, result: std::io::Result<()>| {
            result.map_err(|error| NodeError::files(format!("cannot write {what}: {error}")))
        };
        let content = recording::In {
            events: input.events.clone(),
            frames: Some(input.frames.clone()),
            sensor: input.sensor.clone(),
            truth: None,
        };
        WriteRecording::build(recording::Params::default())?.run(content, cx)?;
        let row = meta.extent.height / 2;
        let times: String = (0..meta.times.len())
            .map(|l| format!("{}\n", meta.times.exposure(l, row).mid().0 as f64 / 1000.0))
            .collect();
        written("times_us.txt", std::fs::write(folder.join("times_us.txt"), times))?;
        written("pictures", std::fs::create_dir(folder.join("pictures")))?;
        self.run_command(folder, cx)?;
        let found = pictures(&folder.join("pictures")).map_err(|error| error.param("command"))?;
        if found.len() != meta.times.len() {
            return Err(NodeError::failed(format!(
                "the command wrote {} pictures, and {} are wanted",
                found.len(),
                meta.times.len()
            ))
            .hint("one picture for each line of times_us.txt, into pictures/")
            .param("command"));
        }
        cx.begin(found.len() as u64, "pictures");
        let paths: Vec<&Path> = found.iter().map(|path| path.as_path()).collect();
        let block = levels.frames(cx, &meta, &paths)?;
        Ok(Out { frames: FrameSequence::in_memory(Arc::new(meta), block) })
    }

    fn files(&self) -> Vec<FileRef> {
        self.params
            .files
            .iter()
            .map(|file| FileRef { param: "files".into(), path: file.path().to_path_buf() })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::context::{Notes, Silent};
    use photocurrent_core::{Colour, Exposure, Extent, FrameBlock, testing};
    use std::collections::BTreeSet;
    use std::sync::atomic::AtomicBool;

    const EXTENT: Extent = Extent { width: 2, height: 1 };

    /// Runs a shell script, which stands in a file of its own, over one grey frame.
    fn run(script: &str, interrupted: bool) -> Result<Vec<f32>, NodeError> {
        let frames = testing::captured(EXTENT, vec![Exposure::new(0, 3_000)], 0, |_, _, _| 7.0);
        run_next_to(frames, script, interrupted)
    }

    fn run_next_to(frames: FrameSequence, script: &str, interrupted: bool) -> Result<Vec<f32>, NodeError> {
        let place = tempfile::tempdir().unwrap();
        let (file, folder) = (place.path().join("script.sh"), place.path().join("out"));
        std::fs::write(&file, script).unwrap();
        std::fs::create_dir(&folder).unwrap();
        let params = Params {
            command: vec!["sh".into(), "{file0}".into(), "a b".into()],
            version: "1".into(),
            files: vec![InputPath::new(file)],
            white: Some(255.0),
            ..Params::default()
        };
        let input = In { frames: frames.clone(), events: None, sensor: None, at: Some(frames) };
        let (wanted, cancel, notes) =
            (BTreeSet::from(["frames".to_string()]), AtomicBool::new(interrupted), Notes::default());
        let cx = Context::new(EXTENT.rows(), 0, &wanted, &Silent, &cancel, Some(&folder), &notes);
        BaselineExec::build(params)?
            .run(input, &cx)?
            .frames
            .read_rows(EXTENT.rows())
            .map(|block| block.dn)
            .map_err(NodeError::from)
    }

    /// A picture of two 8-bit pixels, 65 ("A") and 66 ("B"), as a shell can write it.
    const PICTURE: &str = concat!(
        r#"printf "\223NUMPY\001\000\071\000{'descr': '|u1', 'fortran_order': False, "#,
        r#"'shape': (1, 2)}AB" > pictures/0.npy"#
    );

    #[test]
    fn a_command_finds_its_inputs_and_gives_its_pictures() {
        let script = format!(
            "set -e\ntest -s recording.h5\ntest \"$(cat times_us.txt)\" = 1.5\ntest \"$1\" \
                              = 'a b'\n{PICTURE}\n"
        );
        assert_eq!(run(&script, false).unwrap(), [65.0, 66.0]);
    }

    #[test]
    fn a_command_finds_colours_and_gives_them() {
        let meta = FramesMeta {
            colour: Colour::Rgb,
            ..(*testing::captured(EXTENT, vec![Exposure::new(0, 3_000)], 0, |_, _, _| 7.0).meta).clone()
        };
        let block = FrameBlock::zeros(0..1, EXTENT.rows(), meta.row_values());
        let frames = FrameSequence::in_memory(Arc::new(meta), block);
        let picture = concat!(
            r#"printf "\223NUMPY\001\000\072\000{'descr': '|u1', 'fortran_order': False, "#,
            r#"'shape': (1,2,3)}ABCDEF" > pictures/0.npy"#
        );
        let found = run_next_to(frames, &format!("test -s recording.h5 && {picture}"), false).unwrap();
        assert_eq!(found, [65.0, 66.0, 67.0, 68.0, 69.0, 70.0]);
    }

    #[test]
    fn a_failing_command_shows_its_exit_code_and_its_last_words() {
        let error = run("echo so far so good\nfor i in 1 2 3; do echo line $i >&2; done\nexit 7\n", false)
            .unwrap_err();
        assert_eq!(error.message, "\"sh\" ended with exit code 7");
        assert_eq!(
            error.notes,
            [
                "the last of stderr.txt:",
                "| line 1",
                "| line 2",
                "| line 3",
                "the last of stdout.txt:",
                "| so far so good"
            ]
        );
    }

    #[test]
    fn a_command_that_writes_too_little_learns_what_is_wanted() {
        assert!(run("true\n", false).unwrap_err().message.starts_with("there is no picture in"));
        let error = run(&format!("{PICTURE}\ncp pictures/0.npy pictures/1.npy\n"), false).unwrap_err();
        assert_eq!(error.message, "the command wrote 2 pictures, and 1 are wanted");
    }

    #[test]
    fn an_interrupted_run_ends_the_command() {
        // Without an end to the command, this test would not end either.
        let error = run("exec sleep 100000\n", true).unwrap_err();
        assert_eq!(error.message, "interrupted");
    }

    #[test]
    fn what_cannot_start_is_named() {
        let node = |command: &[&str], version: &str| {
            BaselineExec::build(Params {
                command: command.iter().map(|word| word.to_string()).collect(),
                version: version.into(),
                ..Params::default()
            })
        };
        assert_eq!(node(&[], "1").err().and_then(|error| error.param).as_deref(), Some("command"));
        assert_eq!(node(&["true"], "").err().and_then(|error| error.param).as_deref(), Some("version"));
        let folder = tempfile::tempdir().unwrap();
        let (error, _) = testing::with_context(EXTENT.rows(), &[], |cx| {
            node(&["no-such-program-here"], "1").unwrap().run_command(folder.path(), cx)
        });
        assert!(error.unwrap_err().message.starts_with("cannot start \"no-such-program-here\""));
    }
}
