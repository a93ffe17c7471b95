"""Frames: linear digital numbers with their exposures and, where known, standard deviations."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from photocurrent import _errors, _native, _show
from photocurrent._graph import Graph, Port, Step, available, export

Array = npt.NDArray[np.float32]


class Frame:
    """One picture.

    Attributes
    ----------
    dn : float32 array, [y, x] or [y, x, 3]
        Linear digital numbers; NaN where a value is not known.
    sigma : float32 array of the same shape, or None
        Standard deviation of every value, DN.
    exposure : (float, float)
        Start and end of row 0, us.
    """

    def __init__(self, dn: Array, sigma: Array | None, exposure: tuple[float, float]) -> None:
        self.dn = dn
        self.sigma = sigma
        self.exposure = exposure

    @property
    def time(self) -> float:
        """Middle of its exposure, us."""
        return 0.5 * (self.exposure[0] + self.exposure[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.dn, dtype=dtype) if copy or dtype is not None else self.dn

    def _caption(self, low: float, high: float) -> str:
        length = self.exposure[1] - self.exposure[0]
        text = f"{self.time / 1000:.3f} ms, {length:.0f} us; {low:.0f} to {high:.0f} DN"
        if self.sigma is not None:
            text += f", median standard deviation {float(np.nanmedian(self.sigma)):.1f} DN"
        return text

    def _repr_png_(self) -> bytes:
        low, high = _show.limits(self.dn)
        return _show.png(_show.with_wedge(_show.grey(self.dn, low, high), low, high))

    def _repr_html_(self) -> str:
        low, high = _show.limits(self.dn)
        picture = _show.png(_show.with_wedge(_show.grey(self.dn, low, high), low, high))
        return _show.image(picture, self._caption(low, high), max(2 * self.dn.shape[1], 240))

    def plot(self, ax: Any = None) -> Any:
        """Draws it with matplotlib: values with their colour bar. Gives the axes."""
        from matplotlib import pyplot as plt

        axes = ax if ax is not None else plt.subplots()[1]
        low, high = _show.limits(self.dn)
        shown = axes.imshow(self.dn if self.dn.ndim == 2 else np.clip((self.dn - low) / (high - low), 0, 1),
                            cmap="gray", vmin=low, vmax=high)
        axes.figure.colorbar(shown, ax=axes, label="DN")
        axes.set_title(f"{self.time / 1000:.3f} ms")
        return axes


class Frames:
    """Frames in the order of time.

    Attributes
    ----------
    dn : float32 array, [frame, y, x] or [frame, y, x, 3]
        Linear digital numbers; NaN where a value is not known.
    sigma : float32 array of the same shape, or None
        Standard deviation of every value, DN, where the method estimates one.
    exposures : float64 array, [frame, 2]
        Start and end of row 0, us.
    row_time : float
        Delay from one row to the next, us; 0 is a global shutter.
    scale : float or None
        The exposure, us, of a captured frame that values are scaled to: a virtual frame of 100 us reads as
        one of this length in the same light. None where a value belongs to its own exposure.

    `xarray.DataArray(frames.dn, dims=frames.dims, coords=frames.coords)` makes an xarray of them.
    """

    def __init__(
        self,
        dn: Array,
        exposures: npt.NDArray[np.float64],
        sigma: Array | None = None,
        row_time: float = 0.0,
        scale: float | None = None,
    ) -> None:
        self.dn = dn
        self.exposures = exposures
        self.sigma = sigma
        self.row_time = row_time
        self.scale = scale
        self.digest: str | None = None
        self._port: Port | None = None

    @classmethod
    def _of(cls, value: _native.Value, sigma: _native.Value | None, port: Port | None) -> Frames:
        """What a node gave."""
        count = value.frame_count()
        exposures, row_time_ns, scale_ns = value.times()
        made = cls(
            value.frames(0, count),
            exposures / 1000.0,
            None if sigma is None else sigma.frames(0, count),
            row_time_ns / 1000.0,
            None if scale_ns is None else scale_ns / 1000.0,
        )
        made.digest = value.digest
        made._port = port
        return made

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """Middle of each exposure, us."""
        middles: npt.NDArray[np.float64] = self.exposures.mean(axis=1)
        return middles

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of `dn`."""
        return ("time", "y", "x") if self.dn.ndim == 3 else ("time", "y", "x", "channel")

    @property
    def coords(self) -> dict[str, Any]:
        """Coordinates of `dn` as xarray takes them; `time` in us."""
        found: dict[str, Any] = {
            "time": self.times,
            "y": np.arange(self.dn.shape[1]),
            "x": np.arange(self.dn.shape[2]),
        }
        return found if self.dn.ndim == 3 else {**found, "channel": ["red", "green", "blue"]}

    def __len__(self) -> int:
        return int(self.dn.shape[0])

    @overload
    def __getitem__(self, at: int) -> Frame: ...
    @overload
    def __getitem__(self, at: slice) -> Frames: ...
    def __getitem__(self, at: int | slice) -> Frame | Frames:
        sigma = None if self.sigma is None else self.sigma[at]
        if isinstance(at, slice):
            return Frames(self.dn[at], self.exposures[at], sigma, self.row_time, self.scale)
        start, end = self.exposures[at]
        return Frame(self.dn[at], sigma, (float(start), float(end)))

    def __iter__(self) -> Iterator[Frame]:
        return (self[at] for at in range(len(self)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.dn, dtype=dtype) if copy or dtype is not None else self.dn

    def __repr__(self) -> str:
        size = f"{self.dn.shape[2]} x {self.dn.shape[1]}"
        known = "" if self.sigma is None else ", with standard deviations"
        return f"<{len(self)} frames of {size} pixels{known}>"

    def _repr_html_(self) -> str:
        shown = [int(at) for at in np.linspace(0, len(self) - 1, min(len(self), 6))]
        pictures = "".join(self[at]._repr_html_() for at in dict.fromkeys(shown))
        return f"<p>{len(self)} frames, {len(dict.fromkeys(shown))} of them:</p>{pictures}"

    def manifest(self) -> str:
        """The manifest that makes them, TOML.

        Raises
        ------
        UsageError
            For frames that were made of arrays.
        """
        return Graph([self._made().step]).text()

    def _made(self) -> Port:
        if self._port is None:
            raise _errors.UsageError(
                "error: these frames were made of arrays or are a part of others: there is no node that gives them"
            )
        return self._port

    def to(self, folder: str | os.PathLike[str], sensor: Any = None, **params: Any) -> None:
        """Writes them as 16-bit PNGs with their exposures, as the node `write/frames` does.

        Parameters
        ----------
        folder
            A folder that does not exist yet, or is empty.
        sensor
            The sensor description; states the scale of the pictures.
        **params
            Parameters of `write/frames` (docs/nodes.md), such as `preview=True`.
        """
        from photocurrent._sensor import port_of

        target = Path(folder)
        if target.exists() and any(target.iterdir()):
            raise _errors.UsageError(f"error: {target}: the folder is not empty\n  hint: give another name")
        inputs = {"frames": self._made(), "sensor": None if sensor is None else port_of(sensor)}
        files = export(Step("write/frames", params, inputs))
        shutil.copytree(files, target, dirs_exist_ok=True)


def frames_of(port: Port, sigma: Port | None = None) -> Frames:
    """Runs what frames need, and gives them; `sigma` may be absent."""
    found = available([port] if sigma is None else [port, sigma])
    if found[0] is None:
        raise _errors.DataError(f"error: {port.step.kind} gives no {port.name}")
    return Frames._of(found[0], found[1] if sigma is not None else None, port)


def meta_of(value: _native.Value) -> dict[str, Any]:
    """What is known of a value without its data."""
    meta: dict[str, Any] = json.loads(value.meta())
    return meta
