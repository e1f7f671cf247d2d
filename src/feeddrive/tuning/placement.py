"""Pole placement applied to an axis: gains, desired and achieved poles, and the fastest poles that are permitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.stability import Stability, stability
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.plant.two_bodies import Gains
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop

_SMALLEST = 0.02  # of a tunable: lower end of the search for a stable value
_HALVINGS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Result):
    """The gains of a pole placement in SI, its five poles in rad/s, and the poles reached in the sampled loop.

    poles    as placed, of the model in continuous time, slowest first
    reached  of the loop with its axis, delay, filters and sampling, as s = ln z / T, slowest first
    """

    gains: Gains
    poles: np.ndarray
    reached: np.ndarray
    stability: Stability

    def table(self) -> Table:
        """The gains, the placed poles, and the same number of the slowest poles reached."""
        units = ("N/m", "N/m", "N s/m", "N s/m", "N/(m s)")
        rows = [
            [name, Quantity(value, unit, form="6 SI")]
            for name, value, unit in zip(Gains._fields, self.gains, units, strict=True)
        ]
        rows += [["pole placed", _words(pole)] for pole in self.poles]
        rows += [["pole of the loop", _words(pole)] for pole in self.reached[: self.poles.size]]
        return Table(self.stability.sentence(), ["pole placement", "value"], rows)


def _words(pole: complex) -> str:
    size = abs(pole)
    return Text(
        f"{number(pole.real)}{Quantity(pole.imag):+.4g}j 1/s ({Quantity(size / (2.0 * np.pi), 'Hz')}, damping "
        f"{Quantity(-pole.real / size):.3f})"
    )


def placement(loop: Loop, *, velocity: float = 0.05) -> Placement:
    """Gains and poles of a loop under pole placement.

    Raises ParameterError for another law, and UnstableError, with |z|, its bound and the nearest stable value of each
    tunable, if the poles cannot be reached on this axis because of delay, filters and modes that the model leaves out.
    Poles that no gain could place are refused by the law itself: see `blocks/plant/two_bodies.py`.
    """
    law = loop.control.law
    if not isinstance(law, PolePlacement):
        raise ParameterError(f"control.law is '{law.kind}', which is not a pole placement: take pole_placement")
    sampled = stability(loop, velocity=velocity)
    if not sampled.stable:
        near = list(_stable_tunables(loop, velocity))
        remedy = joined("; or ", near) or "none by lowering a single tunable"
        raise UnstableError(
            f"control.law: the poles cannot be reached on this axis: {sampled.sentence()} (|z| = "
            f"{Quantity(sampled.growth):.6f}, must be < 1); the nearest stable values: {remedy}. If the axis has a "
            f"mode there that the model leaves out, put a notch at {Quantity(sampled.frequency, 'Hz')}"
        )
    poles = np.roots([float(a) for a in reversed(law.polynomial())])
    z = sampled.model.poles()
    reached = np.log(z[np.abs(z) > 1e-12].astype(complex)) / sampled.model.sample_time
    return Placement(law.gains(), poles[np.argsort(np.abs(poles))], reached[np.argsort(np.abs(reached))], sampled)


def _stable_tunables(loop: Loop, velocity: float) -> Iterator[str]:
    """For each tunable alone the largest value below the present one at which the loop is stable, in words."""
    for tunable in loop.control.law.tunables:
        present = float(tree.get(loop.control.law, tunable))

        def is_stable(share: float, tunable: str = tunable, present: float = present) -> bool:
            law = tree.vary(loop.control.law, {tunable: share * present})
            varied = replace(loop, control=replace(loop.control, law=law))
            return stability(varied, velocity=velocity).stable

        shares = np.geomspace(1.0, _SMALLEST, 31)
        stable = next((i for i, share in enumerate(shares) if i and is_stable(float(share))), None)
        if stable is None:
            continue
        low, high = float(shares[stable]), float(shares[stable - 1])
        for _ in range(_HALVINGS):
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if is_stable(middle) else (low, middle)
        unit = tree.declaration(loop.control.law, tunable).unit
        least, now = (Quantity(value, unit, form="SI") for value in (low * present, present))
        yield Text(f"{tunable} = {least} instead of {now}")
