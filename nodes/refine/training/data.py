"""Training data of both networks: recordings simulated by photocurrent itself, solved, and paired with the truth.

Every recording is a manifest that is written here and run by the program: a picture or a film of moving shapes (never a scene of `simulate/scene`, which
the test scenes are), a sensor drawn at random around data/sensors/hybrid.toml, and a solver that is given the true description of that sensor in half of the cases.
Pictures: photographs that ship with scikit-image (public domain or CC0), and shapes drawn from random numbers.
"""

import subprocess
import tomllib
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

SCENE = """# A training recording.
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
in     = {{ events = "{events}", frames = "{frames}", sensor = "sensor" }}

[nodes.rows]
kind   = "render/rows"
in     = {{ tracks = "{tracks}", sensor = "sensor" }}
params = {{ rate = "{rate} Hz", exposure = "100 us", end = "{end} ms" }}

[nodes.map_file]
kind   = "write/frames"
in     = {{ frames = "{pictures}.frames" }}
params = {{ format = "hdf5_f32" }}

[nodes.sigma_file]
kind   = "write/frames"
in     = {{ frames = "{pictures}.sigma" }}
params = {{ format = "hdf5_f32" }}
"""

# Events and frames of one sensor.
PLAIN = """
[nodes.edi]
kind   = "baseline/edi"
in     = {{ events = "recording.events", frames = "recording.frames", sensor = "sensor" }}
params = {{ rate = "{rate} Hz", exposure = "100 us", end = "{end} ms" }}

[nodes.file]
kind = "write/recording"
in   = {{ events = "recording.events", frames = "recording.frames", truth = "light.truth" }}

[nodes.edi_file]
kind   = "write/frames"
in     = {{ frames = "edi" }}
params = {{ format = "hdf5_f32" }}
"""

# Events of another camera's array; solved there and brought to the frames' pixels.
PAIR = """
[nodes.places]
kind   = "read/alignment"
params = {{ homography = {homography}, width = {width}, height = {height} }}

[nodes.seen]
kind = "align/light"
in   = {{ light = "light.light", alignment = "places", sensor = "recorder" }}

[nodes.other]
kind   = "simulate/sensor"
in     = {{ light = "seen", sensor = "recorder" }}
params = {{ frame_rate = "{frame_rate} fps", exposure = "{exposure} us" }}

[nodes.array]
kind = "align/recording"
in   = {{ events = "other.events", frames = "recording.frames", alignment = "places" }}

[nodes.back]
kind = "align/tracks"
in   = {{ tracks = "solve.tracks", frames = "recording.frames", alignment = "places", events = "array.events" }}

[nodes.file]
kind = "write/recording"
in   = {{ frames = "recording.frames", truth = "light.truth" }}

[nodes.events_file]
kind = "write/recording"
in   = {{ events = "array.events" }}
"""

GREY = """
[nodes.grey]
kind = "render/grey"
in   = {{ frames = "{one}.frames", events = "{one}.events", sensor = "sensor" }}
"""

# What the event array does not resolve, and colours, travel along the motion.
HUES = """
[nodes.colour]
kind = "render/colour"
in   = {{ frames = "rows.frames", sigma = "rows.sigma", captured = "recording.frames", tracks = "{tracks}", events = "{one}.events", sensor = "sensor"{alignment} }}
"""

FILE = """
[nodes.file]
kind = "write/recording"
in   = {{ events = "recording.events", frames = "recording.frames", truth = "light.truth" }}
"""

SORTS = ["plain", "pair", "colour", "colour_pair"]


def manifest(sort, **values):
    """The manifest of a recording of a sort: `plain`, events of another array (`pair`), and both in three colours."""
    pair, colour = "pair" in sort, "colour" in sort
    one = "array" if pair else "recording"
    wired = {
        "one": one, "events": f"{one}.events", "frames": "grey" if colour else f"{one}.frames", "tracks": "back.tracks" if pair else "solve.tracks",
        "pictures": "rows" if sort == "plain" else "colour", "alignment": ', alignment = "places"' if pair else "",
    }
    parts = [SCENE, *([PAIR] if pair else [FILE] if colour else [PLAIN]), *([GREY] if colour else []), *([HUES] if sort != "plain" else [])]
    return "".join(part.format(**values, **wired) for part in parts)


def photograph(name, colour=False):
    """A photograph, 8 bits: grey, or in its own colours, if it has some."""
    picture = getattr(photographs, name)()
    if picture.ndim == 3:
        if colour:
            return picture[..., :3]
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


def tinted(random, picture):
    """A grey picture in two hues; where one goes over into the other is not where light changes. 8-bit RGB."""
    share = np.kron(drawn(random) / 255.0, np.ones([-(-side // 192) for side in picture.shape]))[: picture.shape[0], : picture.shape[1], None]
    one, other = np.exp(random.normal(0, 0.5, (2, 3)))
    hue = share * one / one.max() + (1 - share) * other / other.max()
    return np.clip(np.rint(picture[..., None] * hue), 0, 255).astype(np.uint8)


def homography(random):
    """Places of an event array's pixels on the frames, row by row, and the array's size: it covers the frames."""
    pitch, turn = random.uniform(0.9, 1.4), random.uniform(-0.04, 0.04)
    width, height = (int(np.ceil(side / pitch)) + 3 for side in (WIDTH, HEIGHT))
    c, s = pitch * np.cos(turn), pitch * np.sin(turn)
    shift = np.array([WIDTH - 1, HEIGHT - 1]) / 2 - np.array([[c, -s], [s, c]]) @ [(width - 1) / 2, (height - 1) / 2] + random.uniform(-0.5, 0.5, 2)
    rows = [[c, -s, shift[0]], [s, c, shift[1]], [0.0, 0.0, 1.0]]
    return [[round(float(value), 6) for value in row] for row in rows], width, height


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


def sensors(random, more=""):
    """What is recorded with, and what the solver is given, as changes to data/sensors/hybrid.toml in TOML."""
    threshold, ratio, alpha = random.uniform(0.14, 0.32), random.uniform(0.85, 1.2), random.uniform(6, 30)
    noise = random.uniform(0.02, 0.1) * threshold
    stated = 1.0 if random.random() < 0.5 else random.uniform(0.9, 1.1)

    def change(factor, effects, read_noise):
        comparator = f"threshold_on = {threshold * factor:.4f}, threshold_off = {threshold * ratio * factor:.4f}, threshold_noise = {noise:.4f}"
        return f'{{ front_end = {{ alpha = "{alpha * factor:.3f} ms" }}, comparator = {{ {comparator} }}, frames = {{ read_noise_dn = {read_noise:.2f}{more} }}{effects} }}'

    effects = []
    if random.random() < 0.4:
        effects.append(f"threshold_mismatch = {{ sigma = {random.uniform(0.02, 0.15) * threshold:.4f} }}")
    if random.random() < 0.25:
        effects.append(f'background_activity = {{ rate = "{random.uniform(0.5, 8):.2f} Hz" }}')
    effects = f", effects = {{ {', '.join(effects)} }}" if effects else ""
    read_noise = 0.3 if random.random() < 0.5 else np.exp(random.uniform(np.log(0.3), np.log(8)))
    return change(1.0, effects, read_noise), change(stated, "", read_noise if random.random() < 0.5 else 0.3)


def describe(n, folder, sort="plain"):
    """Writes what recording `n` of a sort needs into the folder, and its manifest."""
    seed = FIRST_SEED * (1 + 10 * SORTS.index(sort)) + n
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    frame_rate, exposure, duration = [(120, 6500, 75), (120, 6500, 75), (120, 2000, 75), (240, 3500, 50), (60, 12000, 110), (40, 1000, 130)][int(random.integers(6))]
    colour = "colour" in sort
    ground = photograph(PHOTOGRAPHS[int(random.integers(len(PHOTOGRAPHS)))], colour) if random.random() < 0.5 else drawn(random)
    if random.random() < 0.25:  # a texture of low contrast
        ground = np.rint(ground.mean() + random.uniform(0.1, 0.5) * (ground - ground.mean())).astype(np.uint8)
    if colour and ground.ndim == 2:
        ground = tinted(random, ground)
    io.imsave(folder / "picture.png", ground, check_contrast=False)
    if not colour and random.random() < 0.5:  # a film is grey
        light = "simulate/video"
        film(random, ground, folder / "film", duration * FILM_RATE // 1000 + 2)
        params = f'path = "film", rate = "{FILM_RATE} Hz"'
    else:
        light = "simulate/photo"
        speed = np.exp(random.uniform(np.log(50), np.log(5000))) * (random.random() < 0.7)
        turning = np.exp(random.uniform(np.log(20), np.log(900))) * random.choice([-1, 1]) * (random.random() < 0.5 or speed == 0)
        shrink = int(random.integers(1, 4)) if min(ground.shape[:2]) >= 400 else 1
        params = (
            f'path = "picture.png", outside = "mirror", width = {WIDTH}, height = {HEIGHT}, shrink = {shrink}, scale = {random.uniform(0.8, 1.6):.3f}, speed = {speed:.1f}, '
            f'heading = {random.uniform(-180, 180):.1f}, rotation = "{turning:.2f} rpm", zoom = {random.normal() * 1.0:.3f}, '
            f"shake = {{ amplitude = {random.uniform(0, 3):.2f}, frequency = \"{random.uniform(5, 30):.1f} Hz\" }}, "
            f"centre = {{ x = {random.uniform(0, WIDTH):.1f}, y = {random.uniform(0, HEIGHT):.1f} }}"
        )
        params += ', colour = "rgb"' if colour else ""
    recording, described = sensors(random, ', row_time = "0 us"' if "pair" in sort else "")
    places, width, height = homography(random) if "pair" in sort else (None, 0, 0)
    text = manifest(
        sort, homography=places, width=width, height=height, seed=seed, sensor=ROOT / "data/sensors/hybrid.toml", described=described, recording=recording, light=light, params=params,
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
        found = {}
        if "events" in recording:
            events = recording["events"]
            order = np.argsort(events["t"][:], kind="stable")
            found = {name: events[name][:][order] for name in ("x", "y", "t")} | {"on": events["p"][:][order] == 1}
        if "frames" in recording:
            frames = recording["frames"]
            later = int(frames.attrs["row_time_ns"]) * (frames["dn"].shape[1] // 2)
            found |= {"shots": frames["dn"][:], "start": frames["exposure_start"][:] + later, "end": frames["exposure_end"][:] + later}
        if "truth" in recording:
            found |= {"truth": recording["truth/dn"][:], "truth_t": recording["truth/t"][:]}
        return found


def brought(counts, places, shape):
    """Counts [row, column] of an event array's pixels at the pixels of frames of a shape, bilinear. As `EventCounts::counts_near` of nodes/refine/onnx.rs."""
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    column, row, share = np.einsum("ij,j...->i...", np.linalg.inv(places), np.stack([columns, rows, np.ones(shape)]))
    column, row = column / share, row / share
    inside = (column >= -1) & (column <= counts.shape[1]) & (row >= -1) & (row <= counts.shape[0])
    column, row = np.clip(column, 0, counts.shape[1] - 1), np.clip(row, 0, counts.shape[0] - 1)
    i, j = np.minimum(column.astype(int), counts.shape[1] - 2), np.minimum(row.astype(int), counts.shape[0] - 2)
    s, t = column - i, row - j
    upper = (1 - s) * counts[j, i] + s * counts[j, i + 1]
    lower = (1 - s) * counts[j + 1, i] + s * counts[j + 1, i + 1]
    return (inside * ((1 - t) * upper + t * lower)).astype(np.float32)


def load(folder, sort="plain"):
    """One recording as a dictionary of arrays: [frame, row, column] in DN, `events` [frame, 2, row, column], and what `read` gives, for voxel grids.

    Of frames in three colours each gives one, in turn.
    """
    frames = read(folder / "out/file/recording.h5")
    array = None
    if "pair" in sort:
        frames |= read(folder / "out/events_file/recording.h5")
        array = tomllib.loads((folder / "recording.toml").read_text())["nodes"]["places"]["params"]
    x, y, t, on = (frames[name] for name in ("x", "y", "t", "on"))
    truth, truth_t, captured, start, end = (frames[name] for name in ("truth", "truth_t", "shots", "start", "end"))
    for name in ["map", "sigma", *(["edi"] if sort == "plain" else [])]:
        with h5py.File(folder / f"out/{name}_file/frames.h5") as file:
            frames[name] = file["frames/dn"][:]
            middle = (file["frames/exposure_start"][:] + file["frames/exposure_end"][:]) // 2
    count, taken = len(middle), (start + end) // 2
    assert np.array_equal(middle, truth_t[:count]), f"{folder}: frames and truth are of other instants"
    period = float(np.median(np.diff(taken)))
    shape = truth.shape[1:3]

    def near(pixels, instant):
        if array is None:
            return density(x[pixels], y[pixels], t[pixels], instant, period, shape)
        counts = density(x[pixels], y[pixels], t[pixels], instant, period, (array["height"], array["width"]))
        return brought(counts, np.array(array["homography"]), shape)

    frames["events"] = np.stack([[near(pixels, m) for pixels in (on, ~on)] for m in middle])
    frames["captured"] = captured[[int(np.argmin(np.abs(taken - m))) for m in middle]]
    frames["truth"], frames["truth_t"] = truth[:count], truth_t[:count]
    if "colour" in sort:
        for name in ["map", "sigma", "captured", "truth"]:
            frames[name] = np.stack([picture[..., n % 3] for n, picture in enumerate(frames[name])])
    # Pixels of the frames that no event pixel sees are shown to the network as black, and count as such.
    known = np.isfinite(frames["map"])
    for name in ["map", "sigma", "truth"]:
        frames[name] = np.where(known, frames[name], 0.0)
    return frames


def make_one(program, place, n, sort):
    """Makes recording `n` of a sort and gathers it in a file of numbers."""
    described = describe(n, place, sort)
    command = [str(program), "run", str(described), "--out", str(place / "out"), "--cache", str(place / "cache"), "--progress", "none", "--threads", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{described}: {done.stderr}")
    values = {name: values.astype(np.float32) if values.dtype.kind == "f" else values for name, values in load(place, sort).items()}
    np.savez(place / "part.npz", **values)
    (place / "part.npz").rename(place / "frames.npz")
    for spent in ["cache", "out", "film"]:
        subprocess.run(["rm", "-r", "-f", str(place / spent)], check=True)


def places(folder, count, sort="plain"):
    """The folders of the recordings of a sort, by number."""
    return {n: folder / (f"{n:04d}" if sort == "plain" else f"{sort}_{n:04d}") for n in range(count)}


def make(program, folder, count, sort="plain", threads=2):
    """Makes recordings 0 to `count` of a sort, so many at a time; those that are there are left."""
    lacking = {n: place for n, place in places(folder, count, sort).items() if not (place / "frames.npz").exists()}
    with ProcessPoolExecutor(threads) as pool:
        made = {pool.submit(make_one, program, place, n, sort): n for n, place in lacking.items()}
        for done in as_completed(made):
            done.result()
            print(f"recording {made[done]}, {sort}: made", flush=True)
