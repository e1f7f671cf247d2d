"""From the moves of a part program to motions that are proven."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from feeddrive.path.geometry.joints import SMOOTH, Joiner, Joint
from feeddrive.path.geometry.segments import Chain, chains
from feeddrive.path.motion import Part, Pause
from feeddrive.path.override import Override
from feeddrive.path.pieces import Section
from feeddrive.path.program.moves import Move
from feeddrive.path.schedule.crossing import Crossings
from feeddrive.path.schedule.lift import Lifter
from feeddrive.path.schedule.run import Schedule

SHORT = 100  # segments of a chain that is planned in two ways


def planned(
    moves: Iterable[Move], axes: str, limits: np.ndarray, override: Override | None = None
) -> Iterator[Part | Pause]:
    """The runs of a program, each from rest to rest in one or more parts, and the pauses between them.

    Segments come in windows, and a part leaves as soon as it is fixed: memory does not grow with the program.

    axes      letters of the machine's axes, in the order of `limits`
    limits    of velocity .. snap of each axis, m/s .. m/s⁴, shape (N, 4)
    override  of the feed; with it nothing is lifted, so that what is fixed is never far ahead

    Raises ProgramError as `chains` does.  What is yielded is planned, not proven: give it to a `Prover`.
    """
    joiner, schedule, crossings = Joiner(), Schedule(limits, override=override), Crossings(limits)
    lifter = Lifter(limits) if override is None else None
    joints: deque[str] = deque()  # modes of the path at those that are not decided
    modes: deque[str] = deque()  # for which runs end that have not left

    def leaving(parts: Iterable[Part | Pause]) -> Iterator[Part | Pause]:
        for part in parts:
            if isinstance(part, Pause):
                yield part
                continue
            if part.entering is not None:  # both runs have counted it
                schedule.time -= float(np.sum(part.motion.duration))
            yield part._replace(mode=modes.popleft()) if part.ends else part

    for each in chains(moves, axes):
        if isinstance(each, Pause):
            schedule.time += each.duration
            yield each
            continue
        whole = _quicker(each, limits) if lifter and joiner.rests and each.ends else None
        sections, joint = whole[:2] if whole else joiner.join(each)
        joints.extend(each.modes)
        for stop in joint.stop:
            mode = joints.popleft()
            if stop:
                modes.append(mode)
        yield from leaving(whole[2] if whole else _along(sections, each.ends, schedule, lifter, crossings))


def _along(
    sections: list[Section], ends: bool, schedule: Schedule, lifter: Lifter | None, crossings: Crossings
) -> Iterator[Part | Pause]:
    """What is fixed when these sections of a chain are known, all where it `ends`."""
    for section in sections:
        line = crossings.add_line(section) if lifter and schedule.rests else None
        if line is not None:
            yield from line
            continue
        for part in schedule.add(section):
            if isinstance(part, Pause):
                yield from crossings.end()
                yield part
                continue
            for lifted in lifter.add(part) if lifter else (part,):
                yield from crossings.add(lifted, section.tolerance)
    if ends:
        yield from crossings.end()


def _quicker(chain: Chain, limits: np.ndarray) -> tuple[list[Section], Joint, list[Part | Pause]] | None:
    """A short chain with splines and blends, or with all its corners in time: which is quicker.

    None if it is not short, or if both are the same.
    """
    if len(chain.tolerance) > SHORT:
        return None
    usual, in_time = Joiner().join(chain), Joiner(SMOOTH, 0.0).join(chain)
    if np.array_equal(usual[1].stop, in_time[1].stop):
        return None
    whole = [
        (*each, list(_along(each[0], True, Schedule(limits), Lifter(limits), Crossings(limits))))
        for each in (usual, in_time)
    ]
    return min(whole, key=lambda each: _lasts(each[2]))


def _lasts(parts: list[Part | Pause]) -> float:
    return sum(float(np.sum(part.motion.duration)) for part in parts if isinstance(part, Part))
