"""Provides hosts as network namespaces with separate addresses, connected by a bridge. Requires root and `ip`."""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess

from schemas.support.closing import Closing
from tests.chaos.host_process import on_host


def why_not() -> str:
    """Returns why namespaces are not available; empty when they are."""
    if shutil.which("ip") is None:
        return "needs ip (Debian: iproute2)"
    if os.geteuid() != 0:
        return "network namespaces need root"
    probe = f"probe{secrets.token_hex(3)}"
    made = subprocess.run(["ip", "netns", "add", probe], capture_output=True, text=True)
    if made.returncode != 0:
        return f"network namespaces are not available: {made.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", probe], check=True)
    return ""


class Hosts(Closing):
    """Hosts on one network; the first has the address 10.231.x.1. Context manager.

    Args:
        count: number of hosts.
    """

    def __init__(self, count: int) -> None:
        self._tag = secrets.token_hex(3)
        self._bridge = f"b{self._tag}"
        self._made: list[list[str]] = []
        net = f"10.231.{secrets.randbelow(250) + 1}"
        self.addresses = [f"{net}.{number + 1}" for number in range(count)]
        try:
            self._make(["ip", "link", "add", self._bridge, "type", "bridge"], ["ip", "link", "del", self._bridge])
            self._ip("link", "set", self._bridge, "up")
            for number in range(count):
                self._add(number)
        except BaseException:
            self.close()
            raise

    def inside(self, number: int, module: str, *words: object) -> tuple[str, ...]:
        """Returns the command line that runs `main` of a module on a host."""
        return on_host(self._space(number), module, *words)

    def cut(self, number: int) -> None:
        """Disconnects a host: packets are dropped without a notification."""
        self._ip("link", "set", self._cable(number), "down")

    def heal(self, number: int) -> None:
        """Reconnects a host."""
        self._ip("link", "set", self._cable(number), "up")

    def degrade(self, number: int, rate: str, latency: str) -> str:
        """Limits the rate of a host's link and adds latency; returns why this failed, or an empty text."""
        if shutil.which("tc") is None:
            return "needs tc (Debian: iproute2)"
        shape = ["tbf", "rate", rate, "burst", "16kbit", "latency", latency]
        for where in ([], ["ip", "netns", "exec", self._space(number)]):
            device = self._cable(number) if not where else "eth0"
            done = subprocess.run(
                [*where, "tc", "qdisc", "replace", "dev", device, "root", *shape], capture_output=True, text=True
            )
            if done.returncode != 0:
                return f"tc cannot limit the rate of a link: {done.stderr.strip()}"
        return ""

    def close(self) -> None:
        """Removes all namespaces and links."""
        for command in reversed(self._made):
            subprocess.run(command, capture_output=True)
        self._made = []

    def _add(self, number: int) -> None:
        space, cable = self._space(number), self._cable(number)
        self._make(["ip", "netns", "add", space], ["ip", "netns", "del", space])
        self._make(
            ["ip", "link", "add", cable, "type", "veth", "peer", "name", "eth0", "netns", space],
            ["ip", "link", "del", cable],
        )
        self._ip("link", "set", cable, "master", self._bridge, "up")
        self._ip("-n", space, "address", "add", f"{self.addresses[number]}/24", "dev", "eth0")
        self._ip("-n", space, "link", "set", "eth0", "up")
        self._ip("-n", space, "link", "set", "lo", "up")

    def _space(self, number: int) -> str:
        return f"h{number}-{self._tag}"

    def _cable(self, number: int) -> str:
        return f"v{number}{self._tag}"

    def _make(self, command: list[str], undo: list[str]) -> None:
        subprocess.run(command, check=True, capture_output=True)
        self._made.append(undo)

    def _ip(self, *words: str) -> None:
        subprocess.run(["ip", *words], check=True, capture_output=True)
