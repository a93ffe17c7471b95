//! Draws several sequences side by side: one row per method, one column per instant.
//!
//! For each of a few instants the frame whose exposure middle is nearest is shown, and the events around it
//! when they are connected. All rows share one grey range, taken from the first row (the true frames, when
//! they are connected), so that a method which is too dark looks too dark. It is for looking only: values
//! beyond the range are clipped, and a display gamma of 2.2 brightens the shadows. What is measured stands in
//! the scores, what was rendered in `write/frames`.
//!
//! Captured frames and rendered ones are both DN on top of the black level, but a DN of a longer exposure
//! stands for less light. With the sensor description connected, every frame is shown as if it had been
//! exposed as long as the first row's: `black + (DN - black) x ratio of exposures`. Without it the black
//! level is not known; numbers are then shown as they are, and a note says so where exposures differ.
//!
//! Limits: every sequence must have the same extent. Middles are those of row 0; under a rolling shutter,
//! lower rows are later, so a captured frame leans against the truth and the events next to it. A value that
//! is not known (NaN) is drawn black; what saturated in a longer exposure looks too dark.

mod sheet;
mod shown;

use self::sheet::{GAP, Layout, Sheet, displayed, grey_range};
use self::shown::Shown;
use super::events::{Count, colour, counted};
use super::font;
use super::frames::nominal_exposure_ns;
use super::picture::Picture;
use crate::baseline::repeat::black_level;
use crate::crop::Crop;
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, EventStream, EventsMeta, Extent, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain,
    Meta, Node, NodeError, PortMetas, Rows, Sensor, Table, TimeSpan, Truth,
};
use photocurrent_solve::pixel_events::clock_offset;
use png::BitDepth;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `write/contact_sheet`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Names of the rows: one text for each connected sequence, in the same order, all different. True frames
    /// are called "truth".
    pub labels: Vec<String>,
    /// Number of instants, evenly spaced; 1 to 100. Not used when `times` is given.
    #[schemars(range(min = 1, max = 100))]
    pub columns: usize,
    /// First instant, on the recording's clock. Default: the first exposure middle that all sequences have
    /// reached.
    pub start: Option<Duration>,
    /// Last instant. Default: the last exposure middle that all sequences reach.
    pub end: Option<Duration>,
    /// The instants themselves, on the recording's clock.
    pub times: Option<Vec<Duration>>,
    /// Picture dots for each pixel, 1 to 64. Default: as many as make a row about 1600 dots wide.
    #[schemars(range(min = 1, max = 64))]
    pub scale: Option<u32>,
    /// Show only this part of each frame.
    pub crop: Option<Crop>,
    /// Events are shown from half of this before an instant to half after it. Default: the (median) exposure
    /// of the first captured frames among the rows, so that events stand next to the blur that they explain;
    /// 5 ms when there are none.
    #[schemars(extend("x-min" = "1 us", "x-max" = "1000 s"))]
    pub window: Option<Duration>,
    /// So many events of one polarity in the window give a pixel its full colour, fewer a lighter one in
    /// proportion.
    #[schemars(range(min = 1, max = 1000))]
    pub full_colour: u32,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            labels: Vec::new(),
            columns: 5,
            start: None,
            end: None,
            times: None,
            scale: None,
            crop: None,
            window: None,
            full_colour: 4,
        }
    }
}

photocurrent_core::ports! {
    /// What is drawn.
    pub struct In {
        /// Sequences to compare, one per row.
        frames: Vec<FrameSequence>,
        /// True frames of simulated data, shown as the first row.
        truth: Option<Truth>,
        /// Events, shown below the truth and the captured frames that come first: ON red, OFF blue, both
        /// dark.
        events: Option<EventStream>,
        /// Black level, to show frames of different exposures alike; clock offset of the events.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// What was drawn.
    pub struct Out {
        /// Which frame stands where (events have none): label, column, frame, t_ns (middle of its exposure),
        /// asked_ns (the instant of the column).
        listing: Arc<Table>,
    }
}

/// The node.
pub struct WriteContactSheet {
    params: Params,
}

/// The largest picture, in dots: enough for a wall, and far from what viewers refuse.
const LARGEST: u64 = 400_000_000;
const FOR_LOOKING: &str = "For looking only: one grey range for all rows (0.5 to 99.5 percent of the first \
                           row), display gamma 2.2.";
/// The window of events where neither the parameter nor a captured frame states one.
const WINDOW_NS: i64 = 5_000_000;

/// The exposure that a frame's DN stand for, ns.
fn exposure_of_dn(meta: &FramesMeta, frame: usize) -> i64 {
    match meta.scale {
        FrameScale::Captured => meta.times.exposures[frame].length_ns(),
        FrameScale::Nominal { exposure_ns } => exposure_ns,
    }
}

/// Where the row of events stands: below the true and the captured frames that come first.
fn row_of_events(sequences: &[(&str, &FrameSequence)], has_truth: bool) -> usize {
    let given = |(row, (_, frames)): &(usize, &(&str, &FrameSequence))| {
        (*row == 0 && has_truth) || frames.meta.scale == FrameScale::Captured
    };
    sequences.iter().enumerate().take_while(given).count()
}

/// The frame whose exposure middle is nearest to `t_ns`; the earlier one of two. Middles need not rise when
/// exposures differ in length.
fn nearest(times: &FrameTimes, t_ns: i64) -> usize {
    let away = |l: &usize| times.exposures[*l].mid().0.abs_diff(t_ns);
    (0..times.len()).min_by_key(away).unwrap_or(0)
}

/// First and last exposure middle.
fn middles(times: &FrameTimes) -> Option<(i64, i64)> {
    let middles = || times.exposures.iter().map(|exposure| exposure.mid().0);
    Some((middles().min()?, middles().max()?))
}

impl WriteContactSheet {
    fn crop(&self, extent: Extent) -> Crop {
        self.params.crop.unwrap_or(Crop::whole(extent))
    }

    /// The instants of the columns.
    fn instants(&self, sequences: &[&FramesMeta]) -> Vec<i64> {
        if let Some(times) = &self.params.times {
            return times.iter().map(|time| time.ns()).collect();
        }
        let spans: Vec<(i64, i64)> = sequences.iter().filter_map(|meta| middles(&meta.times)).collect();
        let common = spans
            .iter()
            .copied()
            .reduce(|a, b| (a.0.max(b.0), a.1.min(b.1)))
            .filter(|(first, last)| first <= last);
        // Sequences without common time: the first row says what to look at.
        let (first, last) = common.or(spans.first().copied()).unwrap_or((0, 0));
        let first = self.params.start.map_or(first, Duration::ns);
        let last = self.params.end.map_or(last, Duration::ns).max(first);
        match self.params.columns {
            1 => vec![first + (last - first) / 2],
            n => (0..n)
                .map(|k| first + ((last - first) as f64 * k as f64 / (n - 1) as f64).round() as i64)
                .collect(),
        }
    }

    /// When events are shown: around each instant.
    fn windows(&self, instants: &[i64], sequences: &[&FramesMeta]) -> Vec<TimeSpan> {
        let captured = sequences.iter().find(|meta| meta.scale == FrameScale::Captured);
        let length = self
            .params
            .window
            .map(Duration::ns)
            .or(captured.and_then(|meta| meta.times.nominal_exposure_ns()))
            .unwrap_or(WINDOW_NS);
        instants.iter().map(|t| TimeSpan::new(t - length / 2, t - length / 2 + length)).collect()
    }

    /// Refuses what cannot be drawn.
    fn check(&self, sequences: &[(&str, &FramesMeta)], events: Option<&EventsMeta>) -> Result<(), NodeError> {
        let Some((first_label, first)) = sequences.first() else {
            return Err(NodeError::usage("no frames are connected to write/contact_sheet"));
        };
        for (label, meta) in sequences {
            if meta.extent != first.extent {
                return Err(NodeError::usage(format!(
                    "\"{label}\" has {} pixels, and \"{first_label}\" has {}",
                    meta.extent, first.extent
                ))
                .hint("a contact sheet compares frames of one extent; draw one sheet for each"));
            }
            if meta.times.is_empty() {
                return Err(NodeError::usage(format!("\"{label}\" has no frame to show"))
                    .hint("look at the time window of the node that makes it"));
            }
        }
        if let Some(events) = events.filter(|events| first.extent.multiple_of(events.extent).is_none()) {
            return Err(NodeError::usage(format!(
                "the events have {} pixels, and \"{first_label}\" has {}",
                events.extent, first.extent
            ))
            .hint("connect events and frames of one sensor, or leave `events` out"));
        }
        let crop = self.crop(first.extent);
        crop.check("crop", "frames", first.extent)?;
        let columns = self.params.times.as_ref().map_or(self.params.columns, Vec::len);
        let layout =
            Layout::new(crop, self.params.scale, columns, sequences.len() + usize::from(events.is_some()), 0);
        if layout.width() * layout.height() > LARGEST {
            return Err(NodeError::usage(format!(
                "the contact sheet would have {} x {} dots",
                layout.width(),
                layout.height()
            ))
            .hint("take fewer `columns`, a smaller `scale` or a `crop`")
            .param(if self.params.scale.is_some() { "scale" } else { "columns" }));
        }
        Ok(())
    }

    /// Draws the row of events: a picture for each instant.
    fn draw_events(
        &self,
        sheet: &mut Sheet,
        layout: &Layout,
        events_row: usize,
        counts: &[Vec<Count>],
        window_ns: i64,
        cx: &Context,
    ) -> Result<(), NodeError> {
        for (column, counts) in counts.iter().enumerate() {
            if column == 0 {
                let ms = window_ns as f64 / 1e6;
                sheet.begin_row(
                    layout,
                    events_row,
                    &format!(
                        "events within {ms:.3} ms: ON red, OFF blue, full colour from {}",
                        self.params.full_colour
                    ),
                );
            }
            sheet.picture(
                layout,
                (column, events_row),
                counts.iter().map(|&count| colour(count, self.params.full_colour)),
            );
            cx.advance(1)?;
        }
        Ok(())
    }
}

impl Node for WriteContactSheet {
    const DECL: Decl = Decl {
        kind: "write/contact_sheet",
        about: "Draws several sequences side by side, one row per method and one column per instant, for \
                looking.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["8-bit PNG with display gamma 2.2, for looking only"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.split]
kind   = "split/frames"
in     = { frames = "recording.frames" }

[nodes.sheet]
kind   = "write/contact_sheet"
in     = { frames = ["split.kept", "split.held"], events = "recording.events", sensor = "recording.sensor" }
params = { labels = ["kept", "held out"], columns = 4, window = "5 ms" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if !(1..=100).contains(&params.columns) {
            return Err(NodeError::usage(format!("`columns` is {}, and must be 1 to 100", params.columns))
                .param("columns"));
        }
        if let Some(scale) = params.scale.filter(|scale| !(1..=64).contains(scale)) {
            return Err(NodeError::usage(format!("`scale` is {scale}, and must be 1 to 64")).param("scale"));
        }
        if !(1..=1000).contains(&params.full_colour) {
            return Err(NodeError::usage(format!(
                "`full_colour` is {}, and must be 1 to 1000",
                params.full_colour
            ))
            .param("full_colour"));
        }
        if let Some(window) = params.window.filter(|window| window.ns() < 1000) {
            return Err(
                NodeError::usage(format!("`window` is {window}, and must be 1 us or longer")).param("window")
            );
        }
        if params.times.as_ref().is_some_and(|times| !(1..=100).contains(&times.len())) {
            return Err(NodeError::usage("`times` must list 1 to 100 instants")
                .hint("leave it out to get evenly spaced ones")
                .param("times"));
        }
        if params.times.is_some() && (params.start.is_some() || params.end.is_some()) {
            return Err(NodeError::usage(
                "`times` states every instant, so `start` and `end` have no meaning",
            )
            .hint("leave one or the other out")
            .param("times"));
        }
        if let (Some(start), Some(end)) = (params.start, params.end)
            && end < start
        {
            return Err(NodeError::usage(format!("the window ends at {end}, before it begins at {start}"))
                .hint("make `end` later than `start`")
                .param("end"));
        }
        Ok(WriteContactSheet { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.all("frames");
        super::check_labels(&self.params.labels, frames.len(), "frames")?;
        let truth = inputs
            .all("truth")
            .iter()
            .filter_map(|meta| if let Meta::Truth(meta) = meta { Some(("truth", &**meta)) } else { None });
        let frames = frames.iter().zip(&self.params.labels).filter_map(|(meta, label)| {
            if let Meta::Frames(meta) = meta { Some((label.as_str(), &**meta)) } else { None }
        });
        let events = inputs
            .all("events")
            .iter()
            .find_map(|meta| if let Meta::Events(meta) = meta { Some(&**meta) } else { None });
        self.check(&truth.chain(frames).collect::<Vec<_>>(), events)?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let folder = cx.export_dir()?;
        super::check_labels(&self.params.labels, input.frames.len(), "frames")?;
        let truth = input.truth.iter().map(|truth| ("truth", &truth.0));
        let sequences: Vec<(&str, &FrameSequence)> =
            truth.chain(self.params.labels.iter().map(String::as_str).zip(&input.frames)).collect();
        let metas: Vec<&FramesMeta> = sequences.iter().map(|(_, frames)| &*frames.meta).collect();
        self.check(
            &sequences.iter().map(|(label, frames)| (*label, &*frames.meta)).collect::<Vec<_>>(),
            input.events.as_ref().map(|events| &*events.meta),
        )?;

        let instants = self.instants(&metas);
        let captions: Vec<String> = instants.iter().map(|&t| format!("{:.3} ms", t as f64 / 1e6)).collect();
        let widest = captions.iter().map(|caption| font::width(caption)).max().unwrap_or(0);
        let crop = self.crop(metas[0].extent);
        let drawn_rows = sequences.len() + usize::from(input.events.is_some());
        let layout = Layout::new(crop, self.params.scale, instants.len(), drawn_rows, widest);

        cx.begin((drawn_rows * instants.len()) as u64, "pictures");
        let black = input.sensor.as_deref().map(|sensor| black_level(Some(sensor)));
        let rows = shown_rows(&sequences, &instants, black, crop, cx)?;
        let windows = self.windows(&instants, &metas);
        let shift_ns =
            input.sensor.as_deref().map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns);
        let ratio = |events: &EventStream| metas[0].extent.multiple_of(events.meta.extent).unwrap_or(1);
        let counts = input
            .events
            .as_ref()
            .map(|events| counted(events, ratio(events), &windows, shift_ns, crop))
            .transpose()?;
        let events_row =
            if counts.is_some() { row_of_events(&sequences, input.truth.is_some()) } else { usize::MAX };

        let colourful = counts.is_some() || metas.iter().any(|meta| meta.channels() == 3);
        let channels = if colourful { 3 } else { 1 };
        let (width, height) = (layout.width() as u32, layout.height() as u32);
        let mut sheet =
            Sheet { width, channels, bytes: vec![255; width as usize * height as usize * channels as usize] };
        let range = grey_range(&rows[0]);
        for (column, caption) in captions.iter().enumerate() {
            sheet.text(layout.x(column), GAP, layout.dot, layout.cell_width, caption);
        }
        for (r, ((label, frames), row)) in sequences.iter().zip(&rows).enumerate() {
            let r = r + usize::from(r >= events_row);
            sheet.begin_row(&layout, r, label);
            for (column, shown) in row.iter().enumerate() {
                let grey_or_colour =
                    shown.dn.chunks(frames.meta.channels() as usize).map(|dn| displayed(range, dn));
                sheet.picture(&layout, (column, r), grey_or_colour);
            }
        }
        if let Some(counts) = &counts {
            self.draw_events(&mut sheet, &layout, events_row, counts, windows[0].length_ns(), cx)?;
        }
        let comment = Some(FOR_LOOKING);
        Picture { width, height, channels, depth: BitDepth::Eight, bytes: &sheet.bytes, comment }
            .save(&folder.join("contact_sheet.png"))?;

        let unknown = rows.iter().flatten().flat_map(|shown| &shown.dn).filter(|dn| dn.is_nan()).count();
        cx.count(unknown as u64, "values are not known (NaN) and were drawn black");
        cx.note(format!(
            "contact_sheet.png is for looking only: {:.2} to {:.2} DN, display gamma 2.2",
            range.0, range.1
        ));
        if let Some(note) = black.is_none().then(|| differing_exposures(&sequences)).flatten() {
            cx.note(note);
        }
        Ok(Out { listing: Arc::new(listing(&sequences, &rows, &instants)) })
    }
}

/// The pictures nearest to every instant, a row for each sequence, exposed like the first where the black
/// level is known.
fn shown_rows(
    sequences: &[(&str, &FrameSequence)],
    instants: &[i64],
    black: Option<f64>,
    crop: Crop,
    cx: &Context,
) -> Result<Vec<Vec<Shown>>, NodeError> {
    let to_ns = nominal_exposure_ns(&sequences[0].1.meta);
    let picture = |frames: &FrameSequence, t: i64| {
        let mut shown = read_cropped(frames, nearest(&frames.meta.times, t), crop)?;
        if let (Some(black), Some(to_ns)) = (black, to_ns) {
            shown.exposed(exposure_of_dn(&frames.meta, shown.frame), to_ns, black);
        }
        cx.advance(1)?;
        Ok(shown)
    };
    sequences.iter().map(|(_, frames)| instants.iter().map(|&t| picture(frames, t)).collect()).collect()
}

/// Which sequence has digital numbers of another exposure than the first; none where all are alike.
fn differing_exposures(sequences: &[(&str, &FrameSequence)]) -> Option<String> {
    let exposure = |(_, frames): &(&str, &FrameSequence)| nominal_exposure_ns(&frames.meta);
    let other = sequences.iter().find(|one| exposure(one) != exposure(&sequences[0]))?;
    let (first, label) = (sequences[0].0, other.0);
    Some(format!(
        "brightness differs by exposure: \"{first}\" has DN of {} ns, \"{label}\" of {} ns; connect \
         `sensor` to show them alike",
        exposure(&sequences[0]).unwrap_or(0),
        exposure(other).unwrap_or(0)
    ))
}

/// What is drawn where: a line for each picture.
fn listing(sequences: &[(&str, &FrameSequence)], rows: &[Vec<Shown>], instants: &[i64]) -> Table {
    let cells = || {
        rows.iter()
            .enumerate()
            .flat_map(|(r, row)| row.iter().enumerate().map(move |(column, shown)| (r, column, shown)))
    };
    Table::default()
        .with("label", Column::Texts(cells().map(|(r, ..)| sequences[r].0.to_string()).collect()))
        .with("column", Column::Integers(cells().map(|(_, column, _)| column as i64).collect()))
        .with("frame", Column::Integers(cells().map(|(.., shown)| shown.frame as i64).collect()))
        .with("t_ns", Column::Integers(cells().map(|(.., shown)| shown.t_ns).collect()))
        .with("asked_ns", Column::Integers(cells().map(|(_, column, _)| instants[column]).collect()))
}

fn read_cropped(frames: &FrameSequence, frame: usize, crop: Crop) -> Result<Shown, NodeError> {
    let rows = Rows { start: crop.y, end: crop.y + crop.height };
    let block = frames.read(frame..frame + 1, rows)?;
    let channels = frames.meta.channels() as usize;
    let columns = crop.x as usize * channels..(crop.x + crop.width) as usize * channels;
    let dn = rows.iter().flat_map(|row| block.row(frame, row)[columns.clone()].iter().copied()).collect();
    Ok(Shown { frame, t_ns: frames.meta.times.exposures[frame].mid().0, dn })
}

#[cfg(test)]
mod tests;
