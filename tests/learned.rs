//! The manifests of pipelines/baselines/: a row that says what is missing, and one that is filled as soon as
//! a network or pictures are there.
//!
//! Nobody else's weights are here, so that networks that blend the frames stand in
//! (`data/networks/stand_ins.py`). In a still scene any blend of frames is the scene: a wrong encoding, white
//! or scale would cost tens of decibels.

use crate::support::{Bench, root};
use std::path::Path;

/// Method and the inputs of its network, which the stand-in has too.
const NETWORKS: [&str; 4] = ["time_lens", "film", "cbmnet", "refid"];

fn manifest(method: &str) -> String {
    root().join("pipelines/baselines").join(method).with_extension("toml").display().to_string()
}

/// A still fan, small and short, of the method's own manifest.
fn still(bench: &Bench, method: &str, more: &[&str]) -> crate::support::Done {
    // What is set wins over every level, so that the other scenes are no mistake.
    let sets = [
        "nodes.scene.params.scene=\"fan\"",
        "nodes.scene.params.fan.speed=\"0 rpm\"",
        "nodes.scene.params.width=48",
        "nodes.scene.params.height=32",
        "nodes.scene.params.duration=\"40 ms\"",
    ];
    let end = if method == "evunroll" {
        "nodes.instants.params.end=\"35 ms\"".to_string()
    } else {
        format!("nodes.{method}.params.end=\"35 ms\"")
    };
    let manifest = manifest(method);
    let mut arguments = vec!["run", manifest.as_str(), "--variant", "scene=fan", "--set", end.as_str()];
    arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
    arguments.extend(more);
    bench.run(&arguments)
}

/// The pooled lines of a method's run.
fn pooled(bench: &Bench, method: &str) -> Vec<serde_json::Value> {
    let path = bench.path("out").join(method).join("metrics.pooled.jsonl");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

/// The pooled PSNR and LPIPS of a method.
fn numbers(bench: &Bench, method: &str) -> [f64; 2] {
    let lines = pooled(bench, method);
    ["psnr", "lpips"].map(|metric| {
        let node = format!("{metric}_{method}");
        lines
            .iter()
            .find(|line| line["node"] == node)
            .and_then(|line| line["value"].as_f64())
            .unwrap_or_else(|| panic!("no number of {node}: {lines:?}"))
    })
}

#[test]
fn a_row_says_which_weights_are_missing_in_a_run_that_succeeds() {
    let bench = Bench::new();
    // A method that is there gives the table its columns.
    let stand_in = format!("nodes.film.params.network={:?}", root().join("data/networks/stand_in_film.onnx"));
    let done = still(&bench, "film", &["--set", &stand_in]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for (method, missing) in [
        ("time_lens", "time_lens.onnx"),
        ("cbmnet", "cbmnet.onnx"),
        ("refid", "refid.onnx"),
        ("evunroll", "evunroll/fan"),
    ] {
        let done = still(&bench, method, &[]);
        assert_eq!(done.code, 0, "{method}: {}", done.stderr);
        let note = format!("left out: {method}, psnr_{method}, lpips_{method}: cannot read ");
        assert!(done.stderr.contains(&note), "{method}: {}", done.stderr);
        let manifests = [manifest("film"), manifest(method)];
        let done = bench.run(&[
            "table",
            &manifests[0],
            &manifests[1],
            "--metric",
            "psnr_db",
            "--rows",
            "method",
            "--columns",
            "scene",
        ]);
        assert_eq!(done.code, 0, "{method}: {}", done.stderr);
        assert!(done.stdout.contains(&format!("| {method} | no {missing} |")), "{}", done.stdout);
        assert!(done.stdout.contains(&format!("\nno {missing}: cannot read ")), "{}", done.stdout);
    }
    // Only what is missing is forgiven: a file that is no network is a mistake.
    let wrong = bench.write("wrong.onnx", "no network");
    let done = still(&bench, "cbmnet", &["--set", &format!("nodes.cbmnet.params.network={wrong:?}")]);
    assert_eq!(done.code, 4, "{}", done.stderr);
    assert!(done.stderr.contains("error: node cbmnet (baseline/onnx) failed"), "{}", done.stderr);
}

#[test]
fn a_network_fills_its_row_through_the_same_manifest() {
    let bench = Bench::new();
    for method in NETWORKS {
        let network = root().join("data/networks").join(format!("stand_in_{method}.onnx"));
        let done = still(&bench, method, &["--set", &format!("nodes.{method}.params.network={network:?}")]);
        assert_eq!(done.code, 0, "{method}: {}", done.stderr);
        let [psnr, lpips] = numbers(&bench, method);
        assert!(psnr > 40.0 && lpips < 0.02, "{method}: {psnr} dB, LPIPS {lpips}");
        assert!(!done.stderr.contains("left out:"), "{method}: {}", done.stderr);
    }
}

#[test]
fn the_interpolator_of_this_project_fills_its_row() {
    let bench = Bench::new();
    let done = still(&bench, "learned_ours", &[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let [psnr, lpips] = numbers(&bench, "learned_ours");
    assert!(psnr > 40.0 && lpips < 0.02, "{psnr} dB, LPIPS {lpips}");
    let done = bench.run(&[
        "table",
        &manifest("learned_ours"),
        "--metric",
        "psnr_db",
        "--rows",
        "method",
        "--columns",
        "scene",
    ]);
    assert!(done.stdout.contains("learned_ours"), "{}", done.stdout);
}

/// The values of a grey picture of 16 bits.
fn grey(path: &Path) -> (u32, u32, Vec<u16>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).expect("a picture")));
    let mut reader = decoder.read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("its pixels");
    assert_eq!(info.bit_depth, png::BitDepth::Sixteen);
    (
        info.width,
        info.height,
        bytes[..info.buffer_size()]
            .chunks_exact(2)
            .map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
            .collect(),
    )
}

#[test]
fn pictures_fill_their_row_through_the_same_manifest() {
    let bench = Bench::new();
    // What the camera saw of the still scene, in linear codes of 16 bits.
    bench.write(
        "seen.toml",
        &format!(
            "format = 1\nextends = {:?}\n[nodes.seen]\nkind = \"write/frames\"\nin = \
                  {{ frames = \"recording.frames\" }}\nparams = {{ scale = 1.0, offset = 0.0 }}\n",
            manifest("evunroll")
        ),
    );
    let seen = bench.path("seen.toml").display().to_string();
    let sets = ["scene=\"fan\"", "fan.speed=\"0 rpm\"", "width=48", "height=32", "duration=\"40 ms\""]
        .map(|set| format!("nodes.scene.params.{set}"));
    let mut arguments = vec!["run", seen.as_str(), "--variant", "scene=fan", "--to", "seen"];
    arguments.extend(sets.iter().flat_map(|set| ["--set", set.as_str()]));
    let done = bench.run(&arguments);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let (width, height, dn) = grey(&bench.path("out/seen/scene=fan/seen/000001.png"));
    // As EvUnroll's authors store pictures: 8 bits on the curve of sRGB, white paper white; one each 500 us.
    let srgb = |light: f64| {
        if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055 }
    };
    let codes: Vec<u8> =
        dn.iter().map(|dn| (255.0 * srgb((f64::from(*dn) / 331.0).min(1.0))).round() as u8).collect();
    let folder = bench.path("pictures");
    std::fs::create_dir(&folder).expect("a folder");
    for n in 0..60 {
        let mut encoder = png::Encoder::new(
            std::fs::File::create(folder.join(format!("{n:05}.png"))).expect("a picture"),
            width,
            height,
        );
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().and_then(|mut writer| writer.write_image_data(&codes)).expect("its pixels");
    }
    bench.write("pictures/times_us.txt", &(0..60).map(|n| format!("{}\n", 500 * n)).collect::<String>());
    let place = |param: &str, path: &Path| format!("nodes.evunroll.params.{param}={path:?}");
    let (path, times) = (place("path", &folder), place("times", &folder.join("times_us.txt")));
    let done = still(&bench, "evunroll", &["--set", &path, "--set", &times]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let [psnr, lpips] = numbers(&bench, "evunroll");
    assert!(psnr > 35.0 && lpips < 0.05, "{psnr} dB, LPIPS {lpips}");
    // Pictures end at 29.5 ms, and instants at 35 ms.
    assert!(
        done.stderr.contains("frames have no picture within the tolerance and are left out"),
        "{}",
        done.stderr
    );
}
