//! What becomes of each finding when a manifest is written: one list, one consequence each.
//!
//! `inspect` reports; `photocurrent init` acts. A fault that can be put right in the parameters of a reader
//! is, with a note; what the files leave open becomes a line marked `FILL:`; what would make every picture
//! wrong, and cannot be put right, is refused with the option that states it or accepts it. Facts have no
//! consequence.

/// What `init` does about a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consequence {
    /// Sets parameters of the reader, with a note that states why.
    Corrects(&'static [&'static str]),
    /// Marks a parameter of the reader or a field of the description with `FILL:`, with a proposal.
    Proposes(&'static str),
    /// Writes a line marked `FILL:` that states the finding, for what no parameter holds.
    Marks,
    /// Refuses, and names the option that states what is true; `--accept` and the finding's id goes on all
    /// the same.
    Refuses(&'static str),
    /// Nothing: no fault, or the reader has dealt with it.
    None,
}

use Consequence::{Corrects, Marks, None as Nothing, Proposes, Refuses};

/// Every finding's id, with its consequence.
pub const CONSEQUENCES: &[(&str, Consequence)] = &[
    // Of the file.
    ("damaged", Nothing),
    ("cut_off", Nothing),
    ("events_outside", Marks),
    ("odd_polarity", Marks),
    ("stamps_without_time", Marks),
    ("event_count", Marks),
    // Of the events' clock.
    ("no_events", Refuses("--camera")),
    ("clock_stands", Refuses("--columns")),
    ("unit_too_small", Refuses("--time-unit")),
    ("unit_too_large", Marks),
    ("stamps_are_whole_seconds", Marks),
    ("intervals_too_short", Marks),
    ("clumps", Marks),
    ("equal_stamps", Nothing),
    ("coarse_stamps", Marks),
    ("single_precision", Marks),
    ("stray_stamps", Corrects(&["start", "end"])),
    ("counter_wrap", Refuses("--end")),
    ("time_goes_back", Marks),
    ("not_in_order", Nothing),
    ("counter_wrap_followed", Nothing),
    ("early_in_pixel_times", Refuses("--columns")),
    ("some_early_in_pixel_times", Marks),
    // Of polarity and places.
    ("one_polarity", Refuses("--accept")),
    ("extent_unknown", Proposes("extent")),
    ("outside", Refuses("--extent")),
    ("scaled", Proposes("coordinate_scale")),
    ("small_part_used", Proposes("extent")),
    ("swapped", Refuses("--columns")),
    ("hot_pixels", Marks),
    ("silent_rows", Marks),
    ("silent_columns", Marks),
    ("loud_rows", Nothing),
    ("loud_columns", Nothing),
    ("row_pattern", Nothing),
    ("column_pattern", Nothing),
    ("duplicate_events", Corrects(&["drop_duplicates"])),
    // Of the frames' values.
    ("no_frames", Refuses("--frames")),
    ("unreadable_frames", Corrects(&["skip_frames"])),
    ("infinite_frames", Refuses("--skip-frames")),
    ("nan_frames", Refuses("--skip-frames")),
    ("some_nan", Nothing),
    ("negative_frames", Refuses("--accept")),
    ("some_negative", Marks),
    ("no_picture", Refuses("--frame-camera")),
    ("empty_frames", Corrects(&["skip_frames"])),
    ("all_saturated", Refuses("--accept")),
    ("saturated", Nothing),
    ("repeated_frames", Corrects(&["skip_frames"])),
    // Of the frames' times.
    ("frames_go_back", Marks),
    ("equal_frame_stamps", Corrects(&["skip_frames"])),
    ("missing_frames", Nothing),
    ("empty_exposures", Refuses("--exposure")),
    ("exposure_over_period", Marks),
    ("frames_too_fast", Refuses("--stamps-unit")),
    ("constant_rate", Nothing),
    ("exposure_unknown", Proposes("exposure")),
    ("stamp_unknown", Proposes("stamp")),
    ("exposure_stamps", Nothing),
    ("row_time_unknown", Proposes("row_time")),
    ("transfer_unknown", Proposes("transfer")),
    // Of both.
    ("frames_only", Refuses("--frames")),
    ("events_only", Refuses("--frames")),
    ("no_overlap", Refuses("--frame-offset")),
    ("little_overlap", Corrects(&["start", "end"])),
    ("frame_coupled_events", Marks),
    ("mirrored", Proposes("mirror")),
    ("events_late", Proposes("clock_offset")),
    ("in_time", Nothing),
    ("clock_drift", Marks),
    ("displaced", Proposes("shift")),
    ("on_one_grid", Nothing),
    ("sizes_differ", Refuses("--extent")),
    ("trigger_unpaired", Marks),
    ("trigger_gaps", Marks),
    ("trigger_count", Marks),
];

/// The consequence of a finding.
pub fn consequence(id: &str) -> Option<Consequence> {
    CONSEQUENCES.iter().find(|(known, _)| *known == id).map(|(_, consequence)| *consequence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Cause;
    use std::collections::BTreeSet;

    /// Ids in the sources of the detectors: the first literal of each finding, and those of lines, which are
    /// chosen between rows and columns.
    fn ids() -> BTreeSet<String> {
        let sources = [
            include_str!("mod.rs"),
            include_str!("events.rs"),
            include_str!("frames.rs"),
            include_str!("together.rs"),
        ];
        let mut ids = BTreeSet::new();
        for source in sources {
            let calls = ["add", "error", "hazard", "question", "fact"].map(|name| format!("found.{name}("));
            for call in calls.iter().flat_map(|call| source.split(call.as_str()).skip(1)) {
                // The id is the first argument.
                let before = call.split(',').next().unwrap_or_default();
                let literals = before.split('"').skip(1).step_by(2).filter(|text| {
                    text.len() > 3 && text.chars().all(|c| c.is_ascii_lowercase() || c == '_')
                });
                ids.extend(literals.filter(|text| *text != "column").map(String::from));
            }
        }
        ids.extend(
            [Cause::Damage, Cause::Cut, Cause::Outside, Cause::Polarity, Cause::Stamp]
                .map(|cause| super::super::advice(cause).0.to_owned()),
        );
        ids
    }

    #[test]
    fn every_finding_has_one_consequence_and_every_consequence_a_finding() {
        let listed: BTreeSet<String> = CONSEQUENCES.iter().map(|(id, _)| (*id).to_owned()).collect();
        assert_eq!(listed.len(), CONSEQUENCES.len(), "an id stands once");
        assert_eq!(listed, ids());
    }
}
