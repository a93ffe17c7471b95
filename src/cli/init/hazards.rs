//! What `inspect` finds, `init` acts on: each finding of the part that is read has the consequence that
//! [`photocurrent_formats::hazard::consequence`] lists.

use super::fill::Fill;
use super::readings::Reading;
use crate::failure::{Failure, usage};
use photocurrent_core::Extent;
use photocurrent_formats::hazard::{self, Consequence, Finding, Severity};
use photocurrent_formats::survey::{Interval, Survey};
use photocurrent_formats::{Format, Mirror, Pictures, Shift};
use photocurrent_nodes::read::foreign::{All, Size};
use photocurrent_nodes::read::formats::takes;

/// What was done about the findings.
#[derive(Default)]
pub struct Acts {
    /// Parameters of the reader that were set: corrections, and proposals that are marked.
    pub parameters: Vec<Fill>,
    /// Findings that no parameter holds, a line each.
    pub marks: Vec<String>,
    /// How late events are by a finding that no mirror and no shift explains, ns, and its line.
    pub late: Option<(Interval, String)>,
}

impl Acts {
    fn mark(&mut self, finding: &Finding) {
        self.marks.push(marked(finding));
    }

    /// Sets a parameter, the first time.
    fn set(&mut self, fill: Fill) {
        if !self.parameters.iter().any(|known| known.name == fill.name) {
            self.parameters.push(fill);
        }
    }
}

/// A finding as a line.
fn marked(finding: &Finding) -> String {
    format!("{}: {}; {}. To do: {}", finding.id, finding.message, finding.evidence, finding.what_to_do)
}

/// Where findings come from.
pub struct Evidence<'a> {
    pub survey: &'a Survey,
    pub format: &'a Format,
    /// The frames that were surveyed, and their numbers in the file.
    pub frames: Option<(&'a dyn Pictures, &'a [usize])>,
    /// How both streams agree best, where that was compared.
    pub reading: Option<&'a Reading>,
}

/// Acts on findings; those in `accepted` are not refused.
///
/// # Errors
/// When one is refused: with what was found, the evidence, and the option that states what is true.
pub fn act(
    evidence: &Evidence,
    findings: &[Finding],
    accepted: &[String],
    all: &mut All,
) -> Result<Acts, Failure> {
    let mut acts = Acts::default();
    // A fact is no fault.
    for finding in findings.iter().filter(|finding| finding.severity != Severity::Fact) {
        match hazard::consequence(finding.id) {
            Some(Consequence::Corrects(parameters)) => {
                let parameter = parameters.first().copied().unwrap_or_default();
                match evidence.correction(parameter, finding, all) {
                    Some(fill) if takes(evidence.format.id, parameter) => acts.set(fill),
                    // A window is cut before.
                    None if parameter == "start" && all.start.is_some() => {}
                    _ => acts.mark(finding),
                }
            }
            Some(Consequence::Proposes("clock_offset")) => evidence.late(finding, all, &mut acts),
            Some(Consequence::Proposes(parameter)) => match evidence.proposal(parameter, finding, all) {
                Some(fill) if takes(evidence.format.id, parameter) => acts.set(fill),
                // It was proposed, or is stated, before.
                None if ["exposure", "stamp", "row_time", "transfer"].contains(&parameter) => {}
                None if parameter == "extent" && all.extent.is_some() => {}
                // Another reading explains it better.
                None if evidence.reading.is_some() && ["mirror", "shift"].contains(&parameter) => {}
                _ => acts.mark(finding),
            },
            Some(Consequence::Refuses(option)) if !accepted.iter().any(|id| id == finding.id) => {
                return Err(evidence.refusal(finding, option));
            }
            Some(Consequence::Marks | Consequence::Refuses(_)) => acts.mark(finding),
            Some(Consequence::None) | None => {}
        }
    }
    if let Some(reading) = evidence.reading.filter(|reading| reading.is_inverted)
        && all.invert_polarity.is_none()
        && takes(evidence.format.id, "invert_polarity")
    {
        let why = format!("events and frames agree with ON and OFF exchanged only: {}", reading.why);
        acts.set(Fill::open("invert_polarity", "true", why));
    }
    apply(&acts.parameters, all);
    Ok(acts)
}

impl Evidence<'_> {
    /// What looks late may be mirrored or moved.
    fn late(&self, finding: &Finding, all: &All, acts: &mut Acts) {
        let found = ["mirror", "shift"].map(|parameter| self.proposal(parameter, finding, all));
        let taken = found.into_iter().flatten().filter(|fill| takes(self.format.id, fill.name));
        taken.for_each(|fill| acts.set(fill));
        let is_late = self.reading.is_none_or(|reading| (reading.mirror, reading.shift) == (None, None));
        let late = self.survey.lag.as_ref().and_then(|lag| lag.late_ns).filter(|_| is_late);
        acts.late = late.map(|late| (late, marked(finding)));
    }

    fn refusal(&self, finding: &Finding, option: &str) -> Failure {
        let id = finding.id;
        let parameter = option.trim_start_matches("--").replace('-', "_");
        let is_stated = ["frames", "camera", "frame_camera", "end"].contains(&parameter.as_str())
            || takes(self.format.id, &parameter);
        let state = if is_stated { format!("state what is true: {option}; or ") } else { String::new() };
        usage(format!(
            "{}: {id}: {}\n  {}\n  hint: {}\n  {state}go on all the same: --accept {id}",
            self.survey.format, finding.message, finding.evidence, finding.what_to_do
        ))
    }

    /// A parameter that puts a fault right.
    fn correction(&self, parameter: &str, finding: &Finding, all: &All) -> Option<Fill> {
        match parameter {
            "drop_duplicates" if all.drop_duplicates.is_none() => Some(Fill::settled(
                "drop_duplicates",
                "true",
                format!("{}: {}", finding.message, finding.evidence),
            )),
            "skip_frames" if all.skip_frames.is_none() => {
                let values = &self.survey.frames.as_ref()?.values;
                let mut frames: Vec<usize> = values.unreadable_frames.clone();
                // An even picture everywhere is refused; some of them show nothing.
                if values.constant.len() < values.read.len() {
                    frames.extend(&values.constant);
                }
                frames.extend(&values.repeated);
                let (pictures, numbers) = self.frames?;
                let stamps = &pictures.about().stamps;
                let begin =
                    |frame: usize| stamps[frame].exposure.map_or(stamps[frame].at, |exposure| exposure.0);
                frames.extend((1..stamps.len()).filter(|frame| begin(*frame) == begin(*frame - 1)));
                frames.sort_unstable();
                frames.dedup();
                // Film of which most would go is another fault.
                if frames.is_empty() || 2 * frames.len() > stamps.len() {
                    return None;
                }
                let list = frames
                    .iter()
                    .filter_map(|frame| numbers.get(*frame))
                    .map(usize::to_string)
                    .collect::<Vec<_>>()
                    .join(", ");
                let why = format!(
                    "{}: {}; left out are frames that cannot be read, are even or the one before, or \
                             have its stamp",
                    finding.message, finding.evidence
                );
                Some(Fill::settled("skip_frames", format!("[{list}]"), why))
            }
            _ => None,
        }
    }

    /// A parameter that the files leave open, or that the streams contradict.
    fn proposal(&self, parameter: &str, finding: &Finding, all: &All) -> Option<Fill> {
        let why = format!("{}: {}", finding.message, finding.evidence);
        match parameter {
            "mirror" if all.mirror.is_none() => {
                let reading = self.reading?;
                let way = reading.mirror?;
                let why = format!("{why}; {}", reading.why);
                let word = match way {
                    Mirror::LeftRight => "left_right",
                    Mirror::TopBottom => "top_bottom",
                    Mirror::Both => "both",
                };
                Some(Fill::open("mirror", format!("\"{word}\""), why))
            }
            "shift" if all.shift.is_none() => {
                let reading = self.reading?;
                let Shift { right, down } = reading.shift?;
                let why = format!("{why}; {}", reading.why);
                Some(Fill::open("shift", format!("{{ right = {right}, down = {down} }}"), why))
            }
            "extent" if all.extent.is_none() && finding.id == "small_part_used" => {
                let Reading { extent, why: explained, .. } = self.reading?;
                let Extent { width, height } = (*extent)?;
                Some(Fill::open(
                    "extent",
                    format!("{{ width = {width}, height = {height} }}"),
                    format!("{why}; {explained}"),
                ))
            }
            "extent" if all.extent.is_none() => {
                let (x, y) = self.survey.events.as_ref()?.places.largest;
                let why = format!("{why}; a larger array has more rows or columns than those that fired");
                Some(Fill::open("extent", format!("{{ width = {}, height = {} }}", x + 1, y + 1), why))
            }
            "coordinate_scale" if all.coordinate_scale.is_none() => {
                let scale: u32 = finding
                    .what_to_do
                    .split_once("coordinate_scale = ")
                    .and_then(|(_, rest)| rest.trim_end_matches('`').parse().ok())?;
                Some(Fill::open("coordinate_scale", scale.to_string(), why))
            }
            _ => None,
        }
    }
}

/// Sets the parameters.
fn apply(parameters: &[Fill], all: &mut All) {
    for fill in parameters {
        let text = format!("value = {}", fill.value);
        let Some(value) = text.parse::<toml::Table>().ok().and_then(|mut table| table.remove("value")) else {
            continue;
        };
        match fill.name {
            "invert_polarity" => all.invert_polarity = value.try_into().ok(),
            "drop_duplicates" => all.drop_duplicates = value.try_into().ok(),
            "skip_frames" => all.skip_frames = value.try_into().ok(),
            "mirror" => all.mirror = value.try_into().ok(),
            "shift" => all.shift = value.try_into().ok(),
            "coordinate_scale" => all.coordinate_scale = value.try_into().ok(),
            "extent" => all.extent = value.try_into::<Size>().ok(),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_formats::hazard::consequence::CONSEQUENCES;
    use photocurrent_formats::survey::lag::LagSurvey;
    use photocurrent_formats::survey::pictures::{FramesSurvey, ValuesSurvey};
    use photocurrent_formats::{FrameStamp, FramesAbout, catalog};

    /// Ten frames, of which one repeats the one before.
    struct Film(FramesAbout);

    impl Pictures for Film {
        fn about(&self) -> &FramesAbout {
            &self.0
        }
        fn read(&self, _: usize, _: &mut Vec<f32>) -> Result<(), photocurrent_formats::FormatError> {
            Ok(())
        }
    }

    fn film() -> Film {
        let extent = photocurrent_core::Extent { width: 4, height: 3 };
        let stamps = (0..10).map(|l| FrameStamp { at: 10 * l, exposure: None }).collect();
        let colour = photocurrent_core::Colour::Mono;
        Film(FramesAbout {
            extent,
            colour,
            bits: 8,
            stamps,
            stamp_role: None,
            row_time_ns: None,
            transfer: None,
            notes: Vec::new(),
        })
    }

    fn survey() -> Survey {
        let values = ValuesSurvey { read: (0..10).collect(), repeated: vec![3], ..ValuesSurvey::default() };
        let frames = FramesSurvey { values, ..FramesSurvey::default() };
        Survey {
            format: "npz".into(),
            events: Some(Default::default()),
            frames: Some(frames),
            lag: Some(LagSurvey::default()),
            ..Survey::default()
        }
    }

    fn of(id: &'static str, accepted: &[String]) -> (Result<Acts, Failure>, All) {
        let [message, evidence, what_to_do] =
            ["what", "evidence", "state `coordinate_scale = 32`"].map(String::from);
        let finding = Finding { id, severity: Severity::Hazard, message, evidence, what_to_do };
        let reading = Reading {
            mirror: Some(Mirror::Both),
            shift: Some(Shift { right: 1, down: 0 }),
            why: "why".into(),
            ..Reading::default()
        };
        let extent = (id == "small_part_used").then_some(Extent { width: 4, height: 3 });
        let reading = Reading { extent, ..reading };
        let (film, mut all) =
            (film(), All { start: Some(photocurrent_core::quantity::Duration::new(0)), ..All::default() });
        let numbers: Vec<usize> = (5..15).collect();
        let npz = catalog::named("npz").unwrap();
        let acts = act(
            &Evidence {
                survey: &survey(),
                format: npz,
                frames: Some((&film, &numbers)),
                reading: Some(&reading),
            },
            &[finding],
            accepted,
            &mut all,
        );
        (acts, all)
    }

    #[test]
    fn every_finding_is_corrected_proposed_marked_or_refused_as_it_is_listed() {
        for (id, consequence) in CONSEQUENCES {
            let (acts, all) = of(id, &[]);
            match (consequence, acts) {
                (Consequence::Refuses(_), Err(Failure::Other { message, code: 2 })) => {
                    assert!(message.contains(id) && message.contains(&format!("--accept {id}")), "{message}");
                    let accepted = of(id, &[(*id).to_owned()]).0.ok().unwrap();
                    assert!(
                        accepted.marks.len() == 1 && accepted.marks[0].starts_with(id),
                        "accepted and marked: {id}"
                    );
                }
                (Consequence::Marks, Ok(acts)) => assert!(
                    acts.parameters.is_empty() && acts.marks.len() == 1 && acts.marks[0].starts_with(id),
                    "{id}"
                ),
                (Consequence::Corrects(names), Ok(acts)) => match names[0] {
                    // Cut before anything is surveyed.
                    "start" => assert!(acts.marks.is_empty() && acts.parameters.is_empty(), "{id}"),
                    name => assert!(
                        acts.parameters.len() == 1
                            && acts.parameters[0].name == name
                            && !acts.parameters[0].is_open,
                        "{id}"
                    ),
                },
                (Consequence::Proposes(name), Ok(acts)) => match *name {
                    // Proposed where the reader asks for it.
                    "exposure" | "stamp" | "row_time" | "transfer" => {
                        assert!(acts.marks.is_empty() && acts.parameters.is_empty(), "{id}")
                    }
                    "clock_offset" => {
                        assert!(all.mirror == Some(Mirror::Both) && acts.marks.is_empty(), "{id}")
                    }
                    name => {
                        assert!(acts.parameters.iter().any(|fill| fill.name == name && fill.is_open), "{id}")
                    }
                },
                (Consequence::None, Ok(acts)) => {
                    assert!(acts.parameters.is_empty() && acts.marks.is_empty(), "{id}")
                }
                (consequence, _) => panic!("{id}: {consequence:?} did not come"),
            }
        }
    }

    #[test]
    fn frames_are_left_out_by_their_numbers_in_the_file() {
        let (acts, all) = of("repeated_frames", &[]);
        assert_eq!(
            (acts.ok().unwrap().parameters[0].value.as_str(), all.skip_frames),
            ("[8]", Some(vec![8]))
        );
    }
}
