//! Bounds on scores after a run: in words on stderr, as a record for `run.json` and `--json`, as an exit
//! code.

use crate::numbers::print_count;
use crate::terminal::say;
use photocurrent_engine::{Judged, Outcome, Statistic, Verdict};
use serde::{Deserialize, Serialize};

/// The exit code of a run whose nodes all came to their end, and of which a score is outside its bound.
pub const OUT_OF_BOUNDS: u8 = 5;

/// A bound and how the score came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpectRecord {
    pub variant: String,
    pub node: String,
    pub metric: String,
    /// Which number of the score.
    pub of: Statistic,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub at_least: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub at_most: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub warn_below: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub warn_above: Option<f64>,
    /// What was measured; null where nothing was.
    pub value: Option<f64>,
    pub unit: String,
    pub verdict: Verdict,
    /// File, line and column of the bound.
    pub at: String,
}

impl From<&Judged> for ExpectRecord {
    fn from(judged: &Judged) -> ExpectRecord {
        let bound = &judged.bound;
        ExpectRecord {
            variant: judged.variant.clone(),
            node: judged.node.clone(),
            metric: bound.metric.clone(),
            of: bound.of,
            at_least: bound.at_least,
            at_most: bound.at_most,
            warn_below: bound.warn_below,
            warn_above: bound.warn_above,
            value: judged.value,
            unit: judged.unit.clone(),
            verdict: judged.verdict,
            at: bound.origin.to_string(),
        }
    }
}

impl ExpectRecord {
    /// `psnr.psnr_db`, with the variant of an ablation and the number that is no mean: `psnr.psnr_db (p05)`.
    pub fn name(&self, is_ablation: bool) -> String {
        let variant = if is_ablation { format!("{}: ", self.variant) } else { String::new() };
        let of = if self.of == Statistic::Value { String::new() } else { format!(" ({})", self.of.name()) };
        format!("{variant}{}.{}{of}", self.node, self.metric)
    }

    /// What was measured, with its unit.
    pub fn measured(&self) -> String {
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        self.value.map_or("not measured".into(), |value| format!("{value:.3}{unit}"))
    }

    /// `at least 35, at most 60`.
    pub fn bound(&self) -> String {
        let said = [("at least", self.at_least), ("at most", self.at_most)];
        joined(said)
    }

    /// `below 36`.
    pub fn warning(&self) -> String {
        joined([("below", self.warn_below), ("above", self.warn_above)])
    }

    /// What is wrong; `None` where nothing is.
    pub fn complaint(&self, is_ablation: bool) -> Option<String> {
        let (name, measured) = (self.name(is_ablation), self.measured());
        match self.verdict {
            Verdict::Pass => None,
            Verdict::Warn => Some(format!("{name} is {measured}: a warning {}", self.warning())),
            Verdict::Fail if self.bound().is_empty() => Some(format!("{name} is {measured}")),
            Verdict::Fail => Some(format!("{name} is {measured}, expected {}", self.bound())),
            Verdict::Unchecked => Some(format!("{name}: this run has no result of {}", self.node)),
        }
    }

    /// The same as a line on stderr, with the place of the bound.
    pub fn line(&self, is_ablation: bool) -> Option<String> {
        let word = match self.verdict {
            Verdict::Pass => return None,
            Verdict::Warn => "warning",
            Verdict::Fail => "error",
            Verdict::Unchecked => "not checked",
        };
        Some(format!("{word}: {} ({})", self.complaint(is_ablation)?, self.at))
    }
}

fn joined(limits: [(&str, Option<f64>); 2]) -> String {
    let said = limits.into_iter().filter_map(|(words, limit)| Some(format!("{words} {}", limit?)));
    said.collect::<Vec<_>>().join(", ")
}

/// The exit code of a run: that of its nodes, else that of its bounds.
pub fn exit_code(outcome: &Outcome, judged: &[ExpectRecord]) -> u8 {
    let is_broken = judged.iter().any(|judged| judged.verdict == Verdict::Fail);
    match outcome.exit_code() {
        0 if is_broken => OUT_OF_BOUNDS,
        code => code,
    }
}

/// Says which bounds do not hold, and how many do; when `quiet`, only what is wrong.
pub fn talk(judged: &[ExpectRecord], is_ablation: bool, quiet: bool) {
    if judged.is_empty() {
        return;
    }
    judged.iter().filter_map(|judged| judged.line(is_ablation)).for_each(|line| say!("{line}"));
    let count = |verdict: Verdict| judged.iter().filter(|judged| judged.verdict == verdict).count();
    if count(Verdict::Fail) > 0 {
        say!("hint: the results are stored; change what makes them, or the bound where it is written");
    }
    if quiet {
        return;
    }
    let others = [Verdict::Warn, Verdict::Fail, Verdict::Unchecked].map(|verdict| (verdict, count(verdict)));
    let others = others.into_iter().filter(|(_, count)| *count > 0);
    let others: String = others.map(|(verdict, count)| format!(", {count} {}", verdict.name())).collect();
    say!("expect: {} of {} pass{others}", count(Verdict::Pass), print_count(judged.len(), "bound"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(verdict: Verdict) -> ExpectRecord {
        ExpectRecord {
            variant: "front_end=on".into(),
            node: "psnr".into(),
            metric: "psnr_db".into(),
            of: Statistic::P05,
            at_least: Some(35.0),
            at_most: None,
            warn_below: Some(36.5),
            warn_above: None,
            value: Some(31.5883),
            unit: "dB".into(),
            verdict,
            at: "m.toml:31:3".into(),
        }
    }

    #[test]
    fn what_does_not_hold_is_said_with_its_number_its_bound_and_its_place() {
        assert_eq!(record(Verdict::Pass).line(true), None);
        assert_eq!(
            record(Verdict::Fail).line(true).unwrap(),
            "error: front_end=on: psnr.psnr_db (p05) is 31.588 dB, expected at least 35 (m.toml:31:3)"
        );
        assert_eq!(
            record(Verdict::Warn).line(false).unwrap(),
            "warning: psnr.psnr_db (p05) is 31.588 dB: a warning below 36.5 (m.toml:31:3)"
        );
        let record = ExpectRecord { value: None, ..record(Verdict::Fail) };
        assert!(record.line(false).unwrap().contains("is not measured, expected at least 35"));
    }
}
