//! Events against frames: how late events are, whether the clocks drift apart, and whether the two see one
//! picture.
//!
//! The picture is cut into some four thousand places. Frames give the mean logarithm of each, events their
//! numbers in sixteenths of the frame period; [`photocurrent_sensor::estimate`] finds the shift at which the
//! two agree. The same with the events' picture mirrored shows mirrored data.
//!
//! Rows that are exposed later are compared at their own time where the row time is recorded or stated; the
//! delay of a stated front end, by the light that the frames show, is subtracted from the events' times. What
//! is left is the offset of the clocks, and what nobody states.
//!
//! Limits: places are several pixels wide, so that fine motion shows less; what a scene without motion hides
//! stays hidden.

use super::grid::{Grid, GridSurvey};
use super::interval::Interval;
use super::pictures::middle;
use super::places::MOST_PIXELS;
use crate::declared::Transfer;
use crate::recording::FramesAbout;
use photocurrent_core::Extent;
use photocurrent_sensor::estimate::{self, Centring, Delay, Estimate, NOWHERE, Stretch};
use photocurrent_sensor::front_end::FrontEnd;
use serde::Serialize;

/// Places, about.
const PLACES: u32 = 4096;
/// Steps of time from frame to frame.
const STEPS: i64 = 32;
/// Counters of events, at most: recordings with long gaps between frames get wider steps.
const MOST_COUNTERS: usize = 1 << 24;
/// No event is put earlier for its front end by more than this part of a frame period: in darkness no time is
/// long enough.
const DELAY_SHARE: f64 = 0.5;
/// A step of the grey scale: added before the logarithm, as parts of the largest value, so that darkness is
/// finite.
const DARK: f32 = 1.0 / 255.0;

impl From<Estimate> for Interval {
    fn from(estimate: Estimate) -> Interval {
        Interval { value: estimate.value, ci95: estimate.ci95 }
    }
}

/// What a description that travels with the recording states about time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stated {
    /// Delay from row to row of the frames, ns, for frames that do not record it.
    pub row_time_ns: Option<i64>,
    /// The front end, where it and what its photocurrent is counted in are stated.
    pub front_end: Option<StatedFrontEnd>,
}

/// A front end, and how frames show its photocurrent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedFrontEnd {
    /// Time constant in bright light, s.
    pub tau_0_s: f64,
    /// Time constant times photocurrent, s.
    pub alpha_s: f64,
    /// DN per second and unit of photocurrent.
    pub gain: f64,
    /// DN of darkness.
    pub black_level_dn: f64,
}

/// Events against frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LagSurvey {
    /// Pairs of frames that were compared.
    pub pairs: usize,
    /// How late events are, ns, over what row times and a stated front end explain; none where the two do not
    /// clearly agree.
    pub late_ns: Option<Interval>,
    /// The delay from row to row that rows were compared with; none where it is neither recorded nor stated:
    /// the offset is then that of the middle row.
    pub row_time_ns: Option<i64>,
    /// Mean delay of the stated front end, ns, that was subtracted from the events' times; none where none is
    /// stated.
    pub front_end_ns: Option<f64>,
    /// Correlation at that shift, and without one.
    pub correlation: (f64, f64),
    /// Change of the shift, ns a second.
    pub drift_ns_per_s: Option<Interval>,
    /// Its size in each half of the picture, and the correlation with and without it: chance differs from
    /// half to half.
    pub drift_halves_ns_per_s: (f64, f64),
    /// See there.
    pub drift_correlation: (f64, f64),
    /// From the first frames to the last of the drift, s.
    pub drift_over_s: f64,
    /// Whether both lie on one pixel grid; none where sizes do not agree, or nothing moves.
    pub grid: Option<GridSurvey>,
    /// Correlation of events with the frames' changes at the best shift in time: as they are, mirrored left
    /// to right, top to bottom, both.
    pub mirrored: [f64; 4],
}

/// Frames and events as they come.
pub(super) struct Panel {
    panel: estimate::Panel,
    place_of: Vec<u32>,
    /// Event pixels.
    width: u32,
    height: u32,
    across: u32,
    down: u32,
    /// Of each frame that is read: its stretch and place in it.
    at: Vec<(usize, usize, usize)>,
    now: usize,
    centring: Centring,
    frame: Extent,
    channels: usize,
    dark: f32,
    grid: Option<Grid>,
    row_time_ns: Option<i64>,
    front_end: Option<StatedFrontEnd>,
    /// Length of each frame's exposure that is read, ns, in the order of `at`.
    exposures_ns: Vec<Option<i64>>,
    period_ns: i64,
    /// Delays of the front end that were subtracted, ns, and how many.
    delays: (f64, u64),
}

impl Panel {
    /// For frames that will be read, in order; none when there are too few, or sizes are unknown.
    pub(super) fn new(
        about: &FramesAbout,
        events: Option<Extent>,
        chosen: &[usize],
        stated: &Stated,
    ) -> Option<Panel> {
        let extent = events.unwrap_or(about.extent);
        if extent.pixels() == 0
            || extent.pixels() > MOST_PIXELS
            || about.extent.pixels() == 0
            || chosen.len() < 2
        {
            return None;
        }
        let side = (libm::sqrt(extent.pixels() as f64 / f64::from(PLACES)).ceil() as u32).max(1);
        let (across, down) = (extent.width.div_ceil(side), extent.height.div_ceil(side));
        let place_of: Vec<u32> = (0..extent.height)
            .flat_map(|y| (0..extent.width).map(move |x| (y / side) * across + x / side))
            .collect();
        let mut panel = estimate::Panel::new(&place_of, extent.width, extent.height);
        let mids: Vec<i64> = chosen.iter().map(|frame| middle(&about.stamps[*frame])).collect();
        let mut periods: Vec<i64> = chosen
            .windows(2)
            .zip(mids.windows(2))
            .filter(|(n, _)| n[1] == n[0] + 1)
            .map(|(_, t)| t[1].saturating_sub(t[0]))
            .collect();
        periods.sort_unstable();
        let period = periods.get(periods.len() / 2).copied().filter(|period| *period > 0)?;
        let at = stretches(chosen, &mids, period, &mut panel);
        let centring = Centring::new(extent.pixels(), period / 4);
        let pairs: Vec<(usize, i64, i64)> = at
            .windows(2)
            .zip(mids.windows(2))
            .filter(|(at, _)| at[0].1 == at[1].1)
            .map(|(at, mids)| (at[1].0, mids[0], mids[1]))
            .collect();
        let grid = Grid::new(about, extent, &pairs, period);
        let (frame, channels) = (about.extent, about.colour.channels() as usize);
        let is_linear = matches!(about.transfer, None | Some(Transfer::Linear));
        let length =
            |frame: &usize| about.stamps[*frame].exposure.map(|(start, end)| end.saturating_sub(start));
        Some(Panel {
            panel,
            place_of,
            width: extent.width,
            height: extent.height,
            across,
            down,
            now: 0,
            centring,
            frame,
            channels,
            dark: 0.0,
            grid,
            row_time_ns: about.row_time_ns.or(stated.row_time_ns),
            front_end: stated.front_end.filter(|_| is_linear),
            exposures_ns: at.iter().map(|(frame, ..)| length(frame)).collect(),
            at,
            period_ns: period,
            delays: (0.0, 0),
        })
    }

    /// Takes the values of a frame.
    pub(super) fn picture(&mut self, frame: usize, values: &[f32]) {
        let Ok(found) = self.at.binary_search_by_key(&frame, |at| at.0) else { return };
        let row_values = self.frame.width as usize * self.channels;
        if values.len() < row_values * self.frame.height as usize {
            return;
        }
        if self.dark == 0.0 {
            self.dark = DARK * values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
        }
        if let Some(grid) = &mut self.grid {
            grid.picture(frame, values, self.dark);
        }
        let places = self.panel.places();
        let (mut sums, mut counts) = (vec![0.0f32; places], vec![0u32; places]);
        let (dark, scale) = (self.dark.max(1e-6), |at: u32, of: u32, to: u32| {
            ((u64::from(at) * u64::from(to)) / u64::from(of.max(1))) as usize
        });
        for y in 0..self.frame.height {
            let row = &values[y as usize * row_values..][..row_values];
            let places_of_row = &self.place_of
                [scale(y, self.frame.height, self.height) * self.width as usize..][..self.width as usize];
            for x in 0..self.frame.width {
                let place = places_of_row[scale(x, self.frame.width, self.width)] as usize;
                let value = row[x as usize * self.channels..][..self.channels].iter().sum::<f32>()
                    / self.channels as f32;
                if value.is_finite() {
                    sums[place] += libm::logf(value.max(0.0) + dark);
                    counts[place] += 1;
                }
            }
        }
        let (_, stretch, within) = self.at[found];
        let log = self.panel.stretches[stretch].frame_mut(within);
        log.iter_mut()
            .zip(sums)
            .zip(counts)
            .for_each(|((log, sum), count)| *log = if count > 0 { sum / count as f32 } else { f32::NAN });
        let delay = self.front_end.zip(self.exposures_ns[found]).and_then(|(of, exposure_ns)| {
            let front_end = FrontEnd { tau_0_s: of.tau_0_s, alpha_s: of.alpha_s };
            Some((
                Delay::new(front_end, of.gain, exposure_ns as f64, DELAY_SHARE * self.period_ns as f64)?,
                f64::from(dark) + of.black_level_dn,
            ))
        });
        if let Some((delay, black)) = delay {
            self.panel.stretches[stretch].delay(within, |log| delay.ns(libm::exp(f64::from(log)) - black));
        }
    }

    /// Takes an event.
    #[inline]
    pub(super) fn event(&mut self, t: i64, x: u16, y: u16, on: u8) {
        if u32::from(x) >= self.width || u32::from(y) >= self.height {
            return;
        }
        let pixel = usize::from(y) * self.width as usize + usize::from(x);
        if let Some((t, is_on)) = self.centring.next(pixel, t, on == 1) {
            self.put(pixel, t, is_on);
        }
    }

    fn put(&mut self, pixel: usize, t: i64, is_on: bool) {
        let (x, y) = (pixel % self.width as usize, pixel / self.width as usize);
        // Row 0 is what the frames' middles are of: a row that is exposed later is compared as much later.
        let frame_row = y as i64 * i64::from(self.frame.height) / i64::from(self.height);
        let mut t = t.saturating_sub(self.row_time_ns.unwrap_or(0).saturating_mul(frame_row));
        let place = self.place_of[pixel] as usize;
        let holds = |stretch: &Stretch| {
            t >= stretch.start_ns
                && t.saturating_sub(stretch.start_ns) < stretch.step_ns.saturating_mul(stretch.steps as i64)
        };
        if !self.panel.stretches.get(self.now).is_some_and(holds) {
            // Stretches are in order of time, and hardly overlap.
            let after = self.panel.stretches.partition_point(|stretch| stretch.start_ns <= t);
            let Some(now) = after.checked_sub(1).filter(|now| holds(&self.panel.stretches[*now])) else {
                return;
            };
            self.now = now;
        }
        let stretch = &mut self.panel.stretches[self.now];
        if self.front_end.is_some() {
            let late_ns = stretch.lag_ns(t, place);
            self.delays = (self.delays.0 + late_ns, self.delays.1 + 1);
            t = t.saturating_sub(late_ns as i64);
        }
        stretch.event(t, place, is_on);
        if let Some(grid) = &mut self.grid {
            grid.event(t, x, y, is_on);
        }
    }

    pub(super) fn survey(mut self) -> Option<LagSurvey> {
        let rest: Vec<_> = self.centring.rest().collect();
        rest.into_iter().for_each(|(pixel, t, is_on)| self.put(pixel, t, is_on));
        let pairs = self.panel.pairs();
        if pairs == 0 {
            return None;
        }
        let shift = estimate::offset(&self.panel);
        let drift = shift.and_then(|_| estimate::drift(&self.panel));
        let grid = self.grid.take().and_then(|grid| grid.survey(shift.map_or(0.0, |shift| shift.ns.value)));
        Some(LagSurvey {
            pairs,
            late_ns: shift.map(|shift| shift.ns.into()),
            correlation: shift.map_or((0.0, 0.0), |shift| (shift.correlation, shift.correlation_at_none)),
            drift_ns_per_s: drift.map(|drift| drift.ns_per_s.into()),
            drift_halves_ns_per_s: drift.map_or((0.0, 0.0), |drift| drift.halves_ns_per_s),
            drift_correlation: drift
                .map_or((0.0, 0.0), |drift| (drift.correlation, drift.correlation_at_none)),
            drift_over_s: drift.map_or(0.0, |drift| drift.over_s),
            row_time_ns: self.row_time_ns,
            front_end_ns: (self.delays.1 > 0).then(|| self.delays.0 / self.delays.1 as f64),
            grid,
            mirrored: self.mirrored(),
        })
    }

    /// Events against the changes of the frames, mirrored in four ways.
    fn mirrored(&self) -> [f64; 4] {
        let at = |x: u32, y: u32| y * self.across + x;
        [(false, false), (true, false), (false, true), (true, true)].map(|(flip_x, flip_y)| {
            let places = (0..self.down).flat_map(|y| (0..self.across).map(move |x| (x, y)));
            let from = places.map(|(x, y)| {
                at(if flip_x { self.across - 1 - x } else { x }, if flip_y { self.down - 1 - y } else { y })
            });
            let mut from: Vec<u32> = from.collect();
            from.resize(self.panel.places(), NOWHERE);
            estimate::agreement_from(&self.panel, &from)
        })
    }
}

/// Adds the stretches of the frames to the panel, as far as memory allows: of each frame its stretch and
/// place in it. Neighbours whose middles rise belong to one stretch.
fn stretches(
    chosen: &[usize],
    mids: &[i64],
    period: i64,
    panel: &mut estimate::Panel,
) -> Vec<(usize, usize, usize)> {
    let (mut at, mut from) = (Vec::new(), 0);
    let mut counters = 0;
    while from < chosen.len() {
        let joins = |n: &usize| {
            chosen[*n] == chosen[n - 1] + 1
                && mids[*n] > mids[n - 1]
                && mids[*n].saturating_sub(mids[n - 1]) < 4 * period
        };
        let to = (from + 1..chosen.len()).find(|n| !joins(n)).unwrap_or(chosen.len());
        let stretch = Stretch::new(
            mids[from..to].to_vec(),
            period + period / 4,
            (period / STEPS).max(1),
            panel.places(),
        );
        counters += stretch.on.len();
        if counters > MOST_COUNTERS {
            break;
        }
        at.extend((from..to).map(|n| (chosen[n], panel.stretches.len(), n - from)));
        panel.stretches.push(stretch);
        from = to;
    }
    at
}
