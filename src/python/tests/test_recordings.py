"""Files and arrays in, arrays out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import photocurrent as pc

Columns = dict[str, np.ndarray]


def test_arrays_come_back_as_they_are(stars: Columns) -> None:
    recording = pc.Recording(**stars, size=(40, 30))
    events = recording.events
    assert events.dtype == pc.EVENT and events.dtype.itemsize == 16
    for name, column in stars.items():
        assert np.array_equal(events[name], column), name


def test_events_may_be_structured_out_of_order_and_signed(stars: Columns) -> None:
    shuffled = np.random.default_rng(1).permutation(len(stars["t"]))
    dtype = [("timestamp", "<f8"), ("x", "<i4"), ("y", "<i4"), ("polarity", "<i1")]
    given = np.zeros(len(shuffled), dtype)
    for field, name in (("timestamp", "t"), ("x", "x"), ("y", "y")):
        given[field] = stars[name][shuffled]
    given["polarity"] = 2 * stars["p"][shuffled] - 1
    events = pc.Recording(given).events
    assert np.array_equal(events["t"], stars["t"])
    key = lambda e, p: sorted(zip(e["t"].tolist(), e["x"].tolist(), e["y"].tolist(), p.tolist()))
    assert key(events, events["p"]) == key(stars, stars["p"])


def test_nanoseconds_are_kept_in_files(stars: Columns, tmp_path: Path) -> None:
    stamps = stars["t"] * 1000 + 123
    pc.Recording(**{**stars, "t": stamps}, time_unit="ns").to(tmp_path / "fine.h5")
    again = pc.open(tmp_path / "fine.h5")
    assert np.array_equal(next(iter(again.chunks(10**6, unit="ns")))["t"], stamps)
    assert np.array_equal(again.events["t"], stamps // 1000)


@pytest.mark.parametrize("ending", ["h5", "raw", "csv"])
def test_every_format_that_is_written_is_read_back(stars: Columns, tmp_path: Path, ending: str) -> None:
    # EVT3 has no pixel (0, 0) more than once a stamp; the first stamp becomes 0.
    path = pc.Recording(**stars, size=(40, 30)).to(tmp_path / f"file.{ending}")
    again = pc.open(path, **({"time_unit": "us", "extent": (40, 30)} if ending == "csv" else {}))
    assert again.size == (40, 30)
    zero = stars["t"][0] if ending != "h5" else 0
    assert np.array_equal(again.events["t"], stars["t"] - zero)
    rows = lambda e: sorted(zip(e["t"].tolist(), e["x"].tolist(), e["y"].tolist(), e["p"].tolist()))
    assert rows(again.events) == rows({**stars, "t": stars["t"] - zero})


def test_a_real_file_has_what_inspect_says(root: Path) -> None:
    recording = pc.open(root / "data/recordings/davis346_traffic.aedat4")
    assert len(recording.events) == 78_830 and recording.frames.shape == (59, 260, 346)
    found = recording.inspect()
    assert found["survey"]["events"]["count"] == 78_830 and "78,830" in found.text
    assert recording.exposures.shape == (59, 2) and np.all(np.diff(recording.exposures[:, 0]) > 0)
    assert np.all(np.diff(recording.events["t"]) >= 0) and recording.frames.dtype == np.float32


def test_pieces_are_the_whole(root: Path) -> None:
    recording = pc.open(root / "data/recordings/davis346_traffic.aedat4")
    pieces = list(recording.chunks(10_000))
    assert [len(piece) for piece in pieces] == [10_000] * 7 + [8_830]
    assert np.array_equal(np.concatenate(pieces), recording.events)


def test_events_are_those_of_the_engine(root: Path) -> None:
    path = root / "data/recordings/davis346_cradle.aedat4"
    pipeline = pc.Pipeline()
    pipeline.add("recording", "read/aedat4", path=path)
    engine = pipeline.run().get("recording.events")
    events = pc.open(path).events
    order = lambda e: np.lexsort((e["x"], e["y"], e["t"]))
    assert np.array_equal(engine[order(engine)], events[order(events)])


@pytest.mark.parametrize("source", ["file", "arrays"])
def test_a_window_and_a_part(root: Path, source: str) -> None:
    whole = pc.open(root / "data/recordings/davis346_traffic.aedat4")
    if source == "arrays":
        whole = pc.Recording(whole.events, frames=whole.frames, exposures=whole.exposures, size=whole.size)
    part = whole.window("1 s", 1_200_000).crop(205, 156, 60, 40)
    events, spans = whole.events, whole.exposures
    inside = (events["t"] >= 1_000_000) & (events["t"] < 1_200_000)
    inside &= (events["x"] >= 205) & (events["x"] < 265) & (events["y"] >= 156) & (events["y"] < 196)
    assert len(part.events) == inside.sum() > 100
    assert np.array_equal(part.events["x"], events["x"][inside] - 205)
    kept = (spans[:, 0] >= 1_000_000) & (spans[:, 1] <= 1_200_000)
    assert np.array_equal(part.frames, whole.frames[kept][:, 156:196, 205:265])
    assert np.array_equal(part.exposures, spans[kept]) and part.size == (60, 40)


def test_frames_of_arrays_reach_the_engine(tmp_path: Path, stars: Columns) -> None:
    frames = np.random.default_rng(2).uniform(0, 200, (3, 30, 40)).astype(np.float32)
    frames[1, 2, 3] = np.nan
    exposures = [[0, 10_000], [30_000, 40_000], [60_000, 70_000.5]]
    recording = pc.Recording(**stars, frames=frames, exposures=exposures, row_time="10 us", size=(40, 30))
    again = pc.open(recording.to(tmp_path / "all.h5"))
    assert np.array_equal(again.frames, frames, equal_nan=True)
    assert np.array_equal(again.exposures, np.array(exposures)) and again.row_time == 10.0


def test_a_simulated_recording_keeps_its_description_and_truth(
    recording: pc.Recording, sensor: pc.Sensor, tmp_path: Path
) -> None:
    assert recording.sensor == sensor and recording.size == (24, 16)
    events, frames = recording.events, recording.frames
    again = pc.open(recording.to(tmp_path / "made.h5"))
    assert np.array_equal(again.events, events) and again.sensor == sensor and len(events) > 500
    assert np.array_equal(again.frames, frames) and np.array_equal(again.exposures, recording.exposures)
    truth = recording.truth
    assert truth is not None and truth.dn.shape[1:] == (16, 24)
    assert "frames" in json.dumps(recording.inspect())


def test_reading_without_a_size_finds_one(stars: Columns) -> None:
    recording = pc.Recording(**stars)
    assert recording.size == (int(stars["x"].max()) + 1, int(stars["y"].max()) + 1)
    with pytest.raises(pc.UsageError, match="size"):
        _ = pc.Recording().size
