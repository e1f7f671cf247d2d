"""The certificate of a control: its document, and the figures and plots computed from the document alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from feeddrive.certificate import check
from feeddrive.certificate.discs import LoopResponse, control_of, matrices
from feeddrive.language.errors import NotCertifiedError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Result):
    """The proof of a control for a list of plants; `document` contains all of it as plain values.

    It is created by `certify_loop` or read from a file; both run the checker first.
    """

    document: Mapping[str, Any]

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Certificate:
        """Return the certificate of a document, with the digest of its content."""
        # as a reader of the file gets it: the digest of tuples and numpy numbers would be another one
        plain = json.loads(json.dumps(content))
        return cls({**plain, "sha256": check.digest(plain)})

    def text(self) -> str:
        """Return the JSON text; `python -m feeddrive.certificate.check FILE` checks it."""
        return json.dumps(self.document, indent=1, ensure_ascii=False) + "\n"

    def verify(self) -> tuple[str, ...]:
        """Return the checker's sentences, one per plant. Raises NotCertifiedError if it is rejected."""
        try:
            return tuple(check.verified(self.document))
        except check.RefusedError as error:
            raise NotCertifiedError(f"not certified: {error}") from None

    @property
    def sample_time(self) -> float:
        """The sample time, s."""
        return float.fromhex(self.document["sample_time_s"])

    @property
    def two_rates(self) -> bool:
        """True for a multirate law, whose period is several samples."""
        return "samples" in self.document["control"]

    @property
    def arithmetic(self) -> str:
        """The arithmetic of the coefficients: float64, float32 or fixedN."""
        return self.document["arithmetic"]

    @property
    def outside(self) -> tuple[str, ...]:
        """The effects that the proof does not cover."""
        return tuple(self.document["outside"])

    @cached_property
    def loops(self) -> dict[str, LoopResponse]:
        """The loop response (control and plant) by plant name, for figures and plots."""
        T, control = self.sample_time, self.document["control"]
        readings = control["readings"]
        control_model = control_of(control, T)
        return {
            plant["name"]: LoopResponse(control_model, matrices(plant["model"], ["cut"], readings, T), plant["radius"])
            for plant in self.document["plants"]
        }

    @property
    def reserve(self) -> float | None:
        """The smallest factor, over the plants, by which the discs could be wider; None if all radii are 0."""
        return min(
            (plant["reserve"] for plant in self.document["plants"] if plant["reserve"] is not None), default=None
        )

    def sentence(self) -> str:
        """Return the result as a sentence that names the plant with the smallest reserve."""
        plants = self.document["plants"]
        count = (
            "1 plant and everything in its disc"
            if len(plants) == 1
            else (f"{len(plants)} plants and everything in their discs")
        )
        room = ""
        if self.reserve is not None:
            least = min((plant for plant in plants if plant["reserve"] is not None), key=lambda plant: plant["reserve"])
            room = Text(
                f"; the least room is at {Quantity(least['reserve_at_Hz'], 'Hz'):3}, where the disc of "
                f"'{least['name']}' could be {Quantity(self.reserve):2} times as wide"
            )
        return Text(f"stable for {count}, with {self.arithmetic} coefficients{room}")

    def table(self) -> Table:
        """Return a table with one row per plant, smallest reserve first."""
        rows: list[list[str | float | int | None]] = []
        for plant in sorted(self.document["plants"], key=lambda plant: plant["reserve"] or math.inf):
            radii = [x for band in plant["radius"] for x in band["r"]]
            least, most = min(radii), max(radii)
            loop = self.loops[plant["name"]]
            f = loop.lines()
            peak = float(np.max(loop.size(f) / loop.room(f)[0]))
            rows.append(
                [
                    plant["name"],
                    Text(f"{Quantity(least):3} .. {Quantity(most):3}") if least < most else radii[0],
                    peak,
                    plant["reserve"],
                    plant["reserve_at_Hz"],
                    loop.growth,
                    sum(len(lines) for lines in plant["lines"]),
                ]
            )
        columns = [
            "plant",
            Column("r", "", "3"),
            Column("max Σ|H|" if self.two_rates else "max |L/(1+L)|", "", "3"),
            Column("wider by", "", "3"),
            Column("at", "Hz", "3"),
            Column("max |z|", "", ".6f"),
            "lines",
        ]
        return Table(self.sentence(), columns, rows)
