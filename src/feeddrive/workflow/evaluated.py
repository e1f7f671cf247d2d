"""The options of commands that evaluate many cases: local workers or a cluster, and resumption of a stopped run."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from feeddrive.evaluation.engine import MOST_WORKERS, Engine
from feeddrive.evaluation.scheduler import Certificates
from feeddrive.evaluation.store import Folder
from feeddrive.language.errors import CancelledError, ParameterError, WorkerError
from feeddrive.language.text import Text
from feeddrive.workflow.command import Request, option


class EngineRequest(Request):
    """The base class of requests that evaluate cases. Its options are listed after those of the subclass."""

    workers: int | None = option(
        "Number of cases computed side by side; default: the number of cores",
        default=None,
        least=1,
        most=MOST_WORKERS,
        last=True,
    )
    scheduler: str | None = option(
        "Address of a Dask cluster that computes in place of this machine, as tls://10.0.0.5:8786",
        default=None,
        last=True,
    )
    tls_ca_file: Path | None = option(
        "Certificate of the authority of a cluster with TLS, PEM; default: that of Dask's configuration",
        default=None,
        last=True,
    )
    tls_cert: Path | None = option("Certificate of this client of a cluster with TLS, PEM", default=None, last=True)
    tls_key: Path | None = option("Key of the certificate of this client, PEM", default=None, last=True)

    @property
    def certificates(self) -> Certificates | None:
        """The certificates of this client. Raises the errors of `Certificates.of`."""
        return Certificates.of(self.scheduler, self.tls_ca_file, self.tls_cert, self.tls_key)


class EvaluationRequest(EngineRequest):
    """The base class of requests whose finished cases are stored."""

    resume: bool = option(
        "Go on with an earlier call that was stopped: finished cases are not computed again", default=False, last=True
    )


@contextmanager
def engine_of(request: EvaluationRequest, keep: Path | None, out: Path | None) -> Generator[Engine]:
    """Yield the engine of a request, as a context manager.

    Finished cases are stored in `keep` or, without it, in a folder next to `out`. The body of the `with` statement must
    write the results. If it succeeds, the folder next to `out` is removed, whereas cases in `keep` are retained.
    If the run is cancelled, by its progress or by Ctrl-C or a signal, or loses its workers, the error states how many
    finished cases `--resume` can reuse.
    Raises ParameterError for `resume` without `keep` or `out`.
    """
    store = _store(keep, out, resume=request.resume)
    engine = Engine.of(request.workers, request.scheduler, store, request.certificates)
    try:
        yield engine
    except (CancelledError, KeyboardInterrupt, WorkerError) as error:
        if store is None or not store.count:
            raise
        # the class gives the exit code, so it stays that of the cause
        kind, reason = (WorkerError, error) if isinstance(error, WorkerError) else (CancelledError, "stopped")
        raise kind(Text(f"{reason}; finished cases in {store.place}: {store.count}; go on with --resume")) from None
    if store is not None and keep is None:
        # reached only if the results were written: until then the cases are the only copy
        store.clear()


def _store(keep: Path | None, out: Path | None, *, resume: bool) -> Folder | None:
    if keep is not None:
        # who names a directory for finished cases wants them reused, without --resume
        return Folder(keep)
    if out is not None:
        return Folder(out.parent / f"{out.name}_cases", resume)
    if resume:
        raise ParameterError("resume: name with --out or --keep where the finished cases are")
    return None
