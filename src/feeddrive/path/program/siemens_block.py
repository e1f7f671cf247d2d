"""The words of a block of a SINUMERIK program.

X10   X=R1*2   X=AC(10)   CR=5   A3=0.1        values: behind = where the word ends with a letter and more
G1   M3   TRANS   CSPLINE   MCALL              codes and keywords
R1=10   POCKET(3)   L100 P2   MSG("..")        assignments, calls, messages
"""

from __future__ import annotations

import re
from typing import NamedTuple

from feeddrive.language.quantity import Quantity
from feeddrive.path.program import blocks
from feeddrive.path.program.blocks import AXES, BlockError
from feeddrive.path.program.moves import Orientation
from feeddrive.path.program.siemens_flow import Call, SiemensFlow, is_flow, program_name
from feeddrive.path.program.siemens_splines import BEGINS, ENDS, KINDS
from feeddrive.path.program.siemens_words import IGNORED, Values, ignored_g, refusal
from feeddrive.path.program.state import Emit

SYSTEMS = {54: 1, 55: 2, 56: 3, 57: 4, 505: 5, 506: 6, 507: 7, 508: 8, 509: 9}
"""The number of each settable offset by its G code."""
PATH_MODES = {60: "CANON_EXACT_STOP", **dict.fromkeys((64, 641, 642, 643, 644, 645), "CANON_CONTINUOUS")}
# groups of G codes of which one block has one at most
_GROUPS: dict[str, tuple[int, ...]] = {
    "motion": (0, 1, 2, 3),
    "plane": (17, 18, 19),
    "path": tuple(PATH_MODES),
    "offset": (*SYSTEMS, 500),
    "distance": (90, 91),
    "feed": (93, 94, 95),
    "unit": (70, 71, 700, 710),
    "once": (4, 9, 53, 110, 111, 112, 153),
    "radius": (40, 41, 42),
    "corner": (450, 451),
    "other": (97,),
}
_GROUP = {code: group for group, codes in _GROUPS.items() for code in codes}
CURVES = {"CIP", "POLY", *KINDS}
"""The keywords of curves, which are modal as G0 to G3 are."""
ORIENTATIONS: dict[str, Orientation] = {
    **dict.fromkeys(("ORIAXES", "ORIMKS"), "axes"),
    **dict.fromkeys(("ORIVECT", "ORIPLANE", "ORIWKS"), "plane"),
}
"""How the tool turns between two directions, by the word that says it."""
_KEYWORDS = {"SUPA", "FNORM", "DIAMOF", "RET", "STOPRE", "NORM", "KONT", "MCALL", *ORIENTATIONS, *BEGINS, *ENDS}
_WITH_ARGUMENTS = {"MSG", "CYCLE832", "CYCLE800", "CALL", "EXTCALL", "TRAORI", "TRAFOOF"}
_FRAMES = {"TRANS", "ATRANS", "ROT", "AROT"}
VECTOR = ("A3", "B3", "C3")
"""The words of the direction of the tool, from its tip to the spindle."""
# what can stand before =, besides variables and R parameters
_WORDS = frozenset(
    {
        *(*AXES.upper(), *"IJKFSDT", "CR", "TURN", "AR", "AP", "RP", "I1", "J1", "K1", "CTOL", "OTOL", "ATOL"),
        *("RPL", "ADIS", "ADISPOS", "S1", "M1", "PL", "P", "DISC", "PW", "SD", *VECTOR),
    }
)
_ADDRESS = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+)(?:EX[+-]?\d+)?)", re.IGNORECASE)
_LETTER_NUMBER = re.compile(r"[A-Z]\d+")
_NAME = re.compile(r"[A-Z_$][A-Z0-9_]*", re.IGNORECASE)
_ASSIGNED = re.compile(r"([A-Z_$][A-Z0-9_]*)\s*(\[[^\]=]*\])?\s*=(?!=)", re.IGNORECASE)


class Placed(NamedTuple):
    """A value of a word: absolute (AC), incremental (IC), as G90 or G91 says (empty), or of a rotary axis (DC ...)."""

    value: float
    how: str = ""


class Words:
    """The words of one block: values by name, G codes by group, M codes, keywords, and calls."""

    def __init__(self) -> None:
        self.values: dict[str, Placed] = {}
        self.codes: dict[str, int] = {}
        self.m_codes: list[int] = []
        self.keywords: list[str] = []
        self.frames: list[str] = []
        self.polynomials: dict[str, list[float]] = {}
        self.tool: str | None = None
        self.call: Call | None = None
        self.high_speed: list[str] | None = None  # arguments of CYCLE832

    def take(self, name: str) -> float | None:
        """Remove a word that is always absolute, and return its value."""
        placed = self.values.pop(name, None)
        if placed is None:
            return None
        if placed.how:
            raise BlockError(f"{placed.how}() belongs to words of axes: write {name}= and the value", name)
        return placed.value


class BlockReader:
    """The reader of the words of a block."""

    def __init__(self, flow: SiemensFlow, emit: Emit) -> None:
        self._flow, self._emit = flow, emit

    def read(self, values: Values) -> Words:
        """Return the words of a line; messages and words that are left out are emitted at once."""
        words = Words()
        while values.skipped():
            self._word(values, words)
        return words

    def _word(self, values: Values, words: Words) -> None:
        text, at = values.text, values.at
        assigned = _ASSIGNED.match(text, at)
        if assigned and self._assignable(assigned[1].upper()):
            values.at = assigned.end()
            self._assign(values, words, assigned[1].upper(), assigned[2])
            return
        name = _NAME.match(text, at)
        keyword = name[0].upper() if name else ""
        # X1 is the axis X at 1; the axis X1 stands before = only
        if name and not _LETTER_NUMBER.fullmatch(keyword) and (reason := refusal(keyword)):
            raise values.fault(reason, at, keyword)
        if name and keyword in IGNORED:
            values.at = name.end()
            values.arguments()
            self._emit("IGNORED", keyword)
            return
        if name and self._keyword(values, words, keyword, name.end()):
            return
        address = _ADDRESS.match(text, at)
        if name and (not address or re.fullmatch(r"L\d+", keyword)):
            self._subprogram(values, words, keyword, at)
            return
        if not address:
            raise values.fault("a word begins with a letter", at, text[at : at + 8])
        values.at = address.end()
        self._add(values, words, address[1].upper(), Placed(_number(address[2])), at)

    def _subprogram(self, values: Values, words: Words, name: str, at: int) -> None:
        """Read the call of a subprogram: its name and its arguments."""
        if is_flow(name):
            raise values.fault(f"{name} stands at the beginning of a line: use two lines", at, name)
        if len(name) == 1:
            raise values.fault(f"the word {name} has no value: write {name}1 or {name}=1", at, name)
        if name.startswith("$"):
            raise values.fault(f"the system variable {name} is a value: it stands behind =", at, name)
        try:
            self._flow.check_known(name)
        except BlockError as fault:
            raise values.fault(f"the word {name} is not known here, and {fault.reason}", at, name) from None
        if words.call:
            raise values.fault(f"{words.call.name} and {name} are called in one block: use two lines", at, name)
        values.at = at + len(name)
        words.call = Call(name, tuple(values.tokens()))

    def _assignable(self, name: str) -> bool:
        if name in _WORDS or name == "PO" or self._flow.is_variable(name):
            return True
        return name.startswith("$") or bool(refusal(name))

    def _assign(self, values: Values, words: Words, name: str, index: str | None) -> None:
        at = values.at
        if reason := refusal(name):
            raise values.fault(reason, at, name)
        if name == "PO":
            letter = (index or "").strip("[] ").upper()
            if letter not in tuple("XYZABCUVW"):
                raise values.fault(
                    "a polynomial belongs to an axis: write PO[X]=(end,a2,a3); denominators are not read"
                )
            words.polynomials[letter] = values.arguments()
        elif name == "T":
            string = values.string()
            words.tool = string if string is not None else f"{values.expression():g}"
        elif name.startswith("$"):
            raise values.fault(
                "setting and machine data cannot be written by what is planned: take the line out", at, name
            )
        elif name in _WORDS:
            how = values.placing()
            value = values.expression()
            if how:
                values.closing()
            self._add(values, words, {"S1": "S", "M1": "M"}.get(name, name), Placed(value, how), at)
        elif index is not None:
            raise values.fault("arrays are not read: use one variable for each", at, name)
        else:
            self._flow.assign(name, values.expression())

    def _keyword(self, values: Values, words: Words, keyword: str, end: int) -> bool:
        """Read a keyword with its arguments; return False if the name is none."""
        known = keyword in CURVES or keyword in _FRAMES or keyword in _KEYWORDS
        if not known and keyword not in _WITH_ARGUMENTS:
            return False
        values.at = end
        if keyword in _FRAMES:
            words.frames.append(keyword)
        elif known:
            words.keywords.append(keyword)
        elif keyword == "MSG":
            self._emit("MESSAGE", values.message())
        elif keyword == "CYCLE832":
            words.high_speed = values.tokens()
        elif keyword in ("CALL", "EXTCALL"):
            bracket = values.skipped().startswith("(")
            values.at += bracket
            name = values.string()
            if name is None:
                raise values.fault(f'{keyword} needs the name of a program in quotes, such as {keyword} "POCKET"')
            if bracket:
                values.closing()
            at = values.at
            self._subprogram(values, words, program_name(name), at)
            values.at = at
        else:
            arguments = [argument for argument in values.tokens() if argument]
            if keyword == "CYCLE800" and arguments:
                raise values.fault(refusal("TOROT"), word="CYCLE800")
            if keyword == "TRAORI" and arguments not in ([], ["1"]):
                raise values.fault(
                    "TRAORI has the number 1 or none: the axes of the machine are those of [kinematics]", word="TRAORI"
                )
            if keyword != "CYCLE800":
                words.keywords.append(keyword)
        return True

    def _add(self, values: Values, words: Words, letter: str, placed: Placed, at: int) -> None:
        if letter == "G":
            code = round(placed.value)
            if reason := refusal(f"G{placed.value:g}"):
                raise values.fault(reason, at, f"G{placed.value:g}")
            if ignored_g(code):
                self._emit("IGNORED", f"G{code}")
                return
            group = _GROUP.get(code) if code == placed.value else None
            if group is None:
                raise values.fault("there is no such code here", at, f"G{placed.value:g}")
            if group in words.codes and group != "other":
                raise values.fault(
                    f"G{words.codes[group]} and G{code} exclude each other: use two lines", at, f"G{code}"
                )
            words.codes[group] = code
        elif letter == "M":
            words.m_codes.append(round(placed.value))
        elif letter == "T":
            words.tool = f"{placed.value:g}"
        elif letter in ("H", "Q", "E", "O"):
            raise values.fault(refusal(letter), at, letter)
        elif letter in words.values:
            raise values.fault(f"the word {letter} stands twice in this block: split the line", at, letter)
        elif not abs(placed.value) <= blocks.LARGEST:
            raise values.fault(f"a word is at most {Quantity(blocks.LARGEST)}", at, letter)
        else:
            words.values[letter] = placed


def _number(text: str) -> float:
    """Return the value of a number, whose exponent is EX."""
    return float(re.sub("EX", "e", text, flags=re.IGNORECASE))
