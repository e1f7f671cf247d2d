"""`feeddrive reproduce`: run the experiments of a paper, and tabulate its claims and results."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.papers import claims
from feeddrive.papers.claims import Reproduced
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, option


class ReproduceRequest(Request):
    """The paper to reproduce."""

    paper: str = argument("altintas2009, gordon2013, beltran2013, wu2017, or all; emps or bench with --log")
    log: Path | None = option("the published log: DATA_EMPS.mat for emps, MultisineTypeA.mat for bench", default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for the measured axis without its log, and for a log with a paper."""
        file = claims.MEASURED.get(self.paper)
        if file is not None and self.log is None:
            raise ParameterError(f"{self.paper} needs its measured log: feeddrive reproduce {self.paper} --log {file}")
        if file is None and self.log is not None:
            raise ParameterError(
                f"--log is the measured log of {' or '.join(claims.MEASURED)}, and '{self.paper}' has none: leave it "
                "out"
            )

    def usual_out(self) -> Path:
        return Path("results") / self.paper


@command(ReproduceRequest)
def reproduce(request: ReproduceRequest, progress: Progress) -> Outcome[Sequence[Reproduced]]:
    """Run a paper's experiments and tabulate its claims, the acceptance bounds of each claim, and the results.

    Papers run in parallel processes.  `emps` takes three of them through a measured axis, `bench` pole placement
    through a measured one with two encoders.  Raises ParameterError for an
    unknown paper, and LogError for a log that is not the published one.
    """
    # before the output is opened: an unknown paper must leave no directory
    names = () if request.log is not None else claims.chosen(request.paper)
    files: dict[str, Path] = {}
    with contextlib.ExitStack() as stack:
        # opened before the work, so that an unwritable output fails immediately
        folder = None if request.out is None else stack.enter_context(new_directory(request.out))
        if request.log is None:
            reproduced = claims.reproduce(names, progress)
        else:
            # imported on use: it loads identification and tuning, which `--help` does not need
            module = import_module(f"feeddrive.papers.{request.paper}")
            reproduced = [Reproduced(getattr(module, request.paper)(request.log, progress.named(request.paper)))]
        if folder is not None and request.out is not None:
            claims.fill(folder, reproduced)
            files["Report"] = request.out / "report.html"
    holds = all(claim.holds for paper in reproduced for claim in paper.claims)
    tables = [_claims(paper) for paper in reproduced]
    sentences = [f"{paper.name}: {paper.sentence}" for paper in reproduced]
    judgment = Judgment.CLAIMS_HOLD if holds else Judgment.CLAIM_FAILS
    return Outcome(reproduced, [*tables, *sentences], files=files, judgment=judgment)


def _claims(paper: Reproduced) -> Table:
    rows = [[claim.key, claim.claim, claim.bounds, claim.shown, claim.cells()[-1]] for claim in paper.claims]
    return Table(paper.title, ["row", "claim", "expected", "got", "holds?"], rows, sentences=1)
