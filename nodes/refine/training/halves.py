"""Stores the weights of ONNX files in half precision: python halves.py FILE.onnx ...

Each f32 initialiser of 64 numbers or more becomes one of f16 and a Cast, so that programs with and without f16 run the file, and compute in f32. Weights change by at most 1 part in 2,048.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

LEAST = 64
"""Numbers of an initialiser from which on half precision saves more than a Cast takes."""
HALF = ".half"
"""What the name of an initialiser in half precision ends with; the Cast has the name without it."""


def halved(model):
    """The model with its weights in half precision; those that half precision cannot hold stay."""
    casts = []
    for value in model.graph.initializer:
        if value.data_type != TensorProto.FLOAT:
            continue
        numbers = numpy_helper.to_array(value)
        rounded = numbers.astype(np.float16)
        if numbers.size < LEAST or not np.isfinite(rounded).all():
            continue
        name = value.name
        value.CopyFrom(numpy_helper.from_array(rounded, name + HALF))
        casts.append(helper.make_node("Cast", [name + HALF], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    return model


def weights(model):
    """All weights as f32 by name, whichever precision they are stored in."""
    return {value.name.removesuffix(HALF): numpy_helper.to_array(value).astype(np.float32) for value in model.graph.initializer}


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        model = halved(onnx.load(str(path)))
        onnx.checker.check_model(model)
        onnx.save(model, str(path))
