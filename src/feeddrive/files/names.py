"""The interpretation of channel names and units: quantity, set or measured value, motor or load, and axis.

A name is split into words at punctuation, digits and capitals: `joint.0.motor-pos-cmd` is joint, 0, motor, pos, cmd;
`X1_DCBusVoltage` is x1, dc, bus, voltage.  A known unit determines the quantity; otherwise the words do.

Axes are determined from all names together (`axes_of`), since `x1` and `x2` may be the two encoders of one axis:
prefixes such as `X1_` and `Y1_` name axes if the same words follow different letters.

Names with a fixed meaning are those documented by manufacturers: LinuxCNC (HAL pins), SINUMERIK (trace variables
nckServoData...), HEIDENHAIN (oscilloscope of the iTNC 530), TwinCAT, CiA 402 (EPOS Studio), ODrive.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from feeddrive.files.columns import COUNTS, ROLES, unit_of
from feeddrive.language import units
from feeddrive.language.errors import ParameterError

_SET = {
    "cmd",
    "command",
    "commanded",
    "set",
    "setpoint",
    "ref",
    "reference",
    "demand",
    "target",
    "soll",
    "sollw",
    "sollwert",
    "desired",
    "des",
    "setpos",
    "setvelo",
    "refx",
    "refy",
    "nominal",
    "noml",
    "nom",
    "input",
}
_MOTOR = {"motor", "mot", "mtr", "rotor", "enc1", "encoder1", "rotary", "mx"}
_LOAD = {"load", "table", "linear", "scale", "slide", "arm", "enc2", "encoder2", "tool", "last", "tisch"}
_OUTER = {"load", "cutting", "process", "external", "outer", "disturbance", "kistler", "dynamometer"}
_ERROR = {
    "error",
    "err",
    "ferror",
    "diff",
    "difference",
    "deviation",
    "dev",
    "posdiff",
    "lag",
    "schleppabstand",
    "schleppfehler",
    "regelabweichung",
    "regeldifferenz",
    "konturabweichung",
    "abweichung",
    "fehler",
}
_MEASURED = {
    "fb",
    "feedback",
    "fdbk",
    "act",
    "actl",
    "actual",
    "ist",
    "istw",
    "istwert",
    "measured",
    "meas",
    "estimate",
    "estimated",
}
# signals that are logged with an axis but have no role in its model
_OTHERS: Mapping[str, frozenset[str]] = {
    "the supply of the drive, no signal of the axis": frozenset(
        {"bus", "dcbus", "vbus", "ibus", "dclink", "link", "zwischenkreis", "zwischenkreisspannung", "supply"}
    ),
    "a power: force times speed, which has no direction": frozenset({"power", "leistung", "wirkleistung"}),
    "a temperature": frozenset({"temperature", "temp", "temperatur"}),
    "a utilization, which has no sign: record force, torque or current": frozenset(
        {"utilization", "utilisation", "auslastung"}
    ),
    "the programmed feed, not a motion of the axis": frozenset({"feedrate", "feed", "vorschub", "override"}),
    "a constant of the drive": frozenset({"inertia", "limit", "grenze", "trägheit"}),
    "of one winding, not of the motor": frozenset({"coil", "phase", "winding"}),
    "a part of the controller's output": frozenset({"term", "anteil"}),
    "a count of the program, no signal of the axis": frozenset({"number", "program", "sequence", "line", "satz"}),
}
_VOLTAGE = {"voltage", "spannung"}
_WORDS = {
    "excitation": {"excitation", "exc", "dither", "prbs", "chirp", "multisine", "injection", "perturbation"},
    "torque": {"torque", "trq", "moment", "momenten", "drehmoment", "drehmomenten", "tau"},
    "current": {"current", "curr", "cur", "strom", "iq", "isq"},
    "force": {"force", "kraft"},
    "acceleration": {"acceleration", "acc", "accel", "beschleunigung", "beschleunigungs"},
    "speed": {"omega", "rpm", "drehzahl"},
    "velocity": {"velocity", "vel", "velo", "speed", "geschwindigkeit", "geschwindigkeits"},
    "angle": {"theta", "phi", "angle", "winkel"},
    "position": {
        "position",
        "positions",
        "pos",
        "lage",
        "weg",
        "stroke",
        "displacement",
        "setpos",
        "actpos",
        "steps",
    },
    "command": {"command", "output", "vir", "voltage", "control", "ctrl", "dac", "u", "spannung", "stellgröße"},
}
# complete names with a known role
_EXACT = {
    "qg": "setpoint_position",
    "reference": "setpoint_position",
    "xr": "setpoint_position",
    "qm": "position_load",
    "vir": "command",
    "set_position": "setpoint_position",
    "reading_load": "position_load",
    "reading_motor": "position_motor",
}
_QUANTITY_OF_UNIT = {
    "m": "position",
    "m/s": "velocity",
    "m/s2": "acceleration",
    "N": "force",
    "N m": "torque",
    "A": "current",
    "V": "command",
    "rad": "angle",
    "rad/s": "speed",
}


@dataclass(frozen=True)
class _Documented:
    """The manufacturer's definition of a name that contains no unit."""

    quantity: str
    is_set: bool
    side: str
    unit: str
    maker: str


def _odrive(quantity: str, unit: str, *, is_set: bool = False) -> _Documented:
    return _Documented(quantity, is_set, "motor", unit, "ODrive documents since firmware 0.5.1")


def _heidenhain(quantity: str, unit: str, side: str = "") -> _Documented:
    return _Documented(quantity, False, side, unit, "HEIDENHAIN documents of its oscilloscope")


# the last part of an ODrive property, such as axis0.encoder.pos_estimate
_ODRIVE = {
    "pos_estimate": _odrive("angle", "rev"),
    "pos_setpoint": _odrive("angle", "rev", is_set=True),
    "input_pos": _odrive("angle", "rev", is_set=True),
    "vel_estimate": _odrive("speed", "rev/s"),
    "vel_setpoint": _odrive("speed", "rev/s", is_set=True),
    "input_vel": _odrive("speed", "rev/s", is_set=True),
    "torque_setpoint": _odrive("torque", "N m", is_set=True),
    "torque_estimate": _odrive("torque", "N m"),
    "iq_setpoint": _odrive("current", "A", is_set=True),
    "iq_measured": _odrive("current", "A"),
}
# the letter of a signal of the oscilloscope of HEIDENHAIN's controls: "s actual", "v noml", "V (act rpm)"
_OSCILLOSCOPE = {
    "s": _heidenhain("position", "mm"),
    "v": _heidenhain("velocity", "mm/min"),
    "a": _heidenhain("acceleration", "m/s2"),
    "I": _heidenhain("current", "A"),
    "M": _heidenhain("torque", "N m"),
}
_LETTERED = re.compile(r"([svaIM]|V) \(?(actual|act|nominal|noml|nom)\.?(?: rpm)?\)?(?![A-Za-z])")
# variables of the servo trace of SINUMERIK; 32 and 64 are widths of the number
_NCK = re.compile(r"nckServoData(Act|Cmd)(Pos|Vel|Torque|Curr)(1stEnc|2ndEnc|Mot)?(?:32|64)")
_NCK_UNITS = {"Pos": ("position", "mm"), "Torque": ("torque", "N m"), "Curr": ("current", "A"), "Vel": ("speed", "rpm")}
# German compounds with set or actual at the start or at the end: Sollposition, Lageistwert
_BEHIND = re.compile(r"(soll|ist)wert")
_BEFORE = re.compile(
    r"(?<![a-zäöü])(soll|ist)(?=position|lage|weg|winkel|geschwindigkeit|drehzahl|beschleunigung|kraft|drehmoment|moment|strom)",
    re.IGNORECASE,
)
# the two encoders of a control: Messsystem 1, encoder 2, 1stEnc
_ENCODER = re.compile(r"(?:messsystem|measuring system|encoder|enc)[ _.]*([12])(?![0-9])", re.IGNORECASE)
_AXIS = re.compile(r"(?:joint|axis|axes|achse|ax|j)[ ._\[-]*([0-9]{1,2}|[xyzabc])(?![a-z])", re.IGNORECASE)
_UNIT_NUMBER = re.compile(r"\[u[0-9]+[;, ]+([0-9]{1,2})\]")  # of a SINUMERIK variable: [u1, 2] is axis 2
_SHORT = re.compile(r"(u|v|i|iq|f|pos|vel)_?([xyz])")
_LETTERS = frozenset("xyzabcuvws")
# on their own, these letters denote acceleration, path, voltage or velocity more often than an axis: v_ist, s_soll
_QUANTITIES = frozenset("asuv")
_INTEGRAL = re.compile(r"I \(int")


@dataclass(frozen=True)
class NameReading:
    """The meaning of a channel name. `exact` is the role if the name itself is the name of a role.

    is_assumed  True if the quantity is not in the name: `actual` alone may be a position or a velocity
    """

    quantity: str = ""
    is_set: bool = False
    side: str = ""
    axis: str = ""
    unit: str = ""
    exact: str = ""
    why: str = ""
    is_assumed: bool = False

    @property
    def is_weak(self) -> bool:
        """True for a command whose name marks it as a set value; other names, such as `output`, have priority."""
        return self.quantity == "command" and self.is_set

    @property
    def role_like(self) -> bool:
        """True if the name suggests a role for its channel."""
        return bool(self.quantity or self.exact)


def words_of(name: str) -> list[str]:
    """Split a name into words, in lower case."""
    spaced = re.sub(r"([A-ZÄÖÜ])([A-ZÄÖÜ][a-zäöü])", r"\1 \2", re.sub(r"([a-zäöü])([A-Z])", r"\1 \2", name))
    cut = _BEFORE.sub(r"\1 ", _BEHIND.sub(r" \1", spaced))
    return [word.lower() for word in re.findall(r"[A-Za-zÄÖÜäöüß]+[0-9]?|[0-9]+", cut)]


def read_name(name: str, unit: str, axis: str | None = None) -> NameReading:
    """Interpret the name and the unit of a channel.

    axis  the axis of the channel, determined by `axes_of` from all names; None: determined from this name alone
    """
    words = words_of(_UNIT_NUMBER.sub("", name))
    unit, bare = (unit, words) if unit else _unit_at_the_end(name, words)
    axis = _axis(name, bare) if axis is None else axis
    # Pos1 and Dev64 are Pos and Dev; enc1 and enc2 are the two encoders
    spoken = {*bare, *(word.rstrip("0123456789") for word in bare)} - {""}
    if name in ROLES:
        return NameReading(exact=name, unit=unit, why="its name is a role")
    if name.lower() in _EXACT:
        return NameReading(exact=_EXACT[name.lower()], axis=axis, unit=unit, why="a usual name")
    documented = _documented(name)
    if documented is not None:
        kind = documented.quantity if not unit else _by_unit(unit) or documented.quantity
        why = f"{'set ' if documented.is_set else ''}{kind}, by its name"
        told = "" if unit else f"; in {documented.unit}, as {documented.maker}"
        return NameReading(kind, documented.is_set, documented.side, axis, unit or documented.unit, "", f"{why}{told}")
    # An error has the unit of a position, and would otherwise take its role.
    if _INTEGRAL.match(name):
        return NameReading(axis=axis, unit=unit, why="the integral part of the current")
    if _ERROR & spoken:
        return NameReading(axis=axis, unit=unit, why="a difference, which follows from others")
    is_set = bool(_SET & spoken)
    other = next((why for why, known in _OTHERS.items() if known & spoken), "")
    # the output of a current controller follows the force, the speed and the winding
    if not other and _VOLTAGE & spoken and {"output", "motor", "d", "q"} & set(bare) and not is_set:
        other = "the voltage at the motor, which holds the speed too"
    if not other and "d" in bare and "current" in bare:
        other = "the current that magnetizes, which makes no torque"
    if other:
        return NameReading(axis=axis, unit=unit, why=other)
    encoder = _ENCODER.search(name.replace("1stEnc", "enc1").replace("2ndEnc", "enc2"))
    side = "motor" if _MOTOR & set(bare) else "load" if _LOAD & set(bare) else ""
    if not side and encoder is not None:
        side = "motor" if encoder[1] == "1" else "load"
    by_words = _by_words(name, [*bare, *spoken])
    # x1 and x2 are positions of one axis, where they are not axes
    if not by_words and not axis and any(re.fullmatch("[xyz][0-9]", word) for word in bare):
        by_words = "position"
    by_unit = _by_unit(unit)
    # A unit is the stronger statement; words are often abbreviated or generic.
    quantity = by_unit or by_words
    # A signal in V may stand for a scaled current or torque, which its name then states.
    if by_unit == "command" and by_words in ("current", "torque", "excitation"):
        quantity = by_words
    named = is_set or bool(_MEASURED & spoken)
    if quantity in ("", "command") and axis and by_words != "command" and (named or bare == [axis]):
        # x, x_cmd and y_fb are positions of their axes.
        quantity = "position"
    if bare[:1] == ["pid"] and "output" not in bare and {"command", "feedback"} & set(bare):
        # LinuxCNC's pid.x.command and pid.x.feedback are the positions that the loop compares.
        quantity = "position"
    assumed = False
    if (
        not by_unit
        and named
        and set(bare) <= _SET | _MEASURED | _MOTOR | _LOAD | {axis}
        and by_words in ("", "command")
    ):
        # target and actual alone; `command` alone stays a command
        assumed = bare != ["command"]
        quantity = "position" if assumed else quantity
    if by_words == "excitation":
        quantity, is_set = "excitation", False
    if quantity == "force":
        side = "load" if _OUTER & set(bare) else "motor"
    if unit in RELATIVE:
        quantity = by_words if by_words in ("torque", "current", "force") else ""
        quantity = quantity or ("command" if by_words == "command" or (is_set and not assumed) else "")
        side = "motor" if quantity == "force" else side
    if not quantity:
        return NameReading(axis=axis, unit=unit)
    why = f"{'set ' if is_set else ''}{quantity}{' of the ' + side if side and quantity != 'force' else ''}"
    by = "unit" if by_unit else "name"
    how = f"{why}, as {'a set' if is_set else 'an actual'} value of nothing else" if assumed else f"{why}, by its {by}"
    return NameReading(quantity, is_set, side, axis, unit, "", how, assumed)


# units that are shares of a rated value
RELATIVE = frozenset({"percent", "permille"})


def _documented(name: str) -> _Documented | None:
    """Return the manufacturer's definition of a name; None if there is none."""
    odrive = _ODRIVE.get(name.rpartition(".")[2].lower())
    if odrive is not None:
        return odrive
    letter = _LETTERED.match(name)
    if letter is not None:
        # the speed of the rotary encoder, which the control scales to the feed of the axis
        side = "motor" if letter[1] == "V" else ""
        known = _OSCILLOSCOPE[letter[1] if letter[1] != "V" else "v"]
        return _Documented(known.quantity, letter[2].startswith("no"), side, known.unit, known.maker)
    nck = _NCK.search(name)
    if nck is not None:
        quantity, unit = _NCK_UNITS[nck[2]]
        side = {"1stEnc": "motor", "2ndEnc": "load"}.get(nck[3], "motor" if nck[2] == "Vel" else "")
        return _Documented(quantity, nck[1] == "Cmd", side, unit, "SINUMERIK records it")
    return None


def unit_in_name(name: str) -> str:
    """Return the unit suffix of a name, as in `pos_act_mm`, `force_N`; a single letter must match the quantity.

    `u_in` is an input, not inches.
    """
    unit = _unit_at_the_end(name, [])[0]
    if unit:
        return unit
    last = name.rpartition("_")[2]
    return last if last in {"force": "N", "position": "m", "current": "A"}.get(read_name(name, "").quantity, ()) else ""


def _unit_at_the_end(name: str, words: list[str]) -> tuple[str, list[str]]:
    """Split off the unit suffix of a name, as in `x_cmd_mm`, except single letters and `in`; return unit and words."""
    for start in [k + 1 for k, letter in enumerate(name) if letter in "_ "]:
        end = name[start:].replace(" ", "_")
        # A name cannot contain a slash: rad_s means rad/s.
        unit = unit_of(re.sub(r"^(u?m?m|rad|deg)_(s2?)$", r"\1/\2", end))
        if unit and (len(end) > 1 or end == "%") and end != "in" and not end[0].isdigit():
            return unit, words_of(name[:start])
    return "", words


def _axis(name: str, words: list[str]) -> str:
    """Return the axis determined from one name alone: `joint.0` -> 0, `x_cmd` -> x, `ux` -> x."""
    match = _UNIT_NUMBER.search(name) or _AXIS.search(name)
    if match:
        return match[1].lower()
    single = [word for word in words if word in ("x", "y", "z")]
    if single:
        return single[0]
    short = _SHORT.fullmatch(name.lower())
    return short[2] if short else ""


def axes_of(names: Iterable[str]) -> dict[str, str]:
    """Return the axis of each name, determined from all names of a log together; empty for a name without an axis.

    A word such as `X1` or `C` at the start or at the end of a name is an axis if the other words of the name occur with
    another letter too: X1_ActualPosition and Y1_ActualPosition.  `x1_pos` and `x2_pos` have the same letter and may be
    motor and table of one axis; they are two axes only if there is a force, torque or current for each.
    """
    split = {name: _unit_at_the_end(name, words_of(name))[1] for name in names}
    axes = {name: _axis(name, words) for name, words in split.items()}
    places: dict[str, set[str]] = {}
    for name, words in split.items():
        for token, rest in _tokens(words):
            if not (_UNIT_NUMBER.search(name) or _AXIS.search(name) or _LETTERED.match(name)):
                places.setdefault(rest, set()).add(token)
    found: set[str] = set()
    for tokens in places.values():
        if len({token[0] for token in tokens}) > 1:
            found |= tokens
    drives = {token for rest, tokens in places.items() if _by_words("", rest.split()) in _DRIVING for token in tokens}
    for tokens in places.values():
        found |= tokens & drives if len(tokens & drives) > 1 else set()
    numbered = sum(len(token) > 1 for token in found) > 1
    for name, words in split.items():
        ends = [token for token, _ in _tokens(words)]
        # M1_CURRENT_FEEDRATE beside X1_..., Y1_...: a group of its own, though not an axis that moves
        first = words[0] if words else ""
        chosen = next((token for token in ends if token in found), "")
        if not chosen and numbered and len(words) > 1 and re.fullmatch(r"[a-z][0-9]", first):
            chosen = first
        if chosen and (not axes[name] or len(chosen) > 1 or axes[name] not in found):
            axes[name] = chosen
    # LinuxCNC: with one joint and one pid component, both are of one axis
    joints = {axis for name, axis in axes.items() if name.startswith("joint.")}
    loops = {axis for name, axis in axes.items() if name.startswith("pid.")}
    if len(joints) == 1 and len(loops) == 1:
        axes |= {name: next(iter(joints)) for name, axis in axes.items() if axis in loops}
    return axes


_DRIVING = ("force", "torque", "current")


def _tokens(words: list[str]) -> Iterable[tuple[str, str]]:
    """Yield the first and the last words of a name if they may be an axis, each with the remaining words."""
    if len(words) < 2:
        return
    for k in (0, -1):
        word = words[k]
        numbered = len(word) == 2 and word[1].isdigit()
        if word[0] in _LETTERS and (numbered or (len(word) == 1 and word not in _QUANTITIES)):
            yield word, " ".join(words[1:] if k == 0 else words[:-1])


def _by_words(name: str, words: list[str]) -> str:
    """Return the quantity named by the words of a name; `command` only if no other quantity matches."""
    for quantity, known in _WORDS.items():
        if known & set(words):
            return quantity
    short = _SHORT.fullmatch(name.lower())
    if short:
        return {"u": "command", "v": "velocity", "i": "current", "iq": "current", "f": "force"}.get(short[1], "")
    return ""


def _by_unit(unit: str) -> str:
    """Return the quantity that a unit measures."""
    if unit.lower() in COUNTS:
        return "position"
    for known, quantity in _QUANTITY_OF_UNIT.items():
        try:
            units.factor(unit, known)
        except ParameterError:
            continue
        return quantity if unit else ""
    return ""
