"""All laws on this axis at equal robustness: the trade-off, and a law that is chosen to be tuned on."""

from __future__ import annotations

from functools import partial

from feeddrive.language.errors import ParameterError
from feeddrive.studio.desk import Desk
from feeddrive.studio.room import Asked, Room, Said, act
from feeddrive.studio.works import Shown, compared
from feeddrive.workflow.compare import CompareRequest


class Compare(Room):
    """The comparison of the laws."""

    name = "compare"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.found: Shown | None = None
        self._same = ""

    def begin(self) -> None:
        """Forget the comparison of another axis."""
        bench = self.desk.bench
        same = "" if bench is None else f"{bench.file} {bench.title}"
        if same != self._same:
            self.found, self._same = None, same

    def show(self) -> Said:
        """Which laws there are, and what the comparison came to."""
        bench = self.desk.bench
        words = {"ready": bench is not None and bench.machine is not None, "found": None}
        if self.found is not None:
            words |= {"found": dict(self.found.words), "images": dict(self.found.images)}
        return Said(words)

    @act
    def start(self, asked: Asked) -> None:
        """Tune and judge the laws that are named, or all; those that are finished are kept for the next time."""
        bench = self.desk.needed
        bench.needed_loop()
        laws = asked.texts("laws")
        if any(":" in each for each in laws):  # the page runs no code that somebody names
            raise ParameterError("a law of a module is compared by the command line alone: feeddrive compare --law")
        request = CompareRequest(
            self.desk.machine_path(), axis=bench.axis, law=tuple(laws),
            starts=int(asked.number("starts")), keep=self.desk.folder / "compared_laws",
        )  # fmt: skip

        def then(found: Shown) -> None:
            self.desk.did("compare", request)
            self.found = found

        self.desk.start(self.name, "compare the laws", partial(compared, request), then)

    @act
    def take(self, asked: Asked) -> Said:
        """Go on with a law as it was tuned for the comparison."""
        name = asked.text("law")
        if self.found is None or name not in self.found.controls:
            raise ParameterError(f"the comparison has no law '{name:.60}'")
        self.desk.take(self.found.controls[name])
        return Said({**self.show().words, "go": "tune"})
