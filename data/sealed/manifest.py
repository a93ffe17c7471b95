"""Writes a pipeline that diagnoses every recording of an answer file of the sealed generator, one variant each, and holds what is said against the answers.

    python3 data/sealed/manifest.py DIR/answers.json > DIR/sealed.toml
    photocurrent run DIR/sealed.toml --out out/sealed
    photocurrent table DIR/sealed.toml --rows card.truth --columns card.said --metric count --sum

Recordings with a `.target.toml` beside them are diagnosed on that known target. Of the answers only the names of the recordings are read.
"""

import json
import pathlib
import sys
import tomllib

HEAD = """format = 1

[pipeline]
about = "Sealed recordings diagnosed, and held against the answers."
seed  = 1

[nodes.recording]
kind   = "read/recording"
params = { path = "%(first)s.h5" }

[nodes.integrity]
kind = "diagnose/integrity"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
%(target)s
[nodes.evidence]
kind = "diagnose/evidence"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings"%(on_target)s }

[nodes.decide]
kind = "diagnose/decide"
in   = { evidence = "evidence", sensor = "integrity.sensor" }

[nodes.confirm]
kind = "diagnose/confirm"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings", proposals = "decide" }

[nodes.right]
kind   = "score/diagnosis"
in     = { report = "confirm.report" }
params = { answers = "%(answers)s", recording = "%(first)s" }

[ablation]
about   = "One variant a recording."
metrics = ["right.false_alarm", "right.first_right", "right.in_set", "right.set_size", "right.surplus", "right.f1", "right.parameter_error", "right.unnamed"]

[ablation.axes.recording]
"""

TARGET = """
[nodes.target]
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
    names = [pathlib.Path(one["file"]).stem for one in json.loads(answers.read_text())["recordings"]]
    known = {name: answers.parent / f"{name}.target.toml" for name in names}
    known = {name: tomllib.loads(path.read_text()) for name, path in known.items() if path.exists()}
    first = names[0]
    target, on_target = (TARGET % toml(known[first]), ', target = "target.target"') if known else ("", "")
    print(HEAD % {"first": first, "answers": answers.name, "target": target, "on_target": on_target}, end="")
    for name in names:
        sets = {"nodes.recording.params.path": f"{name}.h5", "nodes.right.params.recording": name}
        if name in known:
            sets["nodes.target.params"] = known[name]
        print(json.dumps(name) + " = { " + ", ".join(f"{key} = {toml(one)}" for key, one in sets.items()) + " }")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
