//! Findings from direct tests, scenes and episodes: declaration, parameters, evidence and location.

use crate::candidates::{CANDIDATES, Candidate};
use crate::dependence::AffectedQuantity;
use crate::integrity::Departure;
use crate::integrity::episodes::Episode;
use crate::report::{DIRECT, Evidence, Finding, Location, MASK_LIMIT, Parameter};
use crate::stages::{EffectProposal, SceneDecision, Unexplained};
use crate::unstated;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::{EffectDecl, Stage, catalogue};

/// The id of an uncatalogued finding.
pub(crate) const UNNAMED: &str = "unnamed";

impl Finding {
    /// From the departure that a direct test measured.
    pub fn from_departure(case: &Case, nominal: &Nominal, departure: &Departure) -> Finding {
        let decl = decl(departure.id);
        let evidence = Evidence {
            statistic: departure.statistic / departure.threshold,
            heldout_nats: departure.heldout.map(|heldout| heldout.nats),
            heldout_nats_per_event: departure.heldout.map(|heldout| heldout.per_event()),
            found_by: vec![DIRECT.to_owned()],
            ..Evidence::default()
        };
        let mut finding = Finding::from_catalogue(&decl, location(case, &decl, departure), evidence);
        finding.plain = format!("{}: {}", decl.about, departure.seen);
        if let Some((id, because)) = unstated::alternative_explanation(&case.sensor, departure) {
            finding.also_possible.push(id.to_owned());
            finding.plain += &format!("; the front end is not stated, and {because}");
        }
        for (name, value) in &departure.parameters {
            let ci95 = departure.interval(name);
            if let Some(candidate) = Candidate::find(departure.id, name) {
                finding.add_parameter(candidate, *value, ci95, &case.sensor, nominal);
                continue;
            }
            // Numbers that are no candidates of their own.
            finding.values.push((*name, *value));
            if let Some(of) = decl.parameter(name) {
                let unit = of.unit.text().to_owned();
                finding.parameters.insert(
                    format!("{name}{}", of.unit.suffix()),
                    Parameter { estimate: *value, ci95, nominal: of.null, unit },
                );
            }
        }
        finding
    }

    /// From a temporary failure.
    pub fn from_episode(case: &Case, episode: &Episode) -> Finding {
        let decl = episode.failure.id().map(decl);
        let mut location = whole_recording(case, decl.as_ref());
        location.stream = "events".to_owned();
        location.covariate = "time".to_owned();
        let Episode { time_ns, rows, columns, pixels, statistic, seen, .. } = episode;
        (location.time_ns, location.rows, location.columns) = (*time_ns, *rows, *columns);
        let count = |ends: &[u32; 2]| u64::from(ends[1] - ends[0] + 1);
        location.pixels = if pixels.is_empty() { count(rows) * count(columns) } else { pixels.len() as u64 };
        location.pixel_list = pixels.iter().copied().take(MASK_LIMIT).collect();
        let evidence =
            Evidence { statistic: *statistic, found_by: vec![DIRECT.to_owned()], ..Evidence::default() };
        let from_to = time_ns.map(|t_ns| format!("{:.1} ms", t_ns as f64 * 1e-6));
        let plain = format!("from {} to {}: {seen}", from_to[0], from_to[1]);
        match &decl {
            Some(decl) => Finding {
                plain: format!("{}, {plain}", decl.about),
                ..Finding::from_catalogue(decl, location, evidence)
            },
            None => {
                let insertion = episode.failure.insertion();
                Finding {
                    plain: plain.clone(),
                    ..Finding::uncatalogued(plain, insertion, location, evidence)
                }
            }
        }
    }

    /// From a proposal on the scene named `scene`.
    pub fn from_proposal(case: &Case, nominal: &Nominal, scene: &str, proposal: &EffectProposal) -> Finding {
        let candidate = &CANDIDATES[proposal.candidate];
        let evidence = Evidence {
            statistic: proposal.score,
            p_value: None,
            heldout_nats: proposal.heldout_nats,
            heldout_nats_ci95: proposal.heldout_nats_ci95,
            heldout_nats_per_event: proposal.heldout_nats_per_event,
            posterior: Some(proposal.probability),
            found_by: vec![scene.to_owned()],
        };
        let decl = candidate.decl();
        let mut finding = Finding::from_catalogue(&decl, whole_recording(case, Some(&decl)), evidence);
        finding.ks = proposal.ks;
        finding.add_parameter(candidate, proposal.value, proposal.ci95, &case.sensor, nominal);
        finding
    }

    /// From a dependence that no effect of the catalogue explains, on a scene or in a direct test.
    pub fn from_unexplained(case: &Case, found: &Unexplained, decided: Option<&SceneDecision>) -> Finding {
        let mut location = whole_recording(case, None);
        found.located(decided).into_iter().for_each(|located| located.copy_to(&mut location));
        location.covariate.clone_from(&found.covariate);
        let is_direct = found
            .dependence
            .as_ref()
            .is_some_and(|dependence| dependence.moved == AffectedQuantity::EventRate);
        let by = decided.filter(|_| !is_direct).map_or(DIRECT, |decided| &decided.name);
        let evidence = Evidence {
            statistic: found.score,
            heldout_nats_per_event: Some(found.nats),
            found_by: vec![by.to_owned()],
            ..Evidence::default()
        };
        let nameless = Finding::uncatalogued(found.equation.clone(), &found.insertion, location, evidence);
        Finding { also_possible: found.also_possible.clone(), ..nameless }
    }

    /// An uncatalogued finding.
    fn uncatalogued(equation: String, insertion: &str, location: Location, evidence: Evidence) -> Finding {
        Finding {
            id: UNNAMED.into(),
            also_possible: Vec::new(),
            plain: "something that no effect of the catalogue explains".into(),
            equation,
            insertion: insertion.to_owned(),
            parameters: Default::default(),
            location,
            evidence,
            values: Vec::new(),
            ks: None,
        }
    }
}

fn decl(id: &str) -> EffectDecl {
    catalogue()
        .into_iter()
        .map(|kind| kind.decl)
        .find(|decl| decl.id == id)
        .unwrap_or_else(|| unreachable!("findings are of the catalogue"))
}

fn whole_recording(case: &Case, decl: Option<&EffectDecl>) -> Location {
    Location {
        stream: match decl.map(|decl| decl.stage) {
            Some(Stage::Exposure) => "frames",
            None => "both",
            Some(_) => "events",
        }
        .to_owned(),
        polarity: "both".to_owned(),
        rows: [0, case.extent.height.saturating_sub(1)],
        columns: [0, case.extent.width.saturating_sub(1)],
        time_ns: [case.span.0, case.span.1],
        covariate: decl.map_or_else(String::new, |decl| decl.covariate.to_owned()),
        shape: None,
        pixels: case.extent.pixels() as u64,
        pixel_list: Vec::new(),
    }
}

fn location(case: &Case, decl: &EffectDecl, departure: &Departure) -> Location {
    let mut location = whole_recording(case, Some(decl));
    location.polarity = departure.polarity.to_owned();
    if !departure.pixels.is_empty() {
        let places: Vec<(u32, u32)> =
            departure.pixels.iter().map(|&pixel| case.pixel_place(pixel as usize)).collect();
        let ends = |values: Vec<u32>| {
            [values.iter().copied().min().unwrap_or(0), values.iter().copied().max().unwrap_or(0)]
        };
        location.columns = ends(places.iter().map(|place| place.0).collect());
        location.rows = ends(places.iter().map(|place| place.1).collect());
        location.pixels = departure.pixels.len() as u64;
        location.pixel_list = departure.pixels.iter().copied().take(MASK_LIMIT).collect();
    }
    location
}
