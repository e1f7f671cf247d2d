"""Columns of numbers as frequency responses: the role of each column by its name and unit.

    f_Hz, re, im [, coherence] [, variance]        one response
    f_Hz, re_Gm, im_Gm, re_Gl, im_Gl several, by the rest of the names
    f_Hz, magnitude_dB, phase_deg [, coherence]    a magnitude in dB or as plain ratio, a phase in deg or rad

A unit may stand in brackets or at the end of a name; that of a response is output over input (`re_rad_per_A`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from feeddrive.files.columns import Columns, unit_of
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError, nearest

_KINDS = {
    "re": ("real", "re", "r"),
    "im": ("imaginary", "imaginär", "imag", "im", "i"),
    "magnitude": ("magnitude", "mag", "amplitude", "amp", "gain", "abs", "betrag"),
    "phase": ("phase", "phi", "angle", "arg", "pha", "phasenwinkel", "winkel"),
    "coherence": ("coherence", "coh", "gamma2", "kohärenz", "kohaerenz"),
    "variance": ("variance", "var", "varianz"),
}
_FREQUENCY = re.compile(r"(f|fr|freq|frequency|frequenz|omega|w)", re.IGNORECASE)
_PLAIN = ("", "1", "-")
# words of a unit that are not SI, and their meaning
_SI = {"deg": "rad", "rev": "rad", "t": "kg", "g": "kg", "in": "m", "min": "s", "h": "s"}


@dataclass
class Response:
    """The columns of one response, and the unit of its numbers as the file states it."""

    name: str
    places: dict[str, str] = field(default_factory=dict[str, str])
    unit: str = ""
    stated: str = ""
    factor: float = 1.0
    decibel: bool = False
    degrees: bool | None = None


@dataclass(frozen=True)
class Named:
    """The parts of a column's name."""

    kind: str
    name: str
    unit: str
    decibel: bool
    degrees: bool | None


def named(column: str, unit: str) -> Named | None:
    """Return kind, name of the response and unit of a column; None if it does not belong to a response.

    `Re_Pv1`, `ReGm_rad_per_A`, `Gm.real`, `mag(dB)`, `phase_deg`, `coherence_y`
    """
    rest, decibel, degrees = column.strip(), False, None
    if unit.lower() == "db" or re.search(r"[\s_.(\[]dB[)\]]?$|^dB$", rest):
        rest, unit, decibel = re.sub(r"[\s_.]*[(\[]?dB[)\]]?$", "", rest) or "magnitude", "", True
    if not unit:
        for start in [k + 1 for k, letter in enumerate(rest) if letter in "_ "]:
            known = unit_of(rest[start:])
            if known and ("per" in known or known in ("deg", "rad")):  # of one word it is a name: re_m, re_l
                rest, unit = rest[: start - 1], known
                break
    kind, name = _kind(rest)
    if kind is None:
        return None
    if kind == "phase":
        degrees, unit = {"deg": True, "rad": False}.get(unit), ""
    return Named(kind, name, "" if unit in _PLAIN else unit, decibel, degrees)


def _kind(rest: str) -> tuple[str | None, str]:
    """Return the kind that a name begins or ends with, and the rest of the name."""
    for kind, words in _KINDS.items():
        for word in words:
            if rest.lower() == word or rest == f"|{word}|":
                return kind, ""
            bars = re.fullmatch(r"\|([^|]+)\|", rest)
            if kind == "magnitude" and bars is not None:  # |G|
                return kind, bars[1]
            short = len(word) < 3
            start = re.match(rf"(?i:{word})(?=[\s_.\-\[(]|$)", rest) or (
                None if len(word) == 1 else re.match(rf"{word.capitalize()}(?=[A-Z])|{word}(?=[A-Z])", rest)
            )
            if start is not None:
                return kind, rest[start.end() :].strip(" _.-[]()")
            end = re.search(rf"(?<=[\s_.\-])(?i:{word})$", rest)
            if end is not None and not (short and len(word) == 1 and "_" not in rest):
                return kind, rest[: end.start()].strip(" _.-")
    return None, rest


def frequency_of(name: str, columns: Columns) -> tuple[str, np.ndarray]:
    """Return the column of frequency in Hz, and its name. Raise LogError if there is none or several."""
    candidates: list[tuple[str, str]] = []
    for column in columns.values:
        unit = columns.units.get(column, "")
        word = column
        for start in [k + 1 for k, letter in enumerate(column) if letter == "_" and not unit]:
            unit = unit_of(column[start:]) or ""
            if unit:
                word = column[: start - 1]
                break
        if _FREQUENCY.fullmatch(word.strip()) or _is_frequency(unit):
            candidates.append((column, unit))
    if len(candidates) != 1:
        there = ", ".join(f"'{column[:40]}'" for column in [*columns.values][:12])
        what = "no column of frequency" if not candidates else f"{len(candidates)} columns of frequency"
        raise LogError(
            f"{name}: has {what} among {there}; name the columns of a file without heads, as in  "
            "columns = ['f_Hz', 're', 'im', 'coherence']  or  ['f_Hz', 'magnitude_dB', 'phase_deg']"
        )
    column, unit = candidates[0]
    if not unit:
        unit = "rad/s" if column.strip().lower() in ("omega", "w") else "Hz"
    try:
        return column, columns.values[column] * units.factor(unit, "Hz")
    except ParameterError:
        raise LogError(
            f"{name}: the frequency '{column}' is in '{unit}', which is no unit of it; Hz or rad/s"
        ) from None


def _is_frequency(unit: str) -> bool:
    try:
        units.factor(unit, "Hz")
    except ParameterError:
        return False
    return True


def responses_of(name: str, columns: Columns, frequency: str) -> list[Response]:
    """Return the responses in the columns, each with those that it needs. Raise LogError for an incomplete one."""
    responses: dict[str, Response] = {}
    for column in columns.values:
        if column == frequency:
            continue
        taken = named(column, columns.units.get(column, ""))
        if taken is None:
            continue
        response = responses.setdefault(taken.name, Response(taken.name))
        if taken.kind in response.places:
            both = f"'{response.places[taken.kind]}' and '{column}'"
            raise LogError(f"{name}: {both} are both the {taken.kind} of one response; name the columns")
        response.places[taken.kind] = column
        if taken.kind == "im" and taken.unit and response.stated not in ("", taken.unit):
            raise LogError(f"{name}: '{column}' is in '{taken.unit}', its real part in '{response.stated}'")
        if taken.kind in ("re", "magnitude"):
            response.decibel = taken.decibel
            response.stated = taken.unit
            response.unit, response.factor = in_si(name, column, taken.unit)
        if taken.kind == "phase":
            response.degrees = taken.degrees
    _share(responses)
    whole = [
        response
        for response in responses.values()
        if {"re", "im"} <= set(response.places) or "magnitude" in response.places
    ]
    if not whole:
        raise LogError(
            f"{name}: no column is the real and imaginary part, or the magnitude, of a response"
            f"{nearest('re', columns.values)}; name them, as in  columns = ['f_Hz', 're', 'im', 'coherence']"
        )
    for complete in whole:
        if not {"re", "im"} <= set(complete.places) and "phase" not in complete.places:
            raise LogError(
                f"{name}: '{complete.places['magnitude']}' is a magnitude without a phase; margins need both: export "
                "the phase too, or real and imaginary part"
            )
    return whole


def in_si(name: str, column: str, unit: str) -> tuple[str, float]:
    """Return the unit in SI, and the factor to it: um/N is m/N times 1e-6. Raise LogError for text that is no unit."""
    if not unit:
        return "", 1.0
    try:
        known = units.response(unit)
    except ParameterError:
        known = None
    if known is not None:
        return known
    words: list[str] = []
    for word in re.split(r"([ _/]|per)", unit):
        base = re.fullmatch(r"[GMkcmun]?(m|s|A|rad|N|W|J|V|Hz)(\d?)", word)
        if word == "rpm" or word == "percent":
            raise LogError(f"{name}: column '{column}' is in '{unit}'; give the response in SI, as m/N or rad/A")
        words.append(base[1] + base[2] if base else _SI.get(word, word))
    plain = re.sub(r"[ _]*(per|/)[ _]*", "/", "".join(words)).replace("_", " ")
    try:
        return plain, units.factor(unit, plain)
    except ParameterError as error:
        raise LogError(f"{name}: column '{column}': {error}; give the response in SI, as m/N or rad/A") from None


def _share(responses: dict[str, Response]) -> None:
    """Give a coherence or variance without a name to the only response."""
    nameless = responses.get("")
    others: Iterable[Response] = [
        response for key, response in responses.items() if key and "coherence" not in response.places
    ]
    if nameless is not None and not {"re", "magnitude"} & set(nameless.places):
        holders = [response for response in others if {"re", "magnitude"} & set(response.places)]
        if len(holders) == 1:
            holders[0].places = {**nameless.places, **holders[0].places}
            del responses[""]
