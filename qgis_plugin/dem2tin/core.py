"""The core, the Python package ``dem2tin`` (imported as ``tin``): is it there, and what to do if not."""

import os
import sys
import sysconfig
from pathlib import Path

from qgis.PyQt.QtCore import QCoreApplication

MINIMUM = "0.1.0"
PACKAGE = f'"dem2tin>={MINIMUM}"'


def tr(text):
    """Translate."""
    return QCoreApplication.translate("dem2tin", text)


def problem():
    """Return why the algorithms cannot run and what to do about it; None if they can."""
    try:
        import tin
        from tin import _core, options  # noqa: F401
    except Exception as error:  # a broken installation may raise anything
        found = tr("it cannot be imported ({error})").format(error=error)
    else:
        if _numbers(tin.__version__) >= _numbers(MINIMUM):
            return None
        found = tr("version {version} is too old").format(version=tin.__version__)
    message = tr(
        "dem2tin needs its core, the Python package dem2tin, version {minimum} or later: {found}. "
        "Install it in {where} with\n    {command}\nand restart QGIS. "
        "The plugin 'QGIS Pip Manager' (qpip) does the same from within QGIS."
    )
    where, command = _advice()
    return message.format(minimum=MINIMUM, found=found, where=where, command=command)


def _advice():
    """Return where and with which command the package is installed on this system.

    Always ``--no-deps``: numpy is there, and a second numpy beside that of QGIS would break its GDAL.
    """
    install = f"-m pip install --upgrade --no-deps {PACKAGE}"
    if sys.platform == "win32":
        return tr("the OSGeo4W Shell (start menu)"), f"python {install}"
    if sys.platform == "darwin":
        python = Path(sys.executable).with_name("bin") / "python3"
        return tr("Terminal"), f'"{python}" {install} --user'
    if "FLATPAK_ID" in os.environ:
        return tr("a terminal"), f"flatpak run --command=python3 org.qgis.qgis {install} --user"
    marker = Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED"
    user = "--user --break-system-packages" if marker.exists() else "--user"
    return tr("a terminal"), f"{sys.executable or 'python3'} {install} {user}"


def _numbers(version):
    return tuple(int("".join(filter(str.isdigit, part)) or 0) for part in version.split("+")[0].split("."))
