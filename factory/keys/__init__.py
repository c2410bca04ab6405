"""Creates TLS certificates for the transport: one private authority, and one certificate for each host."""

from factory.keys.folder import HostKeys, admit, create_authority, list_hosts, revoke

__all__ = ["HostKeys", "admit", "create_authority", "list_hosts", "revoke"]
