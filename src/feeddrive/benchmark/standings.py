"""The tables of rules whose laws are judged on drawn plants: means over the same plants, with intervals and places."""

import math
from collections import Counter

from feeddrive.benchmark.benchmark import FIGURES, HEADS, Benchmark, Group, Score, order_of
from feeddrive.benchmark.order import Decision, Order, Standing
from feeddrive.evaluation.competitor import UNFIT, UNSEARCHED, Competitor
from feeddrive.evaluation.robustness import Design
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.figure import Figure
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.tuning.candidates import PLAIN

RANKED_BY = (of_loops.ROPE_SNAP, of_runs.TRACKING_RMS, of_runs.CUTTING_RMS)
THE_RULES = "the rules"
_MARKED = "; * its search is not settled on one of them: at least so good"


def decision_of(benchmark: Benchmark, group: Group, figure: Figure) -> Decision:
    """Return which places of a group are decided: by the rules, and by each of their variants."""
    orders: dict[str, Order | None] = {THE_RULES: order_of(benchmark, group, figure)}
    for name, variant in benchmark.variants.items():
        same = next((other for other in variant.groups() if other.name == group.name), None)
        orders[name] = None if same is None else order_of(variant, same, figure)
    return Decision(orders)


def score_tables(benchmark: Benchmark) -> list[Table]:
    """Return the score tables of a result: one of all plants where the laws are judged at the models (`tables`), and
    those of groups of plants where they are judged on drawn plants.
    """
    return drawn_tables(benchmark) if benchmark.rules.draws else benchmark.tables()


def drawn_tables(benchmark: Benchmark) -> list[Table]:
    """Return all tables of rules with drawn plants: per group the order at equal robustness and at equal control
    effort, the laws without a place, and the decided places; then what the searches cost.
    """
    tables: list[Table] = []
    for group in benchmark.groups():
        tables += [
            ranked_table(benchmark, group),
            ranked_table(benchmark, group, effort=True),
            *_some(left_out_table(benchmark, group)),
            places_table(benchmark, group),
            views_table(benchmark, group),
        ]
    return [*tables, decided_table(benchmark), search_table(benchmark), *_some(missing_table(benchmark))]


def _some(table: Table) -> list[Table]:
    return [table] if table.rows else []


def _counted(count: int, name: str) -> str:
    return f"{count} {name}" if count == 1 else f"{count} {name}s"


def _places(best: int, worst: int) -> str:
    return f"{best}" if best == worst else f"{best} to {worst}"


def ranked_table(benchmark: Benchmark, group: Group, *, effort: bool = False) -> Table:
    """Return the laws with a place on all plants of a group, best first; means are over the same plants and draws."""
    order = order_of(benchmark, group, FIGURES[0], effort=effort)
    rows: list[list[Cell]] = []
    for standing in order.standings:
        law = standing.law
        score = _with_interval(standing)
        others = (benchmark.score(law, figure, group.plants, effort=effort) for figure in FIGURES[1:])
        cells = [score, *(_whole(other, len(group.plants)) for other in others)]
        mark = " *" if law in order.unsettled else ""
        rows.append(
            [_places(standing.best, standing.worst), f"{law}{mark}", judged_peak(benchmark, law, group), *cells]
        )
    level = "control effort" if effort else "robustness"
    interval = Quantity(float(benchmark.rules.confidence), "share")
    title = Text(
        f"Rules {benchmark.rules.version}, {group.name}: times better than {PLAIN} at equal {level}, on the same "
        f"{_counted(len(group.plants), 'plant')} ({', '.join(group.plants)}) and draws; place and first figure with "
        f"{interval:3} intervals{_MARKED if order.unsettled else ''}"
    )
    return Table(title, ["place", "law", Column("Ms judged", form=".2f"), *HEADS], rows)


def _whole(score: Score, plants: int) -> Cell:
    """Return a score as a cell; without a mean if it lacks a plant, since it would not be over the plants of the laws
    beside it.
    """
    if score.never:
        return Text(f"never on {score.never}")
    return score.cell if score.plants == plants else None


def judged_peak(benchmark: Benchmark, law: str, group: Group) -> float | None:
    """Return the largest Ms of a law over the drawn plants of a group."""
    rows = (row for row in benchmark.counted(law) if row.plant in group.plants)
    return max((peak for row in rows if (peak := row.figures.get(of_loops.SENSITIVITY_PEAK.key))), default=None)


def left_out_table(benchmark: Benchmark, group: Group) -> Table:
    """Return the laws that lack a place on a plant of a group, by name, with the reasons; they have no mean."""
    ranked = order_of(benchmark, group, FIGURES[0]).laws
    rows: list[list[Cell]] = []
    for law in sorted(set(benchmark.laws_on(group)) - {*ranked}):
        on = [row for row in benchmark.rows if row.name == law and row.plant in group.plants]
        placed = [row.plant for row in on if not row.unplaced]
        unstable = [row.plant for row in on if row.kind == UNFIT]
        others = [Text(f"{row.plant}: {row.unplaced}") for row in on if row.unplaced and row.kind != UNFIT]
        never = [p for p, ratio in benchmark.ratios(law, FIGURES[0]).items() if math.isinf(ratio) and p in group.plants]
        gone = [plant for plant in group.plants if plant not in {row.plant for row in on}]
        lacking = [
            *((plant, "no finite error") for plant in never),
            *((plant, "there is no such law") for plant in gone),
        ]
        why = joined("; ", [*others, *(Text(f"{plant}: {reason}") for plant, reason in lacking)])
        count = f"{len(placed)} of {len(group.plants)}"
        rows.append([law, ", ".join(unstable) or "nowhere", count, Text(why or "unstable there")])
    title = f"{group.name}: laws without a place on all of these plants; no mean, since it would be over other plants"
    return Table(title, ["law", "unstable on", "placed on", Column("other reasons")], rows, sentences=3)


def views_table(benchmark: Benchmark, group: Group) -> Table:
    """Return the scores of all laws of a group by the rules and by each of their variants, with intervals: a law whose
    place hangs on the size of the box shows it here.
    """
    orders = decision_of(benchmark, group, FIGURES[0]).orders
    scores = [
        {} if order is None else {row.law: _with_interval(row) for row in order.standings} for order in orders.values()
    ]
    laws = dict.fromkeys(law for row in scores for law in row)
    counts = [0 if order is None else len(order.plants) for order in orders.values()]
    heads = (Text(f"{view} ({_counted(count, 'plant')})") for view, count in zip(orders, counts, strict=True))
    title = Text(f"{group.name}: times better than {PLAIN} in {FIGURES[0].short} by each view, with intervals")
    return Table(title, ["law", *heads], [[law, *(row.get(law) for row in scores)] for law in laws])


def _with_interval(standing: Standing) -> Text:
    low, high = Quantity(standing.low), Quantity(standing.high)
    return Text(f"{Quantity(standing.score):.2f} ({low:.2f} to {high:.2f})")


def places_table(benchmark: Benchmark, group: Group) -> Table:
    """Return, for the figures by which laws are ranked, which places survive the variants of the rules, and whether
    each law is better or worse than P-PI in all of them.
    """
    decisions = [decision_of(benchmark, group, figure) for figure in RANKED_BY]
    rows: list[list[Cell]] = []
    # a law without a finite figure of one kind may have a place by another one
    for law in dict.fromkeys(law for decision in decisions for law in decision.order.laws):
        cells: list[Cell] = []
        for decision in decisions:
            ranked = law in decision.order.laws
            cells += [_places(*decision.places(law)), _against_plain(decision, law)] if ranked else [None, None]
        rows.append([law, *cells])
    views = ", ".join((THE_RULES, *benchmark.variants))
    title = Text(f"{group.name}: places, and what is better or worse than {PLAIN}, on which {views} agree")
    heads = (head for figure in RANKED_BY for head in (figure.short, Text(f"{figure.short}, {PLAIN}")))
    return Table(title, ["law", *heads], rows)


def _against_plain(decision: Decision, law: str) -> Cell:
    """Return whether a law is better than P-PI by the rules and all variants; None for P-PI and laws tied with it."""
    if decision.order.tied(law, PLAIN):
        return None
    verdict = decision.decided(law, PLAIN)
    return "not decided" if verdict is None else "better" if verdict else "worse"


def decided_table(benchmark: Benchmark) -> Table:
    """Return, per group and figure, how many pairs and which places are decided, and what leaves the others open."""
    rows: list[list[Cell]] = []
    for group in benchmark.groups():
        for figure in RANKED_BY:
            decision = decision_of(benchmark, group, figure)
            laws, doubts = decision.order.laws, decision.doubts
            spans = {law: decision.places(law) for law in laws}
            fixed = [f"{best} {law}" for law, (best, worst) in spans.items() if best == worst]
            reasons = Counter(why for doubt in doubts for why in doubt.why)
            pairs = len(decision.pairs)
            rows.append(
                [
                    f"{group.name}, {figure.short}",
                    ", ".join(f"{0 if order is None else len(order.plants)}" for order in decision.orders.values()),
                    f"{pairs - len(doubts)} of {pairs}",
                    ", ".join(fixed) or "none",
                    "; ".join(f"{why} ({count})" for why, count in reasons.items()) or "nothing",
                ]
            )
    views = ", ".join((THE_RULES, *benchmark.variants))
    heads = ["order", "plants", "pairs decided", "places decided", "what leaves pairs open (number of pairs)"]
    return Table(f"Which places are decided; plants: of {views}", heads, rows, sentences=4)


def missing_table(benchmark: Benchmark) -> Table:
    """Return the plants on which P-PI has no place, by the rules and by each variant, and the laws not searched."""
    rows: list[list[Cell]] = []
    for name, result in {THE_RULES: benchmark, **benchmark.variants}.items():
        reasons: dict[str, list[str]] = {}
        for plant in result.plants:
            plain = result.row(plant, PLAIN)
            if plain is None or plain.unplaced:
                reasons.setdefault("there is none" if plain is None else plain.unplaced, []).append(plant)
        rows += [
            [Text(f"{name}: no place of {PLAIN}, so that nothing is compared there"), ", ".join(plants), Text(why)]
            for why, plants in reasons.items()
        ]
    named = {plant for group in benchmark.groups() for plant in group.plants}
    unsearched: dict[str, list[str]] = {}
    for row in benchmark.rows:
        if row.kind == UNSEARCHED and row.plant in named:
            unsearched.setdefault(row.name, []).append(row.plant)
    for law, plants in unsearched.items():
        everywhere = "all" if len(named) == len(benchmark.plants) else "all others"
        where = everywhere if len(plants) == len(named) else ", ".join(plants)
        rows.append([Text(f"{law}: not searched"), where, Text(f"--retune --law '{law}' --keep DIR searches it")])
    return Table("What is missing", ["what", "plants", "reason"], rows, sentences=2)


def search_table(benchmark: Benchmark) -> Table:
    """Return what the search of each law looked at, and how sure it is."""
    designs: dict[str, list[tuple[Competitor, Design]]] = {}
    for row in benchmark.rows:
        if isinstance(row.tuned, Design) and row.tuned.law == row.name:
            designs.setdefault(row.name, []).append((row, row.tuned))
    rows: list[list[Cell]] = []
    for law, found in sorted(designs.items()):
        looks = sorted(design.evaluations for _, design in found)
        agreed = sum(design.agreed[0] for _, design in found), sum(design.agreed[1] for _, design in found)
        tunables = sorted({len(design.tunables) for _, design in found})
        rows.append(
            [
                law,
                f"{sum(not design.unsettled for _, design in found)} of {len(found)}",
                f"{agreed[0]} of {agreed[1]}",
                looks[len(looks) // 2],
                looks[-1],
                _places(tunables[0], tunables[-1]),
            ]
        )
    rules = benchmark.rules
    title = f"Searches: {_counted(rules.repeats, 'whole tuning')} of {_counted(rules.starts, 'round')}"
    heads = ["law", "settled on plants", "searches within 5 %", "loops judged, median", "most", "numbers tuned"]
    return Table(title, heads, rows)
