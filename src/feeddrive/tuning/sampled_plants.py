"""Sampled models of all plants of a box, from the matrices of its plants.

Linearizing the traced step of an axis takes ten times as long, and an examination of a box needs a thousand plants.
The models here are compared with linearized ones when a box is set up, and not used where they differ.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from feeddrive.loop.axis import require_force
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

INPUTS, OUTPUTS = ("cut", "load_force"), ("reading_motor", "reading_load", "position_load")
_SAME = 1e-6  # largest difference from a linearized model, of a response
_CHECKED = 2  # plants drawn from the box that are compared, beside the model
_AFFINE = 1e-12  # of the largest entry of a matrix: difference that is rounding


class SampledPlants:
    """The sampled models of the plants of a box around the axis of a loop.

        x' = F x + G₁ f + G₂ d,    x = (p, p', drive),    q = p₀ e + (0, p₁, p₂, ...)

    The coordinates p are the rigid motion e and the others relative to it, so that a free axis has an integrator of
    exactly 1.  The command acts after whole samples and a part of one; f is held, and so is the force d on the table.
    """

    def __init__(self, box: Box, loop: Loop) -> None:
        self.loop, self.T = loop, float(loop.sample_time)
        axis = loop.axis
        plain = axis.mechanics()
        self.box, self.count = box, len(box.dimensions(axis))
        some = np.array([corner.place for corner in box.drawn(axis, _CHECKED, 5)]).reshape(_CHECKED, self.count)
        middle, *others = self._matrices(np.concatenate([np.zeros((1, self.count)), np.eye(self.count), some]))
        self._middle, units = middle, np.array(others[: self.count]).reshape(self.count, *middle.shape)
        changes = units - middle
        # masses and springs are affine in the place, and a mode is not: its stiffness is a mass by a squared frequency
        off = np.abs(others[self.count :] - middle - np.einsum("kd,dabc->kabc", some, changes))
        self._changes = changes if np.all(off <= _AFFINE * np.max(np.abs(middle), axis=(1, 2), keepdims=True)) else None
        shape = np.array(plain.shape, float)
        along = np.array([float(share) for share in plain.rigid_motion()])
        first = int(np.flatnonzero(along)[0])
        # columns: the rigid motion in place of one coordinate, and the others as they are
        self._basis = np.eye(along.size)
        self._basis[:, first] = along
        self._free = bool(
            np.all(np.abs(self._middle[2] @ along) <= 1e-12 * np.max(np.abs(self._middle[2]), initial=0.0))
        )
        self._first = first
        one = self.one_encoder = axis.one_encoder()
        motor, load = shape[plain.motor], shape[plain.load]
        only = load if axis.encoder_load is not None else motor
        self._drive, self._load = shape[plain.drive], load
        self._outputs = np.array([only if one else motor, only if one else load, load])
        require_force(axis, "a search over plants of a box")
        bandwidth = axis.actuator.current_loop
        self._lag = None if bandwidth is None else 2.0 * np.pi * float(bandwidth)
        samples = float(axis.actuator.dead_time) / self.T
        self._whole = int(np.floor(samples + 1e-9))
        self._part = max(samples - self._whole, 0.0) if samples - self._whole > 1e-9 else 0.0

    def _matrices(self, places: np.ndarray) -> np.ndarray:
        """Return M, C and K at places of the box, shape (plants, dimensions), as (plants, 3, n, n)."""
        # every parameter is the array of its values at all places
        plant = self.box.plant_of(self.loop.axis, tuple(places.T))
        mechanics = replace(self.loop.axis, plant=plant).mechanics()
        n = len(mechanics.mass)
        matrices = np.empty((len(places), 3, n, n))
        for part, rows in enumerate((mechanics.mass, mechanics.damping, mechanics.stiffness)):
            for a, row in enumerate(rows):
                for b, entry in enumerate(row):
                    matrices[:, part, a, b] = entry
        return matrices

    def agree(self, velocity: float) -> bool:
        """Return True if these models are those of the linearized axis, at the model and at plants of the box."""
        f = 0.5 / self.T * np.geomspace(1e-5, 0.98, 24)
        corners = [Corner((0.0,) * self.count, 0), *self.box.drawn(self.loop.axis, _CHECKED, 5)]
        for corner in corners:
            other = linearize(self.box.plant(self.loop, corner), list(INPUTS), list(OUTPUTS), velocity=velocity)
            model = self.model(corner)
            for output in OUTPUTS:
                for source in INPUTS:
                    a, b = (system.response(f, output, source).response for system in (model, other))
                    # at an antiresonance both are rounding: against the largest of their neighbors in the response
                    if not np.all(np.abs(a - b) <= _SAME * np.abs(b) + 1e-12 * np.max(np.abs(b))):
                        return False
        return True

    def held(self, places: np.ndarray) -> "Held":
        """Return the sampled models of plants at places of the box, shape (plants, dimensions)."""
        from scipy.linalg import expm

        if self._changes is None:
            moved = self._matrices(places)
        else:
            moved = self._middle + np.einsum("kd,dabc->kabc", places, self._changes)
        S, count = self._basis, len(places)
        n = S.shape[0]
        M, C, K = (S.T @ moved[:, part] @ S for part in range(3))
        if self._free:
            K[:, :, self._first] = K[:, self._first] = 0.0
        size = 2 * n + (self._lag is not None)
        F = np.zeros((count, size + 2, size + 2))  # states, the command and the force on the table, both held
        F[:, :n, n : 2 * n] = np.eye(n)
        forces = np.broadcast_to(np.column_stack([S.T @ self._drive, S.T @ self._load]), (count, n, 2))
        acts = np.linalg.solve(M, np.concatenate([K, C, forces], axis=2))
        F[:, n : 2 * n, :n], F[:, n : 2 * n, n : 2 * n] = -acts[:, :, :n], -acts[:, :, n : 2 * n]
        F[:, n : 2 * n, 2 * n], F[:, n : 2 * n, size + 1] = acts[:, :, 2 * n], acts[:, :, 2 * n + 1]
        if self._lag is not None:
            F[:, 2 * n, 2 * n], F[:, 2 * n, size] = -self._lag, self._lag
        whole = expm(F * self.T)
        new, old = whole[:, :size, size], np.zeros((count, size))
        if self._part:
            # before the handover the command of the sample before acts
            after = expm(F * (self.T * (1.0 - self._part)))
            new, old = after[:, :size, size], whole[:, :size, size] - after[:, :size, size]
        outputs = np.zeros((3, size))
        outputs[:, :n] = self._outputs @ S
        return Held(whole[:, :size, :size], new, old, whole[:, :size, size + 1], outputs, self._whole, self.T)

    def model(self, corner: Corner) -> StateSpace:
        """Return the sampled model of a plant from command and table force to both readings and the table."""
        held = self.held(np.array([corner.place]).reshape(1, -1))
        A, B, outputs = held.delayed(corner.late)
        n, waiting = held.A.shape[1] // 2, A.shape[1] - held.A.shape[1]
        names = (*(f"position.{i}" for i in range(n)), *(f"velocity.{i}" for i in range(n)))
        states = (*names, *(("drive",) if self._lag is not None else ()), *(f"pending.{i}" for i in range(waiting)))
        return StateSpace(A[0], B[0], outputs, np.zeros((3, 2)), self.T, states, INPUTS, OUTPUTS)


class Held(NamedTuple):
    """Sampled models of plants: x' = A x + new u(k - whole) + old u(k - whole - 1) + pushed d, readings = outputs x.

    A is of shape (plants, n, n), new, old and pushed of shape (plants, n), outputs of shape (3, n).
    """

    A: np.ndarray
    new: np.ndarray
    old: np.ndarray
    pushed: np.ndarray
    outputs: np.ndarray
    whole: int
    T: float

    def delayed(self, late: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A, B and C of the plants with the delayed commands as states, for so many samples of more dead time.

        A is of shape (plants, m, m), B of shape (plants, m, 2) for command and force on the table, C of shape (3, m).
        """
        count, n = self.A.shape[:2]
        after = self.whole + late
        waiting = after + bool(np.any(self.old))
        A, B = np.zeros((count, n + waiting, n + waiting)), np.zeros((count, n + waiting, 2))
        A[:, :n, :n], B[:, :n, 1] = self.A, self.pushed
        for acting, delay in ((self.new, after), (self.old, after + 1)):
            if delay == 0:
                B[:, :n, 0] += acting
            elif delay <= waiting:
                A[:, :n, n + delay - 1] += acting
        if waiting:
            B[:, n, 0] = 1.0
            A[:, n + 1 :, n : n + waiting - 1] = np.eye(waiting - 1)
        return A, B, np.concatenate([self.outputs, np.zeros((3, waiting))], axis=1)

    def at(self, frequency: np.ndarray, late: np.ndarray) -> np.ndarray:
        """Return the responses of both readings to the command, shape (plants, 2, lines).

            C adj(δ - N) B/det(δ - N),   N = A - 1,   δ = z - 1

        The polynomials are those of Faddeev and LeVerrier: N M(k-1) + c(k) is M(k), and c(k+1) = -tr(N M(k))/(k+1).
        In δ their coefficients keep their digits where all poles of a slow axis lie near z = 1.

        frequency  lines in Hz of each plant, shape (plants, lines)
        late       additional dead time of each plant, whole samples
        """
        count, n = self.A.shape[:2]
        N, C = self.A - np.eye(n), self.outputs[:2]
        z = np.exp(2j * np.pi * self.T * frequency)
        inputs = np.stack([self.new, self.old] if np.any(self.old) else [self.new], axis=2)
        delta, adjugate = z - 1.0, np.broadcast_to(np.eye(n), (count, n, n))
        below = np.ones_like(z)
        above = np.zeros((*frequency.shape[:1], 2, inputs.shape[2], frequency.shape[1]), complex)
        for k in range(1, n + 1):
            above = above * delta[:, None, None] + (C @ adjugate @ inputs)[..., None]
            product = N @ adjugate
            c = -np.trace(product, axis1=1, axis2=2) / k
            below = below * delta + c[:, None]
            adjugate = product + c[:, None, None] * np.eye(n)
        driven = above[:, :, 0] if inputs.shape[2] == 1 else above[:, :, 0] + above[:, :, 1] / z[:, None]
        return driven / below[:, None] * (z ** -(self.whole + late)[:, None])[:, None]
