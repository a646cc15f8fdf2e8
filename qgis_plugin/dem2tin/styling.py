"""How results look when QGIS opens them. Runs in the main thread, after the algorithm."""

from pathlib import Path

from qgis.core import (
    QgsColorRampShader,
    QgsGradientColorRamp,
    QgsGradientStop,
    QgsGraduatedSymbolRenderer,
    QgsProcessingLayerPostProcessorInterface,
    QgsRasterShader,
    QgsSingleBandPseudoColorRenderer,
)
from qgis.PyQt.QtGui import QColor

TIN_STYLE = str(Path(__file__).with_name("tin.qml"))
# Lowland to snow, and too low to too high.
HEIGHTS = (
    (0, "#3b6e4f"),
    (0.2, "#8fb573"),
    (0.4, "#e5dca3"),
    (0.6, "#c49a63"),
    (0.8, "#8c6a55"),
    (1, "#f4f1ee"),
)
ERRORS = ((0, "#2166ac"), (0.25, "#92c5de"), (0.5, "#f7f7f7"), (0.75, "#f4a582"), (1, "#b2182b"))

_KEPT = []  # QGIS does not own Python's post-processors; the last few stay alive here


def ramp(colours):
    """Return the colour ramp of (place, colour) pairs."""
    stops = [QgsGradientStop(place, QColor(colour)) for place, colour in colours[1:-1]]
    return QgsGradientColorRamp(QColor(colours[0][1]), QColor(colours[-1][1]), False, stops)


class Styler(QgsProcessingLayerPostProcessorInterface):
    """Styles a layer for values from ``low`` to ``high``."""

    def __init__(self, low, high):
        super().__init__()
        self.low, self.high = low, (high if high > low else low + 1.0)
        _KEPT.append(self)
        del _KEPT[:-64]

    def postProcessLayer(self, layer, context, feedback):
        """Style ``layer``; whatever goes wrong, an unstyled layer is still a result."""
        if layer is not None and layer.isValid():
            self.style(layer)
            layer.triggerRepaint()


class PolygonStyler(Styler):
    """Triangles by height, with thin edges: tin.qml with classes for the heights at hand."""

    def style(self, layer):
        """Load the style and move its classes."""
        layer.loadNamedStyle(TIN_STYLE)
        renderer = layer.renderer()
        if not isinstance(renderer, QgsGraduatedSymbolRenderer):
            return
        renderer = renderer.clone()
        count = len(renderer.ranges())
        step = (self.high - self.low) / count
        decimals = 0 if step >= 2 else 2
        for index in range(count):
            low, high = self.low + index * step, self.low + (index + 1) * step
            renderer.updateRangeLowerValue(index, low)
            renderer.updateRangeUpperValue(index, high)
            renderer.updateRangeLabel(index, f"{low:.{decimals}f} - {high:.{decimals}f}")
        layer.setRenderer(renderer)


class MeshStyler(Styler):
    """A mesh by height, with thin edges."""

    def style(self, layer):
        """Set the colour ramp of the heights and show them."""
        settings = layer.rendererSettings()
        scalars = settings.scalarSettings(0)
        scalars.setClassificationMinimumMaximum(self.low, self.high)
        scalars.setColorRampShader(shader(HEIGHTS, self.low, self.high))
        settings.setScalarSettings(0, scalars)
        settings.setActiveScalarDatasetGroup(0)
        edges = settings.nativeMeshSettings()
        edges.setEnabled(True)
        edges.setColor(QColor(40, 40, 40, 110))
        edges.setLineWidth(0.1)
        settings.setNativeMeshSettings(edges)
        layer.setRendererSettings(settings)


class RasterStyler(Styler):
    """A raster through a colour ramp."""

    def __init__(self, low, high, colours):
        super().__init__(low, high)
        self.colours = colours

    def style(self, layer):
        """Set a pseudo-colour renderer."""
        function = QgsRasterShader(self.low, self.high)
        function.setRasterShaderFunction(shader(self.colours, self.low, self.high))
        renderer = QgsSingleBandPseudoColorRenderer(layer.dataProvider(), 1, function)
        renderer.setClassificationMin(self.low)
        renderer.setClassificationMax(self.high)
        layer.setRenderer(renderer)


def shader(colours, low, high):
    """Return the interpolating shader of a ramp from ``low`` to ``high``."""
    made = QgsColorRampShader(low, high, ramp(colours), QgsColorRampShader.Interpolated)
    items = [
        QgsColorRampShader.ColorRampItem(low + p * (high - low), QColor(c), f"{low + p * (high - low):.4g}")
        for p, c in colours
    ]
    made.setColorRampItemList(items)
    return made
