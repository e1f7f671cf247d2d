"""What every .comp file has: declarations with units and meanings, one a line, and the C text behind them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from feeddrive.export.c.header_only import header_only
from feeddrive.export.c.text import Texts
from feeddrive.export.linuxcnc.names import Item, plain

# LinuxCNC's flags do not forbid a fused multiply-add, which processors other than x86 would take.
_EXACT = '#pragma GCC optimize("fp-contract=off")\n\n'
_AS_IT_STANDS = """\
#pragma GCC push_options
#pragma GCC optimize("O0")
#pragma GCC diagnostic ignored "-Wframe-larger-than="
"""


def core(name: str, parts: Texts) -> str:
    """The header that a component includes: all of a routine.

    What runs once or at a change of parameters may be thousands of lines: it is compiled as it stands, in a tenth of
    the time.
    """
    once = re.compile(
        rf"^static (?:inline bool {name}_retune|int {name}_designed)\([^;{{]*\)\n\{{.*?^\}}\n", re.DOTALL | re.MULTILINE
    )
    whole = header_only(name, parts)
    return _EXACT + once.sub(lambda found: f"{_AS_IT_STANDS}{found[0]}#pragma GCC pop_options\n", whole)


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
    lines = [""]
    for text in texts:
        if len(lines[-1]) + len(text) > 90:
            lines.append("")
        lines[-1] += f" {text},"
    return "\n        ".join(line.strip() for line in lines).rstrip(",")


def where(wanted: bool, text: str) -> str:
    """The text, or nothing."""
    return text if wanted else ""
