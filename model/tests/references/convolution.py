"""Writes convolution.json: small convolutions and attention with all gradients, computed by JAX in 64-bit floats.

    pip install jax numpy && python convolution.py

Inputs are multiples of 1/64 in -1..1 from a congruential generator that the test repeats, so only results are stored:
a weighted sum of the output (its weights come from the same generator), a few output elements, and for each input the
weighted sum and a few elements of its gradient.
"""
import json
import os

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)


class Numbers:
    """Knuth's MMIX generator, top seven bits."""

    def __init__(self):
        self.state = 1

    def take(self, *shape):
        values = []
        for _ in range(int(np.prod(shape))):
            self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
            values.append(((self.state >> 57) - 64) / 64)
        return jnp.array(values, dtype=jnp.float64).reshape(shape)


def conv(x, w, b, stride):
    half = w.shape[0] // 2
    if stride == "up":
        x = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)
    step = 2 if stride == "two" else 1
    y = jax.lax.conv_general_dilated(
        x, w, (step, step), ((half, half), (half, half)), dimension_numbers=("NHWC", "HWIO", "NHWC")
    )
    return y + b


def decode(x, skip, w, b):
    up = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)
    return jax.nn.silu(conv(jnp.concatenate([up, skip], axis=3), w, b, "one"))


def attention(q, k, v, heads):
    def split(t):
        return t.reshape(t.shape[0], t.shape[1], heads, -1).transpose(0, 2, 1, 3)

    q, k, v = split(q), split(k), split(v)
    p = jax.nn.softmax(q @ k.transpose(0, 1, 3, 2) / np.sqrt(q.shape[-1]), axis=-1)
    y = (p @ v).transpose(0, 2, 1, 3)
    return y.reshape(y.shape[0], y.shape[1], -1)


def summary(t, numbers):
    t = t.reshape(-1)
    return {"sum": float(jnp.sum(t * numbers.take(t.size))), "some": [float(v) for v in t[:: max(1, t.size // 8)]]}


def case(name, f, inputs, numbers):
    y = f(*inputs)
    weights = numbers.take(*y.shape)
    gradients = jax.grad(lambda *i: jnp.sum(f(*i) * weights), argnums=tuple(range(len(inputs))))(*inputs)
    return {
        "name": name,
        "shapes": [list(i.shape) for i in inputs],
        "output": summary(y, numbers),
        "gradients": [summary(g, numbers) for g in gradients],
    }


def main():
    cases = []
    for kernel in (1, 3):
        for stride in ("one", "two", "up"):
            for silu in (False, True):
                n = Numbers()
                inputs = [n.take(2, 7, 9, 5), n.take(kernel, kernel, 5, 18), n.take(18)]
                act = jax.nn.silu if silu else (lambda t: t)
                name = f"conv {kernel} {stride} {'silu' if silu else 'plain'}"
                cases.append(case(name, lambda x, w, b: act(conv(x, w, b, stride)), inputs, n))
    n = Numbers()
    cases.append(case("decode", decode, [n.take(1, 3, 5, 6), n.take(1, 6, 10, 3), n.take(3, 3, 9, 20), n.take(20)], n))
    n = Numbers()
    inputs = [n.take(2, 11, 5), n.take(5, 19), n.take(19)]
    cases.append(case("linear", lambda x, w, b: jax.nn.silu(x @ w + b), inputs, n))
    n = Numbers()
    inputs = [n.take(2, 7, 12), n.take(2, 21, 12), n.take(2, 21, 12)]
    cases.append(case("attention 3", lambda q, k, v: attention(q, k, v, 3), inputs, n))
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "convolution.json")
    with open(path, "w") as file:
        lines = ",\n".join(json.dumps(c) for c in cases)
        file.write('{"jax": "%s", "cases": [\n%s\n]}\n' % (jax.__version__, lines))


main()
