"""Names and strings that are valid on every target: identifiers, reserved words, and ASCII text."""

import re
import unicodedata

from feeddrive.language.errors import ParameterError

HAL_LENGTH = 47  # maximum length of a name in LinuxCNC's HAL, the shortest limit of all targets


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


C_WORDS = _words(
    """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    alignas alignof bool constexpr false nullptr static_assert thread_local true typeof typeof_unqual
    and and_eq asm atomic_cancel atomic_commit atomic_noexcept bitand bitor catch char8_t char16_t char32_t class compl
    concept consteval constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export
    friend mutable namespace new noexcept not not_eq operator or or_eq private protected public reflexpr
    reinterpret_cast requires static_cast synchronized template this throw try typeid typename using virtual wchar_t
    xor xor_eq
    abs acos acosh asin asinh assert atan atan2 atanh cbrt ceil copysign cos cosh div errno erf erfc exit exp exp2
    expm1 fabs fdim floor fma fmax fmin fmod fpclassify frexp free hypot ilogb index isfinite isgreater isinf isless
    isnan isnormal j0 j1 jn labs ldexp lgamma linux llrint llround log log10 log1p log2 logb lrint lround main malloc
    memcpy memset modf nan nearbyint nextafter pow rand remainder remquo rint round scalbn signal signbit sin sinh
    sqrt stderr stdin stdout tan tanh tgamma time trunc unix y0 y1 yn
    complex ctype fenv inttypes iso646 limits locale math setjmp stdarg stdatomic stdbool stddef stdint stdio stdlib
    string tgmath threads uchar wchar wctype xmmintrin
    BUFSIZ EOF HUGE_VAL INFINITY INT_MAX MATH_ERRNO NAN NULL RAND_MAX
    """
)  # keywords of C99, C11, C23 and C++20, names of <math.h> and of headers, macros of compilers

HAL_WORDS = _words(
    """
    author bit component description examples extra_arg extra_cleanup extra_setup float function hal include license
    modparam names notes option param period pin rtapi s32 s64 see_also singleton u32 u64 userspace variable
    """
)  # words of a LinuxCNC component, and names that its generated source uses

ST_WORDS = _words(
    """
    ABS ABSTRACT ACOS ACTION ADD ADD_TIME ADR AND ANDN AND_THEN ANY ANY_BIT ANY_CHAR ANY_CHARS ANY_DATE ANY_DERIVED
    ANY_DURATION ANY_ELEMENTARY ANY_INT ANY_MAGNITUDE ANY_NUM ANY_REAL ANY_SIGNED ANY_STRING ANY_UNSIGNED ARRAY ASIN
    AT ATAN ATAN2 BIT BITADR BOOL BY BYTE CAL CALC CALCN CASE CD CDT CEIL CHAR CLASS CLK CONCAT CONFIGURATION CONSTANT
    CONTINUE COS CTD CTU CTUD CU CV D DATE DATE_AND_TIME DELETE DINT DIV DO DS DT DWORD ELSE ELSIF EN END_ACTION
    END_CASE END_CLASS END_CONFIGURATION END_FOR END_FUNCTION END_FUNCTION_BLOCK END_IF END_INTERFACE END_METHOD
    END_NAMESPACE END_PROGRAM END_PROPERTY END_REPEAT END_RESOURCE END_STEP END_STRUCT END_TRANSITION END_TYPE
    END_UNION END_VAR END_WHILE ENO EQ ET EXIT EXP EXPT EXTENDS FALSE FB_EXIT FB_INIT FB_REINIT FINAL FIND FLOOR FOR
    FRAC FROM FUNCTION FUNCTION_BLOCK F_EDGE F_TRIG GE GET GT IF IMPLEMENTS IN INDEXOF INI INITIAL_STEP INSERT INT
    INTERFACE INTERNAL INTERVAL JMP JMPC JMPCN L LD LDATE LDATE_AND_TIME LDN LDT LE LEFT LEN LIMIT LINT LN LOG LREAL LT
    LTIME LTIME_OF_DAY LTOD LWORD MAX METHOD MID MIN MOD MODABS MOVE MUL MUX N NAMESPACE NE NEG NON_RETAIN NOT NULL OF
    ON OR ORN OR_ELSE OVERLAP OVERRIDE P PARAMS PERSISTENT POINTER PRIORITY PRIVATE PROGRAM PROPERTY PROTECTED PT
    PUBLIC PV Q Q1 QD QU R R1 READ_ONLY READ_WRITE REAL REF REFERENCE REF_TO RELEASE REPEAT REPLACE RESOURCE RET RETAIN
    RETC RETCN RETURN RIGHT ROL ROR ROUND RS R_EDGE R_TRIG S S1 SD SEL SEMA SET SHL SHR SIN SINGLE SINT SIZEOF SL SQRT
    SR ST STEP STN STRING STRUCT SUB SUPER T TAN TASK TEST_AND_SET THEN THIS TIME TIME_OF_DAY TO TOD TOF TON TP
    TRANSITION TRUE TRUNC TRUNC_INT TYPE UDINT UINT ULINT UNION UNTIL USING USINT UXINT VAR VAR_ACCESS VAR_CONFIG
    VAR_EXTERNAL VAR_GENERIC VAR_GLOBAL VAR_INPUT VAR_INST VAR_IN_OUT VAR_OUTPUT VAR_STAT VAR_TEMP VERSION WCHAR WHILE
    WITH WORD WSTRING XINT XOR XORN XSIZEOF XWORD __DELETE __ISVALIDREF __NEW __QUERYINTERFACE __QUERYPOINTER
    """
)  # keywords and standard functions of IEC 61131-3, second and third edition, with those of CODESYS and TwinCAT

_LANGUAGES = {"C or C++": C_WORDS, "Structured Text (IEC 61131-3)": ST_WORDS, "LinuxCNC's HAL": HAL_WORDS}
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)


def identifier(wanted: str, taken: set[str], reserved: frozenset[str]) -> str:
    """Return a legal name close to `wanted` that is neither reserved nor taken, and add it to `taken`.

    `axis.law.Kv` becomes `axis_law_Kv`, `ω0` becomes `omega0`, and `_2`, `_3`, ... is appended to a name already taken.
    Names that differ only in case count as equal.  The result is deterministic.
    """
    text = re.sub(r"[^A-Za-z0-9]+", "_", "".join(map(_plain, wanted))).strip("_")
    if not text or text[0].isdigit():
        text = f"x{text}"
    # Structured Text ignores the case of names
    gone = {word.upper() for word in taken} | {word.upper() for word in reserved}
    name, count = text, 1
    while name.upper() in gone:
        count += 1
        name = f"{text}_{count}"
    taken.add(name)
    return name


def _plain(character: str) -> str:
    """Return a character in ASCII: a letter without its accent, or the name of a Greek letter."""
    if character.isascii():
        return character
    words = unicodedata.name(character, "").split()
    if words[:1] == ["GREEK"] and "LETTER" in words:
        name = words[words.index("LETTER") + 1].lower()
        return name.capitalize() if words[1] == "CAPITAL" else name
    text = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return text if text else "_"


def check_name(name: str, where: str, longest: int = HAL_LENGTH) -> None:
    """Raise ParameterError unless `name` is legal on every target; the message names its option or key `where`."""
    advice = "letters, digits and single underscores, a letter first, such as axis_x"
    if not _PLAIN.fullmatch(name):
        raise ParameterError(f"{where}: {name!r} cannot name a component, a function and a struct: take {advice}")
    if len(name) > longest:
        raise ParameterError(
            f"{where}: {name!r} has {len(name)} characters, {len(name) - longest} more than the {longest} that fit; "
            f"take a shorter one"
        )
    for language, words in _LANGUAGES.items():
        if name.upper() in {word.upper() for word in words}:
            raise ParameterError(f"{where}: {name!r} is a word of {language}; take another name, such as {name}_axis")


_SIGNS = {
    "·": "*",
    "×": "x",
    "−": "-",
    "–": "-",
    "—": "-",
    "√": "sqrt",
    "∞": "inf",
    "∛": "cbrt",
    "°": "deg",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "∈": " in ",
    "‖": "||",
    "’": "'",
    "‘": "'",
    "“": '"',
    "”": '"',
    "…": "...",
    "µ": "u",
    "∂": "d",
    "∫": "int ",
    "±": "+-",
    "≈": "~",
    "ß": "ss",
    "Σ": "sum ",
}
_RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ˣʸᵀⁱⁿᵏˢ", "0123456789-+xyTinks", strict=True))


def ascii_text(text: str) -> str:
    """Convert a string to ASCII: `s²` becomes `s^2`, `ζ` becomes `zeta`, an unknown character becomes `?`.

    `·/` becomes `* /`, so that it does not end a C comment.
    """
    return _BEYOND_ASCII.sub(lambda match: _run_spelled(match[0]), text.replace("·/", "· /"))


_BEYOND_ASCII = re.compile(r"[^\x00-\x7f]+")


def _run_spelled(text: str) -> str:
    """Convert a run of non-ASCII characters to ASCII; `^` or `_` precedes a group of superscripts or subscripts."""
    parts: list[str] = []
    raised = lowered = False
    for character in text:
        code = _SIGNS.get(character)
        up = code is None and character in _RAISED
        down = "SUBSCRIPT" in unicodedata.name(character, "")
        if up and not raised:
            parts.append("^")
        if down and not lowered:
            parts.append("_")
        raised, lowered = up, down
        parts.append(code or _RAISED.get(character) or _spelled(character))
    return "".join(parts)


def _spelled(character: str) -> str:
    words = unicodedata.name(character, "").split()
    if words[:1] == ["GREEK"] and "LETTER" in words:
        # Unicode names the letter LAMDA
        name = words[words.index("LETTER") + 1].lower().replace("lamda", "lambda")
        return name.capitalize() if words[1] == "CAPITAL" else name
    if unicodedata.combining(character):
        return ""
    return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"


def bare(text: str) -> str:
    """Return the text without its outer parentheses, if a matching pair encloses all of it."""
    depth = 0
    for place, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return text[1:-1] if place == len(text) - 1 and place > 0 else text
    return text
