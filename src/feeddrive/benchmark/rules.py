"""The rules of the benchmark: limits, searches, seeds, and the plants with their tasks, in one folder of files per
version.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Self

from feeddrive.benchmark.drawn import drawn_places
from feeddrive.benchmark.mode import UnmodelledMode
from feeddrive.blocks.families import Reference
from feeddrive.evaluation.competitor import Place, Plant
from feeddrive.evaluation.duty import Duty
from feeddrive.evaluation.lineup import Lineup
from feeddrive.evaluation.robustness import Rule
from feeddrive.files.job import Job, read_job
from feeddrive.files.section import Section, numbers, read_section, text
from feeddrive.files.toml_file import read_toml
from feeddrive.language import tree
from feeddrive.language.block import Number, choice, declarations, defaults, parameter, part
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box
from feeddrive.loop.loop import Loop
from feeddrive.tuning.filters import with_notch_and_low_pass

VERSION = 2  # of the present rules
FILTERS = ("kept", "free")


class PositionSection(Section):
    """A further position or load at which the axis of a plant is evaluated."""

    name: str = text("of the position", shortest=1)
    set: Mapping[str, float] = numbers('parameters of the axis there, by path: { "plant.stiffness" = 2e8 }')


class VariantSection(Section):
    """A variant of the rules in which the laws are judged once more, to test whether their order survives it."""

    name: str = text("of the variant", shortest=1)
    box: str = text("tolerances of the plants in place of those of the rules", default="")
    draw: int = choice("number of the draw of plants in place of that of the rules", least=0, default=0)


class PlantSection(Section):
    """A plant of the benchmark: one axis with its duty."""

    job: str = text("name of its job in plants/: the machine, the move and what cuts", shortest=1)
    force: Number = parameter("N", "of rope snap and force step", above=0)
    near: Number = parameter("m", "error within which the axis counts as settled", above=0)
    without: tuple[str, ...] = choice(
        "kinds of forces that act in the runs and not in the model of margins and tuning", default=()
    )
    position: tuple[PositionSection, ...] = part("further positions, at which all bounds hold too", default=())

    def plant(self, job: Job, rules: Rules) -> Plant:
        """Return the plant that a job describes, with the encoder noise of the rules."""
        if job.axis is None or not isinstance(job.reference, Reference):
            raise self.error("a plant of the benchmark is one axis with a reference")
        loop = _noisy(job.machine.loop(job.axis), float(rules.noise))
        axes = {"nominal": loop.axis}
        axes |= {position.name: tree.vary(loop.axis, dict(position.set)) for position in self.position}
        duty = Duty(job.reference, float(self.force), float(self.near), cut=job.load)
        places = tuple(self._place(name, axis) for name, axis in axes.items())
        if rules.filters == "free":
            # at the model: what has no slope has no resonance at which a notch could be placed
            model = with_notch_and_low_pass(replace(loop, axis=places[0].model))
            loop = replace(loop, control=model.control)
        rule = Rule(
            rules.sensitivity_peak,
            rules.delay_margin_samples,
            rules.noise_ratio,
            duty.sliding(loop),
            rules.starts,
            repeats=rules.repeats,
            also=tuple(place.model for place in places[1:]),
            box=rules.tolerances,
            filters=rules.filters,
        )
        return rules.seeded(Plant(self.job, loop, duty, rule, places, varied=rules.varied))

    # backlash is not linear at standstill: the model for margins leaves it out, the runs have it
    def _place(self, name: str, axis: Axis) -> Place:
        linear = tuple(force for force in axis.forces if force.kind not in self.without)
        return Place(name, axis, replace(axis, forces=linear))


class Rules(Section):
    """A version of the rules of the benchmark: how laws are tuned and evaluated, and on which plants."""

    version: int = choice("of the rules", least=1)
    sensitivity_peak: Number = parameter("", "largest Ms of the loop cut at the actuator, at every position", above=1)
    delay_margin_samples: Number = parameter("", "least delay margin in samples, at every position", above=0)
    noise_ratio: Number = parameter("", "noise in the force over that of P-PI, at most", least=1)
    starts: int = choice("rounds of each whole tuning", least=1)
    repeats: int = choice("whole tunings of a law on a plant; settled if all end within 5 % of the best", least=1)
    seeds: int = choice("runs with different noise, whose worse figure counts", least=1)
    noise: Number = parameter("", "standard deviation of the white noise in every reading, in counts", least=0)
    varied: Number = parameter("", "error of masses and stiffnesses for the robust Ms, as a share", least=0, below=1)
    box: str = text("tolerances of every plant over which the bounds hold; none: at the models", default="none")
    filters: str = choice("kept: those of the machine; free: tuned with every law", options=FILTERS, default="kept")
    left_out: tuple[str, ...] = choice("laws that take no part, by name", default=())
    recipes: bool = choice("whether tuning recipes are shown", default=True)
    draws: int = choice("plants drawn from the box, on which laws are judged; 0: the models", least=0, default=0)
    draw: int = choice("number of the draw, which changes all drawn plants", least=1, default=1)
    late: int = choice("samples of dead time that every drawn plant has more than its model", least=0, default=0)
    mode: UnmodelledMode | None = part("mode that every drawn plant has more than its model", default=None)
    confidence: Number = parameter("", "of the intervals of ranks and scores", above=0, below=1, default=0.95)
    resamples: int = choice("resamples of the bootstrap over plants and draws", least=100, default=2000)
    inherits: int = choice("version whose files describe the plants without files of this version", default=0, least=0)
    variant: tuple[VariantSection, ...] = part("variants that the order of the laws must survive", default=())
    plant: tuple[PlantSection, ...] = part("the plants", default=())

    @cached_property
    def jobs(self) -> Mapping[str, Job]:
        """The jobs of the plants, with the machine, the move and the cut, by name."""
        return {section.job: read_job(self._file(section.job)) for section in self.plant}

    def _file(self, job: str) -> Path:
        path, *inherited = (folder(v) / "plants" / f"{job}.toml" for v in (self.version, self.inherits) if v)
        return next((other for other in inherited if not path.is_file()), path)

    @property
    def tolerances(self) -> Box | None:
        """The box over which the bounds hold; None if they hold at the models."""
        return Box.parse(self.box)

    def varied_by(self, variant: VariantSection) -> Self:
        """Return the rules of a variant, which has no variants of its own."""
        return replace(self, box=variant.box or self.box, draw=variant.draw or self.draw, variant=())

    def boxes(self) -> tuple[Self, ...]:
        """Return these rules and those of each variant with another box: each of them has designs of its own."""
        first = {str(self.tolerances): self}
        for variant in self.variant:
            varied = self.varied_by(variant)
            first.setdefault(str(varied.tolerances), varied)
        return tuple(first.values())

    def described(self, plant: str) -> str:
        """Return the title of the job of a plant, the source of the numbers, and the remark on them."""
        job = self.jobs[plant]
        return f"{job.title}. {job.machine.source}. {job.machine.remark}"

    @cached_property
    def plants(self) -> Mapping[str, Plant]:
        """The plants, by name."""
        return {section.job: section.plant(self.jobs[section.job], self) for section in self.plant}

    def designs(self, below: Path | None = None) -> Path:
        """Return the folder of the designs for the box of these rules, by default in the package."""
        below = below or folder(self.version) / "designs"
        return below if self.tolerances is None else below / re.sub(r"[^a-z0-9]+", "_", str(self.tolerances))

    def seeded(self, plant: Plant, own: int = 0) -> Plant:
        """Return a plant with seeds derived from a user's number; 0 gives the seeds of the rules."""
        lesson = self.seed(plant, "learning", own)
        if not self.draws:
            return replace(
                plant, seeds=tuple(self.seed(plant, f"run {i}", own) for i in range(self.seeds)), lesson=lesson
            )
        # a machine and its noise: another draw, or another seed of the user, changes both
        uses = [f"draw {self.draw}, plant {number}" for number in range(self.draws)]
        drawn = tuple(
            drawn_places(plant.places, plant.loop, self.tolerances, self.late, self.mode, self.seed(plant, use, own))
            for use in uses
        )
        seeds = tuple(self.seed(plant, f"{use}, run", own) for use in uses)
        return replace(plant, seeds=seeds, lesson=lesson, drawn=drawn)

    def seed(self, plant: Plant, use: str, own: int = 0) -> int:
        """Return a seed hashed from the rules, the plant and the use, so that no two searches or learning trials share
        a noise sequence.

        `own` is a user's number; it changes all seeds.
        """
        return self.number(f"{plant.name}, {use}", own)

    def number(self, use: str, own: int = 0) -> int:
        """Return a seed hashed from the rules and a use."""
        content = f"feeddrive benchmark, rules {self.version}, {use}, {own}"
        return int.from_bytes(hashlib.sha256(content.encode()).digest()[:4], "big") >> 1

    def stated(self) -> list[tuple[str, Text]]:
        """Return the rules in words, by subject."""
        where = Text("at every position of a plant")
        if self.tolerances is not None:
            where = Text(f"{where} and over its box: {self.tolerances.sentence}")
        filters = "; a notch and a low-pass are tuned with every law" if self.filters == "free" else ""
        rows = [
            (
                "Rule",
                Text(
                    f"Ms <= {Quantity(self.sensitivity_peak)}, delay margin >= "
                    f"{Quantity(self.delay_margin_samples, 'samples')}, noise in the force at most "
                    f"{Quantity(self.noise_ratio)} times that of P-PI, {where}{filters}"
                ),
            ),
            ("Searches", Text(self._searches)),
        ]
        if not self.draws:
            runs = Text(f"{self.seeds} with different noise at each position; the worst figure counts")
            return [*rows, ("Runs", runs)]
        late = f", {self.late} more {'sample' if self.late == 1 else 'samples'} of dead time" if self.late else ""
        mode = "" if self.mode is None else ", a mode that no law is told"
        drawn = Text(f"{self.draws} machines drawn for each plant: masses and stiffnesses from the box{late}{mode}")
        variants = ", ".join(variant.name for variant in self.variant) or "no variant"
        places = Text(
            f"percentiles of {self.resamples} resamples of plants and draws, "
            f"{Quantity(float(self.confidence), 'share')}; an order is decided if the rules and {variants} agree"
        )
        return [*rows, ("Runs", drawn), ("Intervals", places)]

    @property
    def _searches(self) -> str:
        if self.repeats > 1:
            return f"{self.repeats} whole tunings of each law on each plant; settled if all end within 5 %"
        return (
            f"{self.starts} rounds of searches of each law on each plant, and more if they disagree; settled if one "
            "from a population and one by continuation in Ms end within 5 % of the best"
        )

    def digest(self) -> str:
        """Return the SHA-256 of all files of the rules and machines; tables with the same digest are comparable."""
        # the files as they are, comments included: a change of any of them is another version
        texts = [file.text for job in self.jobs.values() for file in (job.file, job.machine.file)]
        return hashlib.sha256("\0".join([repr(self.numbers()), *texts]).encode()).hexdigest()

    def numbers(self) -> dict[str, Any]:
        """Return the settings of the rules, and the force (N) and settling band (m) of each plant."""
        plants = {
            name: {"force": plant.duty.force, "near": plant.duty.near, "places": [place.name for place in plant.places]}
            for name, plant in self.plants.items()
        }
        usual = defaults(Rules)
        # a key that a version does not state is none of its numbers: what later versions add leaves its digest alone
        stated = [n for n in declarations(Rules) if n != "plant" and not (n in usual and getattr(self, n) == usual[n])]
        return {name: _plain(getattr(self, name)) for name in stated} | {"plants": plants}

    def lineup(self, plant: Plant) -> Lineup:
        """Return the laws for a plant that take part."""
        lineup = Lineup.of(plant.model)
        return replace(lineup, possible=tuple(law for law in lineup.possible if law.name not in self.left_out))

    def chosen(self, names: tuple[str, ...]) -> tuple[Plant, ...]:
        """Return the plants by name, or all if none is named. Raises ParameterError for an unknown name."""
        for name in names:
            if name not in self.plants:
                raise ParameterError(
                    f"plant '{name}' is not in rules {self.version} of the benchmark{nearest(name, self.plants)}"
                )
        return tuple(plant for name, plant in self.plants.items() if not names or name in names)


def folder(version: int = VERSION) -> Path:
    """Return the folder of a version of the rules, with its plants and stored designs."""
    return Path(__file__).parent / f"rules_{version}"


@cache
def read_rules(version: int = VERSION) -> Rules:
    """Return the rules of a version. Raises ParameterError for an unknown version."""
    path = folder(version) / "rules.toml"
    if not path.is_file():
        known = sorted(each.parent.name.removeprefix("rules_") for each in path.parents[1].glob("rules_*/rules.toml"))
        raise ParameterError(f"there are no rules {version} of the benchmark; there are rules {joined(' and ', known)}")
    return read_section(Rules, read_toml(path).root())


def _plain(value: Any) -> Any:
    """Return a value of the rules as plain numbers and texts, sections as mappings."""
    if isinstance(value, Section):
        return {name: _plain(getattr(value, name)) for name in declarations(type(value))}
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


def _noisy(loop: Loop, noise: float) -> Loop:
    """Return the loop with noise in its encoders, in counts."""
    encoders = {name: getattr(loop.axis, name) for name in ("encoder_motor", "encoder_load")}
    noisy = {
        name: replace(encoder, noise=noise * encoder.resolution)
        for name, encoder in encoders.items()
        if encoder is not None
    }
    return replace(loop, axis=replace(loop.axis, **noisy))
