"""same_batch.py A.png B.png: the batch of stored and of compact frames, as pictures, but for rounding."""
import sys

import numpy as np
from PIL import Image

a, b = (np.asarray(Image.open(path)).astype("i4") for path in sys.argv[1:])
assert a.shape == b.shape and a.std() > 10, "an empty picture"
assert np.abs(a - b).max() <= 3, np.abs(a - b).max()
print("batches of", "x".join(map(str, a.shape)), "differ by", np.abs(a - b).max(), "of 255 at most")
