#!/usr/bin/env python3
"""Reads recordings with this project and with other programs, in one run: do they agree, and how fast are they?

    cargo build --release -p photocurrent-formats --example decode
    pip install numpy faery expelliarmus evlib aedat evt3      # as many of them as you like
    python3 src/formats/benches/peers.py FILE...

For each file and program it prints the number of events, ON events, first and last stamp (us, in the file's order), the
largest stamp, the sum over all events of t + 3 x + 5 y + 7 on (modulo 2^64) and events per second: the fastest of five readings in
one process, from opening the file to columns in memory. A program that is not installed, or does not read the format, is named and passed over.
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


def ours(path):
    """The example binary of this crate."""
    root = os.path.dirname(os.path.abspath(__file__)) + "/../../.."
    binary = os.environ.get("DECODE") or os.path.join(os.environ.get("CARGO_TARGET_DIR", root + "/target"), "release/examples/decode")
    text = subprocess.run([binary, path], capture_output=True, text=True, check=True).stdout
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


def peer(name, read, path):
    import numpy as np

    t, x, y, on, seconds = read(path)
    sums = [int(np.sum(np.asarray(column), dtype=np.int64)) for column in (t, x, y, on)]
    total = (sums[0] + 3 * sums[1] + 5 * sums[2] + 7 * sums[3]) & MASK
    line(name, len(t), sums[3], int(t[0]), int(t[-1]), int(np.max(t)), total, seconds)


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    for path in sys.argv[1:]:
        print(path)
        try:
            line("photocurrent", *ours(path))
        except (OSError, ValueError, subprocess.CalledProcessError) as error:
            print(f"  photocurrent   {error}")
        for read in (faery, expelliarmus, evlib, evt3, aedat):
            name = read.__name__
            try:
                importlib.import_module(name)
                importlib.import_module("numpy")
            except ImportError:
                print(f"  {name:14} is not installed")
                continue
            # What others raise for a file that they do not read is theirs to choose.
            try:
                peer(name, read, path)
            except BaseException as error:  # noqa: BLE001
                if isinstance(error, KeyboardInterrupt):
                    raise
                print(f"  {name:14} does not read it: {str(error)[:100]}")


if __name__ == "__main__":
    main()
