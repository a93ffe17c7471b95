//! What lies over what: `extends`, levels, `--set`, and how variants are made of them.

use super::folder::Folder;
use super::toys::catalogue;
use crate::{Plan, Project, Selection};
use photocurrent_core::document::Item;
use std::path::Path;

const BASE: &str = r#"
format = 1
[pipeline]
seed = 7
[nodes.source]
kind = "read/source"
params = { width = 3, height = 5 }
[nodes.solve]
kind = "solve/add"
in = { plane = "source" }
params = { amount = 2.0, rate = "2 kHz" }
[nodes.sum]
kind = "score/sum"
in = { planes = "solve" }
"#;

fn load(path: &Path, sets: &[&str]) -> Project {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Project::load(path, &sets, &catalogue()).unwrap_or_else(|problems| panic!("{problems:#?}"))
}

fn plan(project: &Project) -> Plan {
    Plan::new(project, &catalogue(), &Selection::default()).unwrap_or_else(|problems| panic!("{problems:#?}"))
}

/// A parameter of `nodes.solve` as it counts in a variant.
fn param(project: &Project, variant: &str, node: &str, name: &str) -> String {
    let plan = plan(project);
    plan.tasks[plan.task_of(variant, node).unwrap()].params[name].to_string()
}

#[test]
fn tables_merge_and_scalars_replace() {
    let folder = Folder::new();
    folder.write("base.toml", BASE);
    let path = folder.write(
        "sub/top.toml",
        "format = 1\nextends = \"../base.toml\"\n[nodes.solve]\nparams.amount = 5.0\n",
    );
    let project = load(&path, &[]);
    assert_eq!(param(&project, "base", "solve", "amount"), "5.0");
    assert_eq!(param(&project, "base", "solve", "rate"), "\"2 kHz\"");
    assert_eq!(project.pipelines[0].seed, 7);
}

#[test]
fn a_changed_kind_drops_the_params_and_keeps_the_inputs() {
    let folder = Folder::new();
    folder.write("base.toml", BASE);
    let path = folder.write(
        "top.toml",
        "format = 1\nextends = \"base.toml\"\n[nodes.solve]\nkind = \"solve/scale\"\nparams.factor = 3.0\n",
    );
    let project = load(&path, &[]);
    let solve = project.pipelines[0].node("solve").unwrap();
    assert_eq!(solve.wires[0].from[0].text, "source");
    assert_eq!(solve.params.as_table().unwrap().entries.len(), 1);
}

#[test]
fn the_same_kind_again_keeps_the_params() {
    let folder = Folder::new();
    folder.write("base.toml", BASE);
    let path = folder
        .write("top.toml", "format = 1\nextends = \"base.toml\"\n[nodes.solve]\nkind = \"solve/add\"\n");
    assert_eq!(param(&load(&path, &[]), "base", "solve", "amount"), "2.0");
}

#[test]
fn later_wins_in_the_order_extends_file_level_set() {
    let folder = Folder::new();
    folder.write("base.toml", BASE);
    let level = "[ablation.axes.way]\nup = { }\ndown = \
                 { nodes.solve.params = { direction = \"down\", amount = 4.0 } }\n";
    let path = folder.write(
        "top.toml",
        &format!("format = 1\nextends = \"base.toml\"\n[nodes.solve]\nparams.amount = 3.0\n{level}"),
    );
    let project = load(&path, &[]);
    assert_eq!(param(&project, "way=up", "solve", "amount"), "3.0");
    assert_eq!(param(&project, "way=down", "solve", "amount"), "4.0");
    let project =
        load(&path, &["nodes.solve.params.amount=5", "nodes.solve.params.rate=10 kHz", "pipeline.seed = 9"]);
    assert_eq!(param(&project, "way=down", "solve", "amount"), "5.0");
    assert_eq!(param(&project, "way=down", "solve", "rate"), "\"10 kHz\"");
    assert_eq!(param(&project, "way=down", "solve", "direction"), "\"down\"");
    assert_eq!(project.pipelines[1].seed, 9);
}

#[test]
fn a_path_starts_from_the_manifest_that_wrote_it() {
    let folder = Folder::new();
    folder.write(
        "deep/base.toml",
        "format = 1\n[nodes.source]\nkind = \"read/source\"\nparams.path = \"data.bin\"\n",
    );
    let path = folder
        .write("top.toml", "format = 1\nextends = \"deep/base.toml\"\n[nodes.source]\nparams.width = 2\n");
    let found = param(&load(&path, &[]), "base", "source", "path");
    assert_eq!(found, format!("\"{}\"", folder.path("deep/data.bin").display()));
}

#[test]
fn axes_multiply_and_skip_takes_out() {
    let folder = Folder::new();
    let ablation = r#"
[ablation]
about = "Which way."
metrics = ["sum.sum"]
baseline = { way = "up", amount = 1 }
skip = [{ way = "down", amount = 3 }]
[ablation.axes.way]
up = { }
down = { nodes.solve.params.direction = "down" }
[ablation.sweep]
"nodes.solve.params.amount" = { linear = [1, 3], steps = 3 }
"#;
    let path = folder.write("m.toml", &format!("{BASE}{ablation}"));
    let project = load(&path, &[]);
    let names: Vec<&str> = project.pipelines.iter().map(|pipeline| pipeline.variant.as_str()).collect();
    assert_eq!(
        names,
        ["way=up,amount=1", "way=up,amount=2", "way=up,amount=3", "way=down,amount=1", "way=down,amount=2"]
    );
    let ablation = project.ablation.as_ref().unwrap();
    assert_eq!(ablation.baseline.as_deref(), Some("way=up,amount=1"));
    assert_eq!(ablation.metrics, [("sum".to_string(), "sum".to_string())]);
    assert_eq!(param(&project, "way=down,amount=2", "solve", "amount"), "2.0");
}

#[test]
fn a_log_sweep_has_round_numbers() {
    let folder = Folder::new();
    let path = folder.write(
        "m.toml",
        &format!(
            "{BASE}[ablation.sweep]\n\"nodes.solve.params.amount\" = {{ log = [0.1, 10.0], steps = 5 }}\n"
        ),
    );
    let project = load(&path, &[]);
    let names: Vec<&str> = project.pipelines.iter().map(|pipeline| pipeline.levels[0].1.as_str()).collect();
    assert_eq!(names, ["0.1", "0.316228", "1", "3.16228", "10"]);
}

#[test]
fn a_sweep_over_text_names_its_levels_without_spaces() {
    let folder = Folder::new();
    let path = folder.write(
        "m.toml",
        &format!("{BASE}[ablation.sweep]\n\"nodes.solve.params.rate\" = [\"1 kHz\", \"2 kHz\"]\n"),
    );
    let project = load(&path, &[]);
    assert_eq!(project.pipelines[0].variant, "rate=1kHz");
    assert_eq!(param(&project, "rate=2kHz", "solve", "rate"), "\"2 kHz\"");
}

#[test]
fn variants_are_chosen_whole_or_in_part() {
    let folder = Folder::new();
    let axes = "[ablation.axes.way]\nup = {}\ndown = \
                { nodes.solve.params.direction = \"down\" }\n[ablation.sweep]\n\
                \"nodes.source.params.offset\" = [1, 2]\n";
    let project = load(&folder.write("m.toml", &format!("{BASE}{axes}")), &[]);
    let names = |variants: &[&str]| -> Vec<String> {
        let selection = Selection {
            variants: variants.iter().map(|name| name.to_string()).collect(),
            ..Selection::default()
        };
        Plan::new(&project, &catalogue(), &selection)
            .unwrap_or_else(|p| panic!("{p:?}"))
            .variants
            .into_iter()
            .map(|variant| variant.name)
            .collect()
    };
    assert_eq!(names(&["way=up,offset=2"]), ["way=up,offset=2"]);
    assert_eq!(names(&["offset=2"]), ["way=up,offset=2", "way=down,offset=2"]);
    let selection = Selection { variants: vec!["way=upp,offset=2".into()], ..Selection::default() };
    let problems = Plan::new(&project, &catalogue(), &selection).err().unwrap();
    assert_eq!(
        folder.show(&problems),
        "there is no variant `way=upp,offset=2`\n  hint: did you mean `way=up,offset=2`?\n"
    );
}

#[test]
fn a_bypassed_node_passes_its_input_on() {
    let folder = Folder::new();
    let path = folder.write("m.toml", BASE);
    let project = load(&path, &["nodes.solve.bypass=true"]);
    let plan = plan(&project);
    assert_eq!(plan.task_of("base", "solve"), None);
    let (source, sum) = (plan.task_of("base", "source").unwrap(), plan.task_of("base", "sum").unwrap());
    assert_eq!(
        plan.tasks[sum].inputs[0].from.iter().map(|from| (from.task, from.port)).collect::<Vec<_>>(),
        [(source, "plane")]
    );
}

#[test]
fn variants_share_equal_branches() {
    let folder = Folder::new();
    let axes = "[ablation.axes.way]\nup = {}\ndown = { nodes.solve.params.direction = \"down\" }\nalso_up = \
                { nodes.solve.params.direction = \"up\" }\n";
    let plan = plan(&load(&folder.write("m.toml", &format!("{BASE}{axes}")), &[]));
    // One source, and two ways with a sum each.
    assert_eq!(plan.tasks.len(), 5);
    assert_eq!(plan.task_of("way=up", "sum"), plan.task_of("way=also_up", "sum"));
    assert_eq!(plan.tasks[plan.task_of("way=up", "source").unwrap()].uses.len(), 3);
}

#[test]
fn only_what_somebody_wants_is_stored() {
    let folder = Folder::new();
    let split = |extra: &str| {
        let text =
            format!("{BASE}[nodes.halves]\nkind = \"split/halves\"\nin = {{ plane = \"solve\" }}\n{extra}");
        let plan = plan(&load(&folder.write("m.toml", &text), &[]));
        plan.tasks[plan.task_of("base", "halves").unwrap()]
            .stored()
            .map(|output| output.port)
            .collect::<Vec<_>>()
    };
    let smooth = "[nodes.smooth]\nkind = \"refine/smooth\"\nin = { plane = \"halves.high\" }\n";
    assert_eq!(split(""), ["low", "high"], "nothing takes an output, so all are results");
    assert_eq!(split(smooth), ["high"]);
    let kept = BASE.replace("seed = 7", "seed = 7\nkeep = [\"halves.low\"]");
    let text =
        format!("{kept}[nodes.halves]\nkind = \"split/halves\"\nin = {{ plane = \"solve\" }}\n{smooth}");
    let plan = plan(&load(&folder.write("m.toml", &text), &[]));
    assert_eq!(plan.tasks[plan.task_of("base", "halves").unwrap()].stored().count(), 2);
}

#[test]
fn a_set_value_knows_where_it_came_from() {
    let folder = Folder::new();
    let project = load(&folder.write("m.toml", BASE), &["nodes.solve.params.rate=10 kHz"]);
    let solve = project.pipelines[0].node("solve").unwrap();
    let rate = solve.params.as_table().unwrap().get("rate").unwrap();
    assert_eq!(
        (rate.origin.to_string(), &rate.item),
        ("--set:1:25".to_string(), &Item::String("10 kHz".into()))
    );
}
