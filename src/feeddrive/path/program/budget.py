"""What a part program may cost: motion, lines, moves of one block, and computing time.

A program can ask for more than anyone means: a feed of 1e-9 mm/min, a loop without an end, eleven nested repeats.
Each bound is checked before the moves beyond it are planned:

    motion     the sum of lengths over programmed feeds, and of dwells
    lines      of the file, and those that loops and calls read again
    commands   of one block: a cycle with many pecks and repeats, an arc of many turns in a tilted plane
    CPU        of reading, planning and sampling, a fixed part and one for each line of the file that has been reached

A large file may take long, since it is planned line by line; what a few lines may take is bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import thread_time
from typing import NamedTuple

from feeddrive.language.errors import ProgramError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.program.blocks import BlockError, Line, located

LONGEST = 172800.0
"""The longest motion, 48 h, s."""
MOST_LINES = 5_000_000
"""The largest number of lines of a file."""
MOST_AGAIN = 10_000_000
"""The largest number of lines that loops and calls may repeat in a whole program."""
MOST_AGAIN_AT_REST = 300_000
"""The largest number of lines that loops and calls may repeat between two lines with a motion or an offset."""
MOST_COMMANDS = 100_000
"""The largest number of commands of one block."""
MOST_CPU = 30.0
"""The processor time of reading, planning and sampling, s, to which `CPU_PER_LINE` is added."""
CPU_PER_LINE = 2e-3
"""The processor time for each line of the file, s."""
_EVERY = 64  # moves between two readings of the clock


class Budget(NamedTuple):
    """The bounds of one program.

    longest  motion, s
    cpu      processor time of reading, planning and sampling, s, to which `CPU_PER_LINE` is added for each line
    """

    longest: float = LONGEST
    cpu: float = MOST_CPU


class Spending:
    """What a program has cost so far.

    budget  its bounds; None: the usual ones
    motion  s, at the programmed feeds
    clock   processor time of the thread, s
    """

    def __init__(self, budget: Budget | None = None, clock: Callable[[], float] = thread_time) -> None:
        self.budget, self._clock = budget or Budget(), clock
        self.motion = 0.0  # s
        self._begun: float | None = None
        self._farthest = self._count = 0

    def move(self, line: Line, seconds: float, word: str) -> None:
        """Count a move or dwell that lasts so long at least; `word` is the one to change.

        Raises ProgramError, located at the line, if a bound is exceeded.
        """
        self.motion += seconds
        # not `>`: a sum that is no number is refused as well
        if not self.motion <= self.budget.longest:
            raise located(line, BlockError(_too_long(self.motion, self.budget.longest, seconds), word))
        self._farthest = max(self._farthest, line.number)
        self._count += 1
        if self._count % _EVERY == 1:
            self.check_cpu(line)

    def check_cpu(self, line: Line) -> None:
        """Raise ProgramError, located at the line, if the program has taken too much processor time."""
        now = self._clock()
        if self._begun is None:
            # not in the constructor: another thread may iterate
            self._begun = now
        most = self.budget.cpu + CPU_PER_LINE * self._farthest
        taken = now - self._begun
        if taken > most:
            reason = Text(
                f"reading, planning and sampling have taken {Quantity(taken, 's'):4 SI} of processor time up to here, "
                f"at most {Quantity(most, 's'):4 SI} for {self._farthest} lines of the file: does a loop never end? "
                "Otherwise allow more with --most-cpu"
            )
            raise located(line, BlockError(reason))


def _too_long(motion: float, longest: float, seconds: float) -> str:
    hours, most, last = (Quantity(value / 3600.0, "h") for value in (motion, longest, seconds))
    return Text(
        f"the motion up to here lasts {hours:4} at the programmed feeds, {last:4} of it in this line, and at most "
        f"{most:4}: correct the feed or the dwell, or allow more with --longest"
    )


def check_lines(program: Path, most: int = MOST_LINES) -> None:
    """Raise ProgramError if a file has too many lines."""
    try:
        # every line has at least the byte that ends it
        if program.stat().st_size <= most:
            return
        with program.open("rb") as file:
            count = sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b""))
    except OSError:
        return  # the reader of the program reports it
    if count > most:
        reason = f"the file has {count:,} lines, and a program at most {most:,}: split it"
        raise ProgramError(str(program), most + 1, 1, "", reason)
