"""Reads files of photocurrent: recordings, rendered frames, tracks. Needs numpy and h5py; `as_xarray` needs xarray.

    import photocurrent_files as pf
    recording = pf.recording("scene.h5")
    tracks = pf.Tracks(pf.output("out/quickstart", "solve_all", "tracks"))
    t_ns, photocurrent = tracks.pixel(64, 48)
"""

import json
from pathlib import Path

import h5py
import numpy as np


def frames(path):
    """Frames of a recording, of frames.h5 or of the cache: DN [frame, row, column(, channel)], exposures of row 0 in ns, row time in ns."""
    with h5py.File(path) as file:
        data = file["frames/dn"]
        dn = data[()]
        if "scale_factor" in data.attrs:
            dn = data.attrs["add_offset"] + data.attrs["scale_factor"] * dn
        if "frames/exposure_start" in file:
            start, end = file["frames/exposure_start"][()], file["frames/exposure_end"][()]
            row_time = int(file["frames"].attrs["row_time_ns"])
        else:  # in the cache, where the channels of a pixel are neighbours in its row
            meta = next(iter(json.loads(file["meta"][()]).values()))
            start, end = (np.array([exposure[key] for exposure in meta["times"]["exposures"]]) for key in ("start", "end"))
            row_time = meta["times"]["row_time_ns"]
            if meta["colour"] == "rgb":
                dn = dn.reshape(*dn.shape[:2], -1, 3)
    return {"dn": dn, "start_ns": start, "end_ns": end, "row_time_ns": row_time}


def recording(path):
    """Events (x, y, p, t and, where recorded, t_in), frames, and the nominal sensor description as TOML text; None for what is not there."""
    with h5py.File(path) as file:
        events = {name: column[()] for name, column in file["events"].items()} if "events" in file else None
        sensor = file["sensor"][()].decode() if "sensor" in file else None
        has_frames = "frames" in file
    return {"events": events, "frames": frames(path) if has_frames else None, "sensor": sensor}


def output(run_folder, node, port):
    """The file in the cache that holds an output of a run: output("out/quickstart", "solve_all", "tracks")."""
    run = json.loads((Path(run_folder) / "run.json").read_text())
    task = next(task for task in run["tasks"] if task["label"] == node)
    return Path(run_folder) / run["cache"] / "data" / (task["outputs"][port]["digest"] + ".h5")


class Tracks:
    """The photocurrent of every pixel over time, as knots; between them it holds or goes over linearly in its logarithm."""

    def __init__(self, path):
        with h5py.File(path) as file:
            self.meta = json.loads(file["meta"][()])["tracks"]
            self.t, self.photocurrent = file["tracks/t"][()], file["tracks/photocurrent"][()]
            self.offsets = file["tracks/pixel_offsets"][()].astype(np.int64)

    def pixel(self, x, y):
        """Times of the knots in ns, and the photocurrent there."""
        at = y * self.meta["extent"]["width"] + x
        knots = slice(self.offsets[at], self.offsets[at + 1])
        return self.t[knots], self.photocurrent[knots].astype(np.float64)

    def at(self, x, y, t_ns):
        """The photocurrent at any instants."""
        t, value = self.pixel(x, y)
        if self.meta.get("between", "hold") == "hold":
            return value[np.maximum(np.searchsorted(t, t_ns, side="right") - 1, 0)]
        return np.exp(np.interp(t_ns, t, np.log(value)))


def as_xarray(pictures):
    """Frames as an xarray.DataArray over the middle of the exposure of row 0, in seconds."""
    import xarray

    middle = (pictures["start_ns"] + pictures["end_ns"]) / 2e9
    return xarray.DataArray(pictures["dn"], dims=("t", "y", "x", "channel")[: pictures["dn"].ndim], coords={"t": middle}, attrs={"units": "DN"})
