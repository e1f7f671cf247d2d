"""`feeddrive studio`: the page of an axis, until Ctrl-C."""

from __future__ import annotations

import secrets
import socket
import webbrowser
from pathlib import Path

from feeddrive.files.machine import MachineLike
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio.bench import Bench, bench_of
from feeddrive.studio.server import PAGE, make_app, serve
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option

HOST = "127.0.0.1"  # nothing else: who is not on this machine does not reach the page


class StudioRequest(Request):
    """Which axis is opened, and where the page listens."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    axis: str | None = option("the axis; the only one if left out", default=None)
    folder: Path = option(
        "in which each page keeps what it is given and what it writes; nothing else is written",
        default=Path("results/studio"),
    )
    port: int = option("of the page on this machine; 0: any free one", default=0, least=0, most=65535)
    no_browser: bool = option("open no browser: print the address alone", default=False)


@command(StudioRequest)
def studio(request: StudioRequest, progress: Progress) -> Outcome[Bench]:
    """Open a page on which the control of an axis is tuned by hand, and serve it until Ctrl-C.

    Raises MissingExtraError without the extra `studio`; ParameterError for a port that is taken, and where the page was
    not built.
    """
    bench = bench_of(request.machine, request.axis)
    if not (PAGE / "index.html").is_file():
        raise ParameterError(
            "this installation holds no built page: in a clone of the repository run  make studio  once, which needs "
            "node and npm"
        )
    with socket.socket() as wanted:
        try:
            wanted.bind((HOST, request.port))
        except OSError as error:
            raise ParameterError(
                f"--port {request.port}: cannot be used ({error.strerror}): choose another one, or 0 for a free one"
            ) from None
        port = wanted.getsockname()[1]
    token = secrets.token_urlsafe(24)
    address = f"http://{HOST}:{port}/?token={token}"

    hosts = f"{HOST}:{port}", f"localhost:{port}"

    def ready() -> None:
        progress.remark(address)
        if not request.no_browser:
            webbrowser.open(address)

    serve(make_app(bench, hosts, token, request.folder), HOST, port, ready)
    return Outcome(bench)
