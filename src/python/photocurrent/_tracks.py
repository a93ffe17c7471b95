"""Tracks: the photocurrent of every pixel over time, and frames rendered from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from photocurrent import _native
from photocurrent._frames import Frames, frames_of, meta_of
from photocurrent._graph import Graph, Port, Step, evaluate
from photocurrent._units import Rate, Time, ns, rate as rate_text, time as time_text


class Tracks:
    """The photocurrent of every pixel over time, as the solver found it.

    Attributes
    ----------
    size : (int, int)
        Width and height in pixels.
    span : (float, float)
        The time that it covers, us.
    between : str
        What happens between two knots: `"log_linear"` (the logarithm is linear) or `"hold"`.
    digest : str
        The name of the content: equal to that of the command's artefact.
    """

    def __init__(self, port: Port, sensor: Port, value: _native.Value) -> None:
        self._port = port
        self._sensor = sensor
        self._value = value
        meta = meta_of(value)
        self.digest = value.digest
        self.size: tuple[int, int] = (meta["extent"]["width"], meta["extent"]["height"])
        self.span: tuple[float, float] = (meta["span"]["start"] / 1000.0, meta["span"]["end"] / 1000.0)
        self.between: str = meta["between"]
        self._channels = 3 if meta["colour"] == "rgb" else 1
        self._nominal_us: float = meta["nominal_exposure_ns"] / 1000.0

    def render(
        self,
        rate: Rate | None = None,
        *,
        times: Sequence[float] | npt.NDArray[np.float64] | None = None,
        exposure: Time = "100 us",
        shutter: str = "global",
        start: Time | None = None,
        end: Time | None = None,
        roi: tuple[int, int, int, int] | None = None,
    ) -> Frames:
        """Renders sharp frames, as the node `render/rows` does.

        Parameters
        ----------
        rate
            Frames per second: a number or a text such as `"10 kHz"`, 0.001 Hz to 1 MHz; 1,000 unless given.
        times
            Instead of a rate: the middles of the exposures, us, rising.
        exposure
            Length of the virtual exposure; the picture is the mean light over it.
        shutter
            `"global"`, or `"rolling"` with the sensor's row time; with `times` global.
        start, end
            First instant, and first instant no longer rendered; the recording's unless given.
        roi
            `(x, y, width, height)`: only these pixels. With `times` the whole array is rendered and cut.

        Returns
        -------
        Frames
            Values in DN scaled to the recording's ordinary exposure, with standard deviations where the
            tracks carry them.

        Raises
        ------
        UsageError
            For a window without an instant, or a rolling shutter without a row time.
        """
        inputs = {"tracks": self._port, "sensor": self._sensor}
        if times is not None:
            return self._at(np.asarray(times, np.float64), ns(exposure), inputs, roi)
        params: dict[str, Any] = {"rate": rate_text(1000.0 if rate is None else rate)}
        params |= {"exposure": time_text(exposure), "shutter": shutter}
        params |= {name: time_text(at) for name, at in (("start", start), ("end", end)) if at is not None}
        if roi is not None:
            params["roi"] = dict(zip(("x", "y", "width", "height"), roi))
        step = Step("render/rows", params, inputs)
        return frames_of(step.port("frames"), step.port("sigma"))

    def _at(
        self,
        times: npt.NDArray[np.float64],
        length_ns: int,
        inputs: Mapping[str, Port],
        roi: tuple[int, int, int, int] | None,
    ) -> Frames:
        from photocurrent._recording import Recording

        width, height = self.size
        start_ns = np.rint(times * 1000).astype(np.int64) - length_ns // 2
        exposures = np.stack([start_ns, start_ns + length_ns], axis=1) / 1000.0
        # Frames whose exposures are imitated; their values are not read.
        blank = np.zeros((len(times), height, width), np.float32)
        at = Recording(frames=blank, exposures=exposures, size=self.size)._ports()["frames"]
        step = Step("render/rows", {}, {**inputs, "at": at})
        found = frames_of(step.port("frames"), step.port("sigma"))
        # Read as frames of their own exposure: scaled as those of a steady rate are.
        from photocurrent._sensor import value_of

        black = float(value_of(inputs["sensor"]).frames.black_level_dn or 0.0)
        factor = np.float32(1000.0 * self._nominal_us / length_ns)
        dn = (found.dn - np.float32(black)) * factor + np.float32(black)
        sigma = None if found.sigma is None else found.sigma * factor
        if roi is not None:
            x, y, columns, rows = roi
            dn = dn[:, y : y + rows, x : x + columns]
            sigma = None if sigma is None else sigma[:, y : y + rows, x : x + columns]
        return Frames(dn, found.exposures, sigma, 0.0, self._nominal_us)

    def pixel(
        self, x: int, y: int, channel: int = 0
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float32], npt.NDArray[np.float32] | None]:
        """The knots of one pixel: instants (us), photocurrent, and the standard deviation of its natural
        logarithm where it is known."""
        offsets, t, photocurrent, sigma = self._value.columns(y, y + 1)
        at = x * self._channels + channel
        own = slice(int(offsets[at]), int(offsets[at + 1]))
        return t[own] / 1000.0, photocurrent[own], sigma[own] if sigma.size else None

    def columns(
        self, rows: tuple[int, int] | None = None
    ) -> tuple[
        npt.NDArray[np.uint64], npt.NDArray[np.int64], npt.NDArray[np.float32], npt.NDArray[np.float32]
    ]:
        """All knots of some rows in flat columns: index of every pixel's first knot (row by row) and the
        number of knots; instants, ns; photocurrent; standard deviation of its natural logarithm (empty where
        it is not known)."""
        start, end = rows if rows is not None else (0, self.size[1])
        return self._value.columns(start, end)

    def maps(self) -> dict[str, npt.NDArray[np.float32]]:
        """How the solution went, for tracks of `pc.solve`: planes by name ([y, x]), such as `status` and
        `event_residual` (docs/nodes.md)."""
        names, planes = evaluate([self._port.step.port("map")])[0].planes()
        return dict(zip(names, planes))

    def manifest(self) -> str:
        """The manifest that makes them, TOML: what the command runs with the same result."""
        return Graph([self._port.step]).text()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<tracks of {width} x {height} pixels, {self.span[0] / 1000:.3f} to {self.span[1] / 1000:.3f} ms>"


def tracks_of(port: Port, sensor: Port) -> Tracks:
    """Runs what tracks need, and gives them."""
    ports = [port, port.step.port("map")] if port.step.kind.startswith("solve/") else [port]
    return Tracks(port, sensor, evaluate(ports)[0])
