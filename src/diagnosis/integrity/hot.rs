//! Hot rows and hot pixels: they fire far more than their neighbours, all the time and independent of the
//! scene.
//!
//! Rows are tested first, or each pixel of a hot row would count as a hot pixel. Counts are compared with
//! those of neighbours (the scene moves across all of them) and with the spread of that comparison over the
//! array. Where thresholds differ between pixels, unequal counts are not significant.

use super::departure::Departure;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::median;

/// The effects that are found here; their pixels are excluded.
pub(crate) const IDS: [&str; 2] = ["hot_rows", "hot_pixels"];
/// A row must have this many standard deviations of counting more events in its median pixel than the rows
/// around it.
const ROW_SIGMAS: f64 = 1.6;
/// In this share of its pixels it must be more than both.
const ROW_SHARE: f64 = 0.75;
/// Least ratio of the disagreement of its events and frames to that of the rows around: a median of many
/// pixels.
const ROW_DISAGREES: f64 = 1.2;
/// A pixel must have this many times the spread of the comparison.
const PIXEL_SIGMAS: f64 = 8.0;
/// Least excess of events over 1.5 times the neighbours' count.
const LEAST_EXCESS: f64 = 20.0;
/// The excess must be there in this many of [`PARTS`] parts of the recording.
const STEADY: usize = 10;
const PARTS: usize = 12;
/// Least ratio of the disagreement of its events and frames to that of the pixels around.
const DISAGREES: f64 = 2.0;

/// Hot rows, and their pixels. Pixels of `out` (rising) are left out.
pub(crate) fn rows(case: &Case, nominal: Option<&Nominal>, out: &[u32]) -> (Option<Departure>, Vec<u32>) {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    if height < 8 || width < 8 {
        return (None, Vec::new());
    }
    let count = |x: usize, y: usize| case.events.of_pixel(y * width + x).len() as f64;
    let (mut hot, mut excess, mut strongest) = (Vec::new(), 0.0, 0.0_f64);
    let is_in = |x: usize, y: usize| out.binary_search(&((y * width + x) as u32)).is_err();
    let medians: Vec<f64> = (0..height)
        .map(|y| median(&mut (0..width).filter(|&x| is_in(x, y)).map(|x| count(x, y)).collect::<Vec<_>>()))
        .collect();
    // What stands at the rim has nothing on its other side to be held against.
    for y in 1..height - 1 {
        // Two rows may stand next to each other: of the four around, the quieter two pairs decide.
        let around: Vec<usize> = [y.checked_sub(2), y.checked_sub(1), Some(y + 1), Some(y + 2)]
            .into_iter()
            .flatten()
            .filter(|row| *row < height)
            .collect();
        let mut levels: Vec<f64> = around.iter().map(|&row| medians[row]).collect();
        let middle = median(&mut levels);
        let sigmas = (medians[y] - middle) / libm::sqrt(middle + 1.0);
        if sigmas <= ROW_SIGMAS {
            continue;
        }
        let quiet: Vec<usize> = around.iter().copied().filter(|&row| medians[row] <= middle).collect();
        let columns: Vec<usize> =
            (0..width).filter(|&x| is_in(x, y) && quiet.iter().all(|&row| is_in(x, row))).collect();
        let more =
            columns.iter().filter(|&&x| quiet.iter().all(|&row| count(x, y) > count(x, row) + 1.0)).count();
        let steady = steady(case, &columns.iter().map(|x| y * width + x).collect::<Vec<_>>(), |pixel| {
            quiet.iter().map(|&row| row * width + pixel % width).collect()
        });
        let of = |row: usize| {
            median(
                &mut columns.iter().map(|x| disagreement(case, nominal, row * width + x)).collect::<Vec<_>>(),
            )
        };
        let elsewhere = quiet.iter().map(|&row| of(row)).fold(0.0, f64::max);
        if 2 * columns.len() > width
            && more as f64 > ROW_SHARE * columns.len() as f64
            && steady >= STEADY
            && (elsewhere == 0.0 || of(y) > ROW_DISAGREES * elsewhere)
        {
            hot.push(y as u32);
            let here: f64 = columns.iter().map(|&x| count(x, y)).sum();
            let there: f64 = quiet.iter().flat_map(|&row| columns.iter().map(move |&x| count(x, row))).sum();
            excess += (here - there / quiet.len() as f64) / columns.len() as f64;
            strongest = strongest.max(sigmas);
        }
    }
    let pixels: Vec<u32> =
        hot.iter().flat_map(|y| (0..width as u32).map(move |x| y * width as u32 + x)).collect();
    // More than a few rows are no defect but a scene with stripes.
    if hot.is_empty() || hot.len() * 8 > height {
        return (None, Vec::new());
    }
    let seconds = (case.span.1 - case.span.0) as f64 * 1e-9;
    let rate = excess / hot.len() as f64 / seconds;
    let share = hot.len() as f64 / height as f64;
    let finding = Departure {
        id: IDS[0],
        parameters: vec![("fraction", share), ("rate", rate)],
        statistic: strongest,
        threshold: ROW_SIGMAS,
        share,
        polarity: polarity(case, &pixels),
        pixels: pixels.clone(),
        seen: format!(
            "rows {hot:?}: every pixel fires about {rate:.0} times a second more than in the rows \
                       around, all the time"
        ),
        heldout: None,
        ci95: Vec::new(),
    };
    (Some(finding), pixels)
}

/// Hot pixels outside the masked ones; adds them to the mask.
pub(crate) fn pixels(case: &Case, nominal: Option<&Nominal>, masked: &mut Vec<u32>) -> Option<Departure> {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let in_hot_row = masked.clone();
    let is_masked = |pixel: usize| in_hot_row.binary_search(&(pixel as u32)).is_ok();
    let count = |pixel: usize| case.events.of_pixel(pixel).len() as f64;
    let around = |pixel: usize| -> Vec<usize> {
        let (x, y) = (pixel % width, pixel / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(|row| columns.clone().map(move |column| row * width + column))
            .filter(|&other| other != pixel && !is_masked(other))
            .collect()
    };
    let level = |pixel: usize| median(&mut around(pixel).into_iter().map(count).collect::<Vec<_>>());
    let unmasked: Vec<usize> = (0..width * height).filter(|&pixel| !is_masked(pixel)).collect();
    let sigmas: Vec<f64> = unmasked
        .iter()
        .map(|&pixel| (count(pixel) - level(pixel)) / libm::sqrt(level(pixel) + 1.0))
        .collect();
    let spread =
        f64::max(1.0, 1.4826 * median(&mut sigmas.iter().map(|sigma| sigma.abs()).collect::<Vec<_>>()));
    let (mut hot, mut strongest, mut excess) = (Vec::new(), 0.0_f64, 0.0);
    for (&pixel, sigma) in unmasked.iter().zip(&sigmas) {
        let is_unlike = || {
            let elsewhere = median(
                &mut around(pixel)
                    .into_iter()
                    .map(|other| disagreement(case, nominal, other))
                    .collect::<Vec<_>>(),
            );
            elsewhere == 0.0 || disagreement(case, nominal, pixel) > DISAGREES * elsewhere
        };
        let (x, y) = (pixel % width, pixel / width);
        let is_inside = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
        if is_inside
            && *sigma > PIXEL_SIGMAS * spread
            && count(pixel) > 1.5 * level(pixel) + LEAST_EXCESS
            && steady(case, &[pixel], around) >= STEADY
            && is_unlike()
        {
            hot.push(pixel as u32);
            strongest = strongest.max(sigma / spread);
            excess += count(pixel) - level(pixel);
        }
    }
    if hot.is_empty() || hot.len() * 20 > unmasked.len() {
        return None;
    }
    masked.extend(&hot);
    masked.sort_unstable();
    let rate = excess / hot.len() as f64 / ((case.span.1 - case.span.0) as f64 * 1e-9);
    let share = hot.len() as f64 / (width * height) as f64;
    let seen = format!(
        "{} pixels fire about {rate:.0} times a second more than those around them, all the time",
        hot.len()
    );
    let polarity = polarity(case, &hot);
    Some(Departure {
        id: IDS[1],
        parameters: vec![("fraction", share), ("rate", rate)],
        statistic: strongest,
        threshold: PIXEL_SIGMAS,
        share,
        polarity,
        pixels: hot,
        seen,
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Root mean square difference, over pairs of frames, of the sum of a pixel's events and the change of its
/// frames, natural-log units. A busy pixel that sees much change agrees with its frames. 0 without frames.
fn disagreement(case: &Case, nominal: Option<&Nominal>, pixel: usize) -> f64 {
    let (Some(nominal), Some(frames)) = (nominal, &case.frames) else { return 0.0 };
    let (_, row) = case.pixel_place(pixel);
    let events = case.events.of_pixel(pixel);
    let signal = |frame: usize| f64::max(case.dn(frame, pixel) - nominal.number.black_level, 1.0);
    let middle = |frame: usize| {
        let exposure = frames.times.exposure(frame, row);
        i64::midpoint(exposure.start.0, exposure.end.0)
    };
    let before = |t_ns: i64| events.partition_point(|event| event.t_in_ns < t_ns);
    let squares = (1..frames.times.len()).filter_map(|frame| {
        let step = |polarity: i8| {
            if polarity > 0 { nominal.pixel.threshold_on } else { -nominal.pixel.threshold_off }
        };
        let sum: f64 = events[before(middle(frame - 1))..before(middle(frame))]
            .iter()
            .map(|event| step(event.polarity))
            .sum();
        let off = sum - libm::log(signal(frame) / signal(frame - 1));
        off.is_finite().then_some(off * off)
    });
    let (count, sum) = squares.fold((0.0, 0.0), |(count, sum), square| (count + 1.0, sum + square));
    libm::sqrt(sum / f64::max(count, 1.0))
}

/// In how many of [`PARTS`] equal parts of the recording some pixels have more events than their reference
/// pixels have on average.
fn steady(case: &Case, pixels: &[usize], reference: impl Fn(usize) -> Vec<usize>) -> usize {
    let length = ((case.span.1 - case.span.0) / PARTS as i64).max(1);
    let part = |t_ns: i64| (((t_ns - case.span.0) / length) as usize).min(PARTS - 1);
    let mut excess = [0.0; PARTS];
    for &pixel in pixels {
        case.events.of_pixel(pixel).iter().for_each(|event| excess[part(event.t_in_ns)] += 1.0);
        let others = reference(pixel);
        for &other in &others {
            case.events
                .of_pixel(other)
                .iter()
                .for_each(|event| excess[part(event.t_in_ns)] -= 1.0 / others.len() as f64);
        }
    }
    excess.iter().filter(|excess| **excess > 0.0).count()
}

/// The sign that prevails by nine to one.
fn polarity(case: &Case, pixels: &[u32]) -> &'static str {
    let (mut on, mut all) = (0, 0);
    for &pixel in pixels {
        on += case.events.of_pixel(pixel as usize).iter().filter(|event| event.polarity > 0).count();
        all += case.events.of_pixel(pixel as usize).len();
    }
    if on * 10 > all * 9 {
        "on"
    } else if on * 10 < all {
        "off"
    } else {
        "both"
    }
}
