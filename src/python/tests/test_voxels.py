"""Voxel grids against sums over events that are written down plainly."""

from __future__ import annotations

import numpy as np
import pytest

import photocurrent as pc

Columns = dict[str, np.ndarray]


def plain(stars: Columns, first: float, last: float, bins: int) -> np.ndarray:
    """The grid by its definition: each event, each bin, a triangle of time (Zhu et al., CVPR 2019)."""
    grid = np.zeros((bins, 30, 40))
    for x, y, t, p in zip(stars["x"], stars["y"], stars["t"], stars["p"]):
        at = (bins - 1) * (t - first) / (last - first)
        for bin in range(bins):
            grid[bin, y, x] += (1 if p else -1) * max(0.0, 1.0 - abs(at - bin))
    return grid


def standardised(grid: np.ndarray, ddof: int) -> np.ndarray:
    filled = grid != 0
    done = grid.copy()
    done[filled] = (grid[filled] - grid[filled].mean()) / grid[filled].std(ddof=ddof)
    return done


@pytest.mark.parametrize(("layout", "bins", "ddof"), [("e2vid", 5, 0), ("dsec", 15, 1)])
def test_layouts_over_events(stars: Columns, layout: str, bins: int, ddof: int) -> None:
    grid = plain(stars, stars["t"][0], stars["t"][-1], bins)
    recording = pc.Recording(**stars, size=(40, 30))
    raw = recording.voxels(layout, normalise=False)
    assert raw.dtype == np.float32 and raw.shape == (bins, 30, 40)
    assert np.allclose(raw, grid, atol=1e-4)
    # Cells where events cancel to rounding count as filled in one and empty in the other: left out.
    clear = (np.abs(raw) > 1e-3) | (raw == 0)
    done = recording.voxels(layout)
    assert np.allclose(done[clear], standardised(np.where(raw == 0, 0, grid), ddof)[clear], atol=1e-3)


def test_time_lens_spreads_bins_over_the_window(stars: Columns) -> None:
    inside = (stars["t"] >= 20_000) & (stars["t"] < 60_000)
    part = {name: column[inside] for name, column in stars.items()}
    grid = pc.Recording(**stars, size=(40, 30)).voxels("time_lens", start="20 ms", end="60 ms")
    assert np.allclose(grid, plain(part, 20_000, 60_000, 5), atol=1e-4)


def test_the_number_of_bins(stars: Columns) -> None:
    grid = pc.Recording(**stars, size=(40, 30)).voxels("e2vid", 3, normalise=False)
    assert np.allclose(grid, plain(stars, stars["t"][0], stars["t"][-1], 3), atol=1e-4)
    with pytest.raises(pc.UsageError, match="time_lens"):
        pc.Recording(**stars).voxels("timelens")


def test_grids_go_to_other_libraries_without_a_copy(stars: Columns) -> None:
    grid = pc.Recording(**stars, size=(40, 30)).voxels()
    assert grid.flags.writeable and grid.flags.c_contiguous
    other = np.from_dlpack(grid)
    assert np.shares_memory(grid, other) and np.array_equal(grid, other)


def test_a_window_without_events_is_empty(stars: Columns) -> None:
    grid = pc.Recording(**stars, size=(40, 30)).voxels(start="200 ms", end="300 ms")
    assert not grid.any()
