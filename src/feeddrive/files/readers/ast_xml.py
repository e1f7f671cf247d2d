"""Measurements of the tuning tool of SINUMERIK drives (AST), as XML with arrays in base85.

UNPROVEN: no file of a real machine was at hand.  The reader was written against a file of our own, which has what the
tool is known to keep: complex frequency responses and their coherence as arrays in base85, and sets of controller
parameters.  It goes by what an element holds, not by one fixed tree:

    <Measurement name="speed plant" input="torque" output="speed" unit="rad/N m/s">
      <Frequency unit="Hz" type="float64" byteOrder="little">base85 ...</Frequency>
      <Response type="complex128">base85 ...</Response>
      <Coherence type="float64">base85 ...</Coherence>
    </Measurement>
    <ControllerSet name="speed loop"><Parameter name="Kp" unit="N m s/rad">12.5</Parameter></ControllerSet>

Document types and entities are refused before they are read; depth, elements and bytes are bounded.
"""

from __future__ import annotations

import base64
import binascii
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from feeddrive.files.columns import Columns, free_name
from feeddrive.language.errors import LogError

MOST_BYTES = 100_000_000
_DEEPEST = 50
_MOST_ELEMENTS = 200_000
_MOST_RESPONSES = 1000
_TYPES = {"float32": "f4", "float64": "f8", "double": "f8", "float": "f4", "complex64": "c8", "complex128": "c16",
          "complex": "c16"}  # fmt: skip
_KINDS = {
    "f": ("frequency", "frequencies", "freq", "f"), "response": ("response", "frf", "data", "value", "values"),
    "coherence": ("coherence", "coh"),
}  # fmt: skip


class _RefusedError(Exception):
    """The text contains constructs that are refused."""


@dataclass
class _Element:
    """An element with its attributes and its text."""

    tag: str
    attributes: dict[str, str]
    parts: list[str] = field(default_factory=list[str])
    children: list[_Element] = field(default_factory=list["_Element"])

    def text(self) -> str:
        return "".join(self.parts)

    def walk(self) -> Iterator[_Element]:
        """The element itself and all in it; depth is bounded when it is read."""
        yield self
        for child in self.children:
            yield from child.walk()


def is_xml(content: bytes) -> bool:
    """True for a text that begins as XML does."""
    return re.match(rb"(\xef\xbb\xbf)?\s*<(\?xml|[A-Za-z_])", content) is not None


def _parsed(name: str, content: bytes) -> _Element:
    """The tree of a text, without entities. Raises LogError for anything else."""
    if len(content) > MOST_BYTES:
        raise LogError(f"{name}: has more than the {MOST_BYTES / 1e6:,.0f} MB of XML that are read; export less")
    parser = expat.ParserCreate()
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
    """A table of f, re, im, coherence for each response in the file, and its input and output."""
    names: dict[str, int] = {}
    for element in _parsed(name, content).walk():
        parts = {kind: each for each in element.children if (kind := _kind(each.tag)) is not None}
        if not {"f", "response"} <= set(parts):
            continue
        label = re.sub(r"[^\w+-]+", "_", element.attributes.get("name", "")).strip("_") or "frf"
        label = free_name(label, names)
        if len(names) > _MOST_RESPONSES:
            raise LogError(f"{name}: holds more than {_MOST_RESPONSES} responses; export fewer")
        frequency = np.real(_array(name, parts["f"]))
        response = _array(name, parts["response"])
        values = {"f": frequency, f"re_{label}": np.real(response), f"im_{label}": np.imag(response)}
        if "coherence" in parts:
            values[f"coherence_{label}"] = np.real(_array(name, parts["coherence"]))
        sizes = {key: column.size for key, column in values.items()}
        if len(set(sizes.values())) > 1:
            raise LogError(f"{name}: the arrays of '{label}' have different lengths, {sizes}; export it again")
        units = {"f": parts["f"].attributes.get("unit", "Hz")}
        if element.attributes.get("unit"):
            units[f"re_{label}"] = element.attributes["unit"]
        stated = {key: element.attributes[key] for key in ("input", "output") if key in element.attributes}
        yield Columns("AST XML", values, units), stated
    if not names:
        raise LogError(f"{name}: is XML without a frequency response (an element with Frequency and Response)")


def controller_sets(name: str, content: bytes) -> dict[str, dict[str, tuple[float, str]]]:
    """Controller parameters by set and name, each with its unit as the file has it."""
    found: dict[str, dict[str, tuple[float, str]]] = {}
    for element in _parsed(name, content).walk():
        if element.tag.lower() not in ("controllerset", "controller"):
            continue
        chosen = found.setdefault(element.attributes.get("name", f"set {len(found) + 1}"), {})
        for each in element.children:
            try:
                number = float(each.text() or each.attributes.get("value", ""))
            except ValueError:
                continue
            if np.isfinite(number):
                chosen[each.attributes.get("name", each.tag)] = (number, each.attributes.get("unit", ""))
    return found


def _kind(tag: str) -> str | None:
    return next((kind for kind, tags in _KINDS.items() if tag.lower() in tags), None)


def _array(name: str, element: _Element) -> np.ndarray:
    """The numbers of an element, complex: base85 of floats, or pairs of them."""
    stated = element.attributes.get("type", "complex128" if _kind(element.tag) == "response" else "float64").lower()
    order = ">" if element.attributes.get("byteOrder", "little").lower().startswith("b") else "<"
    text = re.sub(r"\s+", "", element.text()).encode("ascii", "replace")
    try:
        packed = base64.b85decode(text) if element.attributes.get("encoding", "base85") != "ascii85" else (
            base64.a85decode(text, adobe=text.startswith(b"<~")))  # fmt: skip
        dtype = np.dtype(order + _TYPES[stated])
        return np.frombuffer(packed, dtype).astype(np.complex128)
    except (ValueError, KeyError, binascii.Error, struct.error):
        raise LogError(
            f"{name}: the element {element.tag[:40]} is not an array of {stated[:20]} in base85; export it again"
        ) from None
