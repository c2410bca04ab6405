"""Certificates for the transport: an authority of one's own, and one certificate a host."""

from factory.keys.folder import HostKeys, admit, create_authority, list_hosts, revoke

__all__ = ["HostKeys", "admit", "create_authority", "list_hosts", "revoke"]
