"""`feeddrive cosimulate`: the laws of a job against an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from feeddrive.cosimulation.simulate_with_fmu import Cosimulation, write_cosimulation
from feeddrive.cosimulation.simulate_with_fmu import cosimulate as run_against
from feeddrive.files.job import JobLike, read_job
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import OUT, Request, argument, option, stem


class CosimulateRequest(Request):
    """The job, the FMU, and the roles of its variables."""

    job: JobLike = argument("A job file (TOML) with a reference, or the name of a bundled job")
    fmu: Path = argument("The plant: an FMU 2.0 or 3.0. It is a program, and it is run")
    variable: tuple[str, ...] = option(
        "Role of a variable of the FMU, as force=F_drive or reading=x:mm; may be repeated", default=()
    )
    set: tuple[str, ...] = option("A parameter of the FMU, as m=160; may be repeated", default=())
    dead_time: float = option("Dead time before a command acts", default=0.0, unit="s")
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"cosimulate_{stem(self.job)}"


@command(CosimulateRequest)
def cosimulate(request: CosimulateRequest, progress: Progress) -> Outcome[Cosimulation]:
    """Run the laws of a job against somebody else's model of the machine: an FMU in place of the plant."""
    job = read_job(request.job)
    values = {name: _number(name, text) for name, text in _pairs("--set", request.set).items()}
    cosimulation = run_against(
        job,
        request.fmu,
        names=_pairs("--variable", request.variable),
        parameters=values,
        dead_time=request.dead_time,
        progress=progress.counted(len(job.loops)),
    )
    files: dict[str, Path] = {}
    if request.out is not None:
        files["Signals"] = write_cosimulation(cosimulation, request.out).parent / "runs"
    remark = "No margins: an FMU states no linear model. `feeddrive run` gives those of the machine file."
    tripped = any(row.figures()["trip"] > 0.0 for row in cosimulation.rows)
    judgment = Judgment.TRIPPED if tripped else Judgment.RAN
    return Outcome(
        cosimulation,
        [cosimulation.table()],
        [remark],
        files=files,
        judgment=judgment,
        failure=judgment.says if tripped else "",
    )


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not (mark and name and value) or name in pairs:
            raise ParameterError(f"{option} {text}: give each name once, as name=value")
        pairs[name] = value
    return pairs


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"--set {name}={text}: '{text}' is no number") from None
