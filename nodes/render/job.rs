//! Rows of frames from tracks: integrals over exposures become digital numbers.

use super::reading::Readout;
use crate::held::{Exposures, HeldMeans, Knots, TILE, develop};
use crate::sampling::scale_seconds;
use photocurrent_core::handle::Band;
use photocurrent_core::series::to_bfloat16;
use photocurrent_core::{Between, Colour, Exposure, Extent, FramesMeta, NodeError, Sensor, TrackBand};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::exposure::{DigitalNumber, LogLinearTrack, ManyExposures};
use photocurrent_sensor::integrate::ExposedRow;
use photocurrent_solve::co_located::{channel_gains, gain_of};

/// Tracks of some rows, to be rendered.
pub(super) struct Job<'a> {
    pub(super) band: &'a TrackBand,
    /// The frames.
    pub(super) meta: &'a FramesMeta,
    pub(super) dn: DigitalNumbers,
    /// How tracks are read.
    pub(super) between: Between,
    /// The value and the row of the sensor that frames begin with.
    pub(super) first: (u32, u32),
}

impl Job<'_> {
    /// The value and the row of the sensor that a row of the frames begins with.
    pub(super) fn begins(&self, row: u32) -> (u32, u32) {
        (self.first.0, self.first.1 + row)
    }

    /// Exposures of a row of the frames.
    pub(super) fn exposures(&self, row: u32) -> Vec<Exposure> {
        (0..self.meta.times.len()).map(|frame| self.meta.times.exposure(frame, row)).collect()
    }

    /// The seconds for which each mean counts.
    pub(super) fn seconds(&self, exposures: &[Exposure]) -> Vec<f64> {
        exposures.iter().map(|exposure| scale_seconds(self.meta.scale, *exposure)).collect()
    }

    /// A row of the frames, as places of its pixels in the tracks and their exposures.
    pub(super) fn exposed(&self, row: u32) -> ExposedRow {
        let (left, of_sensor) = self.begins(row);
        let rows = self.band.rows();
        let series = (self.band.offsets().len() - 1) / rows.len();
        let begin = (of_sensor - rows.start) as usize * series + left as usize;
        ExposedRow { pixels: begin..begin + self.meta.row_values(), exposures: self.exposures(row) }
    }

    /// From charge to DN of each value of a row.
    pub(super) fn numbers(&self, row: u32) -> Vec<DigitalNumber> {
        self.dn.row(self.begins(row), self.meta.row_values())
    }

    /// One row of all frames, exposed so.
    pub(super) fn light(&self, row: u32, exposures: Vec<Exposure>, frames: &mut [&mut [f32]]) {
        let (exposures, first) = (Exposures::new(exposures), self.begins(row));
        let seconds = self.seconds(exposures.all());
        match self.between {
            Between::Hold => render_held(self.band, first, &exposures, &seconds, self.dn, frames),
            Between::LogLinear => render_log_linear(self.band, first, &exposures, &seconds, self.dn, frames),
        }
    }

    /// One row of the standard deviations of all frames.
    pub(super) fn sigma(&self, row: u32, frames: &mut [&mut [f32]]) {
        let exposures = self.exposures(row);
        let seconds = self.seconds(&exposures);
        render_sigma(self.band, self.begins(row), &exposures, &seconds, self.dn, frames);
    }

    /// One row of all frames as they are read where effects act on them.
    pub(super) fn read(&self, readout: &Readout, extent: Extent, row: u32, frames: &mut [&mut [f32]]) {
        let first = self.begins(row);
        let exposed: Vec<Exposure> = (0..)
            .zip(self.exposures(row))
            .map(|(frame, exposure)| readout.exposure((first.1, extent.height), frame, exposure))
            .collect();
        let before: Vec<Exposure> =
            exposed.iter().map(|exposure| exposure.delayed(-exposure.length_ns())).collect();
        let mut previous: Vec<Vec<f32>> = frames.iter().map(|values| vec![0.0; values.len()]).collect();
        self.light(row, exposed, frames);
        self.light(row, before, &mut previous.iter_mut().map(Vec::as_mut_slice).collect::<Vec<_>>());
        let channels = self.dn.colour.channels();
        for (frame, (values, before)) in frames.iter_mut().zip(&previous).enumerate() {
            for (x, (value, before)) in values.iter_mut().zip(before).enumerate() {
                let at = first.0 + x as u32;
                let Extent { width, height } = extent;
                let site = Site { x: at / channels, y: first.1, width, height, seed: 0 };
                let number = self.dn.at(at, first.1);
                *value = readout.read(number, &site, frame, f64::from(*value), f64::from(*before)) as f32;
            }
        }
    }
}

/// One row of the standard deviations of all frames, rounded to 16 bits.
fn render_sigma(
    band: &TrackBand,
    (left, row): (u32, u32),
    exposures: &[Exposure],
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut spread: Vec<f32> = Vec::new();
    let mut many = ManyExposures::default();
    for x in 0..width {
        let track = band.pixel(left + x as u32, row);
        let gain = dn.at(left + x as u32, row).gain;
        spread.clear();
        spread.extend(
            track.photocurrent.iter().zip(track.sigma).map(|(photocurrent, sigma)| photocurrent * sigma),
        );
        if spread.is_empty() {
            out.iter_mut().for_each(|values| values[x] = f32::NAN);
            continue;
        }
        let integrals = many.of(&LogLinearTrack::new(track.t, &spread), exposures);
        for (((values, exposure), seconds), integral) in
            out.iter_mut().zip(exposures).zip(seconds).zip(integrals)
        {
            let sigma = gain * integral / exposure.seconds() * seconds;
            values[x] = to_bfloat16(sigma as f32);
        }
    }
}

/// One row of all frames, from held tracks; `first` is the value and the row of the sensor that it begins
/// with.
fn render_held(
    band: &TrackBand,
    first: (u32, u32),
    exposures: &Exposures,
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut means = HeldMeans::default();
    for left in (0..width).step_by(TILE) {
        let tile = left..width.min(left + TILE);
        let mut gain = [0.0; TILE];
        gain.iter_mut()
            .zip(tile.clone())
            .for_each(|(gain, x)| *gain = dn.at(first.0 + x as u32, first.1).gain);
        for frames in Exposures::pieces(0..exposures.len()) {
            let knots = tile.clone().map(|x| {
                let track = band.pixel(first.0 + x as u32, first.1);
                Knots { t: track.t, value: track.photocurrent }
            });
            let means = means.of(exposures, frames.clone(), knots);
            develop(means, &seconds[frames.clone()], dn.black_level, &gain, &mut out[frames], left);
        }
    }
}

/// Pixels whose log-linear tracks are integrated before they go to the frames together.
const COLUMNS: usize = 16;

/// The same from tracks whose logarithm is linear between knots.
fn render_log_linear(
    band: &TrackBand,
    first: (u32, u32),
    exposures: &Exposures,
    seconds: &[f64],
    dn: DigitalNumbers,
    out: &mut [&mut [f32]],
) {
    let width = out.first().map_or(0, |values| values.len());
    let mut tile = vec![[f32::NAN; COLUMNS]; exposures.len()];
    let mut many = ManyExposures::default();
    for left in (0..width).step_by(COLUMNS) {
        let used = COLUMNS.min(width - left);
        for n in 0..used {
            let value = first.0 + (left + n) as u32;
            let track = band.pixel(value, first.1);
            let dn = dn.at(value, first.1);
            if track.t.is_empty() {
                tile.iter_mut().for_each(|values| values[n] = f32::NAN);
                continue;
            }
            let integrals = many.of(&LogLinearTrack::new(track.t, track.photocurrent), exposures.all());
            for (((values, exposure), seconds), integral) in
                tile.iter_mut().zip(exposures.all()).zip(seconds).zip(integrals)
            {
                values[n] = dn.of(integral / exposure.seconds() * seconds) as f32;
            }
        }
        for (values, out) in tile.iter().zip(out.iter_mut()) {
            out[left..left + used].copy_from_slice(&values[..used]);
        }
    }
}

/// From charge to DN for every value of a row.
#[derive(Clone, Copy)]
pub(super) struct DigitalNumbers {
    colour: Colour,
    black_level: f64,
    gain: f64,
    channels: [f64; 3],
}

impl DigitalNumbers {
    pub(super) fn new(sensor: &Sensor, colour: Colour) -> Result<DigitalNumbers, NodeError> {
        let gain = sensor.need(sensor.frames.gain, "frames.gain", "render/rows")?;
        Ok(DigitalNumbers {
            colour,
            black_level: sensor.frames.black_level_dn.unwrap_or(0.0),
            gain,
            channels: channel_gains(sensor)?,
        })
    }

    /// Of so many values of a row of the sensor, from the first on.
    pub(super) fn row(&self, (first, row): (u32, u32), values: usize) -> Vec<DigitalNumber> {
        (0..values as u32).map(|x| self.at(first + x, row)).collect()
    }

    fn at(&self, value: u32, row: u32) -> DigitalNumber {
        DigitalNumber {
            black_level: self.black_level,
            gain: gain_of(self.gain, &self.channels, self.colour, value, row),
        }
    }
}
