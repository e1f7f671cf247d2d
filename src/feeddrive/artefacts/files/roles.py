"""What a column of a measured log may stand for, and how a column is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from feeddrive.language import units
from feeddrive.language.errors import ParameterError

# what a column may stand for, and the unit in which the log then holds it; a command is in the drive's own unit
ROLES: Mapping[str, str] = {
    "time": "s",
    "setpoint_position": "m",
    "position_motor": "m",
    "position_load": "m",
    "force": "N",
    "command": "",
    "load_force": "N",
}


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a file: its name there, and its unit, or the factor to the unit of its role (or neither: SI).

    Column(name="qm", unit="mm"), Column(name="iq", factor=35.15), Column(name="y", factor=-1e-3)
    """

    name: str
    unit: str = ""
    factor: float | None = None

    def checked(self, role: str) -> Column:
        """The column itself. Raises ParameterError if its unit or factor cannot be that of the role."""
        if self.factor is not None and not (np.isfinite(self.factor) and self.factor != 0.0):
            raise ParameterError(f"{role}: factor = {self.factor:g} must be a finite number that is not 0")
        if role != "command" and self.unit:
            if self.factor is not None:
                raise ParameterError(f"{role}: give the unit of column '{self.name}' or a factor, not both")
            units.factor(self.unit, ROLES[role])
        return self


Named: TypeAlias = Column | str | tuple[str, float] | tuple[str, str]
