"""Texts of a report: formatted numbers, blocks and results in sentences, remarks on the figures."""

from __future__ import annotations

import math

import numpy as np

from feeddrive.analysis.replay import Replay
from feeddrive.language.block import Block, declarations
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.report.page import Entry, LawsReport

MS_BOUND = 2.0  # the usual bound on the sensitivity peak: Skogestad & Postlethwaite, section 2.4


def result(contents: LawsReport) -> list[str]:
    """The results, most important first."""
    replayed = next((entry for entry in contents.entries if entry.replay is not None), None)
    if replayed is not None and replayed.replay is not None:
        return _prediction(replayed.replay)
    if len(contents.entries) == 1:
        return _alone(contents.entries[0])
    return _compared(contents)


def _prediction(replay: Replay) -> list[str]:
    off, error = replay.rms("position_load"), _rms(replay.measured["following_error"][replay.skipped :])
    peak = float(np.max(np.abs(replay.residual("position_load"))))
    said = [
        f"The model predicts the measured position to {number(1e6 * off)} µm RMS ({number(1e6 * peak)} µm at most), "
        f"while the axis itself follows its setpoint with {number(1e6 * error)} µm RMS: the residual is "
        f"{percent(off / error if error else 0.0)} of the following error."
    ]
    if "force" in replay.measured:
        said.append(f"The residual of the force is {percent(replay.share('force'))} of its RMS.")
    return said


def _alone(entry: Entry) -> list[str]:
    limit = next(iter(entry.limits.items()), None)
    force = f"the largest force is {number(entry.peak('force'))} N"
    if limit is not None:
        force += f", {percent(entry.peak('force') / limit[1])} of the {limit[0]}"
    said = [f"{_quoted(entry)} follows its setpoint with {_errors(entry)}; {force}."]
    if entry.margins is not None:
        said.append(f"Its sensitivity peak is Ms = {number(entry.margins.sensitivity_peak)}, {_judged(entry)}.")
    return said


def _compared(contents: LawsReport) -> list[str]:
    first = contents.entries[0]
    best = min(contents.entries, key=lambda entry: entry.rms("following_error"))
    if best is first:
        said = f"None of the others follows better than {_quoted(first)}: {_errors(first)}."
        return [said]
    ratio = first.rms("following_error") / (best.rms("following_error") or 1.0)
    better = f"{number(ratio, 2)} times less" if ratio >= 3.0 else f"{percent(1.0 - 1.0 / ratio)} less"
    better_of = (
        f"Of {len(contents.entries)} laws {_quoted(best)} follows best: {_errors(best)}, {better} RMS than "
        f"{_quoted(first)} ({_errors(first)})."
    )
    prices = [price for price in (_price_of_robustness(first, best), _price_of_stiffness(first, best)) if price]
    return [*([f"What {_quoted(best)} costs: {'; '.join(prices)}."] if prices else []), better_of]


def _price_of_robustness(first: Entry, best: Entry) -> str:
    if first.margins is None or best.margins is None:
        return ""
    before, after = first.margins.sensitivity_peak, best.margins.sensitivity_peak
    if after <= 1.02 * before:
        return ""
    return f"its sensitivity peak is {number(after)} in place of {number(before)}, {_judged(best)}"


def _price_of_stiffness(first: Entry, best: Entry) -> str:
    if first.stiffness is None or best.stiffness is None:
        return ""
    before, after = 1e-6 * first.stiffness.minimum, 1e-6 * best.stiffness.minimum
    if after >= 0.98 * before:
        return ""
    return f"the least dynamic stiffness falls from {number(before)} to {number(after)} N/µm"


def _judged(entry: Entry) -> str:
    peak = 0.0 if entry.margins is None else entry.margins.sensitivity_peak
    return f"above the usual bound of {MS_BOUND:g}" if peak > MS_BOUND else f"within the usual bound of {MS_BOUND:g}"


def remarks(contents: LawsReport) -> list[str]:
    """Important remarks, then the notes of the job."""
    found: list[str] = []
    ringing = [
        f"{_quoted(entry)} ({number(entry.margins.sensitivity_peak)})"
        for entry in contents.entries
        if entry.margins is not None and entry.margins.sensitivity_peak > MS_BOUND
    ]
    if ringing:
        found.append(
            f"The sensitivity peak is above {MS_BOUND:g}: {', '.join(ringing)}. A small change of the axis makes such "
            f"a loop ring."
        )
    for entry in contents.entries:
        name = _quoted(entry)
        found += _of_force(entry, name)
        tripped = np.flatnonzero(entry.run["trip"])
        if tripped.size:
            found.append(f"{name}: the guard tripped at {number(float(entry.run.time[tripped[0]]), 4)} s.")
    return [*found, *(note for note in contents.notes if note != contents.rule)]


def _of_force(entry: Entry, name: str) -> list[str]:
    found: list[str] = []
    limit = entry.loop.control.force_limit
    if limit is not None:
        at_limit = float(np.mean(np.abs(entry.counted("force")) >= limit * (1.0 - 1e-9)))
        if at_limit > 0.0:
            found.append(f"{name}: the force is at its limit for {percent(at_limit)} of the time.")
    for what, bound in entry.limits.items():
        if what == "motor peak" and entry.peak("force") > bound * (1.0 + 1e-9):
            found.append(
                f"{name}: the largest force, {number(entry.peak('force'))} N, is above the motor's peak of "
                f"{number(bound)} N: the model does not limit it there, the machine will."
            )
        if what.startswith("motor continuous") and entry.rms("force") > bound:
            found.append(
                f"{name}: the RMS force, {number(entry.rms('force'))} N, is above the motor's continuous "
                f"{number(bound)} N: repeated without pause this work overheats the motor."
            )
    return found


def _errors(entry: Entry) -> str:
    return (
        f"{number(1e6 * entry.rms('following_error'))} µm RMS, {number(1e6 * entry.peak('following_error'))} µm at most"
    )


def _quoted(entry: Entry) -> str:
    return f"'{entry.name}'"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent if that is readable; a dash if it is absent."""
    if value is None:
        return "–"
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "∞" if value > 0.0 else "-∞"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value))) + 1
    if not -4 < size <= 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - size, 0)}f}"


def percent(share: float) -> str:
    """A share in percent."""
    return f"{number(100.0 * share, 2 if abs(share) < 0.0995 else 3)} %"


def decibel(value: float | None) -> str:
    """One decimal."""
    return "–" if value is None else f"{value:.1f}"


def block_sentence(block: Block) -> str:
    """A block by its kind, those parameters that are set, and its parts in brackets."""
    declared = declarations(type(block))
    values = {name: getattr(block, name) for name in declared}
    given = [
        f"{name.replace('_', ' ')} {value:.6g} {declared[name].unit}".rstrip()
        for name, value in values.items()
        if isinstance(value, float)
    ]
    parts = [
        f"({block_sentence(part)})"
        for value in values.values()
        for part in (value if isinstance(value, tuple) else (value,))
        if isinstance(part, Block)
    ]
    return f"{block.kind.replace('_', ' ')}: {', '.join([*given, *parts])}"


def described(control: Control) -> str:
    """The parts of a control, with those parameters that are set."""
    parts = [block_sentence(control.law)]
    parts += [f"compensation {block_sentence(block)}" for block in control.compensation]
    parts += [f"filter {block_sentence(block)}" for block in control.filters]
    parts += [f"feedforward {block_sentence(block)}" for block in control.feedforward]
    if control.prefilter is not None:
        parts.append(f"prefilter {block_sentence(control.prefilter)}")
    if control.force_limit is not None:
        parts.append(Text(f"limit {Quantity(control.force_limit, 'N')}"))
    return "; ".join(parts)
