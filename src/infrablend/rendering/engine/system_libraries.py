"""The system libraries that Blender's Python module loads, by Debian package.

Standard library only, and no import of the package: the set-up runs this file by itself, before anything is
installed (`python system_libraries.py` writes the names of the missing packages, one per line).
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Mapping

# Debian/Ubuntu package -> the shared object bpy asks the loader for. The packages whose names gained "t64" in newer
# releases still answer to the names here.
DEBIAN_PACKAGES: Mapping[str, str] = {
    "libgl1": "libGL.so.1",
    "libice6": "libICE.so.6",
    "libsm6": "libSM.so.6",
    "libx11-6": "libX11.so.6",
    "libxext6": "libXext.so.6",
    "libxfixes3": "libXfixes.so.3",
    "libxi6": "libXi.so.6",
    "libxkbcommon0": "libxkbcommon.so.0",
    "libxrender1": "libXrender.so.1",
    "libxt6": "libXt.so.6",
}


def loads(soname: str) -> bool:
    """Return True if the dynamic loader finds and loads the shared object."""
    try:
        ctypes.CDLL(soname)
    except OSError:
        return False
    return True


def missing_packages(can_load: Callable[[str], bool] = loads, platform: str = sys.platform) -> tuple[str, ...]:
    """Debian names of the packages whose libraries do not load, sorted; empty on other systems than Linux."""
    if not platform.startswith("linux"):
        return ()
    return tuple(sorted(name for name, soname in DEBIAN_PACKAGES.items() if not can_load(soname)))


def install_command(packages: tuple[str, ...]) -> str:
    """Return the one line that installs the packages on Debian and Ubuntu."""
    return "sudo apt-get update && sudo apt-get install -y --no-install-recommends " + " ".join(packages)


if __name__ == "__main__":
    sys.stdout.writelines(f"{name}\n" for name in missing_packages())
