"""A routine as a single header: the same functions, static and inline."""

from __future__ import annotations

import re

from feeddrive.export.c.text import Texts

_SHARED = re.compile(r"\b(designed|decays|exact_\w+|power_of_twof?|exponentf?|uniform)(?=\()")


def header_only(P: str, made: Texts) -> str:
    """Declarations and bodies in one file, to be included where the step is called."""
    close = f"#ifdef __cplusplus\n}}\n#endif\n\n#endif /* {P.upper()}_H */\n"
    header = made.header.removesuffix(close)
    assert header != made.header, "the header ends otherwise than expected"
    header = header.replace("#include <stdbool.h>", "#include <float.h>\n#include <math.h>\n#include <stdbool.h>", 1)
    header = header.replace("#include <stdint.h>", "#include <stdint.h>\n#include <string.h>", 1)
    header = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", header, flags=re.MULTILINE)
    bodies, seen = [], set[str]()
    for text in (made.configure, made.source):
        for piece in _pieces(text, P):
            if piece not in seen:
                bodies.append(piece)
                seen.add(piece)
    return header + _own(P, "\n".join(bodies)) + "\n" + close


def _own(P: str, text: str) -> str:
    """Names of functions and tables that another axis in the same program would have too, made this one's own."""
    text = _SHARED.sub(lambda found: f"{P}_{found[0]}", text)
    return re.sub(r"\bTABLE_", f"{P.upper()}_TABLE_", text)


def _pieces(text: str, P: str) -> list[str]:
    """The comment on top, and each function with its comment; without includes."""
    lines = [line for line in text.splitlines() if not line.startswith("#include")]
    body = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", "\n".join(lines), flags=re.MULTILINE)
    top, rest = body.split("*/\n", 1)
    pieces = [f"{top}*/", *re.split(r"(?<=^\})\n+", rest, flags=re.MULTILINE)]
    return [piece.strip("\n") + "\n" for piece in pieces if piece.strip()]
