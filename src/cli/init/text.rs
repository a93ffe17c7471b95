//! The manifest and the sensor description, as text with the reason on every line that is not certain.

use super::facts::{Facts, OWN};
use super::fill::Fill;
use super::window::Window;
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
    pipeline(&mut text, facts.rate_hz, recording, sensor_port);
    text
}

/// The nodes behind the readers, from the solver to the files that are written.
fn pipeline(text: &mut String, rate_hz: f64, recording: &str, sensor_port: &str) {
    let exposure = photocurrent_core::quantity::Duration::new((1e9 / rate_hz).round() as i64);
    let _ = write!(
        text,
        r#"
# The photocurrent of every pixel, from events and frames together. The front end's delay is not known for this camera, so it is taken as ideal.
[nodes.solve]
kind   = "solve/map"
in     = {{ events = "{recording}.events", frames = "{recording}.frames", sensor = "{sensor_port}" }}
params = {{ front_end = "ideal", event_noise = 0.1 }}

# Sharp frames without rolling shutter.
[nodes.render]
kind   = "render/rows"
in     = {{ tracks = "solve.tracks", sensor = "{sensor_port}" }}
params = {{ rate = "{rate} Hz", exposure = "{exposure}" }}

# For comparison: the event-based double integral, and the frames as they were captured.
[nodes.edi]
kind   = "baseline/edi"
in     = {{ events = "{recording}.events", frames = "{recording}.frames", sensor = "{sensor_port}" }}
params = {{ rate = "{rate} Hz", exposure = "{exposure}" }}

[nodes.repeat]
kind   = "baseline/repeat"
in     = {{ frames = "{recording}.frames", sensor = "{sensor_port}" }}
params = {{ rate = "{rate} Hz", exposure = "{exposure}" }}

# What to look at first: sheet/contact_sheet.png.
[nodes.sheet]
kind   = "write/contact_sheet"
in     = {{ frames = ["render", "edi", "repeat"], events = "{recording}.events", sensor = "{sensor_port}" }}
params = {{ labels = ["photocurrent", "EDI", "captured frames"], columns = 4 }}

# Linear 16-bit PNG for measurements, times in frames.csv; 8-bit pictures to look at in preview/.
[nodes.frames]
kind   = "write/frames"
in     = {{ frames = "render", sensor = "{sensor_port}" }}
params = {{ preview = true }}
"#,
        rate = rate_hz,
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
