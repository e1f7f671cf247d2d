"""A loop with the feedforward that is linear in its parameters: to find it, to put it in, to begin with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.language.block import declarations
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.loop import Loop

COLUMNS = tuple(name for name in declarations(DisturbanceCompensator) if name not in ("stribeck_velocity", "dead_band"))


def compensator(loop: Loop) -> DisturbanceCompensator:
    """The disturbance compensator of a loop. Raises StructureError if there is none, or more than one."""
    found = [block for block in loop.control.feedforward if isinstance(block, DisturbanceCompensator)]
    if len(found) != 1:
        what = "none" if not found else f"{len(found)} of them"
        raise StructureError(
            f"control.feedforward: iterative feedforward tunes the one disturbance_compensator of a control, and there "
            f"is {what}: add one with the parameters to tune, 0 for a start (`begin_compensation`)"
        )
    return found[0]


def compensated(loop: Loop, block: DisturbanceCompensator) -> Loop:
    """The loop with this compensator in the place of its own, or behind its other feedforward."""
    others = tuple(block if isinstance(each, DisturbanceCompensator) else each for each in loop.control.feedforward)
    if not any(each is block for each in others):
        others = (*others, block)
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, feedforward=others))


def begin_compensation(
    loop: Loop, columns: Sequence[str] | None = None, *, stribeck_velocity: float | None = None
) -> Loop:
    """The loop with a compensator to begin with: parameters at 0, or what the loop feeds forward now.

    columns            names of its parameters; default: mass, viscous and both Coulomb levels, as far as the law does
                       not feed them forward itself
    stribeck_velocity  m/s, needed with the column `stribeck`

    An Inertia is taken over; a compensator that is there keeps its values and gets the columns that it lacks.
    Raises ParameterError for a column that is not known, and StructureError for what would be fed twice.
    """
    known = ", ".join(COLUMNS)
    for name in columns or ():
        if name not in COLUMNS:
            raise ParameterError(f"columns: there is no '{name}'; there are {known}")
    chosen = _usual(loop) if columns is None else tuple(columns)
    given: dict[str, float] = dict.fromkeys(chosen, 0.0)
    kept = []
    for block in loop.control.feedforward:
        if isinstance(block, Inertia):
            given |= {"mass": block.mass, "viscous": block.viscous}
        elif isinstance(block, DisturbanceCompensator):
            given |= block.parameters()
            stribeck_velocity = stribeck_velocity or block.stribeck_velocity
        else:
            kept.append(block)
    if "stribeck" in given and stribeck_velocity is None:
        raise ParameterError(
            "columns: 'stribeck' needs the velocity at which the extra level has fallen to 1/e (stribeck_velocity in "
            "m/s > 0 m/s): some mm/s on most guideways"
        )
    block = DisturbanceCompensator(**given, stribeck_velocity=stribeck_velocity if "stribeck" in given else None)
    control = dataclasses.replace(loop.control, feedforward=(*kept, block))
    return dataclasses.replace(loop, control=control)


def _usual(loop: Loop) -> tuple[str, ...]:
    own = {"acceleration": ("mass",), "velocity": ("viscous",), "friction": ("coulomb_positive", "coulomb_negative")}
    return tuple(name for what, names in own.items() if what not in loop.control.law.feeds for name in names)
