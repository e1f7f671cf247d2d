"""What a motion is planned for: roughing, finishing or precision, as with CYCLE832 of SINUMERIK.

A purpose sets the tolerance of corners where the program states none, and the shares of acceleration, jerk and snap
that are used.  Motions are lifted for each of them: at the same cycle time, lower limits with lifting excite the
machine less than higher ones without.

What the program states itself stands (G64 P, CYCLE832): it was computed for this part, and may differ from one section
of it to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

from feeddrive.language.errors import ParameterError, shown
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.limits import MachineLimits
from feeddrive.path.program.moves import Begin, Move, PathMode

PurposeName = Literal["roughing", "finishing", "precision"]


class Dynamics(NamedTuple):
    """The shares of the limits of acceleration, jerk and snap that are used, 0 .. 1."""

    acceleration: float = 1.0
    jerk: float = 1.0
    snap: float = 1.0

    def of(self, limits: MachineLimits) -> MachineLimits:
        """Return these shares of the limits of all axes; velocities stay."""
        return limits if self == Dynamics() else limits.less((0.0, *(1.0 - share for share in self)))


class Purpose(NamedTuple):
    """What a purpose sets: tolerance of corners, m, and dynamics."""

    tolerance: float
    dynamics: Dynamics


# Half of the jerk halves the force with which a ramp excites the machine; a program of short lines takes 1.24 times as
# long.  Tolerances are those for which CYCLE832 is mostly called.
PURPOSES: dict[str, Purpose] = {
    "roughing": Purpose(1e-4, Dynamics()),
    "finishing": Purpose(1e-5, Dynamics(1.0, 0.5, 0.5)),
    "precision": Purpose(5e-6, Dynamics(0.7, 0.25, 0.25)),
}
"""What each purpose sets, by name."""


class Settings(NamedTuple):
    """What a plan was made with.

    purpose    name of the purpose; empty without one
    tolerance  tolerance of corners where the program states none, m; None: the motion stops there
    dynamics   shares of the limits
    options    names of the options that replace what the purpose sets
    """

    purpose: str = ""
    tolerance: float | None = None
    dynamics: Dynamics = Dynamics()
    options: tuple[str, ...] = ()

    def sentence(self, stated: int = 0) -> Text:
        """Return what the purpose sets, as a sentence; `stated`: number of tolerances that the program states."""
        assert self.tolerance is not None
        shares = ", ".join(f"{name} {Quantity(share, 'share'):3}" for name, share in self.dynamics._asdict().items())
        kept = f"; the program states {stated} of its own, which stand{'s' if stated == 1 else ''}" if stated else ""
        by = f"; by {' and '.join(self.options)}, not by the purpose" if self.options else ""
        return Text(
            f"For {self.purpose}: tolerance {Quantity(self.tolerance, 'm'):3 mm} where the program states none{kept}; "
            f"of the limits {shares}{by}."
        )


DEFAULT = Settings()
"""The settings of a plan without a purpose and without options."""


def settings(purpose: str | None, tolerance: float | None = None, dynamics: Dynamics | None = None) -> Settings:
    """Return what a plan is made with: the tolerance (m) and the dynamics that are given, otherwise the purpose's.

    Raises ParameterError for an unknown purpose.
    """
    if purpose is None:
        return Settings("", tolerance, dynamics or Dynamics())
    if purpose not in PURPOSES:
        raise ParameterError(f"the purpose {shown(purpose)} is none of {', '.join(PURPOSES)}")
    chosen = PURPOSES[purpose]
    options = [name for name, value in (("--tolerance", tolerance), ("--dynamics", dynamics)) if value is not None]
    return Settings(
        purpose,
        chosen.tolerance if tolerance is None else tolerance,
        dynamics or chosen.dynamics,
        tuple(options),
    )


def read_dynamics(text: str, option: str = "--dynamics") -> Dynamics:
    """Parse shares of acceleration, jerk and snap in %, such as `100, 50, 50`; one number stands for all three.

    option  its name, for messages

    Raises ParameterError for another number of values, and for a value that is not above 0 and at most 100.
    """
    try:
        shares = [float(entry) / 100.0 for entry in text.split(",")]
    except ValueError:
        shares = []
    if len(shares) not in (1, 3) or not all(0.0 < share <= 1.0 and math.isfinite(share) for share in shares):
        raise ParameterError(
            f"{option}: {shown(text)}: the shares of acceleration, jerk and snap in % are expected, above 0 and at "
            "most 100, such as 100,50,50, or one for all three"
        )
    return Dynamics(*(shares * 3)[:3])


def with_tolerance(moves: Iterable[Move], tolerance: float) -> Iterator[Move]:
    """Yield the moves, adding the tolerance to every continuous path mode for which the program states none."""
    begun = False
    for move in moves:
        if isinstance(move, PathMode) and move.mode == "continuous" and move.tolerance == 0.0:
            yield replace(move, tolerance=tolerance)
        else:
            # the tolerance must hold from the first motion on, also in a program that never states a path mode
            if not begun and not isinstance(move, PathMode | Begin):
                yield PathMode(move.source, "continuous", tolerance)
            yield move
        begun = begun or not isinstance(move, Begin)
