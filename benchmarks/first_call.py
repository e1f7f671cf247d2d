"""The first run in a fresh process: from a loop to native code, without and with the machine code on disk.

    python benchmarks/first_call.py [--processes 15]

Each figure is the median over fresh processes of the CPU time after the imports.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

BARS = {"cold": 60.0, "from disk": 15.0}  # ms


def child(what: str) -> None:
    """One fresh process: the parts of a first call, or the first `simulate`, in ms of CPU time."""
    begun = time.process_time()
    import llvmlite.binding  # noqa: F401
    import workload

    from feeddrive.language.machine_code import target
    from feeddrive.loop.engine import llvm as native
    from feeddrive.loop.engine import llvm as time_loop
    from feeddrive.loop.engine.plan import plan
    from feeddrive.loop.runner import Prepared, Work, gathering
    from feeddrive.loop.simulate import simulate

    marks = {"imports": time.process_time() - begun}
    last = time.process_time()

    def mark(name: str) -> None:
        nonlocal last
        now = time.process_time()
        marks[name], last = now - last, now

    target()
    mark("processor")
    loop, reference = workload.loop(), workload.reference()
    mark("blocks")
    if what == "simulate":
        simulate(loop, reference, record=workload.RECORD)
        mark("first simulate()")
        simulate(loop, reference, record=workload.RECORD)
        mark("second simulate()")
    else:
        prepared = Prepared(loop, Work(loop, reference).first())
        mark("numbers")
        program = gathering(prepared.program(load=False, enable=False), (), ["tracking_error"])
        mark("trace")
        made = plan(program.keeping(workload.RECORD))
        mark("plan")
        text = time_loop.text(made, "feeddrive_run", target()[0])
        mark("text")
        native.Native(made, text)
        mark("machine code")
    print(json.dumps({name: 1e3 * span for name, span in marks.items()}))


def measure(what: str, cache: str) -> dict[str, float]:
    """What a fresh process says."""
    line = [sys.executable, __file__, "--child", what]
    done = subprocess.run(
        line, capture_output=True, text=True, check=True, env={**os.environ, "FEEDDRIVE_CACHE": cache}
    )
    return json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--processes", type=int, default=15)
    parser.add_argument("--child", choices=("parts", "simulate"))
    given = parser.parse_args()
    if given.child:
        child(given.child)
        return
    import rounds

    print(rounds.machine() + "\n")
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for _ in range(given.processes):
        for what in ("parts", "simulate"):
            with tempfile.TemporaryDirectory() as cache:
                os.chmod(cache, 0o700)
                for state in ("cold", "from disk"):
                    found.setdefault((what, state), []).append(measure(what, cache))
    for what in ("parts", "simulate"):
        names = list(found[what, "cold"][0])
        rows = []
        for name in names:
            both = [statistics.median(each[name] for each in found[what, state]) for state in BARS]
            rows.append([name, *(f"{value:.1f}" for value in both)])
        if what == "parts":
            totals = [
                statistics.median(sum(each.values()) - each["imports"] for each in found[what, state]) for state in BARS
            ]
            rows.append(["**all without imports**", *(f"**{value:.1f}**" for value in totals)])
            rows.append(["bar", *(f"{value:.0f}" for value in BARS.values())])
        rounds.table([f"ms of CPU time ({what})", *BARS], rows)


if __name__ == "__main__":
    main()
