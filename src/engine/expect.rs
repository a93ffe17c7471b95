//! Bounds on scores: what `[nodes.NAME.expect]` demands of an evaluator's numbers, and how they came out.
//!
//! A bound decides nothing about a result, so it is no ingredient of a key: it may be changed after a run,
//! and the next one executes nothing and judges anew. It belongs to a node of one variant, not to a task,
//! which several variants with other bounds may share.

use photocurrent_core::document::{Item, Origin, Problem, Table, Tree};
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};

/// Which number of a score is held against a bound.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Statistic {
    /// The scorer's own pooled value, mostly the mean over frames.
    #[default]
    Value,
    /// The smallest frame.
    Min,
    /// The 5th percentile of the frames.
    P05,
    /// The 95th percentile of the frames.
    P95,
    /// The largest frame.
    Max,
}

impl Statistic {
    const ALL: [Statistic; 5] =
        [Statistic::Value, Statistic::Min, Statistic::P05, Statistic::P95, Statistic::Max];

    /// Its key in a line of `metrics.pooled.jsonl`, and in a manifest.
    pub fn name(self) -> &'static str {
        match self {
            Statistic::Value => "value",
            Statistic::Min => "min",
            Statistic::P05 => "p05",
            Statistic::P95 => "p95",
            Statistic::Max => "max",
        }
    }
}

/// What is demanded of one score; the limits themselves are allowed, each in the unit of the score.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// The score, `psnr_db`.
    pub metric: String,
    /// Which of its numbers.
    pub of: Statistic,
    /// Below it the bound is broken.
    pub at_least: Option<f64>,
    /// Above it the bound is broken.
    pub at_most: Option<f64>,
    /// Below it there is a warning.
    pub warn_below: Option<f64>,
    /// Above it there is a warning.
    pub warn_above: Option<f64>,
    /// Where the manifest names the score.
    pub origin: Origin,
}

/// How a score came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Inside all limits.
    Pass,
    /// Its node gave no result in this run: it failed, was skipped, or is left out.
    Unchecked,
    /// Inside the bound, outside the limits of a warning.
    Warn,
    /// Outside the bound, or not measured although its node ran.
    Fail,
}

impl Verdict {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Pass => "pass",
            Verdict::Unchecked => "unchecked",
            Verdict::Warn => "warn",
            Verdict::Fail => "fail",
        }
    }
}

/// A bound and how the score came out.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// The variant.
    pub variant: String,
    /// The evaluator.
    pub node: String,
    /// What was demanded.
    pub bound: Bound,
    /// What was measured.
    pub value: Option<f64>,
    /// `dB`; empty where it has none or was not measured.
    pub unit: String,
    /// How it came out.
    pub verdict: Verdict,
}

const LIMITS: [&str; 4] = ["at_least", "at_most", "warn_below", "warn_above"];

/// The form of the bounds on one score: a table, or a list of them for several of its numbers.
pub(crate) fn schema() -> Json {
    let limit = |about: &str| json!({ "type": "number", "description": about });
    let table = json!({
        "type": "object", "additionalProperties": false,
        "x-example": "`psnr_db = { at_least = 35.0 }`",
        "properties": {
            "at_least": limit("Below it the bound is broken: exit code 5."),
            "at_most": limit("Above it the bound is broken: exit code 5."),
            "warn_below": limit("Below it there is a warning."),
            "warn_above": limit("Above it there is a warning."),
            "of": {
                "enum": Statistic::ALL.map(Statistic::name),
                "description": "Which number of the score: pooled, or over its frames.",
            },
        },
    });
    json!({ "anyOf": [table, { "type": "array", "items": table, "minItems": 1 }] })
}

/// The bounds of a node, whose form was checked; limits that contradict each other are noted and left out.
pub(crate) fn read(expect: &Table, problems: &mut Vec<Problem>) -> Vec<Bound> {
    let mut bounds = Vec::new();
    for (key, tree) in &expect.entries {
        let list = match &tree.item {
            Item::Array(items) => items.as_slice(),
            _ => std::slice::from_ref(tree),
        };
        for item in list {
            let Some(table) = item.as_table() else { continue };
            let number = |name: &str| match table.get(name)?.item {
                Item::Integer(number) => Some(number as f64),
                Item::Float(number) => Some(number),
                _ => None,
            };
            let of = table.get("of").and_then(Tree::as_str);
            let bound = Bound {
                metric: key.name.clone(),
                of: Statistic::ALL.into_iter().find(|s| Some(s.name()) == of).unwrap_or_default(),
                at_least: number("at_least"),
                at_most: number("at_most"),
                warn_below: number("warn_below"),
                warn_above: number("warn_above"),
                origin: key.origin.clone(),
            };
            match bound.mistake(table, item) {
                Some(problem) => problems.push(problem),
                None => bounds.push(bound),
            }
        }
    }
    bounds
}

impl Bound {
    fn mistake(&self, table: &Table, item: &Tree) -> Option<Problem> {
        if LIMITS.iter().all(|name| table.get(name).is_none()) {
            let problem = Problem::at(&item.origin, format!("`{}` has no limit", self.metric));
            let help = format!("such as `{} = {{ at_least = 35.0 }}`; limits are {}", self.metric, limits());
            return Some(problem.label("expected a limit").help(help));
        }
        let place = |name: &str| table.get(name).map_or(&item.origin, |tree| &tree.origin);
        // A warning that begins where the bound is broken already is never given.
        let pairs = [
            (
                "warn_below",
                self.warn_below,
                "at_least",
                self.at_least,
                "above",
                self.warn_below <= self.at_least,
            ),
            (
                "warn_above",
                self.warn_above,
                "at_most",
                self.at_most,
                "below",
                self.warn_above >= self.at_most,
            ),
        ];
        for (warn, limit, bound, other, side, is_wrong) in pairs {
            if let (Some(limit), Some(other), true) = (limit, other, is_wrong) {
                let message = format!("`{warn} = {limit}` never warns: `{bound} = {other}` fails before it");
                let help = format!("write a `{warn}` {side} {other}, or take it out");
                return Some(Problem::at(place(warn), message).help(help));
            }
        }
        let low = self.warn_below.or(self.at_least);
        let high = self.warn_above.or(self.at_most);
        if let (Some(low), Some(high)) = (low, high)
            && low > high
        {
            let message = format!("no value of `{}` passes: at least {low} and at most {high}", self.metric);
            let name = if self.warn_above.is_some() { "warn_above" } else { "at_most" };
            return Some(Problem::at(place(name), message).help("the lower limit comes first: swap them"));
        }
        None
    }

    /// How a value comes out; `None` is a score that could not be measured.
    pub(crate) fn verdict(&self, value: Option<f64>) -> Verdict {
        let Some(value) = value.filter(|value| value.is_finite()) else { return Verdict::Fail };
        let outside = |low: Option<f64>, high: Option<f64>| {
            low.is_some_and(|low| value < low) || high.is_some_and(|high| value > high)
        };
        match () {
            () if outside(self.at_least, self.at_most) => Verdict::Fail,
            () if outside(self.warn_below, self.warn_above) => Verdict::Warn,
            () => Verdict::Pass,
        }
    }
}

fn limits() -> String {
    LIMITS.map(|name| format!("`{name}`")).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::document::{Source, parse};

    fn bounds(text: &str) -> (Vec<Bound>, Vec<String>) {
        let table = parse(&Source::new("m.toml", "", text)).expect("TOML");
        let mut problems = Vec::new();
        let bounds = read(&table, &mut problems);
        (bounds, problems.into_iter().map(|problem| problem.message).collect())
    }

    #[test]
    fn limits_are_allowed_and_what_lies_between_them_warns() {
        let (bounds, problems) = bounds("a = { at_least = 30, warn_below = 32.5, at_most = 60.0 }");
        assert_eq!((bounds.len(), problems), (1, vec![]));
        let of = |value| bounds[0].verdict(value);
        let expected = [
            (Some(29.999), Verdict::Fail),
            (Some(30.0), Verdict::Warn),
            (Some(32.499), Verdict::Warn),
            (Some(32.5), Verdict::Pass),
            (Some(60.0), Verdict::Pass),
            (Some(60.001), Verdict::Fail),
            (Some(f64::NAN), Verdict::Fail),
            (None, Verdict::Fail),
        ];
        expected.iter().for_each(|(value, verdict)| assert_eq!(of(*value), *verdict, "{value:?}"));
    }

    #[test]
    fn one_score_may_have_bounds_on_several_of_its_numbers() {
        let (bounds, _) = bounds("a = [{ at_least = 35 }, { at_least = 30, of = \"min\" }]");
        assert_eq!(
            bounds.iter().map(|bound| (bound.of, bound.at_least)).collect::<Vec<_>>(),
            [(Statistic::Value, Some(35.0)), (Statistic::Min, Some(30.0))]
        );
    }

    #[test]
    fn limits_that_contradict_each_other_are_mistakes() {
        let mistake = |text: &str| {
            let (bounds, problems) = bounds(text);
            assert!(bounds.is_empty(), "{text}");
            problems.join("; ")
        };
        assert_eq!(mistake("a = {}"), "`a` has no limit");
        assert_eq!(mistake("a = { of = \"min\" }"), "`a` has no limit");
        assert_eq!(
            mistake("a = { at_least = 40, at_most = 30.5 }"),
            "no value of `a` passes: at least 40 and at most 30.5"
        );
        assert_eq!(
            mistake("a = { at_least = 40, warn_below = 40 }"),
            "`warn_below = 40` never warns: `at_least = 40` fails before it"
        );
        assert_eq!(
            mistake("a = { at_most = 2, warn_above = 3 }"),
            "`warn_above = 3` never warns: `at_most = 2` fails before it"
        );
        // Without both limits of a pair there is nothing to contradict.
        assert_eq!(bounds("a = { warn_above = 3 }").1, Vec::<String>::new());
        assert_eq!(bounds("a = { warn_below = 3, at_most = 2 }").1.len(), 1);
    }
}
