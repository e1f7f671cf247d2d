"""The linear control as deployed: every stored number rounded to the arithmetic of the controller."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.lifting import MOST, Lifted, lifted
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

READINGS = ("reading_motor", "reading_load")
_COARSE = 0.01  # of a number: a loss by rounding that is worth a word
_STATES = 60  # of a control, as the checker admits
_KEPT = 2.0**-300, 2.0**300  # sizes that a certificate holds


@dataclass(frozen=True, eq=False)
class Deployed:
    """Force over readings, with the numbers that the controller stores.

    model    from `readings` to the force, in the states of the control; of a law with two rates for each sample
    numbers  parameters and prepared numbers by name, after rounding
    coarse   those that rounding moves by more than 1 %, with that share
    """

    model: StateSpace | Lifted
    arithmetic: str
    numbers: Mapping[str, float]
    coarse: Mapping[str, float]


def rounded(value: float, arithmetic: str) -> float:
    """The nearest number of an arithmetic: float64, float32, or fixedN with N binary places.

    Raises ParameterError for another name, and for a number beyond float32.
    """
    if arithmetic == "float64":
        return float(value)
    if arithmetic == "float32":
        with np.errstate(over="ignore"):
            near = float(np.float32(value))
        if np.isinf(near) and np.isfinite(value):
            raise ParameterError(f"{Quantity(value):6} is beyond float32, which ends at 3.4e38")
        return near
    if re.fullmatch(r"fixed[1-9]\d?", arithmetic):
        places = int(arithmetic[5:])
        return float(np.ldexp(np.rint(np.ldexp(float(value), places)), -places))
    raise ParameterError(
        f"arithmetic = '{arithmetic}' must be float64, float32, or fixedN with N binary places, as fixed24"
    )


def deployed(control: Control, sample_time: float, arithmetic: str = "float64", velocity: float = 0.05) -> Deployed:
    """A control as linear system whose prepared and other numbers are rounded before it is linearized.

    The traced step is linearized, so that the matrices are those of the code that runs: a rounded filter coefficient
    moves the pole that the controller has.  Guard and force limit are left out.
    Raises ParameterError for a law with more than 64 samples in a period, and for a control of more than 60 states.
    """
    law = control.law
    if law.period() > MOST:
        raise ParameterError(
            f"the law '{law.kind}' repeats itself every {law.period()} samples, and a certificate takes at most "
            f"{MOST}: set position_every <= {MOST}, or take a longer sample time"
        )
    swings = 0.1 / sample_time  # rad/s of an axis that only provides readings
    axis = Axis(plant=TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=0.5 * swings * swings))
    bare = replace(control, guard=None, force_limit=None)
    memory = bare.start(bare.prepare(sample_time), Setpoint(0.0), 0.0, 0.0).memory
    _check_size(sum(each.length for _, each in tree.leaves(memory) if isinstance(each, Ring)))
    numbers: dict[str, float] = {}
    coarse: dict[str, float] = {}

    def stored(name: str, value: float) -> float:
        near = rounded(value, arithmetic)
        numbers[name] = near
        if value != 0.0 and abs(near / value - 1.0) > _COARSE:
            coarse[name] = abs(near / value - 1.0)
        return near

    loop = Loop(control=bare, axis=axis, sample_time=sample_time)
    try:
        names = ["cut", *READINGS], ["force"]
        if law.period() > 1:
            samples = lifted(loop, *names, velocity=velocity, stored=stored).samples
        else:
            samples = (linearize(loop, *names, velocity=velocity, stored=stored),)
    except ParameterError:
        gone = [name for name, share in coarse.items() if share == 1.0]
        if not gone:
            raise
        raise ParameterError(f"{arithmetic} has too few digits for this control: {gone[0]} becomes zero") from None
    own = [i for i, name in enumerate(samples[0].states) if name.startswith("control.")]
    used = [i for i in (1, 2) if any(np.any(each.B[own, i]) or np.any(each.D[:, i]) for each in samples)]
    if not used:
        raise ParameterError(f"the law '{law.kind}' does not use any reading: there is no loop to certify")
    _check_size(len(own))
    states = tuple(samples[0].states[i].removeprefix("control.") for i in own)
    models = tuple(
        StateSpace(
            each.A[np.ix_(own, own)], each.B[np.ix_(own, used)], each.C[:, own], each.D[:, used], float(sample_time),
            states, tuple(READINGS[i - 1] for i in used), ("force",),
        )
        for each in samples
    )  # fmt: skip
    sizes = np.abs(np.concatenate([x.ravel() for each in models for x in (each.A, each.B, each.C, each.D)]))
    wrong = sizes[(sizes != 0.0) & ((sizes < _KEPT[0]) | (sizes > _KEPT[1]))]
    if wrong.size:
        raise ParameterError(
            f"the control holds the coefficient {Quantity(wrong[0]):6}, too large or too small to certify"
        )
    model = models[0] if len(models) == 1 else Lifted(models)
    return Deployed(model, arithmetic, {k: v for k, v in numbers.items() if _fits(v)}, coarse)


def _check_size(states: int) -> None:
    if states > _STATES:
        raise ParameterError(
            f"the control remembers {states} numbers, and a certificate is about {_STATES} at most: certify it without "
            f"the block that keeps so many samples, such as repetitive control"
        )


def _fits(value: float) -> bool:
    return value == 0.0 or _KEPT[0] < abs(value) < _KEPT[1]
