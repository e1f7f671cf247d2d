"""The certificate of a controller: its document, and the figures and uncertainty discs computed from it alone."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np

from feeddrive.certificate import check
from feeddrive.certificate.systems import NominalPlant
from feeddrive.language.errors import NotCertifiedError, ParameterError
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import Lifted, StateSpace

_BESIDE = np.linspace(-4.0, 4.0, 33)  # offsets, in half-widths of a resonance, at which lines are added
_PER_DECADE, _LOWEST = 150, 1e-6  # of Nyquist
# rounds of refinement, each of which narrows the search tenfold: the limiting frequency has seven digits
_REFINED = 6


def control_of(entry: Mapping[str, Any], T: float) -> StateSpace | Lifted:
    """Return the controller in the certificate entry `entry`; T is the sample time in s."""
    rates = entry.get("samples", [entry])
    systems = tuple(
        matrices({"states": entry["states"], **sample}, entry["readings"], ["force"], T) for sample in rates
    )
    return Lifted(systems) if "samples" in entry else systems[0]


def matrices(entry: Mapping[str, Any], inputs: Sequence[str], outputs: Sequence[str], T: float) -> StateSpace:
    """Return the linear system in the certificate entry `entry`; T is the sample time in s."""
    A, B, C, D = (
        np.array([[float.fromhex(x) for x in row] for row in entry[name]], dtype=float) for name in ("A", "B", "C", "D")
    )
    n = len(entry["A"])
    return StateSpace(
        A.reshape(n, n),
        B.reshape(n, len(inputs)),
        C.reshape(len(outputs), n),
        D.reshape(len(outputs), len(inputs)),
        T,
        tuple(entry["states"]),
        tuple(inputs),
        tuple(outputs),
    )


@dataclass(frozen=True, eq=False)
class LoopResponse:
    """The frequency response of a loop in a certificate.

    `bands` lists the frequency bands with their disc radius r, either one radius for all readings or one for each.

    A multirate controller has a period of N samples.  A sine of 1 N at f, added at the plant's input, causes
    closed-loop forces Hl at the frequencies f + l/(NT), l = 0 .. N-1. With discs of radius r the loop is stable if
    r Σ|Hl| < 1 at all f.  For N = 1 that is r |L| < |1 + L|.
    """

    control: StateSpace | Lifted
    plant: StateSpace
    bands: Sequence[Mapping[str, Any]]

    @property
    def samples(self) -> tuple[StateSpace, ...]:
        """The model of the controller at each sample of its period; a single one if it is not multirate."""
        return self.control.samples if isinstance(self.control, Lifted) else (self.control,)

    @cached_property
    def closed(self) -> Lifted:
        """The closed loop from the plant's input to the force."""
        P = self.plant
        n = self.samples[0].A.shape[0]
        names = (*self.samples[0].states, *P.states), ("cut",), ("force",)
        closed_samples: list[StateSpace] = []
        for C in self.samples:
            A = np.block([[C.A, C.B @ P.C], [P.B @ C.C, P.A + P.B @ C.D @ P.C]])
            B, row = np.vstack([np.zeros((n, 1)), P.B]), np.hstack([C.C, C.D @ P.C])
            closed_samples.append(StateSpace(A, B, row, np.zeros((1, 1)), P.sample_time, *names))
        return Lifted(tuple(closed_samples))

    @cached_property
    def pole(self) -> complex:
        """The closed-loop pole over one period that has the largest |z|."""
        return complex(self.closed.poles()[0])

    @property
    def growth(self) -> float:
        """The largest |z| of the closed-loop poles over a period."""
        return abs(self.pole)

    def images(self, frequency: np.ndarray) -> np.ndarray:
        """Return the closed-loop forces Hl, defined above, at frequencies f in Hz, shape (lines, N)."""
        A, B, C, D = self.closed.stacked(["cut"], ["force"])
        N, n, T = len(self.samples), A.shape[0], self.control.sample_time
        turn = np.exp(2j * np.pi * T * np.outer(frequency, np.arange(N)))
        z = np.exp(2j * np.pi * T * N * frequency)
        states = np.linalg.solve(z[:, None, None] * np.eye(n) - A, (turn @ B.T)[:, :, None])[:, :, 0]
        # without its carrier the force has a period of N samples: its Fourier coefficients are the parts at f + l/(NT)
        return np.fft.fft((states @ C.T + turn @ D.T) * np.conj(turn), axis=1) / N

    def gains(self, frequency: np.ndarray) -> np.ndarray:
        """Return the loop gain -Ci Pi of each reading, shape (readings, lines).

        For a multirate controller, return the effective gain for a sine, in one row.
        """
        if isinstance(self.control, Lifted):
            return 1.0 / (1.0 + self.images(frequency)[None, :, 0]) - 1.0
        loop_gains = [
            -self.control.response(frequency, input=reading).response
            * self.plant.response(frequency, output=output).response
            for reading, output in zip(self.control.inputs, self.plant.outputs, strict=True)
        ]
        return np.array(loop_gains)

    def radii(self, frequency: np.ndarray) -> np.ndarray:
        """Return the radius r of each disc, shape (discs, lines); at a band edge, the larger of the two radii."""
        edges = np.array([band["to_Hz"] for band in self.bands])
        r = np.array([band["r"] for band in self.bands], dtype=float)
        # a line within rounding of an edge belongs to both bands, and the larger radius of the two counts
        left = np.minimum(np.searchsorted(edges, frequency * (1.0 - 1e-12), side="left"), edges.size - 1)
        right = np.minimum(np.searchsorted(edges, frequency * (1.0 + 1e-12), side="right"), edges.size - 1)
        return np.maximum(r[left], r[right]).T

    def room(self, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return |1 + L|, the distance of L from -1, and the part of this distance that the discs take up.

        The second value is Σ ri |Li|, or r |L| with one disc, or r |1 + L| Σ|Hl| for a multirate controller.
        """
        if isinstance(self.control, Lifted):
            images = self.images(frequency)
            distance = 1.0 / np.abs(1.0 + images[:, 0])
            return distance, self.radii(frequency)[0] * distance * np.sum(np.abs(images), axis=1)
        gains, r = self.gains(frequency), self.radii(frequency)
        whole = gains.sum(axis=0)
        taken = r[0] * np.abs(whole) if r.shape[0] == 1 else np.sum(r * np.abs(gains), axis=0)
        return np.abs(1.0 + whole), taken

    def size(self, frequency: np.ndarray) -> np.ndarray:
        """Return the part of |1 + L| that a disc of r = 1 takes up: |L|, or |1 + L| Σ|Hl| for a multirate law."""
        if isinstance(self.control, Lifted):
            images = self.images(frequency)
            return np.sum(np.abs(images), axis=1) / np.abs(1.0 + images[:, 0])
        return np.abs(self.gains(frequency).sum(axis=0))

    def lines(self) -> np.ndarray:
        """Return frequencies up to the Nyquist frequency, Hz, uniformly spaced in ln f and denser around resonances.

        Every edge of the bands is included.
        """
        T = self.control.sample_time
        nyquist = 0.5 / T
        last = self.samples[-1], self.closed.samples[-1]
        poles = np.concatenate([system.poles() for system in (self.plant, *last)])
        # a pole that decays tenfold within a sample causes no narrow peak, and 0 has no logarithm
        poles = poles[(np.abs(poles) > 0.1) & (np.abs(poles.imag) > 0.0)]
        s = np.log(poles) / T
        near = (np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * _BESIDE).ravel() / (2.0 * np.pi)
        spread = np.geomspace(_LOWEST * nyquist, nyquist, round(-np.log10(_LOWEST) * _PER_DECADE))
        edges = np.array([band["to_Hz"] for band in self.bands])
        every = np.unique(np.concatenate([spread, near, edges]))
        every = every[(every >= spread[0]) & (every <= nyquist)]
        return every[np.append(np.diff(every) > 1e-13 * every[:-1], True)]

    def reserve(self, also: Sequence[float] = ()) -> tuple[float, float]:
        """Return the largest factor by which all discs could be widened, and the frequency, Hz, that limits it.

        also  frequencies in Hz around which additional lines are evaluated
        """
        f = self.lines()
        if also:
            spread = np.concatenate([x * np.geomspace(0.98, 1.0 / 0.98, 81) for x in also])
            # a peak that the checker found between the lines of an earlier search
            f = np.unique(np.concatenate([f, spread[spread <= f[-1]]]))
        room = self._ratio(f)
        # the minimum may lie at an edge of a band, where the radius jumps and no refinement lowers it
        best = float(np.min(room)), float(f[np.argmin(room)])
        # each local minimum is refined between its neighbors
        inner = np.flatnonzero((room <= np.append(room[1:], np.inf)) & (room <= np.append(np.inf, room[:-1])))
        for i in inner[np.argsort(room[inner])][:8]:
            low, high = f[max(i - 1, 0)], f[min(i + 1, f.size - 1)]
            for _ in range(_REFINED):
                fine = np.unique(np.linspace(low, high, 21))
                values = self._ratio(fine)
                k = int(np.argmin(values))
                if values[k] < best[0]:
                    best = float(values[k]), float(fine[k])
                low, high = fine[max(k - 1, 0)], fine[min(k + 1, fine.size - 1)]
        return best

    def _ratio(self, f: np.ndarray) -> np.ndarray:
        # a disc of radius 0 uses nothing: the floor keeps the quotient finite
        distance, taken = self.room(f)
        return distance / np.maximum(taken, 1e-12 * distance)


Radius = float | Sequence[tuple[float, float]]
_ALIKE = 1.15  # largest ratio of the radii of neighboring lines that become one step


def deviations(lines: int, confidence: float) -> float:
    """Return the radius, in multiples of √variance, of discs that jointly contain all frequency lines with a given
    confidence.

    For a complex normal error, P(|dG|² > q var) = e^-q. By Bonferroni's inequality q = ln(lines/(1 - confidence))
    covers all lines, however their errors are correlated.
    """
    return math.sqrt(math.log(max(lines, 1) / (1.0 - confidence)))


def radius_steps(radius: Radius, nyquist: float) -> list[tuple[float, float]]:
    """Convert a number, or points (Hz, r) that are linear in ln f in between, to steps (upper frequency in Hz, r).

    The radius of a step is the larger of those at its two ends.
    Raises ParameterError for negative radii and for frequencies that do not increase.
    """
    if isinstance(radius, (int, float)):
        if not (np.isfinite(radius) and radius >= 0.0):
            raise ParameterError(f"radius = {Quantity(radius):6} of a disc, |dP/P|, must be a finite number >= 0")
        return [(nyquist, float(radius))]
    f, r = (np.array([float(point[i]) for point in radius]) for i in (0, 1))
    if f.size == 0 or np.any(~np.isfinite(r)) or np.any(r < 0.0) or np.any(f <= 0.0) or np.any(np.diff(f) <= 0.0):
        raise ParameterError("the radius needs points (Hz, r) with frequencies that rise and radii >= 0")
    steps = np.arange(math.log(f[0]), math.log(f[-1]), 0.02)
    f_all = np.unique(np.concatenate([f, np.exp(steps)]))
    r_all = np.interp(np.log(f_all), np.log(f), r)
    return _steps(f_all, r_all, float(r[0]), float(r[-1]), nyquist, 1.001)


def needed(plant: NominalPlant, reading: int, sure: float) -> np.ndarray:
    """Return, for each line G measured with a reading, the radius of the disc around the model P that contains it.

    The radius is (|G - P| + sure √variance) / |P|.
    """
    lines = plant.lines[reading]
    model = plant.model.response(lines.frequency, output=plant.model.outputs[reading]).response
    return (np.abs(lines.response - model) + sure * np.sqrt(lines.variance)) / np.abs(model)


def measured(
    plant: NominalPlant, sure: float, least: float, beyond: float, nyquist: float
) -> list[list[tuple[float, float]]]:
    """Return, for each reading, steps of r whose discs around the model P contain every measured line G.

    The condition is |G - P| + `sure` √variance <= r|P|.

    Between two frequency lines, r is the larger of their radii.  Below the first line r is the maximum over the first
    octave; above the last line it is the maximum over the last octave, but at least `beyond`.  r is never less than
    `least`.
    """
    steps: list[list[tuple[float, float]]] = []
    for reading, lines in enumerate(plant.lines):
        f, r = lines.frequency, np.maximum(needed(plant, reading, sure), least)
        low, high = float(np.max(r[f <= 2.0 * f[0]])), float(np.max(r[f >= 0.5 * f[-1]]))
        steps.append(_steps(f, r, low, max(high, beyond), nyquist, _ALIKE))
    return steps


def _steps(
    f: np.ndarray, r: np.ndarray, low: float, high: float, nyquist: float, alike: float
) -> list[tuple[float, float]]:
    """Convert lines to steps of the radius; neighbors whose radii differ by at most the factor `alike` are merged."""
    inside = f < nyquist
    f, r = f[inside], r[inside]
    raw = [(float(f[0]), low), *zip(f[1:].tolist(), np.maximum(r[:-1], r[1:]).tolist(), strict=True), (nyquist, high)]
    steps: list[tuple[float, float]] = []
    least = math.inf
    for to, radius in raw:
        radius = _up(radius)
        if steps and max(steps[-1][1], radius) <= alike * min(least, radius):
            steps[-1] = to, max(steps[-1][1], radius)
            least = min(least, radius)
        else:
            steps.append((to, radius))
            least = radius
    return steps


def _up(radius: float) -> float:
    """Round a radius up to four significant digits."""
    if radius == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(radius)) - 3)
    # a radius that has four digits stays as it is, although its quotient may be rounded up
    return math.ceil(radius / unit - 1e-7) * unit


def together(readings: Sequence[Sequence[tuple[float, float]]]) -> list[dict[str, Any]]:
    """Combine the steps of all readings into bands with common edges, in the format of a certificate."""
    edges = sorted({to for steps in readings for to, _ in steps})
    bands: list[dict[str, Any]] = []
    low = 0.0
    for to in edges:
        r = [next(radius for end, radius in steps if end >= to) for steps in readings]
        if bands and bands[-1]["r"] == r:
            bands[-1]["to_Hz"] = to
        else:
            bands.append({"from_Hz": low, "to_Hz": to, "r": r})
        low = to
    return bands


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Result):
    """A proof that a controller robustly stabilizes a list of plants; `document` contains the proof as plain values.

    It is created by `certify_loop` or read from a file; in both cases the checker has accepted it. The draft of a
    `NotCertifiedError` is one that the checker refuses.
    """

    document: Mapping[str, Any]
    _accepted: dict[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]], init=False)

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Create a certificate from the content of a document, to which the digest is added."""
        # as a reader of the file gets it: the digest of tuples and numpy numbers would be another one
        plain = json.loads(json.dumps(content))
        return cls({**plain, "sha256": check.digest(plain)})

    def text(self) -> str:
        """Return the JSON text; `python -m feeddrive.certificate.check FILE` checks it."""
        return json.dumps(self.document, indent=1, ensure_ascii=False) + "\n"

    def accepted(self) -> tuple[str, ...]:
        """Return the checker's sentences, one per plant. Raises check.RefusedError if the certificate is rejected.

        They are cached until the document changes, since the proof for a multirate controller takes seconds.
        """
        content = f"{check.digest(self.document)} {self.document.get('sha256')}"
        if content not in self._accepted:
            self._accepted[content] = tuple(check.verified(self.document))
        return self._accepted[content]

    def verify(self) -> tuple[str, ...]:
        """Return the checker's sentences, one per plant. Raises NotCertifiedError if the certificate is rejected."""
        try:
            return self.accepted()
        except check.RefusedError as error:
            raise NotCertifiedError(f"not certified: {error}") from None

    @property
    def sample_time(self) -> float:
        """The sample time, s."""
        return float.fromhex(self.document["sample_time_s"])

    @property
    def two_rates(self) -> bool:
        """True for a multirate law, whose period has several samples."""
        return "samples" in self.document["control"]

    @property
    def arithmetic(self) -> str:
        """The arithmetic of the coefficients: float64, float32 or fixedN."""
        return self.document["arithmetic"]

    @property
    def outside(self) -> tuple[str, ...]:
        """The effects that the proof does not cover."""
        return tuple(self.document["outside"])

    @cached_property
    def loops(self) -> dict[str, LoopResponse]:
        """The response of the controller and the plant in a loop, by plant name."""
        T, control = self.sample_time, self.document["control"]
        readings = control["readings"]
        control_model = control_of(control, T)
        return {
            plant["name"]: LoopResponse(control_model, matrices(plant["model"], ["cut"], readings, T), plant["radius"])
            for plant in self.document["plants"]
        }

    @property
    def reserve(self) -> float | None:
        """The factor by which the discs of every plant could be widened, or None if no disc limits it."""
        return min(
            (plant["reserve"] for plant in self.document["plants"] if plant["reserve"] is not None), default=None
        )

    def sentence(self) -> str:
        """Return the result as a sentence that names the plant with the smallest margin."""
        plants = self.document["plants"]
        count = (
            "1 plant and everything in its disc"
            if len(plants) == 1
            else (f"{len(plants)} plants and everything in their discs")
        )
        room = ""
        if self.reserve is not None:
            least = min((plant for plant in plants if plant["reserve"] is not None), key=lambda plant: plant["reserve"])
            room = Text(
                f"; the room is {Quantity(self.reserve):2} × what is needed, least at "
                f"{Quantity(least['reserve_at_Hz'], 'Hz'):3} with '{least['name']}'"
            )
        return Text(f"stable for {count}, with {self.arithmetic} coefficients{room}")

    def table(self) -> Table:
        """Tabulate the radii, margins and poles, one row per plant, smallest margin first."""
        rows: list[list[str | float | int | None]] = []
        for plant in sorted(self.document["plants"], key=lambda plant: plant["reserve"] or math.inf):
            radii = [x for band in plant["radius"] for x in band["r"]]
            least, most = min(radii), max(radii)
            loop = self.loops[plant["name"]]
            f = loop.lines()
            peak = float(np.max(loop.size(f) / loop.room(f)[0]))
            rows.append(
                [
                    plant["name"],
                    Text(f"{span(least, most, '', '3', between='..')}") if least < most else radii[0],
                    peak,
                    plant["reserve"],
                    plant["reserve_at_Hz"],
                    loop.growth,
                    sum(len(lines) for lines in plant["lines"]),
                ]
            )
        columns = [
            "plant",
            Column("r", "", "3"),
            Column("max Σ|H|" if self.two_rates else "max |L/(1+L)|", "", "3"),
            Column("wider by", "", "3"),
            Column("at", "Hz", "3"),
            Column("max |z|", "", ".6f"),
            "lines",
        ]
        return Table(self.sentence(), columns, rows)
