//! Files from outside are tried in a copy of this process before this process touches them: every object,
//! type, filter, attribute and text, the whole index of chunks, and some chunks of each dataset, by the same
//! calls that are made here afterwards.
//!
//! What the library merely refuses there it refuses here too, with its message. A file on which it ends the
//! process, loops or floods memory is refused with the object that it was about to touch. The outcome is kept
//! for a file with its length and time of change, so that a run tries a file once.

use super::guard::{Death, Limits, Report, attempt};
use super::{DEEPEST, Opened, locked};
use crate::error::StoreError;
use crate::foreign::ForeignFile;
use hdf5::LocationType;
use std::collections::{HashMap, HashSet};
use std::fs::Metadata;
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

/// Processor time for one object, whatever the size of the file. A walk over 100,000 chunks takes less than
/// 0.1 s.
const CPU: Duration = Duration::from_secs(1);
/// And this much more for a file: an index is a part of it.
const CPU_PER_GIB: Duration = Duration::from_secs(10);
/// Without a report for so long, the library waits for something that does not come. A slow disk answers
/// earlier.
const QUIET: Duration = Duration::from_secs(60);
/// Memory that a trial may take. The library keeps a few MB for a file; an attribute or text that claims more
/// is a lie.
const MEMORY: u64 = 1 << 30;
/// Objects that are looked at: a recording with a dataset for each of 100,000 frames has a tenth of that.
const MOST_OBJECTS: usize = 1_000_000;
/// An outcome is kept only of files that last changed so long ago: the clock of a file system has steps of up
/// to 10 ms.
const SETTLED: Duration = Duration::from_millis(20);
/// Outcomes that are kept.
const MOST_KEPT: usize = 10_000;

/// Which file, in which state.
#[derive(PartialEq, Eq, Hash)]
struct State {
    file: (u64, u64),
    bytes: u64,
    changed: SystemTime,
}

impl State {
    /// `None` where the state cannot be known or may change unseen.
    #[cfg(unix)]
    fn of(metadata: &Metadata) -> Option<State> {
        use std::os::unix::fs::MetadataExt;
        let changed = metadata.modified().ok()?;
        // A time in the future does not show when the file changed last.
        let settled = SystemTime::now().duration_since(changed).is_ok_and(|age| age > SETTLED);
        settled.then_some(State { file: (metadata.dev(), metadata.ino()), bytes: metadata.len(), changed })
    }

    #[cfg(not(unix))]
    fn of(_: &Metadata) -> Option<State> {
        None
    }
}

/// Fails when the library cannot be trusted with this file.
///
/// # Errors
/// When it crashes, loops or floods memory, and when no process can be started to find out.
pub(super) fn pass(path: &Path) -> Result<(), StoreError> {
    static KEPT: LazyLock<Mutex<HashMap<State, Option<Death>>>> = LazyLock::new(Mutex::default);
    let kept = || KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let metadata = std::fs::metadata(path).map_err(|error| StoreError::io(path, "open the file", error))?;
    let state = State::of(&metadata);
    let known = state.as_ref().and_then(|state| kept().get(state).cloned());
    let death = match known {
        Some(death) => death,
        None => {
            let gib = metadata.len() as f64 / (1u64 << 30) as f64;
            // A file that is cut is mapped whole.
            let limits =
                Limits { cpu: CPU + CPU_PER_GIB.mul_f64(gib), quiet: QUIET, memory: MEMORY + metadata.len() };
            let outcome = attempt(limits, |report| walk(path, report));
            let death = outcome
                .map_err(|error| StoreError::io(path, "start a process that tries the file", error))?
                .err();
            if let Some(state) = state {
                let mut kept = kept();
                if kept.len() >= MOST_KEPT {
                    kept.clear();
                }
                kept.insert(state, death.clone());
            }
            death
        }
    };
    match death {
        None => Ok(()),
        Some(Death { at, how }) => {
            let at = if at.is_empty() { "/".into() } else { at };
            Err(StoreError::NotReadable {
                path: path.into(),
                found: format!("the HDF5 library cannot read it: damaged header at {at}: {how}"),
                hint: "the file is damaged: copy or record it again".into(),
            })
        }
    }
}

/// Touches everything that readers of a file touch. What the library refuses is left to them.
fn walk(path: &Path, report: &mut dyn FnMut(Report)) {
    report(Report::At("/"));
    let opened = check(report, Opened::open(path));
    let Some(opened) = opened else { return };
    let file = ForeignFile::of(opened.clone());
    let (mut groups, mut seen, mut objects) = (vec![String::new()], HashSet::new(), 0);
    attributes(&file, &opened, "", report);
    while let Some(group) = groups.pop() {
        for name in check(report, file.names(&group)).unwrap_or_default() {
            let name = if group.is_empty() { name } else { format!("{group}/{name}") };
            objects += 1;
            if objects > MOST_OBJECTS {
                return report(Report::TooMany);
            }
            report(Report::At(&format!("/{name}")));
            if !file.has(&name) {
                continue;
            }
            // An object with two names is looked at once, so that groups which hold each other come to an
            // end.
            let about = locked(|| opened.file.loc_info_by_name(&name));
            let token =
                about.as_ref().map(|about| format!("{:?}", about.token)).unwrap_or_else(|_| name.clone());
            if !seen.insert(token) {
                continue;
            }
            match check(report, file.dataset(&name)).flatten() {
                Some(dataset) => dataset.try_out(),
                None => drop(check(report, file.text(&name))),
            }
            attributes(&file, &opened, &name, report);
            if about.is_ok_and(|about| about.loc_type == LocationType::Group)
                && name.split('/').count() < DEEPEST
            {
                groups.push(name);
            }
        }
    }
}

fn attributes(file: &ForeignFile, opened: &Opened, of: &str, report: &mut dyn FnMut(Report)) {
    for name in check(report, file.attribute_names(of)).unwrap_or_default() {
        report(Report::At(&format!("/{of}: attribute `{name}`")));
        check(report, file.attribute(of, &name));
        if let Some(location) = check(report, file.location(of)).flatten() {
            check(report, opened.text_attribute(&location, of, &name));
            check(report, opened.integer_attribute(&location, of, &name));
        }
    }
}

/// The value, if there is one. A refusal for want of memory would be none in a process that may take more.
fn check<T>(report: &mut dyn FnMut(Report), result: Result<T, StoreError>) -> Option<T> {
    match result {
        Ok(value) => Some(value),
        Err(error) => {
            let detail = match &error {
                StoreError::Library { detail, .. } => detail,
                StoreError::NotReadable { found, .. } => found,
                _ => "",
            };
            if detail.contains("memory allocation failed") {
                report(Report::OutOfMemory);
            }
            None
        }
    }
}
