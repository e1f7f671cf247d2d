"""The families of blocks that act on several axes of a machine: couplings between them, and milling tools."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

from feeddrive.blocks.families import Nothing
from feeddrive.blocks.signals import Motion, Setpoint
from feeddrive.language.block import Block, Number, Rule, choice


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
    """A coupling between the axes of a machine: shared structure modes, forces at common substeps, or a contour
    controller between the controllers of the axes.

    A coupling implements `modes`, `springs`, or `step` with `start` and `prepare`, or several of them; with `controls`
    it implements `listen` and `correct`, which run on the controller once a sample.
    """

    controls: ClassVar[bool] = False

    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes on which it acts."""

    def modes(self) -> tuple[SharedMode, ...]:
        """Return the modes that move with these axes in one exact hold (empty hook)."""
        return ()

    def springs(self) -> tuple[SharedSpring, ...]:
        """Return the springs between tables, which then move in one exact hold (empty hook)."""
        return ()

    def follows(self) -> dict[str, str]:
        """Return, by follower, the axis whose words of a part program move it, too (empty hook)."""
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
    """The edges of a tool, which are helical and alike on all its teeth."""

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
    """A milling tool: the force of the workpiece on it.  Traced, so that both loads and couplings can use it."""

    teeth: int = choice("cutting edges, equally spaced", least=1, most=100)
    slices: int = choice("pieces of an edge, each in contact or not", default=5, least=1, most=200)

    @abstractmethod
    def edge(self) -> Edge:
        """Return the edges of the tool, for a chip that follows from its motion."""

    @abstractmethod
    def forces(self, angle: Number, chip_load: Number) -> tuple[Number, Number, Number]:
        """Return the force in N on the tool along the feed, along the normal (spindle axis x feed) and along the
        spindle axis.

        `angle` is the rotation of the spindle in rad since the tip of the first tooth entered the chip of a slot.
        `chip_load` is the feed per tooth in m.
        """

    @abstractmethod
    def torque(self, angle: Number, chip_load: Number) -> Number:
        """Return the spindle torque at the same angle and chip load, N m."""
