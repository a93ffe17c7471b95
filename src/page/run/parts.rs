//! The parts of a run's report as HTML.

use super::data::{BoundMark, BoundRow, Mark, RunPage, Verdict};
use crate::escape::{code_spans, escaped, list, notes};
use std::fmt::Write;

pub(super) fn lead(page: &RunPage) -> String {
    let mut html = String::new();
    for about in &page.about {
        let _ = writeln!(html, "<p>{}</p>", escaped(about));
    }
    html += &list(&page.facts);
    for failure in &page.failures {
        let _ = writeln!(html, "<p class=\"failed\" role=\"alert\">{}</p>", escaped(failure));
    }
    html
}

pub(super) fn verdict(page: &RunPage, copies: &mut Vec<String>) -> String {
    let mut html = bounds(&page.bounds);
    if page.verdicts.is_empty() {
        html += "<p class=\"missing\">The run has no scores: connect a node <code>score/...</code> to what \
                it renders. Without a truth, <code>split/frames</code> and \
                <code>score/heldout</code> compare with frames that were held out.</p>\n";
        return html;
    }
    html += &page.verdicts.iter().map(|verdict| table(verdict, copies)).collect::<String>();
    html += "<p class=\"note\">\u{25cf} bold: the best; \u{25cb} underlined: the second of three or more; \
             hatched: no number, the reason is in the cell. How each \
             number was measured is under <a href=\"#cards\">metric cards</a>.</p>\n";
    html
}

/// Bounds on scores; empty without any.
fn bounds(rows: &[BoundRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut html = String::from(
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Bounds on scores\">\n<table>\n\
         <caption>Bounds on scores</caption>\n<thead><tr><th scope=\"col\">score</th><th \
         scope=\"col\">verdict</th><th scope=\"col\" class=\"number\">measured</th><th \
         scope=\"col\">expected</th><th scope=\"col\">a warning</th></tr></thead>\n<tbody>\n",
    );
    for row in rows {
        let (class, word) = match row.mark {
            BoundMark::Pass => ("", "pass"),
            BoundMark::Warn => ("", "\u{25b2} warning"),
            BoundMark::Fail => (" class=\"broken\"", "\u{2715} out of bounds"),
            BoundMark::Unchecked => ("", "not checked: no result"),
        };
        let _ = writeln!(
            html,
            "<tr><th scope=\"row\">{}</th><td{class}>{word}</td><td \
             class=\"number\">{}</td><td>{}</td><td>{}</td></tr>",
            escaped(&row.name),
            escaped(&row.measured),
            escaped(&row.bound),
            escaped(&row.warning)
        );
    }
    html + "</tbody>\n</table>\n</div>\n"
}

fn table(verdict: &Verdict, copies: &mut Vec<String>) -> String {
    let mut html = format!(
        "<div class=\"wide\" tabindex=\"0\" role=\"region\" \
         aria-label=\"{0}\">\n<table>\n<caption>{0}</caption>\n<thead><tr>",
        escaped(&verdict.caption)
    );
    verdict.names.iter().for_each(|name| html += &format!("<th scope=\"col\">{}</th>", escaped(name)));
    verdict
        .columns
        .iter()
        .for_each(|name| html += &format!("<th scope=\"col\" class=\"number\">{}</th>", escaped(name)));
    html += "</tr></thead>\n<tbody>\n";
    for row in &verdict.rows {
        html += "<tr>";
        row.names.iter().for_each(|name| html += &format!("<th scope=\"row\">{}</th>", escaped(name)));
        for cell in &row.cells {
            let (class, said) = match cell.mark {
                Mark::Plain => ("", ""),
                Mark::Best => (" best", "<span class=\"hidden\">, the best</span>"),
                Mark::Second => (" second", "<span class=\"hidden\">, the second</span>"),
                Mark::Missing => (" none", ""),
            };
            let _ = write!(
                html,
                "<td class=\"number{class}\" title=\"{}\">{}{said}</td>",
                escaped(&cell.title),
                escaped(&cell.text)
            );
        }
        html += "</tr>\n";
    }
    html += "</tbody>\n</table>\n</div>\n<div class=\"controls\"><span class=\"note\">Copy as</span>";
    for copy in &verdict.copies {
        let _ = write!(
            html,
            "<button type=\"button\" data-copy=\"{}\">{}</button>",
            copies.len(),
            escaped(&copy.name)
        );
        copies.push(copy.text.clone());
    }
    let missing: Vec<String> = verdict
        .rows
        .iter()
        .flat_map(|row| &row.cells)
        .filter(|cell| cell.mark == Mark::Missing)
        .map(|cell| cell.title.clone())
        .collect();
    html += "</div>\n";
    let mut said: Vec<&String> = Vec::new();
    for why in missing.iter().filter(|why| !why.is_empty()) {
        if !said.contains(&why) {
            said.push(why);
            let _ = writeln!(html, "<p class=\"failed\">{}</p>", escaped(why));
        }
    }
    html
}

pub(super) fn pictures(page: &RunPage) -> String {
    let mut html = String::new();
    for (at, group) in page.groups.iter().enumerate() {
        if page.groups.len() > 1 {
            let _ = writeln!(html, "<h3>{}</h3>", escaped(&group.name));
        }
        let _ = write!(
            html,
            r#"<div data-group="{at}">
<div class="controls">
<label>Left <select data-part="left"></select></label>
<label>Right <select data-part="right"></select></label>
<button type="button" data-part="swap">Swap</button>
<span class="group" role="group" aria-label="How the two are compared">
<button type="button" data-mode="slider">Slider</button><button type="button" data-mode="flicker">Flicker</button><button type="button" data-mode="pair">Side by side</button><button type="button" data-mode="difference">Difference</button>
</span>
</div>
<figure>
<div class="stage"><canvas data-part="canvas" tabindex="0" role="img" aria-label="Two pictures of the same instant over each other. Keys: arrows move, plus and minus zoom, comma and full stop change the frame, s slider, f flicker, b side by side, d difference, Enter probes a pixel"></canvas></div>
<figcaption data-part="caption" aria-live="polite"></figcaption>
</figure>
<div class="controls" data-part="divider-row"><label class="grow">Divider <input type="range" data-part="divider" min="0" max="100" step="0.5" value="50"></label></div>
<div class="controls" data-part="scale-row" hidden><label>Scale of the difference <select data-part="scale"><option value="5">5 %</option><option value="10" selected>10 %</option><option value="25">25 %</option><option value="100">100 %</option></select></label>
<span class="scale"><span data-part="ramp-low"></span><canvas data-part="ramp" width="176" height="12" aria-hidden="true"></canvas><span data-part="ramp-high"></span></span><span class="note">left minus right, in percent of {range:.0} DN</span></div>
<div class="controls"><button type="button" data-part="play" aria-pressed="false">Play</button><label class="grow">Frame <input type="range" data-part="scrub" min="0" max="{last}" step="1" value="{middle}"></label><span data-part="instant" class="number"></span></div>
<div class="controls"><label class="grow">Zoom <input type="range" data-part="zoom" min="0" max="5" step="0.1" value="0"></label><button type="button" data-part="reset">Whole picture</button></div>
</div>
"#,
            range = group.white - group.black,
            last = group.instants_ns.len().saturating_sub(1),
            middle = group.instants_ns.len() / 2,
        );
    }
    html += &notes(&page.picture_notes);
    if !page.groups.is_empty() {
        html += "<details><summary>How to look</summary><p class=\"note\">Drag the divider or, when zoomed, \
                 the picture; two fingers or Ctrl and the wheel zoom; a press picks the pixel \
                 that is shown below. With the picture in focus: arrows move, <kbd>+</kbd> <kbd>-</kbd> \
                 <kbd>0</kbd> zoom, <kbd>,</kbd> <kbd>.</kbd> change the frame, <kbd>s</kbd> \
                 <kbd>f</kbd> <kbd>b</kbd> <kbd>d</kbd> choose slider, flicker, side by side, difference, \
                 <kbd>x</kbd> swaps, Shift and arrows move the picked pixel. One black and one \
                 white hold for all pictures of a scene; every sequence shows the frame whose exposure is \
                 nearest in time, and captured frames are shown as if they had been exposed \
                 as long as the others.</p></details>\n";
    }
    html
}

pub(super) fn curves(page: &RunPage) -> String {
    if page.curves.is_empty() {
        return "<p class=\"missing\">The run has no scores of single frames, so there are no curves.</p>\n"
            .into();
    }
    let mut html = panels(0, page.curves.len());
    if !page.has_glitch {
        html += "<p class=\"missing\">No glitch score: connect <code>score/glitch</code> to the scores, and \
                 it measures how much they jump from frame to frame.</p>\n";
    }
    html
}

fn panels(from: usize, count: usize) -> String {
    let each: String = (from..from + count)
        .map(|at| format!("<figure><div data-chart=\"{at}\"></div></figure>\n"))
        .collect();
    format!("<div class=\"panels\">\n{each}</div>\n")
}

pub(super) fn pixel(page: &RunPage) -> String {
    if page.groups.is_empty() {
        return notes(&page.pixel_notes);
    }
    let choose = if page.pixels.is_empty() {
        "<select data-part=\"pixel\" hidden aria-hidden=\"true\" tabindex=\"-1\"></select>"
    } else {
        "<label>Pixel with events and photocurrent <select data-part=\"pixel\"><option \
         value=\"\">another</option></select></label>"
    };
    let mut html = format!(
        r#"<div id="probe-tool">
<div class="controls">{choose}<label>x <input type="number" data-part="x" min="0"></label><label>y <input type="number" data-part="y" min="0"></label><span data-part="solved-row" hidden><label>Band and V_FE of <select data-part="solved"></select></label></span><span class="note" data-part="counts"></span></div>
<p class="missing" data-part="more" hidden>Of this pixel the report holds pictures only. For its events, exposures, voltages and residuals make the report with <code data-part="add"></code>.</p>
<div class="panels"><figure data-part="dn"></figure><figure data-part="voltage"></figure><figure data-part="frame-residual"></figure><figure data-part="event-residual"></figure></div>
<div class="wide" tabindex="0" role="region" aria-label="The pixel at the frame that is looked at"><table><caption>The pixel at the frame that is looked at</caption><thead><tr><th scope="col">sequence</th><th scope="col" class="number">DN</th><th scope="col" class="number">middle of exposure</th></tr></thead><tbody data-part="values"></tbody></table></div>
</div>
"#
    );
    html += &notes(&page.pixel_notes);
    html += "<details><summary>What is shown</summary><p class=\"note\">DN are read from the pictures above \
             (8 bits, clipped at white); bars are captured exposures at what they read, as if exposed \
             as long as the others. V_DC = ln i is the log photocurrent of a solver, V_FE what the front end \
             makes of it, Eqs. (1) and (2); triangles are events, ON above and OFF below, at \
             their in-pixel time where it was recorded, else off-pixel; the band is 95 % of the posterior. A \
             frame's residual is captured minus predicted DN of its own exposure. An \
             event's residual is the step of V_FE since the end of the refractory period after the event \
             before, minus the signed threshold: 0 where the solver agrees with the event.</p></details>\n";
    html
}

pub(super) fn edges(page: &RunPage) -> String {
    let mut html =
        if page.edges.is_empty() { String::new() } else { panels(page.curves.len(), page.edges.len()) };
    html += &notes(&page.edge_notes);
    html
}

pub(super) fn graphs(page: &RunPage) -> String {
    let mut html = String::new();
    for graph in &page.graphs {
        if page.graphs.len() > 1 {
            let _ = writeln!(html, "<h3>{}</h3>", escaped(&graph.name));
        }
        let _ = writeln!(
            html,
            "<div class=\"dag\" tabindex=\"0\" role=\"region\" aria-label=\"Graph of {}\">{}</div>",
            escaped(&graph.name),
            graph.svg
        );
        html += "<details><summary>Nodes as a table: time, cache, parameters</summary>\n<div class=\"wide\" \
                 tabindex=\"0\" role=\"region\" aria-label=\"Nodes\">\n<table><thead><tr>";
        ["node", "kind", "state"].iter().for_each(|name| html += &format!("<th scope=\"col\">{name}</th>"));
        ["time", "stored"]
            .iter()
            .for_each(|name| html += &format!("<th scope=\"col\" class=\"number\">{name}</th>"));
        html += "<th scope=\"col\">key</th><th scope=\"col\">parameters that differ from their \
                 defaults</th></tr></thead>\n<tbody>\n";
        for node in &graph.nodes {
            let _ = writeln!(
                html,
                "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td class=\"number\">{}</td><td \
                 class=\"number\">{}</td><td><code>{}</code></td><td>{}</td></tr>",
                escaped(&node.name),
                escaped(&node.kind),
                escaped(&node.end),
                escaped(&node.time),
                escaped(&node.size),
                escaped(&node.key),
                escaped(&node.changed)
            );
        }
        html += "</tbody></table>\n</div></details>\n";
    }
    html
}

pub(super) fn hazards(page: &RunPage) -> String {
    if page.hazards.is_empty() {
        return "<p>No node reported anything unusual about its data.</p>\n".into();
    }
    let one = |hazard: &super::Hazard| {
        format!(
            "<div class=\"{}\"><strong>{}</strong>: {}</div>\n",
            if hazard.is_serious { "hazard" } else { "missing" },
            escaped(&hazard.at),
            code_spans(&hazard.text)
        )
    };
    // What puts numbers in doubt comes first.
    let (serious, others): (Vec<_>, Vec<_>) = page.hazards.iter().partition(|hazard| hazard.is_serious);
    serious.into_iter().chain(others).map(one).collect()
}

pub(super) fn provenance(page: &RunPage) -> String {
    let mut html = list(&page.provenance);
    if !page.cards.is_empty() {
        html += "<h3 id=\"cards\">Metric cards</h3>\n";
    }
    for card in &page.cards {
        let _ = writeln!(
            html,
            "<details open><summary><strong>{}</strong> {}</summary>\n{}</details>",
            escaped(&card.definition),
            escaped(&card.metrics),
            list(&card.fields)
        );
    }
    html
}
