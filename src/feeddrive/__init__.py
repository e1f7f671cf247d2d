"""feeddrive: the servo loop of a machine-tool feed drive, from a measured log or a machine file to a proven loop.

The names that most programs need stand here; all others stand in the rooms that `dir(feeddrive)` shows, the blocks in
`feeddrive.blocks`.  Names are loaded on first use, so that `import feeddrive` stays quick.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from feeddrive.language.lazy_package import make_lazy, public_names
from feeddrive.language.table import views_from

# names of before whose work another name does now; until 1.0
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
    "Comparison": "fd.workflow.JobResult for a job that was run, fd.comparison.Comparison for laws that were compared",
}


def _load_views(kind: type) -> None:
    """Import what makes chart and DataFrame of a type of result, when they are first asked for."""
    from feeddrive.plot.registry import register

    register(kind)


def _draw(chart: Any) -> Any:
    from feeddrive.plot.drawing import drawn

    return drawn(chart)


def _moved(name: str) -> Any:
    """The error for a name that is not here, with the one to write if there is one."""
    here = public_names(__name__)
    if name in _RENAMED:
        raise AttributeError(f"fd.{name} is now {_RENAMED[name]}")
    for room in [room for room, place in here.items() if place == __name__]:
        if name in public_names(f"{__name__}.{room}"):
            raise AttributeError(f"fd.{name} is now fd.{room}.{name}")
    if name[:1].isupper():  # a block that no stub lists
        from feeddrive import blocks

        if hasattr(blocks, name):
            raise AttributeError(f"fd.{name} is now fd.blocks.{name}")
    near = {each: f"fd.{each}" for each in here}
    for room in [room for room, place in here.items() if place == __name__]:
        near |= {each: f"fd.{room}.{each}" for each in public_names(f"{__name__}.{room}") if each not in near}
    found = get_close_matches(name, near, 3)
    raise AttributeError(
        f"feeddrive has no name '{name}'; "
        + (f"did you mean {' or '.join(near[each] for each in found)}?" if found else "dir(fd) lists them")
    )


views_from(_load_views, _draw)
make_lazy(__name__, _moved)
