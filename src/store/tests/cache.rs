//! The cache keeps its promises: to two processes, to a killed one, to a damaged disk, and to who asks why.
#![allow(clippy::unwrap_used)]

use photocurrent_core::{testing, *};
use photocurrent_store::{
    Cache, FileInput, GcOptions, Ingredients, Lookup, Params, PortInput, Record, StoreError, StoredOutput,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, SystemTime};

fn store(cache: &Cache, value: &Value) -> StoredOutput {
    let mut writer = cache.writer(&value.meta()).unwrap();
    match value.rows() {
        Some(rows) => rows.bands(16).into_iter().for_each(|rows| writer.append(&value.cut(rows)).unwrap()),
        None => writer.append(value).unwrap(),
    }
    writer.finish().unwrap()
}

fn ingredients() -> Ingredients {
    let readable = serde_json::json!({
        "cis_weight": 1.0, "window": { "start": "1 ms", "end": null }, "many": [1, 2], "big": u64::MAX,
    });
    Ingredients {
        kind: "solve/map".into(),
        revision: 3,
        params: Params {
            canonical: "{\"cis_weight\":f3ff0000000000000,}".into(),
            readable: readable.as_object().unwrap().clone(),
        },
        inputs: vec![PortInput {
            port: "events".into(),
            index: 0,
            data_type: DataType::Events,
            layout: 1,
            digest: Digest::of_bytes(b"events"),
            window: None,
            share: None,
        }],
        files: vec![FileInput {
            param: "weights".into(),
            path: "net.onnx".into(),
            digest: Digest::of_bytes(b"net"),
        }],
        seed: Some(u64::MAX),
    }
}

fn record(outputs: &[(&str, Option<StoredOutput>)], ingredients: Ingredients) -> Record {
    Record {
        key: ingredients.key(),
        tool_version: "0.1.0".into(),
        seconds: 1.5,
        created_unix_s: 1_700_000_000,
        notes: vec!["31 pixels did not converge".into()],
        ingredients,
        outputs: outputs.iter().map(|(port, output)| (port.to_string(), *output)).collect::<BTreeMap<_, _>>(),
        exports: Vec::new(),
    }
}

fn tracks() -> Value {
    Value::Tracks(testing::tracks(9, 40))
}

fn data_file(root: &Path, digest: &Digest) -> std::path::PathBuf {
    root.join("data").join(format!("{digest}.h5"))
}

fn flip_a_byte(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn what_is_committed_is_found_and_loaded() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    let stored = store(&cache, &tracks());
    assert_eq!(stored.digest, tracks().digest().unwrap());
    let record = record(&[("tracks", Some(stored)), ("residuals", None)], ingredients());
    assert_eq!(cache.record(&record.key), Lookup::Missing);
    cache.commit(&record).unwrap();
    let Lookup::Found(found) = cache.record(&record.key) else { panic!("the record was just committed") };
    // Nulls mean "not given" and are left out; integers beyond TOML's become text.
    assert_eq!(found.ingredients.params.readable["window"], serde_json::json!({ "start": "1 ms" }));
    assert_eq!(found.ingredients.params.readable["cis_weight"], serde_json::json!(1.0));
    assert_eq!(
        (&found.outputs, found.ingredients.seed, &found.notes),
        (&record.outputs, Some(u64::MAX), &record.notes)
    );
    assert_eq!(found.compute_key(), record.key);
    assert_eq!(cache.load(&stored.digest).unwrap().digest().unwrap(), stored.digest);
    assert_eq!(cache.records().unwrap().len(), 1);
    let text =
        std::fs::read_to_string(root.path().join("keys").join(format!("{}.toml", record.key))).unwrap();
    assert!(
        text.contains("cis_weight = 1.0")
            && text.contains("residuals = \"none\"")
            && text.contains("kind = \"solve/map\""),
        "{text}"
    );
}

#[test]
fn every_type_can_be_stored() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    for value in [
        Value::Events(testing::events(5, 30)),
        Value::Frames(testing::frames(5, 30, 3)),
        tracks(),
        Value::Table(Default::default()),
    ] {
        let stored = store(&cache, &value);
        assert_eq!((stored.digest, stored.data_type), (value.digest().unwrap(), value.data_type()));
        assert_eq!(cache.load(&stored.digest).unwrap().digest().unwrap(), stored.digest);
    }
    assert!(cache.verify().unwrap().damaged.is_empty());
}

#[test]
fn a_damaged_data_file_is_a_miss_and_a_rerun_replaces_it() {
    let root = tempfile::tempdir().unwrap();
    let stored = store(&Cache::open(root.path()).unwrap(), &tracks());
    let path = data_file(root.path(), &stored.digest);
    let sum = path.with_extension("sum");
    let record = record(&[("tracks", Some(stored))], ingredients());
    Cache::open(root.path()).unwrap().commit(&record).unwrap();
    type Harm<'a> = (&'a str, Box<dyn Fn() + 'a>, bool, &'a str);
    let harms: [Harm; 5] = [
        (
            "a flipped byte",
            Box::new(|| flip_a_byte(&path)),
            true,
            "its bytes are not those that were written",
        ),
        (
            "a cut",
            Box::new(|| std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(100).unwrap()),
            false,
            "it has 100 bytes instead of",
        ),
        ("no data", Box::new(|| std::fs::remove_file(&path).unwrap()), false, "its data cannot be read"),
        (
            "no checksum",
            Box::new(|| std::fs::remove_file(&sum).unwrap()),
            false,
            "its checksum cannot be read",
        ),
        (
            "a damaged checksum",
            Box::new(|| std::fs::write(&sum, "bytes = [").unwrap()),
            false,
            "its checksum is no checksum",
        ),
    ];
    for (name, harm, looks_whole, why) in harms {
        harm();
        let cache = Cache::open(root.path()).unwrap();
        match cache.record(&record.key) {
            // Looking a record up compares lengths; bytes are compared when they are loaded.
            Lookup::Found(_) => assert!(looks_whole, "{name}"),
            Lookup::Damaged { why: found } => assert!(
                !looks_whole && found.contains(why) && found.contains("output `tracks`"),
                "{name}: {found}"
            ),
            Lookup::Missing => panic!("{name}: the record is there"),
        }
        let error = cache.load(&stored.digest).unwrap_err();
        assert!(
            matches!(error, StoreError::Damaged { .. })
                && error.is_damage()
                && error.to_string().contains(why),
            "{name}: {error}"
        );
        assert_eq!(cache.verify().unwrap().damaged.is_empty(), name == "no data" && looks_whole, "{name}");
        assert_eq!(store(&cache, &tracks()), stored);
        assert_eq!(cache.load(&stored.digest).unwrap().digest().unwrap(), stored.digest, "{name}");
        assert!(matches!(cache.record(&record.key), Lookup::Found(_)), "{name}");
        assert_eq!(cache.verify().unwrap().damaged, Vec::<String>::new());
    }
}

#[test]
fn a_file_that_is_damaged_between_two_loads_of_one_instance_is_noticed() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    let stored = store(&cache, &tracks());
    cache.load(&stored.digest).unwrap();
    flip_a_byte(&data_file(root.path(), &stored.digest));
    assert!(cache.load(&stored.digest).unwrap_err().is_damage());
}

#[test]
fn a_damaged_record_is_a_miss_that_says_why() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    let record = record(&[], ingredients());
    cache.commit(&record).unwrap();
    let path = root.path().join("keys").join(format!("{}.toml", record.key));
    let text = std::fs::read_to_string(&path).unwrap();
    for (bad, why) in [
        (text.replace("revision = 3", "revision = 4"), "the ingredients are not those of the key"),
        (text[..text.len() / 2].into(), "not a record"),
        (String::new(), "not a record"),
    ] {
        std::fs::write(&path, bad).unwrap();
        let Lookup::Damaged { why: found } = cache.record(&record.key) else { panic!("{why}") };
        assert!(found.contains(why), "{found}");
    }
    let mut lying = record.clone();
    lying.key = Digest::of_bytes(b"another");
    assert!(cache.commit(&lying).unwrap_err().to_string().contains("not that of its ingredients"));
}

#[test]
fn two_runs_may_make_one_content_at_once() {
    let root = tempfile::tempdir().unwrap();
    let value = tracks();
    let digest = value.digest().unwrap();
    std::thread::scope(|scope| {
        for height in 1..9u32 {
            let (root, value) = (root.path(), &value);
            scope.spawn(move || {
                for _ in 0..5 {
                    let cache = Cache::open(root).unwrap();
                    // Bands of different height give files of different bytes and one content.
                    let mut writer = cache.writer(&value.meta()).unwrap();
                    value
                        .rows()
                        .unwrap()
                        .bands(height)
                        .into_iter()
                        .for_each(|rows| writer.append(&value.cut(rows)).unwrap());
                    assert_eq!(writer.finish().unwrap().digest, digest);
                    assert_eq!(cache.load(&digest).unwrap().digest().unwrap(), digest);
                    assert!(matches!(cache.record(&digest), Lookup::Missing));
                }
            });
        }
    });
    let cache = Cache::open(root.path()).unwrap();
    let report = cache.verify().unwrap();
    assert_eq!((report.good_contents, report.damaged.len()), (1, 0));
    assert_eq!(std::fs::read_dir(root.path().join("tmp")).unwrap().count(), 1, "only our own lock is left");
}

#[test]
fn what_a_killed_run_left_is_removed_and_what_a_living_one_writes_is_not() {
    let root = tempfile::tempdir().unwrap();
    let alive = Cache::open(root.path()).unwrap();
    let writer = alive.writer(&tracks().meta()).unwrap();
    let tmp = root.path().join("tmp");
    let names = || {
        std::fs::read_dir(&tmp)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect::<Vec<_>>()
    };
    let before = names();
    assert_eq!(before.len(), 2);
    // A killed process leaves its lock file without a lock, and a file; or, after a half-done clean-up, a
    // file alone.
    for name in ["p1-00ff.lock", "p1-00ff-0.h5", "p1-00ff-12.part", "p2-0a-3.h5"] {
        std::fs::write(tmp.join(name), "half").unwrap();
    }
    let other = Cache::open(root.path()).unwrap();
    let after = names();
    assert!(before.iter().all(|name| after.contains(name)));
    assert_eq!(after.len(), 3, "{after:?}");
    drop(writer);
    drop((alive, other));
    assert!(names().is_empty());
}

#[test]
fn gc_keeps_what_records_name_and_refuses_while_a_run_lives() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    let (a, b) = (store(&cache, &tracks()), store(&cache, &Value::Events(testing::events(5, 30))));
    let orphan = store(&cache, &Value::Frames(testing::frames(5, 30, 3)));
    let second = Ingredients { revision: 4, ..ingredients() };
    let third = Ingredients { revision: 5, ..ingredients() };
    for (ingredients, outputs) in
        [(ingredients(), vec![a]), (second.clone(), vec![a, b]), (third.clone(), vec![b])]
    {
        let outputs: Vec<_> =
            outputs.into_iter().map(|output| (output.data_type.name(), Some(output))).collect();
        cache.commit(&record(&outputs, ingredients)).unwrap();
    }
    assert_eq!(cache.du().unwrap().unreferenced_bytes, orphan.bytes);
    assert_eq!(cache.verify().unwrap().orphans, [data_file(root.path(), &orphan.digest)]);
    let options = GcOptions::default();
    let error = Cache::gc(root.path(), &options).unwrap_err();
    assert!(
        matches!(error, StoreError::Busy { .. }) && error.to_string().contains("in use by another run"),
        "{error}"
    );
    drop(cache);

    let dry = Cache::gc(root.path(), &GcOptions { dry_run: true, ..GcOptions::default() }).unwrap();
    assert_eq!(
        (dry.records, dry.contents, dry.freed_bytes, dry.kept_bytes),
        (0, 1, orphan.bytes, a.bytes + b.bytes)
    );
    assert!(data_file(root.path(), &orphan.digest).exists());
    assert_eq!(Cache::gc(root.path(), &options).unwrap(), dry);
    assert!(!data_file(root.path(), &orphan.digest).exists());

    // The third was used last; the first is pinned; so the second goes, and nothing else, since both contents
    // are still named.
    let age = |key: &Digest, days: u64| {
        let file = std::fs::OpenOptions::new()
            .write(true)
            .open(root.path().join("keys").join(format!("{key}.toml")))
            .unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(days * 86_400)).unwrap();
    };
    age(&ingredients().key(), 30);
    age(&second.key(), 20);
    let report = Cache::gc(
        root.path(),
        &GcOptions {
            older_than: Some(Duration::from_secs(10 * 86_400)),
            keep: [ingredients().key()].into(),
            ..options.clone()
        },
    );
    assert_eq!((report.as_ref().unwrap().records, report.unwrap().contents), (1, 0));
    // A limit of one content: the least recently used goes first, which is now the unpinned first.
    let report = Cache::gc(root.path(), &GcOptions { max_bytes: Some(b.bytes), ..options }).unwrap();
    assert_eq!((report.records, report.contents, report.kept_bytes), (1, 1, b.bytes));
    let cache = Cache::open(root.path()).unwrap();
    assert!(matches!(cache.record(&third.key()), Lookup::Found(_)));
    assert_eq!(cache.ls().unwrap().len(), 1);
    assert_eq!(cache.verify().unwrap().damaged, Vec::<String>::new());
}

#[test]
fn a_changed_file_gets_a_new_digest_even_when_size_and_mtime_stay() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(&root.path().join("cache")).unwrap();
    let path = root.path().join("events.h5");
    let old = SystemTime::now() - Duration::from_secs(1000);
    let write = |text: &str| {
        std::fs::write(&path, text).unwrap();
        std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_modified(old).unwrap();
    };
    write("one");
    assert_eq!(cache.file_digest(&path).unwrap(), Digest::of_bytes(b"one"));
    // Too fresh to be remembered: its change time is now.
    assert_eq!(std::fs::read_dir(root.path().join("cache/files")).unwrap().count(), 0);
    std::thread::sleep(Duration::from_millis(2100));
    assert_eq!(cache.file_digest(&path).unwrap(), Digest::of_bytes(b"one"));
    let remembered: Vec<_> = std::fs::read_dir(root.path().join("cache/files")).unwrap().collect();
    assert_eq!(remembered.len(), 1);
    assert_eq!(cache.file_digest(&path).unwrap(), Digest::of_bytes(b"one"));
    write("two");
    assert_eq!(cache.file_digest(&path).unwrap(), Digest::of_bytes(b"two"));
    assert!(cache.file_digest(&root.path().join("nowhere")).unwrap_err().to_string().contains("nowhere"));
}

#[test]
fn history_is_per_manifest_variant_and_node() {
    let root = tempfile::tempdir().unwrap();
    let cache = Cache::open(root.path()).unwrap();
    let key = Digest::of_bytes(b"key");
    assert_eq!(cache.recall("fusion.toml", "base", "solve"), None);
    cache.remember("fusion.toml", "base", "solve", &key).unwrap();
    assert_eq!(cache.recall("fusion.toml", "base", "solve"), Some(key));
    assert_eq!(cache.recall("fusion.toml", "bases", "olve"), None);
    let other = Digest::of_bytes(b"other");
    cache.remember("fusion.toml", "base", "solve", &other).unwrap();
    assert_eq!(Cache::open(root.path()).unwrap().recall("fusion.toml", "base", "solve"), Some(other));
}

#[test]
fn gc_forgets_outside_files_that_are_gone_and_keeps_the_others() {
    let root = tempfile::tempdir().unwrap();
    let outside = tempfile::tempdir().unwrap();
    let [kept, gone] = ["kept", "gone"].map(|name| outside.path().join(name));
    let memories = || std::fs::read_dir(root.path().join("files")).unwrap().count();
    {
        let cache = Cache::open(root.path()).unwrap();
        [&kept, &gone].iter().for_each(|path| std::fs::write(path, "x").unwrap());
        // A fresh file is not remembered.
        std::thread::sleep(Duration::from_millis(2100));
        [&kept, &gone].iter().for_each(|path| assert!(cache.file_digest(path).is_ok()));
        cache.remember("m", "v", "n", &ingredients().key()).unwrap();
    }
    std::fs::remove_file(&gone).unwrap();
    Cache::gc(root.path(), &GcOptions { dry_run: true, ..GcOptions::default() }).unwrap();
    assert_eq!(memories(), 2);
    Cache::gc(root.path(), &GcOptions::default()).unwrap();
    assert_eq!(memories(), 1);
    assert_eq!(std::fs::read_dir(root.path().join("history")).unwrap().count(), 1);
}

#[test]
fn every_ingredient_enters_the_key_and_its_change_is_named() {
    let base = ingredients();
    let mut readable = base.params.readable.clone();
    readable["cis_weight"] = serde_json::json!(2.0);
    readable["window"] = serde_json::json!({ "start": "2 ms" });
    let other = Digest::of_bytes(b"another");
    let input = base.inputs[0].clone();
    let cases: Vec<(Ingredients, Vec<&str>)> = vec![
        (Ingredients { kind: "solve/global".into(), ..base.clone() }, vec!["kind solve/map -> solve/global"]),
        (Ingredients { revision: 4, ..base.clone() }, vec!["revision 3 -> 4"]),
        (
            Ingredients { params: Params { canonical: "other".into(), readable }, ..base.clone() },
            vec!["params.cis_weight 1.0 -> 2.0", "params.window.start \"1 ms\" -> \"2 ms\""],
        ),
        (
            Ingredients {
                params: Params { canonical: "a third".into(), ..base.params.clone() },
                ..base.clone()
            },
            vec!["params changed"],
        ),
        (
            Ingredients { inputs: vec![PortInput { digest: other, ..input.clone() }], ..base.clone() },
            vec!["input events changed content"],
        ),
        (
            Ingredients { inputs: vec![PortInput { layout: 2, ..input.clone() }], ..base.clone() },
            vec!["input events layout 1 -> 2"],
        ),
        (
            Ingredients { inputs: vec![PortInput { window: Some((0, 5)), ..input.clone() }], ..base.clone() },
            vec!["input events is cut from another block of time"],
        ),
        (
            Ingredients { inputs: vec![PortInput { share: Some((0, 5)), ..input.clone() }], ..base.clone() },
            vec!["input events is cut from another block of time"],
        ),
        (
            Ingredients { inputs: vec![input.clone(), PortInput { index: 1, ..input }], ..base.clone() },
            vec!["input events[1] added"],
        ),
        (Ingredients { inputs: vec![], ..base.clone() }, vec!["input events removed"]),
        (
            Ingredients { files: vec![FileInput { digest: other, ..base.files[0].clone() }], ..base.clone() },
            vec!["file net.onnx changed content"],
        ),
        (Ingredients { files: vec![], ..base.clone() }, vec!["file net.onnx removed (params.weights)"]),
        (Ingredients { seed: None, ..base.clone() }, vec!["seed 18446744073709551615 -> none"]),
    ];
    for (changed, lines) in &cases {
        assert_ne!(changed.key(), base.key(), "{lines:?}");
        assert_eq!(base.differences(changed), *lines);
    }
    for (i, (a, _)) in cases.iter().enumerate() {
        assert!(cases[..i].iter().all(|(b, _)| a.key() != b.key()));
    }
    // What is for people only changes nothing.
    let mut moved = base.clone();
    moved.files[0].path = "elsewhere/net.onnx".into();
    moved.params.readable.clear();
    assert_eq!(moved.key(), base.key());
    assert!(base.differences(&moved).is_empty());
}

/// Stores and commits one thing after another, for [`a_run_killed_at_any_moment_leaves_a_cache_that_works`].
#[test]
#[ignore = "another test runs it in a process of its own, and kills it"]
fn stores_until_it_is_killed() {
    let Ok(root) = std::env::var("PHOTOCURRENT_TEST_CACHE") else { return };
    let cache = Cache::open(Path::new(&root)).unwrap();
    for i in 0..100_000 {
        let value = Value::Frames(testing::captured(
            Extent { width: 40, height: 30 },
            vec![Exposure::new(0, 5)],
            0,
            |_, x, y| (x * y + i % 7) as f32,
        ));
        let stored = store(&cache, &value);
        let ingredients = Ingredients { revision: i, ..ingredients() };
        cache.commit(&record(&[("frames", Some(stored))], ingredients)).unwrap();
        cache.remember("m", "v", "n", &Ingredients { revision: i, ..self::ingredients() }.key()).unwrap();
        // So that the same contents are placed again and again.
        std::fs::remove_file(data_file(Path::new(&root), &stored.digest)).unwrap();
        store(&cache, &value);
    }
}

#[test]
fn a_run_killed_at_any_moment_leaves_a_cache_that_works() {
    let root = tempfile::tempdir().unwrap();
    for round in 0..6u64 {
        let mut children: Vec<std::process::Child> = (0..2)
            .map(|_| {
                let mut command = std::process::Command::new(std::env::current_exe().unwrap());
                command
                    .args(["--ignored", "--exact", "stores_until_it_is_killed"])
                    .env("PHOTOCURRENT_TEST_CACHE", root.path());
                command
                    .stdout(std::process::Stdio::null())
                    .stderr(std::process::Stdio::null())
                    .spawn()
                    .unwrap()
            })
            .collect();
        std::thread::sleep(Duration::from_millis(100 + 37 * round));
        children.iter_mut().for_each(|child| child.kill().unwrap());
        for child in &mut children {
            child.wait().unwrap();
        }
        let cache = Cache::open(root.path()).unwrap();
        assert_eq!(
            std::fs::read_dir(root.path().join("tmp")).unwrap().count(),
            1,
            "only our own lock is left"
        );
        let report = cache.verify().unwrap();
        // The children remove data behind the cache's back, so data may be missing; what is there is whole.
        assert!(
            report.damaged.iter().all(|why| why.contains("cannot be read (No such file")),
            "{:?}",
            report.damaged
        );
        for record in cache.records().unwrap() {
            assert_eq!(record.compute_key(), record.key);
        }
        drop(cache);
        Cache::gc(root.path(), &GcOptions::default()).unwrap();
        let cache = Cache::open(root.path()).unwrap();
        assert!(cache.verify().unwrap().orphans.is_empty());
    }
    assert!(!Cache::open(root.path()).unwrap().records().unwrap().is_empty(), "the children did work");
}
