"""Share of pairs of logs whose clock or force is wrong that a second log tells, and of fair pairs that are doubted.

    python benchmarks/second_source.py --draws 12 --seed 1

Two logs of each axis come from the simulator of the tests, which shares no code with feeddrive: axes, friction, noise,
counts and gains are drawn, each log has a move of its own, and the law is the same in both.  In the second log the
clock or the force is stated wrong by a factor.  The table of docs/how_to/identification.md is that of seeds 1, 2 and 3.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import foreign_axis as fa
from feeddrive.files.columns import Column
from feeddrive.files.role_checks import doubts_of
from feeddrive.identification.motion.identify import Identified, identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.pooled import pool_logs
from feeddrive.language.errors import FeeddriveError, LogError
from feeddrive.language.judgment import Judgment

T = 1e-3
SECONDS = 5.0
FAMILIES = ("P-P", "P-PI", "PID")
# factors of sample time and force that are stated in the second log
CASES = {"fair": (1.0, 1.0), "clock 2 % slow": (1.02, 1.0), "clock 2 % fast": (0.98, 1.0), "force 1.05": (1.0, 1.05)}
CAUSE = {
    "fair": "",
    "clock 2 % slow": "the sample time",
    "clock 2 % fast": "the sample time",
    "force 1.05": "the force",
}

Channels: TypeAlias = dict[str, np.ndarray]  # of a log, by role


def pairs(rng: np.random.Generator, family: str, draws: int) -> Iterator[tuple[Channels, Channels, np.ndarray]]:
    """Two logs of each of some axes, and the true velocity of the second one."""
    axes = [fa.draw_axes(rng, T, two=False, creep=0.0) for _ in range(draws)]
    laws = [fa.draw_law(rng, one, T, family, n=1) for one in axes]
    rows = round(SECONDS / T)
    moves = [fa.draw_move(rng, T, str(rng.choice(("dwells", "no dwells"))), SECONDS) for _ in range(2 * draws)]
    xs = np.stack([np.pad(x, (0, max(rows - len(x), 0)), mode="edge")[:rows] for x in moves])
    logs = fa.simulate(
        fa._stack(axes * 2, fa.SHARED), fa._stack(laws * 2, fa.SHARED), xs, T, rng, count=2 * draws, substeps=4
    )
    for i in range(draws):
        if logs.stable[i] and logs.stable[draws + i]:
            yield logs.log(i), logs.log(draws + i), logs.hidden["velocity"][draws + i]


def identified(log: Channels, name: str, clock: float = 1.0, force: float = 1.0) -> Identified:
    return identify_motion(
        MotionLog(
            name=name,
            position=log["position"],
            force=force * log["force"],
            set_position=log["setpoint"],
            sample_time=clock * T,
        )
    )


def told(a: Identified, second: Channels, case: str) -> str:
    """What the pair leads to: named, another cause, not trusted, recommended, or refused."""
    clock, force = CASES[case]

    def again(k: int, friction: str) -> Identified:
        log = a.log if k == 0 else b.log
        return identify_motion(log, friction=friction)

    try:
        b = identified(second, "b.csv", clock, force)
    except FeeddriveError:
        return "refused alone"
    if a.advice.judgment.bad or b.advice.judgment.bad:
        return "not recommended alone"
    try:
        found = pool_logs([a, b], again)
    except LogError as error:
        return "named" if CAUSE[case] and CAUSE[case] in str(error) else "refused"
    if found.contradicted:
        return "named" if CAUSE[case] and CAUSE[case] in str(found.contradicted) else "another cause"
    return "recommended" if found.advice.judgment is Judgment.USE_VALUES else "not trusted"


def by_velocity(log: Channels, velocity: np.ndarray, clock: float) -> bool:
    """True if a velocity column, rounded to 0.1 mm/s, contradicts the clock."""
    channels = {"position_load": log["position"], "velocity_load": np.rint(velocity / 1e-4) * 1e-4}
    columns = {role: Column(name=role) for role in channels}
    return any(doubt.kind == "clock" for doubt in doubts_of(channels, columns, clock * T, {}))


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--draws", type=int, default=12, help="axes of each family of laws")
    asked.add_argument("--seed", type=int, default=1)
    options = asked.parse_args()
    rng = np.random.default_rng(options.seed)
    counts: dict[str, Counter[str]] = {case: Counter() for case in CASES}
    velocity: dict[str, Counter[bool]] = {case: Counter() for case in CASES if "force" not in case}
    for family in FAMILIES:
        for first, second, speed in pairs(rng, family, options.draws):
            for case, seen in velocity.items():
                seen[by_velocity(second, speed, CASES[case][0])] += 1
            try:
                a = identified(first, "a.csv")
            except FeeddriveError:
                for seen in counts.values():
                    seen["refused alone"] += 1
                continue
            for case, seen in counts.items():
                seen[told(a, second, case)] += 1
    for case, seen in counts.items():
        print(f"{case:16}", dict(seen.most_common()))
    for case, seen in velocity.items():
        print(f"velocity, {case:16}", f"{seen[True]} of {seen.total()} doubted")


if __name__ == "__main__":
    main()
