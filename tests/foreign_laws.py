"""Foreign logs of known control laws, by kind, for the tests and the table of the identification of laws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import foreign_axis as fa

# kind: law of `foreign_axis`, options of its draw, changes of the law that is drawn
KINDS: dict[str, dict[str, Any]] = {
    "P-P": {"law": "P-P"},
    "P-PI": {"law": "P-PI"},
    "P-PI, two masses": {"law": "P-PI", "two": True},
    "P-PI with a reference model": {"law": "P-PI model"},
    "PID": {"law": "PID"},
    "rounded setpoint": {"law": "P-PI", "rounded": True},
    "load encoder": {"law": "P-PI", "two": True, "load": True},
    "coloured noise": {"law": "P-PI", "colour": 0.9},
    "friction feedforward": {"law": "P-PI", "friction": True},
    "PID, two masses": {"law": "PID", "two": True},
}
OUTSIDE = {kind: {"law": kind} for kind in (*fa.OUTSIDE, "PI speed loop")}


@dataclass(frozen=True, eq=False)
class ForeignLog:
    """A log of one axis, with the kind that it is drawn from and its truth."""

    kind: str
    position: np.ndarray
    setpoint: np.ndarray
    force: np.ndarray
    T: float
    truth: dict[str, Any]


def drawn(kind: str, seed: int, count: int, seconds: float = 6.0) -> Iterator[ForeignLog]:
    """Yield `count` logs of a kind; the structure (rate, move, samples of the velocity) is drawn once for all."""
    options = dict({**KINDS, **OUTSIDE}[kind])
    rounded, load, friction = (options.pop(name, False) for name in ("rounded", "load", "friction"))
    rng = np.random.default_rng(seed)
    options.setdefault("two", False)
    T = float(rng.choice((5e-4, 1e-3)))
    move = str(rng.choice(fa.MOVES[:4]))

    def with_friction(law: Any, axes: fa.Axes) -> Any:
        return replace(law, friction_ff=0.7 * axes.coulomb_positive)

    change = with_friction if friction else None
    logs = fa.draw(rng, count=count, T=T, move=move, seconds=seconds, rotary=False, change=change, **options)
    for i in range(count):
        if not logs.stable[i]:
            continue
        log = logs.log(i, first=round(rng.uniform(0.05, 0.6) / T))
        setpoint = log["setpoint"]
        if rounded:
            count_length = fa.log_uniform(rng, 1e-7, 5e-6)
            setpoint = np.rint(setpoint / count_length) * count_length
        truth = {name: logs.true(name, i) for name in logs.truth if np.ndim(logs.truth[name]) < 2}
        yield ForeignLog(
            kind,
            log["position_load" if load else "position"],
            setpoint,
            log["force"],
            T,
            truth,
        )
