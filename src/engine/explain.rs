//! Why one node would run, in one line per reason.

use crate::blocks::is_of;
use crate::plan::Plan;
use crate::status::{State, TaskStatus, status};
use photocurrent_core::document::Problem;
use photocurrent_store::Cache;
use std::path::Path;

/// What is to be said about one node in one or more variants that share its task.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The variants.
    pub variants: Vec<String>,
    /// The state behind it.
    pub status: TaskStatus,
    /// The verdict first, then one reason each.
    pub lines: Vec<String>,
}

/// Explains a node in all variants of the plan.
///
/// # Errors
/// When the plan has no such node.
pub fn explain(plan: &Plan, cache: &Cache, out_dir: &Path, node: &str) -> Result<Vec<Explanation>, Problem> {
    let tasks = plan.tasks_of(node);
    if tasks.is_empty() {
        return Err(Problem::new(format!("there is no node `{node}` in this plan"))
            .did_you_mean(node, plan.node_names()));
    }
    let mut explanations = Vec::new();
    for status in status(plan, cache, out_dir).into_iter().filter(|status| tasks.contains(&status.task)) {
        let uses = plan.tasks[status.task].uses.iter().filter(|(_, name)| is_of(name, node));
        let (verdict, reasons) = match &status.state {
            State::Hit => ("in the cache".to_string(), &[][..]),
            State::Miss { reasons } => ("would run".to_string(), reasons.as_slice()),
            State::Waits { on, reasons } => (format!("waits for {}", on.join(", ")), reasons.as_slice()),
        };
        let lines = std::iter::once(verdict).chain(reasons.iter().cloned()).collect();
        explanations.push(Explanation {
            variants: uses.map(|(variant, _)| variant.clone()).collect(),
            status,
            lines,
        });
    }
    Ok(explanations)
}
