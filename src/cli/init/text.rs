//! The manifest and the sensor description, as text with the reason on every line that is not certain.

use super::facts::{Facts, OWN};
use super::fill::Fill;
use super::window::Window;
use photocurrent_core::Colour;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A text in quotes, escaped as TOML wants.
fn quoted(text: &str) -> String {
    toml::Value::String(text.into()).to_string()
}

/// A comment is one line.
fn one_line(text: &str) -> String {
    text.replace('\n', " ")
}

fn marked(text: &mut String, fill: &Fill) {
    let mark = if fill.is_open { "FILL: " } else { "" };
    let _ = writeln!(text, "{} = {} # {mark}{}", fill.name, fill.value, one_line(&fill.why));
}

/// The manifest.
pub fn manifest(facts: &Facts, name: &str, sensor: &str, relative: &dyn Fn(&Path) -> PathBuf) -> String {
    let path = |path: &Path| quoted(&relative(path).to_string_lossy());
    let all = &facts.all;
    let file = all.path.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut text = format!(
        "# Sharp frames of {file} ({}): made by `photocurrent init`. It runs as it is: photocurrent run \
         {name}.toml\n\
         # Lines marked FILL state what the files do not; the picture depends on them, so check them first.\n\
         {}format = 1\n\n\
         [pipeline]\nabout = {}\n\n",
        facts.format.name,
        facts.marks.iter().map(|mark| format!("# FILL: {}\n", one_line(mark))).collect::<String>(),
        quoted(&format!("Sharp frames of {file}."))
    );
    let from_file = facts.sensor_text.is_some();
    let sensor_port = if from_file { "recording.sensor" } else { "sensor" };
    if !from_file {
        let _ = writeln!(
            text,
            "[nodes.sensor]\nkind   = \"read/sensor\"\nparams = {{ path = {} }}\n",
            quoted(sensor)
        );
    }
    let _ = writeln!(
        text,
        "[nodes.recording]\nkind = \"read/{}\"\n\n[nodes.recording.params]\npath = {}",
        facts.format.id,
        path(all.path.path())
    );
    for (key, place) in [("frames", &all.frames), ("stamps", &all.stamps)] {
        if let Some(place) = place {
            let _ = writeln!(text, "{key} = {}", path(place.path()));
        }
    }
    for (name, value) in &facts.stated {
        let _ = writeln!(text, "{name} = {value}");
    }
    facts.reader.iter().for_each(|fill| marked(&mut text, fill));
    let mut recording = "recording";
    if let Some(Window { start, end, why }) = &facts.window {
        if facts.format.id == OWN {
            // Its reader gives the whole; a node of its own cuts the part.
            recording = "part";
            let _ = writeln!(
                text,
                "\n# {}.\n[nodes.part]\nkind = \"split/time\"\nin = \
                 {{ events = \"recording.events\", frames = \"recording.frames\" }}\nparams = \
                 {{ start = \"{start}\", end = \"{end}\" }}",
                one_line(why)
            );
        } else {
            let _ = writeln!(text, "start = \"{start}\" # {}", one_line(why));
            let _ = writeln!(text, "end = \"{end}\"");
        }
    }
    let wiring = Wiring { recording, sensor: sensor_port, rate_hz: rendered_hz(facts) };
    let is_colour = facts.frames.colour == Colour::Rgb;
    if is_colour || facts.is_warped {
        let array = facts.is_warped.then(|| path(all.path.path()));
        mixture(&mut text, &wiring, (facts.frames.times.len(), is_colour), array);
    } else {
        alone(&mut text, &wiring, facts.is_blend_better.then_some(facts.frames.times.len()));
    }
    compared(&mut text, &wiring, if is_colour || facts.is_warped { "colour" } else { "render" });
    text
}

/// Where the nodes of a manifest take their inputs from, and how many pictures they render.
struct Wiring<'a> {
    recording: &'a str,
    sensor: &'a str,
    rate_hz: f64,
}

impl Wiring<'_> {
    /// Parameters of whoever renders.
    fn sampling(&self) -> String {
        let exposure = photocurrent_core::quantity::Duration::new((1e9 / self.rate_hz).round() as i64);
        format!("rate = \"{} Hz\", exposure = \"{exposure}\"", self.rate_hz)
    }
}

/// Pictures of `render/colour` are in memory all at once: so many values of them at most, four bytes each.
const MOST_VALUES: f64 = 2.5e8;
/// Tracks are refined along the motion from so many frames on: with fewer, no frame can judge it.
const JUDGED_FRAMES: usize = 4;

/// The rate of the pictures: in colour no more of them than memory holds.
fn rendered_hz(facts: &Facts) -> f64 {
    let (frames, mut rate_hz) = (&facts.frames, facts.rate_hz);
    if frames.colour != Colour::Rgb && !facts.is_warped {
        return rate_hz;
    }
    let seconds = frames.times.span(frames.extent.height).map_or(0.0, |span| span.length_ns() as f64 * 1e-9);
    let a_second = (frames.extent.height as usize * frames.row_values()) as f64 * seconds;
    while rate_hz * a_second > MOST_VALUES && rate_hz > 1.0 {
        rate_hz = (rate_hz / 2.0).ceil();
    }
    rate_hz
}

/// The node that solves events with frames.
fn solve(text: &mut String, events: &str, frames: &str, sensor: &str) {
    let _ = write!(
        text,
        r#"
# The photocurrent of every pixel, from events and frames together. The front end's delay is not known for this camera, so it is taken as ideal.
[nodes.solve]
kind   = "solve/map"
in     = {{ events = "{events}", frames = "{frames}", sensor = "{sensor}" }}
params = {{ front_end = "ideal" }}
"#
    );
}

/// Every value of a frame solved by itself; with so many `frames` refined along the motion, which falls back
/// to blends of these.
fn alone(text: &mut String, wiring: &Wiring<'_>, frames: Option<usize>) {
    let Wiring { recording, sensor, .. } = wiring;
    let tracks = solved_tracks(text, (recording, recording, sensor), frames.unwrap_or(0));
    let _ = write!(
        text,
        r#"
# Sharp frames without rolling shutter.
[nodes.render]
kind   = "render/rows"
in     = {{ tracks = "{tracks}", sensor = "{sensor}" }}
params = {{ {sampling} }}
"#,
        sampling = wiring.sampling(),
    );
}

/// The mixture of the colours solved, which is what events see, and divided by the hue of the frames; on the
/// event array's own pixels where events were warped to the frames of the sequence `array`.
fn mixture(
    text: &mut String,
    wiring: &Wiring<'_>,
    (frames, is_colour): (usize, bool),
    array: Option<String>,
) {
    let Wiring { recording, sensor, .. } = wiring;
    let is_array = array.is_some();
    let seen = match array {
        Some(path) => {
            of_the_array(text, (recording, sensor), &path);
            "array"
        }
        None => recording,
    };
    let solved = if is_colour { "grey" } else { seen };
    if is_colour {
        let _ = write!(
            text,
            r#"
# An event pixel sees the mixture of its colours.
[nodes.grey]
kind = "render/grey"
in   = {{ frames = "{seen}.frames", events = "{seen}.events", sensor = "{sensor}" }}
"#
        );
    }
    let mut tracks = solved_tracks(text, (seen, solved, sensor), frames);
    if is_array {
        let _ = write!(
            text,
            r#"
# Back to the pixels of the frames.
[nodes.back]
kind = "align/tracks"
in   = {{ tracks = "{tracks}", frames = "{recording}.frames", alignment = "array.alignment", events = "array.events" }}
"#
        );
        tracks = "back.tracks";
    }
    let _ = write!(
        text,
        r#"
# Sharp frames without rolling shutter, {what}.
[nodes.render]
kind   = "render/rows"
in     = {{ tracks = "{tracks}", sensor = "{sensor}" }}
params = {{ {sampling} }}

[nodes.colour]
kind = "render/colour"

[nodes.colour.in]
frames   = "render.frames"
captured = "{recording}.frames"
tracks   = "{tracks}"
events   = "{seen}.events"
sensor   = "{sensor}"
{alignment}"#,
        what = if is_colour { "and their colours" } else { "and what the event array does not resolve" },
        sampling = wiring.sampling(),
        alignment = if is_array { "alignment = \"array.alignment\"\n" } else { "" },
    );
}

/// The nodes that bring a recording onto the event array's own pixels.
fn of_the_array(text: &mut String, (recording, sensor): (&str, &str), path: &str) {
    let _ = write!(
        text,
        r#"
# Events were warped onto the frames: solved on the pixels of their own array, each once, with the frames as these see them.
[nodes.places]
kind   = "read/alignment"
params = {{ path = {path} }}

# A shift of these places is estimated, and used where it predicts frames that are held out better.
[nodes.array]
kind = "estimate/alignment"
in   = {{ events = "{recording}.events", frames = "{recording}.frames", alignment = "places", sensor = "{sensor}" }}
"#
    );
}

/// The nodes that solve events of `seen` with the frames of `solved`, refined where frames can judge that;
/// the port of their tracks.
fn solved_tracks(
    text: &mut String,
    (seen, solved, sensor): (&str, &str, &str),
    frames: usize,
) -> &'static str {
    solve(text, &format!("{seen}.events"), &format!("{solved}.frames"), sensor);
    if frames < JUDGED_FRAMES {
        return "solve.tracks";
    }
    let _ = write!(
        text,
        r#"
# Solved again with what neighbouring pixels see before and after, where that predicts frames better.
[nodes.refine]
kind   = "refine/motion"
in     = {{ tracks = "solve.tracks", events = "{seen}.events", frames = "{solved}.frames", sensor = "{sensor}" }}
params = {{ front_end = "ideal" }}
"#
    );
    "refine.tracks"
}

/// What the frames of `node` are compared with, and the files that are written.
fn compared(text: &mut String, wiring: &Wiring<'_>, node: &str) {
    let Wiring { recording, sensor, .. } = wiring;
    let _ = write!(
        text,
        r#"
# For comparison: the event-based double integral, and the frames as they were captured.
[nodes.edi]
kind   = "baseline/edi"
in     = {{ events = "{recording}.events", frames = "{recording}.frames", sensor = "{sensor}" }}
params = {{ {sampling} }}

[nodes.repeat]
kind   = "baseline/repeat"
in     = {{ frames = "{recording}.frames", sensor = "{sensor}" }}
params = {{ {sampling} }}

# What to look at first: sheet/contact_sheet.png.
[nodes.sheet]
kind   = "write/contact_sheet"
in     = {{ frames = ["{node}", "edi", "repeat"], events = "{recording}.events", sensor = "{sensor}" }}
params = {{ labels = ["photocurrent", "EDI", "captured frames"], columns = 4 }}

# Linear 16-bit PNG for measurements, times in frames.csv; 8-bit pictures to look at in preview/.
[nodes.frames]
kind   = "write/frames"
in     = {{ frames = "{node}", sensor = "{sensor}" }}
params = {{ preview = true }}
"#,
        sampling = wiring.sampling(),
    );
}

/// The sensor description.
pub fn sensor(facts: &Facts) -> String {
    let file = facts.all.path.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let fill = |name: &str| {
        facts.sensor.iter().filter(|fill| fill.name == name).fold(String::new(), |mut text, fill| {
            marked(&mut text, fill);
            text
        })
    };
    // One unit of photocurrent reads as one DN in a frame of the recording: gain is then 1 / exposure.
    let gain = 1.0 / facts.exposure_s();
    let saturation = if facts.bits >= 32 {
        String::new()
    } else {
        format!("saturation_dn = {:.1}\n", (2f64).powi(facts.bits as i32) - 1.0)
    };
    let row_time = photocurrent_core::quantity::Duration::new(facts.frames.times.row_time_ns);
    let camera: String = facts.camera.iter().map(|line| format!("# {line}\n")).collect();
    let offset = fill("clock_offset");
    let effects = if offset.is_empty() { offset } else { format!("\n[effects]\n{offset}") };
    format!(
        "# The camera of {file}: what its files state, and starting values for the rest. Made by \
         `photocurrent init`.\n\
         # Measured thresholds are better: photocurrent nodes estimate/thresholds.\n\
         # A threshold or a time may be a range instead, threshold_on = [0.2, 0.4]: `photocurrent diagnose` \
         estimates it, everything else takes its middle.\n\
         # Without a front end (tau = tau_0 + alpha / photocurrent) `diagnose` compares nothing on a scene; \
         a range is enough:\n\
         # [front_end]\n# tau_0 = [\"1 us\", \"1 ms\"]\n# alpha = [\"1 ms\", \"1 s\"]\n\
         {camera}format = \"photocurrent-sensor/1\"\nname   = {}\n\n\
         [comparator]\n{}{}\n[readout]\n{}\n[frames]\n\
         gain = {gain:?} # sets the unit of photocurrent: 1 reads as 1 DN in a frame of this recording\n\
         black_level_dn = 0.0\n{saturation}row_time = \"{row_time}\"\n{effects}",
        quoted(&file),
        fill("threshold_on"),
        fill("threshold_off"),
        fill("refractory"),
    )
}
