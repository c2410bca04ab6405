"""Finds out why a coordinator cannot be reached: name, port, certificate. zenoh reports a timeout only.

Opens one short connection per endpoint and sends nothing but a TLS handshake.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Sequence

from schemas.protocol.identity import TlsFiles

_TIMEOUT_S = 2.0


def split_endpoint(endpoint: str) -> tuple[str, str, int]:
    """Returns protocol, host and port of an endpoint such as `tls/hub:7447`."""
    protocol, _, address = endpoint.partition("#")[0].partition("/")
    host, _, port = address.rpartition(":")
    return protocol, host.strip("[]"), int(port)


def why_unreachable(endpoints: Sequence[str], tls: TlsFiles | None, timeout_s: float = _TIMEOUT_S) -> str:
    """Returns the cause for each endpoint to which no connection can be opened; empty if all accept connections.

    Args:
        endpoints: endpoints of coordinators or gateways.
        tls: TLS files of this host, or `None` for plain TCP.
        timeout_s: time limit of a connection and of a handshake, seconds.
    """
    causes = ((endpoint, _cause(endpoint, tls, timeout_s)) for endpoint in endpoints)
    return "; ".join(f"{endpoint}: {cause}" for endpoint, cause in causes if cause)


def _cause(endpoint: str, tls: TlsFiles | None, timeout_s: float) -> str:
    protocol, host, port = split_endpoint(endpoint)
    try:
        with socket.create_connection((host, port), timeout_s) as connection:
            return _tls_cause(connection, host, tls) if protocol == "tls" and tls is not None else ""
    except socket.gaierror as error:
        return f"host {host} cannot be resolved ({error.strerror}); check the name, or write its address"
    except ConnectionRefusedError:
        return f"host {host} refuses connections to port {port}; no server runs there, or it uses another port"
    except TimeoutError:
        return f"host {host} does not answer on port {port}; check the address and the firewall"
    except OSError as error:
        return f"host {host} cannot be reached on port {port} ({error.strerror})"


def _tls_cause(connection: socket.socket, host: str, tls: TlsFiles) -> str:
    """Returns why a TLS handshake fails; empty if it succeeds."""
    try:
        context = ssl.create_default_context(cafile=tls.ca)
        context.load_cert_chain(tls.certificate, tls.key)
        with context.wrap_socket(connection, server_hostname=host):
            return ""
    except ssl.SSLCertVerificationError as error:
        if "match" in error.verify_message:
            return (
                f"its certificate is for another name ({error.verify_message}); connect to a name of the certificate, "
                f"or create it again with `factory keys host DIR NAME --address {host}`"
            )
        if "valid" in error.verify_message or "expired" in error.verify_message:
            return (
                f"its certificate is not valid now ({error.verify_message}); compare the clocks of the hosts, or renew "
                "it with `factory keys host DIR NAME --renew`"
            )
        return f"its certificate is not accepted ({error.verify_message}); use TLS folders of one authority"
    except (ssl.SSLError, OSError) as error:
        return f"the TLS handshake fails ({error}); check that a coordinator with --tls listens there"
