"""dem2tin: compact, noise-robust triangle meshes (TINs) from georeferenced DEMs."""

from __future__ import annotations

__version__ = "0.1.0"
