"""Recordings: events and frames of one sensor, from files of any format, from arrays, or simulated."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from photocurrent import _errors, _native, _show
from photocurrent._frames import Frames, frames_of, meta_of
from photocurrent._graph import Graph, Port, Step, command, evaluate, export
from photocurrent._sensor import Sensor, port_of, value_of
from photocurrent._settings import session
from photocurrent._units import Time, ns, time as time_text

#: One event: column, row, 1 = ON or 0 = OFF, stamp in us. 16 bytes; Metavision's `EventCD`.
EVENT = np.dtype(
    {"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8],
     "itemsize": 16}
)

Events = npt.NDArray[np.void]

#: Other names of the fields of an event.
_NAMES = {
    "x": ("x",),
    "y": ("y",),
    "p": ("p", "on", "pol", "polarity"),
    "t": ("t", "ts", "timestamp", "time"),
}

#: Bins, whether they are spread over the events alone, what cells are divided by, for each layout.
_LAYOUTS = {"e2vid": (5, True, "std"), "time_lens": (5, False, "none"), "dsec": (15, True, "sample_std")}


class Inspection(dict[str, Any]):
    """What `photocurrent inspect` finds: its JSON as a dict (docs/inspect.md), and its text for people."""

    text: str = ""

    def __repr__(self) -> str:
        return self.text

    @property
    def findings(self) -> list[dict[str, Any]]:
        """What is suspicious or unknown, with evidence and what to do."""
        found: list[dict[str, Any]] = self["findings"]
        return found


class Recording:
    """Events and frames of one sensor.

    Parameters
    ----------
    events : structured array, or None
        With fields x, y, p (or on, polarity) and t (or ts, timestamp); any integer types. p is 1 or true for
        ON; -1, 0 or false for OFF.
    x, y, t, p : arrays of one length
        The same as columns.
    frames : array, [frame, y, x] or [frame, y, x, 3], or None
        Linear digital numbers; NaN marks a value that is not known.
    exposures : array, [frame, 2]
        Start and end of the exposure of row 0 of every frame, us.
    row_time
        Delay from one row's exposure to the next; 0 is a global shutter.
    size : (int, int)
        Width and height of the event array; the smallest that holds every event, or the frames', unless
        given. Frames have this size or a whole multiple of it.
    colour
        `"mono"`, `"rgb"` or a mosaic such as `"bayer_rggb"`; from the shape of `frames` unless given.
    sensor
        The sensor description.
    time_unit
        Unit of `t`: `"us"` or `"ns"`. Everything else is in us.

    Raises
    ------
    UsageError
        For columns of different length, events outside of `size`, frames without exposures.

    Times are on one clock; that of a file begins at its earliest stamp.
    """

    def __init__(
        self,
        events: Events | None = None,
        *,
        x: npt.ArrayLike | None = None,
        y: npt.ArrayLike | None = None,
        t: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        frames: npt.ArrayLike | None = None,
        exposures: npt.ArrayLike | None = None,
        row_time: Time = 0.0,
        size: tuple[int, int] | None = None,
        colour: str | None = None,
        sensor: Sensor | str | os.PathLike[str] | Mapping[str, Any] | None = None,
        time_unit: str = "us",
    ) -> None:
        self._path: Path | None = None
        self._params: dict[str, Any] = {}
        self._source: _native.Source | None = None
        self._made: dict[str, Port] = {}
        self._is_simulated = False
        self._events: Events | None = None
        self._frames: npt.NDArray[np.float32] | None = None
        self._exposures_ns = np.zeros((0, 2), np.int64)
        self._row_time_ns = ns(row_time)
        self._colour = "mono"
        self._size: tuple[int, int] | None = size
        self._sensor: Sensor | None = None if sensor is None else (
            sensor if isinstance(sensor, Sensor) else Sensor(sensor)
        )
        columns = [x, y, t, p]
        self._stamps_ns: npt.NDArray[np.int64] | None = None
        if events is not None or any(column is not None for column in columns):
            if time_unit not in ("us", "ns"):
                raise _errors.UsageError(f"error: time_unit is \"us\" or \"ns\", found {time_unit!r}")
            self._take_events(_columns(events, x, y, t, p), time_unit)
        if frames is not None:
            self._take_frames(frames, exposures, colour)
        if self._size is None:
            self._size = self._fitting_size()

    def _take_events(self, columns: dict[str, npt.NDArray[Any]], unit: str) -> None:
        stamps = columns["t"].astype(np.int64)
        self._stamps_ns = stamps if unit == "ns" else stamps * 1000
        made = np.zeros(len(stamps), EVENT)
        for name in ("x", "y"):
            column = columns[name]
            if len(column) and (column.min() < 0 or column.max() > 65535):
                raise _errors.UsageError(f"error: {name} must lie within 0 and 65535")
            made[name] = column
        made["p"] = columns["p"] > 0
        made["t"] = stamps if unit == "us" else stamps // 1000
        order = None if np.all(np.diff(stamps) >= 0) else np.argsort(stamps, kind="stable")
        if order is not None:
            made, self._stamps_ns = made[order], self._stamps_ns[order]
        self._events = made

    def _take_frames(
        self, frames: npt.ArrayLike, exposures: npt.ArrayLike | None, colour: str | None
    ) -> None:
        self._frames = np.ascontiguousarray(frames, np.float32)
        if exposures is None:
            raise _errors.UsageError(
                "error: frames need their exposures\n  hint: exposures=[[start_us, end_us], ...], one a frame"
            )
        self._exposures_ns = np.rint(np.asarray(exposures, np.float64) * 1000).astype(np.int64)
        self._colour = colour or ("rgb" if self._frames.ndim == 4 else "mono")

    def _fitting_size(self) -> tuple[int, int] | None:
        if self._frames is not None and self._frames.ndim > 2:
            return (int(self._frames.shape[2]), int(self._frames.shape[1]))
        if self._events is not None and len(self._events):
            return (int(self._events["x"].max()) + 1, int(self._events["y"].max()) + 1)
        return None

    # What it holds.

    @property
    def path(self) -> Path | None:
        """The file that it was opened from."""
        return self._path

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the event array, or of the frames where there are no events."""
        if self._size is None:
            if self._source is not None:
                self._size = self._source.extent()
            elif self._is_simulated:
                extent = meta_of(evaluate([next(iter(self._made.values()))])[0])["extent"]
                self._size = (extent["width"], extent["height"])
            else:
                raise _errors.UsageError("error: an empty recording has no size\n  hint: state size=(width, height)")
        return self._size

    @property
    def events(self) -> Events:
        """All events in the order of time, as `EVENT`; times in us. Empty without an event stream.

        The array is read once and kept; `chunks` reads a file that is larger than memory.
        """
        if self._events is None:
            self._events = self._read("us")
        return self._events

    def _read(self, unit: str) -> Events:
        if self._source is not None:
            return self._source.events(unit)
        if self._is_simulated:
            return evaluate([self._made["events"]])[0].events(unit)
        return np.zeros(0, EVENT)

    def chunks(self, events: int = 1_000_000, unit: str = "us") -> Iterator[Events]:
        """The events in pieces of so many, in the order of time; memory does not grow with the file.

        Parameters
        ----------
        events
            Events in a piece; the last may have fewer.
        unit
            Unit of the stamps: `"us"` or `"ns"`.
        """
        if self._source is not None:
            yield from self._source.chunks(events, unit)
            return
        whole = self.events if unit == "us" else self._in_ns()
        for at in range(0, len(whole), events):
            yield whole[at : at + events]

    def _in_ns(self) -> Events:
        """All events with stamps in ns."""
        if self._stamps_ns is None:
            return self._read("ns")
        whole: Events = self.events.copy()
        whole["t"] = self._stamps_ns
        return whole

    @property
    def frames(self) -> npt.NDArray[np.float32]:
        """All frames as captured, [frame, y, x] or [frame, y, x, 3]: linear DN. Empty without any."""
        if self._frames is None:
            self._read_frames()
        assert self._frames is not None
        return self._frames

    def _read_frames(self) -> None:
        if self._source is not None and json.loads(self._source.about())["frames"]:
            self._frames = self._source.frames(0, self._source.frame_count())
            self._exposures_ns, self._row_time_ns = self._source.times()
        elif self._is_simulated:
            value = evaluate([self._made["frames"]])[0]
            self._frames = value.frames(0, value.frame_count())
            self._exposures_ns, self._row_time_ns, _ = value.times()
        else:
            self._frames = np.zeros((0, 0, 0), np.float32)

    @property
    def exposures(self) -> npt.NDArray[np.float64]:
        """Start and end of the exposure of row 0 of every frame, [frame, 2], us."""
        _ = self.frames
        return self._exposures_ns / 1000.0

    @property
    def row_time(self) -> float:
        """Delay from one row's exposure to the next, us; 0 is a global shutter."""
        _ = self.frames
        return self._row_time_ns / 1000.0

    @property
    def sensor(self) -> Sensor | None:
        """The sensor description that travels with the recording; None without one."""
        if self._sensor is None and self._source is not None:
            text = self._source.sensor_text()
            self._sensor = None if text is None else Sensor.parse(text)
        if self._sensor is None and self._is_simulated:
            self._sensor = value_of(self._made["sensor"])
        return self._sensor

    @property
    def truth(self) -> Frames | None:
        """True frames of a simulated recording, for scorers; None of a real one."""
        port = self._ports().get("truth")
        if port is None:
            return None
        try:
            return frames_of(port)
        except _errors.DataError:
            return None

    # What is done with it.

    def inspect(self) -> Inspection:
        """What it holds and what is suspicious about it, as the command `inspect` finds it."""
        arguments = self._arguments()
        found = Inspection(json.loads(command(["inspect", "--json", *arguments], (0, 3))[1])["files"][0])
        found.text = command(["inspect", *arguments], (0, 3))[1]
        return found

    def window(self, start: Time | None = None, end: Time | None = None) -> Recording:
        """The part of the recording within a window of time, on the same clock.

        Parameters
        ----------
        start, end
            Leaves out events stamped before `start` or at and after `end`, and frames whose exposure begins
            before `start` or ends after `end`.
        """
        if self._is_foreign():
            params = dict(self._params)
            for name, at, choose in (("start", start, max), ("end", end, min)):
                if at is not None:
                    bound = ns(at) if name not in params else choose(ns(at), ns(params[name]))
                    params[name] = f"{bound} ns"
            return _opened(self._path or Path(), params)
        low = ns(start) if start is not None else -(2**62)
        high = ns(end) if end is not None else 2**62
        whole = self._in_ns()
        frames, spans = self.frames, self._exposures_ns
        kept = (spans[:, 0] >= low) & (spans[:, 1] <= high)
        inside = (whole["t"] >= low) & (whole["t"] < high)
        return self._part(whole[inside], frames[kept] if len(frames) else None, spans[kept], self.size)

    def crop(self, x: int, y: int, width: int, height: int) -> Recording:
        """A part of the array: these event pixels, numbered from 0, and the frame pixels that lie on them.

        Raises
        ------
        UsageError, DataError
            For a part that reaches beyond the array.
        """
        columns, rows = self.size
        if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
            raise _errors.UsageError(
                f"error: a part of {width} x {height} pixels from ({x}, {y}) reaches beyond the "
                f"{columns} x {rows} pixels of the sensor"
            )
        if self._is_foreign():
            before = self._params.get("crop", {"x": 0, "y": 0})
            crop = {"x": before["x"] + x, "y": before["y"] + y, "width": width, "height": height}
            return _opened(self._path or Path(), {**self._params, "crop": crop})
        whole = self._in_ns()
        inside = (whole["x"] >= x) & (whole["x"] < x + width) & (whole["y"] >= y) & (whole["y"] < y + height)
        part = whole[inside]
        part["x"] -= x
        part["y"] -= y
        frames = self.frames
        if len(frames):
            times = frames.shape[1] // rows
            frames = frames[:, y * times : (y + height) * times, x * times : (x + width) * times]
        return self._part(part, frames if len(frames) else None, self._exposures_ns, (width, height))

    def _part(
        self,
        events: Events,
        frames: npt.NDArray[np.float32] | None,
        exposures_ns: npt.NDArray[np.int64],
        size: tuple[int, int],
    ) -> Recording:
        return Recording(
            events, frames=frames, exposures=exposures_ns / 1000.0, row_time=f"{self._row_time_ns} ns",
            size=size, colour=self._colours(), sensor=self.sensor, time_unit="ns",
        )

    def _colours(self) -> str:
        if self._source is not None:
            frames = json.loads(self._source.about())["frames"]
            return str(frames["colour"]) if frames else "mono"
        if self._is_simulated:
            return str(meta_of(evaluate([self._made["frames"]])[0])["colour"])
        return self._colour

    def to(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Writes it: `.h5` (events, frames, sensor description), `.csv`, `.txt` or `.raw` (events alone).

        Parameters
        ----------
        path
            The file; its ending decides what is written.
        force
            Replaces a file that is there.
        """
        target = Path(path)
        is_plain = not self._params.keys() & {"start", "end", "crop", "zero"}
        if target.suffix in (".h5", ".hdf5") and not (self._is_foreign() and is_plain):
            if target.exists() and not force:
                raise _errors.UsageError(
                    f"error: {target} exists\n  hint: give another name, or force=True to replace it"
                )
            source = self._file() if self._path is None or not is_plain else self._path
            if source.resolve() != target.resolve():
                shutil.copyfile(source, target)
            return target
        arguments = [*self._arguments(), str(target), *(["--force"] if force else [])]
        command(["convert", *arguments], (0, 3))
        return target

    def voxels(
        self,
        layout: str = "e2vid",
        bins: int | None = None,
        *,
        start: Time | None = None,
        end: Time | None = None,
        normalise: bool = True,
    ) -> npt.NDArray[np.float32]:
        """The events of a window as a voxel grid, [bin, y, x], as networks take them.

        Each event is shared between the two bins nearest in time; ON counts 1, OFF -1.

        Parameters
        ----------
        layout
            `"e2vid"`: 5 bins from the first to the last event; cells that are not 0 less their mean, over
            their standard deviation (Rebecq et al., CVPR 2019).
            `"time_lens"`: 5 bins over the window, not normalised (Tulyakov et al., CVPR 2021).
            `"dsec"`: 15 bins from the first to the last event; as E2VID with the standard deviation of a
            sample (Gehrig et al., RA-L 2021).
        bins
            Another number of bins.
        start, end
            The window, its end left out; the whole recording unless given.
        normalise
            Whether cells are divided as the layout states.

        Returns
        -------
        float32 array, [bin, y, x]
            `torch.from_numpy` and `torch.from_dlpack` take it without a copy.
        """
        if layout not in _LAYOUTS:
            raise _errors.UsageError(
                f"error: `{layout}` is no layout of voxels\n  known: {', '.join(_LAYOUTS)}"
            )
        usual, over_events, divided = _LAYOUTS[layout]
        whole = self.events
        first, last = (int(whole["t"][0]), int(whole["t"][-1])) if len(whole) else (0, 0)
        low = first if start is None else ns(start) // 1000
        high = last + 1 if end is None else -(-ns(end) // 1000)
        inside = whole[np.searchsorted(whole["t"], low) : np.searchsorted(whole["t"], high)]
        is_whole = start is None and end is None
        return _native.voxels(
            _contiguous(inside), self.size, (low, high), usual if bins is None else bins, False,
            over_events or is_whole, divided if normalise else "none",
        )

    # How the engine takes it.

    def _is_foreign(self) -> bool:
        """Is it a file whose reader takes windows and parts?"""
        return self._source is not None and self._source.format != "recording"

    def _ports(self) -> dict[str, Port]:
        """The outputs of the node that gives it."""
        if not self._made:
            if self._source is not None:
                kind = f"read/{self._source.format}"
                step = Step(kind, {"path": str(self._path), **self._params})
                names = ["events", "frames", "sensor", *(["truth"] if kind == "read/recording" else [])]
            else:
                step, names = Step("read/recording", {"path": str(self._file())}), ["events", "frames"]
                names += ["sensor"] if self._sensor is not None else []
            self._made = {name: step.port(name) for name in names}
        return self._made

    def _file(self) -> Path:
        """Itself as a file: the one that it was opened from, or one in the session's folder."""
        if self._source is not None and not self._params:
            return self._path or Path()
        if self._source is not None or self._is_simulated:
            ports = {name: port for name, port in self._ports().items() if name != "sensor"}
            if self._source is not None:
                about = json.loads(self._source.about())
                ports = {name: port for name, port in ports.items() if about.get(name)}
            sensor = self.sensor
            inputs = {**ports, "sensor": None if sensor is None else port_of(sensor)}
            return export(Step("write/recording", {}, inputs)) / "recording.h5"
        parts = self._arrays()
        path = session() / f"{parts['digest']}.h5"
        if not path.exists():
            _native.write_recording(path, *self.size, **parts["content"])
        return path

    def _arrays(self) -> dict[str, Any]:
        """Its arrays as they are written, and the name of their content."""
        content: dict[str, Any] = {}
        named: list[tuple[str, npt.NDArray[np.uint8]]] = [(f"size {self.size}", np.zeros(0, np.uint8))]
        if self._events is not None and self._stamps_ns is not None:
            x, y, p, _ = _contiguous(self._events)
            content["events"] = (x, y, p, np.ascontiguousarray(self._stamps_ns))
            named += [("events", _bytes(column)) for column in content["events"]]
        if self._frames is not None and self._frames.shape[0]:
            content["frames"] = (self._frames, self._exposures_ns, self._row_time_ns, self._colour)
            named += [(f"frames {self._frames.shape} {self._row_time_ns} {self._colour}", _bytes(self._frames))]
            named += [("exposures", _bytes(self._exposures_ns))]
        if self._sensor is not None:
            content["sensor"] = self._sensor.to_toml()
            named += [("sensor " + content["sensor"], np.zeros(0, np.uint8))]
        return {"content": content, "digest": _native.digest(named)[:32]}

    def _arguments(self) -> list[str]:
        """Itself as arguments of a command."""
        if self._source is None or self._params.keys() & {"start", "end", "crop", "zero"}:
            return [str(self._file())]
        return [str(self._path), *_options(self._params)]

    def manifest(self) -> str:
        """The manifest that gives it, TOML."""
        return Graph([next(iter(self._ports().values())).step]).text()

    def __repr__(self) -> str:
        width, height = self.size
        name = self._path.name if self._path is not None else ("simulated" if self._is_simulated else "of arrays")
        return f"<recording {name}: {width} x {height} pixels>"

    def _repr_html_(self) -> str:
        events, frames = self.events, self.frames
        lines = [f"<p>{len(events):,} events, {len(frames)} frames of {self.size[0]} x {self.size[1]} pixels</p>"]
        if len(frames):
            from photocurrent._frames import Frame

            start, end = (float(at) for at in self.exposures[len(frames) // 2])
            lines.append(Frame(frames[len(frames) // 2], None, (start, end))._repr_html_())
        if len(events):
            middle = int(events["t"][len(events) // 2])
            part = events[np.searchsorted(events["t"], middle - 5000) : np.searchsorted(events["t"], middle + 5000)]
            picture, most = _show.event_picture(part["x"], part["y"], part["p"], self.size)
            caption = f"events of {middle / 1000 - 5:.1f} to {middle / 1000 + 5:.1f} ms; full colour: {most}"
            lines.append(_show.image(_show.png(picture), caption, max(2 * self.size[0], 240)))
        return "".join(lines)


def _columns(
    events: Events | None,
    x: npt.ArrayLike | None,
    y: npt.ArrayLike | None,
    t: npt.ArrayLike | None,
    p: npt.ArrayLike | None,
) -> dict[str, npt.NDArray[Any]]:
    """Events as columns, however they are given."""
    found: dict[str, npt.NDArray[Any]] = {}
    if events is None:
        given = {"x": x, "y": y, "t": t, "p": p}
        missing = [name for name, column in given.items() if column is None]
        if missing:
            raise _errors.UsageError(f"error: events need x, y, t and p; missing: {', '.join(missing)}")
        found = {name: np.asarray(column) for name, column in given.items()}
    else:
        fields = events.dtype.names or ()
        for name, known in _NAMES.items():
            own = next((field for field in known if field in fields), None)
            if own is None:
                raise _errors.UsageError(
                    f"error: the events have no field `{name}`; found: {', '.join(fields) or events.dtype}\n"
                    "  hint: give a structured array with x, y, p and t, or the columns x=, y=, t=, p="
                )
            found[name] = events[own]
    lengths = {name: len(column) for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise _errors.UsageError(f"error: columns of events differ in length: {lengths}")
    return found


def _contiguous(
    events: Events,
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16], npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Events as columns of their own."""
    return (
        np.ascontiguousarray(events["x"]),
        np.ascontiguousarray(events["y"]),
        np.ascontiguousarray(events["p"] > 0).view(np.uint8),
        np.ascontiguousarray(events["t"]),
    )


def _bytes(array: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """The bytes of an array, without a copy where it is contiguous."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)


def _options(params: Mapping[str, Any]) -> list[str]:
    """Parameters of a reader as options of the commands that read a recording."""
    options: list[str] = []
    for name, value in params.items():
        option = "--" + name.replace("_", "-")
        if isinstance(value, bool):
            options += [option] if value else []
        elif name == "extent":
            options += [option, f"{value['width']}x{value['height']}"]
        elif name == "shift":
            options += [f"{option}={value.get('right', 0)},{value.get('down', 0)}"]
        elif isinstance(value, Mapping):
            options += [option, str(next(iter(value.values())))]
        elif isinstance(value, (list, tuple)):
            options += [option, ",".join(str(item) for item in value)]
        else:
            options += [f"{option}={value}"]
    return options


def _opened(path: Path, params: dict[str, Any]) -> Recording:
    source = _native.Source.open(path, json.dumps({"path": str(path), **params}))
    if source is None:
        # The command's message names what it is instead.
        command(["inspect", "--json", str(path)])
        raise _errors.UsageError(
            f"error: {path}: this is a stored artefact, no recording\n  hint: pc.run gives its value"
        )
    made = Recording()
    made._path, made._params, made._source = path, params, source
    return made


def open(path: str | os.PathLike[str], **declared: Any) -> Recording:
    """Opens a recording of any format that `inspect` reads (docs/recordings.md): headers only.

    Parameters
    ----------
    path
        A file or folder; its content decides what it is.
    **declared
        What the file does not state, by the names of the readers' parameters (docs/nodes.md):
        `time_unit="us"`, `extent=(width, height)`, `frames="folder"`, `stamps="times.txt"`,
        `exposure="5 ms"`, `stamp="start"`, `transfer="srgb"`, `row_time="0 us"`, `camera="left"` ...

    Raises
    ------
    UsageError
        For a file that is no recording, or a name that is no parameter.
    DataError
        For a file that cannot be read.
    """
    params: dict[str, Any] = {}
    for name, value in declared.items():
        if value is None:
            continue
        if name == "extent" and not isinstance(value, Mapping):
            value = dict(zip(("width", "height"), (int(n) for n in value)))
        elif name in ("frames", "stamps"):
            value = os.path.abspath(value)
        elif name in ("exposure", "row_time", "frame_offset", "start", "end", "zero"):
            value = time_text(value)
        params[name] = value
    whole = Path(os.path.abspath(path))
    if not whole.exists():
        raise _errors.UsageError(f"error: {path}: there is no such file or folder")
    return _opened(whole, params)


def init(
    recording: Recording | str | os.PathLike[str] | Sequence[str | os.PathLike[str]], *, accept: Sequence[str] = ()
) -> Sensor:
    """A sensor description for a recording, as the command `init` proposes it.

    What the files state is taken; what they cannot state is proposed, and stands in `notes` with what
    depends on it.

    Parameters
    ----------
    recording
        A recording, or its files: events, frames, calibrations (.yaml) and biases (.bias).
    accept
        Findings that are no reason to refuse the recording, by their ids, such as `"one_polarity"`.
    """
    if isinstance(recording, Recording):
        files = recording._arguments()
    elif isinstance(recording, (str, os.PathLike)):
        files = [os.fspath(recording)]
    else:
        files = [os.fspath(file) for file in recording]
    manifest = session() / "init.toml"
    described = manifest.with_suffix(".sensor.toml")
    described.unlink(missing_ok=True)
    arguments = ["init", *files, "-o", str(manifest), "--force"]
    arguments += [f"--accept={name}" for name in accept]
    notes = command(arguments, (0, 3))[2]
    if described.exists():
        sensor = Sensor.parse(described.read_text(encoding="utf-8"))
    else:
        whole = recording if isinstance(recording, Recording) else open(files[0])
        sensor = whole.sensor or Sensor()
    sensor.notes = [line for line in notes.splitlines() if line.startswith(("note: ", "set: ", "check: "))]
    return sensor
