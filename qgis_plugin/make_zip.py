"""Pack the plugin as the QGIS plugin repository takes it: ``python make_zip.py dem2tin.zip``."""

import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
SUFFIXES = {"", ".py", ".txt", ".qml", ".svg"}  # no caches and no binaries


def make_zip(target):
    """Write the zip, the same bytes every time."""
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted((HERE / "dem2tin").rglob("*")):
            if path.is_file() and path.suffix in SUFFIXES:
                entry = zipfile.ZipInfo(path.relative_to(HERE).as_posix())
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, path.read_bytes())


if __name__ == "__main__":
    make_zip(sys.argv[1])
