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

Member names differ between versions of the tool: `controllers` returns every scalar with its path, and
`files/commissioning.py` interprets those that it recognizes.  Document type declarations and entities are refused
before they are read; depth, number of elements and file size are bounded.
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
# members whose quantities are known; for others the file does not state them
_PLANT, _CURRENT = "m_pPlant", "m_CurrentControllerResponse"
# lists in which a member of the plant's name is another response: of the axis behind the motor, or of a closed loop
_NO_PLANT = re.compile(r"MechanicalSystem|MechResponse|SpeedLoop|PositionLoop", re.IGNORECASE)
_ROTARY_MOTOR, _LINEAR_MOTOR = ("m_bMotorIsRotary",), ("m_bIsLinearMotor", "m_bMotorIsLinear")
# a list, and lists that hold the parts of a model and not measurements
_LIST, _GENERIC = re.compile(r"List\b|^m_list"), re.compile(r"DynModList|LinkedList|ControllerList")
# classes and members by which a part of the file counts as a controller, a filter or a model of the mechanics
_CONTROLLER = re.compile(r"regulator|controller|filter|rigid", re.IGNORECASE)
_GAINS = frozenset({"m_Kp", "m_Tn", "m_Kv"})


class _RefusedError(Exception):
    """The exception for XML constructs that are refused."""


@dataclass
class Element:
    """An XML element with its attributes, text and child elements."""

    tag: str
    attributes: dict[str, str]
    parts: list[str] = field(default_factory=list[str])
    children: list[Element] = field(default_factory=list["Element"])

    @property
    def member(self) -> str:
        """The member name of the element in its parent; for a list item, its class."""
        return self.attributes.get("name", self.tag)

    def text(self) -> str:
        """Return the text between the tags of the element."""
        return "".join(self.parts)

    def member_named(self, name: str) -> Element | None:
        """Return the first child with a member name; None if there is none."""
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

    def walk(self, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Element]]:
        """Yield the element and all its descendants with their paths. The parser has already bounded the depth."""
        yield path, self
        counts: dict[str, int] = {}
        members = [child.member for child in self.children]
        for child in self.children:
            k = counts[child.member] = counts.get(child.member, 0) + 1
            # some versions give every item of a list the same name
            listed = "name" not in child.attributes or members.count(child.member) > 1
            yield from child.walk((*path, f"{child.member}[{k}]" if listed and path else child.member))


def is_xml(content: bytes) -> bool:
    """Return True for content that begins like XML."""
    return re.match(rb"(\xef\xbb\xbf)?\s*<(\?xml|[A-Za-z_])", content) is not None


def is_ast(content: bytes) -> bool:
    """Return True for XML that contains a frequency response of the tuning tool."""
    return is_xml(content) and f"<{_RESPONSE}".encode() in content


def parsed(name: str, content: bytes) -> Element:
    """Parse XML into an element tree. Raise LogError for malformed XML, entities or exceeded bounds."""
    if len(content) > MOST_BYTES:
        raise LogError(
            f"{name}: has more than the {Quantity(MOST_BYTES / 1e6, 'MB'):,.0f} of XML that are read; export less"
        )
    parser = expat.ParserCreate()
    # else expat hands over an array of numbers in pieces, one for each line
    parser.buffer_text = True
    root = Element("", {})
    open_: list[Element] = [root]
    count = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(open_) > _DEEPEST or count > _MOST_ELEMENTS:
            raise _RefusedError(f"more than {_DEEPEST} levels or {_MOST_ELEMENTS:,} elements")
        element = Element(tag.rpartition(":")[2], attributes)
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


@dataclass(frozen=True)
class Response:
    """A response that has numbers, with the coherence measured for it, if there is one.

    label  short name: the innermost list, the index in this list and the member, as in `speed_plant_2_plant`
    path   path of the response in the file
    stamp  time of the measurement, as text
    """

    label: str
    path: tuple[str, ...]
    frequency: np.ndarray
    values: np.ndarray
    coherence: tuple[np.ndarray, np.ndarray] | None
    stamp: str

    @property
    def member(self) -> str:
        """The member name, which identifies input and output of the response."""
        return self.path[-1].partition("[")[0]

    @property
    def is_plant(self) -> bool:
        """True for a response of the motor's speed to its torque."""
        return self.member == _PLANT and not any(map(_NO_PLANT.search, self.path))

    @property
    def is_current_loop(self) -> bool:
        """True for a response of the torque to its setpoint."""
        return self.member == _CURRENT


def responses(name: str, root: Element) -> Iterator[Response]:
    """Yield each response that has numbers. Raise LogError for damaged numbers, and if there is no such response."""
    names: dict[str, int] = {}
    empty = 0
    for path, parent in root.walk():
        found = {child.member: child for child in parent.children if child.tag == _RESPONSE}
        coherence = _lines(name, found.pop(_COHERENCE, None))
        for member, response in found.items():
            lines = _lines(name, response)
            if lines is None:
                empty += 1
                continue
            label = free_name(_label((*path[1:], member)), names)
            if len(names) > _MOST_RESPONSES:
                raise LogError(f"{name}: holds more than {_MOST_RESPONSES} responses; export fewer")
            other = coherence if member == _PLANT and coherence is not None else None
            real = None if other is None else (other[0], np.real(other[1]))
            yield Response(label, (*path[1:], member), *lines, real, stamp(parent))
    if not names:
        held = f"; {empty} are there without numbers" if empty else ""
        raise LogError(f"{name}: is XML without a measured response of the tuning tool (<{_RESPONSE}>){held}")


def ast_tables(name: str, content: bytes) -> Iterator[tuple[Columns, dict[str, str]]]:
    """Yield, for each non-empty response, a table of f, re, im and coherence, and the names of its input and output.

    The coherence of a plant has its own frequency vector: lines of the plant without a coherence are left out; if these
    are more than half, the coherence is left out instead.
    """
    root = parsed(name, content)
    unit = "(m/s)/N" if linear_motor(root) else "(rad/s)/(N m)"
    for response in responses(name, root):
        label, frequency, values = response.label, response.frequency, response.values
        quantities = {"input": "input", "output": label}
        if response.is_plant:
            quantities = {"input": "torque", "output": "speed_motor"}
        elif response.is_current_loop:
            quantities = {"input": "torque_setpoint", "output": "torque"}
        columns = {"f": frequency, f"re_{label}": np.real(values), f"im_{label}": np.imag(values)}
        if response.coherence is not None:
            here, there = _shared(frequency, response.coherence[0])
            if here.size >= _ENOUGH * frequency.size:
                columns = {key: column[here] for key, column in columns.items()}
                columns[f"coherence_{label}"] = response.coherence[1][there]
        units = {"f": "Hz", f"re_{label}": unit if response.is_plant else "1"}
        yield Columns("AST XML", columns, units), quantities


def linear_motor(root: Element) -> bool:
    """Return True if the file describes a linear motor; the plant response is then in (m/s)/N."""
    for _, element in root.walk():
        for member, value in element.scalars().items():
            if member in _ROTARY_MOTOR or member in _LINEAR_MOTOR:
                return true(value) == (member in _LINEAR_MOTOR)
    return False


def true(value: float | str) -> bool:
    """Return the value of a boolean, which is written as true or as 1, depending on the version of the tool."""
    return value == 1.0 or str(value).strip().lower() == "true"


def stamp(parent: Element) -> str:
    """Return the time of a measurement as text, from a string or from a date and a time of day; empty if unknown."""
    for child in parent.children:
        if "timestamp" not in child.member.lower():
            continue
        parts = child.scalars()
        if isinstance(parts.get("Date"), float) and isinstance(parts.get("Time"), float):
            date, time = f"{parts['Date']:08.0f}", f"{parts['Time']:06.0f}"
            return f"{date[:4]}-{date[4:6]}-{date[6:]} {time[:2]}:{time[2:4]}:{time[4:]}"
        if child.text().strip():
            return child.text().strip()
    return ""


def controllers(name: str, content: bytes) -> tuple[dict[str, dict[str, float | str]], dict[str, float | str]]:
    """Return controllers, filters and mechanical models by path, and separately all other numbers and strings.

    The numbers are unconverted; the file does not state units, which are presumably SI.
    """
    known: dict[str, dict[str, float | str]] = {}
    others: dict[str, float | str] = {}
    for path, element in parsed(name, content).walk():
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
    *parents, member = path
    lists = [i for i, part in enumerate(parents) if _LIST.search(part) and not _GENERIC.search(part)]
    # some versions name the items after their list
    lists = [i for i in lists if i == 0 or not parents[i].startswith(_bracketless(parents[i - 1]))]
    words: list[str] = []
    if lists:
        item = parents[lists[-1] + 1] if lists[-1] + 1 < len(parents) else ""
        words = [_words_of(parents[lists[-1]]), item.rstrip("]").partition("[")[2]]
    label = "_".join(filter(None, [*words, _words_of(member)]))
    return re.sub(r"[^\w+-]+", "_", label).strip("_") or "response"


def _bracketless(part: str) -> str:
    return part.partition("[")[0]


def _words_of(member: str) -> str:
    """Return a member name in lower case with underscores: speed_plant for m_SpeedPlantMeasurementList."""
    bare = re.sub(r"^m_(p|list|sz|d|b)?(?=[A-Z])", "", _bracketless(member))
    bare = re.sub(r"(Measurement)?(List)?$", "", bare)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", bare).lower()


def _lines(name: str, response: Element | None) -> tuple[np.ndarray, np.ndarray] | None:
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


def _numbers(name: str, array: Element) -> np.ndarray:
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
        words = _decoded(text)
        return np.frombuffer(words.astype(">u4").tobytes(), ">f8").astype(np.float64)
    except ValueError as error:
        raise LogError(
            f"{name}: {array.member} is not an array of doubles in base 85: {error}; export it again"
        ) from None


def _decoded(text: str) -> np.ndarray:
    """Decode base-85 text into 32-bit words. Raise ValueError with the reason for invalid text."""
    try:
        letters = np.frombuffer(text.encode("ascii"), np.uint8)
    except UnicodeEncodeError:
        raise ValueError("it has letters that are not ASCII") from None
    zero = letters == ord(_ZERO_WORD)
    # counted in the characters of nonzero words: each point must lie between two words
    before = np.cumsum(~zero)
    if np.any(before[zero] % 5) or (before.size and before[-1] % 5):
        raise ValueError("a word has not five characters")
    digits = _DIGITS[letters & 127]
    if np.any(digits[~zero] == 255) or np.any(letters > 127):
        raise ValueError("it has characters beyond the 85")
    values = digits[~zero].reshape(-1, 5).astype(np.uint64) @ _PLACES
    if np.any(values >= 2**32):
        raise ValueError("a word is beyond 32 bits")
    # the position of a word is that of its first character, that of a zero word the position of its point
    first = np.flatnonzero(~zero)[::5]
    places = np.concatenate([first, np.flatnonzero(zero)])
    words = np.concatenate([values, np.zeros(np.count_nonzero(zero), np.uint64)])
    return words[np.argsort(places, kind="stable")]
