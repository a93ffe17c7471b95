//! Files for the user: whole or not there, made again when they are gone, and never over somebody's own.

use super::bench::{Bench, executed};
use super::folder::snapshot;
use std::path::PathBuf;

const TEXT: &str = r#"
format = 1
[nodes.source]
kind = "read/source"
params = { width = 1, height = 2 }
[nodes.text]
kind = "write/text"
in.plane = "source"
"#;

impl Bench {
    fn out(&self, name: &str) -> PathBuf {
        self.folder.path("out").join(name)
    }

    /// Names in the output folder, folders left out.
    fn names(&self) -> Vec<String> {
        let root = self.folder.path("out");
        snapshot(&root)
            .into_iter()
            .map(|(path, _)| path.strip_prefix(&root).unwrap().display().to_string())
            .collect()
    }
}

#[test]
fn files_are_stamped_and_a_second_run_leaves_them_alone() {
    let bench = Bench::new();
    let outcome = bench.run(TEXT, &[]);
    assert_eq!(outcome.exit_code(), 0, "{outcome:?}");
    assert_eq!(bench.names(), ["text/.photocurrent.toml", "text/rows/000.txt", "text/rows/001.txt"]);
    let stamp = crate::export::read_stamp(&bench.out("text")).unwrap();
    assert_eq!(Some(stamp.key), outcome.node("base", "text").unwrap().key);
    assert_eq!((stamp.files[0].name.as_str(), stamp.files[0].bytes), ("rows/000.txt", 5));
    assert_eq!(outcome.node("base", "text").unwrap().export, Some(bench.out("text")));
    assert!(executed(&bench.run(TEXT, &[])).is_empty());
}

#[test]
fn a_new_result_takes_the_place_of_the_old_one_as_a_whole() {
    let bench = Bench::new();
    bench.run(TEXT, &["nodes.source.params.height=5"]);
    bench.run(TEXT, &["nodes.source.params.offset=7"]);
    assert_eq!(bench.names(), ["text/.photocurrent.toml", "text/rows/000.txt", "text/rows/001.txt"]);
    assert_eq!(std::fs::read_to_string(bench.out("text/rows/000.txt")).unwrap(), "[7.0]");
    // Back to what the cache knows: the record is there, the files are not.
    assert_eq!(executed(&bench.run(TEXT, &["nodes.source.params.height=5"])), ["text"]);
    assert_eq!(bench.names().len(), 6);
}

#[test]
fn files_that_are_gone_or_cut_short_are_made_again() {
    let bench = Bench::new();
    bench.run(TEXT, &[]);
    std::fs::remove_file(bench.out("text/rows/001.txt")).unwrap();
    assert_eq!(executed(&bench.run(TEXT, &[])), ["text"]);
    std::fs::write(bench.out("text/rows/001.txt"), "[").unwrap();
    assert_eq!(executed(&bench.run(TEXT, &[])), ["text"]);
    std::fs::remove_dir_all(bench.out("text")).unwrap();
    assert_eq!(executed(&bench.run(TEXT, &[])), ["text"]);
    assert_eq!(bench.names().len(), 3);
}

#[test]
fn somebody_s_own_files_are_never_replaced() {
    let bench = Bench::new();
    bench.folder.write("out/text/thesis.tex", "years of work");
    let outcome = bench.run(TEXT, &[]);
    let error = outcome.node("base", "text").unwrap().error.clone().unwrap();
    let shown = error.to_string().replace(&bench.folder.0.path().display().to_string(), "");
    assert_eq!(
        shown,
        "/out/text holds files that this tool did not write there\n  found thesis.tex\n  hint: move them \
         away, or choose another output folder with `--out`"
    );
    assert_eq!(bench.names(), ["text/thesis.tex"]);
    // Nor are those that lie next to ours.
    std::fs::remove_file(bench.out("text/thesis.tex")).unwrap();
    bench.run(TEXT, &[]);
    bench.folder.write("out/text/rows/notes.txt", "mine");
    let outcome = bench.run(TEXT, &["nodes.source.params.offset=7"]);
    assert!(
        outcome.node("base", "text").unwrap().error.as_ref().unwrap().notes[0].contains("rows/notes.txt")
    );
    assert_eq!(bench.names().len(), 4);
}

#[test]
fn every_variant_has_a_folder_of_its_own() {
    let bench = Bench::new();
    let axes = "[ablation.axes.x]\na = { }\nb = { nodes.source.params.width = 1 }\nc = \
                { nodes.source.params.width = 2 }\n";
    let outcome = bench.run(&format!("{TEXT}{axes}"), &[]);
    assert_eq!(outcome.exit_code(), 0);
    // The sources of a and b are one task, their files are not.
    assert_eq!(executed(&outcome), ["source", "text", "text", "source", "text"]);
    let firsts: Vec<String> = bench.names().into_iter().filter(|name| name.ends_with("000.txt")).collect();
    assert_eq!(firsts, ["x=a/text/rows/000.txt", "x=b/text/rows/000.txt", "x=c/text/rows/000.txt"]);
}

#[test]
fn what_a_killed_run_left_is_removed_and_what_a_living_one_makes_is_not() {
    let bench = Bench::new();
    bench.folder.write("out/.text.1-0.partial/rows/000.txt", "half");
    bench.folder.write("out/.text.2-0.partial/rows/000.txt", "in the making");
    let living = std::fs::File::open(bench.out(".text.2-0.partial")).unwrap();
    living.lock().unwrap();
    bench.run(TEXT, &[]);
    assert_eq!(bench.names()[0], ".text.2-0.partial/rows/000.txt");
    assert_eq!(bench.names().len(), 4);
}
