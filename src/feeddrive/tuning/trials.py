"""The loop over trials: run, learn, run again; the references may change from trial to trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Load, Plant, Reference
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.tuning.compensated import compensated, compensator
from feeddrive.tuning.iterative_feedforward import Iteration, iterate
from feeddrive.tuning.trial import Trial, simulated_trial

_RECORDED = ("following_error", "tracking_error", "force", "requested", "trip")


@dataclass(frozen=True, eq=False, repr=False)
class Trials(Result):
    """Trials one after another; trial j ran with the parameters that trial j - 1 taught.

    trials      what each showed
    iterations  what each but the last taught, so one fewer
    loops       the loop of each trial
    """

    trials: tuple[Trial, ...]
    iterations: tuple[Iteration, ...]
    loops: tuple[Loop, ...]

    @property
    def loop(self) -> Loop:
        """The loop of the last trial."""
        return self.loops[-1]

    @property
    def rms(self) -> np.ndarray:
        """Of the following error of each trial, m."""
        return np.array([trial.rms for trial in self.trials])

    def parameters(self) -> dict[str, np.ndarray]:
        """Values by name over the trials, SI."""
        blocks = [iteration.before for iteration in self.iterations]
        blocks.append(self.iterations[-1].after)
        return {name: np.array([block.parameters()[name] for block in blocks]) for name in blocks[0].parameters()}

    def errors(self) -> dict[str, np.ndarray]:
        """Standard errors by name over the trials, SI; NaN where a parameter was not learned in the trial before."""
        names = self.iterations[0].before.parameters()
        return {name: np.array([np.nan, *(i.errors.get(name, np.nan) for i in self.iterations)]) for name in names}

    def table(self) -> Table:
        """Error, prediction and parameters, a column for each trial."""
        declared = self.iterations[0].before
        predicted = ["-", *(f"{1e6 * each.predicted_rms:.4g}" for each in self.iterations[: len(self.trials) - 1])]
        rows = [
            ["RMS um", *(f"{1e6 * trial.rms:.4g}" for trial in self.trials)],
            ["predicted um", *predicted],
            ["peak um", *(f"{1e6 * trial.peak:.4g}" for trial in self.trials)],
        ]
        for name, values in self.parameters().items():
            unit = tree.declaration(declared, name).unit
            rows.append([f"{name} {unit}", *(f"{value:.5g}" for value in values[: len(self.trials)])])
        heads = ["trial", *(str(j + 1) for j in range(len(self.trials)))]
        form = self.iterations[0].form
        return Table(f"{len(self.trials)} trials, {form}; predicted: as if the reference stayed", heads, rows)


def iterate_trials(
    loop: Loop,
    references: Reference | Sequence[Reference],
    trials: int = 6,
    *,
    form: str = "model_free",
    gamma: float = 1.0,
    mu: float = 1e-9,
    columns: Sequence[str] | None = None,
    plant: Plant | None = None,
    least_mass: float = 0.0,
    saturation: str = "refused",
    believed: Loop | None = None,
    load: Callable[[int], Load] | Load | None = None,
    seed: int = 0,
) -> Trials:
    """Simulate trials, each with the parameters that the last one taught (`iterate` has the law and its arguments).

    references  one motion, or several that take turns from trial to trial
    trials      how many, >= 2
    believed    the loop whose gains the tuner believes in, if they are not those of the real one
    load        a force on the table, or a function of the trial's number, from 0 on, that gives one
    seed        of the noise; trial j has seed + j
    """
    if trials < 2:
        raise ParameterError(f"trials = {trials} must be >= 2: the first shows the error, the second what was learned")
    turns = (references,) if isinstance(references, Reference) else tuple(references)
    if not turns:
        raise ParameterError("references: at least one motion is needed")
    shown: list[Trial] = []
    learned: list[Iteration] = []
    loops = [loop]
    for j in range(trials):
        reference = turns[j % len(turns)]
        acting = load(j) if callable(load) else load
        name = f"trial {j + 1}"
        run = simulate(loop, reference, load=acting, seed=seed + j, record=_RECORDED, name=name)
        shown.append(simulated_trial(run, reference))
        if j == trials - 1:
            break
        tuner = loop if believed is None else compensated(believed, compensator(loop))
        found = iterate(
            tuner, shown[-1], form=form, gamma=gamma, mu=mu, columns=columns, plant=plant, least_mass=least_mass,
            saturation=saturation,
        )  # fmt: skip
        learned.append(found)
        loop = compensated(loop, found.after)
        loops.append(loop)
    return Trials(tuple(shown), tuple(learned), tuple(loops))
