"""Part programs that ask for more than anyone means, and files that are none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Draw = np.random.Generator


def _number(draw: Draw) -> str:
    """Numbers of any size, as a word may have them."""
    return str(
        draw.choice(
            [
                f"{10.0 ** draw.uniform(-12.0, 12.0):.12f}",
                f"-{10.0 ** draw.uniform(-12.0, 9.0):.9f}",
                "0",
                "1e9",
                "9" * int(draw.integers(1, 400)),
                "." + "0" * int(draw.integers(1, 300)) + "1",
                f"{draw.integers(0, 1000)}",
            ]
        )
    )


def _feeds(draw: Draw) -> str:
    feed = draw.choice(["0.000000001", "1e-9", "0.0000001", "0.01", "1", "1000000000"])
    return f"G64 P0.01\nG1 X{draw.choice(['1', '0.001', '300'])} F{feed}\nX0 Y1\nM2\n"


def _loops(draw: Draw) -> str:
    body = draw.choice(["G1 X1 F6000\nX0", "#1=[#1+1]", "(nothing)", "G4 P0.001", "G0 X1\nG0 X0", "G91 G1 X0.001 F600"])
    head, end = draw.choice(
        [
            ["while [1]", "endwhile"],
            ["do", "while [1]"],
            ["repeat [1000000000]", "endrepeat"],
            ["repeat [1e3]", "endrepeat"],
        ]
    ).tolist()
    return f"#1=0\nF6000\no1 {head}\n{body}\no1 {end}\nM2\n"


def _nested(draw: Draw) -> str:
    deep, body = int(draw.integers(2, 12)), draw.choice(["G91 G1 X0.01 F600", "#1=1", "G4 P0"])
    begin = "".join(f"o{k} repeat [10]\n" for k in range(deep))
    end = "".join(f"o{k} endrepeat\n" for k in reversed(range(deep)))
    return f"F600\n{begin}{body}\n{end}M2\n"


def _calls(draw: Draw) -> str:
    return str(
        draw.choice(
            [
                "o1 sub\no1 call\no1 endsub\no1 call\nM2\n",
                "o1 sub\no2 call\no1 endsub\no2 sub\no1 call\no2 endsub\no1 call\nM2\n",
                "o1 sub\no2 repeat [2]\no1 call [#1+1]\no2 endrepeat\no1 endsub\no1 call [1]\nM2\n",
                "o1 sub\nG91 G1 X0.01 F600\no1 endsub\no2 while [1]\no1 call\no2 endwhile\nM2\n",
                "o1 sub\no9 if [#1 gt 0]\no1 call [#1-1]\no1 call [#1-1]\no9 endif\n"
                "G91 G1 X0.1 F600\no1 endsub\no1 call [30]\nM2\n",
                "o<there-is-none> call\nM2\n",
                "o1 sub\nM2\n",
                "o1 endsub\n",
            ]
        )
    )


def _huge(draw: Draw) -> str:
    words = [f"{letter}{_number(draw)}" for letter in draw.permutation(list("XYZFS"))[: draw.integers(1, 5)]]
    return f"G{draw.integers(0, 4)} " + " ".join(words) + f"\nG1 X{_number(draw)} F{_number(draw)}\nM2\n"


def _dwells(draw: Draw) -> str:
    time = draw.choice(["100000", "1e9", "172801", "86400", "99999999999", "0.0000000001"])
    return f"G4 P{time}\nG4 P{_number(draw)}\nM2\n"


def _tiny(draw: Draw) -> str:
    step, count = 10.0 ** draw.uniform(-9.0, -2.0), int(draw.integers(200, 3000))
    points = np.cumsum(step * draw.normal(size=(count, 2)), axis=0)
    rows = "\n".join(f"X{x:.12f} Y{y:.12f}" for x, y in points)
    mode = draw.choice(["G64 P0.01", "G64", "G61", "G64 P0.000001", "G61.1"])
    return f"{mode}\nG1 F{draw.choice([1, 600, 60000])}\n{rows}\nM2\n"


def _arcs(draw: Draw) -> str:
    turns = draw.choice([1000000, 100000, 99999, 20000, 2])
    plane = draw.choice(["", "G10 L2 P1 R30\nG18\n", "G19\n", "G91.1\n"])
    words = {"": "X0 Y0 I1 J0", "G91.1\n": "X0 Y0 I1 J0", "G19\n": "Y0 Z0 J1 K0"}.get(str(plane), "X0 Z0 I1 K0")
    radius = draw.choice(["", "G2 X1 Y0 R0.0000001\n", "G3 X0.0000001 R100000\n", "G2 X0 Y0 I0.000000001\n", ""])
    return f"G64 P0.01\n{plane}G1 F{draw.choice(['1', '6000', '1000000'])}\n{radius}G2 {words} P{turns}\nM2\n"


def _parameters(draw: Draw) -> str:
    return str(
        draw.choice(
            [
                "#1=1\no1 repeat [2000]\n#1=[#1*10]\no1 endrepeat\nG1 X#1 F100\nM2\n",
                "#1=[10**400]\nG1 X#1 F100\nM2\n",
                "#99999=1\nM2\n",
                "#1=[0/0]\nM2\n",
                "G1 X[" + "[" * 5000 + "1" + "]" * 5000 + "] F1\nM2\n",
                "#1=" + "+".join(["1"] * 20000) + "\nM2\n",
                "#1=1e308\n#2=[#1*#1]\nG1 X#2 F1\nM2\n",
                "#<a>=1\no1 while [#<a> lt 1e300]\n#<a>=[#<a>*1.0000001]\no1 endwhile\nM2\n",
                "#1=1\n" + "#1=#[#1]\n" * 500 + "M2\n",
                "G1 X" + "#" * 3000 + "1 F1\nM2\n",
            ]
        )
    )


def _cycles(draw: Draw) -> str:
    words = draw.choice(["Z-10 R1 Q0.001 L10000", "Z-10 R1 Q0.0011 L1", "Z-1000 R1 Q0.000001", "Z-1 R1 Q1 L9999"])
    return f"F6000\nG91 G83 X0.001 {words}\nG80\nM2\n"


def _curves(draw: Draw) -> str:
    words = draw.choice(
        ["I0 J0.1 P0 Q0 X1 Y0", "I1e5 J1e5 P-1e5 Q1e5 X1 Y1", "I1e-9 J0 P0 Q0 X1e-9 Y0", "I0 J0 P0 Q0 X100 Y100"]
    )
    return f"G64 P{draw.choice(['0.01', '0.00000001', '0.1'])}\nG1 X0 F{draw.choice([1, 6000])}\nG5 {words}\nM2\n"


def _bytes(draw: Draw) -> bytes:
    return draw.integers(0, 256, int(draw.integers(1, 200_000)), dtype=np.uint8).tobytes()


def _long_lines(draw: Draw) -> str:
    return str(
        draw.choice(
            [
                "G1 " + "X1 " * 40000 + "F1\n",
                "(" + "a" * 200_000 + ")\nM2\n",
                "G1 X" + "1" * 60_000 + " F1\nM2\n",
                " " * 65_000 + "G1 X1 F100\nM2\n",
                "G1X1F600" * 8000 + "\nM2\n",
            ]
        )
    )


KINDS: tuple[Callable[[Draw], str | bytes], ...] = (
    _feeds, _loops, _nested, _calls, _huge, _dwells, _tiny, _arcs, _parameters, _cycles, _curves, _bytes, _long_lines,
)  # fmt: skip


def pathological(seed: int, number: int) -> tuple[str, bytes]:
    """The kind and the bytes of program `number` of a seed."""
    draw = np.random.default_rng((seed, number))
    kind = KINDS[number % len(KINDS)]
    program = kind(draw)
    return kind.__name__.lstrip("_"), program if isinstance(program, bytes) else program.encode()
