"""The package: its types, its command, its pages."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import photocurrent as pc

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def test_the_command_comes_with_the_package(cli: Command) -> None:
    assert cli("--version").stdout.split()[-1] == pc.__version__
    assert "solve/map" in cli("nodes").stdout
    module = subprocess.run([sys.executable, "-m", "photocurrent", "--version"], capture_output=True, text=True)
    assert module.returncode == 0 and module.stdout == cli("--version").stdout


def test_the_sources_are_typed(root: Path) -> None:
    whole = [root / "src/python/photocurrent"]
    done = subprocess.run([sys.executable, "-m", "mypy", "--strict", *whole], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_stub_of_the_compiled_part_is_right(root: Path, tmp_path: Path) -> None:
    allowed = tmp_path / "allowed"
    # Names of the interpreter's own, of every compiled class.
    allowed.write_text("photocurrent._native.__all__\n.*__doc__\n.*__module__\n.*_Columns\n.*_Frames\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "photocurrent._native", "--allowlist", allowed,
         "--ignore-unused-allowlist"],
        cwd=tmp_path, capture_output=True, text=True,
    )
    assert done.returncode == 0, done.stdout


def test_every_public_name_says_what_it_is() -> None:
    for name in pc.__all__:
        thing = getattr(pc, name)
        if not (inspect.isclass(thing) or inspect.isfunction(thing)):
            continue
        assert inspect.getdoc(thing), name
        members = vars(thing).items() if inspect.isclass(thing) else ()
        for member, value in members:
            is_code = inspect.isfunction(value) or isinstance(value, (property, classmethod))
            if not member.startswith("_") and is_code:
                assert inspect.getdoc(getattr(thing, member)), f"{name}.{member}"


def test_pictures_show_themselves(recording: pc.Recording) -> None:
    frames = pc.solve(recording).render(rate=1000, end="10 ms")
    picture = frames[3]._repr_png_()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    text = frames._repr_html_()
    assert text.count("<img") == 6 and "standard deviation" in text and "DN" in text
    assert "<img" in recording._repr_html_()
    assert np.asarray(frames).shape == frames.dn.shape and len(frames[2:5]) == 3


def test_a_written_picture_is_read_by_another_library(recording: pc.Recording) -> None:
    image = pytest.importorskip("matplotlib.image")
    import io

    frame = pc.solve(recording).render(rate=1000, end="5 ms")[2]
    read = image.imread(io.BytesIO(frame._repr_png_()), format="png")
    assert read.shape[0] == 16 and read.shape[1] == 24 + 16


def test_descriptions_are_texts_dicts_and_attributes(root: Path) -> None:
    sensor = pc.Sensor(root / "data/sensors/hybrid.toml")
    assert sensor.comparator.threshold_on == 0.2 and sensor.front_end.tau_0 == "20 us"
    assert sensor.effects.leak_events is None and sensor.name == "hybrid, indoor"
    changed = sensor.changed(comparator={"threshold_on": 0.3}, effects={"leak_events": {"rate": "0.1 Hz"}})
    assert changed.effects.leak_events.rate == "0.1 Hz" and sensor.comparator.threshold_on == 0.2
    assert pc.Sensor.parse(changed.to_toml()) == changed and pc.Sensor(changed.to_dict()) == changed
    changed.comparator.threshold_on = 0.2
    del changed.effects["leak_events"]
    assert changed == sensor
    assert json.dumps(sensor.to_dict())


def test_the_reference_is_what_the_docstrings_say(root: Path) -> None:
    done = subprocess.run(
        [sys.executable, root / "src/python/reference.py"], capture_output=True, text=True, check=True
    )
    page = root / "docs/python/reference.md"
    again = "python src/python/reference.py > docs/python/reference.md"
    assert page.read_text(encoding="utf-8") == done.stdout, f"the page is old: {again}"


def test_the_code_of_the_notebooks_is_typed(root: Path, tmp_path: Path) -> None:
    for notebook in sorted((root / "docs/python").glob("*.ipynb")):
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        assert all(not cell.get("outputs") for cell in cells), f"{notebook.name}: cells are kept without outputs"
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        (tmp_path / f"{notebook.stem}.py").write_text("\n\n".join(code) + "\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", *tmp_path.glob("*.py")],
        cwd=root, capture_output=True, text=True,
    )
    assert done.returncode == 0, done.stdout
