"""Simulation on a host with a bad disk, bad memory or a bad driver. Arguments: `LONGEST_S BUNDLE_MAKER SHARE`.

Runs `light_simulation` and damages a share SHARE of its attempts.
"""

from __future__ import annotations

import hashlib
import os
import random
import sys


def main() -> None:
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # `python -I` does not add this folder
    import light_simulation  # type: ignore[import-not-found]

    light_simulation.main(_damage)


def _damage(bundle: bytes) -> tuple[bytes, str]:
    """Returns the bytes to write to the disk and the SHA-256 to report, or ends the process."""
    if random.random() >= float(sys.argv[3]):
        return bundle, hashlib.sha256(bundle).hexdigest()
    kind = random.choice(("disk flips a bit", "disk cuts", "memory flips a bit", "crash"))
    if kind == "crash":
        os._exit(3)
    if kind == "disk cuts":
        return bundle[: random.randrange(1, len(bundle))], hashlib.sha256(bundle).hexdigest()
    damaged = bytearray(bundle)
    damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
    correct = bundle if kind == "disk flips a bit" else damaged
    return bytes(damaged), hashlib.sha256(correct).hexdigest()


if __name__ == "__main__":
    main()
