"""Simulation of a host with a bad disk, bad memory or a bad driver: `LONGEST_S BUNDLE_MAKER SHARE`.

Damages the share SHARE of its attempts; the others are those of `light_simulation`, which this script runs.
"""

from __future__ import annotations

import hashlib
import os
import random
import sys


def main() -> None:
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # runs isolated for a fast start
    import light_simulation  # type: ignore[import-not-found]

    light_simulation.main(_damage)


def _damage(bundle: bytes) -> tuple[bytes, str]:
    """Returns the bytes on the disk and the reported SHA-256."""
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
