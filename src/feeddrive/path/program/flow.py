"""The control flow of RS-274/NGC: o-words, which are subroutines, loops and conditions.

A loop returns to the position of its line in the file, and a call jumps to the position of its subroutine.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from feeddrive.language.quantity import Quantity
from feeddrive.path.program import blocks
from feeddrive.path.program.blocks import BlockError, LineReader, Parameters, Place, Values
from feeddrive.path.program.lines import ProgramLines
from feeddrive.path.program.modes import Modes

_STATEMENT = re.compile(
    r"(endsub|sub|call|return|if|elseif|else|endif|while|endwhile|do|repeat|endrepeat|break|continue)"
)
_LABEL = re.compile(r"(\d+)|<([^<>]+)>")
_SKIPPED = re.compile(rf"/?(?:n[\d.]+)?o(?:{_LABEL.pattern}){_STATEMENT.pattern}")
_BEGINS = frozenset("oOnN/(")
"""The characters with which a line with an o-word can begin."""
_ENDS = {"sub": "endsub", "if": "endif", "while": "endwhile", "do": "while", "repeat": "endrepeat"}


@dataclass
class Open:
    """An open loop or condition, with the positions of its body and its first line.

    left  for a repeat, the number of remaining passes; for a condition, 1 if a branch was taken
    """

    kind: str
    label: str
    body: Place
    head: Place
    left: int = 0


@dataclass
class Frame:
    """The call frame of a subroutine or of the program: arguments, local parameters, and open loops.

    saved     modes that M70 or M73 have saved at this level
    restores  True if they are restored when the subroutine returns (M73)
    """

    label: str
    arguments: dict[int, float] = field(default_factory=dict[int, float])
    local: dict[str, float] = field(default_factory=dict[str, float])
    opened: list[Open] = field(default_factory=list[Open])
    saved: Modes | None = None
    restores: bool = False


def statement_of(text: str) -> tuple[str, str] | None:
    """Return the label and the kind of the o-word in a skipped line, or None for a line without an o-word."""
    try:
        statement = _SKIPPED.match(blocks.compact(text)[0])
    except BlockError:
        return None
    if not statement:
        return None
    return (statement[1].lstrip("0") or "0" if statement[1] else statement[2]), statement[3]


class Flow:
    """The control flow of a program: the o-words, which say what line comes next."""

    def __init__(self, lines: ProgramLines, parameters: Parameters) -> None:
        self._lines, self._parameters = lines, parameters
        self._defined: dict[str, tuple[LineReader, Place]] = {}
        self._frames = [Frame("")]
        parameters.live["_call_level"] = lambda: float(len(self._frames) - 1)
        parameters.live["_value"] = lambda: self._value
        parameters.live["_value_returned"] = lambda: self._returned
        self._value = self._returned = 0.0
        self.returned: Modes | None = None  # modes that the subroutine which has just returned restores (M73)

    @property
    def frame(self) -> Frame:
        """The innermost call frame."""
        return self._frames[-1]

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself, with its line; empty if none is."""
        loops = [opened for opened in self._frames[0].opened if opened.kind != "if"]
        return f"o{loops[-1].label} {loops[-1].kind} of line {loops[-1].head.number + 1}" if loops else ""

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
        # after a branch that was taken the condition is not evaluated: its parameters may have no value
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

    def _skip(self, label: str, kinds: Sequence[str]) -> str:
        """Skip past the next line whose o-word has the given label and one of the given kinds; return its kind."""
        while True:
            line = self._lines.next_line()
            if line is None:
                raise BlockError(f"o{label} has no {' or '.join(kinds)} behind it: write it")
            # a cheap test, since what is skipped may be long
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
        # a loop may pass the same definition again
        defined = self._defined.get(label)
        if defined and defined != (self._lines.reader, self._lines.reader.place):
            raise BlockError(f"the subroutine o{label} is there twice: rename one")
        self._defined[label] = self._lines.reader, self._lines.reader.place
        self._skip(label, ("endsub",))

    def _call(self, label: str, arguments: list[float]) -> None:
        self._lines.check_depth(f"o{label}")
        if len(arguments) > len(blocks.ARGUMENTS):
            raise BlockError(
                f"a call has at most {len(blocks.ARGUMENTS)} arguments, this one has {len(arguments)}", "o", 0
            )
        if label not in self._defined:
            self._load(label)
        numbered = self._parameters.numbered
        # #1 to #30 are local to a call in LinuxCNC
        kept = {parameter: numbered.pop(parameter) for parameter in blocks.ARGUMENTS if parameter in numbered}
        self._frames.append(Frame(label, kept, self._parameters.local))
        self._parameters.local = {}
        for parameter, value in zip(blocks.ARGUMENTS, arguments, strict=False):
            numbered[parameter] = value
        self._lines.enter(f"o{label}", *self._defined[label])

    def _load(self, label: str) -> None:
        """Load a subroutine from the file of the same name in the program's folder."""
        path = self._lines.program.parent / f"{label}.ngc"
        # a label must not lead to a file outside the program's folder
        if "/" in label or "\\" in label or not path.is_file():
            raise BlockError(
                f"there is no subroutine o{label} before this line, and no file {label}.ngc beside the program", "o", 0
            )
        reader = self._lines.open(path)
        start = reader.place
        reader.go(Place(0, 0))
        while True:
            line = reader.read()
            if line is None:
                raise BlockError(f"the file {path} has no line o<{label}> sub: write it at its beginning", "o", 0)
            if statement_of(line.text) == (label, "sub"):
                self._defined[label] = reader, reader.place
                # the call may come from this very file
                reader.go(start)
                return

    def _return(self, label: str, arguments: list[float]) -> None:
        # as in LinuxCNC its number may be any: that of the condition around it, say
        self._endsub(label, arguments, True)

    def _endsub(self, label: str, arguments: list[float], anywhere: bool = False) -> None:
        frame = self._frames[-1]
        if (frame.label != label and not anywhere) or len(self._frames) == 1:
            running = f"o{frame.label} runs" if len(self._frames) > 1 else "none runs"
            raise BlockError(f"this ends the subroutine o{label}, but {running}: o{label} sub stands where?", "o", 0)
        self._value, self._returned = (arguments[0], 1.0) if arguments else (0.0, 0.0)
        self._frames.pop()
        self.returned = frame.saved if frame.restores else None
        numbered = self._parameters.numbered
        for parameter in blocks.ARGUMENTS:
            numbered.pop(parameter, None)
        numbered.update(frame.arguments)
        self._parameters.local = frame.local
        self._lines.leave()

    # conditions

    def _if(self, label: str, arguments: list[float]) -> None:
        self._open("if", label)
        self._branch(label, arguments[0])

    def _elseif(self, label: str, arguments: list[float]) -> None:
        self._branch(label, arguments[0])

    def _else(self, label: str, arguments: list[float]) -> None:
        self._leave(label)

    def _branch(self, label: str, condition: float) -> None:
        """Enter a branch if its condition is true; otherwise skip to the next elseif, else or endif."""
        here = self._top(label, "if")
        here.left = bool(condition)
        if not condition:
            kind = self._skip(label, ("elseif", "else", "endif"))
            if kind == "elseif":
                self._lines.reader.go(self._lines.reader.last)
            elif kind == "endif":
                self._frames[-1].opened.pop()

    def _leave(self, label: str) -> None:
        """Skip to the end of a conditional block after one of its branches was taken."""
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
                self._lines.reader.go(opened[-1].body)
            else:
                opened.pop()
        elif arguments[0]:
            self._open("while", label)
        else:
            self._skip(label, ("endwhile",))

    def _endwhile(self, label: str, arguments: list[float]) -> None:
        loop = self._top(label, "while")
        self._frames[-1].opened.pop()
        self._lines.reader.go(loop.head)

    def _do(self, label: str, arguments: list[float]) -> None:
        self._open("do", label)

    def _repeat(self, label: str, arguments: list[float]) -> None:
        # more than MOST_AGAIN lines are refused anyway
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
            self._lines.reader.go(loop.body)
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
            # rs274 returns to the start of a `do` loop without testing its condition, so that it may never end
            self._skip(label, ("while",))
            # back to this line, whose condition has yet to be read
            self._lines.reader.go(self._lines.reader.last)

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
        frame.opened.append(Open(kind, label, self._lines.reader.place, self._lines.reader.last))

    def _top(self, label: str, kind: str) -> Open:
        opened = self._frames[-1].opened
        if not opened or (opened[-1].kind, opened[-1].label) != (kind, label):
            inside = f"o{opened[-1].label} {opened[-1].kind} is open" if opened else "none is open"
            raise BlockError(f"this belongs to o{label} {kind}, but {inside}: check the numbers of the o-words", "o", 0)
        return opened[-1]
