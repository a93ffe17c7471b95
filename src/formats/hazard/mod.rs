//! What is wrong with a recording, or not known of it: with evidence, and what to do.
//!
//! Every hazard here has cost somebody days: a wrong unit, a clock that wrapped, an offset forgotten or added
//! twice, frames of NaN. A [`Survey`] counts; this judges. Nothing is guessed and nothing is put right
//! silently: a finding says what was seen, and the user decides.
//!
//! - [`limits`]: from where on something is a finding, each with its reason.
//! - `events`, `frames`, `together`: the detectors.
//! - [`consequence`]: what becomes of each finding when a manifest is written; [`places`]: how the two
//!   streams lie on each other, as parameters.
//!
//! Severities: an [`Severity::Error`] makes results meaningless, so nothing should run on such data; a
//! [`Severity::Hazard`] may, and should be looked at; a [`Severity::Question`] is a fact that a method needs
//! and the file does not hold; a [`Severity::Fact`] is information and no fault.

pub mod consequence;
mod events;
mod frames;
pub mod limits;
pub mod places;
mod together;

#[cfg(test)]
mod tests;

pub use consequence::{Consequence, consequence};
pub use limits::Limits;
pub use places::{mirror_of, shift_of};

use crate::error::Cause;
use crate::survey::Survey;
use serde::Serialize;
use std::fmt;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Results would be meaningless: put it right first.
    Error,
    /// Results may be wrong: look at it.
    Hazard,
    /// The file does not say, and methods need to know.
    Question,
    /// Information, no fault.
    Fact,
}

impl Severity {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            Severity::Error => "error",
            Severity::Hazard => "hazard",
            Severity::Question => "question",
            Severity::Fact => "fact",
        }
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Something about a recording that a person should know.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Short and stable: `unit_too_small`.
    pub id: &'static str,
    /// How bad.
    pub severity: Severity,
    /// What, in a sentence.
    pub message: String,
    /// The numbers behind it.
    pub evidence: String,
    /// What to do about it.
    pub what_to_do: String,
}

/// Findings of one recording while they are collected.
pub(crate) struct Findings<'a> {
    limits: &'a Limits,
    all: Vec<Finding>,
}

impl Findings<'_> {
    fn add(
        &mut self,
        id: &'static str,
        severity: Severity,
        message: impl Into<String>,
        evidence: impl Into<String>,
        what_to_do: impl Into<String>,
    ) {
        let (message, evidence, what_to_do) = (message.into(), evidence.into(), what_to_do.into());
        self.all.push(Finding { id, severity, message, evidence, what_to_do });
    }
}

/// Methods of [`Findings`] that add a finding of one severity.
macro_rules! severities {
    ($($name:ident: $severity:ident),*) => {
        impl Findings<'_> {
            $(fn $name(
                &mut self,
                id: &'static str,
                message: impl Into<String>,
                evidence: impl Into<String>,
                what_to_do: impl Into<String>,
            ) {
                self.add(id, Severity::$severity, message, evidence, what_to_do);
            })*
        }
    };
}
severities!(error: Error, hazard: Hazard, question: Question, fact: Fact);

/// All findings about a recording, worst first.
pub fn findings(survey: &Survey, limits: &Limits) -> Vec<Finding> {
    let mut found = Findings { limits, all: Vec::new() };
    damage(survey, &mut found);
    if let Some(events) = &survey.events {
        events::judge(events, &survey.format, &mut found);
    }
    if let Some(frames) = &survey.frames {
        frames::judge(frames, &mut found);
    }
    for line in &survey.triggers {
        together::line(line, survey.frames.as_ref(), &mut found);
    }
    together::judge(survey, &mut found);
    found.all.sort_by_key(|finding| finding.severity);
    found.all
}

/// What was left out, one finding for each cause: what can be done depends on it.
fn damage(survey: &Survey, found: &mut Findings) {
    let mut causes: Vec<Cause> = survey.losses.iter().map(|loss| loss.cause).collect();
    causes.sort_unstable();
    causes.dedup();
    for cause in causes {
        let of_cause = || survey.losses.iter().filter(|loss| loss.cause == cause);
        let Some(first) = of_cause().next() else { continue };
        let (id, message, what_to_do) = advice(cause);
        let places = count(of_cause().map(|loss| loss.places).sum(), "place", "places");
        found.hazard(id, message, format!("{places} in all; first {}: {}", first.at, first.what), what_to_do);
    }
}

/// Id, message and what to do.
fn advice(cause: Cause) -> (&'static str, &'static str, &'static str) {
    match cause {
        Cause::Damage => (
            "damaged",
            "parts of the file are damaged and were left out",
            "copy the file again from where it came; what is whole can be used",
        ),
        Cause::Cut => (
            "cut_off",
            "the file ends before its content does; what lies behind is lost",
            "copy the file again from where it came, or record it again; what stands before the end can be \
             used",
        ),
        Cause::Outside => (
            "events_outside",
            "events lie outside of the pixel array and were left out",
            "state the array's size as `extent`, or how coordinates are stored: `origin = 1` where they \
             begin at 1, `coordinate_scale` where they count parts of a pixel",
        ),
        Cause::Polarity => (
            "odd_polarity",
            "some events have a polarity that the others do not have, and were left out",
            "if these values mean something, state `polarity`: \"counts\" (every value above 0 is ON) or \
             \"one_two\" (1 is OFF, 2 is ON)",
        ),
        Cause::Stamp => (
            "stamps_without_time",
            "some events have a stamp that is no time, and were left out",
            "check the program that wrote the stamps; if there are many, check which column is the time and \
             its unit (`time_unit`)",
        ),
    }
}

/// `1 event`, `17 events`.
pub(crate) fn count(n: u64, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

/// A time for people: `1.25 ms`.
pub fn time(ns: f64) -> String {
    let size = ns.abs();
    let (value, unit) = match size {
        s if s < 1e3 => (ns, "ns"),
        s if s < 1e6 => (ns * 1e-3, "us"),
        s if s < 1e9 => (ns * 1e-6, "ms"),
        _ => (ns * 1e-9, "s"),
    };
    // Four digits say enough, and a long time keeps its microseconds.
    let digits = if unit == "s" && size >= 1e11 {
        6
    } else {
        [3, 2, 1, 0][(value.abs() >= 10.0) as usize
            + (value.abs() >= 100.0) as usize
            + (value.abs() >= 1000.0) as usize]
    };
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {unit}")
}

/// A share for people: `31 %`.
pub fn percent(share: f64) -> String {
    let value = share * 100.0;
    if value == 0.0 || value >= 10.0 { format!("{value:.0} %") } else { format!("{value:.2} %") }
}
