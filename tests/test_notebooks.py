"""The notebooks run in a kernel of Jupyter, show tables and pictures, and are stored without outputs."""

from __future__ import annotations

import os
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

import feeddrive
from feeddrive.language.errors import CancelledError
from feeddrive.language.progress import Progress

EXAMPLES = Path(__file__).parents[1] / "examples"
QUICK = ("2_from_a_log.ipynb", "3_learned_feedforward.ipynb", "5_prove_and_export.ipynb")
SLOW = ("1_first_axis.ipynb", "4_part_program.ipynb")
notebook = import_module("feeddrive.workflow.notebook")


def shown(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The outputs of all cells; an exception in a cell fails."""
    monkeypatch.setenv("PYTHONPATH", str(Path(feeddrive.__file__).parents[1]))
    content = nbformat.read(EXAMPLES / name, 4)
    # the kernel writes the files of its connection there, which other users cannot read
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(folder / "runtime"))
    client = NotebookClient(content, timeout=250, kernel_name="python3", resources={"metadata": {"path": str(folder)}})
    client.execute(env=dict(os.environ))
    return [output for cell in content.cells if cell.cell_type == "code" for output in cell.outputs]


def check(outputs: list[Any]) -> None:
    kinds = [set(output.data) for output in outputs if "data" in output]
    assert any("text/html" in kind for kind in kinds), "no table"
    assert any("image/png" in kind for kind in kinds), "no picture"
    # the kernel itself may warn on the error stream; a result says nothing there
    errors = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stderr")
    assert "Warning" not in errors


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", QUICK)
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(shown(name, tmp_path, monkeypatch))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.slow(reason="notebooks that tune and run a part program, 10 to 20 s each")
@pytest.mark.parametrize("name", SLOW)
def test_a_long_notebook_runs_and_leaves_no_progress(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs = shown(name, tmp_path, monkeypatch)
    check(outputs)
    lines = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert any(line == "" for line in lines), "no progress was shown"
    assert not any("<small>" in line for line in lines)


def test_every_notebook_is_listed_and_stored_without_outputs() -> None:
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    names = {path.name for path in EXAMPLES.glob("*.ipynb")}
    assert names == {*QUICK, *SLOW}
    for name in names:
        assert f"]({name})" in page
        for cell in nbformat.read(EXAMPLES / name, 4).cells:
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None


def test_a_line_appears_after_half_a_second_and_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    now, lines = [0.0], list[str]()
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    progress = notebook.CellProgress(lines.append)
    for now[0] in (0.1, 0.4, 0.6, 0.75, 0.95):
        progress.step(f"at {now[0]} <s>", 1, 4)
    progress.clear()
    assert lines == [
        '<small><progress max="4" value="1"></progress> at 0.6 &lt;s&gt;, 1 s</small>',
        '<small><progress max="4" value="1"></progress> at 0.95 &lt;s&gt;, 1 s</small>',
        "",
    ]
    progress.cancel()
    with pytest.raises(CancelledError):
        progress.step("more")


def test_outside_of_a_notebook_nothing_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with notebook.cell_progress() as progress:
        assert progress is None
    assert isinstance(notebook.CellProgress(lambda _: None), Progress)
    assert capsys.readouterr().out == ""
