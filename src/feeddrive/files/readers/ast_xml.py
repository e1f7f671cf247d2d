"""Measurements and controllers in the XML of the tuning tool of SINUMERIK drives (AST).

The tag of an element is its class; the attribute `name` is its member name:

    <DynamicModelAxisController>
      <LinkedList name="m_SpeedPlantMeasurementList"><SpeedPlantMeasurement>
        <string name="m_szTimeStamp">2014-05-06 07:08</string>
        <FrequencyResponseFunction name="m_pPlant">
          <NumericArray name="m_ValueVector" elementtype="complex"><raw name="m_pNumberArray"><![CDATA[...]]></raw> ...
          <NumericArray name="m_FrequencyVector" elementtype="double"> ...

Numbers are encoded in base 85: five characters, most significant first, encode a 32-bit word, a period encodes a zero
word, and two words form a big-endian IEEE 754 double; complex arrays alternate between real and imaginary parts.
An array with format="CSV" holds comma-separated numbers instead.  Responses without numbers are left out.

Member names differ between versions of the tool: `controllers` returns every scalar with its path.  Document type
declarations and entities are refused before they are read; depth, number of elements and file size are bounded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from feeddrive.files.columns import Columns, free_name
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity

MOST_BYTES = 100_000_000
# `walk` is recursive
_DEEPEST = 50
_MOST_ELEMENTS = 200_000
_MOST_RESPONSES = 1000

_ALPHABET = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
_ZERO_WORD = "."
_DIGITS = np.full(128, 255, dtype=np.uint8)
_DIGITS[np.frombuffer(_ALPHABET.encode(), np.uint8)] = np.arange(85)
_PLACES = 85 ** np.arange(4, -1, -1, dtype=np.uint64)

_RESPONSE, _ARRAY = "FrequencyResponseFunction", "NumericArray"
_SCALARS = ("float", "double", "unsigned_int", "integer", "int", "boolean", "string")
_COHERENCE = "m_pMeasCoherence"
_ENOUGH = 0.5  # of the plant's lines
# member -> input, output and unit; for other members the file does not state them
_QUANTITIES = {
    "m_pPlant": ("torque", "speed_motor", "(rad/s)/(N m)"),
    "m_CurrentControllerResponse": ("torque_setpoint", "torque", "1"),
}
# classes and members by which a part of the file counts as a controller, a filter or a model of the mechanics
_CONTROLLER = re.compile(r"regulator|controller|filter|rigid", re.IGNORECASE)
_GAINS = frozenset({"m_Kp", "m_Tn", "m_Kv"})


class _RefusedError(Exception):
    """The exception for XML constructs that are refused."""


@dataclass
class _Element:
    """An XML element with its attributes, text and child elements."""

    tag: str
    attributes: dict[str, str]
    parts: list[str] = field(default_factory=list[str])
    children: list[_Element] = field(default_factory=list["_Element"])

    @property
    def member(self) -> str:
        """The member name of the element in its parent; for a list item, its class."""
        return self.attributes.get("name", self.tag)

    def text(self) -> str:
        return "".join(self.parts)

    def member_named(self, name: str) -> _Element | None:
        return next((child for child in self.children if child.member == name), None)

    def scalars(self) -> dict[str, float | str]:
        """Return the numbers and strings that are direct children of the element."""
        scalars: dict[str, float | str] = {}
        for child in self.children:
            text = child.text().strip()
            if child.tag not in _SCALARS or not text:
                continue
            try:
                scalars[child.member] = text if child.tag == "string" else float(text)
            except ValueError:
                scalars[child.member] = text
        return scalars

    def walk(self, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], _Element]]:
        """Yield the element and all its descendants with their paths. The parser has already bounded the depth."""
        yield path, self
        counts: dict[str, int] = {}
        for child in self.children:
            k = counts[child.member] = counts.get(child.member, 0) + 1
            listed = "name" not in child.attributes
            yield from child.walk((*path, f"{child.member}[{k}]" if listed and path else child.member))


def is_xml(content: bytes) -> bool:
    """Return True for content that begins like XML."""
    return re.match(rb"(\xef\xbb\xbf)?\s*<(\?xml|[A-Za-z_])", content) is not None


def is_ast(content: bytes) -> bool:
    """Return True for XML that contains a frequency response of the tuning tool."""
    return is_xml(content) and f"<{_RESPONSE}".encode() in content


def _parsed(name: str, content: bytes) -> _Element:
    """Parse XML into an element tree. Raise LogError for malformed XML, entities or exceeded bounds."""
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has more than the {Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} of XML that are read; export less"
        )
    parser = expat.ParserCreate()
    # else expat hands over an array of numbers in pieces, one for each line
    parser.buffer_text = True
    root = _Element("", {})
    open_: list[_Element] = [root]
    count = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(open_) > _DEEPEST or count > _MOST_ELEMENTS:
            raise _RefusedError(f"more than {_DEEPEST} levels or {_MOST_ELEMENTS:,} elements")
        element = _Element(tag.rpartition(":")[2], attributes)
        open_[-1].children.append(element)
        open_.append(element)

    def end(_: str) -> None:
        open_.pop()

    def letters(text: str) -> None:
        open_[-1].parts.append(text)

    def refuse(*_: object) -> NoReturn:
        raise _RefusedError("a document type with entities, which could fill the memory or read other files")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, letters
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.UnparsedEntityDeclHandler = parser.ExternalEntityRefHandler = refuse
    try:
        parser.Parse(content, True)
    except _RefusedError as error:
        raise LogError(f"{name}: holds {error}; it is not read") from None
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise LogError(f"{name}: is damaged XML: {str(error)[:80]}; export it again") from None
    return root


def ast_tables(name: str, content: bytes) -> Iterator[tuple[Columns, dict[str, str]]]:
    """Yield, for each non-empty response, a table of f, re, im and coherence, and the names of its input and output.

    A response is named by its list, its position in the list, and its member: `speed_plant_1_plant`.  The coherence of
    a plant has its own frequency vector: lines of the plant without a coherence are left out; if these are more than
    half, the coherence is left out instead.
    """
    names: dict[str, int] = {}
    empty = 0
    for path, parent in _parsed(name, content).walk():
        responses = {child.member: child for child in parent.children if child.tag == _RESPONSE}
        coherence = _lines(name, responses.pop(_COHERENCE, None))
        for member, response in responses.items():
            lines = _lines(name, response)
            if lines is None:
                empty += 1
                continue
            label = free_name(_label((*path[1:], member)), names)
            if len(names) > _MOST_RESPONSES:
                raise LogError(f"{name}: holds more than {_MOST_RESPONSES} responses; export fewer")
            input_, output, unit = _QUANTITIES.get(member, ("input", label, "1"))
            frequency, values = lines
            columns = {"f": frequency, f"re_{label}": np.real(values), f"im_{label}": np.imag(values)}
            if member == "m_pPlant" and coherence is not None:
                here, there = _shared(frequency, coherence[0])
                if here.size >= _ENOUGH * frequency.size:
                    columns = {key: column[here] for key, column in columns.items()}
                    columns[f"coherence_{label}"] = np.real(coherence[1])[there]
            yield Columns("AST XML", columns, {"f": "Hz", f"re_{label}": unit}), {"input": input_, "output": output}
    if not names:
        held = f"; {empty} are there without numbers" if empty else ""
        raise LogError(f"{name}: is XML without a measured response of the tuning tool (<{_RESPONSE}>){held}")


def controllers(name: str, content: bytes) -> tuple[dict[str, dict[str, float | str]], dict[str, float | str]]:
    """Return controllers, filters and mechanical models by path, and separately all other numbers and strings.

    The numbers are unconverted; the file does not state units, which are presumably SI.
    """
    known: dict[str, dict[str, float | str]] = {}
    others: dict[str, float | str] = {}
    for path, element in _parsed(name, content).walk():
        if element.tag in (_RESPONSE, _ARRAY) or not path:
            continue
        scalars = element.scalars()
        below = path[1:]
        if scalars and below and (any(map(_CONTROLLER.search, (element.tag, element.member))) or _GAINS & set(scalars)):
            known[".".join(below)] = scalars
        else:
            others |= {".".join((*below, key)): value for key, value in scalars.items()}
    return known, others


def _label(path: tuple[str, ...]) -> str:
    """Shorten a path to a label: speed_plant_2_plant for m_SpeedPlantMeasurementList, ...Measurement[2], m_pPlant."""
    words: list[str] = []
    for part in path:
        bare, bracket, count = part.rstrip("]").partition("[")
        if bracket:
            words.append(count)
            continue
        bare = re.sub(r"^m_(p|list|sz|d|b)?(?=[A-Z])", "", bare)
        bare = re.sub(r"(Measurement)?(List)?$", "", bare)
        words.append(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", bare).lower())
    return re.sub(r"[^\w+-]+", "_", "_".join(words)).strip("_") or "response"


def _lines(name: str, response: _Element | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies in Hz and complex values of a response; None if it is missing or has no numbers."""
    if response is None:
        return None
    parts = [response.member_named(key) for key in ("m_FrequencyVector", "m_ValueVector")]
    if parts[0] is None or parts[1] is None:
        return None
    frequency, values = _numbers(name, parts[0]), _numbers(name, parts[1])
    if not frequency.size and not values.size:
        return None
    if values.size == 2 * frequency.size:
        values = values.view(np.complex128)
    if values.size != frequency.size:
        raise LogError(
            f"{name}: {response.member} has {values.size} values at {frequency.size} frequencies; export it again"
        )
    return frequency, values.astype(np.complex128)


def _shared(plant: np.ndarray, coherence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices, in the plant and in the coherence, of the frequency lines that both contain."""
    # frequencies of the same line may differ in their last digits
    places = np.minimum(np.searchsorted(coherence, plant * (1.0 - 1e-9)), coherence.size - 1)
    same = np.isclose(coherence[places], plant, rtol=1e-9, atol=0.0)
    return np.flatnonzero(same), places[same]


def _numbers(name: str, array: _Element) -> np.ndarray:
    """Return the numbers of an array; real and imaginary parts of complex numbers alternate."""
    raw = array.member_named("m_pNumberArray")
    holders = [array] if raw is None else [raw, array]
    text = re.sub(r"\s+", "", holders[0].text())
    if any(holder.attributes.get("format", "").upper() == "CSV" for holder in holders):
        try:
            return np.array([float(number) for number in re.split(r"[,;]", text) if number], dtype=np.float64)
        except ValueError:
            raise LogError(f"{name}: {array.member} is not a list of numbers with commas; export it again") from None
    try:
        words = _words(text)
        return np.frombuffer(words.astype(">u4").tobytes(), ">f8").astype(np.float64)
    except ValueError as error:
        raise LogError(
            f"{name}: {array.member} is not an array of doubles in base 85: {error}; export it again"
        ) from None


def _words(text: str) -> np.ndarray:
    """Decode base-85 text into 32-bit words. Raise ValueError with the reason for invalid text."""
    try:
        letters = np.frombuffer(text.encode("ascii"), np.uint8)
    except UnicodeEncodeError:
        raise ValueError("it has letters that are not ASCII") from None
    zero = letters == ord(_ZERO_WORD)
    # in characters of a word that is not zero: where each point stands must be between two words
    before = np.cumsum(~zero)
    if np.any(before[zero] % 5) or (before.size and before[-1] % 5):
        raise ValueError("a word has not five characters")
    digits = _DIGITS[letters & 127]
    if np.any(digits[~zero] == 255) or np.any(letters > 127):
        raise ValueError("it has characters beyond the 85")
    values = digits[~zero].reshape(-1, 5).astype(np.uint64) @ _PLACES
    if np.any(values >= 2**32):
        raise ValueError("a word is beyond 32 bits")
    # a word stands where its first character is, a zero word where its point is
    first = np.flatnonzero(~zero)[::5]
    places = np.concatenate([first, np.flatnonzero(zero)])
    words = np.concatenate([values, np.zeros(np.count_nonzero(zero), np.uint64)])
    return words[np.argsort(places, kind="stable")]
