"""The coordinator's disk as chaos has it: small, full, slow. What this machine does not allow is said."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

__all__ = ["Disk"]

_SOURCE = Path(__file__).with_name("slow_fsync.c")
_BLOCK = bytes(1 << 16)
_PROBE = """
import os, sys, time
with open(sys.argv[1], "wb") as file:
    begun = time.monotonic()
    os.fsync(file.fileno())
    print(time.monotonic() - begun)
"""


class Disk:
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
        self._shim = folder / "slow_fsync.so"
        self._make_shim()

    @property
    def environment(self) -> dict[str, str]:
        """What a process needs in its environment to feel the slowness."""
        if "slow disk" in self.missing:
            return {}
        return {"LD_PRELOAD": str(self._shim), "SLOW_DISK": str(self._speed)}

    @property
    def is_full(self) -> bool:
        return (self.path / "filler").exists()

    def fill(self) -> None:
        """Leaves not a byte free."""
        with (self.path / "filler").open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(_BLOCK)
            except OSError:
                return

    def clear(self) -> None:
        """Gives back the room and the speed."""
        (self.path / "filler").unlink(missing_ok=True)
        self._speed.unlink(missing_ok=True)

    def slow(self, milliseconds: int) -> None:
        """Lets every fsync wait."""
        self._speed.write_text(str(milliseconds))

    def close(self) -> None:
        """Unmounts the disk; what was on it is gone."""
        if self._is_mounted:
            subprocess.run(["umount", "--lazy", str(self.path)], check=True)
            self._is_mounted = False
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
            self.slow(120)
            probe = [sys.executable, "-c", _PROBE, str(self.path / "probe")]
            took = float(
                subprocess.run(probe, check=True, capture_output=True, env=os.environ | self.environment).stdout
            )
        except (OSError, subprocess.CalledProcessError, ValueError) as error:
            self.missing["slow disk"] = f"a preloaded library is not to be had: {error}"
        else:
            if took < 0.1:
                self.missing["slow disk"] = f"a preloaded library has no effect: {took:.3f} s"
        finally:
            self._speed.unlink(missing_ok=True)
            (self.path / "probe").unlink(missing_ok=True)
