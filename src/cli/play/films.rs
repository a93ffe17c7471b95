//! Which pictures are embedded, and how large, so that the page keeps its size.
//!
//! Every sequence has its own frames. Where they do not all fit, each has at most so many, evenly chosen;
//! where that would be fewer than [`FEWEST`], pictures get half the size, and again.

use crate::failure::Failure;
use crate::numbers::{human_bytes, in_ms};
use photocurrent_core::{Exposure, NodeError, Sensor, TimeSpan};
use photocurrent_nodes::show::{Shown, Tone};
use photocurrent_page::{PlayPage, Played, PlayedFilm, png_uri};

/// Fewer of a sequence are no film.
const FEWEST: usize = 24;
const MOST_SHRINK: u32 = 16;
/// Frames of a sequence that are marked on the time line though not all are embedded, at most.
const MOST_MARKS: usize = 5000;
/// What a picture takes in addition to its file, bytes.
const AROUND: u64 = 110;
/// Pictures whose size is measured, of each sequence.
const PROBES: usize = 3;

/// A sequence that is played.
pub struct Film {
    /// What people call it.
    pub label: String,
    /// The node that made it, where it is called otherwise.
    pub node: Option<String>,
    pub shown: Shown,
    /// Numbers of the frames within the stretch that is played.
    pub frames: Vec<usize>,
}

impl Film {
    /// Of the frames whose exposure lies within `span`, in part at least; `None` without any.
    pub fn within(span: TimeSpan, label: String, node: Option<String>, shown: Shown) -> Option<Film> {
        let is_inside = |exposure: &Exposure| exposure.end > span.start && exposure.start < span.end;
        let exposures = shown.exposures();
        let frames: Vec<usize> = (0..exposures.len()).filter(|&k| is_inside(&exposures[k])).collect();
        (!frames.is_empty()).then_some(Film { label, node, shown, frames })
    }

    fn kind(&self) -> &'static str {
        if self.shown.is_truth() {
            "truth"
        } else if self.shown.is_captured() {
            "captured"
        } else {
            "method"
        }
    }

    /// Its name, with that of its node.
    fn name(&self) -> String {
        match &self.node {
            Some(node) => format!("{} ({node})", self.label),
            None => self.label.clone(),
        }
    }

    /// Start and end of a frame's exposure, ns.
    fn exposure(&self, frame: usize) -> [i64; 2] {
        let exposure = self.shown.exposures()[frame];
        [exposure.start.0, exposure.end.0]
    }

    /// Bytes of one of its pictures, about.
    fn bytes(&self, tone: &Tone, shrink: u32) -> Result<u64, NodeError> {
        let count = self.frames.len();
        let taken = count.min(PROBES);
        let mut bytes = 0;
        for n in 0..taken {
            bytes +=
                self.shown.png(self.frames[(2 * n + 1) * count / (2 * taken)], tone, shrink)?.len() as u64;
        }
        Ok(in_text(bytes / taken as u64) + AROUND)
    }

    /// So many of its frames, evenly chosen.
    fn chosen(&self, most: usize) -> Vec<usize> {
        let count = self.frames.len();
        match most {
            _ if most >= count => self.frames.clone(),
            0 | 1 => vec![self.frames[count / 2]],
            _ => (0..most).map(|k| self.frames[k * (count - 1) / (most - 1)]).collect(),
        }
    }
}

/// Sequences with what is common to their pictures.
pub struct Films<'a> {
    all: &'a [Film],
    tone: Tone,
    /// Bytes of a picture of each sequence at full size, about.
    bytes: Vec<u64>,
}

/// Bytes of so many as base64.
pub fn in_text(bytes: u64) -> u64 {
    bytes.div_ceil(3) * 4
}

/// Bytes that fit into so many of base64.
pub fn in_binary(bytes: u64) -> u64 {
    bytes / 4 * 3
}

fn failed(error: NodeError) -> Failure {
    Failure::other(format!("the pictures cannot be made: {error}"))
}

impl Films<'_> {
    /// `None` without any sequence. Black and white are those of the truth, else of the first sequence.
    pub fn of<'a>(all: &'a [Film], sensor: Option<&Sensor>) -> Result<Option<Films<'a>>, Failure> {
        let Some(first) = all.iter().find(|film| film.shown.is_truth()).or(all.first()) else {
            return Ok(None);
        };
        let tone = Tone::of(&first.shown, sensor).map_err(failed)?;
        let bytes: Result<Vec<u64>, NodeError> = all.iter().map(|film| film.bytes(&tone, 1)).collect();
        Ok(Some(Films { all, tone, bytes: bytes.map_err(failed)? }))
    }

    /// Bytes of all of them, about.
    pub fn bytes(&self) -> u64 {
        self.of_at_most(usize::MAX, &self.bytes)
    }

    /// Bytes of at most so many pictures of each.
    fn of_at_most(&self, most: usize, bytes: &[u64]) -> u64 {
        self.all.iter().zip(bytes).map(|(film, bytes)| film.frames.len().min(most) as u64 * bytes).sum()
    }

    /// How many pictures of each sequence fit, and how much smaller they are, each way.
    fn fit(&self, budget: u64) -> Result<(usize, u32), Failure> {
        let longest = self.all.iter().map(|film| film.frames.len()).max().unwrap_or(0);
        let (mut shrink, mut bytes) = (1, self.bytes.clone());
        loop {
            let (mut low, mut high) = (1, longest.max(1));
            while low < high {
                let most = (low + high).div_ceil(2);
                if self.of_at_most(most, &bytes) <= budget { low = most } else { high = most - 1 }
            }
            let smaller = shrink * 2;
            let can_shrink = |film: &Film| {
                let extent = film.shown.extent();
                extent.width / smaller >= 16 && extent.height / smaller >= 16
            };
            if low >= longest.min(FEWEST) || smaller > MOST_SHRINK || !self.all.iter().all(can_shrink) {
                return Ok((low, shrink));
            }
            shrink = smaller;
            let measured: Result<_, _> = self.all.iter().map(|film| film.bytes(&self.tone, shrink)).collect();
            bytes = measured.map_err(failed)?;
        }
    }

    /// Adds the pictures that fit to a page, and what there is to say of those that do not.
    pub fn encode(&self, budget: u64, page: &mut PlayPage) -> Result<(), Failure> {
        let (most, shrink) = self.fit(budget)?;
        let mut thinned = Vec::new();
        for film in self.all {
            let extent = film.shown.extent();
            let chosen = film.chosen(most);
            let (count, name) = (film.frames.len(), film.name());
            if chosen.len() < count {
                thinned.push(format!("{} of {count} of {name}", chosen.len()));
            }
            let marked = if count <= MOST_MARKS { &film.frames } else { &chosen };
            let mut played = PlayedFilm {
                kind: film.kind(),
                width: extent.width / shrink,
                height: extent.height / shrink,
                row_time_ns: film.shown.row_time_ns(),
                frames: Vec::with_capacity(chosen.len()),
                marks: marked.iter().map(|&frame| film.exposure(frame)).collect(),
                label: name,
            };
            for &frame in &chosen {
                let src = png_uri(&film.shown.png(frame, &self.tone, shrink).map_err(failed)?);
                let [from_ns, to_ns] = film.exposure(frame);
                played.frames.push(Played { frame, from_ns, to_ns, src });
            }
            page.facts.push((played.label.clone(), about(film)));
            page.films.push(played);
        }
        if !thinned.is_empty() || shrink > 1 {
            let which = if thinned.is_empty() { "all pictures".into() } else { thinned.join("; ") };
            let size =
                if shrink > 1 { format!(", at 1/{shrink} of their size each way") } else { String::new() };
            page.notes.push(format!(
                "Pictures that are embedded: {which}{size}, to keep within {}. `--max-size` allows more, \
                 `--from` and `--to` choose a shorter stretch.",
                human_bytes(budget)
            ));
        }
        Ok(())
    }
}

/// What is stated of a sequence.
fn about(film: &Film) -> String {
    let exposures = film.shown.exposures();
    let (first, last) = (exposures[film.frames[0]], exposures[film.frames[film.frames.len() - 1]]);
    let seconds = (last.start - first.start) as f64 * 1e-9;
    let rate = if seconds > 0.0 {
        format!(", {:.1} a second", (film.frames.len() - 1) as f64 / seconds)
    } else {
        String::new()
    };
    let lengths = || film.frames.iter().map(|&frame| exposures[frame].length_ns());
    let (short, long) = (lengths().min().unwrap_or(0), lengths().max().unwrap_or(0));
    let exposed = match (in_ms(short), in_ms(long)) {
        (_, long) if long == "0.000" => "at an instant each".into(),
        (short, long) if short == long => format!("exposed for {long} ms"),
        (short, long) => format!("exposed for {short} to {long} ms"),
    };
    format!("{} frames{rate}, {exposed}; {} pixels", film.frames.len(), film.shown.extent())
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Extent, Value, testing};

    fn film(count: i64) -> Film {
        let exposures = (0..count).map(|l| Exposure::new(1000 * l, 1000 * l + 500)).collect();
        let extent = Extent { width: 32, height: 32 };
        // Of no regular kind, so that a file is about as large as its values.
        let value = |l: usize, x: u32, y: u32| ((l as u32 * 7919 + x * 104_729 + y * 1_299_709) % 251) as f32;
        let frames = testing::captured(extent, exposures, 0, value);
        let shown = Shown::of(Value::Frames(frames)).unwrap();
        Film::within(TimeSpan::new(0, 1000 * count), "a".into(), None, shown).unwrap()
    }

    #[test]
    fn frames_are_those_that_reach_into_the_stretch() {
        let shown = film(10).shown;
        let within = |from, to| {
            Film::within(TimeSpan::new(from, to), "a".into(), None, shown.clone()).map(|film| film.frames)
        };
        assert_eq!(within(1499, 3000), Some(vec![1, 2]));
        assert_eq!(within(1500, 3001), Some(vec![2, 3]));
        assert_eq!(within(1500, 2000), None);
    }

    #[test]
    fn what_does_not_fit_is_thinned_out_evenly_and_then_made_smaller() {
        let films = |film: Film| vec![film];
        let all = films(film(101));
        let chosen = |most| all[0].chosen(most);
        assert_eq!((chosen(3), chosen(1).len(), chosen(500).len()), (vec![0, 50, 100], 1, 101));
        let pictures = Films::of(&all, None).ok().flatten().unwrap();
        let (whole, one) = (pictures.bytes(), pictures.bytes[0]);
        assert_eq!(pictures.fit(whole).ok(), Some((101, 1)));
        assert_eq!(pictures.fit(50 * one).ok(), Some((50, 1)));
        let (most, shrink) = pictures.fit(10 * one).ok().unwrap();
        assert!(shrink == 2 && most > 10, "{most} at 1/{shrink}");
        let mut page = PlayPage::default();
        assert!(pictures.encode(50 * one, &mut page).is_ok());
        assert_eq!((page.films[0].frames.len(), page.films[0].marks.len()), (50, 101));
        assert!(page.notes[0].contains("50 of 101 of a"), "{}", page.notes[0]);
    }
}
