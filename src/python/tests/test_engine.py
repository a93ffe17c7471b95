"""The same engine as the command's: digests, cache, manifests."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import photocurrent as pc

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def digests(outcome: str) -> dict[str, str]:
    """Digests of all outputs in the JSON of a run."""
    return {
        f"{task['node']}.{port}": output["digest"]
        for task in json.loads(outcome)["tasks"]
        for port, output in task["outputs"].items()
    }


def test_the_same_bits_as_the_command(recording: pc.Recording, tmp_path: Path, cli: Command) -> None:
    tracks = pc.solve(recording)
    frames = tracks.render(rate="2 kHz", exposure="100 us", end="30 ms")
    (tmp_path / "written.toml").write_text(frames.manifest())
    # A cache of its own: the command computes everything again.
    done = cli("run", tmp_path / "written.toml", "--json", "--quiet", "--cache", tmp_path / "other",
               "--out", tmp_path / "out")
    found = digests(done.stdout)
    assert found["solve.tracks"] == tracks.digest
    assert found["render.frames"] == frames.digest


def test_arrays_give_the_bits_of_the_file(recording: pc.Recording, sensor: pc.Sensor, tmp_path: Path) -> None:
    stamps = recording._in_ns()
    arrays = pc.Recording(stamps, frames=recording.frames, exposures=recording.exposures,
                          row_time=recording.row_time, size=recording.size, time_unit="ns")
    of_file = pc.open(arrays.to(tmp_path / "file.h5"))
    assert pc.solve(arrays, sensor).digest == pc.solve(of_file, sensor).digest


def test_results_are_kept(recording: pc.Recording, tmp_path: Path, cli: Command) -> None:
    first = pc.solve(recording)
    (tmp_path / "m.toml").write_text(first.manifest())
    again = json.loads(cli("run", "m.toml", "--json", "-q", "--cache", tmp_path / "cache").stdout)
    assert (again["executed"], again["failed"]) == (0, 0), "what Python ran is in the command's cache"


def test_a_manifest_runs_with_values_laid_over(root: Path) -> None:
    set_ = {"nodes.scene.params.width": 16, "nodes.scene.params.height": 12,
            "nodes.scene.params.duration": "20 ms", "nodes.render_all.params.end": "18 ms"}
    done = pc.run(root / "pipelines/quickstart.toml", set_, to="render_all", out="out")
    frames = done.get("render_all.frames")
    assert frames.dn.shape == (18, 12, 16) and done.variants == ["base"]
    assert done.get("sensor.sensor") == pc.Sensor(root / "data/sensors/hybrid.toml")
    assert done.digest("render_all.frames") == frames.digest and (Path("out") / "run.json").exists()


def small(root: Path) -> pc.Pipeline:
    p = pc.Pipeline(seed=7, about="a test", folder=root)
    sensor = p.add("sensor", "read/sensor", path="data/sensors/hybrid.toml")
    scene = p.add("scene", "simulate/scene", {"sensor": sensor}, scene="pellet", width=16, height=12,
                  duration="30 ms", illuminance="800 lx")
    recording = p.add("recording", "simulate/sensor", {"light": scene.light, "sensor": sensor})
    streams = {"events": recording.events, "frames": recording.frames, "sensor": sensor}
    solve = p.add("solve", "solve/paper", streams, front_end="low_pass")
    render = p.add("render", "render/rows", {"tracks": solve.tracks, "sensor": sensor}, end="28 ms")
    p.add("psnr", "score/psnr", {"frames": render.frames, "truth": scene.truth, "sensor": sensor})
    return p


def test_a_pipeline_is_its_manifest(root: Path, tmp_path: Path, cli: Command) -> None:
    p = small(root)
    done = p.run()
    path = p.write(tmp_path / "p.toml")
    found = digests(cli("run", path, "--json", "-q", "--cache", tmp_path / "other").stdout)
    assert found["render.frames"] == done.digest("render.frames")
    score = done.get("psnr")
    assert isinstance(score, pc.Score) and 10 < score.pooled["psnr_db"] < 60
    assert len(score.frames["psnr_db"]) == len(done.get("render.frames"))
    assert "flowchart" in p.graph() or "graph" in p.graph()


def test_an_ablation(root: Path) -> None:
    p = small(root)
    p.axis("front_end", on={}, off={"solve.front_end": "ideal"})
    p.compare("psnr.psnr_db", front_end="on")
    done = p.run()
    assert done.variants == ["front_end=on", "front_end=off"]
    values = {line["variant"]: line["value"] for line in done.metrics if line["metric"] == "psnr_db"}
    assert set(values) == set(done.variants) and values["front_end=on"] != values["front_end=off"]
    assert "gain" in done.table


def test_render_at_instants_is_render_at_a_rate(recording: pc.Recording) -> None:
    tracks = pc.solve(recording)
    steady = tracks.render(rate=1000, exposure="200 us", start="5 ms", end="12 ms")
    chosen = tracks.render(times=steady.times, exposure="200 us")
    assert np.array_equal(chosen.exposures, steady.exposures) and chosen.scale == steady.scale
    assert np.allclose(chosen.dn, steady.dn, rtol=1e-5)
    assert steady.sigma is not None and chosen.sigma is not None
    # They are kept in steps of 0.8 %, of another scale each.
    assert np.allclose(chosen.sigma, steady.sigma, rtol=0.01)
    part = tracks.render(times=steady.times, exposure="200 us", roi=(3, 2, 8, 5))
    assert np.array_equal(part.dn, chosen.dn[:, 2:7, 3:11])


def test_methods_side_by_side(recording: pc.Recording) -> None:
    tracks = pc.solve(recording)
    ours = tracks.render(rate=1000, end="35 ms")
    refined = pc.refine(tracks).render(rate=1000, end="35 ms")
    scores = {"map": pc.score(ours, recording, sensor=recording.sensor)}
    scores["refined"] = pc.score(refined, recording, sensor=recording.sensor)
    for name in ("edi", "cf", "akf", "repeat"):
        frames = pc.baseline(name, recording, rate=1000, end="35 ms")
        assert frames.dn.shape == ours.dn.shape, name
        scores[name] = pc.score(frames, recording, sensor=recording.sensor)
    assert float(scores["map"]) > float(scores["repeat"])
    assert scores["map"].times.shape == (len(ours),) and scores["map"].units == {"psnr_db": "dB"}


def test_scores_of_arrays() -> None:
    random = np.random.default_rng(4)
    truth = random.uniform(20, 200, (3, 12, 16)).astype(np.float32)
    frames = truth + np.float32(2.0)
    score = pc.score(frames, truth, peak_dn=255.0)
    assert score.pooled["psnr_db"] == pytest.approx(20 * np.log10(255 / 2.0), abs=1e-4)
    with pytest.raises(pc.UsageError, match="shape"):
        pc.score(frames, truth[:2])


def test_tracks_are_arrays(recording: pc.Recording) -> None:
    tracks = pc.solve(recording)
    t, photocurrent, sigma = tracks.pixel(5, 7)
    offsets, all_t, all_photocurrent, _ = tracks.columns()
    own = slice(int(offsets[7 * 24 + 5]), int(offsets[7 * 24 + 6]))
    assert np.array_equal(all_t[own] / 1000, t) and np.array_equal(all_photocurrent[own], photocurrent)
    assert sigma is not None and np.all(sigma > 0) and np.all(np.diff(t) > 0)
    assert tracks.maps()["status"].shape == (16, 24)


def test_a_film_of_arrays_becomes_events(sensor: pc.Sensor) -> None:
    ramp = np.linspace(0.2, 0.8, 40, dtype=np.float64)
    film = np.repeat(ramp[:, None, None], 8, axis=1).repeat(10, axis=2)
    recording = pc.simulate(film, sensor, rate=1000, film={"illuminance": "1000 lx"})
    events = recording.events
    # A rise by a factor of 4 over thresholds of 0.2: about seven ON events a pixel, hardly any OFF.
    on, pixels = int((events["p"] == 1).sum()), 80
    assert 4 * pixels < on < 9 * pixels and (events["p"] == 0).sum() < 0.05 * on
    eight = pc.film((film * 255).astype(np.uint8), sensor, 1000, transfer="linear")
    assert pc.simulate(eight).size == (10, 8)
    colour = np.repeat((film * 255).astype(np.uint8)[..., None], 3, axis=-1)
    assert pc.simulate(pc.film(colour, sensor, 1000)).size == (10, 8)


def test_a_diagnosis(recording: pc.Recording) -> None:
    found = pc.diagnose(recording, direct=True)
    assert found.verdict and found.summary and isinstance(found.findings, list)
    assert "<html" in found.page().text and "iframe" in found.page()._repr_html_()
    found.to("folder")
    assert json.loads((Path("folder") / "diagnosis.json").read_text()) == found.report


def test_a_proposed_description(root: Path) -> None:
    sensor = pc.init(pc.open(root / "data/recordings/davis346_cradle.aedat4"))
    assert sensor.comparator.threshold_on > 0 and sensor.notes


def test_progress_is_reported(recording: pc.Recording) -> None:
    heard: list[pc.Progress] = []
    with pc.settings(progress=heard.append):
        pc.solve(recording)
    ends = {step.node: step.end for step in heard if step.end is not None}
    assert ends.get("solve") == "executed" and all(step.done <= step.total or not step.total for step in heard)
