"""A servo drive and its axis by an integrator of its own, which shares no code with feeddrive.

`run` is one bus cycle: in each of its SAMPLES samples the drive reads its encoders and computes a force by its own
control (P position loop, PI velocity loop, both slow), in each of the SUBSTEPS of a sample the mechanics moves on.  It
is plain scalar arithmetic, so that `translated` can write it as C: with gcc it runs compiled, without it as it stands,
some thirty times slower and with the same bits.

    m1 x1'' = F + cogging(x1) - K - b1 x1' + R1          motor;  R1: friction and holding brake
    m2 x2'' = K - b2 x2' + G - A + R2                    load
    m3 x3'' = A                                          tail, a body that swings on the load; absent with m3 = 0
    K = k e + d (x1' - x2'),  e: x1 - x2 beyond the gap, 0 within;  a contact never pulls
    A = k3 (x2 - x3) + d3 (x2' - x3')
    |R| <= coulomb (1 + (breakaway - 1) exp(-(v/vs)²)),  against the motion, and whatever holds the body at rest

A substep is drift, kick, drift: x += v h/2, v += a h, x += v h/2.  It is exact under constant forces, symmetric in time
and of second order; friction is the impulse that takes the velocity towards 0, at most its level, and standstill is
exact (Moreau).  Positions and forces in m and N at the table; of an axis that turns in rad and N m.

Sources: J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; E. Hairer, C. Lubich,
G. Wanner, Acta Numerica 12 (2003) 399 (drift, kick, drift).
"""

from __future__ import annotations

import ast
import ctypes
import inspect
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from math import copysign, exp, floor, fmod, pi, sin
from pathlib import Path
from typing import Any

OFF, POSITION, VELOCITY, FORCE_ONLY = 0.0, 1.0, 2.0, 3.0  # what of the drive's control runs

# parameters
(
    SAMPLE_TIME, SAMPLES, SUBSTEPS, MASS_MOTOR, MASS_LOAD, MASS_TAIL, STIFFNESS, DAMPING, TAIL_STIFFNESS, TAIL_DAMPING,
    GAP, VISCOUS_MOTOR, VISCOUS_LOAD, COULOMB_MOTOR, COULOMB_LOAD, BREAKAWAY, STRIBECK_VELOCITY, GRAVITY, COGGING,
    COGGING_SECOND, COGGING_PERIOD, COGGING_PHASE, BRAKE, CURRENT_LIMIT, FORCE_SHARE, DELAY, COUNT_MOTOR, COUNT_LOAD,
    NOISE, LOAD_ENCODER, SPEED_SHARE, KV, KP, RATE,
) = range(34)  # fmt: skip
PARAMETERS = 34
# of a radius: what a parameter is multiplied by where the same axis is seen as one that turns
POWERS = {
    **dict.fromkeys((GAP, STRIBECK_VELOCITY, COGGING_PERIOD, COUNT_MOTOR, COUNT_LOAD), -1),
    **dict.fromkeys((COULOMB_MOTOR, COULOMB_LOAD, GRAVITY, COGGING, BRAKE, CURRENT_LIMIT), 1),
    **dict.fromkeys((MASS_MOTOR, MASS_LOAD, MASS_TAIL, STIFFNESS, DAMPING, TAIL_STIFFNESS, TAIL_DAMPING), 2),
    **dict.fromkeys((VISCOUS_MOTOR, VISCOUS_LOAD), 2),
}
# inputs of a cycle
LOOP, BEGIN, END, SET_VELOCITY, ADDED, MOST, BRAKED = range(7)
INPUTS = 7
# state
(
    X1, X2, X3, V1, V2, V3, FORCE, COMMAND, SUM, READING_MOTOR, READING_LOAD, SPEED, SEED, LOW, HIGH, FASTEST,
    STRONGEST, QUEUE,
) = range(18)  # fmt: skip
LONGEST = 40  # samples of delay
STATES = QUEUE + 3 * (LONGEST + 1)


def run(p: Any, s: Any, u: Any) -> None:
    """Run one bus cycle: parameters p, state s, inputs u."""
    h = p[SAMPLE_TIME] / p[SUBSTEPS]
    s[LOW] = s[X2]
    s[HIGH] = s[X2]
    s[FASTEST] = 0.0
    s[STRONGEST] = 0.0
    for k in range(int(p[SAMPLES])):
        # encoders; a generator of Lehmer gives their noise, uniform and of unit variance
        s[SEED] = fmod(16807.0 * s[SEED], 2147483647.0)
        motor = p[COUNT_MOTOR] * floor(
            s[X1] / p[COUNT_MOTOR] + p[NOISE] * 3.4641016151377544 * (s[SEED] / 2147483647.0 - 0.5) + 0.5
        )
        s[SEED] = fmod(16807.0 * s[SEED], 2147483647.0)
        load = p[COUNT_LOAD] * floor(
            s[X2] / p[COUNT_LOAD] + p[NOISE] * 3.4641016151377544 * (s[SEED] / 2147483647.0 - 0.5) + 0.5
        )
        s[SPEED] += p[SPEED_SHARE] * ((motor - s[READING_MOTOR]) / p[SAMPLE_TIME] - s[SPEED])
        s[READING_MOTOR] = motor
        s[READING_LOAD] = load
        # setpoints, on a straight line over the cycle, as old as the delay
        late = int(p[DELAY])
        for j in range(3 * int(p[DELAY])):
            s[QUEUE + j] = s[QUEUE + j + 3]
        s[QUEUE + 3 * late] = u[BEGIN] + (u[END] - u[BEGIN]) * ((k + 1.0) / p[SAMPLES])
        s[QUEUE + 3 * late + 1] = u[SET_VELOCITY]
        s[QUEUE + 3 * late + 2] = u[ADDED]
        asked = s[QUEUE + 2]
        error = 0.0
        if u[LOOP] == POSITION or u[LOOP] == VELOCITY:
            speed = s[QUEUE + 1]
            if u[LOOP] == POSITION:
                speed += p[KV] * (s[QUEUE] - (load if p[LOAD_ENCODER] > 0.0 else motor))
            error = speed - s[SPEED]
            asked += p[KP] * error + s[SUM]
        most = u[MOST] if u[MOST] < p[CURRENT_LIMIT] else p[CURRENT_LIMIT]
        limited = most if asked > most else (-most if asked < -most else asked)
        if (asked - limited) * error <= 0.0:
            s[SUM] += p[KP] * p[RATE] * p[SAMPLE_TIME] * error
        if u[LOOP] == OFF:
            limited = 0.0
        s[COMMAND] = limited
        for _ in range(int(p[SUBSTEPS])):
            s[FORCE] += p[FORCE_SHARE] * (limited - s[FORCE])
            x1 = s[X1] + 0.5 * h * s[V1]
            x2 = s[X2] + 0.5 * h * s[V2]
            # coupling
            stretch = x1 - x2
            beyond = 0.0
            if stretch > 0.5 * p[GAP]:
                beyond = stretch - 0.5 * p[GAP]
            if stretch < -0.5 * p[GAP]:
                beyond = stretch + 0.5 * p[GAP]
            between = p[STIFFNESS] * beyond + p[DAMPING] * (s[V1] - s[V2])
            if p[GAP] > 0.0 and between * beyond <= 0.0:
                between = 0.0
            swing = 0.0
            if p[MASS_TAIL] > 0.0:
                x3 = s[X3] + 0.5 * h * s[V3]
                swing = p[TAIL_STIFFNESS] * (x2 - x3) + p[TAIL_DAMPING] * (s[V2] - s[V3])
            force = s[FORCE] - between - p[VISCOUS_MOTOR] * s[V1]
            if p[COGGING] > 0.0:
                angle = 2.0 * pi * x1 / p[COGGING_PERIOD] + p[COGGING_PHASE]
                force += p[COGGING] * (sin(angle) + p[COGGING_SECOND] * sin(2.0 * angle))
            # motor
            v1 = s[V1] + h * force / p[MASS_MOTOR]
            bell = exp(-(v1 / p[STRIBECK_VELOCITY]) * (v1 / p[STRIBECK_VELOCITY]))
            rub = p[COULOMB_MOTOR] * (1.0 + (p[BREAKAWAY] - 1.0) * bell) + p[BRAKE] * u[BRAKED]
            rub = h * rub / p[MASS_MOTOR]
            v1 = v1 - copysign(rub, v1) if abs(v1) > rub else 0.0
            # load
            force = between - swing - p[VISCOUS_LOAD] * s[V2] + p[GRAVITY]
            v2 = s[V2] + h * force / p[MASS_LOAD]
            bell = exp(-(v2 / p[STRIBECK_VELOCITY]) * (v2 / p[STRIBECK_VELOCITY]))
            rub = h * p[COULOMB_LOAD] * (1.0 + (p[BREAKAWAY] - 1.0) * bell) / p[MASS_LOAD]
            v2 = v2 - copysign(rub, v2) if abs(v2) > rub else 0.0
            if p[MASS_TAIL] > 0.0:
                v3 = s[V3] + h * swing / p[MASS_TAIL]
                s[X3] = s[X3] + 0.5 * h * (s[V3] + v3)
                s[V3] = v3
            s[X1] = x1 + 0.5 * h * v1
            s[X2] = x2 + 0.5 * h * v2
            s[V1] = v1
            s[V2] = v2
            if s[X2] < s[LOW]:
                s[LOW] = s[X2]
            if s[X2] > s[HIGH]:
                s[HIGH] = s[X2]
            if abs(v2) > s[FASTEST]:
                s[FASTEST] = abs(v2)
            if abs(s[FORCE]) > s[STRONGEST]:
                s[STRONGEST] = abs(s[FORCE])


# ---------------------------------------------------------------------------------------------------- written as C

_OPERATORS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Gt: ">", ast.Lt: "<", ast.GtE: ">=", ast.LtE: "<=",
    ast.Eq: "==", ast.And: "&&", ast.Or: "||", ast.USub: "-",
}  # fmt: skip
_CALLS = {"abs": "fabs", "int": "(double)(long)"}


class _Translator:
    """The C of a function of arrays of numbers whose body has assignments, `if`, `for ... in range` and expressions."""

    def __init__(self, names: dict[str, Any]) -> None:
        self._names = names

    def function(self, function: ast.FunctionDef) -> str:
        arrays = [argument.arg for argument in function.args.args]
        body = "".join(self._statement(statement, 1) for statement in function.body[1:])
        stored = {node.id for node in ast.walk(function) if isinstance(node, ast.Name) and self._is_stored(node)}
        counted = {node.target.id for node in ast.walk(function) if isinstance(node, ast.For)}  # type: ignore[union-attr]
        variables = "".join(f"    double {name} = 0.0;\n" for name in sorted(stored - counted))
        head = ", ".join(f"double *{name}" for name in arrays)
        return f"#include <math.h>\nvoid {function.name}({head}) {{\n{variables}{body}}}\n"

    @staticmethod
    def _is_stored(node: ast.Name) -> bool:
        return isinstance(node.ctx, ast.Store)

    def _statement(self, node: ast.stmt, depth: int) -> str:
        space = "    " * depth
        if isinstance(node, ast.Assign):
            return f"{space}{self._value(node.targets[0])} = {self._value(node.value)};\n"
        if isinstance(node, ast.AugAssign):
            place = self._value(node.target)
            return f"{space}{place} = {place} {_OPERATORS[type(node.op)]} ({self._value(node.value)});\n"
        if isinstance(node, ast.If):
            assert not node.orelse
            return f"{space}if ({self._value(node.test)}) {{\n{self._block(node.body, depth)}{space}}}\n"
        assert isinstance(node, ast.For), ast.dump(node)
        assert isinstance(node.iter, ast.Call)
        k, count = self._value(node.target), self._value(node.iter.args[0])
        return f"{space}for (long {k} = 0; {k} < {count}; {k}++) {{\n{self._block(node.body, depth)}{space}}}\n"

    def _block(self, body: list[ast.stmt], depth: int) -> str:
        return "".join(self._statement(statement, depth + 1) for statement in body)

    def _value(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant):
            return repr(node.value)
        if isinstance(node, ast.Name):
            value = self._names.get(node.id)
            return repr(value) if isinstance(value, int | float) else node.id
        if isinstance(node, ast.Subscript):
            return f"{self._value(node.value)}[(long)({self._value(node.slice)})]"
        if isinstance(node, ast.BinOp):
            return f"({self._value(node.left)} {_OPERATORS[type(node.op)]} {self._value(node.right)})"
        if isinstance(node, ast.UnaryOp):
            return f"({_OPERATORS[type(node.op)]}{self._value(node.operand)})"
        if isinstance(node, ast.Compare):
            return f"({self._value(node.left)} {_OPERATORS[type(node.ops[0])]} {self._value(node.comparators[0])})"
        if isinstance(node, ast.BoolOp):
            return f"({f' {_OPERATORS[type(node.op)]} '.join(self._value(value) for value in node.values)})"
        if isinstance(node, ast.IfExp):
            return f"({self._value(node.test)} ? {self._value(node.body)} : {self._value(node.orelse)})"
        assert isinstance(node, ast.Call), ast.dump(node)
        assert isinstance(node.func, ast.Name)
        arguments = ", ".join(self._value(argument) for argument in node.args)
        return f"{_CALLS.get(node.func.id, node.func.id)}({arguments})"


def translated(function: Callable[..., None]) -> str:
    """The function as C99."""
    tree = ast.parse(inspect.getsource(function)).body[0]
    assert isinstance(tree, ast.FunctionDef)
    return _Translator(function.__globals__).function(tree)


@cache
def compiler() -> str | None:
    """The C compiler of this machine, or None."""
    return next((path for name in ("gcc", "cc", "clang") if (path := shutil.which(name))), None)


@cache
def fast_run() -> Callable[[Any, Any, Any], None]:
    """`run`, compiled where a compiler is there; otherwise as it stands, and said so."""
    program = compiler()
    if program is None:
        print("NOT COMPILED: the unknown drives run some thirty times slower; apt-get install gcc", file=sys.stderr)  # noqa: T201
        return run
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "run.c", Path(folder) / "run.so"
        source.write_text(translated(run), encoding="utf-8")
        # without contraction and with IEEE arithmetic: the bits of Python
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC"]
        subprocess.run([program, *flags, str(source), "-o", str(library), "-lm"], check=True)
        return ctypes.CDLL(str(library)).run


class Servo:
    """Parameters, state and inputs of one drive and its axis; `cycle` moves them on."""

    def __init__(self, p: dict[int, float], position: float = 0.0, seed: int = 1, *, compiled: bool = True) -> None:
        self.p, self.s, self.u = ((ctypes.c_double * count)() for count in (PARAMETERS, STATES, INPUTS))
        usual = {
            SAMPLE_TIME: 125e-6, SAMPLES: 8.0, SUBSTEPS: 5.0, MASS_MOTOR: 1.0, MASS_LOAD: 1.0, BREAKAWAY: 1.0,
            STRIBECK_VELOCITY: 1.0, COGGING_PERIOD: 1.0, CURRENT_LIMIT: math.inf, FORCE_SHARE: 1.0, COUNT_MOTOR: 1e-9,
            COUNT_LOAD: 1e-9, SPEED_SHARE: 1.0,
        }  # fmt: skip
        for index, value in {**usual, **p}.items():
            self.p[index] = value
        assert self.p[DELAY] <= LONGEST
        for index in (X1, X2, X3, READING_MOTOR, READING_LOAD):
            self.s[index] = position
        self.s[SEED] = float(1 + seed % 2147483646)
        self.u[MOST] = math.inf
        self._run = fast_run() if compiled else run
        self.hold(position, 0.0)

    def hold(self, position: float, added: float) -> None:
        """Fill the delay with one setpoint."""
        for j in range(LONGEST + 1):
            self.s[QUEUE + 3 * j], self.s[QUEUE + 3 * j + 1], self.s[QUEUE + 3 * j + 2] = position, 0.0, added

    @property
    def reading(self) -> float:
        """The encoder of the position loop, m."""
        return self.s[READING_LOAD if self.p[LOAD_ENCODER] > 0.0 else READING_MOTOR]

    def cycle(self, **inputs: float) -> None:
        """Run one bus cycle after setting inputs by name, such as `loop=OFF`."""
        for name, value in inputs.items():
            self.u[globals()[name.upper()]] = value
        self._run(self.p, self.s, self.u)
