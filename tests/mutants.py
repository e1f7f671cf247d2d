"""A mutation run: each equation of the shipped laws is changed a little, and a claim of its own paper must break.

`make mutate` writes docs/internals/mutants.md.  A mutant is the source of one function with one sign, one gain (5 %)
or one sample of delay changed, compiled in memory and put in its place in a process of its own.  Only the rows whose
claims name the equation are run.
"""

from __future__ import annotations

import ast
import copy
import inspect
import multiprocessing
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from feeddrive.language.errors import FeeddriveError

PAPERS = ("altintas2009", "gordon2013", "beltran2013", "wu2017")
CONTROLLER, OBSERVER = "feeddrive.blocks.controller", "feeddrive.blocks.observer"
FEEDFORWARD, COMPENSATION = "feeddrive.blocks.feedforward", "feeddrive.blocks.compensation"


@dataclass(frozen=True)
class Place:
    """Where an equation stands: a function (module, qualified name) and the names it assigns; "return" for its result.

    late  what stands for one sample of delay, as (text, text in its place); absent: the equation holds no last value
    """

    paper: str
    equation: str
    module: str
    function: str
    targets: tuple[str, ...]
    late: tuple[str, str] | None = None


def _place(paper: str, equation: str, module: str, function: str, targets: str, *late: str) -> Place:
    return Place(paper, equation, module, function, tuple(targets.split()), (late[0], late[1]) if late else None)


PLACES = (
    _place(
        "altintas2009",
        "DADSC (3)",
        f"{CONTROLLER}.dadsc",
        "DADSC.step",
        "v e_x e_v s",
        "s = self.tracking_rate * e_x + e_v",
        "s = state.sliding",
    ),
    _place(
        "altintas2009",
        "DADSC (4)",
        f"{CONTROLLER}.dadsc",
        "DADSC.step",
        "force acceleration",
        "- estimate +",
        "- state.estimate +",
    ),
    _place(
        "altintas2009",
        "DADSC (5)",
        f"{CONTROLLER}.dadsc",
        "DADSC.step",
        "held estimate",
        "prepared.g1 * s",
        "prepared.g1 * state.sliding",
    ),
    _place("altintas2009", "DADSC g1, g2", f"{CONTROLLER}.dadsc", "DADSC.prepare", "g2 return"),
    _place(
        "altintas2009",
        "cascade (7)",
        f"{CONTROLLER}.cascade_ppi",
        "CascadePPI.step",
        "velocity wanted e force integral return",
        "force + integral",
        "force + state.integral",
    ),
    _place(
        "altintas2009",
        "acceleration feedforward",
        f"{FEEDFORWARD}.inertia",
        "Inertia.step",
        "middle return",
        "0.5 * T",
        "-0.5 * T",
    ),
    _place(
        "altintas2009",
        "recovery from (6)",
        f"{OBSERVER}.disturbance_recovery",
        "DisturbanceRecovery.step",
        "velocity force",
        "commands[-1]",
        "(state.pending[-1] if state.pending else 0.0)",
    ),
    _place(
        "altintas2009",
        "recovery, filter",
        f"{OBSERVER}.disturbance_recovery",
        "DisturbanceRecovery.prepare",
        "return",
    ),
    _place("altintas2009", "recovery, Butterworth", "feeddrive.blocks.filter.biquad", "low_pass_section", "w return"),
    _place(
        "altintas2009",
        "Kalman recovery",
        f"{OBSERVER}.kalman_recovery",
        "KalmanRecovery.step",
        "force position velocity missed disturbance",
        "prepared.gain[2] * missed",
        "prepared.gain[2] * (state.position - position)",
    ),
    _place(
        "altintas2009",
        "Kalman recovery",
        f"{OBSERVER}.kalman_recovery",
        "KalmanRecovery.prepare",
        "noise ratio v,force return",
    ),
    _place(
        "altintas2009",
        "mode compensation",
        f"{COMPENSATION}.mode_compensation",
        "ModeCompensation.step",
        "force bent",
        "now = _moved(lead, before, force) if lead else before",
        "now = before",
    ),
    _place("altintas2009", "mode compensation", f"{COMPENSATION}.mode_compensation", "_moved", "return"),
    _place("altintas2009", "mode compensation", f"{COMPENSATION}.mode_compensation", "_hold", "turn give return"),
    _place(
        "altintas2009",
        "disturbance rejection",
        f"{COMPENSATION}.disturbance_rejection",
        "DisturbanceRejection.step",
        "force",
    ),
    _place(
        "gordon2013",
        "pole placement",
        f"{CONTROLLER}.pole_placement",
        "PolePlacement.step",
        "v1 v2 e e1 ev1,ev2 e1,ev1 added integral force",
        "Ki * integral",
        "Ki * state.integral",
    ),
    _place("gordon2013", "desired poles", f"{CONTROLLER}.pole_placement", "PolePlacement.polynomial", "turn"),
    _place("gordon2013", "desired poles", "feeddrive.blocks.plant.two_bodies", "polynomial", "quadratic term"),
    _place("gordon2013", "gains by (2)", "feeddrive.blocks.plant.two_bodies", "place", "free right slope left return"),
    _place(
        "gordon2013",
        "compatible commands",
        "feeddrive.blocks.plant.two_bodies",
        "relaxed_lead",
        "per_acceleration,per_velocity return",
    ),
    _place(
        "gordon2013",
        "compatible commands",
        "feeddrive.blocks.plant.two_bodies",
        "series",
        "return",
        "late * relaxed.velocity",
        "2.0 * late * relaxed.velocity",
    ),
    _place(
        "gordon2013",
        "compatible commands",
        f"{CONTROLLER}.pole_placement",
        "PolePlacement._followed",
        "position,velocity",
        "prepared.new * new",
        "prepared.new * before",
    ),
    _place(
        "gordon2013",
        "inverse dynamics",
        f"{FEEDFORWARD}.inverse_dynamics",
        "InverseDynamics.step",
        "middle a1,v1 screw return",
        "0.5 * T",
        "-0.5 * T",
    ),
    _place(
        "gordon2013",
        "prefilter",
        "feeddrive.blocks.prefilter.trajectory_prefilter",
        "TrajectoryPrefilter.step",
        "return",
    ),
    _place(
        "gordon2013",
        "friction feedforward",
        f"{FEEDFORWARD}.friction_feedforward",
        "FrictionFeedforward.step",
        "v return",
        "0.5 * T",
        "-0.5 * T",
    ),
    _place("gordon2013", "friction feedforward", "feeddrive.blocks.friction.curve", "stribeck_level", "ratio return"),
    _place("gordon2013", "filter pack", "feeddrive.blocks.filter.biquad", "tustin", "w base slope return"),
    _place("gordon2013", "filter pack", "feeddrive.blocks.filter.biquad", "section", "scale up return"),
    _place(
        "gordon2013",
        "filter pack",
        "feeddrive.blocks.filter.biquad",
        "advance",
        "output first return",
        "first = made.b1 * (value - output)",
        "first = made.b1 * (state.output - output)",
    ),
    _place(
        "beltran2013",
        "ADR (9)",
        f"{CONTROLLER}.active_disturbance_rejection",
        "ActiveDisturbanceRejection.step",
        "acceleration slower nearer force",
        "0.5 * T",
        "-0.5 * T",
    ),
    _place("beltran2013", "polynomial (18)", f"{OBSERVER}.gpi_observer", "GpiObserver.polynomial", "made"),
    _place("beltran2013", "polynomial (18)", f"{OBSERVER}.gpi_observer", "GpiObserver.gains", "rate"),
    _place(
        "beltran2013",
        "GPI observer (13)-(15)",
        f"{OBSERVER}.gpi_observer",
        "GpiObserver._rate",
        "turn rate[i][0] rate[i][i+1] rate[1][order] rate[0][order+1]",
    ),
    _place("beltran2013", "GPI observer (13)-(15)", f"{OBSERVER}.gpi_observer", "GpiObserver._sampled", "per_force Gu"),
    _place(
        "beltran2013",
        "GPI observer (13)-(15)",
        f"{OBSERVER}.gpi_observer",
        "GpiObserver.step",
        "moved z disturbance return",
        "y - state.position)",
        "0.0)",
    ),
    _place(
        "beltran2013",
        "cutting force (4)",
        "feeddrive.blocks.cutting.helical_cutter",
        "HelicalCutter.forces",
        "force feed normal return",
    ),
    _place(
        "beltran2013",
        "cutting force (4)",
        "feeddrive.blocks.cutting.helical_cutter",
        "HelicalCutter.torque",
        "force return",
    ),
    _place("beltran2013", "cutting force (4)", "feeddrive.blocks.cutting.engagement", "arc", "share angle"),
    _place(
        "beltran2013",
        "cutting force (4)",
        "feeddrive.blocks.cutting.helical_cutter",
        "_pieces",
        "sine,cosine both return",
    ),
    _place("beltran2013", "reference (19)-(22)", "feeddrive.blocks.reference.smooth_step", "tenth_degree", "return"),
    _place(
        "wu2017",
        "compensator (6), (7)",
        f"{FEEDFORWARD}.disturbance_compensator",
        "DisturbanceCompensator.regressors",
        "middle ratio extra regressors['mass'] regressors['viscous'] "
        "regressors['coulomb_positive'] regressors['coulomb_negative'] regressors['stribeck'] "
        "regressors['jerk_feedforward'] regressors['snap_feedforward']",
        "0.5 * T",
        "-0.5 * T",
    ),
    _place(
        "wu2017",
        "compensator (6), (7)",
        f"{FEEDFORWARD}.disturbance_compensator",
        "DisturbanceCompensator.step",
        "total",
    ),
    _place(
        "wu2017",
        "error model, model-free",
        "feeddrive.learning.iterative_feedforward",
        "_inverse",
        "back,seen whole rest",
    ),
    _place(
        "wu2017",
        "error model, model-free",
        "feeddrive.learning.iterative_feedforward",
        "filtered",
        "state output",
        "+ row * samples",
        "+ columns[max(k - 1, 0)] * samples",
    ),
    _place("wu2017", "update", "feeddrive.learning.iterative_feedforward", "next_iteration", "changed"),
    _place("wu2017", "convergence", "feeddrive.learning.iterative_feedforward", "convergence", "return"),
)


# mutants that nothing can tell from the original, with the reason
EQUIVALENT = {
    ("CascadePPI.step", "5 % of `state.integral`"): "of a law without integral, whose integral stays 0",
    ("KalmanRecovery.prepare", "5 % of `LARGEST_RATIO`"): "a bound on the numbers of the solver, which is not reached",
    ("convergence", "5 % of `seen`"): "the condition is that of scaled columns",
    ("convergence", "5 % of `gamma`"): "kept for the report",
}


@dataclass(frozen=True)
class Mutant:
    """One change: its place, its words, and the source of the function with it."""

    place: Place
    words: str
    source: str


def _owner(place: Place) -> tuple[Any, str, Any]:
    """What holds the function, its name there, and the function itself."""
    owner: Any = import_module(place.module)
    *path, name = place.function.split(".")
    for part in path:
        owner = getattr(owner, part)
    return owner, name, inspect.unwrap(owner.__dict__[name])


def _leaves(node: ast.expr) -> Iterator[tuple[str, ast.expr, ast.expr]]:
    """(words, node, what stands in its place) for every sign and every additive term of an expression."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        swapped = ast.BinOp(node.left, ast.Sub() if isinstance(node.op, ast.Add) else ast.Add(), node.right)
        yield "sign", node, swapped
        yield from _leaves(node.left)
        yield from _leaves(node.right)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
        yield "sign", node, node.operand
        yield from _leaves(node.operand)
    elif isinstance(node, ast.Tuple | ast.List):
        for each in node.elts:
            yield from _leaves(each)
    elif isinstance(node, ast.Starred):
        yield from _leaves(node.value)
    elif isinstance(node, ast.Dict):
        for each in node.values:
            yield from _leaves(each)
    elif isinstance(node, ast.ListComp | ast.GeneratorExp | ast.DictComp):
        yield from _leaves(node.value if isinstance(node, ast.DictComp) else node.elt)
    elif isinstance(node, ast.IfExp):
        yield from _leaves(node.body)
        yield from _leaves(node.orelse)
    elif isinstance(node, ast.Call) and ast.unparse(node.func) == "ops.zero":
        return
    elif isinstance(node, ast.Call) and not _numeric(node.func):
        for each in [*node.args, *(word.value for word in node.keywords)]:
            yield from _leaves(each)
    elif isinstance(node, ast.Call | ast.BinOp | ast.Name | ast.Attribute | ast.Subscript):
        yield "5 %", node, ast.BinOp(ast.Constant(1.05), ast.Mult(), node)
        yield from _inside(node)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value not in (0.0,):
        yield "5 %", node, ast.BinOp(ast.Constant(1.05), ast.Mult(), node)


def _inside(node: ast.expr) -> Iterator[tuple[str, ast.expr, ast.expr]]:
    """Sums in brackets inside a product or in an argument."""
    if isinstance(node, ast.BinOp) and not isinstance(node.op, ast.Add | ast.Sub):
        for each in (node.left, node.right):
            if isinstance(each, ast.BinOp) and isinstance(each.op, ast.Add | ast.Sub):
                yield from _leaves(each)
            else:
                yield from _inside(each)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
        yield "sign", node, node.operand
        yield from _inside(node.operand)
    elif isinstance(node, ast.Call):
        conditions = 1 if isinstance(node.func, ast.Attribute) and node.func.attr == "where" else 0
        for each in node.args[conditions:]:
            yield from _leaves(each)


_NUMERIC = {
    "exp",
    "sin",
    "cos",
    "tan",
    "tanh",
    "sqrt",
    "log",
    "where",
    "dot",
    "maximum",
    "minimum",
    "solve",
    "_moved",
    "backward_velocity",
    "eye",
    "atan2",
    "floor",
}


def _numeric(function: ast.expr) -> bool:
    return (function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")) in _NUMERIC


def _names(statement: ast.stmt) -> tuple[str, ...]:
    """What a statement assigns, as text; a pair as "a,b"."""
    if isinstance(statement, ast.Return):
        return ("return",)
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    found = []
    for each in targets:
        if isinstance(each, ast.Tuple):
            found.append(",".join(ast.unparse(part) for part in each.elts))
        elif each is not None:
            found.append(ast.unparse(each).replace(" ", ""))
    return tuple(found)


def _skipped(words: str) -> bool:
    """What is no number: a state, a tuple of them, an integer place."""
    return words in _NO_NUMBERS or words.startswith(("self.State", "range", "prepared.observer"))


# states, tuples and places; and the `output` of a filter that only a live change of it reads
_NO_NUMBERS = {
    "state",
    "after",
    "bodies",
    "middle",
    "lead",
    "positions",
    "interpolator",
    "model",
    "held",
    "made",
    "reading",
    "prepared.section[0]",
    "delayed",
    "self.Lead",
    "output",
    "state.z",
    "row",
    "moved",
    "names",
    "n",
    "columns.shape[1]",
    "whole.sample_time",
    "setpoint",
    "smoothed",
    "self.encoder",
    "sample.sample_time",
}


def mutants(place: Place) -> list[Mutant]:
    """All of a place."""
    _, _, function = _owner(place)
    text = textwrap.dedent(inspect.getsource(function))
    tree = ast.parse(text)
    found: list[Mutant] = []
    for statement in list(ast.walk(tree)):
        if not isinstance(statement, ast.Assign | ast.AnnAssign | ast.Return) or statement.value is None:
            continue
        if not set(_names(statement)) & set(place.targets):
            continue
        for kind, node, instead in _leaves(statement.value):
            shown = ast.unparse(node)
            if kind == "5 %" and _skipped(shown):
                continue
            changed = _Replaced(node, instead).visit(copy.deepcopy(_marked(tree, node)))
            words = f"{kind} of `{shown}`" if kind == "5 %" else f"sign in `{shown}`"
            found.append(Mutant(place, words, ast.unparse(ast.fix_missing_locations(changed))))
    if place.late is not None:
        plain = ast.unparse(tree)
        before, after = place.late
        assert plain.count(before) == 1, (place.function, before, plain.count(before))
        found.append(Mutant(place, f"late: `{after}` for `{before}`", plain.replace(before, after)))
    return found


def _marked(tree: ast.Module, node: ast.expr) -> ast.Module:
    for each in ast.walk(tree):
        each.__dict__["mark"] = each is node
    return tree


class _Replaced(ast.NodeTransformer):
    """Puts an expression in the place of the marked one."""

    def __init__(self, node: ast.expr, instead: ast.expr) -> None:
        self._instead = copy.deepcopy(instead)

    def visit(self, node: ast.AST) -> Any:
        if node.__dict__.get("mark"):
            return self._instead
        return self.generic_visit(node)


def apply(mutant: Mutant) -> None:
    """Put it in the place of the shipped function, in this process; names imported elsewhere follow."""
    owner, name, function = _owner(mutant.place)
    tree = ast.parse(mutant.source)
    made: dict[str, Any] = {}
    kept = ("classmethod", "staticmethod", "property")
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = [each for each in definition.decorator_list if ast.unparse(each) in kept]
    code = compile(
        ast.Module([ast.parse("from __future__ import annotations").body[0], *tree.body], []), "mutant", "exec"
    )
    exec(code, function.__globals__, made)
    new = made[name]
    type.__setattr__(owner, name, new) if isinstance(owner, type) else setattr(owner, name, new)
    for module in list(sys.modules.values()):
        if getattr(module, "__name__", "").startswith("feeddrive") and module.__dict__.get(name) is function:
            setattr(module, name, new)


def rows(paper: str) -> tuple[Callable[[], Any], ...]:
    """The rows of a paper in which shipped blocks run."""
    return import_module(f"feeddrive.papers.{paper}.shipped").ROWS


def claims_of(row: Callable[[], Any]) -> list[Any]:
    """The claims of a row."""
    found = row()
    return list(getattr(found, "claims", found))


def broken_by(mutant: Mutant, named: dict[str, tuple[str, ...]] | None = None) -> list[str]:
    """The claims that name the equation and no longer hold; `named`: what each row's claims name."""
    apply(mutant)
    found = []
    for row in rows(mutant.place.paper):
        if named is not None and mutant.place.equation not in named[row.__name__]:
            continue
        try:
            found += [
                each.key.split()[0]
                for each in claims_of(row)
                if mutant.place.equation in each.equations and not each.holds
            ]
        except FeeddriveError as error:
            found.append(f"{row.__name__} refused: {str(error)[:40]}")
        if found:
            break
    return found


def equations(paper: str) -> dict[str, tuple[str, ...]]:
    """By row, the equations that its claims name; all claims must hold."""
    found = {}
    for row in rows(paper):
        claims = claims_of(row)
        assert all(claim.holds for claim in claims), [claim.cells() for claim in claims if not claim.holds]
        found[row.__name__] = tuple({name for claim in claims for name in claim.equations})
    return found


def _work(job: tuple[str, Any, Any]) -> Any:
    kind, first, second = job
    if kind == "named":
        return equations(first)
    try:
        return broken_by(first, second)
    except Exception as error:
        return f"{type(error).__name__}: {error!s}"


def run(papers: tuple[str, ...] = PAPERS, processes: int = 2) -> list[tuple[Mutant, Any]]:
    """All mutants of the papers with what they break, each in a process of its own."""
    for name in ("scipy.linalg", "scipy.signal"):  # the rows' own, once for all processes
        import_module(name)
    for paper in papers:
        rows(paper)
    context = multiprocessing.get_context("fork")
    with context.Pool(processes, maxtasksperchild=1) as pool:
        named = dict(zip(papers, pool.map(_work, [("named", paper, None) for paper in papers], 1), strict=True))
        every = [mutant for place in PLACES if place.paper in papers for mutant in mutants(place)]
        found = []
        for i, result in enumerate(pool.imap(_work, [("mutant", m, named[m.place.paper]) for m in every], 1)):
            found.append((every[i], result))
    return found


PAGE = Path(__file__).parents[1] / "docs" / "internals" / "mutants.md"
BELOW = "<!-- below this line written by make mutate -->"


def page(found: list[tuple[Mutant, Any]]) -> str:
    """The table as Markdown."""
    noticed = sum(bool(result) for _, result in found)
    lines = [
        PAGE.read_text(encoding="utf-8").split(BELOW)[0] + BELOW,
        "",
        f"{noticed} of {len(found)} mutants break a claim; the others:",
        "",
    ]
    lines += ["| mutant | why nothing breaks |", "|---|---|"]
    for mutant, result in found:
        if not result:
            reason = EQUIVALENT.get((mutant.place.function, mutant.words), "NOT NOTICED")
            lines.append(f"| `{mutant.place.function}`: {mutant.words} | {reason} |")
    for paper in PAPERS:
        lines += ["", f"## {paper}", "", "| equation | mutant | claims broken |", "|---|---|---|"]
        for mutant, result in found:
            if mutant.place.paper == paper and result:
                keys = ", ".join(dict.fromkeys(result))
                words = mutant.words.replace("|", "\\|")
                lines.append(f"| {mutant.place.equation} | `{mutant.place.function}`: {words} | {keys} |")
    return "\n".join(lines) + "\n"


def unnoticed(found: list[tuple[Mutant, Any]]) -> list[str]:
    """Mutants that break nothing although they should, and those that are no program."""
    return [
        f"{mutant.place.equation}, {mutant.place.function}, {mutant.words}: {result or 'breaks no claim'}"
        for mutant, result in found
        if isinstance(result, str) or (not result and (mutant.place.function, mutant.words) not in EQUIVALENT)
    ]


if __name__ == "__main__":
    out = run(tuple(sys.argv[1:]) or PAPERS)
    left = unnoticed(out)
    if len(sys.argv) == 1 and not left:
        PAGE.write_text(page(out), encoding="utf-8")
    sys.exit("\n".join([*left, f"{len(out)} mutants, {len(left)} not noticed"]) if left else 0)
