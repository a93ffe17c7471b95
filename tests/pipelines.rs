//! The pipelines that people run, and their ablations, do run; and what they write for people and programs is
//! as documented.

use crate::support::{self, Bench, digests, executed};
use photocurrent_core::Value as Artefact;
use photocurrent_store::Cache;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

fn pipeline(name: &str) -> String {
    support::root().join("pipelines").join(name).display().to_string()
}

/// A table as `write/table` wrote it: label to values by metric.
fn table(path: &Path) -> BTreeMap<String, BTreeMap<String, f64>> {
    let table: Value =
        serde_json::from_str(&std::fs::read_to_string(path).expect("table.json")).expect("JSON");
    let metrics: Vec<&str> = table["columns"]
        .as_array()
        .expect("columns")
        .iter()
        .map(|column| column["metric"].as_str().expect("a metric"))
        .collect();
    let row = |row: &Value| {
        let values =
            row["values"].as_array().expect("values").iter().map(|value| value.as_f64().expect("a number"));
        (
            row["label"].as_str().expect("a label").to_string(),
            metrics.iter().map(ToString::to_string).zip(values).collect(),
        )
    };
    table["rows"].as_array().expect("rows").iter().map(row).collect()
}

fn lines(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect()
}

/// Pooled values by (variant, node, metric).
fn pooled(path: &Path) -> BTreeMap<(String, String, String), f64> {
    let text = |line: &Value, key: &str| line[key].as_str().expect("a text").to_string();
    let key = |line: &Value| (text(line, "variant"), text(line, "node"), text(line, "metric"));
    lines(path).iter().map(|line| (key(line), line["value"].as_f64().expect("a number"))).collect()
}

/// A page shows what the command prints, digit for digit.
fn in_the_page(page: &str, printed: &str) {
    let text = std::fs::read_to_string(support::root().join(page)).expect("the page is there");
    assert!(text.contains(printed.trim()), "{page} should show\n{printed}");
}

#[test]
fn the_quickstart_shows_what_compensation_brings() {
    let bench = Bench::new();
    let done = bench.run(&["run", &pipeline("quickstart.toml")]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let table = table(&bench.path("out/quickstart/table/table.json"));
    let psnr = |label: &str| table[label]["psnr_db"];
    // The paper's Table 2 and its comparison: each compensation helps in this scene, and the full model is
    // ahead of the double integral, which is ahead of showing the last frame again.
    assert!(
        psnr("all compensations") > psnr("readout + refractory")
            && psnr("readout + refractory") > psnr("no compensation"),
        "{table:?}"
    );
    assert!(
        psnr("all compensations") > psnr("V_FE delay") && psnr("V_FE delay") > psnr("no compensation"),
        "{table:?}"
    );
    assert!(psnr("all compensations") > psnr("EDI") && psnr("EDI") > psnr("frame repetition"), "{table:?}");
    // People see the same table, to three digits.
    for (label, values) in &table {
        let row = done
            .stdout
            .lines()
            .find(|line| line.starts_with(label.as_str()))
            .unwrap_or_else(|| panic!("{label} is missing from {}", done.stdout));
        assert!(row.ends_with(&format!("  {:.3}", values["psnr_db"])), "{row}");
    }
    in_the_page("README.md", &done.stdout);
    assert!(
        done.stderr.contains("22 nodes executed, 0 reused from the cache")
            && done.stderr.contains("files are in out/quickstart"),
        "{}",
        done.stderr
    );
}

const VARIANTS: [(&str, &str); 4] = [
    ("front_end=off,readout=off", "psnr_none"),
    ("front_end=on,readout=off", "psnr_vfe"),
    ("front_end=off,readout=on", "psnr_rlrp"),
    ("front_end=on,readout=on", "psnr_all"),
];

#[test]
fn the_compensation_ablation_agrees_with_the_quickstart() {
    let (ablation, quickstart) = (Bench::new(), Bench::new());
    // The quickstart renders up to 76 ms; all else is alike.
    let arguments =
        [pipeline("ablations/compensation.toml"), "--set".into(), "nodes.render.params.end=\"76 ms\"".into()];
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let outcome = ablation.outcome(&arguments);
    assert_eq!(outcome["variants"].as_array().map(Vec::len), Some(4));
    let mut nodes = executed(&outcome);
    nodes.dedup();
    assert_eq!(nodes, ["psnr", "recording", "render", "scene", "sensor", "solve"]);
    // One description, one scene and one recording for all; solved, rendered and scored four times.
    assert_eq!(outcome["executed"].as_u64(), Some(3 + 3 * 4));

    quickstart.outcome(&[&pipeline("quickstart.toml")]);
    let varied = pooled(&ablation.path("out/compensation/metrics.pooled.jsonl"));
    let plain = pooled(&quickstart.path("out/quickstart/metrics.pooled.jsonl"));
    assert_eq!(varied.len(), 4);
    for (variant, node) in VARIANTS {
        let (here, there) = (
            varied[&(variant.into(), "psnr".into(), "psnr_db".into())],
            plain[&("base".into(), node.into(), "psnr_db".into())],
        );
        assert_eq!(here.to_bits(), there.to_bits(), "{variant}");
    }
    // The same in another way: what the quickstart made is taken from its cache.
    assert_eq!(executed(&quickstart.outcome(&arguments)), [""; 0]);
}

#[test]
fn an_ablation_prints_one_row_a_variant_with_its_gain() {
    let bench = Bench::new();
    let done = bench.run(&["run", &pipeline("ablations/compensation.toml")]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let rows: Vec<Vec<&str>> = done.stdout.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[0], ["front_end", "readout", "psnr.psnr_db", "gain"]);
    assert_eq!(
        rows[2..].iter().map(|row| (row[0], row[1])).collect::<Vec<_>>(),
        [("off", "off"), ("off", "on"), ("on", "off"), ("on", "on")]
    );
    assert_eq!(rows[2][3], "+0.000");
    in_the_page("docs/ablation.md", &done.stdout);
    let number = |row: usize, column: usize| rows[row][column].parse::<f64>().expect("a number");
    for row in 3..6 {
        // Both are rounded to three digits.
        assert!(
            (number(row, 3) - (number(row, 2) - number(2, 2))).abs() < 0.0021 && number(row, 3) > 0.0,
            "{}",
            done.stdout
        );
    }
}

#[test]
fn blocks_of_a_long_recording_show_every_instant_once_and_as_well_as_the_whole() {
    let bench = Bench::new();
    let scores = |length: &str| -> Vec<(i64, f64)> {
        let small = ["--set", "nodes.scene.params.width=24", "--set", "nodes.scene.params.height=16"];
        let length = format!("pipeline.blocks.length=\"{length}\"");
        let done = bench.run(&[&["run", &pipeline("long.toml"), "--set", &length], &small[..]].concat());
        assert_eq!(done.code, 0, "{}", done.stderr);
        let lines = lines(&bench.path("out/long/metrics.jsonl"));
        let mut scores: Vec<(i64, f64)> = lines
            .iter()
            .map(|line| (line["t_ns"].as_i64().expect("ns"), line["value"].as_f64().expect("dB")))
            .collect();
        scores.sort_by_key(|(t_ns, _)| *t_ns);
        scores
    };
    let whole = scores("1 min");
    let blocks = scores("100 ms");
    // The report shows what was joined: one curve of each pixel's photocurrent, and pictures of the whole.
    let report = bench.run(&["report", "out/long"]);
    assert_eq!(report.code, 0, "{}", report.stderr);
    let page = std::fs::read_to_string(bench.path("out/long/report.html")).expect("the report");
    assert!(page.contains(r#""solved":[{"label":"render","#) && !page.contains(r#""label":"render["#));
    let instants = |scores: &[(i64, f64)]| scores.iter().map(|(t_ns, _)| *t_ns).collect::<Vec<i64>>();
    assert_eq!(instants(&blocks), instants(&whole));
    assert_eq!(blocks.len(), 300);
    let pictures = std::fs::read_dir(bench.path("out/long/pictures")).expect("a folder of pictures");
    assert_eq!(
        pictures
            .filter(|picture| picture
                .as_ref()
                .is_ok_and(|picture| picture.file_name().to_string_lossy().ends_with(".png")))
            .count(),
        300
    );
    let mean = |scores: &[(i64, f64)]| scores.iter().map(|(_, db)| db).sum::<f64>() / scores.len() as f64;
    assert!(mean(&blocks) > mean(&whole) - 0.5, "{} {}", mean(&blocks), mean(&whole));
    // Nor does any frame next to a cut stand out: the ten on either side of both.
    let near_cut = |scores: &[(i64, f64)]| mean(&[&scores[90..110], &scores[190..210]].concat());
    assert!(near_cut(&blocks) > near_cut(&whole) - 0.5, "{} {}", near_cut(&blocks), near_cut(&whole));
}

#[test]
fn the_weights_are_swept_over_one_scene() {
    let bench = Bench::new();
    let smaller = [
        "--set",
        "nodes.scene.params.width=48",
        "--set",
        "nodes.scene.params.height=32",
        "--set",
        "nodes.scene.params.duration=\"40 ms\"",
    ];
    let manifest = pipeline("ablations/weights.toml");
    let mut arguments = vec![manifest.as_str()];
    arguments.extend(smaller);
    let outcome = bench.outcome(&arguments);
    assert_eq!(outcome["variants"].as_array().map(Vec::len), Some(5));
    assert_eq!(outcome["executed"].as_u64(), Some(3 + 3 * 5));
    let found = pooled(&bench.path("out/weights/metrics.pooled.jsonl"));
    assert!(found.len() == 5 && found.values().all(|value| value.is_finite()), "{found:?}");
}

#[test]
fn the_real_camera_is_planned_whole_and_scored_on_a_part() {
    let bench = Bench::new();
    let manifest = pipeline("davis346.toml");
    let planned = bench.run(&["plan", &manifest]);
    assert_eq!(planned.code, 0, "{}", planned.stderr);
    assert!(planned.stderr.contains("0 in the cache"), "{}", planned.stderr);

    // Long enough for two held-out frames: in a single one, nothing is seen to move.
    let part = [
        "nodes.recording.params.end=\"500 ms\"",
        "nodes.render.params.start=\"100 ms\"",
        "nodes.render.params.end=\"105 ms\"",
        "nodes.edi.params.start=\"100 ms\"",
        "nodes.edi.params.end=\"105 ms\"",
        "nodes.repeat.params.start=\"100 ms\"",
        "nodes.repeat.params.end=\"105 ms\"",
    ];
    let mut arguments = vec![manifest.as_str()];
    arguments.extend(part.iter().flat_map(|set| ["--set", set]));
    bench.outcome(&arguments);
    let table = table(&bench.path("out/davis346/table/table.json"));
    assert!(["ours", "EDI", "frame repetition"].iter().all(|label| table.contains_key(*label)), "{table:?}");
    for metric in ["heldout_rmse_dn", "heldout_psnr_db", "heldout_psnr_moving_db"] {
        assert!(table.values().all(|row| row[metric].is_finite()), "{table:?}");
    }
    // True of the whole recording too: who integrates events predicts an unseen frame better than who shows
    // the last one again.
    assert!(table["ours"]["heldout_psnr_db"] > table["frame repetition"]["heldout_psnr_db"], "{table:?}");
    let frames = std::fs::read_to_string(bench.path("out/davis346/frames/frames.csv")).expect("frames.csv");
    assert_eq!(frames.lines().count(), 2 + 5, "{frames}");
    assert_eq!(size(&bench.path("out/davis346/frames/000000.png")), (346, 260));
}

/// A picture as its file says: no gamma may be stated anywhere.
fn decoded(path: &Path) -> (png::OutputInfo, Vec<u8>) {
    let file = std::fs::File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    assert!(
        reader.info().gama_chunk.is_none()
            && reader.info().srgb.is_none()
            && reader.info().chrm_chunk.is_none(),
        "{} states a gamma",
        path.display()
    );
    bytes.truncate(info.buffer_size());
    (info, bytes)
}

fn size(path: &Path) -> (u32, u32) {
    let (info, _) = decoded(path);
    (info.width, info.height)
}

/// `name=NUMBER` in the first line of frames.csv.
fn stated<'a>(line: &'a str, name: &str) -> &'a str {
    let start = line.find(&format!("{name}=")).unwrap_or_else(|| panic!("`{name}` is missing from {line}"))
        + name.len()
        + 1;
    line[start..].split([' ', ';']).next().expect("a value")
}

#[test]
fn exported_frames_follow_the_format_to_the_letter_and_read_back_as_they_were_rendered() {
    let bench = Bench::new();
    let outcome = bench.outcome(&[&pipeline("quickstart.toml"), "--to", "frames"]);
    let folder = bench.path("out/quickstart/frames");
    let text = std::fs::read_to_string(folder.join("frames.csv")).expect("frames.csv");
    let csv: Vec<&str> = text.lines().collect();

    let (offset, scale, exposure) =
        (stated(csv[0], "offset"), stated(csv[0], "scale"), stated(csv[0], "exposure_dn_of_ns"));
    assert_eq!(
        csv[0],
        format!("# dn = offset + scale * code; offset={offset} scale={scale}; exposure_dn_of_ns={exposure}")
    );
    // The scene's frames are exposed for 6.5 ms unless stated otherwise.
    assert_eq!(exposure, "6500000");
    let (offset, scale): (f64, f64) = (offset.parse().expect("a number"), scale.parse().expect("a number"));
    assert!(scale > 0.0);
    assert_eq!(csv[1], "index,t_start_ns,t_end_ns,t_mid_ns,file,offset_dn,scale_dn");
    // 1 kHz below 76 ms, exposed for 100 us around each millisecond.
    assert_eq!(csv.len(), 2 + 76);
    for (k, row) in csv[2..].iter().enumerate() {
        let mid = 1_000_000 * k as i64;
        assert_eq!(
            *row,
            format!("{k},{},{},{mid},{k:06}.png,{offset:?},{scale:?}", mid - 50_000, mid + 50_000)
        );
    }

    let cache = Cache::open(&bench.path(".photocurrent")).expect("the cache");
    let digest = digests(&outcome)["render_all.frames"].parse().expect("a digest");
    let Artefact::Frames(frames) = cache.load(&digest).expect("the frames") else { panic!("frames") };
    let block = frames.read_rows(frames.rows()).expect("the frames' values");
    // The sensor description is connected: code 65535 is its saturation, and what was rendered brighter is
    // clipped to it.
    let saturation = 1023.0;
    assert_eq!((offset, scale), (0.0, saturation / 65535.0));
    let mut brightest = 0;
    for k in 0..frames.len() {
        let (info, bytes) = decoded(&folder.join(format!("{k:06}.png")));
        assert_eq!(
            (info.width, info.height, info.color_type, info.bit_depth),
            (128, 96, png::ColorType::Grayscale, png::BitDepth::Sixteen)
        );
        let codes: Vec<u16> =
            bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        brightest = brightest.max(codes.iter().copied().max().expect("pixels"));
        for (code, dn) in codes.iter().zip(block.frame(k)) {
            let back = offset + scale * f64::from(*code);
            // Half a code step, and the rounding of the division.
            assert!(
                (back - f64::from(*dn).min(saturation)).abs() <= 0.5 * scale * (1.0 + 1e-9),
                "frame {k}: code {code} is {back} DN, {dn} was rendered"
            );
        }
    }
    assert_eq!(brightest, 65535, "some pixel is saturated");
}

#[test]
fn what_a_run_writes_may_be_read_by_those_who_may_read_other_files() {
    let bench = Bench::new();
    bench.write("m.toml", &support::small_pipeline());
    bench.outcome(&["m.toml"]);
    let mode = |path: &Path| {
        std::os::unix::fs::PermissionsExt::mode(&std::fs::metadata(path).expect("a file").permissions())
            & 0o777
    };
    let usual = mode(&bench.path("m.toml"));
    for name in ["run.json", "metrics.jsonl", "metrics.pooled.jsonl"] {
        assert_eq!(mode(&bench.path(&format!("out/m/{name}"))), usual, "{name}");
    }
}

#[test]
fn metrics_are_one_object_a_line_with_the_documented_keys() {
    let bench = Bench::new();
    bench.write("m.toml", &support::small_pipeline());
    bench.outcome(&["m.toml"]);
    let (single, pooled) =
        (lines(&bench.path("out/m/metrics.jsonl")), lines(&bench.path("out/m/metrics.pooled.jsonl")));
    // 1 kHz over 40 ms, two scores a frame; and each once over all frames.
    assert_eq!((single.len(), pooled.len()), (2 * 40, 2));
    for line in single.iter().chain(&pooled) {
        let keys: Vec<&str> = line.as_object().expect("an object").keys().map(String::as_str).collect();
        let tails: &[&str] = if line["frame"] == -1 { &["min", "p05", "p95", "max"] } else { &[] };
        assert_eq!(
            keys,
            [&["variant", "node", "metric", "frame", "t_ns", "value", "unit", "card"], tails].concat()
        );
        assert_eq!(
            (&line["variant"], &line["metric"], &line["unit"]),
            (&"base".into(), &"psnr_db".into(), &"dB".into())
        );
        assert!(
            line["value"].is_f64()
                && line["node"].as_str().is_some_and(|node| ["psnr", "psnr_edi"].contains(&node)),
            "{line}"
        );
        // What a card must state: channel, range, crop, matching, version.
        let card = line["card"].as_str().expect("a card");
        assert!(
            ["psnr.v1", "linear DN", "peak ", "all pixels", "matched by middle of exposure"]
                .iter()
                .all(|part| card.contains(part)),
            "{card}"
        );
    }
    let mine: Vec<&Value> = single.iter().filter(|line| line["node"] == "psnr").collect();
    assert!(
        mine.iter().enumerate().all(|(k, line)| line["frame"] == k && line["t_ns"] == k as i64 * 1_000_000)
    );
    // Pooled is the mean over frames, as the card says.
    let mean =
        mine.iter().map(|line| line["value"].as_f64().expect("a number")).sum::<f64>() / mine.len() as f64;
    let pooled = pooled.iter().find(|line| line["node"] == "psnr").expect("a pooled line");
    let stated = |key: &str| pooled[key].as_f64().expect("a number");
    assert!((mean - stated("value")).abs() < 1e-9, "{mean} {}", stated("value"));
    let worst =
        mine.iter().map(|line| line["value"].as_f64().expect("a number")).fold(f64::INFINITY, f64::min);
    assert_eq!(stated("min"), worst);
    assert!(
        worst <= stated("p05")
            && stated("p05") < mean
            && mean < stated("p95")
            && stated("p95") <= stated("max"),
        "{pooled}"
    );
}

#[test]
fn every_score_ranks_the_methods_alike_where_an_edge_moves() {
    let bench = Bench::new();
    bench.outcome(&[&pipeline("scores.toml")]);
    let of = |metric: &str, column: &str| {
        let table = table(&bench.path(&format!("out/scores/table_{metric}/table.json")));
        ["all compensations", "EDI", "frame repetition"].map(|label| table[label][column])
    };
    for (metric, column) in [("psnr", "psnr_db"), ("ssim", "ssim")] {
        let [ours, edi, repeat] = of(metric, column);
        assert!(ours > edi && edi > repeat, "{column}: {ours} {edi} {repeat}");
    }
    for (metric, column) in [("lpips", "lpips"), ("bew", "bew_px")] {
        let [ours, edi, repeat] = of(metric, column);
        assert!(ours < edi && edi < repeat, "{column}: {ours} {edi} {repeat}");
    }
    // The board slides 0.4 pixels per ms through 6.5 ms: L = 2.6 pixels, with a square pixel L + 1 - 2
    // sqrt(0.2 L) = 2.16 pixels from 10 to 90 %. The scene's own softened edge and bins of a quarter pixel
    // widen it a little.
    let [_, _, blurred] = of("bew", "bew_px");
    assert!((2.1..2.5).contains(&blurred), "{blurred}");
}

#[test]
fn the_contact_sheet_is_a_picture() {
    let bench = Bench::new();
    let smaller = ["--set", "nodes.scene.params.width=48", "--set", "nodes.scene.params.height=32"];
    let manifest = pipeline("quickstart.toml");
    let mut arguments = vec![manifest.as_str(), "--to", "sheet"];
    arguments.extend(smaller);
    bench.outcome(&arguments);
    let (info, bytes) = decoded_sheet(&bench.path("out/quickstart/sheet/contact_sheet.png"));
    // Six methods and the truth, each at least as large as the scene.
    assert!(
        u64::from(info.width) * u64::from(info.height) >= 7 * 48 * 32,
        "{} x {}",
        info.width,
        info.height
    );
    assert!(bytes.iter().any(|byte| *byte != bytes[0]), "the sheet is of one colour");
}

/// The sheet is for looking and may state its gamma.
fn decoded_sheet(path: &Path) -> (png::OutputInfo, Vec<u8>) {
    let file = std::fs::File::open(path).expect("contact_sheet.png");
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    bytes.truncate(info.buffer_size());
    (info, bytes)
}
