"""Collects the versions of the software and the machine properties that affect the bytes this process records.

Does not import the libraries that it lists.
"""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

from schemas.fingerprint import Fingerprint

_PACKAGES = ("isal", "minivla-factory", "moderngl", "numpy", "pybullet", "zstandard")
_CPU_INFO = Path("/proc/cpuinfo")


def make_fingerprint(renderer: str) -> Fingerprint:
    """Returns the fingerprint of this process.

    Args:
        renderer: description of the renderer in use.
    """
    software = {name: version(name) for name in _PACKAGES}
    software["python"] = platform.python_version()
    # the C library computes sines and cosines, so its version can affect the bytes
    software["libc"] = " ".join(platform.libc_ver()).strip() or "unknown"
    return Fingerprint(software=software, renderer=renderer, cpu=f"{_cpu_model()} ({platform.machine()})")


def _cpu_model() -> str:
    """Returns the processor's model name from `/proc/cpuinfo`, or else from `platform`."""
    if _CPU_INFO.is_file():
        for line in _CPU_INFO.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
