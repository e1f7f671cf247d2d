"""Iterative feedforward: the error model, and the correction of the parameters after each repetition of a motion."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.families import Plant, Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.regression import solve, standard_errors
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError, StructureError, UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.learning.at_rest import filtered_held, force_unknown
from feeddrive.learning.axis_values import LEVELS, NORMAL_90, Seen, axis_values
from feeddrive.learning.trial import Trial, check_clock
from feeddrive.loop.linearize import Lifted, StateSpace, linear_model
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples

FORMS = ("model_free", "model_based", "axis_model")
_TINY = 1e-6  # of the axis's mass: replaces a mass of 0, which a plant refuses
_ENDS = ("motor", "load")
_EDGE = 1.0 - 1e-9  # of |z|: the uncertainty of eigenvalues of a small matrix
_DECADES, _STRIDE = 7.0, 0.1  # range and resolution of the search for an admissible mass


def error_model(
    loop: Loop, form: str = "model_free", *, plant: Plant | None = None, least_mass: float = 0.0
) -> StateSpace | Lifted:
    """Return the sampled error model Ĝ_d from the force that the feedforward lacks (N) to the following error (m).

        e = x_set - x = G_d [φᵀ (θ0 - θ) + w],   G_d = P / (1 + P C)

    with plant P, controller C, regressors φ, parameters θ, their ideal values θ0 and a disturbance force w.

    model_free   Ĝ_d = 1/C: the inverse of the controller, from its gains alone.  It is accurate where |P C| >> 1, as in
                 the band of usual references.  Prefilter and filters are neglected: they are close to 1 there.
    model_based  Ĝ_d = P̂/(1 + P̂ C) with the drive's dead time and current loop.  P̂ is `plant`, if given; otherwise a
                 rigid axis with the mass (at least `least_mass`, kg) and the viscous friction that are currently fed
                 forward; or, if no mass is fed forward or the law needs two encoders, the axis of the loop.
    axis_model   As model_based, with the axis of the loop as P̂, for a machine file with an identified axis.

    For any law, C is the linear model of the simulated controller code. For a multirate law, Ĝ_d has one model for each
    sample of a period, and feedforward, regressors and error are taken at the fast samples.  A trial is assumed to
    begin at a sample at which the slow part of the law runs; a different first sample makes almost no difference.
    Raises UnstableError if the model loop is not stable, with the nearest admissible mass, or if the controller has no
    stable inverse; ParameterError for an unknown form.
    Source: Wu, Han, Xiong & Ding 2017, eq. (1)-(10), which is the part of the paper that was available; the three forms
    of Ĝ_d, including the model-free inverse, and the sampled form are this library's.
    """
    if form not in FORMS:
        raise ParameterError(f"form = {form!r} must be one of {', '.join(FORMS)}")
    if form == "model_free":
        return _inverse(loop)
    if form == "axis_model":
        return true_error_model(loop)
    block = next((block for block in loop.control.feedforward if isinstance(block, DisturbanceCompensator)), None)
    if plant is not None or block is None or block.mass is None or loop.control.law.positions() > 1:
        return _required(loop, plant)
    mass = max(block.mass, least_mass, _TINY * float(loop.axis.plant.rigid_mass()))
    return _required(loop, Rigid(mass=mass, viscous=block.viscous or 0.0))


def true_error_model(loop: Loop) -> StateSpace | Lifted:
    """Return the true G_d of a loop, with viscous friction only and without quantization, for comparison with Ĝ_d."""
    return _required(loop, None)


def _samples(model: StateSpace | Lifted) -> tuple[StateSpace, ...]:
    return model.samples if isinstance(model, Lifted) else (model,)


def filtered(model: StateSpace | Lifted, columns: np.ndarray, *, moving: bool = False) -> np.ndarray:
    """Filter columns, shape (n, columns), through a model with one input and one output.

    Row 0 is the first sample of the model's period.  Before row 0, the columns are assumed to be 0 or, with `moving`,
    to have the values of row 0.
    """
    samples = _samples(model)
    N, n = len(samples), samples[0].A.shape[0]
    state = np.zeros((n, columns.shape[1]))
    # the periodic state that a constant column has reached: x = through x + pushed
    if moving and n:
        through, pushed = np.eye(n), state
        for sample in samples:
            through, pushed = sample.A @ through, sample.A @ pushed + sample.B[:, :1] @ columns[:1]
        state = np.linalg.solve(np.eye(n) - through, pushed)
    states = np.empty((columns.shape[0], n, columns.shape[1]))
    for k, row in enumerate(columns):
        states[k] = state
        state = samples[k % N].A @ state + row * samples[k % N].B[:, :1]
    outputs = np.empty(columns.shape)
    for k, sample in enumerate(samples):
        output = (sample.C[:1] @ states[k::N])[:, 0, :] + sample.D[0, 0] * columns[k::N]
        outputs[k::N] = output
    return outputs


def decay(model: StateSpace | Lifted, share: float = 0.01) -> int:
    """Return the number of samples after which the slowest mode of a model has decayed to the fraction `share`."""
    slowest = _growth(model)
    # at the edge of stability ln 1 = 0 would divide
    turns = 1.0 if slowest <= 0.0 else np.log(share) / np.log(min(slowest, 1.0 - 1e-9))
    return max(1, len(_samples(model)) * int(np.ceil(turns)))


def _required(loop: Loop, plant: Plant | None) -> StateSpace | Lifted:
    """Return G_d of the loop with `plant` as its plant or, if that is None, with its own axis and viscous friction.

    Raises UnstableError if this loop is not stable.
    """
    model = _closed(loop, plant)
    size = _growth(model)
    if size < _EDGE:
        return model
    reason = f"is not stable: |z| = {Quantity(size):.6f} must be < 1, it is {number(size - 1.0, 2)} too large"
    near = None if not isinstance(plant, Rigid) else _nearest(loop, plant)
    if near is None or not isinstance(plant, Rigid):
        what = "the axis" if plant is None else f"the plant '{plant.kind}'"
        raise UnstableError(f"the model loop with {what} {reason}: these gains are not those of a loop with this axis")
    raise UnstableError(
        f"the model loop with a mass of {Quantity(plant.mass, 'kg')} {reason}; the nearest admissible mass is "
        f"{Quantity(near, 'kg')}: start from another mass, give the plant, or take form = 'model_free', which needs no "
        "mass"
    )


def _closed(loop: Loop, plant: Plant | None) -> StateSpace | Lifted:
    """Return the linear closed loop from a force added after the force limit to the position."""
    control = dataclasses.replace(loop.control, guard=None, force_limit=None, feedforward=(), prefilter=None)
    # counts have no slope and Coulomb friction is a jump: an ideal encoder and the viscous part are left of them
    ends: dict[str, Any] = {
        f"encoder_{end}": None if getattr(loop.axis, f"encoder_{end}") is None else Encoder() for end in _ENDS
    }
    for end in _ENDS:
        friction = getattr(loop.axis, f"friction_{end}") if plant is None else None
        ends[f"friction_{end}"] = None if friction is None else Viscous(viscous=float(friction.linear()))
    axis = dataclasses.replace(loop.axis, plant=plant or loop.axis.plant, forces=(), **ends)
    return linear_model(dataclasses.replace(loop, control=control, axis=axis), ["added_force"], ["position_load"])


def _growth(model: StateSpace | Lifted) -> float:
    """Return the largest pole magnitude |z| of a model over one period."""
    return float(np.max(np.abs(model.poles()), initial=0.0))


def _nearest(loop: Loop, plant: Rigid) -> float | None:
    """Return the mass, to four digits, that stabilizes the model loop and is closest in ratio to that of the plant."""
    mass = plant.mass

    def stable(log: float) -> bool:
        return _growth(_closed(loop, tree.vary(plant, {"mass": mass * 10.0**log}))) < _EDGE

    grid = np.arange(_STRIDE, _DECADES, _STRIDE)
    for away in grid:
        # heavier and lighter in turn, so that the first stable mass is the nearest by ratio
        for sign in (1.0, -1.0):
            if stable(sign * away):
                low, high = away - _STRIDE, away
                # 14 halvings of a tenth of a decade: four digits
                for _ in range(14):
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if stable(sign * middle) else (middle, high)
                return mass * 10.0 ** (sign * high)
    return None


def _inverse(loop: Loop) -> StateSpace | Lifted:
    """Return 1/C, where C is the response of the force to a common shift of both encoder readings."""
    control = dataclasses.replace(
        loop.control, guard=None, force_limit=None, feedforward=(), prefilter=None, filters=()
    )
    bare = dataclasses.replace(loop, control=control)
    samples = _samples(linear_model(bare, ["cut", "reading_motor", "reading_load"], ["force"]))
    push = [sample.B[:, 1:2] + sample.B[:, 2:3] for sample in samples]
    n = push[0].shape[0]
    # states that no reading reaches belong to the axis: their poles would count as zeros of the controller
    reached = np.any([column != 0.0 for column in push], axis=(0, 2))
    for _ in range(n):
        reached = reached | np.any([sample.A[:, reached] != 0.0 for sample in samples], axis=(0, 2))
    keep = np.flatnonzero(reached)
    names = tuple(samples[0].states[i] for i in keep)
    # a law that does not answer a reading in the same sample has no causal inverse, which the empty list refuses
    passed = [float(sample.D[0, 1] + sample.D[0, 2]) for sample in samples]
    inverse: list[StateSpace] = []
    # the force answers the reading by -C; solved for the reading it is the inverse, with the sign of G_d
    for sample, b, d in zip(samples, push, passed if all(passed) else [], strict=False):
        back, seen = b[keep] / d, sample.C[:, keep]
        whole = sample.A[np.ix_(keep, keep)] - b[keep] @ seen / d
        rest = seen / d, np.array([[-1.0 / d]]), sample.sample_time, names, ("added_force",), ("position_load",)
        inverse.append(StateSpace(whole, back, *rest))
    inverse_model = inverse[0] if len(inverse) == 1 else Lifted(tuple(inverse))
    size = _growth(inverse_model) if inverse else np.inf
    if not size < _EDGE:
        raise UnstableError(
            f"the controller '{loop.control.law.kind}' has no stable inverse: |z| = {Quantity(size):.6f} of its zeros "
            "must be < 1: take form = 'model_based'"
        )
    return inverse_model


LEAST_REVERSAL = 0.02  # share of the moving samples in each direction that separates friction from gravity
LEAST_OWN = 0.02  # of a column's size: least part not explained by other columns, 1/50: there its error grows by 50
FRICTION = ("coulomb_positive", "coulomb_negative", "stribeck")
# of two similar columns the later one in this order is frozen
_ORDER = (
    "mass",
    "coulomb_positive",
    "coulomb_negative",
    "viscous",
    "stribeck",
    "jerk_feedforward",
    "snap_feedforward",
)


def not_excited(
    names: Sequence[str], columns: np.ndarray, seen: np.ndarray, velocity: np.ndarray, dead_band: float
) -> dict[str, str]:
    """Return the parameters that must be frozen because a trial does not excite them, with the reason for each.

    columns   φ, the regressors of the set motion, shape (samples, columns)
    seen      Ψ, the regressors filtered by Ĝ_d: their effect on the error, same shape
    velocity  set velocity in the middle of the samples, m/s
    """
    reasons = _without_reversal(names, velocity, dead_band)
    for i, name in enumerate(names):
        if name not in reasons and not np.any(columns[:, i]):
            reasons[name] = "its column is 0 in the whole trial"
    sizes = np.linalg.norm(seen, axis=0)
    alike = (seen / np.where(sizes > 0.0, sizes, 1.0)).T @ (seen / np.where(sizes > 0.0, sizes, 1.0))
    kept: list[int] = []
    for name in sorted((name for name in names if name not in reasons), key=_ORDER.index):
        i = names.index(name)
        left = _own(alike, i, kept)
        if left < LEAST_OWN:
            nearest = names[max(kept, key=lambda k: abs(float(alike[i, k])))] if kept else "none"
            reasons[name] = Text(
                f"only {Quantity(left, 'share'):2} of its column is not explained by "
                f"{_listed([names[k] for k in kept])}, at least {Quantity(LEAST_OWN, 'share'):6} is needed; it is most "
                f"like {nearest}: add a second speed, or more acceleration"
            )
        else:
            kept.append(i)
    return reasons


def _own(alike: np.ndarray, i: int, others: list[int]) -> float:
    """Return the norm of the part of unit column i that is orthogonal to `others`, from all inner products `alike`."""
    if alike[i, i] <= 0.0:
        return 0.0
    across = alike[others, i]
    between = alike[others][:, others]
    explained = float(across @ np.linalg.solve(between, across)) if others else 0.0
    return float(np.sqrt(max(0.0, 1.0 - explained)))


def _without_reversal(names: Sequence[str], velocity: np.ndarray, dead_band: float) -> dict[str, str]:
    forward, backward = int(np.sum(velocity > dead_band)), int(np.sum(velocity < -dead_band))
    moving = forward + backward
    # in one direction alone, Coulomb friction and gravity are the same constant
    share = min(forward, backward) / moving if moving else 0.0
    if share >= LEAST_REVERSAL:
        return {}
    towards = "smaller" if backward <= forward else "larger"
    missing = int(np.ceil(LEAST_REVERSAL * moving)) - min(forward, backward)
    reason = Text(
        f"the trial has no reversal: {Quantity(share, 'share'):2} of its moving samples go towards {towards} "
        f"positions, at least {Quantity(LEAST_REVERSAL, 'share'):6} are needed ({missing} samples more), else friction "
        "cannot be told from gravity or an offset"
    )
    if moving == 0:
        reason = "the axis does not move in the trial"
    return {name: reason for name in names if name in FRICTION or moving == 0}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def condition(seen: np.ndarray) -> float:
    """Return the condition number of a matrix after its columns are scaled to equal norm; 1 without columns."""
    if not seen.shape[1]:
        return 1.0
    return float(np.linalg.cond(seen / np.linalg.norm(seen, axis=0)))


def reasons(frozen: Mapping[str, str]) -> str:
    """Return the frozen parameters and their reasons as one string."""
    return joined("; ", [f"{name}: {reason}" for name, reason in frozen.items()])


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
    """Return the loop with its compensator replaced by this one or, if it has none, with this one added."""
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
    """Return the loop with an initial compensator, whose parameters are 0 or equal to the values already fed forward.

    columns            names of its parameters; default: mass, viscous friction and both Coulomb levels, except those
                       that the law itself feeds forward
    stribeck_velocity  Stribeck velocity, m/s, required for the column `stribeck`

    The compensator takes over the values of an Inertia block, which it replaces; an existing compensator keeps its
    values, and missing columns are added.
    Raises ParameterError for an unknown column, and StructureError if a term would be fed forward twice.
    """
    for name in columns or ():
        if name not in COLUMNS:
            raise ParameterError(f"columns: there is no '{name}'; there are {', '.join(COLUMNS)}")
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
    by_term = {
        "acceleration": ("mass",),
        "velocity": ("viscous",),
        "friction": ("coulomb_positive", "coulomb_negative"),
    }
    return tuple(name for what, names in by_term.items() if what not in loop.control.law.fed() for name in names)


SATURATION = ("refused", "left_out")
AT_REST = ("held", "none")
# with fewer the standard errors rest on a handful of independent residuals
_LEAST_ROWS = 20  # least number of rows per column


@dataclass(frozen=True, eq=False, repr=False)
class Iteration(Result):
    """The result of one trial: the feedforward before and after, and the standard errors of its parameters.

    loop       the loop of the next trial
    errors     standard error of each tuned parameter after a full step (gamma = 1) as an estimate of the true value,
               including model error, SI
    intervals  90 % interval of the true value of each tuned parameter, SI; empty for `at_rest` "none"
    frozen     parameters that keep their value, and the reason for each
    held       parameters at their bound
    predicted  predicted following error of the next trial along the same reference, m, shape (n,)
    condition  condition number of the columns used, after scaling to equal norm
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
    intervals: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)

    @property
    def predicted_rms(self) -> float:
        """The predicted RMS of the next trial's following error along the same reference, m."""
        return float(np.sqrt(np.mean(self.predicted**2)))

    def table(self) -> Table:
        """Return a table of the present and next parameters, with standard errors and remarks."""
        rows = []
        was, now = self.before.parameters(), self.after.parameters()
        for name, value in was.items():
            unit = tree.declaration(self.before, name).unit
            values = [None if v is None else Quantity(v, unit) for v in (value, now[name], self.errors.get(name))]
            remark = "frozen" if name in self.frozen else "at its bound" if name in self.held else ""
            interval = None if name not in self.intervals else _interval(self.intervals[name], unit)
            rows.append([name, UNIT, *values, *([interval] if self.intervals else []), remark])
        title = Text(
            f"{self.trial.name}: error {Quantity(self.trial.rms, 'm')} RMS, next along the same reference "
            f"{Quantity(self.predicted_rms, 'm')} predicted; {self.form}, gamma {Quantity(self.gamma):6}, condition "
            f"{Quantity(self.condition):3}"
        )
        now_next = [Column(head, form="6 SI") for head in ("now", "next")]
        heads = [*now_next, Column("standard error", form="2 SI"), *(["axis, 90 %"] if self.intervals else [])]
        return Table(title, ["parameter", "unit", *heads, ""], rows)


def _interval(bounds: tuple[float, float], unit: str) -> Text:
    low, high = (Quantity(bound, unit, form="4 SI", bare=True) for bound in bounds)
    return Text(f"{low} .. {high}")


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
    at_rest: str = "held",
) -> Iteration:
    """Compute the feedforward parameters for the next trial from the following error of this one.

        Ψ = Ĝ_d φ,   θ_next = θ + gamma (ΨᵀΨ + mu S²)⁻¹ Ψᵀ e,   S scales the columns of Ψ to the same size

    `loop` is the loop that ran the trial, with its present parameters in a DisturbanceCompensator.  Its controller must
    be the one that ran the trial; its axis is used only if `form` needs it.  The next reference may differ.

    form        "model_free", "model_based" or "axis_model", see `error_model`
    gamma       fraction of the step that is applied, 0 < gamma <= 1.  Use at most 0.5 if the controller's gains are
                known only roughly: each step multiplies the parameter error by about |1 - gamma · true/assumed gain|
    mu          >= 0; reduces the step in directions that the trial hardly excites
    columns     names of the parameters to tune; default: all parameters of the block.  Parameters that a trial does not
                excite are frozen: friction if no reversal occurs, and columns that are 0 or nearly dependent on others
    plant       the plant to assume in the model-based form
    least_mass  lower bound of the mass, kg; all parameters also stay within their declared bounds
    saturation  "refused": a trial with saturation raises LogError; "left_out": saturated samples, and those after them
                until their effect has decayed, are ignored
    skip        number of samples to ignore at the start, for a log that starts in motion

    at_rest     friction at rest. "held": an unknown force that holds the axis; the samples at rest then only determine
                the integral of the law (`filtered_held`). "none", as in the paper: 0, like the regressors; the error
                due to stiction then biases the parameters

    With "held", both Coulomb levels change by the same amount unless the trial determines their difference: in motion
    the difference is a constant force, which the integral compensates, and at rest friction balances any force. Only
    the force at the start of the trial (`Trial.force`) reveals the difference, which includes any constant force, such
    as gravity.  `errors` and `intervals` then include the model error, see `axis_values`. With "none", the standard
    errors treat the residual as autocorrelated noise and do not include bias.
    Raises LogError if the trial contains no information (saturated, too short, no column excited) or its sample time is
    not the controller's, ParameterError for values out of bounds, UnstableError if the model loop is not stable.
    Source: Wu, Han, Xiong & Ding 2017, section 3: parameters from the error of a trial.  Only the part of the paper up
    to eq. (10) was available; Ĝ_d, the scaled and damped step, its bounds, friction at rest, frozen columns and errors
    are this library's.
    """
    _check(loop, trial, gamma, mu, saturation, at_rest)
    block = compensator(loop)
    model = error_model(loop, form, plant=plant, least_mass=least_mass)
    names, phi, velocity = regressors(loop, block, trial.setpoint, columns)
    trip = _Trip(loop, block, trial, velocity, at_rest)
    nuisance = trip.nuisance() if at_rest == "held" else np.zeros((velocity.size, 0))
    seen, error, start = trip.through(model, np.column_stack([phi, nuisance]))
    counted = ~trip.unknown & _rows(trial, decay(model), saturation, skip)
    frozen = dict.fromkeys((name for name in block.parameters() if name not in names), "not asked for")
    frozen |= not_excited(names, phi[counted], seen[counted, : len(names)], velocity[counted], float(block.dead_band))
    active = [i for i, name in enumerate(names) if name not in frozen]
    if not active:
        raise NotIdentifiableError(f"{trial.name}: identifies no parameter. {reasons({n: frozen[n] for n in names})}")
    left, needed = int(np.count_nonzero(counted)), _LEAST_ROWS * len(active)
    if left < needed:
        raise LogError(
            f"{trial.name}: {left} samples are left for {len(active)} parameters, {needed - left} too few; at least "
            f"{needed} are needed"
        )
    chosen = [names[i] for i in active]
    now = np.array([float(block.parameters()[name]) for name in chosen])
    least = np.array([_least(block, name, least_mass) for name in chosen])
    used = seen[counted][:, active]
    # a law without integral has forgotten its first force when the motion begins
    first_force = start if start is not None and _matters(start[counted], used) else None

    def stepped(together: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _step(
            used, error[counted], mu, least - now, together, None if first_force is None else first_force[counted]
        )

    if at_rest == "held":
        step, held = stepped(_levels_together(chosen))

        def in_sight(model: StateSpace | Lifted, seen: np.ndarray, error: np.ndarray, start: np.ndarray | None) -> Seen:
            timing, bump = seen[counted, len(names) : len(names) + 1], seen[counted, len(names) + 1 :]
            timing = timing if "jerk_feedforward" not in chosen else timing[:, :0]
            bump = bump if any(name in FRICTION for name in chosen) and "stribeck" not in chosen else bump[:, :0]
            begun = None if start is None or first_force is None else start[counted]
            return Seen(
                seen[counted][:, active], timing, bump, error[counted], begun, 2 * decay(model), trial.force_error
            )

        first = better = in_sight(model, seen, error, start)
        likely = compensated(loop, _changed(block, chosen, np.maximum(now + step, least)))
        other = None if form == "axis_model" or plant is not None else _likely_model(likely)
        if other is not None:
            better = in_sight(other, *trip.through(other, np.column_stack([phi, nuisance])))
        axis = axis_values(chosen, now, first, better)
        if axis.asymmetric:
            step, held = stepped(np.eye(len(active)))
        sigma, remarks = np.hypot(axis.half / NORMAL_90, now + step - axis.value), axis.remarks
        bounds = zip(chosen, np.maximum(axis.value - axis.half, least), axis.value + axis.half, strict=True)
        intervals = {name: (float(low), float(max(low, high))) for name, low, high in bounds}
    else:
        step, held = stepped(np.eye(len(active)))
        # the loop colors the noise: its residual stays correlated as long as the slowest mode rings
        sigma, remarks = standard_errors(used, error[counted] - used @ step, 2 * decay(model)), ()
        intervals = {}
    # the bound again: a rounded step could end a little below it, which the constructor refuses
    changed = {name: float(value) for name, value in zip(chosen, np.maximum(now + gamma * step, least), strict=True)}
    after = dataclasses.replace(block, **changed)
    taken = np.array(list(changed.values())) - now
    return Iteration(
        trial=trial,
        before=block,
        after=after,
        loop=compensated(loop, after),
        form=form,
        gamma=gamma,
        errors={name: float(s) for name, s in zip(chosen, sigma, strict=True)},
        frozen=frozen,
        held=tuple(name for name, is_held in zip(chosen, held, strict=True) if is_held),
        predicted=trial.following_error - filtered(model, phi[:, active], moving=trial.starts_moving) @ taken,
        condition=condition(used),
        remarks=(*trial.remarks, *_remarks(loop), *remarks),
        intervals=intervals,
    )


def _changed(block: DisturbanceCompensator, names: Sequence[str], values: np.ndarray) -> DisturbanceCompensator:
    """Return the compensator with these values of the named parameters."""
    return dataclasses.replace(block, **{name: float(value) for name, value in zip(names, values, strict=True)})


def _levels_together(names: Sequence[str]) -> np.ndarray:
    """Return the matrix of steps in which both Coulomb levels, if present, change by the same amount."""
    matrix = np.eye(len(names))
    if not set(LEVELS) <= set(names):
        return matrix
    plus, minus = (list(names).index(level) for level in LEVELS)
    matrix[minus, plus] = 1.0
    return np.delete(matrix, minus, axis=1)


def _step(
    used: np.ndarray, error: np.ndarray, mu: float, room: np.ndarray, together: np.ndarray, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounded step of all parameters and the active bounds; `room` is the lower bound of each step, <= 0.

    Each column of `together` changes one or several parameters; `start` is the response to an unknown force of the
    feedback at the first sample, which is also fitted.
    """
    columns = used @ together
    # the lowest step of a column is that of the parameter which reaches its bound first
    least = np.array([float(np.max(room[column != 0.0])) for column in together.T])
    if start is not None and np.any(start):
        columns, least = np.column_stack([columns, start]), np.append(least, -np.inf)
    step, held = solve(columns, error, mu, least, np.full(least.size, np.inf))
    count = together.shape[1]
    step, at_bound = together @ step[:count], together @ held[:count] > 0.0
    # of the parameters that one column moves, only those at their own bound are held, and there exactly
    at_bound &= step <= np.where(np.isfinite(room), (1.0 - 1e-12) * room + 1e-12, -np.inf)
    return np.where(at_bound, room, step), at_bound


_FADED = 0.01  # of the largest column: response to the first force below which it changes no parameter


def _matters(start: np.ndarray, used: np.ndarray) -> bool:
    """Return True if the response to a force at the first sample is not negligible compared with the columns."""
    return float(np.linalg.norm(start)) > _FADED * float(np.max(np.linalg.norm(used, axis=0)))


def _likely_model(loop: Loop) -> StateSpace | Lifted | None:
    """Return Ĝ_d of a rigid axis with the mass and viscous friction that a loop feeds forward, or None."""
    block = compensator(loop)
    if not block.mass or loop.control.law.positions() > 1:
        return None
    try:
        return _required(loop, Rigid(mass=block.mass, viscous=block.viscous or 0.0))
    except UnstableError:
        return None


_SLOW = 0.02  # of the largest set speed: Stribeck friction of some mm/s at the usual 0.1 to 0.5 m/s


class _Trip:
    """A trial and the samples at which sliding friction does not apply; there are none if `at_rest` is "none".

    unknown  mask of these samples, shape (n,)
    """

    def __init__(
        self, loop: Loop, block: DisturbanceCompensator, trial: Trial, velocity: np.ndarray, at_rest: str
    ) -> None:
        self.trial, self.velocity, self.holds = trial, velocity, at_rest == "held"
        self.setpoint, self.T = _prefiltered(loop, trial.setpoint), float(loop.sample_time)
        self.dead_band = float(block.dead_band)
        self.unknown = np.zeros(velocity.size, dtype=bool)
        if not self.holds:
            return
        self.unknown = force_unknown(np.asarray(self.setpoint.position), velocity, self.dead_band)
        _, fed = block.step(block.start(self.setpoint), self.setpoint, self.T)
        self.fed = float(np.broadcast_to(fed, velocity.shape)[0])

    def nuisance(self) -> np.ndarray:
        """Return the set jerk, and a friction regressor of magnitude 1 near standstill and 0 at speed, shape (n, 2)."""
        jerk = np.broadcast_to(self.setpoint.shifted(0.5 * self.T).jerk, self.velocity.shape)
        ratio = self.velocity / (_SLOW * float(np.max(np.abs(self.velocity), initial=self.dead_band)))
        slow = np.where(np.abs(self.velocity) > self.dead_band, np.sign(self.velocity) * np.exp(-(ratio**2)), 0.0)
        return np.column_stack([jerk, slow])

    def through(
        self, model: StateSpace | Lifted, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the columns filtered through Ĝ_d, the error to be explained, and the response to an unknown force."""
        trial = self.trial
        if not self.holds:
            return filtered(model, columns, moving=trial.starts_moving), trial.following_error, None
        seen, error, level = filtered_held(
            _samples(model), columns, trial.following_error, self.unknown, moving=trial.starts_moving
        )
        if trial.force is None:
            return seen, error, level
        return seen, error - (trial.force - self.fed) * level, None


def regressors(
    loop: Loop, block: DisturbanceCompensator, setpoint: Setpoint, columns: Sequence[str] | None = None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return names and values φ, shape (n, columns), of the regressors, and the set velocity (m/s) at mid-sample.

    The code of the block computes them from the setpoint after the prefilter.
    """
    parameters = block.parameters()
    names = list(parameters if columns is None else columns)
    for name in names:
        if name not in parameters:
            raise ParameterError(
                f"columns: the feedforward has no parameter '{name}'; it has {', '.join(parameters) or 'none'}: give "
                f"it a value, 0 for a start"
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
    """Return the setpoint after the prefilter, as law and feedforward receive it."""
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


def _check(loop: Loop, trial: Trial, gamma: float, mu: float, saturation: str, at_rest: str) -> None:
    if not 0.0 < gamma <= 1.0:
        raise ParameterError(f"gamma = {number(gamma, 6)} must be > 0 and <= 1")
    if not 0.0 <= mu < np.inf:
        raise ParameterError(f"mu = {number(mu, 6)} must be a finite number >= 0")
    if saturation not in SATURATION:
        raise ParameterError(f"saturation = {saturation!r} must be one of {', '.join(SATURATION)}")
    if at_rest not in AT_REST:
        raise ParameterError(f"at_rest = {at_rest!r} must be one of {', '.join(AT_REST)}")
    check_clock(trial.name, trial.sample_time, float(loop.sample_time))


def _rows(trial: Trial, after: int, saturation: str, skip: int) -> np.ndarray:
    """Return a mask of the samples to use; raise LogError for saturation that is not allowed."""
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
    # the effect of a missing force outlasts the saturation by the decay of the loop
    for k in np.flatnonzero(saturated):
        counted[k : k + after] = False
    return counted


def _least(block: DisturbanceCompensator, name: str, least_mass: float) -> float:
    """Return the lower bound of a parameter."""
    declared = tree.declaration(block, name).least
    least = -np.inf if declared is None else declared
    return max(least, least_mass) if name == "mass" else least


def _remarks(loop: Loop) -> list[str]:
    """Return remarks on properties of the controller that change the meaning of the parameters."""
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
    """The effect of a trial on the parameter error: θ_next - θ0 = (I - gamma Ψ̂⁺ Ψ)(θ - θ0) + noise.

    matrix     I - gamma Ψ̂⁺ Ψ, for parameters scaled so that all columns have the same norm
    condition  condition number of the assumed columns Ψ̂, scaled to equal norm
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    condition: float
    gamma: float

    @property
    def rate(self) -> float:
        """The factor ρ by which the parameter error changes asymptotically from trial to trial."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix)), initial=0.0))

    @property
    def converges(self) -> bool:
        """True if ρ < 1."""
        return self.rate < 1.0

    def table(self) -> Table:
        """Return a table of the convergence rate, whether the trials converge, and the condition number."""
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
    """Return the convergence of `next_iteration` on a loop with a known axis when the tuner assumes another loop.

        Ψ = G_d φ of the loop,   Ψ̂ = Ĝ_d φ of the assumed loop,   ρ = largest |eigenvalue| of I - gamma Ψ̂⁺ Ψ

    believed  the loop with the gains and parameters that the tuner assumes; default: the loop itself

    The other arguments are those of `next_iteration`.  Friction is assumed to depend on the set velocity: deviations of
    the real velocity are neglected.
    Raises UnstableError if the model loop is not stable, and ParameterError for a column that is 0 throughout.
    Source: derived here for the step of `next_iteration`; the part of Wu, Han, Xiong & Ding 2017 that was available
    ends at eq. (10) and states no rate.
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
    # the same scale on both sides is a similarity: eigenvalues stay, the columns become comparable
    learned = np.linalg.lstsq(seen / sizes, true / sizes, rcond=None)[0]
    return Convergence(tuple(names), np.eye(len(names)) - gamma * learned, condition(seen), gamma)


_RECORDED = ("following_error", "tracking_error", "force", "requested", "trip")
