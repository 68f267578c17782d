"""A small state dictionary as PyTorch writes it: `python wan_state.py` beside this file. Run with torch 2.15.0."""
import collections
import pathlib

import torch


def ramp(*shape):
    return torch.arange(torch.Size(shape).numel(), dtype=torch.float32).reshape(shape) / 8 - 1


state = collections.OrderedDict()
state["conv1.weight"] = ramp(2, 3, 1, 2, 2)
state["half.weight"] = ramp(6).half()
state["head.head.bias"] = ramp(4).bfloat16()
state["transposed"] = ramp(2, 3).t()
torch.save(state, pathlib.Path(__file__).with_name("wan_state.pth"))
