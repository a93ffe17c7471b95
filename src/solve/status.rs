//! How the solution of each pixel went, as planes of a map.

use crate::plausible;
use photocurrent_core::handle::Band;
use photocurrent_core::{Extent, MapBand, MapMeta, TracksMeta};
use photocurrent_sensor::residuals::Misfit;

/// How a pixel came out, worst window counting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Status {
    Converged = 0,
    FellBack = 1,
    Saturated = 2,
    NoFrame = 3,
}

/// Planes of the map of a solution.
pub const PLANES: [&str; 6] =
    ["status", "iterations", "cost", "event_residual", "frame_residual", "implausible"];

/// Where `event_residual` stands among them.
pub const EVENT_RESIDUAL: usize = 3;
/// Where `implausible` stands among them.
const IMPLAUSIBLE: usize = 5;

/// What stands in [`PLANES`] for a pixel.
///
/// Residuals are measured less predicted, over the standard deviations of the MAP estimate or times the roots
/// of the weights of Eq. (13): of all windows, frames in two of them counting twice. Events in blind times
/// and saturated values that are met carry no information for the MAP estimate and are left out; a safe
/// estimate of Eq. (13) meets its events. `excess` is [`plausible::Plausible::excess`].
pub(crate) fn planes(
    status: Status,
    iterations: usize,
    cost: f64,
    misfit: &Misfit,
    excess: f64,
) -> [f32; PLANES.len()] {
    [
        status as u8 as f32,
        iterations as f32,
        cost as f32,
        misfit.event_rms() as f32,
        misfit.frame_rms() as f32,
        excess as f32,
    ]
}

/// What the map of a solution of so many pixels is.
pub fn map_meta(extent: Extent) -> MapMeta {
    MapMeta { extent, planes: PLANES.map(String::from).to_vec() }
}

/// Over the values of each pixel: the worst, the largest, the sum, and root mean squares of residuals.
pub(crate) fn of_pixels(values: MapBand, meta: &TracksMeta) -> MapBand {
    let channels = meta.colour.channels() as usize;
    if channels == 1 {
        return values;
    }
    let mut map = MapBand::zeros(values.rows(), &map_meta(meta.extent));
    for row in values.rows().iter() {
        for (plane, name) in PLANES.iter().enumerate() {
            for (out, of_pixel) in
                map.row_mut(plane, row).iter_mut().zip(values.row(plane, row).chunks_exact(channels))
            {
                *out = match *name {
                    "cost" => of_pixel.iter().sum(),
                    "event_residual" | "frame_residual" => {
                        let known = || of_pixel.iter().filter(|rms| !rms.is_nan());
                        (known().map(|rms| rms * rms).sum::<f32>() / known().count() as f32).sqrt()
                    }
                    _ => of_pixel.iter().copied().fold(0.0, f32::max),
                };
            }
        }
    }
    map
}

/// How many pixels did not come out as they should.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// That fell back to the double-integral estimate in some window.
    pub fell_back: u64,
    /// That were saturated in every frame of some window: their light is a lower bound there.
    pub saturated: u64,
    /// Without a usable frame value in some window: they hold their last known light there.
    pub no_frame: u64,
    /// Whose light was held at what is plausible.
    pub implausible: u64,
}

impl Report {
    /// Of the map of a solution.
    pub fn of(map: &MapBand) -> Report {
        let count = |plane: usize, is: &dyn Fn(f32) -> bool| {
            map.rows().iter().flat_map(|row| map.row(plane, row)).filter(|value| is(**value)).count() as u64
        };
        let with = |status: Status| count(0, &|value| value == status as u8 as f32);
        Report {
            fell_back: with(Status::FellBack),
            saturated: with(Status::Saturated),
            no_frame: with(Status::NoFrame),
            implausible: count(IMPLAUSIBLE, &|excess| excess > 0.0),
        }
    }

    /// Numbers with what they mean, for people.
    pub fn lines(&self, plausible_range: f64) -> [(u64, String); 4] {
        [
            (
                self.fell_back,
                "pixels did not converge in some window and fell back to the double-integral estimate there"
                    .into(),
            ),
            (
                self.saturated,
                "pixels were saturated in every frame of some window: their light is a lower bound there"
                    .into(),
            ),
            (
                self.no_frame,
                "pixels had no usable frame value in some window (NaN): they hold their last \
                             known light there"
                    .into(),
            ),
            (self.implausible, plausible::note(plausible_range)),
        ]
    }
}
