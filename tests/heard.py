"""A progress that remembers what it was told."""

from __future__ import annotations

from feeddrive.language.progress import Progress
from feeddrive.language.table import Table

Step = tuple[str, int | None, int | None, str]


class Heard(Progress):
    """Steps as (what, done, of, part), and remarks; it says yes."""

    def __init__(self) -> None:
        super().__init__()
        self.steps: list[Step] = []
        self.remarks: list[str | Table] = []

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.steps.append((what, done, of, part))

    def show_remark(self, said: str | Table) -> None:
        self.remarks.append(said)

    def confirm(self, question: str) -> bool:
        return True
