"""Check laws that a comparison ranks over a box, by other means than those of the tuner.

    python benchmarks/box.py ball_screw --law cascade_ppi --law lqg      # 10,000 draws, 2 s of processor time a law
    OPENBLAS_NUM_THREADS=1 python benchmarks/box.py ball_screw --law cascade_ppi --law pole_placement --cost 3

Every plant is drawn from the box, half of them evenly, half with each parameter at an end with probability 1/2.  Its
mechanics are written here anew, as masses between springs or modes beside a free mass, with the exact hold of current
loop and dead time by `scipy.linalg.expm`; the law is linearized by central differences of its own step on floats.
Neither the traced law nor the linear models of feeddrive are used.  Ms is the peak of |1/(1 + L)|, first on lines that
are dense at the resonances, then refined at the peak of every draw that is near the largest one; stability is that of
the eigenvalues of the whole closed loop.

`--cost N` measures the comparison instead, without and with the box in turn, N times, each in a process of its own.
"""

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, matrix_balance, schur

import feeddrive as fd
from feeddrive.blocks.families import Friction
from feeddrive.blocks.signals import Setpoint
from feeddrive.evaluation import Engine, Folder
from feeddrive.language import tree
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

LINES, BESIDE = 320, np.linspace(-4.0, 4.0, 17)
ZOOMS, POINTS = 4, 9
FORCES = ("cogging", "gravity")
ROOM = 0.1  # of Ms, below the largest peak on the lines: there no peaks are refined but those of a sample
SAMPLED = 50  # every so many draws are refined wherever they are
SLOW = 1e-3  # of the Nyquist frequency: below it every loop here has |1/(1 + L)| < 0.5


@dataclass(frozen=True)
class Bodies:
    """The mechanics M q'' + D q' + K q = drive f of many plants, with n coordinates and the readings shape q."""

    M: np.ndarray  # (draws, n), a diagonal
    D: np.ndarray  # (draws, n, n)
    K: np.ndarray  # (draws, n, n)
    drive: np.ndarray  # (n,)
    motor: np.ndarray  # (n,), shape of the encoder of the motor's side
    load: np.ndarray  # (n,)


def viscous(friction: Friction | None) -> float:
    """Return the viscous part of a friction, N s/m; of one that differs by direction that of the positive one, in which
    the laws are linearized.
    """
    return float(getattr(friction, "viscous", None) or getattr(friction, "viscous_positive", None) or 0.0)


def slope(loop: Loop) -> float:
    """Return the slope dF/dx of the forces of an axis at x = 0, N/m; above 0 they push the axis away from there."""
    total = 0.0
    for force in loop.axis.forces:
        if force.kind not in FORCES:
            raise SystemExit(f"a force '{force.kind}' is not written here")
        if force.kind == "gravity":  # the same at every position
            continue
        cogging: Any = force
        for harmonic in cogging.harmonics:
            rate = 2.0 * np.pi * harmonic.order / float(cogging.period)
            total += float(cogging.force) * float(harmonic.share) * rate * np.cos(float(harmonic.phase))
    return total


def chain(mass: np.ndarray, springs: np.ndarray, damping: Sequence[float], viscous: Sequence[float]) -> Bodies:
    """Return masses (draws, n) between springs (draws, n - 1) with dampers, from the motor to the load.

    The encoder of the motor's side is at its mass, and of three masses at the second one, the screw.
    """
    draws, n = mass.shape
    between, dampers, unit = np.zeros((draws, n, n)), np.tile(np.diag(viscous), (draws, 1, 1)), np.eye(n)
    for i in range(n - 1):
        pair = np.outer(unit[i] - unit[i + 1], unit[i] - unit[i + 1])
        between, dampers = between + springs[:, i, None, None] * pair, dampers + damping[i] * pair
    return Bodies(mass, dampers, between, unit[0], unit[1 if n == 3 else 0], unit[-1])


def modal(plant: Any, mass: np.ndarray, stiffer: np.ndarray, friction: Sequence[float]) -> Bodies:
    """Return a free mass, first, beside modes: masses (draws, n), factors of the squared frequencies (draws, n - 1).

    The damping ratios stay, so that a mode's damper follows its mass and frequency.
    """
    modes, (draws, n) = plant.modes, mass.shape
    springs, dampers = np.zeros((draws, n, n)), np.zeros((draws, n, n))
    dampers[:, 0, 0] = float(plant.viscous)
    for i, mode in enumerate(modes, 1):
        rate = 2.0 * np.pi * float(mode.frequency) * np.sqrt(stiffer[:, i - 1])
        springs[:, i, i] = mass[:, i] * rate**2
        dampers[:, i, i] = 2.0 * float(mode.damping_ratio) * mass[:, i] * rate
    motor, load = (np.array([1.0, *(float(getattr(mode, end)) for mode in modes)]) for end in ("motor", "load"))
    dampers += friction[0] * np.outer(motor, motor) + friction[1] * np.outer(load, load)
    return Bodies(mass, dampers, springs, motor, motor, load)


class Spread(NamedTuple):
    """The parameters of a plant that spread: its masses, then its springs or the squared frequencies of its modes."""

    masses: list[float]
    springs: list[float]
    dampers: list[float]
    viscous: list[float]


def spread(loop: Loop) -> Spread:
    """Return the parameters of the plant of a loop."""
    plant, kind = loop.axis.plant, loop.axis.plant.kind
    p: Any = plant
    if kind == "three_mass_chain":
        masses, springs = [p.mass_motor, p.mass_screw, p.mass_load], [p.coupling_stiffness, p.stiffness]
        return Spread(masses, springs, [p.coupling_damping, p.damping],
                      [p.viscous_motor, p.viscous_screw, p.viscous_load])  # fmt: skip
    if kind == "two_mass" and p.coupling_mass is None:
        return Spread([p.mass_motor, p.mass_load], [p.stiffness], [p.damping], [p.viscous_motor, p.viscous_load])
    if kind == "rigid":
        return Spread([p.mass], [], [], [p.viscous])
    if kind == "modal":
        return Spread([p.mass, *(mode.mass for mode in p.modes)], [1.0] * len(p.modes), [], [])
    raise SystemExit(f"a plant '{kind}' is not written here")


def drawn(loop: Loop, box: Box, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places of a box, -1 to 1 for each parameter, (draws, parameters), and additional samples of dead time."""
    random, sizes = np.random.default_rng(seed), spread(loop)
    n = len(sizes.masses) + len(sizes.springs)
    place = random.uniform(-1.0, 1.0, (draws, n))
    at_end = random.random((draws, n)) < 0.5
    at_end[: draws // 2] = False
    return np.where(at_end, np.sign(place), place), random.integers(0, box.dead_time + 1, draws)


def bodies(loop: Loop, box: Box, place: np.ndarray) -> Bodies:
    """Return the plants at places of a box."""
    sizes = spread(loop)
    friction = [viscous(block) for block in (loop.axis.friction_motor, loop.axis.friction_load)]
    count = len(sizes.masses)
    masses = np.array(sizes.masses) * (1.0 + box.mass * place[:, :count])
    springs = np.array(sizes.springs) * (1.0 + box.stiffness * place[:, count:])
    if loop.axis.plant.kind == "modal":
        made = modal(loop.axis.plant, masses, springs, friction)
    else:
        b = list(sizes.viscous)
        b[1 if count == 3 else 0] += friction[0]  # of a three-mass chain the encoder and friction are at the screw
        b[-1] += friction[1]
        made = chain(masses, springs, sizes.dampers, b)
    cogging = slope(loop) * np.outer(made.motor, made.motor)
    return replace(made, K=made.K - cogging)


@dataclass(frozen=True)
class Held:
    """Plants held by the drive: x(k+1) = A x + B0 u(k - m) + B1 u(k - m - 1), readings C x; m by plant."""

    A: np.ndarray
    B0: np.ndarray
    B1: np.ndarray
    C: np.ndarray
    late: np.ndarray


def held(bodies: Bodies, late: np.ndarray, loop: Loop) -> Held:
    """Return the exact sampled models of plants under a zero-order hold, with current loop and dead time."""
    draws, n = bodies.M.shape
    T, actuator = float(loop.sample_time), loop.axis.actuator
    bandwidth = actuator.current_loop
    lag = bandwidth is not None
    size = 2 * n + lag
    F = np.zeros((draws, size + 1, size + 1))  # states and the held command
    F[:, :n, n : 2 * n] = np.eye(n)
    F[:, n : 2 * n, :n], F[:, n : 2 * n, n : 2 * n] = -bodies.K / bodies.M[:, :, None], -bodies.D / bodies.M[:, :, None]
    F[:, n : 2 * n, 2 * n] = bodies.drive / bodies.M  # the force, or the command itself
    if bandwidth is not None:
        pole = 2.0 * np.pi * float(bandwidth)
        F[:, 2 * n, 2 * n], F[:, 2 * n, size] = -pole, pole
    whole = float(actuator.dead_time) / T
    m, part = int(np.floor(whole + 1e-9)), (whole - np.floor(whole + 1e-9)) * T
    first, second = expm(F * part), expm(F * (T - part))
    A = second[:, :size, :size] @ first[:, :size, :size]
    B1 = (second[:, :size, :size] @ first[:, :size, size:])[:, :, 0]
    C = np.zeros((2, size))
    one = (loop.axis.encoder_motor is None) != (loop.axis.encoder_load is None)
    C[0, :n] = bodies.load if one and loop.axis.encoder_motor is None else bodies.motor
    C[1, :n] = bodies.motor if one and loop.axis.encoder_load is None else bodies.load
    return Held(A, second[:, :size, size], B1 if part > 1e-12 else 0.0 * B1, C, m + late)


class Modes:
    """The responses of held plants as sums over their modes, C v w B/(z - λ), checked against solved systems."""

    def __init__(self, plants: Held, T: float) -> None:
        self.plants, self.T = plants, T
        self.poles, V = np.linalg.eig(plants.A)
        right = np.stack([plants.B0, plants.B1], axis=2).astype(complex)
        self.outputs, self.inputs = plants.C @ V, np.linalg.solve(V, right)
        every = slice(0, None, max(1, self.poles.shape[0] // 50))
        f = np.array([1e-3, 0.05, 0.3])[None] / T
        z, n = np.exp(2j * np.pi * f[0] * T), plants.A.shape[1]
        for A, B0, B1, late, values in zip(
            *(part[every] for part in (plants.A, plants.B0, plants.B1, plants.late, self.at(np.tile(f, (len(V), 1))))),
            strict=True,
        ):
            solved = [plants.C @ np.linalg.solve(x * np.eye(n) - A, B0 + B1 / x) * x**-late for x in z]
            # against the larger of both readings: far above all modes the table hardly moves
            size = np.max(np.abs(solved), axis=1)
            assert np.all(np.abs(values - np.array(solved).T) < 1e-6 * size)

    def at(self, f: np.ndarray, draws: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the responses of both readings, (draws, 2, lines), on lines f, (draws, lines), of some draws."""
        z = np.exp(2j * np.pi * f * self.T)
        poles, inputs, outputs = self.poles[draws], self.inputs[draws], self.outputs[draws]
        out = np.zeros((f.shape[0], 2, f.shape[1]), complex)
        for i in range(poles.shape[1]):
            # the command acts at once, and the rest of it a sample later
            driven = inputs[:, i, 0, None] + inputs[:, i, 1, None] / z
            out += outputs[:, :, i, None] * (driven / (z - poles[:, i, None]))[:, None]
        return out * (z ** -self.plants.late[draws, None])[:, None]


def linear_law(control: Control, T: float, velocity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, c, d of a control from its readings to its force, by central differences of its step on floats."""
    control = replace(control, guard=None, force_limit=None)
    control = replace(control, law=control.law.settled())
    prepared = control.prepare(T)
    setpoint = Setpoint(0.0, velocity, 0.0, 0.0, 0.0)
    start = control.start(prepared, setpoint, -velocity * T, -velocity * T, velocity)
    names = [name for name, _ in tree.leaves(start)]
    base = np.array([float(value) for _, value in tree.leaves(start)])

    def stepped(x: np.ndarray, motor: float, load: float) -> np.ndarray:
        state = tree.rebuild(start, iter(x.tolist()))
        after, command = control.step(prepared, state, setpoint, motor, load, 1.0, T)
        return np.array([*(float(value) for _, value in tree.leaves(after)), float(command.applied)])

    n = len(names)
    columns = list[np.ndarray]()
    for i in range(n + 2):
        step = max(1e-3 * abs(base[i]), 1e-6) if i < n else 1e-7
        sides = list[np.ndarray]()
        for sign in (1.0, -1.0):
            x, readings = base.copy(), [0.0, 0.0]
            if i < n:
                x[i] += sign * step
            else:
                readings[i - n] = sign * step
            sides.append(stepped(x, *readings))
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    J = np.array(columns).T
    return J[:n, :n], J[:n, n:], J[n, :n], J[n, n:]


def law_response(law: Sequence[np.ndarray], f: np.ndarray, T: float) -> np.ndarray:
    """Return the response of a law to both readings, (draws, 2, lines): d + c (z - A)⁻¹ B by the Schur form of A.

    A million lines at once; some of them are compared with solved systems.
    """
    A, B, c, d = law
    z = np.exp(2j * np.pi * f.ravel() * T)
    # balanced: next to forces in N the positions in m would lose their digits
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    form, vectors = schur(balanced.astype(complex), output="complex")[:2]
    right, left, out = vectors.conj().T @ (B / scale[:, None]), (c * scale) @ vectors, np.empty((2, z.size), complex)
    for i in range(2):
        x = np.repeat(right[:, i, None], z.size, axis=1)
        for k in range(len(x) - 1, -1, -1):
            x[k] /= z - form[k, k]
            x[:k] += form[:k, k, None] * x[k]
        out[i] = left @ x + d[i]
    # lines far below every crossover are not compared (`Draws.peaks` sees that they are): six integrators in a row, as
    # of GPI with five Taylor states, leave few digits there.  Where the law has k times its usual gain, so has the
    # loop, and |1/(1 + L)| is k times smaller and bears k times the error
    above = np.flatnonzero(f.ravel() > SLOW / (2.0 * T))
    lines = above[:: max(1, above.size // 50)]
    unit, rows = np.eye(len(A)), (B / scale[:, None]).astype(complex)
    solved = np.array([(c * scale) @ np.linalg.solve(z[k] * unit - balanced, rows) + d for k in lines])
    if lines.size:
        gain = np.max(np.abs(solved), axis=1)
        error = np.max(np.abs(out[:, lines].T - solved), axis=1) / gain
        assert np.all(error < 1e-6 * np.maximum(1.0, gain / np.median(gain)))
    return out.reshape(2, *f.shape).transpose(1, 0, 2)


def constants(law: Sequence[np.ndarray]) -> np.ndarray:
    """Return a mask of the numbers that a law stored at its start and never writes again, such as an encoder's offset.

    Such a state keeps its value whatever the readings and the other states are, so its row of A is a row of the
    identity and its row of B is 0.  The matrix of the whole loop is then block triangular: it has the eigenvalue 1 of
    the constant, which acts on the rest as a constant input does, and the eigenvalues of the rest.  1e-6: the rows are
    differences of floats.
    """
    A, B, _, _ = law
    apart = np.max(np.abs(np.hstack([A - np.eye(A.shape[0]), B])), axis=1, initial=0.0)
    return apart < 1e-6


def closed_eigenvalues(plants: Held, law: Sequence[np.ndarray]) -> np.ndarray:
    """Return the largest |z| of the closed loop of every plant, with all states of the law but its constants.

    States that never reach the force count as well: one that grows would overflow.
    """
    A, B, c, d = law
    live = ~constants(law)
    inner, entered, c = A[np.ix_(live, live)], B[live], c[live]
    n, q, deep = plants.A.shape[1], inner.shape[0], int(np.max(plants.late)) + 2
    count, size = plants.A.shape[0], n + q + deep
    force = np.concatenate([d @ plants.C, c, np.zeros(deep)])  # of this sample; before: the cells of the memory
    W = np.zeros((count, size, size))
    W[:, :n, :n] = plants.A
    for m in np.unique(plants.late):
        # a command that acts in the sample in which it is computed is the force itself
        late, (here, before) = plants.late == m, (force if k == 0 else np.eye(size)[n + q + k - 1] for k in (m, m + 1))
        W[late, :n] += plants.B0[late][:, :, None] * here + plants.B1[late][:, :, None] * before
    W[:, n : n + q, :n], W[:, n : n + q, n : n + q] = entered @ plants.C, inner
    W[:, n + q] = force
    W[:, n + q + 1 :, n + q : -1] = np.eye(deep - 1)
    return np.max(np.abs(np.linalg.eigvals(W)), axis=1)


@dataclass(frozen=True)
class Drawn:
    """The draws of a law: the largest Ms, refined at its peak, its draw, and the largest |z| of a closed loop."""

    peak: float
    draw: int
    growth: float


class Draws:
    """Plants that are drawn once for all laws: lines that all share, and lines of each that are dense at its modes."""

    def __init__(
        self,
        loop: Loop,
        box: Box,
        count: int = 10_000,
        seed: int = 1,
        lines: int = LINES,
        *,
        at: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        """Draw so many plants, or take those at given places, as `drawn` returns them."""
        self.loop, self.T = loop, float(loop.sample_time)
        self.place, self.late = drawn(loop, box, count, seed) if at is None else at
        count = len(self.place)
        self.plants = held(bodies(loop, box, self.place), self.late, loop)
        self.modes = Modes(self.plants, self.T)
        nyquist = 0.5 / self.T
        self.base = np.geomspace(3e-5 * nyquist, nyquist * (1.0 - 1e-9), lines)
        # of each pair of poles one; sorted, so that the modes of all draws have their columns
        pairs = self.plants.A.shape[1] // 2
        order = np.argsort(-np.angle(self.modes.poles), axis=1)[:, :pairs]
        poles = np.log(np.take_along_axis(self.modes.poles, order, axis=1) + 0j) / self.T
        near = (np.abs(poles.imag)[..., None] + np.abs(poles.real)[..., None] * BESIDE).reshape(count, -1)
        self.near = np.clip(near / (2.0 * np.pi), self.base[0], self.base[-1])
        self.lines = np.concatenate([np.tile(self.base, (count, 1)), self.near], axis=1)
        self.order = np.argsort(self.lines, axis=1)
        self.response = self.modes.at(self.lines)

    def under(self, control: Control, velocity: float = 0.05) -> Drawn:
        """Return the worst of the draws under a control."""
        law = linear_law(control, self.T, velocity)
        peaks = self.peaks(law)
        return Drawn(float(np.max(peaks)), int(np.argmax(peaks)), float(np.max(closed_eigenvalues(self.plants, law))))

    def peaks(self, law: Sequence[np.ndarray]) -> np.ndarray:
        """Return Ms of every draw under a law, refined at its peak where it is near the largest one."""
        count = self.lines.shape[0]
        shared = np.broadcast_to(law_response(law, self.base[None], self.T), (count, 2, self.base.size))
        own = np.concatenate([shared, law_response(law, self.near, self.T)], axis=2)
        peaks = 1.0 / np.abs(1.0 - np.einsum("drl,drl->dl", own, self.response))
        assert np.max(peaks[self.lines <= SLOW / (2.0 * self.T)], initial=0.0) < 0.5
        lines, peaks = (np.take_along_axis(part, self.order, axis=1) for part in (self.lines, peaks))
        at, every = np.argmax(peaks, axis=1), np.arange(count)
        low, high = lines[every, np.maximum(at - 1, 0)], lines[every, np.minimum(at + 1, lines.shape[1] - 1)]
        coarse = np.max(peaks, axis=1)
        near = coarse > (1.0 - ROOM) * np.max(coarse)
        near[::SAMPLED] = True
        best = coarse.copy()
        best[near] = self._refined(law, low[near], high[near], every[near], coarse[near])
        # the lines miss so little of a peak that none that was left as it is can be the largest: else all are refined
        if np.max(best[near] / coarse[near]) > 1.0 + 0.5 * ROOM:
            best = self._refined(law, low, high, every, coarse)
        return best

    def _refined(
        self, law: Sequence[np.ndarray], low: np.ndarray, high: np.ndarray, draws: np.ndarray, best: np.ndarray
    ) -> np.ndarray:
        """Return the peaks of some draws between the lines `low` and `high` beside their largest value, `best`."""
        every = np.arange(draws.size)
        for _ in range(ZOOMS):
            f = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, POINTS)
            fine = 1.0 / np.abs(1.0 - np.einsum("drl,drl->dl", law_response(law, f, self.T), self.modes.at(f, draws)))
            k = np.argmax(fine, axis=1)
            best = np.maximum(best, np.max(fine, axis=1))
            low, high = f[every, np.maximum(k - 1, 0)], f[every, np.minimum(k + 1, POINTS - 1)]
        return best


def seconds(machine: str, axis: str, laws: Sequence[str], box: Box | None) -> float:
    """Return the processor time of a comparison, s, after one of another machine has loaded and compiled all it can."""
    fd.comparison.compare_laws(fd.read_machine("linear_motor"), "x", laws=["P-PI"], starts=1)
    read, begun = fd.read_machine(machine), time.process_time()
    fd.comparison.compare_laws(read, axis, laws=laws, box=box)
    return time.process_time() - begun


def cost(machine: str, axis: str, laws: Sequence[str], box: Box, turns: int) -> None:
    """Print what a comparison costs without and with a box, each in a process of its own."""
    found = list[tuple[float, float]]()
    for _ in range(turns):
        pair = list[float]()
        for some in (None, box):
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                pair.append(process.submit(seconds, machine, axis, laws, some).result())
        found.append((pair[0], pair[1]))
        print(f"no box {pair[0]:.2f} s, {box} {pair[1]:.2f} s, {pair[1] / pair[0]:.2f} times", flush=True)
    plain, over = (min(part) for part in zip(*found, strict=True))
    print(f"least of {turns}: {plain:.2f} s, {over:.2f} s, {over / plain:.2f} times")


def main() -> None:
    """Compare laws over a box, and check each that is ranked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine")
    parser.add_argument("--axis")
    parser.add_argument("--box", default="standard")
    parser.add_argument("--law", action="append")
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="finished laws, as docs/draw_robust.py keeps them in KEPT/box")
    parser.add_argument("--cost", type=int, help="measure the processor time of the comparison, so many times")
    asked = parser.parse_args()
    machine, box = fd.read_machine(asked.machine), Box.parse(asked.box)
    assert box is not None
    axis = asked.axis or next(iter(machine.loops))
    if asked.cost:
        cost(asked.machine, axis, asked.law, box, asked.cost)
        return
    begun = time.process_time()
    engine = None if asked.kept is None else Engine.of(None, store=Folder(asked.kept))
    comparison = fd.comparison.compare_laws(machine, axis, laws=asked.law, box=box, engine=engine)
    print(comparison)
    print(f"compared in {time.process_time() - begun:.0f} s; {box}; {asked.draws} draws, seed {asked.seed}\n")
    draws = Draws(machine.loops[axis], box, asked.draws, asked.seed)
    print(f"| {'law':32} | Ms at the model | at worst, by the tuner | of {asked.draws} draws | largest abs(z) | |")
    print("|---|---|---|---|---|---|")
    for law in comparison.competitors:
        found = draws.under(law.loop.control)
        row = (law.figures.get("sensitivity_peak"), law.worst.get("sensitivity_peak"), found.peak)
        # poles of slow observers differ from 1 by some 1e-5
        cells = [*(f"{value:.4f}" if value is not None else "-" for value in row), f"{found.growth:.6f}"]
        print(f"| {law.name:32} | {' | '.join(cells)} | {law.kind or 'ranked'} |", flush=True)


if __name__ == "__main__":
    main()
