//! What all pages share: head, style, theme switch, navigation, scripts.

use crate::escape::{embedded, escaped};
use serde_json::Value;
use std::fmt::Write;

const STYLE: &str = include_str!("style.css");

/// A script that a page needs. `page.js` is always there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Script {
    /// Curves.
    Chart,
    /// Two pictures over each other.
    Compare,
    /// One pixel over time.
    Probe,
    /// Events and pictures in time.
    Play,
}

impl Script {
    fn text(self) -> &'static str {
        match self {
            Script::Chart => include_str!("chart.js"),
            Script::Compare => include_str!("compare.js"),
            Script::Probe => include_str!("probe.js"),
            Script::Play => include_str!("play.js"),
        }
    }
}

/// A part of a page with a heading.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// What a link to it ends with: letters and hyphens.
    pub id: &'static str,
    /// Its heading, as text.
    pub title: String,
    /// What stands below, as HTML.
    pub html: String,
}

/// A page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Who made it: `photocurrent report`. By this a program knows the file again.
    pub generator: String,
    /// Title of the window and heading, as text.
    pub title: String,
    /// What stands below the heading, as HTML.
    pub lead: String,
    /// The parts in order; those without HTML are left out.
    pub sections: Vec<Section>,
    /// What the scripts read.
    pub data: Value,
    /// The scripts, in order.
    pub scripts: Vec<Script>,
}

impl Page {
    /// The whole file. The same page gives the same bytes.
    pub fn html(&self) -> String {
        let sections: Vec<&Section> =
            self.sections.iter().filter(|section| !section.html.is_empty()).collect();
        let mut html =
            String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
        let _ = writeln!(html, "<meta name=\"generator\" content=\"{}\">", escaped(&self.generator));
        // Nothing is loaded from anywhere, whatever a text on the page may say.
        html.push_str(
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src \
                       data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n",
        );
        html.push_str(
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta \
                       name=\"color-scheme\" content=\"light dark\">\n",
        );
        let _ = writeln!(
            html,
            "<title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>",
            escaped(&self.title)
        );
        html.push_str("<a class=\"skip\" href=\"#main\">Skip to content</a>\n<header>\n");
        let _ = writeln!(html, "<h1>{}</h1>", escaped(&self.title));
        html.push_str(
            "<button type=\"button\" id=\"theme\" class=\"quiet\" hidden>Theme: system</button>\n</header>\n",
        );
        html.push_str("<nav aria-label=\"Parts of this page\">\n");
        for section in &sections {
            let _ = writeln!(html, "<a href=\"#{}\">{}</a>", section.id, escaped(&section.title));
        }
        let _ = writeln!(html, "</nav>\n<main id=\"main\">\n{}", self.lead);
        html.push_str(
            "<noscript><p class=\"missing\">Scripts are off: pictures and curves are not shown; \
                       tables and texts are.</p></noscript>\n",
        );
        for section in &sections {
            let _ = writeln!(
                html,
                "<section id=\"{0}\" aria-labelledby=\"{0}-title\">\n<h2 id=\"{0}-title\">{1}</h2>",
                section.id,
                escaped(&section.title)
            );
            let _ = writeln!(html, "{}</section>", section.html);
        }
        html.push_str("</main>\n");
        let _ = writeln!(
            html,
            "<script type=\"application/json\" id=\"page-data\">{}</script>",
            embedded(&self.data)
        );
        let _ = writeln!(html, "<script>\n\"use strict\";\n{}", include_str!("page.js"));
        for script in &self.scripts {
            let _ = writeln!(html, "{}", script.text());
        }
        html.push_str("</script>\n</body>\n</html>\n");
        html
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_its_maker_early_and_loads_nothing() {
        let page = Page {
            generator: "photocurrent report".into(),
            title: "<Fan> & \"ball\"".into(),
            scripts: vec![Script::Chart],
            ..Page::default()
        };
        let html = page.html();
        assert!(html[..400].contains("content=\"photocurrent report\""));
        assert!(html.contains("<h1>&lt;Fan&gt; &amp; &quot;ball&quot;</h1>"));
        for outside in ["http://", "https://", "src=\"//", "@import", "url("] {
            // The name of a namespace is no address that is opened.
            let found = html.replace("http://www.w3.org/2000/svg", "").contains(outside);
            assert!(!found, "{outside}");
        }
    }

    #[test]
    fn sections_without_content_are_left_out() {
        let section = |id, html: &str| Section { id, title: id.into(), html: html.into() };
        let page = Page {
            sections: vec![section("full", "<p>x</p>"), section("empty-part", "")],
            ..Page::default()
        };
        let html = page.html();
        assert!(
            html.contains("href=\"#full\"") && html.contains("id=\"full\"") && !html.contains("empty-part")
        );
    }
}
