"""Changes of values in a TOML file leave comments, order and everything else as they are."""

from __future__ import annotations

import tomllib

import pytest

from feeddrive.files.machine import BUNDLED
from feeddrive.files.toml_file import TomlEdit
from feeddrive.language.errors import FileError, ParameterError

TEXT = """# a machine
name = "x # not a comment"   # its name
[axis.x.plant] # the plant
mass_g = 1500.0              # weighed
list = [1.0, # one
        2.0]

# the friction of the guideway
[axis.x.friction_load]
kind = "coulomb"
# measured in winter
coulomb = 3.0

# forces
[[axis.x.forces]]
force = 1.0   # N
[[axis.x.forces]]
force = 2.0   # N
"""


def test_a_value_keeps_its_unit_its_comment_and_its_place() -> None:
    edit = TomlEdit(TEXT, "m.toml")
    edit.set(("axis", "x", "plant", "mass"), 2.25, "kg")
    edit.set(("axis", "x", "forces", 1, "force"), -4.5, "N")
    edit.set(("axis", "x", "plant", "viscous"), 7.0, "N s/m")
    assert edit.text == TEXT.replace("1500.0", "2250.0").replace("force = 2.0", "force = -4.5").replace(
        "        2.0]\n", "        2.0]\nviscous = 7.0\n"
    )
    content = tomllib.loads(edit.text)["axis"]["x"]
    assert content["plant"] == {"mass_g": 2250.0, "list": [1.0, 2.0], "viscous": 7.0}
    assert [each["force"] for each in content["forces"]] == [1.0, -4.5]
    assert "# weighed" in edit.text
    assert '"x # not a comment"   # its name' in edit.text


@pytest.mark.parametrize("text", ['a "quoted" word', "two\nlines", "back\\slash", "\x7f", "\t", "\U0001f527 µm"])
def test_every_text_that_is_set_is_read_back(text: str) -> None:
    edit = TomlEdit(TEXT, "m.toml")
    edit.set(("axis", "x", "plant", "name"), text)
    assert tomllib.loads(edit.text)["axis"]["x"]["plant"]["name"] == text


def test_a_section_is_replaced_and_its_own_comments_stay() -> None:
    edit = TomlEdit(TEXT, "m.toml")
    edit.replace(("axis", "x", "friction_load"), '[axis.x.friction_load]\nkind = "stribeck"\n')
    assert "# measured in winter" in edit.text
    assert "# the friction of the guideway" in edit.text
    assert "# forces\n[[axis.x.forces]]" in edit.text
    assert tomllib.loads(edit.text)["axis"]["x"]["friction_load"] == {"kind": "stribeck"}
    edit.remove(("axis", "x", "forces"))
    assert "forces" not in tomllib.loads(edit.text)["axis"]["x"]
    edit.replace(("axis", "x", "forces"), "[[axis.x.forces]]\nforce = 5.0")
    assert tomllib.loads(edit.text)["axis"]["x"]["forces"] == [{"force": 5.0}]


def test_words_behind_a_value_are_renewed_and_not_piled_up() -> None:
    edit = TomlEdit(TEXT, "m.toml")
    key = ("axis", "x", "forces", 0, "force")
    for words in ("standard error 0.2 N", "standard error 0.1 N"):
        edit.comment(key, words)
    assert "force = 1.0   # N; standard error 0.1 N\n" in edit.text
    bare = TomlEdit("a = 1.0\n", "m.toml")
    for words in ("standard error 0.2 N", "standard error 0.1 N"):
        bare.comment(("a",), words)
    assert bare.text == "a = 1.0  # standard error 0.1 N\n"


@pytest.mark.parametrize("path", sorted((BUNDLED / "machines").glob("*.toml")), ids=lambda path: path.stem)
def test_setting_what_is_there_changes_nothing_but_the_digits(path: object) -> None:
    """Every number of every bundled machine, set to itself: the content is the same and so are all comments."""
    text = path.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    edit = TomlEdit(text, "m.toml")
    numbers = [(key, value) for key, value in _leaves(tomllib.loads(text)) if isinstance(value, float)]
    for key, value in numbers:
        edit.set(key, value, digits=17)
    assert tomllib.loads(edit.text) == tomllib.loads(text)
    assert [line.partition("#")[2] for line in edit.text.split("\n")] == [
        line.partition("#")[2] for line in text.split("\n")
    ]


def _leaves(value: object, key: tuple[str | int, ...] = ()) -> list[tuple[tuple[str | int, ...], object]]:
    if isinstance(value, dict):
        return [leaf for name, each in value.items() for leaf in _leaves(each, (*key, name))]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [leaf for k, each in enumerate(value) for leaf in _leaves(each, (*key, k))]
    return [(key, value)]


def test_what_cannot_be_changed_is_said() -> None:
    edit = TomlEdit(TEXT, "m.toml")
    with pytest.raises(ParameterError, match=r"m\.toml: there is no section \[axis\.y\.plant\]"):
        edit.set(("axis", "y", "plant", "mass"), 1.0, "kg")
    with pytest.raises(FileError, match="changed text"):
        edit.add("[axis.x.plant]\nmass = 1.0")
    with pytest.raises(FileError):
        TomlEdit("a = ", "m.toml")


def test_a_section_that_has_no_header_but_that_of_its_part_gets_one() -> None:
    text = 'name = "x"\n\n# the motor\n[axis.x.actuator.motor] # of 1999\nkind = "direct"\n'
    edit = TomlEdit(text, "m.toml")
    edit.set(("axis", "x", "actuator", "dead_time"), 1e-3, "s")
    assert edit.text == text.replace("# the motor", "[axis.x.actuator]\ndead_time = 0.001\n\n# the motor")
