"""Handmade ONNX files: a graph of a few operators, with selectable defects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

BOXES = np.array([[20.0, 3.0, 0.8, 4.5, 1.9, 1.6, 0.1], [-15.0, 9.0, 0.7, 4.0, 1.8, 1.5, 1.0]], np.float32)


def spread(points: np.ndarray, bias: float = 0.0) -> np.ndarray:
    """Return (2,) float64 scores of the graph: the sigmoid of the mean of x / 100, plus and minus, and a bias."""
    mean = points[:, 0].astype(np.float64).mean() / 100
    return 1.0 / (1.0 + np.exp(-(np.array([mean, -mean]) + bias)))


def graph_nodes() -> list[Any]:
    """Return the nodes of a graph: points (N, 3) -> boxes (2, 7), scores (2,)."""
    return [
        helper.make_node("Slice", ["points", "zero", "one", "axis"], ["x"]),
        helper.make_node("ReduceMean", ["x"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "slope"], ["raised"]),
        helper.make_node("Add", ["raised", "bias"], ["logits"]),
        helper.make_node("Sigmoid", ["logits"], ["scores"]),
        helper.make_node("Identity", ["constant"], ["boxes"]),
    ]


def model(bias: float = 0.0, nodes: list[Any] | None = None, columns: Any = 3, **parts: Any) -> onnx.ModelProto:
    """Return the graph as a model. bias: of both logits. parts: outputs, points (input name), rows, dtype, boxes."""
    constants = {
        "zero": np.array([0], np.int64),
        "one": np.array([1], np.int64),
        "axis": np.array([1], np.int64),
        "slope": np.array([0.01, -0.01], np.float32),
        "bias": np.array([bias, bias], np.float32),
        "constant": parts.get("boxes", BOXES),
    }
    dtype = parts.get("dtype", TensorProto.FLOAT)
    inputs = [helper.make_tensor_value_info("points", dtype, [parts.get("rows", "N"), columns])]
    inputs += [helper.make_tensor_value_info(name, dtype, [1]) for name in parts.get("more_inputs", ())]
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, None)
        for name in parts.get("outputs", ("boxes", "scores"))
    ]
    initial = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes or graph_nodes(), "detector", inputs, outputs, initial)
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("mine", 1)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=9)


def write_model(path: Path, bias: float = 0.0, **parts: Any) -> Path:
    """Write the graph as a file."""
    onnx.save_model(model(bias, **parts), path)
    return path


OWN_SOURCE = f"""\
import torch

BOXES = torch.tensor({BOXES.tolist()})


def load(weights):
    return lambda points: (BOXES, points[:, 0].sum() / max(len(points), 1) / 100 * torch.tensor([1.0, -1.0]))
"""
"""The same function with bias 0, as a Python file of a user's own detector."""
