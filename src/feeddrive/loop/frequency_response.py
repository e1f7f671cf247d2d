"""Frequency response functions (FRF): measured, or computed from a linear model at many frequencies."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from feeddrive.language.errors import MissingExtraError, ParameterError
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text


def transfer(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, z: np.ndarray) -> np.ndarray:
    """Return c (z - A)⁻¹ b + d at every z, shape (n,); see `transfers`."""
    return transfers(A, b[:, None], c[None], np.array([[d]]), z)[0, 0]


def transfers(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return C (z - A)⁻¹ B + D at every z, shape (outputs, inputs, n), from the Schur form of the balanced A.

    The transformation is unitary, so the result is as accurate as solving for each z; it is obtained ten times as
    fast, and a hundred times as fast for 200 states.
    """
    # imported here: commands that only read files do not load scipy
    from scipy.linalg import matrix_balance, schur

    # m and N differ by ten powers of ten: unbalanced, the rounding of the large ones would swallow the small ones
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    form = schur(balanced, output="complex")
    S, Z = form[0], form[1]
    left = (C * scale) @ Z
    right = np.repeat((Z.conj().T @ (B / scale[:, None]))[:, :, None], z.size, axis=2)
    values = np.repeat(D.astype(complex)[:, :, None], z.size, axis=2)
    for i in range(scale.size - 1, -1, -1):
        x = right[i] / (z - S[i, i])
        right[:i] += S[:i, i, None, None] * x
        values += left[:, i, None, None] * x
    return values


TRUSTED = 0.9  # least coherence of a line that is used for tuning
AVERAGES = 8  # assumed number of averages of a coherence without a variance
# smaller values count as this, since the variance divides by the coherence
_LEAST_COHERENCE = 1e-3
# Radius of the 95 % disc in roots of E|dG|²: for a circular complex normal error P(|dG| > r) = exp(-r²/E|dG|²).
_DISC = float(np.sqrt(-np.log(0.05)))


def coherence_of(response: np.ndarray, variance: np.ndarray, freedom: np.ndarray | float) -> np.ndarray:
    """Return γ² = 1/(1 + ν var(G)/|G|²), ν = `freedom`: the ordinary coherence at which ν + 1 averages have this
    variance.
    """
    power = np.abs(response) ** 2
    return power / (power + freedom * variance)


def variance_of(response: np.ndarray, coherence: np.ndarray, averages: float = AVERAGES) -> np.ndarray:
    """Return var(G) = |G|² (1 - γ²)/(γ² averages) of each frequency line, from the ordinary coherence γ².

    A coherence below 0.001 counts as 0.001.  Source: Bendat & Piersol, Random Data, section 9.2.
    """
    share = np.maximum(coherence, _LEAST_COHERENCE)
    return np.abs(response) ** 2 * (1.0 - share) / (share * averages)


_PHASE_LINES = 9  # over which the phase of a response is compared: fewer agree by chance, more blur a resonance
_PHASE_ABOVE = 2.0  # times its standard deviation: one line of noise in 55 is as large
_PHASE_COHERENT = 0.5  # half of the output follows the input
_PHASE_AGREES = 0.6  # mean of nine steps of unit length: noise exceeds it once in 30, one flip by 180 degrees keeps 0.7


@dataclass(frozen=True, eq=False, repr=False)
class FRF(Result):
    """The frequency response from `input` to `output` at `frequency` in Hz, shape (n,); `unit` is the SI unit of output
    over input.

    `coherence` and `variance`, shape (n,), belong to a measured FRF; variance is E|dG|² of the complex `response`,
    averaged or not.  Arithmetic with numbers, and with other FRFs at the same frequencies, works as with arrays.
    The variance is propagated to first order if only one operand has one:

        var(c G) = |c|² var(G),   var(c + G) = var(G),   var(1/G) = var(G)/|G|⁴

    Two FRFs with variances usually come from one experiment, so their errors are correlated in an unknown way.  Their
    combination therefore has no variance.  An FRF without variance counts as exact when combined with one that has it.
    Raises ParameterError for frequencies that are not positive and increasing, for NaN, for a coherence outside 0..1
    and for a variance below 0.
    """

    frequency: np.ndarray
    response: np.ndarray
    input: str = "input"
    output: str = "output"
    unit: str = ""
    sample_time: float | None = None
    coherence: np.ndarray | None = None
    variance: np.ndarray | None = None

    def __post_init__(self) -> None:
        frequency, response = np.asarray(self.frequency, float), np.asarray(self.response, complex)
        if frequency.ndim != 1 or frequency.shape != response.shape:
            raise ParameterError(
                f"an FRF needs one response for each frequency, not {response.shape} for {frequency.shape}"
            )
        self._check_finite(frequency, response)
        # from 0 on: the first frequency must be positive, too
        wrong = np.flatnonzero(np.diff(frequency, prepend=0.0) <= 0.0)
        if wrong.size:
            i = int(wrong[0])
            before = Text(f" after {Quantity(frequency[i - 1], 'Hz'):6}") if i else ""
            raise ParameterError(
                f"the frequencies of an FRF must be positive and rise from line to line: line {i + 1} of the one from "
                f"{self.input} to {self.output} is {Quantity(frequency[i], 'Hz'):6}{before} ({wrong.size} such lines)"
            )
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "response", response)
        self._check("coherence", 1.0)
        self._check("variance", np.inf)

    def _check_finite(self, frequency: np.ndarray, response: np.ndarray) -> None:
        wrong = np.flatnonzero(~(np.isfinite(frequency) & np.isfinite(response)))
        if wrong.size:
            i = int(wrong[0])
            raise ParameterError(
                f"the FRF from {self.input} to {self.output} holds numbers that are not finite: line {i + 1} is "
                f"{Quantity(response[i].real):.6g}{Quantity(response[i].imag):+.6g}j at "
                f"{Quantity(frequency[i], 'Hz'):6} ({wrong.size} such lines)"
            )

    def _check(self, name: str, most: float) -> None:
        """Check that an array has one number per frequency line, finite and between 0 and `most`."""
        if getattr(self, name) is None:
            return
        values = np.asarray(getattr(self, name), float)
        if values.shape != self.frequency.shape:
            raise ParameterError(f"an FRF needs one {name} for each frequency, not {values.shape}")
        wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0) & (values <= most)))
        if wrong.size:
            i = int(wrong[0])
            bounds = Text(f"between 0 and {Quantity(most):6}") if np.isfinite(most) else "finite and at least 0"
            raise ParameterError(
                f"the FRF from {self.input} to {self.output}: {name} is {Quantity(values[i]):6} at "
                f"{Quantity(self.frequency[i], 'Hz'):6}, it must be {bounds} ({wrong.size} of {values.size} lines are "
                "not)"
            )
        object.__setattr__(self, name, values)

    @property
    def magnitude(self) -> np.ndarray:
        """The magnitude |response|."""
        return np.abs(self.response)

    @property
    def phase_deg(self) -> np.ndarray:
        """The phase in degrees, unwrapped along the frequency lines that rise above the noise, starting at the first of
        them.

        A multiple of 360° is added to every other line to bring it closest to the phase interpolated between these
        lines, so that noise does not add up to thousands of degrees.
        """
        angle, clear = np.angle(self.response), self._clear_lines()
        if np.all(clear) or not np.any(clear):
            return np.degrees(np.unwrap(angle) if np.all(clear) else angle)
        turned = np.interp(self.frequency, self.frequency[clear], np.unwrap(angle[clear]))
        return np.degrees(angle + 2.0 * np.pi * np.round((turned - angle) / (2.0 * np.pi)))

    def _clear_lines(self) -> np.ndarray:
        """Return a mask of the frequency lines that rise above the noise, by their variance, by their coherence, or if
        neither is known by their neighbors.

        Without variance and coherence a line is clear if the steps of the phase around it agree: |mean exp(i Δφ)| over
        `_PHASE_LINES` lines is above `_PHASE_AGREES`; it is 1 for a smooth phase and about 1/3 for noise.
        """
        # a few lines are a model's, or show no noise
        if self.frequency.size < 2 * _PHASE_LINES:
            return np.ones(self.frequency.size, bool)
        # imported here: commands that only read a log start without it
        from scipy.ndimage import uniform_filter1d

        if self.variance is not None:
            clear = np.abs(self.response) > _PHASE_ABOVE * np.sqrt(self.variance)
        elif self.coherence is not None:
            clear = np.asarray(self.coherence) > _PHASE_COHERENT
        else:
            steps = np.diff(np.angle(self.response), prepend=np.angle(self.response[0]))
            agree = [uniform_filter1d(part, _PHASE_LINES, mode="nearest") for part in (np.cos(steps), np.sin(steps))]
            clear = np.hypot(*agree) > _PHASE_AGREES
        # a line of noise exceeds the bound by chance, but not most of its neighbors
        return clear & (uniform_filter1d(clear.astype(float), 3 * _PHASE_LINES, mode="nearest") > 0.5)

    @property
    def deviation(self) -> np.ndarray | None:
        """The standard deviation of the complex response, √variance; None if it is unknown."""
        return None if self.variance is None else np.sqrt(self.variance)

    @property
    def radius(self) -> np.ndarray | None:
        """The radius of the 95 % confidence disc around each value, √(-ln 0.05 · variance); None if the variance is
        unknown.

        It is valid for a complex normal error whose variance is known, not estimated from few averages.
        """
        return None if self.variance is None else _DISC * np.sqrt(self.variance)

    def known_variance(self, averages: float = AVERAGES) -> np.ndarray | None:
        """Return the variance if known, otherwise that computed from the coherence for this number of averages (see
        `variance_of`), or None if neither is known.
        """
        if self.variance is None and self.coherence is not None:
            return variance_of(self.response, self.coherence, averages)
        return self.variance

    def _with(self, response: Any, variance: Any) -> Self:
        # a coherence belongs to the two signals that were measured
        return replace(self, response=response, coherence=None, variance=variance)

    def _variances(self, other: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return the variances of both operands; None for both if both have one, since errors may be correlated."""
        theirs = other.variance if isinstance(other, FRF) else None
        return (self.variance, theirs) if self.variance is None or theirs is None else (None, None)

    def _other(self, other: Any) -> Any:
        if isinstance(other, FRF):
            if other.frequency.shape != self.frequency.shape or np.any(other.frequency != self.frequency):
                raise ParameterError("two FRFs on different frequencies cannot be combined")
            return other.response
        return other

    def __mul__(self, other: Any) -> Self:
        factor = self._other(other)
        mine, theirs = self._variances(other)
        variance = None if mine is None else np.abs(factor) ** 2 * mine
        if theirs is not None:
            variance = np.abs(self.response) ** 2 * theirs
        return self._with(self.response * factor, variance)

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Self:
        mine, theirs = self._variances(other)
        return self._with(self.response + self._other(other), theirs if mine is None else mine)

    __radd__ = __add__

    def __neg__(self) -> Self:
        return self._with(-self.response, self.variance)

    def inverse(self) -> Self:
        """Return the inverse response, from output to input."""
        parts = self.unit.split("/")
        unit = "/".join(reversed(parts)) if len(parts) == 2 else ""
        variance = None if self.variance is None else self.variance / self.magnitude**4
        return replace(
            self,
            response=1.0 / self.response,
            unit=unit,
            input=self.output,
            output=self.input,
            coherence=None,
            variance=variance,
        )

    def delayed(self, time: float) -> Self:
        """Return the response with an exact dead time τ in s, G e^(-j2πfτ), for any τ, whatever the sample time."""
        return self * np.exp(-2j * np.pi * self.frequency * time)

    def to_control(self) -> Any:
        """Return a python-control FRD over rad/s, with names and sample time, without coherence and variance.

        Raises MissingExtraError if python-control is not installed.
        """
        try:
            import control
        except ImportError as error:
            raise MissingExtraError("control", "control", "handing an FRF to python-control") from error
        return control.frd(
            self.response,
            2.0 * np.pi * self.frequency,
            # 0 is continuous time in python-control
            self.sample_time or 0,
            inputs=[self.input],
            outputs=[self.output],
        )

    def table(self) -> Table:
        """Return a table of magnitude and phase at up to twelve frequencies."""
        chosen = np.unique(np.linspace(0, self.frequency.size - 1, 12).astype(int)) if self.frequency.size else []
        rows = [
            [*map(float, (self.frequency[i], self.magnitude[i], 20.0 * np.log10(self.magnitude[i]), self.phase_deg[i]))]
            for i in chosen
        ]
        unit = unit_name(self.unit, "SI") if self.unit else "1"
        title = Text(f"{self.output} / {self.input} in {unit}, {self.frequency.size} lines")
        columns = [
            Column("frequency", "Hz", "5"),
            Column("magnitude", self.unit, "4 SI"),
            Column("level", "dB", ".2f"),
            Column("phase", "deg", ".1f"),
        ]
        return Table(title, columns, rows)
