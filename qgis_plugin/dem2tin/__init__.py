# SPDX-License-Identifier: GPL-2.0-or-later
"""dem2tin for QGIS: compact, noise-robust TINs from DEMs in the Processing toolbox."""


def classFactory(iface):  # noqa: N802 - the name that QGIS calls
    """Return the plugin."""
    from .plugin import Plugin

    return Plugin(iface)
