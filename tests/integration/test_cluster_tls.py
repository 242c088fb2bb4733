"""A Dask cluster over TLS: its certificates come from Dask's own configuration, and without them
nobody is let in."""

import shutil
import subprocess
from dataclasses import dataclass

import pytest

from pamid.api.options.estimating import FitArguments
from pamid.api.options.record import about_fields
from pamid.base.errors import FileError
from pamid.base.parallel.dask_backend import Patience, cluster
from pamid.base.parallel.jobs import Work, WorkerPool

distributed = pytest.importorskip("distributed", reason="needs pamid[cluster]")


@dataclass(frozen=True)
class Doubled(Work[float, float]):
    what = "double"

    def __call__(self, item: float) -> float:
        return 2.0 * item


@pytest.fixture(scope="module")
def certificates(tmp_path_factory) -> dict[str, str]:
    """Dask's own settings for a cluster over TLS, with a certificate that is its own authority."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl")
    place = tmp_path_factory.mktemp("tls")
    key, certificate = str(place / "key.pem"), str(place / "certificate.pem")
    subprocess.run(
        [
            "openssl",
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:prime256v1",
            "-nodes",
            "-keyout",
            key,
            "-out",
            certificate,
            "-days",
            "2",
            "-subj",
            "/CN=pamid-test",
            "-addext",
            "subjectAltName=IP:127.0.0.1",
        ],
        check=True,
        capture_output=True,
    )
    whose = {
        f"distributed.comm.tls.{who}.{what}": path
        for who in ("client", "scheduler", "worker")
        for what, path in (("cert", certificate), ("key", key))
    }
    return {"distributed.comm.tls.ca-file": certificate, **whose}


def test_over_tls_with_the_certificates_of_dasks_configuration(certificates):
    import dask

    def made(**more):
        return distributed.LocalCluster(
            n_workers=1,
            processes=False,
            threads_per_worker=1,
            dashboard_address=None,
            protocol="tls",
            host="127.0.0.1",
            silence_logs=50,
            **more,
        )

    with dask.config.set(certificates), made(security=distributed.Security()) as ours:
        address = ours.scheduler_address
        assert address.startswith("tls://")
        with cluster(address) as executor:
            assert len(executor.client.scheduler_info()["workers"]) == 1
            (found,) = WorkerPool(executor=executor).run(Doubled(), [21.0])
            assert found == 42.0
        nobody = dict.fromkeys(certificates)
        with (
            dask.config.set(nobody),
            pytest.raises(FileError, match="DASK_DISTRIBUTED__COMM__TLS__CA_FILE"),
            cluster(address, Patience(answer_s=5.0)),
        ):
            pass


def test_the_help_says_whom_to_trust():
    (about,) = (about for item, about in about_fields(FitArguments) if item.name == "cluster")
    assert all(words in about.text for words in ("must be trusted", "tls://", "TLS__CA_FILE"))
