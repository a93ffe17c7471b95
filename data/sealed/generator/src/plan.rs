//! Which recordings there are: their kind, what each conceals, and what its scene must be like.

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

/// All recordings, in the order of their seeds. New ones go to the end, so that the others stay as they are.
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
    fn every_id_of_the_catalogue_is_concealed_alone_somewhere() {
        for id in IDS {
            let alone = PLAN.iter().any(|entry| entry.kind == Kind::Single && entry.effects == [id]);
            assert!(alone, "{id} is not among the singles");
        }
        assert!(
            PLAN.iter()
                .all(|entry| entry.effects.len() == [1, 2].into_iter().find(|n| entry.kind == if *n == 1 { Kind::Single } else { Kind::Pair }).unwrap_or(0))
        );
    }
}
