"""The transfer from a force error to the following error; iterative feedforward filters its regressors with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.lifting import Lifted, linear_model
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop

FORMS = ("model_free", "model_based", "axis_model")
_TINY = 1e-6  # of the axis's mass: replaces a mass of 0, which a plant refuses
_ENDS = ("motor", "load")
_EDGE = 1.0 - 1e-9  # of |z|: what eigenvalues of a small matrix are uncertain by
_DECADES, _STRIDE = 7.0, 0.1  # range and resolution of the search for an admissible mass


def error_model(
    loop: Loop, form: str = "model_free", *, plant: Plant | None = None, least_mass: float = 0.0
) -> StateSpace | Lifted:
    """Return Ĝ_d: from a force that the feedforward lacks, in N, to the following error, in m, at the loop's sample
    time.

        e = x_set - x = G_d [φᵀ (θ0 - θ) + w],   G_d = P / (1 + P C)

    model_free   Ĝ_d = 1/C: the inverse of the controller, from its own gains alone.  Good where |P C| >> 1, as in the
                 band of usual references.  Prefilter and filter pack are left out: they are 1 in that band.
    model_based  Ĝ_d = P̂/(1 + P̂ C) with the drive's dead time and current loop.  P̂ is `plant`; else a rigid axis with
                 the mass (at least `least_mass`, kg) and the viscous friction that are fed forward now; else, if no
                 mass is fed forward or the law needs two encoders, the axis itself.
    axis_model   the same with the axis of the loop: for a machine file whose axis was identified.

    C comes from the linear model of the control itself, that is, from the simulated code, for any law. For a law with
    two rates Ĝ_d has a model for each sample of a period: feedforward, its columns and the error are those of the fast
    samples.  A trial is taken to begin where the slow part runs; another beginning changes next to nothing.
    Raises UnstableError, with the nearest mass that is admissible, for a model loop that is not stable; UnstableError
    for a controller without a stable inverse; ParameterError for another form.
    Source: Wu, Han, Xiong & Ding 2017, eq. (1)-(10), the part that was available; the three forms of Ĝ_d, the
    model-free inverse among them, and the sampled form are this library's.
    """
    if form not in FORMS:
        raise ParameterError(f"form = {form!r} must be one of {', '.join(FORMS)}")
    if form == "model_free":
        return _inverse(loop)
    if form == "axis_model":
        return true_error_model(loop)
    block = next((block for block in loop.control.feedforward if isinstance(block, DisturbanceCompensator)), None)
    if plant is not None or block is None or block.mass is None or loop.control.law.encoders > 1:
        return _required(loop, plant)
    mass = max(block.mass, least_mass, _TINY * float(loop.axis.plant.rigid_mass()))
    return _required(loop, Rigid(mass=mass, viscous=block.viscous or 0.0))


def true_error_model(loop: Loop) -> StateSpace | Lifted:
    """Return G_d of a simulated loop without friction and quantizers, as the reference for a Ĝ_d."""
    return _required(loop, None)


def _samples(model: StateSpace | Lifted) -> tuple[StateSpace, ...]:
    return model.samples if isinstance(model, Lifted) else (model,)


def filtered(model: StateSpace | Lifted, columns: np.ndarray, *, moving: bool = False) -> np.ndarray:
    """Filter columns, shape (n, columns), through a model with one input and one output; the first row is its first
    sample.

    Before the first row the columns are taken as 0, or, if the axis was `moving`, as those of the first row.
    """
    samples = _samples(model)
    N, n = len(samples), samples[0].A.shape[0]
    state = np.zeros((n, columns.shape[1]))
    if moving and n:
        through, pushed = np.eye(n), state
        for sample in samples:
            through, pushed = sample.A @ through, sample.A @ pushed + sample.B[:, :1] @ columns[:1]
        state = np.linalg.solve(np.eye(n) - through, pushed)
    states = np.empty((columns.shape[0], n, columns.shape[1]))
    for k, row in enumerate(columns):
        states[k] = state
        state = samples[k % N].A @ state + row * samples[k % N].B[:, :1]
    outputs = np.empty(columns.shape)
    for k, sample in enumerate(samples):
        output = (sample.C[:1] @ states[k::N])[:, 0, :] + sample.D[0, 0] * columns[k::N]
        outputs[k::N] = output
    return outputs


def decay(model: StateSpace | Lifted, share: float = 0.01) -> int:
    """Return the samples after which the slowest motion of a model has fallen to a share."""
    slowest = _growth(model)
    turns = 1.0 if slowest <= 0.0 else np.log(share) / np.log(min(slowest, 1.0 - 1e-9))
    return max(1, len(_samples(model)) * int(np.ceil(turns)))


def _required(loop: Loop, plant: Plant | None) -> StateSpace | Lifted:
    """Return the model loop's G_d, if it is stable; without a plant that of the axis with its viscous friction."""
    model = _closed(loop, plant)
    size = _growth(model)
    if size < _EDGE:
        return model
    reason = f"is not stable: |z| = {Quantity(size):.6f} must be < 1, it is {number(size - 1.0, 2)} too large"
    near = None if not isinstance(plant, Rigid) else _nearest(loop, plant)
    if near is None or not isinstance(plant, Rigid):
        what = "the axis" if plant is None else f"the plant '{plant.kind}'"
        raise UnstableError(f"the model loop with {what} {reason}: these gains are not those of a loop with this axis")
    raise UnstableError(
        f"the model loop with a mass of {Quantity(plant.mass, 'kg')} {reason}; the nearest admissible mass is "
        f"{Quantity(near, 'kg')}: start from another mass, give the plant, or take form = 'model_free', which needs no "
        "mass"
    )


def _closed(loop: Loop, plant: Plant | None) -> StateSpace | Lifted:
    """Return the linear closed loop from a force behind the limit to the position, without all nonlinear parts."""
    control = dataclasses.replace(loop.control, guard=None, force_limit=None, feedforward=(), prefilter=None)
    ends: dict[str, Any] = {
        f"encoder_{end}": None if getattr(loop.axis, f"encoder_{end}") is None else Encoder() for end in _ENDS
    }
    for end in _ENDS:
        friction = getattr(loop.axis, f"friction_{end}") if plant is None else None
        ends[f"friction_{end}"] = None if friction is None else Viscous(viscous=float(friction.linear()))
    axis = dataclasses.replace(loop.axis, plant=plant or loop.axis.plant, forces=(), **ends)
    return linear_model(dataclasses.replace(loop, control=control, axis=axis), ["added_force"], ["position_load"])


def _growth(model: StateSpace | Lifted) -> float:
    """Return |z| of the largest pole, over a period."""
    return float(np.max(np.abs(model.poles()), initial=0.0))


def _nearest(loop: Loop, plant: Rigid) -> float | None:
    """Return the mass nearest to that of the plant, by ratio, with which the model loop is stable, to four digits."""
    mass = plant.mass

    def stable(log: float) -> bool:
        return _growth(_closed(loop, tree.vary(plant, {"mass": mass * 10.0**log}))) < _EDGE

    grid = np.arange(_STRIDE, _DECADES, _STRIDE)
    for away in grid:
        for sign in (1.0, -1.0):
            if stable(sign * away):
                low, high = away - _STRIDE, away
                for _ in range(14):
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if stable(sign * middle) else (middle, high)
                return mass * 10.0 ** (sign * high)
    return None


def _inverse(loop: Loop) -> StateSpace | Lifted:
    """Return 1/C, with C from both readings, moved together, to the force."""
    control = dataclasses.replace(
        loop.control, guard=None, force_limit=None, feedforward=(), prefilter=None, filters=()
    )
    bare = dataclasses.replace(loop, control=control)
    samples = _samples(linear_model(bare, ["cut", "reading_motor", "reading_load"], ["force"]))
    push = [sample.B[:, 1:2] + sample.B[:, 2:3] for sample in samples]
    n = push[0].shape[0]
    reached = np.any([column != 0.0 for column in push], axis=(0, 2))
    for _ in range(n):
        reached = reached | np.any([sample.A[:, reached] != 0.0 for sample in samples], axis=(0, 2))
    keep = np.flatnonzero(reached)
    names = tuple(samples[0].states[i] for i in keep)
    passed = [float(sample.D[0, 1] + sample.D[0, 2]) for sample in samples]
    inverse: list[StateSpace] = []
    # the force answers the reading by -C; solved for the reading it is the inverse, with the sign of G_d
    for sample, b, d in zip(samples, push, passed if all(passed) else [], strict=False):
        back, seen = b[keep] / d, sample.C[:, keep]
        whole = sample.A[np.ix_(keep, keep)] - b[keep] @ seen / d
        rest = seen / d, np.array([[-1.0 / d]]), sample.sample_time, names, ("added_force",), ("position_load",)
        inverse.append(StateSpace(whole, back, *rest))
    inverse_model = inverse[0] if len(inverse) == 1 else Lifted(tuple(inverse))
    size = _growth(inverse_model) if inverse else np.inf
    if not size < _EDGE:
        raise UnstableError(
            f"the controller '{loop.control.law.kind}' has no stable inverse: |z| = {Quantity(size):.6f} of its zeros "
            "must be < 1: take form = 'model_based'"
        )
    return inverse_model


LEAST_REVERSAL = 0.02  # share of the moving samples in each direction that separates friction from gravity
LEAST_OWN = 0.02  # of a column's size: least part not explained by other columns, 1/50: there its error grows by 50
FRICTION = ("coulomb_positive", "coulomb_negative", "stribeck")
# of two similar columns the later one in this order is frozen
_ORDER = (
    "mass",
    "coulomb_positive",
    "coulomb_negative",
    "viscous",
    "stribeck",
    "jerk_feedforward",
    "snap_feedforward",
)


def not_excited(
    names: Sequence[str], columns: np.ndarray, seen: np.ndarray, velocity: np.ndarray, dead_band: float
) -> dict[str, str]:
    """Return the reasons, by name, why columns must be held; shape of both matrices: (samples, columns).

    columns   φ, of the set motion Ψ, the same through Ĝ_d: their effect on the error
    velocity  m/s, of the set motion in the middle of the samples
    """
    reasons = _without_reversal(names, velocity, dead_band)
    for i, name in enumerate(names):
        if name not in reasons and not np.any(columns[:, i]):
            reasons[name] = "its column is 0 in the whole trial"
    sizes = np.linalg.norm(seen, axis=0)
    alike = (seen / np.where(sizes > 0.0, sizes, 1.0)).T @ (seen / np.where(sizes > 0.0, sizes, 1.0))
    kept: list[int] = []
    for name in sorted((name for name in names if name not in reasons), key=_ORDER.index):
        i = names.index(name)
        left = _own(alike, i, kept)
        if left < LEAST_OWN:
            nearest = names[max(kept, key=lambda k: abs(float(alike[i, k])))] if kept else "none"
            reasons[name] = Text(
                f"only {Quantity(left, 'share'):2} of its column is not explained by "
                f"{_listed([names[k] for k in kept])}, at least {Quantity(LEAST_OWN, 'share'):6} is needed; it is most "
                f"like {nearest}: add a second speed, or more acceleration"
            )
        else:
            kept.append(i)
    return reasons


def _own(alike: np.ndarray, i: int, others: list[int]) -> float:
    """Return the size of the remainder of a unit column without its part along others; `alike` holds their products."""
    if alike[i, i] <= 0.0:
        return 0.0
    across = alike[others, i]
    between = alike[others][:, others]
    explained = float(across @ np.linalg.solve(between, across)) if others else 0.0
    return float(np.sqrt(max(0.0, 1.0 - explained)))


def _without_reversal(names: Sequence[str], velocity: np.ndarray, dead_band: float) -> dict[str, str]:
    forward, backward = int(np.sum(velocity > dead_band)), int(np.sum(velocity < -dead_band))
    moving = forward + backward
    share = min(forward, backward) / moving if moving else 0.0
    if share >= LEAST_REVERSAL:
        return {}
    towards = "smaller" if backward <= forward else "larger"
    missing = int(np.ceil(LEAST_REVERSAL * moving)) - min(forward, backward)
    reason = Text(
        f"the trial has no reversal: {Quantity(share, 'share'):2} of its moving samples go towards {towards} "
        f"positions, at least {Quantity(LEAST_REVERSAL, 'share'):6} are needed ({missing} samples more), else friction "
        "cannot be told from gravity or an offset"
    )
    if moving == 0:
        reason = "the axis does not move in the trial"
    return {name: reason for name in names if name in FRICTION or moving == 0}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def condition(seen: np.ndarray) -> float:
    """Return the condition number of columns that are scaled to the same size; 1 for none."""
    if not seen.shape[1]:
        return 1.0
    return float(np.linalg.cond(seen / np.linalg.norm(seen, axis=0)))


def reasons(frozen: Mapping[str, str]) -> str:
    """Return the names as one text."""
    return joined("; ", [f"{name}: {reason}" for name, reason in frozen.items()])
