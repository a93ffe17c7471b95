//! What is diagnosed, and by which reader with which parameters: files with what is stated on the command
//! line, or the reader of a manifest.
//!
//! A manifest that `photocurrent init` wrote states what the files do not (units, exposures, what a stamp
//! means), so its reader is taken as it stands, and its description with it. A description that `init` wrote
//! lies next to its manifest: `--sensor my.sensor.toml` takes what the files do not state from `my.toml`, if
//! that reads the same recording; its window is not taken, as the files are named whole. What the command
//! line states comes first.

use crate::args::DiagnoseOptions;
use crate::failure::{Failure, usage};
use crate::file_kind::{FileKind, Reader};
use crate::parts::Parts;
use photocurrent_core::quantity::InputPath;
use photocurrent_core::{Catalogue, schema};
use photocurrent_engine::Project;
use photocurrent_nodes::read::foreign::All;
use serde_json::{Map, Value as Json};
use std::path::{Path, PathBuf};

/// A recording, its reader and its description.
#[derive(Debug)]
pub struct Given {
    /// The reader's kind: `read/aedat4`.
    pub kind: String,
    /// Its parameters, the path of the recording among them.
    pub all: All,
    /// The description; none = the recording's own.
    pub sensor: Option<PathBuf>,
    /// Fields to lay over the description.
    pub change: Map<String, Json>,
    /// Where the report goes unless something else is stated.
    pub folder: PathBuf,
    /// What was taken from where.
    pub notes: Vec<String>,
}

/// The form of a recording by this project's own reader.
const OURS: &str = "read/recording";
/// The reader of descriptions.
const SENSOR: &str = "read/sensor";
/// Parameters that a manifest's reader does not lend to files named by themselves: which file, and which part
/// of it.
const OF_MANIFEST: [&str; 4] = ["path", "start", "end", "crop"];

impl Given {
    /// From the arguments.
    ///
    /// # Errors
    /// When a file is of another kind, or a manifest has mistakes or reads no recording, or several.
    pub fn new(options: &DiagnoseOptions) -> Result<Given, Failure> {
        match options.files.as_slice() {
            [one] if matches!(FileKind::of(one), FileKind::Manifest) => Given::of_manifest(one, options),
            files => Given::of_files(files, options),
        }
    }

    /// The recording.
    pub fn path(&self) -> &Path {
        self.all.path.path()
    }

    fn of_files(files: &[PathBuf], options: &DiagnoseOptions) -> Result<Given, Failure> {
        let mut all = options.declared.parameters(&files[0]);
        if files.len() > 1 {
            let parts = Parts::sort(files)?;
            all.path = InputPath::new(parts.recording);
            all.frames = parts.frames.map(InputPath::new).or(all.frames);
            all.stamps = parts.stamps.map(InputPath::new).or(all.stamps);
        }
        let path = all.path.path().to_path_buf();
        let kind = match FileKind::of(&path) {
            FileKind::Recording(Reader::Format(format)) => format!("read/{}", format.id),
            FileKind::Recording(Reader::Ours) | FileKind::Missing => OURS.into(),
            kind => return Err(kind.refuse(&path, "diagnose", "a recording, or a manifest that reads one")),
        };
        let folder = Path::new("out").join(path.file_stem().unwrap_or_default());
        let mut given = Given {
            kind,
            all,
            sensor: options.sensor.clone(),
            change: Map::new(),
            folder,
            notes: Vec::new(),
        };
        given.take_from_neighbour()?;
        Ok(given)
    }

    /// What the files do not state, from the manifest next to a description of `photocurrent init`.
    fn take_from_neighbour(&mut self) -> Result<(), Failure> {
        let Some(manifest) = self.sensor.as_deref().and_then(manifest_of) else { return Ok(()) };
        // One with mistakes or of another recording is nobody's business here.
        let Ok((kind, params)) =
            read(&manifest, &photocurrent_nodes::catalogue()).and_then(|project| reader(&project, &manifest))
        else {
            return Ok(());
        };
        let is_same = |path: &Path| {
            path.canonicalize().ok().zip(self.path().canonicalize().ok()).is_some_and(|(a, b)| a == b)
        };
        if kind != self.kind
            || !params.get("path").and_then(Json::as_str).is_some_and(|path| is_same(Path::new(path)))
        {
            return Ok(());
        }
        let lent: Map<String, Json> =
            params.into_iter().filter(|(name, _)| !OF_MANIFEST.contains(&name.as_str())).collect();
        let taken = lay_under(&mut self.all, lent)?;
        if !taken.is_empty() {
            self.notes.push(format!("{} as in {}", taken.join(", "), manifest.display()));
        }
        Ok(())
    }

    fn of_manifest(manifest: &Path, options: &DiagnoseOptions) -> Result<Given, Failure> {
        let project = read(manifest, &photocurrent_nodes::catalogue())?;
        let (kind, params) = reader(&project, manifest)?;
        let mut all = options.declared.parameters(Path::new(""));
        all.path = params.get("path").and_then(Json::as_str).map(InputPath::new).unwrap_or_default();
        lay_under(&mut all, params)?;
        let (sensor, change) = match &options.sensor {
            Some(sensor) => (Some(sensor.clone()), Map::new()),
            None => description(&project, manifest)?,
        };
        // `out/NAME` is where a run of the manifest writes.
        let folder = Path::new("out")
            .join(format!("{}.diagnosis", manifest.file_stem().unwrap_or_default().to_string_lossy()));
        Ok(Given { kind, all, sensor, change, folder, notes: Vec::new() })
    }
}

/// `my.toml` of `my.sensor.toml`, where it is a manifest.
fn manifest_of(sensor: &Path) -> Option<PathBuf> {
    let name = sensor.file_name()?.to_str()?.strip_suffix(".sensor.toml")?;
    let manifest = sensor.with_file_name(format!("{name}.toml"));
    matches!(FileKind::of(&manifest), FileKind::Manifest).then_some(manifest)
}

fn read(manifest: &Path, catalogue: &Catalogue) -> Result<Project, Failure> {
    Ok(Project::load(manifest, &[], catalogue)?)
}

/// Kind and parameters of a node.
type KindAndParams = (String, Map<String, Json>);

/// Kind and parameters, paths joined to the manifest's folder, of the one node that `is_wanted` and the name
/// prefers; none where there is none.
fn node(
    project: &Project,
    name: &str,
    is_wanted: impl Fn(&str) -> bool,
) -> Result<Option<KindAndParams>, Vec<String>> {
    let Some(pipeline) = project.pipelines.first() else { return Ok(None) };
    let nodes: Vec<_> = pipeline.nodes.iter().filter(|node| is_wanted(&node.kind)).collect();
    let chosen = match nodes.as_slice() {
        [] => return Ok(None),
        [one] => *one,
        several => several
            .iter()
            .copied()
            .find(|node| node.id == name)
            .ok_or_else(|| several.iter().map(|node| node.id.clone()).collect::<Vec<_>>())?,
    };
    let catalogue = photocurrent_nodes::catalogue();
    let schema = catalogue.get(&chosen.kind).map_or(Json::Null, |kind| kind.schema.clone());
    let params = match schema::to_json(&chosen.params, &schema) {
        Json::Object(params) => params,
        _ => Map::new(),
    };
    Ok(Some((chosen.kind.clone(), params)))
}

/// The reader of the recording.
fn reader(project: &Project, manifest: &Path) -> Result<(String, Map<String, Json>), Failure> {
    let name = manifest.display();
    let hint = "hint: name the recording itself: photocurrent diagnose FILE --sensor SENSOR.toml";
    match node(project, "recording", |kind| kind.starts_with("read/") && kind != SENSOR) {
        Ok(Some(found)) => Ok(found),
        Ok(None) => {
            Err(usage(format!("{name}: the manifest reads no recording, and `diagnose` needs one\n  {hint}")))
        }
        Err(several) => Err(usage(format!(
            "{name}: the manifest reads several recordings ({}), and none is called `recording`\n  {hint}",
            several.join(", ")
        ))),
    }
}

/// The description that the manifest reads, and what it lays over; none where the recording carries it.
fn description(project: &Project, manifest: &Path) -> Result<(Option<PathBuf>, Map<String, Json>), Failure> {
    match node(project, "sensor", |kind| kind == SENSOR) {
        Ok(None) => Ok((None, Map::new())),
        Ok(Some((_, params))) => {
            let change = params.get("change").and_then(Json::as_object).cloned().unwrap_or_default();
            Ok((params.get("path").and_then(Json::as_str).map(PathBuf::from), change))
        }
        Err(several) => Err(usage(format!(
            "{}: the manifest reads several sensor descriptions ({}), and none is called `sensor`\n  hint: \
             name one: --sensor FILE",
            manifest.display(),
            several.join(", ")
        ))),
    }
}

/// Takes parameters that are not stated from `below`; the names of those.
fn lay_under(all: &mut All, below: Map<String, Json>) -> Result<Vec<String>, Failure> {
    let failed = |error: serde_json::Error| Failure::other(format!("parameters of a reader: {error}"));
    let mut value = serde_json::to_value(&*all).map_err(failed)?;
    let mut taken = Vec::new();
    if let Some(stated) = value.as_object_mut() {
        for (name, value) in below.into_iter().filter(|(_, value)| !value.is_null()) {
            if stated.get(&name).is_none_or(Json::is_null) {
                stated.insert(name.clone(), value);
                taken.push(name);
            }
        }
    }
    *all = serde_json::from_value(value).map_err(failed)?;
    Ok(taken)
}
