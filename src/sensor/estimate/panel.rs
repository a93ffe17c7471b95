//! Events and frames of some places, side by side.
//!
//! A place is a pixel or a few neighbouring ones. Frames give the mean logarithm of each place, events the
//! numbers of ON and OFF events in even steps of time. Long recordings are given in stretches of neighbouring
//! frames; between them nothing is kept.

use crate::front_end::{FrontEnd, time_constant};

/// A pixel that belongs to no place.
pub const NOWHERE: u32 = u32::MAX;

/// When light changed, from when events came.
///
/// An event comes when its change is complete, and the change went on since the event before: its middle is
/// half of that time earlier. After a quiet time, the time to the next event says how fast the light changes.
/// So an event is put earlier by half of the shorter of the two, which needs the next one to be known.
#[derive(Clone, Debug)]
pub struct Centring {
    /// Of each pixel: the event before the one that waits, and the one that waits with its sign.
    waiting: Vec<(i64, i64, bool)>,
    /// No event is put earlier by more, ns.
    most_ns: i64,
}

/// No event yet.
const NEVER: i64 = i64::MIN;

impl Centring {
    /// For so many pixels, and events put `most_ns` earlier at most.
    pub fn new(pixels: usize, most_ns: i64) -> Centring {
        Centring { waiting: vec![(NEVER, NEVER, false); pixels], most_ns }
    }

    /// Takes the next event of a pixel and gives the one that waited, at the middle of its change.
    #[inline]
    #[must_use]
    pub fn next(&mut self, pixel: usize, t_ns: i64, is_on: bool) -> Option<(i64, bool)> {
        let (before, waiting, was_on) = self.waiting[pixel];
        self.waiting[pixel] = (waiting, t_ns, is_on);
        self.centred(before, waiting, t_ns).map(|t| (t, was_on))
    }

    /// The stamp of the event of a pixel that waits; none before its first.
    #[inline]
    pub(super) fn waits(&self, pixel: usize) -> Option<i64> {
        let waiting = self.waiting[pixel].1;
        (waiting != NEVER).then_some(waiting)
    }

    /// Every pixel whose last event still waits, with that event.
    pub fn rest(&self) -> impl Iterator<Item = (usize, i64, bool)> + '_ {
        let last = |(pixel, (before, waiting, was_on)): (usize, &(i64, i64, bool))| {
            self.centred(*before, *waiting, NEVER).map(|t| (pixel, t, *was_on))
        };
        self.waiting.iter().enumerate().filter_map(last)
    }

    fn centred(&self, before: i64, t: i64, next: i64) -> Option<i64> {
        if t == NEVER {
            return None;
        }
        let gap = |from: i64, to: i64| {
            if from == NEVER || to == NEVER { i64::MAX } else { to.saturating_sub(from).max(0) }
        };
        Some(t.saturating_sub((gap(before, t).min(gap(t, next)) / 2).min(self.most_ns)))
    }
}

/// Neighbouring frames, and the events around them.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Middle of each frame's exposure of row 0 as far as it is known, ns, rising.
    pub mids_ns: Vec<i64>,
    /// Mean logarithm of each place in each frame, [frame][place]; NaN = not known.
    pub log: Vec<f32>,
    /// Start of the first step, ns.
    pub start_ns: i64,
    /// Length of a step, ns, positive.
    pub step_ns: i64,
    /// How many.
    pub steps: usize,
    /// ON events of each step and place, [step][place], per pixel of the place.
    pub on: Vec<u16>,
    /// OFF ones.
    pub off: Vec<u16>,
    /// By how much events of each place are late in the light of each frame, ns, [frame][place]; empty where
    /// nothing is stated of that.
    lag_ns: Vec<f32>,
    places: usize,
}

/// The delay that a stated front end causes: its time constant at the photocurrent that frames show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    front_end: FrontEnd,
    dn_per_photocurrent: f64,
    most_ns: f64,
}

impl Delay {
    /// Of a front end, where `gain` is the DN per second and unit of photocurrent and `exposure_ns` the
    /// length of a frame's exposure; `most_ns` at most, as in darkness no time is long enough. None where one
    /// of them is not positive.
    pub fn new(front_end: FrontEnd, gain: f64, exposure_ns: f64, most_ns: f64) -> Option<Delay> {
        let dn_per_photocurrent = gain * exposure_ns * 1e-9;
        (dn_per_photocurrent > 0.0 && most_ns > 0.0).then_some(Delay {
            front_end,
            dn_per_photocurrent,
            most_ns,
        })
    }

    /// By how much a voltage that follows a slow change of light is late, ns; `dn` is that of a frame over
    /// black level.
    pub fn ns(&self, dn: f64) -> f64 {
        let photocurrent = (dn / self.dn_per_photocurrent).max(1e-12);
        (1e9 * time_constant(&self.front_end, photocurrent)).clamp(0.0, self.most_ns)
    }
}

impl Stretch {
    /// Without events and with unknown frames: `mids_ns` rising, steps of `step_ns` from `margin_ns` before
    /// the first frame to as long after the last.
    pub fn new(mids_ns: Vec<i64>, margin_ns: i64, step_ns: i64, places: usize) -> Stretch {
        let step_ns = step_ns.max(1);
        let (first, last) = (mids_ns.first().copied().unwrap_or(0), mids_ns.last().copied().unwrap_or(0));
        let start_ns = first.saturating_sub(margin_ns);
        let length = last.saturating_sub(start_ns).saturating_add(margin_ns);
        let steps = (length / step_ns + 1).max(1) as usize;
        let log = vec![f32::NAN; mids_ns.len() * places];
        Stretch {
            mids_ns,
            log,
            start_ns,
            step_ns,
            steps,
            on: vec![0; steps * places],
            off: vec![0; steps * places],
            lag_ns: Vec::new(),
            places,
        }
    }

    /// Takes an event of a place; what lies outside of the stretch is let go.
    #[inline]
    pub fn event(&mut self, t_ns: i64, place: usize, is_on: bool) {
        let at = t_ns.wrapping_sub(self.start_ns);
        if at < 0 || t_ns < self.start_ns {
            return;
        }
        let step = (at / self.step_ns) as usize;
        if step < self.steps {
            let counts = if is_on { &mut self.on } else { &mut self.off };
            let count = &mut counts[step * self.places + place];
            *count = count.saturating_add(1);
        }
    }

    /// The logarithms of a frame, to write.
    pub fn frame_mut(&mut self, frame: usize) -> &mut [f32] {
        &mut self.log[frame * self.places..(frame + 1) * self.places]
    }

    /// States by how much events are late in the light of a frame whose logarithms are filled in: of each
    /// place from its logarithm.
    pub fn delay(&mut self, frame: usize, of: impl Fn(f32) -> f64) {
        if self.lag_ns.is_empty() {
            self.lag_ns = vec![0.0; self.log.len()];
        }
        let at = frame * self.places..(frame + 1) * self.places;
        self.lag_ns[at.clone()]
            .iter_mut()
            .zip(&self.log[at])
            .for_each(|(lag, log)| *lag = if log.is_finite() { of(*log) as f32 } else { 0.0 });
    }

    /// By how much an event of a place at an instant is late, ns: between two frames, between what is stated
    /// in their light. Zero where nothing is.
    #[inline]
    pub fn lag_ns(&self, t_ns: i64, place: usize) -> f64 {
        if self.lag_ns.is_empty() {
            return 0.0;
        }
        let after = self.mids_ns.partition_point(|mid| *mid <= t_ns);
        let of = |frame: usize| f64::from(self.lag_ns[frame * self.places + place]);
        match (after.checked_sub(1), after < self.mids_ns.len()) {
            (Some(before), true) => {
                let (from, to) = (self.mids_ns[before], self.mids_ns[after]);
                let part = t_ns.saturating_sub(from) as f64 / to.saturating_sub(from) as f64;
                of(before) + part * (of(after) - of(before))
            }
            (Some(before), false) => of(before),
            (None, true) => of(0),
            (None, false) => 0.0,
        }
    }

    /// Sums over time: element [step][place] is the sum of `on` times ON events less `off` times OFF events
    /// of the steps before.
    pub(super) fn summed(&self, on: f32, off: f32) -> Vec<f32> {
        let mut sums = vec![0.0; (self.steps + 1) * self.places];
        for step in 0..self.steps {
            let (before, after) = sums.split_at_mut((step + 1) * self.places);
            let before = &before[step * self.places..];
            let counts = step * self.places..(step + 1) * self.places;
            for (((sum, before), n_on), n_off) in
                after.iter_mut().zip(before).zip(&self.on[counts.clone()]).zip(&self.off[counts])
            {
                *sum = before + on * f32::from(*n_on) - off * f32::from(*n_off);
            }
        }
        sums
    }

    /// Which step an instant is in, and how far; none outside.
    pub(super) fn at(&self, t_ns: f64) -> Option<(usize, f32)> {
        let at = (t_ns - self.start_ns as f64) / self.step_ns as f64;
        (at >= 0.0 && at < self.steps as f64).then(|| (at as usize, (at - libm::floor(at)) as f32))
    }

    /// Adds `sign` times the sums at an instant to `out`; false, and nothing added, outside of the stretch.
    pub(super) fn add_at(&self, sums: &[f32], t_ns: f64, sign: f32, out: &mut [f32]) -> bool {
        let Some((step, part)) = self.at(t_ns) else { return false };
        let (before, after) = (
            &sums[step * self.places..(step + 1) * self.places],
            &sums[(step + 1) * self.places..(step + 2) * self.places],
        );
        for ((out, before), after) in out.iter_mut().zip(before).zip(after) {
            *out += sign * (before + part * (after - before));
        }
        true
    }

    pub(super) fn logs(&self, frame: usize) -> &[f32] {
        &self.log[frame * self.places..(frame + 1) * self.places]
    }
}

/// Events and frames of some places.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// Mean row of each place.
    pub rows: Vec<f32>,
    /// Pixels of each place.
    pub pixels: Vec<u32>,
    /// The part of the picture that each place belongs to, from 0: what is drawn anew as a whole for
    /// intervals.
    pub parts: Vec<u16>,
    /// Stretches of neighbouring frames, in order of time.
    pub stretches: Vec<Stretch>,
}

/// Parts of a picture across, and down. Rows are cut finer: the row time shows from one band of rows to
/// another.
pub(super) const ACROSS: usize = 4;
/// See [`ACROSS`].
const DOWN: usize = 16;

impl Panel {
    /// Places of an array from the place of each pixel (`y * width + x`), [`NOWHERE`] for none; numbered from
    /// 0 without gap.
    pub fn new(place_of: &[u32], width: u32, height: u32) -> Panel {
        let places = place_of
            .iter()
            .filter(|place| **place != NOWHERE)
            .map(|place| *place as usize + 1)
            .max()
            .unwrap_or(0);
        let (mut pixels, mut x_sums, mut y_sums) = (vec![0u32; places], vec![0.0; places], vec![0.0; places]);
        for (pixel, place) in place_of.iter().enumerate().filter(|(_, place)| **place != NOWHERE) {
            let place = *place as usize;
            pixels[place] += 1;
            x_sums[place] += (pixel % width.max(1) as usize) as f64;
            y_sums[place] += (pixel / width.max(1) as usize) as f64;
        }
        let mean = |sum: f64, n: u32| sum / f64::from(n.max(1));
        let rows: Vec<f32> = y_sums.iter().zip(&pixels).map(|(sum, n)| mean(*sum, *n) as f32).collect();
        let part = |at: f64, of: u32, parts: usize| {
            ((at / f64::from(of.max(1)) * parts as f64) as usize).min(parts - 1)
        };
        let parts = (0..places).map(|n| {
            part(mean(y_sums[n], pixels[n]), height, DOWN) * ACROSS
                + part(mean(x_sums[n], pixels[n]), width, ACROSS)
        });
        Panel { rows, parts: parts.map(|part| part as u16).collect(), pixels, stretches: Vec::new() }
    }

    /// Number of places.
    pub fn places(&self) -> usize {
        self.rows.len()
    }

    /// The logarithm from which on frames are taken at their word: of darker pixels steps of the scale and
    /// noise are changes of tens of per cent, and events that slow pixels lose are many.
    pub(super) fn bright(&self) -> f32 {
        /// As a part of the brightest known place: 30 of 255.
        const BRIGHT: f32 = 0.12;
        let top = self
            .stretches
            .iter()
            .flat_map(|stretch| &stretch.log)
            .copied()
            .filter(|log| log.is_finite())
            .fold(f32::NEG_INFINITY, f32::max);
        top + libm::logf(BRIGHT)
    }

    /// Pairs of neighbouring frames.
    pub fn pairs(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.mids_ns.len().saturating_sub(1)).sum()
    }

    pub(super) fn part_count(&self) -> usize {
        ACROSS * DOWN
    }

    /// Middle time from frame to frame, ns; none without a pair.
    pub fn period_ns(&self) -> Option<i64> {
        let mut periods: Vec<i64> = self
            .stretches
            .iter()
            .flat_map(|one| one.mids_ns.windows(2).map(|pair| pair[1] - pair[0]))
            .collect();
        periods.sort_unstable();
        periods.get(periods.len() / 2).copied().filter(|period| *period > 0)
    }
}
