"""A real Dask cluster on 127.0.0.1: a scheduler and workers as processes of their own, which tests may kill."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

distributed = pytest.importorskip("distributed", reason="pip install 'feeddrive[cluster]'")


def free_port() -> int:
    """A port that nobody has at the moment."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class DaskCluster:
    """A scheduler at `address` and workers of one thread each; a nanny starts a worker again that was killed.

    tls  a folder with the certificates that docs/reference/security.md makes; without it the cluster uses no TLS
    """

    def __init__(self, folder: Path, tls: Path | None = None) -> None:
        self._folder, self._tls = folder, tls
        self.port = free_port()
        self.address = f"{'tls' if tls else 'tcp'}://127.0.0.1:{self.port}"
        self._running: list[subprocess.Popen[bytes]] = []

    def start_scheduler(self) -> None:
        """Start the scheduler, at the same address every time."""
        told = ("--port", str(self.port), "--no-dashboard", "--host", "127.0.0.1")
        self.scheduler = self._start("scheduler", *told, *self._certificates("scheduler"))

    def start_workers(self, count: int, *options: str, environment: dict[str, str] | None = None) -> None:
        """Start some workers and wait until they are there."""
        here = len(self.pids()) + count
        told = (
            self.address,
            "--nthreads",
            "1",
            "--no-dashboard",
            "--host",
            "127.0.0.1",
            *options,
            *self._certificates("worker"),
        )
        for _ in range(count):
            self._start("worker", *told, environment=environment)
        with self.client() as client:
            client.wait_for_workers(here, timeout=60)

    @contextmanager
    def client(self) -> Generator[distributed.Client]:
        """A client of the test's own."""
        security = None
        if self._tls is not None:
            security = distributed.Security(
                tls_ca_file=str(self._tls / "authority.pem"),
                tls_client_cert=str(self._tls / "client.pem"),
                tls_client_key=str(self._tls / "client.key"),
                require_encryption=True,
            )
        with distributed.Client(self.address, security=security, timeout=30, set_as_default=False) as client:
            yield client

    def pids(self) -> list[int]:
        """Processes of the workers."""
        with self.client() as client:
            return sorted(client.run(os.getpid).values())

    def close(self) -> None:
        """End all of it."""
        for each in reversed(self._running):  # the scheduler last: workers say good-bye to it
            each.terminate()
            try:
                each.wait(10)
            except subprocess.TimeoutExpired:
                each.kill()
                each.wait()

    def _certificates(self, name: str) -> tuple[str, ...]:
        """Options with the certificate of a process; none without TLS."""
        if self._tls is None:
            return ()
        files = {"--tls-ca-file": "authority.pem", "--tls-cert": f"{name}.pem", "--tls-key": f"{name}.key"}
        return ("--protocol", "tls", *(word for key, file in files.items() for word in (key, str(self._tls / file))))

    def _start(self, *words: str, environment: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        log = (self._folder / f"{words[0]}_{len(self._running)}.log").open("wb")
        settings = {**os.environ, "OPENBLAS_NUM_THREADS": "1", **(environment or {})}
        started = subprocess.Popen(
            [sys.executable, "-m", "dask", *words], stdout=log, stderr=log, cwd=self._folder, env=settings
        )
        log.close()
        self._running.append(started)
        return started


@contextmanager
def dask_cluster(folder: Path, workers: int, *options: str, tls: Path | None = None) -> Generator[DaskCluster]:
    """A cluster with some workers, ended at the end of the block."""
    cluster = DaskCluster(folder, tls)
    try:
        cluster.start_scheduler()
        if workers:
            cluster.start_workers(workers, *options)
        yield cluster
    finally:
        cluster.close()


def until(true: object, seconds: float = 60.0) -> None:
    """Wait until a function gives something true."""
    assert callable(true)
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)
