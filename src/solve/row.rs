//! What the pixels of a row measured, as the MAP estimate needs it: events in order of time, frame values
//! with their noise.

use crate::co_located::{CoLocated, CoLocatedEvents};
use crate::model::Model;
use crate::plausible::Plausible;
use crate::shares::{Colours, RowShares};
use photocurrent_core::{Exposure, FrameBlock, FrameTimes, NodeError, Rows, TracksMeta};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::map::{MapFrame, MapOptions, Noise, PixelEvent};
use photocurrent_sensor::undo::Known;

/// An event is lone when none of its polarity fired this long before or after, in its pixel or in one of the
/// eight around it, ns.
const LONE_NS: i64 = 3_000_000;

/// How the pixels of a row are solved.
#[derive(Clone, Copy, Debug)]
pub struct RowSetting {
    /// First and last instant, ns.
    pub span: (i64, i64),
    /// How noisy its events are.
    pub noise: Noise,
    /// Prior, knots, steps.
    pub options: MapOptions,
    /// Standard deviation of frame values that the description does not explain, DN.
    pub frame_dn: f64,
    /// Standard deviations of light are widened by this factor.
    pub sigma_factor: f64,
}

/// What is known of the events of every value of some rows.
pub struct KnownOfRows {
    pub(crate) first: u32,
    pub(crate) of_rows: Vec<Vec<Known>>,
}

impl KnownOfRows {
    /// Of a row.
    pub fn of(&self, row: u32) -> &[Known] {
        &self.of_rows[(row - self.first) as usize]
    }
}

/// The rows of a recording that are at hand.
#[derive(Clone, Copy)]
pub struct Recorded<'a> {
    /// As wide as a row has values; a pixel is a value here.
    pub meta: &'a TracksMeta,
    /// Exposures.
    pub times: &'a FrameTimes,
    /// How frames lie on events.
    pub colours: &'a Colours,
    /// The rows whose events are at hand.
    pub rows: Rows,
    /// Events of these rows.
    pub events: &'a CoLocatedEvents,
    /// Frame values of these rows and the rest of their blocks.
    pub frames: &'a FrameBlock,
}

/// The measurements of a row, pixel by pixel: frame values, and the events of the event pixels that see it.
/// Kept from row to row for its memory.
#[derive(Default)]
pub struct RowData {
    events: Events,
    above: Events,
    below: Events,
    frames: Vec<MapFrame>,
    /// Those of one value.
    of_value: Vec<MapFrame>,
    first_frame: Vec<usize>,
    /// Light of a frame's value over that of its event pixel, in which its problem is posed.
    light_ratio: Vec<f64>,
    /// How bright its light may get.
    plausible: Vec<Plausible>,
    /// How much that changes, all in all: natural-log units squared.
    unrest: Vec<f64>,
    places: Places,
    /// Those of the row of events that see this one, and the column there of value x: x plus this.
    event_places: Places,
    event_column: i64,
}

/// Where the values of a row are.
#[derive(Clone, Copy, Default)]
struct Places {
    row: u32,
    values: u32,
    height: u32,
    channels: u32,
    ratio: u32,
}

impl Places {
    fn new(recorded: &Recorded<'_>, row: u32) -> Places {
        let CoLocated { ratio, colour } = recorded.colours.lie;
        let extent = recorded.meta.extent;
        Places { row, values: extent.width, height: extent.height, channels: colour.channels(), ratio }
    }

    /// Values on an event pixel, side by side.
    fn copies(&self) -> u32 {
        self.ratio * self.channels
    }

    /// The pixel of value x.
    fn pixel(&self, x: usize) -> Site {
        Site {
            x: x as u32 / self.channels,
            y: self.row,
            width: self.values / self.channels,
            height: self.height,
            seed: 0,
        }
    }

    /// The event pixel of value x.
    fn event(&self, x: usize) -> Site {
        let Site { x, y, width, height, seed } = self.pixel(x);
        Site {
            x: x / self.ratio,
            y: y / self.ratio,
            width: width / self.ratio,
            height: height / self.ratio,
            seed,
        }
    }
}

impl RowData {
    /// Takes in a row. `frame_dn` is added in squares to the standard deviation of every frame value.
    ///
    /// # Errors
    /// When the events do not fit each other, a broken invariant of their source.
    pub fn take(
        &mut self,
        model: &Model,
        recorded: &Recorded<'_>,
        row: u32,
        frame_dn: f64,
    ) -> Result<(), NodeError> {
        let rows = recorded.rows;
        let width = recorded.meta.extent.width;
        self.places = Places::new(recorded, row);
        // Where effects shift what the events see, those of another row belong to this one.
        let (right, down) =
            model.undo.mixing().map_or((0, 0), |mixing| (mixing.columns_right(), mixing.rows_down()));
        let event_row = i64::from(row) + i64::from(down) * i64::from(self.places.ratio);
        self.event_column = i64::from(right) * i64::from(self.places.copies());
        self.event_places = Places { row: u32::try_from(event_row).unwrap_or(u32::MAX), ..self.places };
        for (events, row) in [
            (&mut self.events, event_row),
            (&mut self.above, event_row - 1),
            (&mut self.below, event_row + 1),
        ] {
            match u32::try_from(row).ok().filter(|row| rows.start <= *row && *row < rows.end) {
                Some(row) => events.take(model, recorded.events, &Places { row, ..self.places })?,
                None => events.clear(),
            }
        }
        self.mark_lone(width as usize);
        let exposures: Vec<Exposure> =
            (0..recorded.times.len()).map(|l| recorded.times.exposure(l, row)).collect();
        let shares = recorded.colours.row(model, recorded.frames, row);
        self.take_frames(model, recorded.frames, row, &exposures, &shares, frame_dn);
        Ok(())
    }

    /// Light of value x over that of its event pixel.
    pub fn light_ratio(&self, x: usize) -> f64 {
        self.light_ratio[x]
    }

    /// How bright value x may get.
    pub(crate) fn plausible(&self, x: usize) -> Plausible {
        self.plausible[x]
    }

    /// How far an event of pixel x may be off because its colour changes, natural-log units squared: what
    /// colours change between frames is spread over the events.
    pub fn unrest(&self, x: usize) -> f64 {
        self.unrest[x] / usize::max(self.events_of(x).len(), 1) as f64
    }

    /// Number of pixels.
    pub fn width(&self) -> usize {
        self.light_ratio.len()
    }

    /// Which column of the events sees pixel x; none where it would lie beyond the array.
    fn event_column(&self, x: usize) -> Option<usize> {
        let column = usize::try_from(x as i64 + self.event_column).ok()?;
        (column + 1 < self.events.first.len()).then_some(column)
    }

    /// Does an event pixel see pixel x? Else the absence of events is no constraint.
    pub fn has_event_pixel(&self, x: usize) -> bool {
        self.event_column(x).is_some()
    }

    /// The events of pixel x, in order of in-pixel time.
    pub fn events_of(&self, x: usize) -> &[PixelEvent] {
        self.event_column(x).map_or(&[], |column| self.events.of(column))
    }

    /// Which of the events of pixel x are lone.
    pub fn is_lone(&self, x: usize) -> &[bool] {
        self.event_column(x).map_or(&[], |column| &self.events.is_lone[self.events.range(column)])
    }

    /// The events of pixel x that have company.
    pub fn in_company(&self, x: usize) -> impl Iterator<Item = &PixelEvent> {
        let events = self.events_of(x).iter().zip(self.is_lone(x));
        events.filter(|(_, is_lone)| !**is_lone).map(|(event, _)| event)
    }

    /// Where the event pixel of value x is, and its events as recorded, in the order of
    /// [`RowData::events_of`].
    pub fn recorded_of(&self, x: usize) -> (Site, &[PixelEvent]) {
        let Some(column) = self.event_column(x) else { return (self.places.event(x), &[]) };
        let range = self.events.range(column);
        let recorded = self.events.recorded.get(range.clone()).unwrap_or(&self.events.all[range]);
        (self.event_places.event(column), recorded)
    }

    /// Value and row of what lies in the event pixel of that column and row where value x lies in its own.
    pub fn same_place(&self, x: usize, (column, row): (u32, u32)) -> (usize, u32) {
        let (copies, ratio) = (self.places.copies(), self.places.ratio);
        (column as usize * copies as usize + x % copies as usize, row * ratio + self.places.row % ratio)
    }

    /// The frame values of pixel x.
    pub fn frames_of(&self, x: usize) -> &[MapFrame] {
        &self.frames[self.first_frame[x]..self.first_frame[x + 1]]
    }

    fn mark_lone(&mut self, width: usize) {
        let columns = if self.events.first.is_empty() { 0 } else { width };
        for x in 0..columns {
            for k in self.events.first[x]..self.events.first[x + 1] {
                let event = self.events.all[k];
                let columns = x.saturating_sub(1)..usize::min(x + 2, width);
                let has_company = columns.into_iter().any(|neighbour| {
                    // An event is no company to itself.
                    self.events.count(neighbour, &event) > usize::from(neighbour == x)
                        || self.above.count(neighbour, &event) > 0
                        || self.below.count(neighbour, &event) > 0
                });
                self.events.is_lone.push(!has_company);
            }
        }
    }

    fn take_frames(
        &mut self,
        model: &Model,
        frames: &FrameBlock,
        row: u32,
        exposures: &[Exposure],
        shares: &RowShares,
        frame_dn: f64,
    ) {
        self.frames.clear();
        self.light_ratio.clear();
        self.plausible.clear();
        self.unrest.clear();
        self.first_frame.clear();
        for x in 0..frames.row_values {
            self.first_frame.push(self.frames.len());
            let share = shares.of(x, 0..exposures.len());
            self.light_ratio.push(share.ratio);
            let of_frames = exposures
                .iter()
                .enumerate()
                .map(|(l, exposure)| (f64::from(frames.row(l, row)[x]), exposure.length_ns() as f64 * 1e-9));
            self.plausible.push(Plausible::new(model, share, of_frames));
            self.unrest.push(shares.unrest(x, |above| {
                let relative = model.frame_sigma_dn(above, frame_dn) / above;
                relative * relative
            }));
            let black_level = model.sensor.number.black_level;
            let of = |(l, exposure): (usize, &Exposure)| {
                let dn = f64::from(frames.row(l, row)[x]);
                let sigma_dn = share.sigma(model.frame_sigma_dn(dn - black_level, frame_dn));
                let saturated = dn >= model.sensor.saturation_dn;
                dn.is_finite().then_some(MapFrame {
                    start_ns: exposure.start.0,
                    end_ns: exposure.end.0,
                    dn,
                    sigma_dn,
                    saturated,
                })
            };
            self.of_value.clear();
            self.of_value.extend(exposures.iter().enumerate().filter_map(of));
            model.undo.frames(&model.sensor, &self.places.pixel(x), &mut self.of_value);
            self.frames.extend(self.of_value.iter().map(|frame| {
                let mut frame = MapFrame { dn: share.dn(frame.dn, black_level), ..*frame };
                model.undo.raise(&model.sensor, &mut frame);
                frame
            }));
        }
        self.first_frame.push(self.frames.len());
    }
}

/// The events of a row, pixel by pixel.
#[derive(Default)]
struct Events {
    all: Vec<PixelEvent>,
    /// The same with stamps as recorded; empty where no effect is undone.
    recorded: Vec<PixelEvent>,
    /// Which are lone; only of the row itself.
    is_lone: Vec<bool>,
    first: Vec<usize>,
}

impl Events {
    fn clear(&mut self) {
        self.all.clear();
        self.is_lone.clear();
        self.recorded.clear();
        self.first.clear();
    }

    fn take(&mut self, model: &Model, events: &CoLocatedEvents, places: &Places) -> Result<(), NodeError> {
        self.clear();
        events.with_row(places.row, |events| {
            let index = events.by_pixel(places.values);
            for x in 0..places.values as usize {
                let begin = self.all.len();
                self.first.push(begin);
                self.all.extend(index.pixel(x).iter().map(|&k| model.event(&events, k)));
                self.all[begin..].sort_by_key(|event| event.t_in_ns);
                if !model.undo.is_none() {
                    let site = places.event(x);
                    let mut pairs: Vec<(PixelEvent, PixelEvent)> = self.all[begin..]
                        .iter()
                        .map(|event| (model.undo.event(&site, event), *event))
                        .collect();
                    pairs.sort_by_key(|(event, _)| event.t_in_ns);
                    for (slot, (event, recorded)) in self.all[begin..].iter_mut().zip(pairs) {
                        *slot = event;
                        self.recorded.push(recorded);
                    }
                }
            }
            self.first.push(self.all.len());
        })
    }

    fn range(&self, x: usize) -> std::ops::Range<usize> {
        self.first[x]..self.first[x + 1]
    }

    fn of(&self, x: usize) -> &[PixelEvent] {
        if self.first.is_empty() { &[] } else { &self.all[self.range(x)] }
    }

    /// Events of pixel x around `event`, of its polarity.
    fn count(&self, x: usize, event: &PixelEvent) -> usize {
        let events = self.of(x);
        let from = events.partition_point(|other| other.t_in_ns < event.t_in_ns - LONE_NS);
        events[from..]
            .iter()
            .take_while(|other| other.t_in_ns <= event.t_in_ns + LONE_NS)
            .filter(|other| other.polarity == event.polarity)
            .count()
    }
}
