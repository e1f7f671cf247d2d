"""The tunings of a comparison, sequential or in parallel processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.tuning.candidates import Candidate, Refusal
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.tunables import law_tunables
from feeddrive.tuning.tune import tune_control
from feeddrive.tuning.tuned import Tuned


@dataclass(frozen=True)
class Rule:
    """What all laws are tuned to: bounds of Ms and delay margin, speed of the axis in m/s, starts of a search."""

    sensitivity_peak: float
    delay_margin_samples: float
    velocity: float
    starts: int

    @property
    def sentence(self) -> str:
        """The rule in words."""
        return (
            f"every law but today's is tuned for the least rope-snap error subject to Ms <= {self.sensitivity_peak:g} "
            f"and a delay margin of at least {self.delay_margin_samples:g} samples, the loop cut at the actuator"
        )


def tuned_all(
    candidates: Sequence[Candidate], rule: Rule, workers: int, progress: Progress
) -> dict[str, Tuned | Refusal]:
    """Every candidate by name: tuned, or refused with the reason. `progress` reports each name."""
    workers = min(workers, len(candidates))
    if workers <= 1:
        found: dict[str, Tuned | Refusal] = {}
        for candidate in candidates:
            progress.step(candidate.name)
            found[candidate.name] = _tuned(candidate, rule)
        return found
    # those with the most tunables take longest: they go first
    order = sorted(candidates, key=lambda candidate: -len(law_tunables(candidate.loop.control)))
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    context = multiprocessing.get_context("spawn")
    with _one_thread(), ProcessPoolExecutor(workers, context, _leave_interrupts) as pool:
        futures = {pool.submit(_tuned, candidate, rule): candidate.name for candidate in order}
        try:
            done: dict[str, Tuned | Refusal] = {}
            for future in as_completed(futures):
                progress.step(futures[future])
                done[futures[future]] = future.result()
            return {candidate.name: done[candidate.name] for candidate in candidates}
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


@contextlib.contextmanager
def _one_thread() -> Generator[None]:
    """Processes that begin here leave small matrices to one thread: several of them stand in each other's way."""
    name = "OPENBLAS_NUM_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        os.environ.pop(name)
        if before is not None:
            os.environ[name] = before


def _leave_interrupts() -> None:
    """Ctrl-C is for the process that asked."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _tuned(candidate: Candidate, rule: Rule) -> Tuned | Refusal:
    limits = Limits(rule.sensitivity_peak, delay_margin_samples=rule.delay_margin_samples)
    try:
        return tune_control(candidate.loop, limits=limits, filters="kept", starts=rule.starts, velocity=rule.velocity)
    except FeeddriveError as error:
        return Refusal(candidate.name, str(error))
