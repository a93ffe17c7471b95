//! `photocurrent cache pack`: a finished run as one file to pass on, from which `cache unpack` makes it
//! complete elsewhere.
//!
//! A pack (`photocurrent-pack/1`, docs/formats.md) is a zip archive whose members are stored as they are: the
//! results are compressed already. It holds the manifest with what it extends, the files that its nodes read,
//! records and contents of the cache, and the files that the run wrote for the user.

use crate::args::{PackOptions, Target};
use crate::failure::{Done, Failure, usage};
use crate::file_kind::FileKind;
use crate::numbers::{human_bytes, print_count};
use crate::run_record::RunRecord;
use crate::terminal::{print, print_json, say};
use photocurrent_core::Digest;
use photocurrent_engine::{Plan, Project, STAMP, State, node_of, read_stamp, status};
use photocurrent_store::{Cache, Lookup, TOOL_VERSION, unnamed_in};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, Write};
use std::path::{Component, Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// The form of a pack.
pub const FORMAT: &str = "photocurrent-pack/1";
/// The member that says what the others are; the first one.
pub const ABOUT: &str = "pack.toml";
/// What the manifest and the files of its nodes are named behind.
pub const PROJECT: &str = "project/";
/// What the files for the user are named behind.
pub const OUT: &str = "out/";

/// What a pack says of itself.
#[derive(Debug, Serialize, Deserialize)]
pub struct About {
    pub format: String,
    /// Version of the program.
    pub version: String,
    /// The manifest, below `project/`.
    pub manifest: String,
    /// What is laid over it.
    pub sets: Vec<String>,
    /// Which variants; none for all.
    pub variants: Vec<String>,
    /// Which nodes, with what they need; none for all.
    pub to: Vec<String>,
    /// Records, `cache/keys/<key>.toml`.
    pub keys: Vec<Digest>,
    /// Contents that they name, `cache/data/<digest>.h5`.
    pub contents: Vec<Digest>,
    /// Every member below `project/` and `out/`; of a folder for the user, its stamp first.
    #[serde(default)]
    pub files: Vec<Member>,
    /// Files that nodes read and that cannot be placed below `project/`.
    #[serde(default)]
    pub elsewhere: Vec<Elsewhere>,
}

/// A member that is a file of somebody's.
#[derive(Debug, Serialize, Deserialize)]
pub struct Member {
    pub name: String,
    pub bytes: u64,
    /// Of its bytes.
    pub blake3: Digest,
}

/// A file that stays where it is.
#[derive(Debug, Serialize, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
pub struct Elsewhere {
    pub node: String,
    /// The parameter that names it.
    pub param: String,
    pub path: PathBuf,
}

/// The member of a record.
pub fn record_name(key: &Digest) -> String {
    format!("cache/keys/{key}.toml")
}

/// The member of a content.
pub fn content_name(digest: &Digest) -> String {
    format!("cache/data/{digest}.h5")
}

/// Packs a run that has ended well; prints the file's name.
pub fn pack(options: &PackOptions, cache: &Path, json: bool) -> Done {
    let output = &options.output;
    if output.exists() && !options.force {
        let hint = "hint: give another name, or --force to replace it";
        return Err(usage(format!("{} exists\n  {hint}", output.display())));
    }
    let target = target(options, cache)?;
    if !target.cache.is_dir() {
        let message = format!("there is no cache at {}; --cache names another", target.cache.display());
        return Err(usage(message));
    }
    let (project, plan) = target.plan("cache pack")?;
    target.check_out_dir()?;
    let cache = Cache::open(&target.cache)?;
    let keys = finished(&target, &plan, &cache)?;
    let mut members: BTreeMap<String, PathBuf> = BTreeMap::new();
    let contents = contents(&cache, &keys, &mut members)?;
    let (manifest, elsewhere) = project_files(&project, &plan, &mut members)?;
    let mut files = Vec::new();
    for (name, path) in members.iter().filter(|(name, _)| name.starts_with(PROJECT)) {
        files.push(member(&cache, name.clone(), path)?);
    }
    for (name, path) in exported(&target, &plan) {
        files.push(member(&cache, name.clone(), &path)?);
        members.insert(name, path);
    }
    let (sets, variants, to) = (target.sets.clone(), target.variants.clone(), target.to.clone());
    let (format, version) = (FORMAT.into(), TOOL_VERSION.into());
    let about = About { format, version, manifest, sets, variants, to, keys, contents, files, elsewhere };
    let bytes = write(output, &about, &members)?;
    for file in &about.elsewhere {
        say!("note: {}", not_packed(file));
    }
    if json {
        print_json(&json!({ "file": output, "bytes": bytes, "pack": about }))?;
    } else {
        let (records, files) = (about.keys.len(), about.files.len());
        say!(
            "{} with {} and {}: {}",
            print_count(records, "record"),
            print_count(about.contents.len(), "content"),
            print_count(files, "file"),
            human_bytes(bytes)
        );
        print(&output.display().to_string())?;
    }
    Ok(0)
}

/// Why a file is not in the pack, and what to do.
pub fn not_packed(file: &Elsewhere) -> String {
    format!(
        "nodes.{}.params.{} names {}, which is not in the pack: only a path that a manifest writes relative \
         to itself can be packed; whoever unpacks needs that file there",
        file.node,
        file.param,
        file.path.display()
    )
}

/// What was run: the manifest that is named, or that of a folder, with what was laid over it then.
fn target(options: &PackOptions, cache: &Path) -> Result<Target, Failure> {
    let (sets, variants) = (options.sets.clone(), options.variants.clone());
    let mut target = Target {
        manifest: options.run.clone(),
        sets,
        variants,
        to: options.to.clone(),
        memory: None,
        cache: cache.into(),
        out: options.out.clone(),
    };
    if !options.run.is_dir() {
        return Ok(target);
    }
    let folder = &options.run;
    if !matches!(FileKind::of(folder), FileKind::RunFolder) {
        let wanted = "a manifest that was run, or the folder that a run wrote to";
        return Err(FileKind::of(folder).refuse(folder, "cache pack", wanted));
    }
    let record = RunRecord::load(folder)?;
    target.manifest = folder.join(&record.manifest_file);
    target.sets = [record.sets, target.sets].concat();
    if target.variants.is_empty() && !record.axes.is_empty() {
        target.variants = record.variants.iter().map(|variant| variant.name.clone()).collect();
    }
    if target.to.is_empty() {
        let names = record.variants.iter().flat_map(|variant| &variant.nodes);
        target.to =
            names.map(|(name, _)| node_of(name).to_string()).collect::<BTreeSet<_>>().into_iter().collect();
    }
    target.out = target.out.or_else(|| Some(folder.clone()));
    if cache == Path::new(crate::args::CACHE) {
        target.cache = folder.join(&record.cache);
    }
    Ok(target)
}

/// The keys of all tasks, each of which has its result.
fn finished(target: &Target, plan: &Plan, cache: &Cache) -> Result<Vec<Digest>, Failure> {
    let all = status(plan, cache, &target.out_dir());
    let missing: Vec<&str> = all
        .iter()
        .filter(|status| status.state != State::Hit)
        .map(|status| plan.tasks[status.task].label.as_str())
        .collect();
    if let Some(first) = missing.first() {
        let more = if missing.len() > 1 { format!(" and {} more", missing.len() - 1) } else { String::new() };
        return Err(usage(format!(
            "{}: {} would run: {first}{more}; a pack holds finished results\n  hint: `photocurrent run` \
             first, with the same --set, --variant, --to and --out; `photocurrent plan` gives the reasons",
            target.manifest.display(),
            print_count(missing.len(), "node"),
        )));
    }
    Ok(all.iter().filter_map(|status| status.key).collect::<BTreeSet<_>>().into_iter().collect())
}

/// Adds records and contents; gives the contents.
fn contents(
    cache: &Cache,
    keys: &[Digest],
    members: &mut BTreeMap<String, PathBuf>,
) -> Result<Vec<Digest>, Failure> {
    let mut contents = BTreeSet::new();
    for key in keys {
        let Lookup::Found(record) = cache.record(key) else {
            return Err(Failure::other(format!("the record {key} is gone from the cache; run again")));
        };
        members.insert(record_name(key), cache.root().join("keys").join(format!("{key}.toml")));
        contents.extend(record.outputs.values().flatten().map(|output| output.digest));
    }
    for digest in &contents {
        let path = cache
            .content_file(digest)
            .map_err(|error| Failure::other(format!("{error}\n  hint: run again, which makes it anew")))?;
        members.insert(content_name(digest), path);
    }
    Ok(contents.into_iter().collect())
}

/// The path from the root of the file system, without links followed and without `..`.
fn plain(path: &Path) -> Result<PathBuf, Failure> {
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path)?.components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            part => plain.push(part),
        }
    }
    Ok(plain)
}

/// Adds the manifest, what it extends and what its nodes read, below the folder that they have in common;
/// gives the manifest's name there, and the files that cannot be moved.
fn project_files(
    project: &Project,
    plan: &Plan,
    members: &mut BTreeMap<String, PathBuf>,
) -> Result<(String, Vec<Elsewhere>), Failure> {
    let (mut paths, mut elsewhere) = (Vec::new(), BTreeSet::new());
    for file in &project.files {
        if file.is_absolute {
            return Err(usage(format!(
                "{} is extended by its absolute path, which nobody else has\n  hint: write `extends` \
                 relative to the manifest",
                file.path.display()
            )));
        }
        paths.push(file.path.clone());
    }
    for task in &plan.tasks {
        for file in &task.files {
            let is_placed =
                |(variant, node): &(String, String)| project.is_placed(variant, node, &file.param);
            if task.uses.iter().all(is_placed) {
                paths.push(file.path.clone());
            } else {
                let (node, param) = (node_of(&task.label).to_string(), file.param.clone());
                elsewhere.insert(Elsewhere { node, param, path: std::path::absolute(&file.path)? });
            }
        }
    }
    let plain_paths = paths.iter().map(|path| plain(path)).collect::<Result<Vec<_>, _>>()?;
    let mut root = plain_paths[0].parent().unwrap_or(Path::new("/")).to_path_buf();
    while !plain_paths.iter().all(|path| path.starts_with(&root)) && root.pop() {}
    let name = |path: &Path| -> Result<String, Failure> {
        crate::failure::must_be_utf8(path)?;
        Ok(format!("{PROJECT}{}", path.strip_prefix(&root).unwrap_or(path).display()))
    };
    for (path, plain) in paths.iter().zip(&plain_paths) {
        members.insert(name(plain)?, path.clone());
    }
    let manifest = name(&plain_paths[0])?;
    let manifest = manifest.strip_prefix(PROJECT).unwrap_or(&manifest).to_string();
    Ok((manifest, elsewhere.into_iter().collect()))
}

/// The files for the user, of every node its stamp first: files without a stamp would count as somebody's
/// own.
fn exported(target: &Target, plan: &Plan) -> Vec<(String, PathBuf)> {
    let out = target.out_dir();
    let of = |below: &PathBuf| {
        let folder = out.join(below);
        let names = read_stamp(&folder).map(|stamp| stamp.files).unwrap_or_default();
        let names = std::iter::once(STAMP.to_string()).chain(names.into_iter().map(|file| file.name));
        names.map(|name| (format!("{OUT}{}/{name}", below.display()), folder.join(&name))).collect::<Vec<_>>()
    };
    plan.tasks.iter().filter_map(|task| task.export.as_ref()).flat_map(of).collect()
}

fn member(cache: &Cache, name: String, path: &Path) -> Result<Member, Failure> {
    let bytes = std::fs::metadata(path)
        .map_err(|error| Failure::other(format!("{}: cannot read: {error}", path.display())))?
        .len();
    Ok(Member { name, bytes, blake3: cache.file_digest(path)? })
}

/// Writes the file whole or not at all; gives its bytes.
fn write(output: &Path, about: &About, members: &BTreeMap<String, PathBuf>) -> Result<u64, Failure> {
    let failed = |error: &dyn std::fmt::Display| {
        Failure::other(format!("{}: cannot write: {error}", output.display()))
    };
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|error| failed(&error))?;
    let mut file = unnamed_in(folder).map_err(|error| failed(&error))?;
    let mut archive = ZipWriter::new(BufWriter::new(file.as_file_mut()));
    let options = |bytes: u64| {
        let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        stored.unix_permissions(0o644).large_file(bytes >= u64::from(u32::MAX))
    };
    let text = toml::to_string(about).map_err(|error| failed(&error))?;
    archive.start_file(ABOUT, options(text.len() as u64)).map_err(|error| failed(&error))?;
    archive.write_all(text.as_bytes()).map_err(|error| failed(&error))?;
    for (name, path) in members {
        let lost = |error: std::io::Error| {
            Failure::other(format!("{}: cannot pack {}: {error}", output.display(), path.display()))
        };
        let mut from = std::fs::File::open(path).map_err(lost)?;
        let bytes = from.metadata().map_err(lost)?.len();
        archive.start_file(name.as_str(), options(bytes)).map_err(|error| failed(&error))?;
        std::io::copy(&mut from, &mut archive).map_err(lost)?;
    }
    let mut inside = archive.finish().map_err(|error| failed(&error))?;
    inside.flush().map_err(|error| failed(&error))?;
    drop(inside);
    file.as_file().sync_all().map_err(|error| failed(&error))?;
    let bytes = file.as_file().metadata().map_err(|error| failed(&error))?.len();
    file.persist(output).map_err(|error| failed(&error.error))?;
    Ok(bytes)
}
