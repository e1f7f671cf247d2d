"""O-words: subroutines, loops and conditions of a part program.

The program is never held in memory: a loop returns to the position of its line in the file, a call to that of its
subroutine.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import (
    ARGUMENTS,
    BlockError,
    Line,
    LineReader,
    Parameters,
    Place,
    Values,
    compact,
    located,
)

DEEPEST_CALL = 50
"""Subroutines inside subroutines."""
MOST_AGAIN = 10_000_000
"""Lines that are read again, by loops and calls, in a whole program."""
MOST_AGAIN_AT_REST = 1_000_000
"""The same between two commands to the machine."""

_STATEMENT = re.compile(
    r"(endsub|sub|call|return|if|elseif|else|endif|while|endwhile|do|repeat|endrepeat|break|continue)"
)
_LABEL = re.compile(r"(\d+)|<([^<>]+)>")
_SKIPPED = re.compile(rf"/?(?:n[\d.]+)?o(?:{_LABEL.pattern}){_STATEMENT.pattern}")
_BEGINS = frozenset("oOnN/(")
"""What the line of an o-word begins with."""
_ENDS = {"sub": "endsub", "if": "endif", "while": "endwhile", "do": "while", "repeat": "endrepeat"}


@dataclass
class Open:
    """An open loop or condition, with the positions of its body and its first line.

    left  for a repeat, the remaining number of passes; for a condition, whether a branch was taken
    """

    kind: str
    label: str
    body: Place
    head: Place
    left: int = 0


@dataclass
class Frame:
    """The call frame of a subroutine or of the program: return position, arguments, local parameters, and open
    loops.
    """

    label: str
    reader: LineReader
    back: Place
    arguments: dict[int, float] = field(default_factory=dict[int, float])
    local: dict[str, float] = field(default_factory=dict[str, float])
    opened: list[Open] = field(default_factory=list[Open])


def statement_of(text: str) -> tuple[str, str] | None:
    """Return label and kind of an o-word in a skipped line; None for other lines."""
    try:
        statement = _SKIPPED.match(compact(text)[0])
    except BlockError:
        return None
    if not statement:
        return None
    return (statement[1].lstrip("0") or "0" if statement[1] else statement[2]), statement[3]


class Flow:
    """The control flow of a program, which returns its lines in order of execution."""

    def __init__(self, program: Path, parameters: Parameters, most_again: int = MOST_AGAIN) -> None:
        self._folder = program.parent
        self._parameters = parameters
        self._most_again = most_again
        self._again = self._at_rest = 0
        self._readers: dict[Path, LineReader] = {}
        self._defined: dict[str, tuple[LineReader, Place]] = {}
        reader = self._reader(program)
        self._frames = [Frame("", reader, reader.place)]
        parameters.live["_call_level"] = lambda: float(len(self._frames) - 1)
        parameters.live["_value"] = lambda: self._value
        parameters.live["_value_returned"] = lambda: self._returned
        self._value = self._returned = 0.0

    def close(self) -> None:
        """Close all files."""
        for reader in self._readers.values():
            reader.close()

    def moved(self) -> None:
        """Record that the last line commanded the machine; such loops may repeat more often."""
        self._at_rest = 0

    def next_line(self) -> Line | None:
        """Return the next line; None at the end of the program."""
        reader = self._frames[-1].reader
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

    def check_end(self) -> None:
        """Refuse a program that ends inside a subroutine, a loop or a condition."""
        frame = self._frames[-1]
        if frame.opened:
            last = frame.opened[-1]
            raise BlockError(
                f"the program ends inside o{last.label} {last.kind}: write o{last.label} {_ENDS[last.kind]}"
            )
        if len(self._frames) > 1:
            raise BlockError(f"the program ends inside the subroutine o{frame.label}: write o{frame.label} endsub")

    def act(self, statement: str) -> None:
        """Execute the o-word of the last line read."""
        values = Values(statement, self._parameters, 1)
        label = self._label(values)
        match = _STATEMENT.match(statement, values.at)
        if not match:
            raise values.fault(
                "an o-word has its number or <name> and then sub, call, return, if, while, do, repeat, break ..."
            )
        values.at = match.end()
        kind = match[1]
        if kind == "elseif" and self._top(label, "if").left:
            self._leave(label)
            return
        if kind in ("if", "elseif", "while", "repeat"):
            arguments = [self._bracket(values)]
        elif kind in ("call", "return", "endsub"):
            arguments = self._brackets(values)
        else:
            arguments = list[float]()
        if values.at < len(statement):
            raise values.fault(f"nothing else stands behind o{label} {kind}")
        getattr(self, f"_{kind}")(label, arguments)

    def _label(self, values: Values) -> str:
        plain = _LABEL.match(values.text, values.at)
        if plain:
            values.at = plain.end()
            return plain[1].lstrip("0") or "0" if plain[1] else plain[2]
        value = values.value()
        if value < 0 or abs(value - round(value)) > 1e-4:
            raise values.fault(f"the number of an o-word is whole and not negative, not {Quantity(value):6}", 1)
        return str(round(value))

    def _bracket(self, values: Values) -> float:
        if not values.text.startswith("[", values.at):
            raise values.fault("a condition or number in brackets [...] is expected here")
        return values.value()

    def _brackets(self, values: Values) -> list[float]:
        numbers: list[float] = []
        while values.text.startswith("[", values.at):
            numbers.append(values.value())
        return numbers

    def _reader(self, path: Path) -> LineReader:
        if path not in self._readers:
            self._readers[path] = LineReader(path)
        return self._readers[path]

    def _skip(self, label: str, kinds: Sequence[str]) -> str:
        """Skip past the next line with the o-word `label` of one of the kinds; return the kind."""
        while True:
            line = self.next_line()
            if line is None:
                raise BlockError(f"o{label} has no {' or '.join(kinds)} behind it: write it")
            if line.text.lstrip()[:1] not in _BEGINS:
                continue
            statement = statement_of(line.text)
            if statement and statement[0] == label and statement[1] in kinds:
                return statement[1]

    # subroutines

    def _sub(self, label: str, arguments: list[float]) -> None:
        frame = self._frames[-1]
        if len(self._frames) > 1:
            raise BlockError(
                f"the subroutine o{label} begins inside of the subroutine o{frame.label}: write its endsub before"
            )
        known = self._defined.get(label)
        if known and known != (frame.reader, frame.reader.place):
            raise BlockError(f"the subroutine o{label} is there twice: rename one")
        self._defined[label] = frame.reader, frame.reader.place
        self._skip(label, ("endsub",))

    def _call(self, label: str, arguments: list[float]) -> None:
        if len(self._frames) > DEEPEST_CALL:
            raise BlockError(
                f"the call of o{label} is more than {DEEPEST_CALL} deep: does it call itself without end?", "o", 0
            )
        if len(arguments) > len(ARGUMENTS):
            raise BlockError(f"a call has at most {len(ARGUMENTS)} arguments, this one has {len(arguments)}", "o", 0)
        if label not in self._defined:
            self._load(label)
        reader, place = self._defined[label]
        caller = self._frames[-1].reader
        numbered = self._parameters.numbered
        kept = {number: numbered.pop(number) for number in ARGUMENTS if number in numbered}
        self._frames.append(Frame(label, reader, caller.place, kept, self._parameters.local))
        self._parameters.local = {}
        for number, value in zip(ARGUMENTS, arguments, strict=False):
            numbered[number] = value
        reader.go(place)
        self._again += 1

    def _load(self, label: str) -> None:
        """Load a subroutine from the file of the same name in the program's folder."""
        path = self._folder / f"{label}.ngc"
        if "/" in label or "\\" in label or not path.is_file():
            raise BlockError(
                f"there is no subroutine o{label} before this line, and no file {label}.ngc beside the program", "o", 0
            )
        reader = self._reader(path)
        start = reader.place
        reader.go(Place(0, 0))
        while True:
            line = reader.read()
            if line is None:
                raise BlockError(f"the file {path} has no line o<{label}> sub: write it at its beginning", "o", 0)
            if statement_of(line.text) == (label, "sub"):
                self._defined[label] = reader, reader.place
                reader.go(start)
                return

    def _endsub(self, label: str, arguments: list[float]) -> None:
        self._return(label, arguments)

    def _return(self, label: str, arguments: list[float]) -> None:
        frame = self._frames[-1]
        if frame.label != label or len(self._frames) == 1:
            running = f"o{frame.label} runs" if len(self._frames) > 1 else "none runs"
            raise BlockError(f"this ends the subroutine o{label}, but {running}: o{label} sub stands where?", "o", 0)
        self._value, self._returned = (arguments[0], 1.0) if arguments else (0.0, 0.0)
        self._frames.pop()
        numbered = self._parameters.numbered
        for number in ARGUMENTS:
            numbered.pop(number, None)
        numbered.update(frame.arguments)
        self._parameters.local = frame.local
        self._frames[-1].reader.go(frame.back)

    # conditions

    def _if(self, label: str, arguments: list[float]) -> None:
        self._open("if", label)
        self._branch(label, arguments[0])

    def _elseif(self, label: str, arguments: list[float]) -> None:
        self._branch(label, arguments[0])

    def _else(self, label: str, arguments: list[float]) -> None:
        self._leave(label)

    def _branch(self, label: str, condition: float) -> None:
        """Take a branch, or skip to the next one whose condition must be read."""
        here = self._top(label, "if")
        here.left = bool(condition)
        if not condition:
            kind = self._skip(label, ("elseif", "else", "endif"))
            if kind == "elseif":
                self._frames[-1].reader.go(self._frames[-1].reader.last)
            elif kind == "endif":
                self._frames[-1].opened.pop()

    def _leave(self, label: str) -> None:
        """Leave the branch that was taken."""
        self._top(label, "if")
        self._skip(label, ("endif",))
        self._frames[-1].opened.pop()

    def _endif(self, label: str, arguments: list[float]) -> None:
        self._top(label, "if")
        self._frames[-1].opened.pop()

    # loops

    def _while(self, label: str, arguments: list[float]) -> None:
        opened = self._frames[-1].opened
        if opened and opened[-1].kind == "do" and opened[-1].label == label:
            if arguments[0]:
                self._frames[-1].reader.go(opened[-1].body)
            else:
                opened.pop()
        elif arguments[0]:
            self._open("while", label)
        else:
            self._skip(label, ("endwhile",))

    def _endwhile(self, label: str, arguments: list[float]) -> None:
        loop = self._top(label, "while")
        self._frames[-1].opened.pop()
        self._frames[-1].reader.go(loop.head)

    def _do(self, label: str, arguments: list[float]) -> None:
        self._open("do", label)

    def _repeat(self, label: str, arguments: list[float]) -> None:
        times = round(arguments[0]) if abs(arguments[0]) < 1e9 else int(1e9)
        if times < 1:
            self._skip(label, ("endrepeat",))
        else:
            self._open("repeat", label)
            self._frames[-1].opened[-1].left = times

    def _endrepeat(self, label: str, arguments: list[float]) -> None:
        loop = self._top(label, "repeat")
        loop.left -= 1
        if loop.left > 0:
            self._frames[-1].reader.go(loop.body)
        else:
            self._frames[-1].opened.pop()

    def _break(self, label: str, arguments: list[float]) -> None:
        loop = self._loop(label, "break")
        self._frames[-1].opened.pop()
        self._skip(label, (_ENDS[loop.kind],))

    def _continue(self, label: str, arguments: list[float]) -> None:
        loop = self._loop(label, "continue")
        if loop.kind == "while":
            self._endwhile(label, arguments)
        elif loop.kind == "repeat" and loop.left > 1:
            self._endrepeat(label, arguments)
        elif loop.kind == "repeat":
            self._break(label, arguments)
        else:
            self._skip(label, ("while",))
            self._frames[-1].reader.go(self._frames[-1].reader.last)  # its condition has yet to be read

    def _loop(self, label: str, kind: str) -> Open:
        """Return the innermost loop with the label, and close everything opened inside it."""
        opened = self._frames[-1].opened
        while opened and (opened[-1].label != label or opened[-1].kind == "if"):
            opened.pop()
        if not opened:
            raise BlockError(f"o{label} {kind} stands in no loop o{label}: write it between the loop's lines", "o", 0)
        return opened[-1]

    def _open(self, kind: str, label: str) -> None:
        frame = self._frames[-1]
        if len(frame.opened) > 200:
            raise BlockError("loops and conditions lie more than 200 deep: is one never ended?", "o", 0)
        frame.opened.append(Open(kind, label, frame.reader.place, frame.reader.last))

    def _top(self, label: str, kind: str) -> Open:
        opened = self._frames[-1].opened
        if not opened or (opened[-1].kind, opened[-1].label) != (kind, label):
            inside = f"o{opened[-1].label} {opened[-1].kind} is open" if opened else "none is open"
            raise BlockError(f"this belongs to o{label} {kind}, but {inside}: check the numbers of the o-words", "o", 0)
        return opened[-1]
