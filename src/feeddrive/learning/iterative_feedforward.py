"""Iterative feedforward: the parameters of a feedforward compensator, corrected after each repetition of a motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Plant, Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.regression import solve, standard_errors
from feeddrive.language import tree
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError, StructureError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.learning.error_model import (
    condition,
    decay,
    error_model,
    filtered,
    not_excited,
    reasons,
    true_error_model,
)
from feeddrive.learning.trial import Trial, check_clock
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples

COLUMNS = tuple(name for name in declarations(DisturbanceCompensator) if name not in ("stribeck_velocity", "dead_band"))


def compensator(loop: Loop) -> DisturbanceCompensator:
    """Return the disturbance compensator of a loop. Raises StructureError if there is none, or more than one."""
    compensators = [block for block in loop.control.feedforward if isinstance(block, DisturbanceCompensator)]
    if len(compensators) != 1:
        what = "none" if not compensators else f"{len(compensators)} of them"
        raise StructureError(
            f"control.feedforward: iterative feedforward tunes the one disturbance_compensator of a control, and there "
            f"is {what}: add one with the parameters to tune, 0 for a start (`begin_compensation`)"
        )
    return compensators[0]


def compensated(loop: Loop, block: DisturbanceCompensator) -> Loop:
    """Return the loop with this compensator instead of its present one, or after its other feedforward."""
    others = tuple(
        block if isinstance(feedforward, DisturbanceCompensator) else feedforward
        for feedforward in loop.control.feedforward
    )
    if not any(feedforward is block for feedforward in others):
        others = (*others, block)
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, feedforward=others))


def begin_compensation(
    loop: Loop, columns: Sequence[str] | None = None, *, stribeck_velocity: float | None = None
) -> Loop:
    """Return the loop with an initial compensator: parameters at 0, or those that the loop feeds forward now.

    columns            names of its parameters; default: mass, viscous and both Coulomb levels, as far as the law does
                       not feed them forward itself
    stribeck_velocity  m/s, needed with the column `stribeck`

    An Inertia is taken over; an existing compensator keeps its values and gets the missing columns.
    Raises ParameterError for a column that is not known, and StructureError for a term that would be fed forward twice.
    """
    known = ", ".join(COLUMNS)
    for name in columns or ():
        if name not in COLUMNS:
            raise ParameterError(f"columns: there is no '{name}'; there are {known}")
    chosen = _usual(loop) if columns is None else tuple(columns)
    parameters: dict[str, float] = dict.fromkeys(chosen, 0.0)
    kept = []
    for block in loop.control.feedforward:
        if isinstance(block, Inertia):
            parameters |= {"mass": block.mass, "viscous": block.viscous}
        elif isinstance(block, DisturbanceCompensator):
            parameters |= block.parameters()
            stribeck_velocity = stribeck_velocity or block.stribeck_velocity
        else:
            kept.append(block)
    if "stribeck" in parameters and stribeck_velocity is None:
        raise ParameterError(
            "columns: 'stribeck' needs the velocity at which the extra level has fallen to 1/e (stribeck_velocity in "
            "m/s > 0 m/s): some mm/s on most guideways"
        )
    block = DisturbanceCompensator(
        **parameters, stribeck_velocity=stribeck_velocity if "stribeck" in parameters else None
    )
    control = dataclasses.replace(loop.control, feedforward=(*kept, block))
    return dataclasses.replace(loop, control=control)


def _usual(loop: Loop) -> tuple[str, ...]:
    own = {"acceleration": ("mass",), "velocity": ("viscous",), "friction": ("coulomb_positive", "coulomb_negative")}
    return tuple(name for what, names in own.items() if what not in loop.control.law.feeds for name in names)


SATURATION = ("refused", "left_out")
_LEAST_ROWS = 20  # least number of rows per column


@dataclass(frozen=True, eq=False, repr=False)
class Iteration(Result):
    """Result of one trial: the feedforward before and after, and the standard errors of its parameters.

    loop       the loop of the next trial
    errors     standard error of each tuned parameter, of the full step (gamma = 1), SI
    frozen     parameters that keep their value, with the reason
    held       parameters that are held by their bound
    predicted  following error of the next trial along the same reference, m, shape (n,)
    condition  number of the columns that were used, scaled to the same size
    """

    trial: Trial
    before: DisturbanceCompensator
    after: DisturbanceCompensator
    loop: Loop
    form: str
    gamma: float
    errors: Mapping[str, float]
    frozen: Mapping[str, str]
    held: tuple[str, ...]
    predicted: np.ndarray
    condition: float
    remarks: tuple[str, ...] = ()

    @property
    def predicted_rms(self) -> float:
        """The RMS of the next trial's following error along the same reference, m."""
        return float(np.sqrt(np.mean(self.predicted**2)))

    def table(self) -> Table:
        """Parameters now and next, each with its standard error or with the reason why it is held."""
        rows = []
        was, now = self.before.parameters(), self.after.parameters()
        for name, value in was.items():
            unit = tree.declaration(self.before, name).unit
            values = [None if v is None else Quantity(v, unit) for v in (value, now[name], self.errors.get(name))]
            remark = "frozen" if name in self.frozen else "at its bound" if name in self.held else ""
            rows.append([name, UNIT, *values, remark])
        title = Text(
            f"{self.trial.name}: error {Quantity(self.trial.rms, 'm')} RMS, next along the same reference "
            f"{Quantity(self.predicted_rms, 'm')} predicted; {self.form}, gamma {Quantity(self.gamma):6}, condition "
            f"{Quantity(self.condition):3}"
        )
        now_next = [Column(head, form="6 SI") for head in ("now", "next")]
        return Table(title, ["parameter", "unit", *now_next, Column("standard error", form="2 SI"), ""], rows)


def next_iteration(
    loop: Loop,
    trial: Trial,
    *,
    form: str = "model_free",
    gamma: float = 1.0,
    mu: float = 1e-9,
    columns: Sequence[str] | None = None,
    plant: Plant | None = None,
    least_mass: float = 0.0,
    saturation: str = "refused",
    skip: int = 0,
) -> Iteration:
    """Return the feedforward parameters for the next trial, from the error of this one.

        Ψ = Ĝ_d φ,   θ_next = θ + gamma (ΨᵀΨ + mu S²)⁻¹ Ψᵀ e,   S scales the columns of Ψ to the same size

    `loop` is the loop that ran the trial, with its present parameters in a DisturbanceCompensator; its control must be
    the real one, its axis is used only where `form` or a frozen model needs it.  The next reference may be another.

    form        "model_free", "model_based" or "axis_model", see `error_model`
    gamma   share of the step that is taken, 0 < gamma <= 1; at most 0.5 if the controller's gains are known only
                roughly: the error of the parameters is multiplied by about |1 - gamma · true gain/believed gain|
    mu          >= 0; reduces the step in directions that the trial hardly excites
    columns     names of the parameters to tune; default: all that the block has.  Parameters that a trial does not
                excite are frozen: friction without a reversal, columns that are 0, columns that others explain
    plant       for the model-based form: the axis to assume
    least_mass  kg; the mass stays above it; all parameters keep the bounds of their declaration
    saturation  "refused", or "left_out": saturated samples, and those until their effect has decayed, do not count
    skip        samples at the start that do not count, for a log that starts in motion

    The standard errors take the residual as noise with its own autocorrelation; they do not include the bias of a wrong
    Ĝ_d, which further trials remove.
    Raises LogError for a trial without information (saturated, too short, no column excited) or whose clock is not the
    controller's, ParameterError for values out of bounds, UnstableError for a model loop that is not stable.
    Source: Wu, Han, Xiong & Ding 2017, section 3: parameters from the error of a trial.  The text was available up to
    eq. (10): Ĝ_d, the scaled and damped step, its bounds, frozen columns and standard errors are this library's.
    """
    _check(loop, trial, gamma, mu, saturation)
    block = compensator(loop)
    model = error_model(loop, form, plant=plant, least_mass=least_mass)
    names, phi, velocity = regressors(loop, block, trial.setpoint, columns)
    seen = filtered(model, phi, moving=trial.starts_moving)
    rows = _rows(trial, decay(model), saturation, skip)
    frozen = dict.fromkeys((name for name in block.parameters() if name not in names), "not asked for")
    frozen |= not_excited(names, phi[rows], seen[rows], velocity[rows], float(block.dead_band))
    active = [i for i, name in enumerate(names) if name not in frozen]
    if not active:
        raise NotIdentifiableError(f"{trial.name}: identifies no parameter. {reasons({n: frozen[n] for n in names})}")
    left, needed = int(np.count_nonzero(rows)), _LEAST_ROWS * len(active)
    if left < needed:
        raise LogError(
            f"{trial.name}: {left} samples are left for {len(active)} parameters, {needed - left} too few; at least "
            f"{needed} are needed"
        )
    now = np.array([float(block.parameters()[names[i]]) for i in active])
    least = np.array([_least(block, names[i], least_mass) for i in active])
    used, error = seen[rows][:, active], trial.following_error[rows]
    step, held = solve(used, error, mu, least - now, np.full(now.size, np.inf))
    sigma = standard_errors(used, error - used @ step, 2 * decay(model))
    changed = {names[i]: float(value) for i, value in zip(active, np.maximum(now + gamma * step, least), strict=True)}
    after = dataclasses.replace(block, **changed)
    taken = np.array([changed[names[i]] for i in active]) - now
    return Iteration(
        trial=trial,
        before=block,
        after=after,
        loop=compensated(loop, after),
        form=form,
        gamma=gamma,
        errors={names[i]: float(s) for i, s in zip(active, sigma, strict=True)},
        frozen=frozen,
        held=tuple(names[i] for i, is_held in zip(active, held, strict=True) if is_held),
        predicted=trial.following_error - seen[:, active] @ taken,
        condition=condition(used),
        remarks=(*trial.remarks, *_remarks(loop)),
    )


def regressors(
    loop: Loop, block: DisturbanceCompensator, setpoint: Setpoint, columns: Sequence[str] | None = None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return names, φ of shape (n, columns), and the set velocity (m/s) in the middle of the samples.

    They are computed by the code of the block, on the setpoint after the prefilter.
    """
    known = block.parameters()
    names = list(known if columns is None else columns)
    for name in names:
        if name not in known:
            raise ParameterError(
                f"columns: the feedforward has no parameter '{name}'; it has {', '.join(known) or 'none'}: give it a "
                f"value, 0 for a start"
            )
    T = float(loop.sample_time)
    seen = _prefiltered(loop, setpoint)
    count = np.asarray(seen.position).size
    regressors = block.regressors(seen, T)
    phi = (
        np.column_stack([np.broadcast_to(regressors[name], count) for name in names]) if names else np.zeros((count, 0))
    )
    return names, phi.astype(np.float64), np.asarray(seen.shifted(0.5 * T).velocity, dtype=np.float64)


def _prefiltered(loop: Loop, setpoint: Setpoint) -> Setpoint:
    """Return the setpoint as law and feedforward see it."""
    prefilter = loop.control.prefilter
    if prefilter is None:
        return setpoint
    rows = np.column_stack([np.asarray(row, dtype=np.float64) for row in setpoint])
    T = np.float64(loop.sample_time)
    first = Setpoint(*rows[0])
    state = prefilter.start(first)
    out = np.empty_like(rows)
    for k, row in enumerate(rows):
        state, moved = prefilter.step(state, Setpoint(*row), T)
        out[k] = [float(value) for value in moved]
    return Setpoint(*out.T)


def _check(loop: Loop, trial: Trial, gamma: float, mu: float, saturation: str) -> None:
    if not 0.0 < gamma <= 1.0:
        raise ParameterError(f"gamma = {number(gamma, 6)} must be > 0 and <= 1")
    if not 0.0 <= mu < np.inf:
        raise ParameterError(f"mu = {number(mu, 6)} must be a finite number >= 0")
    if saturation not in SATURATION:
        raise ParameterError(f"saturation = {saturation!r} must be one of {', '.join(SATURATION)}")
    check_clock(trial.name, trial.sample_time, float(loop.sample_time))


def _rows(trial: Trial, after: int, saturation: str, skip: int) -> np.ndarray:
    """Return a mask of the samples that are used."""
    n = trial.following_error.size
    if not 0 <= skip < n:
        raise ParameterError(f"skip = {skip} samples must be >= 0 and < {n}, the length of the trial")
    counted = np.ones(n, dtype=bool)
    counted[:skip] = False
    saturated = trial.saturated
    if saturated is None or not np.any(saturated[counted]):
        return counted
    first = int(np.argmax(saturated & counted))
    if saturation == "refused":
        raise LogError(
            f"{trial.name}: the force was limited in {int(np.sum(saturated & counted))} samples, the first at "
            f"{Quantity(first * trial.sample_time, 's'):6 SI}; 0 are admitted, since the error then says nothing of "
            "the feedforward: take a slower reference, or leave these samples out (saturation = 'left_out')"
        )
    for k in np.flatnonzero(saturated):
        counted[k : k + after] = False
    return counted


def _least(block: DisturbanceCompensator, name: str, least_mass: float) -> float:
    """Return the lower bound of a parameter."""
    declared = tree.declaration(block, name).least
    least = -np.inf if declared is None else declared
    return max(least, least_mass) if name == "mass" else least


def _remarks(loop: Loop) -> list[str]:
    """Return remarks on the control that concern the meaning of the parameters."""
    law, remarks = loop.control.law, list[str]()
    share = dict(tree.leaves(law)).get("velocity_feedforward")
    if share is not None and share != 1.0:
        remarks.append(
            f"the law feeds {number(share)} of the set velocity forward and not all of it, so that `viscous` and "
            "`mass` also compensate for the missing part: they are not properties of the axis, and are valid for "
            "these gains only"
        )
    if law.period() > 1:
        remarks.append(
            f"the slow part of the law runs every {law.period()} samples, so that its command comes late, and `mass` "
            f"and `viscous` also compensate for that: they are not properties of the axis, and are valid for these "
            f"gains and rates only"
        )
    return remarks


@dataclass(frozen=True, eq=False, repr=False)
class Convergence(Result):
    """The effect of a trial on the error of the parameters: θ_next - θ0 = (I - gamma Ψ̂⁺ Ψ)(θ - θ0) + noise.

    matrix     I - gamma Ψ̂⁺ Ψ, in parameters that are scaled so that all columns have the same size
    condition  condition number of the assumed columns
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    condition: float
    gamma: float

    @property
    def rate(self) -> float:
        """The factor ρ by which the error of the parameters changes from trial to trial in the long run."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix)), initial=0.0))

    @property
    def converges(self) -> bool:
        """True if ρ < 1."""
        return self.rate < 1.0

    def table(self) -> Table:
        """Rate, verdict and condition."""
        verdict = "converges" if self.converges else "DIVERGES: lower gamma"
        row = [", ".join(self.names), self.gamma, self.rate, self.condition, verdict]
        columns = ["columns", "gamma", Column("rho", form=".3f"), Column("condition", form="3"), ""]
        return Table("error of the parameters from trial to trial", columns, [row])


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
    """Return the rate at which `iterate` converges on a loop with a known axis, with a tuner that assumes another axis.

        Ψ = G_d φ of the loop,   Ψ̂ = Ĝ_d φ of the believed one,   ρ = largest |eigenvalue| of I - gamma Ψ̂⁺ Ψ

    believed  the loop with the gains and parameters that the tuner takes for true; default: the loop itself

    The other arguments are those of `iterate`.  Friction is taken as fed forward along the set velocity, so that a
    slip of the real velocity is left out.
    Raises UnstableError for a model loop that is not stable, and ParameterError for a column that is 0 all along.
    Source: this library's, for the step of `iterate`; the text of Wu, Han, Xiong & Ding 2017 at hand ends at
    eq. (10) and states no rate.
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


_RECORDED = ("following_error", "tracking_error", "force", "requested", "trip")
