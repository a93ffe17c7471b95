//! `photocurrent cache unpack`: what `cache pack` wrote, made complete here: results into the cache, the
//! manifest and the files of its nodes into a folder, files for the user into the output folder.
//!
//! Everything is read and held against its digest before anything is placed. What is there already stays as
//! it is: an equal file is left alone, another one of the same name is refused.

use crate::args::UnpackOptions;
use crate::failure::{Done, Failure, usage};
use crate::file_kind::FileKind;
use crate::numbers::print_count;
use crate::pack::{ABOUT, About, FORMAT, Member, OUT, PROJECT, content_name, not_packed, record_name};
use crate::run_record::check_same_manifest;
use crate::terminal::{print, print_json, say};
use photocurrent_core::Digest;
use photocurrent_store::{Cache, StoreError, unnamed_in};
use serde_json::json;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Component, Path, PathBuf};
use zip::ZipArchive;

/// No pack needs more to say what it holds.
const LARGEST_ABOUT: u64 = 64 << 20;
/// No record is larger.
const LARGEST_RECORD: u64 = 16 << 20;
/// Names of files that are in the way and are listed.
const SHOWN: usize = 5;

/// An opened pack.
struct Pack<'a> {
    path: &'a Path,
    archive: ZipArchive<BufReader<File>>,
}

impl Pack<'_> {
    fn open(path: &Path) -> Result<Pack<'_>, Failure> {
        let file =
            File::open(path).map_err(|error| usage(format!("{}: cannot read: {error}", path.display())))?;
        match ZipArchive::new(BufReader::new(file)) {
            Ok(archive) => Ok(Pack { path, archive }),
            Err(error) => Err(refuse(path, &format!("no zip archive that is whole ({error})"))),
        }
    }

    /// A finding about the data of the pack.
    fn damaged(&self, what: &str) -> Failure {
        let hint = "the file is damaged or cut: copy it again, or have it packed again";
        Failure::Other { message: format!("{}: {what}\n  hint: {hint}", self.path.display()), code: 3 }
    }

    fn about(&mut self) -> Result<About, Failure> {
        let text = match self.archive.by_name(ABOUT) {
            Err(_) => return Err(refuse(self.path, &format!("without {ABOUT}"))),
            Ok(member) => {
                let mut text = String::new();
                member.take(LARGEST_ABOUT).read_to_string(&mut text).map(|_| text)
            }
        };
        let text = text.map_err(|error| self.damaged(&format!("{ABOUT}: cannot read: {error}")))?;
        let format = toml::from_str::<toml::Table>(&text)
            .ok()
            .and_then(|table| table.get("format").and_then(toml::Value::as_str).map(str::to_string));
        match format.as_deref() {
            Some(FORMAT) => toml::from_str(&text)
                .map_err(|error| self.damaged(&format!("{ABOUT}: no {FORMAT}: {}", error.message()))),
            Some(other) => Err(usage(format!(
                "{}: the form is `{other}`, and this version reads `{FORMAT}`\n  hint: use the version that \
                 wrote it, or pack again",
                self.path.display()
            ))),
            None => Err(self.damaged(&format!("{ABOUT}: found no `format`, expected `{FORMAT}`"))),
        }
    }

    /// Reads a member; what `work` says of it names the pack.
    fn read<T>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut dyn Read) -> Result<T, String>,
    ) -> Result<T, Failure> {
        let done = match self.archive.by_name(name) {
            Ok(mut member) => work(&mut member),
            Err(error) => Err(format!("it is not there ({error})")),
        };
        done.map_err(|why| self.damaged(&format!("{name}: {why}")))
    }
}

/// Refuses what is no pack.
fn refuse(path: &Path, found: &str) -> Failure {
    let what = FileKind::of(path).describe();
    usage(format!(
        "{}: `cache unpack` takes what `photocurrent cache pack` wrote, found {what}, {found}\n  hint: a \
         pack that was cut while it was copied is no archive either: compare its length",
        path.display()
    ))
}

/// A file of the pack and where it goes.
struct Going<'a> {
    member: &'a Member,
    to: PathBuf,
}

/// Unpacks; prints the manifest's path.
pub fn unpack(options: &UnpackOptions, cache_folder: &Path, json: bool) -> Done {
    let mut pack = Pack::open(&options.file)?;
    let about = pack.about()?;
    let folder = options.to.clone().unwrap_or_else(|| options.file.file_stem().unwrap_or_default().into());
    let inside = inside(&about.manifest).ok_or_else(|| pack.damaged("the manifest has no sound name"))?;
    let manifest = folder.join(inside);
    let stem = manifest.file_stem().unwrap_or_default();
    let out = options.out.clone().unwrap_or_else(|| Path::new("out").join(stem));
    let going = destinations(&pack, &about, &folder, &out)?;
    let new = those_not_there(&going)?;
    let hint = "name another folder with --out";
    check_same_manifest(&out, &manifest, "this is a pack of", hint)?;
    for file in &new {
        let Member { name, bytes, blake3 } = file.member;
        pack.read(name, |from| {
            let (found, digest) = hash(from).map_err(|error| format!("cannot read: {error}"))?;
            match found == *bytes && digest == *blake3 {
                true => Ok(()),
                false => Err(format!(
                    "found {found} bytes {}, expected {bytes} {}",
                    digest.short(),
                    blake3.short()
                )),
            }
        })?;
    }
    let cache = Cache::open(cache_folder)?;
    let mut arrivals = cache.arrivals();
    let short = |error: StoreError| error.to_string();
    for key in &about.keys {
        pack.read(&record_name(key), |from| {
            let mut text = String::new();
            from.take(LARGEST_RECORD).read_to_string(&mut text).map_err(|error| error.to_string())?;
            arrivals.record(key, &text).map_err(short)
        })?;
    }
    for digest in &about.contents {
        pack.read(&content_name(digest), |from| arrivals.content(digest, from).map_err(short))?;
    }
    let placed = arrivals.place().map_err(|error| match error {
        StoreError::Damaged { .. } => pack.damaged(&error.to_string()),
        error => error.into(),
    })?;
    for file in &new {
        pack.read(&file.member.name, |from| write(&file.to, from).map_err(|error| error.to_string()))?;
    }
    let command = command(options, &about, &manifest, cache_folder);
    about.elsewhere.iter().for_each(|file| say!("note: {}", not_packed(file)));
    if json {
        print_json(&json!({
            "manifest": manifest, "out": out, "cache": cache_folder, "command": command,
            "records": placed.records, "contents": placed.contents, "files": new.len(),
        }))?;
        return Ok(0);
    }
    say!(
        "{} of {} and {} of {} were new to the cache, {} of {} written",
        placed.records,
        print_count(about.keys.len(), "record"),
        placed.contents,
        print_count(about.contents.len(), "content"),
        new.len(),
        print_count(going.len(), "file")
    );
    say!("{command}");
    print(&manifest.display().to_string())?;
    Ok(0)
}

/// The command that finds all results.
fn command(options: &UnpackOptions, about: &About, manifest: &Path, cache: &Path) -> String {
    let mut command = format!("photocurrent run {}", manifest.display());
    let named = [("--set", &about.sets), ("--variant", &about.variants), ("--to", &about.to)];
    for (option, values) in named {
        values.iter().for_each(|value| command += &format!(" {option} '{value}'"));
    }
    if cache != Path::new(crate::args::CACHE) {
        command += &format!(" --cache {}", cache.display());
    }
    if let Some(out) = &options.out {
        command += &format!(" --out {}", out.display());
    }
    command
}

/// A name that leads to below the folder that it is joined to.
fn inside(name: &str) -> Option<&Path> {
    let path = Path::new(name);
    let is_sound = path.components().all(|part| matches!(part, Component::Normal(_)));
    (is_sound && !name.is_empty()).then_some(path)
}

fn destinations<'a>(
    pack: &Pack<'_>,
    about: &'a About,
    folder: &Path,
    out: &Path,
) -> Result<Vec<Going<'a>>, Failure> {
    let destination = |member: &'a Member| {
        let below = |prefix: &str| member.name.strip_prefix(prefix).and_then(inside);
        let to = below(PROJECT).map(|name| folder.join(name)).or_else(|| Some(out.join(below(OUT)?)));
        let to = to.ok_or_else(|| {
            let expected = format!("expected one below {PROJECT} or {OUT}");
            pack.damaged(&format!("found the name `{}`, {expected}", member.name))
        })?;
        Ok(Going { member, to })
    };
    about.files.iter().map(destination).collect()
}

/// The files that are not there yet; refuses when others of their names are.
fn those_not_there<'a>(going: &'a [Going<'a>]) -> Result<Vec<&'a Going<'a>>, Failure> {
    let (mut new, mut other) = (Vec::new(), Vec::new());
    for file in going {
        match File::open(&file.to).and_then(|mut there| hash(&mut there)) {
            Ok((_, digest)) if digest == file.member.blake3 => {}
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => new.push(file),
            Ok(_) | Err(_) => other.push(file.to.display().to_string()),
        }
    }
    if other.is_empty() {
        return Ok(new);
    }
    let more = other.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    other.truncate(SHOWN);
    Err(usage(format!(
        "{}{more}: there already, with other content; nothing was unpacked\n  hint: --to names another \
         folder for the manifest and what it reads, --out one for the files that it writes",
        other.join(", ")
    )))
}

/// Length and digest of what comes.
fn hash(from: &mut dyn Read) -> std::io::Result<(u64, Digest)> {
    let mut hasher = blake3::Hasher::new();
    let bytes = std::io::copy(from, &mut hasher)?;
    Ok((bytes, Digest::from_bytes(*hasher.finalize().as_bytes())))
}

/// Writes a file whole or not at all.
fn write(path: &Path, from: &mut dyn Read) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut file = unnamed_in(folder)?;
    std::io::copy(from, file.as_file_mut())?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    Ok(())
}
