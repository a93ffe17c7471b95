//! A scene in parts: one moving picture where it predicts frames, and elsewhere pictures of tiles of the
//! array for a few frames each.
//!
//! Whether a tile has a picture of its own is decided by frame values alone: those that change and that
//! either predicts within the noise.

use crate::case::Case;
use crate::light::LogLight;
use crate::moving::MovingPicture;
use crate::nominal::Nominal;
use crate::picture::begin::images;
use crate::picture::motion::{AffineMap, apply, compose};
pub use crate::picture::patches::PatchSetting;
use crate::picture::patches::{
    LEAST_EVENTS, MOVES, PatchPart, PicturePatch, TURN, follow_motion, foreground, ground,
};
use crate::picture::register::{RegisterSearch, register};
use crate::picture::{FRAME_NOISE, FitStart, PictureSetting, ScenePicture};
use crate::scene::{FrameTolerance, Scene, usual_step_dn};
use crate::statistics::{MEDIAN_NORMAL, median};
use rayon::prelude::*;
use std::ops::Range;

/// The moving picture needs no help where the median of its residuals is below this, standard deviations as
/// first assumed.
const WELL: f64 = 2.0;
/// Number of parts that are tried first: those with the most events.
const PROBES: usize = 8;
/// Fewer of them than this share that are better mean that parts do not help.
const HELPED: f64 = 0.4;
/// Least share of a pixel's frames that agree on its ground.
const AGREED: f64 = 0.35;
/// There is a still ground where more than this share of the pixels has one.
const STILL: f64 = 0.6;
/// A part predicts at least this share of its tile's moving values.
const LEAST_PREDICTED: f64 = 0.5;
/// And so much more than the moving picture.
const BETTER: f64 = 0.1;
/// A value is predicted where its residual is below [`crate::scene::STEP`] of a threshold, or this many usual
/// residuals.
const SPREAD: f64 = 4.5;

/// The moving picture, and pictures of parts where they are better.
pub struct PictureMosaic {
    whole: Option<MovingPicture>,
    patches: Vec<PicturePatch>,
    /// The tile of each patch.
    tile: Vec<usize>,
    tiles: Vec<(Range<u32>, Range<u32>)>,
    setting: PatchSetting,
    /// How pictures of parts are fitted.
    of_parts: PictureSetting,
    /// Which frame values belong to something that moves.
    moves: Vec<bool>,
    residual: Vec<f32>,
    misfit: f64,
    /// Largest residual of a predicted value, DN.
    least_dn: f64,
}

/// Fits a scene to the frames of a recording: one picture, and pictures of parts where it does not predict
/// them and they do.
///
/// # Errors
/// When neither predicts anything, with the reason of [`ScenePicture::fit`].
pub fn scene(
    case: &Case,
    nominal: &Nominal,
    whole: &PictureSetting,
    setting: &PatchSetting,
) -> Result<Box<dyn Scene>, String> {
    scene_where(case, nominal, whole, setting, None)
}

/// The same, to the values of selected pixels ([`FitStart::selected`]); it predicts no others.
///
/// # Errors
/// As [`scene`].
pub fn scene_where(
    case: &Case,
    nominal: &Nominal,
    whole: &PictureSetting,
    setting: &PatchSetting,
    selected: Option<&[bool]>,
) -> Result<Box<dyn Scene>, String> {
    let of_whole = whole;
    let mut whole = MovingPicture::fit_where(case, nominal, of_whole, selected);
    if case.frame_count() < 3 || case.extent.width.min(case.extent.height) < 8 {
        return whole.map(|whole| Box::new(whole) as Box<dyn Scene>);
    }
    let tiles = setting.tiles(case.extent);
    let mut still = ground(case, nominal, FRAME_NOISE, MOVES, AGREED);
    let is_there =
        still.iter().filter(|ground| ground.is_finite()).count() as f64 > STILL * still.len() as f64;
    if !is_there {
        still.fill(f64::NAN);
    }
    let mut moves = foreground(case, nominal, &still, FRAME_NOISE, MOVES);
    if let Some(selected) = selected {
        moves.iter_mut().enumerate().for_each(|(n, moves)| *moves &= selected[n % selected.len()]);
    }
    let ground = is_there.then(|| light_of_ground(case, nominal, &still));
    let everywhere = (0..case.extent.width, 0..case.extent.height);
    let misses = |picture: &ScenePicture| {
        median_residual(case, nominal, &moves, &everywhere, &(0..case.frame_count()), |l, x, y| {
            picture_residual(case, picture, l, x, y)
        })
    };
    let of_one = whole.as_ref().map_or(f64::INFINITY, |whole| misses(&whole.picture));
    if let Some(ground) = ground.as_ref().filter(|_| of_one > WELL) {
        let before = before_ground(case, nominal, of_whole, &moves, (ground, selected));
        if misses(&before) < of_one {
            whole = Ok(MovingPicture::new(before, of_whole, case, nominal));
        }
    }
    let mut found = PictureMosaic {
        whole: whole.as_ref().ok().map(|whole| whole.with_picture(whole.picture.clone())),
        patches: Vec::new(),
        tile: Vec::new(),
        tiles,
        setting: *setting,
        of_parts: of_whole.for_parts(),
        moves,
        residual: Vec::new(),
        misfit: 1.0,
        least_dn: usual_step_dn(case, nominal),
    };
    let changes = found.moves.clone();
    let needed = found.poorly_predicted_tiles(case, nominal, &changes);
    let fit = |list: &[(usize, Range<usize>)]| found.fit(case, nominal, &changes, ground.as_deref(), list);
    let probes = PROBES.min(needed.len());
    let mut fitted = fit(&needed[..probes]);
    let better = |fitted: &[(usize, PicturePatch)]| found.better(case, nominal, &changes, fitted);
    let helped = better(&fitted).iter().filter(|is| **is).count();
    if helped == 0 || (helped as f64) < HELPED * probes as f64 {
        return whole.map(|whole| Box::new(MovingPicture { is_one: helped == 0, ..whole }) as Box<dyn Scene>);
    }
    fitted.extend(fit(&needed[probes..]));
    let is_better = better(&fitted);
    for ((tile, patch), _) in fitted.into_iter().zip(is_better).filter(|(_, is)| *is) {
        found.tile.push(tile);
        found.patches.push(patch);
    }
    found.compare(case);
    Ok(Box::new(found))
}

/// The photocurrent of a still ground from its values, DN.
fn light_of_ground(case: &Case, nominal: &Nominal, ground: &[f64]) -> Vec<f32> {
    let seconds = case
        .frames
        .as_ref()
        .and_then(|frames| frames.times.nominal_exposure_ns())
        .map_or(1.0, |ns| ns as f64 * 1e-9);
    ground
        .iter()
        .map(|dn| ((dn - nominal.number.black_level) / (nominal.number.gain * seconds)) as f32)
        .collect()
}

/// One picture that moves before a still ground, turning and shifting as neighbouring frames do, or shifting
/// steadily.
fn before_ground(
    case: &Case,
    nominal: &Nominal,
    of_picture: &PictureSetting,
    moves: &[bool],
    (ground, selected): (&[f32], Option<&[bool]>),
) -> ScenePicture {
    let count = case.frame_count();
    let images = images(case, nominal);
    let pairs: Vec<AffineMap> = (1..count)
        .into_par_iter()
        .map(|l| register(&images[l - 1], &images[l], &RegisterSearch::default(), None).0)
        .collect();
    let mut chained: Vec<AffineMap> = vec![[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]];
    for pair in &pairs {
        chained.push(compose(chained.last().expect("one is there"), pair));
    }
    let steady = follow_motion(case, nominal, moves, TURN);
    ScenePicture::fit_from(
        case,
        nominal,
        of_picture,
        &[&chained, &steady],
        FitStart { counts: None, ground: Some(ground), selected },
    )
}

impl PictureMosaic {
    /// Tiles and windows with events whose moving values the moving picture does not predict, those with the
    /// most events first.
    fn poorly_predicted_tiles(
        &self,
        case: &Case,
        nominal: &Nominal,
        changes: &[bool],
    ) -> Vec<(usize, Range<usize>)> {
        let windows = self.setting.windows(case.frame_count());
        let mut needed: Vec<(usize, usize, Range<usize>)> = Vec::new();
        let middle = |l: usize, y: u32| middle_ns(case, l, y);
        for (n, tile) in self.tiles.iter().enumerate() {
            for window in &windows {
                let misses = self.whole.as_ref().map(|whole| {
                    median_residual(case, nominal, changes, tile, window, |l, x, y| {
                        picture_residual(case, &whole.picture, l, x, y)
                    })
                });
                if misses.is_some_and(|misses| misses < WELL) {
                    continue;
                }
                let within = |pixel: usize| {
                    let (_, y) = case.pixel_place(pixel);
                    let (from, to) = (middle(window.start, y), middle(window.end - 1, y));
                    case.events
                        .of_pixel(pixel)
                        .iter()
                        .filter(|event| (from..to).contains(&event.t_in_ns))
                        .count()
                };
                let events: usize = pixels_of(case, tile).map(within).sum();
                if events >= LEAST_EVENTS {
                    needed.push((events, n, window.clone()));
                }
            }
        }
        needed.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)).then(a.2.start.cmp(&b.2.start)));
        needed.truncate(self.setting.most_parts);
        needed.into_iter().map(|(_, tile, window)| (tile, window)).collect()
    }

    /// Pictures of tiles and windows, where they can be fitted; `ground`: the still one behind them.
    fn fit(
        &self,
        case: &Case,
        nominal: &Nominal,
        changes: &[bool],
        ground: Option<&[f32]>,
        list: &[(usize, Range<usize>)],
    ) -> Vec<(usize, PicturePatch)> {
        let one = |(tile, frames): &(usize, Range<usize>)| {
            let part = PatchPart::around_tile(&self.tiles[*tile], frames.clone(), case.extent, &self.setting);
            Some((*tile, PicturePatch::fit(case, nominal, changes, ground, part, &self.of_parts)?))
        };
        list.par_iter().filter_map(one).collect()
    }

    /// Which patches predict enough of the moving values of their tiles, and more than the moving picture.
    fn better(
        &self,
        case: &Case,
        nominal: &Nominal,
        changes: &[bool],
        fitted: &[(usize, PicturePatch)],
    ) -> Vec<bool> {
        let mut misses: Vec<f64> = fitted
            .iter()
            .map(|(tile, patch)| {
                median_residual(case, nominal, changes, &self.tiles[*tile], &patch.part.frames, |l, x, y| {
                    patch.residual(l, x, y)
                })
            })
            .filter(|misses| misses.is_finite())
            .collect();
        misses.sort_by(f64::total_cmp);
        // The quarter that does best has the noise alone.
        let noise = misses.get(misses.len() / 4).copied().unwrap_or(1.0);
        let predicted = |tile: usize, frames: &Range<usize>, of: &dyn Fn(usize, u32, u32) -> f32| -> f64 {
            let (mut good, mut all) = (0usize, 0usize);
            for_moving(case, changes, &self.tiles[tile], frames, |l, pixel, x, y| {
                let sigma = nominal.frame_sigma_dn(
                    f64::max(case.dn(l, pixel) - nominal.number.black_level, 0.0),
                    FRAME_NOISE,
                );
                all += 1;
                good += usize::from(
                    f64::from(of(l, x, y)).abs() <= f64::max(self.least_dn, SPREAD * noise * sigma),
                );
            });
            good as f64 / all.max(1) as f64
        };
        fitted
            .iter()
            .map(|(tile, patch)| {
                let own = predicted(*tile, &patch.part.frames, &|l, x, y| patch.residual(l, x, y));
                let other = self.whole.as_ref().map_or(0.0, |whole| {
                    predicted(*tile, &patch.part.frames, &|l, x, y| {
                        picture_residual(case, &whole.picture, l, x, y)
                    })
                });
                own >= LEAST_PREDICTED && own > other + BETTER
            })
            .collect()
    }

    /// Patches of a tile, in order of time.
    fn patches_of_tile(&self, tile: usize) -> Vec<(usize, &PicturePatch)> {
        let mut found: Vec<(usize, &PicturePatch)> =
            self.patches.iter().enumerate().filter(|(n, _)| self.tile[*n] == tile).collect();
        found.sort_by_key(|(_, patch)| patch.part.frames.start);
        found
    }

    /// Works out residuals: of the picture that a place is predicted by, the worse one where two join.
    fn compare(&mut self, case: &Case) {
        let pixels = case.extent.pixels();
        let count = case.frame_count();
        let mut residual = match &self.whole {
            Some(whole) => whole.picture.residual.clone(),
            None => vec![f32::NAN; count * pixels],
        };
        for (n, tile) in self.tiles.iter().enumerate() {
            let patches = self.patches_of_tile(n);
            for l in 0..count {
                let here: Vec<&PicturePatch> = patches
                    .iter()
                    .filter(|(_, patch)| patch.part.frames.contains(&l))
                    .map(|(_, patch)| *patch)
                    .collect();
                if here.is_empty() {
                    continue;
                }
                // Intervals on both sides of the frame: where no patch has one, the moving picture does.
                let is_covered = |k: usize| here.iter().any(|patch| patch.part.frames.contains(&k));
                let is_joint = (l > 0 && !is_covered(l - 1)) || (l + 1 < count && !is_covered(l + 1));
                for pixel in pixels_of(case, tile) {
                    let (x, y) = case.pixel_place(pixel);
                    let own = here.iter().map(|patch| patch.residual(l, x, y));
                    let at = l * pixels + pixel;
                    if !self.moves[at] && residual[at].is_finite() {
                        // What stands still behind.
                        continue;
                    }
                    let joint = is_joint.then_some(residual[at]);
                    residual[at] = own.chain(joint).fold(0.0, larger_residual);
                }
            }
        }
        self.residual = residual;
        let mut misfits: Vec<f64> =
            self.patches.iter().filter_map(|patch| patch.picture.report.misfit.last().copied()).collect();
        self.misfit = if misfits.is_empty() {
            self.whole.as_ref().map_or(1.0, Scene::misfit)
        } else {
            median(&mut misfits)
        };
    }

    /// The picture of most weight on a pixel at an instant: number of its patch, and of none the moving
    /// picture.
    fn patch_at(&self, case: &Case, pixel: usize, t_ns: i64) -> Option<usize> {
        let (x, y) = case.pixel_place(pixel);
        let tile = self.tiles.iter().position(|(columns, rows)| columns.contains(&x) && rows.contains(&y))?;
        let of = self.patches_of_tile(tile);
        let weighed = of.iter().map(|(n, patch)| (*n, weight(case, patch, y, t_ns)));
        weighed.filter(|(_, weight)| *weight > 0.0).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(n, _)| n)
    }
}

/// The larger of two residuals; NaN when one is.
fn larger_residual(a: f32, b: f32) -> f32 {
    if a.is_nan() || b.is_nan() {
        f32::NAN
    } else if b.abs() > a.abs() {
        b
    } else {
        a
    }
}

fn middle_ns(case: &Case, l: usize, y: u32) -> i64 {
    case.frames.as_ref().map_or(0, |frames| {
        let exposure = frames.times.exposure(l, y);
        i64::midpoint(exposure.start.0, exposure.end.0)
    })
}

/// Weight of a patch at an instant: 0 outside of its window, largest in its middle.
fn weight(case: &Case, patch: &PicturePatch, y: u32, t_ns: i64) -> f64 {
    let frames = &patch.part.frames;
    let (from, to) = (middle_ns(case, frames.start, y), middle_ns(case, frames.end - 1, y));
    let t_ns = t_ns.clamp(middle_ns(case, 0, y), middle_ns(case, case.frame_count() - 1, y));
    if !(from..=to).contains(&t_ns) || to <= from {
        return 0.0;
    }
    let place = (t_ns - from) as f64 / (to - from) as f64;
    f64::min(place, 1.0 - place) + 1e-3
}

fn pixels_of<'a>(case: &Case, tile: &'a (Range<u32>, Range<u32>)) -> impl Iterator<Item = usize> + use<'a> {
    let width = case.extent.width;
    let (columns, rows) = tile;
    rows.clone().flat_map(move |y| columns.clone().map(move |x| (y * width + x) as usize))
}

fn picture_residual(case: &Case, picture: &ScenePicture, l: usize, x: u32, y: u32) -> f32 {
    picture.residual[l * case.extent.pixels() + (y * case.extent.width + x) as usize]
}

fn for_moving(
    case: &Case,
    changes: &[bool],
    tile: &(Range<u32>, Range<u32>),
    frames: &Range<usize>,
    mut with: impl FnMut(usize, usize, u32, u32),
) {
    let pixels = case.extent.pixels();
    for l in frames.clone() {
        for pixel in pixels_of(case, tile).filter(|pixel| changes[l * pixels + pixel]) {
            let (x, y) = case.pixel_place(pixel);
            with(l, pixel, x, y);
        }
    }
}

/// Median residual of the moving values of a tile and window, standard deviations over 0.6745; infinite where
/// most of them took no part.
fn median_residual(
    case: &Case,
    nominal: &Nominal,
    changes: &[bool],
    tile: &(Range<u32>, Range<u32>),
    frames: &Range<usize>,
    of: impl Fn(usize, u32, u32) -> f32,
) -> f64 {
    let mut sizes: Vec<f64> = Vec::new();
    for_moving(case, changes, tile, frames, |l, pixel, x, y| {
        let sigma = nominal
            .frame_sigma_dn(f64::max(case.dn(l, pixel) - nominal.number.black_level, 0.0), (1.0, 0.005));
        let size = f64::from(of(l, x, y)).abs() / sigma;
        sizes.push(if size.is_finite() { size } else { f64::INFINITY });
    });
    if sizes.is_empty() { 0.0 } else { median(&mut sizes) / MEDIAN_NORMAL }
}

impl Scene for PictureMosaic {
    fn name(&self) -> &'static str {
        "patches"
    }

    fn log_light(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let of_whole = self.whole.as_ref().map(|whole| whole.log_light(case, step_ns, pixels));
        self.join_predictions((case, step_ns, pixels), of_whole, ScenePicture::log_light)
    }

    fn exposures_seen(&self, case: &Case, step_ns: i64, pixels: &[usize]) -> Vec<Vec<f32>> {
        let of_whole = self.whole.as_ref().map(|whole| whole.exposures_seen(case, step_ns, pixels));
        self.join_predictions((case, step_ns, pixels), of_whole, |picture, x, y, maps| {
            Some(picture.exposures_seen(x, y, maps))
        })
    }

    fn residual(&self) -> &[f32] {
        &self.residual
    }

    fn tolerance(&self) -> Option<FrameTolerance> {
        Some(FrameTolerance { any_dn: self.least_dn, alike_dn: self.least_dn })
    }

    fn sigma(&self, nominal: &Nominal, signal: f64) -> f64 {
        self.misfit * nominal.frame_sigma_dn(signal, FRAME_NOISE)
    }

    fn part_and_place(&self, case: &Case, pixel: usize, t_ns: i64) -> (u32, f64, f64) {
        let Some(n) = self.patch_at(case, pixel, t_ns) else {
            return self
                .whole
                .as_ref()
                .map_or((0, pixel as f64, 0.0), |whole| whole.part_and_place(case, pixel, t_ns));
        };
        let patch = &self.patches[n];
        let (x, y) = case.pixel_place(pixel);
        let extent = patch.part.extent();
        let centre = (0.5 * (f64::from(extent.width) - 1.0), 0.5 * (f64::from(extent.height) - 1.0));
        let place = (
            f64::from(x - patch.part.columns.start) - centre.0,
            f64::from(y - patch.part.rows.start) - centre.1,
        );
        let (x, y) = apply(&patch.picture.motion.at(t_ns), place.0, place.1);
        (n as u32 + 1, x, y)
    }

    fn refit(&self, case: &Case, nominal: &Nominal) -> Result<Box<dyn Scene>, String> {
        let whole = self
            .whole
            .as_ref()
            .map(|whole| whole.with_picture(whole.picture.refit(case, nominal, &whole.setting, None)));
        let patches =
            self.patches.par_iter().map(|patch| patch.refit(case, nominal, &self.of_parts)).collect();
        Ok(Box::new(self.with_pictures(case, whole, patches)))
    }

    fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        seed: u64,
    ) -> Result<Option<Box<dyn Scene>>, String> {
        let draw = |whole: &MovingPicture| {
            whole
                .picture
                .posterior_sample(case, nominal, &whole.setting, None, seed)
                .sharpened(whole.setting.sharpest)
        };
        let whole = self.whole.as_ref().map(|whole| whole.with_picture(draw(whole)));
        let one = |(n, patch): (usize, &PicturePatch)| {
            patch.posterior_sample(case, nominal, &self.of_parts, seed.wrapping_add(1 + n as u64))
        };
        let patches = self.patches.par_iter().enumerate().map(one).collect();
        Ok(Some(Box::new(self.with_pictures(case, whole, patches))))
    }

    fn misfit(&self) -> f64 {
        self.misfit
    }
}

impl PictureMosaic {
    /// Predictions for pixels at steady instants: `of_patch` by patches, and elsewhere `of_whole` by the
    /// moving picture.
    fn join_predictions(
        &self,
        (case, step_ns, pixels): (&Case, i64, &[usize]),
        of_whole: Option<Vec<Vec<f32>>>,
        of_patch: impl Fn(&ScenePicture, usize, usize, &[AffineMap]) -> Option<Vec<f64>>,
    ) -> Vec<Vec<f32>> {
        let mut of_whole = of_whole.unwrap_or_else(|| vec![Vec::new(); pixels.len()]);
        let instants: Vec<i64> = LogLight::instants(case, step_ns).collect();
        // Patches of a tile with where they lie at every instant; neighbouring pixels mostly share them.
        let mut tile = usize::MAX;
        let mut patches: Vec<(&PicturePatch, Vec<AffineMap>)> = Vec::new();
        for (pixel, predicted) in pixels.iter().zip(&mut of_whole) {
            let (x, y) = case.pixel_place(*pixel);
            let Some(here) =
                self.tiles.iter().position(|(columns, rows)| columns.contains(&x) && rows.contains(&y))
            else {
                continue;
            };
            if here != tile {
                tile = here;
                patches = self
                    .patches_of_tile(tile)
                    .into_iter()
                    .map(|(_, patch)| (patch, instants.iter().map(|t| patch.picture.motion.at(*t)).collect()))
                    .collect();
            }
            if !patches.is_empty() {
                *predicted = predict_by_patches(case, *pixel, &patches, &instants, predicted, &of_patch);
            }
        }
        of_whole
    }

    /// The same parts with other pictures.
    fn with_pictures(
        &self,
        case: &Case,
        whole: Option<MovingPicture>,
        patches: Vec<PicturePatch>,
    ) -> PictureMosaic {
        let mut other = PictureMosaic {
            whole,
            patches,
            tile: self.tile.clone(),
            tiles: self.tiles.clone(),
            setting: self.setting,
            of_parts: self.of_parts,
            moves: self.moves.clone(),
            residual: Vec::new(),
            misfit: 1.0,
            least_dn: self.least_dn,
        };
        other.compare(case);
        other
    }
}

/// Prediction for a pixel by patches with their poses at every instant; where they give none, the moving
/// picture's prediction `of_whole`.
fn predict_by_patches(
    case: &Case,
    pixel: usize,
    patches: &[(&PicturePatch, Vec<AffineMap>)],
    instants: &[i64],
    of_whole: &[f32],
    of_patch: &impl Fn(&ScenePicture, usize, usize, &[AffineMap]) -> Option<Vec<f64>>,
) -> Vec<f32> {
    let (x, y) = case.pixel_place(pixel);
    let mut sum = vec![0.0; instants.len()];
    let mut weights = vec![0.0; instants.len()];
    for (patch, maps) in patches {
        let share: Vec<f64> = instants.iter().map(|t| weight(case, patch, y, *t)).collect();
        let Some(first) = share.iter().position(|share| *share > 0.0) else { continue };
        let last = share.iter().rposition(|share| *share > 0.0).unwrap_or(first);
        let place = ((x - patch.part.columns.start) as usize, (y - patch.part.rows.start) as usize);
        let Some(predicted) = of_patch(&patch.picture, place.0, place.1, &maps[first..=last]) else {
            continue;
        };
        for (k, predicted) in (first..=last).zip(predicted) {
            sum[k] += share[k] * predicted;
            weights[k] += share[k];
        }
    }
    let known: Vec<Option<f32>> = (0..instants.len())
        .map(|k| if weights[k] > 0.0 { Some((sum[k] / weights[k]) as f32) } else { of_whole.get(k).copied() })
        .collect();
    filled(&known)
}

/// Replaces unknown values by the nearest known one before or behind; empty where none is known.
fn filled(known: &[Option<f32>]) -> Vec<f32> {
    let Some(first) = known.iter().flatten().next() else { return Vec::new() };
    let mut last = *first;
    known
        .iter()
        .map(|value| {
            last = value.unwrap_or(last);
            last
        })
        .collect()
}
