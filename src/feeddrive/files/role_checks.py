"""Checks of the column roles of a log against its samples, and roles of nameless columns from their samples alone.

`doubts_of` compares the channels of a log with each other, as `identification.shapes` describes.  For each role that
the samples contradict it returns a sentence with the correction: set and actual position exchanged, motor and table
exchanged, a velocity in place of a position, a channel of another axis, a wrong sign, inconsistent units, or a force
column that contains another quantity.  `roles_by_shape` finds position, set position and drive signal among columns
with uninformative names.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from feeddrive.files.columns import FLAGS, ROLES, Column
from feeddrive.identification import shapes
from feeddrive.identification.shapes import Driven, Likeness, driven, likeness
from feeddrive.language import units
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined

POSITIONS = ("position_load", "position_motor", "angle_load", "angle_motor")
_ENCODERS = (("position_motor", "position_load"), ("angle_motor", "angle_load"))
_SETPOINTS = ("setpoint_position", "setpoint_angle")
_VELOCITIES = ("velocity_load", "velocity_motor", "speed_motor", "speed_load")
_FORCES = ("force", "torque", "command", "current")

SCALE = 2.0  # times that two channels of one motion may differ in size: a slow loop; units differ by 16 and more
OTHER = 0.5  # share of a motion below which a channel is certainly of another axis or of another quantity
COUNTED = 1e-4  # share by which the changes of s - x may differ from those of a logged difference
# share by which a position may differ from the integral of its velocity: as an error of the clock, 2 % of a mass
CLOCK_OFF = 0.01
EQUAL = 1e-3  # share by which the numbers of a force may differ from those of a current that it is: rounding of a file
MOST_ROWS = 100_000  # rows that are compared: the liveliest stretch of a longer log

# factors between the units of one quantity: lengths, speeds and angles
_RATIOS = {
    "m": {"mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "m/s": {"mm/s": 1e-3, "m/min": 1.0 / 60.0, "mm/min": 1e-3 / 60.0},
    "rad": {"deg": np.pi / 180.0, "rev": 2.0 * np.pi},
    "rad/s": {"rpm": np.pi / 30.0, "rev/s": 2.0 * np.pi, "deg/s": np.pi / 180.0},
}


@dataclass(frozen=True)
class RoleDoubt:
    """A contradiction between the roles of columns and their samples, or roles that the samples do not confirm.

    roles    the roles concerned, starting with the one to correct
    kind     swapped, encoders, velocity, axis, sign, unit, force, late, clock (a second column contradicts clock or
             scales), or open: the samples neither confirm nor contradict the roles
    why      a sentence with the evidence in the samples and the option that corrects the role
    certain  True if a result with these roles would be wrong; otherwise it is a remark
    """

    roles: tuple[str, ...]
    kind: str
    why: str
    certain: bool = True


def liveliest(signals: Collection[np.ndarray]) -> slice:
    """Return the rows to compare: all of them, or in a long log the `MOST_ROWS` rows with the largest changes."""
    rows = min((values.size for values in signals), default=0)
    if rows <= MOST_ROWS:
        return slice(0, rows)
    activity = np.zeros(rows // MOST_ROWS)
    for values in signals:
        steps = np.abs(np.diff(values[: activity.size * MOST_ROWS], append=0.0)).reshape(activity.size, -1)[:, :-1]
        total = steps.sum()
        activity += steps.sum(axis=1) / total if total > 0.0 else 0.0
    start = int(np.argmax(activity)) * MOST_ROWS
    return slice(start, start + MOST_ROWS)


def doubts_of(
    channels: Mapping[str, np.ndarray],
    columns: Mapping[str, Column],
    T: float,
    others: Mapping[str, np.ndarray],
    *,
    steady: bool = False,
) -> tuple[RoleDoubt, ...]:
    """Return the contradictions between roles and samples.

    channels  the log by role, in the unit of each role, shape (n,)
    columns   the column of each role
    others    channels without a role, by name; one of them may be the intended force
    steady    True for a log recorded at constant speeds, in which the force cannot follow an acceleration

    There are no contradictions in a log that is too short or at standstill.
    """
    rows = liveliest([*channels.values(), *others.values()])
    check = _Check({role: values[rows] for role, values in channels.items()}, columns, T)
    apart = {name: values[rows] for name, values in others.items()}
    position = next((role for role in POSITIONS if role in channels), None)
    if position is None:
        return ()
    return tuple(
        doubt
        for doubt in (
            *check.setpoint(position),
            *check.encoders(),
            *check.velocities(position),
            check.constant(),
            *([] if steady else check.force(position, apart)),
        )
        if doubt is not None
    )


@dataclass(frozen=True)
class _Check:
    channels: Mapping[str, np.ndarray]
    columns: Mapping[str, Column]
    T: float

    def name(self, role: str) -> str:
        return self.columns[role].name

    def option(self, role: str, column: Column) -> str:
        """Return the command-line option that assigns this role to a column."""
        return option_for(role, column)

    def exchange(self, first: str, second: str) -> str:
        """Return the options that exchange two columns together with their units."""
        a, b = self.columns[first], self.columns[second]
        words = [
            self.option(first, replace(a, name=b.name, unit=b.unit, factor=b.factor)),
            self.option(second, replace(b, name=a.name, unit=a.unit, factor=a.factor)),
        ]
        return joined_options(words)

    def turned(self, role: str) -> str:
        """Return the option that reverses the sign of a column."""
        column = self.columns[role]
        factor = -1.0 if column.factor is None else -column.factor
        unit = column.unit or ("" if column.factor is not None or role == "command" else ROLES[role])
        return self.option(role, replace(column, factor=factor, unit=unit))

    def setpoint(self, position: str) -> list[RoleDoubt | None]:
        """Compare the set position with the actual position, and return the doubts."""
        role = next((role for role in _SETPOINTS if role in self.channels), None)
        if role is None or role.endswith("angle") != position.startswith("angle"):
            return []
        goal, actual = self.channels[role], self.channels[position]
        like = likeness(goal, actual, self.T)
        a, b = self.name(role), self.name(position)
        unlike = self.unlike(role, position, like)
        if unlike is not None:
            return [unlike]
        doubts: list[RoleDoubt | None] = [self.scale(role, position, like.gain)]
        if like.lag < -shapes.CLEAR or self.acting is not None:
            force = None if self.acting is None else self.channels[self.acting]
            first = shapes.order(goal, actual, force, self.T)
            lag = Text(f"{number(-like.lag, 3)} samples ({Quantity(-like.lag * self.T, 's'):3})")
            trails = Text(f"'{a}' trails '{b}' by {lag}") if like.lag < -shapes.CLEAR else ""
            if first == -1.0:
                why = Text(
                    f"set and actual position are exchanged: {trails + ', and ' if trails else ''}"
                    f"'{self.name(self.acting or '')}' follows the acceleration and friction of '{a}' better than "
                    f"those of '{b}': {self.exchange(role, position)}"
                )
                doubts.append(RoleDoubt((role, position), "swapped", why))
            elif first < 0.0 and not trails:
                although = f", although '{a}' leads, as a set position does" if like.lag > shapes.CLEAR else ""
                why = Text(
                    f"'{self.name(self.acting or '')}' follows '{a}' better than '{b}'{although}: strong feedforward "
                    f"or coarse counts, or the two columns are exchanged ({self.exchange(role, position)})"
                )
                doubts.append(RoleDoubt((role, position), "late", why, certain=False))
            elif trails:
                why = Text(
                    f"the set position {trails}: it was recorded that much later, feedforward makes the axis lead, or "
                    f"the two columns are exchanged ({self.exchange(role, position)})"
                )
                doubts.append(RoleDoubt((role, position), "late", why, certain=False))
            elif first < 1.0 and np.ptp(goal) > 0.0 and not shapes.smoother(goal, actual):
                why = Text(
                    f"the samples do not tell which of '{a}' and '{b}' is the set position: neither leads clearly, the "
                    f"force follows both alike, and '{a}' is not the smoother one; if they are exchanged: "
                    f"{self.exchange(role, position)}"
                )
                doubts.append(RoleDoubt((role, position), "open", why, certain=False))
        return doubts

    @property
    def acting(self) -> str | None:
        """The role of the force or, without one, of the drive signal; None if there is neither."""
        return next((role for role in _FORCES if role in self.channels), None)

    def unlike(self, first: str, second: str, like: Likeness) -> RoleDoubt | None:
        """Return the doubt for two channels that should move alike but do not, or that move in opposite directions."""
        a, b = self.name(first), self.name(second)
        if np.ptp(self.channels[first]) == 0.0 or np.ptp(self.channels[second]) == 0.0:
            return None
        if self.channels[first].size < shapes.LEAST_ROWS:
            return None
        if like.explained < shapes.SAME:
            share = Quantity(like.explained, "share")
            why = Text(
                f"'{a}' explains only {share:2} of the motion of '{b}': they are of different axes, or one of them is "
                f"another quantity; name the right column with {self.option(first, Column(name='COLUMN'))} or "
                f"{self.option(second, Column(name='COLUMN'))}"
            )
            # a loop that hardly follows still comes to the set positions in the end
            levels, _ = shapes.share(*(x - np.mean(x) for x in (self.channels[second], self.channels[first])))
            return RoleDoubt((first, second), "axis", why, certain=like.explained < OTHER and levels < shapes.SAME)
        if like.gain < 0.0:
            why = Text(f"'{b}' moves against '{a}': one of them has the wrong sign: {self.turned(second)}")
            return RoleDoubt((second, first), "sign", why)
        return None

    def scale(self, first: str, second: str, gain: float) -> RoleDoubt | None:
        """Return the doubt for two channels of one motion that differ by a factor, as if one had a wrong unit."""
        if not gain > 0.0 or 1.0 / SCALE <= gain <= SCALE:
            return None
        a, b = self.name(first), self.name(second)
        cures = self.units_by(first, 1.0 * gain) + self.units_by(second, 1.0 / gain)
        cure = f": {' or '.join(cures)}" if cures else "; check the unit and the factor of both"
        why = Text(f"'{b}' moves {number(gain, 4)} times as far as '{a}', in the units in which they are read{cure}")
        return RoleDoubt((second, first), "unit", why)

    def units_by(self, role: str, factor: float) -> list[str]:
        """Return the option for a unit in which the column's values are larger by a factor, if there is one."""
        si, column = ROLES[role], self.columns[role]
        now = units.factor(column.unit, si) if column.unit else 1.0
        for unit, size in {si: 1.0, **_RATIOS.get(si, {})}.items():
            if 1.0 / SCALE <= size / (now * factor) <= SCALE and size != now:
                return [self.option(role, replace(column, unit=unit, factor=None))]
        return []

    def encoders(self) -> list[RoleDoubt | None]:
        """Compare the encoders of the motor and the table, and return the doubts."""
        for motor, table in _ENCODERS:
            if motor not in self.channels or table not in self.channels:
                continue
            x1, x2 = self.channels[motor], self.channels[table]
            like = likeness(x1, x2, self.T)
            unlike = self.unlike(motor, table, like)
            if unlike is not None:
                return [unlike]
            scale = self.scale(motor, table, like.gain)
            if scale is not None:
                return [scale]
            # the small difference of two encoders is lost if their scales differ by more than a percent
            first = shapes.ahead(x1, x2 / like.gain if like.gain else x2, self.T)
            if first < -shapes.LIKELY:
                a, b = self.name(motor), self.name(table)
                seem = "are" if first < -shapes.SURE else "may be"
                why = Text(
                    f"motor and table {seem} exchanged: '{b}' runs ahead of '{a}' while the axis accelerates, as a "
                    f"motor does through a spring ({number(-first, 2)} standard errors): give them the other way round "
                    f"in a file for --channels, {motor} = '{b}' and {table} = '{a}'"
                )
                return [RoleDoubt((motor, table), "encoders", why, certain=first < -shapes.SURE)]
            # 0 for a log that is too short or at standstill, which gives no evidence
            if 0.0 != first < shapes.LIKELY:
                a, b = self.name(motor), self.name(table)
                why = Text(
                    f"the samples do not tell which of '{a}' and '{b}' is at the motor: neither runs ahead of the "
                    f"other while the axis accelerates ({number(first, 2)} standard errors); if '{b}' is, give them "
                    f"the other way round in a file for --channels, {motor} = '{b}' and {table} = '{a}'"
                )
                return [RoleDoubt((motor, table), "open", why, certain=False)]
        return []

    def velocities(self, position: str) -> list[RoleDoubt | None]:
        """Compare the velocities with the position, and return the doubts."""
        doubts: list[RoleDoubt | None] = []
        x = self.channels[position]
        for role in (role for role in _VELOCITIES if role in self.channels):
            v = self.channels[role]
            if x.size < shapes.LEAST_ROWS or np.ptp(x) == 0.0 or np.ptp(v) == 0.0:
                continue
            a, b = self.name(position), self.name(role)
            explained, k = shapes.integral_of(x, v, self.T)
            same = role.startswith("speed") == position.startswith("angle")
            if explained >= shapes.INTEGRAL:
                doubts.append(self.rate(position, role, k) if same else None)
                continue
            if shapes.integral_of(v, x, self.T)[0] >= shapes.INTEGRAL:
                why = Text(
                    f"'{a}' is the rate of change of '{b}': position and velocity are exchanged: "
                    f"{self.option(position, Column(name=b))}"
                )
                doubts.append(RoleDoubt((position, role), "velocity", why))
                continue
            why = Text(
                f"'{b}' is not the rate of change of '{a}' (its integral explains {Quantity(explained, 'share'):2} of "
                f"the position): it is of another axis, or another quantity; it is not used where the position is"
            )
            doubts.append(RoleDoubt((role, position), "axis", why, certain=False))
        return doubts

    def rate(self, position: str, velocity: str, k: float) -> RoleDoubt | None:
        """Return the doubt for a velocity whose scale or sign does not match the position: k ≠ 1 in Δx = k ∫ v dt."""
        a, b = self.name(position), self.name(velocity)
        if k < 0.0:
            why = Text(f"'{b}' has the sign opposite to the rate of change of '{a}': {self.turned(velocity)}")
            return RoleDoubt((velocity, position), "sign", why, certain=False)
        if 1.0 / SCALE <= k <= SCALE:
            return self.clock(position, velocity, k)
        cures = self.units_by(position, 1.0 / k) + self.units_by(velocity, k)
        cure = f": {' or '.join(cures)}" if cures else "; check the unit and the factor of both, and the clock"
        why = Text(
            f"the rate of change of '{a}' is {number(k, 4)} times '{b}', in the units in which they are read{cure}"
        )
        return RoleDoubt((position, velocity), "unit", why)

    def clock(self, position: str, velocity: str, k: float) -> RoleDoubt | None:
        """Return the doubt for a velocity whose integral differs from the position by some percent: Δx = k ∫ v dt."""
        x, v = self.channels[position], self.channels[velocity]
        # noise of either column makes its own coefficient too small: the truth lies between k and this one
        other = shapes.velocity_of(x, v, self.T)
        if min(k, other) < 1.0 + CLOCK_OFF and max(k, other) > 1.0 - CLOCK_OFF:
            return None
        a, b = self.name(position), self.name(velocity)
        step = Quantity(self.T, "s", form="4")
        why = Text(
            f"the rate of change of '{a}' is {number(k, 4)} times '{b}': the sample time is "
            f"{Quantity(k * self.T, 's')} and not {step} (--time 'column*{number(k, 4)}:s', or --sample-time), or "
            f"one of the two columns has another scale; with this clock a mass would be "
            f"{Quantity(abs(k**-2 - 1.0), 'share'):2} wrong"
        )
        return RoleDoubt((velocity, position), "clock", why, certain=False)

    def constant(self) -> RoleDoubt | None:
        """Return the doubt for a force or torque whose values equal those of the current: A instead of N or N m."""
        role = next((role for role in ("force", "torque") if role in self.channels), None)
        if role is None or "current" not in self.channels:
            return None
        f, i = self.channels[role], self.channels["current"]
        explained, k = shapes.share(f - np.mean(f), i - np.mean(i))
        if explained < 1.0 - EQUAL or abs(abs(float(k[0])) - 1.0) > EQUAL:
            return None
        a, b = self.name(role), self.name("current")
        why = Text(
            f"the numbers of '{a}' are those of '{b}': it is a current in A and no {role}; give the constant of the "
            "motor with --torque-constant (N m/A) or --motor-constant (N/A), and leave its unit out"
        )
        return RoleDoubt((role, "current"), "clock", why, certain=False)

    def force(self, position: str, others: Mapping[str, np.ndarray]) -> list[RoleDoubt | None]:
        """Compare the force, or the drive signal in its place, with the motion, and return the doubts."""
        role = self.acting
        x = self.channels[position]
        if role is None or x.size < shapes.LEAST_ROWS or np.ptp(x) == 0.0 or np.ptp(self.channels[role]) == 0.0:
            return []
        f = self.channels[role]
        a, b = self.name(position), self.name(role)
        as_position, as_velocity = driven(x, f, self.T), driven(x, f, self.T, is_velocity=True)
        if as_position == Driven(0.0, 0.0, 0.0):
            return []
        likely = 1.0 - as_position.explained > shapes.AGREES * (1.0 - as_velocity.explained)
        if _better(as_velocity, as_position) or (likely and as_velocity.explained >= shapes.EXPLAINED):
            why = Text(
                f"'{a}' looks like a velocity, not like a position: '{b}' follows its first derivative, as a force "
                f"follows acceleration ({_shares(as_velocity, as_position)}); name the position with "
                f"{self.option(position, Column(name='COLUMN'))}, or integrate it before"
            )
            return [RoleDoubt((position, role), "velocity", why, certain=_better(as_velocity, as_position))]
        if 1.0 - as_position.as_power < shapes.BETTER * (1.0 - as_position.explained):
            why = Text(
                f"'{b}' looks like a power, not like a force: force times velocity of '{a}' explains "
                f"{Quantity(as_position.as_power, 'share'):3} of it, a force "
                f"{Quantity(as_position.explained, 'share'):3}; name the force with "
                f"{self.option(role, Column(name='COLUMN'))}"
            )
            return [RoleDoubt((role, position), "force", why)]
        reversed_roles = driven(f, x, self.T)
        if _better(reversed_roles, as_position):
            why = Text(
                f"position and force are exchanged: '{a}' acts on '{b}' as a force on a mass "
                f"({_shares(reversed_roles, as_position)}): {self.exchange(position, role)}"
            )
            return [RoleDoubt((position, role), "swapped", why)]
        if as_position.explained >= shapes.EXPLAINED and as_position.mass < 0.0:
            why = Text(
                f"'{b}' points against the acceleration of '{a}': force or position has the wrong sign: "
                f"{self.turned(role)}"
            )
            return [RoleDoubt((role, position), "sign", why)]
        if as_position.by_speed >= shapes.PROPORTIONAL:
            why = Text(
                f"'{b}' follows the velocity to {Quantity(as_position.by_speed, 'share'):3}, hardly the acceleration: "
                "it may command a drive with a speed loop of its own, or the axis has nothing but viscous friction; a "
                "force or current of that drive is needed"
            )
            return [RoleDoubt((role, position), "force", why, certain=False)]
        if as_position.explained < shapes.EXPLAINED:
            best, how = _best_force(x, others, self.T)
            instead = ""
            if best:
                instead = Text(
                    f"; '{best}' follows it to {Quantity(how.explained, 'share'):3}: "
                    f"{self.option(role, Column(name=best))}"
                )
            why = Text(
                f"'{b}' follows acceleration and friction of '{a}' only to "
                f"{Quantity(max(as_position.explained, 0.0), 'share'):2}: it is of another axis, or no force{instead}"
            )
            return [RoleDoubt((role, position), "force", why, certain=bool(best))]
        left = 1.0 - as_position.explained
        for other, what in ((as_velocity.explained, "a velocity"), (as_position.as_power, "")):
            if 1.0 - other > shapes.AGREES * left:
                continue
            told = Text(f"'{a}' is a position or {what}") if what else Text(f"'{b}' is a force or a power")
            named = position if what else role
            why = Text(
                f"the samples do not tell whether {told}: the one explains {Quantity(1.0 - left, 'share'):3} of "
                f"'{b}', the other {Quantity(other, 'share'):3}; name the right column with "
                f"{self.option(named, Column(name='COLUMN'))} if it is another one"
            )
            return [RoleDoubt((named, role if what else position), "open", why, certain=False)]
        return []


def _better(one: Driven, other: Driven) -> bool:
    """Return True if the first interpretation leaves clearly less of the force unexplained than the second."""
    return one.explained >= shapes.EXPLAINED and 1.0 - one.explained < shapes.BETTER * (1.0 - other.explained)


def _shares(one: Driven, other: Driven) -> Text:
    """Return the explained shares of two interpretations, as text for parentheses."""
    return Text(f"{Quantity(one.explained, 'share'):3} explained, {Quantity(other.explained, 'share'):3} as named")


def _best_force(position: np.ndarray, others: Mapping[str, np.ndarray], T: float) -> tuple[str, Driven]:
    """Return the channel that best follows acceleration and friction, with the fit; an empty name if none does."""
    best, how = "", Driven(0.0, 0.0, 0.0)
    for name, values in others.items():
        if np.ptp(values) == 0.0:
            continue
        found = driven(position, values, T)
        if found.explained <= max(how.explained, shapes.SAME) or found.by_speed >= shapes.INTEGRAL:
            continue
        # a copy of the position, such as its setpoint, follows no force law: its changes are those of the position
        if likeness(position, values, T).explained < shapes.SAME:
            best, how = name, found
    return best, how


def option_for(role: str, column: Column) -> str:
    """Return the command-line option that assigns a role to a column, or a line of a file for --channels."""
    flag = FLAGS.get(role)
    text = column.text()
    if flag is None:
        return f"{role} = '{text}' in a file for --channels"
    return f"{flag} '{text}'"


def joined_options(words: Collection[str]) -> str:
    """Join several options into a part of a command line, or into a phrase if some are lines of a file."""
    return " ".join(words) if all(word.startswith("--") for word in words) else " and ".join(words)


Known: TypeAlias = tuple[str, np.ndarray]
"""The name of a column, and its channel."""


@dataclass(frozen=True)
class ByShape:
    """Roles found from samples alone: channel and reason for each role, and a remark on each unused channel."""

    roles: Mapping[str, tuple[str, str]]
    unused: Mapping[str, str]


def roles_by_shape(channels: Mapping[str, np.ndarray], T: float, known: Mapping[str, Known] | None = None) -> ByShape:
    """Find position, set position and drive signal among channels with uninformative names.

    known  name and channel by role, for roles already known from names; only the missing roles are searched for

    Position and drive signal are the pair in which one channel best follows the acceleration and friction of the other.
    Of the channels that move like the position, the leading one is its setpoint, and another is its second encoder.  No
    role is found in a log at standstill or without a drive signal, since positions and velocities then look alike.
    """
    known = known or {}
    keyed = {**dict(known.values()), **channels}
    part = liveliest(list(keyed.values()))
    near = {name: values[part] for name, values in keyed.items() if np.ptp(values[part]) > 0.0}
    free = {name: values for name, values in near.items() if name in channels}
    rows = next((values.size for values in near.values()), 0)
    if rows < shapes.LEAST_ROWS:
        return ByShape({}, {})
    named = {role: name for role, (name, _) in known.items() if name in near}
    its_role = next((role for role in POSITIONS if role in named), "")
    position, acting = named.get(its_role, ""), next((named[role] for role in _FORCES if role in named), "")
    has_setpoint = any(role in named for role in _SETPOINTS)
    roles: dict[str, tuple[str, str]] = {}
    unused: dict[str, str] = {}
    pair, how = _best_pair(near, [position] if position else list(free), [acting] if acting else list(free), T)
    if pair is None:
        return ByShape({}, {})
    place, force = pair
    if not acting:
        share = Quantity(how.explained, "share", form="3")
        what = Text(f"follows the acceleration and friction of '{place}' to {share}, by its samples")
        roles["command"] = (force, f"a drive signal: {what}; its unit is not known")
    alike = _group(near, free, place, force, T)
    if not position:
        ordered, open_ = _ordered(alike, near[force], T, has_setpoint=has_setpoint)
        roles |= ordered
        unused |= open_
    else:
        goals = [
            (name, like)
            for name, (values, like) in alike.items()
            if like.gain > 0.0 and shapes.order(values, near[place], near[force], T) == 1.0
        ]
        if goals and not has_setpoint and its_role.startswith("position"):
            name, like = min(goals, key=lambda item: item[1].lag)
            roles["setpoint_position"] = (name, _leads(place, -like.lag, T))
    taken = {name for name, _ in roles.values()}
    for name, values in free.items():
        if name in taken or name in (place, force):
            continue
        explained, _ = shapes.integral_of(near[place], values, T)
        if explained >= shapes.INTEGRAL:
            unused[name] = f"a velocity of '{place}', by its samples: it is not needed beside the position"
        elif name in alike and name not in unused:
            unused[name] = f"moves as '{place}', by its samples"
    return ByShape(roles, unused)


def _best_pair(
    near: Mapping[str, np.ndarray], places: list[str], forces: list[str], T: float
) -> tuple[tuple[str, str] | None, Driven]:
    """Return the best-fitting pair of position and drive signal, or None, and the quality of this fit."""
    best: tuple[str, str] | None = None
    how = Driven(0.0, 0.0, 0.0)
    for place in places:
        for force in forces:
            if place == force:
                continue
            found = driven(near[place], near[force], T)
            if found.explained <= max(how.explained, shapes.SAME) or found.by_speed >= shapes.INTEGRAL:
                continue
            if _better(driven(near[place], near[force], T, is_velocity=True), found):
                continue
            if likeness(near[place], near[force], T).explained >= shapes.SAME or _is_difference(near, force, T):
                continue
            best, how = (place, force), found
    return best, how


def _is_difference(near: Mapping[str, np.ndarray], name: str, T: float) -> bool:
    """Return True if a channel is the difference of two others, such as a following error."""
    grid = shapes.Grid.of(near[name].size, T)
    changes = {key: grid.change(values) for key, values in near.items() if key != name}
    wanted = grid.change(near[name])
    keys = list(changes)
    return any(
        shapes.share(wanted, changes[a], changes[b])[0] > 1.0 - COUNTED
        for k, a in enumerate(keys)
        for b in keys[k + 1 :]
    )


def _group(
    near: Mapping[str, np.ndarray], free: Mapping[str, np.ndarray], place: str, force: str, T: float
) -> dict[str, tuple[np.ndarray, Likeness]]:
    """Return the channels that move like the position, each with its likeness to the position."""
    group = {}
    for name, values in free.items():
        if name == force:
            continue
        like = likeness(near[place], values, T)
        if like.explained >= shapes.SAME:
            group[name] = (values, like)
    return group


def _ordered(
    alike: Mapping[str, tuple[np.ndarray, Likeness]], force: np.ndarray, T: float, *, has_setpoint: bool
) -> tuple[dict[str, tuple[str, str]], dict[str, str]]:
    """Return the roles (setpoint, motor, table) of channels that move alike, and why others have no role."""
    roles: dict[str, tuple[str, str]] = {}
    unused: dict[str, str] = {}
    names = sorted(alike, key=lambda name: alike[name][1].lag)
    if len(names) > 1 and not has_setpoint:
        # the channel that is the setpoint of all others, if the samples show it
        for goal in names:
            others = [name for name in names if name != goal]
            told = [shapes.order(alike[goal][0], alike[name][0], force, T) for name in others]
            if min(told) > 0.0 and max(told) == 1.0:
                lag = min(alike[name][1].lag for name in others) - alike[goal][1].lag
                roles["setpoint_position"] = (goal, _leads(others[0], lag, T))
                names = others
                break
    what = "a position, by its samples: the drive signal follows its acceleration"
    if len(names) == 1:
        roles["position_load"] = (names[0], what)
        return roles, unused
    first = shapes.ahead(alike[names[0]][0], alike[names[1]][0], T)
    if len(names) == 2 and abs(first) > shapes.SURE and ("setpoint_position" in roles or has_setpoint):
        motor, table = names if first >= 0.0 else names[::-1]
        roles["position_motor"] = (motor, f"{what}; motor: it runs ahead while the axis accelerates")
        roles["position_load"] = (table, f"{what}; table: it trails the motor")
        return roles, unused
    # encoders, or position and setpoint: every second guess would be wrong
    for name in names:
        others = joined(" and ", (f"'{other}'" for other in names if other != name))
        unused[name] = Text(
            f"moves as {others}: position, setpoint or second encoder, which the samples do not tell apart; name "
            f"them with {FLAGS['position_load']} and {FLAGS['setpoint_position']}"
        )
    return roles, unused


def _leads(name: str, lag: float, T: float) -> Text:
    """Return the reason why a channel is the setpoint."""
    if lag <= shapes.CLEAR:
        return Text(
            f"a set position, by its samples: it moves as '{name}', whose acceleration and friction the drive signal "
            "follows better"
        )
    by = Text(f"{number(lag, 3)} samples ({Quantity(lag * T, 's'):3})")
    return Text(f"a set position, by its samples: it moves as '{name}', {by} earlier")
