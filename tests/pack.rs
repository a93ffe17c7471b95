//! A finished run as one file: packed here, unpacked on another machine, which is a folder with a cache of
//! its own and none of the sender's files.

use crate::support::{Bench, files, root, small_pipeline};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A project as people have it: a manifest that extends another one, which names a file outside of its
/// folder.
fn sender() -> Bench {
    let bench = Bench::new();
    std::fs::create_dir_all(bench.path("data")).expect("a folder");
    std::fs::copy(root().join("data/sensors/hybrid.toml"), bench.path("data/sensor.toml")).expect("a copy");
    let sensor = format!("{:?}", root().join("data/sensors/hybrid.toml"));
    let base = small_pipeline();
    assert!(base.contains(&sensor));
    bench.write("pipelines/base.toml", &base.replace(&sensor, "\"../data/sensor.toml\""));
    bench.write(
        "pipelines/m.toml",
        "format = 1\nextends = \"base.toml\"\n[pipeline]\nabout = \"passed on\"\n[nodes.psnr.expect]\n\
         psnr_db = { at_least = 1.0 }\n",
    );
    bench
}

/// The sender with a pack of its finished run.
fn packed(arguments: &[&str]) -> Bench {
    let bench = sender();
    let run = [&["run", "pipelines/m.toml", "--quiet"], arguments].concat();
    assert_eq!(bench.run(&run).code, 0);
    let pack = [&["cache", "pack", "pipelines/m.toml", "-o", "q.zip"], arguments].concat();
    let done = bench.run(&pack);
    assert_eq!((done.code, done.stdout.as_str()), (0, "q.zip\n"), "{}", done.stderr);
    bench
}

/// Another machine, with the pack only.
fn receiver(sender: &Bench) -> Bench {
    let bench = Bench::new();
    std::fs::copy(sender.path("q.zip"), bench.path("q.zip")).expect("a copy");
    bench
}

fn without(folder: &Bench, name: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = files(&folder.path(""));
    found.retain(|path, _| path != Path::new(name));
    found
}

#[test]
fn the_receiver_runs_the_manifest_and_executes_nothing() {
    let sender = packed(&["--set", "nodes.solve.params.cis_weight=2"]);
    let receiver = receiver(&sender);
    let done = receiver.run(&["cache", "unpack", "q.zip"]);
    assert_eq!((done.code, done.stdout.as_str()), (0, "q/pipelines/m.toml\n"), "{}", done.stderr);
    let command = "photocurrent run q/pipelines/m.toml --set 'nodes.solve.params.cis_weight=2'";
    assert!(done.stderr.contains(command), "{}", done.stderr);

    let set = ["--set", "nodes.solve.params.cis_weight=2"];
    let run = receiver.run(&[&["run", "q/pipelines/m.toml"], &set[..]].concat());
    assert!(
        run.code == 0 && run.stderr.contains("0 nodes executed: all 10 results were in the cache"),
        "{}",
        run.stderr
    );
    let exported = |bench: &Bench, name: &str| files(&bench.path(&format!("out/m/{name}")));
    for node in ["frames", "table"] {
        assert!(!exported(&sender, node).is_empty());
        assert_eq!(exported(&receiver, node), exported(&sender, node), "{node}");
    }
    assert_eq!(receiver.run(&["cache", "verify"]).code, 0);
    // The same pack again: everything is there, and nothing is touched.
    let before = without(&receiver, "");
    let again = receiver.run(&["cache", "unpack", "q.zip"]);
    assert!(
        again.code == 0 && again.stderr.contains("0 of 10 records and 0 of"),
        "{}\n{}",
        again.stdout,
        again.stderr
    );
    assert_eq!(without(&receiver, ""), before);
}

#[test]
fn a_folder_of_a_run_says_itself_what_was_run() {
    let sender = sender();
    let run =
        ["run", "pipelines/m.toml", "--quiet", "--set", "pipeline.seed=8", "--to", "psnr", "--cache", "c"];
    assert_eq!(sender.run(&[&run[..], &["--out", "o"]].concat()).code, 0);
    let done = sender.run(&["cache", "pack", "o", "-o", "q.zip"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let receiver = receiver(&sender);
    let done = receiver.run(&["cache", "unpack", "q.zip", "--to", "there", "--cache", "c", "--json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let said: serde_json::Value = serde_json::from_str(&done.stdout).expect("JSON");
    let command = said["command"].as_str().expect("a command").replace('\'', "");
    let words: Vec<&str> = command.split(' ').skip(1).collect();
    assert!(words.starts_with(&["run", "there/pipelines/m.toml", "--set", "pipeline.seed=8"]), "{command}");
    let run = receiver.run(&words);
    assert!(run.code == 0 && run.stderr.contains("0 nodes executed"), "{}", run.stderr);
}

#[test]
fn a_run_that_is_not_complete_is_not_packed() {
    let bench = sender();
    let pack = |arguments: &[&str]| {
        bench.run(&[&["cache", "pack", "pipelines/m.toml", "-o", "q.zip"], arguments].concat())
    };
    let done = pack(&[]);
    assert!(done.code == 2 && done.stderr.contains("there is no cache at"), "{}", done.stderr);
    assert_eq!(bench.run(&["run", "pipelines/m.toml", "--quiet", "--to", "psnr"]).code, 0);
    let done = pack(&[]);
    for part in ["pipelines/m.toml: ", "nodes would run: ", "hint: `photocurrent run` first"] {
        assert!(done.code == 2 && done.stderr.contains(part), "{}", done.stderr);
    }
    assert!(!bench.path("q.zip").exists());
    assert_eq!(pack(&["--to", "psnr"]).code, 0);
    let done = pack(&["--to", "psnr"]);
    assert!(done.code == 2 && done.stderr.contains("q.zip exists"), "{}", done.stderr);
    assert_eq!(pack(&["--to", "psnr", "--force"]).code, 0);
}

#[test]
fn a_file_that_cannot_be_placed_is_named() {
    let bench = Bench::new();
    bench.write("m.toml", &small_pipeline());
    assert_eq!(bench.run(&["run", "m.toml", "--quiet"]).code, 0);
    let done = bench.run(&["cache", "pack", "m.toml", "-o", "q.zip"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let receiver = receiver(&bench);
    let arrived = receiver.run(&["cache", "unpack", "q.zip"]);
    let sensor = root().join("data/sensors/hybrid.toml");
    let part = format!("nodes.sensor.params.path names {}, which is not in the pack", sensor.display());
    for done in [&done, &arrived] {
        assert!(done.code == 0 && done.stderr.contains(&part), "{}", done.stderr);
    }
    // Here it is where the manifest says.
    let run = receiver.run(&["run", "q/m.toml"]);
    assert!(run.stderr.contains("0 nodes executed"), "{}", run.stderr);
}

#[test]
fn files_of_somebody_elses_stay_and_nothing_is_unpacked_over_them() {
    let receiver = receiver(&packed(&[]));
    for (path, option) in [("q/pipelines/base.toml", "--to"), ("out/m/table/table.csv", "--out")] {
        receiver.write(path, "mine\n");
        let before = without(&receiver, "");
        let done = receiver.run(&["cache", "unpack", "q.zip"]);
        for part in [path, "there already, with other content; nothing was unpacked", option] {
            assert!(done.code == 2 && done.stderr.contains(part), "{}", done.stderr);
        }
        assert_eq!(without(&receiver, ""), before, "nothing is written");
        std::fs::remove_file(receiver.path(path)).expect("a file");
    }
    assert_eq!(receiver.run(&["cache", "unpack", "q.zip"]).code, 0);
}

/// The members of an archive whose members are stored, with the places of their bytes.
fn members(bytes: &[u8]) -> Vec<(String, std::ops::Range<usize>)> {
    let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]) as usize;
    let double = |at: usize| word(at) | word(at + 2) << 16;
    let mut found = Vec::new();
    let mut at = 0;
    while bytes[at..].starts_with(b"PK\x03\x04") {
        let (length, name, extra) = (double(at + 18), word(at + 26), word(at + 28));
        let start = at + 30 + name + extra;
        let name = String::from_utf8(bytes[at + 30..at + 30 + name].to_vec()).expect("a name");
        found.push((name, start..start + length));
        at = start + length;
    }
    found
}

/// CRC-32 of the zip format, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    })
}

/// The archive with one byte of a member changed and its CRC made to fit: only digests can see it.
fn forged(bytes: &[u8], name: &str, at: usize) -> Vec<u8> {
    let mut forged = bytes.to_vec();
    let range = members(bytes).into_iter().find(|(member, _)| member == name).expect("the member").1;
    let before = crc32(&bytes[range.clone()]).to_le_bytes();
    forged[range.start + at] ^= 1;
    let after = crc32(&forged[range]).to_le_bytes();
    let places: Vec<usize> = (0..forged.len() - 3).filter(|&at| forged[at..at + 4] == before).collect();
    assert_eq!(places.len(), 2, "in the member's head and in the directory");
    places.into_iter().for_each(|at| forged[at..at + 4].copy_from_slice(&after));
    forged
}

#[test]
fn a_damaged_pack_places_nothing() {
    let sender = packed(&[]);
    let whole = std::fs::read(sender.path("q.zip")).expect("the pack");
    let all = members(&whole);
    let of = |start: &str, end: &str| {
        let found = all.iter().find(|(name, _)| name.starts_with(start) && name.ends_with(end));
        found.map(|(name, range)| (name.clone(), range.len())).expect("a member")
    };
    assert_eq!(all[0].0, "pack.toml");
    let contents = all.iter().filter(|(name, _)| name.starts_with("cache/data/"));
    let (content, range) = contents.max_by_key(|(_, range)| range.len()).expect("a content");
    let (content, length) = (content.clone(), range.len());
    let (record, _) = of("cache/keys/", ".toml");
    let (file, _) = of("project/data/", "sensor.toml");
    let (export, _) = of("out/table/", ".csv");
    let text =
        std::str::from_utf8(&whole[all.iter().find(|(name, _)| *name == record).expect("it").1.clone()])
            .expect("a record");
    let canonical = text.find("params_canonical = ").expect("an ingredient") + 21;
    let damages = [
        ("a content", forged(&whole, &content, length / 2), content.as_str()),
        ("a record", forged(&whole, &record, canonical), record.as_str()),
        ("a file that a node reads", forged(&whole, &file, 3), file.as_str()),
        ("a file for the user", forged(&whole, &export, 3), export.as_str()),
    ];
    for (what, bytes, name) in damages {
        let receiver = Bench::new();
        std::fs::write(receiver.path("q.zip"), bytes).expect("a file");
        let done = receiver.run(&["cache", "unpack", "q.zip"]);
        assert_eq!(done.code, 3, "{what}: {}\n{}", done.stdout, done.stderr);
        assert!(
            done.stderr.contains(&format!("q.zip: {name}: ")) && done.stderr.contains("copy it again"),
            "{what}: {}",
            done.stderr
        );
        let left: Vec<PathBuf> = without(&receiver, "q.zip").into_keys().collect();
        let is_entry = |path: &PathBuf| !path.ends_with("lock") && !path.ends_with("commit.lock");
        assert_eq!(left.into_iter().filter(is_entry).collect::<Vec<_>>(), Vec::<PathBuf>::new(), "{what}");
    }
    let receiver = Bench::new();
    std::fs::write(receiver.path("q.zip"), &whole[..whole.len() / 2]).expect("a file");
    receiver.write("m.toml", &small_pipeline());
    for (name, part) in [("q.zip", "no zip archive that is whole"), ("m.toml", "found a manifest")] {
        let done = receiver.run(&["cache", "unpack", name]);
        assert!(done.code == 2 && done.stderr.contains(part), "{}", done.stderr);
    }
}

#[test]
fn results_of_a_smaller_run_are_completed() {
    let receiver = receiver(&packed(&[]));
    // The same manifest, from its own files, of which only a part was run: equal entries stay as they are.
    assert_eq!(receiver.run(&["cache", "unpack", "q.zip", "--cache", "other", "--out", "other_out"]).code, 0);
    assert_eq!(receiver.run(&["run", "q/pipelines/m.toml", "--quiet", "--to", "edi"]).code, 0);
    let before = files(&receiver.path(".photocurrent/data"));
    assert!(before.len() >= 4, "events, frames, light");
    let done = receiver.run(&["cache", "unpack", "q.zip"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let after = files(&receiver.path(".photocurrent/data"));
    assert!(before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)), "untouched");
    let run = receiver.run(&["run", "q/pipelines/m.toml"]);
    assert!(run.stderr.contains("0 nodes executed: all 10"), "{}", run.stderr);
}
