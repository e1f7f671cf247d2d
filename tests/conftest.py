"""What holds for all tests."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

import fresh_draws
import no_pictures
import slow_share

# Before numpy is there: the tests share the cores already, and small matrices gain nothing by more threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Cyclic garbage is looked for after 20,000 new objects in place of 700: that took a fifteenth of the time of the tests,
# a third of that of their collection, and half of that of those that parse all sources.
gc.set_threshold(20_000)

# No deadline: a busy machine must not fail a proof; a found counterexample prints how to run it again.  CI draws the
# same examples every time, so that a landing does not hang on chance; everybody else draws new ones, and so does
# `--fresh-seed`, with which CI ends.
settings.register_profile("feeddrive", deadline=None, print_blob=True, derandomize=bool(os.environ.get("CI")))
settings.load_profile("feeddrive")

# Measured files that are not part of the repository: they lie beside it, or the tests that need them are skipped.
SHARED = Path(__file__).parents[1].parent / "shared" / "data"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("slow tests")
    group.addoption("--slow-share", type=float, metavar="SECONDS", help="run only slow tests, drawn to fit SECONDS")
    group.addoption("--slow-seed", metavar="TEXT", help="what draws them; the hash of the commit if left out")
    group.addoption("--store-slow-durations", action="store_true", help="write tests/slow_durations.json anew")
    drawn = parser.getgroup("drawn tests")
    drawn.addoption("--fresh-seed", type=int, metavar="SEED", help="run only drawn tests, with the draws of this seed")
    drawn.addoption(
        "--fresh-share", type=float, default=1.0, metavar="SHARE", help="of them only those the seed selects"
    )


@pytest.hookimpl(tryfirst=True)  # before the plugin of hypothesis looks at its seed
def pytest_configure(config: pytest.Config) -> None:
    if config.option.slow_share is not None and config.option.slow_seed is None:
        config.option.slow_seed = slow_share.commit()  # workers take the options of the process that starts them
    if config.option.fresh_seed is not None:
        config.option.hypothesis_seed = str(config.option.fresh_seed)
        settings.register_profile("fresh", settings.get_profile("feeddrive"), derandomize=False)
        settings.load_profile("fresh")


def pytest_report_header(config: pytest.Config) -> str | None:
    if config.option.fresh_seed is not None:
        return f"drawn tests: {fresh_draws.command(config.option.fresh_seed)}"
    seconds, seed = config.option.slow_share, config.option.slow_seed
    return None if seconds is None else f"slow tests: --slow-share {seconds:g} --slow-seed '{seed}'"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A slow test states its reason; `--slow-share` leaves all but its share out, `--fresh-seed` all but drawn ones."""
    if unexplained := slow_share.missing_reasons(items):
        raise pytest.UsageError(f"say why they are slow, @pytest.mark.slow(reason=...): {', '.join(unexplained[:5])}")
    if config.option.fresh_seed is not None:
        seed, share = config.option.fresh_seed, config.option.fresh_share
        names = (item.nodeid for item in items if fresh_draws.is_drawn(item))
        _keep(config, items, {name for name in names if fresh_draws.in_share(name, seed, share)})
    if config.option.slow_share is None:
        return
    slow = [item.nodeid for item in items if item.get_closest_marker("slow")]
    durations = slow_share.limits(items) | slow_share.read_durations()
    _keep(config, items, slow_share.drawn(slow, durations, config.option.slow_share, config.option.slow_seed))


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is imported and collected stays: a collector that leaves it alone takes 4 % less of the time."""
    gc.freeze()


def _keep(config: pytest.Config, items: list[pytest.Item], names: set[str]) -> None:
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in names])
    items[:] = [item for item in items if item.nodeid in names]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """How drawn tests that failed are repeated; what the slow tests took, for `--store-slow-durations`."""
    if config.option.fresh_seed is not None:
        for report in (*terminalreporter.getreports("failed"), *terminalreporter.getreports("error")):
            terminalreporter.write_line(f"to repeat: {fresh_draws.command(config.option.fresh_seed, report.nodeid)}")
    if not config.option.store_slow_durations:
        return
    took: dict[str, float] = {}
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports(""):
        if "slow" in report.keywords:
            took[report.nodeid] = took.get(report.nodeid, 0.0) + report.duration
    slow_share.write_durations(took)
    terminalreporter.write_line(f"{len(took)} durations are stored in {slow_share.DURATIONS}")


@pytest.fixture(autouse=True)
def _few_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts of a report take time: tests of commands leave its pictures empty.

    `@pytest.mark.pictures` keeps them: one test a command, so that every page is drawn once.
    """
    rooms = ("cli", "comparison", "evaluation", "study", "workflow")
    if request.path.parent.name in rooms and not request.node.get_closest_marker("pictures"):
        monkeypatch.setattr(no_pictures.DRAWN_BY, no_pictures.empty)


@pytest.fixture(autouse=True)
def _own_path() -> Iterator[None]:
    """`cli.main` keeps its child processes from importing what lies beside the logs; foreign programs of later tests
    are not its children, and may import their own modules.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    yield
    if before is None:
        os.environ.pop("PYTHONSAFEPATH", None)


@pytest.fixture
def seeded(request: pytest.FixtureRequest) -> fresh_draws.Seeded:
    """Seeds of random cases whose assertions hold for all: a test's own number, or with `--fresh-seed` another one.

    A test of noise whose bound is a chance keeps a seed of its own.
    """
    return fresh_draws.mixed(request.config.option.fresh_seed)


@pytest.fixture
def shared() -> Path:
    """The folder of measured files."""
    if not SHARED.is_dir():
        pytest.skip(f"NOT TESTED on measured files: the folder {SHARED} is not there")
    return SHARED


@pytest.fixture
def emps(shared: Path) -> Path:
    """The log of the EMPS ball-screw axis (Janot, Gautier & Brunot 2019)."""
    path = shared / "emps" / "DATA_EMPS.mat"
    if not path.exists():
        pytest.skip(f"NOT TESTED on the EMPS axis: {path} is not there")
    return path
