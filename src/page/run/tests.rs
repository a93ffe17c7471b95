//! The report says what it has and what it lacks, and text stays text.

use super::*;

const HOSTILE: &str = "</script><img src=x onerror=alert(1)>\"'&";

fn page() -> RunPage {
    let cell = |text: &str, mark| Cell {
        text: text.into(),
        mark,
        title: if mark == Mark::Missing { "render failed: no memory".into() } else { String::new() },
    };
    let row = |name: &str, cells| VerdictRow { names: vec![name.into()], cells };
    RunPage {
        title: "fan".into(),
        verdicts: vec![Verdict {
            caption: "Scores".into(),
            names: vec!["method".into()],
            columns: vec!["psnr_db".into()],
            rows: vec![
                row("ours", vec![cell("31.7", Mark::Best)]),
                row("EDI", vec![cell("25.6", Mark::Second)]),
                row("film", vec![cell("failed", Mark::Missing)]),
                row("repeat", vec![cell("21.6", Mark::Plain)]),
            ],
            copies: vec![Copy { name: "CSV".into(), text: "method,psnr_db\n".into() }],
        }],
        groups: vec![Group {
            name: "fan".into(),
            width: 4,
            height: 2,
            shrink: 1,
            white: 100.0,
            instants_ns: vec![0, 5],
            ..Group::default()
        }],
        ..RunPage::default()
    }
}

/// The JSON that the scripts read.
fn data(html: &str) -> serde_json::Value {
    let begin = html.find("id=\"page-data\">").unwrap() + 15;
    let end = begin + html[begin..].find("</script>").unwrap();
    serde_json::from_str(&html[begin..end]).unwrap()
}

#[test]
fn a_failed_cell_is_visible_and_says_why() {
    let html = page().html();
    assert!(html.contains("class=\"number none\" title=\"render failed: no memory\">failed</td>"));
    assert!(html.contains("<p class=\"failed\">render failed: no memory</p>"), "for those who have no mouse");
    assert!(
        html.contains("class=\"number best\"")
            && html.contains(">31.7<span class=\"hidden\">, the best</span>")
    );
    assert_eq!(data(&html)["copies"][0], "method,psnr_db\n");
}

#[test]
fn what_is_missing_is_said_with_how_to_get_it() {
    let html = RunPage {
        picture_notes: vec!["No pictures: run `photocurrent run x.toml`.".into()],
        ..RunPage::default()
    }
    .html();
    assert!(
        html.contains("The run has no scores")
            && html.contains("No pictures: run <code>photocurrent run x.toml</code>.")
    );
    assert!(html.contains("no curves"));
    assert!(!html.contains("data-part=\"canvas\" tabindex"), "no empty viewer");
}

#[test]
fn text_from_outside_stays_text_wherever_it_stands() {
    let text = || HOSTILE.to_string();
    let pair = || vec![(text(), text())];
    let page = RunPage {
        title: text(),
        about: vec![text()],
        facts: pair(),
        failures: vec![text()],
        verdicts: vec![Verdict {
            caption: text(),
            names: vec![text()],
            columns: vec![text()],
            rows: vec![VerdictRow {
                names: vec![text()],
                cells: vec![Cell { text: text(), mark: Mark::Missing, title: text() }],
            }],
            copies: vec![Copy { name: text(), text: text() }],
        }],
        groups: vec![
            Group {
                name: text(),
                sequences: vec![Film { label: text(), ..Film::default() }],
                ..Group::default()
            },
            Group::default(),
        ],
        picture_notes: vec![text()],
        edge_notes: vec![text()],
        pixel_notes: vec![text()],
        graphs: vec![
            Graph {
                name: text(),
                nodes: vec![NodeRow {
                    name: text(),
                    kind: text(),
                    end: text(),
                    time: text(),
                    size: text(),
                    key: text(),
                    changed: text(),
                }],
                ..Graph::default()
            },
            Graph::default(),
        ],
        hazards: vec![Hazard { at: text(), text: text(), is_serious: true }],
        provenance: pair(),
        cards: vec![Card { metrics: text(), definition: text(), fields: pair() }],
        curves: vec![Panel { title: text(), ..Panel::default() }],
        ..RunPage::default()
    };
    let html = page.html();
    assert!(!html.contains("<img"), "{}", &html[html.find("<img").unwrap() - 80..][..160]);
    assert_eq!(html.matches("<script").count(), 2, "the data and the scripts");
    assert_eq!(data(&html)["copies"][0], HOSTILE, "and reaches the clipboard as it was");
    assert_eq!(data(&html)["groups"][0]["sequences"][0]["label"], HOSTILE);
}

#[test]
fn the_same_report_gives_the_same_bytes() {
    assert_eq!(page().html(), page().html());
}

#[test]
fn every_part_that_a_script_looks_for_is_on_the_page() {
    let page = RunPage { pixels: vec![Pixel::default()], ..page() };
    let html = page.html();
    let (markup, scripts) = html.split_at(html.find("<script>").unwrap());
    for looked_for in ["find(\"", "part(\""] {
        for (at, _) in scripts.match_indices(looked_for) {
            let name = scripts[at + looked_for.len()..].split('"').next().unwrap();
            assert!(markup.contains(&format!("data-part=\"{name}\"")), "{name}");
        }
    }
}
