"""Design of servo loops for machine-tool feed drives, from a measured log or a machine file to a verified loop.

This namespace holds the names that most programs need. All others are in the subpackages that `dir(feeddrive)` lists,
and the blocks are in `feeddrive.blocks`. Names are loaded on first use, so that `import feeddrive` is fast.
"""

from typing import Any

from feeddrive.language.lazy_package import make_lazy, public_names
from feeddrive.language.table import views_from

# former names and their replacements; until 1.0
_RENAMED = {
    "get": "fd.parameters(loop)[path]",
    "leaves": "fd.parameters(loop)",
    "arena": "fd.compare",
    "Arena": "fd.comparison.Comparison",
    "shape": "fd.tune",
    "write_arena": "fd.comparison.write_comparison",
    "ShapedLoop": "fd.tuning.Tuned",
    "Site": "fd.tuning.OperatingPoint",
    "measured_site": "fd.tuning.measured_point",
    "modelled_site": "fd.tuning.modelled_point",
    "Shaped": "fd.blocks.InputShaped",
    "Comparison": "fd.jobs.JobResult for a job that was run, fd.comparison.Comparison for laws that were compared",
}


def _load_views(kind: type) -> None:
    """Import the chart, table and report of a result type when one of them is first requested."""
    # imported late: these modules import most of the package
    from feeddrive.plot.registry import register
    from feeddrive.workflow.reports import register_report

    register(kind)
    register_report(kind)


def _draw(chart: Any) -> Any:
    from feeddrive.plot.drawing import drawn

    return drawn(chart)


def _moved(name: str) -> Any:
    """Raise AttributeError for a missing name, stating its new name or similar names if there are any."""
    here = public_names(__name__)
    if name in _RENAMED:
        raise AttributeError(f"fd.{name} is now {_RENAMED[name]}")
    for room in [room for room, place in here.items() if place == __name__]:
        if name in public_names(f"{__name__}.{room}"):
            raise AttributeError(f"fd.{name} is now fd.{room}.{name}")
    from feeddrive import blocks

    # blocks need their own test, as no subpackage lists their names
    if name[:1].isupper() and hasattr(blocks, name):
        raise AttributeError(f"fd.{name} is now fd.blocks.{name}")
    near = {public: f"fd.{public}" for public in here}
    for room in [room for room, place in here.items() if place == __name__]:
        near |= {public: f"fd.{room}.{public}" for public in public_names(f"{__name__}.{room}") if public not in near}
    if name[:1].isupper():
        near |= {block: f"fd.blocks.{block}" for block in dir(blocks) if block not in near}
    from difflib import get_close_matches  # only for a message

    matches = get_close_matches(name, near, 3)
    raise AttributeError(
        f"feeddrive has no name '{name}'; "
        + (f"did you mean {' or '.join(near[public] for public in matches)}?" if matches else "dir(fd) lists them")
    )


views_from(_load_views, _draw)
make_lazy(
    __name__,
    {
        "": (
            "analysis benchmark blocks bus certificate commissioning comparison cosimulation evaluation export figures "
            "files identification jobs learning loop machining path plot study testing tuning workflow"
        ),
        "analysis.margins": "margins",
        "analysis.measured_loop": "measured_loop",
        "analysis.stability": "stability",
        "analysis.stiffness": "stiffness",
        "export.targets": "write_export",
        "files.frf": "read_frf write_frf",
        "files.job": "read_job",
        "files.log": "Log",
        "files.machine": "read_machine",
        "files.read_log": "read_log",
        "identification.excitation.estimate_frf": "estimate_frf",
        "language.errors": "FeeddriveError",
        "language.tree": "parameters vary",
        "loop.axis": "Axis",
        "loop.control": "Control",
        "loop.frequency_response": "FRF",
        "loop.gradient": "gradient",
        "loop.guard": "Guard",
        "loop.linearize": "compliance linearize loop_gain tracking",
        "loop.loop": "Loop",
        "loop.machine": "Machine",
        "loop.simulate": "simulate simulate_batch stream",
        "version": "__version__",
        "workflow.certify": "certify read_certificate write_certificate",
        "workflow.commission": "commission",
        "workflow.compare": "compare",
        "workflow.export": "verify",
        "workflow.identify": "identify",
        "workflow.run_job": "run",
        "workflow.tune": "tune",
    },
    _moved,
)
