"""`feeddrive commission` on drives that it does not know: some of the twenty of `benchmarks/commission.py`."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

# of the seeds that were used while it was built: a wrong sign with a mode, Stribeck friction and cogging; a table with
# a brake, saturation and Stribeck friction
SEEDS = (7, 0)


def benchmark() -> Any:
    """The script of the table in docs/how_to/commission.md, which is in no package."""
    spec = spec_from_file_location("strangers", Path(__file__).parents[2] / "benchmarks" / "commission.py")
    assert spec is not None
    assert spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.mark.slow(reason="a commissioning from end to end on a drive with a mechanics of its own: 1 to 3 minutes each")
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_stranger_is_proven_or_left_as_it_was_and_never_beyond_its_limits(seed: int, tmp_path: Path) -> None:
    """What holds for every drive; the share that is proven is that of the whole table."""
    script = benchmark()
    row = script.one(seed, tmp_path)
    assert row["excursions"] == {}
    assert not row["error"].startswith("NOT AN ERROR"), row["error"]
    assert row["questions"] <= script.QUESTIONS
    if not row["kept"]:
        assert row["refusal"]
        assert script.is_left_alone(row), (row["off"], row["changed"])
    # as these were, in the table
    assert script.is_proven(row), (row["refusal"], script.ratios(row))
