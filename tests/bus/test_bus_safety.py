"""The safety monitor against virtual drives with injected faults, on both buses in virtual time; and healthy ones."""

from __future__ import annotations

import pytest

from feeddrive.bus.cia402 import PowerState
from injected_faults import BUSES, KINDS, healthy, trial, trials, wrong

MODES = ("csp", "csv", "cst")
ON = PowerState.ENABLED.status
EACH = 34  # of 15 classes: 510 in each mode and on each bus
HEALTHY = 167  # in each mode and on each bus: 1,002


@pytest.mark.parametrize("mode", MODES)
def test_each_fault_is_reacted_to_in_time_and_within_its_bound(mode: str) -> None:
    """One of each class; the buses take turns."""
    made = [(trial(kind, mode, tuple(BUSES)[k % 2], 0), tuple(BUSES)[k % 2]) for k, kind in enumerate(KINDS)]
    # what cannot be observed in this motion, and was not, is no reaction
    shown = [(each, bus) for each, bus in made if each.observed is not None or each.commanded is not None]
    assert [text for each, bus in shown if (text := wrong(each, mode, bus))] == []
    assert len(shown) >= 12


@pytest.mark.parametrize("mode", MODES)
def test_healthy_drives_in_virtual_time_are_not_stopped(mode: str) -> None:
    assert [why for bus in BUSES for seed in range(2) if (why := healthy(mode, bus, seed))] == []


@pytest.mark.slow(reason="510 faults in each mode and on each bus, some 400 cycles each")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("mode", MODES)
def test_five_hundred_faults_are_reacted_to_in_time_and_within_their_bounds(mode: str, bus: str) -> None:
    found = [made for kind in KINDS for made in trials(kind, mode, bus, EACH)[0]]
    assert [text for made in found if (text := wrong(made, mode, bus))] == []
    assert len(found) >= 500


@pytest.mark.slow(reason="167 healthy motions in each mode and on each bus")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("mode", MODES)
def test_a_thousand_healthy_motions_are_not_stopped(mode: str, bus: str) -> None:
    assert [why for seed in range(HEALTHY) if (why := healthy(mode, bus, seed))] == []
