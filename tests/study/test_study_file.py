"""Study files: what is read, what is refused, and what variants come to."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.study import Study, read_study, variant_groups, variants
from feeddrive.study.study import MOST

HEAD = """job = "ball_screw"
sampler = "monte_carlo"
count = 64
seed = 3
measure = ["following_error_rms_m"]
"""
MASS = '[[vary]]\nparameter = "axis.x.plant.mass_load"\n'


def study_of(tmp_path: Path, text: str, head: str = HEAD) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(head + text, encoding="utf-8")
    return read_study(path)


def drawn(tmp_path: Path, text: str, head: str = HEAD) -> dict[str, np.ndarray]:
    return dict(variants(study_of(tmp_path, text, head)).values)


def test_units_stand_in_the_keys(tmp_path: Path) -> None:
    text = '[[vary]]\nparameter = "axis.x.plant.stiffness"\nnominal_N_per_um = 20\ntolerance_percent = 10\n'
    (values,) = drawn(tmp_path, text).values()
    assert 18e6 <= values.min() < 18.3e6
    assert 21.7e6 < values.max() <= 22e6
    (other,) = drawn(tmp_path, text.replace("tolerance_percent = 10", "tolerance_MN_per_m = 2")).values()
    assert np.array_equal(values, other)


def test_nominal_is_the_value_of_the_machine(tmp_path: Path) -> None:
    (values,) = drawn(tmp_path, MASS + "tolerance_kg = 3\n").values()
    assert np.all(np.abs(values - 33.0) <= 3.0)
    assert np.ptp(values) > 5.0


def test_a_factor_scales_and_a_payload_is_added(tmp_path: Path) -> None:
    text = """[[vary]]
name = "wear"
scale = ["axis.x.friction_motor.coulomb", "axis.x.friction_motor.breakaway"]
least = 0.5
most = 2
[[vary]]
name = "payload"
add = ["axis.x.plant.mass_load"]
least_kg = 0
most_kg = 20
"""
    study = study_of(tmp_path, text)
    assert dict(study.columns) == {"wear": "", "payload": "kg"}
    made = variants(study)
    (case,) = variant_groups(study, made)
    assert np.array_equal(case.changes["axis.x.friction_motor.coulomb"], 70.0 * made.values["wear"])
    assert np.array_equal(case.changes["axis.x.friction_motor.breakaway"], 110.0 * made.values["wear"])
    assert np.array_equal(case.changes["axis.x.plant.mass_load"], 33.0 + made.values["payload"])
    third = case.one(3)
    assert tree.get(third, "axis.x.plant.mass_load") == 33.0 + made.values["payload"][3]


def test_a_covariance_gives_its_moments(tmp_path: Path) -> None:
    """20000 draws: means and covariances within 4 standard errors; of normal ones √((s_ii s_jj + s_ij²)/n)."""
    text = """[[vary]]
name = "identified"
parameters = ["axis.x.plant.mass_load", "axis.x.friction_motor.coulomb"]
covariance = [[0.25, 0.3], [0.3, 4.0]]
"""
    found = np.array(list(drawn(tmp_path, text, HEAD.replace("64", "20000")).values()))
    true, n = np.array([[0.25, 0.3], [0.3, 4.0]]), found.shape[1]
    assert np.all(np.abs(found.mean(axis=1) - [33.0, 70.0]) < 4.0 * np.sqrt(np.diag(true) / n))
    error = np.sqrt((np.outer(np.diag(true), np.diag(true)) + true**2) / n)
    assert np.all(np.abs(np.cov(found) - true) < 4.0 * error)
    other = """[[vary]]
name = "identified"
parameters = ["axis.x.plant.mass_load", "axis.x.friction_motor.coulomb"]
deviations = [0.5, 2]
correlations = [[1, 0.3], [0.3, 1]]
"""
    assert np.allclose(np.array(list(drawn(tmp_path, other, HEAD.replace("64", "20000")).values())), found, rtol=1e-12)


def test_settings_go_together(tmp_path: Path) -> None:
    text = """[[vary]]
name = "position"
parameters = ["axis.x.plant.stiffness_N_per_um", "axis.x.plant.damping"]
settings = { near = [21, 800], far = [15, 600] }
"""
    study = study_of(tmp_path, text)
    made = variants(study)
    assert set(made.values["position"]) == {"near", "far"}
    (case,) = variant_groups(study, made)
    near = made.values["position"] == "near"
    assert np.array_equal(case.changes["axis.x.plant.stiffness"], np.where(near, 21e6, 15e6))
    assert np.array_equal(case.changes["axis.x.plant.damping"], np.where(near, 800.0, 600.0))


def test_a_grid_has_all_combinations_and_its_ends(tmp_path: Path) -> None:
    head = 'job = "ball_screw"\nsampler = "grid"\nmeasure = ["force_rms_N"]\n'
    text = MASS + 'least = 30\nmost = 36\nsteps = 3\n[[vary]]\nparameter = "reference.velocity"\nvalues = [0.5, 1]\n'
    study = study_of(tmp_path, text, head)
    assert study.count == 6
    made = variants(study).values
    assert made["axis.x.plant.mass_load"].tolist() == [30, 30, 33, 33, 36, 36]
    assert made["reference.velocity"].tolist() == [0.5, 1.0] * 3


def test_what_changes_the_work_makes_cases(tmp_path: Path) -> None:
    text = MASS + 'tolerance = 3\n[[vary]]\nparameter = "reference.velocity"\nvalues = [0.5, 1]\n'
    text += '[[vary]]\nparameter = "load.force_N"\nleast = -200\nmost = -100\n'.replace("_N", "")
    study = study_of(tmp_path, text)
    made = variants(study)
    found = list(variant_groups(study, made))
    assert len(found) == 64
    assert sorted(int(each.rows[0]) for each in found) == list(range(64))
    for case in found:
        (row,) = case.rows
        assert case.references.velocity == made.values["reference.velocity"][row]
        assert case.loads.force == made.values["load.force"][row]
        assert case.speed == pytest.approx(0.5 * case.references.velocity, rel=1e-3)


def test_choices_are_read_into_job_and_machine(tmp_path: Path) -> None:
    text = """[[vary]]
choice = "row"
values = ["today", "inertia 20 % too small"]
[[vary]]
choice = "axis.x.substeps"
values = [1, 3]
[[vary]]
choice = "reference.back"
values = [true, false]
"""
    study = study_of(tmp_path, text)
    made = variants(study).values
    found = {}
    for case in variant_groups(study, variants(study)):
        key = tuple(made[name][case.rows[0]] for name in ("row", "axis.x.substeps", "reference.back"))
        found[key] = case
        mass = tree.get(case.system, "axis.x.control.feedforward.0.mass")
        assert (mass, case.system.axis.substeps, case.references.back) == (
            163.0 if key[0] == "today" else 130.4,
            key[1],
            key[2],
        )
    assert len(found) == 8
    assert sum(case.rows.size for case in found.values()) == 64


def test_noise_of_its_own(tmp_path: Path) -> None:
    study = study_of(tmp_path, MASS + "tolerance = 3\n", HEAD + 'noise = "each"\n')
    (case,) = variant_groups(study, variants(study, 16, 8))
    assert case.seed.tolist() == [1.0 + number for number in range(16, 24)]  # the job's seed is 1
    (same,) = variant_groups(replace(study, noise="same"), variants(study, 16, 8))
    assert same.seed.tolist() == [1.0] * 8


def test_a_study_may_be_its_own_job(tmp_path: Path) -> None:
    head = 'machine = "ball_screw"\ncount = 4\nmeasure = ["force_rms_N"]\n'
    text = MASS + 'tolerance = 3\n[reference]\nkind = "linear_move"\ndistance_mm = 10\ntravel_time = 1\n'
    study = study_of(tmp_path, text, head)
    assert study.base({}).job.reference.kind == "linear_move"


@pytest.mark.parametrize("sampler", ["monte_carlo", "latin_hypercube", "sobol", "saltelli"])
def test_variants_do_not_depend_on_the_split(sampler: str) -> None:
    study = read_study("ball_screw_series")
    study = replace(study, sampler=sampler, points=256, count=256 * 8 if sampler == "saltelli" else 256)
    whole = variants(study)
    for first, count in ((0, 1), (7, 100), (200, 56)):
        part = variants(study, first, count)
        for name, values in part.values.items():
            assert np.array_equal(values, whole.values[name][first : first + count])
    fresh = variants(replace(study, stream=1)).values
    assert not any(np.any(values == whole.values[name]) for name, values in fresh.items())


def test_a_study_survives_pickling_with_its_digest() -> None:
    study = read_study("ball_screw_series")
    again = pickle.loads(pickle.dumps(study))
    assert again.digest == study.digest == read_study("ball_screw_series").digest
    assert np.array_equal(variants(again).values["wear"], variants(study).values["wear"])


def test_the_digest_follows_the_machine(tmp_path: Path) -> None:
    machine = (Path(tree.__file__).parents[1] / "files/bundled/machines/ball_screw.toml").read_text(encoding="utf-8")
    head = 'machine = "mine.toml"\ncount = 4\nmeasure = ["force_rms_N"]\n'
    text = MASS + 'tolerance = 3\n[reference]\nkind = "linear_move"\ndistance_mm = 10\ntravel_time = 1\n'
    digests = []
    for content in (
        machine,
        machine + "# a remark\n",
        machine.replace("mass_motor_kg = 85", "mass_motor_kg = 85.0001"),
    ):
        (tmp_path / "mine.toml").write_text(content, encoding="utf-8")
        digests.append(study_of(tmp_path, text, head).digest)
    assert digests[0] == digests[1] != digests[2]


GOOD = MASS + "tolerance = 3\n"
BAD = {
    "nothing varies": (HEAD, "", "a study needs a section [[vary]]"),
    "no such parameter": (HEAD, '[[vary]]\nparameter = "axis.x.plant.mas_load"\n', ":7: vary.0.parameter: there is no"),
    "no such part of the work": (HEAD, '[[vary]]\nparameter = "reference.speed"\nvalues = [1]\n', "there is no"),
    "no variants": (
        HEAD.replace("64", "0"),
        GOOD,
        ":3: count = 0 (variants; of saltelli points of k + 2 variants; none of a grid) must be >= 1",
    ),
    "too many": (HEAD.replace("64", "1000000000000"), GOOD, ":3: these are 1,000,000,000,000 variants, more than"),
    "half a variant": (HEAD.replace("64", "1.5"), GOOD, "none of a grid) must be a whole number"),
    "count of a grid": (HEAD.replace("monte_carlo", "grid"), MASS + "values = [1]\n", "count does not go with a grid"),
    "unknown sampler": (
        HEAD.replace("monte_carlo", "halton"),
        GOOD,
        ":2: sampler = 'halton' (how variants are drawn) must be one of \"grid\"",
    ),
    "unknown key": (HEAD + "cout = 3\n", GOOD, "key 'cout' is not known; did you mean"),
    "unknown distribution": (HEAD, MASS + 'kind = "gauss"\n', ":8: kind = 'gauss' is no distribution"),
    "bounds the wrong way": (HEAD, MASS + "least = 40\nmost = 30\n", "least = 40 of a uniform distribution must be"),
    "impossible mass": (HEAD, MASS + "tolerance_percent = 120\n", "-6.6 kg (table and workpiece) must be > 0 kg"),
    "impossible deviation": (HEAD, MASS + 'kind = "normal"\ndeviation = -1\n', "deviation = -1 of a normal"),
    "another dimension": (
        HEAD,
        MASS + "tolerance_mm = 3\n",
        ":8: key 'vary.0.tolerance_mm' is not known; if tolerance is meant: unit 'mm' does",
    ),
    "a key of another kind": (HEAD, MASS + "tolerance = 3\ndeviation = 1\n", "'vary.0.deviation' is not known"),
    "both": (HEAD, MASS + "tolerance = 3\nmost = 40\n", "give either a tolerance, or least and most"),
    "twice": (HEAD, GOOD + GOOD, "'axis.x.plant.mass_load' varies twice"),
    "no numbers at all": (HEAD, MASS, "a uniform distribution needs least and most"),
    "a text": (HEAD, MASS + 'tolerance = "3"\n', "in place of least and most) must be a number without quotes"),
    "no figures": (HEAD.replace("measure", "# "), GOOD, "a study needs figures to measure"),
    "unknown figure": (HEAD.replace("rms_m", "rsm_m"), GOOD, ":5: measure: there is no figure 'following_error_rsm_m'"),
    "empty bound": (HEAD, "[specification]\nforce_rms_N = {}\n" + GOOD, "force_rms_N needs least or most"),
    "bound in another unit": (
        HEAD,
        "[specification]\nforce_rms_N = { most_um = 3 }\n" + GOOD,
        "unit 'um' does not measure",
    ),
    "crossed bounds": (
        HEAD,
        "[specification]\nforce_rms_N = { least = 4, most = 3 }\n" + GOOD,
        "least = 4 must be < most = 3",
    ),
    "no such row": (HEAD + 'row = "tomorrow"\n', GOOD, "row: there is no row 'tomorrow' in"),
    "no such choice": (
        HEAD,
        '[[vary]]\nchoice = "axis.x.substps"\nvalues = [1]\n',
        "with axis.x.substps = 1: ",
    ),
    "no such job": (HEAD.replace('"ball_screw"', '"ball_scrw"'), GOOD, ":1: job: ball_scrw: there is no such file"),
    "a log": (HEAD.replace('"ball_screw"', '"emps_log"'), GOOD, "replays a log, which has one machine"),
    "asymmetric": (
        HEAD,
        '[[vary]]\nname = "a"\nparameters = ["axis.x.plant.mass_load", "axis.x.plant.damping"]\n'
        "covariance = [[1, 0.2], [0.1, 1]]\n",
        "a covariance must be symmetric",
    ),
    "indefinite": (
        HEAD,
        '[[vary]]\nname = "a"\nparameters = ["axis.x.plant.mass_load", "axis.x.plant.damping"]\n'
        "covariance = [[1, 2], [2, 1]]\n",
        "must be positive semidefinite",
    ),
    "steps without a grid": (HEAD, GOOD + "steps = 3\n", "steps belongs to a grid"),
    "points that are no power of 2": (
        HEAD.replace("monte_carlo", "saltelli").replace("64", "100"),
        GOOD,
        "must be a power of 2, such as 64 or 128",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_studies_are_refused_with_file_line_and_key(tmp_path: Path, name: str) -> None:
    head, text, said = BAD[name]
    with pytest.raises(FeeddriveError) as found:
        study_of(tmp_path, text, head)
    assert said in str(found.value)
    assert str(found.value).startswith(str(tmp_path / "study.toml"))
    assert found.value.exit_code == 2


def test_the_largest_study_is_read(tmp_path: Path) -> None:
    study = study_of(tmp_path, GOOD, HEAD.replace("64", str(MOST)))
    assert study.chunks == MOST // 1024
    last = study.range(study.chunks - 1)
    assert len(variants(study, last.start, len(last))) == 1024


def test_a_chunk_that_is_not_there_is_refused() -> None:
    study = read_study("ball_screw_series")
    assert [len(study.range(each)) for each in range(study.chunks)] == [16] * 12 + [8]
    with pytest.raises(ParameterError, match="has chunks 0 to 12, and no 13"):
        study.range(13)
