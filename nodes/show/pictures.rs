//! Frames as pictures of 8 bits that can be compared by eye: one black, one white, one exposure for all
//! sequences of a scene.
//!
//! A DN of a longer exposure stands for less light. Every frame is shown as if it had been exposed as long as
//! the first sequence's: `black + (DN - black) x ratio of exposures`. For looking, never for scores; what is
//! not known (NaN) is black.

use crate::write::display::{Curve, Look};
use crate::write::picture::Picture;
use photocurrent_core::{
    Colour, DataType, Exposure, Extent, FrameScale, FrameSequence, NodeError, Sensor, Truth, Value,
};
use png::BitDepth;

/// Frames that can be shown.
#[derive(Clone)]
pub struct Shown {
    frames: FrameSequence,
    is_truth: bool,
}

/// How DN become codes, for all sequences of a scene.
pub struct Tone {
    /// DN of black.
    pub black: f64,
    /// DN of white.
    pub white: f64,
    exposure_ns: i64,
    curve: Curve,
}

impl Tone {
    /// After the first sequence of a scene; black level and saturation are the sensor's, where they are
    /// stated.
    ///
    /// # Errors
    /// When frames cannot be read.
    pub fn of(first: &Shown, sensor: Option<&Sensor>) -> Result<Tone, NodeError> {
        let look = Look::of(&first.frames, sensor, None)?;
        Ok(Tone {
            black: look.black,
            white: look.white,
            exposure_ns: first.exposure_ns(),
            curve: look.curve(),
        })
    }

    /// A DN of an exposure (ns) as if it had lasted as long as those of the pictures.
    pub fn shown_dn(&self, dn: f64, exposure_ns: i64) -> f64 {
        self.black + (dn - self.black) * self.exposure_ns as f64 / exposure_ns as f64
    }
}

impl Shown {
    /// Frames or true frames; `None` for another value.
    pub fn of(value: Value) -> Option<Shown> {
        let is_truth = value.data_type() == DataType::Truth;
        match value {
            Value::Frames(frames) | Value::Truth(Truth(frames)) if !frames.is_empty() => {
                Some(Shown { frames, is_truth })
            }
            _ => None,
        }
    }

    /// Is it what a simulated scene really was?
    pub fn is_truth(&self) -> bool {
        self.is_truth
    }

    /// Was it captured, by a camera or a simulated one, and not rendered?
    pub fn is_captured(&self) -> bool {
        !self.is_truth && self.frames.meta.scale == FrameScale::Captured
    }

    /// Size in pixels.
    pub fn extent(&self) -> Extent {
        self.frames.meta.extent
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// No frame at all?
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Exposure of each frame's row 0.
    pub fn exposures(&self) -> &[Exposure] {
        &self.frames.meta.times.exposures
    }

    /// Delay from one row's exposure to the next, ns.
    pub fn row_time_ns(&self) -> i64 {
        self.frames.meta.times.row_time_ns
    }

    /// Middle of the exposure of each frame's row 0, ns.
    pub fn middles_ns(&self) -> Vec<i64> {
        self.exposures().iter().map(|exposure| exposure.mid().0).collect()
    }

    /// The exposure that its DN stand for, ns: of captured frames the median one.
    pub fn exposure_ns(&self) -> i64 {
        match self.frames.meta.scale {
            FrameScale::Nominal { exposure_ns } => exposure_ns,
            FrameScale::Captured => self.frames.meta.times.nominal_exposure_ns().unwrap_or(1),
        }
    }

    pub(super) fn frames(&self) -> &FrameSequence {
        &self.frames
    }

    /// One frame as a PNG file, grey or RGB; of every `shrink` x `shrink` pixels the mean.
    ///
    /// # Errors
    /// When the frame cannot be read.
    pub fn png(&self, frame: usize, tone: &Tone, shrink: u32) -> Result<Vec<u8>, NodeError> {
        let meta = &self.frames.meta;
        let block = self.frames.read(frame..frame + 1, meta.extent.rows())?;
        let own_ns = match meta.scale {
            FrameScale::Captured => meta.times.exposures[frame].length_ns(),
            FrameScale::Nominal { exposure_ns } => exposure_ns,
        };
        let channels = if meta.colour == Colour::Rgb { 3 } else { 1 };
        let (width, height) = (meta.extent.width / shrink, meta.extent.height / shrink);
        let mut codes = Vec::with_capacity((width * height) as usize * channels);
        for y in 0..height {
            for x in 0..width {
                for channel in 0..channels {
                    let all = (0..shrink).flat_map(|row| {
                        let values = block.row(frame, y * shrink + row);
                        (0..shrink).map(move |column| {
                            f64::from(values[(x * shrink + column) as usize * channels + channel])
                        })
                    });
                    let mean = all.sum::<f64>() / f64::from(shrink * shrink);
                    codes.push(tone.curve.of(tone.shown_dn(mean, own_ns) as f32));
                }
            }
        }
        let picture = Picture {
            width,
            height,
            channels: channels as u32,
            depth: BitDepth::Eight,
            bytes: &codes,
            comment: None,
        };
        let mut file = Vec::new();
        picture
            .encode_small(&mut file)
            .map_err(|error| NodeError::failed(format!("a picture cannot be encoded: {error}")))?;
        Ok(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::testing;

    fn codes(png: &[u8]) -> (u32, u32, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        (reader.info().width, reader.info().height, bytes)
    }

    #[test]
    fn a_longer_exposure_of_the_same_light_looks_the_same() {
        let extent = Extent { width: 4, height: 2 };
        // Black is 10 DN; 40 DN of light in 1 ms are 120 DN in 3 ms.
        let short =
            testing::captured(extent, vec![Exposure::new(0, 1_000_000)], 0, |_, x, _| 10.0 + 10.0 * x as f32);
        let long =
            testing::captured(extent, vec![Exposure::new(0, 3_000_000)], 0, |_, x, _| 10.0 + 30.0 * x as f32);
        let mut sensor = Sensor::unknown("test");
        sensor.frames.black_level_dn = Some(10.0);
        let [short, long] = [short, long].map(|frames| Shown::of(Value::Frames(frames)).unwrap());
        let tone = Tone::of(&short, Some(&sensor)).unwrap();
        assert_eq!((tone.black, tone.white, tone.shown_dn(100.0, 3_000_000)), (10.0, 40.0, 40.0));
        let found = codes(&short.png(0, &tone, 1).unwrap());
        assert_eq!((found.0, found.1, found.2[0], found.2[3]), (4, 2, 0, 255));
        assert_eq!(codes(&long.png(0, &tone, 1).unwrap()), found);
        // 2 x 2 pixels are one: means of 0 and 10, 20 and 30 DN above black, of 30: sRGB codes of 1/6 and
        // 5/6.
        assert_eq!(codes(&short.png(0, &tone, 2).unwrap()).2, [113, 235]);
        assert!(
            short.is_captured()
                && !short.is_truth()
                && Shown::of(Value::Sensor(std::sync::Arc::new(sensor))).is_none()
        );
    }
}
