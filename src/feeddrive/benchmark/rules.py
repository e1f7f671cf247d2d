"""The rules of the benchmark: limits, searches, seeds, and the plants with their tasks, in one folder of files per
version.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from feeddrive.blocks.families import Reference
from feeddrive.evaluation.duty import Duty
from feeddrive.evaluation.robustness import Rule
from feeddrive.files.job import Job, read_job
from feeddrive.files.section import Section, numbers, read_section, text
from feeddrive.files.toml_file import read_toml
from feeddrive.language import tree
from feeddrive.language.block import Number, choice, declarations, parameter, part
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

VERSION = 1  # of the present rules


@dataclass(frozen=True)
class Place:
    """An axis at one position: `axis` as simulated, and `model` as used for tuning, without forces that cannot be
    linearized there.
    """

    name: str
    axis: Axis
    model: Axis


@dataclass(frozen=True, eq=False)
class Plant:
    """A benchmark axis with its task; `places` are its positions, the nominal one first.

    job      the job of its name, with the machine, the move and the cut
    loop     the axis with the control of its machine file; all laws keep its filters, force limit and guard
    """

    name: str
    job: Job
    loop: Loop
    duty: Duty
    places: tuple[Place, ...]

    @property
    def description(self) -> str:
        """The title of the job, the source of the numbers, and the remark on them."""
        return f"{self.job.title}. {self.job.machine.source}. {self.job.machine.remark}"

    @property
    def model(self) -> Loop:
        """The loop used for tuning, at the nominal position."""
        return replace(self.loop, axis=self.places[0].model)

    def loops(self, control: Control) -> list[tuple[Loop, Loop]]:
        """Return the simulated loop and its tuning model with a given control, at each position."""
        loop = replace(self.loop, control=control)
        return [(replace(loop, axis=place.axis), replace(loop, axis=place.model)) for place in self.places]


class PositionSection(Section):
    """A further position, or another load, of the axis of a plant."""

    name: str = text("of the position", shortest=1)
    set: Mapping[str, float] = numbers('parameters of the axis there, by path: { "plant.stiffness" = 2e8 }')


class PlantSection(Section):
    """A plant of the benchmark: one axis with its work."""

    job: str = text("name of its job in plants/: the machine, the move and what cuts", shortest=1)
    force: Number = parameter("N", "of rope snap and force step", above=0)
    near: Number = parameter("m", "error within which the axis counts as settled", above=0)
    without: tuple[str, ...] = choice(
        "kinds of forces that act in the runs and not in the model of margins and tuning", default=()
    )
    position: tuple[PositionSection, ...] = part("further positions, at which all bounds hold too", default=())

    def plant(self, folder: Path, noise: float) -> Plant:
        """Return the plant of a job in a folder, with noise in the readings in counts."""
        job = read_job(folder / f"{self.job}.toml")
        if job.axis is None or not isinstance(job.reference, Reference):
            raise self.error("a plant of the benchmark is one axis with a reference")
        loop = _noisy(job.machine.loop(job.axis), noise)
        axes = {"nominal": loop.axis}
        axes |= {position.name: tree.vary(loop.axis, dict(position.set)) for position in self.position}
        duty = Duty(job.reference, float(self.force), float(self.near), cut=job.load)
        return Plant(self.job, job, loop, duty, tuple(self._place(name, axis) for name, axis in axes.items()))

    def _place(self, name: str, axis: Axis) -> Place:
        linear = tuple(force for force in axis.forces if force.kind not in self.without)
        return Place(name, axis, replace(axis, forces=linear))


class Rules(Section):
    """A version of the rules of the benchmark: how laws are tuned and judged, and on which plants."""

    version: int = choice("of the rules", least=1)
    sensitivity_peak: Number = parameter("", "largest Ms of the loop cut at the actuator, at every position", above=1)
    delay_margin_samples: Number = parameter("", "least delay margin in samples, at every position", above=0)
    noise_ratio: Number = parameter("", "noise in the force over that of P-PI, at most", least=1)
    starts: int = choice("rounds of each whole tuning", least=1)
    repeats: int = choice("whole tunings of a law on a plant; settled if all end within 5 % of the best", least=1)
    seeds: int = choice("runs with different noise, whose worse figure counts", least=1)
    noise: Number = parameter("", "standard deviation of the white noise in every reading, in counts", least=0)
    varied: Number = parameter("", "error of masses and stiffnesses for the robust Ms, as a share", least=0, below=1)
    plant: tuple[PlantSection, ...] = part("the plants", default=())

    @cached_property
    def plants(self) -> Mapping[str, Plant]:
        """The plants, by name."""
        plants = (section.plant(folder(self.version) / "plants", self.noise) for section in self.plant)
        return {plant.name: plant for plant in plants}

    def rule(self, plant: Plant, noise: float | None = None) -> Rule:
        """Return the rule for all laws on a plant; `noise` is the noise gain of P-PI in N/m, once known."""
        return Rule(
            self.sensitivity_peak,
            self.delay_margin_samples,
            self.noise_ratio,
            plant.duty.sliding(plant.loop),
            self.starts,
            None if noise is None else self.noise_ratio * noise,
            self.repeats,
            tuple(place.model for place in plant.places[1:]),
        )

    def seed(self, plant: Plant, use: str, own: int = 0) -> int:
        """Return a seed hashed from rules, plant and use, so that no two searches or learning trials share a noise
        sequence.

        `own` is a user's number; it changes all seeds.
        """
        content = f"feeddrive benchmark, rules {self.version}, {plant.name}, {use}, {own}"
        return int.from_bytes(hashlib.sha256(content.encode()).digest()[:4], "big") >> 1

    def digest(self) -> str:
        """Return the SHA-256 of all files of the rules and machines; tables with the same digest are comparable."""
        texts = [file.text for plant in self.plants.values() for file in (plant.job.file, plant.job.machine.file)]
        return hashlib.sha256("\0".join([repr(self.numbers()), *texts]).encode()).hexdigest()

    def numbers(self) -> dict[str, Any]:
        """Return the settings of the rules, and the force (N) and settling band (m) of each plant."""
        plants = {
            name: {"force": plant.duty.force, "near": plant.duty.near, "places": [place.name for place in plant.places]}
            for name, plant in self.plants.items()
        }
        return {name: getattr(self, name) for name in declarations(Rules) if name != "plant"} | {"plants": plants}

    def chosen(self, names: tuple[str, ...]) -> tuple[Plant, ...]:
        """Return the plants by name, or all if none is named. Raises ParameterError for an unknown name."""
        for name in names:
            if name not in self.plants:
                raise ParameterError(
                    f"plant '{name}' is not in the benchmark{nearest(name, self.plants)}; there are "
                    f"{', '.join(self.plants)}"
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
        raise ParameterError(f"there are no rules {version} of the benchmark; the present ones are rules {VERSION}")
    return read_section(Rules, read_toml(path).root())


def _noisy(loop: Loop, noise: float) -> Loop:
    """Return the loop with noise in its encoders, in counts."""
    encoders = {name: getattr(loop.axis, name) for name in ("encoder_motor", "encoder_load")}
    noisy = {
        name: replace(encoder, noise=noise * encoder.resolution)
        for name, encoder in encoders.items()
        if encoder is not None
    }
    return replace(loop, axis=replace(loop.axis, **noisy))
