//! Seconds of the card and of one core of the processor for the same pixels of 100 ms, and how quickly the
//! card copies.
//!
//! Run with `cargo bench -p photocurrent-gpu -- [PIXELS]`; 4,096 pixels where nothing is stated, 921,600 are
//! 1280 x 720. Pixels of the forward model, of five kinds of light, repeat after 1,024; the processor solves
//! those once. What is printed is of the second of two runs: the first compiles shaders and takes memory.

#[path = "../tests/card/pixels.rs"]
mod pixels;

use photocurrent_gpu::{Card, CardOptions};
use photocurrent_sensor::map::{MapGroup, MapOptions, MapTask, SecondStart};
use std::time::{Duration, Instant};

const DIFFERENT: u64 = 1_024;
const USUAL: usize = 4_096;
/// Bytes of a copy.
const COPIED: u64 = 96 << 20;

#[allow(clippy::print_stdout)]
fn main() {
    let wanted = std::env::args().filter_map(|text| text.parse().ok()).next();
    let count: usize = wanted.unwrap_or(USUAL);
    let card = match Card::open(CardOptions::default()) {
        Ok(card) => card,
        Err(error) => {
            println!("{error}");
            return;
        }
    };
    match card.copy_speeds(COPIED, Duration::from_secs(1)) {
        Ok(speeds) => println!(
            "copies of {} MiB: on the card {:.1} GB/s read and written, to it {:.1}, from it {:.1}",
            COPIED >> 20,
            speeds.on_card * 1e-9,
            speeds.to_card * 1e-9,
            speeds.from_card * 1e-9
        ),
        Err(error) => println!("{error}"),
    }
    let pixels = pixels::pixels(DIFFERENT);
    // As `solve/map` has it where second starts are rarely kept.
    let second = Some(SecondStart { least_misfit: 0.5, ..SecondStart::USUAL });
    let options = MapOptions { max_iterations: 5, with_sigma: true, second, ..MapOptions::default() };
    let posed = pixels.iter().map(|pixel| MapTask { problem: pixel.problem(), options });
    let tasks: Vec<MapTask<'_>> = posed.cycle().take(count).collect();
    let mut knots = 0;
    let mut run = || {
        let (begun, busy) = (Instant::now(), card.busy());
        knots = 0;
        let left = card.solve(&tasks, true, &mut |_, solution| knots += solution.t_ns.len());
        assert!(left.is_ok_and(|left| left.is_empty()), "the card solves all");
        (begun.elapsed().as_secs_f64(), (card.busy() - busy).as_secs_f64())
    };
    run();
    let (all, on_card) = run();
    let begun = Instant::now();
    let few = &tasks[..usize::min(count, DIFFERENT as usize)];
    MapGroup::default().solve(few, |_, _| {});
    let here = begun.elapsed().as_secs_f64();
    let each = |seconds: f64, count: usize| seconds * 1e6 / count as f64;
    println!(
        "{}; variances in {}",
        card.name(),
        if card.has_double() { "double precision" } else { "pairs" }
    );
    println!("{count} pixels, {knots} knots, {:.1} a pixel", knots as f64 / count as f64);
    println!(
        "card: {all:.2} s, {:.1} us a pixel; on it {on_card:.2} s, {:.1}",
        each(all, count),
        each(on_card, count)
    );
    println!("one core: {:.1} us a pixel", each(here, few.len()));
}
