"""The families of blocks: the abstract interfaces that every block of a family implements.

A block is final: it implements the abstract methods and overrides no method with a body but the empty hooks `prepare`,
`start` of forces and feedforward, `start` and `step` of couplings with `modes`, `springs`, `follows`, `listen` and
`correct`, `retune`, `period`, `check`, `rules`, `sampled_rules`, `substep_rules`, `fed`, `lag`, `settled`, `suits`,
`fits`, `begin`, `goes_beside`, `stretches`, `position_gain`, `positions`, `carries` and `moved`.

    prepare(T)   values that depend on parameters only, computed once per run; returns a named tuple
    start(...)   the steady state of a block at rest
    step(...)    one sample: a pure function from the old state to the new one
    retune(...)  the state after a live change: forces and estimates stay continuous, bit-identical for equal parameters
    begin(axis)  start values of its parameters for the tuning on an axis

`retune` has no default for a block with a state: the old state is right only where no parameter scales its contents,
and no general rule keeps every block continuous, since the last output determines only one of several state variables.
Without it, such a block is refused at a live change and by an export.

Besides the blocks of a single axis there are couplings, which act on several axes of a machine, and milling tools.
"""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from feeddrive.blocks.axis_model import AxisModel, Beside, Start, begun
from feeddrive.blocks.reference.stretches import Stretch
from feeddrive.blocks.signals import Estimate, Motion, Noise, Reading, Setpoint
from feeddrive.language import matrix, tree
from feeddrive.language.block import Block, Number, Rule, choice, declarations
from feeddrive.language.errors import StructureError
from feeddrive.language.matrix import Matrix, Row


class Retuned:
    """The base class of control blocks with prepared values."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any, old_prepared: Any, prepared: Any) -> Any:
        """Return the state after a live change from the block `old` to this one, without a bump (hook).

        Raises StructureError for a block with a state that does not override it.
        """
        return _without_numbers(self.kind, state, "state, old, old_prepared, prepared")


class RetunedUnprepared:
    """The base class of control blocks without prepared values."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any) -> Any:
        """Return the state after a live change from the block `old` to this one, without a bump (hook).

        Raises StructureError for a block with a state that does not override it.
        """
        return _without_numbers(self.kind, state, "state, old")


def _without_numbers(kind: str, state: Any, arguments: str) -> Any:
    held = [name or "a number" for name, _ in tree.leaves(state)]
    if held:
        raise StructureError(
            f"{kind} does not say what becomes of its state ({', '.join(held[:3])}{', ...' if held[3:] else ''}) when "
            f"its parameters change in a running loop: define retune(self, {arguments}), which returns the state with "
            f"which the output goes on: `return state` where no parameter scales what it holds, as positions in m and "
            f"forces in N; else convert it, as docs/live_changes.md shows"
        )
    return state


class Nothing(NamedTuple):
    """The state of a block without memory, and the prepared values of a block without preparation."""


class Mechanics(NamedTuple):
    """The matrices of M q'' + C q' + K q = Sᵀ f with body positions x = S q, with rows of S for drive and encoders."""

    mass: Matrix  # M (n, n), kg, positive definite
    damping: Matrix  # C (n, n), N s/m
    stiffness: Matrix  # K (n, n), N/m
    shape: Matrix  # S (bodies, n)
    drive: int = 0  # row of S on which the drive acts
    motor: int = 0  # row of S with the motor encoder, and with the friction of bearings and nut
    load: int = 0  # row of S whose position is the axis's, with the load encoder and the friction of the guideway
    rigid: Row = ()  # q after a rigid motion of the axis by 1 m, springs relaxed; empty if each q is a body's position

    def rigid_motion(self) -> Row:
        """Return the coordinates of a rigid motion by 1 m: S q = 1 and K q = 0."""
        return self.rigid or (1.0,) * len(self.mass)


class Plant(Block, ABC):
    """The linear mechanics of an axis, continuous in time; forces and positions are referred to the table (linear)."""

    @abstractmethod
    def mechanics(self) -> Mechanics:
        """Return the matrices in plain arithmetic; literal 0.0 and 1.0 in the code cost no operations in the step."""

    def rigid_mass(self) -> Number:
        """Return the mass of the rigid motion, kg."""
        mechanics = self.mechanics()
        along = mechanics.rigid_motion()
        return matrix.dot([matrix.dot(row, along) for row in mechanics.mass], along)


class Friction(Block, ABC):
    """Friction at one body, set-valued and implicit: the force over a substep matches the velocity at its end."""

    @abstractmethod
    def start(self, velocity: Number = 0.0) -> Any:
        """Return the state after a long motion at this velocity."""

    @abstractmethod
    def linear(self) -> Number:
        """Return the viscous coefficient, N s/m: the linear core applies it exactly, and `contact` omits it."""

    @abstractmethod
    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Return the new state, the force F in N, and True if the body is stuck; F is held over the implicit step.

        step, velocity  s, length of the substep; m/s at its start
        free_velocity   m/s at its end if F were 0; with it, v = free_velocity + mobility · F, exactly 0 if it is stuck
        mobility        (m/s)/N, > 0
        """

    @abstractmethod
    def steady(self, velocity: Number) -> Number:
        """Return the friction force in N at a constant velocity, with the linear part; for plots and feedforward."""


class Force(Block, ABC):
    """A force that depends on motion, drive force, time or its own past: cogging, backlash, gravity, regeneration."""

    def start(self, plant: Plant, motion: Motion) -> Any:
        """Return the state after a long motion at this velocity (empty hook)."""
        return Nothing()

    @abstractmethod
    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        """Compute a substep of h seconds: the new state, and the force in N on the motor's and on the load's body.

        `motion` is predicted for the middle of the substep, at the instant `time`; `drive` is the drive's mean force.
        """

    def fits(self, plant: Plant, beside: tuple[Self, ...]) -> None:
        """Raise StructureError for a plant or other forces with which the force cannot be combined (empty hook)."""

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the rules of the force for substeps of h seconds (empty hook)."""
        return iter(())


class Motor(Block, ABC):
    """The source of the force: it converts N at the table into the drive's unit (A, V, N m)."""

    unit: ClassVar[str] = ""

    @abstractmethod
    def force_per_unit(self) -> Number:
        """Return the force in N at the table per unit of the drive's command."""

    @abstractmethod
    def limits(self) -> tuple[Number | None, Number | None]:
        """Return the peak and continuous (RMS) force in N at the table; None if not stated."""

    @abstractmethod
    def velocity_limit(self) -> Number | None:
        """Return the largest speed in m/s at the table; None if not stated."""


class Sensor(Block, ABC):
    """An encoder with its errors: the reading of the controller for a body at `position`."""

    @abstractmethod
    def start(self, position: Number) -> Any:
        """Return the state of an encoder whose axis has been at rest at `position`."""

    @abstractmethod
    def still(self, position: Number) -> Number:
        """Return the reading in m of a body at rest at `position`, without noise."""

    @abstractmethod
    def step(self, state: Any, position: Number, velocity: Number, noise: Noise, T: Number) -> tuple[Any, Number]:
        """Return the new state and the reading in m, from the true position (m) and velocity (m/s) at t = kT."""


class Law(Block, Retuned, ABC):
    """A feedback law: the controller of one paper, in one file. A command is a force in N at the load.

    feeds    parts of the set motion that the law itself feeds forward (`FEEDS`): no other block may feed them too
    rejects  True if the law itself subtracts the estimate of an observer
    encoders 2 if the law always needs the motor's and the load's position as two measurements
    tunables parameters to tune, in the order of manual tuning, without an observer's; empty: see `to_tune`
    title    its name in a comparison; empty: its kind
    steps_live  True if the force steps at a live change in a steady state, as in the original that it reproduces
    """

    feeds: ClassVar[tuple[str, ...]] = ()
    rejects: ClassVar[bool] = False
    encoders: ClassVar[int] = 1
    tunables: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    steps_live: ClassVar[bool] = False

    @classmethod
    def to_tune(cls) -> tuple[str, ...]:
        """Return `tunables`, or else every positive parameter without a default except the plant model."""
        fields = ((spec, declarations(cls)[spec.name]) for spec in dataclasses.fields(cls))  # type: ignore[arg-type]
        free = [
            spec.name
            for spec, declaration in fields
            if spec.default is dataclasses.MISSING and declaration.above == 0.0
        ]
        # mass and friction are those of the axis, not settings
        return cls.tunables or tuple(name for name in free if name not in ("mass", "viscous"))

    @classmethod
    def begin(cls, axis: AxisModel, present: Self) -> tuple[Start, ...]:
        """Return the start values of a search for one or several forms of the law (hook).

        `present` is the law of the axis's current controller. By default the values follow from their units (`begun`).
        An empty tuple leaves the law out of the comparison. Raises StructureError, with the reason, if the law cannot
        be used on the axis.
        """
        return (Start(cls.title or cls.kind.replace("_", " "), begun(cls, axis), axis.sentence()),)

    def prepare(self, T: Number) -> Any:
        """Compute the values that depend on parameters only (empty hook)."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> Any:
        """Return the state for a bumpless start from the reading; pure and traced, since every enable runs it."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, setpoint: Setpoint, reading: Reading, T: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the force in N."""

    def period(self) -> int:
        """Return the period in samples of a time-varying law; more than 1 for a law with a slower part (empty hook)."""
        return 1

    def at_one_rate(self) -> Self:
        """Return the law with all its parts at the sample time, for a law with a slower part (empty hook)."""
        return self

    def position_gain(self) -> Any:
        """Return the velocity commanded per position error, 1/s; None if the law has no such gain (empty hook)."""
        return None

    def positions(self) -> int:
        """Return the number of positions that the law needs as separate measurements (empty hook)."""
        return self.encoders

    def settled(self) -> Self:
        """Return the block without its internal limits, for linear models (empty hook)."""
        return self


class Filter(Block, Retuned, ABC):
    """A scalar filter in the forward path."""

    @abstractmethod
    def prepare(self, T: Number) -> Any:
        """Return the coefficients of the filter."""

    @abstractmethod
    def start(self, prepared: Any, value: Number) -> Any:
        """Return the state after a constant input `value`."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, value: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the output."""


FEEDS = ("acceleration", "velocity", "friction")  # parts of the set motion that can be fed forward


class Feedforward(Block, RetunedUnprepared, ABC):
    """A force computed from the setpoint and its past; it bypasses the filters.

    feeds    the parts of the set motion that the block feeds forward (`FEEDS`), so that none is fed twice
    learned  its name in a comparison if its parameters are learned from trials; empty if they cannot be
    """

    feeds: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    learned: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison combines it with a law, under its `title`, starting from `begin` (empty hook)."""
        return False

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return start values on an axis.  Raises StructureError, with the reason, if there are none (empty hook)."""
        return begun(cls, axis)

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion fed forward: fewer than `feeds` if some are absent (empty hook)."""
        return self.feeds

    def start(self, setpoint: Setpoint) -> Any:
        """Return the state at a constant setpoint (empty hook)."""
        return Nothing()

    @abstractmethod
    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the force in N that acts over [kT, (k+1)T]."""


class Prefilter(Block, RetunedUnprepared, ABC):
    """A block that changes the setpoint before law and feedforward see it."""

    title: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison combines it, fitted to the move, with a law, under its `title` (empty hook)."""
        return False

    @abstractmethod
    def start(self, setpoint: Setpoint) -> Any:
        """Return the state at a constant setpoint."""

    @abstractmethod
    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Setpoint]:
        """Compute one sample: the new state and the setpoint."""


class Observer(Block, Retuned, ABC):
    """An estimator of quantities that are not measured, from reading and `applied`; its `tunables` are positive."""

    tunables: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return start values of a search on an axis. Raises StructureError if there are none (empty hook)."""
        return begun(cls, axis)

    def prepare(self, T: Number) -> Any:
        """Compute the values that depend on parameters only (empty hook)."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, reading: Reading) -> Any:
        """Return the state at rest at the measured position, with `reading.applied` balanced by the disturbance."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, reading: Reading, T: Number) -> tuple[Any, Estimate]:
        """Compute one sample: the new state and the estimate at kT."""

    def lag(self, prepared: Any, T: Number) -> Number:
        """Return the delay of the estimate of a slow disturbance, s; 0.0 if it is unknown (empty hook)."""
        return 0.0


class Compensation(Block, Retuned, ABC):
    """A block for any law: it uses the reading to shift the setpoint (modes) or to add a force (rejection)."""

    title: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison combines it with a law, under its `title`, starting from `begin` (empty hook)."""
        return False

    @classmethod
    def begin(cls, axis: AxisModel) -> tuple[Beside, ...]:
        """Return one or several forms of the compensation, by default with start values by unit (empty hook).

        Raises StructureError, with the reason, if there are none.
        """
        return (Beside(cls.title, begun(cls, axis)),)

    def prepare(self, T: Number) -> Any:
        """Compute the values that depend on parameters only (empty hook)."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> Any:
        """Return the state at rest at the measured position."""

    @abstractmethod
    def step(
        self, prepared: Any, state: Any, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[Any, Setpoint, Number]:
        """Compute one sample: new state, setpoint for law and feedforward, and force in N behind the filters."""

    def carries(self, reading: Reading) -> Any:
        """Return the part of the acting force that the block provides at the start, N; the law adds the rest (hook)."""
        return 0.0

    def moved(self, state: Any) -> Any:
        """Return the part of the set-position shift that only corrects the reading, m (empty hook)."""
        return 0.0

    def settled(self) -> Self:
        """Return the block as it acts in the long run, with all blending complete, for linear models (empty hook)."""
        return self

    def suits(self, law: Law) -> None:
        """Raise StructureError, with the reason, if this block cannot be combined with the law (empty hook)."""


class Reference(Block, ABC):
    """A motion in closed form or from a log; sampled, not traced, so it may use numpy."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """The duration in s, after which the setpoint rests at the end."""

    @abstractmethod
    def at(self, t: np.ndarray) -> Setpoint:
        """Return the setpoints at times t (s, shape (n,)), each field of shape (n,).

        The axis is at rest before 0 and after the end.
        """

    def stretches(self) -> tuple[Stretch, ...]:
        """Return the motion from t = 0 as polynomials of time, for machine code; empty if only `at` exists (hook)."""
        return ()


class Load(Block, ABC):
    """A force on the moved body as a function of time alone; sampled, not traced."""

    @abstractmethod
    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the force in N at times t (s, shape (n,)); it is held over the sample."""


class SharedMode(NamedTuple):
    """A structure mode shared by several axes: mass η'' + damping η' + stiffness η = Σ shape · f."""

    mass: Number  # kg
    damping: Number  # N s/m
    stiffness: Number  # N/m
    shapes: Mapping[str, tuple[Number, Number]]  # by axis: shape at the motor's and at the load's body


class SharedSpring(NamedTuple):
    """A spring and a damper between tables: stretch = Σ share · x_load, force on each table = -share · (k s + c s')."""

    stiffness: Number  # N/m
    damping: Number  # N s/m
    shares: Mapping[str, Number]  # by axis


class Coupling(Block, ABC):
    """A coupling between the axes of a machine: shared modes, forces at common substeps, or a contour controller.

    A coupling implements `modes`, `springs`, or `step` with `start` and `prepare`, or several of them; with `controls`
    it implements `listen` and `correct`, which run on the controller once a sample.
    """

    controls: ClassVar[bool] = False

    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes on which the coupling acts."""

    def modes(self) -> tuple[SharedMode, ...]:
        """Return the modes that are integrated with these axes in one exact hold (empty hook)."""
        return ()

    def springs(self) -> tuple[SharedSpring, ...]:
        """Return the springs between tables; the axes are then integrated in one exact hold (empty hook)."""
        return ()

    def follows(self) -> dict[str, str]:
        """Return, for each follower, the axis whose part-program words also move it (empty hook)."""
        return {}

    def prepare(self, h: Number) -> Any:
        """Compute the values that depend on parameters and the substep h only (empty hook)."""
        return Nothing()

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> Any:
        """Return the state after a long motion of the axes at these velocities (empty hook)."""
        return Nothing()

    def step(
        self, prepared: Any, state: Any, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[Any, Mapping[str, tuple[Number, Number]]]:
        """Compute a substep of h seconds: the new state, and by axis the force in N on its motor's and its load's body.

        Motions are predicted for the middle of the substep, at the instant `time` (empty hook).
        """
        return state, {}

    def listen(self, setpoints: Mapping[str, Setpoint]) -> Any:
        """Return the state on the controller when the axes start at these setpoints (empty hook)."""
        return Nothing()

    def correct(
        self, state: Any, setpoints: Mapping[str, Setpoint], positions: Mapping[str, Number]
    ) -> tuple[Any, Mapping[str, Number]]:
        """Compute one sample on the controller from the positions read (m): state and corrections (empty hook).

        The corrections, by axis in m/s, are added to the velocity that the law of the axis commands.
        """
        return state, {}

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the rules of the coupling for substeps of h seconds (empty hook)."""
        return iter(())


class Edge(NamedTuple):
    """The edges of a tool, which are helical and identical on all teeth."""

    teeth: int
    slices: int  # number of pieces of an edge, each in contact or not
    diameter: Number  # m
    axial_depth: Number  # m
    helix_angle: Number  # rad
    entry: Number  # rad
    exit: Number  # rad
    cutting: tuple[Number, Number, Number]  # Ktc, Krc, Kac: force along, towards the axis, along it, N/m2
    rubbing: tuple[Number, Number, Number] | None = None  # Kte, Kre, Kae of the edge itself, N/m; None: none
    run_out: tuple[Number, Number] | None = None  # offset of the tool's axis in m, and its angle in rad
    flute_length: Number | None = None  # m, of the cutting edges; None: not stated, any depth is admissible


class Cutter(Block, ABC):
    """A milling tool: the force of the workpiece on the tool, traced so that loads and couplings can both use it."""

    teeth: int = choice("cutting edges, equally spaced", least=1, most=100)
    slices: int = choice("pieces of an edge, each in contact or not", default=5, least=1, most=200)

    @abstractmethod
    def edge(self) -> Edge:
        """Return the edges of the tool, for a chip that follows from its motion."""

    @abstractmethod
    def forces(self, angle: Number, chip_load: Number) -> tuple[Number, Number, Number]:
        """Return the force in N on the tool along feed, normal (spindle axis x feed) and spindle axis.

        `angle` is the rotation of the spindle in rad since the tip of the first tooth entered the chip of a slot.
        `chip_load` is the feed per tooth in m.
        """

    @abstractmethod
    def torque(self, angle: Number, chip_load: Number) -> Number:
        """Return the spindle torque at the same angle and chip load, N m."""
