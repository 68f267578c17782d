"""Pairs of pictures for the reference values of tests/metrics.rs, which makes the same ones: plain sums and products of doubles
rounded to single precision, so both agree to the last bit and only numbers are stored.

A pair is named by kind, width, height and amount. Every pair has a mask: a disc, empty in the smallest pictures.
"""
import numpy

# Odd sizes, sizes of no whole window, and pictures one pixel wide; each kind at several of them.
PAIRS = [
    ("mixed", 11, 11, 0.5), ("mixed", 37, 23, 0.2), ("mixed", 64, 48, 0.05), ("mixed", 65, 33, 0.01),
    ("mixed", 128, 128, 0.3), ("mixed", 32, 200, 0.9),
    ("identical", 37, 23, 0.0), ("identical", 12, 65, 0.0),
    ("noise", 65, 33, 0.4), ("noise", 33, 31, 0.02), ("noise", 11, 64, 1.0), ("noise", 256, 255, 0.1),
    ("blur", 37, 23, 0.0), ("blur", 97, 65, 0.0),
    ("shift", 65, 33, 3.0), ("shift", 31, 31, 1.0), ("shift", 128, 67, 7.0),
    ("cast", 37, 23, 0.3), ("cast", 17, 17, 0.9),
    ("dark", 65, 33, 0.02), ("dark", 41, 50, 0.002),
    ("black_white", 37, 23, 0.0), ("black_white", 33, 65, 0.0),
    ("checkers", 65, 33, 1.0), ("checkers", 40, 37, 4.0),
    ("noise", 1, 40, 0.4), ("shift", 40, 1, 2.0), ("black_white", 1, 1, 0.0), ("cast", 2, 3, 0.5), ("blur", 7, 9, 0.0),
]


def generator(seed):
    state = seed
    while True:
        state = (1664525 * state + 1013904223) % 2**32
        yield (state >> 8) / 2**24


def random(width, height, seed):
    values = generator(seed)
    return numpy.array([next(values) for _ in range(width * height * 3)]).reshape(height, width, 3)


def mixed(width, height, seed, smooth):
    y, x = numpy.mgrid[0:height, 0:width]
    ramp = ((x * 3 + y * 5) % 64 / 64.0)[..., None]
    return smooth * ramp + (1 - smooth) * random(width, height, seed)


def disc(width, height):
    y, x = numpy.mgrid[0:height, 0:width]
    return 9 * ((2 * x + 1 - width) ** 2 + (2 * y + 1 - height) ** 2) < 4 * min(width, height) ** 2


def scene(width, height):
    """A coloured disc before a gradient, with a little noise."""
    y, x = numpy.mgrid[0:height, 0:width]
    behind = numpy.stack([x / width, y / height, (x + y) / (width + height)], -1)
    before = numpy.array([0.75, 0.5, 0.125]) * (0.25 + 0.75 * (y / height))[..., None]
    picture = numpy.where(disc(width, height)[..., None], before, behind)
    return 0.9 * picture + 0.1 * random(width, height, 5)


def pair(kind, width, height, amount):
    single = lambda v: v.astype(numpy.float32)
    if kind == "mixed":
        return single(mixed(width, height, 1, 1 - amount / 2)), single(mixed(width, height, 2, 1 - amount))
    if kind == "black_white":
        return [numpy.full((height, width, 3), v, numpy.float32) for v in (0, 1)]
    if kind == "checkers":
        y, x = numpy.mgrid[0:height, 0:width]
        board = (x // int(amount) + y // int(amount)) % 2 * numpy.ones((3, 1, 1))
        return single(board.transpose(1, 2, 0)), single(1 - board.transpose(1, 2, 0))
    a = single(scene(width, height)).astype(numpy.float64)
    if kind == "identical":
        b = a
    elif kind == "noise":
        b = numpy.clip(a + amount * (random(width, height, 9) - 0.5), 0, 1)
    elif kind == "blur":
        padded = numpy.pad(a, ((1, 1), (1, 1), (0, 0)), mode="edge")
        b = numpy.zeros_like(a)
        for dy in range(3):
            for dx in range(3):
                b = b + padded[dy:dy + height, dx:dx + width]
        b = b / 9
    elif kind == "shift":
        b = numpy.roll(a, int(amount), 1)
    elif kind == "cast":
        b = a * (1 - amount * numpy.array([0.0, 0.25, 1.0]))
    elif kind == "dark":
        a, b = a * amount, a * amount * 0.5 + amount * 0.25
    return single(a), single(b)


def described():
    for kind, width, height, amount in PAIRS:
        a, b = pair(kind, width, height, amount)
        yield {"kind": kind, "width": width, "height": height, "amount": amount}, a, b, disc(width, height)
