"""What a refinement does to a recording without truth: how far pixels move that stand still, and whether pictures flicker more.

    photocurrent run pipelines/paper/refinement_clips.toml
    python nodes/refine/training/measure.py out/refinement_clips

Still: pixels without a single event in the whole clip. Flicker: root mean square of a frame less the mean of its two neighbours in time, which smooth
motion hardly has and noise that comes and goes has. Of pictures as they are shown: what is above the saturation of the cameras, 255 DN, is at that.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

SATURATION_DN = 255


def flicker(frames):
    frames = np.minimum(frames, SATURATION_DN)
    return float(np.sqrt(np.nanmean((frames[1:-1] - (frames[:-2] + frames[2:]) / 2) ** 2)))


def measure(before, after, quiet):
    """Largest change of still pixels in DN, the change that 99.9 % of them stay below, and flicker before and after in DN, of still and of other pixels."""
    moved = np.abs(after - before)[:, quiet]
    return {
        "still pixels": float(quiet.mean()),
        "largest change, DN": float(np.nanmax(moved)),
        "99.9 % of changes below, DN": float(np.nanquantile(moved, 0.999)),
        "flicker of still pixels, DN": (flicker(before[:, quiet]), flicker(after[:, quiet])),
        "flicker of other pixels, DN": (flicker(before[:, ~quiet]), flicker(after[:, ~quiet])),
    }


def frames(folder):
    with h5py.File(folder / "frames.h5") as file:
        return file["frames/dn"][:]


def main(folder):
    for events in sorted(folder.glob("**/events_file/recording.h5")):
        place = events.parent.parent
        before, after = frames(place / "map_file"), frames(place / "refined_file")
        quiet = np.ones(before.shape[1:], bool)
        with h5py.File(events) as file:
            quiet[file["events/y"][:], file["events/x"][:]] = False
        print(place.name)
        for name, value in measure(before, after, quiet).items():
            print(f"  {name}: " + (" -> ".join(f"{part:.3f}" for part in value) if isinstance(value, tuple) else f"{value:.3f}"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
