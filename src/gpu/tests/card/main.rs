//! The card against the processor, pixel by pixel. Where there is no card, software or not, these tests are
//! skipped and print so, unless `REQUIRE_GPU` is set: `make gpu` brings one that runs on the processor.

mod means;
mod pixels;
mod recording;

use photocurrent_core::sensor::Reset;
use photocurrent_gpu::{Card, CardOptions, Unsolved};
use photocurrent_sensor::map::{
    Hint, Local, LoneEvents, MapGroup, MapOptions, MapOutcome, MapProblem, MapSolution, MapStatus, MapTask,
    Noise, Prior, Second,
};
use pixels::{Measured, measured, pixels};

/// The card, or nothing where there is none and none is required.
pub(crate) fn card(options: CardOptions) -> Option<Card> {
    match Card::open(options) {
        Ok(card) => Some(card),
        Err(error) if std::env::var_os("REQUIRE_GPU").is_none() => {
            #[allow(clippy::print_stdout)]
            {
                println!("skipped: {error}");
            }
            None
        }
        Err(error) => panic!("REQUIRE_GPU is set: {error}"),
    }
}

/// As `solve/map` solves.
fn options() -> MapOptions {
    MapOptions { max_iterations: 5, with_sigma: true, ..MapOptions::default() }
}

/// An answer.
struct Answer {
    t_ns: Vec<i64>,
    log: Vec<f64>,
    variance: Vec<f64>,
    outcome: MapOutcome,
}

impl Answer {
    fn of(solution: &MapSolution<'_>) -> Answer {
        Answer {
            t_ns: solution.t_ns.to_vec(),
            log: solution.log_photocurrent.to_vec(),
            variance: solution.variance.to_vec(),
            outcome: solution.outcome,
        }
    }
}

fn by_processor(tasks: &[MapTask<'_>]) -> Vec<Answer> {
    let mut answers: Vec<Option<Answer>> = tasks.iter().map(|_| None).collect();
    MapGroup::default().solve(tasks, |n, solution| answers[n] = Some(Answer::of(&solution)));
    answers.into_iter().map(|answer| answer.expect("every task has an answer")).collect()
}

fn by_card(card: &Card, tasks: &[MapTask<'_>]) -> Vec<Answer> {
    let mut answers: Vec<Option<Answer>> = tasks.iter().map(|_| None).collect();
    let left = card.solve(tasks, true, &mut |n, solution| answers[n] = Some(Answer::of(&solution)));
    assert_eq!(left.expect("the card solves"), [], "all are taken");
    answers.into_iter().map(|answer| answer.expect("every task has an answer")).collect()
}

/// How far the card's answer is from the processor's: log light, log standard deviation, evidence.
struct Apart {
    light: f64,
    sigma: f64,
    evidence: f64,
    is_same: bool,
}

fn apart(ours: &Answer, theirs: &Answer) -> Apart {
    assert_eq!(ours.t_ns, theirs.t_ns, "knots are laid by one code");
    let most = |pairs: &mut dyn Iterator<Item = f64>| pairs.fold(0.0, f64::max);
    let log_sigma = |variance: f64| 0.5 * libm::log(f64::max(variance, 1e-8));
    Apart {
        light: most(&mut ours.log.iter().zip(&theirs.log).map(|(a, b)| (a - b).abs())),
        sigma: most(
            &mut ours
                .variance
                .iter()
                .zip(&theirs.variance)
                .map(|(a, b)| (log_sigma(*a) - log_sigma(*b)).abs()),
        ),
        evidence: (ours.outcome.log_evidence - theirs.outcome.log_evidence).abs(),
        is_same: (ours.outcome.status, ours.outcome.second, ours.outcome.iterations)
            == (theirs.outcome.status, theirs.outcome.second, theirs.outcome.iterations)
            && ours.log.len() == theirs.log.len()
            && ours.variance.len() == theirs.variance.len(),
    }
}

/// How far the card's answers may be from the processor's.
#[derive(Clone, Copy)]
struct Tolerance {
    /// Of log light.
    light: f64,
    /// Of the logarithm of its standard deviation.
    sigma: f64,
    /// Of the log evidence, in units.
    evidence: f64,
    /// The part of pixels that may be further off.
    share: f64,
}

const USUAL: Tolerance = Tolerance { light: 1e-3, sigma: 0.01, evidence: 0.05, share: 0.0 };

/// Holds the card's answers to the processor's; status, steps and second start must be the same as well.
fn hold(card: &Card, tasks: &[MapTask<'_>], within: Tolerance) -> Vec<Answer> {
    let ours = by_card(card, tasks);
    hold_to(&ours, &[by_processor(tasks)], within);
    ours
}

/// Holds each of `ours` to one of several answers.
fn hold_to(ours: &[Answer], theirs: &[Vec<Answer>], within: Tolerance) {
    let is_good = |apart: &Apart| {
        let Apart { light, sigma, evidence, is_same } = *apart;
        light < within.light && sigma < within.sigma && evidence < within.evidence && is_same
    };
    let nearest = |n: usize| {
        let all = theirs.iter().map(|theirs| apart(&ours[n], &theirs[n]));
        all.min_by(|a, b| (!is_good(a), a.light).partial_cmp(&(!is_good(b), b.light)).expect("numbers"))
    };
    let apart: Vec<Apart> = (0..ours.len()).map(|n| nearest(n).expect("there are answers")).collect();
    let most = |of: fn(&Apart) -> f64| {
        let mut all: Vec<f64> = apart.iter().filter(|apart| is_good(apart)).map(of).collect();
        all.sort_by(f64::total_cmp);
        format!("{:.1e} and {:.1e}", all[all.len() / 2], all[all.len() - 1])
    };
    let bad: Vec<usize> = (0..apart.len()).filter(|&n| !is_good(&apart[n])).collect();
    let count = |of: fn(&MapOutcome) -> bool| theirs[0].iter().filter(|answer| of(&answer.outcome)).count();
    let mut report = format!(
        "{} of {} pixels differ; of the others, median and most: light {}, log sigma {}, evidence {}; \
         second starts {}, kept {}, failed {}",
        bad.len(),
        apart.len(),
        most(|apart| apart.light),
        most(|apart| apart.sigma),
        most(|apart| apart.evidence),
        count(|outcome| outcome.second != Second::Untried),
        count(|outcome| outcome.second == Second::Kept),
        count(|outcome| outcome.status == MapStatus::Failed),
    );
    for &n in bad.iter().take(8) {
        let Apart { light, sigma, evidence, .. } = apart[n];
        report += &format!(
            "\npixel {n}: light {light:.1e}, sigma {sigma:.1e}, evidence {evidence:.1e}\n  {:?}\n  {:?}",
            ours[n].outcome, theirs[0][n].outcome
        );
    }
    #[allow(clippy::print_stdout)]
    {
        println!("{report}");
    }
    assert!(bad.len() as f64 <= within.share * apart.len() as f64, "{report}");
}

fn tasks<'a>(pixels: &'a [Measured], of: impl Fn(&'a Measured) -> MapTask<'a>) -> Vec<MapTask<'a>> {
    pixels.iter().map(of).collect()
}

fn usual(pixel: &Measured) -> MapTask<'_> {
    MapTask { problem: pixel.problem(), options: options() }
}

#[test]
fn a_thousand_pixels_are_solved_as_by_the_processor() {
    let Some(card) = card(CardOptions::default()) else { return };
    let pixels = pixels(1_000);
    // Of the light that falls into the dark at once, one pixel in a thousand ends in another minimum.
    let within = Tolerance { share: 0.001, ..USUAL };
    let answers = hold(&card, &tasks(&pixels, usual), within);
    // What is furthest off is the same measurement, but where two are about as far.
    let theirs = by_processor(&tasks(&pixels, usual));
    let elsewhere = |(ours, theirs): &(&Answer, &Answer)| {
        let (ours, theirs) = (&ours.outcome, &theirs.outcome);
        ours.largest_ns != theirs.largest_ns && theirs.largest_square > 1e-3
    };
    let differ = answers.iter().zip(&theirs).filter(elsewhere).count();
    assert!(differ <= 5, "{differ} pixels have the largest square at another instant");
    // The test would show nothing of second starts without any.
    let second = |second: Second| answers.iter().filter(|answer| answer.outcome.second == second).count();
    assert!(second(Second::Kept) > 0 && second(Second::Refused) > 0);
}

#[test]
fn variances_are_the_same_in_pairs_of_numbers() {
    let Some(card) = card(CardOptions { with_double: false, ..CardOptions::default() }) else { return };
    assert!(!card.has_double());
    let pixels = pixels(200);
    hold(&card, &tasks(&pixels, usual), USUAL);
}

#[test]
fn thresholds_may_be_unknowns() {
    let Some(card) = card(CardOptions::default()) else { return };
    let pixels = pixels(200);
    let noise = Noise { threshold: 0.03, ..Noise::USUAL };
    let task = |pixel| MapTask { problem: MapProblem { noise, ..usual(pixel).problem }, ..usual(pixel) };
    hold(&card, &tasks(&pixels, task), USUAL);
}

/// The processor's answers, and those to gains that are off by a millionth up and down: where a cost has
/// several minima, rounding may lead to another one.
fn by_processor_moved(pixels: &[Measured], options: MapOptions) -> [Vec<Answer>; 3] {
    [0.0, 1e-6, -1e-6].map(|by| {
        let task = |pixel| {
            let mut task = MapTask { options, ..usual(pixel) };
            task.problem.sensor.gain *= 1.0 + by;
            task
        };
        by_processor(&tasks(pixels, task))
    })
}

#[test]
fn every_prior_is_there() {
    let Some(card) = card(CardOptions::default()) else { return };
    let all = pixels(1_000);
    for (prior, count, share) in [
        (Prior::Local(Local { floor_per_s: 60.0, memory_s: 5e-3, reach_s: 0.5e-3 }), 200, 0.0),
        // Costs with Student's t have several minima, and descents that end before they arrive.
        (Prior::Walk { per_s: 1.0, nu: 1.0 }, 1_000, 0.01),
        // Variances of slopes fall by more digits than single precision has to spare.
        (Prior::IntegratedWalk { per_s3: 3e6, nu: 3.0 }, 200, 0.02),
    ] {
        let pixels = &all[..count];
        let options = MapOptions { prior, ..options() };
        let ours = by_card(&card, &tasks(pixels, |pixel| MapTask { options, ..usual(pixel) }));
        hold_to(&ours, &by_processor_moved(pixels, options), Tolerance { share, ..USUAL });
    }
}

/// A frame that is a lower bound counts or not, which hangs on the sign of a difference that is zero at the
/// start, so that rounding decides: the processor's own answer is another one when the gain is moved by a
/// millionth. Where several frames saturate, each decides for itself.
#[test]
fn saturated_frames_count_as_by_the_processor() {
    let Some(card) = card(CardOptions::default()) else { return };
    let pixels: Vec<Measured> = (0..200).map(|n| measured(n, Reset::Resample, 1.3)).collect();
    assert!(pixels.iter().flat_map(|pixel| &pixel.frames).filter(|frame| frame.saturated).count() > 200);
    let theirs = by_processor_moved(&pixels, options());
    hold_to(&by_card(&card, &tasks(&pixels, usual)), &theirs, Tolerance { share: 0.05, ..USUAL });
}

#[test]
fn what_events_may_be_is_there() {
    let Some(card) = card(CardOptions::default()) else { return };
    let pixels: Vec<Measured> = [Reset::Resample, Reset::Advance, Reset::AdvanceLossy]
        .into_iter()
        .flat_map(|reset| (0..50).map(move |n| measured(n, reset, 0.0)))
        .collect();
    let beyond: Vec<f64> = (0..10_000).map(|n| 0.01 * libm::sin(f64::from(n))).collect();
    let is_lone: Vec<bool> = (0..10_000).map(|n| n % 7 == 3).collect();
    let task = |pixel| {
        let problem = MapProblem {
            beyond: &beyond,
            is_lone: &is_lone,
            lost_before: &[4],
            stamp_sigma_s: 20e-6,
            noise: Noise { lone: LoneEvents::Doubted, threshold: 0.02, ..Noise::USUAL },
            ..usual(pixel).problem
        };
        MapTask { problem, ..usual(pixel) }
    };
    hold(&card, &tasks(&pixels, task), USUAL);
}

#[test]
fn a_small_pool_changes_no_bit_and_hints_are_left_to_the_processor() {
    let (Some(card), Some(small)) =
        (card(CardOptions::default()), card(CardOptions { pool_bytes: 4 << 20, ..CardOptions::default() }))
    else {
        return;
    };
    let pixels = pixels(200);
    let mut tasks = tasks(&pixels, usual);
    let bits = |answers: &[Answer]| -> Vec<u64> {
        answers
            .iter()
            .flat_map(|answer| answer.log.iter().chain(&answer.variance))
            .map(|x| x.to_bits())
            .collect()
    };
    assert!(bits(&by_card(&card, &tasks)) == bits(&by_card(&small, &tasks)));
    let hints = [Hint { t_ns: 1_000, log_photocurrent: 3.0, variance: 0.1, for_sigma: 0.1 }];
    tasks[7].problem.hints = &hints;
    let mut taken = 0;
    let left = small.solve(&tasks, false, &mut |_, _| taken += 1).expect("the card solves");
    assert_eq!((left, taken), (vec![(7, Unsolved::HasHints)], 199));
    // Not even one pixel fits.
    let tiny = Card::open(CardOptions { pool_bytes: 1 << 10, ..CardOptions::default() }).expect("the card");
    let left = tiny.solve(&tasks, false, &mut |_, _| panic!("nothing fits")).expect("the card solves");
    assert_eq!((left.len(), left[0]), (200, (0, Unsolved::TooLong)));
}
