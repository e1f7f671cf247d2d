"""Make the table of laws found in foreign logs of docs/how_to/identification.md (run it with PYTHONPATH=tests).

Every log comes from `foreign_axis`, which shares no code with feeddrive. A law counts as right if one of the readings
that are given is the law that ran: cascade or PID, with an integral or without, and each gain within 5 % or within two
of its 95 % intervals.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line: threads that wait count as CPU time

import numpy as np

from feeddrive.identification.motion.identify_law import ControlFit, LawReading, identify_control
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import FeeddriveError
from foreign_laws import KINDS, OUTSIDE, ForeignLog, drawn

WITHIN = 0.05  # of a gain: what a tuning notices
NORMAL = 1.96


@dataclass(frozen=True)
class Row:
    """One log: what was found, the gains' errors in standard errors and relative to the truth, CPU s."""

    kind: str
    outcome: str  # law, near, refused
    right: bool
    z: tuple[float, ...]
    relative: tuple[float, ...]
    seconds: float
    words: str


def truth(log: ForeignLog) -> list[dict[str, float]]:
    """Return the gains of the law that ran, in all equivalent forms."""
    t = log.truth
    if t["law"] == "LinuxCncPid":
        P, I, D, FF1, FF2 = (  # noqa: E741
            float(t[f"law.{name}"]) for name in ("P", "I", "D", "FF1", "FF2")
        )
        # the foreign pid differences the error to the older target, LinuxCNC's the present one: D T of acceleration
        FF2 -= D * log.T if t["law.previous_target"] else 0.0
        pid = {"P": P, "I": I, "D": D, "FF1": FF1, "FF2": FF2}
        forms = [{name: value for name, value in pid.items() if value}]
        if not I:
            late = P / D * log.T if t["law.previous_target"] else 0.0
            forms.append({"Kv": P / D, "Kp": D, "velocity_feedforward": 1.0 + FF1 / D - late})
        elif not FF1 and P * P > 4.0 * I * D:
            root = np.sqrt(P * P - 4.0 * I * D)
            forms += [{"Kv": (P + s * root) / (2.0 * D), "Kp": D, "Tn": 2.0 * D / (P - s * root)} for s in (1.0, -1.0)]
        return forms
    Kv, Kp, rate, ff, n = (float(t[f"law.{name}"]) for name in ("Kv", "Kp", "rate", "ff", "n"))
    if rate and ff == 1.0 and np.max(np.abs(log.setpoint - log.position)) < t["law.dead_band"]:
        # the error never leaves the dead band: the integral of the velocity error alone is a P-P law
        return [{"Kv": rate, "Kp": Kp}]
    form = {"Kv": Kv, "Kp": Kp} | ({"Tn": 1.0 / rate} if rate else {}) | ({"velocity_feedforward": ff} if ff else {})
    forms = [form]
    if rate and ff == 1.0:
        # the same law with one sample; with more, nearly
        forms += [form | {"Kv": rate, "Tn": 1.0 / Kv}] if n == 1 else []
        forms.append({"P": Kp * (Kv + rate), "I": Kp * Kv * rate, "D": Kp})
    return forms


def compared(reading: LawReading, form: dict[str, float], T: float) -> tuple[list[float], list[float]] | None:
    """Return the errors of the gains, in standard errors and relative; None if the reading is of another form."""
    gains = {e.name: e for e in reading.estimates}
    wanted = dict(form)
    older = reading.structure.older if "Kv" in form else 0
    # a setpoint one sample older, and half a sample of the planner's velocity, are shares of the feedforward
    if older and "velocity_feedforward" in wanted:
        wanted["velocity_feedforward"] += wanted["Kv"] * T
    fed = abs(wanted.get("FF2", 0.0))
    if fed < 1e-9 or ("FF2" not in gains and fed < WITHIN * wanted["D"] * T):
        wanted.pop("FF2", None)
    for name in ("velocity_feedforward", "FF1", "FF2"):
        if name in wanted and name not in gains:
            share = {"one": 1.0, "none": 0.0}.get(reading.structure.forward, np.nan)
            if name == "velocity_feedforward" and abs(wanted[name] - share) < WITHIN:
                del wanted[name]
    core = {"Kv", "Kp", "Tn", "P", "I", "D"}
    if {name for name in gains if name in core} != {name for name in wanted if name in core}:
        return None
    z, relative = [], []
    for name, value in wanted.items():
        if name not in gains:
            return None
        off = gains[name].value - value
        z.append(off / gains[name].error if gains[name].error > 0.0 else 0.0)
        relative.append(off / value)
    return z, relative


def judged(found: ControlFit, log: ForeignLog) -> tuple[bool, list[float], list[float]]:
    """Return whether a reading is the law that ran, and its errors."""
    best: tuple[bool, list[float], list[float]] = (False, [], [])
    size = np.inf
    for reading in found.readings:
        for form in truth(log):
            both = compared(reading, form, log.T)
            if both is None:
                continue
            z, relative = both
            right = all(abs(r) < WITHIN or abs(s) < 2.0 * NORMAL for s, r in zip(z, relative, strict=True))
            if max(map(abs, relative)) < size:
                size, best = max(map(abs, relative)), (right, z, relative)
    return best


def rows(kinds: list[str], seed: int, count: int, batch: int) -> Iterator[Row]:
    """Yield a row a log."""
    for place, kind in enumerate(kinds):
        for begin in range(0, count, batch):
            for log in drawn(kind, seed + 100 * place + begin, min(batch, count - begin)):
                yield row(log)


def row(log: ForeignLog) -> Row:
    """Identify the law of one log."""
    began = time.process_time()
    try:
        motion = MotionLog(
            name=log.kind, position=log.position, force=log.force, set_position=log.setpoint, sample_time=log.T
        )
        found = identify_control(motion)
    except FeeddriveError as error:
        return Row(log.kind, "refused", False, (), (), time.process_time() - began, str(error))
    seconds = time.process_time() - began
    # a law outside of the families that is nearly one of them counts by its gains, too
    gains = "law.Kp" in log.truth or "law.P" in log.truth
    right, z, relative = judged(found, log) if gains else (False, [], [])
    words = found.readings[0].name + (" with other readings" if found.other_readings else "")
    return Row(log.kind, "near" if found.near else "law", right, tuple(z), tuple(relative), seconds, words)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser()
    options.add_argument("--seed", type=int, default=5000)
    options.add_argument("--count", type=int, default=20)
    options.add_argument("--outside", type=int, default=8)
    options.add_argument("--batch", type=int, default=5)
    options.add_argument("--kinds", nargs="*", default=[*KINDS, *OUTSIDE])
    options.add_argument("--detail", action="store_true")
    chosen = options.parse_args()
    print(
        "| log | logs | law right | law wrong | near (right) | refused | gains off: median, 90 % "
        "| coverage | CPU s: median, worst |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind in chosen.kinds:
        count = chosen.count if kind in KINDS else chosen.outside
        made = list(rows([kind], chosen.seed + 1000 * [*KINDS, *OUTSIDE].index(kind), count, chosen.batch))
        line(kind, made)
        if chosen.detail:
            for one in made:
                if not (one.outcome == "law" and one.right):
                    print(
                        "   ", one.outcome, one.words[:150], np.round(one.relative, 3), np.round(one.z, 1), flush=True
                    )


def line(kind: str, made: list[Row]) -> None:
    """Print one line of the table."""
    laws, near = ([one for one in made if one.outcome == outcome] for outcome in ("law", "near"))
    refused = len(made) - len(laws) - len(near)
    right = [one for one in laws if one.right]
    relative = np.abs([r for one in right for r in one.relative])
    z = np.abs([s for one in right for s in one.z])
    off = f"{100 * np.median(relative):.2g} %, {100 * np.quantile(relative, 0.9):.2g} %" if relative.size else "-"
    covered = f"{np.mean(z < NORMAL):.2f} of {z.size}" if z.size else "-"
    seconds = [one.seconds for one in made]
    cpu = f"{np.median(seconds):.1f}, {max(seconds):.1f}" if seconds else "-"
    near_right = f"{len(near)} ({sum(one.right for one in near)})"
    print(
        f"| {kind} | {len(made)} | {len(right)} | {len(laws) - len(right)} | {near_right} | {refused} | {off} "
        f"| {covered} | {cpu} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
