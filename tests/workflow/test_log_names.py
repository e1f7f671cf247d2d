"""Names of results after the logs that they are from."""

from pathlib import Path

import pytest

from feeddrive.workflow.drive_logs import logs_stem


@pytest.mark.parametrize(
    ("logs", "stem"),
    [
        (["a/run.1.csv"], "run.1"),
        (["a/run.2.csv.gz"], "run.2"),
        (["x.mat"], "x"),
        (["x.mat", "y.mat", "z.mat"], "x_and_2"),
    ],
)
def test_a_number_before_the_type_belongs_to_the_name(logs: list[str], stem: str) -> None:
    assert logs_stem([Path(log) for log in logs]) == stem
