//! Every kind of mistake, with the words that the reader sees and the place they point to.

use super::folder::Folder;
use super::toys::catalogue;
use crate::{Plan, Project, Selection};

const SOURCE: &str = "format = 1\n[nodes.source]\nkind = \"read/source\"\n";

/// What is said about a manifest, loaded and planned.
fn said_with(text: &str, sets: &[&str]) -> String {
    let folder = Folder::new();
    let path = folder.write("m.toml", text);
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Plan::load(&path, &sets, &catalogue(), &Selection::default())
        .map_or_else(|problems| folder.show(&problems), |_| String::new())
}

fn said(text: &str) -> String {
    said_with(text, &[])
}

/// After three lines about a source.
fn said_after(text: &str) -> String {
    said(&format!("{SOURCE}{text}"))
}

#[test]
fn the_outline_is_checked() {
    assert_eq!(
        said("[nodes.a]\nkind = \"read/source\"\n"),
        "m.toml:1:1: `format` is missing\n  hint: write `format = 1` as the first line\n"
    );
    assert_eq!(
        said("format = 2\n[nodes.a]\nkind = \"read/source\"\n"),
        "m.toml:1:10: this manifest has format 2, and this version reads format 1\n  hint: use a newer \
         photocurrent, or write `format = 1`\n"
    );
    assert_eq!(
        said("format = 1\n"),
        "m.toml:1:1: the manifest has no node\n  hint: add a table such as `[nodes.sensor]` with a `kind`\n"
    );
    assert_eq!(
        said_after("[pipelin]\nseed = 1\n"),
        "m.toml:4:2: `pipelin` is not a key of a manifest\n  hint: did you mean `pipeline`?\n"
    );
    assert_eq!(
        said_after("[pipeline]\nsed = 1\n"),
        "m.toml:5:1: `sed` is not a key of a pipeline\n  hint: did you mean `seed`?\n"
    );
    assert_eq!(
        said_after("[pipeline]\nseed = \"a\"\n"),
        "m.toml:5:8: expected an integer, found the text \"a\"\n  hint: such as `seed = 7`\n"
    );
    assert_eq!(
        said_after("width = 3\n"),
        "m.toml:4:1: `width` is not a key of a node\n  hint: it is a parameter: write it inside `params`, \
         as in `params = { width = 3 }`\n"
    );
    assert_eq!(
        said_after("parms = { }\n"),
        "m.toml:4:1: `parms` is not a key of a node\n  hint: did you mean `params`?\n"
    );
    assert_eq!(
        said("format = 1\n[nodes.A]\nkind = \"read/source\"\n").lines().next().unwrap(),
        "m.toml:2:8: `A` is not a name for a node"
    );
    assert_eq!(
        said("format = 1\n[nodes.a]\nin = {}\n"),
        "m.toml:2:8: nodes.a: `kind` is missing\n  hint: `photocurrent nodes` lists the kinds\n"
    );
    assert_eq!(
        said_after("in.plane = 3\n"),
        "m.toml:4:12: `in.plane` takes \"node.port\", found the \
                                              integer 3\n  hint: such as `plane = \"scene.events\"`\n"
    );
}

#[test]
fn a_syntax_mistake_is_shown_where_it_stands() {
    let shown = said("format = 1\n[nodes.a\n");
    assert!(shown.starts_with("m.toml:2:") && shown.contains("not TOML"), "{shown}");
}

#[test]
fn a_circle_of_manifests_is_refused() {
    let folder = Folder::new();
    folder.write("b.toml", "format = 1\nextends = \"a.toml\"\n");
    let path =
        folder.write("a.toml", "format = 1\nextends = \"b.toml\"\n[nodes.source]\nkind = \"read/source\"\n");
    let problems = Project::load(&path, &[], &catalogue()).unwrap_err();
    assert_eq!(folder.show(&problems), "b.toml:2:11: a.toml extends itself\n");
    let missing = folder
        .write("c.toml", "format = 1\nextends = \"none.toml\"\n[nodes.source]\nkind = \"read/source\"\n");
    let shown = folder.show(&Project::load(&missing, &[], &catalogue()).unwrap_err());
    assert!(
        shown.starts_with(
            "c.toml:2:11: cannot read none.toml: there is no such file\n  hint: paths are relative"
        ),
        "{shown}"
    );
}

#[test]
fn kinds_and_parameters_are_checked() {
    assert_eq!(
        said("format = 1\n[nodes.a]\nkind = \"read/sorce\"\n"),
        "m.toml:3:8: there is no node kind `read/sorce`\n  hint: did you mean `read/source`?\n"
    );
    assert_eq!(
        said_after("params.widht = 3\n"),
        "m.toml:4:8: `widht` is not a parameter of read/source\n  hint: did you mean `width`?\n"
    );
    let add = "[nodes.solve]\nkind = \"solve/add\"\nin.plane = \"source\"\n";
    assert_eq!(
        said_after(&format!("{add}params = {{ rate = 5, amount = 200.0, direction = \"upp\" }}\n")),
        "m.toml:7:19: expected a rate with its unit, found the integer 5\n  hint: write it as text with a \
         unit, such as \"10 kHz\" (units: Hz, fps, kHz, MHz)\n\
         m.toml:7:31: `amount` must be from -100 to 100, found 200\n\
         m.toml:7:50: \"upp\" is not one of \"up\", \"down\"\n  hint: did you mean \"up\"?\n"
    );
    assert_eq!(
        said_after(&format!("{add}params.amount = 14.0\n")),
        "m.toml:7:17: nodes.solve: `amount` must not be 14\n  hint: take 15\n"
    );
}

#[test]
fn a_node_that_refuses_its_inputs_is_shown_at_the_parameter() {
    let add = "[nodes.solve]\nkind = \"solve/add\"\nin.plane = \"source\"\nparams = { amount = 13.0 }\n";
    assert_eq!(
        said_after(add),
        "m.toml:7:21: nodes.solve: `amount` must not be 13 here\n  somebody is \
                                 superstitious\n  hint: take 15\n"
    );
    let complaint = "[nodes.t]\nkind = \"solve/trouble\"\nin.plane = \"source\"\nparams.mischief = \
                     \"complains\"\n";
    assert_eq!(
        said_after(complaint),
        "m.toml:5:8: nodes.t: the description has a mistake\nline 3 is wrong\n"
    );
}

#[test]
fn sockets_are_checked() {
    let add = "[nodes.solve]\nkind = \"solve/add\"\n";
    assert_eq!(
        said_after(add),
        "m.toml:4:8: nodes.solve: input `plane` (map) is not connected\n  hint: add \
                                 `in = { plane = \"source\" }`\n"
    );
    assert_eq!(
        said_after(&format!("{add}in = {{ plane = \"source\", plain = \"source\" }}\n")),
        "m.toml:6:26: `plain` is not an input of solve/add\n  hint: did you mean `plane`?\n"
    );
    assert_eq!(
        said_after(&format!("{add}in.plane = \"sorce\"\n")),
        "m.toml:6:12: there is no node `sorce`\n  hint: did you mean `source`?\n"
    );
    assert_eq!(
        said_after(&format!("{add}in.plane = \"source.plan\"\n")),
        "m.toml:6:12: `plan` is not an output of read/source\n  hint: did you mean `plane`?\n"
    );
    assert_eq!(
        said_after(&format!("{add}in.plane = [\"source\", \"source\"]\n")),
        "m.toml:6:4: input `plane` of solve takes one value, found a list of 2\n  hint: write one of them, \
         such as `plane = \"source\"`\n"
    );
}

#[test]
fn a_wrong_type_shows_both_sides_and_the_way_out() {
    let frames = "[nodes.frames]\nkind = \"read/frames\"\n[nodes.solve]\nkind = \"solve/add\"\nin.plane = \
                  \"frames\"\n";
    assert_eq!(
        said_after(frames),
        "m.toml:8:12: nodes.solve: input `plane` takes map, and `frames.frames` \
                                    is frames\n  hint: write \"source\"\n"
    );
    let halves = "[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"source\"\n";
    let add = "[nodes.solve]\nkind = \"solve/add\"\nin.plane = \"halves.frames\"\n";
    assert_eq!(
        said_after(&format!("{halves}{add}")),
        "m.toml:9:12: nodes.solve: input `plane` takes map, and `halves.frames` is frames\n  hint: write \
         \"halves.low\" or \"halves.high\"\n"
    );
    assert_eq!(
        said_after(&format!("{halves}{}", add.replace("halves.frames", "halves"))),
        "m.toml:9:12: `halves` has 3 outputs, so its port must be named\n  outputs of split/halves: `low` \
         (map), `high` (map), `frames` (frames)\n"
    );
    let sum = "[nodes.sum]\nkind = \"score/sum\"\nin = { planes = [\"halves.low\"], frames = \"halves\" }\n";
    assert!(said_after(&format!("{halves}{sum}")).ends_with("  hint: write \"halves.frames\"\n"));
}

#[test]
fn an_absent_value_is_refused_where_it_is_needed_and_only_there() {
    let halves = "[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"source\"\n";
    let sum = "[nodes.sum]\nkind = \"score/sum\"\nin = \
               { planes = [\"halves.low\"], frames = \"halves.frames\" }\n";
    assert_eq!(said_after(&format!("{halves}{sum}")), "", "an optional input does not mind");
    let grey = "[nodes.grey]\nkind = \"refine/grey\"\nin.frames = \"halves.frames\"\n";
    assert_eq!(
        said_after(&format!("{halves}{grey}")),
        "m.toml:9:13: nodes.grey: input `frames` needs frames, and `halves.frames` has none\n  the toy has \
         no frames\n"
    );
}

#[test]
fn a_ring_of_nodes_is_printed() {
    let ring = "[nodes.a]\nkind = \"solve/add\"\nin.plane = \"c\"\n[nodes.b]\nkind = \
                \"solve/add\"\nin.plane = \"a\"\n[nodes.c]\nkind = \"solve/add\"\nin.plane = \"b\"\n";
    assert_eq!(
        said_after(ring),
        "m.toml:4:8: these nodes wait for each other: a -> b -> c -> a\n  hint: feedback is written as a \
         chain: solve, render, solve again\n"
    );
}

#[test]
fn a_node_that_feeds_itself_is_named() {
    assert!(
        said_after("[nodes.a]\nkind = \"solve/add\"\nin.plane = \"a\"\n")
            .starts_with("m.toml:4:8: node `a` waits for itself\n")
    );
}

#[test]
fn a_typo_over_a_base_is_not_a_new_node() {
    let folder = Folder::new();
    folder.write("base.toml", SOURCE);
    let path =
        folder.write("m.toml", "format = 1\nextends = \"base.toml\"\n[nodes.sorce.params]\nwidth = 2\n");
    assert_eq!(
        folder.show(&Project::load(&path, &[], &catalogue()).unwrap_err()),
        "m.toml:3:8: there is no node `sorce` below to change, and without `kind` it is no new one\n  hint: \
         did you mean `source`?\n"
    );
}

#[test]
fn a_manifest_that_is_no_text_is_shown_at_its_first_wrong_byte() {
    let folder = Folder::new();
    let path = folder.write("m.toml", "");
    std::fs::write(&path, b"format = 1\n# 7 \xb5s\n").unwrap();
    let shown = folder.show(&Project::load(&path, &[], &catalogue()).unwrap_err());
    assert_eq!(shown, "m.toml:2:5: cannot read m.toml: it is not text in UTF-8\n  hint: save it as UTF-8\n");
}

#[test]
fn what_is_sound_is_planned_with_what_is_not() {
    let add = "[nodes.solve]\nkind = \"solve/add\"\nin.plane = \"source\"\nparams = { amount = 13.0 }\n";
    assert_eq!(
        said_after(&format!(
            "{add}[nodes.c]\nkind = \"solve/ad\"\n[nodes.d]\nkind = \"solve/add\"\nin.plane \
                             = \"c\"\n[pipelin]\n"
        )),
        "m.toml:13:2: `pipelin` is not a key of a manifest\n  hint: did you mean `pipeline`?\n\
         m.toml:9:8: there is no node kind `solve/ad`\n  hint: did you mean `solve/add`?\n\
         m.toml:7:21: nodes.solve: `amount` must not be 13 here\n  somebody is superstitious\n  hint: take \
         15\n"
    );
}

#[test]
fn a_bypass_needs_one_way_through() {
    let node = "[nodes.sum]\nkind = \"score/sum\"\nin.planes = [\"source\"]\nbypass = true\n";
    assert_eq!(
        said_after(node),
        "m.toml:7:10: nodes.sum: a bypass needs one connected input and one output of the same type, and it \
         has none\n  connected inputs: `planes` (map)\n  outputs: `scores` (table)\n  hint: take `bypass` \
         out, and connect what follows to what stands before this node\n"
    );
    let halves = "[nodes.halves]\nkind = \"split/halves\"\nin.plane = \"source\"\nbypass = true\n";
    assert!(said_after(halves).contains("and it has several"));
}

#[test]
fn what_is_kept_must_exist() {
    assert_eq!(
        said_after("[pipeline]\nkeep = [\"source.plan\", \"sorce\"]\n"),
        "m.toml:5:9: `plan` is not an output of read/source\n  hint: did you mean `plane`?\nm.toml:5:24: \
         there is no node `sorce`\n  hint: did you mean `source`?\n"
    );
}

#[test]
fn set_is_checked_like_the_file() {
    let set = |text: &str| said_with(SOURCE, &[text]);
    assert_eq!(
        set("nodes.source.params.width=\"x\""),
        "--set:1:27: expected an integer, found the text \"x\"\n"
    );
    assert_eq!(
        set("nodes.sorce.params.width=1"),
        "--set:1:7: there is no node `sorce` to change\n  hint: did you mean `source`?\n"
    );
    assert_eq!(
        set("nodes.source.params.widht=1"),
        "--set:1:21: `widht` is not a parameter of read/source\n  hint: did you mean `width`?\n"
    );
    assert_eq!(
        set("width"),
        "--set:1:1: `--set` takes path=value\n  hint: such as --set nodes.solve.params.cis_weight=2\n"
    );
    assert_eq!(
        set("source.params.width=1"),
        "--set:1:1: `source` cannot be laid over a manifest\n  hint: write `nodes.source`: it is a node\n"
    );
    assert_eq!(
        set("node.source.params.width=1"),
        "--set:1:1: `node` cannot be laid over a manifest\n  hint: did you mean `nodes`?\n"
    );
}

#[test]
fn an_ablation_is_checked() {
    let ablation = |text: &str| said_after(text);
    assert_eq!(
        ablation("[ablation.axes.way]\nup = { nodes.sorce.params.width = 1 }\n"),
        "m.toml:5:14: there is no node `sorce` to change\n  hint: did you mean `source`?\n"
    );
    assert_eq!(
        ablation(
            "[ablation.axes.a]\none = { nodes.source.params.width = 1 }\n[ablation.axes.b]\ntwo = \
                  { nodes.source.params.width = 2 }\n"
        ),
        "m.toml:7:29: the axes `a` and `b` both set nodes.source.params.width\n  `a` sets it at \
         m.toml:5:29\n  hint: let one axis set it, or make the combinations levels of one axis\n"
    );
    assert_eq!(
        ablation("[ablation]\nskip = [{ wy = \"up\" }, { way = \"upp\" }]\n[ablation.axes.way]\nup = { }\n"),
        "m.toml:5:11: there is no axis `wy`\n  hint: did you mean `way`?\nm.toml:5:32: axis `way` has no \
         level `upp`\n  hint: did you mean `up`?\n"
    );
    assert_eq!(
        ablation("[ablation]\nskip = [{ way = \"up\" }]\n[ablation.axes.way]\nup = { }\n"),
        "m.toml:5:1: `skip` leaves no variant\n  hint: take an entry out, or name more axes in it: an entry \
         skips every variant that has all its levels\n"
    );
    assert_eq!(
        ablation("[ablation]\nbaseline = { }\n[ablation.axes.way]\nup = { }\n"),
        "m.toml:5:12: `baseline` does not say which level of `way`\n  hint: add `way = \"up\"` to it\n"
    );
    assert_eq!(
        ablation("[ablation]\nmetrics = [\"sorce.x\"]\n[ablation.axes.way]\nup = { }\n"),
        "m.toml:5:12: there is no node `sorce`\n  hint: did you mean `source`?\n"
    );
    assert_eq!(
        ablation("[ablation]\nabout = \"x\"\n"),
        "m.toml:4:2: an ablation needs `axes` or `sweep`\n  hint: such as `[ablation.axes.readout]` with \
         levels like `off = { nodes.solve.params.readout = \"none\" }` below it\n"
    );
    assert_eq!(
        ablation("[ablation.sweep]\n\"nodes.source.params.offset\" = { log = [0, 1], steps = 3 }\n"),
        "m.toml:5:40: both ends of a `log` range must be above zero, found 0\n  hint: raise it, or use \
         `linear`\n"
    );
    assert!(
        ablation("[ablation.sweep]\nnodes.source.params.offset = [1]\n")
            .contains("is not the path of a parameter")
    );
    assert_eq!(
        ablation("[ablation.sweep]\n\"nodes.source.params.width\" = [1, \"x\"]\n"),
        "m.toml:5:35: expected an integer, found the text \"x\"\n  in variant width=x\n"
    );
}

#[test]
fn every_independent_mistake_is_reported_at_once_and_none_that_only_follows() {
    let text = "[nodes.a]\nkind = \"solve/ad\"\n[nodes.b]\nkind = \"solve/add\"\nin.plane = \"a\"\n\
                params.amont = 1\n[nodes.c]\nkind = \"solve/add\"\nin.plane = \"b\"\n\
                [nodes.d]\nkind = \"solve/add\"\nin.plan = \"source\"\n";
    let places: Vec<String> = said_after(text)
        .lines()
        .filter(|line| line.starts_with("m.toml"))
        .map(|line| line.to_string())
        .collect();
    assert_eq!(
        places,
        [
            "m.toml:5:8: there is no node kind `solve/ad`",
            "m.toml:9:8: `amont` is not a parameter of solve/add",
            "m.toml:15:4: `plan` is not an input of solve/add",
        ]
    );
}

#[test]
fn a_mistake_of_some_variants_says_in_which() {
    let text = |levels: &str| {
        said_after(&format!(
            "[nodes.solve]\nkind = \"solve/add\"\nin.plane = \
                             \"source\"\n[ablation.sweep]\n\"nodes.solve.params.amount\" = {levels}\n"
        ))
    };
    assert_eq!(
        text("[1, 13]"),
        "m.toml:8:35: nodes.solve: `amount` must not be 13 here\n  somebody is superstitious\n  in variant \
         amount=13\n  hint: take 15\n"
    );
    assert!(!text("[13]").contains("in variant"));
}

/// A source, a node in trouble, and one behind it.
fn in_trouble(optional: &str, mischief: &str) -> String {
    let trouble = format!(
        "[nodes.net]\nkind = \"solve/trouble\"\n{optional}in.plane = \
                           \"source\"\nparams.mischief = \"{mischief}\"\n"
    );
    format!("{SOURCE}{trouble}[nodes.behind]\nkind = \"solve/trouble\"\nin.plane = \"net\"\n")
}

#[test]
fn an_optional_node_is_left_out_with_what_stands_behind_it_while_its_file_is_missing() {
    let folder = Folder::new();
    let path = folder.write("m.toml", &in_trouble("optional = true\n", "misses"));
    let (_, plan) = Plan::load(&path, &[], &catalogue(), &Selection::default())
        .unwrap_or_else(|problems| panic!("{}", folder.show(&problems)));
    assert_eq!(plan.tasks.iter().map(|task| task.label.as_str()).collect::<Vec<_>>(), ["source"]);
    let left: Vec<(&str, &str)> =
        plan.variants[0].left_out.iter().map(|left| (left.node.as_str(), left.why.as_str())).collect();
    let why = "cannot read w.onnx: there is no such file; put it there";
    assert_eq!(left, [("net", why), ("behind", why)]);
}

#[test]
fn only_a_missing_file_of_a_node_marked_optional_is_forgiven() {
    assert!(said(&in_trouble("", "misses")).contains("nodes.net: cannot read w.onnx: there is no such file"));
    assert!(said(&in_trouble("optional = false\n", "misses")).contains("nodes.net: cannot read w.onnx"));
    assert!(
        said(&in_trouble("optional = true\n", "complains"))
            .contains("nodes.net: the description has a mistake")
    );
    assert!(said(&in_trouble("optional = 1\n", "none")).contains("expected `true` or `false`"));
}
