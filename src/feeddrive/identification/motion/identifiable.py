"""Whether a motion holds what a rigid drive is asked for, and if not what to measure next."""

from __future__ import annotations

import numpy as np

from feeddrive.identification.frame import Frame
from feeddrive.language.errors import NotIdentifiableError

LEAST_REVERSAL = 0.05  # share of the moving rows that must go each way
LEAST_OWN = 0.02  # share of a column's size that the other columns must leave unexplained
LARGEST_ERROR = 0.5  # standard error over value, of a mass that counts as found


def check_motion(name: str, velocity: np.ndarray, frame: Frame) -> None:
    """Raise NotIdentifiableError for a motion in one direction only, or without any."""
    top = float(np.max(np.abs(velocity)))
    forward, backward = (int(np.sum(sign * velocity > 0.05 * top)) for sign in (1.0, -1.0))
    moving = forward + backward
    if not moving:
        raise NotIdentifiableError(f"{name}: the axis does not move; record a move to and fro")
    share = min(forward, backward) / moving
    if share < LEAST_REVERSAL:
        towards = "smaller" if backward < forward else "larger"
        raise NotIdentifiableError(
            f"{name}: not identifiable: only {100.0 * share:.2g} % of the motion goes towards {towards} "
            f"positions, at least {100.0 * LEAST_REVERSAL:g} % are needed: in one direction friction cannot be "
            f"told from a constant force; record next a move to and fro over the same travel, at {top:.3g} "
            f"{frame.velocity} or more"
        )


def check_columns(name: str, columns: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError for a column that the others explain: its parameter can have any value."""
    sizes = np.linalg.norm(columns, axis=0)
    for i, each in enumerate(names):
        if sizes[i] == 0.0:
            raise NotIdentifiableError(f"{name}: not identifiable: {_next(each)}")
        others = np.delete(columns, i, axis=1)
        left = columns[:, i] - others @ np.linalg.lstsq(others, columns[:, i], rcond=None)[0]
        own = float(np.linalg.norm(left)) / float(sizes[i])
        if own < LEAST_OWN:
            raise NotIdentifiableError(
                f"{name}: {each} is not identifiable: {100.0 * (1.0 - own):.4g} % of its column is a sum of the "
                f"others; {_next(each)}"
            )


def check_mass(name: str, value: float, error: float, unit: str) -> None:
    """Raise NotIdentifiableError for an inertia that is not positive, or hardly known."""
    if value <= 0.0 or error > LARGEST_ERROR * value:
        raise NotIdentifiableError(
            f"{name}: mass is not identifiable: {value:.3g} {unit} with a standard error of {error:.2g} {unit}; "
            f"{_next('mass')}"
        )


def _next(parameter: str) -> str:
    if parameter.startswith(("mass", "inertia")):
        return (
            "the log holds hardly any acceleration; record next moves with short ramps: the inertial force should be "
            "at least as large as friction for a tenth of the time"
        )
    if parameter.startswith("viscous"):
        return "the speed hardly changes; record next moves at three speeds at least, in both directions"
    return "record next moves at several speeds in both directions, with ramps between them"
