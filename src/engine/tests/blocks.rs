//! Blocks of time: what is cut, what is joined, what is refused, and that a block is kept and made again by
//! itself.

use super::bench::{Bench, assert_well, digests, executed};
use crate::{Extract, Keep, Options, Outcome, Plan, Unobserved, explain, join, run_part};
use photocurrent_core::document::Problem;
use photocurrent_core::{Rows, Value};
use std::sync::atomic::AtomicBool;

const FILM: &str = r#"
format = 1
[pipeline]
blocks = { length = "20 ms", overlap = "5 ms" }
keep   = ["seen.frames"]
[nodes.film]
kind = "read/film"
[nodes.seen]
kind = "solve/seen"
in.frames = "film"
[nodes.again]
kind = "solve/seen"
in.frames = "seen.frames"
[nodes.last]
kind = "write/last"
in.frames = "again.frames"
"#;

impl Bench {
    fn film(&self, sets: &[&str]) -> Plan {
        self.plan(FILM, sets)
    }

    fn run_well(&self, plan: &Plan, options: &Options) -> Outcome {
        let outcome = self.run_with(plan, options);
        assert_well(&outcome);
        outcome
    }

    /// What the last node was given: a DN of each frame.
    fn seen(&self) -> Vec<f32> {
        let text = std::fs::read_to_string(self.folder.path("out/last/frames.txt")).unwrap();
        text.lines().map(|line| line.parse().unwrap()).collect()
    }
}

fn refusal(bench: &Bench, text: &str, sets: &[&str]) -> Problem {
    match bench.planned(text, sets, &[]) {
        Err(problems) => problems.into_iter().next().unwrap(),
        Ok(_) => panic!("a mistake is refused"),
    }
}

#[test]
fn nodes_that_are_local_in_time_see_a_window_and_others_all_of_it_once() {
    let bench = Bench::new();
    let plan = bench.film(&[]);
    // Frames of 4 ms every 5 ms, from 0 to 59 ms: blocks end at 20 and 40 ms and see 5 ms more on either
    // side.
    let labels: Vec<&str> = plan.tasks.iter().map(|task| task.label.as_str()).collect();
    assert_eq!(labels, ["film", "seen[1]", "seen[2]", "seen[3]", "again[1]", "again[2]", "again[3]", "last"]);
    let windows = |label: &str| {
        plan.tasks[labels.iter().position(|other| *other == label).unwrap()].inputs[0].from.clone()
    };
    let ms = |t: i64| t / 1_000_000;
    assert!(matches!(
        windows("seen[2]")[..],
        [only] if matches!(
            only.extract, Extract::Window(span) if (ms(span.start.0), ms(span.end.0)) == (15, 45),
        ),
    ));
    assert!(matches!(windows("again[2]")[..], [only] if only.extract == Extract::All && only.task == 2));
    assert_eq!(windows("last").iter().map(|part| part.task).collect::<Vec<_>>(), [4, 5, 6]);
    bench.run_well(&plan, &bench.options());
    // Every pixel is ten times the frame's number; each node adds the number of frames that it was given,
    // which are 5, 6 and 5.
    let expected: Vec<f32> =
        (0..12).map(|l| 10.0 * l as f32 + 2.0 * if (4..8).contains(&l) { 6.0 } else { 5.0 }).collect();
    assert_eq!(bench.seen(), expected);
}

#[test]
fn without_blocks_or_with_one_that_holds_all_a_node_sees_everything() {
    let bench = Bench::new();
    for length in ["60 ms", "1 min"] {
        let plan = bench.film(&[&format!("pipeline.blocks.length=\"{length}\"")]);
        assert_eq!(plan.tasks.len(), 4);
        bench.run_well(&plan, &bench.options());
        assert_eq!(bench.seen(), (0..12).map(|l| 10.0 * l as f32 + 24.0).collect::<Vec<f32>>());
    }
    let plain = bench.plan(&FILM.replace("blocks =", "about = 'none' #"), &[]);
    // One block is no block: nothing runs again.
    assert!(executed(&bench.run_well(&plain, &bench.options())).is_empty());
}

#[test]
fn a_block_is_taken_from_the_cache_made_again_and_explained_by_itself() {
    let bench = Bench::new();
    let plan = bench.film(&[]);
    bench.run_well(&plan, &bench.options());
    assert!(executed(&bench.run_well(&plan, &bench.options())).is_empty());
    let force = |node: &str| Options { force: [node.to_string()].into(), ..bench.options() };
    assert_eq!(executed(&bench.run_well(&plan, &force("again[2]"))), ["again[2]"]);
    assert_eq!(executed(&bench.run_well(&plan, &force("again"))), ["again[1]", "again[2]", "again[3]"]);
    // A longer overlap makes every block new; a border that stays where it was makes none new that lies
    // before it.
    let wider = bench.film(&["pipeline.blocks.overlap=\"10 ms\""]);
    let lines = |node: &str| {
        explain(&wider, &bench.cache, &bench.folder.path("out"), node)
            .unwrap()
            .into_iter()
            .map(|explained| explained.lines.join("; "))
            .collect::<Vec<_>>()
    };
    assert_eq!(lines("seen[2]"), ["would run; input frames is cut from another block of time"]);
    assert_eq!(lines("seen").len(), 3);
    assert!(explain(&wider, &bench.cache, &bench.folder.path("out"), "see").is_err());
}

#[test]
fn row_bands_and_parts_made_elsewhere_give_the_same_as_one_run() {
    let bench = Bench::new();
    let plan = bench.film(&[]);
    let whole = digests(&bench.run_well(&plan, &bench.options()));
    let banded = Bench::new();
    let plan = banded.film(&[]);
    assert_eq!(
        digests(
            &banded.run_well(&plan, &Options { band_rows: Some(2), keep: Keep::All, ..banded.options() })
        ),
        whole
    );
    let parted = Bench::new();
    let plan = parted.film(&[]);
    let folders = [(0, 3), (3, 5)].map(|(start, end)| {
        let folder = parted.folder.path(&format!("part{start}"));
        run_part(
            &plan,
            &parted.cache,
            &parted.options(),
            Rows { start, end },
            &folder,
            &Unobserved,
            &AtomicBool::new(false),
        )
        .unwrap();
        folder
    });
    let parts = join(&plan, &parted.cache, &folders).unwrap();
    let outcome = parted.run_well(&plan, &Options { parts, ..parted.options() });
    assert_eq!(digests(&outcome), whole);
    let Some(Value::Frames(kept)) = outcome.value(&parted.cache, "base", "seen[3]", "frames").unwrap() else {
        panic!("a block has its own result")
    };
    assert_eq!(kept.len(), 5);
}

#[test]
fn blocks_that_cannot_be_are_refused_with_what_to_do() {
    let bench = Bench::new();
    let at = |problem: &Problem| {
        problem.at.as_ref().map(|at| at.source.text[at.span.clone()].to_string()).unwrap_or_default()
    };
    let short = refusal(&bench, FILM, &["pipeline.blocks.overlap=\"3 ms\""]);
    assert!(
        short.message.contains("overlap by 3 ms")
            && short.message.contains("up to 4 ms")
            && short.help.is_some(),
        "{short:?}"
    );
    let many = refusal(
        &bench,
        &FILM.replace("kind = \"read/film\"", "kind = \"read/film\"\nparams.count = 4000"),
        &["pipeline.blocks.length=\"1 ms\""],
    );
    assert!(many.message.contains("into 19999, and 10000 are the most"), "{many:?}");
    let none = refusal(&bench, &FILM.replace("length = \"20 ms\", ", ""), &[]);
    assert!(none.message.contains("does not say how long") && at(&none).contains("overlap"), "{none:?}");
    let typo = refusal(&bench, &FILM.replace("length", "lenght"), &[]);
    assert!(
        typo.help.as_deref().is_some_and(|help| help.contains("length"))
            || typo.notes.iter().any(|note| note.contains("length")),
        "{typo:?}"
    );
    let zero = refusal(&bench, FILM, &["pipeline.blocks.length=\"0 ms\""]);
    assert!(zero.message.contains("1 ms"), "{zero:?}");
    let text = format!("{FILM}[nodes.sum]\nkind = \"score/sum\"\nin.planes = [\"seen.plane\"]\n");
    let map = refusal(&bench, &text, &[]);
    assert!(
        map.message.contains("`seen.plane`, which blocks of time do not give as one")
            && map.notes[0].contains("map of its own"),
        "{map:?}"
    );
    assert_eq!(at(&map), "\"seen.plane\"");
}

#[test]
fn a_row_that_is_too_long_for_the_budget_is_said_with_what_helps() {
    let bench = Bench::new();
    // 2,000 frames of 3 pixels are 24 kB of input and as much of output, three times; a quarter of the time
    // fits.
    let text = FILM.replace("kind = \"read/film\"", "kind = \"read/film\"\nparams.count = 2000");
    let options = Options { memory: 128 << 10, ..bench.options() };
    let warnings = |length: &str| {
        let plan = bench.plan(&text, &[&format!("pipeline.blocks.length=\"{length}\"")]);
        bench.run_well(&plan, &options).warnings
    };
    let whole = warnings("1 min");
    assert!(
        whole.len() == 2
            && whole[0].contains("seen: a single row takes about")
            && whole[0].contains("pipeline.blocks"),
        "{whole:?}"
    );
    assert_eq!(warnings("2 s"), Vec::<String>::new());
}
