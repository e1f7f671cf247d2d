"""Two masses and a spring, or a rigid mass with modes, from frequency responses of one or both encoders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.identification.response.agreement import beyond
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.identification.response.plant_fit import (
    DRIVE,
    PlantFit,
    SensorLines,
    Task,
    TracedPlant,
    finished,
    solve,
    with_derived,
)
from feeddrive.identification.response.units import ResponseUnits, taken
from feeddrive.language import tree
from feeddrive.language.errors import NotIdentifiableError, ParameterError, WrongSignError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF

_BEYOND = 4.0  # how far beyond the lines a resonance is looked for, as a factor
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0)  # of load to motor mass
_GRID = 15  # resonances
_BEST = 4  # of the grid that are followed


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
    """Any plant block, from its own values as the start, fitted to the responses of motor and load encoder.

        x/f = e^(-s·dead_time) / (1 + s/ω) · Sᵢ (M s² + C s + K)⁻¹ S_driveᵀ,   both responses together

    motor, load        position (or velocity, acceleration, by their unit) over the drive's force, one of them or both
    fixed              parameters that are known, by name; they keep that value
    absent             parameters, such as friction, that keep the value of `plant` if the lines do not determine them
    dead_time          s; None: it is found.  For a response with a sample time the hold is not part of it
    held               whether the input of a sampled response is a command, held over each sample; False for a current
                       or force that was measured
    current_loop       Hz; None: the force follows at once, unless `find_current_loop`
    band               Hz, lowest and highest line that counts
    force_per_unit     N for each unit of the responses' input (a motor's force constant); travel_per_unit m for each
                       unit of their output (lead/2π for rad).  Without them a result is in the responses' own units

    The cost is that of `refine`: weighted by the variances where they are known, else the complex logarithmic ratio.
    Raises ParameterError for units that differ, an unknown name and too few lines.
    When not: far from the start; `fit_two_mass` and `fit_modal_axis` find their own.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    known = dict(fixed or {})
    for name in known:
        tree.get(plant, name)
    actuator = Actuator(dead_time=dead_time or 0.0, current_loop=current_loop)
    names = [name for name, _ in tree.leaves(plant) if name not in known]
    names += ["dead_time"] if dead_time is None else []
    names += ["current_loop"] if find_current_loop else []
    start = tree.vary(plant, known)
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
) -> PlantFit:
    """Two masses and a spring from the responses of the motor's encoder, or of both together.

        (m1 s² + (b1 + c) s + k) x1 - (c s + k) x2 = e^(-s·dead_time) f,   (m2 s² + (b2 + c) s + k) x2 = (c s + k) x1

    Arguments as in `fit_plant`; no start is needed, it follows from a modal fit:  m2/m1 = residue/free at the motor,
    k = ω² m1 m2/(m1 + m2).  Viscous friction that the lines do not determine is fixed at zero and reported as not
    identifiable.  Derived: antiresonance √(k/m2), resonance √(k (m1 + m2)/(m1 m2)), inertia ratio m2/m1, total mass.

    Raises NotIdentifiableError if only the load's response is given and no mass is fixed: it determines the total mass
    and the resonance, but not the split of the masses.
    When not: for an axis with further modes in the band; cut the band, or take `fit_modal_axis`.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    known = dict(fixed or {})
    if "motor" not in responses and not {"mass_motor", "mass_load", "stiffness"} & set(known):
        raise NotIdentifiableError(
            "mass_motor and mass_load are not identifiable from the load's response alone: it determines their sum "
            "and the resonance; measure next the motor's encoder too, or fix one of them"
        )
    every = ("mass_motor", "mass_load", "stiffness", "damping", "viscous_motor", "viscous_load")
    names = [name for name in every if name not in known]
    names += ["dead_time"] if dead_time is None else []
    names += ["current_loop"] if find_current_loop else []
    best: tuple[float, Task] | None = None
    actuator = Actuator(dead_time=dead_time or 0.0, current_loop=current_loop)
    for start in starts(responses, units, dead_time):
        task = Task(tree.vary(start, known), actuator, {}, responses, units, held)
        task, found = solve(task, names, logarithmic=True, steps=25)
        far = float(np.mean(np.minimum(np.abs(np.concatenate(found.residuals)), 1.0)))
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


def _check_driven(modal: ModalFit, frequency: float, residue: float) -> None:
    """Raise ParameterError for a mode that the motor's encoder shows against the force."""
    known = {each.name: each for each in modal.estimates}
    number = int(np.argmin(np.abs(modal.values[: modal.model.modes] - frequency))) + 1
    error = known[f"residue_{number}_motor"].error if f"residue_{number}_motor" in known else np.inf
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
    """A rigid mass with any number of modes in parallel, from the responses of one encoder or of both together.

        x/f = e^(-s·dead_time) [ 1/(M s² + b s) + Σ shapeᵢ / (mᵢ (s² + 2ζᵢωᵢs + ωᵢ²)) ],   shape 1 at the motor

    Arguments as in `fit_plant`; modes None: as many as unused lines support. Modal masses are positive, as those of a
    driven point are: a mode with the wrong sign at the motor ends with a very large mass and is reported as not
    identifiable.  With the load's response alone the shape of a mode at the load is ±1 and its mass is fitted.
    When not: where residues are far from real, see `fit_modes` with proportional=False.
    """
    responses, units = taken({"motor": motor, "load": load}, band, force_per_unit, travel_per_unit)
    plain = {name: replace(frf, variance=None) for name, frf in responses.items()}
    modal = fit_modes(plain, modes, proportional=True, dead_time=dead_time)
    check_signs(modal)
    model, values = modal.model, modal.values
    free = float(np.mean([abs(values[model.common + i * model.own]) for i in range(len(modal.outputs))]))
    parts: list[Mode] = []
    fixed: list[str] = []
    for i, mode in enumerate((*modal.modes, *modal.beyond)):
        at = dict(zip(modal.outputs, (r.real for r in mode.residues), strict=True))
        _check_driven(modal, mode.frequency.value, at.get("motor", 0.0))
        drive = abs(at.get("motor", at.get("load", 0.0))) or 1e-6 * free
        shape = at.get("load", drive) / drive
        fixed += [f"modes.{i}.motor"]
        if "load" not in at or "motor" not in at:
            shape = float(np.sign(shape)) or 1.0
            fixed += [f"modes.{i}.load"]
        ratio = min(mode.damping_ratio.value, 1.0)
        parts.append(Mode(frequency=mode.frequency.value, damping_ratio=ratio, mass=1.0 / drive, motor=1.0, load=shape))
    corner = float(values[2 * model.modes])
    plant = Modal(mass=1.0 / free, viscous=corner / free, modes=tuple(parts))
    actuator = Actuator(dead_time=max(modal["dead_time"].value, 0.0) if dead_time is None else dead_time,
                        current_loop=current_loop)  # fmt: skip
    names = [name for name, _ in tree.leaves(plant) if name not in fixed]
    names += [each for each, wanted in zip(DRIVE, (dead_time is None, find_current_loop), strict=True) if wanted]
    return finished(Task(plant, actuator, {}, responses, units, held), names, ("viscous",))


def starts(responses: Mapping[str, FRF], units: ResponseUnits, dead_time: float | None) -> list[TwoMass]:
    """From modal fits, with one mode and with the most pronounced of several, and from the grid.

    The grid is for resonances at the edge of the lines or beyond, whose peak a modal fit does not see.
    """
    found: list[TwoMass] = []
    plain = {name: replace(frf, variance=None) for name, frf in responses.items()}
    for count in (1, 2):
        try:
            modal = fit_modes(plain, count, proportional=True, rest=count > 1, dead_time=dead_time)
        except ParameterError:
            continue
        if count == 1:
            check_signs(modal)
        found += [start for i in range(len(modal.modes)) if (start := _from_mode(modal, i)) is not None]
    return [*found, *_of_grid(responses, units)]


def _of_grid(responses: Mapping[str, FRF], units: ResponseUnits) -> list[TwoMass]:
    """The best points of a grid of resonances and mass ratios, by magnitude, each with its best total mass."""
    frfs = list(responses.values())
    lines = [SensorLines(frf.frequency, sensor, units.order) for sensor, frf in responses.items()]
    model = TracedPlant(_scaled(1.0, 1.0, 1.0, 0.03, 0.0), (), lines, {})
    low, high = min(f.frequency[0] for f in frfs), max(f.frequency[-1] for f in frfs)
    measured = np.concatenate([np.log(np.maximum(frf.magnitude, 1e-300)) for frf in frfs])
    scored: list[tuple[float, TwoMass]] = []
    for f, ratio in product(np.geomspace(low / _BEYOND, _BEYOND * high, _GRID), _RATIOS):
        plant = _scaled(1.0, ratio, 2.0 * np.pi * f, 0.03, 0.0)
        found = model.responses(dict(tree.leaves(plant)))
        apart = np.concatenate([np.log(np.abs(response)) for response in found]) - measured
        total = float(np.median(apart))
        score = float(np.mean(np.minimum(np.abs(apart - total), 1.0)))
        scored.append((score, _scaled(float(np.exp(total)), ratio, 2.0 * np.pi * f, 0.03, 0.0)))
    return [plant for _, plant in sorted(scored, key=lambda each: each[0])[:_BEST]]


def _scaled(total: float, ratio: float, omega: float, damping_ratio: float, viscous: float) -> TwoMass:
    """Two masses by their sum, their ratio and their resonance in rad/s."""
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
    free = [abs(float(values[model.common + i * model.own])) for i in range(len(modal.outputs))]
    if min(free) <= 0.0:
        return None
    total = 1.0 / float(np.mean(free))
    ratio = abs(mode.residues[modal.outputs.index("motor")]) * total if "motor" in modal.outputs else 1.0
    ratio = float(np.clip(ratio, 1e-3, 1e3))
    viscous = float(values[2 * model.modes]) * total
    return _scaled(total, ratio, 2.0 * np.pi * mode.frequency.value, mode.damping_ratio.value, viscous)


def check_signs(modal: ModalFit) -> None:
    """Raise WrongSignError for an encoder that counts against the force: its free motion has the wrong sign."""
    for name in modal.outputs:
        free = modal[f"free_{name}"] if name else modal["free"]
        if free.value < -5.0 * free.error:
            raise WrongSignError(
                f"the response to '{name}' has the wrong sign: a positive force moves it to smaller positions (its "
                f"free motion is {Quantity(free.value, free.unit):3}); check the direction of the encoder and invert "
                "the response (-frf)"
            )
