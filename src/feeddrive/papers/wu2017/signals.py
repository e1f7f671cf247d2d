"""Row 4.n: parameters against a learned signal, where all repeats and where it does not."""

from __future__ import annotations

import dataclasses

import numpy as np

from feeddrive.blocks.families import Load
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.language.table import Table
from feeddrive.loop.loop import Loop
from feeddrive.papers.claims import Claim
from feeddrive.papers.wu2017 import pictures
from feeddrive.papers.wu2017.setting import (
    CHANGING,
    SAME,
    SET_VALUED,
    SETS,
    TANH,
    TRIALS,
    noise,
    table_axis,
)
from feeddrive.report.content import Shown
from feeddrive.tuning.signal_ilc import learn_signal
from feeddrive.tuning.trials import iterate_trials

BANDWIDTH = 50.0  # Hz of the signal's robustness filter
PULSE = (0.25, 0.30, 150.0)  # s, s, N: a disturbance that comes in each trial at the same time
STRONG = 20.0  # N of noise where nothing repeats


def pulsed(trial: int) -> Load:
    """Noise, and the pulse."""
    plain = noise(trial)
    force = plain.force.copy()
    first, last = (round(each / float(plain.sample_time)) for each in PULSE[:2])
    force[first:last] += PULSE[2]
    return dataclasses.replace(plain, force=force)


def strong(trial: int) -> RecordedForce:
    """More noise."""
    return noise(trial, STRONG)


CASES: dict[str, tuple[object, object]] = {
    "same reference": (SAME, noise),
    "changing references": (CHANGING[:5], noise),
    "same reference, the same pulse in each trial": (SAME, pulsed),
    f"same reference, noise of {STRONG:g} N": (SAME, strong),
}


def signals() -> tuple[list[Claim], list[Table], list[Shown]]:
    """Claims, tables and pictures."""
    found: dict[tuple[str, str, bool], np.ndarray] = {}
    rows = []
    for smooth in (True, False):
        for case, (reference, load) in CASES.items():
            plain, whole = (table_axis("x", SETS[name], smooth=smooth) for name in ("a, b", "+ Stribeck"))
            made = {
                "parameters, + Stribeck": _parameters(whole, reference, load),
                "signal": _signal(plain, reference, load),
            }
            for kind, rms in made.items():
                found[case, kind, smooth] = rms
                friction = TANH if smooth else SET_VALUED
                rows.append([friction, case, kind, *(f"{1e6 * value:.3g}" for value in rms)])
    longest = max(len(row) for row in rows)
    rows = [row + ["-"] * (longest - len(row)) for row in rows]
    heads = ["friction", "case", "learned", *(f"trial {j + 1}" for j in range(longest - 3))]
    table = Table(f"RMS error in um; the signal starts from 45 kg and learns up to {BANDWIDTH:g} Hz", heads, rows)
    kinds = ("parameters, + Stribeck", "signal")
    drawn = {f"{kind}: {case}": found[case, kind, False] for case in list(CASES)[:2] for kind in kinds}
    shown = [pictures.against_signal(drawn, f"Parameters and signal, {SET_VALUED}", "signal")]
    return _claims(found), [table], shown


def _parameters(loop: Loop, reference: object, load: object) -> np.ndarray:
    many = reference if isinstance(reference, tuple) else (reference,)
    trials = len(many) if len(many) > 1 else TRIALS
    return iterate_trials(loop, many, trials, load=load).rms  # type: ignore[arg-type]


def _signal(loop: Loop, reference: object, load: object) -> np.ndarray:
    many = reference if isinstance(reference, tuple) else (reference,)
    trials = len(many) if len(many) > 1 else TRIALS
    return learn_signal(loop, many, trials, bandwidth=BANDWIDTH, load=load).rms  # type: ignore[arg-type]


def _claims(found: dict[tuple[str, str, bool], np.ndarray]) -> list[Claim]:
    ours, theirs = "parameters, + Stribeck", "signal"

    def last(case: str, kind: str, smooth: bool) -> float:
        return float(found[case, kind, smooth][-1])

    def ratio(case: str, smooth: bool) -> float:
        return last(case, theirs, smooth) / last(case, ours, smooth)

    same, changing, pulse, *_ = CASES
    rule = f"x axis, last trial, RMS of the signal over that of the parameters; Q {BANDWIDTH:g} Hz; {SET_VALUED}"
    return [
        Claim("4.n", "the signal wins: same reference", rule, ratio(same, False), None, 1.0),
        Claim("4.n", "the signal wins: a pulse that repeats", rule, ratio(pulse, False), None, 1.0),
        Claim("4.n", "the signal loses: changing references", rule, ratio(changing, False), 2.0, None),
        Claim("4.n", "changing references: the signal is worse than its first trial", rule,
              float(np.max(found[changing, theirs, False][1:]) / found[changing, theirs, False][0]), 1.0, None),
        Claim("4.n", "the signal loses on tanh friction, which creeps at rest: same reference",
              rule.replace(SET_VALUED, TANH), ratio(same, True), 1.0, None),
    ]  # fmt: skip
