"""The force of a milling tool, with the chip from the actual relative motion of the tool and the workpiece."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from feeddrive.blocks.coupling.cut_sections import CutSections, Settings
from feeddrive.blocks.cutting.engagement import Cut, Rubbing, cut, fits_slices
from feeddrive.blocks.families import Coupling, Cutter
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Track
from feeddrive.language.text import Text

# 1/s: only against a division by 0, since no spindle takes days for a turn
_SLOWEST = 1e-6


class MillingCut(Coupling):
    """Regenerative milling forces on three axes: the chip is the tool motion since earlier teeth were at this angle.

        τ        = 60 / (teeth spindle_speed)
        step_m   = r(t) - r(t - mτ),  r = (x, y) of the tool against the workpiece, actual, m = 1 .. surfaces
        h        = max(0, min over m of step_m · e_r),  of each slice of each edge; no edge force if it is 0
        angle    = start_angle + 2π (spindle_speed / 60) t
        F_x, F_y = F_feed t + F_normal n,   F_z = -F_axial

    F_feed, F_normal and F_axial follow from the cutter's force coefficients and this chip, integrated over each engaged
    slice; t is the direction of the feed, n = z x t.  Vibration changes the chip and the chip excites vibration
    (regeneration); where it lifts a tooth out of the work, a later tooth removes the chip of several tooth periods, so
    at least three surfaces are needed.  A vibration that repeats with the period τ leaves the chip of the feed,
    and thus the force, unchanged except for rounding.

    r is taken at the predicted middle of a substep; r(t - mτ) is predicted in the same way, by cubic Hermite
    interpolation of the positions and velocities at the ends of the substeps.  While a straight tooth enters the cut,
    its force is averaged over the substep.  The same holds for a helical tooth whose slices each span a smaller angle
    than the spindle turns in a substep.

    Without `direction` the feed has the direction of the motion over the last turn of the spindle, which a vibration as
    large as the feed distorts: specify a direction, or sections with directions, if the tool may chatter. At the start
    the tool has been at rest outside the workpiece: the chip is 0 and grows over the first tooth periods.  If `moves`
    is "table", the axis moves the workpiece: r is minus the position of the axis, and the force on the axis is
    reversed.  The force acts for cut_from <= t < cut_to, with a separate depth, width, speed or direction in each of
    the `sections`; the spindle always turns.  Where its speed changes, τ is the time in which the spindle has turned by
    one tooth pitch, found in a ring buffer of its rotation angle. With process_damping C the flank rubs on the
    workpiece: F = -C a (ṙ · e_r) / (cutting speed) along e_r on each engaged height a of an edge, with ṙ extrapolated
    from the last two velocities.
    Do not use it with substeps longer than a tenth of τ, or for a motion along the spindle, which does not change the
    chip.
    Source: forces Budak, Altintas & Armarego 1996; regeneration Altintas & Budak 1995, eq. (2); several surfaces Tlusty
    & Ismail 1981.
    """

    cutter: Cutter = part("the tool")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    along_x: str = choice("axis that moves the tool along x", default="x")
    along_y: str = choice("axis that moves the tool along y", default="y")
    along_z: str | None = choice("axis that moves the tool along z; absent: none", default=None)
    moves: str = choice("what the axes move", options=("tool", "table"), default="tool")
    direction: Number | None = parameter(
        "rad", "direction of the feed, from x towards y; absent: that of the motion", default=None
    )
    start_angle: Number = parameter("rad", "angle of the spindle at t = 0", default=0)
    cut_from: Number = parameter("s", "when the cut begins", default=0)
    cut_to: Number | None = parameter("s", "when it ends; absent: never", default=None)
    surfaces: int = choice("earlier surfaces that a tooth may meet", default=3, least=1, most=32)
    process_damping: Number | None = parameter(
        "N/m", "damping of the flank at a cutting speed of 1 m/s, per m of depth; absent: none", least=0, default=None
    )
    sections: CutSections | None = part("what changes in the course of a program", default=None)
    remembered: int = choice("substeps of motion that are stored; they must cover the surfaces", default=4096, least=4)

    class State(NamedTuple):
        """The track of the tool relative to the workpiece (m, m/s), the section, and the spindle's turns."""

        path: Track
        section: Any = None
        turns: Any = None  # of the spindle at the end of the last substep

    def check(self) -> None:
        """Raise StructureError if two directions share an axis, ParameterError if a section is too deep."""
        if len(set(self.axes())) < len(self.axes()):
            raise StructureError(
                f"milling_cut: x, y and z must be moved by different axes, not {', '.join(self.axes())}"
            )
        flute = self.cutter.edge().flute_length
        for i, depth in enumerate(self._depths()):
            # in a trace the length is a symbol, on which an `if` is refused
            if isinstance(flute, float) and depth > flute:
                raise ParameterError(
                    f"milling_cut.sections.axial_depth[{i}] = {Quantity(depth, 'm'):6 SI} is more than "
                    f"cutter.flute_length = {Quantity(flute, 'm'):6 SI}: at most {Quantity(flute, 'm'):6 SI}, in two "
                    "cuts or with a longer tool"
                )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the cut ends after it begins, and a slice spans at most a quarter of a turn."""
        begin, end = self.cut_from, self.cut_to
        if end is not None:
            yield Rule(
                end > begin,
                "the cut ends after it begins",
                lambda: Text(
                    f"milling_cut.cut_to = {Quantity(end, 's'):6 SI} must be > milling_cut.cut_from = "
                    f"{Quantity(begin, 's'):6 SI}; absent: never"
                ),
            )
        edge, depths = self.cutter.edge(), self._depths()
        yield fits_slices("milling_cut.cutter", edge._replace(axial_depth=max(depths)) if depths else edge)

    def _depths(self) -> list[float]:
        """Return the axial depths of the sections, m."""
        return [] if self.sections is None else self.sections.rows().get("axial_depth", [])

    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes that move the tool or the table."""
        return (self.along_x, self.along_y, *(() if self.along_z is None else (self.along_z,)))

    def period(self) -> Number:
        """Return the tooth period τ in s, the longest over the sections in which the tool cuts."""
        return 60.0 / (self.cutter.teeth * self._speeds()[0])

    def _speeds(self) -> list[Any]:
        """Return the spindle speeds, in rpm, of the sections in which the tool cuts, in ascending order."""
        rows = {} if self.sections is None else self.sections.rows()
        if self.sections is not None and "spindle_speed" in rows:
            pairs = zip(rows["spindle_speed"], self.sections.cutting(), strict=True)
            # a program without a cut has no speed of its own, and the rules need one
            return sorted(speed for speed, cuts in pairs if cuts) or [self.spindle_speed]
        return [self.spindle_speed]

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rules: the stored substeps cover the tooth periods, and a turn has at least 4 substeps."""
        period, turn = self.period(), 60.0 / self._speeds()[-1]
        directed = self.direction is not None or (self.sections is not None and self.sections.direction is not None)
        # without a direction the step of a whole turn of the spindle is the direction of the feed
        count = self.surfaces if directed else max(self.surfaces, self.cutter.teeth)
        yield Rule(
            float(count) * period / h <= float(self.remembered - 2),
            "the substeps that the cut stores are not shorter than the tooth periods that it looks back",
            lambda: Text(
                f"milling_cut.remembered = {self.remembered} substeps of {Quantity(h, 's'):6 SI} are shorter than "
                f"{count} tooth period(s) of {Quantity(period, 's'):6 SI}: at least "
                f"{-int(-(count * period / h) // 1) + 2}"
            ),
        )
        yield Rule(
            # the turn in a substep is the width of a slice in `cut`, whose closed forms hold up to a quarter of a turn
            turn >= 4.0 * h,
            "the spindle turns by at most a quarter of a turn in a substep",
            lambda: Text(
                f"milling_cut.spindle_speed: a turn of {Quantity(turn, 's'):6 SI} has to have at least 4 substeps of "
                f"{Quantity(h, 's'):6 SI}: slow the spindle, or take a shorter sample time or more substeps"
            ),
        )

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> State:
        """Return the state of a tool that has been at rest at its present position."""
        place, _ = self._relative(motions)
        nothing = ops.zero(place[0])
        if self.sections is None:
            return self.State(Track.start(self.remembered, place))
        if self.sections.spindle_speed is None:
            return self.State(Track.start(self.remembered, place), nothing)
        return self.State(Track.start(self.remembered, (*place, nothing)), nothing, nothing)

    def step(
        self, prepared: Any, state: State, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[State, dict[str, tuple[Number, Number]]]:
        state, (along, across), found = self.forces(state, motions, time, h)
        acts = time >= self.cut_from
        if self.cut_to is not None:
            acts = ops.both(acts, time < self.cut_to)
        on = ops.where(acts, 1.0, 0.0) * (1.0 if self.moves == "tool" else -1.0)
        forces = {
            self.along_x: (0.0, on * (found.feed * along - found.normal * across)),
            self.along_y: (0.0, on * (found.feed * across + found.normal * along)),
        }
        if self.along_z is not None:
            forces[self.along_z] = 0.0, -(on * found.axial)
        return state, forces

    def forces(
        self, state: State, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[State, tuple[Any, Any], Cut]:
        """Return the state after a substep, the feed direction, and the forces, whether or not the cut is active."""
        place, velocity = self._relative(motions)
        # motions are those predicted for the middle of the substep; the track keeps its start, which is exact
        ends: list[Any] = [x - 0.5 * h * v for x, v in zip(place, velocity, strict=True)]
        section, now = self._section(state.section, time)
        rate = now.spindle_speed / 60.0
        if state.turns is None:
            path, turns = state.path.push(ends, velocity), rate * time
        else:
            path, turns = state.path.push([*ends, state.turns], [*velocity, rate]), state.turns + 0.5 * rate * h
        # reduced to one turn first: after many turns the product with 2π would lose the digits of the angle
        angle = self.start_angle + 2.0 * ops.pi * (turns - ops.floor(turns))
        steps = [path.moved(place, self._ago(m, path, turns, rate, h), h) for m in range(1, self.surfaces + 1)]
        if now.direction is None:
            x, y = path.moved(place, self._ago(self.cutter.teeth, path, turns, rate, h), h)
            length = ops.sqrt(x * x + y * y)
            safe = ops.where(length > 0.0, length, 1.0)
            # at standstill any direction will do, since there is no chip
            along, across = ops.where(length > 0.0, x / safe, 1.0), y / safe
        else:
            along, across = ops.cos(now.direction), ops.sin(now.direction)
        rubbing = None
        if self.process_damping is not None:
            # velocities are known up to the start of the substep: extrapolated linearly to its middle
            before = path.rates_ago(0.0)
            x, y = (v + 0.5 * (v - old) for v, old in zip(velocity, before, strict=False))
            # 1e-9 1/s: a stopped spindle must not divide by 0
            speed = ops.pi * now.edge.diameter * ops.maximum(rate, 1e-9)
            rubbing = Rubbing(x * along + y * across, y * along - x * across, self.process_damping / speed)
        found = cut(
            now.edge,
            angle,
            2.0 * ops.pi * rate * h,
            [(x * along + y * across, y * along - x * across) for x, y in steps],
            rubbing,
        )
        after = None if state.turns is None else state.turns + rate * h
        return self.State(path, section, after), (along, across), found

    def _section(self, before: Any, time: Number) -> tuple[Any, Settings]:
        usual = Settings(self.cutter.edge(), self.spindle_speed, self.direction)
        if self.sections is None:
            return None, usual
        section = self.sections.section(before, time)
        return section, self.sections.settings(section, usual)

    def _ago(self, teeth: int, path: Track, turns: Any, rate: Any, h: Any) -> Any:
        """Return the number of substeps in which the spindle last turned by `teeth` tooth pitches (not an integer)."""
        # the track has no turns: at constant speed the pitch has a fixed time, and nothing is searched
        if len(path.values) == 2:
            return float(teeth) / (self.cutter.teeth * rate * h)
        turned = float(teeth) / float(self.cutter.teeth)
        ago = turned / (ops.maximum(rate, _SLOWEST) * h)
        # two steps are enough: the turns are piecewise linear between changes of the speed
        for _ in range(2):
            then = path.rates_ago(ago)[2]
            then = ops.where(then > _SLOWEST, then, ops.maximum(rate, _SLOWEST))
            ago = ago + (path.ago(ago, h, 0.5)[2] - (turns - turned)) / (then * h)
        return ago

    def _relative(self, motions: Mapping[str, Motion]) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """Return the position and velocity of the tool relative to the workpiece."""
        x, y = motions[self.along_x], motions[self.along_y]
        if self.moves == "tool":
            return (x.position_load, y.position_load), (x.velocity_load, y.velocity_load)
        return (-x.position_load, -y.position_load), (-x.velocity_load, -y.velocity_load)
