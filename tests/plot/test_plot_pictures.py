"""Every picture draws without a warning, says its units, and covers no curve with its legend."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from io import BytesIO
from typing import Any

import numpy as np
import pytest

from feeddrive import plot
from feeddrive.analysis.friction_map import friction_map, worst_window
from feeddrive.analysis.margins import margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.spectrum import spectrum
from feeddrive.analysis.stability import stability
from feeddrive.analysis.stiffness import stiffness
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import MissingExtraError
from feeddrive.language.table import Result
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.gradient import gradient
from feeddrive.loop.linearize import compliance, linearize, loop_gain, tracking
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate, simulate_batch
from feeddrive.plot import frames, registry, style
from feeddrive.plot.chart import FREQUENCY, Chart, Panel
from feeddrive.plot.drawing import drawn

T = 5e-4
F = np.geomspace(1.0, 1000.0, 400)


class Stroke(Reference):
    """One sine stroke of 20 mm and 1 s."""

    @property
    def duration(self) -> float:
        return 1.0

    def at(self, t: np.ndarray) -> Setpoint:
        w = 2 * np.pi
        c, s = 0.01 * np.cos(w * t), 0.01 * np.sin(w * t)
        return Setpoint(0.01 - c, w * s, w**2 * c, -(w**3) * s, -(w**4) * c)


@cache
def loop(Kv: float = 40.0) -> Loop:
    plant = TwoMass(mass_motor=80.0, mass_load=40.0, stiffness=2e7, damping=900.0, viscous_load=100.0)
    return Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=Kv, Kp=3e4, Tn=0.02), force_limit=500.0),
        axis=Axis(plant=plant, friction_load=Coulomb(coulomb=20.0), encoder_load=Encoder(resolution=1e-7)),
    )


@cache
def run(Kv: float = 40.0) -> Run:
    return simulate(loop(Kv), Stroke(), name=f"Kv {Kv:g}")


def runs() -> list[Run]:
    return [run(), run(55.0)]


def replay() -> Replay:
    made = run()
    off = 1e-6 * np.sin(40.0 * made.time)
    measured = {
        "position_load": made["position_load"] + off,
        "following_error": made["following_error"] - off,
        "force": made["force"] + 2.0,
    }
    return Replay(made, measured, 49)


def measured_frf() -> FRF:
    response = loop_gain(loop(), F)
    return FRF(F, response.response, "force", "position_load", "m/N", coherence=np.linspace(1.0, 0.3, F.size))


PICTURES: dict[str, Callable[[], Any]] = {
    "run": lambda: run().plot(),
    "following error": lambda: plot.following_error(runs()),
    "following error, one": lambda: plot.following_error(run()),
    "reversal": lambda: plot.following_error(runs(), worst_window(runs())),
    "force": lambda: plot.force(runs(), {"motor peak": 500.0, "continuous": 30.0, "far": 1e5}),
    "motion": lambda: plot.motion(runs()),
    "friction": lambda: plot.friction(loop(), run()),
    "friction map": lambda: friction_map(run()["position_load"], run()["force"], 120.0, T).plot(),
    "spectrum": lambda: spectrum(run()["following_error"], T, name="following_error", unit="m").plot(),
    "spectra": lambda: plot.spectrum(
        {r.name: spectrum(r["following_error"], T, name="error", unit="m") for r in runs()}
    ),
    "bode": lambda: loop_gain(loop(), F).plot(),
    "bode with coherence": lambda: measured_frf().plot(),
    "open loop": lambda: margins(loop_gain(loop(), F)).plot(),
    "open loops": lambda: plot.open_loop({f"{Kv:g}": margins(loop_gain(loop(Kv), F)) for Kv in (40.0, 55.0)}),
    "nyquist": lambda: plot.nyquist(margins(loop_gain(loop(), F))),
    "nyquist of two": lambda: plot.nyquist({f"{Kv:g}": margins(loop_gain(loop(Kv), F)) for Kv in (40.0, 55.0)}),
    "sensitivity": lambda: plot.sensitivity(margins(loop_gain(loop(), F))),
    "closed loop": lambda: plot.closed_loop({"a": tracking(loop(), F), "b": tracking(loop(55.0), F)}),
    "stiffness": lambda: stiffness(compliance(loop(), F)).plot(),
    "poles": lambda: linearize(loop(), ["load_force"], ["position_load"]).plot(),
    "stability": lambda: stability(loop()).plot(),
    "batch": lambda: simulate_batch(
        tree.vary(loop(), {"axis.x.control.law.Kv": np.linspace(30, 60, 24)}), Stroke()
    ).plot(),
    "gradient": lambda: gradient(
        loop(), Stroke(), ["axis.x.control.law.Kv", "axis.x.control.law.Tn", "axis.x.plant.mass_load"]
    ).plot(),
    "replay": lambda: replay().plot(),
    "comparison": lambda: plot.comparison({r.name: r for r in runs()}),
}
UNIT = re.compile(r"\((µm|mm/s|m/s²|N|s|Hz|dB.*|deg|N/µm|mm|%)\)|part of|ratio|variants|coherence|^$")


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_draws_with_units_and_no_legend_over_a_curve(name: str) -> None:
    figure = PICTURES[name]()
    file = BytesIO()
    figure.savefig(file, format="png", dpi=40)
    assert file.getvalue().startswith(b"\x89PNG")
    labels = [figure.get_supylabel()]
    for ax in figure.axes:
        labels += [ax.get_xlabel(), ax.get_ylabel()]
        assert all(np.all(np.isfinite(limits)) for limits in (ax.get_xlim(), ax.get_ylim()))
        for legend in [ax.get_legend(), *figure.legends]:
            if legend is not None:
                box = legend.get_window_extent()
                # a row's legend stands on the upper edge of its axes: 0.02 of the height is its own padding
                assert box.y0 >= ax.bbox.y1 - 0.03 * ax.bbox.height or box.x0 >= ax.bbox.x1 or box.y1 <= ax.bbox.y0
    assert all(UNIT.search(label) for label in labels), labels
    assert any(labels)


@pytest.mark.parametrize(
    ("low", "high", "numbers"),
    [(11.0, 250.0, {"20", "50", "100", "200"}), (1.0, 1000.0, {"1", "10", "100", "1000"}), (2.0, 9.0, {"2", "5"})],
)
def test_a_frequency_axis_of_less_than_two_decades_has_numbers_between(
    low: float, high: float, numbers: set[str]
) -> None:
    figure = drawn(Chart("", (Panel(""),), FREQUENCY, low, high))
    figure.canvas.draw()
    (ax,) = figure.axes
    shown = zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
    assert {label.get_text() for at, label in shown if low <= at <= high} == numbers


def test_curves_differ_in_dashes_as_well_as_in_color() -> None:
    assert len({style.color(i) for i in range(6)}) == len({style.dashes(i) for i in range(6)}) == 6


def test_neither_pyplot_nor_a_global_setting_is_touched() -> None:
    code = (
        "import sys, matplotlib, numpy as np\n"
        "before = matplotlib.rcParams.copy()\n"
        "from feeddrive.loop.frequency_response import FRF\n"
        "f = np.geomspace(1, 100, 50)\n"
        "figure = FRF(f, 1 / (1 + 1j * f)).plot()\n"
        "png, size = figure._repr_png_()\n"
        "assert png.startswith(b'\\x89PNG') and size['width'] > 500\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "assert dict.__eq__(matplotlib.rcParams, before)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_importing_the_pictures_does_not_import_matplotlib() -> None:
    code = "import sys, feeddrive.plot, feeddrive.report; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_registered_name_is_a_result_and_its_function() -> None:
    """The registry holds texts, so that a renamed class or function is found here."""
    for table in (registry.CHARTS, {kind: f"frames:{name}" for kind, name in registry.FRAMES.items()}):
        for kind, place in table.items():
            module, name = kind.split(":")
            assert issubclass(getattr(import_module(f"feeddrive.{module}"), name), Result), kind
            module, name = place.split(":")
            assert callable(getattr(import_module(f"feeddrive.plot.{module}"), name)), place


def test_the_first_plot_imports_no_other_results() -> None:
    """A plot of a response needs neither tuning nor identification nor their parts of scipy."""
    code = (
        "import sys, numpy as np\n"
        "from feeddrive.loop.frequency_response import FRF\n"
        "f = np.geomspace(1, 100, 50)\n"
        "FRF(f, 1 / (1 + 1j * f)).plot()\n"
        "rooms = ('tuning', 'identification', 'certificate', 'cosimulation', 'files')\n"
        "found = [m for m in sys.modules if m.startswith(tuple(f'feeddrive.{room}' for room in rooms))]\n"
        "assert not found, found\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_names_are_shown_as_they_are_written() -> None:
    figure = plot.following_error({"_costs $3 or $4_": run(), "x" * 200: run(55.0)})
    figure.savefig(BytesIO(), format="svg")
    shown = [text.get_text() for ax in figure.axes for text in ax.get_legend().get_texts()]
    assert shown[0] == "\u200b_costs \\$3 or \\$4_"
    assert len(shown[1]) == 60


def test_a_frame_has_a_named_index_and_pandas_is_asked_for_only_then(monkeypatch: pytest.MonkeyPatch) -> None:
    table = margins(loop_gain(loop(), F)).to_pandas()
    assert table.index.name == "frequency"
    assert set(table["kind"]) == {"gain crossover", "phase crossover"}
    assert run().to_pandas().shape == (run().time.size, len(run().signals))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'feeddrive\[pandas\]'"):
        frames.frame([1], {"a": [2]}, "index")
