"""The search of the studio: the words of the trade lead to views, figures, parameters and documentation."""

from __future__ import annotations

import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Asked, Desk
from feeddrive.studio.rooms.search import Place, Search, documents, found, standing_places, trade_words


@pytest.fixture(scope="module")
def search(tmp_path_factory: pytest.TempPathFactory) -> Search:
    desk = Desk(tmp_path_factory.mktemp("page"))
    desk.bench = bench_of("ball_screw")
    return Search(desk)


def sought(search: Search, text: str) -> list[Place]:
    return found(text, search.places())


@pytest.mark.parametrize(
    ("text", "title", "kind"),
    [
        ("rope snap", "Rope-snap error", "figure"),
        ("GSV", "Kv", "parameter"),
        ("servo gain", "Kv", "parameter"),
        ("reset time", "Tn", "parameter"),
        ("lag", "Following error", "picture"),
        ("notch", "Add a filter: notch", "action"),
        ("Ms", "Ms", "figure"),
        ("delay marg", "Delay margin", "figure"),
        ("ballbar", "Circle test", "documentation"),
        ("lost motion", "Pitch errors and backlash", "documentation"),
        ("autotune", "auto tuning, autotune, servo tuning", "word"),
        ("feeddrive identify", "feeddrive identify", "command"),
    ],
)
def test_words_of_the_trade_lead_to_the_place(search: Search, text: str, title: str, kind: str) -> None:
    assert (title, kind) in [(place.title, place.kind) for place in sought(search, text)[:5]]


@pytest.mark.slow(reason="a search for each of a hundred words")
def test_each_word_of_the_trade_leads_somewhere(search: Search) -> None:
    assert sum(len(row.words) for row in trade_words()) > 100
    assert [word for row in trade_words() for word in row.words if not sought(search, word)] == []
    # rows that lead to a page that is made from declarations, and not written, have no place to be read
    assert {row.words[0] for row in trade_words() if not row.page} == {"notch", "biquad"}


def test_the_typed_word_comes_before_its_synonyms_and_all_words_before_some(search: Search) -> None:
    # `lag` is a parameter of the drive as well
    assert [place.title for place in sought(search, "lag")[:2]] == ["lag", "Following error"]
    assert sought(search, "delay marg")[0].title == "Delay margin"
    both = sought(search, "gain margin")
    assert both[0].title == "Gain margin"
    assert sought(search, "gain nonsense") != []
    assert sought(search, "xyzzy nonsense") == []


def test_a_word_has_two_letters_and_three_are_the_beginning_of_a_word_of_the_trade(search: Search) -> None:
    assert sought(search, "m") == []
    assert sought(search, "ms") != []
    assert sought(search, "geschw")[0].title == "Kv"  # of `Geschwindigkeitsverstärkung`
    assert sought(search, "schl")[0].title == "Following error"
    place = Place("errors", "word", "at a quadrant")
    assert [found(text, [place]) for text in ("qu", "qua")] == [[], [place]]
    assert len(sought(search, "limit")) == 12


def test_every_page_of_the_documentation_can_be_read(search: Search) -> None:
    assert {"how_to/studio", "GLOSSARY", "reference/words"} <= documents().keys()
    for place in standing_places():
        if place.page:
            said = search.read(Asked({"page": place.page, "heading": place.heading})).words["reading"]
            if place.kind == "documentation":
                assert said["title"] == place.title
    said = search.read(Asked({"page": "command:circle", "heading": ""})).words["reading"]
    assert said["parts"][1]["text"].startswith("feeddrive circle ")
    assert any(part["text"].startswith("--radius · mm · ") for part in said["parts"])
    said = search.read(Asked({"page": "GLOSSARY", "heading": "Suffixes"})).words["reading"]
    assert said["parts"][0] == {"kind": "row", "text": "suffix · meaning"}
    assert not any("`" in part["text"] or "](" in part["text"] for part in said["parts"])
    with pytest.raises(ParameterError, match="there is no page"):
        search.read(Asked({"page": "../../etc/passwd", "heading": ""}))
