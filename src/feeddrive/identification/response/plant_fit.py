"""Plant models fitted to frequency responses of one or both encoders, and the selection of their structure.

The structures are two masses, a rigid mass with modes, and that of a machine file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, cast

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.identification.regression import Estimate, estimates_table
from feeddrive.identification.response.agreement import (
    Agreement,
    advice,
    agreement,
    beyond,
    blind,
    entangled,
    lines_above_noise,
)
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.identification.response.refine import (
    STEPS,
    Refined,
    ResponseUnits,
    Unknown,
    covariances_at,
    refine,
    taken,
)
from feeddrive.language import matrix, ops, tree
from feeddrive.language.block import Number
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, ParameterError, WrongSignError
from feeddrive.language.graph import Graph
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.gradient import LinearModel, TracedModel
from feeddrive.loop.hold import Port, Rows, Timing, rate

# The masses, springs and dampers of a plant, traced with its actuator, from frequency responses, in SI.

UNKNOWN = 0.5  # standard error over value above which a parameter counts as not identifiable
_IDEAL = 20.0  # times the highest line: a faster current loop counts as ideal


@dataclass(frozen=True, eq=False, repr=False)
class PlantFit(Result):
    """A plant and its actuator, fitted to measured responses.

    estimates         every fitted parameter with its standard errors; `covariance` is in their order
    derived           derived quantities: antiresonance, resonance, inertia ratio, total mass
    not_identifiable  the reason by parameter, and what to measure next; `plant` contains the value that was used
    agreement         agreement with the responses, at used and at unused frequency lines
    remarks           further remarks based on the residuals and the errors
    """

    plant: Plant
    actuator: Actuator
    estimates: tuple[Estimate, ...]
    covariance: np.ndarray
    derived: tuple[Estimate, ...]
    not_identifiable: Mapping[str, str]
    agreement: Agreement
    units: ResponseUnits
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        estimates_by_name = {estimate.name: estimate for estimate in (*self.estimates, *self.derived)}
        if name not in estimates_by_name:
            raise ParameterError(f"the fit has no parameter '{name}'; there are {', '.join(estimates_by_name)}")
        return estimates_by_name[name]

    def blocks(self) -> tuple[Plant, Actuator]:
        """Return the plant and actuator as blocks of an axis, which is rotary if the fit is in rad and N m.

        Raises ParameterError for units other than kg and N/m or kg m2 and N m/rad.
        """
        if not (self.units.si or self.units.turns):
            raise ParameterError(
                f"the fit is in {self.units.of('kg')} and not in kg: give force_per_unit in N/{self.units.input}"
                + ("" if self.units.output == "m" else f" and travel_per_unit in m/{self.units.output}")
                + " before it becomes part of an axis"
            )
        return self.plant, self.actuator

    def table(self) -> Table:
        """Return a table with one row for each parameter, including those that are not identifiable."""
        title = Text(
            f"{self.plant.kind}; unused lines are predicted within {Quantity(8.686 * self.agreement.unused, 'dB'):.3f} "
            "RMS"
        )
        listing = estimates_table(title, (*self.estimates, *self.derived))
        rows: list[Sequence[Cell]] = [
            [*row[:5], "not identifiable" if row[0] in self.not_identifiable else row[5]] for row in listing.rows
        ]
        there = {row[0] for row in rows}
        held = dict(tree.leaves(self.plant))
        rows += [
            [name, UNIT, Quantity(float(held.get(name, 0.0)), self._unit(name)), "", "", "not identifiable"]
            for name in self.not_identifiable
            if name not in there
        ]
        return Table(title, listing.columns, rows)

    def _unit(self, name: str) -> str:
        """Return the unit of a parameter of the plant or of the actuator."""
        return self.units.of("Hz" if name == "current_loop" else tree.declaration(self.plant, name).unit)


@dataclass(frozen=True)
class Task:
    """The fit problem: initial values, known parameters, and the responses by sensor, as returned by `taken`."""

    plant: Plant
    actuator: Actuator
    fixed: Mapping[str, float]
    responses: Mapping[str, FRF]
    units: ResponseUnits
    held: bool = True

    @property
    def frfs(self) -> list[FRF]:
        """The responses as a list, in the order of the sensors."""
        return list(self.responses.values())

    @property
    def band(self) -> tuple[float, float]:
        """The lowest and the highest frequency line, Hz."""
        return min(f.frequency[0] for f in self.frfs), max(f.frequency[-1] for f in self.frfs)

    def model(self, names: Sequence[str]) -> TracedPlant:
        """Return the model with these parameters as unknowns."""
        lines = [
            SensorLines(frf.frequency, sensor, self.units.order, frf.sample_time if self.held else None)
            for sensor, frf in self.responses.items()
        ]
        fixed = {"dead_time": self.actuator.dead_time, **self.fixed}
        if self.actuator.current_loop is not None and "current_loop" not in names:
            fixed.setdefault("current_loop", self.actuator.current_loop)
        return TracedPlant(self.plant, names, lines, fixed)

    def unknowns(self, names: Sequence[str]) -> list[Unknown]:
        """Return the initial value, scale and bounds of each parameter."""
        leaves = dict(tree.leaves(self.plant))
        low, high = (2.0 * np.pi * f for f in self.band)
        mass = float(self.plant.rigid_mass())
        unknowns: list[Unknown] = []
        for name in names:
            if name == "dead_time":
                unknowns.append(Unknown(name, "s", self.actuator.dead_time, scale=0.1 / high))
                continue
            if name == "current_loop":
                start = self.actuator.current_loop or high / np.pi
                most = 1e3 * high / (2.0 * np.pi)
                unknowns.append(Unknown(name, "Hz", start, positive=True, least=1e-3 * low, most=most))
                continue
            declared = tree.declaration(self.plant, name)
            unit, value = self.units.of(declared.unit), float(leaves[name])
            if declared.above == 0.0 and value > 0.0:
                # a resonance stays near its line, and no parameter leaves the range that the lines can determine
                reach = 3.0 if declared.unit == "Hz" else 1e6
                unknowns.append(Unknown(name, unit, value, positive=True, least=value / reach, most=value * reach))
            else:
                if name.endswith("damping_ratio"):
                    # it is optimized by its logarithm, which needs a start above 0
                    unknowns.append(Unknown(name, unit, max(value, 1e-4), positive=True, least=1e-5, most=2.0))
                    continue
                usual = {"N s/m": mass * np.sqrt(low * high), "": 1.0}.get(declared.unit, abs(value) or 1.0)
                least = max((b for b in (declared.least, declared.above) if b is not None), default=-np.inf)
                most = min((b for b in (declared.most, declared.below) if b is not None), default=np.inf)
                unknowns.append(Unknown(name, unit, value, scale=usual, least=least, most=most))
        return unknowns


def solve(task: Task, names: Sequence[str], *, logarithmic: bool, steps: int = STEPS) -> tuple[Task, Refined]:
    """Return the task with the plant and actuator of minimum cost, and the refined parameters."""
    model, unknowns = task.model(names), task.unknowns(names)
    refined = refine(model, unknowns, task.frfs, logarithmic=logarithmic, steps=steps)
    values = dict(zip(names, refined.values, strict=True))
    plant = tree.rebuild(task.plant, iter(model.values(refined.values)))
    actuator = replace(
        task.actuator,
        # a fit may end at a negative dead time, which no actuator has: it is reported by a remark
        dead_time=max(float(values.get("dead_time", task.actuator.dead_time)), 0.0),
        current_loop=values.get("current_loop", task.actuator.current_loop),
    )
    return replace(task, plant=plant, actuator=actuator), refined


def finished(
    task: Task, names: Sequence[str], neutral: Sequence[str] = (), stated: Mapping[str, float] | None = None
) -> PlantFit:
    """Fit until convergence, fixing parameters of `neutral` that the frequency lines do not determine, and return the
    fit.

    `neutral` lists optional parameters in the order in which they are fixed, at zero or at their `stated` value.  The
    errors of the other parameters are computed as if the fixed ones were unknown.
    """
    kept = {name: (stated or {}).get(name, 0.0) for name in neutral}
    names, gone = list(names), {}
    task, refined = solve(task, names, logarithmic=True)
    weighted = any(frf.variance is not None for frf in task.frfs)
    while True:
        # the logarithmic cost has the wider basin and comes first; the variances then weight the lines
        if weighted:
            task, refined = solve(task, names, logarithmic=False)
        covariance = _covariance(task, names, refined, weighted, {})
        error = np.sqrt(np.maximum(np.diag(covariance[0]), 0.0))
        weak = {
            name: float(e)
            for name, value, e, bound in zip(names, refined.values, error, refined.bound, strict=True)
            if bound or e > UNKNOWN * abs(value)
        }
        if "current_loop" in weak and (task.actuator.current_loop or 0.0) > _IDEAL * task.band[1]:
            # faster than the lines can show: it would represent nothing, and no drive has such a current loop
            gone["current_loop"] = (
                f"it is faster than {number(_IDEAL)} times the highest line; it is left out, and the force acts at once"
            )
            names.remove("current_loop")
            task = replace(task, actuator=replace(task.actuator, current_loop=None))
            task, refined = solve(task, names, logarithmic=True)
            continue
        first = next((name for name in neutral if name in weak), None)
        if first is None:
            break
        gone[first] = advice(first, task.band, float(task.plant.rigid_mass()), weak[first], task.units)
        names.remove(first)
        task = replace(task, plant=tree.vary(task.plant, {first: kept[first]}))
        task, refined = solve(task, names, logarithmic=True)
    model, unknowns = task.model(names), task.unknowns(names)
    covariance = _covariance(task, names, refined, weighted, {name: kept[name] for name in gone if name in kept})
    refined = replace(refined, covariance=covariance[0], ols=covariance[1])
    error, plain = (np.sqrt(np.maximum(np.diag(c), 0.0)) for c in (refined.covariance, refined.ols))
    estimates = tuple(
        Estimate(unknown.name, float(v), unknown.unit, float(e), float(o))
        for unknown, v, e, o in zip(unknowns, refined.values, error, plain, strict=True)
    )
    for unknown, bound in zip(estimates, refined.bound, strict=True):
        # a dead time of zero within its error is an answer
        if unknown.name != "dead_time" and (bound or unknown.error > UNKNOWN * abs(unknown.value)):
            gone[unknown.name] = advice(
                unknown.name, task.band, float(task.plant.rigid_mass()), unknown.error, task.units
            )
    gone = {**blind(estimates, refined), **gone}
    fit = agreement(model, unknowns, task.frfs, refined, task.units.order)
    remarks = [*fit.remarks(), *entangled(names, refined)]
    if not refined.settled:
        remarks.append("the minimization did not converge: limit the band to high coherence")
    late = next((e for e in estimates if e.name == "dead_time"), None)
    if late is not None and late.value < -3.0 * late.error:
        remarks.append(
            Text(
                f"the dead time comes out as {Quantity(late.value, 's'):3}: the position was logged that much later "
                "than the force, the input is a measured current (held=False, --measured-input), or a mode above the "
                "band is missing; it counts as 0"
            )
        )
    return PlantFit(task.plant, task.actuator, estimates, refined.covariance, (), gone, fit, task.units, tuple(remarks))


def _covariance(
    task: Task, names: Sequence[str], refined: Refined, weighted: bool, gone: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the robust and the plain covariance of the parameters; those fixed during the fit count as unknown."""
    every = [*names, *gone]
    at = np.concatenate([refined.values, [*gone.values()]])
    both = covariances_at(
        task.model(every),
        task.unknowns(every),
        task.frfs,
        at,
        logarithmic=not weighted,
        model_error=refined.model_error,
    )
    n = len(names)
    return both[0][:n, :n], both[1][:n, :n]


def with_derived(fit: PlantFit, derived: Sequence[tuple[str, str, Any]]) -> PlantFit:
    """Return the fit with derived quantities, each given as (name, unit, function of the plant).

    Their standard errors follow by first-order propagation.
    """
    leaves = [name for name, _ in tree.leaves(fit.plant)]
    places = [(i, e) for i, e in enumerate(fit.estimates) if e.name in leaves]
    derived_estimates: list[Estimate] = []
    for name, unit, function in derived:
        value, slope = float(function(fit.plant)), np.zeros(len(fit.estimates))
        for i, estimate in places:
            # central difference: its error falls with the square of the step, and rounding with 1e-16 over it
            step = 1e-5 * max(abs(estimate.value), 1e-12)
            up, down = (
                float(function(tree.rebuild(fit.plant, _other(fit.plant, estimate.name, estimate.value + sign * step))))
                for sign in (1.0, -1.0)
            )
            slope[i] = (up - down) / (2.0 * step)
        error = float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
        derived_estimates.append(Estimate(name, value, unit, error, error))
    gone = dict(fit.not_identifiable)
    for estimate in derived_estimates:
        if estimate.error > UNKNOWN * abs(estimate.value):
            gone[estimate.name] = Text(
                f"its standard error is {Quantity(estimate.error, estimate.unit):2}; it follows from "
                f"{', '.join(leaves)}"
            )
    return replace(fit, derived=tuple(derived_estimates), not_identifiable=gone)


def _other(plant: Plant, changed: str, value: float) -> Any:
    return iter([value if name == changed else old for name, old in tree.leaves(plant)])


DRIVE = ("dead_time", "current_loop")  # parameters of the actuator, in addition to those of the plant
_ALIASES = 4  # on either side, at most
_ALIAS = 3e-5  # of the response: aliases that are smaller are left out
_SENSORS = ("motor", "load")  # the outputs of the traced model, in their order


@dataclass(frozen=True)
class SensorLines:
    """The lines of a fitted response in Hz, its encoder, and its order as a derivative of the position (0, 1 or 2)."""

    frequency: np.ndarray
    sensor: str  # "motor" or "load"
    order: int = 0
    sample_time: float | None = None  # s, for a response from a held command to samples of the position


class TracedPlant:
    """The response x/f = e^(-s·dead_time) · s^order · Gᵢ(s) and its derivatives; G is the traced core of an axis.

    The parameters are leaves of the plant by name, then "dead_time" (s) and "current_loop" (Hz) of the actuator; the
    derivatives are forward tangents of the traced core.  `fixed` has the values of other parameters.  A sampled
    response, from a command that is held over each sample, is the sum over its aliases:

        (1 - e^(-jωT))/T Σ G(jω + jmω_s)/(jω + jmω_s),   |m| <= 4, or fewer for low frequencies

    The sum agrees with the loop's own sampled model to 2e-5 below a tenth of the sample rate and to 2e-3 at 0.4 of it.
    """

    def __init__(
        self, plant: Plant, names: Sequence[str], lines: Sequence[SensorLines], fixed: Mapping[str, float]
    ) -> None:
        self.plant, self.names, self.lines = plant, tuple(names), tuple(lines)
        fixed_values = {name: float(value) for name, value in tree.leaves(plant)} | {"dead_time": 0.0}
        self.fixed = {**fixed_values, **{name: float(value) for name, value in fixed.items()}}
        self.traced = _trace(plant, "current_loop" in (*self.names, *self.fixed))

    def on(self, frequencies: Sequence[np.ndarray], /) -> TracedPlant:
        """Return the model on other lines in Hz."""
        other = copy(self)
        other.lines = tuple(
            replace(sensor_lines, frequency=f) for sensor_lines, f in zip(self.lines, frequencies, strict=True)
        )
        return other

    def values(self, parameters: np.ndarray) -> list[float]:
        """Return the values of all leaves of the plant."""
        values_by_name = {**self.fixed, **dict(zip(self.names, map(float, parameters), strict=True))}
        return [values_by_name[name] for name, _ in tree.leaves(self.plant)]

    def responses(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """Return each response, without derivatives, at other values of parameters by name."""
        return [response for response, _ in self._at({**self.fixed, **values}, ())]

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return each response and its derivatives, shape (lines, parameters)."""
        return self._at({**self.fixed, **dict(zip(self.names, map(float, parameters), strict=True))}, self.names)

    def _at(self, values: Mapping[str, float], names: tuple[str, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
        traced = [name for name in names if name != "dead_time"]
        columns = [names.index(name) for name in traced]
        model = self.traced.at({name: np.float64(value) for name, value in values.items()}, traced)
        shared: dict[tuple[bytes, float | None], tuple[np.ndarray, ...]] = {}
        evaluated: list[tuple[np.ndarray, np.ndarray]] = []
        for sensor_lines in self.lines:
            T = None if sensor_lines.order else sensor_lines.sample_time
            key = sensor_lines.frequency.tobytes(), T
            # encoders on the same lines share the solved core, which is the costly part
            if key not in shared:
                shared[key] = _core(model, sensor_lines.frequency, T, values["dead_time"])
            s, factor, responses, moved = shared[key]
            place = _SENSORS.index(sensor_lines.sensor)
            factor = factor * s**sensor_lines.order
            response, slopes = responses[:, place] * factor, np.zeros((s.size, len(names)), complex)
            slopes[:, columns] = moved[:, place] * factor[:, None]
            if "dead_time" in names:
                slopes[:, names.index("dead_time")] = -s * response
            if T is not None:
                shape = (s.size // sensor_lines.frequency.size, sensor_lines.frequency.size)
                response = response.reshape(shape).sum(axis=0)
                slopes = slopes.reshape((*shape, -1)).sum(axis=0)
            evaluated.append((response, slopes))
        return evaluated


def _core(
    model: LinearModel, frequency: np.ndarray, T: float | None, dead_time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return s at all frequency lines and aliases, the factor of dead time and zero-order hold, and response and
    derivatives of the core.
    """
    aliases = np.zeros(1) if T is None else np.arange(-(most := _aliases(frequency, T)), most + 1) / T
    s = 2j * np.pi * (frequency + aliases[:, None]).ravel()
    factor = np.exp(-s * dead_time)
    if T is not None:
        hold = (1.0 - np.exp(-2j * np.pi * frequency * T)) / T
        factor = factor * np.tile(hold, aliases.size) / s
    response, slopes = model.response(s)
    return s, factor, response[:, :, 0], slopes[:, :, 0]


def _aliases(frequency: np.ndarray, T: float) -> int:
    """Return the number of aliases to sum on either side; for a mass and a held force they fall as (f/f_alias)³."""
    share = float(np.max(frequency)) * T
    first = range(1, _ALIASES)
    return next((m for m in first if (share / (m + 1.0 - share)) ** 3 < _ALIAS), _ALIASES)


def _trace(plant: Plant, lagging: bool) -> TracedModel:
    """Trace the linear core: states q, q' and a lagging drive force, one input, two positions as outputs."""
    graph = Graph()

    def leaf(name: str) -> Number:
        return cast(Number, graph.input(name))

    symbolic = tree.rebuild(plant, (leaf(name) for name, _ in tree.leaves(plant)))
    mechanics = symbolic.mechanics()
    shape = mechanics.shape
    bodies = Rows(shape[mechanics.drive], shape[mechanics.motor], shape[mechanics.load])
    lag = 2.0 * ops.pi * leaf("current_loop") if lagging else None
    derivative = rate(mechanics, [Port(bodies, lag, 0.0, Timing(0, False))], 1.0, 1.0)
    n = len(derivative) - 3
    rows = [
        *(row[: n + 1] for row in derivative[:n]),
        mechanics.shape[mechanics.motor],
        mechanics.shape[mechanics.load],
    ]
    entries = tuple(
        (i, j, graph.symbol(value).index)
        for i, row in enumerate(rows)
        for j, value in enumerate(row)
        if not matrix.is_zero(value)
    )
    leaves = {name: graph.input(name).index for name in [name for name, _ in tree.leaves(plant)]}
    if lagging:
        leaves["current_loop"] = graph.input("current_loop").index
    return TracedModel(graph, n, (n + 2, n + 1), entries, leaves)


# Two masses and a spring, or a rigid mass with modes, from frequency responses of one or both encoders.

_BEYOND = 4.0  # how far beyond the lines a resonance is looked for, as a factor
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0)  # of load to motor mass
_GRID = 15  # resonances
_BEST = 4  # of the grid that are followed
_FASTER = 3.0  # times the stated current loop: from there, too, a fit of its lag begins
_TURNED = 0.25  # turns of the phase at the highest line, beyond which a fit begins with the dead time that makes them


def fit_plant(
    plant: Plant,
    motor: FRF | None = None,
    load: FRF | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
    absent: tuple[str, ...] = (),
    dead_time: float | None = None,
    current_loop: float | None = None,
    find_current_loop: bool = False,
    held: bool = True,
    band: tuple[float, float] | None = None,
    force_per_unit: float | None = None,
    travel_per_unit: float | None = None,
) -> PlantFit:
    """Fit any plant block, starting from its values, to the responses of the motor and the load encoder.

        x/f = e^(-s·dead_time) / (1 + s/ω) · Sᵢ (M s² + C s + K)⁻¹ S_driveᵀ,   both responses together

    motor, load        position (or velocity, acceleration, by their unit) over the drive's force, at least one of them
    fixed              known parameters by name; they keep that value
    absent             parameters, such as friction, that keep the value of `plant` if the frequency lines do not
                       determine them
    dead_time          dead time, s; None: it is fitted.  For a response with a sample time it does not include the
                       zero-order hold
    held               True if the input of a sampled response is a command held over each sample; False for a measured
                       current or force
    current_loop       bandwidth, Hz; None: the force follows without lag, unless `find_current_loop` is set
    band               lowest and highest frequency of the lines used, Hz
    force_per_unit     N per unit of the responses' input (a motor's force constant)
    travel_per_unit    m per unit of their output (lead/2π for rad).  Without these, the result is in the units of the
                       responses

    The cost is that of `refine`: residuals weighted by the variances where these are known, otherwise complex
    logarithmic ratios.
    Raises ParameterError for different units, an unknown name and too few lines.
    Not suitable for poor initial values; `fit_two_mass` and `fit_modal_axis` find their own.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    fixed_values = dict(fixed or {})
    # only for its error: a name that the plant lacks is refused before the fit
    for name in fixed_values:
        tree.get(plant, name)
    actuator = Actuator(dead_time=dead_time or 0.0, current_loop=current_loop)
    names = [name for name, _ in tree.leaves(plant) if name not in fixed_values]
    names += ["dead_time"] if dead_time is None else []
    names += ["current_loop"] if find_current_loop else []
    start = tree.vary(plant, fixed_values)
    stated = {name: float(tree.get(start, name)) for name in absent}
    return finished(Task(start, actuator, {}, responses, units, held), names, absent, stated)


def fit_two_mass(
    motor: FRF | None = None,
    load: FRF | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
    dead_time: float | None = None,
    current_loop: float | None = None,
    find_current_loop: bool = False,
    held: bool = True,
    band: tuple[float, float] | None = None,
    force_per_unit: float | None = None,
    travel_per_unit: float | None = None,
    begin: Sequence[TwoMass] = (),
) -> PlantFit:
    """Fit two masses and a spring to the response of the motor's encoder, or to both responses together.

        (m1 s² + (b1 + c) s + k) x1 - (c s + k) x2 = e^(-s·dead_time) f,   (m2 s² + (b2 + c) s + k) x2 = (c s + k) x1

    The arguments are those of `fit_plant`; initial values are `begin`, or follow from a modal fit:  m2/m1 =
    residue/free at the motor, k = ω² m1 m2/(m1 + m2).  Viscous friction that the frequency lines do not determine is
    fixed at zero and reported as not identifiable.  Derived: antiresonance √(k/m2), resonance √(k (m1 + m2)/(m1 m2)),
    inertia ratio m2/m1, total mass.

    Raises NotIdentifiableError if only the load's response is given and no mass is fixed: it determines the total
    mass and the resonance, but not the mass ratio.
    Not suitable for an axis with further modes in the band; reduce the band, or use `fit_modal_axis`.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    fixed_values = dict(fixed or {})
    if "motor" not in responses and not {"mass_motor", "mass_load", "stiffness"} & set(fixed_values):
        raise NotIdentifiableError(
            "mass_motor and mass_load are not identifiable from the load's response alone: it determines their sum "
            "and the resonance; measure next the motor's encoder too, or fix one of them"
        )
    every = ("mass_motor", "mass_load", "stiffness", "damping", "viscous_motor", "viscous_load")
    names = [name for name in every if name not in fixed_values]
    names += ["dead_time"] if dead_time is None else []
    names += ["current_loop"] if find_current_loop else []
    best: tuple[float, Task] | None = None
    late = _late(responses, units) if dead_time is None else dead_time
    # a lag that is looked for has a part of the phase, small or large
    corners = (
        [current_loop] if current_loop is None or not find_current_loop else [current_loop, _FASTER * current_loop]
    )
    lags = [0.0 if corner is None or dead_time is not None else 0.5 / (np.pi * corner) for corner in corners]
    actuators = [
        Actuator(dead_time=max(0.0, late - lag), current_loop=corner) for corner, lag in zip(corners, lags, strict=True)
    ]
    for start, actuator in product(begin or starts(responses, units, dead_time), actuators):
        task = Task(tree.vary(start, fixed_values), actuator, {}, responses, units, held)
        task, refined = solve(task, names, logarithmic=True, steps=25)
        # bounded, so that a few lines at a missed peak do not decide which start is followed
        far = float(np.mean(np.minimum(np.abs(np.concatenate(refined.residuals)), 1.0)))
        if best is None or far < best[0]:
            best = far, task
    assert best is not None
    fit = finished(best[1], names, ("viscous_load", "viscous_motor", "damping"))
    fit = with_derived(
        fit,
        [
            ("antiresonance", "Hz", lambda p: np.sqrt(p.stiffness / p.mass_load) / (2.0 * np.pi)),
            ("resonance", "Hz", _resonance),
            ("inertia_ratio", "", lambda p: p.mass_load / p.mass_motor),
            ("total_mass", units.of("kg"), lambda p: p.mass_motor + p.mass_load),
        ],
    )
    return replace(fit, remarks=(*fit.remarks, *beyond(fit["resonance"], best[1].band)))


def _late(responses: Mapping[str, FRF], units: ResponseUnits) -> float:
    """Return the dead time (s) from which a fit of all lines begins: the slope of the phase, 0 if it is a small one.

    Half a turn at the highest line is another minimum of the phase, from which no fit comes back.
    """
    slopes: list[float] = []
    for frf in responses.values():
        turned = np.unwrap(np.angle(frf.response * (2j * np.pi * frf.frequency) ** (2 - units.order)))
        slopes.append(-float(np.polyfit(2.0 * np.pi * frf.frequency, turned, 1)[0]))
    late, high = min(slopes), max(float(frf.frequency[-1]) for frf in responses.values())
    return late if late * high > _TURNED else 0.0


def _check_driven(modal: ModalFit, frequency: float, residue: float) -> None:
    """Raise WrongSignError for a mode with a negative residue at the motor encoder."""
    by_name = {estimate.name: estimate for estimate in modal.estimates}
    number = int(np.argmin(np.abs(modal.values[: modal.model.modes] - frequency))) + 1
    error = by_name[f"residue_{number}_motor"].error if f"residue_{number}_motor" in by_name else np.inf
    # a driven point moves with its force in every mode: its residues are positive
    if residue < -3.0 * error:
        raise WrongSignError(
            f"the mode at {Quantity(frequency, 'Hz')} has the wrong sign at the motor's encoder (residue "
            f"{Quantity(residue, error=error)}): the force does not act where this encoder sits, and the masses cannot "
            "be determined; give the response as `load` alone, or take fit_modes"
        )


def _resonance(plant: TwoMass) -> float:
    both = 1.0 / plant.mass_motor + 1.0 / plant.mass_load
    return float(np.sqrt(plant.stiffness * both) / (2.0 * np.pi))


def fit_modal_axis(
    motor: FRF | None = None,
    load: FRF | None = None,
    modes: int | None = None,
    *,
    dead_time: float | None = None,
    current_loop: float | None = None,
    find_current_loop: bool = False,
    held: bool = True,
    band: tuple[float, float] | None = None,
    force_per_unit: float | None = None,
    travel_per_unit: float | None = None,
) -> PlantFit:
    """Fit a rigid mass with any number of modes in parallel to the responses of one encoder or of both together.

        x/f = e^(-s·dead_time) [ 1/(M s² + b s) + Σ shapeᵢ / (mᵢ (s² + 2ζᵢωᵢs + ωᵢ²)) ],   shape 1 at the motor

    The arguments are those of `fit_plant`; with `modes` None, as many modes are fitted as the frequency lines left out
    of the fit justify, less those whose frequency or mass the lines do not determine. Modal masses are positive, as is
    required at a driven point: a mode with the wrong sign at the motor is fitted with a very large mass and is reported
    as not identifiable.  With the load's response alone the shape of a mode at the load is ±1 and its mass is fitted.
    Not suitable where residues are far from real; see `fit_modes` with proportional=False.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    fitted = partial(
        _modal_axis,
        responses,
        units,
        dead_time=dead_time,
        current_loop=current_loop,
        find_current_loop=find_current_loop,
        held=held,
    )
    best = fit = fitted(modes)
    # lines left out can be predicted better with a mode whose mass no line determines: a plant has only those modes
    # whose masses are determined
    while modes is None and _untold_modes(fit) and cast(Modal, fit.plant).modes:
        try:
            fit = fitted(len(cast(Modal, fit.plant).modes) - 1)
        except FeeddriveError:
            break
        if fit.agreement.poor:
            break
        if not _untold_modes(fit):
            return fit
    return best


def _untold_modes(fit: PlantFit) -> list[str]:
    """Return the frequencies and masses of modes that the lines do not determine."""
    return [name for name in fit.not_identifiable if name.endswith((".frequency", ".mass"))]


def _modal_axis(
    responses: dict[str, FRF],
    units: ResponseUnits,
    modes: int | None,
    *,
    dead_time: float | None,
    current_loop: float | None,
    find_current_loop: bool,
    held: bool,
) -> PlantFit:
    """Fit a rigid mass with a number of modes; see `fit_modal_axis`."""
    # only start values are needed, and equal weights have the wider basin
    plain = {name: replace(frf, variance=None) for name, frf in responses.items()}
    modal = fit_modes(plain, modes, proportional=True, dead_time=dead_time)
    check_signs(modal)
    model, values = modal.model, modal.values
    free = float(np.mean([abs(values[model.common + i * model.per_output]) for i in range(len(modal.outputs))]))
    parts: list[Mode] = []
    fixed: list[str] = []
    for i, mode in enumerate((*modal.modes, *modal.beyond)):
        at = dict(zip(modal.outputs, (r.real for r in mode.residues), strict=True))
        _check_driven(modal, mode.frequency.value, at.get("motor", 0.0))
        drive = abs(at.get("motor", at.get("load", 0.0))) or 1e-6 * free
        shape = at.get("load", drive) / drive
        # residues determine only the ratio of shape to mass, so that the shape at the motor is 1
        fixed += [f"modes.{i}.motor"]
        if "load" not in at or "motor" not in at:
            shape = float(np.sign(shape)) or 1.0
            fixed += [f"modes.{i}.load"]
        ratio = min(mode.damping_ratio.value, 1.0)
        parts.append(Mode(frequency=mode.frequency.value, damping_ratio=ratio, mass=1.0 / drive, motor=1.0, load=shape))
    corner = float(values[2 * model.modes])
    plant = Modal(mass=1.0 / free, viscous=corner / free, modes=tuple(parts))
    actuator = Actuator(
        dead_time=max(modal["dead_time"].value, 0.0) if dead_time is None else dead_time, current_loop=current_loop
    )
    names = [name for name, _ in tree.leaves(plant) if name not in fixed]
    names += [
        free_name for free_name, wanted in zip(DRIVE, (dead_time is None, find_current_loop), strict=True) if wanted
    ]
    return finished(Task(plant, actuator, {}, responses, units, held), names, ("viscous",))


def starts(responses: Mapping[str, FRF], units: ResponseUnits, dead_time: float | None) -> list[TwoMass]:
    """Return initial plants from modal fits, with one mode and with the most pronounced of several, and from a grid.

    The grid covers resonances at the edge of the band or beyond, whose peak a modal fit cannot detect.
    """
    plants: list[TwoMass] = []
    plain = {name: replace(frf, variance=None) for name, frf in responses.items()}
    for count in (1, 2):
        try:
            modal = fit_modes(plain, count, proportional=True, rest=count > 1, dead_time=dead_time)
        # without a modal fit the grid still gives starts
        except ParameterError:
            continue
        if count == 1:
            check_signs(modal)
        plants += [start for i in range(len(modal.modes)) if (start := _from_mode(modal, i)) is not None]
    return [*plants, *_of_grid(responses, units)]


def _of_grid(responses: Mapping[str, FRF], units: ResponseUnits) -> list[TwoMass]:
    """Return the plants of a grid of resonances and mass ratios that fit the magnitudes best, with best total mass."""
    frfs = list(responses.values())
    lines = [SensorLines(frf.frequency, sensor, units.order) for sensor, frf in responses.items()]
    model = TracedPlant(_scaled(1.0, 1.0, 1.0, 0.03, 0.0), (), lines, {})
    low, high = min(f.frequency[0] for f in frfs), max(f.frequency[-1] for f in frfs)
    measured = np.concatenate([np.log(np.maximum(frf.magnitude, 1e-300)) for frf in frfs])
    scored: list[tuple[float, TwoMass]] = []
    for f, ratio in product(np.geomspace(low / _BEYOND, _BEYOND * high, _GRID), _RATIOS):
        plant = _scaled(1.0, ratio, 2.0 * np.pi * f, 0.03, 0.0)
        predictions = model.responses(dict(tree.leaves(plant)))
        apart = np.concatenate([np.log(np.abs(response)) for response in predictions]) - measured
        # the total mass shifts ln |G| as a whole: its best value is the median, without a search
        total = float(np.median(apart))
        score = float(np.mean(np.minimum(np.abs(apart - total), 1.0)))
        scored.append((score, _scaled(float(np.exp(total)), ratio, 2.0 * np.pi * f, 0.03, 0.0)))
    return [plant for _, plant in sorted(scored, key=lambda point: point[0])[:_BEST]]


def _scaled(total: float, ratio: float, omega: float, damping_ratio: float, viscous: float) -> TwoMass:
    """Return the two-mass plant with a given total mass, mass ratio and resonance in rad/s."""
    first = total / (1.0 + ratio)
    reduced = first * ratio * first / total
    return TwoMass(
        mass_motor=first,
        mass_load=ratio * first,
        stiffness=reduced * omega**2,
        damping=2.0 * min(damping_ratio, 0.3) * omega * reduced,
        viscous_motor=0.5 * viscous,
        viscous_load=0.5 * viscous,
    )


def _from_mode(modal: ModalFit, place: int) -> TwoMass | None:
    mode = modal.modes[place]
    model, values = modal.model, modal.values
    free = [abs(float(values[model.common + i * model.per_output])) for i in range(len(modal.outputs))]
    if min(free) <= 0.0:
        return None
    total = 1.0 / float(np.mean(free))
    ratio = abs(mode.residues[modal.outputs.index("motor")]) * total if "motor" in modal.outputs else 1.0
    ratio = float(np.clip(ratio, 1e-3, 1e3))
    viscous = float(values[2 * model.modes]) * total
    return _scaled(total, ratio, 2.0 * np.pi * mode.frequency.value, mode.damping_ratio.value, viscous)


def check_signs(modal: ModalFit) -> None:
    """Raise WrongSignError if the rigid-body motion at an encoder has the wrong sign (encoder counts reversed)."""
    for name in modal.outputs:
        free = modal[f"free_{name}"] if name else modal["free"]
        if free.value < -5.0 * free.error:
            raise WrongSignError(
                f"the response to '{name}' has the wrong sign: a positive force moves it to smaller positions (its "
                f"free motion is {Quantity(free.value, free.unit):3}); check the direction of the encoder and invert "
                "the response (-frf)"
            )


# a model error beyond the noise up to which a wider band counts as explained: 2 % moves the total mass by less than the
# 5 % that a tuning needs, and the systematic errors of a measurement are of that size
_EXPLAINED = 0.02
_WORSE = 1.5  # times the least model error of all bands, where none of them is explained better
_OCTAVE = 2.0  # between the upper ends of the bands that are tried
_LEAST_DECADE = 8.0  # times the lowest line: a shorter band does not tell mass, friction and spring apart
# accuracy of a drive's torque, which is a current times a constant, and so of every mass, spring and damper: current
# sensors are good to 0.5 to 1 % of their range.  No statistics of one measurement show it
_GAUGE = 0.005
# of a frequency: the shape of the response around a zero changes with the sliding friction of the test
_CLOCK = 0.001
_OTHERS = 2  # starts from the grid beside that of the band above
_NARROWER = 2  # bands below the chosen one whose fits tell its systematic error
_LINES_OF_A_BAND = 200  # for the choice of the band; the fit takes all its lines
_ABOVE = 1.3  # times the resonance: a band must show the far side of the peak


@dataclass(frozen=True)
class ModelBand:
    """The band in which two masses and a spring explain a response.

    low, high   ends of the band, Hz
    whole       True if it contains all frequency lines
    begin       initial plant for a fit, from some lines of the band; empty if the lines contain no resonance
    scatter     deviation of the fits to narrower bands beyond their standard errors, by parameter: the effect of
                systematic measurement errors
    """

    low: float
    high: float
    whole: bool
    begin: tuple[TwoMass, ...]
    scatter: Mapping[str, float]

    def lower(self) -> ModelBand | None:
        """Return the band without its uppermost octave; None if it would end near the lowest lines."""
        high = self.high / _OCTAVE
        return None if high < _LEAST_DECADE * self.low else replace(self, high=high, whole=False)

    def widened(self, fit: PlantFit) -> PlantFit:
        """Return a fit to this band whose standard errors include the scatter and the accuracy of a drive's sensors."""

        def wider(estimate: Estimate) -> Estimate:
            share = {"Hz": _CLOCK, "s": 0.0, "": 0.0}.get(estimate.unit, _GAUGE)
            parts = (estimate.error, self.scatter.get(estimate.name, 0.0), share * abs(estimate.value))
            return replace(estimate, error=float(np.linalg.norm(parts)))

        estimates = tuple(map(wider, fit.estimates))
        factors = np.array(
            [
                new.error / old.error if old.error > 0.0 else 1.0
                for new, old in zip(estimates, fit.estimates, strict=True)
            ]
        )
        return replace(
            fit,
            estimates=estimates,
            derived=tuple(map(wider, fit.derived)),
            covariance=fit.covariance * np.outer(factors, factors),
        )


def two_mass_band(motor: FRF, *, band: tuple[float, float] | None = None, held: bool = True) -> ModelBand:
    """Return the widest band, from the lowest line up, in which two masses and a spring explain a response.

    A drive's response extends to several kHz, where there are structural modes beyond the first one; a fit to all
    frequency lines would mistake one of these for the spring.  Bands with upper ends an octave apart are fitted.  Among
    those that contain the fitted resonance, the widest one is selected whose error beyond the noise is at most 2 %, or
    at most 1.5 times the smallest error.  If no band contains a resonance, all lines are used.

    band   range of the lines to be considered, Hz
    held   as for `fit_plant`
    """
    (frf,) = taken({"motor": motor}, band, None, None)[0].values()
    low, high = float(frf.frequency[0]), float(frf.frequency[-1])
    fits: list[tuple[float, PlantFit]] = []
    errors: list[float] = []
    place, top, begin = 0, high, tuple[TwoMass, ...]()
    # once a band explains its lines no narrower one changes the choice: only the next few tell its systematic error
    while top >= _LEAST_DECADE * low and not (len(fits) > place + _NARROWER and errors[place] <= _EXPLAINED):
        lines = np.flatnonzero(frf.frequency <= top)
        part = on_lines(frf, lines[_spread_out(frf.frequency[lines], _LINES_OF_A_BAND)])
        try:
            fit = fit_two_mass(part, held=held, begin=begin)
            # a band within this one has the same resonance, or one that the grid of starts finds
            begin = (cast(TwoMass, fit.plant), *_of_grid({"motor": part}, fit.units)[:_OTHERS])
        except FeeddriveError:
            # too few lines, or a sign that two masses do not have: another band may do
            top /= _OCTAVE
            continue
        if fit["resonance"].value * _ABOVE <= top:
            fits.append((top, fit))
            errors.append(_misses(fit))
            least = max(_EXPLAINED, _WORSE * min(errors))
            place = next(i for i, error in enumerate(errors) if error <= least)
        top /= _OCTAVE
    if not fits:
        return ModelBand(low, high, True, (), {})
    inside = [fit for _, fit in fits[place : place + 1 + _NARROWER]]
    return ModelBand(low, fits[place][0], place == 0, (cast(TwoMass, inside[0].plant),), _scatter(inside))


def _scatter(fits: Sequence[PlantFit]) -> dict[str, float]:
    """Return, for each parameter, the RMS difference between the first fit and those to narrower bands, beyond the
    noise.

    If the model is correct, the variance of the difference between an estimate from some frequency lines and one from
    all lines is the difference of their variances.
    """
    first, *others = ({e.name: e for e in (*fit.estimates, *fit.derived)} for fit in fits)
    scatter: dict[str, float] = {}
    for name, estimate in first.items():
        beyond_noise = [
            max((other[name].value - estimate.value) ** 2 - max(other[name].error ** 2 - estimate.error**2, 0.0), 0.0)
            for other in others
            if name in other
        ]
        if beyond_noise:
            scatter[name] = float(np.sqrt(np.mean(beyond_noise)))
    return scatter


def on_lines(frf: FRF, lines: np.ndarray) -> FRF:
    """Return the response restricted to some of its frequency lines, which are given by index or mask."""
    coherence, variance = (None if row is None else row[lines] for row in (frf.coherence, frf.variance))
    return replace(
        frf, frequency=frf.frequency[lines], response=frf.response[lines], coherence=coherence, variance=variance
    )


def _misses(fit: PlantFit) -> float:
    """Return the RMS of ln(fitted/measured) at unused frequency lines beyond the measurement noise, if it is known.

    It is a mean and not a median, since a structural mode affects only a few lines, but strongly.
    """
    noise = [
        (frf.variance / frf.magnitude**2)[lines_above_noise(frf)]
        for frf in fit.agreement.measured
        if frf.variance is not None
    ]
    expected = float(np.mean(np.concatenate(noise))) if noise else 0.0
    return float(np.sqrt(max(fit.agreement.unused**2 - expected, 0.0)))


def _spread_out(frequency: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of at most `most` lines that are evenly spread over ln f, the first and the last included."""
    x = np.log(frequency)
    return np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], most)).clip(0, x.size - 1))


_AS_GOOD = 1.1  # times the least error on unused lines that counts as equally good
_NOISE = 0.3  # autocorrelation from line to line below which the residual counts as noise
_DECIBEL = 20.0 / np.log(10.0)  # dB of a natural logarithm


@dataclass(frozen=True, eq=False, repr=False)
class AxisFits(Result):
    """Fits of several structures to the same lines, and the selected one.

    fits     fits by structure; `chosen` is the name of the selected one
    refused  structures that could not be fitted or were not needed, with the reason
    wrong_sign  True if a mode or the rigid-body motion has a sign at an encoder that is impossible in any structure
    """

    fits: Mapping[str, PlantFit]
    chosen: str
    refused: Mapping[str, str]
    wrong_sign: bool = False

    @property
    def fit(self) -> PlantFit:
        """The selected fit."""
        return self.fits[self.chosen]

    def table(self) -> Table:
        """Return a table with one row per structure: parameters, RMS error at unused frequency lines in dB,
        autocorrelation.
        """
        rows: list[Sequence[Cell]] = [
            [
                name,
                len(fit.estimates),
                _DECIBEL * fit.agreement.unused,
                fit.agreement.autocorrelation(),
                "taken" if name == self.chosen else "",
            ]
            for name, fit in self.fits.items()
        ]
        rows += [[name, "", "", "", why] for name, why in self.refused.items()]
        heads = [
            "structure",
            "parameters",
            Column("unused lines", "dB", ".3f"),
            Column("from line to line", form=".2f"),
            "",
        ]
        return Table("structures: the fewest parameters among those that predict unused lines best", heads, rows)


def fit_axis(
    motor: FRF | None = None,
    load: FRF | None = None,
    *,
    plant: Plant | None = None,
    actuator: Actuator | None = None,
    modes: int | None = None,
    fixed: Mapping[str, float] | None = None,
    structure: str | None = None,
    held: bool = True,
    band: tuple[float, float] | None = None,
    force_per_unit: float | None = None,
    travel_per_unit: float | None = None,
    progress: Progress | None = None,
) -> AxisFits:
    """Fit the candidate structures of an axis, from simple to complex, and select the simplest of the best.

    plant      plant of a machine file: unless it is rigid, its structure is tried too, starting from its values
    actuator   actuator of that file: if it has a current loop, its bandwidth is identified too
    modes      number of modes in parallel; None: as many as the frequency lines left out of the fit justify
    fixed      known parameters; structures that lack one of them are not tried
    structure  "rigid", "machine", "two-mass" or "modal": only this structure is fitted
    progress   reports the name of each structure when it begins

    The other arguments are those of `fit_plant`.  Each structure predicts lines that were left out of its fit; of the
    structures whose error is within 10 % of the smallest, the one with the fewest parameters is selected.  Modes in
    parallel are tried only if the residuals of the other structures are still correlated from line to line.
    Raises ParameterError if no structure can be fitted, with the reason for each.
    """
    ways = _ways(motor, load, plant, actuator, modes, dict(fixed or {}), held, band, force_per_unit, travel_per_unit)
    if structure is not None and structure not in ways:
        raise ParameterError(f"there is no structure '{structure}' to fit; there are {', '.join(ways)}")
    fits: dict[str, PlantFit] = {}
    refused: dict[str, str] = {}
    wrong_sign = False
    for name, way in ways.items():
        if structure not in (None, name):
            continue
        white = [other for other, fit in fits.items() if abs(fit.agreement.autocorrelation()) < _NOISE]
        if white and name == "modal":
            refused[name] = f"not tried: no systematic residual is left by {white[-1]}"
            continue
        if progress is not None:
            progress.step(name)
        try:
            fits[name] = way()
        except FeeddriveError as error:
            if structure is not None:
                raise
            refused[name] = Text(f"{error}")
            wrong_sign = wrong_sign or isinstance(error, WrongSignError)
    if not fits:
        raise ParameterError(joined("; ", (f"{name}: {why}" for name, why in refused.items())))
    return AxisFits(fits, simplest(fits), refused, wrong_sign)


def simplest(fits: Mapping[str, PlantFit]) -> str:
    """Return the structure with the fewest parameters among those that predict unused frequency lines best.

    A structure whose total mass is not determined by the lines is excluded if another structure determines it, since a
    tuning needs the mass.
    """
    known = {name: fit for name, fit in fits.items() if _knows_mass(fit)} or fits
    best = min(fit.agreement.unused for fit in known.values())
    # the error on unused lines scatters itself: of equally good structures the simplest one is the safest to tune with
    good = [name for name, fit in known.items() if fit.agreement.unused <= _AS_GOOD * best + 1e-9]
    return min(good, key=lambda name: len(fits[name].estimates))


def _knows_mass(fit: PlantFit) -> bool:
    """Return True if the standard error of each mass in the rigid-body mass is at most half of the rigid-body mass."""
    whole = float(fit.plant.rigid_mass())
    masses = [e for e in fit.estimates if e.name in ("mass", "mass_motor", "mass_load")]
    return all(estimate.error <= UNKNOWN * whole for estimate in masses)


def _ways(
    motor: FRF | None,
    load: FRF | None,
    plant: Plant | None,
    actuator: Actuator | None,
    modes: int | None,
    fixed: dict[str, float],
    held: bool,
    band: tuple[float, float] | None,
    force_per_unit: float | None,
    travel_per_unit: float | None,
) -> dict[str, Callable[[], PlantFit]]:
    """Return the fits that are possible with the fixed parameters, in the order in which they are tried."""
    corner = None if actuator is None else actuator.current_loop
    common: dict[str, Any] = {
        "held": held,
        "band": band,
        "force_per_unit": force_per_unit,
        "travel_per_unit": travel_per_unit,
        "current_loop": None if corner is None else float(corner),
        "find_current_loop": corner is not None,
    }

    def rigid() -> PlantFit:
        responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
        # between friction and the first resonance acceleration over force is 1/mass
        sizes = [frf.magnitude * (2.0 * np.pi * frf.frequency) ** (2 - units.order) for frf in responses.values()]
        start = Rigid(mass=1.0 / float(np.median(np.concatenate(sizes))), viscous=0.0)
        return fit_plant(start, motor, load, fixed=fixed, absent=("viscous",), **common)

    ways: dict[str, Callable[[], PlantFit]] = {"rigid": rigid}
    # a two-mass plant of the file has the structure "two-mass", which finds its own starts
    if plant is not None and plant.kind not in ("rigid", "two_mass"):
        start_plant = plant
        absent = tuple(name for name, _ in tree.leaves(start_plant) if name.rsplit(".", 1)[-1].startswith("viscous"))
        ways["machine"] = lambda: fit_plant(start_plant, motor, load, fixed=fixed, absent=absent, **common)
    ways["two-mass"] = lambda: fit_two_mass(motor, load, fixed=fixed, **common)
    ways["modal"] = lambda: fit_modal_axis(motor, load, modes, **common)
    if not fixed:
        return ways
    fitting = {
        "rigid": {"mass", "viscous"},
        "machine": set() if plant is None else {name for name, _ in tree.leaves(plant)},
        "two-mass": {"mass_motor", "mass_load", "stiffness", "damping", "viscous_motor", "viscous_load"},
    }
    kept = {name: way for name, way in ways.items() if set(fixed) <= fitting.get(name, set())}
    if not kept:
        every = sorted({name for name in ways if name in fitting for name in fitting[name]})
        raise ParameterError(f"no structure has all of {', '.join(fixed)}; there are {', '.join(every)}")
    return kept
