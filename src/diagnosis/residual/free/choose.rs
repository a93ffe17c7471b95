//! Selects the blocks of pixels, and the time, for the light of pixels.

use photocurrent_core::random::Random;
use photocurrent_scene::block::Block;
use photocurrent_scene::case::Case;
use photocurrent_scene::gate::PredictionGate;

/// Side of the blocks, pixels.
const WIDTH: usize = 12;
const HEIGHT: usize = 10;
/// Parts of the array along each side from which blocks are taken.
const PARTS: usize = 2;
/// Largest number of blocks.
const MOST: usize = 4;
/// A block with less than this share of the busiest one's activity is left out.
const LEAST_ACTIVITY: f64 = 0.2;
/// Number of events of one pixel above which more have no weight.
const ENOUGH_EVENTS: f64 = 60.0;
/// Longest stretch of time, ns.
const LONGEST_NS: i64 = 150_000_000;

/// The busiest frames of a recording that is longer than necessary.
pub(super) fn window(case: &Case) -> Option<Case> {
    let period_ns = case.frames.as_ref()?.times.mean_period_ns()?;
    if case.span.1 - case.span.0 <= LONGEST_NS * 4 / 3 {
        return None;
    }
    let frames = ((LONGEST_NS as f64 / period_ns) as usize).max(4);
    case.busiest_frames(frames * case.extent.pixels())
}

/// Busy blocks, spread over the array.
pub(super) fn blocks(case: &Case) -> Vec<Block> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (w, h) = (WIDTH.min(width), HEIGHT.min(height));
    let activity = |block: &Block| -> f64 {
        let rows = block.y..block.y + block.height;
        let pixels = rows.flat_map(|y| (block.x..block.x + block.width).map(move |x| y * width + x));
        pixels.map(|pixel| (case.events.of_pixel(pixel).len() as f64).min(ENOUGH_EVENTS).sqrt()).sum()
    };
    let mut all: Vec<(f64, Block)> = Vec::new();
    for y in (0..=height - h).step_by(h) {
        for x in (0..=width - w).step_by(w) {
            let block = Block { x, y, width: w, height: h };
            all.push((activity(&block), block));
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1.y, a.1.x).cmp(&(b.1.y, b.1.x))));
    let part = |block: &Block| ((block.x + w / 2) * PARTS / width, (block.y + h / 2) * PARTS / height);
    // The busiest of each part first, then whichever are busiest.
    let mut chosen: Vec<Block> = Vec::new();
    let least = LEAST_ACTIVITY * all.first().map_or(0.0, |best| best.0);
    let busy: Vec<Block> = all.iter().filter(|one| one.0 >= least).map(|one| one.1).collect();
    for block in &busy {
        if chosen.iter().all(|other| part(other) != part(block)) {
            chosen.push(*block);
        }
    }
    let rest: Vec<Block> = busy.into_iter().filter(|block| !chosen.contains(block)).collect();
    chosen.extend(rest);
    chosen.truncate(MOST);
    chosen.sort_by_key(|block| (block.y, block.x));
    chosen
}

/// Seed of the choice of pixels.
const SEED: u64 = 5;

/// Numbers of the events of each pixel that a gate keeps.
pub(super) fn gated_events(case: &Case, gate: &PredictionGate) -> Vec<usize> {
    let of = |pixel: usize| {
        case.events.of_pixel(pixel).iter().filter(|event| gate.accepts(pixel, event.t_in_ns)).count()
    };
    (0..case.extent.pixels()).map(of).collect()
}

/// Random pixels of a block until about `trained` of their gated events (`kept`) are fitted and `measured`
/// are held out. Per pixel of the array: is it fitted, is it held out? With few events a quarter is held out.
pub(super) fn choose_pixels(
    case: &Case,
    block: &Block,
    kept: &[usize],
    (trained, measured): (usize, usize),
) -> (Vec<bool>, Vec<bool>) {
    let mut of_block = vec![0; kept.len()];
    for pixel in block.pixels(case.extent) {
        of_block[pixel as usize] = kept[pixel as usize];
    }
    let all = of_block.iter().sum::<usize>().max(1) as f64;
    let of_trained = f64::min(0.75, trained as f64 / all);
    let of_measured = f64::min(0.25, measured as f64 / all);
    let mut random = Random::new(SEED, &[]);
    let drawn: Vec<f64> = of_block.iter().map(|_| random.uniform()).collect();
    let is = |of: &dyn Fn(f64) -> bool| -> Vec<bool> {
        drawn.iter().zip(&of_block).map(|(drawn, kept)| *kept > 0 && of(*drawn)).collect()
    };
    (is(&|drawn| drawn < of_trained), is(&|drawn| drawn > 1.0 - of_measured))
}
