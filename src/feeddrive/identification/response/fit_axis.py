"""Selection of the model structure of an axis: rigid, two masses, modes, or that of a machine file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification.response.plant_fit import PlantFit, fit_modal_axis, fit_plant, fit_two_mass
from feeddrive.identification.response.units import taken
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError, WrongSignError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF

_AS_GOOD = 1.1  # times the least error on unused lines that counts as equally good
_NOISE = 0.3  # autocorrelation from line to line below which the residual counts as noise
_DECIBEL = 20.0 / np.log(10.0)  # dB of a natural logarithm


@dataclass(frozen=True, eq=False, repr=False)
class AxisFits(Result):
    """Fits of several structures to the same lines, and the selected one.

    fits     by structure; `chosen` is the name of the selected one
    refused  structures that could not be fitted or were not needed, with the reason
    wrong_sign  True if a mode or the rigid-body motion has a sign at an encoder that no structure allows
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
        """Return a table with one row per structure: parameters, RMS error on unused lines in dB, autocorrelation."""
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
    """Fit possible structures of an axis, from simple to complex, and select the one that predicts best.

    plant      plant of a machine file: its structure is tried too, from its values, if it is not rigid
    actuator   actuator of that file: if it has a current loop, its bandwidth is identified too
    modes      number of modes in parallel; None: as many as unused lines support
    fixed      known parameters; structures that lack one of them are not tried
    structure  "rigid", "machine", "two-mass" or "modal": only this structure is fitted
    progress   reports the name of each structure when it begins

    Other arguments as in `fit_plant`.  Each structure predicts lines that were left out of its fit; of those within
    10 % of the smallest error the one with the fewest parameters is selected.  Modes in parallel are tried only where
    the residuals of the others are still correlated from line to line.
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
    best = min(fit.agreement.unused for fit in fits.values())
    good = [name for name, fit in fits.items() if fit.agreement.unused <= _AS_GOOD * best + 1e-9]
    return AxisFits(fits, min(good, key=lambda name: len(fits[name].estimates)), refused, wrong_sign)


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
        sizes = [frf.magnitude * (2.0 * np.pi * frf.frequency) ** (2 - units.order) for frf in responses.values()]
        start = Rigid(mass=1.0 / float(np.median(np.concatenate(sizes))), viscous=0.0)
        return fit_plant(start, motor, load, fixed=fixed, absent=("viscous",), **common)

    ways: dict[str, Callable[[], PlantFit]] = {"rigid": rigid}
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
