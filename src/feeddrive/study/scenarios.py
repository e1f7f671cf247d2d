"""The machines of a study as operating points of the tuner, and how a control does on each of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.study.study import Study
from feeddrive.study.variant_groups import variant_groups
from feeddrive.study.variants import variants
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Criteria, Limits
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point

MOST = 5_000  # machines that are held in memory, some 100 kB each
KEPT = 2e-3  # relative excess at which a bound still counts as kept, as in the proof of a tuning
_VIOLATION = 1e3  # weight of an excess in the goal's logarithm: a violated bound outweighs every goal


@dataclass(frozen=True, eq=False)
class Scenarios:
    """Machines of a study that a control is judged on.

    points    with all frequency lines, for the tuner
    sparse    with fewer lines, to judge a control quickly
    velocity  m/s, at which the axes are linearized
    bad       numbers and reasons of variants that cannot be built
    """

    points: tuple[OperatingPoint, ...]
    sparse: tuple[OperatingPoint, ...]
    velocity: float
    bad: tuple[tuple[int, str], ...]

    def merits(self, control: Control, goal: Figure, limits: Limits, band: tuple[float, float]) -> Merits:
        """Judge a control on each machine."""
        response = ControlResponse(control, self.points[0].sample_time, (), self.velocity)
        none = np.zeros(0)
        goals, broken = np.full(len(self.points), np.inf), np.full(len(self.points), np.inf)
        for i, point in enumerate(self.sparse):
            try:
                judged = Criteria((point,), response, goal, limits, band)(none)
            except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
                continue
            if judged.stable and np.isfinite(judged.goal[0]):
                goals[i] = judged.goal[0]
                broken[i] = max((-bound.slack for bound in judged.bounds), default=-math.inf)
        return Merits(goals, broken)


@dataclass(frozen=True, eq=False)
class Merits:
    """By machine the logarithm of the goal, and the violation of the worst bound, negative where all are kept.

    Both are infinite where the loop is unstable.
    """

    goal: np.ndarray
    broken: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """True for machines on which all bounds are kept."""
        return self.broken <= KEPT

    @property
    def severity(self) -> np.ndarray:
        """Merit of each machine, lower is better: one that violates a bound ranks behind all that do not."""
        with np.errstate(invalid="ignore"):
            excess = np.maximum(self.broken - KEPT, 0.0)
        return np.where(np.isfinite(self.goal), self.goal + _VIOLATION * excess, np.inf)


def scenarios(study: Study, samples: int, progress: Progress) -> Scenarios:
    """The first variants of a study as operating points; those that cannot be made are left out and listed.

    Raises ParameterError where the study varies what the tuner would set, or what no linear axis has.
    """
    _require_axis(study)
    if not 1 <= samples <= MOST:
        raise ParameterError(f"samples = {samples} must be 1 to {MOST:,} machines, all of which are held in memory")
    drawn = variants(study, 0, min(samples, study.count))
    by_number: dict[int, OperatingPoint] = {}
    bad: list[tuple[int, str]] = []
    speeds: list[float] = []
    done = 0
    for group in variant_groups(study, drawn):
        velocity = group.speed
        for place, row in enumerate(group.rows.tolist()):
            progress.step("machines", done, len(drawn))
            done += 1
            number = drawn.first + row
            try:
                by_number[number] = modelled_point(group.loop(place), f"variant {number}", velocity=velocity)
            except FeeddriveError as error:
                bad.append((number, str(error)))
        speeds.append(velocity)
    if not by_number:
        raise ParameterError(f"no machine of the study can be made; variant {bad[0][0]}: {bad[0][1]}")
    points = tuple(by_number[number] for number in sorted(by_number))
    sparse = tuple(point.chosen(point.sparse()) for point in points)
    return Scenarios(points, sparse, float(np.median(speeds)), tuple(sorted(bad)))


def _require_axis(study: Study) -> None:
    """Raise ParameterError for what a tuning over the machines of a study cannot vary."""
    base = next(study.bases())
    coupled = base.job.machine.coupled(base.axis)
    if coupled:
        raise ParameterError(f"{study.file.name}: {coupled}; the tuner works on one axis alone")
    place = f"{base.loop.place_of('control')}."
    for varied in study.vary:
        if any(path.startswith(place) for path in varied.paths) or varied.name == "row":
            raise ParameterError(
                f"{study.file.name}: '{varied.name}' varies the control, which is what is tuned: leave it out"
            )


def with_control(study: Study, control: Control) -> Study:
    """The study of the same machines under another control."""
    jobs = {}
    for key, job in study.jobs.items():
        loop = replace(job.loops[study.row], control=control)
        machines = dict(job.machines)
        if study.row in machines:
            whole = machines[study.row]
            machines[study.row] = whole.with_loops({**whole.loops(), loop.name: loop})
        jobs[key] = replace(job, loops={**job.loops, study.row: loop}, machines=machines)
    return replace(study, jobs=jobs)
