"""From the moves of a part program to motions that are proven."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from feeddrive.path.geometry.joints import joined
from feeddrive.path.geometry.segments import Chain, Pause, chains
from feeddrive.path.motion import Part
from feeddrive.path.program.moves import Move
from feeddrive.path.schedule.run import plan_run


def planned(moves: Iterable[Move], axes: str, limits: np.ndarray) -> Iterator[Part | Pause]:
    """The runs of a program, one by one, each from rest to rest, and the pauses between them.

    axes    letters of the machine's axes, in the order of `limits`
    limits  of velocity .. snap of each axis, m/s .. m/s⁴, shape (N, 4)

    Raises ProgramError as `chains` does.  What is yielded is planned, not proven: give it to a `Prover`.
    """
    for each in chains(moves, axes):
        if isinstance(each, Chain):
            for pieces in joined(*each)[0]:
                yield Part(pieces, plan_run(pieces, limits), True)
        else:
            yield each
