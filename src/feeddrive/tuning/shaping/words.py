"""What a shaped loop says in sentences: what it was tuned for, what to do, why, and what is worse than before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.tuning.shaping.figures import FIGURES, LARGER, Figures
from feeddrive.tuning.shaping.limits import Limits

if TYPE_CHECKING:
    from feeddrive.tuning.shaping.shaped_loop import Tuned

_NOT_WORTH = 2.0  # per cent: less gain is no reason to change anything
_WORSE = 0.03  # of a figure that counts as worse
_WHAT = {
    "rope-snap": "rope-snap error",
    "stiffness": "dynamic stiffness",
    "least-stiffness": "least stiffness",
    "bandwidth": "bandwidth",
}


def aim(found: Tuned) -> str:
    """The goal."""
    band = "" if found.band == (0.0, np.inf) else f" from {found.band[0]:g} to {found.band[1]:g} Hz"
    drive = " against a force at the drive" if found.at_drive and found.goal != "bandwidth" else ""
    return {
        "rope-snap": f"least rope-snap error{drive}",
        "stiffness": f"greatest dynamic stiffness{drive}{band}",
        "least-stiffness": f"greatest least stiffness{drive}{band}",
        "bandwidth": "greatest bandwidth",
    }[found.goal]


def recommendation(found: Tuned) -> str:
    """What to do and why, what holds it back, and what is worse than today."""
    failed = [line for line in found.proof if line.holds is False]
    if failed:
        return f"Do not use this tuning: {failed[0].what} does not hold ({failed[0].said})."
    worse = _worse(found)
    return _advised(found) + (f" Worse than today: {worse}." if worse else "") + _of_the_table(found)


def _of_the_table(found: Tuned) -> str:
    if not found.at_drive:
        return ""
    return (
        " Nothing is known of a force on the table, which may well become softer there: strike the table or give a "
        "machine with its plant before cutting with it."
    )


def _advised(found: Tuned) -> str:
    limit = f"; {found.held[0].what} holds it back" if found.held else ""
    gained = found.gained()
    limits, new = found.limits.sentence(), _new_values(found)
    if gained is None:
        state = "there is no control to compare with" if not found.before else "today's loop is unstable"
        return f"{new} keep {limits}, and {state}{limit}."
    less = found.goal == "rope-snap"
    change = 100.0 * (1.0 - 1.0 / gained if less else gained - 1.0)
    word = ("less" if less else "more") if change >= 0.0 else ("more" if less else "less")
    what = _WHAT[found.goal]
    broken = broken_limits(found.before, found.limits)
    if broken:
        return f"{new} keep {limits} with {abs(change):.3g} % {word} {what}, and today's {broken}{limit}."
    drive = " against a force at the drive" if found.at_drive and found.goal != "bandwidth" else ""
    if found.recipe and change < 0.0:
        return f"Leave the control as it is: this rule gives {abs(change):.3g} % {word} {what}{drive}{limit}."
    if change < _NOT_WORTH:
        best = "this rule" if found.recipe else "the best that was found"
        return f"Leave the control as it is: {best} has only {change:.2g} % {word} {what}{drive}{limit}."
    return f"{new} give {change:.3g} % {word} {what} within {limits}{limit}."


def _new_values(found: Tuned) -> str:
    """Taken without reserve only where a force on the table is known."""
    if not found.at_drive:
        return "Take the new values: they"
    return "The new values" if found.goal == "bandwidth" else "Against a force at the drive the new values"


def _worse(found: Tuned) -> str:
    """Figures that are worse than today at the site where they fell most, as a clause."""
    if not found.before or not all(each.stable for each in found.before):
        return ""
    said: list[str] = []
    for head, unit, read in FIGURES:
        if head not in LARGER:
            continue
        pairs = [(read(a), read(b)) for a, b in zip(found.before, found.after, strict=True)]
        fell = [
            ((a / b if LARGER[head] else b / a), a, b)
            for a, b in pairs
            if a is not None and b is not None and a * b > 0
        ]
        if fell and max(fell)[0] > 1.0 + _WORSE:
            _, a, b = max(fell)
            said.append(f"{head} {a:.3g} -> {b:.3g} {unit}".rstrip())
    return ", ".join(said)


def goal_of(found: Tuned, row: Sequence[Figures]) -> float:
    """What is to be small, at the worst site."""
    return max(_goal(each, found.goal, found.band) for each in row)


def _goal(each: Figures, goal: str, band: tuple[float, float]) -> float:
    f, size = each.compliance.frequency, each.compliance.magnitude
    inside = (f >= band[0]) & (f <= band[1])
    match goal:
        case "rope-snap":
            return each.rope_snap
        case "stiffness":
            x = np.log(f[inside])
            return float(np.sqrt(np.trapezoid(size[inside] ** 2, x) / (x[-1] - x[0])))
        case "least-stiffness":
            return float(np.max(size[inside]))
        case _:
            return 1.0 / each.bandwidth if each.bandwidth else np.inf


def broken_limits(before: Sequence[Figures], limits: Limits, room: float = 0.02) -> str:
    """Which limit a control does not keep, as a clause; empty if it keeps all."""
    for each in before:
        m = each.margins
        if limits.sensitivity_peak is not None and m.sensitivity_peak > (1.0 + room) * limits.sensitivity_peak:
            return f"have Ms = {m.sensitivity_peak:.3g}, more than {limits.sensitivity_peak:g}"
        phase, gain, delay = m.phase_margin_deg, m.gain_increase_dB, m.delay_margin_samples
        if (
            limits.phase_margin_deg is not None
            and phase is not None
            and abs(phase) < (1.0 - room) * limits.phase_margin_deg
        ):
            return f"have {phase:.3g} deg of phase margin, less than {limits.phase_margin_deg:g}"
        if limits.gain_margin_dB is not None and gain is not None and gain < (1.0 - room) * limits.gain_margin_dB:
            return f"have {gain:.3g} dB of gain margin, less than {limits.gain_margin_dB:g}"
        if (
            limits.delay_margin_samples is not None
            and delay is not None
            and delay < (1.0 - room) * limits.delay_margin_samples
        ):
            return f"have {delay:.3g} samples of delay margin, less than {limits.delay_margin_samples:g}"
        if limits.compliance_peak is not None and each.peak_compliance > (1.0 + room) * limits.compliance_peak:
            return f"have a peak compliance of {1e6 * each.peak_compliance:.3g} um/N"
    return ""
