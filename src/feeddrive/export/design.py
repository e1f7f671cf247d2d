"""A design to export: the checked controller or plant of a machine file, and random test inputs for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.analysis.contour_control import matched_dynamics
from feeddrive.analysis.margins import margins
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.export.c_code import CALLS, FUNCTIONS, INFIX
from feeddrive.export.identifiers import check_name
from feeddrive.export.layout import Field, Layout, LayoutRun, layout
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import digest_of
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import FeeddriveError, NoSlopeError, ParameterError, StructureError
from feeddrive.language.graph import ELEMENTARY
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.guard import Guard
from feeddrive.loop.linearize import MOST, loop_gain, period_of
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import System
from feeddrive.loop.routine import Routine, Variable, controller_routine, machine_routine, on_target, plant_routine
from feeddrive.version import __version__

# 1/Ms is the distance of the loop gain from -1: above 3, a change of the axis by a third may make it oscillate
LARGEST_MS = 3.0
CONTROL, PLANT = "control", "plant"
MACHINE_FILE = "machine.toml"  # the copy of the machine file in an export


@dataclass(frozen=True, eq=False, repr=False)
class Design:
    """A controller, an axis, or all axes with their couplings, as a routine and its memory layout."""

    machine: MachineFile
    axis: str
    what: str
    layout: Layout

    def __repr__(self) -> str:
        return f"Design({self.name}: {self.title})"

    @property
    def routine(self) -> Routine:
        """The routine of the design: configure, reset, step and retune."""
        return self.layout.routine

    @property
    def loop(self) -> Loop:
        """The axis with its controller."""
        return self.routine.loop

    @property
    def together(self) -> bool:
        """True if the design contains all axes of the machine."""
        return not isinstance(self.routine.origin, Loop)

    @property
    def name(self) -> str:
        """The prefix of all names on the target."""
        return self.routine.name

    @property
    def title(self) -> str:
        """The one-line description of the design."""
        if self.together:
            held = [coupling for coupling in self.machine.couplings if self.what == PLANT or coupling.controls]
            couplings = ", ".join(coupling.kind for coupling in held)
            coupled = f", coupled by {couplings}" if couplings else ""
            whole = "Plant" if self.what == PLANT else "Controls"
            return f"{whole} of the axes {self.axis} of '{self.machine.name}'{coupled}"
        kind = self.loop.control.law.kind if self.what == CONTROL else self.loop.axis.plant.kind
        return f"{self.what.capitalize()} of axis {self.axis} of '{self.machine.name}': {kind}"

    @property
    def system(self) -> System:
        """The simulated system: the loop, or all axes of the machine if the axis is coupled."""
        if self.together:
            return self.routine.origin
        return self.machine.machine() if self.machine.coupled(self.axis) else self.loop

    @property
    def digest(self) -> str:
        """The SHA-256 digest of the machine file."""
        return digest_of(self.machine.file.text)

    @property
    def made_by(self) -> str:
        """A sentence that states the version of feeddrive, and the machine file with its digest."""
        file = Path(self.machine.file.name).name
        return f"Made by feeddrive {__version__} from {file}, SHA-256 {self.digest}."

    @property
    def period(self) -> str:
        """The sample time as text, with its unit."""
        T = self.routine.sample_time
        return f"{1e6 * T:.6g} µs" if T < 1e-3 else f"{1e3 * T:.6g} ms" if T < 1.0 else f"{T:.6g} s"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings to read before the export moves an axis, such as missing limits or a loop close to instability."""
        if self.what == PLANT:
            return ()
        if not self.together:
            return tuple(self._axis_remarks(self.loop))
        of_axes = [
            Text(f"axis {axis}: {remark}")
            for axis, loop in self.system.loops().items()
            for remark in self._axis_remarks(loop)
        ]
        return (*of_axes, *matched_dynamics(self.machine.machine()).remarks())

    def _axis_remarks(self, loop: Loop) -> list[str]:
        """Return the warnings about one axis."""
        guard, control = loop.control.guard, loop.control
        holding_force, remarks = float(weight(loop.axis)), list[str]()
        assert guard is not None, "what is exported has a guard"
        if holding_force != 0.0 and float(guard.safe_force) == 0.0:
            remarks.append(
                Text(
                    f"A HANGING AXIS FALLS: gravity pulls with {Quantity(-holding_force, 'N'):6}, but the guard's "
                    "safe_force is 0 N, which acts whenever the loop is off; write safe_force_N = "
                    f"{number(holding_force, 6)}, or hold the axis by a brake"
                )
            )
        if guard.following_error_limit is None:
            remarks.append("the guard has no following_error_limit: a loop that runs away does not trip")
        remarks += [f"the guard has {name} = false: {then}" for name, then in guard.left_out().items()]
        stability = self._stability(loop.name)
        remarks += [stability.sentence] if stability is not None and stability.judgment.bad else []
        if control.force_limit is None:
            remarks.append("the control has no force_limit: only the drive bounds the force")
        return remarks

    @property
    def judgment(self) -> Judgment:
        """The judgment on the stability of the axes: the first negative one, or `EXPORTED` if there is none."""
        return self.advice.judgment

    @property
    def advice(self) -> Advice:
        """The judgment on the stability of the axes with its reason, which is empty of `EXPORTED`."""
        loops = [self.loop] if not self.together else self.system.loops().values()
        loops = () if self.what == PLANT else loops
        found = [advice for loop in loops if (advice := self._stability(loop.name)) is not None]
        return next((advice for advice in found if advice.judgment.bad), Advice(Judgment.EXPORTED, ""))

    def _stability(self, axis: str) -> Advice | None:
        """Return the judgment on the stability of a loop; None if its period is too long to compute margins."""
        if period_of(self.system) > MOST:
            return None
        nyquist = 0.5 / self.routine.sample_time
        frequency = np.geomspace(1e-4 * nyquist, nyquist, 2000)
        try:
            result = margins(loop_gain(self.system, frequency, axis=axis))
        except NoSlopeError as error:
            return Advice(Judgment.NOT_DECIDED, Text(f"{Judgment.NOT_DECIDED.says}: {error}"))
        if result.sensitivity_peak <= LARGEST_MS:
            return Advice(Judgment.EXPORTED, "")
        return Advice(
            Judgment.NEAR_UNSTABLE,
            Text(
                f"the loop is close to instability: its sensitivity peak Ms is {Quantity(result.sensitivity_peak):3}; "
                f"a tuned loop has at most 2. {Judgment.NEAR_UNSTABLE.says}"
            ),
        )


def read_design(
    source: MachineLike,
    axis: str | None = None,
    *,
    name: str | None = None,
    what: str = CONTROL,
    precision: str = "double",
    together: bool = False,
) -> Design:
    """Return the design of a machine file, or of a bundled machine.

    name      prefix of all names on the target; default: `axis_x`, or `plant_x` for a plant
    axis      required for a controller if the file has several axes; without it, a plant contains all axes and
              couplings
    what      "control" or "plant"
    together  True to export the controllers of all axes as one design, with the couplings between them

    Raises FileError and ParameterError as `read_machine` does, ParameterError for a name that is illegal on a target
    and for the plant of one coupled axis, StructureError for a controller without a guard and for a part that uses
    operations outside `ops`, and the errors of `check_exportable`.
    """
    machine = read_machine(source)
    together = len(machine.loops) > 1 and (together or (what == PLANT and axis is None))
    axis_name = ", ".join(machine.loops) if together else machine.named(axis)
    alone = f"{'axis' if what == CONTROL else 'plant'}_{axis_name}"
    prefix = name or (("plant" if what == PLANT else "axes") if together else alone)
    check_name(prefix, "--name" if name else "the name of the axis")
    if together and what == CONTROL:
        for loop in machine.loops.values():
            require_guard(loop)
        routine = controller_routine(machine.machine(), prefix)
    elif together:
        routine = machine_routine(machine.machine(), prefix)
    elif what == PLANT:
        if machine.coupled(axis_name):
            raise ParameterError(
                f"{machine.file.name}: {machine.coupled(axis_name)}: leave out --axis, and all axes are exported as "
                "one plant"
            )
        routine = plant_routine(machine.loops[axis_name], prefix)
    else:
        _require_uncorrected(machine, axis_name)
        require_guard(machine.loops[axis_name])
        routine = controller_routine(machine.loops[axis_name], prefix)
    planned = layout(routine, precision)
    check_exportable(planned)
    return Design(machine, axis_name, what, planned)


def _require_uncorrected(machine: MachineFile, axis: str) -> None:
    """Raise ParameterError if a coupling between controllers acts on the controller of this axis."""
    for i, coupling in enumerate(machine.couplings):
        if coupling.controls and axis in coupling.axes():
            raise ParameterError(
                f"{machine.file.name}: couplings.{i} ({coupling.kind}) corrects the control of axis '{axis}', which "
                f"alone would be another: leave out --axis, and all controls are exported as one"
            )


def require_alone(design: Design, target: str) -> None:
    """Raise ParameterError if the axis is coupled with others, for a target that simulates a single axis."""
    coupled = design.machine.coupled(design.axis)
    if coupled:
        raise ParameterError(
            f"{design.machine.file.name}: {coupled}, and {target} simulates the axis alone, where it would move "
            f"otherwise: export all controls as one with --together to linuxcnc, or the control to c, cortex-m, st, "
            f"fmu2 or fmu3, and the plant of all axes with --plant, without --axis, to c, fmu2 or fmu3"
        )


def require_guard(loop: Loop) -> None:
    """Raise StructureError for a controller without a guard; the message gives the lines to add to the machine file.

    Only a guard defines how the controller reacts to invalid readings, on the target as in the simulation.
    """
    if loop.control.guard is None:
        held = float(weight(loop.axis))
        raise StructureError(
            f"the control of axis {loop.name} has no guard, so that the reaction of a target to a broken reading "
            "is not defined. Add these lines, with the limits of your machine, simulate, and export again:\n\n"
            f"    [axis.{loop.name}.control.guard]\n"
            f"    following_error_limit_mm = 1    # trips beyond it\n"
            f"    velocity_limit = 1              # m/s, trips beyond it\n"
            f"    safe_force_N = {held:<16g} # while the loop is off{': the weight' if held else ''}"
        )


def weight(axis: Axis) -> Number:
    """Return the force in N that holds a hanging axis against gravity."""
    # + 0.0: the negative of an empty sum is -0.0, which messages would show
    return -sum((force.force for force in axis.forces if isinstance(force, Gravity)), 0.0) + 0.0


# numbers: half a megabyte in double precision, more than the flash of most microcontrollers
LONGEST_TABLE = 65_536
_WORDS = {*INFIX, *CALLS, *FUNCTIONS, *ELEMENTARY, "select", "gather", "neg", "not"}
_LEAVES = ("const", "truth", "input", "table")


def check_exportable(layout: Layout) -> None:
    """Raise ParameterError or StructureError, with location and remedy, if a routine cannot be exported."""
    _check_tables(layout)
    _check_operations(layout)
    if layout.precision == "float":
        _check_numbers(layout)


def _check_tables(layout: Layout) -> None:
    for name, _, row in layout.routine.tables:
        if len(row) > LONGEST_TABLE:
            raise ParameterError(
                f"{name} has {len(row)} numbers, {len(row) - LONGEST_TABLE} more than the {LONGEST_TABLE} that an "
                f"export may hold: give it fewer, over a coarser grid or a shorter motion"
            )


def _check_operations(layout: Layout) -> None:
    for index, node in enumerate(layout.graph.nodes):
        single = layout.precision == "float" and layout.moving[index]
        if (node[0] not in _WORDS and node[0] not in _LEAVES) or (single and node[0] == "uniform"):
            owner = layout.makers.get(index, layout.routine.name)
            precision = " in single precision" if single else ""
            raise StructureError(f"{owner}: uses '{node[0]}', which exports do not support{precision}: leave it out")


def _check_numbers(layout: Layout) -> None:
    """Raise StructureError or ParameterError for a number beyond the range of single precision."""
    read = layout.moving_users
    for index, node in enumerate(layout.graph.nodes):
        if node[0] == "const" and read[index] and _too_large(float.fromhex(node[1])):
            owner = layout.makers.get(index, layout.routine.name)
            raise StructureError(f"{owner}: holds the number {Quantity(float.fromhex(node[1])):6}, {_BEYOND}")
    with np.errstate(over="ignore"):
        stored, wide = LayoutRun(layout).design, LayoutRun(layout, wide=True).design
    for field in layout.design:
        if not field.truth and np.isinf(stored[field.node]) and np.isfinite(wide[field.node]):
            raise ParameterError(f"{_design_name(layout, field)} = {Quantity(wide[field.node]):6}, {_BEYOND}")


_BEYOND = "beyond single precision, which ends at 3.4e38: take --precision double, or change the parameter"


def _too_large(value: float) -> bool:
    return bool(np.isfinite(value)) and abs(value) > float(np.finfo(np.float32).max)


def _design_name(layout: Layout, field: Field) -> str:
    """Return the name of a design number in messages: the dotted name of a parameter, otherwise the field name."""
    kind, place = layout.leaves.get(field.node, ("", 0))
    return layout.routine.parameters[place].path if kind == "parameter" else f"the design number {field.name}"


_DRAWS = 5  # attempts until the block accepts a change
# not numbers, absurdly large ones, and subnormal ones, which a target must count as zero like the simulator
BROKEN = (np.nan, np.inf, -np.inf, 1e300, -1e200, 5e-324, 1e-310)


@dataclass(frozen=True, eq=False)
class Trial:
    """The inputs of a test run, shape (n, inputs), and its parameter changes by sample and dotted name."""

    inputs: np.ndarray
    changes: Mapping[int, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Answers:
    """The outputs of an exported program in a trial, shape (n, outputs), and a description of its build and run."""

    outputs: np.ndarray
    program: str
    how: str


def trial(routine: Routine, count: int, seed: int = 0, *, changes: int = 50, broken: float = 2e-4) -> Trial:
    """Return a reproducible trial of `count` random samples of setpoints and readings.

    The reading follows the set position with an error and a jitter whose sizes change every 40 samples, from less than
    one encoder count to more than any limit, so that a quiet loop, limits and trips all occur.  `broken` is the
    probability that an input becomes an invalid number for one to four samples.  Every 20 samples, enable may drop
    for two samples, which clears trips.  At `changes` samples up to three parameters change by up to 25 %; the new
    values satisfy the bounds and the checks of their blocks.
    """
    random = np.random.default_rng(seed)
    pairs = zip(routine.origin.ports(), routine.origin.loops().values(), strict=True)
    rows: dict[str, np.ndarray] = {}
    for port, loop in pairs:
        wandering = _wandering(loop.control.guard or Guard(), routine.sample_time, count, random)
        rows |= {f"{port}{name}": row for name, row in wandering.items()}
    inputs = np.column_stack([rows[variable.path] for variable in routine.inputs])
    for column in range(inputs.shape[1]):
        for place in np.flatnonzero(random.random(count) < broken):
            inputs[place : place + random.integers(1, 5), column] = random.choice(np.array(BROKEN))
    places = sorted({int(k) for k in np.linspace(0, count, changes + 2)[1:-1]} - {0})
    return Trial(inputs, _changes(routine, places, random))


def _wandering(guard: Guard, T: float, count: int, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return random inputs for one axis, by name of the input."""
    far = 1e-3 if guard.following_error_limit is None else float(guard.following_error_limit)
    fast = 1.0 if guard.velocity_limit is None else float(guard.velocity_limit)

    def held(values: np.ndarray, samples: int) -> np.ndarray:
        return np.repeat(values, samples)[:count]

    blocks = count // 40 + 1
    least, most = (0.5 * sign if end is None else float(end) for sign, end in _ends(guard))
    # 0.502: slightly beyond the travel, so that its ends trip, too
    middle, half = 0.5 * (least + most), 0.502 * (most - least)
    turning = 0.4 * fast / half * np.sin(0.002 * np.cumsum(random.normal(0.0, 1.0, count)))
    angle = T * np.cumsum(turning)
    position, speed = middle + half * np.sin(angle), half * turning * np.cos(angle)
    # up to 10^0.05 = 1.12 times the limit of the following error, so that few blocks trip
    error = held(far * 10.0 ** random.uniform(-6.0, 0.05, blocks), 40) * np.sin(0.03 * np.arange(count))
    jitter = held(fast * T * 10.0 ** random.uniform(-6.0, -0.4, blocks), 40)
    rows: dict[str, np.ndarray] = {
        "set_position": position,
        "set_velocity": speed,
        "set_acceleration": random.normal(0.0, 5.0, count),
        "set_jerk": random.normal(0.0, 100.0, count),
        "set_snap": random.normal(0.0, 1e4, count),
        "enable": np.where(held(random.random(count // 20 + 1) < 0.4, 20) & (np.arange(count) % 20 < 2), 0.0, 1.0),
    }
    for name in ("reading", "reading_motor", "reading_load"):
        rows[name] = position + error + jitter * random.normal(0.0, 1.0, count)
    return rows


def _ends(guard: Guard) -> tuple[tuple[float, Any], tuple[float, Any]]:
    return (-1.0, guard.travel_least), (1.0, guard.travel_most)


def _changes(routine: Routine, places: list[int], random: np.random.Generator) -> dict[int, dict[str, float]]:
    """Return random parameter changes of up to 25 % that pass the checks of their blocks."""
    both = on_target(routine.origin)
    first = {variable.path: variable for variable in routine.parameters}
    changes: dict[int, dict[str, float]] = {}
    for sample in places:
        # a block may refuse a combination; the next draw starts from the last accepted parameters
        for _ in range(_DRAWS):
            chosen = random.choice(len(first), size=min(3, len(first)), replace=False)
            moved = {variable.path: _moved(variable, random) for variable in (list(first.values())[i] for i in chosen)}
            try:
                after = tree.vary(both, moved)
                tree.check_sampled(after, routine.sample_time)
            except FeeddriveError:
                continue
            both, changes[sample] = after, moved
            break
    return changes


def _moved(variable: Variable, random: np.random.Generator) -> float:
    return float(variable.value * random.uniform(0.8, 1.25))
