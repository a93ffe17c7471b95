//! What came of a run.

use crate::expect::{Judged, Verdict};
use crate::observer::End;
use crate::task::{PlannedVariant, TaskId};
use photocurrent_core::error::Trouble;
use photocurrent_core::table::Tails;
use photocurrent_core::{Digest, NodeError, Value};
use photocurrent_store::{Cache, StoreError, StoredOutput};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What came of one task.
#[derive(Clone, Debug)]
pub struct TaskOutcome {
    /// The node's name.
    pub label: String,
    /// Its kind.
    pub kind: &'static str,
    /// The (variant, node)s that it stands for.
    pub uses: Vec<(String, String)>,
    /// How it ended.
    pub end: End,
    /// Why it failed.
    pub error: Option<NodeError>,
    /// For a skipped one: the nodes that failed.
    pub because: Vec<String>,
    /// What the node had to say, on a cache hit too.
    pub notes: Vec<String>,
    /// How long it ran; for a reused one, how long it ran then.
    pub seconds: f64,
    /// What is stored, by port.
    pub outputs: BTreeMap<String, StoredOutput>,
    /// Its key, when that became known.
    pub key: Option<Digest>,
    /// Where its files are.
    pub export: Option<PathBuf>,
}

impl TaskOutcome {
    /// Why there is no result, in a sentence; empty when there is one.
    pub fn trouble(&self) -> String {
        match self.end {
            End::Executed | End::Reused => String::new(),
            End::Failed => format!(
                "{} failed: {}",
                self.label,
                self.error.as_ref().map(|error| error.message.clone()).unwrap_or_default()
            ),
            End::Skipped => format!("{} needs {}, which failed", self.label, self.because.join(", ")),
            End::Interrupted => format!("{} was interrupted", self.label),
        }
    }

    /// Bytes of its stored outputs.
    pub fn bytes(&self) -> u64 {
        self.outputs.values().map(|output| output.bytes).sum()
    }
}

/// What came of a run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// One per task of the plan, in its order.
    pub tasks: Vec<TaskOutcome>,
    /// The variants and the tasks of their nodes.
    pub variants: Vec<PlannedVariant>,
    /// What the user should know, in the order it came up.
    pub warnings: Vec<String>,
    /// Did the manifest have an ablation?
    pub is_ablation: bool,
}

impl Outcome {
    /// What came of a node in a variant.
    pub fn node(&self, variant: &str, node: &str) -> Option<&TaskOutcome> {
        let variant = self.variants.iter().find(|v| v.name == variant)?;
        variant.nodes.iter().find(|(id, _)| id == node).map(|(_, task)| &self.tasks[*task])
    }

    /// How many tasks ended so.
    pub fn count(&self, end: End) -> usize {
        self.tasks.iter().filter(|task| task.end == end).count()
    }

    /// Did every task of a variant end well?
    pub fn variant_is_whole(&self, variant: &PlannedVariant) -> bool {
        variant.nodes.iter().all(|(_, task)| matches!(self.tasks[*task].end, End::Executed | End::Reused))
    }

    /// A stored output; `None` when the node has none of that name, or did not get so far.
    ///
    /// # Errors
    /// When the cache cannot read it.
    pub fn value(
        &self,
        cache: &Cache,
        variant: &str,
        node: &str,
        port: &str,
    ) -> Result<Option<Value>, StoreError> {
        match self.node(variant, node).and_then(|task| task.outputs.get(port)) {
            Some(stored) => cache.load(&stored.digest).map(Some),
            None => Ok(None),
        }
    }

    /// All scores as JSON objects, one per (variant, node, metric, frame): those of single frames, and those
    /// pooled over all frames.
    ///
    /// # Errors
    /// When the cache cannot read a table.
    pub fn metrics(
        &self,
        cache: &Cache,
    ) -> Result<(Vec<serde_json::Value>, Vec<serde_json::Value>), StoreError> {
        let (mut single, mut pooled) = (Vec::new(), Vec::new());
        // Variants share tables: each is read once.
        let mut tables: BTreeMap<Digest, Value> = BTreeMap::new();
        for variant in &self.variants {
            for (node, task) in &variant.nodes {
                let stored = self.tasks[*task].outputs.values();
                for output in stored.filter(|output| output.data_type == photocurrent_core::DataType::Table) {
                    let value = match tables.get(&output.digest) {
                        Some(value) => value,
                        None => {
                            let value = cache.load(&output.digest)?;
                            tables.entry(output.digest).or_insert(value)
                        }
                    };
                    let Value::Table(table) = value else { continue };
                    let card =
                        table.notes.iter().find(|(name, _)| name == "card").map(|(_, text)| text.as_str());
                    let scores = table.as_scores().unwrap_or_default();
                    for score in &scores {
                        let mut line = json!({
                            "variant": variant.name, "node": node, "metric": score.metric,
                            "frame": score.frame, "t_ns": score.t_ns,
                            // JSON has no NaN: what could not be measured is null.
                            "value": score.value.is_finite().then_some(score.value), "unit": score.unit,
                            "card": card,
                        });
                        if score.frame >= 0 {
                            single.push(line);
                            continue;
                        }
                        if let Some(tails) = Tails::of(&scores, &score.metric) {
                            for (name, value) in [
                                ("min", tails.min),
                                ("p05", tails.p05),
                                ("p95", tails.p95),
                                ("max", tails.max),
                            ] {
                                line[name] = json!(value.is_finite().then_some(value));
                            }
                        }
                        pooled.push(line);
                    }
                }
            }
            // Which numbers these would have been is not known: a scorer says so with its numbers.
            let failed = variant
                .nodes
                .iter()
                .map(|(node, task)| (node, &self.tasks[*task]))
                .filter(|(_, task)| !matches!(task.end, End::Executed | End::Reused));
            pooled.extend(failed.map(|(node, task)| {
                json!({ "variant": variant.name, "node": node,
            "missing": "result", "why": task.trouble() })
            }));
            pooled.extend(variant.left_out.iter().map(|left| {
                json!({ "variant": variant.name,
            "node": left.node, "missing": left.missing, "why": left.why })
            }));
        }
        Ok((single, pooled))
    }

    /// Every bound with how the score came out, in the order of variants and nodes; `pooled` are the pooled
    /// scores of [`Outcome::metrics`].
    pub fn judge(&self, pooled: &[serde_json::Value]) -> Vec<Judged> {
        let mut all = Vec::new();
        for variant in &self.variants {
            for (node, bound) in &variant.expect {
                let task = self.node(&variant.name, node);
                let is_left_out = variant.left_out.iter().any(|left| left.node == *node);
                // A node that this run does not reach is not judged.
                if task.is_none() && !is_left_out {
                    continue;
                }
                let line = pooled.iter().find(|line| {
                    line["variant"] == variant.name.as_str()
                        && line["node"] == node.as_str()
                        && line["metric"] == bound.metric.as_str()
                });
                let value = line.and_then(|line| line[bound.of.name()].as_f64());
                let has_result = task.is_some_and(|task| task.end.is_well());
                all.push(Judged {
                    variant: variant.name.clone(),
                    node: node.clone(),
                    verdict: if has_result { bound.verdict(value) } else { Verdict::Unchecked },
                    bound: bound.clone(),
                    value,
                    unit: line.and_then(|line| line["unit"].as_str()).unwrap_or_default().into(),
                });
            }
        }
        all
    }

    /// What is missing, each once: in whole sentences, and the nodes that are left out for it.
    pub fn missing(&self) -> Vec<(&str, Vec<&str>)> {
        let mut all: Vec<(&str, Vec<&str>)> = Vec::new();
        for left in self.variants.iter().flat_map(|variant| &variant.left_out) {
            let at = all.iter().position(|(why, _)| *why == left.why).unwrap_or(all.len());
            if at == all.len() {
                all.push((&left.why, Vec::new()));
            }
            if !all[at].1.contains(&left.node.as_str()) {
                all[at].1.push(&left.node);
            }
        }
        all
    }

    /// The tasks that failed, in order.
    pub fn failures(&self) -> impl Iterator<Item = (TaskId, &TaskOutcome)> {
        self.tasks.iter().enumerate().filter(|(_, task)| task.end == End::Failed)
    }

    /// Did a node leave out damaged input?
    fn lost_data(&self) -> bool {
        self.tasks
            .iter()
            .any(|task| task.notes.iter().any(|note| note.starts_with(photocurrent_core::context::LOSS)))
    }

    /// What the command gives back to the shell: 0 done, 1 a node failed, 3 input data failed a check or were
    /// damaged in part, 4 an ablation finished with failed variants, 130 interrupted.
    pub fn exit_code(&self) -> u8 {
        let only_input = || {
            self.failures()
                .all(|(_, task)| task.error.as_ref().is_some_and(|error| error.trouble == Trouble::Input))
        };
        match () {
            () if self.count(End::Interrupted) > 0 => 130,
            () if self.count(End::Failed) == 0 && self.lost_data() => 3,
            () if self.count(End::Failed) == 0 => 0,
            () if self.is_ablation => 4,
            () if only_input() => 3,
            () => 1,
        }
    }
}
