"""The response of a periodic controller by the N equations of its harmonics, and its derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.tuning.periodic_response import periodic_response


def by_harmonics(samples: np.ndarray, cycles: float, images: list[int], axis: np.ndarray) -> tuple[np.ndarray, complex]:
    """C(f) and det(1 + L) of the images at one line, from the response to each harmonic reading over time.

    The state that returns after a period turned by ζ is solved for; the loops at the images are N linear equations.
    """
    N, n = len(samples), samples.shape[1] - 1
    turn = np.exp(2j * np.pi * (cycles + np.arange(N) / N))
    harmonics = np.zeros((N, N, 2), complex)  # force at image i by reading r at image k
    for k in range(N):
        for r in range(2):
            reading = np.zeros((N, 2), complex)
            reading[:, r] = turn[k] ** np.arange(N)
            rows, right = np.zeros((N * n, N * n), complex), np.zeros(N * n, complex)
            for i in range(N):
                after = slice((i + 1) % N * n, (i + 1) % N * n + n)
                turned = turn[0] ** N if i == N - 1 else 1.0
                rows[i * n : i * n + n, after] += turned * np.eye(n)
                rows[i * n : i * n + n, i * n : i * n + n] -= samples[i, :n, :n]
                right[i * n : i * n + n] = samples[i, :n, n:] @ reading[i]
            states = np.linalg.solve(rows, right).reshape(N, n)
            force = np.einsum("in,in->i", samples[:, n, :n], states) + np.sum(samples[:, n, n:] * reading, axis=1)
            harmonics[:, k, r] = [np.mean(force * turn[i] ** -np.arange(N, dtype=float)) for i in range(N)]
    closed = harmonics[:, images] * axis.T  # by a force at each image
    single = np.sum(closed, axis=2)
    others = np.eye(len(images)) - single[images]
    back = np.linalg.solve(others, harmonics[images, 0])
    return harmonics[0, 0] + single[0] @ back, complex(np.linalg.det(others))


def slow_position_loop(random: np.random.Generator, N: int, columns: tuple[int, ...], many: int = 4) -> np.ndarray:
    """A stable controller in which the first sample alone sets two slow states by some of its columns."""
    n = many + 2
    matrix = random.standard_normal((n + 1, n + 2))
    matrix[:n, :n] *= 0.6 / np.max(np.abs(np.linalg.eigvals(matrix[:n, :n])))
    matrix[:2] = 0.0
    matrix[:2, :2] = np.eye(2)
    samples = np.repeat(matrix[None], N, axis=0)
    direction = random.standard_normal(n - 1)
    for k in range(N):
        share = (k + 1) / N
        samples[k, 2:, 0], samples[k, 2:, 1] = (1.0 - share) * direction, share * direction
    samples[0, 0, :2], samples[0, 1, :2] = (0.0, 1.0), (0.0, 0.0)
    for column in columns:
        gain = random.standard_normal()
        samples[0, 1, column] = gain
        samples[0, 2:, column] += gain / N * direction
    return samples


KINDS = {
    "the load's reading": (5, (7,)),
    "a state of the fast part": (4, (3,)),
    "both readings and a state": (6, (2, 6, 7)),
    "every second sample": (2, (7,)),
}


def drawn(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    N, columns = KINDS[kind]
    samples = slow_position_loop(random, N, columns)
    cycles = random.uniform(0.001, 0.5, 7)
    axis = 0.1 * (random.standard_normal((2, 7, N - 1)) + 1j * random.standard_normal((2, 7, N - 1)))
    return samples, cycles, axis


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("near", [False, True])
def test_the_images_close_as_by_all_their_equations(kind: str, near: bool) -> None:
    samples, cycles, axis = drawn(kind, 1)
    N, images = len(samples), [1, len(samples) - 1] if near and len(samples) > 2 else [*range(1, len(samples))]
    axis = axis[:, :, np.array(images) - 1]
    closed = periodic_response(samples, np.zeros((*samples.shape, 0)), cycles, images, axis)
    for line, turned in enumerate(cycles):
        value, rest = by_harmonics(samples, turned, images, axis[:, line])
        assert closed.value[:, line] == pytest.approx(value, rel=1e-9)
        assert closed.rest[line] == pytest.approx(rest, rel=1e-9)
    transition = np.eye(samples.shape[1] - 1)
    for sample in samples:
        transition = sample[:-1, :-2] @ transition
    assert np.sort(np.abs(closed.poles)) == pytest.approx(np.sort(np.abs(np.linalg.eigvals(transition))), abs=1e-9)
    assert len(samples) == N


def test_a_controller_that_differs_in_every_sample_is_one_too() -> None:
    random = np.random.default_rng(4)
    samples = 0.3 * random.standard_normal((3, 4, 5))
    axis = 0.1 * random.standard_normal((2, 1, 2)) + 0j
    closed = periodic_response(samples, np.zeros((*samples.shape, 0)), np.array([0.07]), [1, 2], axis)
    value, rest = by_harmonics(samples, 0.07, [1, 2], axis[:, 0])
    assert closed.value[:, 0] == pytest.approx(value, rel=1e-9)
    assert closed.rest[0] == pytest.approx(rest, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_its_derivatives_are_those_of_differences(kind: str) -> None:
    samples, cycles, axis = drawn(kind, 2)
    random, images = np.random.default_rng(3), [*range(1, len(samples))]
    slopes = np.zeros((*samples.shape, 3))
    # a gain, an entry of one sample alone, and nothing
    slopes[..., 0] = random.standard_normal(samples.shape[1])[:, None] * samples * (samples != 0.0)
    slopes[0, 1, -1, 1] = 1.0
    closed = periodic_response(samples, slopes, cycles, images, axis)
    nothing, h = np.zeros((*samples.shape, 0)), 1e-6
    for place in range(3):
        ends = [
            periodic_response(samples + sign * h * slopes[..., place], nothing, cycles, images, axis).value
            for sign in (1.0, -1.0)
        ]
        # central differences err by h² of the curvature and by rounding over h
        assert closed.slope[..., place] == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_one_reading_for_two_that_are_equal(kind: str) -> None:
    """One encoder gives both readings: the response to it is the sum of both, and so are its derivatives."""
    samples, cycles, axis = drawn(kind, 5)
    axis[0] = axis[1]
    n, images = samples.shape[1] - 1, [*range(1, len(samples))]
    slopes = np.random.default_rng(6).standard_normal(samples.shape)[..., None] * (samples != 0.0)[..., None]
    whole = periodic_response(samples, slopes, cycles, images, axis)
    one, of_one = (
        np.concatenate([part[:, :, :n], part[:, :, n:].sum(axis=2, keepdims=True)], axis=2)
        for part in (samples, slopes)
    )
    found = periodic_response(one, of_one, cycles, images, axis[1:])
    assert found.value.shape == (1, cycles.size)
    assert found.value[0] == pytest.approx(np.sum(whole.value, axis=0), rel=1e-9)
    assert found.slope[0] == pytest.approx(np.sum(whole.slope, axis=0), rel=1e-9, abs=1e-9)
    assert found.rest == pytest.approx(whole.rest, rel=1e-9)


def test_lines_without_images_are_computed_beside_the_others() -> None:
    """An axis that does not answer at the images leaves their loops open."""
    samples, cycles, axis = drawn("both readings and a state", 7)
    nothing, images = np.zeros((*samples.shape, 0)), [*range(1, len(samples))]
    axis[:, 4:] = 0.0
    both = periodic_response(samples, nothing, cycles, images, axis)
    open_ = periodic_response(samples, nothing, cycles[4:], [], np.zeros((2, 3, 0)))
    assert both.value[:, 4:] == pytest.approx(open_.value, rel=1e-12)
    assert both.rest[4:] == pytest.approx(np.ones(3), rel=1e-12)
    closed = periodic_response(samples, nothing, cycles[:4], images, axis[:, :4])
    assert both.value[:, :4] == pytest.approx(closed.value, rel=1e-12)


def test_without_images_and_without_states() -> None:
    gains = np.array([[[1.0, 2.0]], [[1.0, 4.0]]])
    closed = periodic_response(gains, np.ones((*gains.shape, 1)), np.array([0.1]), [], np.zeros((2, 1, 0)))
    # the mean over a period is the response of a gain that changes
    assert closed.value[:, 0] == pytest.approx([1.0, 3.0])
    assert closed.slope[:, 0, 0] == pytest.approx([1.0, 1.0])
    assert closed.rest == pytest.approx([1.0])
