"""Points in the unit cube for any range of variants: the same numbers in every split, in constant memory.

Each sampler is a function of the number of the variant and of a seed only.  Random numbers come from Philox, whose
counter is the number of a block of variants (Salmon et al. 2011); Sobol points from scipy.stats.qmc, which jumps to any
place; a Latin hypercube of n variants takes the strata of each coordinate in an order that is a permutation of
0 .. n - 1 with access to any entry (`permuted`), and a random place inside of the stratum.
"""

from __future__ import annotations

import numpy as np

BLOCK = 1024  # variants that share one counter of Philox
BITS = 30  # of a Sobol sequence, which ends after 2^30 points
_CELL = 2.0 ** -(BITS + 1)  # to the middle of its cell, so that none is 0
_LEAST, _LARGEST = 2.0**-54, 1.0 - 2.0**-53  # of the numbers in (0, 1)


def uniform(seed: tuple[int, ...], first: int, count: int, dimensions: int) -> np.ndarray:
    """Independent numbers of (0, 1) for variants first .. first + count - 1, shape (count, dimensions)."""
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    numbers = np.empty((count, dimensions))
    at = first
    while at < first + count:
        block, offset = divmod(at, BLOCK)
        drawn = np.random.Generator(np.random.Philox(counter=[0, 0, 0, block], key=key)).random((BLOCK, dimensions))
        size = min(BLOCK - offset, first + count - at)
        numbers[at - first : at - first + size] = drawn[offset : offset + size]
        at += size
    return np.maximum(numbers, _LEAST)  # never 0, whose quantile may be infinite


def sobol(seed: tuple[int, ...], first: int, count: int, dimensions: int) -> np.ndarray:
    """Points of the scrambled Sobol sequence, shape (count, dimensions)."""
    from scipy.stats import qmc  # not for commands that only read

    if not dimensions:
        return np.empty((count, 0))
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    sequence = qmc.Sobol(dimensions, scramble=True, bits=BITS, rng=rng)
    if first:
        sequence.fast_forward(first)
        return sequence.random(count) + _CELL
    # one and the rest: SciPy warns of a first call for other than a power of 2, of which each chunk is only a part
    return np.concatenate([sequence.random(min(count, 1)), sequence.random(max(count - 1, 0))]) + _CELL


def latin_hypercube(seed: tuple[int, ...], first: int, count: int, dimensions: int, total: int) -> np.ndarray:
    """Points of a Latin hypercube of `total` points: one in each stratum of each coordinate."""
    inside = uniform((*seed, 1), first, count, dimensions)
    number = np.arange(first, first + count, dtype=np.uint64)
    points = np.empty((count, dimensions))
    for j in range(dimensions):
        strata = permuted(number, total, (*seed, 2, j))
        points[:, j] = np.minimum((strata + inside[:, j]) / total, _LARGEST)
    return points


_ROUNDS = 6


def permuted(number: np.ndarray, total: int, seed: tuple[int, ...]) -> np.ndarray:
    """Apply a random permutation of 0 .. total - 1 to numbers; dtype uint64, same shape.

    A Feistel network permutes 0 .. 4^h - 1, where 4^h >= total; results of `total` or more are permuted again until
    they are below it (Black & Rogaway 2002, cycle walking): on average less than four times.
    """
    half = np.uint64(max(1, ((total - 1).bit_length() + 1) // 2))
    mask = (np.uint64(1) << half) - np.uint64(1)
    keys = np.random.SeedSequence(seed).generate_state(_ROUNDS, np.uint64)
    image = number.astype(np.uint64)
    outside = np.arange(image.size)
    while outside.size:
        left, right = image[outside] >> half, image[outside] & mask
        for key in keys:
            left, right = right, left ^ (_mixed(right ^ key) & mask)
        image[outside] = (left << half) | right
        outside = outside[image[outside] >= np.uint64(total)]
    return image


def _mixed(x: np.ndarray) -> np.ndarray:
    """The finalizer of SplitMix64 (Steele, Lea & Flood 2014): every bit of the result depends on every bit of x."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def saltelli(seed: tuple[int, ...], first: int, count: int, groups: tuple[int, ...], total: int) -> np.ndarray:
    """Points of a sensitivity analysis, shape (count, dimensions): `total` rows A, as many B, then AB_1 .. AB_k.

    A and B are the halves of one Sobol sequence; AB_j is A with the coordinates of factor j from B, of which there are
    groups[j].  Source: Saltelli et al. 2010, as in scipy.stats.sobol_indices.
    """
    dimensions = sum(groups)
    ends = np.cumsum((0, *groups))
    rows = np.empty((count, dimensions))
    at = first
    while at < first + count:
        part, row = divmod(at, total)
        size = min(total - row, first + count - at)
        both = sobol(seed, row, size, 2 * dimensions)
        points = both[:, :dimensions].copy() if part != 1 else both[:, dimensions:]
        if part > 1:
            own = slice(ends[part - 2], ends[part - 1])
            points[:, own] = both[:, dimensions:][:, own]
        rows[at - first : at - first + size] = points
        at += size
    return rows


def grid(first: int, count: int, steps: tuple[int, ...]) -> np.ndarray:
    """Indices of the points of a grid, the last coordinate fastest, shape (count, dimensions)."""
    number = np.arange(first, first + count, dtype=np.int64)
    indices = np.empty((count, len(steps)), dtype=np.int64)
    for j in range(len(steps) - 1, -1, -1):
        number, indices[:, j] = np.divmod(number, steps[j])
    return indices
