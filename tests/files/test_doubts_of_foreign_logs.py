"""Wrong and right roles of logs from a simulator that shares no code with the package: what is said, and how often.

python tests/files/test_doubts_of_foreign_logs.py 401 402 403      # the figures of docs/reference/files.md
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import foreign_axis as fa
from feeddrive.files.columns import Column
from feeddrive.files.role_checks import doubts_of, roles_by_shape

Channels = dict[str, np.ndarray]


def logs(seed: int, structures: int, count: int) -> Iterator[tuple[Channels, Channels, float]]:
    """Channels by role of drawn logs, those of another axis of the same structure, and the sample time."""
    rng = np.random.default_rng(seed)
    for _ in range(structures):
        two = bool(rng.integers(3) > 0)
        law, move = str(rng.choice([*fa.LAWS])), str(rng.choice(["dwells", "no dwells", "dwells", "constant speeds"]))
        drawn = fa.draw(rng, count=count, law=law, two=two, move=move, seconds=4.0, with_pulses=bool(rng.integers(2)))
        there = [i for i in range(count) if drawn.stable[i]]
        for k, i in enumerate(there):
            log, other = drawn.log(i), drawn.log(there[k - 1])
            yield by_role(log, two), by_role(other, two), float(log["time"][1] - log["time"][0])


def by_role(log: Mapping[str, np.ndarray], two: bool) -> Channels:
    own = {"position_load": log["position"]}
    if two:
        own = {"position_motor": log["position"], "position_load": log["position_load"]}
    return {"setpoint_position": log["setpoint"], "force": log["force"], **own}


def wrong(right: Channels, other: Channels, T: float) -> Iterator[tuple[str, Channels]]:
    """The seven kinds of wrong roles, with their names."""
    x, f, r = right["position_load"], right["force"], right["setpoint_position"]
    v = np.gradient(x, T)
    plain = {role: values for role, values in right.items() if role != "position_motor"}
    yield "set and actual", {**plain, "setpoint_position": x, "position_load": r}
    if "position_motor" in right:
        yield "motor and table", {**right, "position_motor": x, "position_load": right["position_motor"]}
    yield "velocity as position", {"position_load": v, "force": f}
    rows = min(x.size, other["position_load"].size)
    if rows > x.size // 2:
        second = {"position_motor": x[:rows], "position_load": other["position_load"][:rows], "force": f[:rows]}
        yield "table of another axis", second
    yield "sign of the position", {**plain, "position_load": -x}
    yield "sign of the force", {**right, "force": -f}
    yield "mm for m", {**right, "setpoint_position": 1e3 * r}
    yield "power as force", {**plain, "force": f * v}
    yield "position and force", {"position_load": f, "force": x}


def counts(seed: int, structures: int, count: int) -> tuple[Counter[str], Counter[tuple[str, str]], Counter[str]]:
    """Doubts of right roles, answers to wrong ones (certain, said, silent), and roles found by samples alone."""
    rightly, answers, shapes = Counter[str](), Counter[tuple[str, str]](), Counter[str]()
    for right, other, T in logs(seed, structures, count):
        rightly["logs"] += 1
        found = doubts_of(right, {role: Column(name=role) for role in right}, T, {})
        rightly["certain"] += any(doubt.certain for doubt in found)
        rightly["said"] += bool(found)
        for kind, channels in wrong(right, other, T):
            said = doubts_of(channels, {role: Column(name=role) for role in channels}, T, {})
            told = "certain" if any(doubt.certain for doubt in said) else "said" if said else "silent"
            answers[kind, told] += 1
        names = {f"column_{k}": role for k, role in enumerate(right)}
        by_samples = roles_by_shape({name: right[role] for name, role in names.items()}, T)
        for role, (name, _) in by_samples.roles.items():
            shapes["right" if names[name] == role.replace("command", "force") else "wrong"] += 1
        shapes["open"] += len(right) - len(by_samples.roles)
    return rightly, answers, shapes


@pytest.mark.slow(reason="60 logs of a foreign simulator, each with nine wrong sets of roles")
def test_no_true_log_is_refused_and_no_wrong_guess_is_silent() -> None:
    """No true log is refused. One wrong set of roles in 200 may be silent: what the samples do not confirm is said."""
    rightly, answers, shapes = counts(400, 10, 6)
    assert rightly["logs"] > 40
    assert rightly["certain"] == 0
    total = sum(answers.values())
    silent = {kind: number for (kind, told), number in answers.items() if told == "silent"}
    assert sum(silent.values()) <= 0.005 * total, silent
    assert shapes["wrong"] <= 0.05 * (shapes["right"] + shapes["wrong"])


if __name__ == "__main__":
    for seed_ in map(int, sys.argv[1:]):
        true, told_, by_shape = counts(seed_, 10, 6)
        print(seed_, dict(true), dict(by_shape))  # noqa: T201
        for kind_ in dict.fromkeys(kind for kind, _ in told_):
            how_often = ", ".join(f"{told_[kind_, how]} {how}" for how in ("certain", "said", "silent"))
            print(f"    {kind_}: {how_often}")  # noqa: T201
