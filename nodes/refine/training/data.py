"""Training data of both networks: recordings simulated by photocurrent itself, solved, and paired with the truth.

Every recording is a manifest that is written here and run by the program: a picture or a film of moving shapes (never a scene of `simulate/scene`, which
the test scenes are), a sensor drawn at random around data/sensors/hybrid.toml, and a solver that is given the true description of that sensor in half of the cases.
Pictures: photographs that ship with scikit-image (public domain or CC0), and shapes drawn from random numbers.
"""

import subprocess
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import h5py
import numpy as np
from skimage import data as photographs
from skimage import draw, io

ROOT = Path(__file__).resolve().parents[3]
PHOTOGRAPHS = ["astronaut", "brick", "camera", "chelsea", "coffee", "coins", "grass", "gravel", "rocket"]
WIDTH, HEIGHT = 96, 72
FILM_RATE = 4000
FIRST_SEED = 1000  # the project's pipelines use seeds below this one

MANIFEST = """# A training recording.
format = 1

[pipeline]
about = "A simulated recording, solved."
seed  = {seed}

[nodes.sensor]
kind   = "read/sensor"
params = {{ path = "{sensor}", change = {described} }}

[nodes.recorder]
kind   = "read/sensor"
params = {{ path = "{sensor}", change = {recording} }}

[nodes.light]
kind   = "{light}"
in     = {{ sensor = "recorder" }}
params = {{ {params}, duration = "{duration} ms", illuminance = "{lux} lx", truth_rate = "{rate} Hz", exposure = "{exposure} us" }}

[nodes.recording]
kind   = "simulate/sensor"
in     = {{ light = "light.light", sensor = "recorder" }}
params = {{ frame_rate = "{frame_rate} fps", exposure = "{exposure} us" }}

[nodes.solve]
kind   = "solve/map"
in     = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
params = {{ }}

[nodes.map]
kind   = "render/rows"
in     = {{ tracks = "solve.tracks", sensor = "sensor" }}
params = {{ rate = "{rate} Hz", exposure = "100 us", end = "{end} ms" }}

[nodes.edi]
kind   = "baseline/edi"
in     = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
params = {{ rate = "{rate} Hz", exposure = "100 us", end = "{end} ms" }}

[nodes.file]
kind = "write/recording"
in   = {{ events = "recording.events", frames = "recording.frames", truth = "light.truth" }}

[nodes.map_file]
kind   = "write/frames"
in     = {{ frames = "map.frames" }}
params = {{ format = "hdf5_f32" }}

[nodes.sigma_file]
kind   = "write/frames"
in     = {{ frames = "map.sigma" }}
params = {{ format = "hdf5_f32" }}

[nodes.edi_file]
kind   = "write/frames"
in     = {{ frames = "edi" }}
params = {{ format = "hdf5_f32" }}
"""


def photograph(name):
    """A photograph as 8-bit grey."""
    picture = getattr(photographs, name)()
    if picture.ndim == 3:
        picture = picture[..., :3] @ [0.2126, 0.7152, 0.0722]
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def outline(random, radius):
    """Corners of a random shape around the origin: a polygon, a star or nearly a circle."""
    corners = int(random.choice([3, 4, 5, 6, 8, 10, 40]))
    angles = random.uniform(0, 2 * np.pi) + np.linspace(0, 2 * np.pi, corners, endpoint=False)
    rough = random.uniform(0, 0.5) if corners < 40 else 0.0
    reach = radius * (1 - rough * random.random(corners))
    return reach * np.cos(angles), reach * np.sin(angles)


def drawn(random, size=192, fine=3):
    """A picture of overlapping shapes and stripes with sharp edges, on a soft ground; 8-bit grey."""
    rows, columns = np.mgrid[0 : size * fine, 0 : size * fine] / (size * fine)
    slope = random.uniform(-1, 1, 2)
    picture = random.uniform(20, 235) + 40 * (slope[0] * rows + slope[1] * columns)
    for _ in range(int(random.integers(8, 50))):
        x, y = outline(random, fine * random.uniform(5, 50))
        middle = random.uniform(0, size * fine, 2)
        inside = draw.polygon(y + middle[0], x + middle[1], picture.shape)
        if random.random() < 0.3:
            wave = np.sin((inside[0] * random.normal() + inside[1] * random.normal()) / (fine * random.uniform(1, 6)))
            picture[inside] = random.uniform(5, 250) + random.uniform(10, 90) * np.sign(wave)
        else:
            picture[inside] = random.uniform(5, 250)
    picture = picture.reshape(size, fine, size, fine).mean((1, 3))
    return np.clip(picture, 0, 255).astype(np.uint8)


def film(random, ground, folder, frames, fine=3):
    """Shapes that cross a picture that stands still, as a folder of PNG pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    top, left = (int(random.integers(0, side - small + 1)) for side, small in zip(ground.shape, (HEIGHT, WIDTH)))
    ground = np.kron(ground[top : top + HEIGHT, left : left + WIDTH].astype(np.float32), np.ones((fine, fine), np.float32))
    shapes = []
    pellets = random.random() < 0.5
    for _ in range(int(random.integers(3, 12) if pellets else random.integers(1, 5))):
        radius, slowest = (random.uniform(0.8, 3), 1.0) if pellets else (random.uniform(3, 18), 0.1)
        speed = np.exp(random.uniform(np.log(slowest), np.log(6.0))) * 1000 / FILM_RATE  # pixels a picture
        heading, spin = random.uniform(0, 2 * np.pi), random.normal() * 0.01
        middle = random.uniform([0, 0], [HEIGHT, WIDTH])
        value, texture = random.uniform(5, 250), random.uniform(0, 40)
        shapes.append((outline(random, radius), middle, speed * np.array([np.sin(heading), np.cos(heading)]), spin, value, texture))
    for n in range(frames):
        picture = ground.copy()
        for (x, y), middle, step, spin, value, texture in shapes:
            # It comes in again on the other side.
            at = (middle + step * (n - frames / 2) + 20) % np.array([HEIGHT + 40, WIDTH + 40]) - 20
            c, s = np.cos(spin * n), np.sin(spin * n)
            rows, columns = draw.polygon(fine * (at[0] + s * x + c * y), fine * (at[1] + c * x - s * y), picture.shape)
            picture[rows, columns] = value + texture * np.sin((rows / fine - at[0]) * c + (columns / fine - at[1]) * s)
        small = picture.reshape(HEIGHT, fine, WIDTH, fine).mean((1, 3))
        io.imsave(folder / f"{n:06d}.png", np.clip(small, 0, 255).astype(np.uint8), check_contrast=False)


def sensors(random):
    """What is recorded with, and what the solver is given, as changes to data/sensors/hybrid.toml in TOML."""
    threshold, ratio, alpha = random.uniform(0.14, 0.32), random.uniform(0.85, 1.2), random.uniform(6, 30)
    noise = random.uniform(0.02, 0.1) * threshold
    stated = 1.0 if random.random() < 0.5 else random.uniform(0.9, 1.1)

    def change(factor, effects, read_noise):
        comparator = f"threshold_on = {threshold * factor:.4f}, threshold_off = {threshold * ratio * factor:.4f}, threshold_noise = {noise:.4f}"
        return f'{{ front_end = {{ alpha = "{alpha * factor:.3f} ms" }}, comparator = {{ {comparator} }}, frames = {{ read_noise_dn = {read_noise:.2f} }}{effects} }}'

    effects = []
    if random.random() < 0.4:
        effects.append(f"threshold_mismatch = {{ sigma = {random.uniform(0.02, 0.15) * threshold:.4f} }}")
    if random.random() < 0.25:
        effects.append(f'background_activity = {{ rate = "{random.uniform(0.5, 8):.2f} Hz" }}')
    effects = f", effects = {{ {', '.join(effects)} }}" if effects else ""
    read_noise = 0.3 if random.random() < 0.5 else np.exp(random.uniform(np.log(0.3), np.log(8)))
    return change(1.0, effects, read_noise), change(stated, "", read_noise if random.random() < 0.5 else 0.3)


def describe(n, folder):
    """Writes what recording `n` needs into the folder, and its manifest."""
    random = np.random.default_rng(FIRST_SEED + n)
    folder.mkdir(parents=True, exist_ok=True)
    frame_rate, exposure, duration = [(120, 6500, 75), (120, 6500, 75), (120, 2000, 75), (240, 3500, 50), (60, 12000, 110), (40, 1000, 130)][int(random.integers(6))]
    ground = photograph(PHOTOGRAPHS[int(random.integers(len(PHOTOGRAPHS)))]) if random.random() < 0.5 else drawn(random)
    if random.random() < 0.25:  # a texture of low contrast
        ground = np.rint(ground.mean() + random.uniform(0.1, 0.5) * (ground - ground.mean())).astype(np.uint8)
    io.imsave(folder / "picture.png", ground, check_contrast=False)
    if random.random() < 0.5:
        light = "simulate/video"
        film(random, ground, folder / "film", duration * FILM_RATE // 1000 + 2)
        params = f'path = "film", rate = "{FILM_RATE} Hz"'
    else:
        light = "simulate/photo"
        speed = np.exp(random.uniform(np.log(50), np.log(5000))) * (random.random() < 0.7)
        turning = np.exp(random.uniform(np.log(20), np.log(900))) * random.choice([-1, 1]) * (random.random() < 0.5 or speed == 0)
        shrink = int(random.integers(1, 4)) if min(ground.shape) >= 400 else 1
        params = (
            f'path = "picture.png", outside = "mirror", width = {WIDTH}, height = {HEIGHT}, shrink = {shrink}, scale = {random.uniform(0.8, 1.6):.3f}, speed = {speed:.1f}, '
            f'heading = {random.uniform(-180, 180):.1f}, rotation = "{turning:.2f} rpm", zoom = {random.normal() * 1.0:.3f}, '
            f"shake = {{ amplitude = {random.uniform(0, 3):.2f}, frequency = \"{random.uniform(5, 30):.1f} Hz\" }}, "
            f"centre = {{ x = {random.uniform(0, WIDTH):.1f}, y = {random.uniform(0, HEIGHT):.1f} }}"
        )
    recording, described = sensors(random)
    text = MANIFEST.format(
        seed=FIRST_SEED + n, sensor=ROOT / "data/sensors/hybrid.toml", described=described, recording=recording, light=light, params=params,
        duration=duration, lux=f"{np.exp(random.uniform(np.log(60), np.log(800))):.1f}", rate=[250, 233, 270][n % 3], exposure=exposure,
        frame_rate=frame_rate, end=duration - 5,
    )
    (folder / "recording.toml").write_text(text)
    return folder / "recording.toml"


def density(x, y, t, middle, window, shape):
    """Events of each pixel near an instant: each counts as 1 at the instant, and linearly less up to `window` away. As `Timeline::near` of nodes/baseline/onnx/voxel.rs."""
    weight = np.maximum(0.0, 1.0 - np.abs(t - middle) / window)
    near = weight > 0
    out = np.zeros(shape, np.float32)
    np.add.at(out, (y[near], x[near]), weight[near])
    return out


def grid(x, y, t, on, window, bins, shape, reversed=False):
    """The voxel grid [bins, row, column] of a window whose end is left out, ON 1 and OFF -1. As `Timeline::grid` of nodes/baseline/onnx/voxel.rs; events in the order of time."""
    first, last = np.searchsorted(t, window)
    x, y, sign = x[first:last].astype(int), y[first:last].astype(int), np.where(on[first:last], 1.0, -1.0)
    at = (t[first:last] - window[0]) * ((bins - 1) / max(window[1] - window[0], 1))
    if reversed:
        at, sign = bins - 1 - at, -sign
    at = np.clip(at, 0, bins - 1)
    lower = np.minimum(at.astype(int), max(bins - 2, 0))
    share = at - lower
    plane = shape[0] * shape[1]
    cell = lower * plane + y * shape[1] + x
    counts = np.bincount(cell, sign * (1 - share), (bins + 1) * plane) + np.bincount(cell + plane, sign * share, (bins + 1) * plane)
    return counts[: bins * plane].reshape(bins, *shape).astype(np.float32)


def pair(start, end, instant):
    """Index of the captured frame before an instant, the windows of `nodes/baseline/onnx/layout.rs` and the instant's place between the frames; nothing outside their middles.

    `start` and `end` are those of the exposures' middle row.
    """
    middles = (start + end) // 2
    after = min(int(np.searchsorted(middles, instant, side="right")), len(middles) - 1)
    if after == 0 or not middles[after - 1] <= instant <= middles[after]:
        return None
    before = after - 1
    windows = {
        "before_to_instant": (middles[before], instant),
        "instant_to_after": (instant, middles[after]),
        "exposures": (start[before], end[after]),
    }
    return before, windows, (instant - middles[before]) / max(middles[after] - middles[before], 1)


def read(file):
    """What a recording's HDF5 file holds: events in the order of time, truth, and captured frames with the exposures of their middle row."""
    with h5py.File(file) as recording:
        events, frames = recording["events"], recording["frames"]
        order = np.argsort(events["t"][:], kind="stable")
        later = int(frames.attrs["row_time_ns"]) * (frames["dn"].shape[1] // 2)
        return {
            **{name: events[name][:][order] for name in ("x", "y", "t")},
            "on": events["p"][:][order] == 1,
            "truth": recording["truth/dn"][:] if "truth" in recording else None,
            "truth_t": recording["truth/t"][:] if "truth" in recording else None,
            "shots": frames["dn"][:],
            "start": frames["exposure_start"][:] + later,
            "end": frames["exposure_end"][:] + later,
        }


def load(folder):
    """One recording as a dictionary of arrays: [frame, row, column] in DN, `events` [frame, 2, row, column], and what `read` gives, for voxel grids."""
    frames = read(folder / "out/file/recording.h5")
    x, y, t, on = (frames[name] for name in ("x", "y", "t", "on"))
    truth, truth_t, captured, start, end = (frames[name] for name in ("truth", "truth_t", "shots", "start", "end"))
    for name in ["map", "sigma", "edi"]:
        with h5py.File(folder / f"out/{name}_file/frames.h5") as file:
            frames[name] = file["frames/dn"][:]
            middle = (file["frames/exposure_start"][:] + file["frames/exposure_end"][:]) // 2
    count, taken = len(middle), (start + end) // 2
    assert np.array_equal(middle, truth_t[:count]), f"{folder}: frames and truth are of other instants"
    period = float(np.median(np.diff(taken)))
    shape = truth.shape[1:]
    frames["events"] = np.stack([[density(x[p], y[p], t[p], m, period, shape) for p in (on, ~on)] for m in middle])
    frames["captured"] = captured[[int(np.argmin(np.abs(taken - m))) for m in middle]]
    frames["truth"], frames["truth_t"] = truth[:count], truth_t[:count]
    return frames


def make_one(program, place, n):
    """Makes recording `n` and gathers it in a file of numbers."""
    manifest = describe(n, place)
    command = [str(program), "run", str(manifest), "--out", str(place / "out"), "--cache", str(place / "cache"), "--progress", "none", "--threads", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{manifest}: {done.stderr}")
    values = {name: values.astype(np.float32) if values.dtype.kind == "f" else values for name, values in load(place).items()}
    np.savez(place / "part.npz", **values)
    (place / "part.npz").rename(place / "frames.npz")
    for spent in ["cache", "out", "film"]:
        subprocess.run(["rm", "-r", "-f", str(place / spent)], check=True)


def make(program, folder, count, first=0, threads=2):
    """Makes recordings `first` to `first + count`, so many at a time; those that are there are left."""
    places = {n: folder / f"{n:04d}" for n in range(first, first + count)}
    with ProcessPoolExecutor(threads) as pool:
        made = {pool.submit(make_one, program, place, n): n for n, place in places.items() if not (place / "frames.npz").exists()}
        for done in as_completed(made):
            done.result()
            print(f"recording {made[done]}: made", flush=True)
