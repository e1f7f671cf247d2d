"""Every limit of the readers and writers of files, with a case on either side of it."""

from __future__ import annotations

import io
import os
import struct
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.io
from mdf_files import mdf4

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.files import growing
from feeddrive.files.columns import Column, check_size, check_unpacked
from feeddrive.files.growing import GrowingFile, GrowingTable, Grown, Pipe
from feeddrive.files.handover import read_comp_file, write_mat
from feeddrive.files.log import Log, remarks
from feeddrive.files.machine import read_machine
from feeddrive.files.mapping import Mapping
from feeddrive.files.part_program import NotPlannedError, PartProgramSection, planned_program
from feeddrive.files.read_log import checked_clock, read_log, refuse_others
from feeddrive.files.readers import ast_xml
from feeddrive.files.readers.arrays import read_here, read_mat, read_npy
from feeddrive.files.readers.ast_xml import ast_tables
from feeddrive.files.readers.mdf import Blocks, DamagedError, read_mdf
from feeddrive.files.readers.text_files import is_epos, is_twincat, read_csv
from feeddrive.files.readers.uff import sets_of
from feeddrive.files.section import to_toml
from feeddrive.language.errors import FileError, LogError, ParameterError

GB, MB = 10**9, 10**6
CSV = b"t,x\n0,1\n1,2\n2,3\n"


def accepts(action: Callable[[], object], refusal: str, kind: type[Exception] = LogError) -> bool:
    """True if the action succeeds, False if it is refused with these words."""
    try:
        action()
    except kind as error:
        if refusal not in str(error):
            raise
        return False
    return True


# size in memory and on disk


@pytest.mark.parametrize(
    ("unpacked", "packed", "is_read"),
    [
        (90 * MB, 1000, True),  # up to 100 MB whatever the file has
        (110 * MB, 1000, False),
        (280 * MB, 2 * MB, True),  # and 100 times its size
        (320 * MB, 2 * MB, False),
        (1.9 * GB, GB, True),
        (2.1 * GB, GB, False),
    ],
)
def test_a_file_is_unpacked_to_a_hundred_times_its_size_and_to_2_gb(unpacked: float, packed: int, is_read: bool):
    assert accepts(lambda: check_unpacked("a", int(unpacked / 8), packed), "is damaged or a zip bomb") is is_read


@pytest.mark.parametrize(("rows", "is_read"), [(39 * MB, True), (41 * MB, False)])
def test_ten_columns_may_have_40_million_rows(rows: int, is_read: bool):
    assert accepts(lambda: check_size("a", 10, rows), "numbers that are read") is is_read


class Sized(bytes):
    """A short content that claims the length of a long one, which no test can afford."""

    claimed: int

    def __len__(self) -> int:
        return self.claimed


def sized(content: bytes, length: int) -> bytes:
    claiming = Sized(content)
    claiming.claimed = length
    return claiming


class FewSets:
    """In place of pyuff.UFF: a universal file with as many functions as its content has bytes."""

    def __init__(self, path: str) -> None:
        self.count = Path(path).stat().st_size

    def get_set_types(self) -> list[int]:
        return [58] * self.count

    def read_sets(self, place: int) -> dict[str, object]:
        return {"num_pts": 2, "data": np.zeros(2), "x": np.arange(2), "id1": f"{place}"}


AST = '<a><FrequencyResponseFunction name="m_pPlant">{}</FrequencyResponseFunction></a>'.format(
    "".join(
        f'<NumericArray name="{member}" elementtype="{kind}" format="CSV"><raw name="m_pNumberArray">{row}</raw>'
        "</NumericArray>"
        for member, kind, row in (("m_ValueVector", "complex", "1,0,1,0"), ("m_FrequencyVector", "double", "1,2"))
    )
)
SIZES = {
    "text": (lambda content: read_csv("a", content, None), CSV, 500 * MB),
    "MDF4": (lambda content: read_mdf("a", content, None), mdf4({"x": np.arange(9.0)}, 1e-3), 200 * MB),
    "XML": (lambda content: list(ast_tables("a", content)), AST.encode(), 100 * MB),
    "UFF": (lambda content: sets_of("a", content), b"12", 50 * MB),
}


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("kind", SIZES)
def test_a_file_of_each_format_may_have_its_size(kind: str, share: float, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pyuff", SimpleNamespace(UFF=FewSets))
    read, content, most = SIZES[kind]
    assert accepts(lambda: read(sized(content, int(share * most))), "more than the") is (share < 1.0)


@pytest.mark.parametrize(("count", "is_read"), [(900, True), (1000, True), (1001, False)])
def test_a_universal_file_may_have_a_thousand_functions(count: int, is_read: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pyuff", SimpleNamespace(UFF=FewSets))
    assert accepts(lambda: sets_of("a", bytes(count)), "more than the 1000 that are read") is is_read


@pytest.mark.parametrize(("count", "is_read"), [(900, True), (1100, False)])
def test_the_xml_of_a_tuning_tool_may_have_a_thousand_responses(count: int, is_read: bool):
    content = f"<b>{AST * count}</b>".encode()
    assert accepts(lambda: list(ast_tables("a", content)), "more than 1000 responses") is is_read


@pytest.mark.parametrize(("count", "refusal"), [(180_000, "without a measured response"), (220_000, "more than 50")])
def test_xml_may_have_two_hundred_thousand_elements(count: int, refusal: str, monkeypatch: pytest.MonkeyPatch):
    """One element stands for all, which would take seconds."""
    element = ast_xml.Element("", {})
    element.children = SimpleNamespace(append=lambda _: None)
    element.walk = lambda: iter(())
    monkeypatch.setattr(ast_xml, "Element", lambda *_: element)
    with pytest.raises(LogError, match=refusal):
        list(ast_tables("a", b"<a>" + b"<b/>" * count + b"</a>"))


@pytest.mark.parametrize(("size", "is_toml"), [(3.9 * MB, True), (4.1 * MB, False)])
def test_a_text_is_toml_up_to_the_size_that_the_reader_of_toml_takes(size: float, is_toml: bool):
    content = b"a = 1\n#" + b"x" * int(size) + b"\n"
    assert accepts(lambda: refuse_others("a", content, ""), "is a TOML file") is not is_toml


@pytest.mark.parametrize(("size", "is_read"), [(0.9 * MB, True), (1.1 * MB, False)])
def test_a_compensation_file_may_have_a_megabyte(size: float, is_read: bool, tmp_path: Path):
    """256 rows have 30 kB."""
    path = tmp_path / "x.comp"
    path.write_bytes(b"0 0 0\n1 1 1\n" + b" " * int(size))
    assert accepts(lambda: read_comp_file(path), "is it the right file?", FileError) is is_read


# structures within structures, chains of blocks, heads


def nested(depth: int) -> dict[str, object]:
    return {"s": nested(depth - 1)} if depth else {"x": np.arange(5.0)}


@pytest.mark.parametrize(("depth", "names"), [(8, {".".join("ssssssssx")}), (9, set())])
def test_eight_structures_within_each_other_are_opened(depth: int, names: set[str]):
    file = io.BytesIO()
    scipy.io.savemat(file, nested(depth))
    columns = read_mat("a", file.getvalue(), None)
    assert set(columns.values) == names
    assert columns.left_out == ({} if names else {".".join("s" * 9): "inside more than 8 structures"})
    file = io.BytesIO()
    with h5py.File(file, "w") as written:
        written["/".join("s" * depth + "x")] = np.arange(5.0)
    columns = read_here("a", file.getvalue(), None)
    assert set(columns.values) == names
    assert columns.left_out == ({} if names else {".".join("s" * 9): "inside more than 8 groups"})


@pytest.mark.parametrize(("fields", "is_read"), [(500, True), (700, False)])  # of 17 letters each
def test_the_head_of_a_numpy_file_may_have_ten_thousand_letters(fields: int, is_read: bool):
    file = io.BytesIO()
    np.save(file, np.zeros(3, dtype=[(f"x{k:03d}", "<f8") for k in range(fields)]))
    assert accepts(lambda: read_npy("a", file.getvalue(), None), "is a numpy file that cannot be read") is is_read


@pytest.mark.parametrize(("count", "is_read"), [(90_000, True), (110_000, False)])
def test_a_chain_of_mdf4_may_have_a_hundred_thousand_blocks(count: int, is_read: bool):
    head = np.dtype([("kind", "S4"), ("free", "<u4"), ("length", "<u8"), ("links", "<u8"), ("next", "<u8")])
    chain = np.zeros(count, head)
    chain["kind"], chain["length"], chain["links"] = b"##CN", head.itemsize, 1
    chain["next"][:-1] = 64 + head.itemsize * np.arange(1, count)
    blocks = Blocks("a", bytes(64) + chain.tobytes())
    assert accepts(lambda: deque(blocks.chain(64, b"##CN"), maxlen=0), "", DamagedError) is is_read


@pytest.mark.parametrize(("count", "is_read"), [(90_000, True), (110_000, False)])
def test_a_block_of_mdf4_may_have_a_hundred_thousand_links(count: int, is_read: bool):
    blocks = Blocks("a", struct.pack("<4s4xQQ", b"##DL", 24 + 8 * count, count) + bytes(8 * count))
    assert accepts(lambda: blocks.at(0, b"##DL"), "", DamagedError) is is_read


@pytest.mark.parametrize(("size", "is_one"), [(3000, True), (6000, False)])
def test_a_recording_of_epos_studio_says_so_in_its_first_four_kilobytes(size: int, is_one: bool):
    assert is_epos(b"x" * size + b"\nEPOS Studio Version:;3.6.1.0\n") is is_one


@pytest.mark.parametrize(("size", "is_one"), [(1.5 * MB, True), (3.0 * MB, False)])
def test_an_export_of_twincat_has_its_heads_in_the_first_two_megabytes(size: float, is_one: bool):
    assert is_twincat(b"Name\t" + b"x" * int(size) + b"\nSampleTime[ms]\t1\n") is is_one


# text


@pytest.mark.parametrize(("remark", "is_read"), [(250, True), (450, False)])
def test_rows_of_numbers_are_sought_in_the_first_four_hundred_lines(remark: int, is_read: bool):
    content = "some words\n" * remark + "".join(f"{k},{k + 1}\n" for k in range(500))
    assert accepts(lambda: read_csv("a", content.encode(), None), "holds no rows of numbers") is is_read


@pytest.mark.parametrize(("count", "is_read"), [(1000, True), (2000, False)])
def test_a_line_may_have_twenty_thousand_letters(count: int, is_read: bool):
    content = (",".join(["0.123456789012"] * count) + "\n") * 5

    def read() -> None:
        assert len(read_csv("a", content.encode(), None).values) == count

    assert accepts(read, "cells, the lines above") is is_read


def test_a_table_has_six_numbers_in_a_line_of_a_machine_file():
    def lines(count: int) -> list[str]:
        rows = np.arange(float(count))
        text = to_toml(PitchCompensation(forward=rows, backward=rows, table_start=0.0, spacing=1.0))
        forward = text.partition("forward = [")[2].partition("]")[0]
        return [line.strip() for line in forward.split("\n") if line.strip()]

    assert lines(6) == ["0.0, 1.0, 2.0, 3.0, 4.0, 5.0"]
    assert lines(8) == ["0.0, 1.0, 2.0, 3.0, 4.0, 5.0,", "6.0, 7.0,"]


def test_a_name_in_a_matlab_file_has_63_letters_as_matlab_allows(tmp_path: Path):
    time = 1e-3 * np.arange(4)
    channels = {"a" * 63: time, "b" * 64: time}
    log = Log(name="x", time=time, channels=channels, units=dict.fromkeys(channels, "m"), sample_time=1e-3)
    write_mat(tmp_path / "a.mat", log)
    assert {"a" * 63, "b" * 63} <= set(scipy.io.loadmat(tmp_path / "a.mat"))


# the clock and the numbers of a log


@pytest.mark.parametrize(("share", "is_read"), [(0.07, True), (0.15, False)])
def test_a_step_may_differ_from_the_sample_time_by_a_tenth(share: float, is_read: bool):
    time = 1e-3 * np.arange(1000)
    time[500:] += 1e-3 * share
    assert accepts(lambda: checked_clock("a", time, str), "the clock is not uniform") is is_read


@pytest.mark.parametrize(("number", "is_read"), [("0.7e30", True), ("-0.7e30", True), ("1.5e30", False)])
def test_a_number_of_a_log_may_have_thirty_digits(number: str, is_read: bool, tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(f"t_ms,x\n0,1\n1,{number}\n2,3\n", encoding="utf-8")
    assert accepts(lambda: read_log(path), "as no measured quantity does") is is_read


@pytest.mark.parametrize(("seconds", "is_read"), [(0.7e9, True), (1.5e9, False)])
def test_a_sample_time_is_less_than_30_years(seconds: float, is_read: bool):
    columns = {"force": Column(name="f")}
    assert accepts(lambda: Mapping(columns, sample_time=seconds), "must be > 0 s", ParameterError) is is_read


# what is remarked on a channel


def clipped(levels: int = 100, *, length: int = 8, times: int = 3, last: float = 1.0) -> np.ndarray:
    """Rise in steps of 1 to `levels` - 1, stay for `length` samples, and fall; the last whole step has size `last`.

    The first step is smaller, since readings are finer than a step.
    """
    rise = np.arange(levels - 1.0)
    rise[0] = 0.95
    rise[-1] = rise[-2] + last
    return np.tile(np.concatenate([rise, np.full(length, levels - 1.0), rise[:0:-1]]), times)


@pytest.mark.parametrize(
    ("signal", "is_clipped"),
    [
        (clipped(), True),
        (clipped(length=5), True),
        (clipped(length=3), False),  # the flat top of a sine
        (clipped(times=2), True),
        (clipped(times=1), False),  # an end stop
        (clipped(40), True),
        (clipped(25), False),  # a selector
        (clipped(last=0.3), True),
        (clipped(last=0.15), False),  # a position that comes to rest
    ],
)
def test_a_signal_is_clipped_if_it_meets_its_extreme_at_speed_and_stays(signal: np.ndarray, is_clipped: bool):
    assert any("is clipped: it stays at its largest value" in text for text in remarks({"x": signal})) is is_clipped


@pytest.mark.parametrize(
    ("steps", "is_clipped"),
    [
        ((3, 3, 2, 2, 1), False),  # by the last whole step alone, two counts, it would stop abruptly
        ((3, 3, 2, 1, 1), False),
        ((3, 3, 3, 3, 3), True),
        ((3, 3, 3, 3, 1), True),  # the last step in part
        ((3, 2, 3, 2, 2), True),
    ],
)
def test_a_position_in_counts_that_slows_down_to_its_extreme_is_not_clipped(steps: tuple[int, ...], is_clipped: bool):
    ramp = np.cumsum([1, 1, *[3] * 30, *steps])
    signal = np.tile(np.concatenate([ramp, np.full(8, ramp[-1]), ramp[::-1]]), 2).astype(float)
    assert any("is clipped: it stays at its largest value" in text for text in remarks({"x": signal})) is is_clipped


@pytest.mark.parametrize(("others", "is_slow"), [(1, True), (20, False)])
def test_a_channel_is_slow_if_nearly_all_changes_lie_on_one_grid(others: int, is_slow: bool):
    """A hundred gaps of five samples, and `others` of three among them."""
    gaps = np.insert(np.full(100, 5), np.arange(others) * 5, 3)
    signal = np.repeat(np.arange(gaps.size, dtype=float), gaps)
    assert any("changes only at every 5th sample" in text for text in remarks({"x": signal})) is is_slow


# tables that grow


@pytest.mark.parametrize(("size", "from_begin"), [(7 * MB, True), (9 * MB, False)])
def test_of_a_growing_file_the_last_eight_megabytes_are_read(size: int, from_begin: bool, tmp_path: Path):
    path = tmp_path / "run.csv"
    path.write_bytes(b"1.234567,2.345678\n" * (size // 18))
    grown = GrowingFile(path).read()
    assert grown.begins is from_begin
    assert len(grown.content) % 18 == 0


@pytest.mark.parametrize(("place", "is_anew"), [(10, False), (80, True)])
def test_a_growing_file_is_another_one_if_its_last_64_bytes_changed(place: int, is_anew: bool, tmp_path: Path):
    """Of 120 bytes; a recorder may correct the number of rows in its head."""
    path = tmp_path / "run.csv"
    path.write_bytes(b"1,2\n" * 30)
    follower = GrowingFile(path)
    follower.read()
    with path.open("r+b") as file:
        file.seek(place)
        file.write(b"9")
        file.seek(0, os.SEEK_END)
        file.write(b"3,4\n")
    grown = follower.read()
    assert grown.anew is is_anew
    assert len(grown.content) == (124 if is_anew else 4)


@pytest.mark.parametrize(("size", "is_lost"), [(20 * MB, False), (40 * MB, True)])
def test_a_pipe_keeps_16_to_32_megabytes(size: int, is_lost: bool, tmp_path: Path):
    with (tmp_path / "pipe").open("w+b") as stream:
        stream.truncate(size)
        pipe = Pipe(stream)
        pipe._thread.join()
    content, end, lost = pipe.since(0)
    assert (end, lost) == (size, is_lost)
    assert 16 * MB <= len(content) <= 32 * MB


def test_after_a_second_without_rows_a_growing_table_says_so(monkeypatch: pytest.MonkeyPatch):
    now = [100.0]
    monkeypatch.setattr(growing, "clock", SimpleNamespace(monotonic=lambda: now[0]))
    rows = SimpleNamespace(
        name="a", head=lambda: CSV, waits=lambda: "", read=lambda: Grown(b"" if now[0] > 100.0 else CSV, True)
    )
    table = GrowingTable(rows)
    table.take()
    now[0] += 0.8
    assert table.state() == "rows come"
    now[0] += 0.7
    assert "no new rows for" in table.state()


# part programs


@pytest.mark.parametrize(("count", "is_held"), [(3.5 * MB, True), (4.5 * MB, False)])
def test_a_job_holds_four_million_samples_of_a_program(
    count: float, is_held: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 F100\nM2\n", encoding="utf-8")
    machine = read_machine("mill")
    few = SimpleNamespace(
        values=np.zeros((2, len(machine.loops), 5)), feed=np.ones(2), line=np.ones(2, np.int32), proven=True
    )

    def planned(setpoints: object, _name: str, _machine: str, keep: Callable[..., None]) -> object:
        keep(few, ())
        return SimpleNamespace(blocks=1, cycle_time=1.0, kinematics=None)

    # they are imported where a program is planned
    monkeypatch.setattr("feeddrive.path.setpoints.Setpoints", lambda *_: SimpleNamespace(samples=int(count)))
    monkeypatch.setattr("feeddrive.path.planned.planned_of", planned)
    section = PartProgramSection(file="p.ngc")
    assert (
        accepts(
            lambda: planned_program(section, tmp_path / "job.toml", machine),
            "4,000,000 samples, which a job does not hold",
            NotPlannedError,
        )
        is is_held
    )
