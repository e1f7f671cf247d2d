"""Laws tuned over the box of an identification, with and without its correlations (docs/explanation/box.md).

python benchmarks/correlated.py [--machine machining_center --axis x --noise 0.05 --late 0]

Two responses of the axis, with noise, are fitted as two masses; the axis is then tuned over two standard errors of the
fit, taken as independent and along the principal axes of their correlations.
"""

from __future__ import annotations

import argparse

import numpy as np

import feeddrive as fd
from feeddrive.comparison.compare import compare_laws
from feeddrive.identification.response.plant_fit import fit_two_mass
from feeddrive.language import tree
from feeddrive.loop.box import Box

PARAMETERS = ("mass_motor", "mass_load", "stiffness")


def main() -> None:
    """Fit, tune and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="machining_center")
    parser.add_argument("--axis", default="x")
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--late", type=int, default=0, help="samples of dead time in the box")
    parser.add_argument("--seed", type=int, default=3)
    asked = parser.parse_args()
    machine = fd.read_machine(asked.machine)
    loop, random = machine.loop(asked.axis), np.random.default_rng(asked.seed)
    f, lines = np.geomspace(5.0, 0.45 / float(loop.sample_time), 120), []
    for name in ("reading_motor", "reading_load"):
        response = fd.linearize(loop, ["cut"], [name]).response(f).response
        size = asked.noise * np.abs(response)
        noise = size * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size)) / np.sqrt(2.0)
        lines.append(fd.FRF(f, response + noise, "force", name, "m/N", float(loop.sample_time), None, size**2))
    fit = fit_two_mass(*lines)
    names = [estimate.name for estimate in fit.estimates]
    places = [names.index(name) for name in PARAMETERS]
    covariance = fit.covariance[np.ix_(places, places)]
    errors = np.sqrt(np.diag(covariance))
    R = covariance / np.outer(errors, errors)
    shares = [error / fit[name].value for name, error in zip(PARAMETERS, errors, strict=True)]
    print("standard errors:", ", ".join(f"{name} {share:.3%}" for name, share in zip(PARAMETERS, shares, strict=True)))
    print("correlations:", np.array2string(R[np.tril_indices(3, -1)], precision=3))
    # around the true axis, of which the controls know the model: only the sizes are those of the fit
    paths = [f"plant.{name}" for name in PARAMETERS]
    true = dict(tree.leaves(loop.axis.plant))
    known = {path: share * float(true[name]) for path, name, share in zip(paths, PARAMETERS, shares, strict=True)}
    ties = {frozenset((paths[i], paths[j])): float(R[i, j]) for i in range(3) for j in range(i)}
    plain = Box(dead_time=asked.late, deviations=2.0)
    boxes = {
        "none": None,
        "independent": plain.with_errors(loop.axis, known, asked.machine),
        "principal axes": plain.with_errors(loop.axis, known, asked.machine, ties),
    }
    print("\n| box | law | rope snap, nm √s/N: model | worst | stiffness at 10 Hz, N/µm: model | worst | |")
    print("|---|---|---|---|---|---|---|")
    for name, box in boxes.items():
        found = compare_laws(machine, asked.axis, laws=["P-PI", "pole placement"], box=box, filters="free")
        for law in found.competitors[1:]:
            pairs = [(figures.get(key), scale) for key, scale in (("rope_snap_ISE_root_m_per_N", 1e9),
                     ("stiffness_10_Hz_N_per_m", 1e-6)) for figures in (law.figures, law.worst)]  # fmt: skip
            cells = ["-" if value is None else f"{value * scale:.4g}" for value, scale in pairs]
            print(f"| {name} | {law.name} | {' | '.join(cells)} | {law.kind or 'ranked'} |", flush=True)


if __name__ == "__main__":
    main()
