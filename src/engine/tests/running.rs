//! What a run does, what it does not do again, and what it leaves behind when something goes wrong.

use super::bench::{Bench, assert_well, digests, ended};
use super::folder::snapshot;
use super::troubles;
use crate::{End, Keep, Observer, Options, State, TaskId, Unobserved, explain, run, status};
use photocurrent_core::Value;
use photocurrent_store::Cache;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

const CHAIN: &str = r#"
format = 1
[pipeline]
seed = 7
[nodes.source]
kind = "read/source"
[nodes.solve]
kind = "solve/add"
in.plane = "source"
params.amount = 2.0
[nodes.smooth]
kind = "refine/smooth"
in.plane = "solve"
[nodes.sum]
kind = "score/sum"
in.planes = ["smooth", "solve"]
"#;

impl Bench {
    /// Nodes and their reasons, as `plan` would print them.
    fn status(&self, text: &str, sets: &[&str]) -> Vec<String> {
        let plan = self.plan(text, sets);
        let line = |status: crate::TaskStatus| {
            let label = &plan.tasks[status.task].label;
            match status.state {
                State::Hit => format!("{label}: hit"),
                State::Miss { reasons } => format!("{label}: {}", reasons.join("; ")),
                State::Waits { on, reasons } => {
                    format!("{label}: waits for {} {}", on.join(", "), reasons.join("; "))
                        .trim_end()
                        .to_string()
                }
            }
        };
        status(&plan, &self.cache, &self.folder.path("out")).into_iter().map(line).collect()
    }
}

#[test]
fn a_second_run_executes_nothing() {
    let bench = Bench::new();
    let first = bench.run(CHAIN, &[]);
    assert_well(&first);
    assert_eq!(ended(&first, End::Executed), ["source", "solve", "smooth", "sum"]);
    let second = bench.run(CHAIN, &[]);
    assert_eq!(ended(&second, End::Reused), ["source", "solve", "smooth", "sum"]);
    assert_eq!(digests(&first), digests(&second));
    assert_eq!(second.node("base", "solve").unwrap().notes, ["12 rows were added to"]);
    assert_eq!(second.exit_code(), 0);
}

#[test]
fn values_are_what_the_nodes_say() {
    let bench = Bench::new();
    let outcome = bench.run(CHAIN, &["nodes.source.params = { width = 1, height = 2, offset = 1.0 }"]);
    // Rows 1.0 and 1.5, plus 2: 3.0 and 3.5; their mean twice: 3.25.
    let Some(Value::Table(table)) = outcome.value(&bench.cache, "base", "sum", "scores").unwrap() else {
        panic!("a table is stored")
    };
    let sums: Vec<f64> = table.as_scores().unwrap().iter().map(|score| score.value).collect();
    assert_eq!(sums, [6.5, 6.5, 13.0]);
    let (single, pooled) = outcome.metrics(&bench.cache).unwrap();
    assert_eq!(single.len(), 2);
    assert_eq!(
        pooled[0].to_string(),
        r#"{"variant":"base","node":"sum","metric":"sum","frame":-1,"t_ns":0,"value":13.0,"unit":"1","card":"sum of all pixels","min":6.5,"p05":6.5,"p95":6.5,"max":6.5}"#
    );
}

#[test]
fn a_changed_parameter_reruns_the_node_and_what_follows() {
    let bench = Bench::new();
    bench.run(CHAIN, &[]);
    let outcome = bench.run(CHAIN, &["nodes.solve.params.amount=3"]);
    assert_eq!(ended(&outcome, End::Executed), ["solve", "smooth", "sum"]);
}

#[test]
fn a_comment_and_the_order_of_keys_rerun_nothing() {
    let bench = Bench::new();
    bench.run(CHAIN, &[]);
    let outcome = bench.run(
        &format!(
            "# A comment.\n{}",
            CHAIN.replace("params.amount = 2.0", "params = { direction = \"up\", amount = 2 }")
        ),
        &[],
    );
    assert_eq!(ended(&outcome, End::Executed), [""; 0]);
}

#[test]
fn an_equal_result_upstream_stops_the_rerun() {
    let bench = Bench::new();
    let text = format!(
        "{CHAIN}[nodes.sign]\nkind = \"refine/sign\"\nin.plane = \
                        \"solve\"\n[nodes.after]\nkind = \"solve/scale\"\nin.plane = \"sign\"\n"
    );
    bench.run(&text, &[]);
    let outcome = bench.run(&text, &["nodes.solve.params.amount=3"]);
    assert_eq!(ended(&outcome, End::Reused), ["source", "after"]);
}

#[test]
fn variants_share_equal_branches_and_run_them_once() {
    let bench = Bench::new();
    let text = format!("{CHAIN}[ablation.sweep]\n\"nodes.solve.params.amount\" = [1, 2, 3]\n");
    let outcome = bench.run(&text, &[]);
    assert_well(&outcome);
    assert_eq!(outcome.count(End::Executed), 1 + 3 * 3);
    assert_eq!(
        outcome.node("amount=1", "source").unwrap().key,
        outcome.node("amount=3", "source").unwrap().key
    );
    // The base pipeline has the amount 2: its results are there already.
    assert_eq!(ended(&bench.run(CHAIN, &[]), End::Executed), [""; 0]);
}

#[test]
fn bands_of_any_height_and_any_number_of_threads_give_the_same() {
    let text = format!(
        "{CHAIN}[nodes.noise]\nkind = \"simulate/noise\"\nin.plane = \
                 \"smooth\"\n[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"noise\"\n"
    );
    let mut seen = None;
    for threads in [1, 2] {
        for height in [None, Some(1), Some(5), Some(11), Some(12), Some(100)] {
            let bench = Bench::new();
            let options = Options { threads, band_rows: height, ..bench.options() };
            let outcome = bench.run_with(&bench.plan(&text, &[]), &options);
            assert_well(&outcome);
            assert_eq!(outcome.node("base", "solve").unwrap().notes, ["12 rows were added to"]);
            let found = digests(&outcome);
            assert_eq!(seen.get_or_insert(found.clone()), &found, "{threads} threads, bands of {height:?}");
        }
    }
}

#[test]
fn a_node_is_cut_into_bands_or_not_as_its_inputs_say() {
    let text = "format = 1\n[nodes.source]\nkind = \"read/source\"\n[nodes.couple]\nkind = \
                \"refine/couple\"\nin.plane = \"source\"\n";
    #[derive(Default)]
    struct Bands(Mutex<usize>);
    impl Observer for Bands {
        fn progress_advance(&self, _: TaskId, _: u64) {
            *self.0.lock().unwrap() += 1;
        }
    }
    // Row y of column x is 1 + x / 4 + y / 2: eight columns of three rows sum up to 24 + 21 + 12.
    for (width, bands, expected) in [(8, 0, [57.0; 3]), (4, 3, [1.0, 1.5, 2.0])] {
        let bench = Bench::new();
        let plan = bench.plan(text, &[&format!("nodes.source.params = {{ width = {width}, height = 3 }}")]);
        let (seen, options) = (Bands::default(), Options { band_rows: Some(1), ..bench.options() });
        let outcome = run(&plan, &bench.cache, &options, &seen, &AtomicBool::new(false));
        assert_well(&outcome);
        assert_eq!(*seen.0.lock().unwrap(), bands);
        let Some(Value::Map(map)) = outcome.value(&bench.cache, "base", "couple", "plane").unwrap() else {
            panic!("a map is stored")
        };
        let band = map.read(map.rows()).unwrap();
        assert_eq!([0, 1, 2].map(|y| band.row(0, y)[0]), expected);
    }
}

#[test]
fn a_small_budget_cuts_into_bands_and_gives_the_same() {
    let (roomy, tight) = (Bench::new(), Bench::new());
    let large = ["nodes.source.params = { width = 64, height = 64 }"];
    let expected = digests(&roomy.run(CHAIN, &large));
    #[derive(Default)]
    struct Rows(Mutex<Vec<u64>>);
    impl Observer for Rows {
        fn progress_advance(&self, _: TaskId, items: u64) {
            self.0.lock().unwrap().push(items);
        }
    }
    let (rows, options) = (Rows::default(), Options { memory: 40_000, ..tight.options() });
    let outcome = run(&tight.plan(CHAIN, &large), &tight.cache, &options, &rows, &AtomicBool::new(false));
    assert_well(&outcome);
    assert_eq!(digests(&outcome), expected);
    // 15 000 bytes are a task's share and a row of `solve` takes 256 of inputs and three times as many of
    // outputs: 14 such rows fit. The first band is an eighth of that, because nothing is known yet of what it
    // gives; the ones after it are at most twice as high as the one before.
    let seen = rows.0.lock().unwrap();
    assert_eq!(seen.iter().max().map(|rows| *rows <= 14), Some(true), "{seen:?}");
    assert!(seen.windows(4).any(|heights| heights == [1, 2, 4, 8]), "{seen:?}");
}

#[test]
fn the_memory_budget_is_kept() {
    let bench = Bench::new();
    let heavy: String = (0..6)
        .map(|i| {
            format!("[nodes.h{i}]\nkind = \"solve/heavy\"\nin.plane = \"source\"\nparams.amount = {i}\n")
        })
        .collect();
    let text = format!(
        "format = 1\n[nodes.source]\nkind = \"read/source\"\nparams = \
                        {{ width = 100, height = 100 }}\n{heavy}"
    );
    // One heavy node counts 3 x 40 000 bytes: two fit next to each other and to what is kept, three do not.
    let options = Options { threads: 6, memory: 360_000, ..bench.options() };
    let outcome = bench.run_with(&bench.plan(&text, &[]), &options);
    assert_well(&outcome);
    // Whether two really meet is up to a busy machine; that a third never joins them is up to the scheduler.
    let most = troubles::HEAVY_MOST.load(Ordering::SeqCst);
    assert!((120_000..=240_000).contains(&most), "{most}");
    // One alone is larger than this budget, and runs alone.
    troubles::HEAVY_MOST.store(0, Ordering::SeqCst);
    let options = Options { force: (0..6).map(|i| format!("h{i}")).collect(), memory: 1000, ..options };
    assert_well(&bench.run_with(&bench.plan(&text, &[]), &options));
    assert_eq!(troubles::HEAVY_MOST.load(Ordering::SeqCst), 120_000);
}

fn with_mischief(mischief: &str) -> String {
    let trouble = format!(
        "[nodes.bad]\nkind = \"solve/trouble\"\nin.plane = \"source\"\nparams.mischief = \"{mischief}\"\n"
    );
    format!(
        "{CHAIN}{trouble}[nodes.after]\nkind = \"refine/smooth\"\nin.plane = \"bad\"\n[nodes.last]\nkind = \
         \"score/sum\"\nin.planes = [\"after\", \"smooth\"]\n"
    )
}

#[test]
fn a_failed_node_skips_only_what_hangs_on_it() {
    let bench = Bench::new();
    let outcome = bench.run(&with_mischief("fails"), &[]);
    assert_eq!(ended(&outcome, End::Failed), ["bad"]);
    assert_eq!(ended(&outcome, End::Skipped), ["after", "last"]);
    assert_eq!(ended(&outcome, End::Executed), ["source", "solve", "smooth", "sum"]);
    assert_eq!(outcome.node("base", "last").unwrap().because, ["bad"]);
    assert_eq!(
        outcome.node("base", "bad").unwrap().error.as_ref().unwrap().to_string(),
        "nothing works today\n  hint: try tomorrow"
    );
    assert_eq!(outcome.exit_code(), 1);
    assert_eq!(bench.run(&with_mischief("bad_input"), &[]).exit_code(), 3);
    let ablation = "[ablation.axes.x]\nbad = { }\ngood = { nodes.bad.params.mischief = \"none\" }\n";
    let outcome = bench.run(&format!("{}{ablation}", with_mischief("fails")), &[]);
    assert_eq!(outcome.exit_code(), 4);
    assert_eq!(
        outcome.variants.iter().map(|variant| outcome.variant_is_whole(variant)).collect::<Vec<_>>(),
        [false, true]
    );
}

#[test]
fn a_panic_is_that_node_s_failure() {
    let bench = Bench::new();
    let outcome = bench.run(&with_mischief("panics"), &[]);
    assert_eq!(ended(&outcome, End::Failed), ["bad"]);
    assert_eq!(
        outcome.node("base", "bad").unwrap().error.as_ref().unwrap().message,
        "the node broke off: index 5 is beyond 3"
    );
    assert_eq!(ended(&outcome, End::Executed), ["source", "solve", "smooth", "sum"]);
}

#[test]
fn an_output_that_is_not_as_planned_is_refused() {
    let bench = Bench::new();
    let outcome = bench.run(&with_mischief("lies"), &[]);
    assert_eq!(
        outcome.node("base", "bad").unwrap().error.as_ref().unwrap().message,
        "solve/trouble broke its promise: `plane` is not as planned"
    );
}

#[test]
fn a_cancelled_run_leaves_the_cache_whole() {
    let bench = Bench::new();
    let cancel = AtomicBool::new(false);
    struct Canceller<'a>(&'a AtomicBool);
    impl Observer for Canceller<'_> {
        fn task_started(&self, _: TaskId, label: &str) {
            if label == "bad" {
                self.0.store(true, Ordering::Relaxed);
            }
        }
    }
    let plan = bench.plan(&with_mischief("waits"), &[]);
    let outcome = run(&plan, &bench.cache, &bench.options(), &Canceller(&cancel), &cancel);
    assert!(
        ended(&outcome, End::Interrupted).contains(&"bad")
            && ended(&outcome, End::Interrupted).contains(&"last")
    );
    assert_eq!(outcome.exit_code(), 130);
    assert_eq!(bench.cache.verify().unwrap().damaged, [""; 0]);
    assert_well(&bench.run(&with_mischief("none"), &[]));
}

/// Stops a run when a task in bands has done so many rows.
struct StopAfter<'a> {
    rows: u64,
    task: TaskId,
    done: Mutex<u64>,
    cancel: &'a AtomicBool,
}

impl Observer for StopAfter<'_> {
    fn progress_advance(&self, task: TaskId, rows: u64) {
        let mut done = self.done.lock().unwrap();
        *done += if task == self.task { rows } else { 0 };
        if *done >= self.rows {
            self.cancel.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn a_stopped_run_goes_on_from_the_bands_that_it_kept() {
    let expected = digests(&Bench::new().run(CHAIN, &[]));
    for forged in [false, true] {
        let bench = Bench::new();
        let plan = bench.plan(CHAIN, &[]);
        let options = Options { keep: Keep::All, band_rows: Some(5), threads: 1, ..bench.options() };
        let solve = plan.task_of("base", "solve").unwrap();
        let cancel = AtomicBool::new(false);
        let stopped = run(
            &plan,
            &bench.cache,
            &options,
            &StopAfter { rows: 5, task: solve, done: Mutex::new(0), cancel: &cancel },
            &cancel,
        );
        assert_eq!(stopped.exit_code(), 130);
        let bands = bench.cache.bands().unwrap();
        let kept: Vec<_> = bands
            .list()
            .unwrap()
            .into_iter()
            .filter(|band| band.counts.contains_key("rows were added to"))
            .collect();
        let [band] = &kept[..] else { panic!("the band that was done is kept: {kept:?}") };
        assert_eq!((band.start, band.end), (0, 5));
        if forged {
            // Other numbers in the same rows: whether the band is taken shows in the result.
            let meta = plan.tasks[solve].output("plane").unwrap().meta.clone();
            let value = bands.load(band, "plane", &meta).unwrap();
            let Value::Map(map) = value else { panic!("a map is kept") };
            let mut rows = map.read(map.rows()).unwrap();
            rows.values.fill(100.0);
            let other = Value::Map(photocurrent_core::MapSet::in_memory(map.meta.clone(), rows));
            bands
                .put(
                    band.identity,
                    band.rows(),
                    &[("plane", other)],
                    (band.texts.clone(), band.counts.clone()),
                )
                .unwrap();
        }
        // With other bands, threads and memory: none of them says what a result is.
        let outcome = bench.run_with(&plan, &Options { band_rows: Some(3), ..bench.options() });
        assert_well(&outcome);
        assert_eq!(outcome.node("base", "solve").unwrap().notes, ["12 rows were added to"]);
        assert_eq!(digests(&outcome) == expected, !forged, "the kept band is taken, not computed again");
        assert!(bands.list().unwrap().is_empty(), "bands go when their result is complete");
    }
}

#[test]
fn a_damaged_band_is_computed_again() {
    let expected = digests(&Bench::new().run(CHAIN, &[]));
    let bench = Bench::new();
    let plan = bench.plan(CHAIN, &[]);
    let options = Options { keep: Keep::All, band_rows: Some(4), threads: 1, ..bench.options() };
    let cancel = AtomicBool::new(false);
    let observer = StopAfter {
        rows: 8,
        task: plan.task_of("base", "solve").unwrap(),
        done: Mutex::new(0),
        cancel: &cancel,
    };
    run(&plan, &bench.cache, &options, &observer, &cancel);
    let bands = bench.cache.bands().unwrap();
    let data = std::fs::read_dir(bands.folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "h5"));
    let mut damaged = 0;
    for path in data {
        let mut bytes = std::fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        damaged += 1;
    }
    assert!(damaged > 0);
    let outcome = bench.run_with(&plan, &bench.options());
    assert_well(&outcome);
    assert_eq!(digests(&outcome), expected);
    assert_eq!(outcome.node("base", "solve").unwrap().notes, ["12 rows were added to"]);
}

#[test]
fn a_damaged_artefact_is_made_again_with_a_warning() {
    let bench = Bench::new();
    let first = bench.run(CHAIN, &[]);
    let digest = first.node("base", "solve").unwrap().outputs["plane"].digest;
    let path = bench.folder.path(&format!("cache/data/{digest}.h5"));
    let mut bytes = std::fs::read(&path).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    // The length is right, so the damage shows when somebody reads it: `smooth`, which has to run with
    // another halo of interest.
    let cache = Cache::open(&bench.folder.path("cache")).unwrap();
    let options = Options { force: ["smooth".to_string(), "sum".to_string()].into(), ..bench.options() };
    let outcome = run(&bench.plan(CHAIN, &[]), &cache, &options, &Unobserved, &AtomicBool::new(false));
    assert_well(&outcome);
    assert_eq!(ended(&outcome, End::Executed), ["solve", "smooth", "sum"]);
    assert_eq!(digests(&outcome), digests(&first));
    assert!(outcome.warnings[0].starts_with("solve: output plane is made again: "), "{:?}", outcome.warnings);
    // Cut short, it is seen at once.
    std::fs::write(&path, &bytes[..last]).unwrap();
    let shown = bench.status(CHAIN, &[]);
    assert!(shown[1].starts_with("solve: record damaged: output `plane`"), "{shown:?}");
    let outcome = bench.run(CHAIN, &[]);
    assert_eq!(ended(&outcome, End::Executed), ["solve"]);
    assert!(
        outcome.warnings[0].starts_with("solve: the cache's record is damaged"),
        "{:?}",
        outcome.warnings
    );
}

#[test]
fn two_runs_at_once_on_one_cache_are_both_right() {
    let bench = Bench::new();
    let plan = bench.plan(CHAIN, &[]);
    let one = || {
        let cache = Cache::open(&bench.folder.path("cache")).unwrap();
        run(&plan, &cache, &bench.options(), &Unobserved, &AtomicBool::new(false))
    };
    let (a, b) = std::thread::scope(|scope| {
        let (a, b) = (scope.spawn(one), scope.spawn(one));
        (a.join().unwrap(), b.join().unwrap())
    });
    assert_well(&a);
    assert_well(&b);
    assert_eq!(digests(&a), digests(&b));
    assert_eq!(ended(&bench.run(CHAIN, &[]), End::Executed), [""; 0]);
}

#[test]
fn the_status_names_what_changed_and_writes_nothing() {
    let bench = Bench::new();
    let before = snapshot(&bench.folder.path("cache"));
    assert_eq!(
        bench.status(CHAIN, &[]),
        [
            "source: never ran",
            "solve: waits for source",
            "smooth: waits for solve",
            "sum: waits for solve, smooth"
        ]
    );
    assert_eq!(snapshot(&bench.folder.path("cache")), before);
    let data = bench.folder.write("data.bin", "four");
    let text = format!(
        "{CHAIN}[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"smooth\"\n[nodes.low]\nkind = \
                 \"refine/sign\"\nin.plane = \"halves.low\"\n"
    )
    .replace("kind = \"read/source\"", "kind = \"read/source\"\nparams.path = \"data.bin\"");
    assert_well(&bench.run(&text, &[]));
    let before = snapshot(&bench.folder.path("cache"));
    assert!(bench.status(&text, &[]).iter().all(|line| line.ends_with(": hit")));
    let shown = bench.status(&text, &["nodes.solve.params = { amount = 3, rate = \"2 kHz\" }"]);
    assert_eq!(
        shown[..3],
        [
            "source: hit",
            "solve: params.amount 2.0 -> 3.0; params.rate \"1 kHz\" -> \"2 kHz\"",
            "smooth: waits for solve"
        ]
    );
    let kept = text.replace("seed = 7", "keep = [\"halves.high\"]");
    assert_eq!(bench.status(&kept, &[])[4], "halves: output high was not stored");
    std::fs::write(&data, "five!").unwrap();
    assert_eq!(bench.status(&text, &[])[0], format!("source: file {} changed content", data.display()));
    assert_eq!(snapshot(&bench.folder.path("cache")), before);
    let explained = explain(
        &bench.plan(&text, &["nodes.solve.params.amount=3"]),
        &bench.cache,
        &bench.folder.path("out"),
        "solve",
    )
    .unwrap();
    assert_eq!(explained[0].lines, ["waits for source", "params.amount 2.0 -> 3.0"]);
    let problem =
        explain(&bench.plan(&text, &[]), &bench.cache, &bench.folder.path("out"), "slove").unwrap_err();
    assert_eq!(problem.help.as_deref(), Some("did you mean `solve`?"));
}

#[test]
fn another_seed_reruns_only_what_draws_and_what_follows() {
    let bench = Bench::new();
    let text = format!("{CHAIN}[nodes.noise]\nkind = \"simulate/noise\"\nin.plane = \"source\"\n");
    bench.run(&text, &[]);
    assert_eq!(bench.status(&text, &["pipeline.seed=8"])[4], "noise: seed 7 -> 8");
    assert_eq!(ended(&bench.run(&text, &["pipeline.seed=8"]), End::Executed), ["noise"]);
}

#[test]
fn a_part_of_the_pipeline_runs_alone() {
    let bench = Bench::new();
    let plan = bench.planned(CHAIN, &[], &["solve"]).unwrap();
    let outcome = bench.run_with(&plan, &bench.options());
    assert_eq!(ended(&outcome, End::Executed), ["source", "solve"]);
}

#[test]
fn outputs_that_another_pipeline_stored_stay_named() {
    let bench = Bench::new();
    let halves = format!(
        "{CHAIN}[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"smooth\"\n[nodes.x]\nkind = \
                 \"refine/sign\"\nin.plane = \"halves.PORT\"\n"
    );
    bench.run(&halves.replace("PORT", "low"), &[]);
    assert_eq!(ended(&bench.run(&halves.replace("PORT", "high"), &[]), End::Executed), ["halves", "x"]);
    assert_eq!(ended(&bench.run(&halves.replace("PORT", "low"), &[]), End::Executed), [""; 0]);
}
