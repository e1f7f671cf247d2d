"""Moves from a line of a program on, with the modal state that the lines before it have left.

The program is read from its beginning, as LinuxCNC does when it runs from a line: nothing moves, but units, plane,
feed, offsets, path mode, tool and spindle are followed.  The machine is assumed to stand where the line begins; from
another start position it first goes there by a straight traverse.
"""

from collections.abc import Generator
from contextlib import closing

from feeddrive.path.program.moves import Begin, Feed, Move, Offsets, PathMode, Point, Spindle, Straight, Synchronized

_MODAL = (PathMode, Feed, Spindle, Synchronized, Offsets)
"""The moves that hold until the next of their kind."""


def _told(feed: Feed) -> str:
    # as a program would have it, whatever the units of the reader
    return f"feed {1e3 * feed.linear:.6g} mm a turn" if feed.per_turn else f"feed {6e4 * feed.linear:.6g} mm/min"


def resumed(moves: Generator[Move], start: Point | None) -> Generator[Move]:
    """Yield the moves behind the first `Begin`, with the last of each modal kind before it.

    start  where the machine stands, m and rad; None: where the line begins
    """
    last: dict[type, Move] = {}
    with closing(moves):
        for move in moves:
            if isinstance(move, _MODAL):
                last[type(move)] = move
            elif isinstance(move, Begin):
                begin = move
                break
        else:
            return  # an error of the interpreter has ended the program before
        place = begin.position if start is None else start
        feed = last.get(Feed)
        told = _told(feed) if isinstance(feed, Feed) and feed.linear > 0.0 else "no feed"
        yield Begin(begin.source, place, f"{begin.state}, {told}")
        yield from last.values()
        if place != begin.position:
            yield Straight(begin.source, place, begin.position, True)
        yield from moves
