"""Pipelines of named nodes, run by the engine; manifests run and written."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from photocurrent import _errors, _native
from photocurrent._frames import Frames
from photocurrent._graph import absolute, heard, kinds, node_lines, run_arguments, takes_list, toml, toml_key, written
from photocurrent._methods import Score
from photocurrent._sensor import Sensor
from photocurrent._settings import listener


class Run:
    """Results of a run.

    Attributes
    ----------
    code : int
        The exit code of the command: 0, 4 for an ablation with failed variants, or 5 when a score is outside its
        bound (`expect`).
    variants : list of str
        Names of the variants; `["base"]` without an ablation.
    seconds : float
        From start to end.
    out : Path
        Folder with the files that nodes wrote, `run.json` and the scores.
    table : str
        The table that the command prints.
    notes : str
        What the command writes to stderr.
    """

    def __init__(self, native: _native.Run) -> None:
        self._native = native
        self.code = native.code
        self.variants = native.variants
        self.seconds = native.seconds
        self.out = Path(native.out_dir)
        self.table = native.out
        self.notes = native.err

    def _variant(self, given: str | None) -> str:
        return self.variants[0] if given is None else given

    @property
    def tasks(self) -> list[dict[str, Any]]:
        """What came of every node: `node`, `kind`, `uses`, `end` (`"executed"`, `"reused"` ...), `seconds`,
        `key`, `outputs` with their digests, `notes`, `error`, `files`."""
        found: list[dict[str, Any]] = json.loads(self._native.tasks())
        return found

    @property
    def metrics(self) -> list[dict[str, Any]]:
        """Scores pooled over frames, one object for each variant, node and metric: `metrics.pooled.jsonl`."""
        pooled: list[dict[str, Any]] = json.loads(self._native.metrics())[1]
        return pooled

    def digest(self, output: str, variant: str | None = None) -> str:
        """The name of the content of an output, `"solve.tracks"`: that of the command's artefact."""
        return self._value(output, variant).digest

    def _value(self, output: str, variant: str | None) -> _native.Value:
        node, _, port = output.partition(".")
        for task in self.tasks:
            if [self._variant(variant), node] in task["uses"]:
                ports = list(task["outputs"])
                value = self._native.value(self._variant(variant), node, port or (ports[0] if ports else ""))
                if value is not None:
                    return value
                raise _errors.UsageError(
                    f"error: node {node} gives no {port or 'output'}; it gives: {', '.join(ports) or 'nothing'}"
                )
        known = sorted({use[1] for task in self.tasks for use in task["uses"]})
        raise _errors.UsageError(f"error: there is no node {node} in this run; there are: {', '.join(known)}")

    def get(self, output: str, variant: str | None = None) -> Any:
        """An output, `"render.frames"` or `"render"` where it has one, by its type.

        Frames give `Frames`, events a structured array, a sensor description a `Sensor`, scores a `Score`,
        other tables a dict of columns, maps a dict of planes, a stage of a diagnosis its document as a dict;
        tracks and light their flat columns (see `Tracks.columns`).
        """
        value = self._value(output, variant)
        match value.kind:
            case "frames" | "truth":
                sigma = None
                if "." not in output or output.endswith(".frames"):
                    node = output.partition(".")[0]
                    sigma = self._native.value(self._variant(variant), node, "sigma")
                return Frames._of(value, sigma, None)
            case "events":
                return value.events("us")
            case "sensor":
                return Sensor.parse(value.text())
            case "table":
                columns, _ = value.table()
                is_score = {name for name, _ in columns} >= {"metric", "frame", "value", "unit"}
                return Score(value) if is_score else dict(columns)
            case "map":
                names, planes = value.planes()
                return dict(zip(names, planes))
            case "diagnosis":
                return json.loads(value.text())
            case _:
                extent = json.loads(value.meta())["extent"]
                return value.columns(0, extent["height"])

    def __repr__(self) -> str:
        ends = [task["end"] for task in self.tasks]
        counts = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(ends))
        return f"<run of {len(ends)} nodes: {counts}; {self.seconds:.1f} s>"


def run(
    manifest: str | os.PathLike[str],
    set: Mapping[str, Any] | Sequence[str] = (),
    *,
    to: str | Sequence[str] = (),
    variant: str | Sequence[str] = (),
    force: str | Sequence[str] = (),
    out: str | os.PathLike[str] | None = None,
) -> Run:
    """Runs a manifest, as the command `run` does: the same cache, the same digests, the same files.

    Parameters
    ----------
    manifest
        A TOML file.
    set
        Values to lay over it: `{"nodes.solve.params.cis_weight": 2}`, or texts `"path=value"`.
    to
        Only these nodes and what they need.
    variant
        Only these variants of an ablation, by name or a part of it.
    force
        Nodes to run even when the cache has them.
    out
        Folder for files; `out/NAME` of the manifest unless given.

    Raises
    ------
    UsageError
        For every mistake in the manifest, at its line, all at once; nothing ran.
    RunError, DataError
        For nodes that failed.
    """
    sets = [f"{path}={toml(value)}" for path, value in set.items()] if isinstance(set, Mapping) else list(set)
    return _run(Path(manifest), None if out is None else Path(out), sets, to, variant, force)


def _several(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


def _run(
    manifest: Path,
    out: Path | None,
    sets: Sequence[str],
    to: str | Sequence[str],
    variant: str | Sequence[str],
    force: str | Sequence[str],
) -> Run:
    arguments = run_arguments(manifest, out)
    for option, names in (("--set", sets), ("--to", _several(to)), ("--variant", _several(variant)),
                          ("--force", _several(force))):
        for name in names:
            arguments += [option, name]
    native = _native.run(arguments, listener())
    if native.code not in (4, 5):
        heard(native)
    return Run(native)


class Node:
    """A node of a pipeline; its outputs are attributes and items: `node.tracks`, `node["tracks"]`."""

    def __init__(self, name: str, kind: str) -> None:
        self._name = name
        self._kind = kind

    def __getattr__(self, port: str) -> str:
        if port.startswith("_"):
            raise AttributeError(port)
        known = [output["name"] for output in kinds().get(self._kind, {}).get("outputs", [])]
        if known and port not in known:
            raise _errors.UsageError(
                f"error: {self._kind} has no output `{port}`; it has: {', '.join(known)}"
            )
        return f"{self._name}.{port}"

    def __getitem__(self, port: str) -> str:
        return str(getattr(self, port))

    def __repr__(self) -> str:
        return f"<node {self._name}: {self._kind}>"


#: What an input takes: a node, an output of one, or a list of such.
Wire = Node | str | Sequence[Node | str]


class Pipeline:
    """A graph of nodes, built in Python and run by the engine.

    Parameters
    ----------
    about
        What it is for, in a sentence.
    seed
        Of everything random.
    folder
        Where relative paths in parameters start from; the current folder unless given.

    Example
    -------
    >>> import photocurrent as pc
    >>> p = pc.Pipeline(seed=7)
    >>> sensor = p.add("sensor", "read/sensor", path="data/sensors/hybrid.toml")
    >>> recording = p.add("recording", "read/aedat4", path="clip.aedat4")
    >>> solve = p.add("solve", "solve/map", {"events": recording.events, "frames": recording.frames,
    ...                                      "sensor": sensor})
    >>> render = p.add("render", "render/rows", {"tracks": solve.tracks, "sensor": sensor}, rate="1 kHz")
    >>> print(p.text().splitlines()[0])
    format = 1
    """

    def __init__(
        self, *, about: str | None = None, seed: int | None = None, folder: str | os.PathLike[str] = "."
    ) -> None:
        self._head: dict[str, Any] = {
            name: value for name, value in (("about", about), ("seed", seed)) if value is not None
        }
        self._folder = Path(os.path.abspath(folder))
        self._nodes: dict[str, tuple[str, dict[str, Any], dict[str, list[str]]]] = {}
        self._ablation: dict[str, Any] = {}
        self._axes: dict[str, Mapping[str, Mapping[str, Any]]] = {}

    def add(self, name: str, kind: str, inputs: Mapping[str, Wire] | None = None, /, **params: Any) -> Node:
        """Adds a node.

        Parameters
        ----------
        name
            Small letters, digits and `_`, a letter first; no other node has it.
        kind
            A kind of docs/nodes.md, such as `"solve/map"`.
        inputs
            Its sockets and what they take: a node with one output, `node.port`, or a list of such.
        **params
            Its parameters, by the names of docs/nodes.md.
        """
        if name in self._nodes:
            raise _errors.UsageError(f"error: there is a node `{name}` already")
        wires = {socket: [_wire(one) for one in _wires(wire)] for socket, wire in (inputs or {}).items()}
        self._nodes[name] = (kind, absolute(kind, params, self._folder), wires)
        return Node(name, kind)

    def axis(self, name: str, /, **levels: Mapping[str, Any]) -> None:
        """Adds an axis of an ablation: each level lays parameters over nodes.

        `p.axis("front_end", on={}, off={"solve.front_end": "ideal"})` compares two front ends; a level's
        keys are `node.parameter`.
        """
        self._axes[name] = levels

    def compare(self, *metrics: str, **baseline: str) -> None:
        """What an ablation shows: metrics such as `"psnr.psnr_db"`, and the variant that others are
        compared with, by its levels: `p.compare("psnr.psnr_db", front_end="on")`."""
        self._ablation = {"metrics": list(metrics), **({"baseline": baseline} if baseline else {})}

    def text(self) -> str:
        """The manifest, TOML: what the command runs with the same results."""
        lines = ["format = 1", ""]
        if self._head:
            lines += ["[pipeline]", *(f"{key} = {toml(value)}" for key, value in self._head.items()), ""]
        for name, (kind, params, wires) in self._nodes.items():
            lists = takes_list(kind)
            lines += node_lines(name, kind, params, wires, lists)
        if self._axes:
            lines += ["[ablation]", *(f"{key} = {toml(value)}" for key, value in self._ablation.items()), ""]
        for axis, levels in self._axes.items():
            lines.append(f"[ablation.axes.{toml_key(axis)}]")
            lines += [f"{toml_key(level)} = {toml(self._level(changes))}" for level, changes in levels.items()]
            lines.append("")
        return "\n".join(lines)

    def _level(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """A level's changes as what it lays over nodes."""
        nodes: dict[str, Any] = {}
        for path, value in changes.items():
            node, _, param = path.partition(".")
            if node not in self._nodes or not param:
                raise _errors.UsageError(
                    f"error: `{path}` names no parameter of a node\n  hint: such as \"solve.front_end\"; nodes: "
                    f"{', '.join(self._nodes)}"
                )
            kind = self._nodes[node][0]
            changed = absolute(kind, {param: value}, self._folder)
            nodes.setdefault(node, {"params": {}})["params"].update(changed)
        return {"nodes": nodes} if nodes else {}

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Writes the manifest; paths in it are whole, so it runs from anywhere on this machine."""
        target = Path(path)
        target.write_text(self.text(), encoding="utf-8")
        return target

    def run(
        self,
        *,
        to: str | Sequence[str] = (),
        variant: str | Sequence[str] = (),
        force: str | Sequence[str] = (),
        out: str | os.PathLike[str] | None = None,
    ) -> Run:
        """Runs it; parameters are those of `pc.run`. Files go to `out`, by default to a folder that goes
        away with the process."""
        manifest = written(self.text())
        folder = manifest.parent / "out" / manifest.stem if out is None else Path(out)
        return _run(manifest, folder, (), to, variant, force)

    def graph(self) -> str:
        """Its graph in Mermaid."""
        code, out, err = _native.command(["graph", str(written(self.text())), "--format", "mermaid"])
        if code != 0:
            raise _errors.of(code, err.strip())
        return out

    def __repr__(self) -> str:
        return self.text()


def _wires(wire: Wire) -> list[Node | str]:
    return [wire] if isinstance(wire, (Node, str)) else list(wire)


def _wire(wire: Node | str) -> str:
    return wire._name if isinstance(wire, Node) else wire
