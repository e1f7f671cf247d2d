"""Trees of named leaves: one walk names them, takes them out and puts them back."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine


def loop(**plant: float) -> Loop:
    return Loop(
        control=Control(
            law=CascadePPI(Kv=40.0, Kp=20e3, Tn=0.02),
            filters=(Notch(frequency=160.0), Notch(frequency=300.0)),
            force_limit=2000.0,
        ),
        axis=Axis(
            plant=TwoMass(**{"mass_motor": 100.0, "mass_load": 50.0, "stiffness": 1e8, **plant}),
            friction_load=Coulomb(coulomb=50.0),
            actuator=Actuator(dead_time=1e-4),
        ),
        sample_time=1e-4,
    )


def test_a_path_is_the_name_in_the_machine_file():
    """A loop of axis y places its parts under `axis.y`; the name by fields is refused with the path to write."""
    other = dataclasses.replace(loop(), name="y")
    paths, names = list(tree.parameters(other)), [name for name, _ in tree.leaves(other)]
    assert [tree.path_of(other, name) for name in names] == paths
    assert [tree.name_of(other, path) for path in paths] == names
    assert tree.get(tree.vary(other, {"axis.y.control.law.Kv": 7.0}), "axis.y.control.law.Kv") == 7.0
    assert tree.parameters(other.control.law) == dict(tree.leaves(other.control.law))
    for refused, right in (
        ("control.law.Kv", "axis.y.control.law.Kv"),
        ("axis.plant.stiffness", "axis.y.plant.stiffness"),
    ):
        with pytest.raises(ParameterError, match=f"'{refused}' is written '{right}', as in a machine file"):
            tree.vary(other, {refused: 1.0})
    with pytest.raises(ParameterError, match=r"no parameter 'axis.x.control.law.Kv'; did you mean axis.y.control.law"):
        tree.get(other, "axis.x.control.law.Kv")


def test_names_are_dotted_and_absent_parameters_have_none():
    names = list(tree.parameters(loop()))
    assert "axis.x.control.law.Kv" in names
    assert "axis.x.control.filters.1.frequency" in names
    assert "axis.x.plant.coupling_mass" not in names
    assert len(set(names)) == len(names)
    assert "axis.x.plant.coupling_mass" in tree.parameters(loop(coupling_mass=1.0))


def test_leaves_taken_out_and_put_back_are_the_same_tree():
    made = loop()
    again = tree.rebuild(made, (value for _, value in tree.leaves(made)))
    assert dict(tree.leaves(again)) == dict(tree.leaves(made))
    assert tree.structure(again) == tree.structure(made)
    assert repr(again) == repr(made)


class Inner(NamedTuple):
    a: float
    b: tuple[float, ...]


class Outer(NamedTuple):
    first: Inner
    nothing: None
    c: float


numbers = st.floats(-1e3, 1e3)
states = st.builds(Outer, st.builds(Inner, numbers, st.tuples(numbers, numbers)), st.none(), numbers)


@given(states, states, st.booleans())
def test_select_swaps_whole_states(a: Outer, b: Outer, condition: bool):
    assert tree.select(np.bool_(condition), a, b) == (a if condition else b)


@given(states)
def test_named_tuples_keep_their_type_and_names(state: Outer):
    assert [name for name, _ in tree.leaves(state)] == ["first.a", "first.b.0", "first.b.1", "c"]
    doubled = tree.rebuild(state, (2 * value for _, value in tree.leaves(state)))
    assert isinstance(doubled.first, Inner)
    assert doubled.first.b == (2 * state.first.b[0], 2 * state.first.b[1])


def test_get_and_vary_agree():
    varied = tree.vary(loop(), {"axis.x.control.law.Kv": 55.0, "axis.x.control.filters.0.frequency": 170.0})
    assert tree.get(varied, "axis.x.control.law.Kv") == 55.0
    assert tree.get(varied, "axis.x.control.filters.0.frequency") == 170.0
    assert tree.get(varied, "axis.x.control.filters.1.frequency") == 300.0


def test_vary_takes_lists_as_lanes():
    varied = tree.vary(loop(), {"axis.x.plant.mass_load": [40.0, 50.0, 60.0]})
    assert np.array_equal(tree.get(varied, "axis.x.plant.mass_load"), [40.0, 50.0, 60.0])
    assert tree.structure(varied) == tree.structure(loop())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axis.x.control.law.kv": 1.0}, "did you mean axis.x.control.law.Kv"),
        ({"axis.x.plant.mass": 1.0}, "there is no parameter 'axis.x.plant.mass'"),
        ({"axis.x.plant.coupling_mass": 1.0}, "there is no parameter"),
        ({"axis.x.control.law.Kv": -1.0}, r"axis\.x\.control\.law\.Kv = -1 1/s \(position gain\) must be > 0 1/s"),
        ({"axis.x.control.law.Kv": float("nan")}, "must be a finite number"),
        ({"axis.x.control.law.Kv": [1.0, -2.0]}, "must be > 0"),
        ({"axis.x.control.law.Kv": [1.0, 2.0], "axis.x.control.law.Kp": [1.0, 2.0, 3.0]}, "one length"),
        ({"axis.x.plant.mass_load": "heavy"}, "must be a number"),
        ({"axis.x.plant.mass_load": True}, "must be a number"),
    ],
)
def test_errors_name_parameter_value_bound_and_unit(changes: dict[str, object], words: str):
    with pytest.raises(ParameterError, match=words):
        tree.vary(loop(), changes)


def test_vary_runs_the_check_of_the_block():
    with pytest.raises(ParameterError, match="not positive definite"):
        tree.vary(loop(coupling_mass=1.0), {"axis.x.plant.coupling_mass": 90.0})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"axis.y.control.guard.safe_force": 3000.0},
            r"^axis\.y\.control\.guard\.safe_force = 3000 N is beyond axis\.y\.control\.force_limit = 2000 N",
        ),
        ({"axis.y.actuator.dead_time": 10.0}, r"^axis\.y\.actuator\.dead_time is 100000 samples"),
        ({"axis.y.plant.stiffness": 1e22}, r"^axis\.y\.plant: its fastest mode, "),
    ],
)
def test_what_does_not_fit_together_is_named_by_its_path(changes: dict[str, float], words: str):
    """Control and axis do not know the name of their axis: the loop puts it in."""
    plain = loop()
    guarded = dataclasses.replace(plain.control, guard=Guard(following_error_limit=1e-3))
    other = dataclasses.replace(plain, control=guarded, name="y")
    with pytest.raises((ParameterError, StructureError), match=words):
        tree.vary(other, changes)


def test_a_control_alone_and_a_machine_name_what_does_not_fit_by_path():
    plain = loop()
    guarded = dataclasses.replace(plain.control, guard=Guard(following_error_limit=1e-3))
    with pytest.raises(ParameterError, match=r"^guard\.safe_force = 3000 N is beyond force_limit = 2000 N"):
        tree.vary(guarded, {"guard.safe_force": 3000.0})
    two = Machine.of({"x": plain, "y": dataclasses.replace(plain, control=guarded)})
    words = r"^axis\.y\.control\.guard\.safe_force = 3000 N is beyond axis\.y\.control\.force_limit = 2000 N"
    with pytest.raises(ParameterError, match=words):
        tree.vary(two, {"axis.y.control.guard.safe_force": 3000.0})
    full = Machine.of({"x": plain, "y": loop(coupling_mass=1.0)})
    with pytest.raises(ParameterError, match=r"^axis\.y\.plant\.coupling_mass = 1000 kg must be smaller than"):
        tree.vary(full, {"axis.y.plant.coupling_mass": 1000.0})


def test_structure_knows_choices_types_and_what_is_absent_but_no_values():
    base = tree.structure(loop())
    assert base == tree.structure(tree.vary(loop(), {"axis.x.control.law.Kv": 1.0}))
    assert base != tree.structure(loop(coupling_mass=1.0))
    hash(base)


def test_blocks_are_walked_outermost_first():
    kinds = [block.kind for block in tree.blocks(loop())]
    assert kinds[0] == "loop"
    assert kinds.index("control") < kinds.index("cascade_ppi") < kinds.index("axis")
