"""Which variable of an FMU is which signal of the loop, and the factor between its unit and SI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from feeddrive.cosimulation.archive import Archive
from feeddrive.files.messages import nearest
from feeddrive.language.errors import FmuError, ParameterError
from feeddrive.language.units import factor, measure
from feeddrive.loop.loop import UNITS

# what the loop hands to an FMU, and what it can take from one
GIVEN = ("force", "command", "load_force", "start_position")
TAKEN = (
    "reading", "reading_motor", "reading_load", "position_motor", "position_load", "velocity_motor", "velocity_load",
    "drive_force", "friction_motor", "friction_load",
)  # fmt: skip
_BASE = ("m", "kg", "s", "A", "rad")  # in the order of `units.Dimension`
_REALS = ("Real", "Float64")


class Port(NamedTuple):
    """A variable that carries a signal: value in SI = factor · value of the FMU."""

    signal: str
    variable: str
    reference: int
    factor: float


def ports(archive: Archive, names: Mapping[str, str], command_unit: str | None) -> dict[str, Port]:
    """The ports by signal: those of `names`, and every signal whose own name the FMU has.

    `names` are the FMU's variables by signal, as "x" or "x:mm"; a variable that states no unit counts as SI.
    `command_unit` is the unit of the drive's command; None without a motor.

    Raises ParameterError for a signal that there is not or a unit that does not fit, FmuError for a variable that is
    missing or of the wrong kind.
    """
    known = {each.name: each for each in archive.description.modelVariables}
    for signal in names:
        if signal not in (*GIVEN, *TAKEN):
            raise ParameterError(
                f"there is no signal '{signal}' to name a variable for{nearest(signal, GIVEN + TAKEN)}"
            )
    both = {"force", "command"} & set(names)
    own = [signal for signal in (*GIVEN, *TAKEN) if signal in known and not (signal in ("force", "command") and both)]
    if not both and "force" in own and "command" in own:
        own.remove("command")
    wanted = {signal: signal for signal in own} | dict(names)
    return {signal: _port(archive, known, signal, text, command_unit) for signal, text in wanted.items()}


def _port(archive: Archive, known: Mapping[str, Any], signal: str, text: str, command_unit: str | None) -> Port:
    name, unit = text, ""
    if name not in known and ":" in text:
        name, _, unit = text.rpartition(":")
    if name not in known:
        raise FmuError(f"{archive.name}: has no variable '{name}' for {signal}{nearest(name, list(known))}")
    variable = known[name]
    causalities = _causalities(signal)
    if variable.causality not in causalities:
        raise FmuError(f"{archive.name}: '{name}' is {variable.causality}, but {signal} needs an {causalities[0]}")
    if variable.type not in _REALS or variable.dimensions:
        raise FmuError(f"{archive.name}: '{name}' is no single number of 64 bits, which {signal} needs")
    if signal == "command" and command_unit is None:
        raise ParameterError("command: the machine file names no motor, so that there is no command in a drive's unit")
    declared = (command_unit or "") if signal == "command" else _unit(signal)
    try:
        return Port(signal, name, variable.valueReference, _factor(archive, variable, unit, declared))
    except ParameterError as error:
        raise ParameterError(f"{archive.name}: '{name}' as {signal}: {error}") from None


def _causalities(signal: str) -> tuple[str, ...]:
    if signal == "start_position":
        return ("input", "parameter")
    return ("input",) if signal in GIVEN else ("output", "local")


def _unit(signal: str) -> str:
    return UNITS.get(signal, "m")  # readings without a side and the start are positions


def _factor(archive: Archive, variable: Any, given: str, declared: str) -> float:
    """From the unit that was given, else from that of the FMU."""
    if given:
        return factor(given, declared)
    stated = variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)
    if not stated or stated == declared:
        return 1.0
    base = next((each.baseUnit for each in archive.description.unitDefinitions if each.name == stated), None)
    if base is None:
        return factor(stated, declared)
    powers = {name: int(getattr(base, name) or 0) for name in (*_BASE, "K", "mol", "cd")}
    size, dimension = measure(declared)
    wanted: dict[str, int] = dict(zip(_BASE, dimension, strict=True))
    if any(power != wanted.get(name, 0) for name, power in powers.items()) or float(base.offset or 0.0) != 0.0:
        raise ParameterError(f"its unit '{stated}' does not measure the same thing as '{declared}'")
    return float(base.factor if base.factor is not None else 1.0) / size


def needed(found: Mapping[str, Port], signals: Iterable[str], archive: Archive, who: str) -> None:
    """Raise FmuError unless all of these signals, which `who` needs, have a port."""
    missing = next((signal for signal in signals if signal not in found), None)
    if missing is None:
        return
    kind = "input" if missing in GIVEN else "output"
    have = ", ".join(each.name for each in archive.description.modelVariables if each.causality == kind)
    example = f'"x" or "x:{"N" if kind == "input" else "mm"}"'
    raise FmuError(
        f"{archive.name}: {who} needs {missing}, but no variable is named for it: name one, as {example}; "
        f"the FMU's {kind}s are: {have or 'none'}"
    )
