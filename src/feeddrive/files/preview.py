"""Peak figures of a log in the units of its columns, by which the user can check the log before any fit.

The person who recorded the log knows travel, top speed and acceleration, and can therefore notice a wrong unit, a wrong
column or another axis.  Without the rated value of a drive, the acceleration that 100 % of its force would cause is
shown instead of force and mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.files.columns import OWN_UNIT, ROLES, Column
from feeddrive.files.names import RELATIVE
from feeddrive.identification.plausibility import RANGES, sizes, spoken
from feeddrive.identification.regression import SHAFT, TABLE, Frame
from feeddrive.identification.shapes import EXPLAINED, WINDOW, Driven, driven
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Result, Table
from feeddrive.language.text import Text, joined

_PLACES = ("position_load", "position_motor", "angle_load", "angle_motor")
_SETPOINTS = {"position": "setpoint_position", "angle": "setpoint_angle"}
_ACTING = ("force", "torque", "command", "current")
_BINS = 500  # of which each keeps its smallest and its largest value, for the picture
_GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True, eq=False)
class Trace:
    """A channel reduced for plotting: minimum and maximum of each of up to `_BINS` stretches, in its own unit."""

    name: str
    role: str
    unit: str
    time: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Preview(Result):
    """Peak figures of a log, and its signals for a picture.

    length        the user's unit of lengths or angles: mm, in, deg
    sizes         travel, speed and acceleration in SI units, by the names in `plausibility.RANGES`, where available
    signal        unit of the force, or of the drive signal that replaces it
    acting        largest absolute value of this force or signal, in `signal`
    force         the user's unit of force: N, kN, Nm; empty for a drive signal
    mass          kg or kg m², or `signal` per m/s² or rad/s²; None if the force does not follow the acceleration
    traces        set and actual position, speed and force over time
    """

    name: str
    frame: Frame
    length: str
    sizes: Mapping[str, float]
    signal: str
    force: str
    acting: float | None
    mass: float | None
    traces: tuple[Trace, ...]

    @property
    def per_mass(self) -> float | None:
        """The acceleration that the largest force would cause without friction, m/s² or rad/s²; None if there is no
        mass.
        """
        return None if self.acting is None or not self.mass else self.acting / self.mass

    @property
    def is_force(self) -> bool:
        """True if the signal is in N or N m, and not in the drive's own unit."""
        return self.signal in ("N", "N m")

    def table(self) -> Table:
        """Tabulate the figures, with the usual ranges of feed drives."""
        travel, speed, acceleration, force, mass, over = RANGES[self.frame]
        rows: list[list[Cell]] = [
            [span.quantity, self._own(self.sizes[span.quantity], span.unit), span.bounds()]
            for span in (travel, speed, acceleration)
            if span.quantity in self.sizes
        ]
        if self.acting is not None and self.is_force:
            largest = Quantity(self.acting, self.signal, form=f"4 {self.force}")
            rows.append([f"largest {force.quantity}", largest, force.bounds()])
            if self.mass is not None:
                rows.append([f"{mass.quantity}, roughly", spoken(abs(self.mass), mass.unit), mass.bounds()])
                rows.append([over.quantity, spoken(abs(self.per_mass or 0.0), over.unit), over.bounds()])
        elif self.acting is not None:
            name = "signal of the drive" if self.signal else "signal of the drive, no unit"
            rows.append([f"largest {name}", self._own_signal(self.acting), ""])
            if self.mass:
                full = 100.0 if self.signal == "percent" else 1000.0 if self.signal == "permille" else self.acting
                what = "100 % would give" if self.signal in RELATIVE else "which would give"
                rows.append([f"{what}, without friction", spoken(abs(full / self.mass), over.unit), over.bounds()])
        return Table(f"{self.name}: does this look like your machine?", ["", "in this log", "feed drives have"], rows)

    def sentence(self) -> Text:
        """Return the figures as a text that asks the user whether they match the machine."""
        travel, speed, acceleration, *_ = RANGES[self.frame]
        parts = [
            Text(f"{span.quantity} {self._own(self.sizes[span.quantity], span.unit)}")
            for span in (travel, speed, acceleration)
            if span.quantity in self.sizes
        ]
        return Text(
            f"Does this look like your machine? {joined(', ', parts)}. If not, a unit, a column or the axis is wrong."
        )

    def _own(self, value: float, unit: str) -> Text:
        """Return a travel, speed or acceleration in the user's unit, with that of data sheets in parentheses."""
        if unit in ("m", "rad"):
            return Text(f"{Quantity(value, unit, form=f'4 {self.length}')}")
        if unit == "m/s":
            minute = "in/min" if self.length == "in" else "m/min"
            second = "mm/s" if self.length == "m" and value < 1.0 else f"{self.length}/s"
            return Text(f"{Quantity(value, unit, form=f'4 {second}')} ({Quantity(value, unit, form=f'3 {minute}')})")
        if unit == "rad/s":
            return Text(f"{Quantity(value, unit, form='4 rpm')}")
        if unit == "m/s2":
            return Text(f"{Quantity(value, unit, form='3 SI')} ({Quantity(value / _GRAVITY):2} g)")
        return Text(f"{Quantity(value, unit, form='3 SI')}")

    def _own_signal(self, value: float) -> Text:
        unit = {"percent": "%", "permille": "‰"}.get(self.signal, self.signal)
        return Text(f"{Quantity(value):4} {unit}".rstrip())


def preview_of(
    name: str, channels: Mapping[str, np.ndarray], columns: Mapping[str, Column], T: float, lengths: Mapping[str, str]
) -> Preview | None:
    """Return the peak figures of a log; None if the log has no position.

    channels  the log by role, in the unit of each role; a role that still needs a factor is in the unit of the file
    columns   the column of each role, with its unit
    lengths   the unit of each column in the file, by name
    """
    place = next((role for role in _PLACES if role in channels), None)
    if place is None or channels[place].size < 3:
        return None
    frame = SHAFT if place.startswith("angle") else TABLE
    x = channels[place]
    acting = next((role for role in _ACTING if role in channels), None)
    figures = {key: value for key, value in sizes(frame, T, x, None).items() if np.isfinite(value)}
    signal, force, largest, how = "", "", None, Driven(0.0, 0.0, 0.0)
    if acting is not None:
        column = columns[acting]
        stated = lengths.get(column.name, "")
        own = column.unit or ("" if column.factor is not None else stated)
        signal = own if acting in OWN_UNIT or own in RELATIVE else ROLES[acting]
        force = _unit_of(column, lengths, signal) or signal if signal in ("N", "N m") else ""
        largest = float(np.max(np.abs(channels[acting]), initial=0.0))
        how = driven(x, channels[acting], T)
    length = _length(columns[place], lengths, ROLES[place])
    traces = [
        _trace(columns[role].name, role, length, x_ / _size(length, ROLES[place]), T)
        for role in (_SETPOINTS[place.partition("_")[0]], place)
        if (x_ := channels.get(role)) is not None
    ]
    traces.append(_trace("speed", "speed", f"{length}/s", np.gradient(x, T) / _size(length, ROLES[place]), T, WINDOW))
    if acting is not None:
        traces.append(_trace(columns[acting].name, acting, signal, channels[acting], T))
    mass = how.mass if how.explained >= EXPLAINED else None
    return Preview(name, frame, length, figures, signal, force, largest, mass, tuple(traces))


def _length(column: Column, lengths: Mapping[str, str], si: str) -> str:
    """Return the user's unit of a length or angle: that of the column, if none that of the file, or mm or rad."""
    return _unit_of(column, lengths, si) or ("mm" if si == "m" else "rad")


def _unit_of(column: Column, stated: Mapping[str, str], si: str) -> str:
    """Return the unit of a column, or of the file, if it measures the quantity of an SI unit; otherwise an empty
    string.
    """
    for unit in (column.unit, "" if column.factor is not None else stated.get(column.name, "")):
        try:
            if unit:
                units.factor(unit, si)
                return unit
        except ParameterError:
            continue
    return ""


def _size(unit: str, si: str) -> float:
    return units.factor(unit, si)


def _trace(name: str, role: str, unit: str, values: np.ndarray, T: float, window: float = 0.0) -> Trace:
    """Return a channel reduced to the extremes of short stretches, after a moving average over `window` s."""
    width = round(window / T)
    if width > 1 and values.size > width:
        values = np.convolve(values, np.full(width, 1.0 / width), mode="same")
    time = T * np.arange(values.size)
    length = -(-values.size // _BINS)
    if length > 2:
        whole = values[: values.size // length * length].reshape(-1, length)
        starts = np.arange(len(whole)) * length
        ends = (0, values.size - 1)
        kept = np.unique([*(starts + whole.argmin(axis=1)), *(starts + whole.argmax(axis=1)), *ends])
        time, values = time[kept], values[kept]
    return Trace(name, role, unit, time, values)
