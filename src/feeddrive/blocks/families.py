"""The families of blocks: the abstract interfaces that every block of a family implements.

A block is final: it implements the abstract methods and overrides no other methods except these, which have defaults:
`prepare`, `start` of forces and feedforward, `start` and `step` of couplings with `modes`, `springs`, `follows`,
`listen` and `correct`, `retune`, `period`, `check`, `rules`, `sampled_rules`, `substep_rules`, `fed`, `lag`, `settled`,
`suits`, `fits`, `begin`, `goes_beside`, `stretches`, `position_gain`, `positions`, `subtracts`, `tuned`, `at_one_rate`,
`scheduled_at`, `carries` and `moved`.

    prepare(T)   returns a named tuple of values that depend on parameters only; called once per run
    start(...)   returns the steady state of a block at rest
    step(...)    computes one sample: a pure function that maps the old state to the new one
    retune(...)  returns the state after a live change; forces and estimates stay continuous, and equal parameters
                 leave the state bit-identical
    begin(axis)  returns starting values of the parameters for tuning on an axis

`retune` has no default for a block with a state: the old state is right only where no parameter scales its contents,
and no general rule keeps every block continuous, since the last output determines only one of several state variables.
A block with a state but without `retune` is therefore refused at a live change and in an export.

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
    """The base class of control blocks with precomputed values (`prepare`)."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any, old_prepared: Any, prepared: Any) -> Any:
        """Return the state after a bumpless live change from the block `old` to this one.

        Raises StructureError if the block has a state but does not override this method.
        """
        return _without_numbers(self.kind, state, "state, old, old_prepared, prepared")


class RetunedUnprepared:
    """The base class of control blocks without precomputed values."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any) -> Any:
        """Return the state after a bumpless live change from the block `old` to this one.

        Raises StructureError if the block has a state but does not override this method.
        """
        return _without_numbers(self.kind, state, "state, old")


def _without_numbers(kind: str, state: Any, arguments: str) -> Any:
    held = [name or "a number" for name, _ in tree.leaves(state)]
    if held:
        raise StructureError(
            f"{kind} does not say what becomes of its state ({', '.join(held[:3])}{', ...' if held[3:] else ''}) when "
            f"its parameters change in a running loop: define retune(self, {arguments}), which returns the state with "
            f"which the output goes on: `return state` where no parameter scales what it holds, as positions in m and "
            f"forces in N; else convert it, as docs/explanation/live_changes.md shows"
        )
    return state


class Nothing(NamedTuple):
    """The empty state of a block without memory, and the empty result of `prepare` of a block that needs none."""


class Mechanics(NamedTuple):
    """The matrices of M q'' + C q' + K q = Sᵀ f with body positions x = S q; S has rows for drive and encoders."""

    mass: Matrix  # M (n, n), kg, positive definite
    damping: Matrix  # C (n, n), N s/m
    stiffness: Matrix  # K (n, n), N/m
    shape: Matrix  # S (bodies, n)
    drive: int = 0  # row of S on which the drive acts
    motor: int = 0  # row of S with the motor encoder, and with the friction of bearings and nut
    load: int = 0  # row of S whose position is the axis's, with the load encoder and the friction of the guideway
    rigid: Row = ()  # q after a rigid motion of the axis by 1 m, springs relaxed; empty if each q is a body's position

    def rigid_motion(self) -> Row:
        """Return the coordinates q of a rigid displacement by 1 m, for which S q = 1 and K q = 0."""
        return self.rigid or (1.0,) * len(self.mass)


class Plant(Block, ABC):
    """The linear mechanics of an axis, continuous in time; forces and positions are referred to the table."""

    @abstractmethod
    def mechanics(self) -> Mechanics:
        """Return the matrices, computed by plain arithmetic; a literal 0.0 or 1.0 saves operations in the step."""

    def rigid_mass(self) -> Number:
        """Return the total mass in rigid motion, kg."""
        mechanics = self.mechanics()
        along = mechanics.rigid_motion()
        return matrix.dot([matrix.dot(row, along) for row in mechanics.mass], along)


class Friction(Block, ABC):
    """Set-valued friction at one body, solved implicitly: the force over a substep fits the velocity at its end."""

    @abstractmethod
    def start(self, velocity: Number = 0.0) -> Any:
        """Return the steady state at a constant velocity."""

    @abstractmethod
    def linear(self) -> Number:
        """Return the viscous coefficient, N s/m: the linear core applies it exactly, and `contact` omits it."""

    @abstractmethod
    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Return the new state, the force F (N) held over the substep, and a flag that is True if the body sticks.

        step           length of the substep, s
        velocity       velocity at the start of the substep, m/s
        free_velocity  velocity at its end if F were 0, m/s; the velocity with F is free_velocity + mobility · F,
                       which is exactly 0 if the body sticks
        mobility       velocity change per force, (m/s)/N, > 0
        """

    @abstractmethod
    def steady(self, velocity: Number) -> Number:
        """Return the friction force in N at a constant velocity, linear part included; for plots and feedforward."""


class Force(Block, ABC):
    """A force that depends on motion, drive force, time or its own past: cogging, backlash, gravity, regeneration."""

    def start(self, plant: Plant, motion: Motion) -> Any:
        """Return the steady state at the velocity of `motion`; by default an empty state."""
        return Nothing()

    @abstractmethod
    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        """Compute a substep of h seconds: the new state, and the force in N on the motor's and on the load's body.

        `motion` is predicted for the middle of the substep, at the instant `time`; `drive` is the drive's mean force.
        """

    def fits(self, plant: Plant, beside: tuple[Self, ...]) -> None:
        """Raise StructureError if this force cannot be combined with the plant or with the forces `beside` it."""

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rules of the force for substeps of h seconds; by default none."""
        return iter(())


class Motor(Block, ABC):
    """The motor, which converts force at the table (N) to the unit of the drive's command (A, V or N m)."""

    unit: ClassVar[str] = ""

    @abstractmethod
    def force_per_unit(self) -> Number:
        """Return the force in N at the table per unit of the drive's command."""

    @abstractmethod
    def limits(self) -> tuple[Number | None, Number | None]:
        """Return the peak and continuous (RMS) force in N at the table; None for a limit that is not specified."""

    @abstractmethod
    def velocity_limit(self) -> Number | None:
        """Return the largest speed in m/s at the table; None if it is not specified."""


class Sensor(Block, ABC):
    """An encoder with its errors, which turns the position of a body into the position that the controller reads."""

    @abstractmethod
    def start(self, position: Number) -> Any:
        """Return the state of an encoder whose axis has been at rest at `position`."""

    @abstractmethod
    def still(self, position: Number) -> Number:
        """Return the position in m that the controller reads, without noise, when the body is at rest at `position`."""

    @abstractmethod
    def step(self, state: Any, position: Number, velocity: Number, noise: Noise, T: Number) -> tuple[Any, Number]:
        """Return the new state and the reading (m), from the true position (m) and velocity (m/s) at t = kT."""


class Law(Block, Retuned, ABC):
    """A feedback law, one per file, whose command is a force in N at the load, or a velocity in m/s (`commanded`).

    feeds    parts of the set motion (`FEEDS`) that the law itself feeds forward, so no other block may do so
    rejects  True if the law itself subtracts the estimate of an observer
    encoders 2 if the law always needs separate measurements of the motor and the load position, otherwise 1 tunables
    parameters to tune, in the order of manual tuning, excluding an observer's; if empty, see `to_tune`
    title    name of the law in a comparison; if empty, its kind is used
    commanded   what the command is: "force" in N or, for a drive with its own velocity loop, "velocity" in m/s
    steps_live  True if the force jumps at a live change in steady state, as in the original that the law reproduces
    """

    feeds: ClassVar[tuple[str, ...]] = ()
    rejects: ClassVar[bool] = False
    encoders: ClassVar[int] = 1
    tunables: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    commanded: ClassVar[str] = "force"
    steps_live: ClassVar[bool] = False

    @classmethod
    def to_tune(cls) -> tuple[str, ...]:
        """Return `tunables` or, if empty, all positive parameters without default, except mass and viscous friction."""
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
        """Return one or more variants of the law with starting values for a search.

        `present` is the law of the axis's existing controller. By default the starting values follow from the units of
        the parameters (`begun`). If the tuple is empty, the comparison omits the law. Raises StructureError, with the
        reason, if the law cannot be used on the axis.
        """
        return (Start(cls.title or cls.kind.replace("_", " "), begun(cls, axis), axis.sentence()),)

    def prepare(self, T: Number) -> Any:
        """Return the values that depend on parameters only, computed once per run; by default none."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> Any:
        """Return the state for a bumpless start from the reading; a pure, traced function that runs at every enable."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, setpoint: Setpoint, reading: Reading, T: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the command, a force in N or a velocity in m/s (`commanded`)."""

    def period(self) -> int:
        """Return the period of the law in samples: more than 1 if a part of it runs more slowly, by default 1."""
        return 1

    def at_one_rate(self) -> Self:
        """Return the law with all its parts running at the sample time; by default the law itself."""
        return self

    def position_gain(self) -> Any:
        """Return the ratio of commanded velocity to position error, 1/s; None, the default, if there is none."""
        return None

    def positions(self) -> int:
        """Return the number of positions that the law needs as separate measurements; by default `encoders`."""
        return self.encoders

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion that the law feeds forward; by default `feeds`."""
        return self.feeds

    def subtracts(self) -> bool:
        """Return True if the law subtracts the estimate of an observer; by default `rejects`."""
        return self.rejects

    def tuned(self) -> tuple[str, ...]:
        """Return the dotted names of the parameters to tune; by default `to_tune` and those of an observer."""
        observer = getattr(self, "observer", None)
        within = (f"observer.{name}" for name in observer.tunables) if isinstance(observer, Observer) else ()
        return (*self.to_tune(), *within)

    def scheduled_at(self) -> tuple[Number, ...]:
        """Return the positions (m) of a law whose parameters depend on the position; by default it depends on none."""
        return ()

    def settled(self) -> Self:
        """Return the law without its internal limits, for linear models; by default the law itself."""
        return self


class Filter(Block, Retuned, ABC):
    """A scalar filter in the forward path."""

    @abstractmethod
    def prepare(self, T: Number) -> Any:
        """Return the coefficients of the filter."""

    @abstractmethod
    def start(self, prepared: Any, value: Number) -> Any:
        """Return the steady state for a constant input `value`."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, value: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the output."""


FEEDS = ("acceleration", "velocity", "friction")  # parts of the set motion that can be fed forward


class Feedforward(Block, RetunedUnprepared, ABC):
    """A force computed from the setpoint and its past; it bypasses the filters.

    feeds    parts of the set motion (`FEEDS`) that the block feeds forward, so no other block may do so
    title    name of the block in a comparison
    learned  name in a comparison if the parameters are learned from trials; empty if they cannot be learned
    """

    feeds: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    learned: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison should try the block, as set up by `begin`, with a law; default: False."""
        return False

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return a block with starting values for an axis, by default derived from the units of the parameters.

        Raises StructureError, with the reason, if the block cannot be used on the axis.
        """
        return begun(cls, axis)

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion that are fed forward: `feeds` (the default) without the absent ones."""
        return self.feeds

    def start(self, setpoint: Setpoint) -> Any:
        """Return the state at a constant setpoint; by default an empty state."""
        return Nothing()

    @abstractmethod
    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        """Compute one sample: the new state and the force in N that acts over [kT, (k+1)T]."""


class Prefilter(Block, RetunedUnprepared, ABC):
    """A block that changes the setpoint before law and feedforward receive it.

    title    name of the block in a comparison
    """

    title: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison should try the block, fitted to the move, together with a law; default: False."""
        return False

    @abstractmethod
    def start(self, setpoint: Setpoint) -> Any:
        """Return the state at a constant setpoint."""

    @abstractmethod
    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Setpoint]:
        """Compute one sample: the new state and the setpoint."""


class Observer(Block, Retuned, ABC):
    """An estimator of unmeasured quantities from the reading and the `applied` force; its `tunables` are positive."""

    tunables: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return an observer with starting values for an axis, by default derived from the units of the parameters.

        Raises StructureError, with the reason, if the observer cannot be used on the axis.
        """
        return begun(cls, axis)

    def prepare(self, T: Number) -> Any:
        """Return the values that depend on parameters only, computed once per run; by default none."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, reading: Reading) -> Any:
        """Return the state at rest at the measured position; the disturbance balances `reading.applied`."""

    @abstractmethod
    def step(self, prepared: Any, state: Any, reading: Reading, T: Number) -> tuple[Any, Estimate]:
        """Compute one sample: the new state and the estimate at kT."""

    def lag(self, prepared: Any, T: Number) -> Number:
        """Return the delay of the estimate of a slow disturbance, s; 0.0, the default, if it is unknown."""
        return 0.0


class Compensation(Block, Retuned, ABC):
    """A block that uses the reading to shift the setpoint (modes) or to add a force (rejection), with any law.

    title    name of the block in a comparison
    """

    title: ClassVar[str] = ""

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True if a comparison should try the block, as set up by `begin`, with a law; default: False."""
        return False

    @classmethod
    def begin(cls, axis: AxisModel) -> tuple[Beside, ...]:
        """Return one or more variants of the block, by default one with starting values derived from the units.

        Raises StructureError, with the reason, if no variant suits the axis.
        """
        return (Beside(cls.title, begun(cls, axis)),)

    def prepare(self, T: Number) -> Any:
        """Return the values that depend on parameters only, computed once per run; by default none."""
        return Nothing()

    @abstractmethod
    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> Any:
        """Return the state at rest at the measured position."""

    @abstractmethod
    def step(
        self, prepared: Any, state: Any, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[Any, Setpoint, Number]:
        """Compute one sample: new state, setpoint for law and feedforward, force (N) added after the filters."""

    def carries(self, reading: Reading) -> Any:
        """Return the part of the acting force in N that this block, not the law, provides at the start; default: 0."""
        return 0.0

    def moved(self, state: Any) -> Any:
        """Return the part of the set-position shift in m that only corrects an error of the reading; default: 0."""
        return 0.0

    def settled(self) -> Self:
        """Return the block with all blending complete, for linear models; by default the block itself."""
        return self

    def suits(self, law: Law) -> None:
        """Raise StructureError, with the reason, if this block cannot be combined with the law."""


class Reference(Block, ABC):
    """A motion in closed form or from a log; it is sampled rather than traced, so it may use numpy."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """The duration in s, after which the setpoint rests at its end position."""

    @abstractmethod
    def at(self, t: np.ndarray) -> Setpoint:
        """Return the setpoints at times t (s, shape (n,)), each field of shape (n,).

        The axis is at rest before 0 and after the end.
        """

    def stretches(self) -> tuple[Stretch, ...]:
        """Return the motion from t = 0 as polynomials in time, for exported code.

        By default the result is empty; the motion can then be computed only by `at`.
        """
        return ()


class Load(Block, ABC):
    """A force on the load's body as a function of time alone; it is sampled rather than traced."""

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
    """A spring and a damper between tables: stretch s = Σ share · x_load, force on each table -share · (k s + c s')."""

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
        """Return the modes that are discretized together with these axes; by default none."""
        return ()

    def springs(self) -> tuple[SharedSpring, ...]:
        """Return the springs between tables (default: none); with springs the axes are discretized together."""
        return ()

    def follows(self) -> dict[str, str]:
        """Return, for each follower, the axis whose part-program words also move it; by default none."""
        return {}

    def prepare(self, h: Number) -> Any:
        """Return the values that depend only on the parameters and the substep h; by default none."""
        return Nothing()

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> Any:
        """Return the steady state at the velocities of `motions`; by default an empty state."""
        return Nothing()

    def step(
        self, prepared: Any, state: Any, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[Any, Mapping[str, tuple[Number, Number]]]:
        """Compute a substep of h seconds: the new state, and for each axis the forces in N on motor and load body.

        Motions are predicted for the middle of the substep, at the instant `time`. By default there are no forces.
        """
        return state, {}

    def listen(self, setpoints: Mapping[str, Setpoint]) -> Any:
        """Return the state on the controller when the axes start at these setpoints; by default an empty state."""
        return Nothing()

    def correct(
        self, state: Any, setpoints: Mapping[str, Setpoint], positions: Mapping[str, Number]
    ) -> tuple[Any, Mapping[str, Number]]:
        """Run one sample of the controller: return the new state and the corrections, from the measured positions (m).

        Each correction, in m/s, is added to the velocity that the law of that axis commands. By default there are none.
        """
        return state, {}

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rules of the coupling for substeps of h seconds; by default none."""
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
    """A milling tool and the cutting force on it; its methods are traced so that loads and couplings can use them."""

    teeth: int = choice("cutting edges, equally spaced", least=1, most=100)
    slices: int = choice("pieces of an edge, each in contact or not", default=5, least=1, most=200)

    @abstractmethod
    def edge(self) -> Edge:
        """Return the edges of the tool, for use where the chip follows from the motion of the tool."""

    @abstractmethod
    def forces(self, angle: Number, chip_load: Number) -> tuple[Number, Number, Number]:
        """Return the force in N on the tool along feed, normal (spindle axis x feed) and spindle axis.

        `angle` is the rotation of the spindle in rad since the tip of the first tooth entered the chip of a slot.
        `chip_load` is the feed per tooth in m.
        """

    @abstractmethod
    def torque(self, angle: Number, chip_load: Number) -> Number:
        """Return the spindle torque in N m, for an angle and a chip load as in `forces`."""
