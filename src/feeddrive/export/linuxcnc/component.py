"""HAL names, and the parts common to all .comp files: declarations, one a line, and the C text behind them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from feeddrive.export.c.header_only import header_only
from feeddrive.export.c.text import Texts
from feeddrive.export.identifiers import HAL_LENGTH
from feeddrive.export.linuxcnc.texts import text
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.routine import Routine, Variable

# Components of LinuxCNC 2.9: one of the same name would take their place on the user's machine, or not load.
STOCK = frozenset(text("stock.txt").split())
FASTEST, SLOWEST = 10_000, 100_000_000  # ns; what a PC keeps up with at best, and slower than any servo loop
MEASURED = ("time", "tmax", "tmax-increased")  # pins that HAL adds to every function


class Item(NamedTuple):
    """A pin or a parameter: what the .comp file declares."""

    name: str
    type: str  # "float", "bit", "s32" or "u32"
    direction: str  # "in", "out" or "rw"
    meaning: str  # plain ASCII, with the unit

    @property
    def c(self) -> str:
        """The name by which halcompile lets C text read and write it."""
        return re.sub("_+", "_", re.sub("[-.]", "_", self.name))


def pin(name: str, kind: str, direction: str, meaning: str) -> Item:
    """A pin."""
    return Item(name, kind, direction, plain(meaning))


def parameter(variable: Variable) -> Item:
    """The HAL parameter of a routine's parameter: `axis.x.control.law.Kv` is `law.Kv` of the component `axis-x`."""
    name = re.sub(r"^axis\.[^.]+\.(control\.|actuator\.(?=motor\.))?", "", variable.path).replace("_", "-")
    return Item(name, "float", "rw", plain(f"{variable.meaning}, {variable.unit or 'no unit'}"))


def hal(name: str) -> str:
    """`axis_x` is written `axis-x` in HAL."""
    return name.replace("_", "-")


def check_component(name: str, functions: Sequence[str], items: Iterable[Item]) -> None:
    """Raise ParameterError for a name that is LinuxCNC's own or too long, StructureError for two that are the same."""
    if name in STOCK:
        raise ParameterError(
            f"the name '{name}' is that of a component of LinuxCNC, which the installed one would replace; "
            f"take another, such as axis_{name}"
        )
    seen: dict[str, str] = {}
    measured = [".".join((*filter(None, (each,)), last)) for each in functions for last in MEASURED]
    for each in (*(item.name for item in items), *measured):
        whole = f"{hal(name)}.{each}"
        if len(whole) > HAL_LENGTH:
            raise ParameterError(
                f"'{whole}' has {len(whole)} characters, {len(whole) - HAL_LENGTH} more than the {HAL_LENGTH} of a "
                f"name in LinuxCNC's HAL; take a shorter name than '{name}'"
            )
        key = re.sub("[-._]+", "_", each)
        if key in seen:
            raise StructureError(f"'{hal(name)}.{seen[key]}' and '{whole}' are one name in LinuxCNC's HAL")
        seen[key] = each


def plain(words: str) -> str:
    """Text that halcompile and its manual pages take: ASCII, without quotes and backslashes."""
    words = words.replace("²", "2").replace("³", "3").replace("µ", "u").replace("·", " ").replace("−", "-")
    words = words.replace('"', "'").replace("\\", "/").replace("\n", " ")
    return words.encode("ascii", "replace").decode()


def period(routine: Routine) -> int:
    """The sample time in ns. Raises ParameterError for one that no servo thread of LinuxCNC can have."""
    exact = routine.sample_time * 1e9
    whole = round(exact)
    if abs(exact - whole) > 1e-3:
        raise ParameterError(
            f"sample_time = {routine.sample_time:.12g} s is no whole number of nanoseconds, in which LinuxCNC gives "
            f"the period of a thread; the nearest one is {max(whole, FASTEST) * 1e-9:.9g} s"
        )
    if not FASTEST <= whole <= SLOWEST:
        raise ParameterError(
            f"sample_time = {routine.sample_time:.9g} s: a servo thread of LinuxCNC has a period from "
            f"{FASTEST * 1e-6:g} ms to {SLOWEST * 1e-6:g} ms; take a sample time in between"
        )
    return whole


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


def component_text(
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
    for each in texts:
        if len(lines[-1]) + len(each) > 90:
            lines.append("")
        lines[-1] += f" {each},"
    return "\n        ".join(line.strip() for line in lines).rstrip(",")


def where(wanted: bool, text: str) -> str:
    """The text, or nothing."""
    return text if wanted else ""
