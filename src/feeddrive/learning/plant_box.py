"""The machines on which a correction of a part is judged: the nominal one, and others within its tolerances."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import number
from feeddrive.loop.box import tolerances
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine

NOMINAL = "nominal"
"""The name of the machine without deviations."""
EXAMPLE = "mass=0.15,friction=0.3,stiffness=0.2,dead_time=1sample,cut=0.1"
"""The standard box as a text."""
_MASSES = ("mass_load", "mass", "carriage_mass")
_EDGE = ("N/m2", "N/m")  # units of the cutting coefficients
_READ = 0.5  # of a count: noise of an encoder without noise of its own
_MIXED = 2.0 / 3.0  # of the tolerance of the mass, beside a softer screw and a later drive


@dataclass(frozen=True)
class PlantBox:
    """The tolerances of a machine; all axes deviate alike.

    mass       of the load, share
    friction   dry friction of motor and load, share
    stiffness  towards a softer one, share
    dead_time  towards a longer one, samples
    cut        of the cutting coefficients, share; it deviates with the friction
    """

    mass: float = 0.15
    friction: float = 0.3
    stiffness: float = 0.2
    dead_time: int = 1
    cut: float = 0.1

    def __post_init__(self) -> None:
        for name in ("mass", "friction", "stiffness", "cut"):
            value = getattr(self, name)
            if not 0.0 <= value < 1.0:
                raise ParameterError(
                    f"box.{name} = {number(value, 6)} must be >= 0 and < 1: it is a share, such as 0.15 or 15%"
                )
        if self.dead_time < 0:
            raise ParameterError(f"box.dead_time = {self.dead_time} must be >= 0 samples: a drive is not early")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the box of a text such as `mass=0.2,dead_time=1sample`, `standard` or `none`; see `tolerances`.

        Raises ParameterError for any other text.
        """
        if text.strip() == "standard":
            return cls()
        names = tuple(each.name for each in dataclasses.fields(cls))
        values = dict.fromkeys(names, 0.0) if text.strip() == "none" else tolerances(text, names, EXAMPLE)
        return cls(values["mass"], values["friction"], values["stiffness"], int(values["dead_time"]), values["cut"])

    def machines(self, machine: Machine) -> dict[str, Machine]:
        """Return the nominal machine and six others by name: the corners of mass and friction, a softer and later one.

        Corners of mass and friction come in all four combinations; the last machine is lighter, has less friction, a
        softer screw and a later drive at once.
        """
        corners = [(m * self.mass, f * self.friction, 0.0, 0) for m, f in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
        soft = (0.0, 0.0, -self.stiffness, self.dead_time)
        mixed = (-_MIXED * self.mass, -self.friction, -self.stiffness, self.dead_time)
        # a tolerance of 0 makes some of them the same machine, which the names tell
        chosen = {_named(*values): values for values in ((0.0, 0.0, 0.0, 0), *corners, soft, mixed)}
        return {name: self.machine(machine, *values) for name, values in chosen.items()}

    def drawn(self, machine: Machine, count: int, seed: int) -> dict[str, Machine]:
        """Return machines drawn uniformly within the box, by name."""
        random = np.random.default_rng(seed)
        machines: dict[str, Machine] = {}
        for _ in range(count):
            mass, friction = random.uniform(-1.0, 1.0, 2) * (self.mass, self.friction)
            softer, late = -random.uniform(0.0, self.stiffness), int(random.integers(0, self.dead_time + 1))
            values = (float(mass), float(friction), float(softer), late)
            machines[_named(*values)] = self.machine(machine, *values)
        return machines

    def machine(self, machine: Machine, mass: float, friction: float, stiffness: float, dead_time: int) -> Machine:
        """Return a machine with these deviations, as shares and in samples; the cut deviates with the friction."""
        loops = {
            name: changed_loop(loop, 1.0 + mass, 1.0 + friction, 1.0 + stiffness, dead_time)
            for name, loop in machine.loops().items()
        }
        share = 1.0 + (self.cut * friction / self.friction if self.friction > 0.0 else 0.0)
        couplings = tuple(
            dataclasses.replace(coupling, cutter=scaled(coupling.cutter, lambda _, unit: unit in _EDGE, share))
            if isinstance(coupling, MillingCut)
            else coupling
            for coupling in machine.couplings
        )
        return dataclasses.replace(machine.with_loops(loops), couplings=couplings)


def _named(mass: float, friction: float, stiffness: float, dead_time: int) -> str:
    words = [
        f"{word} {'-' if value < 0.0 else '+'}{number(100.0 * abs(value), 3)} %"
        for word, value in (("mass", mass), ("friction", friction), ("stiffness", stiffness))
        if value
    ]
    if dead_time:
        words.append(f"dead time +{dead_time} sample{'s' if dead_time > 1 else ''}")
    return ", ".join(words) or NOMINAL


def changed_loop(loop: Loop, mass: float, friction: float, stiffness: float, dead_time: int) -> Loop:
    """Return the loop with factors on the mass of the load, the dry friction and the stiffness, and a later drive.

    dead_time  additional samples
    """
    axis = loop.axis
    plant = scaled(axis.plant, lambda name, _: name in _MASSES, mass)
    plant = scaled(plant, lambda name, _: name == "stiffness", stiffness)
    # the mode of a modal plant has the frequency of its spring
    plant = scaled(plant, lambda name, _: name.endswith(".frequency"), float(np.sqrt(stiffness)))
    rubs = [
        None if each is None else scaled(each, lambda _, unit: unit == "N", friction)
        for each in (axis.friction_motor, axis.friction_load)
    ]
    changed = dataclasses.replace(axis, plant=plant, friction_motor=rubs[0], friction_load=rubs[1])
    return dataclasses.replace(loop, axis=changed).later(dead_time)


def read_by(loop: Loop) -> Loop:
    """Return the loop with noise on each encoder that has none: half a count, so that no two runs are the same."""

    def noisy(encoder: Any) -> Any:
        if encoder is None or encoder.resolution is None or encoder.noise:
            return encoder
        return dataclasses.replace(encoder, noise=_READ * float(encoder.resolution))

    axis = dataclasses.replace(
        loop.axis, encoder_motor=noisy(loop.axis.encoder_motor), encoder_load=noisy(loop.axis.encoder_load)
    )
    return dataclasses.replace(loop, axis=axis)


def noisy_machines(machines: Mapping[str, Machine]) -> dict[str, Machine]:
    """Return machines whose encoders have noise, by name."""
    return {
        name: machine.with_loops({axis: read_by(loop) for axis, loop in machine.loops().items()})
        for name, machine in machines.items()
    }


def scaled(block: Any, chosen: Callable[[str, str], bool], factor: float) -> Any:
    """Return a block whose leaves are multiplied by a factor where `chosen`, of name and unit, is true."""
    if factor == 1.0:
        return block
    values = [
        factor * value if chosen(name, tree.declaration(block, name).unit) else value
        for name, value in tree.leaves(block)
    ]
    return tree.rebuild(block, iter(values))
