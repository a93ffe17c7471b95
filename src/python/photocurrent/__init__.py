"""The light behind blurred frames and late events, for people who hold both as arrays.

A hybrid sensor records ordinary frames (blurred, rolling shutter) and events (steps of log light, late). This
package inverts the sensor pixel by pixel and renders sharp frames at any rate, with standard deviations. It
is the command `photocurrent` with arrays in and out: the same engine, the same cache, the same digests.

    import photocurrent as pc
    recording = pc.open("clip.aedat4")
    tracks = pc.solve(recording, pc.init(recording))
    frames = tracks.render(rate=1000)

Times are microseconds on the recording's clock, or texts with a unit such as `"5 ms"`. Frames are linear
digital numbers (DN). docs/python.md is the guide.
"""

from photocurrent import _native
from photocurrent._diagnose import Diagnosis, Finding, Page, Parameter, diagnose
from photocurrent._errors import DataError, Error, InternalError, RunError, UsageError
from photocurrent._frames import Frame, Frames
from photocurrent._graph import Port
from photocurrent._methods import Score, baseline, refine, score, solve
from photocurrent._pipeline import Node, Pipeline, Run, run
from photocurrent._recording import EVENT, Inspection, Recording, init, open
from photocurrent._sensor import Section, Sensor
from photocurrent._settings import Progress, settings
from photocurrent._simulate import Light, film, photo, scene, simulate
from photocurrent._tracks import Tracks

__version__: str = _native.__version__

__all__ = [
    "EVENT",
    "DataError",
    "Diagnosis",
    "Error",
    "Finding",
    "Frame",
    "Frames",
    "Inspection",
    "InternalError",
    "Light",
    "Node",
    "Page",
    "Parameter",
    "Pipeline",
    "Port",
    "Progress",
    "Recording",
    "Run",
    "RunError",
    "Score",
    "Section",
    "Sensor",
    "Tracks",
    "UsageError",
    "baseline",
    "diagnose",
    "film",
    "init",
    "open",
    "photo",
    "refine",
    "run",
    "scene",
    "score",
    "settings",
    "simulate",
    "solve",
]
