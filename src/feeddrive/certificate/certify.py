"""Certification of a controller for a list of plants, and the reasons for a refusal."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.certificate import check
from feeddrive.certificate.certificate import (
    Certificate,
    LoopResponse,
    Radius,
    deviations,
    measured,
    radius_steps,
    together,
)
from feeddrive.certificate.systems import Deployed, NominalPlant, deployed, measured_plant, modelled_plant
from feeddrive.language import tree
from feeddrive.language.errors import NotCertifiedError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import Lifted, StateSpace
from feeddrive.loop.loop import Loop, response_unit
from feeddrive.tuning.operating_point import OperatingPoint

CLAIM = (
    "For every plant of the list the linear loop of the control with these coefficients is stable, and it stays so for "
    "every plant P (1 + Δ) with |Δ| <= r(f) at all frequencies from 0 to half the sample rate, grid points and "
    "everything between them."
)
THEOREM = (
    "F = Dc Dp - Nc Np has all zeros inside the unit circle and |F| > r |Nc Np| on it; by Rouché's theorem "
    "F - Nc Np Δ then has as many zeros outside as F, none. Δ is any stable transfer function, or one with which "
    "P (1 + Δ) has the poles of P on and outside the circle (Doyle, Francis & Tannenbaum 1992, chapter 4)."
)
THEOREM_OF_TWO_RATES = (
    "The linear loop repeats itself after N samples. Hl(f) is the force at f + l/(NT), l = 0 .. N-1, that a sine of "
    "1 N at f, at the plant's input, adds to in the closed loop. The loop over a period has all poles inside the unit "
    "circle, and r(f) Σ|Hl(f)| < 1 at all f: then det(1 - H Δ) differs from 0 on the circle for all |Δ| <= r, since "
    "the columns of H Δ sum to less than 1, and as many poles lie outside as without Δ, none. Δ is any stable transfer "
    "function at the fast rate, or one with which P (1 + Δ) has the poles of P on and outside the circle."
)
ASSUMED = [
    "The plant of the list is linear, time invariant and sampled with the control; its poles on and outside the unit "
    "circle are those of the model.",
    "The control computes its linear law with the numbers of the list.",
]
BETWEEN = (
    "Between measured lines the true plant stays in the disc around the model, with the larger radius of both; "
    "a resonance that is narrower than the distance of the lines is not covered.  Below the first and "
    "above the last line the radius is an assumption. The errors of the lines are complex normal with the variances of "
    "the list; they may be correlated."
)
NOT_CHECKED = [
    "the texts for readers: claim, theorem, assumed, machine, made_from, law, parameters, units, readings, states, the "
    "plants' names and source, dead_time_s, sample_time_ms, velocity",
    "that the matrices are those of this control with these numbers: feeddrive traced it, and `feeddrive check` with "
    "--machine traces it again",
]
OUTSIDE = [
    "saturation: force limit, current limit, anti-windup in action",
    "friction other than its slope at the stated velocity: stick, stiction, reversal; backlash",
    "rounding of signals: counts of encoders, arithmetic of the running controller, limit cycles",
    "enable, trips and start; feedforward and reference, which cannot destabilize a linear loop",
    "change in time: wear, temperature, a position or load that is not in the list",
]


def refusal(controller: Deployed, plant: NominalPlant, loop: LoopResponse, place: float | None) -> str:
    """Return the message of a refusal, with the amount of the violation and a remedy.

    `place` is the frequency in Hz at which a disc is too wide, or None if the nominal loop is unstable.
    """
    lost = ""
    if controller.coarse:
        name = max(controller.coarse, key=lambda coefficient: controller.coarse[coefficient])
        lost = Text(
            f"; rounding to {controller.arithmetic} moves {name} by {Quantity(controller.coarse[name], 'share'):3}: "
            "use more digits"
        )
    T = controller.model.sample_time
    if place is None:
        turning = abs(np.angle(loop.pole)) / (2.0 * np.pi * T * len(loop.samples))
        motion = Text(f"an oscillation of {Quantity(turning, 'Hz')}") if turning > 0.0 else "a drift"
        grows = "grows" if loop.growth > 1.0 else "does not die out"
        rounded = "" if controller.arithmetic == "float64" else f" with {controller.arithmetic} coefficients"
        remedy = "lower the gains, or put a notch there" if turning > 0.0 else "lower the gains"
        if plant.lines and turning == 0.0:
            remedy += ", or multiply the response by -1 if its sign is reversed"
        return Text(
            f"not certified: '{plant.name}': the nominal loop{rounded} is not stable: {motion} {grows} (|z| = "
            f"{Quantity(loop.growth):9}): {remedy}{lost}"
        )
    at = np.array([place])
    distance, taken = (float(values[0]) for values in loop.room(at))
    share = distance / taken if taken else np.inf
    r = float(np.max(loop.radii(at)))
    reason = Text(
        f"not certified: '{plant.name}': at {Quantity(place, 'Hz'):5} |1 + L| is {Quantity(distance)} and the disc "
        f"takes {Quantity(taken)}: with r = {Quantity(r)} there, it may be at most {Quantity(r * share)}"
    )
    return Text(f"{reason}: {_remedy(plant, place)}{lost}")


def _remedy(plant: NominalPlant, place: float) -> str:
    """Return a remedy for a disc that is too wide at `place` in Hz, depending on the cause."""
    T = plant.model.sample_time
    if plant.lines:
        lines = plant.lines[0]
        if place > lines.frequency[-1]:
            return Text(
                f"lower the gains, measure beyond {Quantity(lines.frequency[-1], 'Hz')}, or state a smaller r beyond it"
            )
        i = int(np.argmin(np.abs(lines.frequency - place)))
        model = plant.model.response(lines.frequency[i : i + 1], output=plant.model.outputs[0]).response[0]
        noise, misfit = np.sqrt(lines.variance[i]), abs(lines.response[i] - model)
        if noise > misfit:
            return Text(
                f"measure longer around {Quantity(place, 'Hz')}, where noise makes the disc wide, or lower the gains"
            )
        better = "" if "fitted" in plant.source else ", with --fit from the lines alone"
        return Text(
            f"lower the gains, or fit the plant better around {Quantity(place, 'Hz')}, where the model misses the "
            f"lines{better}"
        )
    # a motion that halves within a sample is no resonance
    modes = np.array([p for p in plant.model.poles() if abs(p) > 0.5 and np.imag(p) > 0.0])
    if modes.size:
        near = np.angle(modes) / (2.0 * np.pi * T)
        nearest = float(near[np.argmin(np.abs(np.log(near / place)))])
        # a notch helps only if the disc is too wide at the mode itself
        if 0.9 < nearest / place < 1.1:
            return Text(f"put a notch at {Quantity(nearest, 'Hz')}, lower the gains, or state a smaller disc")
    return "lower the gains, or state a smaller disc"


PlantLike = Loop | Axis | FRF | Sequence[Loop | Axis | FRF]
# default radii: of a model, the least around measured lines, and beyond the last line, where a plant with r = 1 may be
# anything from nothing to twice the model
_MODEL, _LEAST, _BEYOND = 0.2, 0.05, 1.0
_MOST = 1e6  # largest reserve that is stated
# repetitions of the search, each with one more peak that the checker has named
_ROUNDS = 4


_TINY = 2.0**-290  # the checker takes exponents up to 300


def certify_loop(
    loop: Loop | Control,
    plants: Mapping[str, PlantLike] | None = None,
    *,
    sample_time: float | None = None,
    radius: Radius | None = None,
    beyond: float = _BEYOND,
    arithmetic: str = "float64",
    confidence: float = 0.95,
    velocity: float = 0.05,
    machine: Mapping[str, str] | None = None,
    made_from: Sequence[Mapping[str, str]] = (),
) -> Certificate:
    """Prove robust stability of a deployed controller for a list of plants with a disc |dP/P| <= r(f) around each.

        nominal stability, and |1 + L| > r|L| at all frequencies up to half the sample rate;
        with two encoders measured separately: |1 + L| > r₁|C₁P₁| + r₂|C₂P₂|
        for a multirate controller with a period of N samples: r Σ|Hl| < 1, where Hl is the closed-loop force at
        f + l/(NT) due to a sine of 1 N at f

    The proof is that of `check.py`: in exact integer arithmetic or, for a multirate controller, in floating point with
    a bound on every rounding error. Every certificate that is returned has passed it.

    loop         the loop whose controller is certified, or a `Control` with `sample_time` in s
    plants       plants by name: a loop or an axis, which is a model; a response in m/N, to whose lines a model is
                 fitted; or a tuple (axis, response), (load response, motor response) or (axis, load response, motor
                 response). None: the axis of the loop
    radius       for models, r as a number or as points (Hz, r); default 0.2. For measured plants r follows from the
                 frequency lines and their variances, and `radius` is its minimum; default 0.05
    beyond       minimum of r above the last measured line
    arithmetic   arithmetic of the coefficients: float64, float32, or fixedN with N binary places
    confidence   joint probability that the true responses at all measured lines lie in their discs
    velocity     velocity of the axes at which friction is linearized, m/s
    machine      the machine to name in the certificate: name, file, axis, sha256
    made_from    name and digest of each other file to name in it, such as the measured responses

    Raises NotCertifiedError, with the frequency and amount of the violation, if the proof fails; ParameterError for
    wrong arguments and for a multirate law with two encoders measured separately; NotIdentifiableError for a response
    that no model fits.
    Source: Doyle, Francis & Tannenbaum 1992, chapter 4 (robust stability); Rouché's theorem.
    """
    control = loop.control if isinstance(loop, Loop) else loop
    T = float(loop.sample_time) if isinstance(loop, Loop) else sample_time
    if T is None or not (math.isfinite(T) and 0.0 < T < 10.0):
        raise ParameterError("a control alone needs its sample_time, in s, above 0")
    # a normal error has no finite bound: at a confidence of 1 every disc would be infinitely wide
    if not 0.0 < confidence < 1.0 - 1e-9:
        raise ParameterError(f"confidence = {Quantity(confidence):6} must lie between 0 and 1; 0.95 is 95 %")
    if not (math.isfinite(beyond) and beyond >= 0.0):
        raise ParameterError(
            f"beyond = {Quantity(beyond):6}, the radius above the last line, must be a finite number >= 0"
        )
    if not math.isfinite(velocity):
        raise ParameterError(
            f"velocity = {Quantity(velocity, 'm/s'):6 SI}, at which the axes move, must be a finite number"
        )
    if plants is None:
        if not isinstance(loop, Loop):
            raise ParameterError("a control alone has no plant: give `plants`")
        plants = {"model": loop}
    if not plants:
        raise ParameterError("there is no plant: give at least one in `plants`")
    controller = deployed(control, T, arithmetic, velocity)
    nominal = [_plant(name, plant, control, T, controller.model.inputs, velocity) for name, plant in plants.items()]
    sure = deviations(sum(lines.frequency.size for plant in nominal for lines in plant.lines), confidence)
    document: dict[str, Any] = {
        "format": check.FORMAT,
        "version": check.VERSION,
        "claim": CLAIM,
        "theorem": THEOREM_OF_TWO_RATES if isinstance(controller.model, Lifted) else THEOREM,
        "assumed": [*ASSUMED, *([BETWEEN] if any(plant.lines for plant in nominal) else [])],
        "outside": OUTSIDE,
        "not_checked": NOT_CHECKED,
        "machine": dict(machine or {}),
        "made_from": [dict(origin) for origin in made_from],
        "velocity": velocity,
        "sample_time_s": T.hex(),
        "sample_time_ms": 1e3 * T,
        "arithmetic": arithmetic,
        "confidence": confidence,
        "control": {
            "law": control.law.kind,
            "parameters": {name: float(value) for name, value in tree.leaves(control)},
            "units": {name: tree.declaration(control, name).unit for name, _ in tree.leaves(control)},
            "readings": list(controller.model.inputs),
            **_control(controller.model),
        },
        "numbers": {name: value.hex() for name, value in controller.numbers.items()},
    }
    also: list[float] = []
    while True:
        tried = [_tried(controller, plant, radius, beyond, sure, also) for plant in nominal]
        certificate = Certificate.of({**document, "plants": [row for row, _ in tried]})
        refused = next((reason for _, reason in tried if reason), "")
        if refused:
            raise NotCertifiedError(refused, certificate)
        try:
            certificate.accepted()
        except check.RefusedError as error:
            if not error.frequency or len(also) == _ROUNDS:
                raise NotCertifiedError(f"not certified: {error}", certificate) from None
            # the checker found a peak between the lines of the search, which is then searched there, too
            also.append(error.frequency)
        else:
            return certificate


def _plant(
    name: str, entry: PlantLike, control: Control, T: float, readings: Sequence[str], velocity: float
) -> NominalPlant:
    """Return the nominal plant for one entry of the `plants` argument."""
    parts = entry if isinstance(entry, Sequence) else (entry,)
    loops = [part for part in parts if isinstance(part, Loop)]
    axes = [part.axis if isinstance(part, Loop) else part for part in parts if isinstance(part, (Loop, Axis))]
    responses = [part for part in parts if isinstance(part, FRF)]
    if len(axes) > 1 or len(responses) > 2 or not parts or len(axes) + len(responses) != len(parts):
        raise ParameterError(f"'{name}' is neither a loop, an axis nor one or two responses in m/N")
    for other in loops:
        if abs(float(other.sample_time) / T - 1.0) > 1e-9:
            raise ParameterError(
                f"'{name}' is sampled every {Quantity(float(other.sample_time), 's'):6}, not {Quantity(T, 's'):6}"
            )
    for response in responses:
        if response.sample_time is not None and abs(response.sample_time / T - 1.0) > 1e-6:
            raise ParameterError(
                f"'{name}' was measured every {Quantity(response.sample_time, 's'):6}, and the control runs every "
                f"{Quantity(T, 's'):6}: a sampled response holds for its own sample time"
            )
    axis = axes[0] if axes else None
    if responses:
        return measured_plant(name, responses, axis, control, T, readings, velocity)
    assert axis is not None
    return modelled_plant(name, axis, control, T, readings, velocity)


def _tried(
    controller: Deployed, plant: NominalPlant, radius: Radius | None, beyond: float, sure: float, also: Sequence[float]
) -> tuple[dict[str, Any], str]:
    """Return the certificate entry of a plant, and why it is refused: a disc is too wide; empty if none is.

    The margin is searched on a finer grid near the frequencies `also`, Hz.

    Raises NotCertifiedError if the nominal loop is unstable, and ParameterError for a radius or responses that do not
    fit the plant.
    """
    T = controller.model.sample_time
    nyquist = 0.5 / T
    if plant.lines:
        if radius is not None and not isinstance(radius, (int, float)):
            raise ParameterError("for measured plants the radius is one number, the least; the lines say the rest")
        steps = measured(plant, sure, _LEAST if radius is None else float(radius), beyond, nyquist)
        if len(steps) == 1 and len(plant.model.outputs) > 1 and not _same(plant.model):
            raise ParameterError(f"'{plant.name}': one measured response for two readings that differ")
        if len(steps) > 1 and isinstance(controller.model, Lifted):
            raise ParameterError(
                f"'{plant.name}': a law with two rates is certified with one disc for both encoders, and their "
                f"responses were measured apart: certify the machine's model, or a law that reads one encoder"
            )
    else:
        steps = [radius_steps(_MODEL if radius is None else radius, nyquist)]
    loop = LoopResponse(controller.model, plant.model, together(steps))
    # the search below assumes a stable loop; the checker proves both in exact arithmetic
    if loop.growth >= 1.0:
        raise NotCertifiedError(refusal(controller, plant, loop, None))
    reserve, place = loop.reserve(also)
    reason = refusal(controller, plant, loop, place) if reserve <= 1.0 else ""
    discs = "each" if len(steps) > 1 or len(plant.model.outputs) == 1 else "one"
    entry = {
        "name": plant.name,
        "source": plant.source,
        "dead_time_s": plant.dead_time,
        "model": _held(plant.model),
        "discs": discs,
        "radius": loop.bands,
        "lines": [
            [
                [float(f), float(g.real), float(g.imag), float(v)]
                for f, g, v in zip(lines.frequency, lines.response, lines.variance, strict=True)
            ]
            for lines in plant.lines
        ],
        "reserve": reserve if reserve < _MOST else None,
        "reserve_at_Hz": place,
    }
    return entry, reason


def _same(model: StateSpace) -> bool:
    return bool(np.all(model.C[0] == model.C[-1]))


def _held(model: StateSpace) -> dict[str, Any]:
    """Return the certificate entry of a model: state names, and matrices as hexadecimal numbers, which are exact."""
    entry: dict[str, Any] = {"states": list(model.states)}
    for name in ("A", "B", "C", "D"):
        entry[name] = [[_storable(float(x)).hex() for x in line] for line in getattr(model, name)]
    return entry


def _control(model: StateSpace | Lifted) -> dict[str, Any]:
    """Return the certificate entry of a controller; for a multirate controller, with the matrices of each sample."""
    if isinstance(model, StateSpace):
        return _held(model)
    samples = [_held(sample) for sample in model.samples]
    return {"states": samples[0]["states"], "samples": [{name: sample[name] for name in "ABCD"} for sample in samples]}


def point_plants(points: Sequence[OperatingPoint | Loop]) -> dict[str, PlantLike]:
    """Convert operating points to plants by name: a model to its loop, a measurement to its smoothed response."""
    plants: dict[str, PlantLike] = {}
    for point in points:
        name = point.name if isinstance(point, OperatingPoint) else "model"
        count = sum(other == name or other.startswith(f"{name} ") for other in plants)
        # loops without a name are all called model, and a dictionary would keep only the last of them
        plants[name if count == 0 else f"{name} {count + 1}"] = _plant_like(point)
    return plants


def _plant_like(point: OperatingPoint | Loop) -> PlantLike:
    if isinstance(point, Loop):
        return point
    if point.loop is not None:
        return point.loop
    variance = np.zeros(point.by_force.shape) if point.variance is None else point.variance
    load = _response(point, 1, variance[1])
    if np.all(point.by_force[0] == point.by_force[1]):
        return load
    of_motor = variance[0]
    if point.ratio is not None:
        # if their ratio was fitted, the motor's line has the error of the load's, too
        tied = ~np.isnan(point.ratio[0])
        of_motor = of_motor + np.where(tied, np.abs(np.where(tied, point.ratio[0], 0.0)) ** 2 * variance[1], 0.0)
    return [load, _response(point, 0, of_motor)]


def _response(point: OperatingPoint, row: int, variance: np.ndarray) -> FRF:
    output = ("reading_motor", "reading_load")[row]
    unit = response_unit(point.commanded)
    return FRF(point.frequency, point.by_force[row], "cut", output, unit, point.sample_time, None, variance)


def _storable(value: float) -> float:
    """Return a number of a matrix, 0 in place of one that is too small for the checker: no product knows it from 0."""
    return value if abs(value) > _TINY else 0.0
