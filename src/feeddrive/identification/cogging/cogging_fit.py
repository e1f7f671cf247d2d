"""Cogging as harmonics of the position; what changes its sign with the direction of motion stands apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.identification.estimate import Estimate
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.table import Result, Table


@dataclass(frozen=True)
class CoggingOrder:
    """One order: amplitudes in the unit of the force, with standard errors; phases in rad of a sine.

    even      what does not change with the direction: cogging; None with runs in one direction only
    odd       what changes its sign with the direction: friction that varies along the travel
    forward   as measured in motion towards larger positions, backward in the other; None where there is no such run
    p_value   the chance of such amplitudes without this order
    """

    order: int
    even: Estimate | None
    even_phase: float
    odd: Estimate | None
    forward: Estimate | None
    backward: Estimate | None
    phase: float
    p_value: float
    significant: bool

    @property
    def amplitude(self) -> float:
        """As measured: the largest of both directions."""
        return max(each.value for each in (self.forward, self.backward) if each is not None)


@dataclass(frozen=True, eq=False, repr=False)
class CoggingFit(Result):
    """Harmonics, the strongest first, with Coulomb friction and a constant force apart from them.

    coulomb   half the difference of the means of both directions; None with one direction
    offset    their mean; with one direction it holds the friction
    orders    all that were tried
    residual  of all runs, one after the other
    """

    orders: tuple[CoggingOrder, ...]
    coulomb: Estimate | None
    offset: Estimate
    residual: np.ndarray
    unit: str
    remarks: tuple[str, ...]

    @property
    def significant(self) -> tuple[CoggingOrder, ...]:
        """Those that chance does not explain."""
        return tuple(each for each in self.orders if each.significant)

    def order(self, order: int) -> CoggingOrder:
        """One of them. Raises ParameterError for an order that was not tried."""
        for each in self.orders:
            if each.order == order:
                return each
        raise ParameterError(f"order {order} was not tried; the largest is {max(each.order for each in self.orders)}")

    def table(self) -> Table:
        """The strongest significant orders."""
        rows = []
        for each in self.significant[:16]:
            cells = (_cell(each.forward), _cell(each.backward), _cell(each.even), _cell(each.odd))
            rows.append([str(each.order), *cells, f"{each.p_value:.1g}"])
        friction = "" if self.coulomb is None else f"; Coulomb friction {_cell(self.coulomb)} {self.unit}"
        title = f"{len(self.significant)} of {len(self.orders)} orders are significant{friction}"
        heads = ["order", f"forward {self.unit}", "backward", "cogging", "friction-like", "p"]
        return Table(title, heads, rows)

    def block(self, period: float, *, force_per_unit: float = 1.0, most: int = 12) -> Cogging:
        """The strongest significant orders of the cogging as a block.

        period          table motion in one turn, m
        force_per_unit  N at the table per unit of the measured force (per A, say)
        most            how many orders

        The measured force balances the cogging, so the block has its opposite.  With runs in one direction only, what
        varies with friction is in it.
        """
        strongest = sorted(self.significant, key=lambda each: -_balanced(each)[0])[:most]
        if not strongest:
            raise NotIdentifiableError("no order is significant: there is no cogging to be written")
        largest = _balanced(strongest[0])[0]
        harmonics = tuple(
            Harmonic(order=each.order, share=_balanced(each)[0] / largest, phase=_wrapped(_balanced(each)[1] + np.pi))
            for each in strongest
        )
        return Cogging(force=largest * force_per_unit, period=period, harmonics=harmonics)


def _balanced(each: CoggingOrder) -> tuple[float, float]:
    """Amplitude and phase of what is cogging, as well as it is known."""
    return (each.even.value, each.even_phase) if each.even is not None else (each.amplitude, each.phase)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _cell(estimate: Estimate | None) -> str:
    return "-" if estimate is None else f"{estimate.value:.3g} ± {estimate.error:.1g}"
