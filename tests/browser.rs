//! The pages in a real browser: headless Chromium opens the report of a run, of a diagnosis, and a page that
//! plays a recording, and does what a person would.
//!
//! The browser is driven through its own protocol on a pipe (`--remote-debugging-pipe`: JSON, ended by a zero
//! byte): no port, no driver program, no library. Any error on a page, or anything that it would load, fails
//! the test. `make browser` installs Debian's `chromium`; without a browser these tests fail, for a page that
//! nobody opened is not tested. With `KEEP_SCREENSHOTS=FOLDER` the pictures that the tests take are kept, to
//! be looked at.
//!
//! On each page, in light and dark, wide and 390 px, axe-core looks for what breaks WCAG 2.0 to 2.2 at levels
//! A and AA, or its best practices. `make browser` fetches it; without it that part is skipped and said so,
//! unless `REQUIRE_AXE` is set. What axe-core cannot decide is not reported.

use crate::support::{Bench, root, small_pipeline};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Where `make browser` puts the accessibility tests.
const AXE: &str = "out/axe-core/4.14.1/axe.min.js";

/// A browser with one page.
struct Browser {
    process: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    session: Option<String>,
    last: u64,
    /// Errors and warnings that the page reported, and requests that it made.
    complaints: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts one and opens a file.
    fn open(file: &Path, width: u32, height: u32) -> Browser {
        let program = ["chromium", "chromium-browser", "google-chrome"]
            .into_iter()
            .find(|name| Command::new(name).arg("--version").output().is_ok_and(|out| out.status.success()));
        let program = program.expect("a browser: `make browser` installs chromium");
        let profile = tempfile::tempdir().expect("a folder for the profile");
        // The protocol is spoken on descriptors 3 and 4, which the shell makes of its own input and output.
        let script = format!(
            "exec {program} --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --hide-scrollbars \
             --no-first-run --disable-extensions --force-device-scale-factor=1 \
             --user-data-dir=\"$1\" --window-size={width},{height} --remote-debugging-pipe about:blank 3<&0 \
                               4>&1 0</dev/null 1>/dev/null 2>/dev/null"
        );
        let mut process = Command::new("sh")
            .args(["-c", &script, "browser"])
            .arg(profile.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let (to, from) = (
            process.stdin.take().expect("its input"),
            BufReader::new(process.stdout.take().expect("its output")),
        );
        let mut browser =
            Browser { process, to, from, session: None, last: 0, complaints: Vec::new(), _profile: profile };
        let target = browser.ask("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let session = browser.ask("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        browser.session = session["sessionId"].as_str().map(String::from);
        for domain in ["Page", "Runtime", "Log", "Network", "DOM", "Accessibility"] {
            browser.ask(&format!("{domain}.enable"), json!({}));
        }
        browser.resize(width, height);
        let url = format!("file://{}", file.canonicalize().expect("the page").display());
        browser.ask("Page.navigate", json!({ "url": url }));
        browser.wait("document.readyState === 'complete'");
        browser
    }

    /// One call of the protocol and its answer; what the browser says in between is looked through for
    /// complaints.
    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.last += 1;
        let mut message = json!({ "id": self.last, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.to
            .write_all(message.to_string().as_bytes())
            .and_then(|()| self.to.write_all(b"\0"))
            .and_then(|()| self.to.flush())
            .expect("the browser listens");
        loop {
            let mut bytes = Vec::new();
            self.from.read_until(0, &mut bytes).expect("the browser answers");
            assert_eq!(bytes.pop(), Some(0), "the browser went away at {method}");
            let message: Value = serde_json::from_slice(&bytes).expect("JSON");
            if message["id"] == self.last {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            self.listen(&message);
        }
    }

    fn listen(&mut self, message: &Value) {
        let params = &message["params"];
        match message["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => {
                self.complaints.push(format!("exception: {}", params["exceptionDetails"]))
            }
            "Runtime.consoleAPICalled" if params["type"] == "error" || params["type"] == "warning" => {
                self.complaints.push(format!("console: {}", params["args"]))
            }
            "Log.entryAdded" => self.complaints.push(format!("log: {}", params["entry"])),
            "Network.requestWillBeSent" => {
                let url = params["request"]["url"].as_str().unwrap_or_default();
                if !url.starts_with("data:") && params["type"] != "Document" {
                    self.complaints.push(format!("request: {url}"));
                }
            }
            _ => {}
        }
    }

    /// The value of an expression; promises are waited for.
    fn js(&mut self, expression: &str) -> Value {
        let answer = self.ask(
            "Runtime.evaluate",
            json!({
                "expression": expression, "awaitPromise": true, "returnByValue": true, "userGesture": true,
            }),
        );
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true; the page's own clock paces it.
    fn wait(&mut self, condition: &str) {
        let looped = format!(
            "(async () => {{ for (let k = 0; k < 2000; k++) {{ if ({condition}) return true; await new \
             Promise((done) => setTimeout(done, 15)); }} return false; }})()"
        );
        assert_eq!(self.js(&looped), json!(true), "never came true: {condition}");
    }

    fn resize(&mut self, width: u32, height: u32) {
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500 }),
        );
    }

    fn scheme(&mut self, media: &str, scheme: &str) {
        self.ask(
            "Emulation.setEmulatedMedia",
            json!({ "media": media, "features": [{ "name": "prefers-color-scheme", "value": scheme }] }),
        );
    }

    /// Left, top, width, height [CSS pixel] of an element that is brought into view, once five pictures of
    /// the page in turn have it at one place: a caption that wraps anew moves what stands below it.
    fn settled(&mut self, selector: &str) -> [f64; 4] {
        let place = self.js(&format!(
            "(async () => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: \
             'center', behavior: 'instant' }}); let last = null, same = 0; while (same < 5) {{ await new \
             Promise((done) => requestAnimationFrame(done)); const b = e.getBoundingClientRect(); const \
             now = [b.left, b.top, b.width, b.height]; same = String(now) === String(last) ? same + 1 : 0; \
             last = now; }} return last; }})()"
        ));
        [0, 1, 2, 3].map(|k| place[k].as_f64().expect("a number"))
    }

    fn press(&mut self, x: f64, y: f64) {
        for kind in ["mousePressed", "mouseReleased"] {
            self.ask(
                "Input.dispatchMouseEvent",
                json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 }),
            );
        }
    }

    /// Keeps a picture of the whole page when `KEEP_SCREENSHOTS` names a folder.
    fn keep(&mut self, name: &str) {
        let Ok(folder) = std::env::var("KEEP_SCREENSHOTS") else { return };
        let picture =
            self.ask("Page.captureScreenshot", json!({ "format": "png", "captureBeyondViewport": true }));
        let path = Path::new(&folder).join(format!("{name}.png"));
        let script = "import base64,sys; open(sys.argv[1],'wb').write(base64.b64decode(sys.stdin.read()))";
        let mut child = Command::new("python3")
            .args(["-c", script])
            .arg(path)
            .stdin(Stdio::piped())
            .spawn()
            .expect("python3, to keep pictures");
        child
            .stdin
            .take()
            .expect("its input")
            .write_all(picture["data"].as_str().unwrap_or_default().as_bytes())
            .expect("a picture");
        child.wait().expect("python3 ends");
    }

    /// What hurts on any page: complaints, a page wider than its window, text without contrast, controls
    /// without a name.
    fn check(&mut self, what: &str) {
        let overflow = self.js("document.documentElement.scrollWidth - document.documentElement.clientWidth");
        assert_eq!(overflow, json!(0), "{what}: the page is wider than its window; {}", self.js(WIDEST));
        let pale = self.js(CONTRAST);
        assert_eq!(pale, json!([]), "{what}: text with less than 4.5 : 1 of contrast");
        let nameless = self.nameless();
        assert!(nameless.is_empty(), "{what}: controls or pictures without a name: {nameless:?}");
        assert_eq!(
            self.js("[...document.querySelectorAll('[id]')].map((e) => e.id).filter((id, at, all) => \
                     all.indexOf(id) !== at)"),
            json!([]),
            "{what}: ids twice"
        );
        assert_eq!(
            self.js("[...document.querySelectorAll('a[href^=\"#\"]')].map((a) => \
                     a.hash.slice(1)).filter((id) => !document.getElementById(id))"),
            json!([]),
            "{what}: links to nothing"
        );
        let barriers = self.barriers();
        assert!(barriers.is_empty(), "{what}: axe-core finds\n{}", barriers.join("\n"));
        assert!(self.complaints.is_empty(), "{what}: {:?}", self.complaints);
    }

    /// What axe-core finds that breaks WCAG at levels A and AA or its best practices: a rule and its elements
    /// each.
    fn barriers(&mut self) -> Vec<String> {
        let Ok(script) = std::fs::read_to_string(root().join(AXE)) else {
            assert!(std::env::var_os("REQUIRE_AXE").is_none(), "{AXE} is missing: `make browser` fetches it");
            eprintln!(
                "skipped: no {AXE} here, so the pages are not tested with axe-core; `make browser` fetches it"
            );
            return Vec::new();
        };
        if self.js("typeof axe") != json!("object") {
            self.js(&script);
        }
        // From the top: where the page stands in the middle of a scroll, controls that pass under the fixed
        // list of parts would count as too small.
        self.js("window.scrollTo({ top: 0, behavior: 'instant' })");
        let found =
            self.js("axe.run(document, { runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', \
             'best-practice'], resultTypes: ['violations'] }).then((found) => ({ passes: found.passes.length,
             bad: found.violations.map((one) => `${one.id}: ${one.help}: \
             ${one.nodes.slice(0, 5).map((node) => `${node.target.join(' ')} ${node.html.slice(0, \
             120)}`).join('; ')}`) }))");
        assert!(
            found["passes"].as_u64().is_some_and(|passes| passes > 10),
            "axe-core has looked at the page: {found}"
        );
        found["bad"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|one| one.as_str().unwrap_or_default().to_owned())
            .collect()
    }

    /// Roles and names as a screen reader gets them: every control and picture has a name.
    fn nameless(&mut self) -> Vec<String> {
        let tree = self.ask("Accessibility.getFullAXTree", json!({}));
        let wanted = [
            "button",
            "combobox",
            "slider",
            "spinbutton",
            "link",
            "image",
            "img",
            "textbox",
            "region",
            "navigation",
            "heading",
        ];
        let nodes = tree["nodes"].as_array().cloned().unwrap_or_default();
        assert!(nodes.len() > 20, "there is an accessibility tree");
        let is_bad = |node: &&Value| {
            node["ignored"] != json!(true)
                && wanted.contains(&node["role"]["value"].as_str().unwrap_or_default())
                && node["name"]["value"].as_str().unwrap_or_default().trim().is_empty()
        };
        nodes.iter().filter(is_bad).map(|node| node["role"]["value"].to_string()).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        let mut rest = Vec::new();
        let _ = self.from.read_to_end(&mut rest);
    }
}

/// The elements that reach furthest to the right, outside of parts that scroll by themselves.
const WIDEST: &str = "JSON.stringify([...document.querySelectorAll('body *')].filter((e) => \
                      !e.closest('.wide, .dag, nav, pre') && e.getBoundingClientRect().right > \
                      document.documentElement.clientWidth + 1).slice(0, 5).map((e) => e.outerHTML.slice(0, \
                      90)))";

/// Texts whose contrast with what is painted behind them is below 4.5 : 1 (WCAG 2.2, 1.4.3), as far as plain
/// colours say.
const CONTRAST: &str = r#"(() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => { canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1); return [...canvas.getImageData(0, 0, 1, 1).data]; };
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((sum, v, at) => sum + v * [0.2126, 0.7152, 0.0722][at], 0);
  const behind = (element) => { for (let e = element; e; e = e.parentElement) { const c = rgba(getComputedStyle(e).backgroundColor); if (c[3] > 250) return c; } return [255, 255, 255, 255]; };
  const bad = [];
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!own || !element.checkVisibility() || ["SCRIPT", "STYLE", "NOSCRIPT", "TITLE", "OPTION"].includes(element.tagName.toUpperCase())) continue;
    const svg = element.closest("svg");
    const box = svg && element.tagName === "text" ? element.parentElement.querySelector("rect.box") : null;
    const front = rgba(svg ? getComputedStyle(element).fill : getComputedStyle(element).color);
    const back = box ? rgba(getComputedStyle(box).fill) : behind(svg ?? element);
    const [high, low] = [light(front), light(back)].sort((a, b) => b - a);
    const ratio = (high + 0.05) / (low + 0.05);
    if (ratio < 4.5) bad.push(`${element.tagName} "${element.textContent.trim().slice(0, 30)}" ${ratio.toFixed(2)}`);
  }
  return [...new Set(bad)].slice(0, 12);
})()"#;

/// Each page in light and dark, wide and 390 px, and as print.
fn look_everywhere(browser: &mut Browser, name: &str) {
    for scheme in ["light", "dark"] {
        for width in [1280, 390] {
            browser.resize(width, 900);
            browser.scheme("screen", scheme);
            browser.js("new Promise((done) => setTimeout(done, 200))");
            browser.keep(&format!("{name}-{scheme}-{width}"));
            browser.check(&format!("{name}, {scheme}, {width} px"));
        }
    }
    browser.resize(794, 1123);
    browser.scheme("print", "dark");
    browser.keep(&format!("{name}-print"));
    let paper = browser.js("getComputedStyle(document.body).backgroundColor");
    assert_eq!(paper, json!("rgb(255, 255, 255)"), "paper is white, whatever the screen is");
    assert_eq!(
        browser.js("document.querySelector('nav').checkVisibility()"),
        json!(false),
        "links within the page are not printed"
    );
    browser.scheme("screen", "light");
    browser.resize(1280, 900);
}

/// `codes`: what the picture shows, read from a copy, so that the page's own canvas stays as it is.
const CODES: &str = "const c = document.querySelector('[data-part=canvas]'); const k = new \
                     OffscreenCanvas(c.width, c.height).getContext('2d', { willReadFrequently: true }); \
                     k.drawImage(c, 0, 0); const codes = k.getImageData(0, 60, c.width, c.height - 60).data;";

/// One number that changes with what the picture shows.
fn shown() -> String {
    format!(
        "(() => {{ {CODES} let sum = 0; for (let k = 0; k < codes.length; k += 97) sum = (sum * 31 + \
         codes[k]) % 1000003; return sum; }})()"
    )
}

#[test]
fn the_report_of_the_demo_is_used_in_a_browser() {
    let bench = Bench::new();
    let manifest = root().join("pipelines/quickstart.toml").display().to_string();
    let done = bench.run(&["run", &manifest, "--quiet", "--out", "demo"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let done = bench.run(&["report", "demo", "-o", "report.html"]);
    assert_eq!((done.code, done.stdout.as_str()), (0, "report.html\n"), "{}", done.stderr);
    let mut browser = Browser::open(&bench.path("report.html"), 1280, 900);
    browser.wait("document.querySelector('[data-part=caption]').textContent.includes('frame')");
    browser.wait("document.querySelectorAll('#probe-tool svg.chart').length === 4");
    look_everywhere(&mut browser, "report");

    // The slider: the divider moves, and with it what is seen.
    let before = browser.js(&shown());
    browser.js("(() => { const d = document.querySelector('[data-part=divider]'); d.value = 10; \
                d.dispatchEvent(new Event('input')); })()");
    assert_ne!(browser.js(&shown()), before, "another part of each picture is seen");
    // Another method on the right.
    let captioned = browser.js("document.querySelector('[data-part=caption]').textContent");
    browser.js("(() => { const s = document.querySelector('[data-part=right]'); s.value = \
                [...s.options].find((o) => o.text === 'EDI').value; s.dispatchEvent(new Event('input')); \
                })()");
    browser.wait("document.querySelector('[data-part=caption]').textContent.includes('EDI')");
    assert_ne!(browser.js("document.querySelector('[data-part=caption]').textContent"), captioned);
    // Frames: both sequences move on, and the cursor of the curves with them.
    let cursor = browser.js("document.querySelector('#time .cursor').getAttribute('x1')");
    browser.js("(() => { const s = document.querySelector('[data-part=scrub]'); s.value = 7; \
                s.dispatchEvent(new Event('input')); })()");
    browser.wait("document.querySelector('[data-part=caption]').textContent.includes('EDI: frame 7,')");
    assert_ne!(browser.js("document.querySelector('#time .cursor').getAttribute('x1')"), cursor);
    // Modes, each another picture; a method against itself differs nowhere.
    let mut seen = vec![browser.js(&shown())];
    for mode in ["pair", "difference"] {
        browser.js(&format!("document.querySelector('[data-mode={mode}]').click()"));
        seen.push(browser.js(&shown()));
        browser.check(mode);
    }
    seen.dedup();
    assert_eq!(seen.len(), 3);
    browser.js("(() => { const [l, r] = ['left', 'right'].map((p) => \
                document.querySelector(`[data-part=${p}]`)); l.value = r.value; l.dispatchEvent(new \
                Event('input')); })()");
    browser.wait("document.querySelector('[data-part=caption]').textContent.startsWith('EDI')");
    // Grey is neither more nor less; yellow, in a dark line, is the frame of the picked pixel.
    let most = format!(
        "(() => {{ {CODES} const at = (k) => [k / 4 % c.width, Math.floor(k / 4 / c.width)]; const box = \
         [1e9, 1e9, -1e9, -1e9];
        for (let k = 0; k < codes.length; k += 4) if (codes[k] >= 200 && codes[k + 2] < codes[k] - 60) {{ \
        const [x, y] = at(k); box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y); box[2] = \
        Math.max(box[2], x); box[3] = Math.max(box[3], y); }}
        if (box[2] - box[0] > 60 || box[3] - box[1] > 60) return 999;
        let most = 0; for (let k = 0; k < codes.length; k += 4) {{ const [x, y] = at(k); if (x > box[0] - 5 \
        && x < box[2] + 5 && y > box[1] - 5 && y < box[3] + 5) continue; most = Math.max(most, codes[k] === \
        codes[k + 2] ? Math.abs(codes[k] - 120) % 120 : 999); }} return most; }})()"
    );
    // The caption is there before the picture is drawn.
    browser.wait(&format!("{most} === 0"));
    browser.js("document.querySelector('[data-mode=flicker]').click()");
    let flickering = browser.js("document.querySelector('[data-part=caption]').textContent");
    let first = browser.js(&shown());
    browser.js("(() => { const s = document.querySelector('[data-part=left]'); s.value = 0; \
                s.dispatchEvent(new Event('input')); })()");
    browser.wait(&format!("{} !== {first}", shown()));
    // Flicker alone changes what is seen: the new picture is there when its caption is.
    browser.wait(&format!("document.querySelector('[data-part=caption]').textContent !== {flickering}"));
    browser.js("document.querySelector('[data-mode=slider]').click()");

    // A press on the picture probes that pixel, and the values are those of every sequence.
    let [left, top, width, height] = browser.settled("[data-part=canvas]");
    browser.press(left + width * 100.5 / 128.0, top + height * 30.5 / 96.0);
    browser.wait(
        "document.querySelector('[data-part=x]').value === '100' && \
                  document.querySelector('[data-part=y]').value === '30'",
    );
    browser.wait("document.querySelectorAll('[data-part=values] tr').length === 8");
    assert_eq!(
        browser.js("document.querySelector('[data-part=more]').checkVisibility()"),
        json!(true),
        "only pictures are known of this pixel, and how to get more is said"
    );
    // One of the pixels of which all is known.
    browser.js("(() => { const s = document.querySelector('[data-part=pixel]'); s.value = 0; \
                s.dispatchEvent(new Event('input')); })()");
    browser.wait("document.querySelectorAll('#probe-tool svg.chart').length === 4");
    assert!(
        browser
            .js("document.querySelector('[data-part=counts]').textContent")
            .as_str()
            .is_some_and(|text| text.contains("events"))
    );
    // Keys, for those who have no mouse.
    browser.js("document.querySelector('[data-part=canvas]').focus()");
    for key in [".", "d", "+"] {
        browser.ask("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": key, "text": key }));
    }
    browser.wait("document.querySelector('[data-part=instant]').textContent.startsWith('9 of')");
    assert_eq!(
        browser.js("document.querySelector('[data-mode=difference]').getAttribute('aria-pressed')"),
        json!("true")
    );
    assert!(
        browser
            .js("Number(document.querySelector('[data-part=zoom]').value)")
            .as_f64()
            .is_some_and(|zoom| zoom > 0.0)
    );
    // A curve is hidden by its entry in the legend.
    let curves = browser.js("document.querySelectorAll('#time .curve').length");
    browser.js("document.querySelector('#time .legend button').click()");
    assert_eq!(
        browser.js("document.querySelectorAll('#time .curve').length").as_u64().map(|n| n + 1),
        curves.as_u64()
    );
    // Tables are copied; a page from disk may have no clipboard, and then shows the text.
    browser.js("document.querySelector('[data-copy=\"0\"]').click()");
    browser.wait("document.querySelector('[data-copy=\"0\"]').textContent !== 'Markdown'");
    browser.js("document.getElementById('theme').click()");
    browser.check("after all of it");
}

#[test]
fn a_page_that_plays_a_run_is_used_in_a_browser() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let done = bench.run(&["play", "m.toml", "-o", "play.html"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut browser = Browser::open(&bench.path("play.html"), 1280, 900);
    let caption = "document.querySelector('[data-film=method] [data-part=caption]').textContent";
    browser.wait(&format!("{caption}.includes('frame')"));
    look_everywhere(&mut browser, "play");
    // The instant in ms, as the page states it.
    let now = "Number.parseFloat(document.querySelector('[data-part=now]').textContent)";
    let at = |browser: &mut Browser| browser.js(now).as_f64().expect("a time");
    let key = |browser: &mut Browser, key: &str| {
        let text = if key.len() == 1 { key } else { "" };
        browser.ask("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": key, "text": text }));
    };
    let wait_for = |browser: &mut Browser, ms: f64| browser.wait(&format!("Math.abs({now} - {ms}) < 1e-6"));
    // Space plays and pauses.
    let begin = at(&mut browser);
    key(&mut browser, " ");
    browser.wait(&format!("{now} > {begin}"));
    assert_eq!(browser.js("document.querySelector('[data-part=play]').textContent"), json!("Pause"));
    key(&mut browser, " ");
    assert_eq!(
        browser.js("document.querySelector('[data-part=play]').getAttribute('aria-pressed')"),
        json!("false")
    );
    // The slider, and arrows by the window of events.
    browser.js("(() => { const s = document.querySelector('[data-part=time]'); s.value = 100; \
                s.dispatchEvent(new Event('input')); s.focus(); const w = \
                document.querySelector('[data-part=window]'); w.value = 2e6; w.dispatchEvent(new \
                Event('input')); })()");
    let data = "P.data.from_ns / 1e6";
    let zero = browser.js(data).as_f64().expect("a time");
    wait_for(&mut browser, zero + 10.0);
    key(&mut browser, "ArrowRight");
    wait_for(&mut browser, zero + 12.0);
    assert!(
        browser
            .js("document.querySelector('[data-part=time]').getAttribute('aria-valuetext')")
            .as_str()
            .is_some_and(|text| text.contains(" ms, ") && text.ends_with("events/s"))
    );
    // From frame to frame: the instant is the middle of an exposure.
    key(&mut browser, ".");
    let frames = "document.querySelector('[data-film=captured] [data-part=caption]').textContent";
    browser.wait(&format!("{frames}.endsWith('its middle is at the instant')"));
    // Another sequence, and events over it: other pictures each.
    let picture = "(() => { const c = document.querySelector('[data-film=method] [data-part=picture]'); \
                   const k = new OffscreenCanvas(c.width, c.height).getContext('2d'); k.drawImage(c, 0, 0); \
                   return [...k.getImageData(0, 0, c.width, c.height).data].reduce((sum, v, at) => (sum * 31 \
                   + v + at) % 1000003, 0); })()";
    let first = browser.js(picture);
    browser.js("(() => { const s = document.querySelector('[data-film=method] select'); s.value = \
                [...s.options].find((o) => o.text === 'truth').value; s.dispatchEvent(new Event('input')); \
                })()");
    browser.wait(&format!("{caption}.startsWith('truth, frame') && {picture} !== {first}"));
    let second = browser.js(picture);
    browser.js("document.querySelector('[data-part=over]').click()");
    browser.wait(&format!("{picture} !== {second}"));
    // A press on the time line goes there.
    let [left, top, width, height] = browser.settled("[data-part=line]");
    browser.press(left + 96.0 + 0.25 * (width - 102.0), top + height / 2.0);
    let length = browser.js("(P.data.to_ns - P.data.from_ns) / 1e6").as_f64().expect("a time");
    browser.wait(&format!("Math.abs({now} - {}) < {}", zero + 0.25 * length, 0.01 * length));
    browser.js("document.getElementById('theme').click()");
    browser.check("after all of it");
}

#[test]
fn a_page_draws_the_events_of_its_window_where_they_were() {
    let bench = Bench::new();
    // From 0 on: ON at (3, 2) within the first ms, OFF at (7, 5) at 10 ms, both at (1, 4) at 20 ms.
    bench.write("e.csv", "t,x,y,p\n0,3,2,1\n900,3,2,1\n10000,7,5,0\n20000,1,4,1\n20010,1,4,0\n30000,0,0,1\n");
    let done = bench.run(&["play", "e.csv", "--extent", "8x6", "--time-unit", "us", "-o", "play.html"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut browser = Browser::open(&bench.path("play.html"), 1280, 900);
    browser.wait("document.querySelector('[data-part=events-caption]').textContent.includes('ON')");
    let goes = |browser: &mut Browser, ms: u32, window_ns: u32| {
        browser.js(&format!(
            "(async () => {{ const set = (part, value) => {{ const e = \
             document.querySelector(`[data-part=${{part}}]`); e.value = value; e.dispatchEvent(new \
             Event('input')); }}; set('window', {window_ns}); set('time', {}); for (let k = 0; k < 3; k++) \
             await new Promise((done) => requestAnimationFrame(done)); }})()",
            ms * 10
        ));
        // Column, row, and which of ON's orange and OFF's blue outweighs.
        browser.js("(() => { const c = document.querySelector('[data-part=events]'); const d = \
                    c.getContext('2d').getImageData(0, 0, c.width, c.height).data; const all = []; for (let \
                    k = 0; k < d.length; k += 4) if (d[k + 3]) all.push([k / 4 % c.width, Math.floor(k / 4 / \
                    c.width), d[k] > d[k + 2] + 40 ? 'on' : d[k + 2] > d[k] + 40 ? 'off' : 'both']); return \
                    all; })()")
    };
    let rate = "document.querySelector('[data-part=rate]').textContent";
    assert_eq!(goes(&mut browser, 10, 1_000_000), json!([[7, 5, "off"]]));
    assert_eq!(browser.js(rate), json!("1 k events/s"));
    assert_eq!(goes(&mut browser, 20, 1_000_000), json!([[1, 4, "both"]]));
    assert_eq!(browser.js(rate), json!("2 k events/s"));
    assert_eq!(goes(&mut browser, 5, 1_000_000), json!([]));
    assert_eq!(browser.js(rate), json!("0 events/s"));
    // At the beginning half of the window lies before the recording: two events in 1 ms.
    assert_eq!(goes(&mut browser, 0, 2_000_000), json!([[3, 2, "on"]]));
    assert_eq!(browser.js(rate), json!("2 k events/s"));
    assert_eq!(goes(&mut browser, 10, 20_000_000), json!([[3, 2, "on"], [7, 5, "off"]]));
}

#[test]
fn axe_core_finds_a_barrier_where_there_is_one() {
    let bench = Bench::new();
    let page = |picture: &str| {
        let rest: String = (0..12)
            .map(|n| format!("<section aria-label=\"{n}\"><h2>Part {n}</h2><p>Text</p></section>"))
            .collect();
        format!(
            "<!doctype html><html lang=\"en\"><head><meta \
             charset=\"utf-8\"><title>x</title></head><body><main><h1>x</h1>{picture}{rest}<a href=\"#a\" \
             id=\"a\">link</a><button>press</button></main></body></html>"
        )
    };
    bench.write("good.html", &page("<img alt=\"dot\" src=\"data:image/png;base64,\">"));
    bench.write("bad.html", &page("<img src=\"data:image/png;base64,\">"));
    assert_eq!(Browser::open(&bench.path("good.html"), 800, 600).barriers(), [""; 0]);
    let found = Browser::open(&bench.path("bad.html"), 800, 600).barriers();
    assert!(!root().join(AXE).exists() || found.len() == 1 && found[0].starts_with("image-alt"), "{found:?}");
}

#[test]
fn the_page_of_a_diagnosis_is_read_in_a_browser() {
    let bench = Bench::new();
    let clip = root().join("data/recordings/davis346_traffic.aedat4").display().to_string();
    let sheet = root().join("data/sensors/davis346_sheet.toml").display().to_string();
    let done = bench.run(&["diagnose", &clip, "--direct", "--sensor", &sheet, "-o", "found", "--quiet"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut browser = Browser::open(&bench.path("found/report.html"), 1280, 900);
    look_everywhere(&mut browser, "diagnosis");
    assert_eq!(browser.js("document.title"), json!("Diagnosis: davis346_traffic.aedat4"));
    assert!(
        browser
            .js("document.querySelector('main dl').textContent")
            .as_str()
            .is_some_and(|text| text.contains("davis346_sheet.toml"))
    );
    assert!(
        browser
            .js("document.querySelector('#looked-at svg').getBoundingClientRect().width")
            .as_f64()
            .is_some_and(|width| width > 300.0)
    );
    assert!(
        browser
            .js("document.querySelector('#missing').textContent")
            .as_str()
            .is_some_and(|text| text.contains(" ms") && text.contains(" us")),
        "times in units that people write"
    );
    browser.js("document.getElementById('theme').click()");
    assert_eq!(browser.js("document.documentElement.dataset.theme"), json!("light"));
    browser.check("light by choice");
}
