//! Unusual ways of storing events that are no damage: polarity as counts or as 1 and 2, coordinates that
//! begin at 1, stamps of a counter that begins again, negative numbers in columns without a sign.
//!
//! A reader counts what its columns hold over the whole file ([`Tally`]); [`Tally::settle`] decides once how
//! stored numbers are read ([`Rules`]). What was recognised is stated in a note and as a fact
//! ([`Convention`]). What is stated goes before: `polarity`, `origin`, `counter` of [`Declared`].
//!
//! | stored | read as | recognised where |
//! | --- | --- | --- |
//! | polarity 0 to n, or -n to n | above 0 is ON | every number up to n occurs |
//! | polarity 0 and one number n | n is ON | nothing else occurs |
//! | polarity 1 and 2 | 1 is OFF, 2 is ON | nothing else occurs (programs of MATLAB: `Read_Ndataset.m` of N-MNIST adds 1 to polarity and coordinates) |
//! | polarity 1 and 255, 65,535, ... | the large one is -1 without a sign, OFF | nothing else occurs |
//! | coordinates from 1 on | 1 is subtracted | an axis has events at 1 and at the array's width or height, and both stay within 1 to those |
//! | coordinates from 61,440 on | negative, outside | the size is not known, few events have them, and none lies between |
//! | stamps that begin again | the counter's range is added | time goes back by a range of [`Counter`], and all stamps lie within that range |
//!
//! Sources: better-flow/evimo#20 (counts), gorchard's Matlab_AER_vision_functions (1 and 2, from 1 on),
//! uzh-rpg/timelens-pp#4 (65,534), neuromorphicsystems/neuromorphic-drivers#1 (a counter of 24 bits).
//!
//! Limits: where fewer than one event in a hundred (or than ten) have another polarity than 0, 1 and -1, that
//! is no convention but damage; these are left out. Counting costs one more pass over the events of text,
//! numpy arrays and HDF5 columns, when they are first asked for.

use crate::chunk::EventChunk;
use crate::declared::{Counter, Declared, Polarity};
use crate::error::FormatError;
use crate::recording::{Convention, EventCursor, EventsAbout};
use photocurrent_core::Extent;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

#[cfg(test)]
mod tests;

/// A stored value that is no whole number, or no number at all.
pub(crate) const NONE: i64 = i64::MIN;

/// Share of events with an odd polarity from which that is no damage.
const ODD_SHARE: f64 = 0.01;
/// Fewer events decide nothing.
const FEWEST_ODD: u64 = 10;
/// Largest count that is still one: more events of one pixel are not summed.
const MOST_COUNT: i64 = 64;
/// Distinct polarities that are counted one by one.
const MOST_DISTINCT: usize = 64;
/// Part of a counter's range by which time goes back at least when it begins again: the rest is the time
/// between two events.
const WHOLE_RANGE: f64 = 0.98;
/// Coordinates from here on may be negative ones of 16 bits; from [`BETWEEN`] on none may lie then.
const NEGATIVE: i64 = 61_440;
/// See [`NEGATIVE`].
const BETWEEN: i64 = 16_384;

/// Formats whose events are read by these rules, and which take `polarity`, `origin` and `counter`.
pub(crate) const FORMATS: [&str; 10] =
    ["csv", "npz", "memmap", "hs_ergb", "ecd", "dsec", "m3ed", "mvsec", "event_utils_hdf5", "v2e_hdf5"];

/// What is stated, and what stored numbers are held against.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stated {
    polarity: Option<Polarity>,
    origin: Option<u32>,
    counter: Option<Counter>,
    /// Size of frames that lie elsewhere.
    frames: Option<Extent>,
}

impl Stated {
    pub(crate) fn of(declared: &Declared) -> Stated {
        let frames = declared
            .frames
            .as_deref()
            .filter(|_| declared.extent.is_none())
            .and_then(crate::pictures::size_of);
        Stated { polarity: declared.polarity, origin: declared.origin, counter: declared.counter, frames }
    }
}

/// What polarities mean.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Code {
    #[default]
    Signs,
    Counts,
    OneTwo,
    /// This number stands for -1.
    Unsigned(i64),
}

/// How stored numbers become places and polarities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rules {
    code: Code,
    origin: i64,
    has_negative: bool,
}

impl Rules {
    /// A stored polarity: ON, OFF, or none.
    #[inline]
    pub(crate) fn on(self, stored: i64) -> Option<bool> {
        match (self.code, stored) {
            (_, NONE) => None,
            (Code::Signs, 1) | (Code::OneTwo, 2) | (Code::Unsigned(_), 1) => Some(true),
            (Code::Signs, 0 | -1) | (Code::OneTwo, 1) => Some(false),
            (Code::Counts, _) => Some(stored > 0),
            (Code::Unsigned(minus), _) if stored == minus => Some(false),
            _ => None,
        }
    }

    /// A stored coordinate as a pixel counted from 0; it may lie outside.
    #[inline]
    pub(crate) fn pixel(self, stored: i64) -> i64 {
        let signed = if self.has_negative && stored >= NEGATIVE { stored - 65_536 } else { stored };
        signed.saturating_sub(self.origin)
    }

    /// Are 0, 1 and -1 read as usual, and coordinates as they are stored?
    pub(crate) fn is_usual(self) -> bool {
        self == Rules::default()
    }
}

/// One coordinate of all events.
#[derive(Clone, Debug)]
struct Side {
    least: i64,
    most: i64,
    /// Events at the largest.
    at_most: u64,
    /// Largest below the negative ones, and how many of these there are.
    below: i64,
    negative: u64,
}

impl Default for Side {
    fn default() -> Side {
        Side { least: i64::MAX, most: i64::MIN, at_most: 0, below: i64::MIN, negative: 0 }
    }
}

impl Side {
    #[inline]
    fn add(&mut self, value: i64) {
        if value == NONE {
            return;
        }
        self.least = self.least.min(value);
        if value > self.most {
            (self.most, self.at_most) = (value, 0);
        }
        self.at_most += u64::from(value == self.most);
        if value < NEGATIVE {
            self.below = self.below.max(value);
        } else {
            self.negative += 1;
        }
    }

    /// Does it run from 1 to the size of the array, with as many events there as a column of the array may
    /// have?
    fn fills(&self, size: u32, events: u64) -> bool {
        let usual = events as f64 / f64::from(size.max(1));
        self.least == 1 && self.most == i64::from(size) && self.at_most as f64 >= 0.05 * usual
    }

    fn is_within(&self, size: u32) -> bool {
        self.least >= 1 && self.most <= i64::from(size)
    }
}

/// Stamps of all events, ns.
#[derive(Clone, Debug)]
struct Clock {
    before: i64,
    least: i64,
    most: i64,
    /// How often time goes back by each range, less how often it goes forward by it.
    turns: [i64; Counter::ALL.len()],
}

impl Default for Clock {
    fn default() -> Clock {
        Clock { before: NONE, least: i64::MAX, most: i64::MIN, turns: [0; Counter::ALL.len()] }
    }
}

impl Clock {
    #[inline]
    fn add(&mut self, t: i64) {
        if t == NONE {
            return;
        }
        (self.least, self.most) = (self.least.min(t), self.most.max(t));
        if self.before != NONE && t.abs_diff(self.before) > 4_000_000_000 {
            self.step(t.saturating_sub(self.before));
        }
        self.before = t;
    }

    #[cold]
    fn step(&mut self, step: i64) {
        for (turns, counter) in self.turns.iter_mut().zip(Counter::ALL) {
            *turns -= i64::from(step as f64 >= WHOLE_RANGE * counter.range_ns() as f64);
            *turns += i64::from(step as f64 <= -WHOLE_RANGE * counter.range_ns() as f64);
        }
    }

    /// The smallest counter that holds all stamps, and whose range time goes back by.
    fn counter(&self) -> Option<(Counter, i64)> {
        let span = self.most.checked_sub(self.least)?;
        Counter::ALL
            .into_iter()
            .zip(self.turns)
            .find(|(counter, turns)| span < counter.range_ns() && *turns > 0)
    }
}

/// What the columns of a file hold.
#[derive(Clone, Debug)]
pub(crate) struct Tally {
    events: u64,
    /// Of -1 to 255, at value + 1.
    small: Vec<u64>,
    others: BTreeMap<i64, u64>,
    /// Events whose polarity is no whole number, or one too many.
    odd: u64,
    x: Side,
    y: Side,
    clock: Clock,
}

impl Tally {
    pub(crate) fn new() -> Tally {
        Tally {
            events: 0,
            small: vec![0; 257],
            others: BTreeMap::new(),
            odd: 0,
            x: Side::default(),
            y: Side::default(),
            clock: Clock::default(),
        }
    }

    /// Takes an event: its stamp in ns, and coordinates (as pixels) and polarity as they are stored. [`NONE`]
    /// is no number.
    #[inline]
    pub(crate) fn add(&mut self, t: i64, x: i64, y: i64, p: i64) {
        self.events += 1;
        self.clock.add(t);
        self.x.add(x);
        self.y.add(y);
        match self.small.get_mut(p.wrapping_add(1) as usize) {
            Some(count) => *count += 1,
            None => self.other(p),
        }
    }

    #[cold]
    fn other(&mut self, p: i64) {
        if p != NONE && (self.others.len() < MOST_DISTINCT || self.others.contains_key(&p)) {
            *self.others.entry(p).or_default() += 1;
        } else {
            self.odd += 1;
        }
    }

    /// Polarities that occur, and how often.
    fn polarities(&self) -> Vec<(i64, u64)> {
        let small = self
            .small
            .iter()
            .zip(-1..)
            .filter(|(count, _)| **count > 0)
            .map(|(count, value)| (value, *count));
        let mut all: Vec<(i64, u64)> =
            small.chain(self.others.iter().map(|(value, count)| (*value, *count))).collect();
        all.sort_unstable();
        all
    }

    /// What polarities mean: `Err` with what is odd of them where no convention explains them.
    fn code(&self) -> Result<Code, String> {
        let all = self.polarities();
        let values: Vec<i64> = all.iter().map(|(value, _)| *value).collect();
        let odd = self.odd
            + all.iter().filter(|(value, _)| !(-1..=1).contains(value)).map(|(_, count)| count).sum::<u64>();
        if odd < FEWEST_ODD || (odd as f64) < ODD_SHARE * self.events as f64 {
            // None, or a few: damage, and left out one by one.
            return Ok(Code::Signs);
        }
        if self.odd == 0 {
            match values.as_slice() {
                [2] | [1, 2] => return Ok(Code::OneTwo),
                [1, minus] if [0xff, 0xffff, 0xffff_ffff, i64::MAX].contains(minus) => {
                    return Ok(Code::Unsigned(*minus));
                }
                [0, on] if *on > 1 => return Ok(Code::Counts),
                _ => {}
            }
            let largest = values.iter().map(|value| value.saturating_abs()).max().unwrap_or(0);
            let occurs = |size: i64| values.contains(&size) || values.contains(&-size);
            if largest <= MOST_COUNT && values.iter().any(|value| *value <= 0) && (1..=largest).all(occurs) {
                return Ok(Code::Counts);
            }
        }
        let listed = values.iter().take(8).map(i64::to_string).collect::<Vec<_>>().join(", ");
        let more = if values.len() > 8 || self.odd > 0 { " and others" } else { "" };
        Err(format!(
            "polarity takes the values {listed}{more}; {:.0} % of the events have others than 0, 1 and -1",
            100.0 * odd as f64 / self.events as f64
        ))
    }

    /// Do coordinates begin at 1, as far as an array of this size shows it?
    fn begins_at_one(&self, size: Option<Extent>) -> bool {
        size.is_some_and(|Extent { width, height }| {
            let fills = self.x.fills(width, self.events) || self.y.fills(height, self.events);
            fills && self.x.is_within(width) && self.y.is_within(height)
        })
    }

    /// Decides how the file is read.
    ///
    /// # Errors
    /// When no convention explains the polarities of more than one event in a hundred, and none is stated.
    pub(crate) fn settle(
        self,
        path: &Path,
        stated: &Stated,
        mut about: EventsAbout,
    ) -> Result<Settled, FormatError> {
        let (mut conventions, mut rules) = (Vec::new(), Rules::default());
        let code = match stated.polarity {
            Some(Polarity::Signs) => Ok(Code::Signs),
            Some(Polarity::Counts) => Ok(Code::Counts),
            Some(Polarity::OneTwo) => Ok(Code::OneTwo),
            None => self.code(),
        };
        rules.code = code.map_err(|found| {
            let hint = "state how it is stored: `polarity = \"counts\"` (every value above 0 is ON), \
                        \"one_two\" (1 is OFF, 2 is ON), or \"signs\" (1 is ON, 0 and -1 \
                        are OFF, events with other values are left out)";
            FormatError::new(path, found, hint).at("the column of the polarity").undeclared("polarity")
        })?;
        conventions.extend(self.polarity_said(rules.code, stated.polarity.is_some()));
        let size = about.extent.or(stated.frames);
        let is_one = stated.origin.map_or_else(|| self.begins_at_one(size), |origin| origin == 1);
        if is_one {
            rules.origin = 1;
            conventions.push(self.origin_one(size));
        }
        let negative = self.x.negative + self.y.negative;
        let is_negative = |side: &Side| side.negative == 0 || side.below < BETWEEN;
        if about.extent.is_none()
            && negative > 0
            && negative as f64 <= 0.1 * self.events as f64
            && is_negative(&self.x)
            && is_negative(&self.y)
        {
            rules.has_negative = true;
            conventions.push(Convention {
                id: "negative_coordinates",
                what: format!(
                    "coordinates of {NEGATIVE} and more are negative numbers stored without a \
                               sign: their events lie outside of the array"
                ),
                evidence: format!(
                    "{negative} such coordinates; all others are at most {}",
                    self.x.below.max(self.y.below)
                ),
                otherwise: "state `extent`: then what lies outside is left out by its size".into(),
            });
        }
        let counter = match stated.counter {
            Some(counter) => (counter != Counter::None).then_some((counter, 0.5)),
            None => self.clock.counter().map(|(counter, _)| (counter, WHOLE_RANGE)),
        };
        if let (None, Some((counter, turns))) = (stated.counter, self.clock.counter()) {
            let bits = counter.name();
            conventions.push(Convention {
                id: "counter_followed",
                what: format!(
                    "the stamps' counter of {bits} started again {turns} {}; its range was added",
                    if turns == 1 { "time" } else { "times" }
                ),
                evidence: format!("time goes back by the range of {bits}, and all stamps lie within it"),
                otherwise: "state `counter = \"none\"` where recordings were joined that begin anew".into(),
            });
        }
        about.notes.extend(conventions.iter().map(|convention| convention.what.clone()));
        Ok(Settled {
            about,
            rules,
            follow: counter
                .map(|(counter, share)| (counter.range_ns(), (share * counter.range_ns() as f64) as i64)),
            conventions,
        })
    }

    /// What is noted of coordinates that begin at 1.
    fn origin_one(&self, size: Option<Extent>) -> Convention {
        Convention {
            id: "origin_one",
            what: "coordinates begin at 1: 1 was subtracted".into(),
            evidence: format!(
                "columns {} to {}, rows {} to {}{}",
                self.x.least,
                self.x.most,
                self.y.least,
                self.y.most,
                of_pixels(size)
            ),
            otherwise: "state `origin = 0` where they begin at 0".into(),
        }
    }

    /// What is noted of the polarity; nothing of the usual signs.
    fn polarity_said(&self, code: Code, is_stated: bool) -> Option<Convention> {
        let all = self.polarities();
        let (least, most) = (all.first()?.0, all.last()?.0);
        let (id, what) = match code {
            Code::Signs => return None,
            _ if is_stated && self.code() == Ok(Code::Signs) => return None,
            Code::Counts if all.len() == 2 && least == 0 => {
                ("polarity_two_values", format!("polarity is 0 or {most}: {most} was read as ON"))
            }
            Code::Counts => {
                let off = if least < 0 { ", every other as OFF" } else { "" };
                (
                    "polarity_counts",
                    format!(
                        "polarity holds counts {least} to {most}: every value above 0 was read as ON{off}"
                    ),
                )
            }
            Code::OneTwo => ("polarity_one_two", "polarity is 1 or 2: 1 was read as OFF, 2 as ON".into()),
            Code::Unsigned(minus) => (
                "polarity_unsigned",
                format!("a polarity of {minus} is -1 stored without a sign: it was read as OFF"),
            ),
        };
        let shares = all
            .iter()
            .take(8)
            .map(|(value, count)| format!("{value}: {count}"))
            .collect::<Vec<_>>()
            .join(", ");
        let more = if all.len() > 8 { format!(", and {} more values", all.len() - 8) } else { String::new() };
        let otherwise =
            "state `polarity`, \"signs\", \"counts\" or \"one_two\", where it is otherwise".into();
        Some(Convention { id, what, evidence: format!("events by value: {shares}{more}"), otherwise })
    }
}

fn of_pixels(size: Option<Extent>) -> String {
    size.map_or_else(String::new, |size| format!(" of {} x {} pixels", size.width, size.height))
}

/// How a file is read, decided once.
#[derive(Clone, Debug)]
pub(crate) struct Settled {
    pub(crate) about: EventsAbout,
    pub(crate) rules: Rules,
    /// Range of the counter that is followed, and the step from which it began again, ns.
    follow: Option<(i64, i64)>,
    pub(crate) conventions: Vec<Convention>,
}

impl Settled {
    /// A cursor whose stamps follow the counter, where there is one.
    pub(crate) fn followed(&self, inner: Box<dyn EventCursor>) -> Box<dyn EventCursor> {
        match self.follow {
            Some((range, step)) => Box::new(Followed { inner, range, step, turns: 0, before: None }),
            None => inner,
        }
    }
}

/// What is known of events before they are read, and how they are read: decided when it is first needed, by
/// counting what the columns hold.
pub(crate) struct Lazy {
    path: PathBuf,
    stated: Stated,
    about: EventsAbout,
    settled: OnceLock<Result<Settled, FormatError>>,
}

impl Lazy {
    /// Nothing is counted yet.
    pub(crate) fn new(path: &Path, declared: &Declared, about: EventsAbout) -> Lazy {
        Lazy { path: path.into(), stated: Stated::of(declared), about, settled: OnceLock::new() }
    }

    /// As known before anything is counted.
    pub(crate) fn before(&self) -> &EventsAbout {
        &self.about
    }

    /// Adds a note, before anything is counted.
    pub(crate) fn note(&mut self, note: Option<String>) {
        self.about.notes.extend(note);
    }

    /// The same with another size of the array, before anything is counted.
    pub(crate) fn with_extent(self, extent: Option<Extent>) -> Lazy {
        Lazy { about: EventsAbout { extent, ..self.about }, settled: OnceLock::new(), ..self }
    }

    /// How the events are read; `count` fills a tally the first time.
    ///
    /// # Errors
    /// When the file cannot be read, or something must be stated.
    pub(crate) fn settled(
        &self,
        count: impl FnOnce(&mut Tally) -> Result<(), FormatError>,
    ) -> Result<&Settled, FormatError> {
        let decide = || {
            let mut tally = Tally::new();
            count(&mut tally)?;
            tally.settle(&self.path, &self.stated, self.about.clone())
        };
        self.settled.get_or_init(decide).as_ref().map_err(Clone::clone)
    }

    /// What is known of the events, with what was recognised.
    pub(crate) fn about(&self, count: impl FnOnce(&mut Tally) -> Result<(), FormatError>) -> &EventsAbout {
        // What must be stated is reported by who reads the events.
        self.settled(count).map_or(&self.about, |settled| &settled.about)
    }
}

/// Adds the range of a counter as often as it began again.
struct Followed {
    inner: Box<dyn EventCursor>,
    range: i64,
    step: i64,
    turns: i64,
    before: Option<i64>,
}

impl EventCursor for Followed {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        let more = self.inner.next(chunk)?;
        for k in 0..chunk.t.len() {
            let stored = chunk.t[k];
            let step = stored.saturating_sub(self.before.unwrap_or(stored));
            if step <= -self.step {
                self.turns += 1;
            } else if step >= self.step && self.turns > 0 {
                // Late, from before the counter began again.
                self.turns -= 1;
            }
            self.before = Some(stored);
            chunk.t[k] = stored.saturating_add(self.turns.saturating_mul(self.range));
            if let Some(t_in) = chunk.t_in.as_mut().and_then(|all| all.get_mut(k)) {
                // It may have fired before the turn, and left after it.
                let turns =
                    if t_in.saturating_sub(stored) >= self.range / 2 { self.turns - 1 } else { self.turns };
                *t_in = t_in.saturating_add(turns.saturating_mul(self.range));
            }
        }
        Ok(more)
    }

    fn seek(&mut self, _t_ns: i64) -> Result<(), FormatError> {
        // How often the counter began again is known from the first event on.
        (self.turns, self.before) = (0, None);
        self.inner.seek(i64::MIN)
    }

    crate::recording::forward_cursor!(inner);
}
