//! The curve of what is reported without a name, over what it depends on.

use super::plot::{Plot, Scale};
use super::svg::COLOURS;
use crate::covariates::Covariate;
use crate::dependence::{Dependence, Moved};
use crate::report::short as number;
use photocurrent_page::escaped;
use std::fmt::Write;

const GREY: &str = "var(--edge)";

/// The curve of what has no name.
pub(super) fn unnamed(html: &mut String, dependence: &Dependence) {
    let (what, unit, factor) = match dependence.moved {
        Moved::Stamps => ("how much later stamps are", "us", 1e6),
        Moved::Threshold => ("how much higher thresholds are", "%", 100.0),
        Moved::Rate => ("how many more ON than OFF events without light a pixel fires", "Hz", 1.0),
        Moved::EventRate => ("how much more often events come", "%", 100.0),
    };
    let rhythm =
        dependence.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", number(1.0 / period_s)));
    let (name, measured) = (escaped(dependence.covariate.name()), number(dependence.significance));
    let against = if dependence.moved == Moved::EventRate { "than around" } else { "than described" };
    let unit_of_significance =
        if dependence.moved == Moved::EventRate && dependence.covariate == Covariate::FramePhase {
            "times what chance gives"
        } else {
            "standard errors from nothing"
        };
    let _ = writeln!(
        html,
        "<p class=\"note\">{what} {against}, over {name}{rhythm}; bars: 95 %. It is {measured} \
         {unit_of_significance}, removes {:.1} % of the squares \
         and gains {} nats an event on events that it was not fitted to.</p>",
        100.0 * dependence.taken,
        number(dependence.nats_per_event)
    );
    let points: Vec<(f64, f64, f64)> = (0..dependence.at.len())
        .map(|k| (dependence.at[k], factor * dependence.value[k], 1.96 * factor * dependence.error[k]))
        .collect();
    html.push_str(&over(dependence.covariate, &points, unit));
}

/// Points with half lengths of their bars over a covariate, joined by a line, and a flat line at 0.
fn over(covariate: Covariate, points: &[(f64, f64, f64)], unit: &str) -> String {
    let ends = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |ends, point| (ends.0.min(point.0), ends.1.max(point.0)));
    // Intervals and loads lie over decades.
    let is_of_a_clock = matches!(covariate, Covariate::Time | Covariate::FramePhase);
    let scale = if !is_of_a_clock && ends.0 > 0.0 && ends.1 > 8.0 * ends.0 {
        Scale::Logarithmic
    } else {
        Scale::Linear
    };
    // Room on both sides, so that points of a class do not stand on the axis.
    let room = if scale == Scale::Linear { 0.06 * (ends.1 - ends.0) } else { 0.0 };
    let rims = [(ends.0 - room, 0.0), (ends.1 + room, 0.0)];
    let reach = points.iter().flat_map(|(at, value, bar)| [(*at, value - bar), (*at, value + bar)]);
    let mut plot = Plot::with_rows(reach.chain(rims), 700.0, 230.0, scale, &[]);
    plot.line(&rims, GREY, Some("4 3"));
    plot.line(
        &points.iter().map(|(at, value, _)| (*at, *value)).collect::<Vec<_>>(),
        COLOURS[0],
        Some("1 3"),
    );
    plot.points(points, COLOURS[0], 0.0);
    plot.name(COLOURS[0], "measured");
    plot.close(&axis(covariate), unit)
}

/// A covariate with its unit, as the name of an axis.
fn axis(covariate: Covariate) -> String {
    let unit = match covariate {
        Covariate::Time
        | Covariate::FramePhase
        | Covariate::TimeSinceLastEvent
        | Covariate::NeighbourEvent => ", s",
        Covariate::AcPhase => ", periods",
        Covariate::Photocurrent => ", ln",
        Covariate::Slope => ", 1/s",
        Covariate::Lag => ", ln units",
        Covariate::SpatialGradient => ", 1/px",
        Covariate::LocalRate | Covariate::RowRate | Covariate::GlobalRate => ", events in a millisecond",
        Covariate::Radius => ", 1 = corner",
        _ => "",
    };
    format!("{}{unit}", covariate.name())
}
