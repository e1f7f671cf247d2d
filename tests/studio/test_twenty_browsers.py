"""Twenty people with a page each: what one moves no other one sees, and the server's memory stays small."""

from __future__ import annotations

from typing import Any

import pytest

from studio_server import memory_of, needs_proc

_PAGES = 20
_MOST = 50.0  # MB of the server for each page: the bar of its issue


@needs_proc
@pytest.mark.slow(reason="twenty browsers draw their pictures on two cores")
def test_twenty_browsers_side_by_side_keep_their_own_numbers_also_after_a_reload(studio: Any) -> None:
    before = memory_of(studio.server.pid)
    opened = [studio.open() for _ in range(_PAGES)]
    wanted = {each: 30_000 + 1_000 * i for i, each in enumerate(opened)}

    def shown(each: Any) -> float:
        each.page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
        return float(each.page.input_value("[id='number-law.Kp']"))

    for each in opened:
        each.go("tune")
    for each, value in wanted.items():  # all are open, and act in turn
        each.page.fill("[id='number-law.Kp']", str(value))
        each.page.keyboard.press("Enter")
    for each in opened:
        each.settled()
    for letter in "ABC":
        for each in opened:
            each.page.click(f"text=Keep as {letter}")
    for each in opened:
        each.settled()
    assert {each: shown(each) for each in opened} == wanted
    for each in opened:
        each.page.reload()
    assert {each: shown(each) for each in opened} == wanted
    most = (memory_of(studio.server.pid) - before) / _PAGES
    assert most < _MOST, f"memory of the server for each page: {most:.1f} MB"
    assert [each.said for each in opened] == [[]] * _PAGES
    for each in opened:
        each.context.close()
