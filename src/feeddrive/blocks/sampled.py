"""Common checks for references and loads, which are sampled before the run, are not traced, and have no variants."""

import numpy as np

from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity

# s, nearly four months: a motion that long has a parameter in a wrong unit
LONGEST = 1e7
# share of a row spacing by which kT may miss a row: rounding exceeds it only after 1e9 samples
_ROUNDING = 1e-6


def check_single(block: Block) -> None:
    """Raise StructureError if a parameter is an array of variants; a batch shares its references and loads."""
    for name, declared in declarations(type(block)).items():
        value = getattr(block, name)
        if declared.role == "parameter" and value is not None and not isinstance(value, float):
            raise StructureError(
                f"{block.kind}.{name} ({declared.meaning}) holds variants; references and loads take one number each"
            )


def are_all(parts: object, family: type[Block]) -> bool:
    """Return True if `parts` is a nonempty tuple of blocks of the family; no other code checks this."""
    return isinstance(parts, tuple) and bool(parts) and all(isinstance(part, family) for part in parts)


def check_duration(kind: str, duration: float) -> None:
    """Raise StructureError for a duration that is negative or longer than `LONGEST`."""
    if not 0.0 <= duration <= LONGEST:
        raise StructureError(
            f"{kind} would take {Quantity(duration, 's'):3 SI}, more than {Quantity(LONGEST, 's'):6 SI}: check the "
            "units of its parameters"
        )


def check_order(kind: str, start: float, end: float | None) -> None:
    """Raise ParameterError if the end is not after the start."""
    if end is not None and not end > start:
        raise ParameterError(
            f"{kind}.end = {Quantity(end, 's'):6 SI} must be > {kind}.start = {Quantity(start, 's'):6 SI}; leave it "
            "out to never end"
        )


def check_source(kind: str, feed_per_turn: float | None, reference: Block | None) -> None:
    """Raise StructureError unless exactly one of a feed per turn and a reference says how thick the chip is."""
    if (feed_per_turn is None) == (reference is None):
        raise StructureError(
            f"{kind} takes its chip from either feed_per_turn (m) or a reference (the motion of the feed): give "
            "exactly one of them"
        )


def since(t: np.ndarray, start: float) -> np.ndarray:
    """Return a mask that is True at and after `start`, also for a t = kT that is below `start` only by rounding.

    The tolerance of 1e-12 s plus 1e-14 of `start` is far below any sample time and far above the rounding error of a
    product kT, and is enough for a `start` written with 15 digits.
    """
    return t >= start - (1e-12 + 1e-14 * abs(start))


def rows_at(t: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times in units of rows, rounded to a row within the rounding error, and a mask of the times on a row."""
    place = t / sample_time
    near = np.rint(place)
    on_row = np.abs(place - near) <= _ROUNDING
    return np.where(on_row, near, place), on_row
