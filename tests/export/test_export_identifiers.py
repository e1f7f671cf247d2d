"""Names of exports: legal, unique without regard to case, stable, and no word of any target's language."""

from __future__ import annotations

import keyword
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.export.identifiers import C_WORDS, HAL_WORDS, ST_WORDS, ascii_text, check_name, identifier
from feeddrive.language.errors import ParameterError

WORDS = sorted(C_WORDS | ST_WORDS | HAL_WORDS)
wanted = st.one_of(st.text(max_size=20), st.sampled_from(WORDS), st.from_regex(r"[a-zA-Z_.0-9]{1,12}", fullmatch=True))


@given(st.lists(wanted, max_size=30), st.sampled_from([C_WORDS, ST_WORDS, C_WORDS | ST_WORDS | HAL_WORDS]))
def test_names_are_legal_unique_and_stable(names: list[str], reserved: frozenset[str]) -> None:
    taken: set[str] = set()
    found = [identifier(name, taken, reserved) for name in names]
    assert len({name.upper() for name in found}) == len(names)
    assert set(found) == taken
    forbidden = {word.upper() for word in reserved}
    for name in found:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)
        assert "__" not in name
        assert not name.endswith("_")
        assert name.upper() not in forbidden
    again: set[str] = set()
    assert [identifier(name, again, reserved) for name in names] == found


@given(st.from_regex(r"[A-Za-z][a-z0-9]{0,8}(_[a-z0-9]{1,5}){0,3}", fullmatch=True))
def test_a_good_name_stays(name: str) -> None:
    assert identifier(name, set(), frozenset()) == name


@pytest.mark.parametrize(
    ("given_name", "expected"),
    [
        ("control.law.Kv", "control_law_Kv"),
        ("ω0", "omega0"),
        ("Ω", "Omega"),
        ("x̂", "x"),
        ("é1", "e1"),
        ("T", "T_2"),
        ("__x__", "x"),
        ("2nd", "x2nd"),
        ("", "x"),
        ("step", "step_2"),
        ("double", "double_2"),
    ],
)
def test_what_becomes_of_a_name(given_name: str, expected: str) -> None:
    assert identifier(given_name, set(), C_WORDS | ST_WORDS) == expected


def test_case_does_not_tell_names_apart() -> None:
    taken: set[str] = set()
    assert [identifier(name, taken, ST_WORDS) for name in ("Kv", "kv", "KV", "kv_2")] == [
        "Kv",
        "kv_2",
        "KV_3",
        "kv_2_2",
    ]


def test_reserved_words_cover_the_keywords_that_everybody_knows() -> None:
    assert {"double", "restrict", "class", "INFINITY"} <= C_WORDS
    assert {"STEP", "LREAL", "FUNCTION_BLOCK", "T", "S1"} <= ST_WORDS
    assert all(word == word.upper() for word in ST_WORDS)
    assert not any(keyword.iskeyword(word) for word in HAL_WORDS)


@pytest.mark.parametrize("name", ["axis_x", "X", "spindle2", "a" * 47])
def test_a_name_that_can_be_exported(name: str) -> None:
    check_name(name, "--name")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "cannot name"),
        ("x axis", "cannot name"),
        ("x-axis", "cannot name"),
        ("_x", "cannot name"),
        ("x_", "cannot name"),
        ("x__y", "cannot name"),
        ("2x", "cannot name"),
        ("höhe", "cannot name"),
        ("x\n", "cannot name"),
        ("a" * 48, "48 characters, 1 more than the 47"),
        ("double", "C or C\\+\\+"),
        ("step", "Structured Text"),
        ("Step", "Structured Text"),
        ("pin", "HAL"),
    ],
)
def test_a_name_that_cannot_be_exported_is_named_with_the_reason(name: str, said: str) -> None:
    with pytest.raises(ParameterError, match=said) as raised:
        check_name(name, "--name")
    assert "--name" in str(raised.value)
    assert repr(name) in str(raised.value)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("H(z) = b1 z⁻¹ + b2 z⁻²", "H(z) = b1 z^-1 + b2 z^-2"),
        ("2 ζ ω T, x̂₁ and λ₁₂", "2 zeta omega T, x_1 and lambda_12"),
        ("every 50 µs, ü ≤ 3 · Δ", "every 50 us, u <= 3 * Delta"),
        ("√x → ∞, 日", "sqrtx -> inf, ?"),
        ("a ·/ b", "a * / b"),
    ],
)
def test_comments_are_spelled_in_ascii(text: str, wanted: str) -> None:
    assert ascii_text(text) == wanted


@given(st.text())
def test_any_text_has_an_ascii_form(text: str) -> None:
    assert ascii_text(text).isascii()
    assert ascii_text(ascii_text(text)) == ascii_text(text)
