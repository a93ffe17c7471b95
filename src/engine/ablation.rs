//! Ablations: a base and named overlays, multiplied out into variants.
//!
//! One axis with named levels is a list of cases; several axes multiply; `sweep` is an axis whose levels are
//! values of one parameter; `skip` takes combinations out again. Two axes may not touch one path, so the
//! order of the axes changes names and order, never a result.

use crate::manifest::{Manifest, check_targets};
use crate::overlay::{merge, nested, node_names, read_path};
use photocurrent_core::document::{Item, Key, Origin, Problem, Source, Table, Tree};

/// Beyond this many variants an ablation is a slip of the hand.
const MOST_VARIANTS: usize = 4096;

/// The name of the only variant of a manifest without an ablation.
const BASE: &str = "base";

/// What an ablation says about its variants as a whole.
#[derive(Clone, Debug)]
pub struct Ablation {
    /// What it is for.
    pub about: Option<String>,
    /// The numbers to compare, `psnr.psnr_db`, as (node, metric).
    pub metrics: Vec<(String, String)>,
    /// The variant that the others are compared with.
    pub baseline: Option<String>,
    /// Axes in order, each with the names of its levels.
    pub axes: Vec<(String, Vec<String>)>,
}

/// One point of the product.
#[derive(Clone, Debug)]
pub(crate) struct Variant {
    pub name: String,
    pub levels: Vec<(String, String)>,
    pub overlay: Table,
}

struct Axis {
    key: Key,
    levels: Vec<(String, Table)>,
}

/// The variants of a manifest, in the order of its axes, the last one changing fastest.
pub(crate) fn variants(manifest: &mut Manifest) -> (Option<Ablation>, Vec<Variant>) {
    let base = Variant { name: BASE.into(), levels: Vec::new(), overlay: Table::default() };
    let Some((key, Tree { item: Item::Table(table), .. })) = manifest.table.remove("ablation") else {
        return (None, vec![base]);
    };
    let before = manifest.problems.len();
    let mut axes = named_axes(&table, manifest);
    swept_axes(&table, manifest, &mut axes);
    if axes.is_empty() {
        // An axis with a mistake in it is an axis all the same.
        if manifest.problems.len() > before {
            return (None, vec![base]);
        }
        let problem =
            Problem::at(&key.origin, "an ablation needs `axes` or `sweep`").label("nothing to vary");
        manifest.problems.push(problem.help(
            "such as `[ablation.axes.readout]` with levels like `off = \
                                             { nodes.solve.params.readout = \"none\" }` below it",
        ));
        return (None, vec![base]);
    }
    check_overlaps(&axes, &mut manifest.problems);
    let count = axes.iter().fold(1usize, |count, axis| count.saturating_mul(axis.levels.len()));
    if count > MOST_VARIANTS {
        let problem = Problem::at(
            &key.origin,
            format!("the axes multiply to {count} variants, more than {MOST_VARIANTS}"),
        );
        manifest.problems.push(problem.help("take an axis out, or give a sweep fewer steps"));
        return (None, vec![base]);
    }
    let skips = points(table.get("skip"), &axes, &mut manifest.problems);
    let mut all = vec![Variant { name: String::new(), ..base }];
    for axis in &axes {
        all = all
            .iter()
            .flat_map(|variant| axis.levels.iter().map(|level| extended(variant, &axis.key.name, level)))
            .collect();
    }
    all.retain(|variant| !skips.iter().any(|skip| skip.iter().all(|pair| variant.levels.contains(pair))));
    if all.is_empty() {
        let problem = Problem::at(
            table.key("skip").map_or(&key.origin, |skip| &skip.origin),
            "`skip` leaves no variant",
        );
        manifest.problems.push(problem.help(
            "take an entry out, or name more axes in it: an entry skips \
                                             every variant that has all its levels",
        ));
    }
    let baseline = find_baseline(&table, &axes, &all, &mut manifest.problems);
    let ablation = Ablation {
        about: table.get("about").and_then(Tree::as_str).map(str::to_string),
        metrics: metrics(&table, manifest),
        baseline,
        axes: axes
            .into_iter()
            .map(|axis| (axis.key.name, axis.levels.into_iter().map(|(name, _)| name).collect()))
            .collect(),
    };
    (Some(ablation), all)
}

fn extended(variant: &Variant, axis: &str, (level, overlay): &(String, Table)) -> Variant {
    let mut variant = variant.clone();
    let comma = if variant.name.is_empty() { "" } else { "," };
    variant.name += &format!("{comma}{axis}={level}");
    variant.levels.push((axis.to_string(), level.clone()));
    merge(&mut variant.overlay, overlay);
    variant
}

fn named_axes(table: &Table, manifest: &mut Manifest) -> Vec<Axis> {
    let mut axes = Vec::new();
    for (key, tree) in table.get("axes").and_then(Tree::as_table).iter().flat_map(|axes| &axes.entries) {
        let mut levels: Vec<(String, Table)> = Vec::new();
        for (level, overlay) in tree.as_table().iter().flat_map(|levels| &levels.entries) {
            let mut overlay = overlay.as_table().cloned().unwrap_or_default();
            check_targets(&mut overlay, manifest);
            check_name(&level.name, "level", &level.origin, &mut manifest.problems);
            levels.push((level.name.clone(), overlay));
        }
        check_name(&key.name, "axis", &key.origin, &mut manifest.problems);
        if levels.is_empty() {
            manifest.problems.push(
                Problem::at(&key.origin, format!("axis `{}` has no level", key.name))
                    .help("give it levels such as `off = { }`"),
            );
            continue;
        }
        axes.push(Axis { key: key.clone(), levels });
    }
    axes
}

/// Names stand in variant names and in folder names.
fn check_name(name: &str, what: &str, origin: &Origin, problems: &mut Vec<Problem>) {
    let fits = |c: char| c.is_ascii_alphanumeric() || "_.+-".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(fits) {
        let problem = Problem::at(
            origin,
            format!("`{name}` is not a name for {} {what}", if what == "axis" { "an" } else { "a" }),
        );
        problems.push(problem.help("names are letters, digits, `_`, `.`, `+` and `-`"));
    }
}

fn swept_axes(table: &Table, manifest: &mut Manifest, axes: &mut Vec<Axis>) {
    for (key, tree) in table.get("sweep").and_then(Tree::as_table).iter().flat_map(|sweep| &sweep.entries) {
        let path =
            read_path(&Source::new(key.origin.source.name.clone(), "", key.name.clone())).unwrap_or_default();
        if path.len() < 2
            || tree
                .as_table()
                .is_some_and(|table| table.get("log").is_none() && table.get("linear").is_none())
        {
            let problem = Problem::at(&key.origin, format!("`{}` is not the path of a parameter", key.name));
            let example =
                "write it in quotes with its values: \"nodes.solve.params.cis_weight\" = [0.5, 1.0]";
            manifest.problems.push(problem.help(example));
            continue;
        }
        // A sweep is named by its parameter; with the node's name before it where another axis has that name
        // already.
        let names: Vec<String> = path.iter().map(|key| key.name.clone()).collect();
        let short = names[names.len() - 1].clone();
        let name = if axes.iter().any(|axis| axis.key.name == short) {
            format!("{}.{short}", names[1])
        } else {
            short
        };
        let path: Vec<Key> =
            path.into_iter().map(|step| Key { name: step.name, origin: key.origin.clone() }).collect();
        let mut levels: Vec<(String, Table)> = Vec::new();
        let values = values(tree, &mut manifest.problems);
        // The path is one text: a mistake in it needs to be said once, not once per value.
        let before = manifest.problems.len();
        if let Some(value) = values.first() {
            check_targets(&mut nested(path.clone(), value.clone()), manifest);
        }
        if manifest.problems.len() > before {
            continue;
        }
        for value in values {
            let overlay = nested(path.clone(), value.clone());
            let level = level_name(&value);
            if levels.iter().any(|(other, _)| *other == level) {
                manifest.problems.push(
                    Problem::at(&value.origin, format!("the sweep has the value {level} twice"))
                        .help("leave one out"),
                );
            }
            levels.push((level, overlay));
        }
        if !levels.is_empty() {
            axes.push(Axis { key: Key { name, origin: key.origin.clone() }, levels });
        }
    }
}

/// A value as part of a variant's name: `10 kHz` becomes `10kHz`.
fn level_name(value: &Tree) -> String {
    let text = match &value.item {
        Item::String(text) => text.clone(),
        Item::Integer(number) => number.to_string(),
        Item::Float(number) => number.to_string(),
        Item::Boolean(value) => value.to_string(),
        Item::Datetime(text) => text.clone(),
        Item::Array(items) => items.iter().map(level_name).collect::<Vec<_>>().join("+"),
        Item::Table(table) => table
            .entries
            .iter()
            .map(|(key, value)| format!("{}-{}", key.name, level_name(value)))
            .collect::<Vec<_>>()
            .join("+"),
    };
    let kept = text.chars().filter(|c| !c.is_whitespace());
    kept.map(|c| if c.is_ascii_alphanumeric() || "_.+-".contains(c) { c } else { '-' }).collect()
}

fn values(tree: &Tree, problems: &mut Vec<Problem>) -> Vec<Tree> {
    match &tree.item {
        Item::Array(items) if !items.is_empty() => items.clone(),
        Item::Table(table) => stepped(tree, table).unwrap_or_else(|problem| {
            problems.push(problem);
            Vec::new()
        }),
        _ => {
            let problem = Problem::at(
                &tree.origin,
                format!("a sweep takes a list of values or a range, found {}", tree.describe()),
            );
            problems.push(problem.help(
                "such as [0.5, 1.0], { linear = [0, 4], steps = 5 } or { log = [0.1, 10.0], steps = 5 }",
            ));
            Vec::new()
        }
    }
}

/// `{ log = [a, b], steps = n }` and `{ linear = [a, b], steps = n }`.
fn stepped(tree: &Tree, table: &Table) -> Result<Vec<Tree>, Problem> {
    if let Some((key, _)) =
        table.entries.iter().find(|(key, _)| !["log", "linear", "steps"].contains(&key.name.as_str()))
    {
        let problem =
            Problem::at(&key.origin, format!("`{}` is not a key of a sweep", key.name)).label("unknown key");
        return Err(problem.did_you_mean(&key.name, ["log", "linear", "steps"]));
    }
    let number = |tree: &Tree| match tree.item {
        Item::Integer(number) => Some(number as f64),
        Item::Float(number) if number.is_finite() => Some(number),
        _ => None,
    };
    let is_log = table.get("log").is_some();
    let ends = table.get("log").or(table.get("linear")).unwrap_or(tree);
    let (first, last, whole) = match &ends.item {
        Item::Array(items) if items.len() == 2 && items.iter().all(|item| number(item).is_some()) => {
            let whole = items.iter().all(|item| matches!(item.item, Item::Integer(_)));
            (number(&items[0]).unwrap_or(0.0), number(&items[1]).unwrap_or(0.0), whole)
        }
        _ => {
            let problem =
                Problem::at(&ends.origin, format!("a range is two numbers, found {}", ends.describe()));
            return Err(
                problem.help("such as { linear = [0, 4], steps = 5 } or { log = [0.1, 10.0], steps = 5 }")
            );
        }
    };
    if is_log && table.get("linear").is_some() {
        return Err(Problem::at(&tree.origin, "a sweep is either `log` or `linear`, found both")
            .help("leave one out"));
    }
    if is_log && (first <= 0.0 || last <= 0.0) {
        let problem = Problem::at(
            &ends.origin,
            format!(
                "both ends of a `log` range must be above zero, found {}",
                if first <= 0.0 { first } else { last }
            ),
        );
        return Err(problem.help("raise it, or use `linear`"));
    }
    let steps = match table.get("steps").map(|steps| &steps.item) {
        Some(Item::Integer(steps)) if (2..=MOST_VARIANTS as i64).contains(steps) => *steps,
        _ => {
            let (at, found) = table
                .get("steps")
                .map_or((&tree.origin, "none".into()), |steps| (&steps.origin, steps.describe()));
            let problem = Problem::at(
                at,
                format!("a range needs `steps`, an integer from 2 to {MOST_VARIANTS}, found {found}"),
            );
            return Err(problem.help(
                "both ends count: `steps = 2` gives just them; one value alone is \
                                     written as a list, such as [0.5]",
            ));
        }
    };
    let value = |step: i64| {
        let part = step as f64 / (steps - 1) as f64;
        let exact =
            if is_log { first * libm::pow(last / first, part) } else { first + (last - first) * part };
        // Six digits print well in names and tables; the value that runs is the one that is printed.
        let rounded: f64 = format!("{exact:.5e}").parse().unwrap_or(exact);
        if whole && !is_log && rounded.fract() == 0.0 {
            Item::Integer(rounded as i64)
        } else {
            Item::Float(rounded)
        }
    };
    Ok((0..steps).map(|step| Tree { item: value(step), origin: tree.origin.clone() }).collect())
}

/// Paths of the values that a level sets.
fn leaves(table: &Table, prefix: &str, found: &mut Vec<(String, Origin)>) {
    for (key, tree) in &table.entries {
        let path = if prefix.is_empty() { key.name.clone() } else { format!("{prefix}.{}", key.name) };
        match &tree.item {
            Item::Table(inner) => leaves(inner, &path, found),
            _ => found.push((path, key.origin.clone())),
        }
    }
}

fn check_overlaps(axes: &[Axis], problems: &mut Vec<Problem>) {
    let mut seen: Vec<(String, Origin, &str)> = Vec::new();
    for axis in axes {
        let mut mine = Vec::new();
        axis.levels.iter().for_each(|(_, overlay)| leaves(overlay, "", &mut mine));
        let mut reported: Vec<String> = Vec::new();
        for (path, origin) in &mine {
            // A value and a table below the same path touch as well.
            let inside =
                |a: &str, b: &str| a == b || a.strip_prefix(b).is_some_and(|rest| rest.starts_with('.'));
            let other = seen.iter().find(|(other, ..)| inside(path, other) || inside(other, path));
            if let Some((_, there, other)) = other.filter(|_| !reported.contains(path)) {
                let problem = Problem::at(
                    origin,
                    format!("the axes `{other}` and `{}` both set {path}", axis.key.name),
                );
                let problem = problem.note(format!("`{other}` sets it at {there}"));
                problems
                    .push(problem.help("let one axis set it, or make the combinations levels of one axis"));
                reported.push(path.clone());
            }
        }
        seen.extend(mine.into_iter().map(|(path, origin)| (path, origin, axis.key.name.as_str())));
    }
}

/// `skip` as lists of (axis, level).
fn points(tree: Option<&Tree>, axes: &[Axis], problems: &mut Vec<Problem>) -> Vec<Vec<(String, String)>> {
    let Some(Tree { item: Item::Array(items), .. }) = tree else { return Vec::new() };
    items
        .iter()
        .filter_map(Tree::as_table)
        .map(|table| point(table, axes, problems))
        .filter(|point| !point.is_empty())
        .collect()
}

fn point(table: &Table, axes: &[Axis], problems: &mut Vec<Problem>) -> Vec<(String, String)> {
    let mut pairs = Vec::new();
    for (key, tree) in &table.entries {
        let Some(axis) = axes.iter().find(|axis| axis.key.name == key.name) else {
            let problem =
                Problem::at(&key.origin, format!("there is no axis `{}`", key.name)).label("unknown axis");
            problems.push(problem.did_you_mean(&key.name, axes.iter().map(|axis| axis.key.name.as_str())));
            continue;
        };
        let level = level_name(tree);
        if axis.levels.iter().any(|(name, _)| *name == level) {
            pairs.push((key.name.clone(), level));
        } else {
            let problem = Problem::at(&tree.origin, format!("axis `{}` has no level `{level}`", key.name))
                .label("unknown level");
            problems.push(problem.did_you_mean(&level, axis.levels.iter().map(|(name, _)| name.as_str())));
        }
    }
    // A point with a mistake in it would match more than was meant.
    if pairs.len() == table.entries.len() { pairs } else { Vec::new() }
}

fn find_baseline(
    table: &Table,
    axes: &[Axis],
    all: &[Variant],
    problems: &mut Vec<Problem>,
) -> Option<String> {
    let tree = table.get("baseline")?;
    let before = problems.len();
    let point = point(tree.as_table()?, axes, problems);
    if problems.len() > before {
        return None;
    }
    if let Some(axis) = axes.iter().find(|axis| !point.iter().any(|(name, _)| *name == axis.key.name)) {
        let problem =
            Problem::at(&tree.origin, format!("`baseline` does not say which level of `{}`", axis.key.name));
        let name = if axis.key.name.contains('.') {
            format!("\"{}\"", axis.key.name)
        } else {
            axis.key.name.clone()
        };
        let levels: Vec<String> =
            axis.levels.iter().map(|(level, _)| format!("`{name} = \"{level}\"`")).collect();
        problems.push(problem.help(format!("add {} to it", levels.join(" or "))));
        return None;
    }
    let found = all.iter().find(|variant| point.iter().all(|pair| variant.levels.contains(pair)));
    if found.is_none() {
        let problem = Problem::at(&tree.origin, "`skip` leaves the baseline out");
        problems.push(problem.help("choose a baseline that runs, or take its entry out of `skip`"));
    }
    found.map(|variant| variant.name.clone())
}

fn metrics(table: &Table, manifest: &mut Manifest) -> Vec<(String, String)> {
    let Some(Tree { item: Item::Array(items), .. }) = table.get("metrics") else { return Vec::new() };
    let nodes = node_names(&manifest.table);
    let mut metrics = Vec::new();
    for (text, origin) in items.iter().filter_map(|item| Some((item.as_str()?, &item.origin))) {
        match text.split_once('.') {
            Some((node, metric)) if nodes.iter().any(|name| name == node) => {
                metrics.push((node.to_string(), metric.to_string()))
            }
            Some((node, _)) => {
                let problem = Problem::at(origin, format!("there is no node `{node}`")).label("unknown node");
                manifest.problems.push(problem.did_you_mean(node, nodes.iter().map(String::as_str)));
            }
            None => manifest.problems.push(
                Problem::at(origin, format!("`{text}` does not name a metric"))
                    .help("such as \"psnr.psnr_db\""),
            ),
        }
    }
    metrics
}
