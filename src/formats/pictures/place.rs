//! Gives every picture its time: by name where the stamps have names, else by [`super::pairing`].

use super::files::{Found, PictureFiles};
use super::pairing::{Candidate, Sides, Unclear, periods, stated};
use super::partners::{Times, alone, remainder};
use super::stamps::{self, Row, Stamps};
use crate::declared::{Declared, Pairing, Transfer};
use crate::error::FormatError;
use crate::recording::{FrameStamp, FramesAbout};
use std::collections::HashMap;
use std::path::Path;

/// Entries that are named one by one.
const NAMED: usize = 5;

impl Stamps {
    /// Wrong lines at the front are left out where there are more than pictures: the first of BS-ERGB's may
    /// be too many (ercanburak/EVREAL#5). Lines that count pictures are numbered.
    pub(crate) fn settle(&mut self, pictures: usize) {
        if let Some((wrong, why)) =
            stamps::leading_wrong(&self.rows, self.rows.len().saturating_sub(pictures))
        {
            self.notes.push(why);
            self.rows.drain(..wrong);
        }
        // Fewer lines than pictures: those of HS-ERGB belong to the first pictures (uzh-rpg/rpg_timelens#36).
        // Where a gap of whole periods is as long as what is missing, that is where it is missing.
        let times: Vec<i64> = self.rows.iter().map(|row| row.at).collect();
        let shows = periods(&times).is_some_and(|periods| periods + 1 == pictures as i64);
        if self.lines_count
            && self.rows.len() < pictures
            && !shows
            && self.rows.iter().all(|row| row.index.is_none())
        {
            self.rows.iter_mut().zip(0..).for_each(|(row, n)| row.index = Some(n));
        }
    }
}

impl Found {
    /// Gives every picture its stamp. `path` is the file or folder that messages name.
    pub(super) fn place(
        self,
        path: &Path,
        mut stamps: Stamps,
        declared: &Declared,
        times: Times,
    ) -> Result<PictureFiles, FormatError> {
        let mut chosen = Vec::new();
        let mut about = self.about.clone();
        if stamps.rows.iter().any(|row| row.name.is_some()) {
            by_name(&self, &stamps.rows, &mut about, &mut chosen);
        } else {
            stamps.settle(self.names.len());
            let sides = Sides::new(&self.names, &stamps.rows);
            let decided = sides
                .decide(declared)
                .map_err(|unclear| question(path, &self, &stamps, &sides, &unclear, times))?;
            let Some(candidate) = decided else {
                return Err(nothing(path, &self, &stamps.rows, declared, times));
            };
            let pairs = sides.pairs(&candidate);
            about.notes.extend(left_out(&self, &stamps.rows, &candidate, &pairs, times));
            for &(picture, row) in
                pairs.iter().filter(|(picture, row)| self.whole[*picture] && stamps.rows[*row].is_whole)
            {
                chosen.push(picture);
                about
                    .stamps
                    .push(FrameStamp { at: stamps.rows[row].at, exposure: stamps.rows[row].exposure });
            }
        }
        // What the stamps' file states goes before what follows from it.
        let own = self.about.notes.len();
        about.notes.splice(own..own, stamps.notes);
        about.stamp_role = stamps.role;
        about.row_time_ns = stamps.row_time_ns;
        if stamps.is_linear {
            about.transfer = Some(Transfer::Linear);
        }
        Ok(PictureFiles { about, source: self.source, chosen, losses: self.losses, files: self.files })
    }
}

fn by_name(found: &Found, rows: &[Row], about: &mut FramesAbout, chosen: &mut Vec<usize>) {
    let index: HashMap<&str, usize> =
        found.names.iter().enumerate().map(|(index, name)| (name.as_str(), index)).collect();
    let mut missing: Option<&str> = None;
    let (mut used, mut absent) = (vec![false; found.names.len()], 0);
    for row in rows {
        let name = row.name.as_deref().unwrap_or_default();
        match index.get(name) {
            Some(&picture) if !used[picture] => {
                used[picture] = true;
                if found.whole[picture] {
                    chosen.push(picture);
                    about.stamps.push(FrameStamp { at: row.at, exposure: row.exposure });
                }
            }
            _ => {
                absent += 1;
                missing = missing.or(Some(name));
            }
        }
    }
    if absent > 0 {
        let first = missing.unwrap_or_default();
        about.notes.push(format!(
            "{absent} stamps name no picture that is there, or one twice (the first: \
                                  `{first}`); they were left out"
        ));
    }
    let unstamped = used.iter().filter(|used| !**used).count();
    if unstamped > 0 {
        about.notes.push(format!("{unstamped} pictures have no stamp and were left out"));
    }
}

/// The first of some, and how many more.
fn list(all: &[String]) -> String {
    let more = all.len().saturating_sub(NAMED);
    let first = all[..all.len().min(NAMED)].join(", ");
    if more > 0 { format!("{first} and {more} more") } else { first }
}

/// A picture by its name, or by its number in a film.
fn name(found: &Found, picture: usize) -> String {
    if found.names[picture].is_empty() { format!("frame {picture}") } else { found.names[picture].clone() }
}

/// What has no partner, for the user.
fn left_out(
    found: &Found,
    rows: &[Row],
    candidate: &Candidate,
    pairs: &[(usize, usize)],
    times: Times,
) -> Vec<String> {
    let (pictures, unused) = alone(found.names.len(), rows, pairs);
    let broken: Vec<String> = pairs
        .iter()
        .filter(|(_, row)| !rows[*row].is_whole)
        .map(|(picture, _)| name(found, *picture))
        .collect();
    let mut notes = Vec::new();
    if pictures.is_empty() && unused.is_empty() && broken.is_empty() {
        return notes;
    }
    let by = match candidate.by {
        Pairing::Order => "in order",
        Pairing::Numbers => "by the numbers in their names",
        Pairing::Times => "by the period of the times",
        Pairing::NumbersAndTimes => "by the numbers in their names and the period of the times",
    };
    let whole = rows.iter().filter(|row| row.is_whole).count();
    notes.push(format!(
        "{} pictures and {whole} {}: paired {by}, the first picture with {} {}",
        found.names.len(),
        times.many(),
        times.one(),
        candidate.first
    ));
    if !pictures.is_empty() {
        let names: Vec<String> = pictures.iter().map(|picture| name(found, *picture)).collect();
        notes.push(format!(
            "{} pictures have no {} and were left out: {}",
            names.len(),
            times.one(),
            list(&names)
        ));
    }
    if !unused.is_empty() {
        let at: Vec<String> = unused.iter().map(|row| format!("{} ns", rows[*row].at)).collect();
        notes.push(format!("{} {}s have no picture and were left out: {}", at.len(), times.one(), list(&at)));
    }
    if !broken.is_empty() {
        notes.push(format!(
            "{} pictures belong to a pulse of which an edge is missing and were left out: {}",
            broken.len(),
            list(&broken)
        ));
    }
    notes
}

fn question(
    path: &Path,
    found: &Found,
    stamps: &Stamps,
    sides: &Sides,
    unclear: &Unclear,
    times: Times,
) -> FormatError {
    let rows = &stamps.rows;
    let with_by = unclear.best.by != unclear.second.by;
    let of = |candidate: &Candidate| {
        format!(
            "{} leaves {}",
            stated(candidate, with_by),
            remainder(found.names.len(), rows, &sides.pairs(candidate), times)
        )
    };
    let whole = rows.iter().filter(|row| row.is_whole).count();
    let what = format!(
        "{} pictures and {whole} {}: counts, numbers in the pictures' names and gaps between the times \
         leave open which belong together",
        found.names.len(),
        times.many()
    );
    let hint = format!(
        "state it: {}, {}; photocurrent init compares them with the events",
        of(&unclear.best),
        of(&unclear.second)
    );
    FormatError::new(path, what, hint).undeclared(if unclear.best.first == unclear.second.first {
        "pairing"
    } else {
        "first_pulse"
    })
}

fn nothing(path: &Path, found: &Found, rows: &[Row], declared: &Declared, times: Times) -> FormatError {
    let what = format!("{} pictures and {} {}", found.names.len(), rows.len(), times.many());
    match declared.first_pulse {
        Some(first) => FormatError::new(
            path,
            format!("{what}: with `first_pulse = {first}` none belongs to another"),
            "state a smaller `first_pulse`, or none",
        ),
        None => FormatError::new(path, what, format!("name pictures that have a {}", times.one())),
    }
}
