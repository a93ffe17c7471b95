"""How often `photocurrent inspect` reports clocks, shifts and mirrored pictures that are not there, and how often those that are.

Simulates small recordings (eight scenes, rows read at once to 30 us apart, front ends fast and slow, dim and bright light, little and much noise of the frames) without any
deviation and with one, inspects each, and prints a Markdown table. The limits of src/formats/hazard/limits.rs name it; docs/inspect.md holds its tables.

    python3 pipelines/calibration/inspect.py target/release/photocurrent --seed 5000

Needs nothing but Python. `--keep FOLDER` keeps the recordings and what inspect printed of each; `--only N` takes the first N of each group.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile

SCENES = ["texture", "checkerboard", "fan", "siemens_disk", "pellet", "slingshot_egg", "basketball", "running_man"]
PERIOD_MS, DURATION_MS = 1000 / 120, 160
SENSOR = """format = "photocurrent-sensor/1"
name = "calibration"
[front_end]
tau_0 = "20 us"
alpha = "{alpha} ms"
[comparator]
threshold_on = {on}
threshold_off = {off}
threshold_noise = 0.01
[readout]
refractory = "50 us"
latency_min = "1 us"
[frames]
gain = 1100.0
black_level_dn = 0.0
saturation_dn = 1023.0
row_time = "{row} us"
read_noise_dn = {noise}
full_well_e = 10000.0
[optics]
photocurrent_per_lux = 0.2
"""
MANIFEST = """format = 1
[pipeline]
about = "A recording to calibrate inspect on."
seed = {seed}
[nodes.nominal]
kind = "read/sensor"
params = {{ path = "nominal.toml" }}
[nodes.actual]
kind = "read/sensor"
params = {{ path = "actual.toml" }}
[nodes.scene]
kind = "simulate/scene"
in = {{ sensor = "nominal" }}
params = {{ scene = "{scene}", width = 96, height = 72, duration = "{duration} ms", illuminance = "{lux} lx", truth_rate = "10 Hz", tolerance = 0.005 }}
[nodes.recording]
kind = "simulate/sensor"
in = {{ light = "scene.light", sensor = "actual" }}
params = {{ frame_rate = "120 fps", exposure = "4 ms" }}
[nodes.file]
kind = "write/recording"
in = {{ events = "recording.events", frames = "recording.frames", sensor = "nominal" }}
"""
# What each group has, as effects of the description that simulates; the one that travels with the recording has none.
GROUPS = {
    "none": (64, lambda n: {}),
    "clock_drift": (24, lambda n: {"clock_drift": {"rate": [0.1, -0.1, 0.2, -0.2, 0.4, -0.4][n % 6] * PERIOD_MS / DURATION_MS}}),
    "clock_offset": (8, lambda n: {"clock_offset": {"offset": f"{[1, -1, 2, -2][n % 4]} ms"}}),
    "misalignment": (8, lambda n: {"misalignment": {"shift_x": [1, -2, 0, 3][n % 4], "shift_y": [0, 1, 2, -3][n % 4]}}),
}
FINDINGS = ["events_late", "clock_drift", "displaced", "mirrored"]


def value(item):
    return f'"{item}"' if isinstance(item, str) else repr(float(item))


def recording(program, folder, seed, n, effects):
    """Simulates one recording and returns its file."""
    front_end = [1, 12, 40][(n // 4) % 3]
    light = [100, 300, 800][(n // 3 + seed) % 3]
    row, noise = [0, 10, 20, 30][(n // 8 + n) % 4], [0.3, 3.0][(n // 2) % 2]
    text = SENSOR.format(alpha=front_end, on=0.2, off=[0.21, 0.25][n % 2], row=row, noise=noise)
    (folder / "nominal.toml").write_text(text)
    for name, parameters in effects.items():
        text += f"[effects.{name}]\n" + "".join(f"{key} = {value(item)}\n" for key, item in parameters.items())
    (folder / "actual.toml").write_text(text)
    scene = SCENES[n % len(SCENES)]
    (folder / "case.toml").write_text(MANIFEST.format(seed=seed + n, scene=scene, duration=DURATION_MS, lux=light))
    done = subprocess.run([program, "run", "case.toml", "--to", "file"], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{scene}, seed {seed + n}: {done.stderr}")
    return scene, next(folder.rglob("*.h5"))


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("program", help="the command `photocurrent`")
    arguments.add_argument("--seed", type=int, default=5000, help="seed of the first recording of a group")
    arguments.add_argument("--only", type=int, default=10**9, help="recordings of a group, at most")
    arguments.add_argument("--keep", type=pathlib.Path, help="a folder for the recordings")
    given = arguments.parse_args()
    program = str(pathlib.Path(given.program).resolve())
    print("| made with | recordings | " + " | ".join(f"`{name}`" for name in FINDINGS) + " | largest offset, drift [periods] |")
    print("| --- |" + " --- |" * (len(FINDINGS) + 2))
    for group, (count, effects) in GROUPS.items():
        counts, taken, late, drift = dict.fromkeys(FINDINGS, 0), 0, 0.0, 0.0
        for n in range(min(count, given.only)):
            with tempfile.TemporaryDirectory() as temporary:
                folder = given.keep / f"{given.seed}_{group}_{n}" if given.keep else pathlib.Path(temporary)
                folder.mkdir(parents=True, exist_ok=True)
                scene, file = recording(program, folder, given.seed, n, effects(n))
                done = subprocess.run([program, "inspect", "--json", str(file)], capture_output=True, text=True, check=True)
                entry = json.loads(done.stdout)["files"][0]
                if given.keep:
                    (folder / "inspect.json").write_text(done.stdout)
            taken += 1
            ids = [finding["id"] for finding in entry["findings"]]
            for name in FINDINGS:
                counts[name] += name in ids
            lag, period = entry["survey"]["lag"], entry["survey"]["frames"]["period"]["median_ns"]
            if lag and lag["late_ns"]:
                late = max(late, abs(lag["late_ns"]["value"]) / period)
            if lag and lag["drift_ns_per_s"]:
                drift = max(drift, abs(lag["drift_ns_per_s"]["value"]) * lag["drift_over_s"] / period)
        print(f"| {group} | {taken} | " + " | ".join(str(counts[name]) for name in FINDINGS) + f" | {late:.3f}, {drift:.3f} |", flush=True)


if __name__ == "__main__":
    main()
