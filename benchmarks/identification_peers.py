"""A drive from a log: feeddrive against SIPPY (sippy_unipi) on the same rows, in time and in what the model is worth.

    python benchmarks/identification_peers.py [--log DATA_EMPS.mat]

Each gets the first half of a log, up to a standstill, and predicts the speed in the second half from its force alone,
a free run over some 12 s.  SIPPY gets speed and force low-passed without phase and decimated to 100 Hz, as its methods
need it; that is not in its time.  In the second group it is told the direction of the set motion as a further input,
which is what an expert would do about friction.  Without `--log` the log is simulated.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rounds import machine, measure, ratio, table
from scipy.signal import butter, lfilter, sosfiltfilt

from feeddrive.files.read_log import read_log
from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.rigid import RigidFit, identify_rigid
from identification import simulated

ROUNDS = 5
EVERY = 10
LOW_PASS = 40.0  # Hz, under Nyquist of the decimated rows
OURS = "feeddrive, inverse dynamics"
Simulated = Callable[[np.ndarray, np.ndarray], np.ndarray]  # force and direction -> speed


def measured(path: Path) -> MotionLog:
    """The EMPS log in SI."""
    log = read_log(path)
    return MotionLog(
        name="EMPS",
        position=log["qm"],
        force=log.constants["gtau"] * log["vir"],
        set_position=log["qg"],
        sample_time=log.sample_time,
    )


def part(log: MotionLog, rows: slice) -> MotionLog:
    assert log.set_position is not None
    return replace(log, position=log.position[rows], force=log.force[rows], set_position=log.set_position[rows])


def slow(values: np.ndarray, T: float) -> np.ndarray:
    """Low-passed without phase and decimated."""
    return sosfiltfilt(butter(4, LOW_PASS, fs=1.0 / T, output="sos"), values)[::EVERY]


def columns(log: MotionLog) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed, force and direction of the set motion, at 100 Hz."""
    assert log.set_position is not None
    T = log.sample_time
    speed = slow(np.gradient(log.position, T), T)
    wanted = np.gradient(log.set_position, T)[::EVERY]
    return speed, slow(log.force, T), np.where(np.abs(wanted) > 1e-4, np.sign(wanted), 0.0)


def free_run(fit: RigidFit, log: MotionLog) -> np.ndarray:
    """Speed of the identified drive from rest: m v' = F - friction - offset, friction implicit."""
    T, value = log.sample_time, {each.name: each.value for each in fit.estimates}
    sides = {
        way: (
            value.get(f"viscous_{name}", value.get("viscous", 0.0)),
            value.get(f"coulomb_{name}", value.get("coulomb", 0.0)),
        )
        for way, name in ((1.0, "positive"), (-1.0, "negative"))
    }
    v, found = 0.0, np.empty(log.force.size)
    for k, force in enumerate(log.force):
        found[k] = v
        pushed = value["mass"] * v / T + force - value.get("offset", 0.0)
        way = 1.0 if pushed > 0.0 else -1.0
        viscous, coulomb = sides[way]
        v = way * max(abs(pushed) - coulomb, 0.0) / (value["mass"] / T + viscous)
    return slow(found, T)


def sippy(first: tuple[np.ndarray, ...], T: float) -> dict[str, Callable[[], Simulated]]:
    """Name -> identification, which returns a free run."""
    from sippy_unipi import system_identification

    speed, force, direction = first
    both = np.vstack([force, direction])

    def made(method: str, inputs: np.ndarray, **orders: Any) -> Callable[[], Simulated]:
        def call() -> Simulated:
            with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model = system_identification(speed.copy(), inputs.copy(), method, tsample=T * EVERY, **orders)
            return lambda *given: run(model, np.vstack(given[: np.atleast_2d(inputs).shape[0]]))

        return call

    return {
        "ARX(2, 2)": made("ARX", force, ARX_orders=[2, 2, 0]),
        "ARMAX(2, 2, 2)": made("ARMAX", force, ARMAX_orders=[2, 2, 2, 0]),
        "OE(2, 2)": made("OE", force, OE_orders=[2, 2, 0]),
        "N4SID, 2 states": made("N4SID", force, SS_fixed_order=2),
        "ARX(2, 2), told the direction": made("ARX", both, ARX_orders=[[2], [[2, 2]], [[0, 0]]]),
        "ARMAX(2, 2, 2), told the direction": made("ARMAX", both, ARMAX_orders=[[2], [[2, 2]], [2], [[0, 0]]]),
        "OE(2, 2), told the direction": made("OE", both, OE_orders=[[[2, 2]], [2], [[0, 0]]]),
        "N4SID, 2 states, told the direction": made("N4SID", both, SS_fixed_order=2),
    }


def run(model: Any, inputs: np.ndarray) -> np.ndarray:
    """Free run of one of SIPPY's models from rest."""
    if hasattr(model, "A"):
        x, found = np.zeros(model.A.shape[0]), np.empty(inputs.shape[1])
        A, B, C, D = (np.asarray(each) for each in (model.A, model.B, model.C, model.D))
        for k, u in enumerate(inputs.T):
            found[k] = (C @ x + D @ u)[0]
            x = A @ x + B @ u
        return found
    num, den = model.G.num[0], model.G.den[0]
    # python-control's polynomials are in z: as many delays as the denominator is longer
    return sum(
        lfilter(np.r_[np.zeros(len(den[i]) - len(num[i])), num[i]], den[i], inputs[i]) for i in range(inputs.shape[0])
    )


def fit_percent(found: np.ndarray, true: np.ndarray) -> float:
    """100 % for a perfect prediction, 0 for none better than the mean, less for worse."""
    if not np.all(np.isfinite(found)):
        return -np.inf
    return 100.0 * (1.0 - float(np.linalg.norm(true - found) / np.linalg.norm(true - np.mean(true))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--log", type=Path)
    given = parser.parse_args()
    print(machine(), "\n")
    log = simulated() if given.log is None else measured(given.log)
    assert log.set_position is not None
    rest = np.flatnonzero(np.gradient(log.set_position) == 0.0)
    half = int(rest[np.argmin(np.abs(rest - log.position.size // 2))])
    first, second = part(log, slice(0, half)), part(log, slice(half, None))
    speed, force, direction = columns(second)
    calls: dict[str, Callable[[], object]] = {
        OURS: lambda: identify_rigid(first),
        "feeddrive, with dead time, gains, closed loop": lambda: identify_motion(first),
    }
    fits = dict.fromkeys(calls, fit_percent(free_run(identify_rigid(first), second), speed))
    fits["feeddrive, with dead time, gains, closed loop"] = float("nan")
    try:
        peers = sippy(columns(first), log.sample_time)
    except ImportError:
        peers = {}
        print("SIPPY is not installed: pip install sippy_unipi (the package `sippy` is something else).\n")
    for name, call in peers.items():
        try:
            fits[name] = fit_percent(call()(force, direction), speed)
            calls[name] = call
        except Exception as error:
            print(f"{name}: {error}")
    taken = measure(calls, ROUNDS)
    rows = [
        [
            name,
            f"{1e3 * np.median(taken[name]):.0f}",
            f"{ratio(taken, name, OURS):.2g}",
            "" if np.isnan(fits[name]) else f"{fits[name]:.1f}",
        ]
        for name in calls
    ]
    table([f"{half} rows of '{log.name}'", "CPU ms", "times ours", "fit of the unused half, %"], rows)


if __name__ == "__main__":
    main()
