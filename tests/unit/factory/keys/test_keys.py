"""The folder of an authority: files, permissions, refusals."""

from __future__ import annotations

import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from coordinator.protocol.tls import Guard, read_credentials
from factory.keys import admit, create_authority, list_hosts, revoke
from factory.support.listen import require_endpoints, require_loopback, require_tls_endpoints
from schemas.errors import UsageError
from schemas.protocol.identity import Role, format_admitted, parse_admitted, tls_files
from tests.builders.keys import make_authority

NOW = datetime.now(UTC)


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    return make_authority(tmp_path / "pki", ("node-1",), ("admin",))


def read(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def test_secrets_are_readable_only_by_their_owner(pki):
    keys = sorted(pki.rglob("*.key"))
    assert [path.relative_to(pki).as_posix() for path in keys] == [
        "admin/host.key",
        "ca.key",
        "hub/host.key",
        "node-1/host.key",
    ]
    assert {stat.S_IMODE(path.stat().st_mode) for path in keys} == {0o600}
    assert {stat.S_IMODE(path.parent.stat().st_mode) for path in keys} == {0o700}
    assert not list(pki.rglob("*.part"))


def test_a_certificate_names_its_host_and_has_one_purpose(pki):
    for name, purpose in (("hub", ExtendedKeyUsageOID.SERVER_AUTH), ("node-1", ExtendedKeyUsageOID.CLIENT_AUTH)):
        certificate = read(tls_files(pki / name).certificate)
        (common,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        assert common.value == name
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert list(usage) == [purpose]
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        certificate.verify_directly_issued_by(read(pki / "ca.pem"))


def test_an_evaluator_certificate_is_for_clients_only(tmp_path):
    folder = make_authority(tmp_path / "pki", evaluators=("desk",))
    usage = read(tls_files(folder / "desk").certificate).extensions.get_extension_for_class(x509.ExtendedKeyUsage)
    assert list(usage.value) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    assert Guard(folder / "hub").admitted() == {"desk": Role.EVALUATOR}
    desk = Guard(folder / "desk", listens=False)
    assert (desk.name, desk.admitted()) == ("desk", {})
    with pytest.raises(UsageError, match=r"hosts\.txt cannot be read"):
        Guard(folder / "desk")


def test_a_coordinator_certificate_contains_its_addresses(pki):
    admit(pki, "hub-2", Role.COORDINATOR, ("10.0.0.1", "hub.example.org"), 1, NOW)
    names = read(tls_files(pki / "hub-2").certificate).extensions.get_extension_for_class(x509.SubjectAlternativeName)
    assert names.value.get_values_for_type(x509.DNSName) == ["hub-2", "localhost", "hub.example.org"]
    assert [str(ip) for ip in names.value.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "::1", "10.0.0.1"]


def test_openssl_accepts_the_key_with_its_certificate(pki):
    files = tls_files(pki / "hub")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files.certificate, files.key)
    context.load_verify_locations(files.ca)


def test_every_coordinator_folder_gets_the_host_list(pki):
    admit(pki, "hub-2", Role.COORDINATOR, (), 1, NOW)
    admit(pki, "node-2", Role.WORKER, (), 1, NOW)
    wanted = {"admin": Role.OPERATOR, "node-1": Role.WORKER, "node-2": Role.WORKER}
    assert Guard(pki / "hub").admitted() == Guard(pki / "hub-2").admitted() == wanted
    assert revoke(pki, "node-1") == (pki / "hub" / "hosts.txt", pki / "hub-2" / "hosts.txt")
    assert "node-1" not in Guard(pki / "hub").admitted()
    assert [(keys.name, keys.role, keys.admitted) for keys in list_hosts(pki)] == [
        ("admin", "operator", True),
        ("hub", "coordinator", True),
        ("hub-2", "coordinator", True),
        ("node-1", "worker", False),
        ("node-2", "worker", True),
    ]


def test_a_host_keeps_its_certificate_until_it_is_renewed(pki):
    files = tls_files(pki / "node-1")
    before = files.certificate.read_bytes()
    with pytest.raises(UsageError, match="--renew"):
        admit(pki, "node-1", Role.WORKER, (), 1, NOW)
    assert files.certificate.read_bytes() == before
    admit(pki, "node-1", Role.WORKER, (), 9, NOW, renew=True)
    assert files.certificate.read_bytes() != before
    assert abs(read(files.certificate).not_valid_after_utc - NOW - timedelta(days=9)) < timedelta(seconds=2)
    assert read_credentials(pki / "node-1") == (files, "node-1")


def test_an_authority_is_never_replaced(pki):
    before = (pki / "ca.key").read_bytes()
    with pytest.raises(UsageError, match="lock out all its hosts"):
        create_authority(pki, "new", 1, NOW)
    assert (pki / "ca.key").read_bytes() == before


@pytest.mark.parametrize("name", ["a.b", "A", "", "-a", "a-", "a/b", "..", "x" * 49, "*", "a$*"])
def test_names_with_path_or_key_separators_are_refused(pki, name):
    with pytest.raises(UsageError, match="not a valid host name"):
        admit(pki, name, Role.WORKER, (), 1, NOW)


def test_without_an_authority_nothing_is_issued(tmp_path):
    for act in (lambda: admit(tmp_path, "a", Role.WORKER, (), 1, NOW), lambda: list_hosts(tmp_path)):
        with pytest.raises(UsageError, match="factory keys ca"):
            act()
    assert list(tmp_path.iterdir()) == []


def test_unknown_hosts_cannot_be_revoked(pki):
    with pytest.raises(UsageError, match="admitted hosts: admin, node-1"):
        revoke(pki, "nobody")


def test_a_world_readable_key_is_refused(pki):
    tls_files(pki / "node-1").key.chmod(0o644)
    with pytest.raises(UsageError, match="chmod 600"):
        read_credentials(pki / "node-1")


def test_the_error_of_an_incomplete_folder_names_the_missing_files(pki):
    tls_files(pki / "node-1").ca.unlink()
    with pytest.raises(UsageError, match=r"lacks ca\.pem"):
        read_credentials(pki / "node-1")
    with pytest.raises(UsageError, match="--role coordinator"):
        Guard(pki / "admin")


def test_the_host_list_is_read_back_as_written():
    admitted = {"a": Role.WORKER, "b-1": Role.OPERATOR}
    assert parse_admitted(format_admitted(admitted)) == admitted
    assert parse_admitted("a\n# b\n\nc operator # d\n") == {"a": Role.WORKER, "c": Role.OPERATOR}


@pytest.mark.parametrize("line", ["a coordinator", "a worker b", "a.b", "A worker", "*"])
def test_an_invalid_host_list_admits_no_host(line):
    with pytest.raises(UsageError, match="line 1"):
        parse_admitted(line)


def test_tls_endpoints_without_keys_and_keys_without_tls_endpoints_are_refused():
    require_loopback(["tcp/127.0.0.1:7447", "tcp/[::1]:1", "tcp/localhost:0"])
    require_tls_endpoints(["tls/0.0.0.0:7447", "tls/hub.example.org:7447"])
    with pytest.raises(UsageError, match="only loopback"):
        require_loopback(["tcp/0.0.0.0:7447"])
    with pytest.raises(UsageError, match="--tls"):
        require_loopback(["tls/127.0.0.1:7447"])
    require_endpoints(["tcp/10.0.0.1:7447"], with_tls=False)  # possibly through a tunnel of the user
    require_endpoints(["tls/10.0.0.1:7447"], with_tls=True)
    with pytest.raises(UsageError, match="--tls"):
        require_endpoints(["tls/10.0.0.1:7447"], with_tls=False)
    with pytest.raises(UsageError, match="not a valid endpoint"):
        require_endpoints(["nonsense"], with_tls=False)
    with pytest.raises(UsageError, match="write tls/127"):
        require_tls_endpoints(["tcp/127.0.0.1:7447"])
    for bad in ("udp/127.0.0.1:7447", "tls/127.0.0.1", "tls/:1", "tls/h:99999"):
        with pytest.raises(UsageError, match="not a valid endpoint"):
            require_tls_endpoints([bad])
