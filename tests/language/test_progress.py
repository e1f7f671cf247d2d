"""One protocol: what a piece of work tells reaches the progress of the whole, and a cancel reaches both."""

from __future__ import annotations

import pytest

from feeddrive.language.errors import CancelledError
from feeddrive.language.progress import Progress
from heard import Heard


def test_counted_steps_reach_the_whole_with_their_number() -> None:
    heard = Heard()
    counted = heard.counted(2)
    counted.step("first")
    counted.step("second")
    assert heard.steps == [("first", 0, 2, ""), ("second", 1, 2, "")]


def test_steps_of_a_named_piece_carry_its_name_and_keep_their_numbers() -> None:
    heard = Heard()
    heard.named("wu2017").step("rates", 3, 7)
    heard.named("wu2017").counted(4).step("circle")
    heard.named("outer").named("inner").step("circle")
    assert heard.steps == [("rates", 3, 7, "wu2017"), ("circle", 0, 4, "wu2017"), ("circle", None, None, "inner")]


def test_remarks_and_questions_of_a_piece_reach_the_whole() -> None:
    heard = Heard()
    heard.counted(1).remark("a guess")
    assert heard.remarks == ["a guess"]
    assert heard.named("part").confirm("move the axis?")
    assert not Progress().named("part").confirm("move the axis?")


@pytest.mark.parametrize("piece", [lambda whole: whole.counted(3), lambda whole: whole.named("part")])
@pytest.mark.parametrize("from_the_piece", [True, False])
def test_a_cancel_stops_the_piece_and_the_whole_and_is_not_counted(piece, from_the_piece: bool) -> None:
    heard = Heard()
    inner = piece(heard)
    inner.step("before")
    (inner if from_the_piece else heard).cancel()
    for each in (inner, heard):
        assert each.cancelled
        with pytest.raises(CancelledError, match="nothing was written"):
            each.step("after")
    assert [what for what, *_ in heard.steps] == ["before"]
