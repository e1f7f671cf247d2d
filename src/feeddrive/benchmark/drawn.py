"""The plants on which laws are judged: drawn from the box, with more dead time and with a mode that no law is told."""

import math
from dataclasses import replace

import numpy as np

from feeddrive.benchmark.mode import UnmodelledMode
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.with_mode import WithMode
from feeddrive.evaluation.competitor import Place
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box
from feeddrive.loop.loop import Loop


def drawn_places(
    places: tuple[Place, ...], loop: Loop, box: Box | None, late: int, mode: UnmodelledMode | None, seed: int
) -> tuple[Place, ...]:
    """Return one drawn machine at all positions of a plant: one place of the box and one mode hold at all of them."""
    random = np.random.default_rng(seed)
    size = 0 if box is None else len(box.dimensions(places[0].axis))
    where = random.uniform(-1.0, 1.0, size)
    # drawn in any case, so that a version without one of these has the same plants otherwise
    numbers = random.uniform(-1.0, 1.0, 3)
    side = float(random.choice((-1.0, 1.0)))

    def changed(axis: Axis) -> Axis:
        plant = axis.plant if box is None else box.plant_of(axis, tuple(where.tolist()))
        if mode is not None:
            plant = WithMode(plant=plant, mode=added(mode, axis, float(loop.sample_time), numbers, side))
        return replace(loop, axis=replace(axis, plant=plant)).later(late).axis

    return tuple(Place(place.name, changed(place.axis), changed(place.model)) for place in places)


def added(mode: UnmodelledMode, axis: Axis, T: float, numbers: np.ndarray, side: float) -> Mode:
    """Return the mode of one machine. `numbers`: its frequency, mass and damping in their ranges, from -1 to 1.

    A single encoder may lie on the other side of the mode's node than the drive (`side`).  With two encoders the shape
    is the same at both, since their difference is the deflection of the spring between them.
    """
    usual = 1.0 / (2.0 * math.pi * (float(axis.actuator.delay()) + 0.5 * T))
    mechanics = axis.mechanics()
    squares = np.linalg.eigvals(np.linalg.solve(np.array(mechanics.mass, float), np.array(mechanics.stiffness, float)))
    highest = math.sqrt(max(float(np.max(squares.real)), 0.0)) / (2.0 * math.pi)
    detuned, share, damping = (
        math.exp(0.5 * (math.log(least) + math.log(most)) + 0.5 * u * (math.log(most) - math.log(least)))
        for u, (least, most) in zip(numbers.tolist(), mode.ranges, strict=True)
    )
    frequency = detuned * max(usual, float(mode.above) * float(mode.detune) * highest)
    load = side if axis.one_encoder() else 1.0
    return Mode(
        frequency=frequency,
        damping_ratio=damping,
        mass=float(axis.plant.rigid_mass()) / share,
        motor=1.0,
        load=load,
    )
