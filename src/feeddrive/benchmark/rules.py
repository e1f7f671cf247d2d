"""The rules of the benchmark: bounds, searches, seeds, and the plants with their work; a folder of files a version."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from feeddrive.blocks.families import Reference
from feeddrive.comparison.tune_all import Rule
from feeddrive.evaluation.duty import Duty
from feeddrive.files.job import read_job
from feeddrive.files.toml_file import TomlFile, TomlTable, read_toml
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

VERSION = 1  # of the present rules
_NUMBERS = ("sensitivity_peak", "delay_margin_samples", "noise_ratio", "starts", "repeats", "seeds", "noise", "varied")
_PLANT = ("job", "force", "near", "without", "position")


@dataclass(frozen=True)
class Place:
    """A position of an axis: as it runs, and as it is tuned, without forces that have no slope there."""

    name: str
    axis: Axis
    model: Axis


@dataclass(frozen=True, eq=False)
class Plant:
    """A fixed axis with its work; `places` are its positions, the nominal one first.

    loop     the axis under the control of its machine file, whose filters, limit and guard all laws keep
    without  kinds of forces that act in the runs and not in the model of margins and tuning
    """

    name: str
    title: str
    loop: Loop
    duty: Duty
    places: tuple[Place, ...]
    without: tuple[str, ...]
    source: str
    remark: str
    files: tuple[TomlFile, ...]

    @property
    def model(self) -> Loop:
        """The loop that is tuned, at the nominal position."""
        return replace(self.loop, axis=self.places[0].model)

    def loops(self, control: Control) -> list[tuple[Loop, Loop]]:
        """The loop that runs and its model under a control, at each position."""
        made = replace(self.loop, control=control)
        return [(replace(made, axis=place.axis), replace(made, axis=place.model)) for place in self.places]


@dataclass(frozen=True, eq=False)
class Rules:
    """A version of the rules.

    sensitivity_peak, delay_margin_samples, noise_ratio   the bounds at every position of a plant, as those of `compare`
    starts, repeats  of a search: rounds of each whole tuning, and how many whole tunings must agree
    seeds            runs of each law, the worse one counts
    noise            standard deviation of the noise in every reading, in counts of its encoder
    varied           share by which masses and stiffnesses are wrong where the robust Ms is taken
    """

    version: int
    sensitivity_peak: float
    delay_margin_samples: float
    noise_ratio: float
    starts: int
    repeats: int
    seeds: int
    noise: float
    varied: float
    plants: Mapping[str, Plant]

    def rule(self, plant: Plant, noise: float | None = None) -> Rule:
        """What all laws on a plant are tuned to; `noise` in N/m once that of P-PI is known."""
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
        """A seed that follows from rules, plant and use by a hash: no search and no trial of a learner sees another's.

        `own` is a person's number, which gives other seeds throughout.
        """
        said = f"feeddrive benchmark, rules {self.version}, {plant.name}, {use}, {own}"
        return int.from_bytes(hashlib.sha256(said.encode()).digest()[:4], "big") >> 1

    def digest(self) -> str:
        """SHA-256 of all files of the rules and machines: two tables with the same digest may be compared."""
        texts = [file.text for plant in self.plants.values() for file in plant.files]
        return hashlib.sha256("\0".join([repr(self.numbers()), *texts]).encode()).hexdigest()

    def numbers(self) -> dict[str, Any]:
        """The numbers of the rules, and by plant its force (N) and its band (m)."""
        found: dict[str, Any] = {"version": self.version, **{name: getattr(self, name) for name in _NUMBERS}}
        found["plants"] = {
            each.name: {"force": each.duty.force, "near": each.duty.near, "places": [p.name for p in each.places]}
            for each in self.plants.values()
        }
        return found

    def chosen(self, names: tuple[str, ...]) -> tuple[Plant, ...]:
        """Plants by name, all of them if none is named. Raises ParameterError for one that is not there."""
        for name in names:
            if name not in self.plants:
                raise ParameterError(
                    f"plant '{name}' is not in the benchmark{nearest(name, self.plants)}; there are "
                    f"{', '.join(self.plants)}"
                )
        return tuple(each for name, each in self.plants.items() if not names or name in names)


def folder(version: int = VERSION) -> Path:
    """Where a version of the rules stands, with its plants and the stored designs."""
    return Path(__file__).parent / f"rules_{version}"


@cache
def read_rules(version: int = VERSION) -> Rules:
    """The rules of a version. Raises ParameterError for one that there is not."""
    place = folder(version) / "rules.toml"
    if not place.is_file():
        raise ParameterError(f"there are no rules {version} of the benchmark; the present ones are rules {VERSION}")
    root = read_toml(place).root()
    root.refuse_unknown(["version", *_NUMBERS, "plant"])
    numbers = {name: root.values[name] for name in _NUMBERS}
    plants = [_plant(section, place.parent / "plants", numbers["noise"]) for section in root.listed("plant")]
    return Rules(version=root.values["version"], **numbers, plants={each.name: each for each in plants})


def _plant(section: TomlTable, jobs: Path, noise: float) -> Plant:
    """A plant from its entry in the rules and its job: the move, and what cuts."""
    section.refuse_unknown(_PLANT)
    values = section.values
    job = read_job(jobs / f"{values['job']}.toml")
    if job.axis is None or not isinstance(job.reference, Reference):
        raise section.error("a plant of the benchmark is one axis with a reference")
    loop, without = _noisy(job.machine.loop(job.axis), noise), tuple(values.get("without", ()))
    duty = Duty(job.reference, float(values["force"]), float(values["near"]), cut=job.load)
    others = [each.values for each in section.listed("position")]
    changed = [("nominal", loop.axis), *((each["name"], tree.vary(loop.axis, each["set"])) for each in others)]
    places = tuple(Place(name, axis, _without(axis, without)) for name, axis in changed)
    return Plant(
        values["job"],
        job.title,
        loop,
        duty,
        places,
        without,
        job.machine.source,
        job.machine.remark,
        (job.file, job.machine.file),
    )


def _without(axis: Axis, kinds: tuple[str, ...]) -> Axis:
    return replace(axis, forces=tuple(each for each in axis.forces if each.kind not in kinds)) if kinds else axis


def _noisy(loop: Loop, noise: float) -> Loop:
    """A loop whose encoders have noise, in counts."""
    encoders = {name: getattr(loop.axis, name) for name in ("encoder_motor", "encoder_load")}
    noisy = {name: replace(each, noise=noise * each.resolution) for name, each in encoders.items() if each is not None}
    return replace(loop, axis=replace(loop.axis, **noisy))
