"""The cluster of ``--scheduler local``: nobody else can use it."""

import pathlib
import socket
import sys
import urllib.error
import urllib.request

import pytest

distributed = pytest.importorskip("distributed", reason="comes with jaxblur[dask]")

from distributed.security import Security  # noqa: E402

from jaxblur.sequence import cluster  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def client():
    with cluster.cluster_client(cluster.LOCAL, 1) as client:
        yield client


def test_the_client_can_use_it(client):
    assert client.submit(sum, [1, 2]).result(30) == 3


def test_nobody_else_can(client):
    address = client.scheduler.address
    assert address.startswith("tls://127.0.0.1:")
    strangers = [
        {"address": address.replace("tls", "tcp")},
        {"address": address, "security": Security.temporary()},
    ]
    for stranger in strangers:
        with pytest.raises((OSError, RuntimeError)):
            distributed.Client(**stranger, timeout=3, set_as_default=False)
    worker = next(iter(client.scheduler_info()["workers"]))
    assert worker.startswith("tls://127.0.0.1:")


def listening():
    """Ports of this machine's IPv4 sockets that listen, with the addresses, see proc(5)."""
    lines = pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]
    fields = [line.split() for line in lines]
    return [field[1].split(":") for field in fields if field[3] == "0A"]


@pytest.mark.skipif(not pathlib.Path("/proc/net/tcp").exists(), reason="needs Linux")
def test_its_web_servers_show_nothing(client):
    services = client.scheduler_info()["services"]
    assert services["dashboard"] != 8787
    for path in ("", "status", "health", "info/main/workers.html", "json/identity.json"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://127.0.0.1:{services['dashboard']}/{path}", timeout=5)
    address = socket.inet_aton("127.0.0.1")[::-1].hex().upper()
    assert [address, f"{services['dashboard']:04X}"] in listening()


def test_what_is_missing_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(ValueError, match=r"pip install 'jaxblur\[dask\]'"):
        with cluster.cluster_client(cluster.LOCAL, 1):
            pass
