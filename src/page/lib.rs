//! Pages of HTML that need nothing else: one file, no network, opened from disk.
//!
//! [`Page`] is the shell that all pages share: head, style (`style.css`), theme, navigation, scripts.
//! [`RunPage`] is the report of finished runs, [`PlayPage`] plays a recording. What the pages show is given
//! as plain structs: this crate knows no files, no graph and no sensor. It draws no numbers of its own, but
//! those of axes.
//!
//! Scripts are files of their own, each for one thing: `page.js` (helpers, theme, copy buttons), `chart.js`
//! (curves), `compare.js` (two pictures over each other), `probe.js` (one pixel over time), `play.js` (events
//! and pictures in time). They find their data in the element `page-data`, as JSON.
//!
//! Limits: without scripts the tables, the graph and the texts stay; pictures and curves need them.

#![cfg_attr(not(test), warn(unreachable_pub))]

mod escape;
mod play;
mod run;
mod shell;

pub use escape::{escaped, png_uri};
pub use play::{PlayPage, Played, PlayedEvents, PlayedFilm};
pub use run::{
    Bar, BoundMark, BoundRow, Card, Cell, Copy, Curve, Event, Film, Graph, Group, Hazard, Mark, NodeRow,
    Panel, Picture, Pixel, Residual, RunPage, Solved, Verdict, VerdictRow,
};
pub use shell::{Page, Script, Section};
