//! Events of a recording: by time in the file, by row band in memory, checked on the way.

use super::checked::{check_column, column, group_integer, has_group, required};
use crate::error::{Mistakes, StoreError};
use crate::hdf::Opened;
use crate::hdf::grid::Grid;
use crate::threads;
use photocurrent_core::{EventBand, EventsMeta, Extent, Rows, TimeSpan};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Events that are read at a time: about 20 MB.
const BLOCK: usize = 1 << 20;

/// The event stream of a recording.
pub(super) struct Events {
    pub meta: Arc<EventsMeta>,
    pub count: usize,
    x: Grid<u16>,
    y: Grid<u16>,
    p: Grid<u8>,
    t: Grid<i64>,
    t_in: Option<Grid<i64>>,
    /// Set when a whole scan found nothing wrong. Not a lock: two first readers may both check, and come to
    /// the same result.
    checked: AtomicBool,
}

/// One block of columns.
struct Block {
    x: Vec<u16>,
    p: Vec<u8>,
    t: Vec<i64>,
    t_in: Option<Vec<i64>>,
}

impl Events {
    pub(super) fn open(opened: &Opened, extent: Extent) -> Result<Option<Events>, StoreError> {
        if !has_group(opened, "events") {
            return Ok(None);
        }
        let mut mistakes = Mistakes::default();
        let t: Option<Grid<i64>> = mistakes.take(required(opened, "events/t", Some("ns")));
        // Without stamps there is still something to say of the other columns: they have one length.
        let count = t.as_ref().and_then(|t| t.shape.first().copied());
        if let Some(t) = &t {
            mistakes.take(check_column(opened, "events/t", t, count.unwrap_or(0), "a column"));
        }
        let (count, like) = match count {
            Some(count) => (count, "/events/t"),
            None => (
                mistakes
                    .take(required::<u16>(opened, "events/x", None))
                    .and_then(|x| x.shape.first().copied())
                    .unwrap_or(0),
                "/events/x",
            ),
        };
        let x = mistakes.take(column(opened, "events/x", count, like, None));
        let y = mistakes.take(column(opened, "events/y", count, like, None));
        let p = mistakes.take(column(opened, "events/p", count, like, None));
        let has_t_in = mistakes.take(opened.dataset("events/t_in")).flatten().is_some();
        let t_in = if has_t_in {
            mistakes.take(column(opened, "events/t_in", count, like, Some("ns")))
        } else {
            None
        };
        let resolution = mistakes.take(resolution(opened)).flatten();
        let span = match &t {
            Some(t) if mistakes.is_empty() && count > 0 => {
                let (first, last) = (t.column(0..1)?[0], t.column(count - 1..count)?[0]);
                Some(TimeSpan::new(first, last.saturating_add(1)))
            }
            _ => None,
        };
        mistakes.finish(&opened.path)?;
        let (Some(t), Some(x), Some(y), Some(p)) = (t, x, y, p) else { return Ok(None) };
        let meta = EventsMeta {
            extent,
            span,
            has_t_in,
            has_step: false,
            t_resolution_ns: resolution,
            count_hint: Some(count as u64),
        };
        Ok(Some(Events { meta: Arc::new(meta), count, x, y, p, t_in, t, checked: AtomicBool::new(false) }))
    }

    /// The events of some rows; the first call checks all events of the file.
    pub(super) fn read(&self, opened: &Opened, rows: Rows) -> Result<EventBand, StoreError> {
        let mut checks = (!self.checked.load(Ordering::Acquire)).then(Checks::default);
        let mut kept = Kept::new(rows, self.t_in.is_some());
        for start in (0..self.count).step_by(BLOCK) {
            let range = start..self.count.min(start + BLOCK);
            let y = self.y.column(range.clone())?;
            let wanted: Vec<usize> =
                (0..y.len()).filter(|&i| (rows.start..rows.end).contains(&y[i].into())).collect();
            if wanted.is_empty() && checks.is_none() {
                continue;
            }
            let block = self.block(range)?;
            if let Some(checks) = &mut checks {
                checks.add(start, &y, &block, self.meta.extent);
            }
            kept.add(&wanted, &y, &block);
        }
        if let Some(checks) = checks {
            checks.verdict(opened, self.meta.extent)?;
            self.checked.store(true, Ordering::Release);
        }
        kept.into_band().map_err(|error| {
            opened.content("/events", error.message, "events in time order", "sort the events by /events/t")
        })
    }

    fn block(&self, range: Range<usize>) -> Result<Block, StoreError> {
        let ((x, p), (t, t_in)) = threads::both(
            || (self.x.column(range.clone()), self.p.column(range.clone())),
            || {
                (
                    self.t.column(range.clone()),
                    self.t_in.as_ref().map(|column| column.column(range.clone())).transpose(),
                )
            },
        );
        Ok(Block { x: x?, p: p?, t: t?, t_in: t_in? })
    }
}

/// The step of the stamps, when it is stated.
fn resolution(opened: &Opened) -> Result<Option<i64>, StoreError> {
    let resolution = group_integer(opened, "events", "t_resolution_ns")?;
    if let Some(step) = resolution.filter(|&step| step < 0) {
        let hint = "give the step of the recorded stamps, or leave the attribute out";
        return Err(opened.content(
            "/events: attribute `t_resolution_ns`",
            step.to_string(),
            "a number of nanoseconds",
            hint,
        ));
    }
    Ok(resolution)
}

/// A kind of mistake: where it comes first, how often, and an example.
#[derive(Default)]
struct Fault {
    count: u64,
    first: Option<(usize, String)>,
}

impl Fault {
    fn add(&mut self, index: usize, example: impl FnOnce() -> String) {
        self.count += 1;
        if self.first.is_none() {
            self.first = Some((index, example()));
        }
    }
}

/// What is wrong with the events, found in file order whatever rows are read.
#[derive(Default)]
struct Checks {
    last_t: Option<i64>,
    outside: Fault,
    polarity: Fault,
    order: Fault,
    in_pixel: Fault,
}

impl Checks {
    fn add(&mut self, start: usize, y: &[u16], block: &Block, extent: Extent) {
        for i in 0..y.len() {
            let (x, t) = (block.x[i], block.t[i]);
            if u32::from(x) >= extent.width || u32::from(y[i]) >= extent.height {
                self.outside.add(start + i, || format!("x = {x}, y = {}", y[i]));
            }
            if block.p[i] > 1 {
                self.polarity.add(start + i, || format!("p = {}", block.p[i]));
            }
            if let Some(last) = self.last_t
                && last > t
            {
                self.order.add(start + i, || format!("{t} ns after {last} ns"));
            }
            self.last_t = Some(t);
            if let Some(t_in) = &block.t_in
                && t_in[i] > t
            {
                self.in_pixel.add(start + i, || format!("t_in = {} ns, t = {t} ns", t_in[i]));
            }
        }
    }

    fn verdict(self, opened: &Opened, extent: Extent) -> Result<(), StoreError> {
        let faults = [
            (
                "/events/x, /events/y",
                "outside the sensor",
                self.outside,
                format!("x below {} and y below {}", extent.width, extent.height),
                WRONG_SIZE,
            ),
            (
                "/events/p",
                "with another polarity",
                self.polarity,
                "1 for ON, 0 for OFF".into(),
                "write OFF as 0, not as -1 or 255",
            ),
            (
                "/events/t",
                "earlier than the event ahead",
                self.order,
                "times that do not decrease".into(),
                "sort the events by t, keeping ties in order",
            ),
            (
                "/events/t_in",
                "with its in-pixel time after its off-pixel time",
                self.in_pixel,
                "t_in <= t".into(),
                "were the two columns swapped?",
            ),
        ];
        let mut mistakes = Mistakes::default();
        for (at, what, fault, expected, hint) in faults {
            if let Some((index, example)) = fault.first {
                let events = if fault.count == 1 { "event" } else { "events" };
                let found =
                    format!("{} {events} {what}, the first at index {index} ({example})", fault.count);
                mistakes.take::<()>(Err(opened.content(at, found, expected, hint)));
            }
        }
        mistakes.finish(&opened.path)
    }
}

const WRONG_SIZE: &str = "check the attributes `width` and `height`, and that x is the column and y the row";

/// Events of the rows asked for, in file order.
struct Kept {
    rows: Rows,
    y: Vec<u16>,
    x: Vec<u16>,
    p: Vec<u8>,
    t: Vec<i64>,
    t_in: Option<Vec<i64>>,
}

impl Kept {
    fn new(rows: Rows, has_t_in: bool) -> Kept {
        Kept {
            rows,
            y: Vec::new(),
            x: Vec::new(),
            p: Vec::new(),
            t: Vec::new(),
            t_in: has_t_in.then(Vec::new),
        }
    }

    fn add(&mut self, wanted: &[usize], y: &[u16], block: &Block) {
        self.y.extend(wanted.iter().map(|&i| y[i]));
        self.x.extend(wanted.iter().map(|&i| block.x[i]));
        self.p.extend(wanted.iter().map(|&i| block.p[i]));
        self.t.extend(wanted.iter().map(|&i| block.t[i]));
        if let (Some(kept), Some(t_in)) = (&mut self.t_in, &block.t_in) {
            kept.extend(wanted.iter().map(|&i| t_in[i]));
        }
    }

    fn into_band(self) -> Result<EventBand, photocurrent_core::DataError> {
        // The band could repair a disorder in time; here it is a mistake of the file, which `Checks` reports
        // before.
        EventBand::from_file_order(self.rows, &self.y, &self.x, &self.p, &self.t, self.t_in.as_deref())
    }
}
