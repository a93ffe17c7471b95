//! Shaders from their texts: WGSL has no generics, so the number of states and the prior are filled in here.
//!
//! A text may have lines `#if NAME` ... `#end`, which are kept where the name is set, and
//! `#each a in FROM..TO` ... `#end`, which are repeated with `$a` as each number; both may lie in each other.
//! `$N`, `$HALF` and the states `$U`, `$Z`, `$V`, `$S`, `$R`, `$ON`, `$OFF` are numbers everywhere. So every
//! index is a constant, and states stay in registers.

use crate::structs;
use photocurrent_sensor::map::estimate::LEAST_VARIANCE;
use photocurrent_sensor::map::laid;
use std::collections::BTreeMap;
use std::fmt::Write;

/// How many pixels of a group lie side by side in memory.
pub(crate) const LANES: u32 = 32;

/// Storage buffers that a shader has.
pub(crate) const BINDINGS: u32 = 10;
/// Bytes of the largest: what every Vulkan driver allows.
pub(crate) const LARGEST_BINDING: u64 = 128 << 20;

/// How a pixel comes out, and what becomes of its second start.
pub(crate) mod codes {
    pub(crate) const CONVERGED: u32 = 0;
    pub(crate) const UNFINISHED: u32 = 1;
    pub(crate) const FAILED: u32 = 2;

    pub(crate) const REFUSED: u32 = 1;
    pub(crate) const KEPT: u32 = 2;
}

/// Columns of what is given, and of what is worked on.
pub(crate) mod columns {
    pub(crate) const LENGTH: u32 = 0;
    pub(crate) const TARGET: u32 = 1;
    pub(crate) const EXPOSURE: u32 = 2;
    pub(crate) const START: u32 = 3;
    pub(crate) const NEAR: u32 = 4;
    pub(crate) const REACH: u32 = 5;
    pub(crate) const PER_NEARBY: u32 = 6;
    /// How many columns are given.
    pub(crate) const GIVEN: u32 = 7;

    /// First the light of now and that of a trial, then what is fetched.
    pub(crate) const SAVED: u32 = 2;
    pub(crate) const CHANGE: u32 = 3;
    pub(crate) const ENERGY: u32 = 4;
    /// How many columns are worked on.
    pub(crate) const WORK: u32 = 8;
    /// How many a move has.
    pub(crate) const MOVE: u32 = 7;
}

/// What a shader computes in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Real {
    /// 32 bits.
    Single,
    /// 64 bits.
    Double,
    /// Two of 32 bits.
    Pair,
}

/// The family of a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Family {
    /// Local variance.
    Local,
    /// Student's t of increments.
    Walk,
    /// The same of changes of slope.
    Integrated,
}

/// Which shaders a pixel takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Variant {
    /// Are thresholds unknowns?
    pub free: bool,
    pub family: Family,
}

impl Variant {
    /// How many states there are.
    pub(crate) fn states(self) -> u32 {
        if self.free { 7 } else { 5 }
    }
}

const PIXEL: &str = include_str!("shaders/pixel.wgsl");
const STATES: &str = include_str!("shaders/states.wgsl");
const WALK: &str = include_str!("shaders/walk.wgsl");

/// The shader of Gauss-Newton steps: entry points `begin` and `descend`.
pub(crate) fn descend(variant: Variant) -> String {
    shader(variant, Real::Single, include_str!("shaders/descend.wgsl"))
}

/// The shader of the last pass: entry point `last`.
pub(crate) fn last(variant: Variant, real: Real) -> String {
    shader(variant, real, include_str!("shaders/last.wgsl"))
}

/// The shader that integrates light: entry point `integrate`.
pub(crate) fn means() -> String {
    [structs::WGSL, include_str!("shaders/means.wgsl")].join("\n")
}

/// The shader that makes tracks of answers: entry point `settle`.
pub(crate) fn settle() -> String {
    [constants(0).as_str(), structs::WGSL, include_str!("shaders/settle.wgsl")].join("\n")
}

fn shader(variant: Variant, real: Real, own: &str) -> String {
    let (name, arithmetic) = match real {
        Real::Single => ("f32", include_str!("shaders/single.wgsl")),
        Real::Double => ("f64", include_str!("shaders/double.wgsl")),
        Real::Pair => ("vec2<f32>", include_str!("shaders/pair.wgsl")),
    };
    let constants = constants(variant.states());
    let texts = [constants.as_str(), structs::WGSL, PIXEL, arithmetic, STATES, WALK, own];
    // An alias would be a type of its own inside arrays.
    let texts = texts.join("\n").replace("REAL", name);
    let family = match variant.family {
        Family::Local => "local",
        Family::Walk => "walk",
        Family::Integrated => "integrated",
    };
    let mut set = vec![family];
    if variant.free {
        set.push("free");
    }
    expanded(&texts, &set, variant.states())
}

/// Constants of the solver, from where they are stated.
fn constants(states: u32) -> String {
    let mut text = String::new();
    let mut put = |name: &str, value: String| {
        // Writing into a string does not fail.
        let _ = writeln!(text, "const {name} = {value};");
    };
    for (name, bits) in [
        ("EVENT", laid::EVENT),
        ("FRAME", laid::FRAME),
        ("NO_EVENT", laid::NO_EVENT),
        ("BOUND", laid::BOUND),
        ("MOVE", laid::MOVE),
        ("EXPOSE", laid::EXPOSE),
        ("LATCH", laid::LATCH),
        ("SEGMENT", laid::SEGMENT),
        ("RISE", laid::RISE),
        ("LAST", laid::LAST),
        ("LANES", LANES),
        ("LENGTH", columns::LENGTH),
        ("TARGET", columns::TARGET),
        ("EXPOSURE", columns::EXPOSURE),
        ("START", columns::START),
        ("NEAR", columns::NEAR),
        ("REACH", columns::REACH),
        ("PER_NEARBY", columns::PER_NEARBY),
        ("SAVED", columns::SAVED),
        ("CHANGE", columns::CHANGE),
        ("ENERGY", columns::ENERGY),
        ("CONVERGED", codes::CONVERGED),
        ("UNFINISHED", codes::UNFINISHED),
        ("FAILED", codes::FAILED),
        ("REFUSED", codes::REFUSED),
        ("KEPT", codes::KEPT),
        ("NO_EVENT_FROM", laid::NO_EVENT_FROM as u32),
        ("ATTEMPTS", laid::ATTEMPTS as u32),
    ] {
        put(name, format!("{bits}u"));
    }
    for (name, value) in [
        ("FIRST_VARIANCE", laid::FIRST_VARIANCE),
        ("FIRST_SLOPE_VARIANCE", laid::FIRST_SLOPE_VARIANCE),
        ("LONGEST_STEP", laid::LONGEST_STEP),
        ("LOG_LIMIT", laid::LOG_LIMIT),
        ("FIRST_DAMPING", laid::FIRST_DAMPING),
        ("LOG_TWO_PI", laid::LOG_TWO_PI),
        ("LEAST_VARIANCE", LEAST_VARIANCE),
        // Of a sum of squares in single precision.
        ("ROUNDING", 1e-5),
    ] {
        put(name, format!("f32({value:e})"));
    }
    let mut index = 0;
    for a in 0..states {
        for b in a..states {
            put(&format!("I{a}{b}"), format!("{index}u"));
            if a != b {
                put(&format!("I{b}{a}"), format!("{index}u"));
            }
            index += 1;
        }
    }
    text
}

/// A text with its conditions, repetitions and numbers filled in.
fn expanded(text: &str, set: &[&str], states: u32) -> String {
    let mut numbers: BTreeMap<String, u32> =
        ["U", "Z", "V", "S", "R", "ON", "OFF"].into_iter().map(String::from).zip(0..).collect();
    numbers.insert("N".into(), states);
    numbers.insert("HALF".into(), states * (states + 1) / 2);
    let mut out = String::new();
    expand(&mut text.lines(), set, &mut numbers, true, &mut out);
    out
}

/// Up to the matching `#end`, or to the end of the text; writes it where `writes`.
fn expand<'a>(
    lines: &mut (impl Iterator<Item = &'a str> + Clone),
    set: &[&str],
    numbers: &mut BTreeMap<String, u32>,
    writes: bool,
    out: &mut String,
) {
    while let Some(line) = lines.next() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["#end"] => return,
            ["#if", name] => expand(lines, set, numbers, writes && set.contains(&name), out),
            ["#each", name, "in", range] => {
                let number = |text: &str| numbers.get(text).copied().or(text.parse().ok());
                let (from, to) = range.split_once("..").unwrap_or((range, range));
                let (from, to) = (number(from).unwrap_or(0), number(to).unwrap_or(0));
                let body = lines.clone();
                // To its end, whether it is repeated or not.
                expand(lines, set, numbers, false, out);
                for n in from..to {
                    numbers.insert(name.into(), n);
                    expand(&mut body.clone(), set, numbers, writes, out);
                }
                numbers.remove(name);
            }
            _ if writes => {
                fill(line, numbers, out);
                out.push('\n');
            }
            _ => {}
        }
    }
}

/// A line with its numbers filled in: the longest name counts.
fn fill(line: &str, numbers: &BTreeMap<String, u32>, out: &mut String) {
    let mut parts = line.split('$');
    out.push_str(parts.next().unwrap_or_default());
    for part in parts {
        let name = numbers.iter().filter(|(name, _)| part.starts_with(name.as_str()));
        match name.max_by_key(|(name, _)| name.len()) {
            Some((name, number)) => {
                let _ = write!(out, "{number}{}", &part[name.len()..]);
            }
            None => {
                out.push('$');
                out.push_str(part);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_and_repetitions_lie_in_each_other() {
        let text = "a[$N]\n#each a in 0..2\n#each b in a..2\np[I$a$b] = $au;\n#if free\nq[$ON];\n#end\n\
                    #end\n#end\n#if free\nx\n#each a in 0..9\n#end\n#end\nz";
        assert_eq!(expanded(text, &[], 5), "a[5]\np[I00] = 0u;\np[I01] = 0u;\np[I11] = 1u;\nz\n");
        let free = expanded(text, &["free"], 7);
        assert!(free.starts_with("a[7]\np[I00] = 0u;\nq[5];\n") && free.ends_with("x\nz\n"), "{free}");
    }

    #[test]
    fn nothing_is_left_unfilled_in_any_variant() {
        for free in [false, true] {
            for family in [Family::Local, Family::Walk, Family::Integrated] {
                let variant = Variant { free, family };
                let texts = [
                    descend(variant),
                    last(variant, Real::Single),
                    last(variant, Real::Double),
                    last(variant, Real::Pair),
                ];
                for text in texts {
                    assert!(!text.contains(['$', '#']), "{variant:?}:\n{text}");
                }
            }
        }
    }
}
