"""Methods on recordings: the solver, its refinements, baselines, scores."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from photocurrent import _errors, _native
from photocurrent._frames import Frames, frames_of
from photocurrent._graph import Port, Step, evaluate
from photocurrent._recording import Recording
from photocurrent._sensor import Sensor, port_of
from photocurrent._settings import session
from photocurrent._tracks import Tracks, tracks_of
from photocurrent._units import Rate, Time, rate as rate_text, time as time_text

#: A sensor description, or what one is made of.
Described = Sensor | str | os.PathLike[str] | Mapping[str, Any]


def sensor_port(recording: Recording, sensor: Described | None) -> Port:
    """The description that counts: the one given, otherwise the recording's own."""
    if sensor is not None:
        return port_of(sensor)
    own = recording._ports().get("sensor")
    if own is None or recording.sensor is None:
        raise _errors.UsageError(
            "error: there is no sensor description in the recording\n"
            "  hint: give one: pc.Sensor(\"sensor.toml\"), or pc.init(recording), which proposes one"
        )
    return own


def _streams(recording: Recording) -> dict[str, Port]:
    ports = recording._ports()
    return {name: ports[name] for name in ("events", "frames") if name in ports}


def solve(
    recording: Recording, sensor: Described | None = None, *, method: str = "map", **params: Any
) -> Tracks:
    """Solves for the photocurrent of every pixel from its events and frames.

    Parameters
    ----------
    recording
        Events and at least one frame.
    sensor
        The sensor description; the recording's own unless given.
    method
        `"map"`: the MAP estimate, with standard deviations (node `solve/map`).
        `"paper"`: the least squares of Jiang et al., CVPR 2024 (node `solve/paper`).
    **params
        Parameters of the node (docs/nodes.md), such as `front_end="ideal"`, `knot_spacing="500 us"`.

    Raises
    ------
    UsageError
        For a description that does not state what the method needs, naming the fields.
    """
    described = sensor_port(recording, sensor)
    step = Step(f"solve/{method}", params, {**_streams(recording), "sensor": described})
    return tracks_of(step.port("tracks"), described)


def refine(
    tracks: Tracks,
    recording: Recording | None = None,
    sensor: Described | None = None,
    *,
    method: str = "motion",
    **params: Any,
) -> Tracks:
    """Solves tracks again with what neighbouring pixels saw.

    Parameters
    ----------
    tracks
        The first solution.
    recording, sensor
        What it was solved from; found by itself for tracks of `pc.solve`.
    method
        `"motion"`: with neighbours carried along the motion. `"picture"`: with one moving picture as well.
        `"steered"`: smooths tracks of the paper's solver, without solving again.
    **params
        Parameters of the node `refine/<method>` (docs/nodes.md).
    """
    before = tracks._port.step.inputs
    described = port_of(sensor) if sensor is not None else tracks._sensor
    streams: dict[str, Port] = {
        name: before[name][0] for name in ("events", "frames") if name in before
    }
    if recording is not None:
        streams = _streams(recording)
    inputs = {"tracks": tracks._port}
    if method != "steered":
        inputs |= {**streams, "sensor": described}
    return tracks_of(Step(f"refine/{method}", params, inputs).port("tracks"), described)


def baseline(
    method: str,
    recording: Recording,
    sensor: Described | None = None,
    *,
    rate: Rate = 1000.0,
    exposure: Time = "100 us",
    at: Recording | None = None,
    **params: Any,
) -> Frames:
    """Frames by another method, for comparison (docs/baselines.md).

    Parameters
    ----------
    method
        `"edi"` (event-based double integral), `"akf"` (asynchronous Kalman filter), `"cf"` (complementary
        filter) or `"repeat"` (the captured frame nearest in time).
    recording
        Events and frames.
    sensor
        The sensor description; the recording's own unless given.
    rate, exposure
        When virtual frames are exposed, and for how long.
    at
        A recording whose frames' exposures are imitated instead.
    **params
        Parameters of the node `baseline/<method>` (docs/nodes.md), such as `threshold=0.2`.
    """
    inputs: dict[str, Port] = {**_streams(recording), "sensor": sensor_port(recording, sensor)}
    if method == "repeat":
        inputs.pop("events", None)
    if at is not None:
        inputs["at"] = at._ports()["frames"]
    else:
        params = {"rate": rate_text(rate), "exposure": time_text(exposure), **params}
    return frames_of(Step(f"baseline/{method}", params, inputs).port("frames"))


class Score:
    """A score of frames.

    Attributes
    ----------
    pooled : dict
        Values over all frames by metric, such as `psnr_db`.
    frames : dict
        Arrays of values by metric, one a frame.
    times : float64 array
        Middle of each frame's exposure, us.
    units : dict
        Unit of each metric.
    card : str
        What the numbers mean: the metric's definition.
    """

    def __init__(self, value: _native.Value) -> None:
        columns, notes = value.table()
        table = {name: np.asarray(cells) for name, cells in columns}
        is_pooled = table["frame"] < 0
        names = list(dict.fromkeys(str(name) for name in table["metric"]))
        of = {name: table["metric"] == name for name in names}
        self.digest = value.digest
        self.pooled = {name: float(table["value"][of[name] & is_pooled][0]) for name in names
                       if np.any(of[name] & is_pooled)}
        self.frames: dict[str, npt.NDArray[np.float64]] = {
            name: table["value"][of[name] & ~is_pooled] for name in names
        }
        self.units = {name: str(table["unit"][of[name]][0]) for name in names}
        times = table["t_ns"][of[names[0]] & ~is_pooled] if names else np.zeros(0)
        self.times: npt.NDArray[np.float64] = times / 1000.0
        self.card = dict(notes).get("card", "")

    def __float__(self) -> float:
        return next(iter(self.pooled.values()))

    def __repr__(self) -> str:
        return ", ".join(f"{name} {value:.3f} {self.units[name]}".strip() for name, value in self.pooled.items())


def score(
    frames: Frames | npt.ArrayLike,
    truth: Frames | Recording | npt.ArrayLike,
    metric: str = "psnr",
    sensor: Described | None = None,
    **params: Any,
) -> Score:
    """Scores frames against true ones, or against captured frames that were held out.

    Parameters
    ----------
    frames
        Frames of this package, or an array [frame, y, x] or [frame, y, x, 3].
    truth
        What they should be: the simulated recording or its `truth`; an array of the same shape for an array.
    metric
        `"psnr"`, `"ssim"`, `"lpips"` (with `weights=`), `"bew"` or another scorer (docs/nodes.md).
    sensor
        States peak and black level; without, pass `peak_dn=`.
    **params
        Parameters of the node `score/<metric>`, such as `region="moving"`, `peak_dn=255`.

    Raises
    ------
    UsageError
        For frames of which none is exposed when a true one is, or whose values have another scale.
    """
    if isinstance(frames, Frames) and frames._port is not None:
        port = frames._made()
        true = _truth_port(truth)
    else:
        port, true = _arrays(np.asarray(frames, np.float32), np.asarray(truth, np.float32))
    described = None if sensor is None else port_of(sensor)
    inputs = {"frames": port, "truth": true, "sensor": described}
    return Score(evaluate([Step(f"score/{metric}", params, inputs).port("scores")])[0])


def _truth_port(truth: Any) -> Port:
    if isinstance(truth, Recording):
        found = truth._ports().get("truth")
        if found is None:
            raise _errors.UsageError("error: this recording has no true frames: it was not simulated")
        return found
    if isinstance(truth, Frames):
        return truth._made()
    raise _errors.UsageError(
        "error: frames of this package are scored against a simulated recording or its truth\n"
        "  hint: arrays are scored against arrays: pc.score(frames.dn, truth)"
    )


def _arrays(frames: npt.NDArray[np.float32], truth: npt.NDArray[np.float32]) -> tuple[Port, Port]:
    """Frames and truth as a recording in the session's folder: 1 ms apart, of one exposure."""
    if frames.shape != truth.shape:
        raise _errors.UsageError(f"error: frames have the shape {frames.shape}, the truth {truth.shape}")
    start = np.arange(len(frames), dtype=np.int64) * 1_000_000
    exposures = np.stack([start, start + 500_000], axis=1)
    colour = "rgb" if frames.ndim == 4 else "mono"
    both = [(np.ascontiguousarray(values), exposures, 0, colour) for values in (frames, truth)]
    shape = np.array(frames.shape, np.int64).view(np.uint8)
    name = _native.digest([("shape", shape)] + [("dn", v[0].reshape(-1).view(np.uint8)) for v in both])[:32]
    path = session() / f"{name}.h5"
    if not path.exists():
        _native.write_recording(path, frames.shape[2], frames.shape[1], None, both[0], both[1], None)
    step = Step("read/recording", {"path": str(path)})
    return step.port("frames"), step.port("truth")
