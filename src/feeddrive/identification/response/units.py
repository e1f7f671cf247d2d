"""Input and output quantities of a frequency response, its order of differentiation, and the resulting units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF

_SI = {("m", "N"): {}, ("rad", "N m"): {"kg": "kg m2", "N/m": "N m/rad", "N s/m": "N m s/rad", "m/N": "rad/(N m)"}}
FEWEST = 8  # lines


@dataclass(frozen=True)
class ResponseUnits:
    """The units of position (`output`) over force (`input`), differentiated `order` times: m/N, (m/s)/N, rad/A ..."""

    output: str
    input: str
    order: int

    @property
    def si(self) -> bool:
        """True if identified masses are in kg and stiffnesses in N/m."""
        return (self.output, self.input) == ("m", "N")

    def of(self, unit: str) -> str:
        """Return the unit that corresponds to an SI unit of a linear axis, such as kg, N/m, N s/m, m/N."""
        known = _SI.get((self.output, self.input))
        if known is not None:
            return known.get(unit, unit)
        force, travel = self.input, self.output
        own = {"kg": f"{force} s2/{travel}", "N/m": f"{force}/{travel}", "N s/m": f"{force} s/{travel}"}
        return {**own, "m/N": f"{travel}/{force}"}.get(unit, unit)


def response_units(frf: FRF) -> ResponseUnits:
    """Return the quantities of an FRF from its unit, in any spelling; without a unit it counts as m/N."""
    output, _, force = (_known(frf.unit) or (frf.unit or "m/N", 1.0))[0].rpartition("/")
    match = re.fullmatch(r"\(?([^()/]+?)(?:/(s2?|s\^2))?\)?", output.strip())
    if match is None or not force:
        raise ParameterError(
            f"the unit '{frf.unit}' of the response to {frf.output} is not one of position, velocity or acceleration "
            f"over force or current; give it as m/N, (m/s)/N, rad/A ..."
        )
    order = {None: 0, "s": 1}.get(match[2], 2)
    return ResponseUnits(match[1].strip(), force.strip(" ()"), order)


def _known(unit: str) -> tuple[str, float] | None:
    """Return the SI unit and the conversion factor; None for a unit of another quantity or an unknown unit."""
    try:
        return units.response(unit) if unit else None
    except ParameterError:
        return None


def _in_si(frf: FRF) -> FRF:
    """Return a response in SI with the canonical spelling of its unit; unchanged if the unit is unknown."""
    known = _known(frf.unit)
    if known is None:
        return frf
    unit, factor = known
    return replace(frf if factor == 1.0 else replace(frf * factor, coherence=frf.coherence), unit=unit)


def taken(
    responses: Mapping[str, FRF | None],
    band: tuple[float, float] | None,
    force_per_unit: float | None,
    travel_per_unit: float | None,
) -> tuple[dict[str, FRF], ResponseUnits]:
    """Return the available responses, cut to a band in Hz and in SI, with their input and output quantities.

    force_per_unit    N per unit of the input, such as the force constant of a motor in N/A
    travel_per_unit   m per unit of the output, such as lead/2π for an angle in rad
    Raises ParameterError if there is no response, if one is 0, if their units differ or if too few lines are left.
    """
    there = {name: _in_si(as_frf(frf)) for name, frf in responses.items() if frf is not None}
    if not there:
        raise ParameterError("a fit needs at least one frequency response, of the motor's or of the load's position")
    for name, frf in there.items():
        silent = np.flatnonzero(frf.response == 0.0)
        if silent.size:
            raise ParameterError(
                f"the response of the {name} is 0 at {Quantity(frf.frequency[silent[0]], 'Hz'):6} ({silent.size} such "
                "lines), which no axis does: check its columns, and leave out lines on which nothing was measured"
            )
    of_each = {name: response_units(frf) for name, frf in there.items()}
    first = next(iter(of_each.values()))
    for name, response in of_each.items():
        if response != first:
            raise ParameterError(
                f"the responses must lead from and to the same quantities: '{name}' is in {there[name].unit}, "
                f"another in {next(iter(there.values())).unit}"
            )
    scale = (1.0 if travel_per_unit is None else travel_per_unit) / (1.0 if force_per_unit is None else force_per_unit)
    if not (np.isfinite(scale) and scale > 0.0):
        raise ParameterError("force_per_unit and travel_per_unit must be finite and > 0")
    first = replace(
        first,
        output=first.output if travel_per_unit is None else "m",
        input=first.input if force_per_unit is None else "N",
    )
    unit = first.output if not first.order else f"({first.output}/{('s', 's2')[first.order - 1]})"
    unit = f"{unit}/{first.input if ' ' not in first.input else f'({first.input})'}"
    kept: dict[str, FRF] = {}
    for name, frf in there.items():
        low, high = band or (0.0, np.inf)
        inside = (frf.frequency >= low) & (frf.frequency <= high)
        if np.count_nonzero(inside) < FEWEST:
            raise ParameterError(
                f"the response to '{name}' has {np.count_nonzero(inside)} lines from "
                f"{Quantity(low, 'Hz', form='6', bare=True)} to {Quantity(high, 'Hz'):6} and needs {FEWEST} at least"
            )
        parts = {
            key: None if (values := getattr(frf, key)) is None else values[inside] for key in ("coherence", "variance")
        }
        cut = replace(frf, frequency=frf.frequency[inside], response=frf.response[inside], unit=unit, **parts)
        kept[name] = cut * scale if scale != 1.0 else cut
        if scale != 1.0:
            kept[name] = replace(kept[name], coherence=cut.coherence)
    return kept, first
