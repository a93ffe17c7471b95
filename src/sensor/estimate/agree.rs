//! Which of several readings of a recording agrees best: the share of the frames' log change that events
//! explain, on pairs of frames that were not fitted.
//!
//! Tiles of some pairs of frames hold the log change of each pixel ([`Changes`]). Each reading (another unit,
//! another offset, a mirrored picture, ...) sorts the same events into counts of its own ([`Trial`]). The
//! counts are fitted to the changes on half of the pairs, with two thresholds that are not negative and,
//! where a trial fits one, an offset in time; what the fit explains is measured on the other half, and the
//! same with the halves exchanged. All trials are measured on the same pixels, so that a reading that brings
//! no event between the frames explains none of their change.
//!
//! Limits: a change of all tiles of a pair alike is taken out (an exposure that adapts). Neighbouring pairs
//! share a frame, whose noise is then in both halves.

use super::draw::{Estimate, by_draws, peak};
use super::panel::Centring;

/// Pixels in a row and in a column of a tile.
pub const TILE: usize = 8;
/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;
/// Values beyond this share of a pair's are brought to it: a hot pixel or a lamp would be all that is seen.
const KEPT: f64 = 0.997;
/// Steps of time from frame to frame where an offset is fitted.
pub const STEPS: i64 = 12;

/// Log changes of pairs of frames, tile by tile.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// First tile of each pair, and one more: the number of tiles.
    first: Vec<usize>,
    /// [tile][y][x]; zero where it is not known.
    change: Vec<f32>,
    /// The unit that each tile belongs to: what is drawn anew as a whole for intervals.
    unit: Vec<usize>,
    units: usize,
}

impl Changes {
    /// Adds a pair of frames: its tiles in order, each with the part of the picture that it belongs to (for
    /// intervals) and the log change of its [`TILE`] squared pixels. A value that is not finite is not known.
    pub fn push(&mut self, tiles: &[(usize, Vec<f32>)]) {
        if self.first.is_empty() {
            self.first.push(0);
        }
        let mut known: Vec<f32> = tiles
            .iter()
            .flat_map(|(_, change)| change)
            .copied()
            .filter(|change| change.is_finite())
            .collect();
        let middle = median(&mut known);
        let mut sizes: Vec<f32> = known.iter().map(|change| (change - middle).abs()).collect();
        let limit = quantile(&mut sizes, KEPT);
        let mut parts: Vec<usize> = tiles.iter().map(|(part, _)| *part).collect();
        parts.sort_unstable();
        parts.dedup();
        for (part, change) in tiles {
            let value = |n: usize| {
                change
                    .get(n)
                    .filter(|change| change.is_finite())
                    .map_or(0.0, |change| (change - middle).clamp(-limit, limit))
            };
            self.change.extend((0..PIXELS).map(value));
            self.unit.push(self.units + parts.partition_point(|other| other < part));
        }
        self.units += parts.len();
        self.first.push(self.unit.len());
    }

    /// Pairs of frames.
    pub fn pairs(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    fn tiles(&self, pair: usize) -> usize {
        self.first[pair + 1] - self.first[pair]
    }
}

/// The time of one pair in one reading.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Window {
    /// Middles of both exposures, ns.
    mids_ns: (i64, i64),
    /// Start of the first step, and length of one, ns.
    start_ns: i64,
    step_ns: i64,
    steps: usize,
    /// Where its counts begin.
    at: usize,
    tiles: usize,
}

/// The events of one reading, counted by pair, step, tile and pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    windows: Vec<Option<Window>>,
    /// Windows by their start: (start, latest end so far, pair).
    order: Vec<(i64, i64, usize)>,
    on: Vec<u8>,
    off: Vec<u8>,
    period_ns: i64,
    fits_offset: bool,
}

impl Trial {
    /// For the pairs of `changes`, whose middles this reading puts at `mids_ns` (a pair whose middles do not
    /// rise holds no event). With `fits_offset` an offset of up to a period to each side is fitted.
    pub fn new(changes: &Changes, mids_ns: &[(i64, i64)], fits_offset: bool) -> Trial {
        let length = |mids: &(i64, i64)| mids.1.saturating_sub(mids.0);
        let mut periods: Vec<i64> = mids_ns.iter().map(length).filter(|period| *period > 0).collect();
        periods.sort_unstable();
        let period_ns = periods.get(periods.len() / 2).copied().unwrap_or(1);
        let mut at = 0;
        let window = |(pair, mids): (usize, &(i64, i64))| {
            // A pair around a gap is no pair of neighbours: with steps it would take memory for the gap.
            let is_pair =
                length(mids) > 0 && length(mids) < period_ns.saturating_mul(4) && pair < changes.pairs();
            is_pair.then(|| {
                let reach_ns = if fits_offset { period_ns } else { 0 };
                let step_ns = if fits_offset { (period_ns / STEPS).max(1) } else { length(mids) };
                let start_ns = mids.0.saturating_sub(reach_ns);
                let steps = if fits_offset {
                    (length(mids).saturating_add(reach_ns.saturating_mul(2)) / step_ns + 2) as usize
                } else {
                    1
                };
                let window =
                    Window { mids_ns: *mids, start_ns, step_ns, steps, at, tiles: changes.tiles(pair) };
                at += steps * window.tiles * PIXELS;
                window
            })
        };
        let windows: Vec<Option<Window>> = mids_ns.iter().enumerate().map(window).collect();
        let end = |window: &Window| {
            window.start_ns.saturating_add(window.step_ns.saturating_mul(window.steps as i64))
        };
        let mut order: Vec<(i64, i64, usize)> = windows
            .iter()
            .enumerate()
            .filter_map(|(pair, window)| window.as_ref().map(|window| (window.start_ns, end(window), pair)))
            .collect();
        order.sort_unstable();
        let mut latest = i64::MIN;
        order.iter_mut().for_each(|(_, end, _)| {
            latest = latest.max(*end);
            *end = latest;
        });
        Trial { windows, order, on: vec![0; at], off: vec![0; at], period_ns, fits_offset }
    }

    /// The middle time from frame to frame in this reading, ns.
    pub fn period_ns(&self) -> i64 {
        self.period_ns
    }

    /// Takes an event at this reading's time. `tile_of` gives the tile, counted within its pair, and the
    /// pixel within the tile that the event falls on; none beyond all tiles.
    #[inline]
    pub fn event(&mut self, t_ns: i64, is_on: bool, tile_of: impl Fn(usize) -> Option<(usize, usize)>) {
        let after = self.order.partition_point(|(start, ..)| *start <= t_ns);
        for n in (0..after).rev() {
            let (_, latest_end, pair) = self.order[n];
            if latest_end <= t_ns {
                break;
            }
            let Some(window) = self.windows[pair] else { continue };
            let step = (t_ns.saturating_sub(window.start_ns) / window.step_ns) as usize;
            if step >= window.steps {
                continue;
            }
            if let Some((tile, pixel)) =
                tile_of(pair).filter(|(tile, pixel)| *tile < window.tiles && *pixel < PIXELS)
            {
                let counts = if is_on { &mut self.on } else { &mut self.off };
                let count = &mut counts[window.at + (step * window.tiles + tile) * PIXELS + pixel];
                *count = count.saturating_add(1);
            }
        }
    }

    /// Counts of a pair's pixels between the two middles, both later by `offset_ns`; less the mean, with the
    /// largest brought in.
    fn between(&self, pair: usize, counts: &[u8], offset_ns: f64) -> Option<Vec<f32>> {
        let window = self.windows[pair]?;
        let at = |t: i64| (t.saturating_sub(window.start_ns) as f64 + offset_ns) / window.step_ns as f64;
        let (from, to) = (at(window.mids_ns.0), at(window.mids_ns.1));
        let mut sums = vec![0.0f32; window.tiles * PIXELS];
        for step in 0..window.steps {
            let part = (to.min(step as f64 + 1.0) - from.max(step as f64)).clamp(0.0, 1.0) as f32;
            if part > 0.0 {
                let counts = &counts[window.at + step * sums.len()..][..sums.len()];
                sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += part * f32::from(*count));
            }
        }
        let mut some: Vec<f32> = sums.iter().copied().filter(|sum| *sum > 0.0).collect();
        if some.is_empty() {
            return None;
        }
        let limit = quantile(&mut some, KEPT);
        sums.iter_mut().for_each(|sum| *sum = sum.min(limit));
        let mean = sums.iter().sum::<f32>() / sums.len() as f32;
        sums.iter_mut().for_each(|sum| *sum -= mean);
        Some(sums)
    }
}

/// When light changed, from when events came, for readings that scale time: an event with the time by which
/// [`Centring`] would put it earlier.
#[derive(Clone, Debug)]
pub struct Waits(Centring);

impl Waits {
    /// For so many pixels.
    pub fn new(pixels: usize) -> Waits {
        Waits(Centring::new(pixels, i64::MAX))
    }

    /// Takes the next event of a pixel and gives the one that waited: its stamp, by how much the middle of
    /// its change is earlier, and its sign.
    #[inline]
    #[must_use]
    pub fn next(&mut self, pixel: usize, t_ns: i64, is_on: bool) -> Option<(i64, i64, bool)> {
        // The first event of a pixel is taken too, and gives none.
        let stamp = self.0.waits(pixel).unwrap_or(t_ns);
        self.0.next(pixel, t_ns, is_on).map(|(t, was_on)| (stamp, stamp.saturating_sub(t), was_on))
    }

    /// Every pixel whose last event still waits, with that event as [`Waits::next`] gives it.
    pub fn rest(&self) -> impl Iterator<Item = (usize, i64, i64, bool)> + '_ {
        self.0.rest().filter_map(|(pixel, t, is_on)| {
            self.0.waits(pixel).map(|stamp| (pixel, stamp, stamp.saturating_sub(t), is_on))
        })
    }
}

/// How well a reading agrees with the frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Share of the variance of the frames' log change that the events explain, on held-out pairs; 1 = all, 0
    /// = none, negative = worse than no events.
    pub explained: Estimate,
    /// How much more the best reading explains, from the same draws; zero for the best itself.
    pub behind: Estimate,
    /// Correlation of the prediction with the change on held-out pairs.
    pub correlation: f64,
    /// The fitted offset, ns: events are later by so much; zero where none is fitted.
    pub offset_ns: f64,
    /// The fitted thresholds, ON and OFF, natural-log units.
    pub thresholds: (f64, f64),
    /// Pairs with events between the frames.
    pub pairs: usize,
}

/// Sums over some pixels: ON x ON, ON x OFF, OFF x OFF, ON x change, OFF x change, change x change.
type Moments = [f64; 6];

/// What a trial counts at one offset: moments of each tile, and the pairs with events.
struct Counted {
    tiles: Vec<Moments>,
    pairs: usize,
}

impl Counted {
    fn of(changes: &Changes, trial: &Trial, offset_ns: f64) -> Counted {
        let mut counted = Counted { tiles: vec![[0.0; 6]; changes.unit.len()], pairs: 0 };
        for pair in 0..changes.pairs().min(trial.windows.len()) {
            let (on, off) =
                (trial.between(pair, &trial.on, offset_ns), trial.between(pair, &trial.off, offset_ns));
            counted.pairs += usize::from(on.is_some() || off.is_some());
            for tile in 0..changes.tiles(pair) {
                let change = &changes.change[(changes.first[pair] + tile) * PIXELS..][..PIXELS];
                let of = |counts: &Option<Vec<f32>>, n: usize| {
                    counts.as_ref().map_or(0.0, |counts| f64::from(counts[tile * PIXELS + n]))
                };
                let moments = &mut counted.tiles[changes.first[pair] + tile];
                for (n, change) in change.iter().enumerate() {
                    let (a, b, y) = (of(&on, n), of(&off, n), f64::from(*change));
                    moments
                        .iter_mut()
                        .zip([a * a, a * b, b * b, a * y, b * y, y * y])
                        .for_each(|(sum, more)| *sum += more);
                }
            }
        }
        counted
    }

    /// Summed over the pairs that `takes` takes.
    fn total(&self, changes: &Changes, takes: impl Fn(usize) -> bool) -> Moments {
        let tiles = (0..changes.pairs())
            .filter(|pair| takes(*pair))
            .flat_map(|pair| changes.first[pair]..changes.first[pair + 1]);
        tiles.fold([0.0; 6], |total, tile| std::array::from_fn(|n| total[n] + self.tiles[tile][n]))
    }
}

/// Thresholds that fit best, not negative.
fn fit(&[aa, ab, bb, ay, by, _]: &Moments) -> (f64, f64) {
    // Change = on x ON events - off x OFF events.
    let one = |product: f64, square: f64| if square > 0.0 { (product / square).max(0.0) } else { 0.0 };
    let determinant = aa * bb - ab * ab;
    let (on, off) = ((ay * bb - by * ab) / determinant, (ay * ab - by * aa) / determinant);
    if determinant > 1e-9 * aa * bb && on >= 0.0 && off >= 0.0 {
        return (on, off);
    }
    let (only_on, only_off) = ((one(ay, aa), 0.0), (0.0, one(-by, bb)));
    let left = |of: (f64, f64)| residual(&[aa, ab, bb, ay, by, 0.0], of);
    if left(only_on) <= left(only_off) { only_on } else { only_off }
}

/// Squares that thresholds leave.
fn residual(&[aa, ab, bb, ay, by, yy]: &Moments, (on, off): (f64, f64)) -> f64 {
    yy + on * on * aa + off * off * bb - 2.0 * on * off * ab - 2.0 * on * ay + 2.0 * off * by
}

/// Measured on held-out pairs: squares of the change, squares that are left, products and squares of the
/// prediction, by unit.
struct Measured {
    units: Vec<[f64; 4]>,
    offset_ns: f64,
    thresholds: (f64, f64),
    pairs: usize,
}

impl Measured {
    fn of(changes: &Changes, trial: &Trial) -> Measured {
        let step_ns = trial.period_ns as f64 / STEPS as f64;
        let offsets: Vec<f64> = if trial.fits_offset {
            (-STEPS..=STEPS).map(|n| n as f64 * step_ns).collect()
        } else {
            vec![0.0]
        };
        let counted: Vec<Counted> =
            offsets.iter().map(|offset| Counted::of(changes, trial, *offset)).collect();
        let left = |takes: &dyn Fn(usize) -> bool| -> Vec<f64> {
            counted
                .iter()
                .map(|counted| counted.total(changes, takes))
                .map(|total| -residual(&total, fit(&total)))
                .collect()
        };
        // Of equal offsets (no events at any) the one nearest none.
        let best = |left: &[f64]| {
            (0..left.len())
                .max_by(|a, b| {
                    left[*a].total_cmp(&left[*b]).then(offsets[*b].abs().total_cmp(&offsets[*a].abs()))
                })
                .unwrap_or(0)
        };
        let mut units = vec![[0.0; 4]; changes.units];
        for half in 0..2 {
            let chosen = &counted[best(&left(&|pair| pair % 2 == half))];
            let (on, off) = fit(&chosen.total(changes, |pair| pair % 2 == half));
            for pair in (0..changes.pairs()).filter(|pair| pair % 2 != half) {
                for tile in changes.first[pair]..changes.first[pair + 1] {
                    let moments = &chosen.tiles[tile];
                    let [aa, ab, bb, ay, by, yy] = *moments;
                    let predicted = on * on * aa + off * off * bb - 2.0 * on * off * ab;
                    let more = [yy, residual(moments, (on, off)), on * ay - off * by, predicted];
                    units[changes.unit[tile]].iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
                }
            }
        }
        let all = left(&|_| true);
        let at = best(&all);
        let between = peak(&all, at).map_or(0.0, |top| (top - at as f64) * step_ns);
        let thresholds = fit(&counted[at].total(changes, |_| true));
        Measured {
            units,
            offset_ns: offsets[at] + if trial.fits_offset { between } else { 0.0 },
            thresholds,
            pairs: counted[at].pairs,
        }
    }

    fn total(&self, weights: &[f64]) -> [f64; 4] {
        self.units
            .iter()
            .zip(weights)
            .fold([0.0; 4], |total, (sums, weight)| std::array::from_fn(|n| total[n] + weight * sums[n]))
    }

    fn explained(&self, weights: &[f64]) -> Option<f64> {
        let [all, left, ..] = self.total(weights);
        (all > 0.0).then(|| 1.0 - left / all)
    }
}

/// How well each trial agrees with the changes, in the order of `trials`; none where there are fewer than two
/// pairs of frames, or nothing changes in them.
pub fn agreements(changes: &Changes, trials: &[Trial]) -> Option<Vec<Agreement>> {
    if changes.pairs() < 2 || changes.units < 2 || trials.is_empty() {
        return None;
    }
    let measured: Vec<Measured> = trials.iter().map(|trial| Measured::of(changes, trial)).collect();
    let ones = vec![1.0; changes.units];
    let explained: Vec<f64> = measured.iter().map(|one| one.explained(&ones)).collect::<Option<_>>()?;
    let best = (0..explained.len()).max_by(|a, b| explained[*a].total_cmp(&explained[*b]).then(b.cmp(a)))?;
    let agreement = |one: &Measured| {
        let [all, _, product, predicted] = one.total(&ones);
        Some(Agreement {
            explained: by_draws(changes.units, |weights| one.explained(weights))?,
            behind: by_draws(changes.units, |weights| {
                Some(measured[best].explained(weights)? - one.explained(weights)?)
            })?,
            correlation: if all * predicted > 0.0 { product / (all * predicted).sqrt() } else { 0.0 },
            offset_ns: one.offset_ns,
            thresholds: one.thresholds,
            pairs: one.pairs,
        })
    };
    measured.iter().map(agreement).collect()
}

fn median(values: &mut [f32]) -> f32 {
    let half = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(half, f32::total_cmp).1 }
}

fn quantile(values: &mut [f32], share: f64) -> f32 {
    let at = (values.len().saturating_sub(1) as f64 * share) as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    const PERIOD: i64 = 10_000_000;
    const PAIRS: usize = 8;
    const TILES: usize = 12;

    /// A random change of every pixel in every pair, constant over its period; events at whole thresholds of
    /// 0.2 and 0.3.
    fn changes(random: &mut Random) -> Changes {
        let mut changes = Changes::default();
        for _ in 0..PAIRS {
            let tiles: Vec<(usize, Vec<f32>)> = (0..TILES)
                .map(|tile| (tile / 3, (0..PIXELS).map(|_| 0.7 * random.normal() as f32).collect()))
                .collect();
            changes.push(&tiles);
        }
        changes
    }

    fn mids(late_ns: i64) -> Vec<(i64, i64)> {
        (0..PAIRS as i64).map(|pair| (pair * PERIOD + late_ns, (pair + 1) * PERIOD + late_ns)).collect()
    }

    fn events(changes: &Changes, mut each: impl FnMut(i64, bool, usize, usize, usize)) {
        for pair in 0..PAIRS {
            for tile in 0..TILES {
                for pixel in 0..PIXELS {
                    let change = f64::from(changes.change[(pair * TILES + tile) * PIXELS + pixel]);
                    let count = (change.abs() / if change > 0.0 { 0.2 } else { 0.3 }).round() as i64;
                    (0..count).for_each(|n| {
                        each(
                            pair as i64 * PERIOD + (2 * n + 1) * PERIOD / (2 * count),
                            change > 0.0,
                            pair,
                            tile,
                            pixel,
                        )
                    });
                }
            }
        }
    }

    /// What events explain when a trial sees them at other times, of other pixels, or with the other sign.
    fn of(mids_ns: &[(i64, i64)], fits_offset: bool, shift: usize, swaps: bool) -> Vec<Agreement> {
        let changes = changes(&mut Random::new(5, &[]));
        let mut trials =
            vec![Trial::new(&changes, &mids(0), false), Trial::new(&changes, mids_ns, fits_offset)];
        events(&changes, |t, is_on, pair, tile, pixel| {
            trials[0].event(t, is_on, |at| (at == pair).then_some((tile, pixel)));
            trials[1].event(t, is_on != swaps, |_| Some((tile, (pixel + shift) % PIXELS)));
        });
        agreements(&changes, &trials).unwrap()
    }

    #[test]
    fn events_that_are_the_change_explain_it_with_its_thresholds() {
        let right = of(&mids(0), false, 0, false)[0];
        assert!(
            right.explained.value > 0.95 && right.explained.ci95.0 > 0.9 && right.correlation > 0.97,
            "{right:?}"
        );
        assert!(
            (right.thresholds.0 - 0.2).abs() < 0.02
                && (right.thresholds.1 - 0.3).abs() < 0.03
                && right.pairs == PAIRS,
            "{right:?}"
        );
        assert_eq!(right.behind, Estimate { value: 0.0, ci95: (0.0, 0.0) });
    }

    #[test]
    fn other_pixels_other_signs_and_other_times_are_behind() {
        let late: Vec<(i64, i64)> = mids(1_000 * PERIOD);
        for wrong in [
            of(&mids(0), false, 1, false)[1],
            of(&mids(0), false, 0, true)[1],
            of(&late, false, 0, false)[1],
            of(&mids(PERIOD / 2), false, 0, false)[1],
        ] {
            assert!(wrong.explained.value < 0.7 && wrong.behind.ci95.0 > 0.25, "{wrong:?}");
        }
        // Without an event between the frames nothing is explained, and nothing is lost.
        let none = of(&late, false, 0, false)[1];
        assert!(
            none.explained.value.abs() < 1e-9 && none.pairs == 0 && none.thresholds == (0.0, 0.0),
            "{none:?}"
        );
    }

    #[test]
    fn a_fitted_offset_is_the_one_that_was_made() {
        let found = of(&mids(-4_000_000), true, 0, false)[1];
        assert!((found.offset_ns - 4e6).abs() < 0.4e6 && found.explained.value > 0.9, "{found:?}");
        // Of another picture an offset explains no more than chance.
        let wrong = of(&mids(-4_000_000), true, 5, false)[1];
        assert!(wrong.explained.value < 0.05 && wrong.behind.ci95.0 > 0.8, "{wrong:?}");
    }

    #[test]
    fn fewer_than_two_pairs_decide_nothing() {
        let mut changes = Changes::default();
        assert_eq!(agreements(&changes, &[]), None);
        changes.push(&[(0, vec![1.0; PIXELS]), (1, vec![f32::NAN; 3])]);
        let trial = Trial::new(&changes, &[(0, PERIOD)], true);
        assert_eq!(agreements(&changes, &[trial]), None);
    }
}
