"""The lines of a program and of its subprograms, in the order in which they are executed.

The program is never held in memory: a loop returns to the position of its line in the file, and a call jumps to the
position of its subprogram, in the same file or in another one.
"""

from pathlib import Path

from feeddrive.path.program.blocks import BlockError, Line, LineReader, Place, located
from feeddrive.path.program.budget import MOST_AGAIN, MOST_AGAIN_AT_REST

DEEPEST_CALL = 50
"""The deepest nesting of subprogram calls."""


class ProgramLines:
    """The lines of a program in order of execution, with the bounds on those that are read again.

    program     its file; subprograms lie in it or in the same folder
    most_again  largest number of lines that loops and calls may repeat
    """

    def __init__(self, program: Path, most_again: int = MOST_AGAIN) -> None:
        self.program = program
        self._most_again = most_again
        self._again = self._at_rest = 0
        self._readers: dict[Path, LineReader] = {}
        # the files that are being read, and where their callers go on
        self._reading = [(self.open(program), Place(0, 0))]

    @property
    def reader(self) -> LineReader:
        """The reader of the file whose lines are being executed."""
        return self._reading[-1][0]

    @property
    def calls(self) -> int:
        """The number of subprograms that are running."""
        return len(self._reading) - 1

    def open(self, path: Path) -> LineReader:
        """Return the reader of a file, which is the same for all calls."""
        if path not in self._readers:
            self._readers[path] = LineReader(path)
        return self._readers[path]

    def close(self) -> None:
        """Close all files."""
        for reader in self._readers.values():
            reader.close()

    def moved(self) -> None:
        """Record a motion or an offset: restart the count of repeated lines that `MOST_AGAIN_AT_REST` limits."""
        self._at_rest = 0

    def next_line(self) -> Line | None:
        """Return the next line, or None at the end of the file."""
        reader = self._reading[-1][0]
        line = reader.read()
        if line is None:
            return None
        if line.number > reader.furthest:
            reader.furthest = line.number
        else:
            self._again += 1
            self._at_rest += 1
            if self._again > self._most_again or self._at_rest > MOST_AGAIN_AT_REST:
                reason = (
                    f"{self._again} lines were read again by loops and calls (at most {self._most_again}, and "
                    f"{MOST_AGAIN_AT_REST} without a motion): does a loop never end?"
                )
                raise located(line, BlockError(reason))
        return line

    def check_depth(self, name: str) -> None:
        """Raise BlockError if the subprogram `name` would be called too deep."""
        if self.calls >= DEEPEST_CALL:
            raise BlockError(
                f"the call of {name} is more than {DEEPEST_CALL} deep: does it call itself without end?", name
            )

    def enter(self, name: str, reader: LineReader, place: Place) -> None:
        """Go on at a place of a subprogram; `leave` returns behind the line of this call.

        Raises BlockError if calls are nested too deep.
        """
        self.check_depth(name)
        self._reading.append((reader, self.reader.place))
        reader.go(place)
        self._again += 1

    def leave(self) -> None:
        """Return from the innermost subprogram to the line behind its call."""
        _, back = self._reading.pop()
        self.reader.go(back)
