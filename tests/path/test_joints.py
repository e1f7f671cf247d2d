"""Blends of joints: the tolerance against an independent distance, angles and mirrors, what needs none."""

from __future__ import annotations

import numpy as np
import pytest
from paths import arc, joined_up, lines

from feeddrive.path.geometry.joints import joined
from feeddrive.path.motion import ARC, LINE, POLYNOMIAL, Pieces, derivatives


def points(pieces: Pieces, count: int) -> np.ndarray:
    """Positions along pieces."""
    found, r = [], np.zeros((pieces.origin.shape[1], 5))
    for k, length in enumerate(pieces.length):
        for x in np.linspace(0.0, length, count):
            derivatives(int(pieces.kind[k]), length, pieces.shape[k], x, r)
            found.append(pieces.origin[k] + r[:, 0])
    return np.array(found)


def corner(angle: float, length: float = 0.03) -> np.ndarray:
    end = length * np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], np.array([length, 0.0, 0.0]) + end])


@pytest.mark.parametrize("tolerance", [1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("degrees", [0.01, 1.0, 10.0, 45.0, 90.0, 135.0, 179.0])
def test_a_corner_is_rounded_within_its_tolerance(degrees: float, tolerance: float):
    """Distance of the blend to the two lines by dense points; that of the corner's tip to the blend, too."""
    segments = lines(corner(np.radians(degrees)), 0.1)
    (run,), joint = joined(segments, np.full(2, tolerance), sharpest=4.0, lonely=np.inf)
    path = points(run, 40)
    tip, direction = np.array([0.03, 0.0, 0.0]), np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
    before = np.hypot(np.maximum(path[:, 0] - 0.03, 0.0), path[:, 1])
    along = (path - tip) @ direction
    after = np.linalg.norm(path - tip - np.maximum(along, 0.0)[:, None] * direction, axis=1)
    assert np.minimum(before, after).max() <= joint.deviation[0] + 1e-12  # m: positions are rounded
    assert np.linalg.norm(path - tip, axis=1).min() <= joint.deviation[0] + 1e-12
    assert joint.deviation[0] <= tolerance
    whole = segments.length.sum() / 4.0  # a blend takes half of a segment at most
    taken = 0.03 - run.length[0]
    assert joint.deviation[0] >= 0.99 * tolerance or taken >= 0.99 * whole


def test_a_blend_does_not_care_how_the_corner_lies():
    """Mirrored, turned and taken backwards: the same bound, 1e-6 of it by the search for L."""
    base = corner(1.0)
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    found = [
        joined(lines(each, 0.1), np.full(2, 1e-5), sharpest=4.0, lonely=np.inf)[0][0].length[0]
        for each in (base, base * [1, -1, 1], base @ turn.T, base[::-1])
    ]
    assert found == pytest.approx([found[0]] * 4, rel=1e-6)


def test_derivatives_meet_at_every_joint():
    """r', r'' and r''' of neighbors, each as a share of the largest there: 1e-12."""
    segments = joined_up(
        lines(np.array([[-0.03, 0.0, 0.0], [0.0, 0.0, 0.0]]), 0.1),
        arc((0.0, 0.005), 0.005, -0.5 * np.pi, 0.5 * np.pi, 0.1),
        lines(np.array([[0.0, 0.01, 0.0], [-0.03, 0.01, 0.0], [-0.04, 0.02, 0.0]]), 0.1),
    )
    (run,), _ = joined(segments, np.full(4, 1e-5), sharpest=4.0, lonely=np.inf)
    assert (run.kind == POLYNOMIAL).sum() == 24
    a, b, sizes = np.zeros((3, 5)), np.zeros((3, 5)), np.zeros(3)
    jumps = np.zeros(3)
    for k in range(len(run.length) - 1):
        derivatives(int(run.kind[k]), run.length[k], run.shape[k], run.length[k], a)
        derivatives(int(run.kind[k + 1]), run.length[k + 1], run.shape[k + 1], 0.0, b)
        assert np.abs(run.origin[k + 1] - run.origin[k] - a[:, 0]).max() <= 1e-15
        jumps = np.maximum(jumps, np.abs(b - a)[:, 1:4].max(axis=0))
        sizes = np.maximum(sizes, np.abs(a)[:, 1:4].max(axis=0))
    assert (jumps <= 1e-12 * sizes).all()


def test_lines_in_one_direction_need_no_blend_and_stops_stay_stops():
    straight = lines(np.linspace([0.0, 0.0, 0.0], [0.1, 0.2, 0.3], 1001), 0.1)
    runs, joint = joined(straight, np.full(1000, 1e-5))
    assert len(runs) == 1
    assert joint.deviation.max() <= 1e-14
    (run, other), joint = joined(lines(corner(0.5), 0.1), np.zeros(2), sharpest=4.0, lonely=np.inf)
    assert joint.stop.tolist() == [1, 1]
    assert run.kind.tolist() == other.kind.tolist() == [LINE]
    # sharper than asked for: a stop, although there is a tolerance
    assert len(joined(lines(corner(0.5), 0.1), np.full(2, 1e-5), sharpest=0.2)[0]) == 2
    assert len(joined(lines(corner(0.5), 0.1), np.full(2, -1.0))[0]) == 2


def test_a_circle_in_parts_stays_a_circle():
    """Parts whose ends are exact need no blend; with ends that are rounded, a blend takes a twentieth of P."""
    r, quarter, P = 0.5, 0.5 * np.pi, 1e-4
    parts = joined_up(*(arc((0.0, 0.0), r, k * quarter, (k + 1) * quarter, 0.1) for k in range(4)))
    (whole,), joint = joined(parts, np.full(4, P), sharpest=4.0, lonely=np.inf)
    assert np.all(whole.kind == ARC)
    assert not np.any(joint.deviation)
    # an end that is 1 um beside turns the direction by 2e-6 rad
    other = arc((0.0, 0.0), r, np.pi + 2e-6, 2.0 * np.pi, 0.1)
    other.origin[0] = (-r, 0.0, 0.0)
    (run,), joint = joined(
        joined_up(arc((0.0, 0.0), r, 0.0, np.pi, 0.1), other), np.full(2, P), sharpest=4.0, lonely=np.inf
    )
    assert POLYNOMIAL in run.kind
    assert 0.0 < joint.deviation[0] <= 0.05 * P
    path = points(run, 200)
    assert np.abs(np.linalg.norm(path, axis=1) - r).max() <= 0.05 * P + 1e-6
