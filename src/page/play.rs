//! A recording as a page that plays it: events, captured frames, and what was made of them, side by side at
//! one instant that a slider moves.
//!
//! Pictures are files of their own, events stand as `photocurrent-nodes` packs them: counts of ON and OFF
//! events of each slice of time, lengths, and pixels, all LEB128 in base64.
//!
//! Limits: pictures and events need scripts; facts and notes do not.

use crate::escape::{as_text, escaped, list, notes};
use crate::shell::{Page, Script, Section};
use serde::Serialize;
use serde_json::json;
use std::fmt::Write;

/// A page that plays.
#[derive(Clone, Debug, Default)]
pub struct PlayPage {
    /// Heading.
    pub title: String,
    /// Facts in one line each: name and text.
    pub facts: Vec<(String, String)>,
    /// Where time begins, ns.
    pub from_ns: i64,
    /// Where it ends, ns.
    pub to_ns: i64,
    /// The events; none where there are no events.
    pub events: Option<PlayedEvents>,
    /// Sequences of pictures.
    pub films: Vec<PlayedFilm>,
    /// Place in `films` of the method that is shown first.
    pub first: usize,
    /// What was left out or assumed, in whole sentences.
    pub notes: Vec<String>,
}

/// Events of the stretch.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PlayedEvents {
    /// Columns of the array.
    pub width: u32,
    /// Rows of the array.
    pub height: u32,
    /// Where the first slice begins, ns.
    pub start_ns: i64,
    /// Length of a slice, ns.
    pub slice_ns: i64,
    /// Number of slices.
    pub slices: usize,
    /// The part of the events that is drawn, 0 to 1.
    pub share: f64,
    /// ON events of each slice.
    #[serde(serialize_with = "as_text")]
    pub on_counts: Vec<u8>,
    /// OFF events of each slice.
    #[serde(serialize_with = "as_text")]
    pub off_counts: Vec<u8>,
    /// Bytes of each slice in `places`.
    #[serde(serialize_with = "as_text")]
    pub lengths: Vec<u8>,
    /// Pixels and signs.
    #[serde(serialize_with = "as_text")]
    pub places: Vec<u8>,
}

/// A sequence of pictures.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PlayedFilm {
    /// Its name.
    pub label: String,
    /// `truth`, `captured` or `method`.
    pub kind: &'static str,
    /// Columns of its pictures.
    pub width: u32,
    /// Rows of its pictures.
    pub height: u32,
    /// Delay from one row of the array to the next, ns.
    pub row_time_ns: i64,
    /// Its pictures in order of time.
    pub frames: Vec<Played>,
    /// Start and end of the exposure of frames that are marked in time: all of them, or those of `frames`.
    pub marks: Vec<[i64; 2]>,
}

/// A picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Played {
    /// Number of the frame in its sequence.
    pub frame: usize,
    /// Start of the exposure of row 0, ns.
    pub from_ns: i64,
    /// Its end, ns.
    pub to_ns: i64,
    /// Its file as an address.
    pub src: String,
}

impl PlayPage {
    /// The whole file.
    pub fn html(&self) -> String {
        let section = |id, title: &str, html: String| Section { id, title: title.into(), html };
        Page {
            generator: "photocurrent play".into(),
            title: self.title.clone(),
            lead: String::new(),
            sections: vec![
                section("playback", "Playback", self.player()),
                section("facts", "What is shown", list(&self.facts) + &notes(&self.notes)),
                section("how", "How to read it", how()),
            ],
            data: json!({
                "from_ns": self.from_ns,
                "to_ns": self.to_ns,
                "events": self.events,
                "films": self.films,
                "first": self.first,
            }),
            scripts: vec![Script::Play],
        }
        .html()
    }

    /// The panels and their controls.
    fn player(&self) -> String {
        let mut html = String::from("<div id=\"player\">\n<div class=\"panels play\">\n");
        if let Some(events) = &self.events {
            let _ = writeln!(
                html,
                "<figure><h3>Events</h3><div class=\"stage paper\"><canvas data-part=\"events\" width=\"{}\" \
                 height=\"{}\" role=\"img\" aria-label=\"Events around the instant, ON and OFF in two \
                 colours\"></canvas></div><figcaption data-part=\"events-caption\"></figcaption></figure>",
                events.width, events.height
            );
        }
        for (kind, title) in [("captured", "Frames"), ("method", "Reconstruction")] {
            let is_here = |film: &&PlayedFilm| film.kind == kind || kind == "method" && film.kind == "truth";
            if !self.films.iter().any(|film| is_here(&film)) {
                continue;
            }
            let has_method = self.films.iter().any(|film| film.kind == "method");
            let title = if kind == "method" && !has_method { "True frames" } else { title };
            let of_several = self.films.iter().filter(is_here).count() > 1;
            let _ = writeln!(
                html,
                "<figure data-film=\"{kind}\"><h3>{title} <select data-part=\"choice\" aria-label=\"{title}: \
                 which\"{}></select></h3><div class=\"stage\"><canvas data-part=\"picture\" role=\"img\" \
                 aria-label=\"{title}: the picture whose exposure is nearest to the \
                 instant\"></canvas></div><figcaption data-part=\"caption\"></figcaption></figure>",
                if of_several { "" } else { " hidden" }
            );
        }
        html += "</div>\n";
        html += &self.controls();
        html + "</div>\n"
    }

    fn controls(&self) -> String {
        let has_both = self.events.is_some() && !self.films.is_empty();
        let with_events = |html: &'static str| if self.events.is_some() { html } else { "" };
        let [window, rate, keys] = [
            with_events("<label>Events within <select data-part=\"window\"></select></label>\n"),
            with_events(
                "<output class=\"number\" data-part=\"rate\" aria-live=\"off\" \
                 aria-label=\"Event rate\"></output>",
            ),
            with_events(
                "<span class=\"keys\"><span class=\"swatch\" data-part=\"on\"></span> ON (brighter)</span>\n\
                 <span class=\"keys\"><span class=\"swatch\" data-part=\"off\"></span> OFF (darker)</span>\n",
            ),
        ];
        let over = if has_both {
            "<label><input type=\"checkbox\" data-part=\"over\"> Events over pictures</label>\n"
        } else {
            ""
        };
        format!(
            r#"<div class="controls">
<button type="button" data-part="play" aria-pressed="false">Play</button>
<label class="grow">Time <input type="range" data-part="time" min="0" max="1" step="1" value="0"></label>
<output class="number" data-part="now" aria-live="off" aria-label="Time"></output>{rate}
</div>
<div class="line"><canvas data-part="line" role="img" aria-label="Time line: event rate, exposures of frames and pictures, and the instant that is shown"></canvas></div>
<div class="controls">
<label>Speed <select data-part="speed"></select></label>
{window}<label>Time line <select data-part="span"></select></label>
{over}{keys}<span class="group" role="group" aria-label="Steps"><button type="button" data-part="back">Frame back</button><button type="button" data-part="next">Frame on</button></span>
</div>
"#
        )
    }
}

fn how() -> String {
    let text = "Space plays and pauses. Left and right arrows move by the window of events, with \
                Shift by the smallest step. With the focus on a control of the player, comma and \
                full stop go to the frame before and after, Home and End to the ends. A press on the \
                time line goes there. Events are drawn from half a window before the instant to half \
                a window after it, at the times of their stamps: the more events of a pixel, the \
                fuller its colour, and a pixel with both has a colour between. Of a sequence stands \
                the picture whose exposure has its middle nearest to the instant; the time line has \
                its exposures as bars, at the time of row 0. One black and one white hold for all \
                pictures, which are shown as if all had been exposed alike. The event rate counts \
                all events within the window, those too that are not drawn.";
    format!("<p class=\"note\">{}</p>\n", escaped(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOSTILE: &str = "</script><img src=x onerror=alert(1)>\"'&";

    fn film(kind: &'static str) -> PlayedFilm {
        PlayedFilm {
            label: HOSTILE.into(),
            kind,
            frames: vec![Played { src: "data:image/png;base64,".into(), ..Played::default() }],
            ..PlayedFilm::default()
        }
    }

    fn page() -> PlayPage {
        PlayPage {
            title: HOSTILE.into(),
            facts: vec![(HOSTILE.into(), HOSTILE.into())],
            events: Some(PlayedEvents { places: vec![255, 1], ..PlayedEvents::default() }),
            films: vec![film("truth"), film("captured"), film("method")],
            notes: vec![HOSTILE.into()],
            ..PlayPage::default()
        }
    }

    /// The JSON that the script reads.
    fn data(html: &str) -> serde_json::Value {
        let begin = html.find("id=\"page-data\">").unwrap() + 15;
        serde_json::from_str(html[begin..].split("</script>").next().unwrap()).unwrap()
    }

    #[test]
    fn text_from_outside_stays_text_and_bytes_reach_the_script() {
        let html = page().html();
        assert!(!html.contains("<img") && html.matches("<script").count() == 2);
        let data = data(&html);
        assert_eq!(data["films"][1]["label"], HOSTILE);
        assert_eq!(data["events"]["places"], "/wE=");
        assert_eq!(page().html(), html, "the same page gives the same bytes");
    }

    #[test]
    fn what_a_recording_lacks_has_no_panel() {
        let panels = |page: PlayPage| {
            let html = page.html();
            let markup = html.split("page-data").next().unwrap().to_string();
            ["data-part=\"events\"", "data-film=\"captured\"", "data-film=\"method\"", "data-part=\"window\""]
                .map(|part| markup.contains(part))
        };
        assert_eq!(panels(page()), [true; 4]);
        assert_eq!(panels(PlayPage { films: Vec::new(), ..page() }), [true, false, false, true]);
        let frames = PlayPage { events: None, films: vec![film("captured")], ..page() };
        assert_eq!(panels(frames), [false, true, false, false]);
    }
}
