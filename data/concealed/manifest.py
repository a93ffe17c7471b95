"""Writes a pipeline that diagnoses every recording of an answer file of the concealed generator, one variant each, and holds what is said against the answers.

    python3 data/concealed/manifest.py DIR/answers.json > DIR/concealed.toml
    photocurrent run DIR/concealed.toml --out out/concealed
    photocurrent table DIR/concealed.toml --rows card.truth --columns card.said --metric count --sum

Recordings with a `.target.toml` next to them are diagnosed on that known target. Of the answers only the names of the recordings are read.
"""

import json
import pathlib
import sys
import tomllib

# The graph is that of the stored recordings; theirs, and the first of them, are replaced.
PIPELINE = pathlib.Path(__file__).parent / "../../pipelines/diagnose/concealed.toml"
STORED, ITS_FIRST = "../../data/concealed/", "059b61b4"

TARGET = """[nodes.target]
kind   = "diagnose/target"
in     = { events = "recording.events", frames = "recording.frames", sensor = "integrity.sensor" }
params = %s

"""


def toml(value):
    """A value as TOML, on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(toml(one) for one in value) + "]"
    return json.dumps(value)


def main(answers):
    answers = pathlib.Path(answers)
    try:
        names = [pathlib.Path(one["file"]).stem for one in json.loads(answers.read_text())["recordings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{answers}: not the answers of a folder of concealed recordings ({type(error).__name__}: {error}); make one with data/concealed/generator")
    if not names:
        sys.exit(f"{answers}: no recording is named in it")
    known = {name: answers.parent / f"{name}.target.toml" for name in names}
    known = {name: tomllib.loads(path.read_text()) for name, path in known.items() if path.exists()}
    first = names[0]
    graph, _ = PIPELINE.read_text().split("[ablation.axes.recording]\n")
    graph = graph[graph.index("format = 1") :].replace(f"{STORED}recordings/", "").replace(f"{STORED}answers.json", answers.name).replace(ITS_FIRST, first)
    if known:
        evidence = graph.index("[nodes.evidence]")
        connected = graph[evidence:].replace('integrity = "integrity.findings"', 'integrity = "integrity.findings", target = "target.target"', 1)
        graph = graph[:evidence] + TARGET % toml(known[first]) + connected
    print(graph + "[ablation.axes.recording]")
    for name in names:
        sets = {"nodes.recording.params.path": f"{name}.h5", "nodes.right.params.recording": name}
        if name in known:
            sets["nodes.target.params"] = known[name]
        print(json.dumps(name) + " = { " + ", ".join(f"{key} = {toml(one)}" for key, one in sets.items()) + " }")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
