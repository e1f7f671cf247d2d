"""`feeddrive benchmark`: evaluate all laws with their stored designs on the fixed plants of the benchmark."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from feeddrive.benchmark.benchmark import Benchmark, advice, laws_of, score, search
from feeddrive.benchmark.report import benchmark_report, citation, reasons, write_benchmark
from feeddrive.benchmark.rules import VERSION, Rules, read_rules
from feeddrive.benchmark.standings import score_tables
from feeddrive.evaluation.lineup import Lineup
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.tuning.candidates import PLAIN
from feeddrive.workflow.command import OUT, Outcome, command, option
from feeddrive.workflow.evaluated import EvaluationRequest, engine_of


class BenchmarkRequest(EvaluationRequest):
    """The plants, laws and seed of a benchmark, and the options for tuning the laws again."""

    plant: tuple[str, ...] = option("A plant that is wanted; may be repeated; default: all", default=())
    law: tuple[str, ...] = option(
        "A law that is wanted, by name or kind, beside P-PI; may be repeated; default: all", default=()
    )
    seed: int = option("Seed of the runs; 0: the seeds of the rules", default=0, least=0)
    retune: bool = option(
        "Search the laws that have no design in --keep yet, over each box; all of them take hours", default=False
    )
    keep: Path | None = option(
        "Directory of designs that are kept as they are found, to go on after a stop; they come before the stored ones",
        default=None,
    )
    rules: int = option("Version of the rules", default=VERSION, least=1)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"benchmark_{self.rules}"


AT_THE_MODELS = (
    "the bounds hold at the models of the plants, at all their positions, and not over tolerances: these rules have no "
    "box; feeddrive compare MACHINE --box standard ranks the laws of one axis over one"
)


def rules_in_short(rules: Rules) -> list[str]:
    """Return what a reader of the tables must know of the rules, in sentences."""
    if rules.draws:
        return [
            f"each figure: times better than {PLAIN}, the geometric mean over the plants named above and their draws",
            *(f"{subject.lower()}: {text}" for subject, text in rules.stated()),
        ]
    return [
        f"each figure: times better than {PLAIN}, the geometric mean over the plants on which both have a place",
        *([AT_THE_MODELS] if rules.tolerances is None else []),
    ]


@command(BenchmarkRequest)
def benchmark(request: BenchmarkRequest, progress: Progress) -> Outcome[Benchmark]:
    """Run every law with its stored design on the fixed plants of the benchmark, and print a table to be cited.

    User-defined laws (--blocks) have no stored design and are tuned first.  With `retune` all laws are tuned, over each
    box of the rules and their variants, except those whose design is already in the directory `keep`, and P-PI, which
    is the stored one if laws are named without it.  Raises ParameterError for an unknown plant, law or version of the
    rules.
    """
    if request.retune and request.keep is None:
        raise ParameterError("--retune: name with --keep the directory in which the designs are kept as they are found")
    rules = read_rules(request.rules)
    plants = rules.chosen(request.plant)
    # checked here: an unknown law must be refused before a search that takes hours
    laws = laws_of(plants, request.law, rules)
    own = tuple(law for law in Lineup.of(plants[0].model).user_defined if not laws or law in laws)
    files: dict[str, Path] = {}
    with engine_of(request, None, request.out) as engine, TemporaryDirectory() as forgotten:
        keep = request.keep or Path(forgotten)
        if request.retune or own:
            # a table needs the designs of all boxes; a law of the user is first tried over that of the rules
            for searched in rules.boxes() if request.retune else (rules,):
                search(
                    searched,
                    searched.chosen(request.plant),
                    keep,
                    laws=laws if request.retune else own,
                    engine=engine,
                    progress=progress,
                )
        scored = score(rules, plants, laws=laws, designs=[keep], own=request.seed, engine=engine, progress=progress)
        if request.out is not None:
            progress.step("report")
            files["Report"] = write_benchmark(scored, request.out)
    judgment, verdict = advice(scored, asked=bool(request.law))
    missing = [reasons(scored)] if scored.unplaced() else []
    # a law that was requested by name and has no rank gets its reason at once, others only with --verbose
    named = missing if request.law else []
    return Outcome(
        scored,
        [*score_tables(scored), *named],
        [*rules_in_short(scored.rules), f"to be cited as: {citation(scored)}"],
        verdict,
        files=files,
        judgment=judgment,
        page=partial(benchmark_report, scored),
        details=[scored.winners(), *([] if named else missing)],
    )
