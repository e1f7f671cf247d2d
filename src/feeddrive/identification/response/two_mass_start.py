"""Where the fit of two masses begins: at the modes that stand out, and at the best of a coarse grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.identification.response.traced_plant import SensorLines, TracedPlant
from feeddrive.identification.response.units import ResponseUnits
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF

_BEYOND = 4.0  # how far beyond the lines a resonance is looked for, as a factor
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0)  # of load to motor mass
_GRID = 15  # resonances
_BEST = 4  # of the grid that are followed


def starts(responses: Mapping[str, FRF], units: ResponseUnits, dead_time: float | None) -> list[TwoMass]:
    """From modal fits, with one mode and with the most pronounced of several, and from the grid.

    The grid is for resonances at the edge of the lines or beyond, of which a modal fit sees no top.
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
    """The few of a grid of resonances and mass ratios whose magnitudes, each with its best total mass, fit best."""
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
    """Raise ParameterError for an encoder that counts against the force: its free motion has the wrong sign."""
    for name in modal.outputs:
        free = modal[f"free_{name}"] if name else modal["free"]
        if free.value < -5.0 * free.error:
            raise ParameterError(
                f"the response to '{name}' has the wrong sign: a positive force moves it to smaller positions "
                f"(its free motion is {free.value:.3g} {free.unit}); turn it, -frf, after a look at the "
                f"encoder's direction"
            )
