"""The control flow of SINUMERIK programs: variables, jumps, loops, and subprograms.

    L100 P3   POCKET(10,R1)   CALL "POCKET"     calls; P repeats
    MCALL POCKET(10)  ..  MCALL                  a call behind each block with a motion, until MCALL alone
    PROC POCKET(REAL DEPTH, VAR REAL COUNT)      parameters, by value or (VAR) by reference
    PROC POCKET SAVE                             G codes and frames of the caller act again behind the call
    CASE R1 OF 1 GOTOF A 2 GOTOF B DEFAULT GOTOF C   a jump by a whole number
    M17  RET  M2  M30                            return; only RET does not stop the path

A subprogram lies in the same file, behind a line %_N_NAME_SPF, or in the file NAME.SPF or NAME.MPF beside it.  R
parameters are those of all programs, variables (DEF) are local to theirs.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from feeddrive.path.program.blocks import BlockError, LineReader, Place
from feeddrive.path.program.lines import ProgramLines
from feeddrive.path.program.siemens_words import Values

MOST_NESTED = 200
"""The deepest nesting of loops and conditions of one program."""
MOST_REPEATS = 9999
"""The largest P of a call, as on the control."""

_BEGIN = re.compile(r"\s*(?:[N:]\s*(\d+)(?![A-Z0-9_.])\s*)?(?:([A-Z_][A-Z0-9_]+)\s*:(?![=:])\s*)?", re.IGNORECASE)
_SECTION = re.compile(r"\s*%\s*_N_([A-Z0-9_]+)_(?:MPF|SPF)\s*$", re.IGNORECASE)
_HEADER = re.compile(r"\s*%(?:_N_\w*|MPF\d*|SPF\d*|\s*\d*)\s*$", re.IGNORECASE)
_OPENS = {"IF": "ENDIF", "FOR": "ENDFOR", "WHILE": "ENDWHILE", "LOOP": "ENDLOOP", "REPEAT": "UNTIL"}
_FLOW = re.compile(
    r"(IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|LOOP|ENDLOOP|REPEAT|UNTIL|GOTOF|GOTOB|GOTOC|GOTO|CASE|DEF|PROC|EXTERN)"
    r"(?![A-Z0-9_])",
    re.IGNORECASE,
)
_TARGET = re.compile(r"(GOTOF|GOTOB|GOTOC|GOTO)\s+(?:N(?=\d))?([A-Z0-9_]+)", re.IGNORECASE)
_JUMP = re.compile(_TARGET.pattern + r"\s*$", re.IGNORECASE)
_CASE = re.compile(rf"(?:([+-]?\d+)|(DEFAULT))\s+{_TARGET.pattern}(?=\s|$)\s*", re.IGNORECASE)
_R = re.compile(r"R\d{1,4}")
_PARAMETER = re.compile(r"(VAR\s+)?(REAL|INT|BOOL)\s+([A-Z_][A-Z0-9_]*)\s*(?:=\s*(.+))?$", re.IGNORECASE)
_PROGRAM_NAME = re.compile(r"(?:_N_)?([A-Z0-9_]+?)(?:[._](?:SPF|MPF))?$", re.IGNORECASE)


class _Open(NamedTuple):
    """An open IF or loop: the place of its line and of its body, and of a FOR its variable and last value."""

    kind: str
    head: Place
    body: Place
    variable: str = ""
    last: float = 0.0


class _Mark(NamedTuple):
    """The target of a jump: its place, the offsets of the lines of the IFs and loops around it, and its section."""

    place: Place
    around: tuple[int, ...]
    section: int


class _Map(NamedTuple):
    """The places in a file: targets of its jumps, and the programs in it by name, with the number of their section."""

    marks: dict[str, list[_Mark]]
    sections: dict[str, tuple[Place, int]]


class Call(NamedTuple):
    """A call of a subprogram: its name, the texts of its arguments, and how often it runs."""

    name: str
    arguments: tuple[str, ...] = ()
    repeats: int = 1


@dataclass
class _Scope:
    """A program that runs.

    start      place of its first line; section: its number in the file
    arguments  values and names of the call, until PROC binds them
    variables  of the program; returned: the variable of the caller for each one by reference (VAR)
    left       number of passes that remain, with this one
    modal      True for a call of MCALL
    restore    what the end of the program restores of the state of its caller (SAVE)
    begun      True once one of its lines was executed
    """

    name: str
    start: Place
    section: int = 0
    arguments: list[tuple[float | None, str]] = field(default_factory=list[tuple[float | None, str]])
    variables: dict[str, float] = field(default_factory=dict[str, float])
    returned: dict[str, str] = field(default_factory=dict[str, str])
    opened: list[_Open] = field(default_factory=list[_Open])
    left: int = 1
    modal: bool = False
    restore: Callable[[], None] | None = None
    begun: bool = False


def begin_of(text: str) -> int:
    """Return the index behind the block number and the label of a line."""
    begin = _BEGIN.match(text)
    assert begin is not None
    return begin.end()


class SiemensFlow:
    """The control flow of a program, and its variables.

    parameters  variables from outside, which all programs see
    live        function that returns the value of a system variable by its name and index
    save        function that takes the G codes and frames that act, and returns one that restores them
    """

    def __init__(
        self,
        lines: ProgramLines,
        parameters: dict[str, float],
        live: Callable[[str, str | None], float],
        save: Callable[[], Callable[[], None]],
    ) -> None:
        self._lines, self._live, self._save = lines, live, save
        self._common = parameters
        self._scopes = [_Scope("", Place(0, 0))]
        self._maps: dict[LineReader, _Map] = {}
        self._files: dict[str, Path] | None = None
        self._modal: tuple[Call, list[tuple[float | None, str]]] | None = None

    @property
    def loop(self) -> str:
        """The innermost loop that is running in the program itself, with its line; empty if none is."""
        loops = [opened for opened in self._scopes[0].opened if opened.kind != "IF"]
        return f"{loops[-1].kind} of line {loops[-1].head.number + 1}" if loops else ""

    @property
    def _scope(self) -> _Scope:
        return self._scopes[-1]

    # variables

    def value(self, name: str, index: str | None) -> float:
        """Return the value of a variable, an R parameter or a system variable."""
        name = name.upper()
        if name.startswith("$"):
            return self._live(name, index)
        if name in ("TRUE", "FALSE"):
            return float(name == "TRUE")
        if index is not None:
            raise BlockError(f"arrays such as {name}[{index}] are not read: use one variable for each", name)
        if _R.fullmatch(name):
            return self._common.get(name, 0.0)
        for variables in (self._scope.variables, self._common):
            if name in variables:
                return variables[name]
        raise BlockError(f"the variable {name} has no value here: write DEF REAL {name}= before", name)

    def is_variable(self, name: str) -> bool:
        """Return True for an R parameter, and for a variable that the running program sees."""
        return bool(_R.fullmatch(name)) or name in self._scope.variables or name in self._common

    def assign(self, name: str, value: float) -> None:
        """Set a variable or an R parameter."""
        common = _R.fullmatch(name) or (name in self._common and name not in self._scope.variables)
        (self._common if common else self._scope.variables)[name] = value

    # lines

    def take(self, text: str) -> tuple[bool, str, int]:
        """Take a line without its comment: return True if a program ends at it, its flow word, and the index behind.

        Lines of other programs in the same file begin with %_N_NAME_SPF, which ends the one before.
        """
        scope = self._scope
        if _HEADER.match(text):
            return scope.begun and bool(_SECTION.match(text)), "", len(text)
        at = begin_of(text)
        if at == len(text.rstrip()):
            return False, "", at
        flow = _FLOW.match(text, at)
        word = flow[1].upper() if flow else ""
        if scope.arguments and word != "PROC":
            raise BlockError(
                f"{scope.name} was called with arguments, and does not begin with PROC {scope.name}(..): take them out",
                scope.name,
            )
        scope.begun = True
        return False, word, flow.end() if flow else at

    def control(self, word: str, values: Values, at: int) -> None:
        """Execute the flow word of a line, behind which the rest begins at an index."""
        text = values.text
        if word in ("DEF", "PROC"):
            self._define(values, at) if word == "DEF" else self._bind(text[at:])
        elif word == "EXTERN":
            # it says what PROC says again
            pass
        elif word.startswith("GOTO"):
            self._jump(text, values.at)
        elif word == "CASE":
            values.at = at
            self._case(values)
        elif word == "IF":
            values.at = at
            true = values.expression() != 0.0
            jump = _JUMP.match(text, values.at)
            if jump:
                if true:
                    self._jump(text, jump.start())
            elif text[values.at :].strip():
                raise values.fault("behind the condition of IF stands GOTOF, GOTOB or nothing")
            else:
                head = self._lines.reader.last
                if true or self._skip("IF", ("ELSE", "ENDIF")) == "ELSE":
                    self._push(_Open("IF", head, self._lines.reader.place))
        elif word == "ELSE":
            self._top("IF", word)
            self._skip("IF", ("ENDIF",))
            self._scope.opened.pop()
        elif word == "ENDIF":
            self._top("IF", word)
            self._scope.opened.pop()
        else:
            values.at = at
            self._loop(word, values)

    def check_end(self) -> None:
        """Refuse the end of a program inside of a loop or condition."""
        if self._scope.opened:
            kind = self._scope.opened[-1].kind
            raise BlockError(f"the program ends inside {kind}: write {_OPENS[kind]}", kind)

    def _loop(self, word: str, values: Values) -> None:
        reader, opened = self._lines.reader, self._scope.opened
        if word == "FOR":
            self._begin_for(values)
        elif word == "ENDFOR":
            loop = self._top("FOR", word)
            value = self.value(loop.variable, None) + 1.0
            self.assign(loop.variable, value)
            if value <= loop.last:
                reader.go(loop.body)
            else:
                opened.pop()
        elif word == "WHILE":
            if values.expression() == 0.0:
                self._skip("WHILE", ("ENDWHILE",))
            else:
                # back to this line, whose condition is read again
                self._push(_Open("WHILE", reader.last, reader.last))
        elif word in ("ENDWHILE", "ENDLOOP"):
            loop = self._top(word[3:], word)
            opened.pop()
            reader.go(loop.body)
        elif word == "LOOP":
            self._push(_Open("LOOP", reader.last, reader.last))
        elif word == "REPEAT":
            if values.text[values.at :].strip():
                raise BlockError("the repetition of labels is not read: write FOR or REPEAT .. UNTIL", "REPEAT")
            self._push(_Open("REPEAT", reader.last, reader.place))
        else:
            loop = self._top("REPEAT", word)
            if values.expression() == 0.0:
                reader.go(loop.body)
            else:
                opened.pop()

    def _begin_for(self, values: Values) -> None:
        found = re.compile(r"\s*([A-Z_][A-Z0-9_]*)\s*=", re.IGNORECASE).match(values.text, values.at)
        if not found:
            raise values.fault("a loop is FOR NAME=first TO last")
        values.at = found.end()
        first = values.expression()
        to = re.compile(r"\s*TO(?![A-Z0-9_])", re.IGNORECASE).match(values.text, values.at)
        if not to:
            raise values.fault("a loop is FOR NAME=first TO last: TO is missing")
        values.at = to.end()
        last, name = values.expression(), found[1].upper()
        head = self._lines.reader.last
        self.assign(name, first)
        if first > last:
            self._skip("FOR", ("ENDFOR",))
        else:
            self._push(_Open("FOR", head, self._lines.reader.place, name, last))

    def _push(self, opened: _Open) -> None:
        if len(self._scope.opened) >= MOST_NESTED:
            raise BlockError(
                f"loops and conditions lie more than {MOST_NESTED} deep: is one left by a jump?", opened.kind
            )
        self._scope.opened.append(opened)

    def _top(self, kind: str, word: str) -> _Open:
        opened = self._scope.opened
        if not opened or opened[-1].kind != kind:
            raise BlockError(f"{word} ends {kind}, and {opened[-1].kind if opened else 'none'} is open", word)
        return opened[-1]

    def _skip(self, kind: str, ends: tuple[str, ...]) -> str:
        """Skip lines behind the end of the part that is open, and return the word that ends it."""
        depth = 0
        while (line := self._lines.next_line()) is not None:
            text = without_comment(line.text)
            if _SECTION.match(text):
                break
            word = _FLOW.match(text, begin_of(text))
            found = word[1].upper() if word else ""
            if depth == 0 and found in ends:
                return found
            if found == kind and not (kind == "IF" and re.search(r"GOTO[FBC]?\s", text, re.IGNORECASE)):
                depth += 1
            elif found == _OPENS[kind]:
                depth -= 1
        raise BlockError(f"{kind} has no {' or '.join(ends)} behind it: write it", kind)

    def _jump(self, text: str, at: int) -> None:
        jump = _JUMP.match(text, at)
        if not jump:
            raise BlockError("a jump is GOTOF, GOTOB, GOTO or GOTOC and a label or a block number", "GOTO")
        self._go(jump[1].upper(), jump[2].upper())

    def _go(self, word: str, label: str) -> None:
        """Go on at a label or a block number, in the direction that the word of a jump says."""
        reader, scope = self._lines.reader, self._scope
        here = reader.last.offset
        marks = [mark for mark in self._map(reader).marks.get(label, []) if mark.section == scope.section]
        ahead = [mark for mark in marks if mark.place.offset > here]
        behind = [mark for mark in marks if mark.place.offset <= here]
        found = (ahead[:1] if word != "GOTOB" else []) or (behind[-1:] if word != "GOTOF" else [])
        if not found:
            if word == "GOTOC":
                return
            way = {"GOTOF": "behind this line", "GOTOB": "before this line"}.get(word, "in the program")
            short = ", which has two letters or more" if len(label) == 1 and label.isalpha() else ""
            raise BlockError(
                f"there is no label or block number {label} {way}: write it{short}, or correct the jump", label
            )
        mark = found[0]
        if tuple(opened.head.offset for opened in scope.opened[: len(mark.around)]) != mark.around:
            raise BlockError(
                f"{label} lies inside a loop or condition, into which no jump leads: jump before it", label
            )
        # a jump leaves the loops and conditions that are not around its target
        del scope.opened[len(mark.around) :]
        reader.go(mark.place)

    def _case(self, values: Values) -> None:
        """Execute CASE value OF 1 GOTOF A 2 GOTOB B DEFAULT GOTOF C; without DEFAULT the program goes on."""
        value, text = values.expression(), values.text
        of = re.compile(r"\s*OF(?![A-Z0-9_])\s*", re.IGNORECASE).match(text, values.at)
        values.at = of.end() if of else values.at
        if not of or values.at == len(text):
            raise values.fault(
                "a branch is CASE value OF 1 GOTOF FIRST 2 GOTOF SECOND DEFAULT GOTOF OTHERS", word="CASE"
            )
        taken: re.Match[str] | None = None
        while values.at < len(text):
            branch = _CASE.match(text, values.at)
            if not branch:
                raise values.fault(
                    "a whole number or DEFAULT, GOTOF or GOTOB, and a label or block number are expected here",
                    word="CASE",
                )
            fits = branch[2] is not None or float(branch[1]) == value
            taken = branch if taken is None and fits else taken
            values.at = branch.end()
            if branch[2] is not None and values.at < len(text):
                raise values.fault("DEFAULT is the last branch of CASE", word="CASE")
        if taken is not None:
            self._go(taken[3].upper(), taken[4].upper())

    def _map(self, reader: LineReader) -> _Map:
        if reader not in self._maps:
            self._maps[reader] = _map_of(Path(reader.name))
        return self._maps[reader]

    def _define(self, values: Values, at: int) -> None:
        kind = re.compile(r"\s*(REAL|INT|BOOL|STRING|CHAR|AXIS|FRAME)(?![A-Z0-9_])", re.IGNORECASE).match(
            values.text, at
        )
        if not kind or kind[1].upper() not in ("REAL", "INT", "BOOL"):
            raise BlockError("variables are DEF REAL, DEF INT or DEF BOOL: others are not read", "DEF")
        values.at = kind.end()
        while True:
            name = re.compile(r"\s*([A-Z_][A-Z0-9_]*)\s*(\[)?", re.IGNORECASE).match(values.text, values.at)
            if not name or name[2]:
                raise values.fault("a variable has a name, and no index: arrays are not read")
            values.at = name.end()
            value = 0.0
            if values.skipped().startswith("="):
                values.at += 1
                value = values.expression()
            self._scope.variables[name[1].upper()] = value
            if not values.skipped().startswith(","):
                break
            values.at += 1
        if values.skipped():
            raise values.fault("nothing else stands behind a definition")

    # subprograms

    def call(self, call: Call, modal: bool = False) -> None:
        """Enter a subprogram; with `modal` (MCALL), call it behind each block with a motion instead."""
        arguments = [self._argument(text) for text in call.arguments]
        if modal:
            self._find(call.name)
            self._modal = call, arguments
        else:
            self._enter(call, arguments)

    def check_known(self, name: str) -> None:
        """Raise BlockError if there is no such subprogram."""
        self._find(name)

    def end_modal(self) -> None:
        """End the modal call (MCALL alone)."""
        self._modal = None

    @property
    def modal(self) -> bool:
        """True if a call follows each block with a motion: MCALL is on, and its subprogram does not run."""
        return self._modal is not None and not any(scope.modal for scope in self._scopes)

    def moved(self) -> None:
        """Call the modal subprogram behind a block with a motion, except in a block of this subprogram."""
        if self._modal and self.modal:
            self._enter(*self._modal, modal=True)

    def leave(self) -> bool:
        """Return from the running program; return True if it is the main program."""
        if len(self._scopes) == 1:
            return True
        self.check_end()
        scope = self._scopes.pop()
        values = {outside: scope.variables[inside] for inside, outside in scope.returned.items()}
        for outside, value in values.items():
            self.assign(outside, value)
        if scope.left > 1:
            self._scopes.append(
                _Scope(scope.name, scope.start, scope.section, left=scope.left - 1, modal=scope.modal, begun=True)
            )
            self._lines.reader.go(scope.start)
        else:
            self._lines.leave()
        if scope.restore is not None:
            scope.restore()
        return False

    def _argument(self, text: str) -> tuple[float | None, str]:
        """Return the value of an argument, None for one that is left out, and its variable, if it is one."""
        text = text.strip()
        if not text:
            return None, ""
        if text.startswith('"'):
            raise BlockError(f"the argument {text} is a text: only numbers are read", text)
        name = text.upper()
        return Values(text, 0, self.value).whole(), name if self.is_variable(name) else ""

    def _enter(self, call: Call, arguments: list[tuple[float | None, str]], modal: bool = False) -> None:
        if not 1 <= call.repeats <= MOST_REPEATS:
            raise BlockError(f"P repeats a call 1 to {MOST_REPEATS} times, not {call.repeats}", "P")
        if call.repeats > 1 and arguments:
            raise BlockError("a call with arguments is not repeated here: write it in a loop", "P")
        reader, start, section = self._find(call.name)
        self._lines.enter(call.name, reader, start)
        scope = _Scope(call.name, start, section, arguments, left=call.repeats, modal=modal, begun=section > 0)
        self._scopes.append(scope)

    def _find(self, name: str) -> tuple[LineReader, Place, int]:
        """Return the file of a subprogram, its first line, and its section in this file (0: it has no others)."""
        for reader in (self._lines.reader, self._lines.open(self._lines.program)):
            if name in self._map(reader).sections:
                return reader, *self._map(reader).sections[name]
        if self._files is None:
            folder = self._lines.program.parent
            self._files = {path.name.upper(): path for path in sorted(folder.iterdir(), reverse=True)}
        for file in (f"{name}.SPF", f"{name}.MPF", f"_N_{name}_SPF", f"_N_{name}_MPF"):
            path = self._files.get(file)
            if path is not None and path.is_file():
                return self._lines.open(path), Place(0, 0), 0
        raise BlockError(
            f"there is no subprogram {name}: neither %_N_{name}_SPF in this file nor {name}.SPF beside it", name
        )

    def _bind(self, text: str) -> None:
        """Bind the arguments of the call to the parameters of PROC."""
        proc = re.compile(r"\s*(\w+)\s*(?:\((.*)\))?\s*([^()]*)$").match(text)
        if not proc:
            raise BlockError("a subprogram begins with PROC NAME(REAL FIRST, INT SECOND)", "PROC")
        scope, name = self._scope, proc[1].upper()
        for word in proc[3].upper().split():
            if word == "SAVE":
                # the main program has no caller
                scope.restore = self._save() if len(self._scopes) > 1 else None
            elif word not in ("DISPLOF", "DISPLON", "SBLOF", "SBLON", "ACTBLOCNO"):
                raise BlockError(f"{word} of PROC is not planned: take it out", word)
        parameters = [part.strip() for part in (proc[2] or "").split(",")] if (proc[2] or "").strip() else []
        if len(scope.arguments) > len(parameters):
            raise BlockError(
                f"{name} has {len(parameters)} parameters, and the call {len(scope.arguments)}: take some out", name
            )
        for k, parameter in enumerate(parameters):
            match = _PARAMETER.match(parameter)
            if not match:
                reason = f"the parameter {parameter} is none of REAL, INT and BOOL: others are not read"
                raise BlockError(reason, parameter)
            value, outside = scope.arguments[k] if k < len(scope.arguments) else (None, "")
            if value is None:
                value = Values(match[4], 0, self.value).whole() if match[4] else 0.0
            inside = match[3].upper()
            scope.variables[inside] = value
            if match[1] and outside:
                scope.returned[inside] = outside
        scope.arguments = []


def _map_of(program: Path) -> _Map:
    """Return the places of the labels and block numbers to which a file jumps, and of the programs in it."""
    wanted: set[str] = set()
    marks: dict[str, list[_Mark]] = {}
    sections: dict[str, tuple[Place, int]] = {}
    reader = LineReader(program)
    try:
        while (line := reader.read()) is not None:
            text = without_comment(line.text)
            wanted |= {jump[2].upper() for jump in re.finditer(_TARGET, text)}
        reader.go(Place(0, 0))
        around: list[int] = []
        section, begun = 0, False
        while (line := reader.read()) is not None:
            text = without_comment(line.text)
            if named := _SECTION.match(text):
                # the first one is that of the program with which the file begins
                section += begun
                begun = True
                around.clear()
                sections[named[1].upper()] = reader.place, section
                continue
            begun = begun or not (_HEADER.match(text) or not text.strip())
            begin = _BEGIN.match(text)
            assert begin is not None
            for name in (begin[1], (begin[2] or "").upper()):
                if name in wanted:
                    marks.setdefault(name, []).append(_Mark(reader.last, tuple(around), section))
            word = _FLOW.match(text, begin.end())
            kind = word[1].upper() if word else ""
            if kind in _OPENS and not re.search(r"GOTO[FBC]?\s", text, re.IGNORECASE):
                around.append(reader.last.offset)
            elif kind in _OPENS.values() and around:
                around.pop()
    finally:
        reader.close()
    return _Map(marks, sections)


def without_comment(text: str) -> str:
    """Return a line without the comment behind ; outside of quotes."""
    at, quoted = 0, False
    for at, letter in enumerate(text):
        if letter == '"':
            quoted = not quoted
        elif letter == ";" and not quoted:
            return text[:at]
    return text


def is_flow(word: str) -> bool:
    """Return True for a word of the control flow, such as WHILE."""
    return bool(_FLOW.fullmatch(word))


def program_name(text: str) -> str:
    """Return the name of a program in capitals, without the prefix _N_ and the suffix _SPF or .SPF.

    Raises BlockError for a path.
    """
    match = _PROGRAM_NAME.match(text.strip())
    if not match:
        raise BlockError(
            f'"{text}" is no name of a program beside this one: folders are not searched, copy the file here', text
        )
    return match[1].upper()
