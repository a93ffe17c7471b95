//! Chart of an uncatalogued dependence over its covariate.

use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, Dependence};
use crate::report::{four_digits as number, six_digits};
use photocurrent_page::{Curve, Panel, escaped};
use std::fmt::Write;

/// Appends the chart of an uncatalogued dependence.
pub(super) fn append_unexplained(html: &mut String, charts: &mut Vec<Panel>, dependence: &Dependence) {
    let (what, unit, factor) = match dependence.moved {
        AffectedQuantity::Stamps => ("how much later stamps are", "us", 1e6),
        AffectedQuantity::Threshold => ("how much higher thresholds are", "%", 100.0),
        AffectedQuantity::Rate => ("how many more ON than OFF events without light a pixel fires", "Hz", 1.0),
        AffectedQuantity::EventRate => ("how much more often events come", "%", 100.0),
    };
    let rhythm =
        dependence.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", number(1.0 / period_s)));
    let (name, measured) = (escaped(dependence.covariate.name()), number(dependence.significance));
    let against =
        if dependence.moved == AffectedQuantity::EventRate { "than around" } else { "than described" };
    let unit_of_significance =
        if dependence.moved == AffectedQuantity::EventRate && dependence.covariate == Covariate::FramePhase {
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
    points_panel(dependence.covariate, &points, unit).put(html, charts);
}

/// Points with half lengths of their bars, as a curve.
pub(super) fn measured(points: &[(f64, f64, f64)]) -> Curve {
    let rounded =
        points.iter().map(|&(at, value, bar)| [at, value, value - bar, value + bar].map(six_digits));
    let rounded: Vec<[f64; 4]> = rounded.filter(|point| point.iter().all(|of| of.is_finite())).collect();
    Curve {
        label: "measured".into(),
        dots: true,
        whiskers: true,
        points: rounded.iter().map(|[at, value, ..]| (*at, Some(*value))).collect(),
        band: rounded.iter().map(|[at, _, low, high]| (*at, *low, *high)).collect(),
        ..Curve::default()
    }
}

/// Points with half lengths of their bars over a covariate.
fn points_panel(covariate: Covariate, points: &[(f64, f64, f64)], unit: &str) -> Panel {
    let ends = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |ends, point| (ends.0.min(point.0), ends.1.max(point.0)));
    // Intervals and loads lie over decades.
    let is_of_a_clock = matches!(covariate, Covariate::Time | Covariate::FramePhase);
    let is_log = !is_of_a_clock && ends.0 > 0.0 && ends.1 > 8.0 * ends.0;
    // Room on both sides, so that points of a class do not stand on the axis.
    let room = if is_log { 0.0 } else { 0.06 * (ends.1 - ends.0) };
    Panel {
        x: axis(covariate),
        y: unit.into(),
        is_log,
        has_zero: true,
        x_range: (ends.1 > ends.0).then(|| [six_digits(ends.0 - room), six_digits(ends.1 + room)]),
        series: vec![measured(points)],
        ..Panel::default()
    }
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
