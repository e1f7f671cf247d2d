"""A rigid axis with structural modes in parallel."""

from feeddrive.blocks.families import Mechanics, Plant
from feeddrive.blocks.plant.mode import Mode
from feeddrive.language import matrix
from feeddrive.language.block import Number, parameter, part


class Modal(Plant):
    """A rigid mass and any number of modes in parallel: the same forces excite all of them, and their motions add up.

        mass q'' + viscous q' = f_motor + f_load
        x_motor = q + Σ motorᵢ ηᵢ,    x_load = q + Σ loadᵢ ηᵢ,    with ηᵢ of `Mode`

    A measured frequency response is fitted in this form:
    x/f = 1/(mass s² + viscous s) + Σ shapesᵢ / massᵢ (s² + 2ζᵢωᵢs + ωᵢ²).
    Do not use it for dry friction on both bodies with few modes: the two friction contacts are then strongly coupled,
    and the fixed number of Gauss-Seidel sweeps over them does not converge; use a chain of masses.
    """

    mass: Number = parameter("kg", "all that moves when the axis moves as one", above=0)
    viscous: Number = parameter("N s/m", "viscous friction of the rigid motion", least=0, default=0)
    modes: tuple[Mode, ...] = part("structural modes in parallel", default=())

    def mechanics(self) -> Mechanics:
        """Return the diagonal matrices; the rigid coordinate is last, as exact standstill requires."""
        n = len(self.modes) + 1
        mass, damping, stiffness = (matrix.zeros(n, n) for _ in range(3))
        for i, mode in enumerate(self.modes):
            mass[i][i], damping[i][i], stiffness[i][i] = mode.mass, mode.damping(), mode.stiffness()
        mass[-1][-1], damping[-1][-1] = self.mass, self.viscous
        motor = (*(mode.motor for mode in self.modes), 1.0)
        load = (*(mode.load for mode in self.modes), 1.0)
        return Mechanics(
            mass=tuple(map(tuple, mass)),
            damping=tuple(map(tuple, damping)),
            stiffness=tuple(map(tuple, stiffness)),
            shape=(motor, load),
            load=1,
            rigid=(*([0.0] * len(self.modes)), 1.0),
        )
