"""Evaluation of cases on an existing Dask cluster.

The client submits a few cases for each thread of the cluster and collects their outcomes.  Only the client writes the
store, so a folder on its local disk is enough, no worker needs access to it, and there is a single record of progress.
The fields that all cases share are sent once to each worker.  The outcomes are sent back; those of a chunk of a study
are its rows, some hundred bytes per variant.

A case whose worker was killed is computed again by another worker.  A case on which Dask gives up after several killed
workers is submitted again a few times, after which an error names the case.
"""

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
from dataclasses import dataclass
from itertools import count, islice
from typing import Any, Generic, TypeVar

from feeddrive.evaluation.case import Case, attached, computed, detached
from feeddrive.evaluation.scheduler import OPTIONS, Certificates, exposure, is_encrypted
from feeddrive.files.atomic_io import refusal
from feeddrive.language.errors import (
    FeeddriveError,
    FileError,
    MissingExtraError,
    ParameterError,
    WorkerError,
)
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.version import __version__

C = TypeVar("C", bound=Case[Any])
# cases handed out for each thread of the cluster: one at work and two that wait, so that it is never idle
_AHEAD = 3
# cases handed out before there is any worker: a cluster that grows on demand starts workers for them
_LEAST = 8
_LOOK = 0.02  # s between two looks at what is done
# s between two counts of the threads of the cluster, each of which is a request to the scheduler
_COUNT = 2.0
# s without a worker before a remark: a cluster that grows on demand needs a while to start one
_PATIENCE = 30.0
# times that a case may be given up: each time Dask itself has already tried it on several workers
_LOSSES = 3


def finished(
    cases: Iterable[C],
    address: str,
    progress: Progress,
    *,
    certificates: Certificates | None = None,
    timeout: float = 10.0,
) -> Generator[tuple[C, Any]]:
    """Yield each case with its outcome on completion; closing the generator cancels the pending cases.

    address       address of the scheduler, such as `tls://10.0.0.5:8786`
    certificates  of the client; None: those of Dask's configuration, if there are any
    timeout       longest time to wait for a response of the scheduler, s

    A scheduler that is neither local nor reached by TLS is warned of by a remark.

    Raises MissingExtraError if dask.distributed is not installed, FileError for certificates that cannot be used,
    ParameterError for an address that does not respond or a cluster with another version of feeddrive, WorkerError if
    the scheduler is lost or a case repeatedly kills its worker, and any exception of `progress.check()`.
    """
    if warning := exposure(address):
        progress.remark(warning)
    with _client(address, certificates, timeout, progress) as client:
        _refuse_other_versions(client, address)
        yield from _Handed[C](client, address, progress).finished(iter(cases))


@dataclass
class _Place(Generic[C]):
    """A submitted case, its number among the cases of this client, and how many times Dask has given up on it."""

    case: C
    number: int
    losses: int = 0


class _Handed(Generic[C]):
    """The cases that one client has submitted."""

    def __init__(self, client: Any, address: str, progress: Progress) -> None:
        self._client, self._address, self._progress = client, address, progress
        # futures are shared by key: two clients with the same cases must not cancel those of the other
        self._run = secrets.token_hex(4)
        self._common: tuple[Any, ...] | None = None  # what the cases have in common
        self._sent: list[Any] = []  # futures of it, the last one in use
        self._handed: dict[Any, _Place[C]] = {}
        self._threads, self._counted, self._since = 0, -math.inf, time.monotonic()

    def finished(self, cases: Iterator[C]) -> Generator[tuple[C, Any]]:
        """Yield each case with its outcome on completion."""
        # an extra, which only evaluations on a cluster need
        from distributed import as_completed

        done = as_completed(loop=self._client.loop, with_results=True, raise_errors=False)
        numbers = count()
        try:
            while True:
                for case in islice(cases, max(self._window() - len(self._handed), 0)):
                    done.add(self._hand_out(_Place(case, next(numbers))))
                if not self._handed:
                    return
                self._wait(done)
                for future, answer in done.next_batch(block=False):
                    place = self._handed.pop(future)
                    if isinstance(answer, _Outcome):
                        yield place.case, answer.value
                    else:
                        self._explain(place, answer)
                        done.add(self._hand_out(place))
        finally:
            # also after an error: nobody collects these cases any more, and other users need the workers
            self._client.cancel([*self._sent, *self._handed])

    def _hand_out(self, place: _Place[C]) -> Any:
        """Submit a case and return its future, whose key is shown on the dashboard."""
        kind = f"feeddrive_{place.case.kind}"
        key = f"{kind}-{self._run}-{place.number:08d}-{place.losses}"
        common, rest = detached(place.case)
        sent = self._sent_common(common, kind) if common else None
        future = self._client.submit(_computed, sent, pickle.dumps(rest), __version__, key=key, pure=False)
        self._handed[future] = place
        return future

    def _sent_common(self, common: tuple[Any, ...], kind: str) -> Any:
        """Submit the shared fields as a separate task, which the scheduler runs again if its worker is killed."""
        # by identity, as `Case.common` requires: comparing arrays and blocks costs more than sending them again
        same = self._common is not None and all(a is b for a, b in zip(common, self._common, strict=True))
        # a lost future would fail every case that depends on it
        if not same or self._sent[-1].status not in ("pending", "finished"):
            key = f"{kind}_common-{self._run}-{len(self._sent)}"
            self._sent.append(self._client.submit(pickle.loads, pickle.dumps(common), key=key, pure=False))
            self._common = common
        return self._sent[-1]

    def _window(self) -> int:
        """Return the number of cases that may be pending at once; it depends on the threads of the cluster."""
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
                f"The cluster at {self._address} has no workers: the cases wait until some are started "
                f"(dask worker {self._address})."
            )
        return max(_AHEAD * self._threads, _LEAST)

    def _wait(self, done: Any) -> None:
        """Wait until at least one case is done."""
        self._progress.check()
        # polled: a blocking wait would notice neither a cancellation nor the loss of the scheduler
        while not done.has_ready():
            time.sleep(_LOOK)
            self._progress.check()
            if self._client.status != "running":
                raise self._lost()
            self._window()

    def _explain(self, place: _Place[C], answer: Any) -> None:
        """Raise the error of a case without an outcome, or return if it should be submitted again.

        answer  type, error and traceback of a task that failed, or the error that reports the loss of its outcome
        """
        from distributed import KilledWorker

        if self._client.status != "running":
            raise self._lost()
        which = place.case.name
        error = answer[1] if isinstance(answer, tuple) else None
        if isinstance(error, FeeddriveError):
            raise error
        if error is not None and not isinstance(error, KilledWorker):
            advice = "; install on the workers what the case needs" if isinstance(error, ImportError) else ""
            raise WorkerError(f"{which} could not be computed on the cluster: {type(error).__name__}: {error}{advice}")
        place.losses += 1
        if place.losses > _LOSSES:
            raise WorkerError(
                f"{which} was given up {place.losses} times, each time after several workers that ended while "
                "they computed it: is there enough memory for each?  Their logs hold their last words"
            )

    def _lost(self) -> WorkerError:
        return WorkerError(f"the connection to the scheduler at {self._address} is lost: start it again")


@contextmanager
def _client(address: str, certificates: Certificates | None, timeout: float, progress: Progress) -> Generator[Any]:
    """Yield a client of the cluster, which is closed at the end of the block."""
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "cluster", "work on a cluster") from None
    security = _security(certificates)
    try:
        # in another thread: a notebook already runs an event loop in this one, and asyncio.run would refuse
        with ThreadPoolExecutor(1) as apart:
            apart.submit(asyncio.run, asyncio.wait_for(_answer(address, security), timeout)).result()
        # not the default: a client of the calling program must stay the one that its own code uses
        client = Client(address, security=security, timeout=timeout, set_as_default=False, name="feeddrive")
    except (OSError, ValueError, TypeError) as error:  # TimeoutError is an OSError
        reason = str(error).splitlines()[0] if str(error) else Text(f"nothing within {Quantity(timeout, 's'):6 SI}")
        tls = f", and the certificates ({OPTIONS}), which must be of its authority" if is_encrypted(address) else ""
        raise ParameterError(
            f"no Dask scheduler answers at '{address}' ({reason}): start one (dask scheduler), or check the address; "
            f"it is what the scheduler printed, as tcp://10.0.0.5:8786{tls}"
        ) from None
    log = logging.getLogger("distributed.client")
    level = log.level
    # this module reports the same errors in one sentence; the log would write between the lines of the progress
    log.setLevel(logging.CRITICAL)
    try:
        if "dashboard" in client.scheduler_info().get("services", {}):
            progress.remark(f"Dashboard of the cluster: {client.dashboard_link}")
        yield client
    finally:
        client.close(timeout=timeout)
        log.setLevel(level)


def _security(certificates: Certificates | None) -> Any:
    """Return Dask's settings of TLS for these certificates; None, which stands for those of Dask's configuration.

    Raises FileError for files that cannot be read, or are no certificates and key.
    """
    from distributed import Security

    if certificates is None:
        return None
    ca_file, cert, key = str(certificates.ca_file), str(certificates.cert), str(certificates.key)
    for file in (ca_file, cert, key):
        try:
            with open(file, "rb"):
                pass
        except OSError as error:
            raise refusal(file, "read", error) from None
    security = Security(tls_ca_file=ca_file, tls_client_cert=cert, tls_client_key=key, require_encryption=True)
    try:
        security.get_connection_args("client")
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        raise FileError(
            f"{OPTIONS}: {ca_file}, {cert} and {key} are no certificate of an authority, certificate and its key in "
            f"PEM format ({error}): docs/reference/security.md makes them"
        ) from None
    return security


async def _answer(address: str, security: Any) -> None:
    """Request the identity of the scheduler, since a client would wait forever for a server with another protocol."""
    from distributed import Security, rpc

    async with rpc(address, connection_args=(security or Security()).get_connection_args("client")) as scheduler:
        await scheduler.identity()


def _refuse_other_versions(client: Any, address: str) -> None:
    """Raise ParameterError if the scheduler or a worker has another version of feeddrive, or lacks it.

    Workers that join later check the version themselves.  The scheduler needs feeddrive too, since it unpickles
    the messages that it passes on.
    """
    # a function of Python itself, since a worker without feeddrive can call no other
    asked = pkgutil.resolve_name, "feeddrive.version:__version__"
    try:
        versions = {f"the scheduler at {address}": client.run_on_scheduler(*asked)}
    except ImportError as error:
        versions = {f"the scheduler at {address}": error}
    workers = client.run(*asked, on_error="return")
    versions |= {f"worker {name} of the cluster at {address}": version for name, version in sorted(workers.items())}
    for who, version in versions.items():
        if version != __version__:
            has = f"has feeddrive {version}" if isinstance(version, str) else f"cannot import feeddrive ({version})"
            raise ParameterError(
                f"{who} {has}, and this is {__version__}: outcomes of two versions may differ; run  pip install "
                f"'feeddrive[cluster]=={__version__}'  there, and start it again"
            )


@dataclass(frozen=True)
class _Outcome:
    """A wrapper of an outcome from a worker, which distinguishes it from errors that Dask passes on."""

    value: Any


def _computed(common: tuple[Any, ...] | None, content: bytes, version: str) -> _Outcome:
    """Compute a case on a worker. It is sent as bytes, so that the scheduler needs no user-defined modules.

    Raises ParameterError if the versions of worker and client differ.
    """
    if version != __version__:
        raise ParameterError(f"a worker has feeddrive {__version__}, and this is {version}: start it again with that")
    case: Case[Any] = pickle.loads(content)
    return _Outcome(computed(case if common is None else attached(case, common), Progress()))
