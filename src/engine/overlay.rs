//! Documents laid over each other: tables merge key by key; scalars and lists replace.

use photocurrent_core::document::{self, Item, Key, Problem, Source, Table, Tree};
use std::sync::Arc;

/// Lays one document over another, with the rule for a changed `kind`.
pub(crate) fn overlay(base: &mut Table, over: &Table) {
    let kind = |node: &Tree| {
        node.as_table().and_then(|node| node.get("kind")).and_then(Tree::as_str).map(str::to_string)
    };
    for (key, node) in over.get("nodes").and_then(Tree::as_table).iter().flat_map(|nodes| &nodes.entries) {
        let Some(Tree { item: Item::Table(nodes), .. }) = base.get_mut("nodes") else { continue };
        let Some(old) = nodes.get_mut(&key.name) else { continue };
        if kind(node).is_some_and(|new| kind(old).is_some_and(|old| old != new))
            && let Item::Table(old) = &mut old.item
        {
            old.remove("params");
            old.remove("expect");
        }
    }
    merge(base, over);
}

/// Tables merge key by key; everything else replaces.
pub(crate) fn merge(base: &mut Table, over: &Table) {
    for (key, tree) in &over.entries {
        match (base.get_mut(&key.name), &tree.item) {
            (Some(Tree { item: Item::Table(old), .. }), Item::Table(new)) => merge(old, new),
            _ => base.set(key.clone(), tree.clone()),
        }
    }
}

/// The names of the nodes in a document.
pub(crate) fn node_names(table: &Table) -> Vec<String> {
    let nodes = table.get("nodes").and_then(Tree::as_table);
    nodes.iter().flat_map(|nodes| &nodes.entries).map(|(key, _)| key.name.clone()).collect()
}

/// Reads a dotted path of keys; the places are those inside `source`.
pub(crate) fn read_path(source: &Arc<Source>) -> Result<Vec<Key>, Vec<Problem>> {
    let probe = Source::new(source.name.clone(), source.folder.clone(), format!("{}=0", source.text));
    let mut table = document::parse(&probe)?;
    let mut path = Vec::new();
    while let Some((key, tree)) = table.entries.pop() {
        path.push(key);
        match tree.item {
            Item::Table(inner) => table = inner,
            _ => break,
        }
    }
    Ok(path)
}

/// A value inside one table per key.
pub(crate) fn nested(path: Vec<Key>, value: Tree) -> Table {
    let mut tree = value;
    for key in path.into_iter().rev() {
        let origin = key.origin.clone();
        tree = Tree { item: Item::Table(Table { entries: vec![(key, tree)] }), origin };
    }
    match tree.item {
        Item::Table(table) => table,
        _ => Table::default(),
    }
}
