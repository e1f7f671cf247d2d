"""Words of SINUMERIK programs that are not planned, with the reason, and the expressions that are values of words.

Operators from the strongest to the weakest, each from left to right: NOT B_NOT; * / DIV MOD; + -; B_AND; B_XOR; B_OR;
AND; XOR; OR; == <> > < >= <=.  Comparisons bind weakest on the control, which reads `A==1 AND B==1` as
`A==(1 AND B)==1`: such a condition is refused, with the parentheses that it needs.
"""

import math
import operator
import re
from collections.abc import Callable

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import DEEPEST, BlockError

_FIVE = "this way to orient the tool or the workpiece is not planned: write A3= B3= C3=, or the letters of rotary axes"
_NORMAL = "angles to the path and to the normal of a surface are not planned: write A3= B3= C3= of each block"
_CONE = "a tool that turns on a cone is not planned: write A3= B3= C3= in short blocks"
_LATHE = "lathe work is not planned: only milling with X, Y and Z as they stand"
_SPLINE = "splines of other axes than X Y Z are not planned: post lines, arcs or POLY"
_SPINDLE = "the move follows the real spindle: take it out of what is planned"
_CYCLE = "cycles of the control are not read: let the CAM system write their moves"
_CALL = "this call is not read: write the name of the subprogram, CALL or a loop"
_FEED = "the feed changes along a move: write a feed for each of them"
_CORNER = "a rounding or chamfer that the control inserts is not planned: write its arc or line"
_FRAME = "frames that scale or mirror are not planned: post the coordinates as they are moved"
_MACHINE = "the place is a datum of the machine: write the move, with SUPA in machine coordinates"
_COMPENSATION = "this way to the contour or along it is not planned: write NORM, and lines or arcs"
_PLC = "what it does is decided by the machine's own logic: take it out"
_WORDS: dict[str, tuple[str, ...]] = {
    _FIVE: (
        *("ORICURVE", "ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIVIRT2", "ORISON", "ORIROTA", "ORIROTR"),
        *("ORIROTT", "ORIROTC", "THETA", "A2", "B2", "C2", "A8", "B8", "C8"),
        *("TOROT", "TOFRAME", "PAROT", "TCARR", "TCOABS", "TCOFR", "CUT3DC", "CUT3DF", "CUT3DFS"),
        *("CUT3DFF", "CUT3DCC", "CUT3DCCD", "TLIFT", "CYCLE996", "TRACON", "TRAFOON", "TRACYL", "TRAANG"),
    ),
    _NORMAL: ("LEAD", "TILT", "ORIPATH", "ORIPATHS", "A4", "B4", "C4", "A5", "B5", "C5"),
    _CONE: ("ORICONCW", "ORICONCCW", "ORICONIO", "ORICONTO", "NUT", "A6", "B6", "C6", "A7", "B7", "C7"),
    _LATHE: (
        "DIAMON",
        "DIAM90",
        "DIAMCYCOF",
        "TRANSMIT",
        "LIMS",
        "G96",
        "G961",
        "G962",
        "G971",
        "G973",
    ),
    _SPLINE: ("SPLINEPATH",),
    _SPINDLE: ("G33", "G34", "G35", "G63", "G331", "G332", "SPOS", "SPOSA", "SPCON", "COUPON", "FPR"),
    _CYCLE: ("HOLES1", "HOLES2", "POCKET1", "POCKET2", "POCKET3", "POCKET4", "SLOT1", "SLOT2", "LONGHOLE"),
    _CALL: ("PCALL", "ISOCALL", "MODALCALL", "REPEATB", "INIT", "START", "WAITE"),
    _FEED: ("FLIN", "FCUB", "FPO", "FRC", "FRCM", "FB", "FXS", "FGROUP", "FGREF", "FL", "FA", "OVR", "OVRRAP", "G93.1"),
    _CORNER: ("CHF", "CHR", "RND", "RNDM", "ANG"),
    _FRAME: (
        "SCALE",
        "ASCALE",
        "MIRROR",
        "AMIRROR",
        "CTRANS",
        "CROT",
        "CSCALE",
        "CMIRROR",
        "ROTS",
        "AROTS",
        "CROTS",
        "MEAFRAME",
    ),
    _MACHINE: ("G74", "G75", "G751", "FP"),
    _COMPENSATION: ("KONTC", "KONTT", "G140", "G147", "G148", "G247", "G248", "G347", "G348", "OFFN"),
    _PLC: (
        "H",
        "ID",
        "IDS",
        "WHEN",
        "WHENEVER",
        "FROM",
        "EVERY",
        "DO",
        "SYNFCT",
        "WAITM",
        "WAITMC",
        "SETM",
        "CANCEL",
        "Q",
        "E",
        "O",
    ),
    "the tangent of the move before is not used: write the center or the radius": ("CT",),
    "involutes are not planned: post lines or arcs": ("INVCW", "INVCCW"),
    "offsets in the program by G58 and G59 are not read: write TRANS": ("G58", "G59"),
    "limits of the working area and of the spindle are not changed by a program here: take it out": ("G25", "G26"),
    "the ISO dialect is another language: give the program with --dialect linuxcnc": ("G291",),
    "an array is not read: use one variable for each": ("SET", "REP"),
    "it belongs to the ISO dialect: write G700 for inches of lengths and feeds, G70 for those of lengths": ("G20",),
    "it belongs to the ISO dialect: write G710 for mm of lengths and feeds, G71 for those of lengths": ("G21",),
    "SAVE stands behind the name of a subprogram: PROC NAME SAVE": ("SAVE",),
    "what a probe measures is not known before: take it out": ("MEAS", "MEAW", "MEASA", "MEAWA", "MEAC"),
    "an axis of the machine's own: only X Y Z A B C U V W are planned": (
        *(f"{letter}{number}" for letter in "XYZUVWQ" for number in range(1, 6)),
        *("A1", "B1", "C1", "POS", "POSA", "POSP"),
    ),
}
_REASONS = {word: reason for reason, words in _WORDS.items() for word in words}

IGNORED = frozenset(
    (
        *("SOFT", "SOFTA", "BRISK", "BRISKA", "DRIVE", "DRIVEA", "FFWON", "FFWOF", "FIFOCTRL", "STARTFIFO", "STOPFIFO"),
        *(
            "COMPON",
            "COMPCURV",
            "COMPCAD",
            "COMPSURF",
            "COMPOF",
            "COMPPATH",
            "DYNNORM",
            "DYNPOS",
            "DYNROUGH",
            "DYNSEMIFIN",
        ),
        *("DYNFINISH", "DYNPREC", "UPATH", "SPATH", "CFC", "CFTCP", "CFIN", "RTLION", "RTLIOF", "ORISOF", "WALIMON"),
        *("WALIMOF", "CDOF", "CDON", "CDOF2", "WORKPIECE", "SETMS", "SBLOF", "SBLON"),
        *(
            "DISPLOF",
            "DISPLON",
            "GETT",
            "GROUP_BEGIN",
            "GROUP_END",
            "BSS",
            "CUT2D",
            "CUT2DF",
            "ORIRESET",
            "TOROTOF",
        ),
        *("PAROTOF", "TCOABSOF", "RPY", "MSG_OFF", "AUXFUDEL", "PRESETON_OFF"),
    )
)
"""Keywords that move nothing: shape of the acceleration, feedforward, compression, display, modes of what is off."""
_IGNORED_G = frozenset((290, 460, 461, 462, 601, 602, 603))


def ignored_g(code: int) -> bool:
    """Return True for a G code that changes nothing of the motion here."""
    return code in _IGNORED_G


def refusal(word: str) -> str:
    """Return the reason why a word is known but not planned; empty for any other word."""
    if re.fullmatch(r"CYCLE\d+|POCKET\d+|SLOT\d+|HOLES\d+|E_\w+", word) and word not in ("CYCLE832", "CYCLE800"):
        return _CYCLE
    return _REASONS.get(word, "")


_OF_ONE: dict[str, Callable[[float], float]] = {
    "SIN": lambda x: math.sin(math.radians(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "TAN": lambda x: math.tan(math.radians(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)),
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "SQRT": math.sqrt,
    "POT": lambda x: x * x,
    "ABS": abs,
    "TRUNC": lambda x: float(math.trunc(x)),
    # halves away from zero; Python's round would go to the even neighbor
    "ROUND": lambda x: float(math.floor(abs(x) + 0.5)) * math.copysign(1.0, x),
    "ROUNDUP": lambda x: float(math.ceil(x)),
    "LN": math.log,
    "EXP": math.exp,
}
_OF_TWO: dict[str, Callable[[float, float], float]] = {
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
    "MINVAL": min,
    "MAXVAL": max,
}
_BOUND = "BOUND"  # BOUND(low, high, x)
_FUNCTIONS = frozenset({*_OF_ONE, *_OF_TWO, _BOUND})


def _whole_division(a: float, b: float) -> float:
    return float(math.trunc(a / b))


def _rest(a: float, b: float) -> float:
    return math.fmod(a, b)


def _bits(of: Callable[[int, int], int]) -> Callable[[float, float], float]:
    return lambda a, b: float(of(int(a), int(b)))


_LEVELS: tuple[dict[str, Callable[[float, float], float]], ...] = (
    {
        "==": lambda a, b: float(a == b),
        "<>": lambda a, b: float(a != b),
        ">=": lambda a, b: float(a >= b),
        "<=": lambda a, b: float(a <= b),
        ">": lambda a, b: float(a > b),
        "<": lambda a, b: float(a < b),
    },
    {"OR": lambda a, b: float(bool(a) or bool(b))},
    {"XOR": lambda a, b: float(bool(a) != bool(b))},
    {"AND": lambda a, b: float(bool(a) and bool(b))},
    {"B_OR": _bits(operator.or_)},
    {"B_XOR": _bits(operator.xor)},
    {"B_AND": _bits(operator.and_)},
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "/": operator.truediv, "DIV": _whole_division, "MOD": _rest},
)
_LOGIC = ("OR", "XOR", "AND")
_TOKEN = [
    re.compile(
        "|".join(f"{re.escape(sign)}(?![A-Z0-9_])" if sign[0].isalpha() else re.escape(sign) for sign in level), re.I
    )
    for level in _LEVELS
]
_NUMBER = re.compile(r"(\d+\.?\d*|\.\d+)(EX[+-]?\d+)?", re.IGNORECASE)
_NAME = re.compile(r"[A-Z_$][A-Z0-9_]*", re.IGNORECASE)
_SPACE = re.compile(r"\s*")
_PLACING = re.compile(r"\s*(AC|IC|DC|ACP|ACN)\s*\(", re.IGNORECASE)


class Values:
    """The reader of the values in a line.

    text   the line without its comment
    at     index of the next character
    value  function that returns a variable by its name and its index, if it has one
    """

    def __init__(self, text: str, at: int, value: Callable[[str, str | None], float]) -> None:
        self.text, self.at = text.rstrip(), at
        self._value = value
        self._depth = 0

    def fault(self, reason: str, at: int | None = None, word: str = "") -> BlockError:
        """Return an error at an index, by default at the next character."""
        return BlockError(reason, word, column=(self.at if at is None else at) + 1)

    def skipped(self) -> str:
        """Skip white space, and return the rest of the line."""
        match = _SPACE.match(self.text, self.at)
        assert match is not None
        self.at = match.end()
        return self.text[self.at :]

    def whole(self) -> float:
        """Return the value of the whole text."""
        value = self.expression()
        if self.skipped():
            raise self.fault("an operator or the end is expected here")
        return value

    def expression(self) -> float:
        """Read an expression."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise self.fault(f"parentheses and signs lie more than {DEEPEST} deep: use a variable for a part of it")
        value = self._level(0)
        self._depth -= 1
        if not math.isfinite(value):
            raise self.fault("the value is not a finite number")
        return value

    def _level(self, level: int) -> float:
        if level == len(_LEVELS):
            return self._single()
        begin, value, count = self.at, self._level(level + 1), 0
        while True:
            self.skipped()
            match = _TOKEN[level].match(self.text, self.at)
            if not match or (match[0] == "<" and self.text.startswith("<<", self.at)):
                break
            self.at = match.end()
            count += 1
            other = self._level(level + 1)
            if level == 0:
                outside = re.sub(r"\([^()]*\)", "", self._flat(self.text[begin : self.at]))
                if count > 1 or re.search(rf"(?<![A-Z0-9_])({'|'.join(_LOGIC)})(?![A-Z0-9_])", outside, re.IGNORECASE):
                    raise self.fault("comparisons bind weaker than AND and OR: write parentheses around each", begin)
            try:
                value = _LEVELS[level][match[0].upper()](value, other)
            except ZeroDivisionError:
                raise self.fault("division by zero: check the divisor before", match.start()) from None
        return value

    @staticmethod
    def _flat(text: str) -> str:
        """Return a text without its inner parentheses."""
        while (inner := re.sub(r"\([^()]*\)", "", text)) != text:
            text = inner
        return text

    def _single(self) -> float:
        rest = self.skipped()
        if rest[:1] in ("+", "-"):
            self.at += 1
            self._depth += 1
            if self._depth > DEEPEST:
                raise self.fault(f"parentheses and signs lie more than {DEEPEST} deep: use a variable for a part of it")
            value = self._single()
            self._depth -= 1
            return -value if rest[0] == "-" else value
        if rest[:1] == "(":
            self.at += 1
            value = self.expression()
            self.closing()
            return value
        number = _NUMBER.match(self.text, self.at)
        if number:
            self.at = number.end()
            return float(re.sub("EX", "e", number[0], flags=re.IGNORECASE))
        name = _NAME.match(self.text, self.at)
        if not name:
            raise self.fault("a number, a variable or a function is expected here")
        begin, word = self.at, name[0].upper()
        self.at = name.end()
        if word == "NOT":
            return float(not self._single())
        if word == "B_NOT":
            return float(~int(self._single()))
        if word in _FUNCTIONS:
            return self._function(word, begin)
        index = re.compile(r"\s*\[([^\]]*)\]").match(self.text, self.at)
        if index:
            self.at = index.end()
        try:
            return self._value(word, index[1] if index else None)
        except BlockError as fault:
            raise self.fault(str(fault.reason), begin, word) from None

    def _function(self, word: str, begin: int) -> float:
        if not self.skipped().startswith("("):
            raise self.fault(f"{word} needs its argument in parentheses")
        arguments = self.arguments()
        try:
            if word in _OF_ONE and len(arguments) == 1:
                return _OF_ONE[word](arguments[0])
            if word in _OF_TWO and len(arguments) == 2:
                return _OF_TWO[word](arguments[0], arguments[1])
            if word == _BOUND and len(arguments) == 3:
                low, high, x = arguments
                return min(max(x, low), high)
            raise self.fault(f"{word} has another number of arguments than {len(arguments)}", begin, word)
        except ValueError:
            shown = ", ".join(f"{Quantity(value):6}" for value in arguments)
            raise self.fault(f"{word} has no value at {shown}", begin, word) from None

    def closing(self) -> None:
        """Read a closing parenthesis."""
        if not self.skipped().startswith(")"):
            raise self.fault("a closing parenthesis is expected here")
        self.at += 1

    def arguments(self) -> list[float]:
        """Read numbers in parentheses; an empty list if no parenthesis opens here."""
        if not self.skipped().startswith("("):
            return []
        self.at += 1
        values: list[float] = []
        while True:
            if self.skipped()[:1] in (",", ")"):
                values.append(0.0)
            elif self.skipped().startswith('"'):
                self.string()
                values.append(0.0)
            else:
                values.append(self.expression())
            if self.skipped().startswith(","):
                self.at += 1
                continue
            self.closing()
            return values

    def tokens(self) -> list[str]:
        """Read arguments in parentheses as text; an empty list if no parenthesis opens here."""
        if not self.skipped().startswith("("):
            return []
        parts, begin, depth, quoted = list[str](), self.at + 1, 0, False
        for k in range(self.at, len(self.text)):
            letter = self.text[k]
            quoted = quoted != (letter == '"')
            depth += 0 if quoted else {"(": 1, ")": -1}.get(letter, 0)
            if depth == 0 or (depth == 1 and letter == "," and not quoted):
                parts.append(self.text[begin:k].strip())
                begin = k + 1
            if depth == 0:
                self.at = k + 1
                return parts
        raise self.fault("a closing parenthesis is expected here", len(self.text))

    def string(self) -> str | None:
        """Read a text in quotes; None if none begins here."""
        if not self.skipped().startswith('"'):
            return None
        end = self.text.find('"', self.at + 1)
        if end < 0:
            raise self.fault('a closing " is expected', len(self.text))
        found = self.text[self.at + 1 : end]
        self.at = end + 1
        return found

    def message(self) -> str:
        """Read the text of MSG("..."): texts and values joined by <<."""
        if not self.skipped().startswith("("):
            return ""
        self.at += 1
        parts: list[str] = []
        while not self.skipped().startswith(")"):
            string = self.string()
            parts.append(string if string is not None else f"{self.expression():g}")
            if self.skipped().startswith("<<"):
                self.at += 2
            elif self.skipped().startswith(","):
                self.at += 1
                self.expression()
        self.closing()
        return "".join(parts)

    def placing(self) -> str:
        """Read AC(, IC( and the like before a value; empty for none."""
        match = _PLACING.match(self.text, self.at)
        if not match:
            return ""
        self.at = match.end()
        return match[1].upper()
