"""What a run depends on, as short texts to compare: the same inputs give the same bits."""

import hashlib
import platform
from functools import cache
from pathlib import Path

import jax


@cache
def code_hash() -> str:
    """Hash the package's own source, so that nothing made by other code is taken for its own."""
    folder, found = Path(__file__).parents[1], hashlib.blake2b(digest_size=16)
    for path in sorted(folder.rglob("*.py")):
        found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


def machine() -> str:
    """Describe where programs run: kind and number of devices, and the processor; other ones round differently."""
    devices = jax.devices()
    return f"{len(devices)} x {devices[0].device_kind} on {platform.machine()} {platform.processor()}".strip()
