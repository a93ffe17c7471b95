//! Events next to frames of more pixels or more colours: which events belong to which value of a frame.
//!
//! Frames may have a whole number of pixels along the side of each event pixel, and three values or a mosaic
//! of filters instead of grey. Every value of a frame is a problem of its own, with the events of the event
//! pixel that it lies on: so [`CoLocatedEvents`] gives the events of a row of frames as if every one of its
//! values had fired them, at the column where the value stands in the row. Who works on values that way need
//! not know of either.

use photocurrent_core::events::EventRow;
use photocurrent_core::{
    Colour, EventBand, EventStream, EventsMeta, Extent, FramesMeta, NodeError, Rows, Sensor,
};

/// How the pixels of frames lie on those of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoLocated {
    /// Frame pixels along the side of an event pixel.
    pub ratio: u32,
    /// The frames' colours.
    pub colour: Colour,
}

/// Columns of events are 16 bits wide.
const MOST_VALUES: usize = 1 << 16;

impl CoLocated {
    /// Of events and frames.
    ///
    /// # Errors
    /// When the frames' extent is no whole multiple of the events', or a row has more values than columns can
    /// count.
    pub fn new(events: &EventsMeta, frames: &FramesMeta) -> Result<CoLocated, NodeError> {
        let ratio = frames.extent.multiple_of(events.extent).ok_or_else(|| {
            NodeError::usage(format!("events are {}, frames are {}", events.extent, frames.extent)).hint(
                "frames and events must come from the same pixels: frames have the events' extent or \
                       a whole multiple of it",
            )
        })?;
        if frames.row_values() > MOST_VALUES {
            return Err(NodeError::usage(format!(
                "a row of the frames has {} values, and {MOST_VALUES} are the most",
                frames.row_values()
            )));
        }
        Ok(CoLocated { ratio, colour: frames.colour })
    }

    /// One grey value for each event pixel?
    pub fn is_plain(&self) -> bool {
        self.ratio == 1 && self.colour == Colour::Mono
    }

    /// Refuses anything else, for who works on grey frames of the events' pixels.
    ///
    /// # Errors
    /// When a frame has colours or more pixels than the events; `who` is the asker.
    pub fn need_plain(&self, who: &str) -> Result<(), NodeError> {
        if self.is_plain() {
            return Ok(());
        }
        Err(NodeError::usage(format!(
            "{who} works on grey frames of the events' pixels, and these are {}",
            self.describe()
        ))
        .hint(
            "solve/map, solve/paper, baseline/edi, baseline/cf and baseline/repeat take colour and \
                   more pixels",
        ))
    }

    fn describe(&self) -> String {
        let pixels = if self.ratio == 1 {
            String::new()
        } else {
            format!(" with {0} x {0} pixels on each event pixel", self.ratio)
        };
        format!("{}{pixels}", self.colour)
    }

    /// Rows of the events that rows of the frames lie on.
    pub fn event_rows(&self, frames: Rows) -> Rows {
        Rows { start: frames.start / self.ratio, end: frames.end.div_ceil(self.ratio) }
    }

    /// The events of some rows of the frames.
    ///
    /// # Errors
    /// When the events cannot be read.
    pub fn read(&self, events: &EventStream, rows: Rows) -> Result<CoLocatedEvents, NodeError> {
        Ok(CoLocatedEvents { lie: *self, band: events.read(self.event_rows(rows))? })
    }
}

/// Events of some rows of frames, kept once for each event pixel.
pub struct CoLocatedEvents {
    lie: CoLocated,
    band: EventBand,
}

impl CoLocatedEvents {
    /// What `work` makes of the events of row `y` of the frames: `x` counts the values of the row
    /// (`x * channels + channel`), and every event stands at each value it belongs to. The copies live as
    /// long as the call.
    ///
    /// # Errors
    /// When the events do not fit each other, a broken invariant of their source.
    pub fn with_row<T>(&self, y: u32, work: impl FnOnce(EventRow) -> T) -> Result<T, NodeError> {
        let CoLocated { ratio, colour } = self.lie;
        let row = self.band.row(y / ratio);
        if self.lie.is_plain() {
            return Ok(work(row));
        }
        let copies = ratio * colour.channels();
        let all = row.len() * copies as usize;
        let (mut x, mut on, mut t) =
            (Vec::with_capacity(all), Vec::with_capacity(all), Vec::with_capacity(all));
        let (mut t_in, mut step) =
            (row.t_in.map(|_| Vec::with_capacity(all)), row.step.map(|_| Vec::with_capacity(all)));
        for k in 0..row.len() {
            for copy in 0..copies {
                // Below the limit that was checked.
                x.push((u32::from(row.x[k]) * copies + copy) as u16);
                on.push(row.on[k]);
                t.push(row.t[k]);
            }
            fill(&mut t_in, row.t_in, k, copies);
            fill(&mut step, row.step, k, copies);
        }
        let spread = EventBand::from_columns(y, vec![0, all], x, on, t, t_in, step)?;
        Ok(work(spread.row(y)))
    }
}

fn fill<T: Copy>(column: &mut Option<Vec<T>>, row: Option<&[T]>, k: usize, copies: u32) {
    if let (Some(column), Some(row)) = (column, row) {
        column.extend((0..copies).map(|_| row[k]));
    }
}

/// Gain of each channel over that of the description: `frames.channel_gain`, 1 when it is not stated.
///
/// # Errors
/// When one is not positive.
pub fn channel_gains(sensor: &Sensor) -> Result<[f64; 3], NodeError> {
    let gains = sensor.frames.channel_gain.unwrap_or([1.0; 3]);
    if gains.iter().all(|gain| *gain > 0.0 && gain.is_finite()) {
        return Ok(gains);
    }
    Err(NodeError::usage(format!(
        "`frames.channel_gain` of \"{}\" is {gains:?}, and must be three positive numbers: red, green, blue",
        sensor.name
    )))
}

/// How strongly an event pixel sees red, green and blue: `optics.event_weights`; `None` when it is not
/// stated.
///
/// # Errors
/// When one is negative, or all are zero.
pub fn event_weights(sensor: &Sensor) -> Result<Option<[f64; 3]>, NodeError> {
    let Some(weights) = sensor.optics.event_weights else { return Ok(None) };
    if weights.iter().all(|weight| *weight >= 0.0 && weight.is_finite()) && weights.iter().sum::<f64>() > 0.0
    {
        return Ok(Some(weights));
    }
    Err(NodeError::usage(format!(
        "`optics.event_weights` of \"{}\" is {weights:?}, and must be three \
                                  numbers, not negative and not all 0",
        sensor.name
    )))
}

/// The gain of a value of row `y`, given the description's gain and those of the channels.
pub fn gain_of(gain: f64, channels: &[f64; 3], colour: Colour, value: u32, y: u32) -> f64 {
    colour.channel(value, y).map_or(gain, |channel| gain * channels[channel])
}

/// A picture of one channel with a pixel for each value: `width * channels` wide.
pub fn values_of(extent: Extent, colour: Colour) -> Extent {
    Extent { width: extent.width * colour.channels(), ..extent }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{FrameSequence, testing};
    use std::sync::Arc;

    fn frames(width: u32, height: u32, colour: Colour) -> FrameSequence {
        let wide = testing::frames(width * colour.channels(), height, 1);
        let meta = FramesMeta { extent: Extent { width, height }, colour, ..(*wide.meta).clone() };
        FrameSequence::in_memory(Arc::new(meta), wide.read_rows(wide.rows()).unwrap())
    }

    /// By the definition: value v of row y belongs to event pixel (v / channels / ratio, y / ratio).
    #[test]
    fn every_value_has_the_events_of_its_event_pixel() {
        let events = testing::events(4, 3);
        let own = events.read(events.rows()).unwrap();
        for (ratio, colour) in
            [(1, Colour::Rgb), (2, Colour::Mono), (3, Colour::Rgb), (2, Colour::named("bayer_rggb").unwrap())]
        {
            let frames = frames(4 * ratio, 3 * ratio, colour);
            let lie = CoLocated::new(&events.meta, &frames.meta).unwrap();
            for rows in [frames.rows(), Rows { start: 1, end: 2 }] {
                let band = lie.read(&events, rows).unwrap();
                for y in rows.iter() {
                    let (values, expected) = (4 * ratio * colour.channels(), own.row(y / ratio));
                    let pixels = expected.by_pixel(4);
                    type Found = Vec<Vec<(i64, u8, i64)>>;
                    let of_values = |row: EventRow| -> Found {
                        let index = row.by_pixel(values);
                        let of = |value| {
                            index
                                .pixel(value)
                                .iter()
                                .map(|&k| (row.t[k], row.on[k], row.t_in.unwrap()[k]))
                                .collect()
                        };
                        (0..values as usize).map(of).collect()
                    };
                    let found = band.with_row(y, of_values).unwrap();
                    for (value, found) in found.into_iter().enumerate() {
                        let pixel = pixels.pixel(value / colour.channels() as usize / ratio as usize);
                        assert_eq!(
                            found,
                            pixel
                                .iter()
                                .map(|&k| (expected.t[k], expected.on[k], expected.t_in.unwrap()[k]))
                                .collect::<Vec<_>>()
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn grey_frames_of_the_events_pixels_have_the_events_as_they_are() {
        let (events, frames) = (testing::events(4, 3), testing::frames(4, 3, 1));
        let lie = CoLocated::new(&events.meta, &frames.meta).unwrap();
        assert!(lie.is_plain());
        let (band, expected) =
            (lie.read(&events, events.rows()).unwrap(), events.read(events.rows()).unwrap());
        band.with_row(1, |row| {
            assert_eq!(
                (row.first, row.t, row.x),
                (expected.row(1).first, expected.row(1).t, expected.row(1).x)
            )
        })
        .unwrap();
        let other = CoLocated::new(&events.meta, &testing::frames(8, 9, 1).meta).unwrap_err();
        assert_eq!(other.message, "events are 4 x 3, frames are 8 x 9");
    }

    #[test]
    fn gains_and_weights_that_make_no_sense_are_refused() {
        let mut sensor = Sensor::unknown("odd");
        assert_eq!((channel_gains(&sensor).unwrap(), event_weights(&sensor).unwrap()), ([1.0; 3], None));
        sensor.frames.channel_gain = Some([1.0, 0.0, 1.0]);
        sensor.optics.event_weights = Some([0.0; 3]);
        assert!(channel_gains(&sensor).unwrap_err().message.contains("three positive numbers"));
        assert!(event_weights(&sensor).unwrap_err().message.contains("not all 0"));
    }
}
