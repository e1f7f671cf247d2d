"""Polynomials that rise from 0 to 1 with zero slope at both ends; windows and run-ups composed of them."""

import numpy as np

from feeddrive.blocks.reference.derivatives import Derivatives


def seventh_degree(share: np.ndarray) -> Derivatives:
    """Return ψ = 35τ⁴ - 84τ⁵ + 70τ⁶ - 20τ⁷ for τ in 0 .. 1, with derivatives in τ.

    Written with σ = 1 - τ to avoid cancellation:  ψ = τ⁴(35σ³ + 21τσ² + 7τ²σ + τ³),  ψ' = 140 τ³σ³.
    """
    tau, rest = share, 1.0 - share
    both = tau * rest
    return (
        tau**4 * (35.0 * rest**3 + tau * (21.0 * rest**2 + tau * (7.0 * rest + tau))),
        140.0 * both**3,
        420.0 * both**2 * (rest - tau),
        840.0 * both * (1.0 - 5.0 * both),
        840.0 * (rest - tau) * (1.0 - 10.0 * both),
    )


def tenth_degree(share: np.ndarray) -> Derivatives:
    """Return ψ = τ⁵(252 - 1050τ + 1800τ² - 1575τ³ + 700τ⁴ - 126τ⁵) for τ in 0 .. 1, with derivatives in τ.

    Written with σ = 1 - τ to avoid cancellation:  ψ = Σ C(10, k) τᵏσ¹⁰⁻ᵏ over k = 5 .. 10,  ψ' = 1260 τ⁴σ⁵.
    """
    tau, rest = share, 1.0 - share
    tail = 120.0 * rest**3 + tau * (45.0 * rest**2 + tau * (10.0 * rest + tau))
    third = 12.0 + tau * (72.0 * tau - 64.0)
    return (
        tau**5 * (252.0 * rest**5 + tau * (210.0 * rest**4 + tau * tail)),
        1260.0 * tau**4 * rest**5,
        1260.0 * tau**3 * rest**4 * (4.0 - 9.0 * tau),
        1260.0 * tau**2 * rest**3 * third,
        1260.0 * tau * rest**2 * ((2.0 - 5.0 * tau) * third + tau * rest * (144.0 * tau - 64.0)),
    )


def window(t: np.ndarray, duration: float, blend_time: float) -> Derivatives:
    """Return a window that rises to 1 and finally falls to 0, each in `blend_time` (s), as `seventh_degree` does."""
    if blend_time == 0.0:
        nothing = np.zeros_like(t)
        return np.ones_like(t), nothing, nothing, nothing, nothing
    left = np.minimum(t, duration - t) / blend_time
    steps = seventh_degree(np.clip(left, 0.0, 1.0))
    inside = (left >= 0.0) & (left < 1.0)
    rate = np.where(t < 0.5 * duration, 1.0, -1.0) / blend_time
    # masked: the fourth derivative of the polynomial is not 0 where it ends
    one, two, three, four = (np.where(inside, step * rate**k, 0.0) for k, step in enumerate(steps[1:], 1))
    return steps[0], one, two, three, four


def run_up_angle(t: np.ndarray, turned: float, duration: float, run_up: float) -> Derivatives:
    """Return an angle from 0 to `turned` whose rate is `window` times the constant turned / (duration - run_up).

    The integral of the seventh-degree polynomial is ∫ψ dτ = τ⁵(7 - 14τ + 10τ² - 2.5τ³), which is 1/2 at τ = 1.
    """
    rate = turned / (duration - run_up)
    steps = window(t, duration, run_up)
    early = t < 0.5 * duration
    left = np.minimum(t, duration - t)
    tau = np.clip(left / run_up, 0.0, 1.0)
    swept = run_up * tau**5 * (7.0 - tau * (14.0 - tau * (10.0 - 2.5 * tau))) + np.maximum(left - run_up, 0.0)
    angle = np.where(early, rate * swept, turned - rate * swept)
    return angle, rate * steps[0], rate * steps[1], rate * steps[2], rate * steps[3]
