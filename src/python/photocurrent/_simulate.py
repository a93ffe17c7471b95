"""Simulated recordings: light, and what a described sensor records of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from photocurrent import _errors, _native, _show
from photocurrent._frames import Frames, frames_of
from photocurrent._graph import Port, Step
from photocurrent._methods import Described
from photocurrent._recording import Recording
from photocurrent._sensor import port_of
from photocurrent._settings import session
from photocurrent._units import Rate, Time, rate as rate_text, time as time_text


class Light:
    """Photocurrent of every pixel over time, of a known scene, before a sensor; and true frames of it."""

    def __init__(self, step: Step, sensor: Port) -> None:
        self._step = step
        self._sensor = sensor

    @property
    def truth(self) -> Frames:
        """True frames, DN of the stated exposure."""
        return frames_of(self._step.port("truth"))

    def __repr__(self) -> str:
        return f"<light of {self._step.kind}>"


def scene(name: str, sensor: Described, **params: Any) -> Light:
    """Light of a moving scene that is known in closed form.

    Parameters
    ----------
    name
        `"pellet"`, `"fan"`, `"checkerboard"`, `"siemens_disk"`, `"texture"` ... (docs/nodes.md, node
        `simulate/scene`).
    sensor
        The sensor that records it: its photocurrent per lux and its gain.
    **params
        Parameters of the node, such as `width=128`, `height=96`, `duration="80 ms"`,
        `illuminance="800 lx"`.
    """
    described = port_of(sensor)
    return Light(Step("simulate/scene", {"scene": name, **params}, {"sensor": described}), described)


def photo(path: str | os.PathLike[str], sensor: Described, **params: Any) -> Light:
    """Light of a still photo that moves as stated (node `simulate/photo`): `speed=2000.0`,
    `rotation="30 rpm"` ..."""
    described = port_of(sensor)
    return Light(Step("simulate/photo", {"path": os.fspath(path), **params}, {"sensor": described}), described)


def film(
    frames: npt.NDArray[Any] | str | os.PathLike[str],
    sensor: Described,
    rate: Rate | None = None,
    **params: Any,
) -> Light:
    """Light of a film: straight lines between its frames.

    Parameters
    ----------
    frames
        An array [frame, y, x], or [frame, y, x, 3] of uint8 in colour; or a folder of pictures, or a Y4M
        file. uint8 and uint16 count from black to full white, and are sRGB unless `transfer` states another curve;
        floats are linear light from 0 to 1, kept in steps of 1/65535.
    sensor
        The sensor that records it.
    rate
        Frames per second at which it was taken; needed unless a Y4M file states it.
    **params
        Parameters of the node `simulate/video` (docs/nodes.md): `illuminance="1000 lx"` on full white,
        `transfer="linear"`, `black=0.01`, `truth_rate="1 kHz"`, `start=`, `duration=`.

    Raises
    ------
    UsageError
        For an array of another shape or type, or without a rate.
    """
    described = port_of(sensor)
    if isinstance(frames, (str, os.PathLike)):
        path = Path(frames)
    else:
        if rate is None:
            raise _errors.UsageError("error: a film from an array needs its rate\n  hint: such as rate=240")
        path, transfer = _stored(np.asarray(frames))
        params = {"transfer": transfer, **params}
    if rate is not None:
        params = {"rate": rate_text(rate), **params}
    return Light(Step("simulate/video", {"path": path, **params}, {"sensor": described}), described)


def _stored(frames: npt.NDArray[Any]) -> tuple[Path, str]:
    """An array as a film in the session's folder, and its transfer curve."""
    is_colour = frames.ndim == 4 and frames.shape[-1] == 3
    if frames.ndim != 3 and not (is_colour and frames.dtype == np.uint8):
        raise _errors.UsageError(
            f"error: a film is an array [frame, y, x], or [frame, y, x, 3] of uint8; found the shape "
            f"{frames.shape} of {frames.dtype}"
        )
    transfer = "srgb"
    if np.issubdtype(frames.dtype, np.floating):
        if not np.all(np.isfinite(frames)) or frames.min() < 0 or frames.max() > 1:
            raise _errors.UsageError("error: a film of floats is linear light within 0 and 1")
        frames, transfer = np.rint(frames * 65535).astype(np.uint16), "linear"
    if frames.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise _errors.UsageError(f"error: a film is of uint8, uint16 or floats, found {frames.dtype}")
    frames = np.ascontiguousarray(frames)
    shape = np.array([*frames.shape, frames.dtype.itemsize], np.int64).view(np.uint8)
    name = _native.digest([("shape", shape), ("film", frames.reshape(-1).view(np.uint8))])[:32]
    path = session() / (f"{name}.film" if is_colour else f"{name}.y4m")
    if path.exists():
        return path, transfer
    if is_colour:
        # Pictures in colour are read as they are; a film file would hold luma and chroma.
        unfinished = path.with_suffix(".unfinished")
        unfinished.mkdir(exist_ok=True)
        for at, picture in enumerate(frames):
            (unfinished / f"{at:06d}.png").write_bytes(_show.png(picture))
        unfinished.rename(path)
        return path, transfer
    deep = "mono" if frames.dtype == np.uint8 else "mono16"
    head = f"YUV4MPEG2 W{frames.shape[2]} H{frames.shape[1]} F1:1 Ip C{deep} XCOLORRANGE=FULL\n"
    stored = frames if frames.dtype == np.uint8 else frames.astype("<u2")
    unfinished = path.with_suffix(".unfinished")
    with unfinished.open("wb") as file:
        file.write(head.encode())
        for picture in stored:
            file.write(b"FRAME\n" + picture.tobytes())
    unfinished.rename(path)
    return path, transfer


def simulate(
    light: Light | npt.NDArray[Any] | str | os.PathLike[str],
    sensor: Described | None = None,
    *,
    rate: Rate | None = None,
    frame_rate: Rate = "120 Hz",
    exposure: Time = "6500 us",
    seed: int = 1,
    film: Mapping[str, Any] | None = None,
    **params: Any,
) -> Recording:
    """What a described sensor records of a light: events and frames, with the effects of its description.

    Parameters
    ----------
    light
        Of `pc.scene`, `pc.photo` or `pc.film`; or the frames of a film, as `pc.film` takes them.
    sensor
        The sensor; that of the light unless given. Its description states thresholds, bandwidth, refractory
        period, noise, mismatch and other effects.
    rate
        Frames per second of a film.
    frame_rate, exposure
        Captured frames per second, and their exposure.
    seed
        Of everything random.
    film
        Parameters of `pc.film` for the frames of a film.
    **params
        Parameters of the node `simulate/sensor` (docs/nodes.md): `latency_spread`, `pixels_per_event_pixel`.

    Returns
    -------
    Recording
        Its events, frames, true frames (`truth`) and description (`sensor`).
    """
    if not isinstance(light, Light):
        if sensor is None:
            raise _errors.UsageError("error: a film needs the sensor that records it\n  hint: sensor=")
        made = globals()["film"]
        light = made(light, sensor, rate, **{"exposure": time_text(exposure), **(film or {})})
    assert isinstance(light, Light)
    described = light._sensor if sensor is None else port_of(sensor)
    settings = {"frame_rate": rate_text(frame_rate), "exposure": time_text(exposure), **params}
    step = Step("simulate/sensor", settings, {"light": light._step.port("light"), "sensor": described}, seed)
    recording = Recording()
    recording._is_simulated = True
    recording._made = {
        "events": step.port("events"),
        "frames": step.port("frames"),
        "truth": light._step.port("truth"),
        "sensor": described,
    }
    return recording
