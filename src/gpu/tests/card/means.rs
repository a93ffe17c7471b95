//! Means of light over exposures, against the integrals of the processor.

use crate::card;
use photocurrent_core::Exposure;
use photocurrent_core::random::Random;
use photocurrent_gpu::CardOptions;
use photocurrent_sensor::exposure::{HeldTrack, LogLinearTrack};
use photocurrent_sensor::integrate::{Columns, ExposedRow, Integrate};

const PIXELS: usize = 300;
/// A clock that counts since 1970.
const FAR_NS: i64 = 1_700_000_000_000_000_000;

#[derive(Default)]
struct Tracks {
    offsets: Vec<usize>,
    t_ns: Vec<i64>,
    light: Vec<f32>,
    sigma: Vec<f32>,
}

impl Tracks {
    /// Pixels of up to 60 knots in 20 ms from `origin_ns` on, some without any; with jumps, the dark, light
    /// that rises by twenty orders of magnitude, and first knots that are as good as never.
    fn new(origin_ns: i64) -> Tracks {
        let mut random = Random::new(3, &[]);
        let mut tracks = Tracks::default();
        for pixel in 0..PIXELS {
            tracks.offsets.push(tracks.t_ns.len());
            let count = if pixel % 9 == 4 { 0 } else { 1 + (random.uniform() * 60.0) as usize };
            let mut t: Vec<i64> = (0..count).map(|_| origin_ns + (random.uniform() * 20e6) as i64).collect();
            t.sort_unstable();
            if count > 3 && pixel % 4 == 0 {
                t[2] = t[1];
            }
            if count > 0 && pixel % 5 == 0 {
                t[0] = i64::MIN / 4;
            }
            tracks.t_ns.extend(&t);
            for k in 0..count {
                let log =
                    2.0 + 1.5 * random.normal() + if pixel % 7 == 3 { 20.0 * random.normal() } else { 0.0 };
                let is_dark = pixel % 11 == 2 && k % 3 == 1;
                tracks.light.push(if is_dark { 0.0 } else { libm::exp(log.clamp(-70.0, 70.0)) as f32 });
                tracks.sigma.push(libm::exp(-3.0 + random.normal()) as f32);
            }
        }
        tracks.offsets.push(tracks.t_ns.len());
        tracks
    }

    fn columns(&self, is_linear: bool, with_sigma: bool) -> Columns<'_> {
        let sigma: &[f32] = if with_sigma { &self.sigma } else { &[] };
        Columns { offsets: &self.offsets, t_ns: &self.t_ns, light: &self.light, sigma, is_linear }
    }
}

/// Three rows of the pixels, the last two apart, each later than the one before, with short and long
/// exposures that overlap.
fn rows(origin_ns: i64) -> Vec<ExposedRow> {
    [0..100, 100..180, 200..PIXELS]
        .into_iter()
        .zip(0..)
        .map(|(pixels, row)| {
            let exposure = |n: i64| {
                let start = origin_ns - 1_000_000 + 237_000 * n + 31_000 * row;
                Exposure::new(start, start + [100_000, 37, 4_000_000][n as usize % 3])
            };
            ExposedRow { pixels, exposures: (0..100).map(exposure).collect() }
        })
        .collect()
}

/// Light and spread of each exposure and pixel of each row.
type Means = Vec<Vec<(Vec<f32>, Vec<f32>)>>;

fn means(card: &impl Integrate, columns: Columns<'_>, rows: &[ExposedRow]) -> (Means, Vec<usize>) {
    let mut all: Means = rows.iter().map(|_| Vec::new()).collect();
    let left = card.means(columns, rows, &mut |means| {
        assert_eq!(means.exposure, all[means.row].len(), "exposures of a row come in order");
        all[means.row].push((means.light.to_vec(), means.spread.to_vec()));
    });
    (all, left.expect("the card integrates"))
}

#[test]
fn means_are_those_of_the_processor() {
    let Some(card) = card(CardOptions::default()) else { return };
    let (mut most, mut compared) = (0.0, 0);
    for (origin_ns, is_linear, with_sigma) in
        [(0, true, true), (FAR_NS, true, false), (-5_000_000, false, true), (FAR_NS, false, false)]
    {
        let (tracks, rows) = (Tracks::new(origin_ns), rows(origin_ns));
        let (found, left) = means(&card, tracks.columns(is_linear, with_sigma), &rows);
        assert!(left.is_empty(), "all rows are taken");
        for (row, found) in rows.iter().zip(&found) {
            assert_eq!(found.len(), row.exposures.len());
            for (exposure, (light, spread)) in row.exposures.iter().zip(found) {
                assert_eq!((light.len(), spread.is_empty()), (row.pixels.len(), !with_sigma));
                for (n, pixel) in row.pixels.clone().enumerate() {
                    let range = tracks.offsets[pixel]..tracks.offsets[pixel + 1];
                    if range.is_empty() {
                        assert!(light[n].is_nan() && spread.get(n).is_none_or(|spread| spread.is_nan()));
                        continue;
                    }
                    let (t, light_of) = (&tracks.t_ns[range.clone()], &tracks.light[range.clone()]);
                    let times = |k: usize| light_of[k] * tracks.sigma[range.clone()][k];
                    let spread_of: Vec<f32> = (0..t.len()).map(times).collect();
                    let linear = |light: &[f32]| LogLinearTrack::new(t, light).integral(*exposure);
                    let of_light = if is_linear {
                        linear(light_of)
                    } else {
                        HeldTrack::new(t, light_of).integral(*exposure)
                    };
                    let mut hold = |found: f32, integral: f64, what: &str| {
                        let expected = integral / exposure.seconds();
                        // Where there is no light at all, what a photocurrent of zero counts as is no light.
                        let apart = (f64::from(found) - expected).abs() / f64::max(expected, 1e-30);
                        assert!(
                            apart < 2e-5,
                            "{what} of {pixel}, {exposure:?}: {found}, expected {expected} ({apart:.1e})"
                        );
                        (most, compared) = (f64::max(most, apart), compared + 1);
                    };
                    hold(light[n], of_light, "light");
                    if with_sigma {
                        hold(spread[n], linear(&spread_of), "spread");
                    }
                }
            }
        }
    }
    #[allow(clippy::print_stdout)]
    {
        println!("{compared} means differ by {most:.1e} of their size at most");
    }
}

#[test]
fn a_small_pool_and_other_rows_change_no_mean() {
    let (Some(card), Some(small)) =
        (card(CardOptions::default()), card(CardOptions { pool_bytes: 1 << 20, ..CardOptions::default() }))
    else {
        return;
    };
    let (mut tracks, rows) = (Tracks::new(0), rows(0));
    let bits = |means: &Means| -> Vec<u32> {
        let values = means.iter().flatten().flat_map(|(light, spread)| light.iter().chain(spread));
        values.map(|value| value.to_bits()).collect()
    };
    let columns = tracks.columns(true, true);
    let (whole, _) = means(&card, columns, &rows);
    assert_eq!(bits(&whole), bits(&means(&small, columns, &rows).0));
    assert_eq!(bits(&whole[1..2].to_vec()), bits(&means(&card, columns, &rows[1..2]).0));
    // Not even a row fits; and numbers that are not finite stay here.
    let tiny = crate::card(CardOptions { pool_bytes: 1 << 12, ..CardOptions::default() }).expect("the card");
    assert_eq!(means(&tiny, columns, &rows).1, [0, 1, 2]);
    let knot = tracks.offsets[150];
    tracks.light[knot] = f32::INFINITY;
    let (found, left) = means(&card, tracks.columns(true, true), &rows);
    assert_eq!(left, [1]);
    assert!(found[1].is_empty() && bits(&found[2..].to_vec()) == bits(&whole[2..].to_vec()));
}
