"""Reading and writing of measured frequency responses; the role of each column is derived from its name.

    f_Hz, re, im [, coherence] [, variance]        one response
    f_Hz, re_Gm, im_Gm, re_Gl, im_Gl               several, named by the rest of the header
    f_Hz, magnitude_dB, phase_deg [, coherence]    magnitude in dB or as a plain ratio, phase in deg or rad

A unit may be given in brackets or as a suffix of the name; the unit of a response is output over input
(`re_rad_per_A`).
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TypeAlias

import numpy as np

from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.files.columns import MOST_BYTES, Columns, is_time, unit_of
from feeddrive.files.origins import digest_of
from feeddrive.files.read_log import OpenedFile, refuse_others
from feeddrive.files.readers import ast_xml, uff
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError, nearest, plain
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF

_KINDS = {
    "re": ("real", "re", "r"),
    "im": ("imaginary", "imaginär", "imag", "im", "i"),
    "magnitude": ("magnitude", "mag", "amplitude", "amp", "gain", "abs", "betrag"),
    "phase": ("phase", "phi", "angle", "arg", "pha", "phasenwinkel", "winkel"),
    "coherence": ("coherence", "coh", "gamma2", "kohärenz", "kohaerenz"),
    "variance": ("variance", "var", "varianz"),
}
_FREQUENCY = re.compile(r"(f|fr|freq|frequency|frequenz|omega|w)", re.IGNORECASE)
_PLAIN = ("", "1", "-")
# words of a unit that are not SI, and their meaning
_SI = {"deg": "rad", "rev": "rad", "t": "kg", "g": "kg", "in": "m", "min": "s", "h": "s"}


@dataclass
class Response:
    """The columns of one response, and the unit of its numbers as stated in the file."""

    name: str
    places: dict[str, str] = field(default_factory=dict[str, str])
    unit: str = ""
    stated: str = ""
    factor: float = 1.0
    decibel: bool = False
    degrees: bool | None = None


@dataclass(frozen=True)
class Named:
    """The components of a column name."""

    kind: str
    name: str
    unit: str
    decibel: bool
    degrees: bool | None


def named(column: str, unit: str) -> Named | None:
    """Parse a column name into kind, response name and unit; None if it does not belong to a response.

    `Re_Pv1`, `ReGm_rad_per_A`, `Gm.real`, `mag(dB)`, `phase_deg`, `coherence_y`
    """
    rest, decibel, degrees = column.strip(), False, None
    if unit.lower() == "db" or re.search(r"[\s_.(\[]dB[)\]]?$|^dB$", rest):
        rest, unit, decibel = re.sub(r"[\s_.]*[(\[]?dB[)\]]?$", "", rest) or "magnitude", "", True
    if not unit:
        for start in [k + 1 for k, letter in enumerate(rest) if letter in "_ "]:
            known = unit_of(rest[start:])
            # A single word is a name rather than a unit: re_m and re_l are motor and load.
            if known and ("per" in known or known in ("deg", "rad")):
                rest, unit = rest[: start - 1], known
                break
    kind, name = _kind(rest)
    if kind is None:
        return None
    if kind == "phase":
        degrees, unit = {"deg": True, "rad": False}.get(unit), ""
    return Named(kind, name, "" if unit in _PLAIN else unit, decibel, degrees)


def _kind(rest: str) -> tuple[str | None, str]:
    """Split a name into the kind at its start or end (None if there is none) and the rest of the name."""
    for kind, words in _KINDS.items():
        for word in words:
            if rest.lower() == word or rest == f"|{word}|":
                return kind, ""
            bars = re.fullmatch(r"\|([^|]+)\|", rest)
            if kind == "magnitude" and bars is not None:  # |G|
                return kind, bars[1]
            short = len(word) < 3
            start = re.match(rf"(?i:{word})(?=[\s_.\-\[(]|$)", rest) or (
                # A capital ends the word, as in ReGm; for one letter this would split ordinary names such as iPhase.
                None if len(word) == 1 else re.match(rf"{word.capitalize()}(?=[A-Z])|{word}(?=[A-Z])", rest)
            )
            if start is not None:
                return kind, rest[start.end() :].strip(" _.-[]()")
            end = re.search(rf"(?<=[\s_.\-])(?i:{word})$", rest)
            if end is not None and not (short and len(word) == 1 and "_" not in rest):
                return kind, rest[: end.start()].strip(" _.-")
    return None, rest


def frequency_of(name: str, columns: Columns) -> tuple[str, np.ndarray]:
    """Return the name of the frequency column and its values in Hz. Raise LogError unless there is exactly one."""
    candidates: list[tuple[str, str]] = []
    for column in columns.values:
        unit = columns.units.get(column, "")
        word = column
        for start in [k + 1 for k, letter in enumerate(column) if letter == "_" and not unit]:
            unit = unit_of(column[start:]) or ""
            if unit:
                word = column[: start - 1]
                break
        if _FREQUENCY.fullmatch(word.strip()) or _is_frequency(unit):
            candidates.append((column, unit))
    if len(candidates) != 1:
        there = ", ".join(f"'{column[:40]}'" for column in [*columns.values][:12])
        what = "no column of frequency" if not candidates else f"{len(candidates)} columns of frequency"
        raise LogError(
            f"{name}: has {what} among {there}; name the columns of a file without heads, as in  "
            "columns = ['f_Hz', 're', 'im', 'coherence']  or  ['f_Hz', 'magnitude_dB', 'phase_deg']"
        )
    column, unit = candidates[0]
    if not unit:
        # By convention omega is an angular frequency.
        unit = "rad/s" if column.strip().lower() in ("omega", "w") else "Hz"
    try:
        return column, columns.values[column] * units.factor(unit, "Hz")
    except ParameterError:
        raise LogError(
            f"{name}: the frequency '{column}' is in '{unit}', which is no unit of it; Hz or rad/s"
        ) from None


def _is_frequency(unit: str) -> bool:
    try:
        units.factor(unit, "Hz")
    except ParameterError:
        return False
    return True


def responses_of(name: str, columns: Columns, frequency: str) -> list[Response]:
    """Group the columns into responses. Raise LogError for a response with missing columns."""
    responses: dict[str, Response] = {}
    for column in columns.values:
        if column == frequency:
            continue
        taken = named(column, columns.units.get(column, ""))
        if taken is None:
            continue
        response = responses.setdefault(taken.name, Response(taken.name))
        if taken.kind in response.places:
            both = f"'{response.places[taken.kind]}' and '{column}'"
            raise LogError(f"{name}: {both} are both the {taken.kind} of one response; name the columns")
        response.places[taken.kind] = column
        if taken.kind == "im" and taken.unit and response.stated not in ("", taken.unit):
            raise LogError(f"{name}: '{column}' is in '{taken.unit}', its real part in '{response.stated}'")
        if taken.kind in ("re", "magnitude"):
            # The unit of a response is that of its magnitude or real part; a phase has none, and an imaginary part must
            # agree.
            response.decibel = taken.decibel
            response.stated = taken.unit
            response.unit, response.factor = in_si(name, column, taken.unit)
        if taken.kind == "phase":
            response.degrees = taken.degrees
    _share(responses)
    whole = [
        response
        for response in responses.values()
        if {"re", "im"} <= set(response.places) or "magnitude" in response.places
    ]
    if not whole:
        raise LogError(
            f"{name}: no column is the real and imaginary part, or the magnitude, of a response"
            f"{nearest('re', columns.values)}; name them, as in  columns = ['f_Hz', 're', 'im', 'coherence']"
        )
    for complete in whole:
        if not {"re", "im"} <= set(complete.places) and "phase" not in complete.places:
            raise LogError(
                f"{name}: '{complete.places['magnitude']}' is a magnitude without a phase; margins need both: export "
                "the phase too, or real and imaginary part"
            )
    return whole


def in_si(name: str, column: str, unit: str) -> tuple[str, float]:
    """Return the SI unit and the conversion factor: m/N and 1e-6 for um/N. Raise LogError for an unknown unit."""
    if not unit:
        return "", 1.0
    try:
        known = units.response(unit)
    except ParameterError:
        known = None
    if known is not None:
        return known
    words: list[str] = []
    for word in re.split(r"([ _/]|per)", unit):
        base = re.fullmatch(r"[GMkcmun]?(m|s|A|rad|N|W|J|V|Hz)(\d?)", word)
        if word == "rpm" or word == "percent":
            raise LogError(f"{name}: column '{column}' is in '{unit}'; give the response in SI, as m/N or rad/A")
        # Prefixes are dropped and words replaced by SI units; the factor then follows from the two units as a whole.
        words.append(base[1] + base[2] if base else _SI.get(word, word))
    plain = re.sub(r"[ _]*(per|/)[ _]*", "/", "".join(words)).replace("_", " ")
    try:
        return plain, units.factor(unit, plain)
    except ParameterError as error:
        raise LogError(f"{name}: column '{column}': {error}; give the response in SI, as m/N or rad/A") from None


def _share(responses: dict[str, Response]) -> None:
    """Assign a coherence or variance column whose name contains no response name to the only response."""
    nameless = responses.get("")
    others: Iterable[Response] = [
        response for key, response in responses.items() if key and "coherence" not in response.places
    ]
    if nameless is not None and not {"re", "magnitude"} & set(nameless.places):
        holders = [response for response in others if {"re", "magnitude"} & set(response.places)]
        if len(holders) == 1:
            holders[0].places = {**nameless.places, **holders[0].places}
            del responses[""]


_LARGEST = 1e30  # of a response: its powers must not overflow
_READABLE = "CSV, UFF 58, AST XML, also packed by gzip"


FrfLike: TypeAlias = str | Path | FRF
"""A file of frequency responses, or an `FRF`."""


def read_frf(
    path: FrfLike,
    name: str | None = None,
    *,
    columns: Sequence[str] | None = None,
    input: str | None = None,  # noqa: A002  the name that the field has
    output: str | None = None,
    unit: str | None = None,
) -> FRF:
    """Read the frequency response in a file, or the one called `name` if there are several.

    columns        names for the columns of a file without headers, or to replace its headers:
                   ["f_Hz", "re", "im", "coherence"], ["f_Hz", "magnitude_dB", "phase_deg"]
    input, output  names of its input and output; default: as in the file
    unit           output over input in SI units, such as m/N, if the file does not state it; a stated unit is converted
                   to SI

    Raises FileError (no such file, ...) or LogError (unsupported format, damaged, NaN, frequencies that are negative or
    not increasing, a coherence above 1, a magnitude without phase), each with file, line and remedy.
    """
    responses = read_frfs(path, columns=columns)
    if name is None and len(responses) > 1:
        raise ParameterError(
            f"{path}: holds {len(responses)} responses: {', '.join(responses)}; name the one that is meant"
        )
    if name is not None and name not in responses:
        raise ParameterError(f"{path}: there is no response '{name}'{nearest(name, responses)}")
    frf = responses[name] if name is not None else next(iter(responses.values()))
    return replace(
        frf,
        input=frf.input if input is None else input,
        output=frf.output if output is None else output,
        unit=frf.unit if unit is None else unit,
    )


def read_frfs(path: FrfLike | OpenedFile, *, columns: Sequence[str] | None = None) -> dict[str, FRF]:
    """Read all frequency responses in a file, and return them by name.

    An FRF is also accepted in place of a path; it is returned under the name of its output.
    """
    if isinstance(path, FRF):
        return {path.output: path}
    try:
        return _read_frfs(path, columns)
    except (LogError, ParameterError) as error:
        raise type(error)(plain(f"{error}")) from None
    except MemoryError:
        raise LogError(f"{path}: does not fit into the memory") from None


def read_controllers(path: str | Path | OpenedFile) -> dict[str, dict[str, float | str]]:
    """Read controllers, filters and mechanical models from the XML of a SINUMERIK tuning tool (AST).

    The result maps the path of each controller in the file to its members, such as m_Kp, m_Tn, m_Kv, which are numbers
    or strings.  The path "" collects all other numbers and strings, so that members renamed in another version of the
    tool are still available.  Raises FileError or LogError (damaged, or unsupported format).
    """
    file = _opened(path)
    if not ast_xml.is_xml(file.unpacked):
        raise LogError(f"{path}: is not the XML of a tuning tool; controllers can be read only from such a file")
    known, others = ast_xml.controllers(str(file), file.unpacked)
    return {**known, **({"": others} if others else {})}


def names_frequency(path: str | Path | OpenedFile) -> bool:
    """Return True for a file of frequency responses, even one with invalid lines; such a file is not a log.

    It has a frequency column and no time column, or it is the XML of a tuning tool.
    """
    where, file = str(path), _opened(path)
    try:
        if ast_xml.is_ast(file.unpacked):
            return True
        tables = list(_tables(file, None))
        for table, _ in tables:
            frequency_of(where, table)
        return bool(tables) and not any(is_time(name) for table, _ in tables for name in table.values)
    except (LogError, ParameterError, MemoryError):
        # Whatever is wrong with the file is reported when it is read as a log.
        return False


def _opened(path: str | Path | OpenedFile) -> OpenedFile:
    return path if isinstance(path, OpenedFile) else OpenedFile(path)


def _read_frfs(path: str | Path | OpenedFile, columns: Sequence[str] | None) -> dict[str, FRF]:
    where = str(path)
    responses: dict[str, FRF] = {}
    for table, stated in _tables(_opened(path), columns):
        responses |= _responses(where, table, stated)
    return responses


def _tables(file: OpenedFile, columns: Sequence[str] | None) -> Iterable[tuple[Columns, Mapping[str, str]]]:
    """Return a table for each frequency vector in the file, with the metadata stated for it in the file."""
    where, content = str(file), file.unpacked
    if content.startswith(uff.STARTS):
        return uff.uff_tables(where, content)
    if ast_xml.is_xml(content):
        return ast_xml.ast_tables(where, content)
    refuse_others(where, content, _READABLE)
    table = file.csv
    return [(table if columns is None else _renamed(where, table, columns), _statements(content))]


def _responses(where: str, table: Columns, stated: Mapping[str, str]) -> dict[str, FRF]:
    """Return the responses of one table."""
    label, frequency = frequency_of(where, table)
    kept = _check_frequency(where, label, frequency, table)
    step = _number(stated.get("sample_time"))
    responses: dict[str, FRF] = {}
    for response in responses_of(where, table, label):
        if not response.unit and "unit" in stated:
            response.unit, response.factor = _stated_unit(where, stated["unit"])
        responses[response.name or "frf"] = FRF(
            frequency[kept],
            response.factor * _complex(where, response, table)[kept],
            input=stated.get("input", "input"),
            output=stated.get("output", response.name or "output"),
            unit=response.unit,
            sample_time=step,
            coherence=_coherence(where, response, table, kept),
            variance=_variance(where, response, table, kept),
        )
    return responses


def _stated_unit(where: str, unit: str) -> tuple[str, float]:
    """Return the SI unit and conversion factor for a line `# unit: um/N`; an unknown unit is left unchanged."""
    try:
        return in_si(where, "unit", unit)
    except LogError:
        return unit, 1.0


def _renamed(where: str, table: Columns, columns: Sequence[str]) -> Columns:
    """Return the table with its columns renamed. Raise ParameterError unless there is one unique name per column."""
    if len(columns) != len(table.values) or len(set(columns)) != len(columns):
        raise ParameterError(
            f"{where}: {len(table.values)} columns of numbers need {len(table.values)} different names, not {columns}"
        )
    return replace(table, values=dict(zip(columns, table.values.values(), strict=True)), units={})


def _finite(where: str, table: Columns, column: str) -> np.ndarray:
    """Return the values of a column. Raise LogError if one is not finite."""
    values = table.values[column]
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise LogError(
            f"{where}: column '{column}' is {values[bad[0]]} at {table.place(int(bad[0]))} ({bad.size} such lines); "
            "remove those lines"
        )
    return values


def _check_frequency(where: str, label: str, frequency: np.ndarray, table: Columns) -> slice:
    """Return the frequency lines to use: all except a leading one at 0 Hz, which a logarithmic axis cannot show."""
    _finite(where, table, label)
    if frequency.size == 0:
        raise LogError(f"{where}: holds no lines")
    negative = np.flatnonzero(frequency < 0.0)
    if negative.size:
        k = int(negative[0])
        raise LogError(
            f"{where}: the frequency is {Quantity(frequency[k], 'Hz'):9} at {table.place(k)} ({negative.size} such "
            "lines); an FRF has positive frequencies: leave out the half that mirrors the other"
        )
    still = np.flatnonzero(np.diff(frequency) <= 0.0)
    if still.size:
        k = int(still[0])
        what = "stands still" if frequency[k + 1] == frequency[k] else "falls"
        raise LogError(
            f"{where}: the frequency {what} at {table.place(k + 1)}: {Quantity(frequency[k], 'Hz'):9} is followed by "
            f"{Quantity(frequency[k + 1], 'Hz'):9} ({still.size} such lines); sort the lines by frequency, each once"
        )
    if frequency.size == 1 and frequency[0] == 0.0:
        raise LogError(f"{where}: holds only a line at 0 Hz")
    return slice(1, None) if frequency[0] == 0.0 else slice(None)


def _complex(where: str, response: Response, table: Columns) -> np.ndarray:
    """Return the complex values of a response. Raise LogError for an implausible magnitude."""
    values = _from_parts(where, response, table)
    size = np.abs(values)
    if (most := float(np.max(size))) > _LARGEST:
        raise LogError(
            f"{where}: the response reaches {Quantity(most):3} at {table.place(int(np.argmax(size)))}, beyond "
            f"{Quantity(_LARGEST)}, which no axis does: look at exponents and decimal mark"
        )
    return values


def _from_parts(where: str, response: Response, table: Columns) -> np.ndarray:
    """Compute the complex values of a response from its real and imaginary parts or its magnitude and phase."""
    places = response.places
    if {"re", "im"} <= set(places):
        return _finite(where, table, places["re"]) + 1j * _finite(where, table, places["im"])
    magnitude, phase = _finite(where, table, places["magnitude"]), _finite(where, table, places["phase"])
    if response.decibel:
        # from 6,165 dB on the power of ten overflows, before the limit of a response could refuse it
        if np.max(np.abs(magnitude), initial=0.0) > 2000.0:
            raise LogError(
                f"{where}: column '{places['magnitude']}' reaches {Quantity(np.max(np.abs(magnitude)), 'dB')}"
            )
        magnitude = 10.0 ** (magnitude / 20.0)
    elif np.any(magnitude < 0.0):
        k = int(np.argmax(magnitude < 0.0))
        raise LogError(
            f"{where}: the magnitude '{places['magnitude']}' is {Quantity(magnitude[k]):6} at {table.place(k)}; if it "
            "is in dB say so: name the column magnitude_dB"
        )
    # Phases in deg and in rad overlap near 0, so the unit cannot be guessed from the values.
    if response.degrees is None:
        raise LogError(f"{where}: the phase '{places['phase']}' has no unit; name the column phase_deg or phase_rad")
    angle = np.radians(phase) if response.degrees else phase
    return magnitude * np.exp(1j * angle)


def _coherence(where: str, response: Response, table: Columns, kept: slice) -> np.ndarray | None:
    """Return the coherence, clipped to 1 where rounding exceeds it; None if there is no such column.

    Raises LogError for values outside 0 to 1.
    """
    column = response.places.get("coherence")
    if column is None:
        return None
    values = _finite(where, table, column)
    # |Sxy|² and Sxx Syy are rounded separately: a coherence of 1 may be printed as 1.0000001
    wrong = np.flatnonzero((values > 1.0 + 1e-6) | (values < 0.0))
    if wrong.size:
        k = int(wrong[0])
        why = "in percent? Divide it by 100" if np.max(values) > 2.0 else "it is |Sxy|²/(Sxx Syy)"
        raise LogError(
            f"{where}: the coherence '{column}' is {Quantity(values[k]):6} at {table.place(k)} ({wrong.size} such "
            f"lines), outside 0 to 1; {why}"
        )
    return np.minimum(values[kept], 1.0)


def _variance(where: str, response: Response, table: Columns, kept: slice) -> np.ndarray | None:
    column = response.places.get("variance")
    if column is None:
        return None
    values = _finite(where, table, column)
    if np.any(values < 0.0):
        k = int(np.argmax(values < 0.0))
        raise LogError(
            f"{where}: the variance '{column}' is {Quantity(values[k]):6} at {table.place(k)}; it must be >= 0"
        )
    # a variance has the unit of the response squared
    return response.factor**2 * values[kept]


# keys of the lines that `write_frf` writes above its columns
_KEYS = ("input", "output", "unit", "sample_time")


def _statements(content: bytes) -> dict[str, str]:
    """Read the `# key: value` lines at the start of a file that feeddrive wrote."""
    statements: dict[str, str] = {}
    # The statements are at the start, and a file may have gigabytes.
    for line in content[:4096].split(b"\n"):
        if not line.startswith(b"#"):
            break
        key, mark, value = line[1:].decode("utf-8", "replace").partition(":")
        if mark and key.strip() in _KEYS:
            statements[key.strip()] = value.strip()
    return statements


def _number(text: str | None) -> float | None:
    try:
        number = float(text) if text else 0.0
    except ValueError:
        return None
    # The text may come from any program: an implausible sample time is ignored like a missing one.
    return number if 0.0 < number < 1e9 else None


def write_frf(path: str | Path, *frfs: FRF) -> None:
    """Write frequency responses as CSV; `read_frfs` reads them back bit for bit.

    Columns: f_Hz, re, im, and coherence and variance if they are known; for several responses re_<output> and so on,
    on their common frequency lines.  Raises ParameterError (outputs of the same name, different inputs or sample times,
    no common line) or FileError if it cannot be written.
    """
    wrong = [frf for frf in frfs if not isinstance(frf, FRF)]  # pyright: ignore[reportUnnecessaryIsInstance]
    if wrong or not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        other = type(wrong[0] if wrong else path).__name__
        raise ParameterError(f"write_frf(path, frf, ...) writes FRFs, such as fd.compliance(loop, f), not a {other}")
    outputs = [frf.output for frf in frfs]
    if len(set(outputs)) < len(outputs) or len({(frf.input, frf.sample_time) for frf in frfs}) != 1:
        raise ParameterError(
            f"responses of one file lead from one input, with one sample time, to outputs of different names, not to "
            f"{', '.join(outputs)}"
        )
    # by equal bits: responses of one measurement have one frequency vector
    lines = reduce(np.intersect1d, (frf.frequency for frf in frfs))
    if not lines.size:
        raise ParameterError("responses of one file need common lines")
    one = len(frfs) == 1
    columns = {"f_Hz": lines}
    for frf in frfs:
        kept = np.isin(frf.frequency, lines)
        values = {
            "re": np.real(frf.response),
            "im": np.imag(frf.response),
            "coherence": frf.coherence,
            "variance": frf.variance,
        }
        end = "" if one else f"_{frf.output}"
        columns |= {f"{name}{end}": column[kept] for name, column in values.items() if column is not None}
    first, units = frfs[0], {frf.unit for frf in frfs}
    stated = {
        "input": first.input,
        "output": first.output if one else None,
        "unit": units.pop() if len(units) == 1 else None,
        "sample_time": first.sample_time,
    }
    text = [f"# {key}: {plain(str(value))}" for key, value in stated.items() if value not in (None, "")]
    text.append(",".join(columns))
    # `repr` gives the fewest digits from which the same double is read.
    text += [",".join(map(repr, row)) for row in zip(*(column.tolist() for column in columns.values()), strict=True)]
    write_whole(path, "\n".join(text) + "\n")


def encoders(responses: Mapping[str, FRF]) -> dict[str, FRF]:
    """Return the responses measured with the motor and the load encoder, identified by their names.

    responses   the responses by name, as returned by `read_frfs`

    The word "motor" or "load" in the name of a response or of its output identifies the encoder; a single response
    without such a name counts as that of the motor.  An encoder without a response is omitted.
    """
    by_role = {
        role: frf
        for role in ("motor", "load")
        for name, frf in responses.items()
        if role in f"{name} {frf.output}".lower()
    }
    return by_role if by_role or len(responses) != 1 else {"motor": next(iter(responses.values()))}


def digest(path: str | Path) -> str:
    """Return the SHA-256 digest by which a report identifies an input file. Raises FileError."""
    return digest_of(read_whole(path, MOST_BYTES))
