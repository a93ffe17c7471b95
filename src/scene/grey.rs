//! Grey frames for the event path: one value for each event pixel.
//!
//! Frames may have three values per pixel, or several pixels along the side of each event pixel. A photodiode
//! without a filter receives the light of all of them. So their values are averaged by its sensitivity to
//! each colour (`optics.event_weights`, equal where nothing is stated), over the channels' gains. Behind a
//! mosaic of filters at the events' own pixels, events have the colour of their pixel as well, so each value
//! stays as it is; neighbours then measure other light ([`GreyFrames::is_behind_filters`]).
//!
//! Limit: a mean with a saturated value is unknown, or is that of the clipped values ([`SaturatedMean`]).

use photocurrent_core::{
    Colour, DataError, Exposure, Extent, FrameBlock, FrameSequence, FrameTimes, FramesMeta, Sensor, Timestamp,
};
use photocurrent_sensor::pooling::block_weights;
use std::sync::Arc;

/// Treatment of a mean with a saturated value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaturatedMean {
    /// Not known: for whoever measures.
    Unknown,
    /// The mean of the values as they are, saturated where all are: for whoever renders.
    Mean,
}

/// How frames become one grey value for each event pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct GreyFrames {
    extent: Extent,
    /// Frame pixels along the side of an event pixel.
    pub ratio: u32,
    /// Colours of the frames.
    pub colour: Colour,
    /// Weights of an event pixel's values, for each column and row of event pixels within a cell of the
    /// mosaic.
    weights: Vec<Vec<f64>>,
    gains: [f64; 3],
    black: f64,
    full: f64,
}

impl GreyFrames {
    /// Of frames next to events of `extent` pixels.
    ///
    /// # Errors
    /// When the frames' extent is no whole multiple of the events', or weights or gains are not positive.
    pub fn new(extent: Extent, frames: &FramesMeta, sensor: &Sensor) -> Result<GreyFrames, DataError> {
        let ratio = frames.extent.multiple_of(extent).ok_or_else(|| {
            let (found, times) = (frames.extent, "or a whole number of times as many");
            DataError::new(format!(
                "frames have {found} pixels, {}; needed are frames of {extent} pixels, as the events \
                 have, {times}",
                frames.colour.name()
            ))
        })?;
        let gains = sensor.frames.channel_gain.unwrap_or([1.0; 3]);
        let seen = sensor.optics.event_weights;
        if !gains.iter().all(|gain| *gain > 0.0 && gain.is_finite()) {
            return Err(DataError::new(format!(
                "`frames.channel_gain` is {gains:?}, and must be three positive numbers: red, green, blue"
            )));
        }
        let is_mixture = |weights: [f64; 3]| {
            weights.iter().all(|weight| *weight >= 0.0 && weight.is_finite())
                && weights.iter().sum::<f64>() > 0.0
        };
        if let Some(weights) = seen.filter(|weights| !is_mixture(*weights)) {
            return Err(DataError::new(format!(
                "`optics.event_weights` is {weights:?}, and must be three numbers, not negative and not all 0"
            )));
        }
        let (black, full) = (
            sensor.frames.black_level_dn.unwrap_or(0.0),
            sensor.frames.saturation_dn.unwrap_or(f64::INFINITY),
        );
        let cell = frames.colour.cell();
        let weights = (0..cell * cell)
            .map(|at| block_weights(frames.colour, ratio, (at % cell, at / cell), seen))
            .collect();
        Ok(GreyFrames { extent, ratio, colour: frames.colour, weights, gains, black, full })
    }

    /// Do the frames already have one grey value per event pixel?
    pub fn is_plain(&self) -> bool {
        self.ratio == 1 && self.colour == Colour::Mono
    }

    /// Does each event pixel lie behind one filter of several?
    pub fn is_behind_filters(&self) -> bool {
        self.colour.is_mosaic() && !self.ratio.is_multiple_of(self.colour.cell())
    }

    /// Exposures of the events' rows: the middle of those of the frame rows that lie on each.
    pub fn times(&self, times: &FrameTimes) -> FrameTimes {
        if self.ratio == 1 {
            return times.clone();
        }
        let later_ns = i64::from(self.ratio - 1) * times.row_time_ns / 2;
        let moved = |exposure: &Exposure| Exposure {
            start: Timestamp(exposure.start.0 + later_ns),
            end: Timestamp(exposure.end.0 + later_ns),
        };
        let exposures: Vec<Exposure> = times.exposures.iter().map(moved).collect();
        FrameTimes { exposures: exposures.into(), row_time_ns: i64::from(self.ratio) * times.row_time_ns }
    }

    /// Values of the frames on each event pixel.
    pub fn values(&self) -> usize {
        (self.ratio * self.ratio * self.colour.channels()) as usize
    }

    /// Position of value `n` of event pixel (x, y): its index in its row, and the row.
    pub fn value_place(&self, n: usize, (x, y): (u32, u32)) -> (u32, u32) {
        let side = self.ratio * self.colour.channels();
        (x * side + n as u32 % side, y * self.ratio + n as u32 / side)
    }

    /// Gain of the channel of a value.
    pub fn gain(&self, value: u32, row: u32) -> f64 {
        self.colour.channel(value, row).map_or(1.0, |channel| self.gains[channel])
    }

    /// Weights of the values of event pixel (x, y): positive or zero, sum 1 ([`block_weights`]).
    pub fn weights(&self, (x, y): (u32, u32)) -> &[f64] {
        let cell = self.colour.cell();
        &self.weights[(y % cell * cell + x % cell) as usize]
    }

    /// Light of a value of the frames, DN above black over the gain of its channel.
    pub fn light(&self, dn: f64, value: u32, row: u32) -> f64 {
        (dn - self.black) / self.gain(value, row)
    }

    /// Light of a mixture, DN above black.
    pub fn above(&self, dn: f64) -> f64 {
        dn - self.black
    }

    /// DN of light, given in DN above black of a channel with gain 1.
    pub fn dn(&self, light: f64, value: u32, row: u32) -> f64 {
        self.black + light * self.gain(value, row)
    }

    /// The grey values as [frame][y][x], DN; NaN = not known.
    ///
    /// # Errors
    /// When the frames cannot be read.
    pub fn read(&self, frames: &FrameSequence, clipped: SaturatedMean) -> Result<Vec<f32>, DataError> {
        let rows = frames.meta.extent.rows();
        if self.is_plain() {
            return Ok(frames.read_rows(rows)?.dn);
        }
        let mut all = Vec::with_capacity(frames.len() * self.extent.pixels());
        for l in 0..frames.len() {
            // One frame at a time: in colour they are larger than what is made of them.
            let block = frames.read(l..l + 1, rows)?;
            let values = block.frame(l);
            (0..self.extent.height).for_each(|y| {
                let of = |x: u32| self.pixel_mean(values, block.row_values, (x, y), clipped);
                all.extend((0..self.extent.width).map(of))
            });
        }
        Ok(all)
    }

    /// Metadata of the grey frames.
    pub fn meta(&self, frames: &FramesMeta) -> FramesMeta {
        let times = self.times(&frames.times);
        FramesMeta { extent: self.extent, colour: Colour::Mono, times, scale: frames.scale }
    }

    /// The grey frames, in memory.
    ///
    /// # Errors
    /// When the frames cannot be read.
    pub fn frames(&self, frames: &FrameSequence, clipped: SaturatedMean) -> Result<FrameSequence, DataError> {
        let (meta, rows) = (self.meta(&frames.meta), self.extent.rows());
        let (row_values, dn) = (meta.row_values(), self.read(frames, clipped)?);
        let block = FrameBlock { frames: 0..frames.len(), rows, row_values, dn };
        Ok(FrameSequence::in_memory(Arc::new(meta), block))
    }

    fn pixel_mean(
        &self,
        values: &[f32],
        row_values: usize,
        place: (u32, u32),
        clipped: SaturatedMean,
    ) -> f32 {
        let mut sum = 0.0;
        for (n, of) in self.weights(place).iter().enumerate() {
            let (value, row) = self.value_place(n, place);
            let dn = f64::from(values[row as usize * row_values + value as usize]);
            sum += match clipped {
                _ if self.values() == 1 && dn >= self.full => dn,
                SaturatedMean::Unknown if dn >= self.full => f64::NAN,
                _ => of * (self.black + self.light(dn, value, row)),
            };
        }
        sum as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::testing;

    const EXTENT: Extent = Extent { width: 2, height: 1 };

    /// One frame of given values next to events of 2 x 1 pixels.
    fn frames(ratio: u32, colour: &str, values: &[f32]) -> FrameSequence {
        let colour = Colour::named(colour).unwrap();
        let extent = Extent { width: 2 * ratio, height: ratio };
        let meta = FramesMeta { extent, colour, ..(*testing::frames(2, 1, 1).meta).clone() };
        let mut block = FrameBlock::zeros(0..1, extent.rows(), meta.row_values());
        block.dn.copy_from_slice(values);
        FrameSequence::in_memory(Arc::new(meta), block)
    }

    fn grey(frames: &FrameSequence, sensor: &Sensor) -> Vec<f32> {
        GreyFrames::new(EXTENT, &frames.meta, sensor).unwrap().read(frames, SaturatedMean::Unknown).unwrap()
    }

    #[test]
    fn colours_are_averaged_by_what_an_event_pixel_receives() {
        let mut sensor = Sensor::unknown("");
        let rgb = frames(1, "rgb", &[30.0, 60.0, 90.0, 3.0, 6.0, 0.0]);
        assert_eq!(grey(&rgb, &sensor), [60.0, 3.0]);
        sensor.optics.event_weights = Some([0.0, 1.0, 0.0]);
        assert_eq!(grey(&rgb, &sensor), [60.0, 6.0]);
        // A gain of two above a black of 10: 10 + (90 - 10) / 2 in blue.
        (sensor.frames.channel_gain, sensor.frames.black_level_dn) = (Some([1.0, 1.0, 2.0]), Some(10.0));
        sensor.optics.event_weights = Some([0.0, 0.0, 1.0]);
        assert_eq!(grey(&rgb, &sensor)[0], 50.0);
        sensor.frames.saturation_dn = Some(80.0);
        assert!(grey(&rgb, &sensor)[0].is_nan());
        let clipped =
            GreyFrames::new(EXTENT, &rgb.meta, &sensor).unwrap().read(&rgb, SaturatedMean::Mean).unwrap();
        assert_eq!(clipped[0], 50.0, "blue is clipped, and counts as it is");
    }

    #[test]
    fn pixels_on_one_event_pixel_are_averaged_and_a_mosaic_at_its_pixels_stays() {
        let sensor = Sensor::unknown("");
        let finer = frames(2, "mono", &[1.0, 2.0, 10.0, 20.0, 3.0, 4.0, 30.0, 40.0]);
        assert_eq!(grey(&finer, &sensor), [2.5, 25.0]);
        let of = |frames: &FrameSequence| GreyFrames::new(EXTENT, &frames.meta, &sensor).unwrap();
        let mut seen = sensor.clone();
        seen.optics.event_weights = Some([0.0, 1.0, 0.0]);
        let bayer = frames(2, "bayer_rggb", &[1.0, 2.0, 10.0, 20.0, 3.0, 4.0, 30.0, 40.0]);
        assert_eq!(grey(&bayer, &seen), [2.5, 25.0], "two greens share what green counts");
        let (mosaic, cells) = (frames(1, "bayer_rggb", &[5.0, 7.0]), frames(2, "bayer_rggb", &[1.0; 8]));
        assert_eq!(grey(&mosaic, &sensor), [5.0, 7.0]);
        assert!(
            of(&mosaic).is_behind_filters()
                && !of(&cells).is_behind_filters()
                && !of(&finer).is_behind_filters()
        );
        assert!(of(&frames(1, "mono", &[1.0, 2.0])).is_plain() && !of(&mosaic).is_plain());
        let other = FramesMeta { extent: Extent { width: 3, height: 1 }, ..(*finer.meta).clone() };
        assert!(
            GreyFrames::new(EXTENT, &other, &sensor).unwrap_err().message.contains("whole number of times")
        );
    }

    #[test]
    fn a_row_of_events_is_exposed_as_the_middle_of_its_frame_rows() {
        let frames = frames(2, "mono", &[0.0; 8]);
        let times = FrameTimes { row_time_ns: 10, ..frames.meta.times.clone() };
        let own = GreyFrames::new(EXTENT, &frames.meta, &Sensor::unknown("")).unwrap().times(&times);
        let middle = (times.exposure(0, 2).start.0 + times.exposure(0, 3).start.0) / 2;
        assert_eq!((own.exposure(0, 1).start.0, own.row_time_ns), (middle, 20));
    }
}
