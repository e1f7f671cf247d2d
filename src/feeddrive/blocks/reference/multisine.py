"""A periodic sum of sines: the excitation for frequency responses."""

from functools import cached_property

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.derivatives import Derivatives, product, resting
from feeddrive.blocks.reference.smooth_step import window
from feeddrive.blocks.sampled import check_duration, check_single
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity, span

# each line costs a sine in every sample
_MOST_LINES = 20000
# points per period of the highest line: between them the sum exceeds the peak by at most the factor 1/cos(π/32)
_FINE = 32


class Multisine(Reference):
    """A motion x = center + w(t) · scale · Σ wₖ sin(2π k t / period + φₖ), over lines k / period in a band.

    Of the multiples of 1/period between `lowest` and `highest`, `lines` carry equal amplitudes of position, velocity or
    acceleration (`flat`): wₖ = 1, 1/k or 1/k².  The phases are those of Schroeder, φₖ = -2π Σᵢ (k - i) pᵢ over all
    lower lines i with power shares pᵢ, or random phases that depend only on `seed` and the line.
    The scale is such that |x - center| never exceeds `amplitude` and reaches at least 0.995 of it: the peak is taken on
    a grid of 32 points per period of the highest line, divided by cos(π/32) (Ehlich & Zeller 1964).  The sum is shifted
    in time so that the motion starts and ends at the center, at the zero crossing with the lowest speed.

    Without `blend_time`, w is 1, and the velocity jumps at both ends.  With it, the periodic motion is extended by this
    time before the first and after the last period, and w rises and falls there.  Whole periods remain unchanged.
    Source: Schroeder 1970; Pintelon & Schoukens 2012, chapter 5.
    """

    amplitude: Number = parameter("m", "largest distance from the center", least=0)
    lowest: Number = parameter("Hz", "lower end of the band", above=0)
    highest: Number = parameter("Hz", "upper end of the band", above=0)
    period: Number = parameter("s", "time after which it repeats; its inverse is the frequency resolution", above=0)
    periods: int = choice("number of whole periods", default=1, least=1)
    lines: int = choice("how many lines are spread over the band; 0 for all", default=0, least=0)
    spread: str = choice(
        "where the lines lie if not all are taken", options=("linear", "logarithmic"), default="logarithmic"
    )
    flat: str = choice(
        "the derivative in which all lines are equal",
        options=("position", "velocity", "acceleration"),
        default="position",
    )
    phases: str = choice("how phases are chosen", options=("schroeder", "random"), default="schroeder")
    seed: int = choice("of random phases", default=0, least=0)
    center: Number = parameter("m", "position at start and end", default=0)
    blend_time: Number = parameter("s", "length of run-in and run-out; 0 s for none", default=0, least=0)

    def check(self) -> None:
        """Raise ParameterError for an empty band, StructureError if there are no lines in it or too many."""
        check_single(self)
        check_duration(self.kind, self.duration)
        if self.highest < self.lowest:
            raise ParameterError(
                f"multisine.highest = {Quantity(self.highest, 'Hz'):6} must be >= multisine.lowest, "
                f"{Quantity(self.lowest, 'Hz'):6}"
            )
        if self.highest * self.period > _MOST_LINES:
            raise StructureError(
                f"multisine has lines up to number {Quantity(self.highest * self.period):3} of 1/period, more than "
                f"{_MOST_LINES}: shorten the period or the band"
            )
        if self._all_lines().size == 0:
            raise StructureError(
                f"multisine has no line: no multiple of 1/period = {Quantity(1.0 / self.period, 'Hz'):6} lies in "
                f"{span(self.lowest, self.highest, 'Hz', '6', between='..')}; make the period "
                "longer"
            )

    def _all_lines(self) -> np.ndarray:
        # 1e-12: a line on an edge of the band belongs to it, however the product is rounded
        low = np.ceil(self.lowest * self.period * (1.0 - 1e-12))
        return np.arange(max(low, 1.0), np.floor(self.highest * self.period * (1.0 + 1e-12)) + 1.0)

    @cached_property
    def numbers(self) -> np.ndarray:
        """The multiples k of 1/period at which the signal has a frequency line."""
        every = self._all_lines()
        if self.lines == 0 or self.lines >= every.size:
            return every
        if self.spread == "linear":
            wanted = np.linspace(every[0], every[-1], self.lines)
        else:
            wanted = np.geomspace(every[0], every[-1], self.lines)
        return np.unique(np.rint(wanted))

    def frequencies(self) -> np.ndarray:
        """Return the line frequencies in Hz, fewer than `lines` if low lines coincide in logarithmic spacing."""
        return self.numbers / self.period

    @cached_property
    def _waves(self) -> tuple[np.ndarray, np.ndarray]:
        """The amplitudes in m and the phases in rad of the lines."""
        k = self.numbers
        weights = k ** -float(("position", "velocity", "acceleration").index(self.flat))
        phases = self._first_phases(weights)
        # a power of two, for which the transform is fastest
        count = int(2 ** np.ceil(np.log2(_FINE * k[-1])))
        spectrum = np.zeros((2, count // 2 + 1), dtype=np.complex128)
        places = k.astype(np.int64)
        spectrum[0, places] = weights * np.exp(1j * (phases - 0.5 * np.pi))
        spectrum[1] = spectrum[0] * 1j * np.arange(count // 2 + 1)
        # irfft counts each line twice and divides by the number of points
        fine, slope = np.fft.irfft(spectrum, count) * (0.5 * count)
        peak = float(np.max(np.abs(fine))) / np.cos(np.pi / _FINE)
        crossing = np.flatnonzero((fine <= 0.0) != (np.roll(fine, -1) <= 0.0))
        left = int(crossing[np.argmin(np.abs(slope[crossing]))])
        shift = self._zero(weights, phases, left / count, (left + 1) / count)
        return self.amplitude / peak * weights, np.remainder(phases + 2.0 * np.pi * k * shift, 2.0 * np.pi)

    def _first_phases(self, weights: np.ndarray) -> np.ndarray:
        if self.phases == "random":
            return 2.0 * np.pi * ops.uniform(float(self.seed), self.numbers, 0.0)
        shares = weights**2 / np.sum(weights**2)
        below = np.concatenate([[0.0], np.cumsum(shares)[:-1]])
        moments = np.concatenate([[0.0], np.cumsum(shares * self.numbers)[:-1]])
        return -2.0 * np.pi * (self.numbers * below - moments)

    def _zero(self, weights: np.ndarray, phases: np.ndarray, low: float, high: float) -> float:
        """Return a zero of the sum between `low` and `high` (in periods), where it changes sign, by bisection."""

        def value(share: float) -> float:
            return float(np.sum(weights * np.sin(2.0 * np.pi * self.numbers * share + phases)))

        sign = value(low) <= 0.0
        # 2⁻⁶⁰ of a period is below the rounding of any time in it
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if (value(middle) <= 0.0) == sign else (low, middle)
        return 0.5 * (low + high)

    @property
    def duration(self) -> float:
        """The duration of all periods and both blends, s."""
        return self.periods * self.period + 2.0 * self.blend_time

    def at(self, t: np.ndarray) -> Setpoint:
        times = np.asarray(t, dtype=np.float64)
        inside = np.clip(times, 0.0, self.duration)
        moved = self._sum((inside - self.blend_time) / self.period)
        if self.blend_time > 0.0:
            moved = product(window(inside, self.duration, self.blend_time), moved)
        return resting(times, self.duration, (self.center + moved[0], *moved[1:]), self.center, self.center)

    def _sum(self, place: np.ndarray) -> Derivatives:
        """Return the sum and its derivatives at the times `place`, which are in periods."""
        # whole periods are dropped first, so that late ones keep their digits
        share = place - np.floor(place)
        sums = np.zeros((5, *share.shape))
        for k, height, phase in zip(self.numbers, *self._waves, strict=True):
            angle = 2.0 * np.pi * k * share + phase
            rate = 2.0 * np.pi * k / self.period
            sine, cosine = height * np.sin(angle), height * np.cos(angle)
            sums += np.stack([sine, rate * cosine, -(rate**2) * sine, -(rate**3) * cosine, rate**4 * sine])
        return sums[0], sums[1], sums[2], sums[3], sums[4]
