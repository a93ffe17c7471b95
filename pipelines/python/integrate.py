"""A method of one's own for `baseline/exec`: the last frame, carried on by the events since its middle.

    python3 integrate.py PHOTOCURRENT_FILES.PY

It runs in a folder with recording.h5 and times_us.txt, and writes pictures/000000.npy ... in DN. Blur, rolling shutter and delays are ignored: it is a baseline.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(sys.argv[1]).parent))
import photocurrent_files as pf  # noqa: E402

recording = pf.recording("recording.h5")
frames, events = recording["frames"], recording["events"]
sensor = tomllib.loads(recording["sensor"])
black = sensor["frames"].get("black_level_dn", 0.0)
# One step of ln photocurrent for each event, in order of time.
step = np.where(events["p"] == 1, sensor["comparator"]["threshold_on"], -sensor["comparator"]["threshold_off"])
middle = (frames["start_ns"] + frames["end_ns"]) // 2

for number, line in enumerate(Path("times_us.txt").read_text().split()):
    t = float(line) * 1000.0
    last = max(np.searchsorted(middle, t, side="right") - 1, 0)
    first, end = np.searchsorted(events["t"], sorted((middle[last], t)))
    change = np.zeros(frames["dn"].shape[1:])
    np.add.at(change, (events["y"][first:end], events["x"][first:end]), step[first:end])
    picture = black + (frames["dn"][last] - black) * np.exp(change if t >= middle[last] else -change)
    np.save(f"pictures/{number:06d}.npy", picture.astype(np.float32))
