"""Commands: declared requests, options made from them, one progress, and nothing written by what is cancelled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

from feeddrive.cli.commands import app
from feeddrive.files import formats
from feeddrive.language.errors import CancelledError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import COMMANDS, Command, load
from feeddrive.workflow.request import Request, argument, fields_of, option


class Asked(Request):
    """One field of each kind."""

    machine: str = argument("a machine file")
    compliance: float | None = option("largest compliance", default=None, unit="m/N", entered="um/N", above=0.0)
    starts: int = option("searches", default=2, least=1, most=20)
    goal: str = option("what is made best", default="snap", options=("snap", "stiffness"))
    at: tuple[Path, ...] = option("other places", default=())


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"compliance": -2e-6}, "--compliance = -2 um/N (largest compliance) must be > 0 um/N"),
        ({"compliance": float("nan")}, "--compliance = nan um/N (largest compliance) must be a finite number"),
        ({"starts": 21}, "--starts = 21 (searches) must be <= 20"),
        ({"starts": 1.5}, "--starts = 1.5 (searches) must be a whole number"),
        ({"goal": "speed"}, "--goal = 'speed' (what is made best) must be one of 'snap', 'stiffness'"),
    ],
)
def test_a_wrong_field_is_refused_by_name_value_bound_and_unit(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Asked("emps", **given)
    assert str(caught.value) == said


def test_a_request_is_in_si_and_says_its_command_line() -> None:
    asked = Asked("emps", compliance=2e-7, at=("a b.csv", "c.csv"))  # type: ignore[arg-type]
    assert asked.at == (Path("a b.csv"), Path("c.csv"))
    assert asked.python("tune").startswith(
        "from feeddrive.workflow.tune import tune; tune('emps', compliance=2e-07, at="
    )
    assert asked.command_line("tune") == "feeddrive tune emps --compliance 0.2 --at 'a b.csv' --at c.csv"


def test_what_is_given_on_the_command_line_reaches_the_request_in_si(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.2 um/N on the command line are 0.2e-6 m/N in the request."""
    seen: list[Any] = []

    def stopped(_: object, request: Request, progress: Progress) -> None:
        seen.append(request)
        raise CancelledError("enough")

    monkeypatch.setattr(Command, "run", stopped)
    command: Any = get_command(app)
    with pytest.raises(CancelledError):
        command.main(
            ["tune", "emps", "--max-compliance", "0.2", "--at", "mill", "--at", "b.csv"], standalone_mode=False
        )
    assert seen[0].max_compliance == pytest.approx(2e-7, rel=1e-12)
    assert seen[0].at == ("mill", "b.csv")
    assert seen[0].out == Path("results/tune_emps")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_field_of_a_request_is_an_argument_or_an_option(name: str) -> None:
    command: Any = get_command(app)
    shown = {each.name: each for each in command.commands[name].params if each.name != "help"}
    fields = {each.name: each for each in fields_of(load(name).request)}
    assert set(shown) == set(fields)
    for key, field in fields.items():
        assert field.declared.meaning
        assert field.flag == "" or field.flag in shown[key].opts


class Stopped(Progress):
    """Somebody who cancels at the first step."""

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.cancel()


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("run", {"job": "emps"}),
        ("demo", {}),
        ("compare", {"machine": "linear_motor", "law": ("DADSC",), "starts": 1}),
        ("tune", {"source": "linear_motor", "starts": 1}),
        ("certify", {"source": "linear_motor"}),
        ("excite", {"machine": "emps", "band": "5..50", "amplitude": 1.0}),
        ("reproduce", {"paper": "gordon2013"}),
    ],
)
def test_a_cancel_ends_the_work_and_nothing_is_written(name: str, asked: dict[str, Any], tmp_path: Path) -> None:
    command = load(name)
    with pytest.raises(CancelledError):
        command.run(command.request(**asked, out=tmp_path / "d"), Stopped())
    assert not list(tmp_path.iterdir())


def test_without_a_place_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from feeddrive.workflow.excite import excite

    monkeypatch.chdir(tmp_path)
    found = excite("emps", band="20..40", amplitude=1.0, periods=2, realisations=1)
    assert found.result.frequency.size > 0
    assert not found.files
    assert not list(tmp_path.iterdir())


def log_of_a_motion(path: Path) -> None:
    """0.4 kg and dry friction, to and fro; columns with the usual names."""
    t = 1e-3 * np.arange(4000)
    x = 0.05 * np.sin(2.0 * np.pi * 0.5 * t) + 0.005 * np.sin(2.0 * np.pi * 2.3 * t)
    v, a = np.gradient(x, 1e-3), np.gradient(np.gradient(x, 1e-3), 1e-3)
    force = 40.0 * a + 12.0 * np.sign(v) + 5.0 * v + np.random.default_rng(1).normal(0.0, 0.2, t.size)
    rows = "\n".join(f"{p:.6f};{q:.9f};{r:.6f}" for p, q, r in zip(t, x, force, strict=True))
    path.write_text("time_s;position_m;force_N\n" + rows + "\n", encoding="utf-8")


@pytest.mark.parametrize("words", [{}, {"time": "time_s"}, {"force": "force_N:N"}])
def test_identify_parses_its_log_once(words: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks whether there are frequency responses, guesses roles, and reads what it chose: four looks, one parse."""
    from feeddrive.workflow.identify import identify

    log_of_a_motion(tmp_path / "log.csv")
    read, parsed = formats.read_csv, list[str]()

    def counted(name: str, *rest: Any) -> Any:
        parsed.append(name)
        return read(name, *rest)

    monkeypatch.setattr(formats, "read_csv", counted)
    found = identify(tmp_path / "log.csv", **words)
    assert found.result.rigid is not None
    assert len(parsed) == 1
