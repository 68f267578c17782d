"""The fusion network in PyTorch: the same weights, the same picture (with --device cpu:f32), the same loss as in the program.

    from renderflow.fusion import Batches, Fusion, loss

    model = Fusion.shipped()                     # or Fusion.load("weights.safetensors"), Fusion(seed=1)
    batches = Batches("kept")                    # sequences that `renderflow train --keep kept` wrote
    batch = batches.at(step=0, size=96, items=8)
    picture = model(batch)                       # (8, 96, 96, 3), exposed and linear
    loss(picture, batch).total.mean().backward()
    model.save("weights.safetensors")            # for `renderflow infer --weights` and `evaluate`

``examples/train_fusion.py`` trains it on one or several processes. The network is a U-Net that reads what is known about each
pixel, and a head without parameters that filters and mixes the given pictures (:mod:`renderflow.fusion.head`).
"""

from .batches import Batch, Batches, Groups, Sequence, prefetch, sequence_files
from .losses import Loss, LossWeights, display, loss, psnr
from .network import Fusion, Outputs

__all__ = [
    "Batch",
    "Batches",
    "Fusion",
    "Groups",
    "Loss",
    "LossWeights",
    "Outputs",
    "Sequence",
    "display",
    "loss",
    "prefetch",
    "psnr",
    "sequence_files",
]
