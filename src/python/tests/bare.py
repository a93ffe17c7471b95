"""Installs a wheel in a fresh environment and uses it where the system's libhdf5 cannot be found.

`python bare.py WHEEL`; `make wheel` calls it. No test of pytest: it needs a wheel.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

USE = """
import numpy as np, photocurrent as pc, sys
sensor = pc.Sensor(sys.argv[1])
light = pc.scene("pellet", sensor, width=16, height=12, duration="30 ms", illuminance="800 lx")
recording = pc.simulate(light)
assert pc.open(recording.to("made.h5")).events.shape == recording.events.shape
assert np.isfinite(pc.solve(recording).render(rate=1000).dn).all()
loaded = [line.split()[-1] for line in open("/proc/self/maps") if "hdf5" in line]
inside = [path for path in loaded if "photocurrent" in path]
assert loaded and len(inside) == len(loaded), sorted(set(loaded))
print("libhdf5 is", sorted({path.rsplit("/", 1)[-1] for path in loaded}))
"""


def main(wheel: Path) -> None:
    """Installs and uses the wheel."""
    sensor = Path(__file__).resolve().parents[3] / "data/sensors/hybrid.toml"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", f"{folder}/venv"], check=True)
        python = f"{folder}/venv/bin/python"
        subprocess.run([python, "-m", "pip", "install", "-q", wheel.resolve()], check=True)
        found = subprocess.run(["find", f"{folder}/venv", "-name", "*.so*"], capture_output=True, text=True)
        for library in (line for line in found.stdout.splitlines() if "photocurrent" in line):
            needed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
            outside = [line for line in needed.splitlines() if "hdf5" in line and folder not in line]
            assert not outside, f"{library} takes libhdf5 from the system: {outside}"
        subprocess.run([python, "-c", USE, sensor], cwd=folder, check=True)
        subprocess.run([f"{folder}/venv/bin/photocurrent", "--version"], check=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
