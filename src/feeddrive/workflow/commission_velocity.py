"""The steps of `feeddrive commission` for a drive that is commanded by velocities (csv).

Its velocity loop stays as it is, and is identified as a part of the axis; what is tuned, proven and exported is the
position loop around it, whose command is a velocity.  The other steps are those of `commission_steps`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.velocity_loop import VelocityLoop
from feeddrive.blocks.controller.position_loop import PositionLoop
from feeddrive.blocks.families import Law
from feeddrive.bus.live import LiveAxis
from feeddrive.bus.play import Profile
from feeddrive.commissioning import motions
from feeddrive.commissioning.cogging import acting, stated
from feeddrive.commissioning.motions import Pace, Shaken
from feeddrive.commissioning.velocity_loop import SUBSTEP, fit_velocity_loop, gain_of
from feeddrive.export.design import weight
from feeddrive.files.atomic_io import new_directory, write_whole
from feeddrive.files.frf import read_frfs, write_frf
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile, machine_of_text
from feeddrive.files.read_log import read_log
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import Record
from feeddrive.identification.response.plant_fit import on_lines
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.workflow.commission_steps import (
    BAND,
    LINES,
    MODES,
    REACH,
    UNKNOWN_DELAY,
    USED,
    WORK,
    Chain,
    CommissionRequest,
)
from feeddrive.workflow.frf import FrfRequest, frf

START = 5.0  # 1/s of the start law: a fifth of a velocity loop of 4 Hz, than which those of drives are faster
ASSUMED = 10.0  # Hz of the velocity loop in the machine file of the start law, until it is measured
SLIDES = 0.5  # of the speed of the even move, that an excitation may add: the axis goes on sliding
FIRST = 0.2  # of the friction: force of the first excitation, by whose motion the others are sized
MOST_LARGER = 20.0  # times the first excitation, at most
PERIODS = 3  # whole periods of a realisation
TIMES = {"N": 2, "m/s": 4}  # realisations with a force, which tells the velocity loop alone, and with velocities
WIDE, LEAST_TOP = 20.0, 100.0  # times the rate of the velocity loop, and Hz: highest line, above which nothing matters
SLOWEST = 5e-3  # m/s of the even move, below which periods are shorter
STEP = 0.02  # of limits.force: step on the table in the simulation that proves a tuning, far from any limit
SEEDS = {"N": 100, "m/s": 200}  # of the phases


class _Plan(NamedTuple):
    """The excitation: one even move forth and one back, with a multisine each, of size 1."""

    pairs: tuple[Shaken, ...]
    lines: np.ndarray
    resolution: float


def _by_output(path: Path) -> dict[str, FRF]:
    """Return the responses of a file by the name of their output."""
    return {response.output: response for response in read_frfs(path).values()}


class VelocityChain(Chain):
    """The steps of the commissioning of a drive that takes velocities, in order."""

    # the force of these logs is the one that the drive tells with its reading
    late = 0.0
    forces, measured_force = "force/frf.csv", True

    @classmethod
    def check(cls, request: CommissionRequest) -> None:
        """Raise ParameterError for a bound of the noise of a force, which a control in csv does not command."""
        # the options of limits are made from the table of figures
        if getattr(request, "max_noise", None) is not None:
            raise ParameterError(
                "--max-noise bounds the noise of a commanded force, and this drive is commanded by velocities: leave "
                "it out"
            )

    def start_law(self) -> tuple[str, Mapping[str, float]]:
        """Write a slow position loop, which any velocity loop of a drive bears; nothing moves."""
        facts = self.facts
        axis = self._rigid(facts["rough_mass"], facts["friction"], 0.0, UNKNOWN_DELAY + 2.0 * self.T)
        loop = self._around(axis, START)
        with new_directory(self.place) as folder:
            write_whole(folder / "machine.toml", self._machine(loop, "slow start law of feeddrive commission"))
        return Text(
            f"a position loop with Kv {Quantity(START, '1/s'):3} around the drive's velocity loop, which stays as it is"
        ), {}

    def _around(self, axis: Axis, Kv: float) -> Loop:
        """Return an axis under a position loop, with a velocity loop that is assumed until it is measured."""
        rate = 2.0 * np.pi * ASSUMED
        inner = VelocityLoop(
            Kp=rate * float(axis.plant.rigid_mass()), Tn=6.0 / rate, lag=SUBSTEP, held_force=float(weight(axis))
        )
        actuator = Actuator(dead_time=axis.actuator.dead_time, velocity_loop=inner)
        axis = replace(axis, actuator=actuator, substeps=max(1, round(self.T / SUBSTEP)))
        return Loop(control=self._control(Kv), axis=axis, sample_time=self.T, name="x")

    def _control(self, Kv: float) -> Control:
        limits = self.limits
        guard = Guard(following_error_limit=limits.following_error, velocity_limit=limits.velocity)
        return Control(law=PositionLoop(Kv=Kv), velocity_limit=float(limits.velocity), guard=guard)

    def _strokes_pace(self, loop: Loop) -> Pace:
        """Return the pace that the force allows: how the drive follows is not known, and the strokes grow slowly."""
        return self._pace(self.facts["rough_mass"])

    def _forced(self, log: Log) -> Log:
        """Return a log in which the force that the drive tells stands for that of a control, which commands none."""
        return replace(log, channels={**log.channels, "commanded": log["force"]})

    def _identified(self, machine: MachineFile, force: str) -> tuple[dict[str, float], str]:
        """Return mass, friction and dead time by the strokes; nothing is said of a law that made their force."""
        return super()._identified(machine, force)[0], ""

    def _by_force(self, machine: MachineFile) -> MachineFile:
        return machine_of_text(self._machine(self._by_mass(self.facts["rough_mass"]), "a mass"), "machine.toml")

    def _by_mass(self, mass: float) -> Loop:
        """Return a rigid axis that takes a force, under a start law for it: the fits of masses begin with it."""
        return super()._started(self._rigid(mass, self.facts["friction"], 0.0, UNKNOWN_DELAY), 0.3)

    def _begin_of_fit(self) -> Loop:
        return self._by_mass(self.facts["mass"])

    # the responses

    def excitation(self) -> tuple[str, Mapping[str, float]]:
        """Choose the lines of the multisines; how large they are is told by a first, weak one. Nothing moves."""
        plan = self._planned()
        first, last = plan.lines[[0, -1]] * plan.resolution
        return Text(
            f"{plan.lines.size} lines from {Quantity(first, 'Hz'):3} to {Quantity(last, 'Hz'):3}, or less where the "
            f"velocity loop turns out to be slow; on the force ({TIMES['N']} realisations) and on the velocity "
            f"({TIMES['m/s']})"
        ), {"period": float(plan.pairs[0].period), "amplitude": FIRST * self.facts["friction"]}

    def _planned(self, top: float = MODES) -> _Plan:
        """Return the excitation with lines up to `top`, Hz, or to what the bus carries."""
        travel, pace = REACH * self.limits.travel, self._pace(self.facts["mass"])
        top = min(top, BAND / self.T)
        for resolution in (0.5 * LINES[0][0], LINES[0][0], LINES[1][0]):
            period = round(1.0 / (resolution * self.T))
            lines = motions.lines_of(top, 1.0 / (period * self.T))
            pairs = tuple(
                motions.shaken("responses", way * travel, lines, period, PERIODS, pace, self.T, k)
                for k, way in enumerate((1.0, -1.0))
            )
            speed = float(np.max(np.abs(pairs[0].profile.velocity)))
            if speed >= min(SLOWEST, 0.1 * self.limits.velocity):
                break
        if speed > pace.speed:
            # more travel than it takes: the even move is as fast as the pace allows
            share = pace.speed / speed
            pairs = tuple(
                motions.shaken("responses", share * way * travel, lines, period, PERIODS, pace, self.T, k)
                for k, way in enumerate((1.0, -1.0))
            )
        return _Plan(pairs, lines, 1.0 / (period * self.T))

    def responses(self) -> tuple[str, Mapping[str, float]]:
        """Shake the axis by a force and by the velocity in even moves, and estimate the responses to both."""
        plan = self._planned()
        control = self._control(START)
        far, times = float(np.ptp(plan.pairs[0].profile.set_position)), sum(TIMES.values()) // 2 + 1
        self._ask(
            Text(
                f"Responses: the axis moves slowly by {Quantity(far, 'm'):3 mm} and back, {times} times, and is "
                "shaken by a force and by its velocity, weakly first."
            )
        )
        axis = self._under_control()
        weak = FIRST * self.facts["friction"]
        tried = self._shaken(axis, plan, control, weak, "N", (0, 1))
        by_force = self._sized(plan, tried, weak)
        rate = gain_of(self._rough(tried)) / (2.0 * np.pi * self.facts["mass"])
        # lines far above the velocity loop take amplitude from those that count
        plan = self._planned(max(LEAST_TOP, WIDE * rate))
        pushed = self._shaken(axis, plan, control, by_force, "N", range(TIMES["N"]))
        rough = gain_of(self._rough(pushed))
        speed = SLIDES * float(np.max(np.abs(plan.pairs[0].profile.velocity)))
        by_velocity = min(speed, WORK * self._free / rough)
        led = self._shaken(axis, plan, control, by_velocity, "m/s", range(TIMES["m/s"]))
        with_all = {f"pushed_{k}": log for k, log in enumerate(pushed, start=1)}
        with_all |= {f"led_{k}": log for k, log in enumerate(led, start=1)}
        self._kept(**{name: self._acted(log) for name, log in with_all.items()})
        self._answers()
        return Text(
            f"{' and '.join(self._outputs(led[0]))}, to velocities of at most {Quantity(by_velocity, 'm/s'):3} and to "
            f"forces of at most {Quantity(by_force, 'N'):3}"
        ), {"amplitude": by_force}

    def _shaken(
        self, axis: LiveAxis, plan: _Plan, control: Control, amplitude: float, unit: str, numbers: Sequence[int]
    ) -> list[Log]:
        """Play realisations of the multisine, forth and back in turn; return their logs."""
        logs = list[Log]()
        for number in numbers:
            shaken = plan.pairs[number % 2]
            distance, pace = float(shaken.profile.set_position[-1]), self._pace(self.facts["mass"])
            drawn = motions.shaken(
                "responses", distance, plan.lines, shaken.period, PERIODS, pace, self.T, SEEDS[unit] + number
            )
            played = self._against(drawn.sized(amplitude, unit))
            logs.append(self._play(axis, played, control, step="excitation").log)
        return logs

    def _against(self, profile: Profile) -> Profile:
        """Return the profile with the force against that along the travel, which would pass for noise."""
        along = stated(self.facts)
        if along is None:
            return profile
        return replace(profile, beside=-self._held_against(along, profile))

    def _sized(self, plan: _Plan, logs: Sequence[Log], weak: float) -> float:
        """Return the amplitude (N) at which the axis goes on sliding, within following error and force."""
        shares = [MOST_LARGER, WORK * self._free / weak]
        for log, shaken in zip(logs, plan.pairs, strict=True):
            rows = shaken.whole
            reading = log["reading_load"][rows]
            # means over a period leave noise and counts out, and what does not repeat
            waves = reading[: PERIODS * shaken.period].reshape(PERIODS, shaken.period)
            steady = np.polyval(np.polyfit(np.arange(reading.size), reading, 1), np.arange(reading.size))
            wave = np.mean(waves - steady.reshape(waves.shape), axis=0)
            spectrum = np.zeros(shaken.period // 2 + 1, dtype=complex)
            spectrum[plan.lines] = np.fft.rfft(wave)[plan.lines]
            omega = 2.0j * np.pi * np.arange(spectrum.size) / (shaken.period * self.T)
            speed = float(np.max(np.abs(np.fft.irfft(omega * spectrum, shaken.period))))
            even = float(np.max(np.abs(shaken.profile.velocity)))
            shares.append(SLIDES * even / max(speed, 1e-12))
            error = float(np.max(np.abs(log["set_position"] - log["reading_load"])[rows]))
            shares.append(USED * self.limits.following_error / max(error, 1e-12))
        return weak * min(shares)

    def _outputs(self, log: Log) -> tuple[str, ...]:
        return tuple(name for name in ("reading_motor", "reading_load") if name in log.channels)

    def _acted(self, log: Log) -> Log:
        """Return a log with the columns `acting`, the force that the drive tells, and `added`, its force offset, both
        with the force along the travel.
        """
        along = stated(self.facts)
        made = {"acting": log["force"], "added": log["commanded"]}
        if along is not None:
            made = {
                "acting": acting(self._forced(log), along, self.late)["acting"],
                "added": acting(log, along, self.late)["acting"],
            }
        units = dict.fromkeys(made, log.units["force"])
        return replace(log, channels={**log.channels, **made}, units={**log.units, **units})

    def _rough(self, logs: Sequence[Log]) -> FRF:
        """Return the response of the reading to a force offset, with what the slow position loop does meanwhile."""
        records = [
            Record(
                input=log["added"],
                output=log["reading_load"],
                references=(log["excitation"],),
                sample_time=self.T,
                unit="m/N",
            )
            for log in map(self._acted, logs)
        ]
        return estimate_frf(records, method="periodic", period=round(self.facts["period"])).frf

    def _estimate(self, kind: str, unit: str, source: str, outputs: Sequence[str], folder: str) -> dict[str, FRF]:
        """Estimate responses of the step from logs of a kind; return them by output."""
        frf.run(
            FrfRequest(
                tuple(self.place / f"{kind}_{k}.parquet" for k in range(1, TIMES[unit] + 1)),
                input=source,
                output=tuple(outputs),
                reference=("excitation",),
                method="periodic",
                period=round(self.facts["period"]),
                out=self.place / folder,
            ),
            self.progress.quiet(),
        )
        return _by_output(self.place / folder / "frf.csv")

    def _answers(self) -> None:
        """Estimate and write the responses to velocities, to the force offset alone, and to the force that is told.

        While a force is added, the position loop moves the velocity as well: G_F = X/F - G_w W/F.
        """
        outputs = [name for name in ("reading_motor", "reading_load") if name in self._log("led_1").channels]
        by_velocity = self._estimate("led", "m/s", "commanded_velocity", outputs, "responses")
        both = self._estimate("pushed", "N", "added", [*outputs, "commanded_velocity"], "offset")
        moved, alone = both["commanded_velocity"], list[FRF]()
        for name in outputs:
            # a line that one of the two estimates leaves out, as too noisy, is left out of both
            here = np.isin(np.round(moved.frequency, 6), np.round(by_velocity[name].frequency, 6))
            there = np.isin(np.round(by_velocity[name].frequency, 6), np.round(moved.frequency, 6))
            answer = on_lines(both[name], here)
            led = by_velocity[name].response[there] * moved.response[here]
            alone.append(replace(answer, response=answer.response - led))
        with new_directory(self.place / "offset_alone") as place:
            write_frf(place / "frf.csv", *alone)
        self._estimate("led", "m/s", "acting", outputs, "force")

    def _log(self, name: str) -> Log:
        return read_log(self.place / f"{name}.parquet")

    # the model

    def _model_of(self, fitted: Loop) -> Loop:
        """Return the loop of the model with the velocity loop of the drive, under the start law."""
        by_velocity, by_force = (
            _by_output(self._in("responses", f"{name}/frf.csv")) for name in ("responses", "offset_alone")
        )
        found = fit_velocity_loop(fitted.axis, by_velocity, by_force, self.T, float(weight(fitted.axis)))
        self.progress.remark(Text(f"- {found.sentence()}"))
        return replace(fitted, axis=found.axis, control=self._control(START))

    def _start_control(self, model: Loop) -> Control:
        return self._control(START)

    def _tuning(self, most_noise: float | None) -> dict[str, Any]:
        """Return options of the tuning: no filters, which the drive has itself, and no noise of a force."""
        # the control has no limit of force, of which the proof of a tuning takes a share
        return {"filters": "kept", "step_force": STEP * float(self.limits.force)}

    def _slowed(self, law: Any, share: float) -> Law:
        return replace(law, Kv=share * law.Kv)

    def _again(self, *, opens: bool = True) -> str:
        """Return "": its responses are not measured again."""
        return ""
