"""Errors are exceptions with the command's text; nothing aborts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import photocurrent as pc
from photocurrent import _native

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def test_a_mistake_in_a_manifest_is_shown_as_the_command_shows_it(tmp_path: Path, cli: Command) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text('format = 1\n[nodes.a]\nkind = "solve/mapp"\n[nodes.b]\nkind = "read/sensor"\n')
    with pytest.raises(pc.UsageError) as raised:
        pc.run(path)
    assert raised.value.code == 2
    assert str(raised.value) == cli("run", path, code=2).stderr.strip()
    assert "wrong.toml:3" in str(raised.value) and "solve/map" in str(raised.value)


def test_a_node_that_fails_raises_what_the_command_says(
    root: Path, tmp_path: Path, recording: pc.Recording, cli: Command
) -> None:
    bare = pc.Sensor({"name": "bare"})
    with pytest.raises(pc.UsageError, match="threshold") as raised:
        pc.solve(recording, bare)
    assert "does not state" in str(raised.value)
    broken = tmp_path / "broken.aedat4"
    broken.write_bytes(b"#!AER-DAT4.0\r\n" + b"\0" * 100)
    with pytest.raises(pc.Error) as damaged:
        pc.open(broken).events
    assert "broken.aedat4" in str(damaged.value)


def test_files_that_are_no_recordings(tmp_path: Path, cli: Command) -> None:
    path = tmp_path / "letter.txt"
    path.write_text("Dear reader,\n")
    with pytest.raises(pc.UsageError) as raised:
        pc.open(path)
    assert str(raised.value) == cli("inspect", path, code=2).stderr.strip()
    with pytest.raises(pc.UsageError, match="no such file"):
        pc.open(tmp_path / "none.raw")
    with pytest.raises(pc.UsageError, match="no_such_parameter"):
        pc.open(path, no_such_parameter=1)


def test_a_wrong_description_is_shown_at_its_place(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('format = "photocurrent-sensor/1"\n[comparator]\nthreshold_onn = 0.2\n')
    with pytest.raises(pc.UsageError) as raised:
        pc.Sensor(path)
    assert "s.toml:3" in str(raised.value) and "threshold_on" in str(raised.value)
    with pytest.raises(pc.UsageError):
        pc.Sensor(comparator={"threshold_on": -1.0})
    with pytest.raises(pc.UsageError, match="leek_events"):
        pc.Sensor(effects={"leek_events": {"rate": "0.1 Hz"}})


def test_wrong_arrays_are_refused() -> None:
    column = np.arange(3)
    for arguments, message in [
        ({"x": column, "y": column, "t": column}, "missing: p"),
        ({"x": column, "y": column, "t": column, "p": np.ones(2)}, "differ in length"),
        ({"x": column - 1, "y": column, "t": column, "p": column}, "65535"),
        ({"frames": np.zeros((2, 3, 3))}, "exposures"),
        ({"events": np.zeros(3, [("a", "i4")])}, "no field `x`"),
    ]:
        with pytest.raises(pc.UsageError, match=message):
            pc.Recording(**arguments)  # type: ignore[arg-type]
    outside = pc.Recording(x=[50], y=[1], t=[0], p=[1], size=(40, 30))
    with pytest.raises(pc.UsageError, match="x = 50"):
        outside.to("outside.h5")
    assert not Path("outside.h5").exists()


def test_a_panic_is_an_exception() -> None:
    with pytest.raises(pc.InternalError, match="a panic that was wanted"):
        _native._panic()
    # The interpreter and the engine go on.
    assert _native.command(["--version"])[0] == 0


def test_ctrl_c_stops_a_run(root: Path, tmp_path: Path) -> None:
    script = (
        "import sys, time, photocurrent as pc\n"
        "p = pc.open(sys.argv[1]); s = pc.Sensor(sys.argv[2])\n"
        "def heard(step):\n"
        "    if step.node == 'solve': print('running', flush=True)\n"
        "pc.settings(cache=sys.argv[3], progress=heard)\n"
        "try:\n"
        "    pc.solve(p, s, front_end='ideal')\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', flush=True); sys.exit(7)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, root / "data/recordings/davis346_cradle.aedat4",
         root / "data/sensors/davis346_cradle.toml", tmp_path / "c"],
        stdout=subprocess.PIPE, text=True,
    )
    assert process.stdout is not None and process.stdout.readline() == "running\n"
    os.kill(process.pid, signal.SIGINT)
    rest = process.stdout.read()
    assert process.wait() == 7 and rest.endswith("interrupted\n")


def test_other_threads_run_while_the_engine_works(recording: pc.Recording) -> None:
    turns, done = 0, threading.Event()

    def count() -> None:
        nonlocal turns
        while not done.is_set():
            turns += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    pc.solve(recording)
    during = turns
    done.set()
    thread.join()
    assert during > 20, "the engine does not hold the interpreter"


def test_an_exception_of_the_listener_stops_the_run(recording: pc.Recording) -> None:
    def heard(step: pc.Progress) -> None:
        raise ZeroDivisionError(step.node)

    with pc.settings(progress=heard), pytest.raises(ZeroDivisionError):
        pc.solve(recording)


def test_seeds_that_meet_are_refused(sensor: pc.Sensor) -> None:
    light = pc.scene("fan", sensor, width=8, height=8, duration="10 ms")
    one, other = pc.simulate(light, seed=1), pc.simulate(light, seed=2)
    assert not np.array_equal(one.events, other.events)
    tracks = pc.solve(one)
    with pytest.raises(pc.UsageError, match="seeds"):
        pc.refine(tracks, other)
