"""The coordinator's disk as chaos has it: small, full, slow. What this machine does not allow is said.

A library preloaded into the coordinator slows its fsync down, and notes what it felt.
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

__all__ = ["Disk"]

_SOURCE = Path(__file__).with_name("slow_fsync.c")
_BLOCK = bytes(1 << 16)
_FULL, _SLOW = "f", "s"
"""What the preloaded library notes."""
_PROBE = """
import os, sys, time
with open(sys.argv[1], "wb") as file:
    begun = time.monotonic()
    os.fsync(file.fileno())
    print(time.monotonic() - begun)
"""


class Disk(Closing):
    """A tmpfs of some megabytes where root may mount one, else a plain folder; a context manager.

    Args:
        folder: where to work.
        megabytes: size of the disk.
    """

    def __init__(self, folder: Path, megabytes: int) -> None:
        self.path = folder / "disk"
        self.path.mkdir(parents=True)
        self.missing: dict[str, str] = {}
        """Fault -> why it cannot be had here."""
        self._is_mounted = self._mount(megabytes)
        self._speed = folder / "slow_ms"
        self._felt = folder / "slow_ms.felt"
        self._spells: dict[str, FaultSpan] = {}
        self._shim = folder / "slow_fsync.so"
        self._make_shim()

    @property
    def preload(self) -> dict[str, str]:
        """What the environment of a process needs from its beginning to feel anything."""
        return {} if "slow disk" in self.missing else {"LD_PRELOAD": str(self._shim)}

    @property
    def environment(self) -> dict[str, str]:
        """What else it needs, then or later."""
        return {} if "slow disk" in self.missing else {"SLOW_DISK": str(self._speed)}

    def fill(self) -> FaultSpan | None:
        """Leaves not a byte free until it is cleared; `None` when it is full already."""
        if _FULL in self._spells:
            return None
        with (self.path / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(_BLOCK)
        return self._begin(_FULL)

    def slow(self, milliseconds: int) -> FaultSpan | None:
        """Lets every fsync wait until it is cleared; `None` when it is slow already."""
        if _SLOW in self._spells:
            return None
        self._speed.write_text(str(milliseconds))
        return self._begin(_SLOW)

    def clear(self) -> None:
        """Gives back the room and the speed, and tells the spells what was felt of them."""
        (self.path / "filler").unlink(missing_ok=True)
        self._speed.unlink(missing_ok=True)
        felt = self._felt.read_text() if self._felt.exists() else ""
        self._felt.unlink(missing_ok=True)
        for letter, spell in self._spells.items():
            spell.felt += felt.count(letter)
        self._spells.clear()

    def _begin(self, letter: str) -> FaultSpan:
        spell = self._spells[letter] = FaultSpan()
        return spell

    def close(self) -> None:
        """Unmounts the disk; what was on it is gone."""
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
            spell = self.slow(120)
            probe = [sys.executable, "-c", _PROBE, str(self.path / "probe")]
            feeling = os.environ | self.preload | self.environment
            took = float(subprocess.run(probe, check=True, capture_output=True, env=feeling).stdout)
            self.clear()
            if took < 0.1 or spell is None or not spell.felt:
                self._miss(f"a preloaded library has no effect: {took:.3f} s")
        except (OSError, subprocess.CalledProcessError, ValueError) as error:
            self._miss(f"a preloaded library is not to be had: {error}")
        finally:
            self.clear()
            (self.path / "probe").unlink(missing_ok=True)

    def _miss(self, why: str) -> None:
        for fault in ("slow disk", "full disk"):  # without the library nobody says whether a full disk was felt
            self.missing.setdefault(fault, why)
