"""What a bounded memory keeps and drops."""

from __future__ import annotations

from feeddrive.language.recent import Recent


def test_it_makes_once_and_drops_what_was_not_asked_for_the_longest():
    made: list[str] = []

    def value(name: str) -> str:
        return recent.get(name, lambda: made.append(name) or name.upper())

    recent: Recent[str] = Recent(2)
    assert [value(each) for each in "aba"] == ["A", "B", "A"]
    assert value("c") == "C"  # b goes: a was asked for after it
    assert len(recent) == 2
    assert value("a") == "A"
    assert made == ["a", "b", "c"]
    assert value("b") == "B"
    assert made == ["a", "b", "c", "b"]
