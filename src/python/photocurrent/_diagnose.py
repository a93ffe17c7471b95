"""Diagnosis: where a recording and its sensor description differ."""

from __future__ import annotations

import html
import json
import os
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from photocurrent._graph import command
from photocurrent._methods import Described
from photocurrent._recording import Recording
from photocurrent._sensor import Sensor
from photocurrent._settings import current, session


@dataclass(frozen=True)
class Parameter:
    """A number that was found: `estimate`, its 95 % interval `ci95`, what the description states
    (`nominal`), and its `unit`."""

    name: str
    estimate: float
    ci95: tuple[float, float] | None
    nominal: float | None
    unit: str

    def __str__(self) -> str:
        interval = f" ({self.ci95[0]:.4g} to {self.ci95[1]:.4g})" if self.ci95 is not None else ""
        stated = f", stated {self.nominal:.4g}" if self.nominal is not None else ""
        return f"{self.name} = {self.estimate:.4g}{interval} {self.unit}{stated}"


@dataclass(frozen=True)
class Finding:
    """An effect that the description lacks: its id in the catalogue (docs/effects.md), in plain words, its
    equation, its size, and everything else that the report has of it (`detail`)."""

    id: str
    plain: str
    equation: str
    parameters: list[Parameter]
    also_possible: list[str]
    detail: dict[str, Any] = field(repr=False)


class Page:
    """A page of HTML that shows itself in a notebook."""

    def __init__(self, text: str) -> None:
        self.text = text

    def _repr_html_(self) -> str:
        document = html.escape(self.text, quote=True)
        return f'<iframe srcdoc="{document}" style="width:100%;height:640px;border:1px solid #ccc"></iframe>'

    def to(self, path: str | os.PathLike[str]) -> None:
        """Writes it as a file."""
        Path(path).write_text(self.text, encoding="utf-8")


class Diagnosis:
    """What a diagnosis found.

    Attributes
    ----------
    verdict : str
        `"consistent"`, `"named"`, `"unnamed"`, `"broken_data"` ... (docs/diagnosis.md).
    summary : str
        The verdict in a sentence.
    findings : list of Finding
        What the description lacks, with sizes and intervals.
    sensor : Sensor or None
        The description with what was found; None where nothing was fitted.
    report : dict
        `diagnosis.json` (docs/formats.md).
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.report: dict[str, Any] = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        self.verdict: str = self.report["verdict"]
        self.summary: str = self.report["summary"]
        self.findings = [_finding(effect) for effect in self.report["effects"]]
        fitted = folder / "sensor.fitted.toml"
        self.sensor: Sensor | None = Sensor.parse(fitted.read_text(encoding="utf-8")) if fitted.exists() else None

    def page(self) -> Page:
        """The page of the diagnosis; a notebook shows it."""
        return Page((self._folder / "report.html").read_text(encoding="utf-8"))

    def to(self, folder: str | os.PathLike[str]) -> None:
        """Writes `diagnosis.json`, `report.html` and `sensor.fitted.toml` to a folder."""
        shutil.copytree(self._folder, folder, dirs_exist_ok=True)

    def __repr__(self) -> str:
        lines = [f"{self.verdict}: {self.summary}"]
        for finding in self.findings:
            lines.append(f"{finding.id}: {finding.plain}")
            lines += [f"  {parameter}" for parameter in finding.parameters]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def _finding(effect: dict[str, Any]) -> Finding:
    parameters = [
        Parameter(
            name,
            value["estimate"],
            None if value.get("ci95") is None else (value["ci95"][0], value["ci95"][1]),
            value.get("nominal"),
            value.get("unit", ""),
        )
        for name, value in effect.get("parameters", {}).items()
    ]
    return Finding(
        effect["id"], effect.get("plain", ""), effect.get("equation", ""), parameters,
        list(effect.get("also_possible", [])), effect,
    )


def diagnose(
    recording: Recording, sensor: Described | None = None, *, direct: bool = False, seed: int = 1
) -> Diagnosis:
    """Says where a recording and the sensor description differ, as the command `diagnose` does.

    Parameters
    ----------
    recording
        Events and frames.
    sensor
        The description; the recording's own unless given.
    direct
        Only the tests that need no scene: a second, and blind for most effects.
    seed
        Of everything random.

    Raises
    ------
    UsageError
        For a description that lacks what a diagnosis needs, naming the fields.
    """
    arguments = ["diagnose", *recording._arguments()]
    if sensor is None and recording.path is None and recording.sensor is not None:
        sensor = recording.sensor
    if sensor is not None:
        described = sensor if isinstance(sensor, Sensor) else Sensor(sensor)
        arguments += ["--sensor", str(described._port().step.params["path"])]
    folder = Path(tempfile.mkdtemp(prefix="diagnosis-", dir=session())) / "report"
    now = current()
    arguments += ["--out", str(folder), "--cache", os.fspath(now.cache), "--seed", str(seed), "--quiet"]
    arguments += ["--direct"] if direct else []
    arguments += ["--threads", str(now.threads)] if now.threads is not None else []
    arguments += ["--memory", now.memory] if now.memory is not None else []
    # Broken data are a verdict.
    command(arguments, (0, 3))
    return Diagnosis(folder)
