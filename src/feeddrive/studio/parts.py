"""The simulations of a control that pictures show beside its loop: runs, step and poles, computed when first needed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import TypeVar

from feeddrive.analysis.step_response import StepResponse, step_response
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.simulate import Run
from feeddrive.studio.bench import Bench

T = TypeVar("T")


class Parts:
    """Simulations of a control on a bench. None where one is impossible: no machine, an unstable loop, or bounds
    exceeded.
    """

    def __init__(self, bench: Bench, control: Control, name: str) -> None:
        self.bench, self.control, self.name = bench, control, name

    @cached_property
    def run(self) -> Run | None:
        """The move followed by the force on the table."""
        return self._if_there(lambda: self.bench.run(self.control, self.name))

    @cached_property
    def snap(self) -> Run | None:
        """The rope that is cut."""
        return self._if_there(lambda: self.bench.snap(self.control, self.name))

    @cached_property
    def linear(self) -> StateSpace | None:
        """The linear loop from the set position to the table."""
        return self._if_there(lambda: self.bench.linear(self.control))

    @cached_property
    def step(self) -> StepResponse | None:
        """The step response of the set position."""
        model = self.linear
        return None if model is None else self._if_there(lambda: step_response(model))

    def _if_there(self, compute: Callable[[], T]) -> T | None:
        if self.bench.loop is None:
            return None
        with suppress(FeeddriveError):
            return compute()
        return None
