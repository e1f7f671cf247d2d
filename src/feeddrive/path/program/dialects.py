"""Dialects of part programs: what a line means in the language of another controller, as a line of RS-274/NGC.

linuxcnc  RS-274/NGC itself
grbl      the codes of Grbl 1.1; $H homes, other lines with $ set the controller and are left out
marlin    3D printers (Marlin and its relatives): E is the axis U, G0 moves at the feed, temperatures are left out
siemens   SINUMERIK controls, whose programs have an interpreter of their own (`siemens.py`)

A rewritten line keeps its columns where it can.  A code that a dialect does not have is refused.
"""

import re
from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

from feeddrive.path.program.blocks import BlockError

DialectName = Literal["linuxcnc", "grbl", "marlin", "siemens"]
FrontEnd = Literal["auto", "own", "rs274"]
FRONT_ENDS: tuple[FrontEnd, ...] = get_args(FrontEnd)
"""The readers of programs: `own`, or LinuxCNC's `rs274`; `auto` takes the one that fits."""


class Rewritten(NamedTuple):
    """What a line of a dialect means.

    text      the line in RS-274/NGC; empty if nothing is left of it
    ignored   name of a code that moves nothing and is left out
    home      letters of the axes that go to the machine's zero
    extruder  True or False for an extruder (E) in incremental or absolute coordinates from here on
    """

    text: str
    ignored: str = ""
    home: str = ""
    extruder: bool | None = None


_CODE = re.compile(r"\s*(?:N\d+\s*)?([GMT])\s*(\d+(?:\.\d+)?)", re.IGNORECASE)


def _numbers(*groups: int | range) -> frozenset[str]:
    return frozenset(str(n) for group in groups for n in (group if isinstance(group, range) else (group,)))


# temperatures, fans, settings of the printer, its display and its memory card
_MARLIN_IGNORED = {
    "M": _numbers(
        *(17, 18, range(20, 30), 31, 42, 73, range(75, 79), 80, 81, range(84, 87), 92, 104, 105, 106, 107, 108),
        *(range(110, 116), range(117, 122), 123, 126, 127, 140, 141, 144, 145, 150, 154, 155, range(200, 206)),
        *(207, 208, 209, 211, 250, 256, 280, 300, 301, 302, range(303, 306), 350, 355, range(401, 408)),
        *(range(412, 415), 420, 425, 486, range(500, 505), 569, 572, 593, 900, 906, 907, 908, range(911, 918)),
    ),
    "G": _numbers(29, 80, 31, 32),
}
# they wait for a temperature, for the end of the motion or for the operator
_MARLIN_STOPS = _numbers(0, 1, 109, 116, 190, 191, 192, 226, 303, 400, 600, 601)
_MARLIN = {"G": _numbers(*range(5), 17, 18, 19, 20, 21, 90, 91, 92), "M": _numbers(2, 3, 4, 5)}
_MARLIN_REFUSED = {
    "G10": "the length of a retraction is a setting of the printer: let the slicer write it with E",
    "G11": "the length of a retraction is a setting of the printer: let the slicer write it with E",
    "M206": "it shifts the zero of the printer: write G92",
    "M851": "it shifts the zero of the printer: write G92",
    "M220": "it scales all feeds: write S100, and give --override",
    "M221": "it scales what is extruded: write S100, and scale E in the slicer",
}
_EXTRUDED = re.compile(r"E(?=\s*[-+]?[\d.])", re.IGNORECASE)
_DWELL = re.compile(r"([PS])\s*(\d*\.?\d*)", re.IGNORECASE)


def _marlin(text: str) -> Rewritten:
    plain = text.partition(";")[0]
    # the sum of a line that came over a serial port
    plain = re.sub(r"\*\s*\d+\s*$", lambda match: " " * len(match[0]), plain)
    match = _CODE.match(plain)
    if not match:
        return Rewritten(_EXTRUDED.sub("U", plain))
    letter, number = match[1].upper(), match[2].lstrip("0") or "0"
    name, rest = letter + number, plain[match.end() :]
    if letter == "T":
        return Rewritten(f"{plain} M6")
    if name in ("M220", "M221") and re.fullmatch(r"\s*S\s*100(\.0*)?\s*", rest, re.IGNORECASE):
        return Rewritten("", name)
    if name in _MARLIN_REFUSED:
        raise BlockError(_MARLIN_REFUSED[name], name)
    if letter == "M" and number in _MARLIN_STOPS:
        return Rewritten("M0", "" if number in ("0", "1") else name)
    if name in ("M82", "M83"):
        return Rewritten("", extruder=name == "M83")
    if name == "M30":
        return Rewritten("M2")
    if name == "G28":
        named = "".join(axis for axis in "XYZ" if axis in rest.upper())
        return Rewritten("", home=named or "XYZ")
    if name == "G4":
        seconds = _DWELL.search(rest)
        scale = "1000" if seconds and seconds[1].upper() == "P" else "1"
        return Rewritten(f"G4 P[{seconds[2] or 0}/{scale}]" if seconds else "G4 P0")
    if number in _MARLIN_IGNORED[letter]:
        return Rewritten("", name)
    if number not in _MARLIN[letter]:
        raise BlockError("the dialect marlin has no such code here: take it out, or give the right --dialect", name)
    if name == "G0":
        start = match.start(2)
        plain = f"{plain[: match.end() - 1]}1{plain[match.end() :]}" if start else plain
    if name == "G92" and not rest.strip():
        return Rewritten("G92 X0 Y0 Z0 U0")
    return Rewritten(_EXTRUDED.sub("U", plain))


_GRBL_G = (
    "0 1 2 3 4 10 17 18 19 20 21 28 28.1 30 30.1 38.2 38.3 38.4 38.5 40 43.1 49 53 54 55 56 57 58 59 61 80 90 91 "
    "91.1 92 92.1 93 94"
)
_GRBL = {"G": frozenset(_GRBL_G.split()), "M": _numbers(0, 1, 2, 30, 3, 4, 5, 7, 8, 9)}
_ANY_CODE = re.compile(r"([GM])\s*0*(\d+(?:\.\d+)?)", re.IGNORECASE)


def _grbl(text: str) -> Rewritten:
    plain = re.sub(r"\([^)]*\)", lambda match: " " * len(match[0]), text.partition(";")[0])
    if plain.strip().startswith("$"):
        setting = plain.strip().split()[0].upper()
        if setting == "$H":
            return Rewritten("", home="XYZ")
        if setting.startswith(("$J", "$N")):
            raise BlockError("it moves the machine from a setting: write the move into the program", setting)
        return Rewritten("", setting)
    for match in _ANY_CODE.finditer(plain):
        if match[2] not in _GRBL[match[1].upper()]:
            raise BlockError(
                "the dialect grbl has no such code: take it out, or give --dialect linuxcnc",
                f"{match[1].upper()}{match[2]}",
                column=match.start() + 1,
            )
    if "#" in plain or "[" in plain or (plain.lstrip()[:1] in "oO" and plain.strip()):
        raise BlockError("the dialect grbl has no parameters, expressions and o-words: give --dialect linuxcnc", "")
    # a tool word is read by Grbl and does nothing
    return Rewritten(text)


DIALECTS: dict[str, Callable[[str], Rewritten] | None] = {
    "linuxcnc": None,
    "grbl": _grbl,
    "marlin": _marlin,
    "siemens": None,
}
"""The function that rewrites a line of a dialect, by its name; None for one that is not rewritten line by line."""
