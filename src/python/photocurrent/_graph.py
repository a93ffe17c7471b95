"""Graphs of nodes as values, and manifests written of them: every function of this package runs one."""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

from photocurrent import _errors, _native
from photocurrent._settings import current, listener, session

log = logging.getLogger("photocurrent")

#: A value of a manifest.
Value = Any


def toml(value: Value) -> str:
    """A value as TOML, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, os.PathLike):
        return toml(os.path.abspath(value))
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(item) for item in value) + "]"
    # A number of numpy too.
    number = value.item() if hasattr(value, "item") else value
    if isinstance(number, int):
        return str(number)
    if isinstance(number, float):
        return repr(number) if math.isfinite(number) else str(number)
    raise _errors.UsageError(
        f"error: {value!r} is no value of a manifest\n  hint: texts, numbers, booleans, lists and dicts are"
    )


def toml_key(key: str) -> str:
    """A key as TOML."""
    bare = key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key)
    return key if bare else json.dumps(key)


@lru_cache(maxsize=1)
def kinds() -> dict[str, Any]:
    """Every kind of node by its name: its ports and the schema of its parameters."""
    code, out, err = _native.command(["nodes", "--json"])
    if code != 0:
        raise _errors.of(code, err)
    return {kind["kind"]: kind for kind in json.loads(out)}


def absolute(kind: str, params: Mapping[str, Value], folder: Path) -> dict[str, Value]:
    """Parameters with every path from the root: a manifest may lie anywhere."""
    properties = kinds().get(kind, {}).get("params", {}).get("properties", {})

    def is_path(form: Any) -> bool:
        if not isinstance(form, dict):
            return False
        return bool(form.get("x-path")) or any(is_path(part) for part in form.get("anyOf", []))

    def whole(name: str, value: Value) -> Value:
        form = properties.get(name, {})
        if isinstance(value, (str, os.PathLike)) and is_path(form):
            return str(Path(os.path.abspath(folder / value)))
        if isinstance(value, (list, tuple)) and is_path(form.get("items")):
            return [str(Path(os.path.abspath(folder / item))) for item in value]
        return value

    return {name: whole(name, value) for name, value in params.items() if value is not None}


class Step:
    """A node without a name: its kind, parameters and inputs."""

    def __init__(
        self,
        kind: str,
        params: Mapping[str, Value] | None = None,
        inputs: Mapping[str, Port | Sequence[Port] | None] | None = None,
        seed: int | None = None,
    ) -> None:
        self.kind = kind
        self.params = absolute(kind, params or {}, Path("."))
        given = (inputs or {}).items()
        self.inputs: dict[str, list[Port]] = {
            name: [port] if isinstance(port, Port) else list(port) for name, port in given if port is not None
        }
        self.seed = seed

    def port(self, name: str) -> Port:
        """An output."""
        return Port(self, name)

    def before(self) -> Iterable[Step]:
        """The steps whose outputs it takes."""
        return (port.step for ports in self.inputs.values() for port in ports)


class Port:
    """An output of a node."""

    def __init__(self, step: Step, name: str) -> None:
        self.step = step
        self.name = name

    def __repr__(self) -> str:
        return f"<{self.name} of {self.step.kind}>"


class Graph:
    """Steps with names, in running order."""

    def __init__(self, ends: Iterable[Step]) -> None:
        self.names: dict[Step, str] = {}
        seeds: set[int] = set()
        waiting = [(step, False) for step in reversed(list(ends))]
        while waiting:
            step, is_ready = waiting.pop()
            if step in self.names:
                continue
            if not is_ready:
                waiting.append((step, True))
                waiting.extend((earlier, False) for earlier in step.before())
                continue
            self.names[step] = self._free(step.kind)
            if step.seed is not None:
                seeds.add(step.seed)
        if len(seeds) > 1:
            raise _errors.UsageError(
                f"error: recordings that were simulated with several seeds ({sorted(seeds)}) meet in one graph\n"
                "  hint: simulate them with one seed, or write one with Recording.to and open it"
            )
        self.seed = seeds.pop() if seeds else None

    def _free(self, kind: str) -> str:
        family, _, own = kind.partition("/")
        is_light = family == "simulate" and own != "sensor"
        is_recording = family in ("read", "simulate") and kind != "read/sensor"
        name = own if is_light or kind == "read/sensor" else "recording" if is_recording else family
        taken = set(self.names.values())
        numbered = (f"{name}_{k}" for k in range(2, 1_000_000))
        return name if name not in taken else next(one for one in numbered if one not in taken)

    def text(self, kept: Sequence[str] = ()) -> str:
        """The manifest; `kept` are outputs that are stored although nothing takes them."""
        lines = ["format = 1", ""]
        if self.seed is not None or kept:
            lines += ["[pipeline]"]
            lines += [f"seed = {self.seed}"] if self.seed is not None else []
            lines += [f"keep = {toml(list(kept))}", ""] if kept else [""]
        for step, name in self.names.items():
            lines += node_lines(
                name,
                step.kind,
                step.params,
                {
                    socket: [f"{self.names[port.step]}.{port.name}" for port in ports]
                    for socket, ports in step.inputs.items()
                },
                takes_list(step.kind),
            )
        return "\n".join(lines)


def takes_list(kind: str) -> set[str]:
    """The sockets of a kind that take a list."""
    return {port["name"] for port in kinds().get(kind, {}).get("inputs", []) if port["takes"] == "one or more"}


def node_lines(
    name: str,
    kind: str,
    params: Mapping[str, Value],
    inputs: Mapping[str, Sequence[str]],
    lists: set[str],
) -> list[str]:
    """A node as lines of a manifest."""
    lines = [f"[nodes.{name}]", f"kind   = {toml(kind)}"]
    if inputs:
        wires = {
            socket: list(ports) if socket in lists or len(ports) != 1 else ports[0]
            for socket, ports in inputs.items()
        }
        lines.append(f"in     = {toml(wires)}")
    if params:
        lines.append(f"params = {toml(params)}")
    return [*lines, ""]


def written(text: str) -> Path:
    """A manifest in the session's folder, named by its content."""
    name = blake2b(text.encode(), digest_size=10).hexdigest()
    path = session() / f"{name}.toml"
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    return path


def run_arguments(manifest: Path, out: Path | None) -> list[str]:
    """The arguments of `run` that settings decide."""
    now = current()
    arguments = [str(manifest), "--cache", os.fspath(now.cache)]
    if out is not None:
        arguments += ["--out", str(out)]
    if now.threads is not None:
        arguments += ["--threads", str(now.threads)]
    if now.memory is not None:
        arguments += ["--memory", now.memory]
    return arguments


def evaluate(ports: Sequence[Port]) -> list[_native.Value]:
    """Runs what outputs need, and gives them. Raises what the command would report."""
    values = available(ports)
    for port, value in zip(ports, values):
        if value is None:
            raise _errors.DataError(f"error: {port.step.kind} gives no {port.name}")
    return [value for value in values if value is not None]


def available(ports: Sequence[Port]) -> list[_native.Value | None]:
    """The same; None for outputs that there are none of."""
    graph = Graph([port.step for port in ports])
    # Outputs that nothing takes are kept when they are named.
    kept = [f"{graph.names[port.step]}.{port.name}" for port in ports]
    manifest = written(graph.text(kept))
    arguments = run_arguments(manifest, session() / "out" / manifest.stem)
    for name in dict.fromkeys(graph.names[port.step] for port in ports):
        arguments += ["--to", name]
    ran = _native.run(arguments, listener())
    heard(ran)
    return [ran.value("base", graph.names[port.step], port.name) for port in ports]


def export(step: Step) -> Path:
    """Runs a node that writes files, and gives their folder."""
    graph = Graph([step])
    manifest = written(graph.text())
    out = session() / "out" / manifest.stem
    ran = _native.run([*run_arguments(manifest, out), "--to", graph.names[step]], listener())
    heard(ran)
    return out / graph.names[step]


def heard(ran: _native.Run) -> None:
    """Logs the notes of nodes, and raises what failed."""
    for warning in ran.warnings:
        log.warning("%s", warning)
    if ran.code != 0:
        raise _errors.of(ran.code, ran.err.strip())
    for line in ran.err.splitlines():
        if line.startswith("note: "):
            log.info("%s", line[6:])


def command(arguments: Sequence[str], allowed: Sequence[int] = (0,)) -> tuple[int, str, str]:
    """Runs a command, and raises what it reports on stderr unless its exit code is allowed."""
    code, out, err = _native.command(list(arguments), listener())
    if code not in allowed:
        raise _errors.of(code, err.strip())
    return code, out, err
