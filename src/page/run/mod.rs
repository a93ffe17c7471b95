//! The report of finished runs: verdict first, then pictures, curves, one pixel, edges, the graph, the
//! diagnosis, hazards, where it all comes from.
//!
//! Every part that a run does not hold says what is missing and how to get it, so that nobody looks for it in
//! vain.

mod data;
mod parts;

pub use data::{
    Bar, BoundMark, BoundRow, Card, Cell, Copy, Curve, Event, Film, Graph, Group, Hazard, Mark, NodeRow,
    Panel, Picture, Pixel, Residual, RunPage, Solved, Verdict, VerdictRow,
};

use crate::shell::{Page, Script, Section};
use serde_json::json;

impl RunPage {
    /// The whole file.
    pub fn html(&self) -> String {
        let mut copies = Vec::new();
        let section = |id, title: &str, html: String| Section { id, title: title.into(), html };
        let panels: Vec<&Panel> = self.curves.iter().chain(&self.edges).collect();
        let sections = vec![
            section("verdict", "Verdict", parts::verdict(self, &mut copies)),
            section("pictures", "Pictures", parts::pictures(self)),
            section("time", "Over time", parts::curves(self)),
            section("pixel", "One pixel", parts::pixel(self)),
            section("edges", "Edges", parts::edges(self)),
            section("diagnosis", "Diagnosis", self.diagnosis.clone()),
            section("graph", "Pipeline", parts::graphs(self)),
            section("data", "Data", parts::hazards(self)),
            section("provenance", "Provenance", parts::provenance(self)),
        ];
        let data =
            json!({ "copies": copies, "groups": self.groups, "pixels": self.pixels, "charts": panels });
        Page {
            generator: "photocurrent report".into(),
            title: self.title.clone(),
            lead: parts::lead(self),
            sections,
            data,
            scripts: if self.groups.is_empty() {
                vec![Script::Chart]
            } else {
                vec![Script::Chart, Script::Compare, Script::Probe]
            },
        }
        .html()
    }
}

#[cfg(test)]
mod tests;
