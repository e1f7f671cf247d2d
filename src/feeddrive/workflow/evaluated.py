"""The options of commands that evaluate many cases: the workers or cluster, and how to resume a stopped call."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from feeddrive.evaluation.engine import MOST_WORKERS, Engine
from feeddrive.evaluation.store import Folder
from feeddrive.language.errors import CancelledError, ParameterError, WorkerError
from feeddrive.language.text import Text
from feeddrive.workflow.command import Request, option


class EngineRequest(Request):
    """The base class of requests that evaluate cases; their own fields come first."""

    workers: int | None = option(
        "Number of cases computed side by side; default: the number of cores",
        default=None,
        least=1,
        most=MOST_WORKERS,
        last=True,
    )
    scheduler: str | None = option(
        "Address of a Dask cluster that computes in place of this machine, as tcp://10.0.0.5:8786",
        default=None,
        last=True,
    )


class EvaluationRequest(EngineRequest):
    """The base class of requests whose finished cases are stored."""

    resume: bool = option(
        "Go on with an earlier call that was stopped: finished cases are not computed again", default=False, last=True
    )


@contextmanager
def engine_of(request: EvaluationRequest, keep: Path | None, out: Path | None) -> Generator[Engine]:
    """Yield the engine of a request; finished cases are stored in `keep`, or temporarily beside `out`.

    The caller's block writes the results: after it, cases beside `out` are removed, and those in `keep` stay. An error
    that ends the block early states how many cases `--resume` can reuse. Raises ParameterError for a request to resume
    without either.
    """
    store = _store(keep, out, resume=request.resume)
    engine = Engine.of(request.workers, request.scheduler, store)
    try:
        yield engine
    except (CancelledError, WorkerError) as error:
        if store is None or not store.count:
            raise
        reason = "stopped" if isinstance(error, CancelledError) else error
        raise type(error)(
            Text(f"{reason}; finished cases in {store.place}: {store.count}; go on with --resume")
        ) from None
    if store is not None and keep is None:
        store.clear()


def _store(keep: Path | None, out: Path | None, *, resume: bool) -> Folder | None:
    if keep is not None:
        return Folder(keep)  # a named directory is always continued
    if out is not None:
        return Folder(out.parent / f"{out.name}_cases", resume)
    if resume:
        raise ParameterError("resume: name with --out or --keep where the finished cases are")
    return None
