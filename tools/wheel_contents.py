"""Check the size and the dependencies of a wheel: it needs only NumPy and a Linux system."""

from __future__ import annotations

import re
import subprocess
import tempfile
import zipfile
from pathlib import Path

MAX_BYTES = 10_000_000
# Libraries outside of the wheel that the wheel may need. Every Linux has them.
SYSTEM_LIBRARIES = re.compile(
    r"^(libc|libm|libdl|libpthread|librt|libgcc_s|libstdc\+\+)\.so\.\d+$|^ld-linux"
)


def fault(wheel: Path) -> str:
    """Return a message for the first fault of a wheel, or "" if the wheel has no fault."""
    if (size := wheel.stat().st_size) >= MAX_BYTES:
        return f"{size} bytes, allowed are {MAX_BYTES}"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = next(n for n in names if n.endswith(".dist-info/METADATA"))
        requires = re.findall(
            r"^Requires-Dist: (.+)$", archive.read(metadata).decode(), re.MULTILINE
        )
        if extra := [r for r in requires if "extra ==" not in r and not re.match(r"numpy\b", r)]:
            return f"it requires {', '.join(extra)} besides NumPy"
        libraries = [n for n in names if re.search(r"\.so(\.\d+)*$", n)]
        own = {Path(n).name for n in libraries}
        if "libnovaphy_io.so" not in own:
            return "it has no libnovaphy_io.so, so it cannot load meshes"
        return _foreign(archive, libraries, own)


def _foreign(archive: zipfile.ZipFile, libraries: list[str], own: set[str]) -> str:
    with tempfile.TemporaryDirectory() as folder:
        for name in libraries:
            command = ["readelf", "-d", archive.extract(name, folder)]
            text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            for needed in re.findall(r"\(NEEDED\).*\[(.+)\]", text):
                if needed not in own and not SYSTEM_LIBRARIES.match(needed):
                    return f"{name} needs {needed}, which is not in the wheel"
    return ""
