"""The box that encloses what a measurement leaves open of an axis, for laws that are judged over it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import chi2

from feeddrive.identification.regression import Estimate
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop

CONFIDENCE = 0.95  # of the ellipsoid that the box encloses
DRAWS = 64  # plants within the box, besides its corners


@dataclass(frozen=True)
class Uncertain:
    """The box that encloses the 95 % ellipsoid of the covariance of the identified parameters.

        value ± k error,   k² = χ²(0.95) with as many degrees of freedom as there are parameters

    with one more sample of dead time or none.  Masses, friction, damping and dead time end at 0.
    """

    model: Loop
    estimates: tuple[Estimate, ...]

    @property
    def factor(self) -> float:
        """The k of the equation above."""
        return math.sqrt(float(chi2.ppf(CONFIDENCE, len(self.estimates))))

    @property
    def mass_share(self) -> float:
        """The relative half width of the box in the mass."""
        mass = next(estimate for estimate in self.estimates if estimate.name.endswith("mass"))
        return self.factor * mass.error / mass.value

    def places(self) -> Iterator[tuple[tuple[float, ...], int]]:
        """Yield the center, all corners and draws: places from -1 to 1 in each parameter, and samples of dead time."""
        n = len(self.estimates)
        random = np.random.default_rng(0)
        for late in (0, 1):
            yield (0.0,) * n, late
            for corner in product((-1.0, 1.0), repeat=n):
                yield corner, late
        for _ in range(DRAWS):
            yield tuple(random.uniform(-1.0, 1.0, n).tolist()), int(random.integers(0, 2))

    def loop(self, law: Loop, place: Sequence[float], late: int) -> Loop:
        """Return the loop of a law with a plant of the box; the law keeps the numbers of its design."""
        changes = {
            # masses, friction, damping and dead time are not negative, however large their errors are
            estimate.name: max(estimate.value + u * self.factor * estimate.error, 0.0)
            for estimate, u in zip(self.estimates, place, strict=True)
        }
        axis = tree.vary(self.model, changes).axis
        return replace(law, axis=axis).later(late)

    def table(self, published: Loop | None, what: str) -> Table:
        """Return the parameters with their errors, the ends of the box, and the published values, if there are any.

        what  the beginning of the title: which measurement the parameters are from
        """
        rows: list[list[str | Quantity]] = []
        for estimate in self.estimates:
            numbers = [estimate.value, estimate.error, *self._ends(estimate)]
            if published is not None:
                numbers.append(float(tree.get(published, estimate.name)))
            rows.append([estimate.name.rsplit(".", 1)[-1], *(Quantity(number, estimate.unit) for number in numbers)])
        heads = ("value", "error", "from", "to", *(() if published is None else ("published",)))
        title = Text(f"{what}, and the box of its covariance, ± {Quantity(self.factor):3} errors")
        return Table(title, ["parameter", *(Column(head, form="4") for head in heads)], rows)

    def _ends(self, estimate: Estimate) -> tuple[float, float]:
        """Return the ends of the box in one parameter, of which none can be negative."""
        half = self.factor * estimate.error
        return max(estimate.value - half, 0.0), estimate.value + half
