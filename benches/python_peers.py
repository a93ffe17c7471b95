"""The package next to other Python packages: reading events, and simulating them.

`python benches/python_peers.py [--events 20000000] [--folder out/peers]`

Makes one recording of events that move along rows, in EVT3, AEDAT4 (where faery is installed, whose writer
is used), DSEC's HDF5 and the project's own, and times how long each package takes to give all events as an
array: the best of three, wall and processor time, each package in a process of its own. Then one film is
made into events by `pc.simulate` and by EventCV, with one sensor, and the events are compared pixel by
pixel. Packages that are not installed are left out, with a line that names them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

SIZE = (1280, 720)


def recording(folder: Path, count: int) -> dict[str, Path]:
    """The files, made once."""
    import photocurrent as pc

    folder.mkdir(parents=True, exist_ok=True)
    files = {"evt3": folder / f"{count}.raw", "aedat4": folder / f"{count}.aedat4",
             "dsec": folder / f"{count}.dsec.h5", "recording": folder / f"{count}.h5"}
    if all(file.exists() for file in files.values()):
        return files
    random = np.random.default_rng(1)
    # Edges that move: events of one stamp lie next to each other in a row, as a sensor reads them.
    runs = count // 4
    x = (random.integers(0, SIZE[0] - 8, runs)[:, None] + np.arange(4)).reshape(-1)
    y = random.integers(0, SIZE[1], runs).repeat(4)
    t = np.sort(random.integers(0, 2_000_000, runs)).repeat(4)
    p = random.integers(0, 2, runs).repeat(4)
    whole = pc.Recording(x=x, y=y, t=t, p=p, size=SIZE)
    whole.to(files["recording"], force=True)
    from photocurrent import _native

    for name, to in (("evt3", "evt3"), ("dsec", "dsec")):
        arguments = ["convert", str(files["recording"]), str(files[name]), "--to", to, "--force"]
        code, _, err = _native.command(arguments)
        assert code == 0, err
    if installed("faery"):
        import faery

        events = whole.events
        array = np.zeros(len(events), faery.EVENTS_DTYPE)
        array["t"], array["x"], array["y"], array["on"] = events["t"], events["x"], events["y"], events["p"] > 0
        faery.events_stream_from_array(array, SIZE).to_file(files["aedat4"])
    return files


#: How each package gives all events as arrays; what stands before `; ` is not timed.
READERS = {
    "photocurrent": "import photocurrent as pc; n = len(pc.open(FILE).events)",
    "faery": "import faery; n = len(faery.events_stream_from_file(FILE).to_array())",
    "expelliarmus": "from expelliarmus import Wizard; n = len(Wizard(encoding='evt3').read(FILE))",
    "evlib": "import evlib; n = evlib.load_events(FILE).collect().height",
    "eventcv": "import eventcv; n = len(eventcv.load(FILE))",
}

#: What each package reads, by its documentation.
READS = {
    "evt3": ["photocurrent", "faery", "expelliarmus", "evlib", "eventcv"],
    "aedat4": ["photocurrent", "faery", "evlib", "eventcv"],
    "dsec": ["photocurrent", "evlib", "eventcv"],
    "recording": ["photocurrent"],
}


def measured(code: str) -> dict[str, Any]:
    """Runs code in a process of its own, and times it without its imports."""
    imports, _, work = code.partition("; ")
    program = (
        f"import json, sys, time\n{imports}\nbest = None\nfor _ in range(3):\n"
        "    b, c = time.perf_counter(), time.process_time()\n"
        f"    {work}\n"
        "    spent = (time.perf_counter() - b, time.process_time() - c)\n"
        "    best = spent if best is None or spent < best else best\n"
        "print(json.dumps({'events': n, 'seconds': best[0], 'processor': best[1],"
        " 'MB': int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) // 1024}))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=600)
    if done.returncode != 0:
        return {"failed": (done.stderr.strip().splitlines() or ["no reason given"])[-1][:100]}
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def installed(name: str) -> bool:
    """Is a package there?"""
    import importlib.util

    return importlib.util.find_spec(name) is not None


def reading(files: dict[str, Path]) -> None:
    """Prints how fast each package reads each file."""
    print("| file | package | seconds | processor seconds | M events a processor second | peak MB |")
    print("| --- | --- | --- | --- | --- | --- |")
    for kind, packages in READS.items():
        for package in packages:
            if not installed(package):
                print(f"| {kind} | {package} | not installed | | | |")
                continue
            found = measured(READERS[package].replace("FILE", repr(str(files[kind]))))
            if "failed" in found:
                print(f"| {kind} | {package} | does not read it: {found['failed']} | | | |")
                continue
            rate = found["events"] / max(found["processor"], 1e-9) / 1e6
            print(f"| {kind} | {package} | {found['seconds']:.2f} | {found['processor']:.2f} | {rate:.0f} "
                  f"| {found['MB']} |")


def film(frames: int, size: tuple[int, int]) -> np.ndarray:
    """Bars that move over a textured ground, 8 bits."""
    width, height = size
    random = np.random.default_rng(2)
    ground = random.integers(60, 120, (height, width)).astype(np.uint8)
    x = np.arange(width)[None, :]
    shown = [np.where((x + 3 * k) % 40 < 12, 220, ground) for k in range(frames)]
    return np.stack(shown).astype(np.uint8)


def simulating(folder: Path) -> None:
    """Prints how fast each simulator makes events of one film, and how their events agree."""
    import photocurrent as pc

    size, rate, count = (346, 260), 500, 150
    frames = film(count, size)
    # A bandwidth of 1 / (2 pi 0.8 ms) = 200 Hz in white light (photocurrent 200), slower in the dark.
    sensor = pc.Sensor(
        front_end={"tau_0": "0 us", "alpha": "160 ms"},
        comparator={"threshold_on": 0.2, "threshold_off": 0.2, "reset": "advance"},
        readout={"refractory": "500 us", "latency_min": "1 us"},
        frames={"gain": 850.0, "black_level_dn": 0.0, "saturation_dn": 1023.0, "row_time": "0 us"},
        optics={"photocurrent_per_lux": 0.2},
        effects={"threshold_mismatch": {"sigma": 0.03}, "background_activity": {"rate": "1 Hz"},
                 "leak_events": {"rate": "0.1 Hz"}},
    )

    def ours() -> np.ndarray:
        with pc.settings(cache=folder / f"cache-{time.time_ns()}"):
            light = pc.film(frames, sensor, rate, illuminance="1000 lx")
            return pc.simulate(light, frame_rate="30 fps", exposure="1 ms").events

    def eventcv() -> np.ndarray:
        import eventcv

        made = eventcv.simulate(frames, fps=rate, pos_thres=0.2, neg_thres=0.2, sigma_thres=0.03,
                                cutoff_hz=200, leak_rate_hz=0.1, shot_noise_rate_hz=1.0, refractory_us=500)
        columns = made.numpy()
        events = np.zeros(len(columns), pc.EVENT)
        for at, name in enumerate(("x", "y", "t", "p")):
            events[name] = columns[:, at]
        return events

    print("\n| simulator | events | ON | seconds | processor seconds | M events a processor second |")
    print("| --- | --- | --- | --- | --- | --- |")
    maps = {}
    for name, make in (("photocurrent", ours), ("eventcv", eventcv)):
        if not installed(name):
            print(f"| {name} | not installed | | | | |")
            continue
        begin, busy = time.perf_counter(), time.process_time()
        events = make()
        spent, processor = time.perf_counter() - begin, time.process_time() - busy
        on = events["p"] > 0
        print(f"| {name} | {len(events):,} | {on.mean():.1%} | {spent:.2f} | {processor:.2f} "
              f"| {len(events) / processor / 1e6:.2f} |")
        flat = events["y"].astype(np.int64) * size[0] + events["x"]
        maps[name] = np.bincount(flat, minlength=size[0] * size[1])
    if len(maps) == 2:
        first, second = maps.values()
        print(f"\nevents a pixel: {first.mean():.1f} and {second.mean():.1f}, "
              f"correlation {np.corrcoef(first, second)[0, 1]:.3f}")


def main() -> None:
    """Everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--events", type=int, default=20_000_000)
    parser.add_argument("--folder", type=Path, default=Path("out/peers"))
    options = parser.parse_args()
    reading(recording(options.folder, options.events))
    simulating(options.folder)


if __name__ == "__main__":
    main()
