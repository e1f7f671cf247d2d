"""The engine: outcomes in the order of the cases wherever they are computed, finished ones kept, stopped in time."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pytest

from feeddrive.evaluation.case import Case, content_digest
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.store import Folder
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import CancelledError, ParameterError, UnstableError
from feeddrive.language.progress import Progress

if TYPE_CHECKING:
    from dask_cluster import DaskCluster


@dataclass(frozen=True, eq=False)
class Sum(Case[float]):
    """The sum of a table and a number; refused for a negative one."""

    common: ClassVar[tuple[str, ...]] = ("table",)
    stages: ClassVar[int] = 3

    table: tuple[float, ...]
    number: float
    seconds: float = 0.0

    @property
    def name(self) -> str:
        return f"number {self.number:g}"

    def outcome(self, progress: Progress) -> float:
        progress.step("adding")
        time.sleep(self.seconds)
        if self.number < 0.0:
            raise UnstableError(f"{self.number:g} is negative")
        return sum(self.table) + self.number

    def record(self, outcome: float) -> Any:
        return outcome.hex()

    def restored(self, record: Any, progress: Progress) -> float:
        return float.fromhex(record)


class Threaded(Sum):
    """The same as machine code would be."""

    @property
    def threaded(self) -> bool:
        return True


class Told(Progress):
    """What is told, in order; cancels at a step, or once so many cases are done."""

    def __init__(self, at: str = "never", cases: int = 1000) -> None:
        super().__init__()
        self.at, self.cases, self.steps = at, cases, list[tuple[str, int | None, int | None]]()

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.steps.append((what, done, of))
        if what == self.at or sum(":" not in said for said, _, _ in self.steps) == self.cases:
            self.cancel()


TABLE = (0.1, 0.2, 0.7)
CASES = [Sum(TABLE, number, seconds=0.05 * (3.0 - number)) for number in (0.0, 1.0, 2.0, 3.0)]  # the last is done first
WANTED = [case.outcome(Progress()) for case in CASES]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Generator[DaskCluster]:
    from dask_cluster import dask_cluster  # takes half a second, which each process of the engine would spend, too

    with dask_cluster(tmp_path_factory.mktemp("cluster"), 0) as own:
        places = os.pathsep.join([str(Path(__file__).parent), *sys.path])
        own.start_workers(2, "--no-nanny", environment={"PYTHONPATH": places})
        yield own


@pytest.mark.parametrize("kind", [Sum, Threaded])
@pytest.mark.parametrize("workers", [1, 2])
def test_outcomes_stand_in_the_order_of_the_cases(kind: type[Sum], workers: int) -> None:
    cases = [kind(TABLE, case.number, case.seconds) for case in CASES]
    told = Told()
    assert Engine(workers).evaluate(cases, told) == WANTED
    shares = [done / of for _, done, of in told.steps if done is not None and of]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_cluster_gives_the_same(cluster: DaskCluster, tmp_path: Path) -> None:
    store = Folder(tmp_path / "kept")
    assert Engine(scheduler=cluster.address, store=store).evaluate(CASES) == WANTED
    assert store.count == len(CASES)  # the client keeps them
    with pytest.raises(UnstableError, match="-1 is negative"):
        Engine(scheduler=cluster.address).evaluate([*CASES, Sum(TABLE, -1.0)])


def test_stages_of_processes_are_heard() -> None:
    told = Told()
    Engine(2).evaluate([replace(case, seconds=0.3) for case in CASES], told)
    assert {f"{case.name}: adding" for case in CASES} <= {what for what, _, _ in told.steps}


def test_cases_with_other_things_in_common_are_computed_beside_each_other() -> None:
    """What is sent once is that of the first case; a case with a table of its own takes it along."""
    other = Sum((1.0, 2.0), 4.0)
    assert Engine(2).evaluate([*CASES, other]) == [*WANTED, 7.0]


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_finished_is_kept_and_not_computed_again(workers: int, tmp_path: Path) -> None:
    store = Folder(tmp_path / "kept")
    with pytest.raises(CancelledError):
        Engine(workers, store=store).evaluate(CASES, Told(cases=2))
    before = {path.name: path.stat().st_mtime_ns for path in store.place.iterdir()}
    assert 1 <= len(before) < len(CASES)
    told = Told()
    assert Engine(workers, store=store).evaluate(CASES, told) == WANTED
    assert before.items() <= {path.name: path.stat().st_mtime_ns for path in store.place.iterdir()}.items()
    computed = {what for what, _, _ in told.steps if what.endswith("adding")}
    assert len(computed) <= len(CASES) - len(before)
    # one who does not resume begins anew
    told = Told()
    assert Engine(store=replace(store, resume=False)).evaluate(CASES, told) == WANTED
    assert sum(what.endswith("adding") for what, _, _ in told.steps) == len(CASES)
    (store.place / "notes.txt").write_text("of a person")
    store.clear()
    assert [path.name for path in store.place.iterdir()] == ["notes.txt"]


def test_a_damaged_or_changed_file_is_computed_anew(tmp_path: Path) -> None:
    store = Folder(tmp_path)
    Engine(store=store).evaluate(CASES[:1])
    (path,) = tmp_path.iterdir()
    for content in ("", "{}", '{"digest": "x"}', path.read_text().replace(CASES[0].digest, "0" * 64), "[1]"):
        path.write_text(content)
        assert Engine(store=store).evaluate(CASES[:1]) == WANTED[:1]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_first_error_ends_the_others(workers: int) -> None:
    begun = time.monotonic()
    with pytest.raises(UnstableError, match="-1 is negative"):
        Engine(workers).evaluate([Sum(TABLE, -1.0), *(Sum(TABLE, float(i), 20.0) for i in range(4))])
    assert time.monotonic() - begun < 15.0


def test_a_cancel_ends_processes_at_work() -> None:
    begun = time.monotonic()
    with pytest.raises(CancelledError):
        Engine(2).evaluate([Sum(TABLE, float(i), 60.0) for i in range(4)], Told(at="number 1: adding"))
    assert time.monotonic() - begun < 30.0


def test_no_case_is_no_work() -> None:
    assert Engine(4).evaluate([]) == []
    assert list(Engine(4).finished(iter(()))) == []


def test_cases_are_taken_as_workers_become_free() -> None:
    taken = list[int]()

    def many() -> Generator[Sum]:
        for number in range(1000):
            taken.append(number)
            yield Threaded(TABLE, float(number))

    finished = Engine(2).finished(many())
    next(finished)
    finished.close()
    assert len(taken) < 10


def test_impossible_engines_are_refused() -> None:
    for workers in (0, 1025):
        with pytest.raises(ParameterError, match=f"workers = {workers} must be 1 to 1024"):
            Engine(workers)
    with pytest.raises(ParameterError, match="the scheduler has its own: give one of them"):
        Engine.of(2, "tcp://127.0.0.1:1")


def test_a_digest_follows_from_every_bit() -> None:
    """Of a loop every number and the structure, and of a case every field; two of the same content are alike."""
    loop = read_machine("linear_motor").loop("x")
    same = read_machine("linear_motor").loop("x")
    assert content_digest(loop) == content_digest(same)
    Kp = float(tree.get(loop, "axis.x.control.law.Kp"))
    other = tree.vary(loop, {"axis.x.control.law.Kp": float(np.nextafter(Kp, np.inf))})
    assert content_digest(other) != content_digest(loop)
    digests = {content_digest(value) for value in (1, 1.0, "1", (1,), [(1,)], {"a": 1}, None, True, np.array([1.0]))}
    assert len(digests) == 9
    assert replace(CASES[0], number=-0.0).digest != CASES[0].digest
    with pytest.raises(TypeError, match="has no content"):
        content_digest(len)


def test_a_bar_goes_over_several_evaluations() -> None:
    told = Told()
    bar = Bar(told, 2 * Sum.stages + 1)
    Engine().evaluate(CASES[:1], bar)
    bar.step("between")
    Engine().evaluate(CASES[1:2], bar)
    assert told.steps[-1][1:] == (7, 7)
