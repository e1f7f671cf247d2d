"""TOML with lines: every key is found where it stands, and every broken file is named with line and reason."""

from __future__ import annotations

import random
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from feeddrive.files.toml_file import Key, TomlFile, TomlTable, lines_of_keys, parse_toml, read_toml
from feeddrive.language.errors import FileError, ParameterError, plain, shown
from fresh_draws import Seeded
from slow_share import all_but

EVERYTHING = (
    r'''# a comment with [brackets] = "quotes"
title = "a # b = [c]"      # 2
'quoted key' = 1           # 3
"esc\u0061ped\tkey" = 2    # 4
dotted . name.deep = 3     # 5
numbers = [                # 6
  1, 2,   # [not, a, table]
  3, -0.5e3,
]
nested = [[1, 2], [        # 10
  3, 4]]
tables = [{ a = 1, b = { c = "}" } },   # 12
          { a = 2, b = { c = ']' } }]   # 13
text = """
[not.a.section]
key = 1 \" """ "" """"     # never reached as a key
'''.replace('""" "" """"', '""""')
    + r"""
literal = '''
x = 1 '
''''
when = 1979-05-27T07:32:00Z
flag = true

[axis.x]                   # 25
mass = 1
[[axis.x.forces]]          # 27
kind = "gravity"
[[axis.x.forces]]          # 29
kind = "cogging"
[axis.x.forces.table]      # 31
row = [1.0]
[axis.y]
mass.kg = 2                # 34
[ axis . "z z" ]           # 35
"""
)


def keys(value: Any, key: Key = ()) -> set[Key]:
    """Every table, key and table in an array below a value, from tomllib alone."""
    found: set[Key] = {key} if key else set()
    if isinstance(value, dict):
        for name, item in value.items():
            found |= keys(item, (*key, name))
    elif isinstance(value, list):
        for place, item in enumerate(value):
            if isinstance(item, dict | list):
                found |= keys(item, (*key, place))
    return found


def test_every_key_has_its_line() -> None:
    lines = lines_of_keys(EVERYTHING)
    assert set(lines) == keys(tomllib.loads(EVERYTHING))
    rows = EVERYTHING.split("\n")
    expected = {
        ("title",): 2,
        ("quoted key",): 3,
        ("escaped\tkey",): 4,
        ("dotted", "name", "deep"): 5,
        ("numbers",): 6,
        ("nested",): 10,
        ("nested", 1): 10,
        ("tables", 0, "b", "c"): 12,
        ("tables", 1, "a"): 13,
        ("axis", "x", "forces", 0): rows.index("[[axis.x.forces]]          # 27") + 1,
        ("axis", "x", "forces", 1, "kind"): rows.index('kind = "cogging"') + 1,
        ("axis", "x", "forces", 1, "table", "row"): rows.index("row = [1.0]") + 1,
        ("axis", "y", "mass", "kg"): rows.index("mass.kg = 2                # 34") + 1,
        ("axis", "z z"): rows.index('[ axis . "z z" ]           # 35') + 1,
    }
    assert {key: lines[key] for key in expected} == expected


VALUES = ["1", "-2.5e-3", "true", '"x = 1 # [a]"', "'}]'", '"""a\nb = 2\n""""', "'''[[c]]\n'd'\n'''", "[]", "{}"]
VALUES += ["[1, [2, 'a'], {q = 1}]", "[\n 1, # , [ {\n 2,\n]", "07:32:00", "nan"]


class Writer:
    """Writes random documents in every layout that TOML knows, and notes where each key went."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.rows: list[str] = []
        self.lines: dict[Key, int] = {}

    def name(self) -> str:
        return self.draw.choice(["a", "b1", "c_d", "-", "7", "sp ace", "q'uote", 'd"ot.s', "μ", "#"])

    def spelled(self, name: str) -> str:
        if all(c.isascii() and (c.isalnum() or c in "-_") for c in name) and self.draw.random() < 0.8:
            return name
        if "'" not in name and self.draw.random() < 0.5:
            return f"'{name}'"
        return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'

    def value(self) -> str:
        return self.draw.choice(VALUES)

    def note(self, key: Key, row: int) -> None:
        self.lines.setdefault(key, row)

    def pairs(self, prefix: Key) -> None:
        used: set[str] = set()
        for _ in range(self.draw.randrange(4)):
            name = self.name()
            if name in used:
                continue
            used.add(name)
            row = len("\n".join(self.rows).split("\n")) + 1 if self.rows else 1
            parts = [name] + ([self.name()] if self.draw.random() < 0.2 else [])
            for k in range(len(parts)):
                self.note((*prefix, *parts[: k + 1]), row)
            text = self.value()
            if text == "[1, [2, 'a'], {q = 1}]":
                for tail in ((1,), (2,), (2, "q")):
                    self.note((*prefix, *parts, *tail), row)
            spaces = self.draw.choice(["", " ", "\t "])
            self.rows.append(f"{spaces}{'.'.join(map(self.spelled, parts))}{spaces}={spaces}{text} # {name}")
            if self.draw.random() < 0.3:
                self.rows.append(self.draw.choice(["", "# [comment]", "   "]))

    def document(self) -> str:
        self.pairs(())
        for k in range(self.draw.randrange(5)):
            path = (f"t{k}", *(self.name() for _ in range(self.draw.randrange(2))))
            array = self.draw.random() < 0.5
            for place in range(self.draw.choice([1, 3]) if array else 1):
                row = len("\n".join(self.rows).split("\n")) + 1 if self.rows else 1
                for end in range(1, len(path) + 1):
                    self.note(path[:end], row)
                prefix: Key = (*path, place) if array else path
                self.note(prefix, row)
                header = ".".join(map(self.spelled, path))
                self.rows.append(f"[[{header}]]" if array else f"[ {header} ]")
                self.pairs(prefix)
        return "\n".join(self.rows) + "\n"


def test_random_documents_in_every_layout(seeded: Seeded) -> None:
    for seed in range(600):
        writer = Writer(seeded(seed))
        text = writer.document()
        content = tomllib.loads(text)
        lines = lines_of_keys(text)
        assert set(lines) == keys(content), text
        assert lines == writer.lines, text


def outcome(text: str) -> TomlFile | str:
    try:
        return parse_toml(text, "m.toml")
    except FileError as error:
        return str(error)


def test_damaged_documents_raise_nothing_but_a_file_error(seeded: Seeded) -> None:
    draw = random.Random(seeded(1))
    accepted = 0
    for _ in range(2500):
        text = list(EVERYTHING)
        for _ in range(draw.randrange(1, 4)):
            place = draw.randrange(len(text))
            match draw.randrange(4):
                case 0:
                    del text[place : place + draw.randrange(1, 30)]
                case 1:
                    text[place] = draw.choice("[]{}\"'=.,#\\\n\r\t\x00\x7f\u2028a1_")
                case 2:
                    text.insert(place, draw.choice("[]{}\"'=.,#\\\n\ra1"))
                case _:
                    text = text[:place] if draw.random() < 0.2 else text
            text = text or ["x"]
        damaged = "".join(text)
        found = outcome(damaged)
        if isinstance(found, str):
            assert re.match(r"m\.toml(:\d+)?: [^\n]+$", found)
        else:
            accepted += 1
            assert set(found.lines) == keys(found.content), damaged
    assert accepted > 100  # harmless damages, in comments and values: the lines still fit


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = 1\nb = 1,5\n", r"m\.toml:2: is not valid TOML: .* in  b = 1,5; .*decimal point"),
        ("a = 1\nkind = two_mass\n", r"m\.toml:2: .*invalid value in  kind = two_mass; a text needs quotes"),
        ("a\n", r"m\.toml:1: .*expected '=' .*; a line reads  key = value"),
        ("a = 1\na = 2\n", r"m\.toml:2: .*cannot overwrite a value.*given twice"),
        ("[a]\n[b]\n[a]\n", r"m\.toml:3: .*opened twice"),
        ("x = [1,\n2", r"m\.toml:2: is not valid TOML: unclosed array in  2; a bracket \] is missing"),
        ('x = "abc\n', r"m\.toml:1: .*a closing quote is missing"),
        ("x = " + "1" * 5000, "holds a value that cannot be read"),
        ("x = 2020-02-31", r"m\.toml"),
        ("x = " + "[" * 5000, "nested too deeply"),
        ("a = 1\n" + "a." * 3000 + "b = 1", r"m\.toml:2: a name of more than 64 parts"),
    ],
)
def test_syntax_errors_name_line_and_remedy(text: str, message: str) -> None:
    with pytest.raises(FileError, match=message):
        parse_toml(text, "m.toml")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a = 1\nb = '\xff'", r"m\.toml:2: holds the byte 0xff, which is not UTF-8"),
        ("a = 1".encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
        (b"a = \0", "is a binary file, not TOML text"),
        (b"# " + b"x" * 4_000_000, r"has 4\.0 MB, more than the 4\.0 MB"),
    ],
)
def test_files_that_are_no_text(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "m.toml").write_bytes(content)
    with pytest.raises(FileError, match=message):
        read_toml(tmp_path / "m.toml")


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\n\r\nb = 2\r\n")
    file = read_toml(tmp_path / "m.toml")
    assert file.content == {"a": 1, "b": 2}
    assert file.lines == {("a",): 1, ("b",): 3}


@pytest.mark.parametrize(
    "text",
    [
        "a = [" + "1.5, " * 790_000 + "]",
        "# " + "a." * 1_999_000,
        "".join(f"key_{k} = {k}\n" for k in range(100_000)),
        "x = '" + "[" * 3_900_000 + "'",
        "a" * 3_900_000,
        "a.a." * 15 + "\n" + ("b" * 62 + "\n") * 60_000,
        "[[t]]\n" * 100_000,
    ],
    ids=lambda text: text[:6].strip(),
)
@pytest.mark.parametrize("most", all_but([800_000], [800_000, 4_000_000], "the same with five times the characters"))
@pytest.mark.timeout(120)
def test_the_largest_files_come_to_an_end(text: str, most: int) -> None:
    """Time must grow with the length of a file, not with its square: 4 MB of square time would be hours, 0.8 MB some
    minutes.
    """
    assert outcome(text[:most]) is not None


def section(text: str) -> TomlTable:
    return parse_toml(text, "m.toml").root()


def test_sections_say_what_is_missing_or_of_another_type() -> None:
    root = section("a = 1\n[b]\nx = 1\n[[c]]\ny = 2\n[[c]]\ny = 3\n[d]\n")
    assert root.section("b").values == {"x": 1}
    assert [each.values["y"] for each in root.listed("c")] == [2, 3]
    assert root.listed("c")[1].dotted("y") == "c.1.y"
    assert root.listed("nothing") == ()
    assert root.optional("nothing") is None
    with pytest.raises(ParameterError, match=r"m\.toml: section \[e\] is missing"):
        root.section("e")
    with pytest.raises(ParameterError, match=r"m\.toml:1: a = 1 must be a section \[a\]"):
        root.section("a")
    with pytest.raises(ParameterError, match=r"m\.toml:2: b must be a list of sections, each under \[\[b\]\]"):
        root.listed("b")
    with pytest.raises(ParameterError, match=r"there must be at least one section \[d\.NAME\]"):
        root.named("d")
    with pytest.raises(ParameterError, match=r"m\.toml:3: b\.x = 1 must be a section"):
        root.named("b")
    with pytest.raises(ParameterError, match=r"m\.toml:5: key 'c\.0\.y' is not known; did you mean yy\?"):
        root.listed("c")[0].refuse_unknown(["yy", "zz"])
    with pytest.raises(ParameterError, match=r"key 'a' is not known; there are: first, second"):
        root.refuse_unknown(["first", "second"])


def test_values_in_messages_stay_short() -> None:
    assert shown(10**4000) == "a whole number of more than 20 digits"
    assert shown(True) == "true"
    assert plain("a\n\x1b[31mb μ²") == "a??[31mb μ²"
    assert len(shown("x" * 1000)) == 60
