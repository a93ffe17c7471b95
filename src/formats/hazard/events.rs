//! Hazards of an event stream by itself: unit, clock, stamps, polarity, places.

use super::{Findings, Severity, count, percent, time};
use crate::declared::Counter;
use crate::survey::EventsSurvey;
use crate::survey::places::{LinesSurvey, PlacesSurvey};
use crate::survey::stamps::StampsSurvey;

/// Adds what there is to say.
pub(super) fn judge(events: &EventsSurvey, format: &str, found: &mut Findings) {
    if events.count == 0 {
        found.error(
            "no_events",
            "there is an event stream and no event in it",
            "0 events were read",
            "check the recording: was the event sensor on, and is this the right camera or topic?",
        );
        return;
    }
    if let Some(stated) = events.stated_count.filter(|stated| *stated != events.count && !events.is_cut) {
        found.hazard(
            "event_count",
            "the file says that it holds another number of events than it does",
            format!("{stated} are stated, {} could be read", events.count),
            "copy the file again from where it came",
        );
    }
    if events.count >= found.limits.fewest_events {
        unit(events, found);
        stamps(events, found);
        polarity(events, found);
    }
    for convention in &events.conventions {
        found.fact(convention.id, &convention.what, &convention.evidence, &convention.otherwise);
    }
    clock(events, format, found);
    places(events, found);
    if let Some(in_pixel) = &events.in_pixel {
        if in_pixel.early as f64 > found.limits.early_share * events.count as f64 {
            found.error(
                "early_in_pixel_times",
                "events leave the array before they fire",
                format!("{} of {} have t < t_in", in_pixel.early, events.count),
                "check which column is the in-pixel time, and that both have one unit and one zero",
            );
        } else if in_pixel.early > 0 {
            found.hazard(
                "some_early_in_pixel_times",
                "a few events leave the array before they fire",
                format!("{} of {} have t < t_in", in_pixel.early, events.count),
                "rounding of one of the two stamps does this; they will be refused by `check`",
            );
        }
    }
}

fn unit(events: &EventsSurvey, found: &mut Findings) {
    let (seconds, Some(rate)) = (events.seconds(), events.rate_of_pixel_hz()) else { return };
    let all = events.count as f64 / seconds;
    // One instant for everything is no rate.
    let evidence = format!(
        "{} events of {} pixels in {}: {all:.3e} a second, {rate:.3e} a pixel and second; stored as {}",
        events.count,
        events.pixels(),
        time(seconds * 1e9),
        if events.stored_as.is_empty() { "not stated" } else { &events.stored_as }
    );
    if rate > found.limits.fastest_pixel_hz || all > found.limits.fastest_array_hz {
        // A unit by its name could be the one that is in use.
        let times =
            if rate > 1e3 * found.limits.fastest_pixel_hz { "a million or more" } else { "a thousand" };
        found.error(
            "unit_too_small",
            "events come faster than any sensor gives them: the stamps are of a larger unit than they are \
             read in",
            evidence,
            format!(
                "state the unit of the stamps; one that is {times} times larger would make the rate plausible"
            ),
        );
    } else if rate < found.limits.slowest_pixel_hz {
        found.hazard(
            "unit_too_large",
            "events come slower than the noise of any sensor: the stamps may be of a smaller unit than they \
             are read in",
            evidence,
            "state the unit of the stamps; one that is a thousand or more times smaller would make the rate \
             plausible",
        );
    }
    if events.stamps.step_ns >= 1_000_000_000 {
        found.hazard(
            "stamps_are_whole_seconds",
            "every stamp is a whole number of seconds: they may be frame indices, or counts of another unit",
            format!("all stamps lie on a grid of {}", time(events.stamps.step_ns as f64)),
            "state the unit of the stamps",
        );
    }
    if let Some(short) = events.places.interval_quantile_ns(0.01).filter(|short| {
        *short < found.limits.shortest_interval_ns && rate > 0.02 * found.limits.fastest_pixel_hz
    }) {
        found.hazard(
            "intervals_too_short",
            "pixels fire again at once: the stamps may be of a larger unit than they are read in",
            format!(
                "one in a hundred events follows the one before of its pixel and sign within {}",
                time(short)
            ),
            "state the unit of the stamps, or look for pixels that oscillate",
        );
    }
}

fn stamps(events: &EventsSurvey, found: &mut Findings) {
    let stamps = &events.stamps;
    if stamps.step_ns == 0 {
        found.error(
            "clock_stands",
            "all events have one and the same stamp",
            format!(
                "{} events at {}",
                events.count,
                events.span_ns.map_or_else(String::new, |span| time(span.0 as f64))
            ),
            "check which column or dataset is the time",
        );
        return;
    }
    shared(stamps, found);
    coarse(stamps, found);
    single_precision(events, found);
    stray(events, found);
}

/// Stamps that many events have.
fn shared(stamps: &StampsSurvey, found: &mut Findings) {
    // A clock of that step is reported as such.
    let is_clumped = stamps.equal_share > found.limits.clump_share
        && stamps.median_step_ns >= found.limits.clump_step_ns.max(2 * stamps.step_ns);
    if is_clumped {
        found.hazard(
            "clumps",
            "events come in clumps of one stamp: their time is known to a clump only",
            format!(
                "{} of the events have the stamp of the one before, up to {} in a row, and the next clump \
                 is {} away",
                percent(stamps.equal_share),
                stamps.longest_equal,
                time(stamps.median_step_ns as f64)
            ),
            "events of a simulator need finer steps of its video; of a camera, look for a driver that \
             stamps packets",
        );
    } else if stamps.equal_share > found.limits.equal_share {
        found.fact(
            "equal_stamps",
            "many events share their stamp with the one before",
            format!(
                "{} of them, up to {} in a row; stamps of different neighbours differ by {} most often",
                percent(stamps.equal_share),
                stamps.longest_equal,
                time(stamps.common_step_ns as f64)
            ),
            "nothing, if the read-out gives a row one stamp; order within a stamp carries no information",
        );
    }
}

/// Stamps on a grid that is wider than the format's.
fn coarse(stamps: &StampsSurvey, found: &mut Findings) {
    if stamps.step_ns >= found.limits.coarse_times * stamps.tick_ns {
        let bits = stamps.step_ns / stamps.tick_ns;
        let frozen = if stamps.step_ns % stamps.tick_ns == 0 && bits.count_ones() == 1 {
            format!("; the lowest {} bits never change", bits.trailing_zeros())
        } else {
            String::new()
        };
        let is_bad = stamps.step_ns >= found.limits.clump_step_ns;
        found.add(
            "coarse_stamps",
            if is_bad { Severity::Hazard } else { Severity::Fact },
            "stamps are coarser than their format",
            format!(
                "all lie on a grid of {}, the format's step is {}{frozen}",
                time(stamps.step_ns as f64),
                time(stamps.tick_ns as f64)
            ),
            "state the step as the resolution of the stamps where a method asks for it; a decoder that \
             drops bits does this too",
        );
    }
}

/// Stamps that lost digits as single-precision seconds.
fn single_precision(events: &EventsSurvey, found: &mut Findings) {
    let stamps = &events.stamps;
    if stamps.float_tested >= found.limits.float_fewest
        && stamps.float_hits as f64 >= found.limits.float_share * stamps.float_tested as f64
        && stamps.step_ns < 1_000_000
    {
        let latest = events.span_ns.map_or(0, |span| span.1);
        let step = libm::exp2(libm::floor(libm::log2(latest.max(1) as f64 * 1e-9)) - 23.0) * 1e9;
        found.hazard(
            "single_precision",
            "stamps were single-precision seconds once: their step grows with time",
            format!(
                "{} of {} late stamps are such numbers; at the end their step is {}",
                stamps.float_hits,
                stamps.float_tested,
                time(step)
            ),
            "convert again from the source with double precision or whole numbers",
        );
    }
}

/// Stamps far from all others.
fn stray(events: &EventsSurvey, found: &mut Findings) {
    let rate = &events.rate;
    if rate.counts.len() >= 50 {
        let empty = rate.counts.iter().filter(|n| **n == 0).count();
        let kept = (found.limits.stray_span * rate.counts.len() as f64).ceil() as usize;
        // Ends of the stretch are stamps, not edges of bins, which may be seconds wide.
        if let Some((inside, first, last)) = rate.densest(kept)
            && inside as f64 >= found.limits.stray_share * events.count as f64
            && empty * 10 > rate.counts.len() * 8
        {
            found.hazard(
                "stray_stamps",
                "a few events lie far from all others in time",
                format!(
                    "{inside} of {} events lie in {} of a span of {}; {} beyond",
                    events.count,
                    percent(last.saturating_sub(first) as f64 * 1e-9 / events.seconds()),
                    time(events.seconds() * 1e9),
                    count(events.count.saturating_sub(inside), "lies", "lie")
                ),
                "cut the recording to the span that is full, and look for damaged packets",
            );
        }
    }
}

fn clock(events: &EventsSurvey, format: &str, found: &mut Findings) {
    let stamps = &events.stamps;
    if stamps.furthest_back_ns > found.limits.back_ns {
        let furthest = stamps.back_examples.iter().max_by_key(|step| step.from_ns.saturating_sub(step.to_ns));
        let place = furthest.map_or_else(String::new, |step| {
            format!(
                ", at event {}: from {} to {}",
                step.event,
                time(step.from_ns as f64),
                time(step.to_ns as f64)
            )
        });
        let evidence = format!(
            "time goes back {}, {} at most{place}",
            count(stamps.backward, "time", "times"),
            time(stamps.furthest_back_ns as f64)
        );
        let size = stamps.furthest_back_ns as f64;
        match Counter::ALL.iter().find(|counter| {
            (size - counter.range_ns() as f64).abs() < found.limits.wrap_share * counter.range_ns() as f64
        }) {
            Some(counter) => found.error(
                "counter_wrap",
                "a counter started again, and nobody added its range",
                format!("{evidence}; {} have that range", counter.name()),
                if crate::convention::FORMATS.contains(&format) {
                    format!(
                        "state the counter, `counter = \"{}\"`, so that its range is added; or cut the \
                             recording there",
                        counter.word()
                    )
                } else {
                    "convert again with a reader that follows the counter, or cut the recording there".into()
                },
            ),
            None => found.hazard(
                "time_goes_back",
                "time goes back further than a read-out mixes events",
                evidence,
                "look whether several recordings were joined, or a clock was set; cut the recording there",
            ),
        }
    } else if stamps.backward > 0 {
        found.fact(
            "not_in_order",
            "events are not quite in order of time",
            format!(
                "{} of {} are earlier than the one before, by {} at most",
                stamps.backward,
                events.count,
                time(stamps.furthest_back_ns as f64)
            ),
            "nothing: they are sorted when they are read",
        );
    }
    if let Some((first, last)) = events.span_ns.filter(|_| format.contains("evt3")) {
        // 24 bits of microseconds: what public decoders get wrong.
        let range = 16_777_216_000;
        let wraps = last.div_euclid(range) - first.div_euclid(range);
        if wraps > 0 {
            found.fact(
                "counter_wrap_followed",
                "the 24-bit counter of EVT3 starts again within the recording, and was followed",
                format!(
                    "{} between {} and {}",
                    count(wraps as u64, "time", "times"),
                    time(first as f64),
                    time(last as f64)
                ),
                "nothing; other decoders may give times that are 16.777216 s off",
            );
        }
    }
}

fn polarity(events: &EventsSurvey, found: &mut Findings) {
    let on = events.on_share();
    if on > found.limits.one_polarity || on < 1.0 - found.limits.one_polarity {
        found.hazard(
            "one_polarity",
            format!("nearly all events are {}", if on > 0.5 { "ON" } else { "OFF" }),
            format!("{} of {} are ON", events.on, events.count),
            "check the coding of polarity (0 and 1, -1 and +1), and the biases of the camera",
        );
    }
}

fn places(events: &EventsSurvey, found: &mut Findings) {
    let places = &events.places;
    extent(events, found);
    hot_pixels(places, found);
    lines("row", &places.rows, found);
    lines("column", &places.columns, found);
    if events.count >= found.limits.fewest_events
        && places.duplicates as f64 > found.limits.duplicate_share * events.count as f64
    {
        found.hazard(
            "duplicate_events",
            "events are there twice: same time, place and sign",
            format!("{} of {}", places.duplicates, events.count),
            "look whether parts of the recording overlap; a pixel cannot fire twice at one instant",
        );
    }
}

/// What events reach, against the stated size of the pixel array.
fn extent(events: &EventsSurvey, found: &mut Findings) {
    let places = &events.places;
    let (x, y) = places.largest;
    let begins_at_one = places.smallest == (1, 1) && events.count >= found.limits.fewest_events;
    match events.extent {
        None => found.question(
            "extent_unknown",
            "the size of the pixel array is not recorded",
            format!(
                "events reach column {x} and row {y}{}",
                if begins_at_one { ", and none lies in column 0 or row 0" } else { "" }
            ),
            if begins_at_one {
                "state the extent; if coordinates begin at 1, as programs of MATLAB write them, state \
                 `origin = 1` too"
            } else {
                "state the extent; the largest coordinates are its least size"
            },
        ),
        Some((width, height)) if x >= width || y >= height => found.error(
            "outside",
            "events lie outside of the stated pixel array",
            format!("they reach column {x} and row {y} of {width} x {height} pixels"),
            if y >= height && x < height {
                "columns and rows may be swapped"
            } else {
                "state the extent, or the scale of the coordinates"
            },
        ),
        Some((width, height)) if events.count >= found.limits.fewest_events => {
            let (used_x, used_y) =
                (f64::from(x + 1) / f64::from(width), f64::from(y + 1) / f64::from(height));
            if used_x <= found.limits.used_share && used_y <= found.limits.used_share {
                found.hazard(
                    "small_part_used",
                    "events use a small part of the pixel array: its size or their scale may be wrong",
                    format!("they reach column {x} and row {y} of {width} x {height} pixels"),
                    "check the extent and the scale of the coordinates; a region of interest does this too",
                );
            } else if width > height && x < height && y + 1 == height {
                found.hazard(
                    "swapped",
                    "columns and rows may be swapped",
                    format!(
                        "columns reach {x}, rows {y}, of {width} x {height} pixels: the columns that \
                             are no rows are empty"
                    ),
                    "look at a picture of the events; state the columns in the order in which they are \
                     stored",
                );
            }
        }
        Some(_) => {}
    }
}

/// Pixels that fire far more than others.
fn hot_pixels(places: &PlacesSurvey, found: &mut Findings) {
    if places.hot_pixels > 0 {
        let first: Vec<String> = places
            .hottest
            .iter()
            .take(3)
            .map(|pixel| format!("({}, {}): {}", pixel.x, pixel.y, pixel.events))
            .collect();
        found.add(
            "hot_pixels",
            if places.hot_share > found.limits.hot_share { Severity::Hazard } else { Severity::Fact },
            "some pixels fire far more than those around them",
            format!(
                "{}, {} of the events; {}",
                count(places.hot_pixels, "pixel", "pixels"),
                percent(places.hot_share),
                first.join(", ")
            ),
            "state `hot_pixels` in the description or mask them; a lamp that blinks does this too",
        );
    }
}

fn lines(what: &str, lines: &LinesSurvey, found: &mut Findings) {
    let list = |of: &[u32]| of.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    let several = |n: u64| count(n, what, &format!("{what}s"));
    if lines.silent > 0 {
        found.hazard(
            if what == "row" { "silent_rows" } else { "silent_columns" },
            format!("{} without any event, between others that have many", several(lines.silent)),
            format!("{what} {}", list(&lines.silent_list)),
            "a damaged sensor, a read-out that skips, or coordinates that were multiplied or rounded",
        );
    }
    if lines.loud > 0 {
        found.fact(
            if what == "row" { "loud_rows" } else { "loud_columns" },
            format!("{} with over three times the events of their neighbours", several(lines.loud)),
            format!("{what} {}", list(&lines.loud_list)),
            "state `hot_rows` in the description if it is the sensor; a lamp or an edge along it does this \
             too",
        );
    }
    if let Some(pattern) = lines.pattern {
        found.fact(
            if what == "row" { "row_pattern" } else { "column_pattern" },
            format!("counts of {what}s repeat with a period of {}", pattern.period),
            format!(
                "{what}s {} + {} n have {:.2} times the events of the others ({:.0} sigma)",
                pattern.phase, pattern.period, pattern.ratio, pattern.sigma
            ),
            "thresholds differ between them, or coordinates were rounded; keep it in mind when thresholds \
             are calibrated",
        );
    }
}
