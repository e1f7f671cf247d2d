"""A servo axis that shares no code with feeddrive: logs with a known truth for tests of the identification.

All quantities are SI (m, N, kg, s; on a rotary axis rad, N m, kg m2, s). Every number of `Axes` and of a law may be
one number or an array (N,): N axes of one structure run side by side, so that 400 draws cost little more than one.

**Plant.** One mass, or two:

    m1 x1'' = F + R1 - k (x1 - x2) - d (x1' - x2') - b1 x1'          (motor)
    m2 x2'' = R2 + k (x1 - x2) + d (x1' - x2') - b2 x2' + G - P(x2) + D(t)   (load; with one mass all act on it)
    P(x) = slope x + ripple sin(2 pi x / period + phase);  G gravity;  D(t) pulses nobody logs, force noise

The linear part is stepped exactly (matrix exponential) over a substep h = T / substeps with all other forces held
at their value in its middle. The force F is the command, `dead_time` late (any real number of samples), held over
a sample, within `limit`.

**Friction** R of a body: levels g+-(v) = C+- + B exp(-(v / vs)^2) of the two directions. Without `creep` a time
stepping with stick (Moreau): R is the force that makes the velocity zero at the end of the substep, within
[-g+, g-]. With `creep` a presliding length, LuGre without its viscous term:

    z' = v - s0 |v| z / g,   R = -(s0 z + s1 z'),   s0 = (C+ + C-) / (2 creep),   s1 = creep_damping sqrt(s0 m)

z is stepped exactly for a constant speed. `share_load` of the friction acts on the load.

**Encoders** round to counts: round(x / resolution) resolution, of motor and of load.

**Laws** get set positions and readings, both `delay` samples old; velocities are differences of these over n
samples. The logged force is the command (within the limit) plus `noise_log`; `noise_drive` acts on the plant and is
not logged. Both noises are v(k) = c v(k-1) + sqrt(1 - c^2) w(k) with `colour` c.

Sources: J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; C. Canudas de Wit et
al., IEEE Trans. Automat. Contr. 40 (1995) 419; manual of LinuxCNC, `man pid`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray


@dataclass(frozen=True)
class Axes:
    """N axes of one structure; `mass_load` 0 is one mass."""

    mass: Any = 100.0
    mass_load: Any = 0.0
    stiffness: Any = 0.0
    damping: Any = 0.0
    viscous: Any = 0.0
    viscous_load: Any = 0.0
    coulomb_positive: Any = 0.0
    coulomb_negative: Any = 0.0
    stribeck: Any = 0.0
    stribeck_velocity: Any = 1e-3
    creep: Any = 0.0
    creep_damping: Any = 0.5
    share_load: Any = 0.0
    gravity: Any = 0.0
    offset: Any = 0.0  # added to the logged force: zero point of the drive's current
    slope: Any = 0.0
    ripple: Any = 0.0
    ripple_period: Any = 0.01
    ripple_phase: Any = 0.0
    dead_time: Any = 0.0
    resolution: Any = 1e-7
    resolution_load: Any = 1e-7
    noise_log: Any = 0.0
    noise_drive: Any = 0.0
    colour: Any = 0.0
    limit: Any = math.inf
    rotary: bool = False

    @property
    def two_masses(self) -> bool:
        """True if motor and load are two bodies."""
        return bool(np.any(np.asarray(self.mass_load) > 0))

    @property
    def mass_all(self) -> Any:
        """Motor and load."""
        return self.mass + self.mass_load

    @property
    def resonance(self) -> Any:
        """Undamped resonance of two masses, Hz."""
        return np.sqrt(self.stiffness * (1 / self.mass + 1 / self.mass_load)) / (2 * np.pi)

    @property
    def antiresonance(self) -> Any:
        """Undamped antiresonance at the motor, Hz."""
        return np.sqrt(self.stiffness / self.mass_load) / (2 * np.pi)


# ----------------------------------------------------------------------------------------------------- set motion


def smooth_moves(
    T: float, targets: Sequence[float], speed: float, acceleration: float, jerk: float, dwell: float, lead: float = 0.0
) -> Array:
    """Jerk-limited moves from 0 to each target in turn, `dwell` s of rest after each, `lead` s before.

    A trapezoid of speed, averaged over acceleration / jerk: its acceleration rises linearly.
    """
    pieces, here = [np.full(max(round(lead / T), 1), 0.0)], 0.0
    for target in targets:
        way = target - here
        top = min(speed, math.sqrt(acceleration * abs(way)))
        rise, whole = top / acceleration, abs(way) / top
        smooth = max(round(acceleration / jerk / T), 1)
        t = np.arange(0.0, rise + whole + T, T)
        v = np.clip(np.minimum(t / rise, (rise + whole - t) / rise), 0.0, 1.0)
        v = np.convolve(v, np.full(smooth, 1.0 / smooth))
        x = np.cumsum(v)
        pieces += [here + way * x / x[-1], np.full(round(dwell / T), target)]
        here = target
    return np.concatenate(pieces)


def constant_speeds(T: float, speeds: Sequence[float], travel: float, acceleration: float, dwell: float = 0.1) -> Array:
    """There and back at each speed."""
    pieces = [
        smooth_moves(T, (travel, 0.0), speed, acceleration, acceleration / 0.02, dwell, dwell) for speed in speeds
    ]
    return np.concatenate(pieces)


def circle(T: float, radius: float, feed: float, turns: float = 2.0, run_up: float = 0.2) -> tuple[Array, Array]:
    """Set positions of two axes on a circle that begins and ends at rest at (0, 0)."""
    rate = feed / radius
    time = np.arange(0.0, turns * 2 * np.pi / rate + run_up, T)
    ramp = np.clip(np.minimum(time, time[-1] - time) / run_up, 0.0, 1.0)
    angle = np.cumsum(rate * ramp * ramp * (3 - 2 * ramp)) * T
    return radius * (np.cos(angle) - 1.0), radius * np.sin(angle)


def multisine(T: float, rng: np.random.Generator, first: float, last: float, period: float, periods: int) -> Array:
    """Lines of one amplitude and random phases, RMS 1; the same in each period."""
    rows = round(period / T)
    spectrum = np.zeros(rows // 2 + 1, complex)
    lines = np.arange(math.ceil(first * period), math.floor(last * period) + 1)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    wave = np.fft.irfft(spectrum, rows)
    return np.tile(wave / wave.std(), periods)


def pulses(
    rows: int, T: float, rng: np.random.Generator, count: int, force: float, length: float, shape: str = "half_sine"
) -> Array:
    """Pulses of both signs at drawn instants, `length` s long; EMPS-like with shape `rectangle`."""
    wave = np.zeros(rows)
    long = max(round(length / T), 2)
    for start in rng.integers(round(0.05 * rows), rows - long, count):
        form = np.ones(long) if shape == "rectangle" else np.sin(np.pi * (np.arange(long) + 0.5) / long)
        wave[start : start + long] += rng.choice((-1.0, 1.0)) * force * form
    return wave


# ----------------------------------------------------------------------------------------------------------- laws


class Law:
    """A law steps on (k, set position, its velocity, its acceleration, motor's reading, load's reading)."""

    family = "outside"

    def start(self, count: int, T: float, limit: Any) -> None:
        """Forget the past."""
        self.T, self.limit, self.zero = T, limit, np.zeros(count)
        self.past: list[Array] = []

    def difference(self, reading: Array, samples: int) -> Array:
        """Velocity over n samples (fewer at the start)."""
        self.past = [*self.past[-samples:], reading]
        if len(self.past) == 1:
            return 0.0 * reading
        return (reading - self.past[0]) / ((len(self.past) - 1) * self.T)

    def step(self, k: int, xs: Array, vs: Array, accs: Array, motor: Array, load: Array) -> Array:
        """Return the force asked for."""
        raise NotImplementedError

    def truth(self) -> dict[str, Any]:
        """Gains by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]


@dataclass
class Open(Law):
    """Force given over time, (K,) or (N, K); with a weak spring to the set position so that the axis stays."""

    wave: Any
    spring: Any = 0.0
    damper: Any = 0.0
    family = "open"

    def step(self, k: int, xs: Array, vs: Array, accs: Array, motor: Array, load: Array) -> Array:
        speed = self.difference(motor, 4)
        return np.asarray(self.wave)[..., k] + self.spring * (xs - motor) - self.damper * speed


@dataclass
class Cascade(Law):
    """P-PI (P-P with 1/Tn = 0).

    c = Kv e + ff v_s                    position loop (every `slower` samples; held between)
    r = v_s-model if `model_mass` else c  v_m' = Kp (c - v_m) / model_mass, trapezoid, `model_delay` samples
    u = Kp (c - v + I), I' = (r - v)/Tn  + Mff a_s + friction_ff tanh(v_s / friction_speed), low-pass `tau`
    windup: "back": I' gets (sat(u) - u)/(Kp Tn) more; "stop": I' = 0 while saturated outwards; "none"
    """

    Kv: Any
    Kp: Any
    rate: Any = 0.0  # 1/Tn
    ff: Any = 0.0
    n: int = 1
    windup: str = "none"
    mass_ff: Any = 0.0
    tau: Any = 0.0
    model_mass: Any = 0.0
    model_delay: int = 0
    friction_ff: Any = 0.0
    friction_speed: float = 1e-3
    slower: int = 1
    position_load: bool = False
    velocity_filter: Any = 0.0  # time constant of a low pass of the velocity alone: outside the families
    notch: Any = 0.0  # Hz: outside the families
    dead_band: Any = 0.0  # m of the position error: outside the families

    @property
    def family(self) -> str:  # type: ignore[override]
        """The name of what ran."""
        if np.any(self.velocity_filter) or np.any(self.notch) or np.any(self.dead_band):
            return "outside"
        if self.slower > 1:
            return "PI speed loop"
        return "P-PI" if np.any(self.rate) else "P-P"

    def start(self, count: int, T: float, limit: Any) -> None:
        super().start(count, T, limit)
        z = self.zero
        self.sum, self.out, self.command, self.model, self.slow = z, z, z, z, z
        self.commands = [z] * (self.model_delay + 2)
        self.notched = [z, z, z, z]
        parts = ("velocity_filter", "model_mass", "friction_ff", "tau", "notch", "dead_band")
        self.has = {part: bool(np.any(getattr(self, part))) for part in parts}

    def step(self, k: int, xs: Array, vs: Array, accs: Array, motor: Array, load: Array) -> Array:
        T, Kp = self.T, self.Kp
        error = xs - (load if self.position_load else motor)
        if self.has["dead_band"]:
            error = np.sign(error) * np.maximum(np.abs(error) - self.dead_band, 0.0)
        if k % self.slower == 0:
            self.command = self.Kv * error + self.ff * vs
        command, speed = self.command, self.difference(motor, self.n)
        if self.has["velocity_filter"]:
            self.slow = self.slow + (speed - self.slow) * T / (self.velocity_filter + T)
            speed = self.slow
        reference = command
        if self.has["model_mass"]:
            self.commands = [*self.commands[1:], command]
            new, old = self.commands[-1 - self.model_delay], self.commands[-2 - self.model_delay]
            gain = T * Kp / self.model_mass / 2
            reference = self.model
            self.model = (self.model * (1 - gain) + gain * (new + old)) / (1 + gain)
        self.sum = self.sum + T * self.rate * (reference - speed)
        asked = Kp * (command - speed + self.sum) + self.mass_ff * accs
        if self.has["friction_ff"]:
            asked = asked + self.friction_ff * np.tanh(vs / self.friction_speed)
        if self.has["tau"]:
            self.out = self.out + (asked - self.out) * (1 - np.exp(-T / np.maximum(self.tau, 1e-12)))
            asked = self.out
        if self.has["notch"]:
            asked = self._notch(asked)
        if self.windup == "none":
            return asked
        sat = within(asked, -self.limit, self.limit)
        if self.windup == "back":
            self.sum = self.sum + T * self.rate * (sat - asked) / Kp
        elif self.windup == "stop":
            outwards = (sat != asked) & (asked * (reference - speed) > 0)
            self.sum = np.where(outwards, self.sum - T * self.rate * (reference - speed), self.sum)
        return asked

    def _notch(self, u: Array) -> Array:
        """Notch of damping 0.1 over 0.7, bilinear."""
        w = np.tan(np.pi * self.notch * self.T)
        u1, u2, y1, y2 = self.notched
        a0 = 1 + 1.4 * w + w * w
        y = (
            (1 + 0.2 * w + w * w) * u
            + 2 * (w * w - 1) * u1
            + (1 - 0.2 * w + w * w) * u2
            - 2 * (w * w - 1) * y1
            - (1 - 1.4 * w + w * w) * y2
        ) / a0
        self.notched = [u, u1, y, y1]
        return y


@dataclass
class LinuxCncPid(Law):
    """LinuxCNC's `pid`: P e + I sum(e) T + D de/dt + FF0 x_s + FF1 v_s + FF2 a_s + bias, all limits of its sum.

    With `previous_target` e is formed with the set position of the sample before, as the component's default.
    """

    P: Any
    I: Any = 0.0  # noqa: E741
    D: Any = 0.0
    FF1: Any = 0.0
    FF2: Any = 0.0
    bias: Any = 0.0
    max_error_i: Any = math.inf
    dead_band: Any = 0.0
    previous_target: bool = True
    position_load: bool = False

    @property
    def family(self) -> str:  # type: ignore[override]
        """The name of what ran."""
        return "outside" if np.any(self.dead_band) else "PID"

    def start(self, count: int, T: float, limit: Any) -> None:
        super().start(count, T, limit)
        self.sum, self.error, self.target, self.held = self.zero, None, None, self.zero

    def step(self, k: int, xs: Array, vs: Array, accs: Array, motor: Array, load: Array) -> Array:
        reading = load if self.position_load else motor
        target = xs if self.target is None or not self.previous_target else self.target
        error = target - reading
        error = np.sign(error) * np.maximum(np.abs(error) - self.dead_band, 0.0)
        change = 0.0 * error if self.error is None else (error - self.error) / self.T
        # The integral stands still while the output is at its limit and the error drives it further out.
        free = self.held * error <= 0
        self.sum = np.clip(self.sum + np.where(free, error, 0.0) * self.T, -self.max_error_i, self.max_error_i)
        self.error, self.target = error, xs
        asked = self.bias + self.P * error + self.I * self.sum + self.D * change + self.FF1 * vs + self.FF2 * accs
        self.held = np.where(np.abs(asked) > self.limit, np.sign(asked), 0.0)
        return asked


@dataclass
class Adrc(Law):
    """Linear disturbance rejection of second order with an observer: outside the families."""

    mass: Any
    bandwidth: Any
    observer: Any

    def start(self, count: int, T: float, limit: Any) -> None:
        super().start(count, T, limit)
        self.x, self.v, self.d, self.u = None, self.zero, self.zero, self.zero

    def step(self, k: int, xs: Array, vs: Array, accs: Array, motor: Array, load: Array) -> Array:
        T, w = self.T, self.observer
        if self.x is None:
            self.x = motor
        miss = motor - self.x
        self.x = self.x + T * (self.v + 3 * w * miss)
        self.v = self.v + T * (self.d + self.u / self.mass + 3 * w * w * miss)
        self.d = self.d + T * w**3 * miss
        wc = self.bandwidth
        asked = self.mass * (accs + wc * wc * (xs - self.x) + 2 * wc * (vs - self.v) - self.d)
        self.u = np.clip(asked, -self.limit, self.limit)
        return asked


# ------------------------------------------------------------------------------------------------------- simulation


@dataclass
class Logs:
    """N logs of one run: arrays (N, K) in SI, and what is true."""

    T: float
    columns: dict[str, Array]
    truth: dict[str, Any]
    axes: Axes
    law: Law
    stable: Array
    hidden: dict[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.stable)

    def log(self, i: int = 0, first: int = 0, last: int | None = None) -> dict[str, Array]:
        """Columns of log i: time, setpoint, position (motor), position_load, force; rows first to last."""
        cut = slice(first, last)
        log = {name: (v[i] if v.ndim == 2 else v)[cut].copy() for name, v in self.columns.items()}
        log["time"] = log["time"] - log["time"][0]
        return log

    def true(self, name: str, i: int = 0) -> Any:
        """One true value of log i."""
        v = self.truth[name]
        if isinstance(v, str | bool):
            return v
        v = np.asarray(v)
        return float(v[i] if v.ndim else v)


def _exponential(matrix: Array) -> Array:
    """e^A of each matrix (N, n, n) by scaling and squaring of a Taylor series."""
    size = np.abs(matrix).sum(-1).max() if matrix.size else 0.0
    halvings = max(0, math.ceil(math.log2(max(size, 1e-12))) + 4)
    a = matrix / 2.0**halvings
    total = term = np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape).copy()
    for order in range(1, 13):
        term = term @ a / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def _propagator(axes: Axes, count: int, h: float) -> tuple[Array, Array]:
    """Exact step of the linear part and of forces held on each body: (n, n, N), (n, bodies, N)."""
    bodies = 2 if axes.two_masses else 1
    full = lambda v: np.broadcast_to(np.asarray(v, float), (count,))  # noqa: E731
    n = 2 * bodies
    whole = np.zeros((count, n + bodies, n + bodies))
    m1, b1 = full(axes.mass), full(axes.viscous)
    whole[:, 0, 1] = 1.0
    if bodies == 1:
        whole[:, 1, 1] = -b1 / m1
        whole[:, 1, 2] = 1 / m1
    else:
        m2, b2, k, d = full(axes.mass_load), full(axes.viscous_load), full(axes.stiffness), full(axes.damping)
        whole[:, 2, 3] = 1.0
        whole[:, 1, :4] = np.stack((-k / m1, -(d + b1) / m1, k / m1, d / m1), -1)
        whole[:, 3, :4] = np.stack((k / m2, d / m2, -k / m2, -(d + b2) / m2), -1)
        whole[:, 1, 4], whole[:, 3, 5] = 1 / m1, 1 / m2
    step = _exponential(whole * h)
    return np.moveaxis(step[:, :n, :n], 0, -1).copy(), np.moveaxis(step[:, :n, n:], 0, -1).copy()


def within(values: Any, low: Any, high: Any) -> Array:
    """As `np.clip`, whose way to the same two operations takes longer than they do for a few axes."""
    return np.minimum(np.maximum(values, low), high)


def _noise(rng: np.random.Generator, shape: tuple[int, int], size: Any, colour: Any) -> Array:
    """Coloured noise of standard deviation `size`, one row an axis."""
    white = rng.standard_normal(shape)
    c = np.broadcast_to(np.asarray(colour, float), shape[:1])
    for row, share in zip(white, c, strict=True):
        if share:
            row[1:] = lfilter([np.sqrt(1 - share * share)], [1.0, -share], row[1:], zi=[share * row[0]])[0]
    return white * np.broadcast_to(np.asarray(size, float), shape[:1])[:, None]


def simulate(
    axes: Axes,
    law: Law,
    setpoint: Array,
    T: float,
    rng: np.random.Generator,
    *,
    count: int = 1,
    disturbance: Array | None = None,
    added: Array | None = None,
    substeps: int = 4,
    delay: int = 0,
    start: Any = 0.0,
    set_resolution: float = 0.0,
) -> Logs:
    """Run N axes along `setpoint` ((K,) or (N, K)); `disturbance` (same shapes) acts on the load.

    `added` is a force on top of the law's (in the log), `start` the position in which all begins, `set_resolution`
    rounds the set position in the log alone.
    """
    shape = (count, np.shape(setpoint)[-1])
    rows = shape[1]
    places = np.broadcast_to(setpoint, shape) + np.reshape(np.broadcast_to(start, (count,)), (count, 1))
    vs = np.diff(places, axis=1, prepend=places[:, :1]) / T
    accs = np.diff(vs, axis=1, prepend=vs[:, :1]) / T
    full = lambda v: np.broadcast_to(np.asarray(v, float), (count,)).copy()  # noqa: E731
    h = T / substeps
    A, B = _propagator(axes, count, h)
    two = axes.two_masses
    n, bodies = A.shape[0], 2 if two else 1
    state = np.zeros((n, count))
    state[0::2] = places[:, 0]
    shares = [1.0 - full(axes.share_load), full(axes.share_load)] if two else [np.ones(count)]
    cp, cn = full(axes.coulomb_positive), full(axes.coulomb_negative)
    extra, vstri, creep = full(axes.stribeck), full(axes.stribeck_velocity), full(axes.creep)
    presliding = bool(np.any(creep > 0))
    masses = [full(axes.mass), full(axes.mass_load)][:bodies]
    s0 = (cp + cn) / 2 / np.maximum(creep, 1e-12)
    s1 = [full(axes.creep_damping) * np.sqrt(s0 * sh * m) for sh, m in zip(shares, masses, strict=True)]
    z = [np.zeros(count) for _ in range(bodies)]
    friction = [np.zeros(count) for _ in range(bodies)]
    gravity, slope, ripple = full(axes.gravity), full(axes.slope), full(axes.ripple)
    wave, phase = 2 * np.pi / full(axes.ripple_period), full(axes.ripple_phase)
    placed = bool(np.any(slope) or np.any(ripple))
    q1, q2, limit = full(axes.resolution), full(axes.resolution_load), full(axes.limit)
    late = full(axes.dead_time) / T
    whole = np.floor(late).astype(int)
    part = late - whole
    push = np.zeros(shape) if disturbance is None else np.broadcast_to(disturbance, shape).copy()
    if np.any(np.asarray(axes.noise_drive) > 0):
        push = push + _noise(rng, shape, axes.noise_drive, axes.colour)
    noisy = _noise(rng, shape, axes.noise_log, axes.colour) if np.any(np.asarray(axes.noise_log) > 0) else 0.0
    read1, read2, force, speed1, place2 = (np.zeros(shape) for _ in range(5))
    true1, rubbing = np.zeros(shape), np.zeros(shape)
    history = np.zeros((whole.max() + 2, count))  # commands, newest first
    history[:] = -gravity if not isinstance(law, Open) else 0.0
    who = np.arange(count)
    law.start(count, T, limit)
    if isinstance(law, Cascade) and np.any(law.rate):
        law.sum = -gravity / law.Kp
    elif isinstance(law, LinuxCncPid):
        law.bias = law.bias - gravity
    # share of each substep in which the newer command acts already
    newer = [within(i + 1 - part * substeps, 0.0, 1.0) for i in range(substeps)]
    bumpy, bump = bool(np.any(extra)), np.zeros(count)
    for k in range(rows):
        read1[:, k] = np.rint(state[0] / q1) * q1
        read2[:, k] = np.rint(state[n - 2] / q2) * q2
        true1[:, k], speed1[:, k], place2[:, k] = state[0], state[1], state[n - 2]
        old = max(k - delay, 0)
        asked = law.step(k, places[:, old], vs[:, old], accs[:, old], read1[:, old], read2[:, old])
        if added is not None:
            asked = asked + np.broadcast_to(added, shape)[:, k]
        force[:, k] = within(asked, -limit, limit)
        history[1:] = history[:-1].copy()
        history[0] = force[:, k]
        new, before = history[whole, who], history[np.minimum(whole + 1, len(history) - 1), who]
        for i in range(substeps):
            outer = [before + newer[i] * (new - before)]
            load = gravity + push[:, k]
            if placed:
                x = state[n - 2] + 0.5 * h * state[n - 1]
                load = load - slope * x - ripple * np.sin(wave * x + phase)
            if two:
                outer.append(load)
            else:
                outer[0] = outer[0] + load
            nxt = np.einsum("ijc,jc->ic", A, state)
            for j in range(bodies):
                nxt = nxt + B[:, j] * outer[j]
            if presliding:
                for j in range(bodies):
                    v = state[2 * j + 1]
                    level = np.where(v > 0, cp, cn) + extra * np.exp(-((v / vstri) ** 2))
                    rate = s0 * np.abs(v) / level
                    middle = np.sign(v) * level / s0
                    half = middle + (z[j] - middle) * np.exp(-rate * h / 2)
                    half = np.where(v == 0, z[j], half)
                    friction[j] = -(shares[j] * s0 * half + s1[j] * (v - rate * half))
                    nxt = nxt + B[:, j] * friction[j]
                for j in range(bodies):
                    v = 0.5 * (state[2 * j + 1] + nxt[2 * j + 1])
                    level = np.where(v > 0, cp, cn) + extra * np.exp(-((v / vstri) ** 2))
                    middle = np.sign(v) * level / s0
                    z[j] = np.where(v == 0, z[j], middle + (z[j] - middle) * np.exp(-s0 * np.abs(v) / level * h))
            else:
                for j in range(bodies):
                    v = 0.5 * (state[2 * j + 1] + nxt[2 * j + 1] + B[2 * j + 1, j] * friction[j])
                    if bumpy:
                        bump = extra * np.exp(-((v / vstri) ** 2))
                    free = nxt[2 * j + 1]
                    if j == 1:
                        free = free + B[3, 0] * friction[0]
                    most = shares[j] * (cn + bump)
                    friction[j] = within(-free / B[2 * j + 1, j], -shares[j] * (cp + bump), most)
                for j in range(bodies):
                    nxt = nxt + B[:, j] * friction[j]
            state = nxt
        rubbing[:, k] = sum(friction)
    with np.errstate(invalid="ignore"):
        error = np.abs(places - true1)
        stable = np.isfinite(true1).all(1) & (np.abs(speed1).max(1) < 20 * np.abs(vs).max(1) + 1.0)
        stable &= (np.abs(force) >= 0.999 * limit[:, None]).mean(1) < 0.3
    logged = force + noisy + np.reshape(full(axes.offset), (count, 1))
    shown = np.rint(places / set_resolution) * set_resolution if set_resolution else places
    columns = {
        "time": np.arange(rows) * T,
        "setpoint": shown,
        "position": read1,
        "position_load": read2 if two else read1,
        "force": logged,
    }
    truth = _truth(axes, law, T)
    hidden = {"position": true1, "velocity": speed1, "position_load": place2, "force": force, "friction": rubbing}
    hidden |= {"disturbance": push, "error": error}
    return Logs(T, columns, truth, axes, law, stable, hidden)


def _truth(axes: Axes, law: Law, T: float) -> dict[str, Any]:
    """Name what an identification should find.

    The model F = mass a + viscous v + coulomb sgn(v) + offset takes half the sum and half the difference of the levels.
    """
    truth: dict[str, Any] = {
        "mass": axes.mass_all,
        "mass_motor": axes.mass,
        "mass_load": axes.mass_load,
        "viscous": axes.viscous + axes.viscous_load,
        "coulomb": (axes.coulomb_positive + axes.coulomb_negative) / 2,
        "coulomb_positive": axes.coulomb_positive,
        "coulomb_negative": axes.coulomb_negative,
        "offset": axes.offset - axes.gravity,
        "offset_of_levels": axes.offset - axes.gravity + (axes.coulomb_positive - axes.coulomb_negative) / 2,
        "gravity": axes.gravity,
        "slope": axes.slope,
        "ripple": axes.ripple,
        "dead_time": axes.dead_time,
        "dead_time_samples": axes.dead_time / T,
        "family": law.family,
        "law": type(law).__name__,
        "T": T,
    }
    if axes.two_masses:
        truth["resonance"], truth["antiresonance"] = axes.resonance, axes.antiresonance
    return truth | {f"law.{name}": v for name, v in law.truth().items() if not isinstance(v, np.ndarray) or v.ndim < 2}


# ------------------------------------------------------------------------------------------------------------ draws

LAWS = ("P-P", "P-PI", "P-PI model", "PID", "PI speed loop")
OUTSIDE = ("notch", "dead band", "adrc", "velocity filter")
MOVES = ("dwells", "no dwells", "one way", "constant speeds", "circle", "multisine")


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw_axes(rng: np.random.Generator, T: float, *, two: bool, rotary: bool = False, **over: Any) -> Axes:
    """One axis with sizes as machine tools have them; names in `over` replace what is drawn."""
    mass = log_uniform(rng, 5.0, 400.0)
    weight = 10.0  # force scale for 1 m/s2 and 10 kg
    scale = 1.0
    if rotary:
        mass, scale = log_uniform(rng, 1e-3, 0.3), 10.0  # rad for m: ten times larger numbers of motion
    unit = mass * 2.0 * scale  # force of a usual acceleration
    level = unit * rng.uniform(0.05, 0.6)
    skew = rng.uniform(0.0, 0.25) * rng.choice((-1, 0, 1))
    share = rng.uniform(0.25, 0.7) if two else 0.0
    m2, m1 = mass * share, mass * (1 - share)
    wr = 2 * np.pi * rng.uniform(25.0, 120.0)
    k = wr**2 / (1 / m1 + 1 / m2) if two else 0.0
    zeta = rng.uniform(0.01, 0.06)
    values: dict[str, Any] = {
        "mass": m1,
        "mass_load": m2,
        "stiffness": k,
        "damping": 2 * zeta * wr / (1 / m1 + 1 / m2) if two else 0.0,
        "viscous": mass * log_uniform(rng, 0.2, 5.0),
        "coulomb_positive": level * (1 + skew),
        "coulomb_negative": level * (1 - skew),
        "stribeck": level * rng.uniform(0.0, 0.4) * rng.integers(0, 2),
        "stribeck_velocity": scale * log_uniform(rng, 1e-3, 1e-2),
        "creep": scale * log_uniform(rng, 2e-6, 2e-5) if rng.random() < 0.4 else 0.0,
        "gravity": unit * rng.uniform(-0.5, 0.5) if rng.random() < 0.2 else 0.0,
        "offset": level * rng.uniform(-0.1, 0.1),
        "dead_time": T * rng.uniform(0.0, 2.0),
        "resolution": scale * log_uniform(rng, 1e-7, 2e-5),
        "resolution_load": scale * log_uniform(rng, 1e-7, 1e-6),
        "noise_log": unit * log_uniform(rng, 0.002, 0.05),
        "noise_drive": unit * log_uniform(rng, 0.001, 0.02),
        "colour": rng.choice((0.0, 0.0, 0.8)),
        "limit": unit * rng.uniform(6.0, 12.0),
        "rotary": rotary,
    }
    del weight
    return Axes(**(values | over))


def draw_law(
    rng: np.random.Generator, axes: Axes, T: float, family: str, slow: float = 1.0, n: int | None = None
) -> Law:
    """A law that suits the axis: crossover of the velocity loop from 0.12 to 0.3 of 1/(dead time + 1.5 T)."""
    mass, n = axes.mass_all, int(rng.choice((1, 1, 2, 4))) if n is None else n
    late = axes.dead_time + (n + 1) * T / 2
    wc = slow * rng.uniform(0.12, 0.3) / late
    if axes.two_masses:  # a quarter of the antiresonance at most
        wc = min(wc, slow * rng.uniform(0.2, 0.5) * 2 * np.pi * axes.antiresonance)
    wc = min(wc, slow * 400.0)
    Kp, Kv, rate = mass * wc, wc * rng.uniform(0.12, 0.3), wc * rng.uniform(0.08, 0.25)
    ff = float(rng.choice((0.0, 1.0, 1.0, rng.uniform(0.5, 1.0))))
    windup = str(rng.choice(("back", "stop", "none")))
    basic: dict[str, Any] = {"Kv": Kv, "Kp": Kp, "ff": ff, "n": n, "windup": windup}
    if family == "P-P":
        return Cascade(**basic)
    if family == "P-PI":
        mass_ff = mass * rng.uniform(0.5, 1.0) if rng.random() < 0.25 else 0.0
        tau = T * rng.uniform(2.0, 6.0) if rng.random() < 0.2 else 0.0
        friction = axes.coulomb_positive * 0.7 if rng.random() < 0.2 else 0.0
        return Cascade(**basic, rate=rate, mass_ff=mass_ff, tau=tau, friction_ff=friction)
    if family == "P-PI model":
        return Cascade(**basic, rate=rate, model_mass=mass * rng.uniform(0.8, 1.3), model_delay=int(rng.integers(0, 3)))
    if family == "PID":
        late = axes.dead_time + T
        wc = min(slow * rng.uniform(0.12, 0.3) / late, wc * 2, slow * 400.0)
        D, Kv, rate = mass * wc, wc * 0.25, wc * 0.1
        return LinuxCncPid(
            P=D * (Kv + rate),
            I=D * Kv * rate * rng.integers(0, 2),
            D=D,
            FF1=D * rng.choice((0.0, 0.0, 1.0)),
            FF2=mass * rng.uniform(0.5, 1.0) if rng.random() < 0.5 else 0.0,
            previous_target=bool(rng.integers(0, 2)),
        )
    if family == "PI speed loop":
        slower = int(rng.choice((2, 4, 8)))
        return Cascade(**{**basic, "ff": 1.0, "Kv": Kv / 2}, rate=rate, slower=slower)
    if family == "notch":
        return Cascade(**basic, rate=rate, notch=rng.uniform(3.0, 6.0) * wc / (2 * np.pi))
    if family == "velocity filter":
        return Cascade(**basic, rate=rate, velocity_filter=rng.uniform(0.1, 0.2) / wc)
    if family == "dead band":
        return Cascade(**basic, rate=rate, dead_band=axes.resolution * rng.uniform(2, 10) + 5e-6)
    if family == "adrc":
        return Adrc(mass * rng.uniform(0.8, 1.2), wc * 0.3, wc)
    raise ValueError(f"no law is called {family!r}")


def draw_move(rng: np.random.Generator, T: float, kind: str, seconds: float, rotary: bool = False) -> Array:
    """Set positions of a move of about `seconds` s."""
    scale = 10.0 if rotary else 1.0
    speed, acc = scale * log_uniform(rng, 0.05, 0.4), scale * log_uniform(rng, 0.8, 5.0)
    travel = scale * log_uniform(rng, 0.02, 0.25)
    jerk = acc / rng.uniform(0.01, 0.06)
    lead, rest = 0.3, 0.0 if kind == "no dwells" else rng.uniform(0.1, 0.5)
    if kind in ("dwells", "no dwells", "one way"):
        targets: list[float] = []
        here, time = 0.0, lead
        while time < seconds:
            if kind == "one way":
                here += travel
            else:
                here = travel * rng.uniform(0.6, 1.0) if here == 0.0 else 0.0
            targets.append(here)
            time += travel / speed + speed / acc + rest
        return smooth_moves(T, targets, speed, acc, jerk, rest, lead)
    if kind == "constant speeds":
        speeds = speed * np.geomspace(0.1, 1.0, 6)
        return constant_speeds(T, list(speeds), min(travel, seconds * speed / 60 + 0.01), acc)
    if kind == "circle":
        radius = travel / 2
        feed = min(speed, math.sqrt(acc * radius))
        x, y = circle(T, radius, feed, max(seconds * feed / (2 * np.pi * radius), 2.0), max(0.2, 3 * feed / acc))
        return x if rng.random() < 0.5 else y
    if kind == "multisine":
        return np.zeros(round(seconds / T))
    raise ValueError(f"no move is called {kind!r}")


def _stack(items: Sequence[Any], shared: tuple[str, ...]) -> Any:
    """One value whose fields are arrays, one entry an item; fields in `shared` and texts are those of the first."""
    first, values = items[0], {}
    for f in fields(first):
        column = [getattr(item, f.name) for item in items]
        alike = f.name in shared or isinstance(column[0], str | bool)
        values[f.name] = column[0] if alike else np.array(column, float)
    return replace(first, **values)


SHARED = ("n", "windup", "model_delay", "slower", "previous_target", "position_load", "friction_speed", "rotary")


def draw(
    rng: np.random.Generator,
    *,
    count: int = 1,
    law: str | None = None,
    two: bool | None = None,
    move: str | None = None,
    rotary: bool | None = None,
    T: float | None = None,
    seconds: float = 6.0,
    with_pulses: bool = False,
    n: int | None = None,
    change: Callable[[Law, Axes], Law] | None = None,
    **over: Any,
) -> Logs:
    """Draw everything that is not given, and run `count` axes of one structure (family, T, masses, kind of move).

    Gains are lowered (x 0.6) until a loop is calm; an axis that never is has `stable` False. `over`: fields of `Axes`
    that are given; `change` replaces a law that was drawn for an axis. The logs end after `seconds` (at least one way
    there and back). One axis costs 1 to 5 s, 100 axes twice that.
    """
    T = float(rng.choice((2.5e-4, 5e-4, 1e-3))) if T is None else T
    rotary = bool(rng.random() < 0.35) if rotary is None else rotary
    two = bool(rng.random() < 0.4) if two is None else two
    move = str(rng.choice(MOVES[:5])) if move is None else move
    family = str(rng.choice(LAWS)) if law is None else law
    n = int(rng.choice((1, 1, 2, 4))) if n is None else n
    structure = np.random.default_rng(rng.integers(0, 2**31))
    over = {"creep": 0.0} | over if structure.random() < 0.6 else over
    axes = [draw_axes(rng, T, two=two, rotary=rotary, **over) for _ in range(count)]
    units = np.array([float(a.mass_all) for a in axes]) * (20.0 if rotary else 2.0)
    ramps = [draw_move(rng, T, "constant speeds" if move == "multisine" else move, seconds, rotary) for _ in axes]
    rows = round(seconds / T)
    added = None
    if move == "multisine":  # about slow ways there and back, so that Coulomb friction is only an offset
        ramps = [np.resize(x, rows) for x in ramps]
        tone = [multisine(T, rng, 2.0, 0.2 / T, 1.0, math.ceil(seconds))[:rows] for _ in axes]
        added = np.stack(tone) * (units * rng.uniform(0.3, 1.0, count))[:, None]
    xs = np.stack([np.pad(x, (0, max(rows - len(x), 0)), mode="edge")[:rows] for x in ramps])
    wave = np.stack([pulses(rows, T, rng, 6, u, 0.05) for u in units]) if with_pulses else None
    law_seeds = rng.integers(0, 2**31, count)
    start = rng.uniform(-0.2, 0.2, count)
    lowered = np.zeros(count, int)
    todo, whole = np.arange(count), None
    for _ in range(7):
        laws = [draw_law(np.random.default_rng(law_seeds[i]), axes[i], T, family, 0.6 ** lowered[i], n) for i in todo]
        laws = laws if change is None else [change(law, axes[i]) for law, i in zip(laws, todo, strict=True)]
        logs = simulate(
            _stack([axes[i] for i in todo], SHARED),
            _stack(laws, SHARED),
            xs[todo],
            T,
            rng,
            count=len(todo),
            disturbance=None if wave is None else wave[todo],
            added=None if added is None else added[todo],
            substeps=max(2, math.ceil(T / 2.5e-4)),
            start=start[todo],
        )
        # Calm: the reading is not much faster than the set motion, and the law does not chatter between its limits.
        speed = np.abs(np.diff(xs[todo])).max(1) / T
        moves = [np.sqrt(np.mean(np.diff(x) ** 2, 1)) / T for x in (logs.columns["position"], xs[todo])]
        calm = moves[0] - moves[1] < 0.3 * speed + 1.5 * np.asarray(logs.axes.resolution) / T
        logs.stable &= calm | (move == "multisine")
        if whole is None:
            whole = logs
        else:
            for store, fresh in ((whole.columns, logs.columns), (whole.hidden, logs.hidden), (whole.truth, logs.truth)):
                for name, v in fresh.items():
                    if isinstance(v, np.ndarray) and v.shape[:1] == (len(todo),) and name != "time":
                        store[name][todo] = v
            whole.stable[todo] = logs.stable
        todo = np.flatnonzero(~whole.stable)
        if len(todo) == 0:
            break
        lowered[todo] += 1
    assert whole is not None
    whole.truth |= {"move": move, "lowered": lowered}
    return whole


# ------------------------------------------------------------------------------------------------------------ files

NAMES: dict[str, tuple[tuple[str, ...], ...]] = {
    "setpoint": (("x_set", "pos_cmd", "target", "ref_pos", "Sollposition", "SetPosition", "joint.0.motor-pos-cmd"),),
    "position": (("x", "pos_fb", "actual", "meas_pos", "Istposition", "ActPosition", "joint.0.motor-pos-fb"),),
    "position_load": (("x_table", "pos_load", "scale", "encoder2", "Istposition_2", "ActPosition2", "load-pos"),),
    "force": (("force", "torque_cmd", "output", "current", "Sollmoment", "ActTorque", "pid.0.output"),),
}
LENGTHS = {"m": 1.0, "mm": 1e3, "um": 1e6, "inch": 1 / 0.0254}
ANGLES = {"rad": 1.0, "deg": 180 / math.pi, "rev": 1 / (2 * math.pi)}


@dataclass(frozen=True)
class Written:
    """A file and what its reader must find out: names, unit of each role, and the value of 100 %, of 1 A."""

    path: Path
    names: dict[str, str]
    units: dict[str, str]
    rated: float
    delimiter: str
    decimal: str


def write_csv(
    path: Path,
    log: dict[str, Array],
    rng: np.random.Generator,
    *,
    rotary: bool = False,
    language: int | None = None,
    unit: str | None = None,
    force_unit: str | None = None,
    count_length: float = 1e-6,
    two: bool = False,
    header: bool = True,
    with_time: bool = True,
    time_unit: str | None = None,
    bracket: str | None = None,
) -> Written:
    """Write a log as a maker would: drawn names, length unit, force in N, %, A or kN, comma or semicolon.

    `unit` "counts" writes positions as whole numbers of `count_length`. `bracket` is the form of the unit in the
    header, "{name} [{unit}]"; "" writes names alone.
    """
    lengths = ANGLES if rotary else LENGTHS
    forces = ("N m", "%", "A") if rotary else ("N", "%", "A", "kN")
    choice = int(rng.integers(0, 7)) if language is None else language
    unit = str(rng.choice([*lengths][: 3 if rotary else 2])) if unit is None else unit
    force_unit = str(rng.choice(forces)) if force_unit is None else force_unit
    time_unit = str(rng.choice(("s", "ms"))) if time_unit is None else time_unit
    bracket = (
        str(rng.choice(("{name} [{unit}]", "{name} ({unit})", "{name}/{unit}", "{name}")))
        if bracket is None
        else bracket
    )
    peak = float(np.abs(log["force"]).max())
    rated = {"%": float(f"{peak / rng.uniform(0.5, 1.8):.3g}"), "A": float(f"{peak / rng.uniform(3, 20):.3g}")}.get(
        force_unit, 1.0
    )
    factor = {"%": 100 / rated, "A": 1 / rated, "kN": 1e-3}.get(force_unit, 1.0)
    length = 1 / count_length if unit == "counts" else lengths[unit]
    delimiter, decimal = ((",", "."), (";", "."), (";", ","), ("\t", "."))[int(rng.integers(0, 4))]
    roles = ["setpoint", "position", *(["position_load"] if two else []), "force"]
    names = {role: NAMES[role][0][choice] for role in roles}
    units = {role: force_unit if role == "force" else unit for role in roles}
    columns = [(names[role], units[role], log[role] * (factor if role == "force" else length)) for role in roles]
    order = rng.permutation(len(columns))
    columns = [columns[i] for i in order]
    if with_time:
        names["time"], units["time"] = ("t", "time", "Time", "Zeit")[int(rng.integers(0, 4))], time_unit
        columns.insert(0, (names["time"], time_unit, log["time"] * (1e3 if time_unit == "ms" else 1.0)))
    lines = []
    if header:
        form = bracket or "{name}"
        lines.append(delimiter.join(form.format(name=name, unit=u) for name, u, _ in columns))
    forms: list[Callable[[float], str]] = [
        (lambda v: str(round(v))) if u == "counts" else (lambda v: f"{v:.10g}") for _, u, _ in columns
    ]
    for row in zip(*(v for _, _, v in columns), strict=True):
        text = [f(v) for f, v in zip(forms, row, strict=True)]
        lines.append(delimiter.join(t.replace(".", decimal) for t in text))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Written(path, names, units, rated, delimiter, decimal)


__all__ = [
    "Adrc", "Axes", "Cascade", "LinuxCncPid", "Logs", "Open", "Written", "circle", "constant_speeds", "draw",
    "draw_axes", "draw_law", "draw_move", "multisine", "pulses", "replace", "simulate", "smooth_moves", "write_csv",
]  # fmt: skip
