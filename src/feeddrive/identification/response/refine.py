"""Refinement of models by measured frequency responses: quantities and units, cost, minimization, and covariance.

The quantities of a response are its input and output, its order of differentiation, and the resulting units.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.conversion import as_frf
from feeddrive.identification.regression import median_spread, ols_covariance, robust_covariance
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, span
from feeddrive.loop.frequency_response import FRF

_SI = {("m", "N"): {}, ("rad", "N m"): {"kg": "kg m2", "N/m": "N m/rad", "N s/m": "N m s/rad", "m/N": "rad/(N m)"}}
FEWEST = 8  # lines


@dataclass(frozen=True)
class ResponseUnits:
    """The units of position (`output`) over force (`input`), differentiated `order` times: m/N, (m/s)/N, rad/A ..."""

    output: str
    input: str
    order: int

    @property
    def si(self) -> bool:
        """True if identified masses are in kg and stiffnesses in N/m."""
        return (self.output, self.input) == ("m", "N")

    @property
    def turns(self) -> bool:
        """True if identified masses are inertias in kg m2 at a shaft, and stiffnesses are in N m/rad."""
        return (self.output, self.input) == ("rad", "N m")

    def of(self, unit: str) -> str:
        """Return the unit that corresponds to an SI unit of a linear axis, such as kg, N/m, N s/m, m/N."""
        si_units = _SI.get((self.output, self.input))
        if si_units is not None:
            return si_units.get(unit, unit)
        force, travel = self.input, self.output
        composed = {"kg": f"{force} s2/{travel}", "N/m": f"{force}/{travel}", "N s/m": f"{force} s/{travel}"}
        return {**composed, "m/N": f"{travel}/{force}"}.get(unit, unit)


def response_units(frf: FRF) -> ResponseUnits:
    """Return the units of output and input of an FRF, from its unit in any spelling; without a unit m/N is assumed."""
    output, _, force = (_known(frf.unit) or (frf.unit or "m/N", 1.0))[0].rpartition("/")
    match = re.fullmatch(r"\(?([^()/]+?)(?:/(s2?|s\^2))?\)?", output.strip())
    if match is None or not force:
        raise ParameterError(
            f"the unit '{frf.unit}' of the response to {frf.output} is not one of position, velocity or acceleration "
            f"over force or current; give it as m/N, (m/s)/N, rad/A ..."
        )
    order = {None: 0, "s": 1}.get(match[2], 2)
    return ResponseUnits(match[1].strip(), force.strip(" ()"), order)


def _known(unit: str) -> tuple[str, float] | None:
    """Return the SI unit and the conversion factor, or None for an unknown unit or one of another quantity."""
    try:
        return units.response(unit) if unit else None
    except ParameterError:
        return None


def _in_si(frf: FRF) -> FRF:
    """Return a response in SI with the canonical spelling of its unit, or unchanged if the unit is unknown."""
    conversion = _known(frf.unit)
    if conversion is None:
        return frf
    unit, factor = conversion
    return replace(frf if factor == 1.0 else replace(frf * factor, coherence=frf.coherence), unit=unit)


def taken(
    responses: Mapping[str, FRF | None],
    band: tuple[float, float] | None,
    force_per_unit: float | None,
    travel_per_unit: float | None,
) -> tuple[dict[str, FRF], ResponseUnits]:
    """Return the available responses in SI units, cut to a band in Hz, with their input and output quantities.

    force_per_unit    N per unit of the input, such as the force constant of a motor in N/A
    travel_per_unit   m per unit of the output, such as lead/2π for an angle in rad
    Raises ParameterError if there is no response, if one is 0, if their units differ or if too few frequency lines are
    left.
    """
    there = {name: _in_si(as_frf(frf)) for name, frf in responses.items() if frf is not None}
    if not there:
        raise ParameterError("a fit needs at least one frequency response, of the motor's or of the load's position")
    for name, frf in there.items():
        silent = np.flatnonzero(frf.response == 0.0)
        if silent.size:
            raise ParameterError(
                f"the response of the {name} is 0 at {Quantity(frf.frequency[silent[0]], 'Hz'):6} ({silent.size} such "
                "lines), which no axis does: check its columns, and leave out lines on which nothing was measured"
            )
    of_each = {name: response_units(frf) for name, frf in there.items()}
    first = next(iter(of_each.values()))
    for name, response in of_each.items():
        if response != first:
            raise ParameterError(
                f"the responses must lead from and to the same quantities: '{name}' is in {there[name].unit}, "
                f"another in {next(iter(there.values())).unit}"
            )
    scale = (1.0 if travel_per_unit is None else travel_per_unit) / (1.0 if force_per_unit is None else force_per_unit)
    if not (np.isfinite(scale) and scale > 0.0):
        raise ParameterError("force_per_unit and travel_per_unit must be finite and > 0")
    first = replace(
        first,
        output=first.output if travel_per_unit is None else "m",
        input=first.input if force_per_unit is None else "N",
    )
    unit = first.output if not first.order else f"({first.output}/{('s', 's2')[first.order - 1]})"
    unit = f"{unit}/{first.input if ' ' not in first.input else f'({first.input})'}"
    kept: dict[str, FRF] = {}
    for name, frf in there.items():
        low, high = band or (0.0, np.inf)
        inside = (frf.frequency >= low) & (frf.frequency <= high)
        if np.count_nonzero(inside) < FEWEST:
            raise ParameterError(
                f"the response to '{name}' has {np.count_nonzero(inside)} lines from "
                f"{span(low, high, 'Hz', '6')} and needs {FEWEST} at least"
            )
        parts = {
            key: None if (values := getattr(frf, key)) is None else values[inside] for key in ("coherence", "variance")
        }
        cut = replace(frf, frequency=frf.frequency[inside], response=frf.response[inside], unit=unit, **parts)
        kept[name] = cut * scale if scale != 1.0 else cut
        # a factor does not change the coherence, which the multiplication drops
        if scale != 1.0:
            kept[name] = replace(kept[name], coherence=cut.coherence)
    return kept, first


# from the parameters to each response, shape (lines,), and its slope, shape (lines, parameters)
Model = Callable[[np.ndarray], "list[tuple[np.ndarray, np.ndarray]]"]

_FAR = 2.0  # standard deviations above which a residual is weighted less
_OPEN = 1.0  # standard error of a logarithm above which its start value is more reliable than the lines
# of a singular value of unit columns: its square is still well above the rounding of doubles
_ROUNDING = 3e-7
STEPS = 100
_FLAT = 1e-7  # share of the cost by which a step must still lower it: far less than a standard error moves it
_LITTLE = 1e-3  # of a squared residual: two steps in a row that lower the cost by less do not move an error


@dataclass(frozen=True)
class Unknown:
    """An unknown parameter. A positive parameter is optimized as its logarithm, any other in units of `scale`."""

    name: str
    unit: str
    start: float
    scale: float = 1.0
    positive: bool = False
    least: float = -np.inf
    most: float = np.inf
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Measured:
    """A response with the standard deviation of its frequency lines, which is relative if no variance was measured
    (`relative`).

    With a variance the residual is (G - Gm)/σ, σ² = variance + (model error · |Gm|)²; without one it is ln(G/Gm), which
    gives peaks and valleys the same weight, divided by the standard deviation that follows from the coherence of
    each line, or by 1 without a coherence.
    """

    frf: FRF
    sigma: np.ndarray
    relative: bool

    @property
    def lines(self) -> int:
        """The number of frequency lines."""
        return self.frf.frequency.size


@dataclass(frozen=True, eq=False)
class Refined:
    """The parameters of minimum cost, in the order of the unknowns.

    covariance   valid for residuals correlated from line to line; `ols` for uncorrelated ones
    slopes       Jacobian of the real residuals (rows) with respect to the internal parameters (columns)
    residuals    complex weighted residuals of each response
    spread       standard deviation of the real residuals, from their median; 1 if the variances are right
    model_error  relative model error beyond the noise
    bound        True for parameters that ended at a bound
    """

    values: np.ndarray
    covariance: np.ndarray
    ols: np.ndarray
    slopes: np.ndarray
    residuals: tuple[np.ndarray, ...]
    spread: float
    model_error: float
    bound: np.ndarray
    settled: bool


def measured(responses: Sequence[FRF], model_error: float = 0.0) -> tuple[Measured, ...]:
    """Return the responses with the standard deviations by which they are weighted."""
    weighted: list[Measured] = []
    for frf in responses:
        if np.any(frf.response == 0.0):
            where = frf.frequency[np.argmin(frf.magnitude)]
            raise ParameterError(
                f"the response to {frf.output} is zero at {Quantity(where, 'Hz'):6}: leave out this line"
            )
        if frf.variance is not None:
            # a variance of a real residual is half of E|dG|²
            sigma = np.sqrt(0.5 * frf.variance + 0.5 * (model_error * frf.magnitude) ** 2)
            # a variance of 0, as that of a simulation, would be an infinite weight
            least = 1e-9 * frf.magnitude
            weighted.append(Measured(frf, np.maximum(sigma, least), False))
        else:
            sigma = np.ones(frf.frequency.size)
            if frf.coherence is not None:
                noise = (1.0 - frf.coherence) / np.maximum(frf.coherence, 1e-6)
                # lines that are better than most are limited by the model and not by noise
                sigma = np.sqrt(1.0 + noise / max(float(np.median(noise)), 1e-12))
            weighted.append(Measured(frf, sigma, True))
    return tuple(weighted)


def refine(
    model: Model,
    unknowns: Sequence[Unknown],
    responses: Sequence[FRF],
    *,
    logarithmic: bool = False,
    use: Sequence[np.ndarray] | None = None,
    start: np.ndarray | None = None,
    steps: int = STEPS,
    model_error: float = 0.0,
) -> Refined:
    """Minimize the cost by the Levenberg-Marquardt method, over the frequency lines in `use`.

    The initial values are `start`, by default those of the unknowns.  The cost is Σ ρ(r), ρ = 2 s² c² (√(1 + (r/sc)²) -
    1), c = 2, s the median magnitude of the residuals: quadratic except for outlying lines, whose influence is
    bounded.  If the variances are known and the model fits worse than they predict, a `model_error` is added to them
    until both agree.
    Sources: Levenberg 1944; Marquardt 1963; Pintelon & Schoukens, System Identification, section 9 (the cost).
    """
    chosen = [replace(frf, variance=None) if logarithmic else frf for frf in responses]
    keep = [np.ones(frf.frequency.size, bool) for frf in chosen] if use is None else list(use)
    u = _inner(unknowns, np.array([unknown.start for unknown in unknowns]) if start is None else start)
    begin, data, refined = u, measured(chosen), None
    # the variances depend on the model error, and the fit on the variances: both are repeated until they agree
    for _ in range(8):
        data = measured(chosen, model_error)
        refined = _descend(model, unknowns, data, keep, u, steps)
        u = _inner(unknowns, refined.values)
        refined = replace(refined, model_error=model_error)
        wanted = _model_error(refined, data, keep, model_error)
        if wanted <= model_error * 1.05 + 1e-6:
            break
        model_error = wanted
    assert refined is not None
    return _near_its_start(refined, model, unknowns, data, keep, begin, steps)


def _near_its_start(
    refined: Refined,
    model: Model,
    unknowns: Sequence[Unknown],
    data: Sequence[Measured],
    keep: Sequence[np.ndarray],
    begin: np.ndarray,
    steps: int,
) -> Refined:
    """Return the equally good point that is closest to the start, if noise leaves parameters undetermined.

    In such a flat valley of the cost an unconstrained descent ends at a point that depends on rounding, and its
    standard errors mean nothing.
    """
    inner = np.array([unknown.positive and not unknown.fixed for unknown in unknowns])
    loose = np.array([not unknown.fixed for unknown in unknowns]) & ~refined.bound
    normal = (refined.slopes.T @ refined.slopes)[np.ix_(loose, loose)]
    if _determined(normal, inner[loose], refined.spread).shape[1] == normal.shape[0]:
        return refined
    near = _descend(model, unknowns, data, keep, begin, steps, refined.spread)
    far = _FAR * refined.spread
    low, other = (
        _cost(np.concatenate([part for r in candidate.residuals for part in (np.real(r), np.imag(r))]), far)
        for candidate in (refined, near)
    )
    # a chi-square of four: not more than noise
    return replace(near, model_error=refined.model_error) if other <= low + 4.0 * refined.spread**2 else refined


def _determined(normal: np.ndarray, inner: np.ndarray, noise: float) -> np.ndarray:
    """Return the directions, one per column, in which the logarithms are determined at this noise level.

    They follow from the normal equations of the logarithms, reduced by all other parameters: H₁₁ - H₁₂ H₂₂⁻¹ H₂₁.
    """
    if not np.any(inner):
        return np.eye(inner.size)
    other = ~inner
    cross = normal[np.ix_(inner, other)]
    reduced = normal[np.ix_(inner, inner)] - cross @ np.linalg.pinv(normal[np.ix_(other, other)]) @ cross.T
    curvature, directions = np.linalg.eigh(reduced)
    determined = directions[:, curvature > (noise / _OPEN) ** 2]
    ways = np.zeros((inner.size, determined.shape[1] + int(np.sum(other))))
    ways[np.flatnonzero(inner), : determined.shape[1]] = determined
    ways[np.flatnonzero(other), determined.shape[1] :] = np.eye(int(np.sum(other)))
    return ways


def _inner(unknowns: Sequence[Unknown], values: np.ndarray) -> np.ndarray:
    return np.array(
        [np.log(v) if unknown.positive else v / unknown.scale for unknown, v in zip(unknowns, values, strict=True)]
    )


def _outer(unknowns: Sequence[Unknown], u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameter values and their derivatives with respect to the internal parameters."""
    values = np.array(
        [np.exp(v) if unknown.positive else v * unknown.scale for unknown, v in zip(unknowns, u, strict=True)]
    )
    slopes = np.array([v if unknown.positive else unknown.scale for unknown, v in zip(unknowns, values, strict=True)])
    return values, slopes


def _residuals(
    model: Model, unknowns: Sequence[Unknown], data: Sequence[Measured], use: Sequence[np.ndarray], u: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Return the complex residuals of each response, and all real residuals with their Jacobian."""
    values, inner = _outer(unknowns, u)
    whole: list[np.ndarray] = []
    rows: list[np.ndarray] = []
    slopes: list[np.ndarray] = []
    # a step too far may overflow: its cost is then infinite, and the step is refused
    with np.errstate(all="ignore"):
        for (response, slope), weighted, kept in zip(model(values), data, use, strict=True):
            if weighted.relative:
                r = np.log(response / weighted.frf.response) / weighted.sigma
                j = slope / (response * weighted.sigma)[:, None]
            else:
                r = (response - weighted.frf.response) / weighted.sigma
                j = slope / weighted.sigma[:, None]
            whole.append(r[kept])
            part = j[kept] * inner
            rows += [np.real(r[kept]), np.imag(r[kept])]
            slopes += [np.real(part), np.imag(part)]
    return whole, np.concatenate(rows), np.vstack(slopes)


def _cost(r: np.ndarray, far: float) -> float:
    if not np.all(np.isfinite(r)):
        return np.inf
    return float(np.sum(2.0 * far * far * (np.sqrt(1.0 + (r / far) ** 2) - 1.0)))


def _spread(r: np.ndarray) -> float:
    """Return the robust standard deviation of residuals, from their median absolute value."""
    return median_spread(r) + 1e-12


def _descend(
    model: Model,
    unknowns: Sequence[Unknown],
    data: Sequence[Measured],
    use: Sequence[np.ndarray],
    u: np.ndarray,
    steps: int,
    noise: float | None = None,
) -> Refined:
    """Minimize the cost from `u`; if a noise level is given, move only in directions that the residuals determine."""
    lower, upper = (
        np.array([getattr(unknown, side) / (1.0 if unknown.positive else unknown.scale) for unknown in unknowns])
        for side in ("least", "most")
    )
    inner = np.array([unknown.positive for unknown in unknowns])
    with np.errstate(all="ignore"):
        lower = np.where(inner, np.where(lower > 0.0, np.log(lower), -np.inf), lower)
        upper = np.where(inner, np.log(upper), upper)
    whole, r, slopes = _residuals(model, unknowns, data, use, u)
    damping, settled, flat = 1e-3, False, 0
    far = _FAR * _spread(r)
    cost = _cost(r, far)
    loose = np.array([not unknown.fixed for unknown in unknowns])
    free = loose
    for step in range(steps):
        # a limit that moved with each step would change the cost under the descent
        if step % 5 == 4:
            far = _FAR * _spread(r)
            cost = _cost(r, far)
        weight = 1.0 / np.sqrt(1.0 + (r / far) ** 2)
        gradient, normal = slopes.T @ (weight * r), (slopes * weight[:, None]).T @ slopes
        free = loose & ~(((u <= lower) & (gradient > 0.0)) | ((u >= upper) & (gradient < 0.0)))
        size = np.diag(normal)[free]
        # Marquardt's scaling by the diagonal; a parameter without effect has none, and would make the matrix singular
        size = size + 1e-12 * float(np.max(size, initial=1e-300))
        ways = np.eye(size.size) if noise is None else _determined(normal[np.ix_(free, free)], inner[free], noise)
        before = cost
        while damping < 1e12:
            move = np.zeros(u.size)
            damped = normal[np.ix_(free, free)] + np.diag(damping * size)
            move[free] = -ways @ np.linalg.solve(ways.T @ damped @ ways, ways.T @ gradient[free])
            # a positive parameter changes by a factor of e at most in one step
            move = np.where(inner, np.clip(move, -1.0, 1.0), move)
            tried = np.clip(u + move, lower, upper)
            other = _residuals(model, unknowns, data, use, tried)
            lowered = _cost(other[1], far)
            if lowered < cost:
                u, (whole, r, slopes), cost = tried, other, lowered
                damping = max(damping * 0.2, 1e-12)
                break
            damping *= 6.0
        else:
            settled = True
            break
        # the step after the outlier limit has changed is no evidence: its cost is a different one
        little = before - cost <= max(_FLAT * before, _LITTLE * (far / _FAR) ** 2)
        flat = flat + 1 if little and step % 5 != 4 else 0
        if flat == 2:
            settled = True
            break
    values, slope = _outer(unknowns, u)
    covariance, ols = _covariances(r, slopes, slope, free, _turns(whole))
    return Refined(values, covariance, ols, slopes, tuple(whole), _spread(r), 0.0, loose & ~free, settled)


def covariances_at(
    model: Model,
    unknowns: Sequence[Unknown],
    responses: Sequence[FRF],
    values: np.ndarray,
    *,
    logarithmic: bool,
    model_error: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the robust and the plain covariance of all parameters at given values, without a fit.

    The parameters may include some that were fixed in the fit because they are not identifiable: counting them as
    unknown increases the errors of the others.
    """
    chosen = [replace(frf, variance=None) if logarithmic else frf for frf in responses]
    everywhere = [np.ones(frf.frequency.size, bool) for frf in chosen]
    u = np.array(
        [np.log(v) if unknown.positive else v / unknown.scale for unknown, v in zip(unknowns, values, strict=True)]
    )
    whole, r, slopes = _residuals(model, unknowns, measured(chosen, model_error), everywhere, u)
    free = np.array([not unknown.fixed for unknown in unknowns])
    return _covariances(r, slopes, _outer(unknowns, u)[1], free, _turns(whole))


def _turns(whole: Sequence[np.ndarray]) -> np.ndarray:
    """Return alternating signs from line to line, for the real residuals of each response."""
    return np.concatenate([np.tile(1.0 - 2.0 * (np.arange(r.size) % 2), 2) for r in whole])


def _covariances(
    r: np.ndarray, slopes: np.ndarray, scale: np.ndarray, free: np.ndarray, turns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the robust and the plain covariance of the values; `scale` converts from the internal parameters.

    The covariance of an estimate with Σ ψ(r) ∂r = 0, ψ = ρ'(r)/2, is mean ψ² / (mean ψ')² (JᵀJ)⁻¹ (Huber 1981).
    A difference between even and odd lines beyond noise is distortion or model error, which is added to the robust
    covariance:

        (1 - p/s²)₊ u uᵀ,   u = (JᵀJ)⁻¹ Σ ± Jᵀψ,   s² = uᵀ C⁻¹ u

    u is half the difference between the estimates from even and from odd lines, p the number of parameters and C their
    plain covariance.  With noise alone s² is p on average.
    """
    # a parameter without effect has no defined error; its bound is reported instead
    free = free & (np.linalg.norm(slopes, axis=0) > 0.0)
    moving = np.ix_(free, free)
    robust_whole, plain_whole = (np.zeros((free.size, free.size)) for _ in range(2))
    if not np.any(free):
        return robust_whole, plain_whole
    weight = 1.0 / np.sqrt(1.0 + (r / (_FAR * _spread(r))) ** 2)
    root, curved = np.sqrt(weight), float(np.mean(weight**3))
    columns, left = _independent((slopes * root[:, None])[:, free]), root * r
    between = np.outer(scale[free], scale[free])
    average = float(np.mean(weight))
    plain = ols_covariance(columns, left) * (
        float(np.mean(weight**2 * r**2)) * average / (float(np.mean(weight * r**2)) * curved**2)
    )
    robust = robust_covariance(columns, left) * (average / curved) ** 2
    # with few lines the robust estimate may fall below that of a white residual by chance
    wider = np.sqrt(np.maximum(np.diag(plain) / np.maximum(np.diag(robust), 1e-300), 1.0))
    robust = robust * np.outer(wider, wider)
    apart = np.linalg.pinv(columns.T @ columns, hermitian=True) @ (columns.T @ (turns * left)) * (average / curved)
    size = np.sqrt(np.maximum(np.diag(plain), 1e-300))
    share = float(apart / size @ np.linalg.pinv(plain / np.outer(size, size), hermitian=True) @ (apart / size))
    robust = robust + max(0.0, 1.0 - apart.size / max(share, 1e-300)) * np.outer(apart, apart)
    robust_whole[moving] = robust * between
    plain_whole[moving] = plain * between
    return robust_whole, plain_whole


def _independent(columns: np.ndarray) -> np.ndarray:
    """Return the columns with the smallest change that makes them linearly independent in double precision.

    An undetermined parameter then has a very large error. For exactly dependent columns rounding alone would give
    arbitrary errors, including small ones.
    """
    size = np.linalg.norm(columns, axis=0)
    left, values, right = np.linalg.svd(columns / size, full_matrices=False)
    return (left * np.maximum(values, _ROUNDING)) @ right * size


def _model_error(refined: Refined, data: Sequence[Measured], use: Sequence[np.ndarray], now: float) -> float:
    """Return the model error at which residuals of known variance agree with their weights; `now` if they do."""
    parts = [
        (np.abs(r * weighted.sigma[kept]) ** 2, weighted.frf.variance[kept], weighted.frf.magnitude[kept] ** 2)
        for r, weighted, kept in zip(refined.residuals, data, use, strict=True)
        if weighted.frf.variance is not None
    ]
    if not parts:
        return 0.0
    apart, variance, size = (np.concatenate(column) for column in zip(*parts, strict=True))
    freedom = 1.0 - refined.values.size / max(2.0 * sum(r.size for r in refined.residuals), refined.values.size + 1.0)

    def ratio(share: float) -> float:
        return float(np.median(apart / np.maximum(variance + share * share * size, 1e-300))) / (np.log(2.0) * freedom)

    # a median of |r|² of a complex normal residual is ln 2 of its mean; 1.5 leaves room for its own scatter
    if ratio(now) <= 1.5:
        return now
    low, high = now, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) > 1.0 else (low, middle)
    return high
