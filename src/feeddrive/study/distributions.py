"""Distributions of one number as quantile functions, and the points of the unit cube at which they are evaluated.

A quantile function maps u in (0, 1) to the value below which a number lies with the probability u.  All samplers draw
points in (0, 1), so that a Latin hypercube or a Sobol sequence can be used with any distribution.  A range
`least`..`most` truncates a distribution: the probability outside is spread proportionally over the inside, not
concentrated at the ends.  Numbers are in SI units.

Each sampler is a function of the variant number and a seed only, so that the points do not depend on how the variants
are split into chunks, and memory is constant.  Random numbers come from Philox, whose counter is the number of a block
of variants (Salmon et al. 2011); Sobol points come from scipy.stats.qmc, which can jump to any index.  A Latin
hypercube of n variants visits the strata of each coordinate in the order of a random-access permutation of 0 .. n - 1
(`permuted`), at a random position within the stratum.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import number

# Part of the definition of the points: another block length gives other variants for the same seed.
BLOCK = 1024  # variants that share one Philox counter
BITS = 30  # of a Sobol sequence, which has 2^30 points
_CELL = 2.0 ** -(BITS + 1)  # shift to the center of a cell, so that no point is 0
# Generator.random returns multiples of 2^-53 in [0, 1): half of the smallest replaces 0; the other is the largest
# double below 1.
_LEAST, _LARGEST = 2.0**-54, 1.0 - 2.0**-53


def uniform(seed: tuple[int, ...], first: int, count: int, dimensions: int) -> np.ndarray:
    """Return uniform random numbers in (0, 1) for variants first .. first + count - 1, shape (count, dimensions)."""
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    numbers = np.empty((count, dimensions))
    at = first
    while at < first + count:
        block, offset = divmod(at, BLOCK)
        # The highest word of the counter numbers the block, so blocks never overlap. A block is always drawn whole: a
        # row then has the same numbers in every split.
        drawn = np.random.Generator(np.random.Philox(counter=[0, 0, 0, block], key=key)).random((BLOCK, dimensions))
        size = min(BLOCK - offset, first + count - at)
        numbers[at - first : at - first + size] = drawn[offset : offset + size]
        at += size
    # Never 0, whose quantile may be infinite.
    return np.maximum(numbers, _LEAST)


def sobol(seed: tuple[int, ...], first: int, count: int, dimensions: int) -> np.ndarray:
    """Return points first .. first + count - 1 of the scrambled Sobol sequence, shape (count, dimensions)."""
    # Deferred: commands that only read a study do not need it.
    from scipy.stats import qmc

    if not dimensions:
        return np.empty((count, 0))
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    sequence = qmc.Sobol(dimensions, scramble=True, bits=BITS, rng=rng)
    if first:
        sequence.fast_forward(first)
        return sequence.random(count) + _CELL
    # SciPy warns if the first call is not for a power of 2 points, so draw one point, then the rest
    return np.concatenate([sequence.random(min(count, 1)), sequence.random(max(count - 1, 0))]) + _CELL


def latin_hypercube(seed: tuple[int, ...], first: int, count: int, dimensions: int, total: int) -> np.ndarray:
    """Return `count` points of a Latin hypercube of `total` points: each coordinate has one point in each stratum."""
    # Different suffixes of the seed make the position within a stratum independent of the permutation.
    inside = uniform((*seed, 1), first, count, dimensions)
    number = np.arange(first, first + count, dtype=np.uint64)
    points = np.empty((count, dimensions))
    for j in range(dimensions):
        strata = permuted(number, total, (*seed, 2, j))
        # The quotient of the last stratum may round to 1.
        points[:, j] = np.minimum((strata + inside[:, j]) / total, _LARGEST)
    return points


_ROUNDS = 6


def permuted(number: np.ndarray, total: int, seed: tuple[int, ...]) -> np.ndarray:
    """Apply a random permutation of 0 .. total - 1 to numbers; dtype uint64, same shape.

    A Feistel network permutes 0 .. 4^h - 1, where 4^h >= total; results of `total` or more are permuted again until
    they are below it (Black & Rogaway 2002, cycle walking): on average fewer than four times.
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
    """Apply the finalizer of SplitMix64 (Steele, Lea & Flood 2014): every output bit depends on every bit of x."""
    # The products are meant to wrap modulo 2^64, which numpy does silently for arrays.
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def saltelli(seed: tuple[int, ...], first: int, count: int, groups: tuple[int, ...], total: int) -> np.ndarray:
    """Return points of a Sobol sensitivity analysis, shape (count, dimensions): A, B, AB_1 .. AB_k, `total` rows each.

    A and B are the halves of one Sobol sequence; AB_j is A with the groups[j] coordinates of factor j
    replaced by those of B.  Source: Saltelli et al. 2010, as in scipy.stats.sobol_indices.
    """
    dimensions = sum(groups)
    ends = np.cumsum((0, *groups))
    rows = np.empty((count, dimensions))
    at = first
    while at < first + count:
        part, row = divmod(at, total)
        size = min(total - row, first + count - at)
        # Row r of each matrix is made from row r of one sequence of 2 d coordinates, drawn again for every matrix:
        # memory stays constant.
        both = sobol(seed, row, size, 2 * dimensions)
        points = both[:, :dimensions].copy() if part != 1 else both[:, dimensions:]
        if part > 1:
            own = slice(ends[part - 2], ends[part - 1])
            points[:, own] = both[:, dimensions:][:, own]
        rows[at - first : at - first + size] = points
        at += size
    return rows


def grid(first: int, count: int, steps: tuple[int, ...]) -> np.ndarray:
    """Return the indices of grid points, shape (count, dimensions); the last coordinate varies fastest."""
    number = np.arange(first, first + count, dtype=np.int64)
    indices = np.empty((count, len(steps)), dtype=np.int64)
    for j in range(len(steps) - 1, -1, -1):
        number, indices[:, j] = np.divmod(number, steps[j])
    return indices


class Distribution(Protocol):
    """The distribution of a number, or of a choice among several values."""

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u in (0, 1), with the shape of u."""
        ...

    def range(self) -> tuple[float, float]:
        """Return the least and the largest possible value; infinite if there is no limit."""
        ...


@dataclass(frozen=True)
class Uniform:
    """The uniform distribution from least to most."""

    least: float
    most: float

    def __post_init__(self) -> None:
        _ordered("uniform", self.least, self.most)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u."""
        return self.least + u * (self.most - self.least)

    def range(self) -> tuple[float, float]:
        """Return both ends of the range."""
        return self.least, self.most


@dataclass(frozen=True)
class LogUniform:
    """The log-uniform distribution from least to most, both > 0."""

    least: float
    most: float

    def __post_init__(self) -> None:
        _ordered("loguniform", self.least, self.most)
        _positive("loguniform", "least", self.least)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u."""
        return self.least * np.exp(u * math.log(self.most / self.least))

    def range(self) -> tuple[float, float]:
        """Return both ends of the range."""
        return self.least, self.most


@dataclass(frozen=True)
class Normal:
    """The normal distribution with a mean and a standard deviation, truncated to least..most."""

    mean: float
    deviation: float
    least: float = -math.inf
    most: float = math.inf

    def __post_init__(self) -> None:
        _positive("normal", "deviation", self.deviation)
        _ordered("normal", self.least, self.most)
        _within_reach("normal", self.least, self.most, self.mean, self.deviation)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u."""
        z = truncated(u, (self.least - self.mean) / self.deviation, (self.most - self.mean) / self.deviation)
        # Rounding may exceed an end by a last bit, which a parameter with that bound would refuse.
        return np.clip(self.mean + self.deviation * z, self.least, self.most)

    def range(self) -> tuple[float, float]:
        """Return both ends of the range."""
        return self.least, self.most


@dataclass(frozen=True)
class LogNormal:
    """The log-normal distribution: before truncation, ln x has the mean ln(median) and the deviation ln(ratio)."""

    median: float
    ratio: float
    least: float = 0.0
    most: float = math.inf

    def __post_init__(self) -> None:
        _positive("lognormal", "nominal", self.median)
        if not (math.isfinite(self.ratio) and self.ratio > 1.0):
            raise ParameterError(f"ratio = {number(self.ratio, 6)} of a lognormal distribution must be > 1")
        _ordered("lognormal", self.least, self.most)
        low, high = self._logarithms()
        _within_reach("lognormal", low, high, 0.0, 1.0)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u."""
        z = truncated(u, *self._logarithms())
        return np.clip(self.median * np.exp(math.log(self.ratio) * z), self.least, self.most)

    def _logarithms(self) -> tuple[float, float]:
        """Return both ends of the range as deviations of ln x from its mean, in standard deviations."""
        low, high = (
            -math.inf if end <= 0.0 else math.log(end / self.median) / math.log(self.ratio)
            for end in (self.least, self.most)
        )
        return low, high

    def range(self) -> tuple[float, float]:
        """Return both ends of the range."""
        return max(self.least, 0.0), self.most


@dataclass(frozen=True)
class Triangular:
    """The triangular distribution with its mode between least and most."""

    least: float
    mode: float
    most: float

    def __post_init__(self) -> None:
        _ordered("triangular", self.least, self.most)
        if not self.least <= self.mode <= self.most:
            raise ParameterError(
                f"nominal = {number(self.mode, 6)}, the mode of a triangular distribution, must be in "
                f"{number(self.least, 6)}..{number(self.most, 6)}"
            )

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles at u."""
        width, left, right = self.most - self.least, self.mode - self.least, self.most - self.mode
        rising = self.least + np.sqrt(u * width * left)
        falling = self.most - np.sqrt((1.0 - u) * width * right)
        return np.where(u * width < left, rising, falling)

    def range(self) -> tuple[float, float]:
        """Return both ends of the range."""
        return self.least, self.most


@dataclass(frozen=True)
class Discrete:
    """The distribution over several values, numbers or strings, with probabilities proportional to weights."""

    values: tuple[Any, ...]
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.values:
            raise ParameterError("values must have at least one entry")
        if self.weights and len(self.weights) != len(self.values):
            raise ParameterError(f"{len(self.weights)} weights for {len(self.values)} values: give one for each")
        if any(not (math.isfinite(weight) and weight >= 0.0) for weight in self.weights) or not sum(
            self.weights or (1.0,)
        ):
            raise ParameterError("weights must be finite numbers >= 0, one of them > 0")

    def places(self, u: np.ndarray) -> np.ndarray:
        """Return the indices of the values selected by u in (0, 1)."""
        weights = np.array(self.weights or (1.0,) * len(self.values))
        edges = np.cumsum(weights / weights.sum())
        # The rounded sum may stay below 1, and a u above it would select no value.
        edges[-1] = 1.0
        return np.minimum(np.searchsorted(edges, u, side="right"), len(self.values) - 1)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the values selected by u: an array of floats, or of objects if the values are strings or integers."""
        kind = np.float64 if all(isinstance(value, float) for value in self.values) else object
        # `np.array(values)` would convert mixed numbers and texts to texts.
        row = np.empty(len(self.values), dtype=kind)
        row[:] = self.values
        return row[self.places(u)]

    def range(self) -> tuple[float, float]:
        """Return the least and the largest number, or infinite ends if any value is not a float."""
        if all(isinstance(value, float) for value in self.values):
            return min(self.values), max(self.values)
        return -math.inf, math.inf


def truncated(u: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return quantiles of the normal distribution N(0, 1) truncated to low..high; either end may be infinite.

    Above 0, the complementary probabilities are used to avoid cancellation; the relative error is below 1e-12.
    """
    # Deferred: commands that only read a study do not need it.
    from scipy.special import ndtr, ndtri

    if low > 0.0:
        return -truncated(1.0 - u, -high, -low)
    return ndtri(ndtr(low) + u * (ndtr(high) - ndtr(low)))


# A range farther out than 6 deviations has a probability below 1e-9.
_FARTHEST = 6.0


def _ordered(kind: str, least: float, most: float) -> None:
    if math.isnan(least) or math.isnan(most) or not least < most:
        raise ParameterError(f"least = {number(least, 6)} of a {kind} distribution must be < most = {number(most, 6)}")
    if kind in ("uniform", "loguniform", "triangular") and not (math.isfinite(least) and math.isfinite(most)):
        raise ParameterError(f"a {kind} distribution needs least and most, or a tolerance, as finite numbers")


def _positive(kind: str, name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(f"{name} = {number(value, 6)} of a {kind} distribution must be a finite number > 0")


def _within_reach(kind: str, least: float, most: float, middle: float, deviation: float) -> None:
    """Raise ParameterError if a normal distribution has practically no probability within a range."""
    if (least - middle) / deviation > _FARTHEST or (middle - most) / deviation > _FARTHEST:
        raise ParameterError(
            f"the range of a {kind} distribution lies more than {number(_FARTHEST)} deviations from its middle: it "
            "would hold less than 1e-9 of it"
        )
