"""Provides a small disk for the coordinator that can be full or slow. Reports faults that the machine does not support.

A library preloaded into the coordinator delays fsync and records the effects of both faults.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from schemas.support.closing import Closing
from tests.chaos.fault_span import FaultSpan

_SOURCE = Path(__file__).with_name("slow_fsync.c")
_BLOCK = bytes(1 << 16)
_FULL, _SLOW = "f", "s"
"""Letters that the preloaded library writes for each effect of a full and of a slow disk."""
_PROBE = """
import os, sys, time
with open(sys.argv[1], "wb") as file:
    started = time.monotonic()
    os.fsync(file.fileno())
    print(time.monotonic() - started)
"""


class Disk(Closing):
    """A small tmpfs if this process can mount one, otherwise a plain folder. Context manager.

    Args:
        folder: working directory.
        megabytes: size of the disk.
    """

    def __init__(self, folder: Path, megabytes: int) -> None:
        self.path = folder / "disk"
        self.path.mkdir(parents=True)
        self.missing: dict[str, str] = {}
        """Fault -> why this machine does not support it."""
        self._is_mounted = self._mount(megabytes)
        self._speed = folder / "slow_ms"
        self._log = folder / "slow_ms.effects"
        self._spans: dict[str, FaultSpan] = {}
        self._shim = folder / "slow_fsync.so"
        self._make_shim()

    @property
    def preload(self) -> dict[str, str]:
        """Environment variable that loads the library into a process; must be set when the process starts."""
        return {} if "slow disk" in self.missing else {"LD_PRELOAD": str(self._shim)}

    @property
    def environment(self) -> dict[str, str]:
        """Environment variable that names the file with the delay; a process may also set it after its start."""
        return {} if "slow disk" in self.missing else {"SLOW_DISK": str(self._speed)}

    def fill(self) -> FaultSpan | None:
        """Fills the disk until `clear` is called; returns `None` if the disk is already full."""
        if _FULL in self._spans:
            return None
        with (self.path / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(_BLOCK)
        return self._begin(_FULL)

    def slow(self, milliseconds: int) -> FaultSpan | None:
        """Delays every fsync until `clear` is called; returns `None` if the disk is already slow."""
        if _SLOW in self._spans:
            return None
        self._speed.write_text(str(milliseconds))
        return self._begin(_SLOW)

    def clear(self) -> None:
        """Ends both faults and adds their recorded effects to their spans."""
        (self.path / "filler").unlink(missing_ok=True)
        self._speed.unlink(missing_ok=True)
        effects = self._log.read_text() if self._log.exists() else ""
        self._log.unlink(missing_ok=True)
        for letter, span in self._spans.items():
            span.effects += effects.count(letter)
        self._spans.clear()

    def _begin(self, letter: str) -> FaultSpan:
        span = self._spans[letter] = FaultSpan()
        return span

    def close(self) -> None:
        """Unmounts the disk and deletes its content."""
        if self._is_mounted:
            subprocess.run(["umount", "--lazy", str(self.path)], check=True)
            self._is_mounted = False
        shutil.rmtree(self.path, ignore_errors=True)

    def _mount(self, megabytes: int) -> bool:
        command = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "chaos", str(self.path)]
        try:
            done = subprocess.run(command, capture_output=True, text=True)
        except OSError as error:
            self.missing["full disk"] = str(error)
            return False
        if done.returncode != 0:
            self.missing["full disk"] = f"mounting a tmpfs needs root: {done.stderr.strip()}"
            return False
        return True

    def _make_shim(self) -> None:
        try:
            command = ["cc", "-shared", "-fPIC", "-O1", "-o", str(self._shim), str(_SOURCE), "-ldl"]
            subprocess.run(command, check=True, capture_output=True)
            span = self.slow(120)
            probe = [sys.executable, "-c", _PROBE, str(self.path / "probe")]
            environment = os.environ | self.preload | self.environment
            took = float(subprocess.run(probe, check=True, capture_output=True, env=environment).stdout)
            self.clear()
            if took < 0.1 or span is None or not span.effects:
                self._miss(f"a preloaded library has no effect: {took:.3f} s")
        except (OSError, subprocess.CalledProcessError, ValueError) as error:
            self._miss(f"the preloaded library cannot be built or run: {error}")
        finally:
            self.clear()
            (self.path / "probe").unlink(missing_ok=True)

    def _miss(self, why: str) -> None:
        for fault in ("slow disk", "full disk"):  # without the library, no effect of either fault is recorded
            self.missing.setdefault(fault, why)
