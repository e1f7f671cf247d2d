"""The chunks of a study on a Dask cluster that is there already.

The client hands out a few chunks for each thread of the cluster, and takes their rows back: it alone writes the store,
so that a folder of the client's own disk is enough, no worker needs to see it, and one place says what is done.  What
travels is the study, once to each worker, and the rows, some hundred bytes a variant.

A chunk of a worker that was killed is computed again by another one.  What Dask gives up after several of them is
handed out again a few times; then the chunk is named.
"""

from __future__ import annotations

import asyncio
import logging
import math
import pickle
import pkgutil
import secrets
import time
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any

from feeddrive.language.errors import (
    FeeddriveError,
    MissingExtraError,
    ParameterError,
    WorkerError,
)
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.study.chunk import run_chunk
from feeddrive.study.study import Study
from feeddrive.version import __version__

if TYPE_CHECKING:
    import pyarrow

_AHEAD = 3  # chunks for each thread of the cluster that are handed out, so that none waits for the client
_LEAST = 8  # handed out while no worker is there: a cluster that grows on demand starts some for them
_LOOK = 0.02  # s between two looks at what is done
_COUNT = 2.0  # s between two counts of the cluster's threads
_PATIENCE = 30.0  # s without a worker after which that is said
_LOSSES = 3  # times that Dask may give a chunk up, each after several workers that ended with it


def finished(
    study: Study, numbers: Iterable[int], address: str, progress: Progress, *, timeout: float = 10.0
) -> Generator[tuple[int, pyarrow.Table]]:
    """Number and rows of each chunk, in the order in which they are done; closing it cancels what is handed out.

    address  of the scheduler, `tcp://10.0.0.5:8786`
    timeout  s until an address that does not answer is given up

    Raises MissingExtraError without dask.distributed, ParameterError for an address that nobody answers or a cluster
    with another version of feeddrive, WorkerError if the scheduler is lost or a chunk ends its workers again and
    again, and what `progress.check()` raises.
    """
    with _client(address, timeout, progress) as client:
        _refuse_other_versions(client, address)
        yield from _Sweep(client, study, address, progress).finished(iter(numbers))


class _Sweep:
    """What one client has handed out of one study."""

    def __init__(self, client: Any, study: Study, address: str, progress: Progress) -> None:
        self._client, self._study, self._address, self._progress = client, study, address, progress
        self._run = f"{study.digest[:8]}-{secrets.token_hex(4)}"  # two clients with one study do not share futures
        self._sent: list[Any] = []  # futures of the study, the last one in use
        self._handed: dict[Any, int] = {}  # future -> number of its chunk
        self._losses: dict[int, int] = {}
        self._threads, self._counted, self._since = 0, -math.inf, time.monotonic()

    def finished(self, numbers: Iterator[int]) -> Generator[tuple[int, pyarrow.Table]]:
        """Number and rows of each chunk."""
        import pyarrow as arrow
        from distributed import as_completed

        done = as_completed(loop=self._client.loop, with_results=True, raise_errors=False)
        try:
            while True:
                for number in islice(numbers, max(self._window() - len(self._handed), 0)):
                    done.add(self._hand_out(number))
                if not self._handed:
                    return
                self._wait(done)
                for future, found in done.next_batch(block=False):
                    number = self._handed.pop(future)
                    if isinstance(found, arrow.Table):
                        yield number, found
                    else:
                        self._explain(number, found)
                        done.add(self._hand_out(number))
        finally:
            self._client.cancel([*self._sent, *self._handed])

    def _hand_out(self, number: int) -> Any:
        """The future of a chunk; its name is that on the dashboard."""
        key = f"feeddrive_chunk-{self._run}-{number:08d}-{self._losses.get(number, 0)}"
        future = self._client.submit(_chunk, self._sent_study(), number, __version__, key=key, pure=False)
        self._handed[future] = number
        return future

    def _sent_study(self) -> Any:
        """The study as a task of its own, so that the scheduler computes it again where its worker is killed."""
        if not self._sent or self._sent[-1].status not in ("pending", "finished"):
            key = f"feeddrive_study-{self._run}-{len(self._sent)}"
            self._sent.append(self._client.submit(_opened, pickle.dumps(self._study), key=key, pure=False))
        return self._sent[-1]

    def _window(self) -> int:
        """How many chunks may be handed out at once: workers come and go."""
        now = time.monotonic()
        if now - self._counted > _COUNT:
            self._counted = now
            try:
                self._threads = sum(self._client.nthreads().values())
            except OSError:
                raise self._lost() from None
        if self._threads:
            self._since = now
        elif now - self._since > _PATIENCE:
            self._since = now
            self._progress.remark(
                f"The cluster at {self._address} has no workers: the sweep waits until some are started "
                f"(dask worker {self._address})."
            )
        return max(_AHEAD * self._threads, _LEAST)

    def _wait(self, done: Any) -> None:
        """Until a chunk is done."""
        self._progress.check()
        while not done.has_ready():
            time.sleep(_LOOK)
            self._progress.check()
            if self._client.status != "running":
                raise self._lost()
            self._window()

    def _explain(self, number: int, found: Any) -> None:
        """Raise why a chunk has no rows; returns where it is to be handed out again.

        found  type, error and traceback of a task that failed, or the error with which its rows were lost
        """
        from distributed import KilledWorker

        if self._client.status != "running":
            raise self._lost()
        rows = self._study.range(number)
        which = f"chunk {number} (variants {rows.start} to {rows.stop - 1})"
        error = found[1] if isinstance(found, tuple) else None
        if isinstance(error, FeeddriveError):
            raise error
        if error is not None and not isinstance(error, KilledWorker):
            advice = "; install on the workers what the study needs" if isinstance(error, ImportError) else ""
            raise WorkerError(f"{which} could not be computed on the cluster: {type(error).__name__}: {error}{advice}")
        self._losses[number] = self._losses.get(number, 0) + 1
        if self._losses[number] > _LOSSES:
            raise WorkerError(
                f"{which} was given up {self._losses[number]} times, each time after several workers that ended while "
                "they computed it: is there enough memory for each?  Their logs hold their last words"
            )

    def _lost(self) -> WorkerError:
        return WorkerError(f"the connection to the scheduler at {self._address} is lost: start it again")


@contextmanager
def _client(address: str, timeout: float, progress: Progress) -> Generator[Any]:
    """A client of the cluster, closed at the end of the block."""
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "cluster", "a sweep on a cluster") from None
    try:
        with ThreadPoolExecutor(1) as apart:  # a notebook has an event loop of its own in this thread
            apart.submit(asyncio.run, asyncio.wait_for(_answer(address), timeout)).result()
        client = Client(address, timeout=timeout, set_as_default=False, name="feeddrive")
    except (OSError, ValueError, TypeError) as error:  # TimeoutError is an OSError
        reason = str(error).splitlines()[0] if str(error) else Text(f"nothing within {Quantity(timeout, 's'):6 SI}")
        raise ParameterError(
            f"no Dask scheduler answers at '{address}' ({reason}): start one (dask scheduler), or check the address; "
            "it is what the scheduler printed, as tcp://10.0.0.5:8786"
        ) from None
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)  # what it would say beside the progress is said by errors
    try:
        if "dashboard" in client.scheduler_info().get("services", {}):
            progress.remark(f"Dashboard of the cluster: {client.dashboard_link}")
        yield client
    finally:
        client.close(timeout=timeout)
        log.setLevel(level)


async def _answer(address: str) -> None:
    """Ask the scheduler who it is: a client would wait without end for a server that speaks another protocol."""
    from distributed import Security, rpc

    async with rpc(address, connection_args=Security().get_connection_args("client")) as scheduler:
        await scheduler.identity()


def _refuse_other_versions(client: Any, address: str) -> None:
    """Raise ParameterError where scheduler or a worker has another version of feeddrive, or none.

    Workers that come later say it for themselves.  The scheduler needs it, since Dask reads there what it hands on.
    """
    asked = pkgutil.resolve_name, "feeddrive.version:__version__"  # Python's own: what is of feeddrive may not be there
    try:
        found = {f"the scheduler at {address}": client.run_on_scheduler(*asked)}
    except ImportError as error:
        found = {f"the scheduler at {address}": error}
    workers = client.run(*asked, on_error="return")
    found |= {f"worker {name} of the cluster at {address}": version for name, version in sorted(workers.items())}
    for who, version in found.items():
        if version != __version__:
            has = f"has feeddrive {version}" if isinstance(version, str) else f"cannot import feeddrive ({version})"
            raise ParameterError(
                f"{who} {has}, and this is {__version__}: rows of two versions may differ; run  pip install "
                f"'feeddrive[cluster]=={__version__}'  there, and start it again"
            )


def _opened(content: bytes) -> Study:
    """The study on a worker; runs there. As bytes, so that the scheduler needs no modules of one's own."""
    return pickle.loads(content)


def _chunk(study: Study, number: int, version: str) -> pyarrow.Table:
    """The rows of a chunk; runs on a worker. Raises ParameterError if that has another version than the client."""
    if version != __version__:
        raise ParameterError(f"a worker has feeddrive {__version__}, and this is {version}: start it again with that")
    return run_chunk(study, number)
