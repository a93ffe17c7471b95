//! Pages are whole, and safe to open.

use super::*;
use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, Dependence};
use crate::diagnose::{ConfirmSetting, check, confirm, unreadable_report};
use crate::residual::located::{EffectLocations, GainingValues, LocatedSetting, LocationData};
use crate::stages::{EffectProposal, SceneDecision, Unexplained};
use crate::testing;

/// Is the page complete, without external resources and without numbers that are not finite?
fn is_sound(html: &str) {
    assert!(html.starts_with("<!doctype html>") && html.ends_with("</html>\n"));
    let data = charts(html).to_string();
    assert!(!data.contains("null"), "{data}");
    // Style and scripts are those of all pages, and tested there.
    let html = &html[html.find("<body>").unwrap()..html.find("<script").unwrap()];
    for part in ["src=", "<link", "NaN", "inf"] {
        assert!(!html.contains(part), "{part}");
    }
    for tag in ["svg", "table", "div", "h2", "h3", "p"] {
        let (open, close) = (
            html.matches(&format!("<{tag}>")).count() + html.matches(&format!("<{tag} ")).count(),
            html.matches(&format!("</{tag}>")).count(),
        );
        assert_eq!(open, close, "{tag}");
    }
}

/// The charts that the script draws.
fn charts(html: &str) -> serde_json::Value {
    let data = html.split("id=\"page-data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let charts = serde_json::from_str::<serde_json::Value>(data).unwrap()["charts"].take();
    assert_eq!(charts.as_array().unwrap().len(), html.matches("data-chart=").count());
    charts
}

fn diagnosed(case: &Case, proposed: DecisionOutcome) -> Diagnosis {
    confirm(case, &ConfirmSetting::default(), check(case).unwrap(), proposed).unwrap()
}

#[test]
fn a_page_is_whole_and_needs_no_other_file() {
    let case = testing::case();
    let found = diagnosed(&case, DecisionOutcome::NotAsked);
    let html = page(&found.report, Some(&case), Some(&found));
    is_sound(&html);
    for part in [
        "consistent",
        "Held-out frames",
        "Three pixels",
        "Not identifiable from this recording",
        "Evaluated parts",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains(">fitted</text>"), "nothing is fitted");
    assert!(!charts(&html).to_string().contains("fitted"));
    assert_eq!(html, page(&found.report, Some(&case), Some(&found)));
}

#[test]
fn what_is_claimed_is_shown_before_and_after() {
    let leak = serde_json::json!({"rate": "25 Hz"});
    let case = testing::case_with(
        &[("leak_events".to_owned(), leak.as_object().unwrap().clone())].into_iter().collect(),
    );
    let candidate = CANDIDATES.iter().position(|one| one.id == "leak_events").unwrap();
    let proposal = EffectProposal {
        candidate,
        score: 1.1,
        probability: 0.9,
        value: 25.0,
        passed: true,
        ..EffectProposal::default()
    };
    let found = diagnosed(
        &case,
        DecisionOutcome::Decided(Box::new(SceneDecision {
            name: "picture".into(),
            detected: true,
            proposals: vec![proposal],
            ..SceneDecision::default()
        })),
    );
    let html = page(&found.report, Some(&case), Some(&found));
    is_sound(&html);
    for part in [
        "What the description lacks",
        "leak_events.rate",
        "PSNR of held-out frames",
        "<td class=\"number\">25 Hz</td>",
    ] {
        assert!(html.contains(part), "{part}");
    }
    // Two maps, a curve and three pixels are of both.
    let drawn = charts(&html).to_string();
    let [nominal, fitted] = ["nominal", "fitted"].map(|word| {
        html.matches(&format!(">{word}</text>")).count()
            + drawn.matches(&format!("\"label\":\"{word}\"")).count()
    });
    assert!(fitted > 4 && nominal == fitted, "{nominal} {fitted}");
}

#[test]
fn a_curve_without_a_name_is_drawn_as_it_was_measured() {
    let case = testing::case();
    let dependence = Dependence {
        at: vec![0.0, 1.0],
        value: vec![0.11, -0.11],
        error: vec![0.01, 0.01],
        taken: 0.2,
        significance: 9.0,
        nats_per_event: 0.1,
        ..Dependence::empty_over(Covariate::RowParity, AffectedQuantity::Threshold)
    };
    let unexplained = Unexplained {
        covariate: dependence.covariate.name().into(),
        score: 2.0,
        dependence: Some(dependence),
        ..Unexplained::default()
    };
    let decided = SceneDecision {
        name: "picture".into(),
        detected: true,
        unexplained: Some(unexplained),
        ..SceneDecision::default()
    };
    let found = diagnosed(&case, DecisionOutcome::Decided(Box::new(decided)));
    assert_eq!(found.report.verdict, Verdict::Unnamed);
    let html = page(&found.report, Some(&case), Some(&found));
    is_sound(&html);
    assert!(html.contains("The curve without a name") && html.contains("over row_parity"));
    assert!(html.split("id=\"curve\"").nth(1).unwrap().contains("data-chart=\"0\""));
    let curve = &charts(&html)[0]["series"][0];
    assert_eq!(curve["points"], serde_json::json!([[0.0, 11.0], [1.0, -11.0]]));
    assert_eq!(curve["band"], serde_json::json!([[0.0, 9.04, 12.96], [1.0, -12.96, -9.04]]));
    assert_eq!(curve["whiskers"], true);
}

#[test]
fn a_part_of_the_array_is_reported_and_framed_on_a_picture_of_the_scene() {
    let leak = serde_json::json!({"rate": "25 Hz"});
    let case = testing::case_with(
        &[("leak_events".to_owned(), leak.as_object().unwrap().clone())].into_iter().collect(),
    );
    let (mut pixel, mut t_ns, mut polarity) = (Vec::new(), Vec::new(), Vec::new());
    for at in 0..case.events.pixels() {
        for event in case.events.of_pixel(at) {
            pixel.push(at as u32);
            t_ns.push(event.t_in_ns);
            polarity.push(event.polarity);
        }
    }
    let place = |k: usize| case.pixel_place(pixel[k] as usize);
    let block: Vec<u32> = (0..pixel.len())
        .map(|k| 2 * (place(k).1 / 2 * 6 + place(k).0 / 2) + (place(k).0 / 2 + place(k).1 / 2) % 2)
        .collect();
    let light: Vec<f64> = t_ns.iter().map(|t| *t as f64 * 1e-9).collect();
    let gains: Vec<f64> = (0..pixel.len())
        .map(|k| if place(k).0 < 6 { 1.0 + 0.1 * (k % 7) as f64 } else { 0.01 * (k % 7) as f64 - 0.02 })
        .collect();
    let setting = LocatedSetting { least_events: 20, rim_events: 4, ..LocatedSetting::default() };
    let on =
        GainingValues { pixel: &pixel, t_ns: &t_ns, polarity: &polarity, log_light: &light, block: &block };
    let located = LocationData::new(&case, on, &[], &setting).locate(&gains, "time_since_last_event");
    assert_eq!(located.columns.range, [0, 5]);
    let candidate = CANDIDATES.iter().position(|one| one.id == "leak_events").unwrap();
    let proposal = EffectProposal {
        candidate,
        score: 1.1,
        probability: 0.9,
        value: 25.0,
        passed: true,
        ..EffectProposal::default()
    };
    let decided = SceneDecision {
        name: "picture".into(),
        detected: true,
        proposals: vec![proposal],
        ..SceneDecision::default()
    };
    let with_place = SceneDecision {
        located: EffectLocations { first: vec![(candidate, located)], ..EffectLocations::default() },
        ..decided.clone()
    };
    let found = diagnosed(&case, DecisionOutcome::Decided(Box::new(with_place)));
    let place = &found.report.effects[0].location;
    assert_eq!(
        (place.columns, place.rows, &place.stream[..], place.shape.as_deref()),
        ([0, 5], [0, 9], "events", Some("flat"))
    );
    let html = page(&found.report, Some(&case), Some(&found));
    is_sound(&html);
    let part = html.split("id=\"where\"").nth(1).unwrap().split("</section>").next().unwrap();
    for text in ["columns 0 to 5", "stroke-dasharray=\"6 3\"", "nats an event"] {
        assert!(part.contains(text), "{text}");
    }
    let first = part.split("data-chart=\"").nth(1).unwrap().split('"').next().unwrap();
    let first: usize = first.parse().unwrap();
    for (at, x) in ["row", "time since the start, s", "light: log photocurrent"].iter().enumerate() {
        let chart = &charts(&html)[first + at];
        assert_eq!((&chart["x"], &chart["y"]), (&(*x).into(), &"nats an event".into()));
    }
    // Nothing is located that was not measured.
    let found = diagnosed(&case, DecisionOutcome::Decided(Box::new(decided)));
    assert!(found.located.is_empty() && found.report.effects[0].location.shape.is_none());
    assert!(!page(&found.report, Some(&case), Some(&found)).contains("Where it is"));
}

#[test]
fn files_are_named_in_title_heading_and_lead() {
    let html =
        with_names(&page(&unreadable_report("nothing", 1), None, None), Some("a <b>.h5"), Some("mine.toml"));
    for part in [
        "<title>Diagnosis: a &lt;b&gt;.h5</title>",
        "<h1>Diagnosis: a &lt;b&gt;.h5</h1>",
        "<dd>mine.toml</dd>",
    ] {
        assert!(html.contains(part), "{part}");
    }
}

#[test]
fn effects_near_their_threshold_are_listed_first() {
    let case = testing::case();
    let candidate = CANDIDATES.iter().position(|one| one.id == "leak_events").unwrap();
    let with = |score: f64| {
        let proposal =
            EffectProposal { candidate, score, probability: 1.0, value: 25.0, ..EffectProposal::default() };
        let decided =
            SceneDecision { name: "picture".into(), proposals: vec![proposal], ..SceneDecision::default() };
        let found = diagnosed(&case, DecisionOutcome::Decided(Box::new(decided)));
        page(&found.report, Some(&case), Some(&found))
    };
    let lead = |html: &str| html.split("<section").next().unwrap().to_owned();
    assert!(
        lead(&with(0.8))
            .contains("; near the detection threshold, and not reported: leak_events.rate (80 % of it)")
    );
    assert!(!lead(&with(0.2)).contains("near the detection threshold"));
}

#[test]
fn estimates_stand_in_report_page_and_fitted_description() {
    use crate::report::SceneEstimate;
    use crate::unknowns::unknowns;
    use photocurrent_core::quantity::Duration;
    use photocurrent_core::sensor::Range;
    let mut case = testing::case();
    let range = Range::Time([1_000_000, 25_000_000].map(Duration::new));
    case.sensor.ranges.insert("front_end.alpha".to_owned(), range);
    let unknown = &unknowns(&case.sensor)[0];
    let estimated: Vec<SceneEstimate> = vec![unknown.estimated(libm::log(6e-3), 0.1)];
    let decided =
        SceneDecision { name: "joint".into(), estimated: estimated.clone(), ..SceneDecision::default() };
    let found = diagnosed(&case, DecisionOutcome::Decided(Box::new(decided)));
    assert_eq!(found.report.estimated, estimated);
    // Found or not: the estimate is in the description, and nothing is open any more.
    let fitted = found.fitted.as_ref().unwrap();
    assert_eq!(fitted.front_end.alpha, Some(Duration::new(6_000_000)));
    assert!(fitted.ranges.is_empty() && found.report.sensor_fitted.is_some());
    let html = page(&found.report, Some(&case), Some(&found));
    assert!(html.contains("Estimated with the scene") && html.contains("front_end.alpha"));
    assert!(html.contains("1 ms to 25 ms") && found.report.summary.contains("front_end.alpha 6 ms"));
    // Without a range there is no such table.
    let without = diagnosed(&testing::case(), DecisionOutcome::NotAsked);
    assert!(!page(&without.report, Some(&case), Some(&without)).contains("Estimated with the scene"));
}

#[test]
fn text_of_a_file_cannot_become_markup() {
    let html = page(&unreadable_report("<script>alert(1)</script> & more", 1), None, None);
    assert!(
        html.contains("&lt;script&gt;alert(1)&lt;/script&gt; &amp; more") && !html.contains("<script>alert")
    );
}
