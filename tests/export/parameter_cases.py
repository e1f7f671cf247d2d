"""Random parameters inside and outside of their rules, and what Python says of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.routine import Routine

BROKEN = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 1e-300)


def cases(routine: Routine, count: int, seed: int) -> Iterator[dict[str, float]]:
    """`count` sets of other parameters by dotted name: some near the old ones, some far, some no number at all."""
    random = np.random.default_rng(seed)
    yield {}
    for _ in range(count - 1):
        size = int(min(len(routine.parameters), random.integers(1, 4)))
        changed: dict[str, float] = {}
        for i in random.choice(len(routine.parameters), size=size, replace=False):
            variable = routine.parameters[int(i)]
            bounds = [getattr(variable.declared, side) for side in ("above", "least", "below", "most")]
            kind = random.random()
            if kind < 0.1:
                value = float(random.choice(np.array(BROKEN)))
            elif kind < 0.2 and any(bound is not None for bound in bounds):
                value = float(next(bound for bound in bounds if bound is not None))  # the bound itself
            elif kind < 0.6:
                value = variable.value * float(random.uniform(0.5, 1.5))
            else:
                value = (variable.value or 1.0) * float(10.0 ** random.uniform(-2.5, 2.5))
            changed[variable.path] = value
        yield changed


def refused(routine: Routine, changed: Mapping[str, float]) -> bool:
    """Whether Python refuses these parameters in the loop that is exported."""
    loop: fd.Loop = routine.origin
    try:
        after = tree.vary(loop, changed)
    except FeeddriveError:
        return True
    # an axis is exported with a number of samples of dead time; with another one it would be another program
    return routine.memory == "plant" and after.timing() != loop.timing()
