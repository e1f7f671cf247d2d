"""How fast iterative feedforward converges, and whether: before the first trial, from models alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Plant, Reference
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples
from feeddrive.tuning.compensated import compensator
from feeddrive.tuning.error_model import error_model, filtered, true_error_model
from feeddrive.tuning.excitation import condition
from feeddrive.tuning.iterative_feedforward import regressors


@dataclass(frozen=True, eq=False, repr=False)
class Convergence(Result):
    """What a trial does to the error of the parameters: θ_next - θ0 = (I - gamma Ψ̂⁺ Ψ)(θ - θ0) + noise.

    matrix     I - gamma Ψ̂⁺ Ψ, in parameters that are scaled so that all columns have the same size
    condition  number of the believed columns
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    condition: float
    gamma: float

    @property
    def rate(self) -> float:
        """ρ: by what the error of the parameters is multiplied from trial to trial in the long run."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix)), initial=0.0))

    @property
    def converges(self) -> bool:
        """Whether ρ < 1."""
        return self.rate < 1.0

    def table(self) -> Table:
        """Rate, verdict and condition."""
        verdict = "converges" if self.converges else "DIVERGES: lower gamma"
        row = [", ".join(self.names), f"{self.gamma:g}", f"{self.rate:.3f}", f"{self.condition:.3g}", verdict]
        return Table("error of the parameters from trial to trial", ["columns", "gamma", "rho", "condition", ""], [row])


def convergence(
    loop: Loop,
    reference: Reference,
    *,
    believed: Loop | None = None,
    form: str = "model_free",
    gamma: float = 1.0,
    columns: Sequence[str] | None = None,
    plant: Plant | None = None,
    least_mass: float = 0.0,
) -> Convergence:
    """The rate at which `iterate` converges on a loop whose axis is known, with a tuner that believes in another.

        Ψ = G_d φ of the loop,   Ψ̂ = Ĝ_d φ of the believed one,   ρ = largest |eigenvalue| of I - gamma Ψ̂⁺ Ψ

    believed  the loop with the gains and parameters that the tuner takes for true; default: the loop itself

    The other arguments are those of `iterate`.  Friction is taken as fed forward along the set velocity, so that a
    slip of the real velocity is left out.
    Raises UnstableError for a model loop that is not stable, and ParameterError for a column that is 0 all along.
    Source: Wu, Han, Xiong & Ding 2017, section 3.
    """
    T = float(loop.sample_time)
    setpoint = reference.at(np.arange(samples(reference.duration, T)) * T)
    block = compensator(loop)
    names, phi, _ = regressors(loop, block, setpoint, columns)
    silent = [name for i, name in enumerate(names) if not np.any(phi[:, i])]
    if silent:
        raise ParameterError(f"columns: the reference does not excite {', '.join(silent)}: leave it out")
    true = filtered(true_error_model(loop), phi)
    guess = error_model(loop if believed is None else believed, form, plant=plant, least_mass=least_mass)
    seen = filtered(guess, phi)
    sizes = np.linalg.norm(seen, axis=0)
    learned = np.linalg.lstsq(seen / sizes, true / sizes, rcond=None)[0]
    return Convergence(tuple(names), np.eye(len(names)) - gamma * learned, condition(seen), gamma)
