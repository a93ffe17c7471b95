"""Writes stand_in_*.onnx: networks with the inputs and outputs of Time Lens, FILM, CBMNet and REFID as pipelines/baselines/ has them, and nothing learned in them.

    pip install onnx==1.23.2 && python3 stand_ins.py

Each gives (1 - t) before + t after, CBMNet (which takes no time) the mean of both frames, plus the sum of all voxel grids over 1000, so that each input is used.
"""

from pathlib import Path

import onnx
from onnx import TensorProto as T
from onnx import helper as h

FRAME = [1, 3, "h", "w"]


def save(name, before, after, grids, time, time_shape):
    """One network; `grids` are names with their bins."""
    inputs = [(before, FRAME), (after, FRAME)] + [(grid, [1, bins, "h", "w"]) for grid, bins in grids] + ([(time, time_shape)] if time else [])
    constants = [h.make_tensor("axes", T.INT64, [1], [1]), h.make_tensor("least", T.FLOAT, [1], [0.001]), h.make_tensor("half", T.FLOAT, [1], [0.5])]
    nodes = [
        h.make_node("Sub", [after, before], ["rise"]),
        h.make_node("Mul", ["rise", time or "half"], ["part"]),
        h.make_node("Add", [before, "part"], ["sum0"]),
    ]
    for n, (grid, _) in enumerate(grids):
        nodes += [
            h.make_node("ReduceSum", [grid, "axes"], [f"count{n}"], keepdims=1),
            h.make_node("Mul", [f"count{n}", "least"], [f"light{n}"]),
            h.make_node("Add", [f"sum{n}", f"light{n}"], [f"sum{n + 1}"]),
        ]
    nodes.append(h.make_node("Identity", [f"sum{len(grids)}"], ["image"]))
    used = {name for node in nodes for name in node.input}
    info = lambda described: [h.make_tensor_value_info(n, T.FLOAT, shape) for n, shape in described]
    graph = h.make_graph(nodes, name, info(inputs), info([("image", FRAME)]), [c for c in constants if c.name in used])
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], producer_name="photocurrent", ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, Path(__file__).parent / f"stand_in_{name}.onnx")


save("time_lens", "before", "after", [("before_voxel", 5), ("before_voxel_reversed", 5), ("after_voxel", 5)], "weight", [1])
save("film", "x0", "x1", [], "time", [1, 1])
save("cbmnet", "image_input0", "image_input1", [("event_input_0t", 16), ("event_input_t0", 16), ("event_input_t1", 16)], None, None)
save("refid", "before", "after", [("voxel", 26)], "t", [1])
