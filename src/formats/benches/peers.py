#!/usr/bin/env python3
"""Reads recordings with this project and with other programs, in one run: do they agree, and how fast are they?

    cargo build --release -p photocurrent-formats --example decode
    pip install numpy faery expelliarmus evlib aedat evt3 h5py hdf5plugin pandas rosbags mcap opencv-python-headless   # as many as you like
    python3 src/formats/benches/peers.py [--time-unit s|us] [--rounds N] FILE...

On a machine that does other work too, `--rounds 5` reads with all programs in turn, five times over, and takes the fastest reading of each.
`made.py` writes files of the formats that cameras seldom write themselves.

For each file and program it prints the number of events, ON events, first and last stamp (us, in the file's order), the
largest stamp, the sum over all events of t + 3 x + 5 y + 7 on (modulo 2^64) and events per second: the fastest of five readings in
one process, from opening the file to columns in memory; for frames, their number, the sum of their values and frames per second. A program that is not installed, or does not read the format, is named and passed over.
Set CARGO_TARGET_DIR if the example is elsewhere than in target/, or DECODE to its path.
"""

import importlib
import os
import re
import subprocess
import sys
import time

RUNS = 5
MASK = (1 << 64) - 1


def line(name, n, on, first, last, latest, total, seconds):
    speed = f"{n / seconds / 1e6:9.1f} M/s" if seconds else "        - M/s"
    print(f"  {name:14} {n:>10} events {on:>10} on  {first} .. {last} us (latest {latest})  sum {total:>20}{speed}", flush=True)


UNIT = []


def decoded(path):
    """What the example binary of this crate prints."""
    root = os.path.dirname(os.path.abspath(__file__)) + "/../../.."
    binary = os.environ.get("DECODE") or os.path.join(os.environ.get("CARGO_TARGET_DIR", root + "/target"), "release/examples/decode")
    return subprocess.run([binary, *UNIT, path], capture_output=True, text=True, check=True).stdout


def ours(path):
    text = decoded(path)
    found = re.search(r"events (\d+), on (\d+), first (\S+) us, last (\S+) us, earliest \S+ us, latest (\S+) us\n  sum (\d+)\n  seconds (\S+),", text)
    if not found:
        raise ValueError(text.strip() or "no events")
    n, on, first, last, latest, total, seconds = found.groups()
    whole = lambda us: us.removesuffix(".000")
    return int(n), int(on), whole(first), whole(last), whole(latest), int(total), float(seconds)


def timed(read):
    """The columns that `read` gives, and the shortest time it took."""
    best, columns = None, None
    for _ in range(RUNS):
        start = time.perf_counter()
        raw = read()
        seconds = time.perf_counter() - start
        best, columns = min(best or seconds, seconds), raw
    return columns, best


def faery(path):
    import faery as module
    import numpy as np

    packets, seconds = timed(lambda: list(module.events_stream_from_file(path)))
    events = np.concatenate(packets)
    return events["t"], events["x"], events["y"], events["on"], seconds


def expelliarmus(path):
    import expelliarmus as module

    head = open(path, "rb").read(4096)
    encoding = "dat" if path.endswith(".dat") else "evt3" if re.search(rb"% (evt 3|format EVT3)", head) else "evt2"
    events, seconds = timed(lambda: module.Wizard(encoding=encoding).read(path))
    return events["t"], events["x"], events["y"], events["p"], seconds


def evt3(path):
    import evt3 as module

    # It decodes any bytes.
    if not re.search(rb"% (evt 3|format EVT3)", open(path, "rb").read(4096)):
        raise ValueError("no EVT3")
    events, seconds = timed(lambda: module.decode_file(path))
    return events.timestamp, events.x, events.y, events.polarity, seconds


def evlib(path):
    import evlib as module
    import numpy as np

    def read():
        frame = module.load_events(path)
        return frame.collect() if hasattr(frame, "collect") else frame

    frame, seconds = timed(read)
    return frame["t"].to_physical().to_numpy(), frame["x"].to_numpy(), frame["y"].to_numpy(), (frame["polarity"].to_numpy() > 0).astype(np.uint8), seconds


def aedat(path):
    import aedat as module
    import numpy as np

    packets, seconds = timed(lambda: [packet["events"] for packet in module.Decoder(path) if "events" in packet])
    events = np.concatenate(packets)
    return events["t"], events["x"], events["y"], events["on"], seconds


def columns(t, x, y, p, seconds):
    """Columns with t in us."""
    import numpy as np

    return np.asarray(t, np.int64), x, y, (np.asarray(p) > 0).astype(np.uint8), seconds


def h5py(path):
    import h5py as module

    try:
        import hdf5plugin  # noqa: F401
    except ImportError:
        pass

    def read():
        with module.File(path, "r") as file:
            return [file["events"][name][:] for name in "txyp"] + [int(file["t_offset"][()])]

    (t, x, y, p, offset), seconds = timed(read)
    return columns(t.astype("int64") + offset, x, y, p, seconds)


def is_text(path):
    if not path.endswith((".csv", ".txt")):
        raise ValueError("no text")
    return path.endswith(".csv")


def numpy(path):
    import numpy as module

    if path.endswith(".npz"):

        def archive():
            with module.load(path) as file:
                return [file[name] for name in "txyp"]

        (t, x, y, p), seconds = timed(archive)
        return columns(t, x, y, p, seconds)
    comma = is_text(path)
    scale, kind = (1, "i8") if comma else (1e6, "f8")
    event = module.dtype([("t", kind), ("x", "u2"), ("y", "u2"), ("p", "u1")])
    events, seconds = timed(lambda: module.loadtxt(path, event, delimiter="," if comma else None, skiprows=1))
    return columns(module.rint(events["t"] * scale), events["x"], events["y"], events["p"], seconds)


def pandas(path):
    import numpy as np
    import pandas as module

    comma = is_text(path)
    kinds = {"t": "i8" if comma else "f8", "x": "u2", "y": "u2", "p": "u1"}
    frame, seconds = timed(lambda: module.read_csv(path, sep="," if comma else " ", skiprows=1, names=list("txyp"), dtype=kinds, engine="c"))
    return columns(np.rint(frame["t"].to_numpy() * (1 if comma else 1e6)), frame["x"].to_numpy(), frame["y"].to_numpy(), frame["p"].to_numpy(), seconds)


def joined(x, y, seconds, nanoseconds, p):
    import numpy as np

    x, y, seconds, nanoseconds, p = (np.concatenate(part) for part in (x, y, seconds, nanoseconds, p))
    return [seconds.astype(np.int64) * 1_000_000 + nanoseconds // 1000, x, y, p]


def rosbags(path):
    """The container by rosbags, the fields of `dvs_msgs/EventArray` by numpy: its own reading of messages, one object an event, is far slower."""
    import numpy as np
    from rosbags.rosbag1 import Reader

    def read():
        with Reader(path) as reader:
            event = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
            events = np.concatenate([np.frombuffer(body, event, offset=31) for _, _, body in reader.messages()])
            return joined(*([np.ascontiguousarray(events[name])] for name in ("x", "y", "s", "ns", "p")))

    (t, x, y, p), seconds = timed(read)
    return columns(t, x, y, p, seconds)


def mcap(path):
    """The container by mcap, the fields by numpy, as for `rosbags`."""
    import numpy as np
    from mcap.reader import make_reader

    def read():
        with open(path, "rb") as file:
            columns = [], [], [], [], []
            for _, _, message in make_reader(file).iter_messages():
                # Fields stand at multiples of their own sizes, see `made.py`.
                body = np.frombuffer(message.data + bytes(3), np.uint8, offset=32)
                words, longs = body.view("<u2"), body.view("<u4")
                x, y = words[7::8], words[8::8]
                fields = np.append(words[:1], x[:-1]), np.append(words[1:2], y), longs[1::4], longs[2::4], body[12::16]
                for column, field in zip(columns, fields):
                    column.append(field)
            return joined(*columns)

    (t, x, y, p), seconds = timed(read)
    return columns(t, x, y, p, seconds)


def cv2(path):
    """Frames with OpenCV, as 32-bit floats as ours are: a folder of PNG, or a Y4M film whose luma is taken."""
    import cv2 as module
    import numpy as np

    if os.path.isdir(path):
        files = sorted(f"{path}/{name}" for name in os.listdir(path) if name.endswith(".png"))
        read = lambda: [module.imread(file, module.IMREAD_UNCHANGED).astype(np.float32) for file in files]
    else:

        def read():
            film, frames = module.VideoCapture(path), []
            while True:
                found, frame = film.read()
                if not found:
                    return frames
                frames.append(frame.astype(np.float32))

    frames, seconds = timed(read)
    print(f"  {'cv2':14} {len(frames):>10} frames, sum {sum(float(np.sum(frame, dtype=np.float64)) for frame in frames):.0f} {len(frames) / seconds:9.0f} frames/s")


def frames(path):
    found = re.search(r"frames (\d+) of .*\n  frame values sum (\S+)\n  frame seconds \S+, frames/s (\d+)", decoded(path))
    if found:
        print(f"  {'photocurrent':14} {found[1]:>10} frames, sum {float(found[2]):.0f} {int(found[3]):9} frames/s")


def peer(name, read, path):
    import numpy as np

    t, x, y, on, seconds = read(path)
    sums = [int(np.sum(np.asarray(column), dtype=np.int64)) for column in (t, x, y, on)]
    total = (sums[0] + 3 * sums[1] + 5 * sums[2] + 7 * sums[3]) & MASK
    return len(t), sums[3], int(t[0]), int(t[-1]), int(np.max(t)), total, seconds


PEERS = (faery, expelliarmus, evlib, evt3, aedat, h5py, numpy, pandas, rosbags, mcap)


def compare(path, rounds):
    """Programs in turn, round after round, so that what else the machine does meets all of them; the fastest reading of each counts."""
    found, refused = {}, {}
    for _ in range(rounds):
        for read in (None, *PEERS):
            name = read.__name__ if read else "photocurrent"
            if name in refused:
                continue
            # What others raise for a file that they do not read is theirs to choose.
            try:
                if read:
                    importlib.import_module("numpy")
                    importlib.import_module(name)
                result = peer(name, read, path) if read else ours(path)
                best = min(result[-1], found.get(name, result)[-1])
                found[name] = (*result[:-1], best)
            except BaseException as error:  # noqa: BLE001
                if isinstance(error, KeyboardInterrupt):
                    raise
                refused[name] = "is not installed" if isinstance(error, ImportError) else f"does not read it: {str(error)[:100]}"
    for name, result in found.items():
        line(name, *result)
    for name, why in refused.items():
        print(f"  {name:14} {why}")


def main():
    paths, rounds = sys.argv[1:], 1
    while paths and paths[0] in ("--time-unit", "--rounds"):
        if paths[0] == "--rounds":
            rounds = int(paths[1])
        else:
            UNIT[:] = paths[:2]
        paths = paths[2:]
    if not paths:
        sys.exit(__doc__)
    for path in paths:
        print(path)
        if os.path.isdir(path) or path.endswith(".y4m"):
            for read in (frames, cv2):
                read(path)
        else:
            compare(path, rounds)


if __name__ == "__main__":
    main()
