//! Which recordings there are: their kind, what each conceals, and what its scene must be like.
//!
//! Five plans: many short recordings of 72 x 54 pixels, a few of a second, recordings of a known target,
//! short ones of ten other families with effects near their detection limit, and short ones of four of these
//! with dependences in no catalogue alone.

mod field;
pub mod outside;

use field::FIELD;
use outside::OUTSIDE;

/// A list of recordings that are made together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// 72 x 54 pixels, 0.12 to 0.15 s.
    Short,
    /// 96 x 72 pixels, 1 s.
    Long,
    /// A star that a file beside the recording states, 64 x 48 to 96 x 72 pixels, 0.15 to 0.3 s.
    Target,
    /// Like the short ones, of the families of `views`, with noise, and effects near their detection limit.
    Field,
    /// Like those, each with a dependence that no catalogue lists.
    Outside,
}

impl Plan {
    pub const ALL: [Self; 5] = [Self::Short, Self::Long, Self::Target, Self::Field, Self::Outside];

    pub fn name(self) -> &'static str {
        match self {
            Self::Short => "short",
            Self::Long => "long",
            Self::Target => "target",
            Self::Field => "field",
            Self::Outside => "outside",
        }
    }

    pub fn entries(self) -> &'static [Entry] {
        match self {
            Self::Short => PLAN,
            Self::Long => LONG,
            Self::Target => TARGET,
            Self::Field => FIELD,
            Self::Outside => OUTSIDE,
        }
    }

    /// What the random numbers of recording `index` are named by; plans share none.
    pub fn seed(self, seed: &str, index: usize) -> String {
        match self {
            Self::Short => format!("{seed}/{index}"),
            _ => format!("{seed}/{}/{index}", self.name()),
        }
    }
}

/// How a recording is to be judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The sensor is as described.
    Null,
    /// The same in conditions that make a careless method raise an alarm.
    HardNull,
    /// The same, with something in scene or stamps that looks like an effect and is none.
    Trap,
    Single,
    Pair,
    OffCatalogue,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::HardNull => "hard_null",
            Self::Trap => "trap",
            Self::Single => "single",
            Self::Pair => "pair",
            Self::OffCatalogue => "off_catalogue",
        }
    }
}

/// One recording to be made.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    pub kind: Kind,
    /// Effects of the catalogue, `id` or `id:variant`.
    pub effects: &'static [&'static str],
    /// A law outside the catalogue, by name.
    pub law: Option<&'static str>,
    /// What is special about the scene or the sensor: see `draw`.
    pub condition: &'static str,
    /// A family of scenes that shows it; empty = any.
    pub family: &'static str,
}

const fn null(family: &'static str) -> Entry {
    Entry { kind: Kind::Null, effects: &[], law: None, condition: "", family }
}

const fn hard(condition: &'static str, family: &'static str) -> Entry {
    Entry { kind: Kind::HardNull, effects: &[], law: None, condition, family }
}

const fn trap(condition: &'static str, family: &'static str) -> Entry {
    Entry { kind: Kind::Trap, effects: &[], law: None, condition, family }
}

const fn single(effect: &'static [&'static str]) -> Entry {
    Entry { kind: Kind::Single, effects: effect, law: None, condition: "", family: "" }
}

const fn pair(effects: &'static [&'static str]) -> Entry {
    Entry { kind: Kind::Pair, effects, law: None, condition: "", family: "" }
}

const fn unnamed(law: &'static str, family: &'static str) -> Entry {
    Entry { kind: Kind::OffCatalogue, effects: &[], law: Some(law), condition: "", family }
}

const fn star(entry: Entry) -> Entry {
    Entry { family: "star", ..entry }
}

/// All short recordings, in the order of their seeds. New ones go to the end, so that the others stay as they
/// are.
pub const PLAN: &[Entry] = &[
    null("drift"),
    null("zoom"),
    null("spin"),
    null("turntable"),
    null("patch"),
    null("spokes"),
    null("bars"),
    null("discs"),
    null("rings"),
    null("shake"),
    null("shear"),
    null("chess"),
    null("spots"),
    null("waves"),
    null(""),
    null(""),
    null(""),
    null(""),
    hard("fast", "spokes"),
    hard("fast", "discs"),
    hard("dim", "drift"),
    hard("dim", "patch"),
    hard("few_events", "spots"),
    hard("few_events", "drift"),
    hard("large_latency", "shake"),
    hard("large_latency", "rings"),
    hard("still_ground", "few_discs"),
    hard("wide_range", "shear"),
    trap("flicker", "drift"),
    trap("flicker", "shake"),
    trap("shown_queue", "shake"),
    trap("shown_queue", "patch"),
    trap("strong_frame_noise", "spin"),
    trap("strong_frame_noise", "zoom"),
    single(&["dark_current"]),
    single(&["time_constant"]),
    single(&["second_pole"]),
    single(&["large_signal_front_end"]),
    single(&["slew_limit"]),
    single(&["high_pass_front_end"]),
    single(&["bandwidth_gradient"]),
    single(&["threshold_scale"]),
    single(&["threshold_asymmetry"]),
    single(&["threshold_mismatch"]),
    single(&["threshold_noise"]),
    single(&["threshold_drift"]),
    single(&["threshold_gradient"]),
    single(&["refractory"]),
    single(&["refractory_spread"]),
    single(&["refractory_light"]),
    single(&["reset_memory"]),
    single(&["leak_events"]),
    single(&["parasitic_leak"]),
    single(&["background_activity"]),
    single(&["hot_pixels"]),
    single(&["hot_rows"]),
    single(&["lateral_inhibition"]),
    single(&["readout_queue"]),
    single(&["event_loss"]),
    single(&["timestamp_quantization"]),
    single(&["timestamp_jitter"]),
    single(&["clock_offset"]),
    single(&["clock_drift"]),
    single(&["row_skew"]),
    single(&["frame_coupling"]),
    single(&["misalignment"]),
    single(&["blur"]),
    single(&["crosstalk"]),
    single(&["black_level"]),
    single(&["frame_nonlinearity"]),
    single(&["vignetting"]),
    single(&["row_time"]),
    single(&["exposure_time"]),
    single(&["frame_gain_steps"]),
    single(&["image_lag"]),
    single(&["time_constant:tau_0"]),
    single(&["time_constant:less"]),
    single(&["second_pole:light"]),
    single(&["slew_limit:both"]),
    single(&["refractory:law"]),
    single(&["reset_memory:over"]),
    single(&["row_skew:rows"]),
    single(&["leak_events"]),
    single(&["clock_offset"]),
    single(&["threshold_scale"]),
    single(&["black_level"]),
    pair(&["leak_events", "blur"]),
    pair(&["clock_offset", "threshold_scale"]),
    pair(&["second_pole", "black_level"]),
    pair(&["refractory", "misalignment"]),
    pair(&["threshold_asymmetry", "row_time"]),
    pair(&["threshold_mismatch", "dark_current"]),
    pair(&["hot_pixels", "clock_offset"]),
    pair(&["event_loss", "vignetting"]),
    pair(&["time_constant", "frame_gain_steps"]),
    pair(&["threshold_gradient", "image_lag"]),
    pair(&["background_activity", "misalignment"]),
    pair(&["parasitic_leak", "timestamp_jitter"]),
    pair(&["row_skew", "frame_nonlinearity"]),
    pair(&["lateral_inhibition", "clock_drift"]),
    unnamed("hysteresis", "spots"),
    unnamed("frame_kick", "spin"),
    unnamed("row_parity", ""),
    unnamed("fatigue", "patch"),
    unnamed("column_block", ""),
    unnamed("neighbour_delay", "turntable"),
    unnamed("ripple", "drift"),
    unnamed("row_reset", "rings"),
    unnamed("spatial_gradient", "shake"),
    unnamed("global_rate", "shake"),
    unnamed("row_rate", "shear"),
    unnamed("polarity_delay", ""),
    unnamed("light", "waves"),
    unnamed("radius", ""),
    unnamed("slow_comparator", "zoom"),
    unnamed("telegraph", "spokes"),
    unnamed("lag", "chess"),
    unnamed("hysteresis", "rings"),
    unnamed("ripple", "turntable"),
    unnamed("frame_kick", "shear"),
];

/// The recordings of a second.
pub const LONG: &[Entry] = &[
    null("turntable"),
    null("shake"),
    null(""),
    hard("wide_range", "shear"),
    single(&["time_constant"]),
    single(&["threshold_scale"]),
    single(&["leak_events"]),
    single(&["clock_offset"]),
    single(&["image_lag"]),
    pair(&["second_pole", "black_level"]),
    pair(&["refractory", "misalignment"]),
    unnamed("hysteresis", "discs"),
];

/// The recordings of a known target; frames of every second one have photon and read noise, which is stated.
pub const TARGET: &[Entry] = &[
    null("star"),
    null("star"),
    null("star"),
    null("star"),
    star(single(&["threshold_scale"])),
    star(single(&["threshold_asymmetry"])),
    star(single(&["time_constant"])),
    star(single(&["second_pole"])),
    star(single(&["refractory"])),
    star(single(&["clock_offset"])),
    star(single(&["leak_events"])),
    star(single(&["dark_current"])),
    star(single(&["black_level"])),
    star(single(&["exposure_time"])),
    star(single(&["row_time"])),
    star(single(&["misalignment"])),
    star(single(&["blur"])),
    star(single(&["reset_memory"])),
    star(single(&["image_lag"])),
    star(single(&["vignetting"])),
    star(pair(&["time_constant", "threshold_scale"])),
    star(pair(&["leak_events", "black_level"])),
    unnamed("hysteresis", "star"),
    unnamed("light", "star"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::IDS;

    fn count(kind: Kind) -> usize {
        PLAN.iter().filter(|entry| entry.kind == kind).count()
    }

    #[test]
    fn there_are_enough_of_every_kind() {
        assert!(PLAN.len() >= 100);
        let (null, hard, trap) = (count(Kind::Null), count(Kind::HardNull), count(Kind::Trap));
        assert!(null + hard + trap >= 28 && hard >= 10 && trap >= 4, "{null} {hard} {trap}");
        assert!(count(Kind::Single) >= 44 && count(Kind::Pair) >= 12 && count(Kind::OffCatalogue) >= 16);
        let mut laws: Vec<_> = PLAN.iter().filter_map(|entry| entry.law).collect();
        laws.sort_unstable();
        laws.dedup();
        assert!(laws.len() >= 10, "{laws:?}");
    }

    #[test]
    fn the_plans_have_their_numbers_of_every_kind() {
        let counts = |plan: Plan| {
            let kinds =
                [Kind::Null, Kind::HardNull, Kind::Trap, Kind::Single, Kind::Pair, Kind::OffCatalogue];
            kinds.map(|kind| plan.entries().iter().filter(|entry| entry.kind == kind).count())
        };
        assert_eq!(Plan::ALL.map(|plan| plan.entries().len()), [120, 12, 24, 120, 56]);
        assert_eq!(counts(Plan::Long), [3, 1, 0, 5, 2, 1]);
        assert_eq!(counts(Plan::Target), [4, 0, 0, 16, 2, 2]);
        assert_eq!(counts(Plan::Field), [26, 0, 6, 60, 12, 16]);
        assert!(TARGET.iter().all(|entry| entry.family == "star"));
        assert!(LONG.iter().chain(TARGET).flat_map(|entry| entry.effects).all(|id| IDS.contains(id)));
        let names: std::collections::BTreeSet<String> =
            Plan::ALL.iter().flat_map(|plan| (0..plan.entries().len()).map(|k| plan.seed("s", k))).collect();
        assert_eq!(names.len(), 332, "no two recordings share random numbers");
    }

    #[test]
    fn every_id_of_the_catalogue_is_concealed_alone_somewhere() {
        for id in IDS {
            let alone =
                |plan: &[Entry]| plan.iter().any(|entry| entry.kind == Kind::Single && entry.effects == [id]);
            assert!(alone(PLAN) && alone(FIELD), "{id} is not among the singles");
        }
        for entry in PLAN.iter().filter(|entry| entry.kind == Kind::Single) {
            assert!(FIELD.iter().any(|other| other.kind == Kind::Single && other.effects == entry.effects));
        }
        assert!(PLAN.iter().chain(FIELD).all(|entry| {
            entry.effects.len()
                == [1, 2]
                    .into_iter()
                    .find(|n| entry.kind == if *n == 1 { Kind::Single } else { Kind::Pair })
                    .unwrap_or(0)
        }));
    }
}
