//! Keys: what a result depends on, and whether the cache has it.
//!
//! A key is a hash over the kind, its revision, the canonical parameters, the content of every input and
//! declared file, and the seed if the node draws. It needs the *contents* of the inputs, so a task's key is
//! known only when those before it are done or found; in return a task that was run again with an equal
//! result changes no key after it.

use crate::blocks::Extract;
use crate::export;
use crate::plan::Plan;
use crate::task::{Task, TaskId};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::schema::strip_paths;
use photocurrent_core::{DataType, Digest, NodeError, TimeSpan};
use photocurrent_store::{Cache, FileInput, Ingredients, Lookup, Params, PortInput, Record};
use std::path::Path;

/// Everything that enters a task's key; `None` while the content of an input is not known.
pub(crate) fn ingredients(
    task: &Task,
    cache: &Cache,
    content: &dyn Fn(TaskId, &str) -> Option<Digest>,
) -> Result<Option<Ingredients>, NodeError> {
    let mut inputs = Vec::new();
    for input in &task.inputs {
        for (index, source) in input.from.iter().enumerate() {
            let Some(digest) = content(source.task, source.port) else { return Ok(None) };
            let (data_type, layout) = (input.data_type, input.data_type.layout_version());
            let ns = |span: TimeSpan| (span.start.0, span.end.0);
            let (window, share) = match source.extract {
                Extract::All => (None, None),
                Extract::Window(span) => (Some(ns(span)), None),
                Extract::Share(span) => (None, Some(ns(span))),
            };
            inputs.push(PortInput {
                port: input.port.to_string(),
                index: index as u32,
                data_type,
                layout,
                digest,
                window,
                share,
            });
        }
    }
    let mut files = Vec::new();
    for file in &task.files {
        let digest = cache
            .file_digest(&file.path)
            .map_err(|error| NodeError::from(error).param(file.param.clone()))?;
        files.push(FileInput { param: file.param.clone(), path: file.path.display().to_string(), digest });
    }
    Ok(Some(Ingredients {
        kind: task.decl.kind.to_string(),
        revision: task.decl.revision,
        params: params(task),
        inputs,
        files,
        seed: task.seed,
    }))
}

/// What every task's result is a function of, without its inputs' contents: known before anything runs, so
/// that bands of one result that were made in other runs or on other machines are known as such. `None` where
/// a declared file cannot be read: the task itself will say so.
pub(crate) fn identities(plan: &Plan, cache: &Cache) -> Vec<Option<Digest>> {
    let mut all: Vec<Option<Digest>> = Vec::new();
    for task in &plan.tasks {
        let source = |from: TaskId, port: &str| {
            all[from]
                .map(|digest| DigestBuilder::new("photocurrent-output/1").digest(&digest).text(port).finish())
        };
        let ingredients = ingredients(task, cache, &source).ok().flatten();
        let identity = ingredients.map(|ingredients| {
            DigestBuilder::new("photocurrent-identity/1").digest(&ingredients.key()).finish()
        });
        all.push(identity);
    }
    all
}

/// A task's parameters as they enter the key; the readable form without the paths, which do not.
pub(crate) fn params(task: &Task) -> Params {
    let mut readable = task.params.clone();
    strip_paths(&mut readable, &task.schema);
    Params {
        canonical: task.canonical_params.clone(),
        readable: readable.as_object().cloned().unwrap_or_default(),
    }
}

/// Can a task's result be taken from the cache?
pub(crate) enum Reuse {
    /// Yes.
    Hit(Box<Record>),
    /// No: something is missing besides the record, which is there.
    Partly {
        /// What is missing, one line each.
        reasons: Vec<String>,
    },
    /// No: there is no record of this key, or it cannot be read.
    Nothing {
        /// What is wrong with it, when it is there.
        damage: Option<String>,
    },
}

/// Looks a task up. Stored outputs are seen to be there in full length; whether their bytes are right is
/// known when they are read.
pub(crate) fn look_up(task: &Task, key: &Digest, cache: &Cache, out_dir: &Path) -> Reuse {
    let record = match cache.record(key) {
        Lookup::Found(record) => record,
        Lookup::Missing => return Reuse::Nothing { damage: None },
        Lookup::Damaged { why } => return Reuse::Nothing { damage: Some(why) },
    };
    let mut reasons = Vec::new();
    for output in task.stored() {
        match record.outputs.get(output.port) {
            // The report reads every table, whether a node does or not: one that is damaged must be made
            // again here, or it would end each run for ever.
            Some(Some(stored)) if stored.data_type == DataType::Table => {
                if let Err(error) = cache.load(&stored.digest) {
                    return Reuse::Nothing { damage: Some(format!("output `{}`: {error}", output.port)) };
                }
            }
            Some(Some(_)) => {}
            Some(None) | None => reasons.push(format!("output {} was not stored", output.port)),
        }
    }
    if let Some(folder) = &task.export
        && let Err(reason) = export::check_current(&out_dir.join(folder), key)
    {
        reasons.push(reason);
    }
    if reasons.is_empty() { Reuse::Hit(record) } else { Reuse::Partly { reasons } }
}
