"""What the name and the unit of a channel say: quantity, set or measured, motor or load, which axis.

Names are cut into words at marks, digits and capitals: `joint.0.motor-pos-cmd` is joint, 0, motor, pos, cmd.  A unit
that is known decides about the quantity; the words decide where there is none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from feeddrive.files.columns import COUNTS, unit_of
from feeddrive.files.roles import ROLES
from feeddrive.language import units
from feeddrive.language.errors import ParameterError

_SET = {"cmd", "command", "commanded", "set", "setpoint", "ref", "reference", "demand", "target", "soll", "sollwert",
        "desired", "des", "setpos", "setvelo", "refx", "refy"}  # fmt: skip
_MOTOR = {"motor", "mot", "mtr", "rotor", "enc1", "encoder1", "rotary", "mx"}
_LOAD = {"load", "table", "linear", "scale", "slide", "arm", "enc2", "encoder2", "tool", "last", "tisch"}
_OUTER = {"load", "cutting", "process", "external", "outer", "disturbance", "kistler", "dynamometer"}
_ERROR = {"error", "err", "ferror", "diff", "difference", "deviation", "posdiff", "lag", "schleppabstand",
          "schleppfehler", "regelabweichung", "abweichung", "fehler"}  # fmt: skip
_MEASURED = {"fb", "feedback", "act", "actual", "ist", "measured", "meas"}
_WORDS = {
    "excitation": {"excitation", "exc", "dither", "prbs", "chirp", "multisine", "injection", "perturbation"},
    "torque": {"torque", "trq", "moment", "drehmoment", "tau"},
    "current": {"current", "curr", "cur", "strom", "iq", "isq"},
    "force": {"force", "kraft"},
    "acceleration": {"acceleration", "acc", "accel", "beschleunigung"},
    "speed": {"omega", "rpm", "drehzahl"},
    "velocity": {"velocity", "vel", "velo", "speed", "geschwindigkeit"},
    "angle": {"theta", "phi", "angle", "winkel"},
    "position": {"position", "pos", "lage", "weg", "stroke", "displacement", "setpos", "actpos"},
    "command": {"command", "output", "vir", "voltage", "control", "ctrl", "dac", "u"},
}
# names that are known as they stand
_EXACT = {
    "qg": "setpoint_position", "qm": "position_load", "vir": "command", "set_position": "setpoint_position",
    "reading_load": "position_load", "reading_motor": "position_motor",
}  # fmt: skip
_QUANTITY_OF_UNIT = {"m": "position", "m/s": "velocity", "m/s2": "acceleration", "N": "force", "N m": "torque",
                     "A": "current", "V": "command", "rad": "angle", "rad/s": "speed"}  # fmt: skip
# German compounds with set or actual before or behind: Sollposition, Lageistwert
_BEHIND = re.compile(r"(soll|ist)wert")
_BEFORE = re.compile(
    r"(?<![a-zäöü])(soll|ist)(?=position|lage|weg|winkel|geschwindigkeit|drehzahl|beschleunigung|kraft|drehmoment|moment|strom)",
    re.IGNORECASE,
)
_AXIS = re.compile(r"(?:joint|axis|achse|ax|j)[ ._-]*([0-9]{1,2}|[xyzabc])(?![a-z])", re.IGNORECASE)
_SHORT = re.compile(r"(u|v|i|iq|f|pos|vel)_?([xyz])")


@dataclass(frozen=True)
class Reading:
    """What a name says. `exact` is a role that is known by the name itself."""

    quantity: str = ""
    is_set: bool = False
    side: str = ""
    axis: str = ""
    unit: str = ""
    exact: str = ""
    why: str = ""

    @property
    def is_weak(self) -> bool:
        """True for a command that is only a set value of something, which an `output` is before."""
        return self.quantity == "command" and self.is_set

    @property
    def role_like(self) -> bool:
        """True if it may stand for anything at all."""
        return bool(self.quantity or self.exact)


def words_of(name: str) -> list[str]:
    """The words of a name, in small letters."""
    cut = _BEFORE.sub(r"\1 ", _BEHIND.sub(r" \1", re.sub(r"([a-zäöü])([A-Z])", r"\1 \2", name)))
    return [word.lower() for word in re.findall(r"[A-Za-zÄÖÜäöü]+[0-9]?|[0-9]+", cut)]


def read_name(name: str, unit: str) -> Reading:
    """What the name and the unit of a channel say."""
    words = words_of(name)
    unit, bare = (unit, words) if unit else _unit_at_the_end(name, words)
    axis = _axis(name, bare)
    if name in ROLES:
        return Reading(exact=name, unit=unit, why="its name is a role")
    if name.lower() in _EXACT:
        return Reading(exact=_EXACT[name.lower()], axis=axis, unit=unit, why="a usual name")
    if _ERROR & set(bare) or bare[-1:] == ["f", "error"]:
        return Reading(axis=axis, unit=unit, why="a difference, which follows from others")
    is_set = bool(_SET & set(bare))
    side = "motor" if _MOTOR & set(bare) else "load" if _LOAD & set(bare) else ""
    by_words = _by_words(name, bare)
    by_unit = _by_unit(unit)
    quantity = by_unit or by_words
    if by_unit == "command" and by_words in ("current", "torque", "excitation"):
        quantity = by_words
    if (
        quantity in ("", "command")
        and axis
        and by_words != "command"
        and (is_set or _MEASURED & set(bare) or bare == [axis])
    ):
        quantity = "position"  # x, x_cmd, y_fb
    if bare[:1] == ["pid"] and "output" not in bare and {"command", "feedback"} & set(bare):
        quantity = "position"  # pid.x.command and pid.x.feedback are what the loop compares
    if by_words == "excitation":
        quantity, is_set = "excitation", False
    if quantity == "force":
        side = "load" if _OUTER & set(bare) else "motor"
    if unit == "percent" and by_words not in ("torque", "current"):
        quantity = "command" if by_words in ("command", "force") or is_set else ""
    if not quantity:
        return Reading(axis=axis, unit=unit)
    why = f"{'set ' if is_set else ''}{quantity}{' of the ' + side if side and quantity != 'force' else ''}"
    return Reading(quantity, is_set, side, axis, unit, "", f"{why}, by its {'unit' if by_unit else 'name'}")


def unit_in_name(name: str) -> str:
    """The unit that a name ends with, `pos_act_mm`, `force_N`: one letter only if it measures what the name says.

    `u_in` is an input and no inch.
    """
    found = _unit_at_the_end(name, [])[0]
    if found:
        return found
    last = name.rpartition("_")[2]
    return last if last in {"force": "N", "position": "m", "current": "A"}.get(read_name(name, "").quantity, ()) else ""


def _unit_at_the_end(name: str, words: list[str]) -> tuple[str, list[str]]:
    """The unit that a name ends with, `x_cmd_mm`, and its other words; a single letter is none, nor is `in`."""
    for start in [k + 1 for k, letter in enumerate(name) if letter in "_ "]:
        end = name[start:].replace(" ", "_")
        found = unit_of(re.sub(r"^(u?m?m|rad|deg)_(s2?)$", r"\1/\2", end))  # rad_s is rad/s in a name
        if found and len(end) > 1 and end != "in":
            return found, words_of(name[:start])
    return "", words


def _axis(name: str, words: list[str]) -> str:
    """The axis that a name is about: `joint.0` -> 0, `x_cmd` -> x, `ux` -> x."""
    found = _AXIS.search(name)
    if found:
        return found[1].lower()
    single = [word for word in words if word in ("x", "y", "z")]
    if single:
        return single[0]
    short = _SHORT.fullmatch(name.lower())
    return short[2] if short else ""


def _by_words(name: str, words: list[str]) -> str:
    """The quantity that the words of a name stand for; `command` only if nothing else does."""
    for quantity, known in _WORDS.items():
        if known & set(words):
            return quantity
    short = _SHORT.fullmatch(name.lower())
    if short:
        return {"u": "command", "v": "velocity", "i": "current", "iq": "current", "f": "force"}.get(short[1], "")
    return ""


def _by_unit(unit: str) -> str:
    """The quantity that a unit measures."""
    if unit.lower() in COUNTS:
        return "position"
    for known, quantity in _QUANTITY_OF_UNIT.items():
        try:
            units.factor(unit, known)
        except ParameterError:
            continue
        return quantity if unit else ""
    return ""
