//! Where the gain of an effect is: rows, columns, time, light, polarity, and over which covariate it varies.
//!
//! Each event gains the log density of its residual with the effect less that without it, both under the
//! noise that is left with the effect ([`super::fit::row_gains`]): an event that the effect changes nothing
//! of gains nothing. The mean gain per event is then compared between parts of the array, of the time, of the
//! light and of the polarities, with errors from blocks of pixels. A part is reported only where the rest
//! gains almost nothing compared with it ([`LocatedSetting::rest`]) and the two differ by many standard
//! errors ([`LocatedSetting::certain`]), and still differ where the part is chosen on one half of the blocks
//! and judged on the other; otherwise the whole range is.
//!
//! Limits: gains are those of the fit, and held out only on a scene of frames and events; one contiguous
//! part for each axis; events that the gate leaves out carry no information; random effects are not located.

pub(crate) use super::axis::MeanGain;
use super::axis::{best, mean_gain, shape};
use super::laid::{CovariateBins, CovariateColumns};
use crate::covariates::Covariate;
use crate::dependence::Dependence;
use crate::report::Location;
use photocurrent_scene::case::Case;
use serde::{Deserialize, Serialize};

/// Settings of the location of gains: significance and resolution.
#[derive(Clone, Copy, Debug)]
pub struct LocatedSetting {
    /// Largest gain of the rest, as a share of the part's gain per event.
    pub rest: f64,
    /// Least difference of the two, standard errors.
    pub certain: f64,
    /// Least difference where the part is selected on one half of the blocks and evaluated on the other,
    /// standard errors.
    pub certain_apart: f64,
    /// Fewer events are neither a part nor a rest.
    pub least_events: usize,
    /// A rim of the range with fewer events than this belongs to the part next to it.
    pub rim_events: usize,
    /// Steps of time and of light that a part is made of.
    pub steps: usize,
    /// Bins of curves and covariates.
    pub bins: usize,
    /// Least significance of a covariate: reduction of squared gains on held-out blocks, standard errors.
    pub significant: f64,
    /// And at least this share of the squares.
    pub least_explained: f64,
    /// Least ratio of explained squares at which another covariate replaces the catalogue's.
    pub displaces: f64,
    /// And at least this share of the squares: that much an effect that is everywhere varies by chance of the
    /// scene.
    pub least_displacing: f64,
    /// Largest gain of its lowest bin, as a share of the highest.
    pub uneven: f64,
    /// A curve rises or falls where a straight line over its bins explains this share of it.
    pub straight: f64,
    /// Least side of the map's cells, pixels.
    pub cell: usize,
    /// Number of events per cell.
    pub cell_events: usize,
}

impl Default for LocatedSetting {
    fn default() -> LocatedSetting {
        LocatedSetting {
            rest: 0.1,
            certain: 4.0,
            certain_apart: 2.5,
            least_events: 100,
            rim_events: 20,
            steps: 60,
            bins: 8,
            significant: 4.0,
            least_explained: 0.02,
            displaces: 2.0,
            least_displacing: 0.3,
            uneven: 0.5,
            straight: 0.5,
            cell: 4,
            cell_events: 12,
        }
    }
}

/// A part of an axis that the gain is in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocatedPart<T> {
    /// First and last.
    pub range: [T; 2],
    /// Gain within.
    pub inside: MeanGain,
    /// And of the rest, in the parts of the other axes; none where the part is the whole range.
    pub outside: Option<MeanGain>,
}

/// A located range: first and last step, gain within and outside.
struct FoundRange {
    first: usize,
    last: usize,
    inside: MeanGain,
    outside: MeanGain,
}

impl<T> LocatedPart<T> {
    fn from_range(
        found: Option<FoundRange>,
        all: MeanGain,
        range: impl Fn(Option<&FoundRange>) -> [T; 2],
    ) -> LocatedPart<T> {
        let (inside, outside) =
            found.as_ref().map_or((all, None), |found| (found.inside, Some(found.outside)));
        LocatedPart { range: range(found.as_ref()), inside, outside }
    }
}

/// Gain per event over something.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainCurve {
    /// Mean of it in each bin.
    pub at: Vec<f64>,
    /// Gain in each bin.
    pub gain: Vec<MeanGain>,
}

/// Gain per event by place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainMap {
    /// Side of a cell, pixels.
    pub side: usize,
    /// Cells of a row.
    pub across: usize,
    /// Gain per event, row by row of cells, nats; 0 without events.
    pub gain: Vec<f64>,
    /// How many events.
    pub events: Vec<u32>,
}

/// Location of an effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocatedEffect {
    /// Gain of all events.
    pub all: MeanGain,
    /// Of ON events, and of OFF events; of frame values neither.
    pub by_polarity: Option<[MeanGain; 2]>,
    /// `on`, `off` or `both`.
    pub polarity: String,
    /// Rows.
    pub rows: LocatedPart<u32>,
    /// Columns.
    pub columns: LocatedPart<u32>,
    /// Time, ns.
    pub time_ns: LocatedPart<i64>,
    /// Log photocurrent (of frame values, log of digital numbers above black).
    pub log_light: LocatedPart<f64>,
    /// Covariate of the gain, by the names of docs/formats.md.
    pub covariate: String,
    /// How: `rises`, `falls`, `peak`, `valley`, `uneven`, of classes `differs`, or `flat` where it does not.
    pub shape: String,
    /// The covariate of `over`.
    pub curve_of: Option<Covariate>,
    /// Gain over the covariate; empty where it does not vary.
    pub over: GainCurve,
    /// Gain over rows.
    pub over_rows: GainCurve,
    /// Over time, seconds since the start.
    pub over_time: GainCurve,
    /// Over the log photocurrent.
    pub over_light: GainCurve,
    /// Gain over the array.
    pub map: GainMap,
    /// Pixels of the part in whose surroundings events gain.
    pub pixels: u64,
}

impl LocatedEffect {
    /// Copies the measured ranges to a location of a report; its stream and pixel list stay.
    pub fn copy_to(&self, location: &mut Location) {
        location.polarity.clone_from(&self.polarity);
        (location.rows, location.columns, location.time_ns) =
            (self.rows.range, self.columns.range, self.time_ns.range);
        location.covariate.clone_from(&self.covariate);
        location.shape = Some(self.shape.clone());
        location.pixels = self.pixels;
    }

    /// The same of a curve that has no name: the covariate and how it runs are the curve's own.
    #[must_use]
    pub fn of_dependence(self, dependence: &Dependence, setting: &LocatedSetting) -> LocatedEffect {
        let shape = if dependence.covariate.is_class() {
            "differs"
        } else {
            shape(&dependence.value, setting.straight)
        };
        LocatedEffect { covariate: dependence.covariate.name().to_owned(), shape: shape.to_owned(), ..self }
    }
}

/// Locations of one method's answers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EffectLocations {
    /// Of effects with nothing else applied, by their number in [`crate::candidates::CANDIDATES`].
    pub first: Vec<(usize, LocatedEffect)>,
    /// Of effects with the best one applied.
    pub second: Vec<(usize, LocatedEffect)>,
    /// Of an uncatalogued dependence.
    pub unnamed: Option<LocatedEffect>,
}

impl EffectLocations {
    /// Of an effect.
    pub fn for_effect(&self, candidate: usize, is_second: bool) -> Option<&LocatedEffect> {
        let list = if is_second { &self.second } else { &self.first };
        list.iter().find(|(of, _)| *of == candidate).map(|(_, located)| located)
    }
}

/// Events, or frame values, with their places.
#[derive(Clone, Copy)]
pub(crate) struct GainingValues<'a> {
    /// The pixel of each.
    pub pixel: &'a [u32],
    /// When, ns.
    pub t_ns: &'a [i64],
    /// +1 or -1; empty for frame values.
    pub polarity: &'a [i8],
    /// Log photocurrent, or log of the digital number above black.
    pub log_light: &'a [f64],
    /// Block of pixels of each; the last bit is its half.
    pub block: &'a [u32],
}

/// Data of the location: events, blocks and axes.
pub(crate) struct LocationData<'a> {
    case: &'a Case,
    /// Of a gain each.
    pub on: GainingValues<'a>,
    bins: Vec<(Covariate, CovariateBins)>,
    setting: &'a LocatedSetting,
}

/// Steps of events along the axes that parts are looked for on.
struct AxisSteps {
    row: Vec<usize>,
    column: Vec<usize>,
    time: Vec<usize>,
    /// Length of a step of time, ns.
    step_ns: i64,
    /// Bin of the log photocurrent.
    lit: Vec<usize>,
    /// And how many there are.
    lights: usize,
}

impl<'a> LocationData<'a> {
    /// Of events or frame values; `laid`: their covariates.
    pub(crate) fn new(
        case: &'a Case,
        on: GainingValues<'a>,
        laid: &[CovariateColumns],
        setting: &'a LocatedSetting,
    ) -> LocationData<'a> {
        let bins = laid
            .iter()
            .map(|laid| {
                (laid.covariate, CovariateBins::new(&laid.at, setting.bins, 1, laid.covariate.is_class()))
            })
            .collect();
        LocationData { case, on, bins, setting }
    }

    /// Locates gains, nats, one per event. `own`: the covariate that the catalogue states for the effect.
    pub(crate) fn locate(&self, gains: &[f64], own: &str) -> LocatedEffect {
        let gains: Vec<f64> = gains.iter().map(|gain| if gain.is_finite() { *gain } else { 0.0 }).collect();
        let (case, setting) = (self.case, self.setting);
        let AxisSteps { row, column, time: step, step_ns, lit, lights } = &self.steps(gains.len());
        let wide = |values: &[usize]| -> Vec<f64> { values.iter().map(|value| *value as f64).collect() };
        let (start_ns, end_ns) = case.span;
        let seconds: Vec<f64> = self.on.t_ns.iter().map(|t| (t - start_ns) as f64 * 1e-9).collect();

        let (all, _) = self.means(&gains, &|_| true);
        let (width, height) = (case.extent.width as usize, case.extent.height as usize);
        let is_within = |at: &[usize], found: &Option<FoundRange>, k: usize| {
            found.as_ref().is_none_or(|found| (found.first..=found.last).contains(&at[k]))
        };
        // Each axis on the part of those before it, so that a corner of the array stands out in both.
        let mut rows = self.find_range(&gains, row, height, &|_| true);
        let columns = self.find_range(&gains, column, width, &|k| is_within(row, &rows, k));
        if rows.is_none() && columns.is_some() {
            rows = self.find_range(&gains, row, height, &|k| is_within(column, &columns, k));
        }
        let is_placed = |k: usize| is_within(row, &rows, k) && is_within(column, &columns, k);
        let (placed, _) = self.means(&gains, &is_placed);
        let time = self.find_range(&gains, step, setting.steps, &is_placed);
        let is_then = |k: usize| is_placed(k) && is_within(step, &time, k);
        let lit_part = self.find_range(&gains, lit, *lights, &is_then);
        let ends = self.light_range((0..gains.len()).filter(|&k| is_within(lit, &lit_part, k)));
        let by_polarity = (!self.on.polarity.is_empty()).then(|| {
            [1, -1].map(|sign| self.means(&gains, &|k| is_then(k) && self.on.polarity[k] == sign).0)
        });
        let polarity = by_polarity.map_or("both", |[on, off]| self.polarity_of(&on, &off));
        let rows = LocatedPart::from_range(rows, all, |found| {
            found
                .map_or([0, height.saturating_sub(1) as u32], |found| [found.first as u32, found.last as u32])
        });
        let columns = LocatedPart::from_range(columns, all, |found| {
            found.map_or([0, width.saturating_sub(1) as u32], |found| [found.first as u32, found.last as u32])
        });
        let to_ns = |last: usize| {
            if last + 1 == setting.steps { end_ns } else { start_ns + (last as i64 + 1) * step_ns }
        };
        let time_ns = LocatedPart::from_range(time, all, |found| {
            found.map_or([start_ns, end_ns], |found| {
                [start_ns + found.first as i64 * step_ns, to_ns(found.last)]
            })
        });
        let log_light = LocatedPart::from_range(lit_part, all, |_| ends.unwrap_or([0.0; 2]));
        let (covariate, found) = self.covariate(&gains, own);
        let over = found.map_or_else(GainCurve::default, |n| self.curve(&gains, &self.bins[n].1));
        let means: Vec<f64> = over.gain.iter().map(|mean| mean.gain).collect();
        let shape = found.map_or("flat", |n| {
            if self.bins[n].1.is_class { "differs" } else { shape(&means, setting.straight) }
        });
        let curve = |values: &[f64]| self.curve(&gains, &CovariateBins::new(values, setting.bins, 1, false));
        let map = self.map(&gains);
        let pixels = self.count_gaining_pixels(&map, rows.range, columns.range, setting.rest * placed.gain);
        LocatedEffect {
            all,
            by_polarity,
            polarity: polarity.to_owned(),
            rows,
            columns,
            time_ns,
            log_light,
            covariate,
            shape: shape.to_owned(),
            curve_of: found.map(|n| self.bins[n].0),
            over,
            over_rows: curve(&wide(row)),
            over_time: curve(&seconds),
            over_light: curve(self.on.log_light),
            map,
            pixels,
        }
    }

    /// Steps of each of the first `count` events along every axis.
    fn steps(&self, count: usize) -> AxisSteps {
        let (case, setting) = (self.case, self.setting);
        let place = |k: usize| case.pixel_place(self.on.pixel[k] as usize);
        let (start_ns, end_ns) = case.span;
        let step_ns = ((end_ns - start_ns) / setting.steps.max(1) as i64).max(1);
        let light = CovariateBins::new(self.on.log_light, setting.steps, 1, false);
        AxisSteps {
            row: (0..count).map(|k| place(k).1 as usize).collect(),
            column: (0..count).map(|k| place(k).0 as usize).collect(),
            time: self
                .on
                .t_ns
                .iter()
                .map(|t| ((t - start_ns) / step_ns).clamp(0, setting.steps as i64 - 1) as usize)
                .collect(),
            step_ns,
            lit: light.of.iter().map(|bin| bin.unwrap_or(0) as usize).collect(),
            lights: light.at.len(),
        }
    }

    /// Least and greatest log photocurrent of events; none where none is known.
    fn light_range(&self, events: impl Iterator<Item = usize>) -> Option<[f64; 2]> {
        let light = events.map(|k| self.on.log_light[k]).filter(|u| u.is_finite());
        light.fold(None, |ends: Option<[f64; 2]>, u| {
            Some(ends.map_or([u, u], |[low, high]| [f64::min(low, u), f64::max(high, u)]))
        })
    }

    /// Name of the polarity with the gain.
    fn polarity_of(&self, on: &MeanGain, off: &MeanGain) -> &'static str {
        if self.stands_out(on, off) {
            "on"
        } else if self.stands_out(off, on) {
            "off"
        } else {
            "both"
        }
    }

    /// Mean gain of the chosen events, and of the others.
    fn means(&self, gains: &[f64], is_chosen: &dyn Fn(usize) -> bool) -> (MeanGain, MeanGain) {
        let blocks = self.on.block.iter().copied().max().map_or(0, |last| last as usize + 1);
        let mut sums = [vec![(0.0, 0.0); blocks], vec![(0.0, 0.0); blocks]];
        for (k, gain) in gains.iter().enumerate() {
            let sum = &mut sums[usize::from(!is_chosen(k))][self.on.block[k] as usize];
            *sum = (sum.0 + gain, sum.1 + 1.0);
        }
        let [chosen, others] = sums.map(|sums| mean_gain(&sums));
        (chosen, others)
    }

    /// Does one part have the gain, and the rest almost none?
    fn stands_out(&self, part: &MeanGain, rest: &MeanGain) -> bool {
        let least = self.setting.least_events;
        let differ = part.gain - rest.gain > self.setting.certain * libm::hypot(part.error, rest.error);
        part.events >= least
            && rest.events >= least
            && part.gain > 0.0
            && rest.gain < self.setting.rest * part.gain
            && differ
    }

    /// The contiguous part of an axis with the gain of the events for which `is_selected` is true. `None`
    /// where it is not significant, or where parts selected on either half of the blocks are not significant
    /// on the other: the best of many parts differs from the rest by chance alone. `at`: the step of each
    /// event.
    fn find_range(
        &self,
        gains: &[f64],
        at: &[usize],
        steps: usize,
        is_selected: &dyn Fn(usize) -> bool,
    ) -> Option<FoundRange> {
        let setting = self.setting;
        let (first, last) = best(gains, at, steps, is_selected, setting.least_events, setting.rim_events)?;
        let sides = |(first, last): (usize, usize), is_selected: &dyn Fn(usize) -> bool| {
            [true, false].map(|wanted| {
                self.means(gains, &|k| is_selected(k) && (first..=last).contains(&at[k]) == wanted).0
            })
        };
        let [inside, outside] = sides((first, last), is_selected);
        let (mut differ, mut error) = (0.0, 0.0);
        for half in 0..2_u32 {
            let is_in = |k: usize| is_selected(k) && self.on.block[k] % 2 == half;
            let chosen = best(gains, at, steps, &is_in, setting.least_events / 2, setting.rim_events / 2)?;
            let [inside, outside] = sides(chosen, &|k| is_selected(k) && self.on.block[k] % 2 != half);
            (differ, error) = (
                differ + inside.gain - outside.gain,
                libm::hypot(error, libm::hypot(inside.error, outside.error)),
            );
        }
        (differ > setting.certain_apart * error && self.stands_out(&inside, &outside)).then_some(FoundRange {
            first,
            last,
            inside,
            outside,
        })
    }

    fn curve(&self, gains: &[f64], bins: &CovariateBins) -> GainCurve {
        let of = |bin: usize| self.means(gains, &|k| bins.of[k] == Some(bin as u32)).0;
        GainCurve { at: bins.at.clone(), gain: (0..bins.at.len()).map(of).collect() }
    }

    /// Name of the gain's covariate, and the index of its curve; the catalogue's own where no other explains
    /// much more.
    fn covariate(&self, gains: &[f64], own: &str) -> (String, Option<usize>) {
        let explained: Vec<f64> = self.bins.iter().map(|(_, bins)| self.explained(gains, bins)).collect();
        let best_of = |is_selected: &dyn Fn(Covariate) -> bool| {
            let selected =
                (0..self.bins.len()).filter(|n| is_selected(self.bins[*n].0) && explained[*n] > 0.0);
            selected.max_by(|a, b| explained[*a].total_cmp(&explained[*b]).then(b.cmp(a)))
        };
        let is_own = |covariate: Covariate| {
            own.split('*').any(|factor| {
                factor == covariate.name() || (factor == "dn" && covariate == Covariate::Photocurrent)
            })
        };
        let own_curve = best_of(&is_own);
        let by_own = own_curve.map_or(0.0, |n| explained[n]);
        // Where every event gains about as much, what little it varies by does not constrain the effect.
        let displaces = |n: &usize| {
            explained[*n] >= self.setting.least_displacing
                && explained[*n] > self.setting.displaces * by_own
                && self.is_uneven(gains, &self.bins[*n].1)
        };
        match best_of(&|_| true).filter(displaces) {
            Some(other) => (self.bins[other].0.name().to_owned(), Some(other)),
            None => (own.to_owned(), own_curve),
        }
    }

    /// Does some bin gain less than a share ([`LocatedSetting::uneven`]) of what the best one gains, per
    /// event?
    fn is_uneven(&self, gains: &[f64], bins: &CovariateBins) -> bool {
        let mut sums = vec![(0.0, 0.0); bins.at.len()];
        for (gain, bin) in gains.iter().zip(&bins.of) {
            if let Some(bin) = bin {
                let sum = &mut sums[*bin as usize];
                *sum = (sum.0 + gain, sum.1 + 1.0);
            }
        }
        let means = sums.iter().filter(|sum| sum.1 > 0.0).map(|sum| sum.0 / sum.1);
        let (least, most) = means.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), mean| {
            (f64::min(least, mean), f64::max(most, mean))
        });
        least < self.setting.uneven * most
    }

    /// Share of the squares of gains that a mean for each bin explains, on the half of the blocks that the
    /// means are not from; 0 where it is not significant.
    fn explained(&self, gains: &[f64], bins: &CovariateBins) -> f64 {
        let blocks = self.on.block.iter().copied().max().map_or(0, |last| last as usize + 1);
        if bins.at.len() < 2 {
            return 0.0;
        }
        let (mut taken, mut counts, mut squares) = (vec![0.0; blocks], vec![0.0; blocks], 0.0);
        for half in 0..2_u32 {
            let mut sums = vec![(0.0, 0.0); bins.at.len() + 1];
            let there = |k: usize| bins.of[k].map_or(bins.at.len(), |bin| bin as usize);
            let (mut all, mut count) = (0.0, 0.0);
            for k in (0..gains.len()).filter(|&k| self.on.block[k] % 2 == half) {
                let sum = &mut sums[there(k)];
                *sum = (sum.0 + gains[k], sum.1 + 1.0);
                (all, count) = (all + gains[k], count + 1.0);
            }
            let middle = all / f64::max(count, 1.0);
            for k in (0..gains.len()).filter(|&k| self.on.block[k] % 2 != half) {
                let (sum, of) = sums[there(k)];
                let own = if of > 0.0 { sum / of } else { middle };
                let (far, left) = (gains[k] - middle, gains[k] - own);
                taken[self.on.block[k] as usize] += far * far - left * left;
                counts[self.on.block[k] as usize] += 1.0;
                squares += far * far;
            }
        }
        let sums: Vec<(f64, f64)> = taken.into_iter().zip(counts).collect();
        let found = mean_gain(&sums);
        let share = found.gain * found.events as f64 / f64::max(squares, 1e-300);
        if share >= self.setting.least_explained && found.gain > self.setting.significant * found.error {
            share
        } else {
            0.0
        }
    }

    fn map(&self, gains: &[f64]) -> GainMap {
        let (width, height) = (self.case.extent.width as usize, self.case.extent.height as usize);
        let share = gains.len().max(1) as f64 / (width * height).max(1) as f64;
        let side = usize::max(
            self.setting.cell,
            libm::ceil(libm::sqrt(self.setting.cell_events as f64 / share)) as usize,
        )
        .max(1);
        let (across, down) = (width.div_ceil(side), height.div_ceil(side));
        let mut map =
            GainMap { side, across, gain: vec![0.0; across * down], events: vec![0; across * down] };
        for (k, gain) in gains.iter().enumerate() {
            let (x, y) = self.case.pixel_place(self.on.pixel[k] as usize);
            let cell = y as usize / side * across + x as usize / side;
            map.gain[cell] += gain;
            map.events[cell] += 1;
        }
        map.gain
            .iter_mut()
            .zip(&map.events)
            .filter(|(_, events)| **events > 0)
            .for_each(|(gain, events)| *gain /= f64::from(*events));
        map
    }

    /// Number of pixels of a part around which (3 x 3 cells) events gain more than `least`.
    fn count_gaining_pixels(&self, map: &GainMap, rows: [u32; 2], columns: [u32; 2], least: f64) -> u64 {
        let side = map.side;
        let cells = |range: [u32; 2]| range[0] as usize / side..=range[1] as usize / side;
        let within = |range: [u32; 2], cell: usize| {
            let (from, to) = (
                usize::max(range[0] as usize, cell * side),
                usize::min(range[1] as usize, (cell + 1) * side - 1),
            );
            (to + 1).saturating_sub(from) as u64
        };
        let mut pixels = 0;
        for row in cells(rows) {
            for column in cells(columns) {
                let near = |at: usize, range: [u32; 2]| {
                    usize::max(at.saturating_sub(1), *cells(range).start())
                        ..=usize::min(at + 1, *cells(range).end())
                };
                let around =
                    near(row, rows).flat_map(|y| near(column, columns).map(move |x| y * map.across + x));
                let (gain, events) = around.fold((0.0, 0.0), |(gain, events), cell| {
                    let count = f64::from(map.events[cell]);
                    (gain + count * map.gain[cell], events + count)
                });
                if events > 0.0 && gain > least * events {
                    pixels += within(rows, row) * within(columns, column);
                }
            }
        }
        pixels
    }
}

#[cfg(test)]
#[path = "located_tests.rs"]
mod tests;
