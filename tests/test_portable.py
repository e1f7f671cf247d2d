"""No call that only POSIX has outside bus/: the README promises Windows, on which these tests do not run.

A call is allowed where the system was asked before: under an `if` (or behind a return) on sys.platform, os.name or
hasattr, or with `except` for its absence.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import feeddrive

SOURCE = Path(feeddrive.__file__).parent
TESTS = Path(__file__).parent
MODULES = {
    "crypt",
    "curses",
    "fcntl",
    "grp",
    "nis",
    "posix",
    "pty",
    "pwd",
    "readline",
    "resource",
    "spwd",
    "syslog",
    "termios",
    "tty",
}
# names of the standard library that Windows lacks, by module
LACKING = {
    "os": (
        "O_CLOEXEC O_DIRECTORY O_NOCTTY O_NOFOLLOW O_NONBLOCK O_SYNC WEXITSTATUS WIFEXITED chown chroot "
        "ctermid eventfd fchdir fchmod fchown fork forkpty getegid geteuid getgid getgroups getloadavg "
        "getpgid getpgrp getpriority getresuid getsid getuid initgroups killpg lchown memfd_create mkfifo "
        "mknod nice openpty pipe2 posix_fadvise posix_spawn pread pwrite sched_getaffinity sched_setaffinity "
        "sched_setscheduler sendfile setgid setpgid setpriority setsid setuid statvfs sysconf tcgetpgrp "
        "ttyname uname wait wait3 wait4"
    ),
    "signal": (
        "SIGALRM SIGCHLD SIGCONT SIGHUP SIGIO SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 "
        "SIGWINCH alarm getitimer pause pthread_kill pthread_sigmask setitimer siginterrupt sigpending "
        "sigtimedwait sigwait"
    ),
    "select": "epoll kqueue poll",
    "socket": "AF_CAN AF_NETLINK AF_PACKET AF_UNIX SO_REUSEPORT socketpair",
    "time": "CLOCK_MONOTONIC clock_gettime clock_nanosleep tzset",
    "subprocess": "getoutput getstatusoutput",
}
# of the same name on Windows, where they do other things: kill ends a process at once, whatever the signal
OTHERWISE = {"os": "kill"}
# of Linux by what they do, so that nothing else reaches them: only encodings are looked at
OF_LINUX = {
    "export/linuxcnc_session.py": "runs LinuxCNC, whose programs are looked for first",
    "mutants.py": "a tool of `make mutate`, which forks after its imports",
    "constant_mutants.py": "the same: it forks a process for each changed constant",
    "forked_jobs.py": "asks first whether processes can be forked",
    "bus_bench.py": "tests of bus/",
    "bus_scenarios.py": "tests of bus/",
}
PLACES = re.compile(r"/(proc|tmp|dev|etc|usr|bin|var|run|sys|home|opt)(/|$)")
PATHS = re.compile(r"path|file|folder|director|place", re.IGNORECASE)
TEXTS = {"read_text", "write_text"}


def text_of(node: ast.AST) -> str:
    return ast.unparse(node)


def lacks(module: str, name: str) -> bool:
    """Whether Windows lacks a name of the standard library, or means something else by it."""
    return name in f"{LACKING.get(module, '')} {OTHERWISE.get(module, '')}".split()


def asks(test: ast.AST) -> bool:
    """Whether a condition is about the system or what it has."""
    said = text_of(test)
    return any(
        each in said for each in ("sys.platform", "os.name", "hasattr(", "platform.system", "find_spec", "LINUX")
    )


class Portability(ast.NodeVisitor):
    """What of a file only POSIX has, as lines and words."""

    def __init__(self) -> None:
        self.found = list[tuple[int, str]]()
        self._asked = 0

    def say(self, node: ast.AST, what: str) -> None:
        if not self._asked:
            self.found.append((getattr(node, "lineno", 0), what))

    def body(self, nodes: list[ast.stmt]) -> None:
        """Statements; those behind an `if` on the system that leaves are guarded too."""
        before = self._asked
        for each in nodes:
            self.visit(each)
            leaves = isinstance(each, ast.If) and isinstance(each.body[-1], ast.Return | ast.Raise | ast.Continue)
            if leaves and isinstance(each, ast.If) and asks(each.test):
                self._asked += 1
        self._asked = before

    def generic_visit(self, node: ast.AST) -> None:
        for _, value in ast.iter_fields(node):
            if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                self.body(value)
            elif isinstance(value, list):
                for each in value:
                    if isinstance(each, ast.AST):
                        self.visit(each)
            elif isinstance(value, ast.AST):
                self.visit(value)

    def guarded(self, node: ast.AST, test: bool) -> None:
        self._asked += test
        self.generic_visit(node)
        self._asked -= test

    def visit_If(self, node: ast.If) -> None:
        self.guarded(node, asks(node.test))

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.guarded(node, asks(node.test))

    def visit_Try(self, node: ast.Try) -> None:
        caught = " ".join(text_of(each.type) for each in node.handlers if each.type is not None)
        self.guarded(node, "ImportError" in caught or "AttributeError" in caught)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self.guarded(node, any(asks(each) or "needs_proc" in text_of(each) for each in node.decorator_list))

    def visit_Import(self, node: ast.Import) -> None:
        for each in node.names:
            if each.name.split(".")[0] in MODULES:
                self.say(node, f"import {each.name}")

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        module = node.module or ""
        if module in MODULES:
            self.say(node, f"import {module}")
        for each in node.names:
            if lacks(module, each.name):
                self.say(node, f"{module}.{each.name}")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.value, ast.Name) and lacks(node.value.id, node.attr):
            self.say(node, text_of(node))
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not (isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)):  # docstrings
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and PLACES.match(node.value):
            self.say(node, f"the place {node.value!r}")

    def visit_Call(self, node: ast.Call) -> None:
        given = {each.arg for each in node.keywords}
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        of = text_of(node.func.value) if isinstance(node.func, ast.Attribute) else ""
        words = [each.value for each in node.args if isinstance(each, ast.Constant)]
        if name in {"get_context", "set_start_method"} and {"fork", "forkserver"} & set(map(str, words)):
            self.say(node, f"{name}({words[0]!r})")
        if name in TEXTS and "encoding" not in given and len(node.args) < (1 if name == "read_text" else 2):
            self.say(node, f"{name} without encoding")
        if name == "open" and "encoding" not in given and of in ("", "io") and not self._binary(node, 1):
            self.say(node, "open without encoding")
        if name == "open" and "encoding" not in given and of not in ("", "io", "os", "webbrowser"):
            mode = [each for each in words if isinstance(each, str) and re.fullmatch(r"[rwaxbt+]{1,3}", each)]
            if (PATHS.search(of) or mode) and not any("b" in each for each in mode):
                self.say(node, "open without encoding")
        if of == "subprocess" and {"text", "universal_newlines"} & given and "encoding" not in given:
            self.say(node, f"subprocess.{name} of text without encoding")
        if {"preexec_fn", "start_new_session", "pass_fds", "process_group"} & given:
            self.say(node, f"{name} with what only POSIX has")
        if name in {"add_signal_handler", "add_reader", "add_writer"}:
            self.say(node, name)
        splits = name in {"split", "rsplit", "partition", "rpartition"} and "/" in words
        if splits and PATHS.search(of):
            self.say(node, f"{text_of(node)} parts a path by hand")
        self.generic_visit(node)

    @staticmethod
    def _binary(node: ast.Call, place: int) -> bool:
        modes = [node.args[place]] if len(node.args) > place else [e.value for e in node.keywords if e.arg == "mode"]
        return any("b" in text_of(each) for each in modes)


def findings(text: str) -> list[tuple[int, str]]:
    walk = Portability()
    walk.body(ast.parse(text).body)
    return sorted(set(walk.found))


def files() -> Iterator[tuple[str, Path]]:
    """All but bus/, and what tests share, by name."""
    for path in sorted(SOURCE.rglob("*.py")):
        if "bus" not in path.relative_to(SOURCE).parts[:1]:
            yield path.relative_to(SOURCE).as_posix(), path
    for path in [*sorted(TESTS.glob("*.py")), *sorted(TESTS.glob("*/conftest.py"))]:
        if not path.name.startswith("test_"):
            yield path.relative_to(TESTS).as_posix(), path


def test_nothing_outside_the_bus_calls_what_only_posix_has() -> None:
    found = [
        f"{name}:{line}: {what}"
        for name, path in files()
        for line, what in findings(path.read_text(encoding="utf-8"))
        if name not in OF_LINUX or ("encoding" in what and "bus" not in name)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import fcntl", "import fcntl"),
        ("from resource import getrusage", "import resource"),
        ("import os\nos.fork()", "os.fork"),
        ("from os import getuid", "os.getuid"),
        ("os.kill(pid, signal.SIGKILL)", "signal.SIGKILL"),
        ("multiprocessing.get_context('fork')", "get_context('fork')"),
        ("Path('/tmp/a')", "the place '/tmp/a'"),
        ("path.read_text()", "read_text without encoding"),
        ("path.write_text(x)", "write_text without encoding"),
        ("open(x)", "open without encoding"),
        ("open(x, 'w')", "open without encoding"),
        ("path.open('w')", "open without encoding"),
        ("subprocess.run(x, text=True)", "subprocess.run of text without encoding"),
        ("subprocess.Popen(x, preexec_fn=f)", "Popen with what only POSIX has"),
        ("path.split('/')", "path.split('/') parts a path by hand"),
        ("if a:\n    os.fork()", "os.fork"),
    ],
)
def test_a_call_of_posix_is_found(text: str, said: str) -> None:
    assert said in [what for _, what in findings(text)]


@pytest.mark.parametrize(
    "text",
    [
        '"""Reads /proc/self."""',
        "if sys.platform == 'linux':\n    os.fork()",
        "def f():\n    if sys.platform == 'win32':\n        return None\n    return os.getuid()",
        "try:\n    import resource\nexcept ImportError:\n    resource = None",
        "x = os.getuid() if hasattr(os, 'getuid') else 0",
        "path.read_text(encoding='utf-8')",
        "open(x, 'rb')",
        "path.open('wb')",
        "unit.split('/')",
        "subprocess.run(x, text=True, encoding='utf-8')",
    ],
)
def test_what_every_system_has_or_was_asked_for_is_allowed(text: str) -> None:
    assert findings(text) == []
