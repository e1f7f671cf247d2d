"""Mass, damping and stiffness matrices of a chain of masses with springs between neighbors."""

from collections.abc import Sequence

from feeddrive.blocks.families import Mechanics
from feeddrive.language import matrix
from feeddrive.language.block import Number


def chain(
    masses: Sequence[Number],
    springs: Sequence[tuple[Number, Number]],
    viscous: Sequence[Number],
    motor: int,
) -> Mechanics:
    """Return the matrices of n masses (kg) in a row; spring i (stiffness N/m, damping N s/m) joins masses i and i+1.

    `viscous` is the friction of each mass against the ground, N s/m.  The drive acts on the first mass.  The motor
    encoder is on the mass with the index `motor`.  The last mass is the load.
    """
    n = len(masses)
    mass, damping, stiffness, shape = (matrix.zeros(n, n) for _ in range(4))
    for i in range(n):
        mass[i][i] = masses[i]
        damping[i][i] = viscous[i]
        shape[i][i] = 1.0
    for i, (k, c) in enumerate(springs):
        for table, value in ((stiffness, k), (damping, c)):
            # a literal 0.0 is replaced, not added to: each term is an operation of the traced step
            table[i][i] = value if matrix.is_zero(table[i][i]) else table[i][i] + value
            table[i + 1][i + 1] = value if matrix.is_zero(table[i + 1][i + 1]) else table[i + 1][i + 1] + value
            table[i][i + 1] = table[i + 1][i] = -value
    M, C, K, S = (tuple(tuple(row) for row in table) for table in (mass, damping, stiffness, shape))
    return Mechanics(mass=M, damping=C, stiffness=K, shape=S, motor=motor, load=n - 1)
