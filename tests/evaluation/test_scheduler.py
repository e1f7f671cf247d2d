"""Whom a scheduler lets in: the warning about one that others reach, and the certificates for one with TLS."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from feeddrive.evaluation.cluster import finished
from feeddrive.evaluation.engine import Engine
from feeddrive.evaluation.scheduler import Certificates, exposure
from feeddrive.language.errors import FileError, ParameterError, WorkerError
from feeddrive.language.progress import Progress
from feeddrive.study.study import read_study
from feeddrive.study.sweep import sweep
from feeddrive.workflow.evaluated import EngineRequest
from small_study import small_study

if TYPE_CHECKING:
    from dask_cluster import DaskCluster

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "security.md"
WARNING = "is neither local nor reached by TLS: everyone who reaches its port can run code"
STUDY = small_study(8, 4)


@pytest.mark.parametrize(
    "address",
    [
        "tcp://10.0.0.5:8786",
        "10.0.0.5:8786",
        "tcp://[2001:db8::5]:8786",
        "ws://10.0.0.5:8786",
        "tcp://cluster.example:8786",
        "tcp://localhost.example:8786",
        "tcp://0.0.0.0:8786",  # it listens everywhere, also where the client means this machine
        "tcp://:8786",
    ],
)
def test_a_scheduler_that_others_reach_without_tls_is_warned_of(address: str) -> None:
    assert f"{address} {WARNING}" in exposure(address)


@pytest.mark.parametrize(
    "address",
    [
        "tls://10.0.0.5:8786",
        "TLS://cluster.example:8786",
        "wss://10.0.0.5:8786",
        "tcp://127.0.0.1:8786",
        "127.0.0.1:8786",
        "tcp://127.1.2.3:8786",
        "tcp://[::1]:8786",
        "tcp://localhost:8786",
        "inproc://10.0.0.5/1/1",
    ],
)
def test_one_on_the_loopback_or_with_tls_is_not(address: str) -> None:
    assert exposure(address) == ""


TRAP = """
import feeddrive.evaluation.cluster

class Trap:
    def __reduce__(self):
        return eval, ("__import__('pathlib').Path({file!r}).write_text(str(__import__('os').getpid()))",)

feeddrive.evaluation.cluster._computed = lambda *_: Trap()
"""


class Heard(Progress):
    """Keeps the remarks."""

    def __init__(self) -> None:
        super().__init__()
        self.remarks = list[str]()

    def show_remark(self, message: object) -> None:
        self.remarks.append(str(message))


def test_the_warning_comes_before_anything_is_sent() -> None:
    """Nobody listens at port 1, so that the warning does not depend on an answer."""
    pytest.importorskip("distributed", reason="pip install 'feeddrive[cluster]'")
    for address, warned in (("tcp://0.0.0.0:1", True), ("tcp://127.0.0.1:1", False)):
        heard = Heard()
        with pytest.raises(ParameterError, match="no Dask scheduler answers"):
            next(finished(iter(()), address, heard, timeout=0.1))
        assert [WARNING in remark for remark in heard.remarks] == [True] * warned


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheduler": "tls://10.0.0.5:8786", "tls_cert": "c.pem"}, "belong together: 1 of the three files"),
        ({"scheduler": "tls://10.0.0.5:8786", "tls_ca_file": "a.pem", "tls_key": "c.key"}, "2 of the three files"),
        ({"scheduler": "tcp://10.0.0.5:8786", "tls_cert": "c.pem"}, "'tcp://10.0.0.5:8786' is reached without TLS"),
        ({"tls_cert": "c.pem"}, "no scheduler is given"),
    ],
)
def test_certificates_that_do_not_fit_are_refused(options: dict[str, str], message: str) -> None:
    with pytest.raises(ParameterError, match=re.escape(message)):
        EngineRequest(**options).certificates  # type: ignore[arg-type]  # noqa: B018


def test_certificates_are_named_together_or_not_at_all() -> None:
    assert EngineRequest(scheduler="tls://10.0.0.5:8786").certificates is None
    given = EngineRequest(scheduler="tls://10.0.0.5:8786", tls_ca_file=Path("a"), tls_cert=Path("b"), tls_key=Path("c"))
    assert given.certificates == Certificates(Path("a"), Path("b"), Path("c"))


def test_files_that_are_no_certificates_are_named(tmp_path: Path) -> None:
    """Before a connection is tried."""
    pytest.importorskip("distributed", reason="pip install 'feeddrive[cluster]'")
    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "there.pem").write_text("no certificate", encoding="utf-8")
    for name, message in (("gone.pem", r"gone\.pem: cannot be read"), ("there.pem", r"there\.pem are no certificate")):
        files = Certificates(*[tmp_path / name] * 3)
        with pytest.raises(FileError, match=message):
            sweep(tmp_path / "small.toml", tmp_path / "rows", scheduler="tls://127.0.0.1:1", certificates=files)


def made(folder: Path) -> Path:
    """Certificates by the commands of the page; the folder that holds them."""
    (recipe,) = re.findall(r"^```sh\n(mkdir -m 700 tls.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    subprocess.run(["bash", "-eu", "-c", recipe], cwd=folder, check=True, capture_output=True)
    return folder / "tls"


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("openssl") is None:
        pytest.skip("NOT TESTED: TLS needs openssl: apt-get install openssl")
    return made(tmp_path_factory.mktemp("certificates"))


@pytest.fixture(scope="module")
def cluster(tls: Path, tmp_path_factory: pytest.TempPathFactory):
    from dask_cluster import dask_cluster

    with dask_cluster(tmp_path_factory.mktemp("cluster"), 1, tls=tls) as found:
        yield found


def certificates(folder: Path, name: str = "client") -> Certificates:
    return Certificates(folder / "authority.pem", folder / f"{name}.pem", folder / f"{name}.key")


REASON = "scheduler and worker are processes, which take seconds to begin"


@pytest.mark.slow(reason=REASON)
def test_a_sweep_runs_over_tls_as_the_page_says(cluster: DaskCluster, tls: Path, tmp_path: Path) -> None:
    """The command with the client's certificates; its rows have the bytes of a sweep on this machine."""
    study = tmp_path / "small.toml"
    study.write_text(STUDY, encoding="utf-8")
    words = [sys.executable, "-c", "from feeddrive.cli import main; main()", "sweep", str(study), "--out", "series"]
    words += ["--scheduler", cluster.address, "--tls-ca-file", str(tls / "authority.pem")]
    words += ["--tls-cert", str(tls / "client.pem"), "--tls-key", str(tls / "client.key")]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TLS" not in done.stdout + done.stderr
    sweep(study, tmp_path / "alone", workers=1)
    for chunk in sorted((tmp_path / "alone/rows").iterdir()):
        assert (tmp_path / "series/rows" / chunk.name).read_bytes() == chunk.read_bytes()


@pytest.mark.slow(reason=REASON)
def test_who_has_no_certificate_of_the_authority_is_kept_out(cluster: DaskCluster, tls: Path, tmp_path: Path) -> None:
    """Neither without certificates, nor with those of another authority, nor without TLS."""
    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    study = read_study(tmp_path / "small.toml")
    other = certificates(made(tmp_path))
    plain = cluster.address.replace("tls", "tcp")
    for address, files in ((cluster.address, None), (cluster.address, other), (plain, None)):
        with pytest.raises(ParameterError, match="no Dask scheduler answers at"):
            sweep(study, tmp_path / "rows", scheduler=address, certificates=files)
    # the same study goes through with the right ones
    assert sweep(study, tmp_path / "rows", scheduler=cluster.address, certificates=certificates(tls)).ran == 8


@pytest.mark.slow(reason=REASON)
def test_the_certificate_of_a_client_makes_no_scheduler(tls: Path, tmp_path: Path) -> None:
    """It is for clients alone: who steals it cannot pose as the scheduler, whose answers a client unpickles."""
    from dask_cluster import DaskCluster

    stolen = tmp_path / "stolen"
    stolen.mkdir()
    shutil.copy(tls / "authority.pem", stolen)
    for kind in ("pem", "key"):
        shutil.copy(tls / f"client.{kind}", stolen / f"scheduler.{kind}")
    cluster = DaskCluster(tmp_path, stolen)
    try:
        cluster.start_scheduler()
        log = tmp_path / "scheduler_0.log"
        from dask_cluster import until

        until(lambda: "Scheduler at" in log.read_text(encoding="utf-8"))
        with pytest.raises(ParameterError, match=r"no Dask scheduler answers at.*certificate"):
            next(Engine(scheduler=cluster.address, certificates=certificates(tls)).finished(iter([None])))  # type: ignore[list-item]
    finally:
        cluster.close()


@pytest.mark.slow(reason=REASON)
def test_without_tls_whoever_reaches_the_port_runs_code_on_all_three(tmp_path: Path) -> None:
    """This is what the warning means; the client, this process, unpickles what a worker that was taken over sends."""
    from dask_cluster import dask_cluster

    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    with dask_cluster(tmp_path, 1) as cluster:
        with cluster.client() as foreign:
            assert foreign.run_on_scheduler(eval, "__import__('os').getpid()") == cluster.scheduler.pid
            foreign.run(exec, TRAP.format(file=str(tmp_path / "caught")), {})
        with pytest.raises(WorkerError):
            sweep(tmp_path / "small.toml", tmp_path / "rows", scheduler=cluster.address)
    assert (tmp_path / "caught").read_text(encoding="utf-8") == str(os.getpid())
