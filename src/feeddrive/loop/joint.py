"""The physics of the axes of a machine with what acts between them."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from feeddrive.blocks.machine_families import Coupling
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis, slow_enough
from feeddrive.loop.core import Acting, Core, Push, Shared
from feeddrive.loop.hold import Columns, JointHold, Timing


class Joint:
    """The physics of axes by name with what acts between them: all of a machine but its controls.

    Axes that share structure modes move in one exact hold; all others have their own.  Couplings act at common
    substeps, from the motions of all axes at the same instant.
    """

    class Prepared(NamedTuple):
        """The prepared numbers of the linear cores and the couplings."""

        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """The states of the axes by name, of the modes of each core, and of the couplings."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]

    def __init__(self, axes: Mapping[str, Axis], couplings: tuple[Coupling, ...]) -> None:
        self.axes, self.couplings = dict(axes), couplings
        self.cores = self._cores()
        self._where = {name: place for place, core in enumerate(self.cores) for name in core.axes}

    def _cores(self) -> list[Core]:
        """Return groups of axes that share modes or springs, in the order of the axes."""
        groups: list[tuple[list[str], list[Any], list[Any]]] = [([name], [], []) for name in self.axes]
        for coupling in self.couplings:
            modes, springs = coupling.modes(), coupling.springs()
            if modes or springs:
                joined = [group for group in groups if set(group[0]) & set(coupling.axes())]
                first = joined[0]
                for other in joined[1:]:
                    for mine, theirs in zip(first, other, strict=True):
                        mine.extend(theirs)
                    groups.remove(other)
                first[1].extend(modes)
                first[2].extend(springs)
        axes = ({name: axis for name, axis in self.axes.items() if name in names} for names, *_ in groups)
        return [Core(own, modes, springs) for own, (_, modes, springs) in zip(axes, groups, strict=True)]

    def substeps(self) -> int:
        """Return the number of substeps, which is the same for every axis."""
        return self.cores[0].substeps()

    def rules(self, T: Number) -> Iterator[Rule]:
        """Yield the conditions of couplings and shared modes at the substeps."""
        h = T / self.substeps()
        for core in self.cores:
            if core.modes or core.springs:
                yield from slow_enough(
                    core.mechanics(),
                    None,
                    h,
                    f"the {'modes' if core.modes else 'springs'} under {', '.join(core.axes)}",
                )
        for coupling in self.couplings:
            yield from coupling.substep_rules(h)

    def prepare(self, T: Number, timings: Mapping[str, Timing]) -> Prepared:
        """Compute everything that depends on parameters only."""
        h = T / self.substeps()
        holds = tuple(core.prepare(T, timings) for core in self.cores)
        return self.Prepared(holds, tuple(coupling.prepare(h) for coupling in self.couplings))

    def start(self, prepared: Prepared, states: Mapping[str, Axis.State], motions: Mapping[str, Motion]) -> State:
        """Return the state of the axes with these motions, and modes at rest."""
        zero = ops.zero(next(iter(motions.values())).position_load)
        shared = tuple(Shared((zero,) * len(core.modes), (zero,) * len(core.modes)) for core in self.cores)
        couplings = zip(self.couplings, prepared.couplings, strict=True)
        begun = tuple(
            coupling.start(coefficients, {name: motions[name] for name in coupling.axes()})
            for coupling, coefficients in couplings
        )
        return self.State(named(states), shared, begun)

    def motion(self, name: str, state: State) -> Motion:
        """Return the true position and velocity of the two bodies of an axis."""
        place = self._where[name]
        return self.cores[place].motion(name, state.axis._asdict(), state.shared[place])

    def columns(self, prepared: Prepared) -> dict[str, Columns]:
        """Return the columns of the forces of each axis."""
        return {
            name: axis
            for core, core_prepared in zip(self.cores, prepared.cores, strict=True)
            for name, axis in zip(core.axes, core_prepared.axes, strict=True)
        }

    def advance(
        self, prepared: Prepared, state: State, at: Mapping[str, Acting], time: Number, T: Number
    ) -> tuple[State, dict[str, Axis.Step], dict[str, Number | None]]:
        """Advance all axes from kT to (k+1)T; return the state, each axis's forces for the record, and the mean force
        on its table.
        """
        moved: dict[str, Axis.State] = state.axis._asdict()
        shared, remembered = list(state.shared), list(state.couplings)
        loads: dict[str, list[Any]] = {name: [] for name in self.axes}
        done: dict[str, Axis.Step] = {}
        substeps = self.substeps()
        h = T / substeps
        for index in range(substeps):
            now = time + index * h
            pushes = self._coupled(prepared, moved, shared, remembered, now + 0.5 * h, h)
            for name, push in pushes.items():
                loads[name].append(push.load)
            for place, core in enumerate(self.cores):
                own = {name: moved[name] for name in core.axes}
                after, shared[place], steps = core.substep(
                    prepared.cores[place], own, shared[place], at, pushes, index, now, h
                )
                moved.update(after)
                done.update(steps)
        mean = {name: _mean(at[name].load, coupled) for name, coupled in loads.items()}
        return self.State(named(moved), tuple(shared), tuple(remembered)), done, mean

    def _coupled(
        self,
        prepared: Prepared,
        states: Mapping[str, Axis.State],
        shared: list[Shared],
        remembered: list[Any],
        middle: Number,
        h: Number,
    ) -> dict[str, Push]:
        """Return the forces of all couplings by axis over a substep with the given middle; their states are updated."""
        motions: dict[str, Motion] = {}
        pushes: dict[str, Push] = {}
        for i, (coupling, coefficients) in enumerate(zip(self.couplings, prepared.couplings, strict=True)):
            for name in coupling.axes():
                if name not in motions:
                    core = self.cores[self._where[name]]
                    motions[name] = core.middle(name, states, shared[self._where[name]], h)
            own = {name: motions[name] for name in coupling.axes()}
            remembered[i], forces = coupling.step(coefficients, remembered[i], own, middle, h)
            for name, pair in forces.items():
                pushes[name] = pushes.get(name, Push()) + pair
        return pushes


def named(values: Mapping[str, Any]) -> Any:
    """Return a named tuple of values by axis."""
    return _type(tuple(values))(*values.values())


@lru_cache(maxsize=256)
def _type(names: tuple[str, ...]) -> Any:
    for name in names:
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise ParameterError(f"'{name}' cannot be the name of an axis: letters, digits and _ , first a letter")
    make: Any = NamedTuple  # names are known at run time only
    kind = make("Axes", [(name, Any) for name in names])
    kind.__reduce__ = lambda axes: (named, (axes._asdict(),))  # pickle cannot find a class that is made at run time
    return kind


def _mean(held: Any, coupled: list[Any]) -> Any:
    """Return the mean force on a table over the sample; None if there is none."""
    total: Any = None
    for force in coupled:
        total = force if total is None else total + force
    mean = None if total is None else total / float(len(coupled)) if len(coupled) > 1 else total
    return mean if held is None else held if mean is None else held + mean
