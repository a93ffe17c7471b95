//! Covariates of an event: its place and time, brightness and slope of its light, and earlier events of its
//! pixel and of the array.
//!
//! Names are those of reports (`location.covariate`). All are computed from the recording and the estimated
//! scene alone. They are defined for any event at any time, recorded or simulated.

use crate::curves::LogLightCurves;
use crate::sample::PixelSample;
use photocurrent_core::Extent;
use photocurrent_scene::case::Case;
use photocurrent_sensor::effects::{BURST_GAP_NS, Site};
use serde::{Deserialize, Serialize};

/// Something that a mismatch may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariate {
    /// Row, from 0.
    Row,
    /// Even or odd row.
    RowParity,
    /// Column, from 0.
    Column,
    /// Even or odd column.
    ColumnParity,
    /// Eighth of the array's width.
    ColumnBlock,
    /// Distance from the centre, 1 = corner.
    Radius,
    /// Time since the start, seconds.
    Time,
    /// Time since the row's last exposure began, seconds.
    FramePhase,
    /// Log photocurrent.
    Photocurrent,
    /// |d log i / dt|, 1/s.
    Slope,
    /// |V_DC - V_FE|, natural-log units: slope times time constant.
    Lag,
    /// +1 or -1.
    Polarity,
    /// +1 when the pixel's last event had the same polarity, -1 when the other.
    PreviousPolarity,
    /// Seconds since the pixel's last event.
    TimeSinceLastEvent,
    /// Place in a run of events of one polarity that are close in time, from 1.
    BurstIndex,
    /// Events of the 3 x 3 pixels around in the millisecond before.
    LocalRate,
    /// Events of the row in the millisecond before.
    RowRate,
    /// Events of the array in the millisecond before.
    GlobalRate,
    /// Size of the gradient of log light over the array, 1/px.
    SpatialGradient,
    /// Mean of the four neighbours' log light less the pixel's own.
    Laplacian,
    /// Seconds since the last event of one of the eight neighbours.
    NeighbourEvent,
    /// Phase of a rhythm, in periods from 0 to 1; see [`CovariateSource::set_period`].
    AcPhase,
}

impl Covariate {
    /// Covariates of frame values.
    pub const OF_FRAMES: [Covariate; 8] = [
        Covariate::Row,
        Covariate::RowParity,
        Covariate::Column,
        Covariate::ColumnBlock,
        Covariate::Radius,
        Covariate::Time,
        Covariate::Photocurrent,
        Covariate::Slope,
    ];

    /// All of them.
    pub const ALL: [Covariate; 22] = [
        Covariate::Row,
        Covariate::RowParity,
        Covariate::Column,
        Covariate::ColumnParity,
        Covariate::ColumnBlock,
        Covariate::Radius,
        Covariate::Time,
        Covariate::FramePhase,
        Covariate::Photocurrent,
        Covariate::Slope,
        Covariate::Lag,
        Covariate::Polarity,
        Covariate::PreviousPolarity,
        Covariate::TimeSinceLastEvent,
        Covariate::BurstIndex,
        Covariate::LocalRate,
        Covariate::RowRate,
        Covariate::GlobalRate,
        Covariate::SpatialGradient,
        Covariate::Laplacian,
        Covariate::NeighbourEvent,
        Covariate::AcPhase,
    ];

    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Covariate::Row => "row",
            Covariate::RowParity => "row_parity",
            Covariate::Column => "column",
            Covariate::ColumnParity => "column_parity",
            Covariate::ColumnBlock => "column_block",
            Covariate::Radius => "radius",
            Covariate::Time => "time",
            Covariate::FramePhase => "frame_phase",
            Covariate::Photocurrent => "photocurrent",
            Covariate::Slope => "slope",
            Covariate::Lag => "lag",
            Covariate::Polarity => "polarity",
            Covariate::PreviousPolarity => "previous_polarity",
            Covariate::TimeSinceLastEvent => "time_since_last_event",
            Covariate::BurstIndex => "burst_index",
            Covariate::LocalRate => "local_rate",
            Covariate::RowRate => "row_rate",
            Covariate::GlobalRate => "global_rate",
            Covariate::SpatialGradient => "spatial_gradient",
            Covariate::Laplacian => "laplacian",
            Covariate::NeighbourEvent => "neighbour_event",
            Covariate::AcPhase => "ac_phase",
        }
    }

    /// Is it a function of the light at the pixel and around it, and of the events that this light causes?
    pub fn is_of_light(self) -> bool {
        !matches!(
            self,
            Covariate::Row
                | Covariate::RowParity
                | Covariate::Column
                | Covariate::ColumnParity
                | Covariate::ColumnBlock
                | Covariate::Radius
                | Covariate::Time
                | Covariate::FramePhase
                | Covariate::AcPhase
                | Covariate::RowRate
                | Covariate::GlobalRate
        )
    }

    /// Is it a class rather than a number on a scale?
    pub fn is_class(self) -> bool {
        matches!(
            self,
            Covariate::RowParity
                | Covariate::ColumnParity
                | Covariate::ColumnBlock
                | Covariate::Polarity
                | Covariate::PreviousPolarity
        )
    }
}

/// Load is counted over so long, ns.
const LOAD_NS: i64 = 1_000_000;
/// A slope is taken over so long to each side, ns.
const SLOPE_NS: i64 = 100_000;

/// Recording and light from which covariates are computed.
pub struct CovariateSource<'a> {
    case: &'a Case,
    /// Log photocurrent of a pixel at an instant; none where it is not known.
    light: Box<dyn Fn(usize, i64) -> Option<f64> + Sync + 'a>,
    /// Pixels whose light is known.
    pixels: usize,
    /// Time constant: tau_0 and alpha, seconds.
    tau: (f64, f64),
    /// Events up to the start of each millisecond: of the array, and of each row.
    array_load: Vec<u32>,
    row_load: Vec<Vec<u32>>,
    period_ns: Option<i64>,
}

impl<'a> CovariateSource<'a> {
    /// Of a recording and its scene; `tau` is (tau_0, alpha) in seconds.
    pub fn new(
        case: &'a Case,
        sample: &'a PixelSample,
        scene: &'a LogLightCurves,
        tau: (f64, f64),
    ) -> CovariateSource<'a> {
        let light = |pixel: usize, t_ns: i64| {
            sample.index_of(pixel).filter(|&n| scene.is_known[n]).map(|n| scene.at(n, t_ns))
        };
        CovariateSource::from_light(case, Box::new(light), sample.len(), tau)
    }

    /// Of the recording `case`. `light` returns the log photocurrent by pixel and instant (ns), natural-log
    /// units, for `pixels` of its pixels. `tau` is the front end's (tau_0 in s, alpha).
    pub fn from_light(
        case: &'a Case,
        light: Box<dyn Fn(usize, i64) -> Option<f64> + Sync + 'a>,
        pixels: usize,
        tau: (f64, f64),
    ) -> CovariateSource<'a> {
        let bins = usize::try_from((case.span.1 - case.span.0) / LOAD_NS + 2).unwrap_or(2);
        let mut array_load = vec![0; bins];
        let mut row_load = vec![vec![0; bins]; case.extent.height as usize];
        for pixel in 0..case.events.pixels() {
            let (_, y) = case.pixel_place(pixel);
            for event in case.events.of_pixel(pixel) {
                let bin = usize::try_from((event.t_in_ns - case.span.0) / LOAD_NS).unwrap_or(0).min(bins - 1);
                array_load[bin] += 1;
                row_load[y as usize][bin] += 1;
            }
        }
        CovariateSource { case, light, pixels, tau, array_load, row_load, period_ns: None }
    }

    /// Sets the period of a rhythm.
    pub fn set_period(&mut self, period_ns: Option<i64>) {
        self.period_ns = period_ns;
    }

    /// Size of the array, and number of pixels whose light is known.
    pub fn size(&self) -> (Extent, usize) {
        (self.case.extent, self.pixels)
    }

    /// The value for an event of `polarity` at `t_ns` in a pixel of the array; none where it is not defined
    /// (no event before, no neighbour in the sample).
    pub fn value(&self, covariate: Covariate, pixel: usize, t_ns: i64, polarity: i8) -> Option<f64> {
        let (x, y) = self.case.pixel_place(pixel);
        let Extent { width, height } = self.case.extent;
        let site = Site { x, y, width, height, seed: 0 };
        Some(match covariate {
            Covariate::Row => f64::from(y),
            Covariate::RowParity => f64::from(y % 2),
            Covariate::Column => f64::from(x),
            Covariate::ColumnParity => f64::from(x % 2),
            Covariate::ColumnBlock => f64::from(site.column_block()),
            Covariate::Radius => site.radius(),
            Covariate::Time => (t_ns - self.case.span.0) as f64 * 1e-9,
            Covariate::FramePhase => {
                let times = &self.case.frames.as_ref()?.times;
                (t_ns - times.exposure(times.last_begun(y, t_ns)?, y).start.0) as f64 * 1e-9
            }
            Covariate::Photocurrent => self.log_light(pixel, t_ns)?,
            Covariate::Slope => self.slope(pixel, t_ns)?.abs(),
            Covariate::Lag => {
                let tau = self.tau.0 + self.tau.1 * libm::exp(-self.log_light(pixel, t_ns)?);
                tau * self.slope(pixel, t_ns)?.abs()
            }
            Covariate::Polarity => f64::from(polarity),
            Covariate::PreviousPolarity => f64::from(polarity * self.last_event_before(pixel, t_ns)?.1),
            Covariate::TimeSinceLastEvent => (t_ns - self.last_event_before(pixel, t_ns)?.0) as f64 * 1e-9,
            Covariate::BurstIndex => self.burst_index(pixel, t_ns, polarity),
            Covariate::LocalRate => {
                self.neighbours(x, y).map(|neighbour| self.count_before(neighbour, t_ns)).sum::<usize>()
                    as f64
            }
            Covariate::RowRate => f64::from(self.row_load[y as usize][self.bin(t_ns)]),
            Covariate::GlobalRate => f64::from(self.array_load[self.bin(t_ns)]),
            Covariate::SpatialGradient => {
                let difference = |by: (i32, i32)| {
                    Some(
                        0.5 * (self.neighbour(x, y, by, t_ns)?
                            - self.neighbour(x, y, (-by.0, -by.1), t_ns)?),
                    )
                };
                let (across, down) = (difference((1, 0))?, difference((0, 1))?);
                libm::sqrt(across * across + down * down)
            }
            Covariate::Laplacian => {
                let neighbours = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|by| self.neighbour(x, y, by, t_ns));
                neighbours.into_iter().sum::<Option<f64>>()? / 4.0 - self.log_light(pixel, t_ns)?
            }
            Covariate::NeighbourEvent => {
                let latest = self
                    .neighbours(x, y)
                    .filter(|&neighbour| neighbour != pixel)
                    .filter_map(|neighbour| Some(self.last_event_before(neighbour, t_ns)?.0))
                    .max()?;
                (t_ns - latest) as f64 * 1e-9
            }
            Covariate::AcPhase => {
                let period_ns = self.period_ns?;
                (t_ns - self.case.span.0).rem_euclid(period_ns) as f64 / period_ns as f64
            }
        })
    }

    fn bin(&self, t_ns: i64) -> usize {
        usize::try_from((t_ns - self.case.span.0) / LOAD_NS).unwrap_or(0).min(self.array_load.len() - 1)
    }

    fn neighbours(&self, x: u32, y: u32) -> impl Iterator<Item = usize> {
        let (width, height) = (self.case.extent.width, self.case.extent.height);
        let rows = y.saturating_sub(1)..=u32::min(y + 1, height - 1);
        rows.flat_map(move |y| {
            (x.saturating_sub(1)..=u32::min(x + 1, width - 1)).map(move |x| (y * width + x) as usize)
        })
    }

    /// Stamp and polarity of the pixel's last event before `t_ns`.
    fn last_event_before(&self, pixel: usize, t_ns: i64) -> Option<(i64, i8)> {
        let events = self.case.events.of_pixel(pixel);
        let event = events[..events.partition_point(|event| event.t_in_ns < t_ns)].last()?;
        Some((event.t_in_ns, event.polarity))
    }

    fn count_before(&self, pixel: usize, t_ns: i64) -> usize {
        let events = self.case.events.of_pixel(pixel);
        events.partition_point(|event| event.t_in_ns < t_ns)
            - events.partition_point(|event| event.t_in_ns < t_ns - LOAD_NS)
    }

    fn burst_index(&self, pixel: usize, t_ns: i64, polarity: i8) -> f64 {
        let events = self.case.events.of_pixel(pixel);
        let (mut index, mut later) = (1.0, t_ns);
        for event in events[..events.partition_point(|event| event.t_in_ns < t_ns)].iter().rev() {
            if event.polarity != polarity || later - event.t_in_ns > BURST_GAP_NS {
                break;
            }
            (index, later) = (index + 1.0, event.t_in_ns);
        }
        index
    }

    fn log_light(&self, pixel: usize, t_ns: i64) -> Option<f64> {
        (self.light)(pixel, t_ns)
    }

    fn slope(&self, pixel: usize, t_ns: i64) -> Option<f64> {
        Some(
            (self.log_light(pixel, t_ns + SLOPE_NS)? - self.log_light(pixel, t_ns - SLOPE_NS)?)
                / (2.0 * SLOPE_NS as f64 * 1e-9),
        )
    }

    fn neighbour(&self, x: u32, y: u32, by: (i32, i32), t_ns: i64) -> Option<f64> {
        let (column, row) = (x.checked_add_signed(by.0)?, y.checked_add_signed(by.1)?);
        (column < self.case.extent.width && row < self.case.extent.height).then_some(())?;
        self.log_light((row * self.case.extent.width + column) as usize, t_ns)
    }
}
