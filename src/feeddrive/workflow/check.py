"""`feeddrive check`: check a certificate in exact arithmetic, using only the standard library."""

from __future__ import annotations

from pathlib import Path

from feeddrive.certificate.check import checked
from feeddrive.language.errors import FileError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, Request, argument, command


class CheckRequest(Request):
    """The certificate to check."""

    file: Path = argument("A certificate (JSON)")


@command(CheckRequest)
def check(request: CheckRequest, progress: Progress) -> Outcome[bool]:
    """Check a certificate in exact arithmetic. The result is True if the certificate is proven.

    Otherwise the last line of the outcome gives the reason. Raises FileError for a missing file.
    """
    if not request.file.exists():
        raise FileError(f"{request.file}: no such file")
    progress.step(f"checking {request.file}")
    lines, proven = checked(str(request.file))
    return Outcome(proven, lines, judgment=Judgment.PROVEN if proven else Judgment.NOT_PROVEN)
