"""The HTML report: numbers, a map of the errors and their distribution, in one file."""

import base64
import html

import numpy as np
from qgis.PyQt.QtCore import QBuffer, QByteArray, QIODevice
from qgis.PyQt.QtGui import QImage

from .core import tr

WIDTH, HEIGHT, BARS = 560, 180, 40
MAP = 480  # pixels at most a side
COLOURS = np.array([(33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)], float)
PAGE = """<!DOCTYPE html>
<html><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font-family: sans-serif; max-width: 46em; margin: 2em auto; color: #222 }}
table {{ border-collapse: collapse }} figure {{ margin: 2em 0 }}
td {{ padding: .15em 1.5em .15em 0; border-bottom: 1px solid #ddd }} td + td {{ text-align: right }}
img {{ max-width: 100%; border: 1px solid #ccc }} figcaption {{ color: #555; font-size: 90% }}
</style></head><body>
<h1>{title}</h1>
<table>{rows}</table>
<figure>{picture}<figcaption>{below_picture}</figcaption></figure>
<figure>{histogram}<figcaption>{below_histogram}</figcaption></figure>
</body></html>
"""


def page(title, numbers, errors, unit):
    """Return the report of ``numbers`` {name: value} and ``errors`` (rows, cols), TIN minus DEM or NaN."""
    known = errors[np.isfinite(errors)]
    limit = float(np.percentile(np.abs(known), 99)) if known.size else 0.0
    limit = limit or 1.0
    unit = f" {unit}" if unit else ""
    rows = "".join(
        f"<tr><td>{html.escape(str(name))}</td><td>{html.escape(_text(value))}</td></tr>"
        for name, value in numbers.items()
    )
    return PAGE.format(
        title=html.escape(title),
        rows=rows,
        picture=_picture(errors, limit),
        below_picture=html.escape(
            tr(
                "Height of the TIN minus that of the DEM: blue too low, red too high, full colour at {limit}"
            ).format(limit=f"{limit:.3g}{unit}")
        ),
        histogram=_histogram(known, limit),
        below_histogram=html.escape(
            tr("How many pixels have which error, from {low} to {high} (99 % of them)").format(
                low=f"{-limit:.3g}", high=f"{limit:.3g}{unit}"
            )
        ),
    )


def _text(value):
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _picture(errors, limit):
    step = max(1, -(-max(errors.shape) // MAP))
    small = errors[::step, ::step]
    place = np.clip(small / (2 * limit) + 0.5, 0, 1) * (len(COLOURS) - 1)
    void = np.isnan(place)
    place[void] = 0
    low = np.minimum(place.astype(int), len(COLOURS) - 2)
    share = (place - low)[..., None]
    pixels = np.empty((*small.shape, 4), np.uint8)
    pixels[..., :3] = COLOURS[low] * (1 - share) + COLOURS[low + 1] * share
    pixels[..., 3] = np.where(void, 0, 255)
    rows, cols = small.shape
    data = pixels.tobytes()
    image = QImage(data, cols, rows, 4 * cols, QImage.Format.Format_RGBA8888)
    content = QByteArray()
    buffer = QBuffer(content)
    buffer.open(QIODevice.OpenModeFlag.WriteOnly)
    image.save(buffer, "PNG")
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(content.data()).decode()}">'


def _histogram(known, limit):
    counts, _ = np.histogram(known, BARS, (-limit, limit))
    tallest, width = max(1, counts.max()), WIDTH / BARS
    bars = "".join(
        f'<rect x="{i * width:.1f}" y="{HEIGHT * (1 - n / tallest):.1f}" width="{width - 1:.1f}" '
        f'height="{HEIGHT * n / tallest:.1f}" fill="#5b7f95"/>'
        for i, n in enumerate(counts.tolist())
    )
    axis = f'<path d="M0 {HEIGHT}H{WIDTH}M{WIDTH / 2} {HEIGHT}v6" stroke="#222" fill="none"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT + 8}">{bars}{axis}</svg>'
