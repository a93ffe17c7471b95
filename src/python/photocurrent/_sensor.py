"""Sensor descriptions: what is known of one sensor."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, MutableMapping
from hashlib import blake2b
from pathlib import Path
from typing import Any

from photocurrent import _errors, _native
from photocurrent._graph import Port, Step, evaluate
from photocurrent._settings import session

_SECTIONS = ("front_end", "comparator", "readout", "frames", "optics", "effects")


class Section(MutableMapping[str, Any]):
    """A table of a description: its fields as attributes and as items.

    A field that is absent is unknown, not zero. Reading one gives `None`; setting one to `None` removes it.
    """

    _fields: dict[str, Any]

    def __init__(self, fields: dict[str, Any]) -> None:
        object.__setattr__(self, "_fields", fields)

    def __getitem__(self, name: str) -> Any:
        value = self._fields[name]
        return Section(value) if isinstance(value, dict) else value

    def __setitem__(self, name: str, value: Any) -> None:
        if value is None:
            self._fields.pop(name, None)
        else:
            self._fields[name] = dict(value) if isinstance(value, Mapping) else value

    def __delitem__(self, name: str) -> None:
        del self._fields[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return self[name] if name in self._fields else None

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._fields]

    def __repr__(self) -> str:
        return f"Section({self._fields!r})"


class Sensor:
    """A sensor description (`photocurrent-sensor/1`, docs/formats.md).

    Parameters
    ----------
    source
        A TOML file, a dict in the form of such a file, or another description, which is copied. Nothing:
        a description that states nothing.
    **sections
        Fields to lay over it: `comparator={"threshold_on": 0.3}`.

    Attributes
    ----------
    front_end, comparator, readout, frames, optics, effects
        The tables of the description as `Section`: `sensor.comparator.threshold_on` (natural-log units),
        `sensor.front_end.tau_0` (a time such as `"20 us"`), `sensor.effects.leak_events`. They can be
        changed.

    Raises
    ------
    UsageError
        For a field, effect, unit or value that no description has, with its place.
    """

    def __init__(
        self, source: str | os.PathLike[str] | Mapping[str, Any] | Sensor | None = None, **sections: Any
    ) -> None:
        self.notes: list[str] = []
        self._file: Path | None = None
        if source is None:
            self._fields: dict[str, Any] = {"format": "photocurrent-sensor/1"}
        elif isinstance(source, Sensor):
            self._fields = json.loads(json.dumps(source._fields))
        elif isinstance(source, Mapping):
            self._fields = {"format": "photocurrent-sensor/1", **json.loads(json.dumps(dict(source)))}
        else:
            path = Path(source)
            try:
                text = path.read_text(encoding="utf-8")
            except OSError as error:
                raise _errors.UsageError(f"error: {path}: cannot read the sensor description: {error}") from None
            self._fields = json.loads(_native.sensor_to_json(text, str(path)))
            self._file = path
        for name, fields in sections.items():
            if name == "name":
                self._fields["name"] = fields
            elif name in _SECTIONS:
                self._fields.setdefault(name, {}).update(fields)
            else:
                raise _errors.UsageError(
                    f"error: `{name}` is no table of a sensor description\n  known: {', '.join(_SECTIONS)}"
                )
        if self._file is None or sections:
            self._file = None
            self.to_toml()

    @classmethod
    def parse(cls, text: str) -> Sensor:
        """A description from TOML text."""
        return cls(json.loads(_native.sensor_to_json(text, "sensor.toml")))

    @property
    def name(self) -> str:
        """A name for people."""
        return str(self._fields.get("name", ""))

    def _section(self, name: str) -> Section:
        return Section(self._fields.setdefault(name, {}))

    @property
    def front_end(self) -> Section:
        """Photodiode to front-end voltage, Eq. (3): `tau_0`, `alpha`."""
        return self._section("front_end")

    @property
    def comparator(self) -> Section:
        """Front-end voltage to event, Eq. (4): thresholds and their noise, `reset`."""
        return self._section("comparator")

    @property
    def readout(self) -> Section:
        """Event to stamp: `refractory`, `latency_min`."""
        return self._section("readout")

    @property
    def frames(self) -> Section:
        """Photodiode to digital number, Eq. (5): `gain`, `black_level_dn`, `saturation_dn`, `row_time`."""
        return self._section("frames")

    @property
    def optics(self) -> Section:
        """Light to photocurrent: `photocurrent_per_lux`, `event_weights`."""
        return self._section("optics")

    @property
    def effects(self) -> Section:
        """Effects beyond the paper's model, by their ids (docs/effects.md)."""
        return self._section("effects")

    def changed(self, **sections: Any) -> Sensor:
        """A copy with fields laid over: `sensor.changed(comparator={"threshold_on": 0.3})`."""
        return Sensor(self, **sections)

    def to_dict(self) -> dict[str, Any]:
        """A copy of its fields in the form of the TOML file."""
        fields: dict[str, Any] = json.loads(_native.sensor_to_json(self.to_toml(), "sensor.toml"))
        return fields

    def to_toml(self) -> str:
        """Its text as TOML, checked."""
        return _native.sensor_to_toml(json.dumps({k: v for k, v in self._fields.items() if v != {}}))

    def to(self, path: str | os.PathLike[str]) -> None:
        """Writes it as a TOML file."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensor) and self.to_toml() == other.to_toml()

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return self.to_toml()

    def _port(self) -> Port:
        """The node that reads it."""
        text = self.to_toml()
        path = session() / f"{blake2b(text.encode(), digest_size=10).hexdigest()}.sensor.toml"
        if not path.exists():
            path.write_text(text, encoding="utf-8")
        return Step("read/sensor", {"path": str(path)}).port("sensor")


def port_of(sensor: Sensor | Port | str | os.PathLike[str] | Mapping[str, Any]) -> Port:
    """The output that gives a description, however it is given."""
    if isinstance(sensor, Port):
        return sensor
    return (sensor if isinstance(sensor, Sensor) else Sensor(sensor))._port()


def value_of(port: Port) -> Sensor:
    """The description that an output gives."""
    return Sensor.parse(evaluate([port])[0].text())
