//! From manifests to pipelines: what `extends`, levels and `--set` lay over each other.
//!
//! Tables merge key by key; scalars and lists replace. Later wins: what is extended, the file, the level,
//! `--set`. A changed `kind` drops the old `params`, which belonged to another method, and keeps `in`,
//! because within a role the sockets are the same. There are no conditions, loops or interpolation: what a
//! manifest means can be seen by reading it.

use crate::ablation::{self, Ablation};
use crate::blocks::node_of;
use crate::manifest::{self, Manifest, ManifestFile, check_targets};
use crate::overlay::{nested, overlay, read_path};
use crate::pipeline::Pipeline;
use photocurrent_core::document::{self, Item, Key, Origin, Problem, Source, Table, Tree};
use photocurrent_core::{Catalogue, Digest};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// A manifest with its overlays resolved: one pipeline per variant.
#[derive(Debug)]
pub struct Project {
    /// The manifest's path as given.
    pub path: PathBuf,
    /// The manifest and what it extends, in the order in which they were read.
    pub files: Vec<ManifestFile>,
    /// Names the manifest in the cache's history, see [`manifest_id`].
    pub manifest_id: Digest,
    /// What the ablation says, when there is one.
    pub ablation: Option<Ablation>,
    /// One per variant, in the order of the axes; exactly one, called `base`, without an ablation.
    pub pipelines: Vec<Pipeline>,
}

impl Project {
    /// Reads a manifest, lays `--set` texts such as `nodes.solve.params.cis_weight=2` over it, and checks all
    /// of it against the catalogue.
    ///
    /// # Errors
    /// Every independent mistake, each at its place.
    pub fn load(path: &Path, sets: &[String], catalogue: &Catalogue) -> Result<Project, Vec<Problem>> {
        let (project, problems) = Project::resolve(path, sets, catalogue);
        // What could be read is checked further even when something else is wrong, so that one run shows
        // every mistake.
        let mut variants = Vec::new();
        for pipeline in &project.pipelines {
            let mut problems = Vec::new();
            crate::typed::check(pipeline, catalogue, &mut problems);
            variants.push((pipeline.variant.as_str(), problems));
        }
        let problems = distinct(problems, variants);
        if problems.is_empty() { Ok(project) } else { Err(problems) }
    }

    /// The part of [`Project::load`] that looks at the manifest alone.
    pub(crate) fn resolve(path: &Path, sets: &[String], catalogue: &Catalogue) -> (Project, Vec<Problem>) {
        let mut manifest = manifest::read(path, catalogue);
        let sets = read_sets(sets, &mut manifest);
        let (ablation, variants) = ablation::variants(&mut manifest);
        let mut pipelines = Vec::new();
        for variant in variants {
            let mut table = manifest.table.clone();
            overlay(&mut table, &variant.overlay);
            sets.iter().for_each(|set| overlay(&mut table, set));
            pipelines.push(Pipeline::from_table(&table, variant, &mut manifest));
        }
        let manifest_id = manifest_id(path);
        let Manifest { files, problems, .. } = manifest;
        (Project { path: path.to_path_buf(), files, manifest_id, ablation, pipelines }, problems)
    }

    /// Can a file that a node reads be found from the manifest wherever that is moved? Not where it is named
    /// by an absolute path or by `--set`, whose paths are relative to the folder of the command.
    pub fn is_placed(&self, variant: &str, node: &str, param: &str) -> bool {
        let spec = self.pipeline(variant).and_then(|pipeline| pipeline.node(node_of(node)));
        let written = spec.map(|spec| spec.param_origin(param));
        written.is_some_and(|written| written.source.name != "--set" && !manifest::is_absolute(written))
    }

    /// A variant's pipeline.
    pub fn pipeline(&self, variant: &str) -> Option<&Pipeline> {
        self.pipelines.iter().find(|pipeline| pipeline.variant == variant)
    }
}

/// Names a manifest in the cache's history: the digest of its canonical path.
pub fn manifest_id(path: &Path) -> Digest {
    let canonical = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    Digest::of_bytes(canonical.to_string_lossy().as_bytes())
}

/// The mistakes of all variants, each once: they share most of their text. One that only some variants make
/// says in which.
pub(crate) fn distinct(common: Vec<Problem>, variants: Vec<(&str, Vec<Problem>)>) -> Vec<Problem> {
    let mut seen: Vec<(Problem, Vec<&str>)> = Vec::new();
    let mut place: HashMap<Mark, usize> = HashMap::new();
    let count = variants.len();
    for (variant, problem) in variants
        .into_iter()
        .flat_map(|(variant, problems)| problems.into_iter().map(move |problem| (variant, problem)))
    {
        let at = *place.entry(mark(&problem)).or_insert(seen.len());
        match seen.get_mut(at) {
            Some((_, of)) if of.last() != Some(&variant) => of.push(variant),
            Some(_) => {}
            None => seen.push((problem, vec![variant])),
        }
    }
    let placed = seen.into_iter().map(|(problem, of)| match of[..] {
        [first, ..] if of.len() < count => {
            let more = if of.len() > 1 { format!(" and {} more", of.len() - 1) } else { String::new() };
            problem.note(format!("in variant {first}{more}"))
        }
        _ => problem,
    });
    let mut seen: HashSet<Mark> = HashSet::new();
    common.into_iter().chain(placed).filter(|problem| seen.insert(mark(problem))).collect()
}

/// What two reports of one mistake have in common: text and place, and the words there.
type Mark = (String, Option<(String, usize, usize, String)>);

fn mark(problem: &Problem) -> Mark {
    let at = problem.at.as_ref().map(|at| {
        let words: String =
            at.source.text.get(at.span.clone()).unwrap_or_default().chars().take(200).collect();
        (at.source.name.clone(), at.span.start, at.span.end, words)
    });
    (problem.message.clone(), at)
}

fn read_sets(sets: &[String], manifest: &mut Manifest) -> Vec<Table> {
    let mut tables = Vec::new();
    for text in sets {
        match read_set(text) {
            Ok(mut table) => {
                check_targets(&mut table, manifest);
                tables.push(table);
            }
            Err(problems) => manifest.problems.extend(problems),
        }
    }
    tables
}

/// Reads one `path=value`. A value that is no TOML value, such as `10 kHz`, is taken as text: a shell has
/// eaten its quotes.
fn read_set(text: &str) -> Result<Table, Vec<Problem>> {
    let source = Source::new("--set", "", text);
    let whole = Origin { source: source.clone(), span: 0..text.len() };
    let Some(equals) = text.find('=') else {
        let problem = Problem::at(&whole, "`--set` takes path=value")
            .help("such as --set nodes.solve.params.cis_weight=2");
        return Err(vec![problem]);
    };
    if let Ok(table) = document::parse(&source) {
        return Ok(table);
    }
    let path = read_path(&Source::new("--set", "", &text[..equals])).map_err(|_| {
        vec![Problem::at(
            &Origin { source: source.clone(), span: 0..equals },
            format!("`{}` is not a path of keys", text[..equals].trim()),
        )]
    })?;
    let value = Origin { source: source.clone(), span: equals + 1..text.len() };
    let item = Item::String(text[equals + 1..].trim().to_string());
    // The keys were read from the part before the `=`: the same bytes, so their places hold in the whole
    // text.
    let keys = path
        .into_iter()
        .map(|key| Key { origin: Origin { source: source.clone(), span: key.origin.span }, ..key })
        .collect();
    Ok(nested(keys, Tree { item, origin: value }))
}
