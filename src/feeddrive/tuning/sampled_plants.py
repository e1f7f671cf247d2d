"""Sampled models of all plants of a box, from matrices that are affine in its parameters.

Linearizing the traced step of an axis takes ten times as long, and an examination of a box needs a thousand plants.
The models here are compared with linearized ones when a box is set up, and not used where they differ.
"""

from dataclasses import replace

import numpy as np

from feeddrive.loop.axis import require_force
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

INPUTS, OUTPUTS = ("cut", "load_force"), ("reading_motor", "reading_load", "position_load")
_SAME = 1e-6  # largest difference from a linearized model, of a response
_CHECKED = 2  # plants drawn from the box that are compared, beside the model


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
        self.count = len(box.dimensions(axis))
        self._middle = self._matrices(box, np.zeros(self.count))
        self._changes = [self._matrices(box, unit) - self._middle for unit in np.eye(self.count)]
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
        one = axis.one_encoder()
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

    def _matrices(self, box: Box, place: np.ndarray) -> np.ndarray:
        """Return M, C and K at a place of the box, shape (3, n, n)."""
        mechanics = replace(self.loop.axis, plant=box.plant_of(self.loop.axis, tuple(place.tolist()))).mechanics()
        return np.array([mechanics.mass, mechanics.damping, mechanics.stiffness], float)

    def agree(self, box: Box, velocity: float) -> bool:
        """Return True if these models are those of the linearized axis, at the model and at plants of the box."""
        f = 0.5 / self.T * np.geomspace(1e-5, 0.98, 24)
        corners = [Corner((0.0,) * self.count, 0), *box.drawn(self.loop.axis, _CHECKED, 5)]
        for corner in corners:
            other = linearize(box.plant(self.loop, corner), list(INPUTS), list(OUTPUTS), velocity=velocity)
            model = self.model(corner)
            for output in OUTPUTS:
                for source in INPUTS:
                    a, b = (system.response(f, output, source).response for system in (model, other))
                    # at an antiresonance both are rounding: against the largest of their neighbors in the response
                    if not np.all(np.abs(a - b) <= _SAME * np.abs(b) + 1e-12 * np.max(np.abs(b))):
                        return False
        return True

    def model(self, corner: Corner) -> StateSpace:
        """Return the sampled model of a plant from command and table force to both readings and the table."""
        from scipy.linalg import expm

        moved = self._middle.copy()
        for u, change in zip(corner.place, self._changes, strict=True):
            moved += u * change
        S = self._basis
        n = S.shape[0]
        M, C, K = (S.T @ part @ S for part in moved)
        if self._free:
            K[:, self._first] = K[self._first] = 0.0
        size = 2 * n + (self._lag is not None)
        F = np.zeros((size + 2, size + 2))  # states, the command and the force on the table, both held
        F[:n, n : 2 * n] = np.eye(n)
        acts = np.linalg.solve(M, np.column_stack([K, C, S.T @ self._drive, S.T @ self._load]))
        F[n : 2 * n, :n], F[n : 2 * n, n : 2 * n] = -acts[:, :n], -acts[:, n : 2 * n]
        F[n : 2 * n, 2 * n], F[n : 2 * n, size + 1] = acts[:, 2 * n], acts[:, 2 * n + 1]
        if self._lag is not None:
            F[2 * n, 2 * n], F[2 * n, size] = -self._lag, self._lag
        whole = expm(F * self.T)
        A, pushed = whole[:size, :size], whole[:size, size + 1]
        new, old = whole[:size, size], np.zeros(size)
        if self._part:
            # before the handover the command of the sample before acts
            after = expm(F * (self.T * (1.0 - self._part)))
            new, old = after[:size, size], whole[:size, size] - after[:size, size]
        late = self._whole + corner.late
        waiting = late + (self._part > 0.0)
        full = np.zeros((size + waiting, size + waiting))
        full[:size, :size] = A
        B = np.zeros((size + waiting, 2))
        B[:size, 1] = pushed
        for acting, delay in ((new, late), (old, late + 1)):
            if delay == 0:
                B[:size, 0] += acting
            elif delay <= waiting:
                full[:size, size + delay - 1] += acting
        if waiting:
            B[size, 0] = 1.0
            full[size + 1 :, size : size + waiting - 1] = np.eye(waiting - 1)
        outputs = np.zeros((3, size + waiting))
        outputs[:, :n] = self._outputs @ S
        names = (*(f"position.{i}" for i in range(n)), *(f"velocity.{i}" for i in range(n)))
        states = (*names, *(("drive",) if self._lag is not None else ()), *(f"pending.{i}" for i in range(waiting)))
        return StateSpace(full, B, outputs, np.zeros((3, 2)), self.T, states, INPUTS, OUTPUTS)
