"""Dry friction within a substep: friction forces consistent with the resulting velocities, with exact standstill."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from feeddrive.blocks.families import Friction, Mechanics
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number
from feeddrive.language.matrix import Row


class Contact(NamedTuple):
    """Friction on one body."""

    friction: Friction
    state: Any
    row: Row  # of the shape matrix: the body's position is row · q
    column: Row  # of the hold: what a force on the body does to (q, q', ...)


class Answer(NamedTuple):
    """Of a contact: its new state, the force in N, and whether the body is stuck."""

    state: Any
    force: Any
    stuck: Any


def settle(
    contacts: Sequence[Contact],
    position: Row,
    velocity: Row,
    free: Row,
    h: Number,
    sweeps: int,
) -> tuple[list[Any], list[Answer]]:
    """The end of a substep h, from the coordinates at its start and the end `free` that it would have without friction.

    Each contact is solved in turn with the latest forces of the others (Gauss-Seidel), `sweeps` times.
    """
    n = len(position)
    answers: list[Answer | None] = [None] * len(contacts)
    for _ in range(sweeps):
        for i, contact in enumerate(contacts):
            end = matrix.dot(contact.row, free[n : 2 * n])
            for other, answer in zip(contacts, answers, strict=True):
                if other is not contact and answer is not None:
                    end = plus(end, matrix.dot(contact.row, other.column[n : 2 * n]), answer.force)
            mobility = matrix.dot(contact.row, contact.column[n : 2 * n])
            start = matrix.dot(contact.row, velocity)
            answers[i] = Answer(*contact.friction.contact(h, contact.state, start, end, mobility))
    given = [answer for answer in answers if answer is not None]
    after = list(free)
    for contact, answer in zip(contacts, given, strict=True):
        after = [plus(x, column, answer.force) for x, column in zip(after, contact.column, strict=True)]
    for contact, answer in zip(contacts, given, strict=True):
        if answer.stuck is not False:
            _stop(contact.row, answer.stuck, after, position, velocity, h)
    return after, given


def plus(x: Any, column: Any, force: Any) -> Any:
    """x + column · force, without absent terms."""
    if force is None or matrix.is_zero(column) or matrix.is_zero(force):
        return x
    return column * force if matrix.is_zero(x) else x + column * force


def share_mass(mechanics: Mechanics) -> bool:
    """Whether a force on the motor's body accelerates the load's body directly: by a full mass matrix, or in a modal
    model.
    """
    n = len(mechanics.mass)
    full = any(not matrix.is_zero(mechanics.mass[i][j]) for i in range(n) for j in range(n) if i != j)
    motor, load = mechanics.shape[mechanics.motor], mechanics.shape[mechanics.load]
    return full or any(not matrix.is_zero(a) and not matrix.is_zero(b) for a, b in zip(motor, load, strict=True))


def _stop(row: Row, stuck: Any, end: list[Any], position: Row, velocity: Row, h: Number) -> None:
    """Set the velocity of a body that sticks at the end of a substep to exactly zero.

    Its last coordinate with the share 1 cancels all others; it must be the last for the sum row · q' to be exactly 0.
    The body ends where a constant deceleration to rest takes it, x + v h/2, and thus stays where it is if it stood
    before; the friction force, a mean over the substep, would let it creep while a spring on it is loaded.  Where two
    bodies share a coordinate, as in a modal model, the second is exact and the first is at rest up to rounding.
    """
    own = max((i for i, share in enumerate(row) if matrix.is_one(share)), default=None)
    if own is None:
        return
    n = len(position)
    others = [*row[:own], *row[own + 1 :]]
    moving = matrix.dot(others, [*end[n : n + own], *end[n + own + 1 : 2 * n]])
    end[n + own] = ops.where(stuck, 0.0 if matrix.is_zero(moving) else -moving, end[n + own])
    if n > 1:
        place = matrix.dot(row, position) + (0.5 * h) * matrix.dot(row, velocity)
        aside = matrix.dot(others, [*end[:own], *end[own + 1 : n]])
        end[own] = ops.where(stuck, place if matrix.is_zero(aside) else place - aside, end[own])
