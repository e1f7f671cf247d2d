"""LinuxCNC's stock pids and biquads, as lines of halcmd; the target `linuxcnc-pid` has the wiring and the proof."""

from __future__ import annotations

from collections.abc import Iterator

from feeddrive.export.linuxcnc_pid.bundle import COEFFICIENTS, GAINS
from feeddrive.export.linuxcnc_pid.mapping import left_out, period, stock_law
from feeddrive.export.parameters.maker import Line
from feeddrive.export.parameters.quantities import Cascade
from feeddrive.export.parameters.unsupported import Lost, numbers

UNITS = 1000.0  # machine units in a meter: mm
_SOURCE = "LinuxCNC manual page pid(9); tested bit for bit against the component of LinuxCNC 2.9"
_BIQUAD = "LinuxCNC manual page biquad(9); tested as the pids; it stands between two sum2, see the target linuxcnc-pid"
_MEANINGS = {
    "position.Pgain": ("1/s, that is (mm/s)/mm", "position gain", "control.law.Kv"),
    "position.FF1": ("(mm/s)/(mm/s)", "share of the set velocity", "control.law.velocity_feedforward"),
    "velocity.Pgain": ("output/(mm/s)", "velocity gain", "control.law.Kp"),
    "velocity.Igain": ("output/mm", "velocity gain over integral time", "control.law.Kp / control.law.Tn"),
    "velocity.FF0": ("output/(mm/s)", "what the law gives back of the viscous friction", "control.law.viscous"),
    "velocity.maxoutput": ("output", "limit of the output", "control.force_limit"),
}


def lines(cascade: Cascade) -> tuple[list[Line], list[Lost]]:
    """The settings of two pids and what feeds their bias; zeros that are the default are left out."""
    law = stock_law(cascade, units=UNITS)
    assert law.velocity is not None
    found = list(_gains(cascade, "position", law.position)) + list(_gains(cascade, "velocity", law.velocity))
    for name, value, unit, quantity in (
        ("forward.gain0", law.acceleration_gain, "output/(mm/s^2)", "mass"),
        ("forward.gain1", law.velocity_gain, "output/(mm/s)", "viscous"),
    ):
        if value:
            meaning = f"gain of sum2 at velocity.bias: {quantity} that is fed forward"
            si = f"{cascade.values[quantity] or 0.0!r} {'kg' if quantity == 'mass' else 'N s/m'}"
            found.append(Line(name, f"{value:.9g}", unit, meaning, f"control.feedforward, {quantity}", si, _SOURCE))
    if law.velocity.bias:
        si = f"{cascade.values['weight']!r} N"
        meaning = "offset of the same sum2: the weight of a hanging axis"
        value = f"{law.velocity.bias:.9g}"
        found.append(Line("forward.offset", value, "output", meaning, "control.guard.safe_force", si, _SOURCE))
    for i, (block, design) in enumerate(zip(law.filters, cascade.loop.control.filters, strict=True)):
        for name in COEFFICIENTS:
            meaning = f"biquad {i}, type 0, at a period of {1e3 * period(cascade.loop):.6g} ms: {numbers(design)}"
            value = getattr(block, name)
            found.append(Line(f"filter{i}.{name}", f"{value:.17g}", "", meaning, f"control.filters.{i}", "", _BIQUAD))
    output = f"The output is in {_unit(cascade)}; 1 of it is {float(law.force_per_output):.6g} N at the table."
    found.insert(0, Line("", "", "", output, "", "", ""))
    return found, list(left_out(cascade))


def _gains(cascade: Cascade, name: str, pid: object) -> Iterator[Line]:
    for gain in GAINS:
        value, key = getattr(pid, gain), f"{name}.{gain}"
        if value and key in _MEANINGS:
            unit, meaning, path = _MEANINGS[key]
            yield Line(key, f"{value:.9g}", unit, meaning, path, _si(cascade, path), _SOURCE)
    yield Line(f"{name}.error-previous-target", "0", "bit", "error against the command of now", "", "", _SOURCE)


def _si(cascade: Cascade, path: str) -> str:
    """What stands in the machine file, in SI."""
    values = {
        "control.law.Kv": ("Kv", "1/s"),
        "control.law.velocity_feedforward": ("velocity_feedforward", ""),
        "control.law.Kp": ("Kp", "N s/m"),
        "control.law.Kp / control.law.Tn": ("Kp/Tn", "N/m"),
        "control.force_limit": ("force_limit", "N"),
    }
    if path == "control.law.viscous":
        return f"{cascade.law.viscous!r} N s/m"
    quantity, unit = values[path]
    return f"{cascade.values[quantity]!r} {unit}".rstrip()


def _unit(cascade: Cascade) -> str:
    motor = cascade.loop.axis.actuator.motor
    return "N" if motor is None else motor.unit
