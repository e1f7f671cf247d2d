"""What every .comp file has: declarations with units and meanings, one a line, and the C text behind them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from feeddrive.artefacts.export.c.text import Texts
from feeddrive.artefacts.export.linuxcnc.names import Item, plain

# LinuxCNC's flags do not forbid a fused multiply-add, which processors other than x86 would take.
_EXACT = '#pragma GCC optimize("fp-contract=off")'


def core(name: str, parts: Texts) -> str:
    """Header, step and configure in one text, which a component includes; they share the names of the header only."""
    first = _own(parts.source)
    own = [each for each in _own(parts.configure) if each in first]
    apart = [f"#define {each} configure_{each}" for each in own]
    back = [f"#undef {each}" for each in own]
    text = "\n".join([_EXACT, "", parts.header, parts.source, *apart, parts.configure, *back, ""])
    return re.sub(rf'#include "{name}\.h"\n+', "", text)


def _own(text: str) -> list[str]:
    """Names of the static functions of a C text."""
    return re.findall(r"^static (?:inline )?\w+ (\w+)\(", text, re.MULTILINE)


def component(
    name: str,
    description: str,
    pins: Iterable[Item],
    parameters: Mapping[Item, float],
    functions: Sequence[str],
    body: str,
) -> str:
    """The text of a .comp file that includes `name`.h, for `halcompile --install`."""
    lines = [f'component {name} "{plain(description)}";', ""]
    lines += [f'pin {each.direction} {_TYPES[each.type]} {each.name} "{each.meaning}";' for each in pins]
    lines.append("")
    lines += [
        f'param rw {_TYPES[each.type]} {each.name} = {_number(each, value)} "{each.meaning}";'
        for each, value in parameters.items()
    ]
    lines.append("")
    lines += [f"function {each} fp;" for each in functions]
    lines += ["option singleton yes;", f'include "{name}.h";', 'license "MIT";', 'author "feeddrive";', "", ";;"]
    return "\n".join(lines) + f"\n{body}"


_TYPES = {"float": "float", "bit": "bit", "s32": "signed", "u32": "unsigned"}


def _number(item: Item, value: float) -> str:
    """A default as halcompile reads it: it knows no sign of an exponent's plus."""
    return repr(float(value)).replace("e+", "e") if item.type == "float" else str(int(value))


def numbers(texts: Iterable[str]) -> str:
    """A C initialiser, broken into lines."""
    line, lines = "", []
    for text in texts:
        if len(line) + len(text) > 100:
            lines.append(line)
            line = ""
        line += f"{text}, "
    return ("\n        ".join([*lines, line])).rstrip(", ")


def where(wanted: bool, text: str) -> str:
    """The text, or nothing."""
    return text if wanted else ""
