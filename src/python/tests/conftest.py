"""What the tests share."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import photocurrent as pc

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every test has a cache and a folder of its own."""
    monkeypatch.chdir(tmp_path)
    with pc.settings(cache=tmp_path / "cache"):
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The project."""
    return ROOT


@pytest.fixture(scope="session")
def sensor() -> pc.Sensor:
    """A described sensor."""
    return pc.Sensor(ROOT / "data/sensors/hybrid.toml")


def made(sensor: pc.Sensor, seed: int = 7) -> pc.Recording:
    """A small simulated recording."""
    light = pc.scene("pellet", sensor, width=24, height=16, duration="40 ms", illuminance="800 lx")
    return pc.simulate(light, frame_rate="120 fps", seed=seed)


@pytest.fixture
def recording(sensor: pc.Sensor) -> pc.Recording:
    """The same."""
    return made(sensor)


@pytest.fixture
def stars() -> dict[str, np.ndarray]:
    """Events at random places and times, as columns in the order of time; us."""
    random = np.random.default_rng(3)
    count = 5000
    return {
        "x": random.integers(0, 40, count),
        "y": random.integers(0, 30, count),
        "t": np.sort(random.integers(0, 90_000, count)),
        "p": random.integers(0, 2, count),
    }


@pytest.fixture(scope="session")
def cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the installed command in a process of its own."""
    program = shutil.which("photocurrent", path=str(Path(__import__("sys").executable).parent))
    assert program is not None, "the command comes with the package"

    def call(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
        whole = [program, *(str(argument) for argument in arguments)]
        done = subprocess.run(whole, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stderr
        return done

    return call
