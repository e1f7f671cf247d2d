"""Remakes pictures and tables of docs/explanation/five_axes.md: a held tip, parts of the joints, errors of axes.

python docs/draw_five_axes.py            docs/images/held_tip.svg and tip_joints.svg
python docs/draw_five_axes.py --tables   the waves of location errors; the loops of four machines
"""

import argparse
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

from feeddrive import plot
from feeddrive.files.job import read_job
from feeddrive.files.machine import planned_limits, read_machine
from feeddrive.jobs.run_laws import run_laws
from feeddrive.language.table import Column, Table
from feeddrive.machining import HeldTip, PivotError, TipError, held_tip_test

IMAGES = Path(__file__).parent / "images"
# machine, joint that turns, point (m), travel and position of the other joint (degrees)
TESTS = (
    ("trunnion_ac", "C", (0.05, 0.0, 0.02), 0.0, 360.0, 0.0),
    ("trunnion_ac", "A", (0.0, 0.05, 0.02), -90.0, 30.0, 0.0),
    ("head_table_bc", "C", (0.05, 0.0, 0.02), 0.0, 360.0, 0.0),
    ("head_table_bc", "B", (0.05, 0.0, 0.02), -30.0, 90.0, 0.0),
    ("fork_head_cb", "B", (0.05, 0.0, 0.02), -90.0, 90.0, 0.0),
    ("fork_head_cb", "C", (0.05, 0.0, 0.02), -180.0, 180.0, 20.0),
)
ERROR = 10e-6  # m and rad


def held(test: tuple[str, str, tuple[float, float, float], float, float, float], error: PivotError) -> HeldTip:
    """Return the readings of one of the tests, with an error of the joint that turns."""
    name, joint, tip, begin, end, other = test
    file = read_machine(name)
    assert file.kinematics is not None
    return held_tip_test(
        file.machine(),
        file.kinematics,
        planned_limits(file, None),
        joint,
        tip,
        begin=math.radians(begin),
        end=math.radians(end),
        held=math.radians(other),
        speed=2.0,
        errors={joint: error},
    )


def waves() -> Iterator[list[str]]:
    """Yield the waves of each error in each test: radial / tangential / axial, um."""
    for test in TESTS:
        row = [f"{test[0]}, {test[1]}"]
        for kind in ("shift", "tilt"):
            for axis in range(3):
                error = [ERROR if k == axis else 0.0 for k in range(3)]
                x, y, z = error
                found = held(test, PivotError(**{kind: (x, y, z)})).waves_of_geometry.values()
                row.append(" / ".join(f"{1e6 * wave.amplitude:.2f}" for wave in found))
        yield row


def tip(machine: str) -> TipError:
    """Return the error of the tip along s_curve_vectors on a machine."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "j.toml"
        path.write_text(f'machine = "{machine}"\n[program]\nfile = "s_curve_vectors.ngc"\n', encoding="utf-8")
        found = run_laws(read_job(path)).parts["today"].tip
    assert found is not None
    return found


def main() -> None:
    """Read the options."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--tables", action="store_true")
    if options.parse_args().tables:
        heads = [Column("machine, joint"), *(f"E_{name}" for name in ("X0", "Y0", "Z0", "A0", "B0", "C0"))]
        print(Table("Waves of 10 um or 10 urad, radial / tangential / axial", heads, list(waves())))
        for machine in ("trunnion_ac", "head_table_bc", "fork_head_cb", "nutating_head_bc"):
            found = tip(machine)
            print(machine, f"95 % within {1e6 * found.contour.within():.1f} um", found.table(), sep="\n")
        return
    error = PivotError((20e-6, 0.0, 0.0), (100e-6, 0.0, 0.0))
    pictures = {"held_tip": plot.held_tip(held(TESTS[0], error)), "tip_joints": plot.tip_joints(tip("fork_head_cb"))}
    for name, figure in pictures.items():
        figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
