"""Creates a certificate authority and signs host certificates with `cryptography`. Writes no files."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, NamedTuple

from schemas.errors import WorldError
from schemas.protocol.identity import Role
from schemas.support.extras import require_package

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

_CLOCK_TOLERANCE = timedelta(minutes=5)
"""The validity of a certificate starts this long before its creation, because the clocks of hosts differ."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Certificate(NamedTuple):
    """X.509 certificate and its private key, PEM encoded."""

    certificate: bytes
    key: bytes


def require_cryptography() -> None:
    """Raises an error unless the package `cryptography` is installed.

    Raises:
        UsageError: The package is not installed.
    """
    require_package("cryptography", "`factory keys`")


def create_authority_certificate(name: str, days: int, now: datetime) -> Certificate:
    """Creates a certificate authority with a P-256 key, which may sign host certificates only."""
    require_cryptography()
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    key = _new_key()
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    signed = (
        _builder(_name(name), _name(name), key=key, days=days, now=now)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return _pem(signed, key)


def issue(
    authority: Certificate, name: str, role: Role, addresses: Sequence[str], days: int, now: datetime
) -> Certificate:
    """Signs a host certificate; its common name is the name of the host.

    Args:
        authority: Certificate and key of the signing authority.
        name: Name of the host.
        role: Role of the host. Coordinators may only listen, gateways may listen and connect, all others only connect.
        addresses: Names and IP addresses at which peers reach the host. Loopback is added for roles that listen.
        days: Validity, days.
        now: Current time; validity starts five minutes earlier, because the clocks of hosts differ.

    Raises:
        WorldError: The files of the authority cannot be parsed.
    """
    require_cryptography()
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import ExtendedKeyUsageOID

    signer, signer_key = _read(authority)
    key = _new_key()
    listens, connects = role in {Role.COORDINATOR, Role.GATEWAY}, role is not Role.COORDINATOR
    purposes = [ExtendedKeyUsageOID.SERVER_AUTH] * listens + [ExtendedKeyUsageOID.CLIENT_AUTH] * connects
    reached = dict.fromkeys((name, *_LOOPBACK, *addresses) if listens else (name, *addresses))
    signed = (
        _builder(_name(name), signer.subject, key=key, days=days, now=now)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=True)
        .add_extension(x509.SubjectAlternativeName([_alternative(address) for address in reached]), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer_key.public_key()), critical=False)
        .sign(signer_key, hashes.SHA256())
    )
    return _pem(signed, key)


def expiry_of(certificate: bytes) -> datetime:
    """Returns the expiry time of a PEM certificate, UTC.

    Raises:
        WorldError: The certificate cannot be parsed.
    """
    require_cryptography()
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(certificate).not_valid_after_utc
    except ValueError as error:
        raise WorldError(f"the certificate is not valid PEM: {error}") from error


def addresses_of(certificate: bytes) -> tuple[str, ...]:
    """Returns the names and addresses of a certificate in PEM, without those of loopback.

    Raises:
        UsageError: `cryptography` is not installed.
        WorldError: the file is not a certificate.
    """
    require_cryptography()
    from cryptography import x509

    try:
        loaded = x509.load_pem_x509_certificate(certificate)
        names = loaded.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    except ValueError as error:
        raise WorldError(f"the certificate is damaged: {error}") from error
    return tuple(address for name in names if (address := str(name.value)) not in _LOOPBACK)


def _read(authority: Certificate) -> tuple[x509.Certificate, EllipticCurvePrivateKey]:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        certificate = x509.load_pem_x509_certificate(authority.certificate)
        key = load_pem_private_key(authority.key, None)
    except (ValueError, TypeError) as error:
        raise WorldError(f"the authority cannot be read ({error}): restore its files from a backup") from error
    if not isinstance(key, EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise WorldError("the authority's key does not match its certificate: restore both from the same backup")
    return certificate, key


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _name(common: str) -> x509.Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: EllipticCurvePrivateKey, days: int, now: datetime
) -> x509.CertificateBuilder:
    from cryptography import x509

    begin = now.astimezone(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin - _CLOCK_TOLERANCE)
        .not_valid_after(begin + timedelta(days=days))
    )


def _alternative(address: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _pem(certificate: x509.Certificate, key: EllipticCurvePrivateKey) -> Certificate:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return Certificate(certificate.public_bytes(Encoding.PEM), secret)
