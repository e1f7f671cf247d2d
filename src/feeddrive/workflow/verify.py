"""`feeddrive verify`: the bit-for-bit comparison of an export with the simulator, on the user's computer."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.verify import MOST, Verified, verify_export
from feeddrive.files.atomic_io import write_whole
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option


class VerifyRequest(Request):
    """The export, the length of the trial, and the compiler."""

    directory: Path = argument("A directory that `feeddrive export` wrote")
    samples: int | None = option(
        "samples of the trial; default: 1000000, 5000 in single precision", least=1, most=MOST, default=None
    )
    seed: int = option("seed of the random samples", default=1, least=0)
    compiler: str | None = option("another compiler than gcc, cc or clang", default=None)
    flag: tuple[str, ...] = option("a flag for it, such as -O3; may be repeated", default=())
    out: Path | None = option("File for the certificate (text)", short="-o", default=None)


@command(VerifyRequest)
def verify(request: VerifyRequest, progress: Progress) -> Outcome[Verified]:
    """Run the equality proof of an export again, with this machine's compiler."""
    progress.step(f"verifying {request.directory}")
    verified = verify_export(
        request.directory, samples=request.samples, seed=request.seed, flags=request.flag, command=request.compiler
    )
    text = verified.sentences()
    files: dict[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, text + "\n")
        files["Certificate"] = request.out
    judgment = Judgment.NOT_EQUAL if verified.differing else Judgment.EQUAL if verified.holds else Judgment.CHANGED
    return Outcome(verified, text.splitlines(), files=files, judgment=judgment)
