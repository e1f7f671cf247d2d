"""Blocks from TOML and back: the same bits; file, line, value, bound and unit for whatever is wrong."""

from __future__ import annotations

import random
import re
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.blocks.families import Force, Friction, Law, Plant, Reference
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.files.section import Section, read_block, read_section, text, to_toml
from feeddrive.files.toml_file import parse_toml
from feeddrive.language import tree, units
from feeddrive.language.block import Block, choice, declarations, parameter, part, table
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.testing.strategies import blocks_of
from fresh_draws import Seeded
from slow_share import all_but

ALL = [block for group in catalogue().values() for block in group.values()]
TWO_MASS = 'kind = "two_mass"\nmass_motor = 100\nmass_load = 350.0\nstiffness = 1.8e8\n'


def read(family: type[Block], text: str) -> Any:
    return read_block(family, parse_toml(text, "m.toml").root())


def bits(block: Block) -> list[Any]:
    """Types, choices, and the bits of every number of a block."""
    numbers_in = [(name, struct.pack("<d", value)) for name, value in tree.leaves(block)]
    rows = [(name, row.tobytes()) for name, row in tree.tables(block)]
    return [tree.structure(block), numbers_in, rows]


def families() -> list[tuple[type[Block], type[Block]]]:
    found = [(family, block) for family, group in catalogue().items() for block in group.values()]
    return [*found, (Axis, Axis), (Control, Control), (Loop, Loop)]


@pytest.mark.parametrize(
    ("family", "kind"),
    all_but(
        [each for each in families() if each[1] is not GainSchedule],
        families(),
        "most draws of laws at places are refused: 12 s",
    ),
    ids=lambda kind: kind.__name__,
)
@settings(max_examples=8, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_every_block_comes_back_from_its_text(family: type[Block], kind: type[Block], data: st.DataObject) -> None:
    block = data.draw(blocks_of(kind))
    text = to_toml(block)
    assert bits(read(family, text)) == bits(block)
    nested = to_toml(block, "axis.x.part")
    section = parse_toml(nested, "m.toml").root().section("axis").section("x").section("part")
    assert bits(read_block(family, section)) == bits(block)


class Everything(Force):
    """A block with every kind of field; it belongs to no folder."""

    amplitude: float = parameter("N", "amplitude", least=0)
    amplitude_offset: float = parameter("m", "a name that begins as the other", default=0.0)
    share: float = parameter("", "plain number", default=1.0)
    bandwidth: float = parameter("Hz", "frequency", default=None, above=0)
    count: int = choice("count", default=2, least=1)
    smooth: bool = choice("flag", default=False)
    label: str = choice("name", default="a")
    orders: tuple[int, ...] = choice("orders", default=(1, 2))
    mode: str | bool = choice("mode", options=("fast", "slow", True), default="fast")
    row: np.ndarray | None = table("N", "row", default=None)
    friction: Friction | None = part("one", default=None)
    laws: tuple[Law, ...] = part("many", default=())
    inner: TwoMass | None = part("exactly this one", default=None)

    def check(self) -> None:
        if self.share > 10:
            raise StructureError("everything.share is too large for the rest")

    def step(self, *given: Any) -> tuple[Any, Any, Any]:
        return (), 0.0, 0.0


EVERYTHING = """
amplitude_kN = 2
amplitude_offset_um = 3
share_percent = 50
bandwidth_kHz = 1
count = 3
smooth = true
label = "x \\" # y"
orders = [3]
mode = true
row_kN = [1, 2.5]
[friction]
kind = "coulomb"
coulomb = 5
[[laws]]
kind = "cascade_ppi"
Kv_m_per_min_per_mm = 3
Kp_kN_s_per_m = 4
[[laws]]
kind = "cascade_ppi"
Kv = 1
Kp = 1
Tn_ms = 20
[inner]
mass_motor = 1
mass_load_t = 2
stiffness_N_per_um = 180
"""


def test_every_kind_of_field() -> None:
    block = read(Everything, EVERYTHING)
    assert (block.amplitude, block.share, block.bandwidth) == (2000.0, 0.5, 1000.0)
    assert block.amplitude_offset == pytest.approx(3e-6, rel=1e-15)
    assert (block.count, block.smooth, block.label, block.orders, block.mode) == (3, True, 'x " # y', (3,), True)
    assert block.row.tolist() == [1000.0, 2500.0]
    assert block.friction.coulomb == 5.0
    assert block.laws[0].Kv == pytest.approx(50.0, rel=1e-15)  # 3 (m/min)/mm = 3 · 16.667 1/s
    assert block.laws[0].Kp == 4000.0
    assert (block.laws[0].Tn, block.laws[1].Tn) == (None, 0.02)
    assert (block.inner.mass_load, block.inner.stiffness) == (2000.0, 1.8e8)
    assert bits(read(Everything, to_toml(block))) == bits(block)


UNITS = [
    "N",
    "kN",
    "m",
    "mm",
    "um",
    "kg",
    "t",
    "g",
    "s",
    "ms",
    "us",
    "Hz",
    "kHz",
    "rpm",
    "A",
    "V",
    "N_m",
    "kg_m2",
    "deg",
]
UNITS += [
    "N_per_um",
    "N_s_per_m",
    "N_per_m",
    "m_per_s",
    "mm_per_s",
    "m_per_min",
    "1_per_s",
    "per_s",
    "m_per_min_per_mm",
]
UNITS += ["percent", "1", "kg_cm2", "N_s_per_mm", "N_m_per_A", "rad", "rad_per_s", "m_per_s2", "mm_per_rev", "N_per_A"]


def test_a_parameter_in_any_unit_of_its_dimension_is_the_same_and_in_no_other() -> None:
    fitting = 0
    for kind in ALL:
        for name, declared in declarations(kind).items():
            for unit in UNITS if declared.role == "parameter" else []:
                text = f"{name}_{unit} = 0.5"
                try:
                    factor = units.factor(unit, declared.unit)
                except ParameterError:
                    with pytest.raises(ParameterError, match=r"does not measure the same thing|is not known to"):
                        read(kind, text)
                    continue
                if f"{name}_{unit}" in declarations(kind) or not declared.admits(0.5 * factor):
                    continue
                fitting += 1
                with pytest.raises(FeeddriveError) as missing:  # only what else is needed, or it is read
                    read(kind, text + "\nnobody_knows_this = 1")
                assert "nobody_knows_this" in str(missing.value)
    assert fitting > 50


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass_load = 1\n", r"m\.toml: kind is missing; there are: .*two_mass"),
        ('a = 1\nkind = "two_mas"', r"m\.toml:2: kind = 'two_mas' is not known; did you mean two_mass"),
        ("kind = 5", r"m\.toml:1: kind = 5 is not known; there are: "),
        (TWO_MASS + "stifness = 1", r"m\.toml:5: key 'stifness' is not known to two_mass; did you mean stiffness\?"),
        (TWO_MASS + "mass_motor_g = 1", r"m\.toml:5: mass_motor is given twice, as mass_motor and as mass_motor_g"),
        (TWO_MASS + "damping_N = 1", r"m\.toml:5: key 'damping_N' is not .*unit 'N' does not measure .*'N s/m'"),
        (TWO_MASS + "damping_foo = 1", r"m\.toml:5: key 'damping_foo' .*; if damping is meant: .*'foo'"),
        (TWO_MASS + "damping = -2", r"m\.toml:5: damping = -2 N s/m \(damping between .*\) must be >= 0 N s/m"),
        (TWO_MASS + "damping_N_s_per_mm = -2", r"damping = -2000 N s/m .* >= 0 .*\(given as damping_N_s_per_mm = -2\)"),
        (TWO_MASS + "damping = nan", r"m\.toml:5: damping = nan N s/m .* must be a finite number"),
        (TWO_MASS + "damping = -inf", r"m\.toml:5: damping = -inf N s/m .* must be a finite number"),
        (TWO_MASS + f"damping = 1{'0' * 400}", r"m\.toml:5: damping = inf N s/m .* must be a finite number"),
        (TWO_MASS + 'damping = "5"', r"m\.toml:5: damping = '5' .* must be a number without quotes"),
        (TWO_MASS + "damping = true", r"m\.toml:5: damping \(damping between .*\) must be a number, not True"),
        (TWO_MASS + "damping = [1]", r"m\.toml:5: damping .* must be a number, not \[1\]"),
        (TWO_MASS + "[damping]", r"m\.toml:5: damping .* must be a number, not \{\}"),
        (TWO_MASS + "coupling_mass = 1e4", r"m\.toml: two_mass\.coupling_mass = 10000 kg must be smaller"),
        ('kind = "two_mass"\nmass_load = 1', r"needs mass_motor \(kg, .*, > 0 kg\), stiffness \(N/m, axial stiffness"),
    ],
)
def test_what_is_wrong_with_a_plant(text: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message) as error:
        read(Plant, text)
    assert "\n" not in str(error.value)


def test_a_kind_of_before_is_refused_with_the_new_one() -> None:
    said = r"m\.toml:1: kind = 'shaped' is now called 'input_shaped'"
    with pytest.raises(ParameterError, match=said):
        read(Reference, 'kind = "shaped"\nfrequency = 30')
    with pytest.raises(ParameterError, match=r"'shaped' is not known; there are: .*two_mass"):  # of another family
        read(Plant, 'kind = "shaped"')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("count = 0", r"m\.toml:2: count = 0 \(count\) must be >= 1"),
        ("count = 1.5", r"count = 1\.5 \(count\) must be a whole number"),
        ("count = true", r"count = true \(count\) must be a whole number"),
        ("smooth = 1", r"smooth = 1 \(flag\) must be true or false"),
        ("label = 1", r"label = 1 \(name\) must be text in quotes"),
        ("orders = 1", r"orders = 1 \(orders\) must be a list, each entry a whole number"),
        ("orders = [1, 'a']", r"orders = \[1, 'a'\] \(orders\) must be a list, each entry a whole number"),
        ("mode = 1", r"m\.toml:2: mode = 1 \(mode\) must be one of \"fast\", \"slow\", true"),
        ("row = 1", r"row \(row\) must be a list of numbers"),
        ("row = [1, 'a']", r"row: entry 2 = 'a' \(row\) must be a finite number"),
        ("row = [1, true]", r"row: entry 2 = true \(row\) must be a finite number"),
        ("row = [1, nan]", r"row: entry 2 = nan \(row\) must be a finite number"),
        ("row = [1, [2]]", r"row: entry 2 = \[2\] \(row\) must be a finite number"),
        ("row = [1]", r"m\.toml:2: row \(row\) must be a row of at least two numbers"),
        ("label_m = 1", r"key 'label_m' is not known to everything"),
        ("share = 11", r"m\.toml: everything\.share is too large"),
        ("friction = 1", r"m\.toml:2: friction = 1 must be a section \[friction\]"),
        ("[[friction]]", r"m\.toml:2: friction = .* must be a section \[friction\]"),
        ("[laws]", r"m\.toml:2: laws must be a list of sections, each under \[\[laws\]\]"),
        ("laws = [1]", r"m\.toml:2: laws must be a list of sections"),
        ("[friction]\n", r"m\.toml:2: friction: kind is missing; there are: .*coulomb"),
        ("[friction]\nkind = 'coulomb'", r"m\.toml:2: friction: coulomb needs coulomb \(N, level of the "),
        ("[friction]\nkind = 'coulomb'\ncoulomb = -1", r"m\.toml:4: friction\.coulomb = -1 N .* must be >= 0 N"),
        ("[[laws]]\nkind = 'cascade_ppi'\nKv = 0", r"m\.toml:4: laws\.0\.Kv = 0 1/s .* must be > 0 1/s"),
        ("[inner]\nkind = 'rigid'", r"m\.toml:3: inner\.kind = 'rigid' is not known; there are: two_mass"),
        (
            "[inner]\nmass_motor = 1\nmass_load = 1\nstiffness = 1\ncoupling_mass = 2",
            r"m\.toml:2: inner: two_mass\.coupling_mass = 2 kg must be smaller",
        ),
    ],
)
def test_what_is_wrong_with_every_kind_of_field(text: str, message: str) -> None:
    with pytest.raises((ParameterError, StructureError), match=message) as error:
        read(Everything, "amplitude = 1\n" + text)
    assert "\n" not in str(error.value)


def test_keys_of_somebody_else_are_left_alone() -> None:
    class Bench(Section):
        """A plant whose keys stand among those of a section."""

        title: str = text("of the bench")
        plant: Plant = part("the mechanics", inline=True)

    table = parse_toml("title = 'a'\n" + TWO_MASS + "note = 'x'\n", "m.toml").root()
    bench = read_section(Bench, table, besides=["note"])
    assert isinstance(bench.plant, TwoMass)
    assert (bench.title, bench.plant.mass_load) == ("a", 350.0)


def test_the_text_explains_itself() -> None:
    lines = to_toml(TwoMass(mass_motor=1, mass_load=2, stiffness=3e8), "axis.x.plant").split("\n")
    assert lines[0] == "[axis.x.plant]"
    assert lines[1] == 'kind = "two_mass"                  # ' + (TwoMass.__doc__ or "").split("\n")[0]
    assert lines[2] == "mass_motor = 1.0                   # kg: motor, coupling and screw, seen at the table (> 0 kg)"
    assert "# coupling_mass =                  # kg: off-diagonal term of the mass matrix" in lines


def test_variants_have_no_text() -> None:
    plant = TwoMass(mass_motor=1, mass_load=2, stiffness=3e8)
    with pytest.raises(StructureError, match="mass_load holds variants, not one number"):
        to_toml(tree.vary(plant, {"mass_load": np.array([1.0, 2.0])}))


def test_random_values_raise_nothing_but_errors_with_file_and_line(seeded: Seeded) -> None:
    draw = random.Random(seeded(2))
    pool = [
        "1",
        "-1",
        "0",
        "nan",
        "inf",
        "true",
        "'a'",
        "[]",
        "[1.0, 2]",
        "{}",
        "{kind = 'rigid'}",
        "[{}]",
        "1e308",
        "''",
    ]
    pool += ["1979-05-27", "07:32:00", f"1{'0' * 400}", "[[]]", "5e-324", "{kind = {}}", "[{kind = 'coulomb'}]"]
    read_well = 0
    for _ in range(3000):
        family, kind = draw.choice(families())
        names = [*declarations(kind), "kind", "kind_m", *(f"{name}_mm" for name in declarations(kind)), "x", '""']
        text = f'kind = "{kind.kind}"\n' if draw.random() < 0.8 else ""
        for name in draw.sample(names, draw.randrange(len(names))):
            text += "" if name == "kind" and "kind" in text else f"{name} = {draw.choice(pool)}\n"
        try:
            read(family, text)
            read_well += 1
        except FeeddriveError as error:
            message = str(error)
            assert re.match(r"m\.toml(:\d+)?: [^\n]+$", message), message
    assert read_well > 0
