"""`feeddrive lobes`: the stability lobes of a milling cut, and a check of whether the machine's own cut chatters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.job import Job, JobLike, read_job
from feeddrive.files.machine import MachineFile, MachineLike, find_bundled, read_machine
from feeddrive.files.run_files import write_parquet
from feeddrive.files.toml_file import read_toml
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.text import Text, capitalized
from feeddrive.loop.machine import Machine
from feeddrive.machining.lobes import Lobes, ZeroOrder, stability_lobes, zero_order
from feeddrive.machining.regeneration import Regeneration, regeneration
from feeddrive.machining.tool_point import ToolMode, cut_of, tool_modes, tool_point
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts
from feeddrive.workflow.command import OUT, Outcome, Request, argument, called, command, option, stem

# default numbers of speeds: fewer for a helical cutter, which needs separate segments at each depth and is slower
_SPEEDS, _HELICAL = 120, 40
_MOST = 5000  # largest number of speeds


class LobesRequest(Request):
    """The machine with a milling cut among its couplings, the spindle speeds, and known modes of the tool."""

    machine: MachineLike | JobLike = argument("A machine file or a job (TOML) with a milling_cut among its couplings")
    speeds: str | None = option(
        "spindle speeds in rpm, as 2000:12000:200, first:last:count; from a half to double of the cut's if left out",
        default=None,
    )
    mode: tuple[str, ...] = option(
        "a mode of tool or work, as 922:0.011:0.04, Hz:damping ratio:kg, in both directions; with :x or :y behind it "
        "in one; may be repeated",
        default=(),
    )
    rigid: bool = option("the drives count as rigid: the modes alone give way", default=False)
    direction: float | None = option(
        "direction of the feed, from x towards y; that of the cut, or 0, if left out",
        unit="rad",
        entered="deg",
        default=None,
    )
    depth: float | None = option(
        "axial depth of the cut; that of the cutter if left out", unit="m", entered="mm", above=0, default=None
    )
    deepest: float | None = option(
        "axial depth up to which limits are looked for", unit="m", entered="mm", above=0, default=None
    )
    process_damping: float | None = option(
        "force per depth and per vibration velocity over cutting speed; it depends on the wear of the edge",
        unit="N/m",
        least=0,
        default=None,
    )
    islands: bool = option("look for stable depths above the limit as well", default=False)
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for rigid drives without a tool mode."""
        if self.rigid and not self.mode:
            raise ParameterError("--rigid leaves nothing that gives way: name the modes of the tool with --mode")

    def usual_out(self) -> Path:
        return Path("results") / f"lobes_{stem(self.machine)}"


@command(LobesRequest)
def lobes(request: LobesRequest, progress: Progress) -> Outcome[Lobes]:
    """Compute the chatter-free depths of a milling cut over the spindle speed, and judge the machine's cut.

    Raises ParameterError for a machine without a cut and for invalid speeds, and the errors of `stability_lobes`.
    """
    machine = _machine(request.machine)
    try:
        cut = cut_of(machine)
    except ParameterError as error:
        raise ParameterError(f"{called(request.machine)}: {error}") from None
    teeth = _teeth(request, cut)
    own = float(cut.spindle_speed)
    depth = request.depth if request.depth is not None else float(cut.cutter.edge().axial_depth)
    speeds = _speeds(request.speeds, own, _HELICAL if teeth.lag else _SPEEDS)
    modes = [mode for text in request.mode for mode in _modes(text)]
    progress.step("the machine at the tool")
    tool = tool_modes(*modes) if request.rigid else tool_point(machine)
    if modes and not request.rigid:
        # drives and modes transmit the same cutting force, so their compliances add
        tool = tool + tool_modes(*modes)
    turn = request.direction if request.direction is not None else float(cut.direction or 0.0)
    # the stability analysis has the feed along the first direction of the tool point
    tool = tool.turned(turn) if turn else tool
    result = stability_lobes(
        tool,
        teeth,
        speeds,
        deepest=request.deepest,
        islands=request.islands,
        speed=own,
        depth=depth,
        progress=progress,
    )
    # written beside the limits for comparison: Altintas & Budak 1995, without flip borders
    simple = zero_order(tool, teeth, speeds)
    files: dict[str, str | Path] = {}
    known = {
        "Machine": called(request.machine),
        "Cut": Text(
            f"{teeth.teeth} teeth, Kt {Quantity(teeth.tangential, 'N/m2', bare=True):5 N/mm2}, Kn "
            f"{Quantity(teeth.radial, 'N/m2'):5 N/mm2}, engaged {span(teeth.entry, teeth.leave, 'rad', 'deg')}"
        ),
        "Feed": Text(f"{Quantity(turn, 'rad'):deg} from x towards y"),
        "Gives way": ", ".join(([] if request.rigid else ["the drives under control"]) + list(request.mode)),
    }
    if request.out is not None:
        progress.step("report")
        files["Report"] = write_lobes(result, simple, request.out, known)
    assert result.own is not None
    judgment = Judgment.STABLE_CUT if result.own.stable else Judgment.CHATTERS
    return Outcome(
        result,
        [result.table()],
        _remarks(result),
        Text(f"{result.own.sentence()}."),
        files=files,
        judgment=judgment,
        page=partial(lobes_report, result, known),
    )


def _machine(source: MachineLike | JobLike) -> Machine:
    """Return all axes with their couplings, from a machine file or a job."""
    if isinstance(source, MachineFile):
        return source.machine()
    if not isinstance(source, Job) and _is_job(source):
        source = read_job(source)
    if isinstance(source, Job):
        return next(iter(source.machines.values()), source.machine.machine())
    return read_machine(source).machine()


def _is_job(path: str | Path) -> bool:
    """Return True for a job: a file without axes, or the name of a bundled job that is not a machine."""
    try:
        # machines first: a bundled name may be that of a machine and of a job
        place = find_bundled(path, "machines")
    except FileError:
        try:
            place = find_bundled(path, "jobs")
        except FileError:
            return False
    return not isinstance(read_toml(place).content.get("axis"), dict)


def _teeth(request: LobesRequest, cut: MillingCut) -> Regeneration:
    """Return the regeneration model of the cut, with the process damping of the request or of the cut."""
    damping = request.process_damping
    if damping is None:
        damping = float(cut.process_damping or 0.0)
    try:
        return regeneration(cut.cutter, process_damping=damping)
    except ParameterError as error:
        raise ParameterError(f"{called(request.machine)}, the cutter of its milling_cut: {error}") from None


def _speeds(text: str | None, own: float, count: int) -> np.ndarray:
    """Parse `first:last:count` into spindle speeds in rpm; by default they span half to double the speed `own`.

    Raises ParameterError for an invalid string.
    """
    if text is None:
        return np.linspace(0.5 * own, 2.0 * own, count)
    try:
        first, last, *rest = text.split(":")
        low, high, count = float(first), float(last), int(rest[0]) if rest else count
        # written as a chain, so that nan fails too
        if len(rest) > 1 or not 0.0 < low < high < math.inf or not 2 <= count <= _MOST:
            raise ValueError
    except ValueError:
        raise ParameterError(
            f"--speeds {text}: must be first:last:count in rpm, as 2000:12000:200, with 0 < first < last and 2 to "
            f"{_MOST} of them"
        ) from None
    return np.linspace(low, high, count)


def _modes(text: str) -> list[ToolMode]:
    """Parse a string `Hz:damping ratio:kg`, with :x or :y appended for a single direction, into modes.

    Raises ParameterError for an invalid string.
    """
    numbers = text.split(":")
    direction = numbers.pop() if numbers[-1] in ("x", "y") else ""
    try:
        frequency, damping, mass = (float(part) for part in numbers)
        shapes = {"x": [(1.0, 0.0)], "y": [(0.0, 1.0)], "": [(1.0, 0.0), (0.0, 1.0)]}[direction]
        return [ToolMode(frequency, damping, mass, *shape) for shape in shapes]
    except (ValueError, ParameterError) as error:
        why = f": {error}" if isinstance(error, ParameterError) else ""
        raise ParameterError(
            f"--mode {text}: must be Hz:damping ratio:kg, as 922:0.011:0.04, or with :x or :y behind it{why}"
        ) from None


def _remarks(result: Lobes) -> list[str]:
    """Return remarks on the stability limits."""
    remarks: list[str] = []
    if np.any(result.flip):
        remarks.append("At flip borders every second tooth cuts deeper: the zero-order theory does not know them.")
    if result.missed > 1e-3:
        remarks.append(
            Text(
                f"The response of the machine at the tool is matched to {Quantity(result.missed, 'share'):2} of its "
                "largest compliance: limits are as uncertain."
            )
        )
    if result.islands:
        n = len({speed for speed, _, _ in result.islands})
        remarks.append(f"At {n} speeds deeper cuts are stable again above the limit: the table holds the first limit.")
    return remarks


def write_lobes(result: Lobes, simple: ZeroOrder, out: Path, known: Mapping[str, str]) -> Path:
    """Write `report.html`, `lobes.csv` and `lobes.parquet` into `out`; return the path of the report.

    Raises FileError if the directory cannot be written.
    """
    columns = {
        "spindle_speed": result.spindle_speed,
        "depth": result.depth,
        "chatter_frequency": result.frequency,
        "flip": result.flip.astype(float),
        "zero_order_depth": simple.depth,
    }
    units = {"spindle_speed": "rpm", "depth": "m", "chatter_frequency": "Hz", "flip": "", "zero_order_depth": "m"}
    heads = ",".join(f"{name} [{units[name]}]" if units[name] else name for name in columns)
    rows = (",".join(repr(float(value)) for value in row) for row in zip(*columns.values(), strict=True))
    with new_directory(out) as folder:
        write_parquet(folder / "lobes.parquet", columns, {"units": units, **known})
        (folder / "lobes.csv").write_text("\n".join([heads, *rows]) + "\n", encoding="utf-8")
        (folder / "report.html").write_text(html(lobes_report(result, known)), encoding="utf-8")
    return out / "report.html"


def lobes_report(result: Lobes, known: Mapping[str, str] | None = None) -> Report:
    """Return the report of stability limits; `known` holds facts about the cut."""
    assert result.own is not None
    own, shown = result.own.table(), result.table()
    drawn = Picture(
        "lobes",
        "Depth without chatter over the spindle speed",
        "Shaded: stable. Dotted: speeds at which a tooth passes every k swings of a mode. Below: what is heard at the "
        "limit; dashed are the own frequencies of what gives way.",
        "Limits of the axial depth and chatter frequency over the spindle speed.",
        result.chart,
    )
    return Report(
        "Will the cut chatter?",
        "feeddrive lobes",
        Verdict((capitalized(f"{own.title}."), capitalized(f"{shown.title}.")), good=result.own.stable),
        (Section("limits", "Limits", (own, shown, Remarks(_remarks(result)))), facts("The cut", known or {})),
        drawn,
    )
