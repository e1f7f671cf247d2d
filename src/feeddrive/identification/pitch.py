"""Pitch errors and backlash of an axis from positions measured over its travel."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.identification.regression import SIGNIFICANT
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run, root_mean_square
from feeddrive.machining.circle_test import CircleCauses

_MOST = 65_536  # entries of a table that an export may hold
_LEAST_SPEED = 1e-6  # m/s: slower is standing


@dataclass(frozen=True, eq=False, repr=False)
class LearnedPitch(Result):
    """A pitch compensation with the RMS errors before and after it (m) and the number of samples per direction."""

    compensation: PitchCompensation
    before: float
    after: float
    samples: tuple[int, int]

    @property
    def backlash(self) -> float:
        """The backlash in m: the mean difference between the tables of the two directions."""
        return float(np.mean(self.compensation.forward - self.compensation.backward))

    def table(self) -> Table:
        """Return a table of the size, the errors and the backlash of the compensation."""
        block = self.compensation
        peak = max(float(np.max(np.abs(entries))) for entries in (block.forward, block.backward))
        start, spacing = (Quantity(value, "m", form="6 mm") for value in (block.table_start, block.spacing))
        rows: list[list[Cell]] = [
            ["entries", len(block.forward)],
            ["from", Text(f"{start}, every {spacing}")],
            ["largest entry", Quantity(peak, "m", form="3")],
            ["backlash, mean", Quantity(self.backlash, "m", form="3")],
            ["error before, RMS", Quantity(self.before, "m", form="3")],
            ["left, RMS", Quantity(self.after, "m", form="3")],
        ]
        return Table(f"Pitch compensation learned from {sum(self.samples)} samples", ["", ""], rows)


def learned_pitch(
    nominal: np.ndarray,
    reached: np.ndarray,
    velocity: np.ndarray,
    *,
    spacing: float,
    reversal_distance: float = 1e-5,
    settle: float = 0.0,
) -> LearnedPitch:
    """Return the correction tables of the set position, by least squares over all samples of each direction.

    nominal   position measured by the controller, m
    reached   true position of table or tool, m: from a laser, a load encoder, or `tool.x` of a run
    velocity  set velocity, m/s; its sign gives the direction, samples at standstill are ignored
    spacing   distance between entries, m, starting at the lowest position
    settle    travel left out after each reversal, m, over which backlash and friction change sides

    The piecewise linear function of each direction is fitted as a whole, so that the entries do not depend on where
    the samples between them lie.  Raises ParameterError for arrays of unequal length, numbers that are not finite,
    motion in one direction only, a part of the travel without samples, and a spacing that is not positive or gives too
    many entries.
    """
    rows = [np.asarray(channel, dtype=np.float64) for channel in (nominal, reached, velocity)]
    if len({channel.shape for channel in rows}) != 1 or rows[0].ndim != 1:
        raise ParameterError(
            f"nominal, reached and velocity need one length, not {[channel.shape for channel in rows]}"
        )
    if not all(np.all(np.isfinite(channel)) for channel in rows):
        raise ParameterError("nominal, reached and velocity hold numbers that are not finite: leave those samples out")
    if not spacing > 0.0:
        raise ParameterError(f"spacing = {Quantity(spacing, 'm'):6 SI} must be > 0")
    nominal, reached, velocity = rows
    moves = np.abs(velocity) > _LEAST_SPEED
    way = np.where(moves, np.sign(velocity), 0.0)
    if settle > 0.0:
        way[_turning(nominal, way, settle)] = 0.0
    if not np.any(way > 0.0) or not np.any(way < 0.0):
        raise ParameterError("the motion goes one way only: both directions are needed, there and back")
    low, high = float(np.min(nominal[way != 0.0])), float(np.max(nominal[way != 0.0]))
    # a travel of a whole number of spacings must not get one more entry by rounding
    count = max(2, round(np.ceil((high - low) / spacing * (1.0 - 1e-9))) + 1)
    if count > _MOST:
        raise ParameterError(
            f"{count} entries are more than {_MOST}: take a larger spacing than {Quantity(spacing, 'm'):6 SI}"
        )
    added = nominal - reached
    tables, left = [], []
    for sign in (1.0, -1.0):
        chosen = way == sign
        entries = _hats((nominal[chosen] - low) / spacing, added[chosen], count, "forward" if sign > 0 else "backward")
        tables.append(entries)
        left.append(added[chosen] - np.interp(nominal[chosen], low + spacing * np.arange(count), entries))
    block = PitchCompensation(
        forward=tables[0], backward=tables[1], table_start=low, spacing=spacing, reversal_distance=reversal_distance
    )
    before, after = added[way != 0.0], np.concatenate(left)
    sizes = int(np.sum(way > 0.0)), int(np.sum(way < 0.0))
    return LearnedPitch(block, root_mean_square(before), root_mean_square(after), sizes)


def _turning(nominal: np.ndarray, way: np.ndarray, settle: float) -> np.ndarray:
    """Return a mask of the samples within `settle` (m) of travel after a reversal."""
    turning = np.zeros(len(way), bool)
    last, since = 0.0, np.inf
    for k in range(len(way)):
        # the first motion counts as a reversal, since the flank on which the axis stood before is not known
        if way[k] not in (0.0, last):
            last, since = way[k], 0.0
        elif k:
            since += abs(nominal[k] - nominal[k - 1])
        turning[k] = since < settle
    return turning


def _hats(place: np.ndarray, values: np.ndarray, count: int, named: str) -> np.ndarray:
    """Return the values at 0, 1, ... of the piecewise linear least-squares fit to `values` at `place`."""
    from scipy.linalg import solveh_banded

    below = np.clip(np.floor(place).astype(int), 0, count - 2)
    share = place - below
    missing = np.setdiff1d(np.arange(count - 1), below)
    if missing.size:
        raise ParameterError(
            f"the {named} motion has no sample between entries {missing[0]} and {missing[0] + 1}: measure the whole "
            f"travel both ways, or take a larger spacing"
        )
    # hat functions overlap with their neighbors only: the normal equations are tridiagonal
    diagonal = np.bincount(below, (1.0 - share) ** 2, count) + np.bincount(below + 1, share**2, count)
    beside = np.bincount(below + 1, share * (1.0 - share), count)
    right = np.bincount(below, (1.0 - share) * values, count) + np.bincount(below + 1, share * values, count)
    # an entry that hardly a sample touches would make the equations singular
    diagonal += 1e-12 * np.max(diagonal)
    return np.asarray(solveh_banded(np.stack([beside, diagonal]), right))


def learned_from(run: Run, axis: str, *, spacing: float, reached: str = "", settle: float = 0.0) -> LearnedPitch:
    """Return the pitch compensation of an axis from a run of its machine, back and forth over the travel.

    reached  signal of the true position; default: `tool.AXIS` of a machine with geometry errors, otherwise the true
             position of the table
    Raises ParameterError as `learned_pitch` does, and for a signal that the run does not have.
    """
    prefix = f"{axis}." if f"{axis}.set_velocity" in run.signals else ""
    signal = reached or (f"tool.{axis}" if f"tool.{axis}" in run.signals else f"{prefix}position_load")
    return learned_pitch(
        run[f"{prefix}reading_load"], run[signal], run[f"{prefix}set_velocity"], spacing=spacing, settle=settle
    )


def learned_from_circles(
    causes: CircleCauses, travel: Mapping[str, tuple[float, float]], *, reversal_distance: float = 1e-5
) -> dict[str, PitchCompensation]:
    """Return compensations by axis for the scale errors and the backlash of a circle test: -scale x ± backlash/2.

    A scale error or backlash within 3 standard errors of 0 is not compensated, and an axis with neither is left out.
    Raises ParameterError if no axis has one, if the circles do not separate them, and for a travel beyond the positions
    that the circles measured.
    """
    names = [cause.name.removeprefix("backlash ") for cause in causes.causes if cause.name.startswith("backlash ")]
    for name in ("scale, mean", "scale, difference", *(f"backlash {axis}" for axis in names)):
        # a cause that the circles do not separate from others has an infinite error
        if not np.isfinite(causes[name].error):
            raise ParameterError(f"the circles do not separate '{name}': {causes[name].note}")
    mean, half = causes["scale, mean"], causes["scale, difference"]
    compensations: dict[str, PitchCompensation] = {}
    small: list[str] = []
    for axis, sign in zip(names, (1.0, -1.0), strict=True):
        if axis not in travel or not travel[axis][0] < travel[axis][1]:
            raise ParameterError(f"travel: axis '{axis}' needs its two ends in m, the lower one first")
        _check_measured(axis, travel[axis], causes.measured.get(axis))
        gap = causes[f"backlash {axis}"]
        found = {
            "scale error": (mean.value + sign * half.value, float(np.hypot(mean.error, half.error)), "", "ppm"),
            "backlash": (gap.value, gap.error, "m", "um"),
        }
        sure = {name: value if abs(value) > SIGNIFICANT * error else 0.0 for name, (value, error, *_) in found.items()}
        if not any(sure.values()):
            small += [
                Text(f"{name} {axis} {Quantity(value, unit, error, form=f'4 {shown}')}")
                for name, (value, error, unit, shown) in found.items()
            ]
            continue
        ends = np.array(travel[axis], dtype=np.float64)
        # a scale error is linear along the travel, so that two entries at its ends suffice
        compensations[axis] = PitchCompensation(
            forward=-sure["scale error"] * ends + 0.5 * sure["backlash"],
            backward=-sure["scale error"] * ends - 0.5 * sure["backlash"],
            table_start=float(ends[0]),
            spacing=float(ends[1] - ends[0]),
            reversal_distance=reversal_distance,
        )
    if not compensations:
        raise ParameterError(
            f"nothing to compensate: {', '.join(small)} are within {Quantity(SIGNIFICANT):6} standard errors of 0: "
            "measure with a slower feed or a larger radius"
        )
    return compensations


_BEYOND = 0.01  # of the measured positions: a compensated travel may exceed them by the errors of the circles


def _check_measured(axis: str, travel: tuple[float, float], measured: tuple[float, float] | None) -> None:
    """Raise ParameterError for a travel beyond the positions that the circles measured."""
    if measured is None:
        return
    slack = _BEYOND * (measured[1] - measured[0])
    if travel[0] < measured[0] - slack or travel[1] > measured[1] + slack:
        low, high, from_, to = (Quantity(end, "m", form="6 mm") for end in (*travel, *measured))
        raise ParameterError(
            f"travel of '{axis}', {low} to {high}: the circles measured {from_} to {to} only: give this range, or "
            "measure larger circles"
        )
