"""Reference LPIPS for tests/metrics.rs, from the lpips package. The backbones' weights are those of the folder given (their names
are torchvision's), the heads the package's own. Also the smallest square each network takes.

Run: python tests/references/lpips_metrics.py WEIGHTS_FOLDER > tests/references/lpips_metrics.json
"""
import importlib.metadata
import json
import pathlib
import re
import sys
import warnings

import torch
from metrics_pairs import described, pair
from safetensors.torch import load_file

warnings.simplefilter("ignore")
import lpips


def network(name):
    result = lpips.LPIPS(net=name, version="0.1", pretrained=True, pnet_rand=True, verbose=False)
    stored = load_file(pathlib.Path(sys.argv[1]) / f"lpips_{name}.safetensors")
    state = result.state_dict()
    for key in state:
        if key.startswith("net."):
            state[key] = stored[re.sub(r"^net\.slice\d+\.", "net.features.", key)]
    result.load_state_dict(state)
    return result.eval().double()


def distance(network, a, b):
    tensor = lambda p: torch.from_numpy(p).double().permute(2, 0, 1)[None] * 2 - 1
    with torch.no_grad():
        return float(network(tensor(a), tensor(b)))


networks = {name: network(name) for name in ("alex", "squeeze")}
smallest = {}
for name, net in networks.items():
    for side in range(1, 64):
        try:
            distance(net, *pair("noise", side, side, 0.4))
            smallest[name] = side
            break
        except RuntimeError:
            continue
cases = []
for case, a, b, _ in described():
    side = min(case["width"], case["height"])
    if side >= min(smallest.values()):
        cases.append(case | {name: distance(net, a, b) for name, net in networks.items() if side >= smallest[name]})
print(json.dumps({"lpips": importlib.metadata.version("lpips"), "torch": torch.__version__, "smallest": smallest, "cases": cases}, indent=1))
