"""What the three algorithms have in common."""

from pathlib import Path

from qgis.core import (
    NULL,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputNumber,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
)
from qgis.PyQt.QtGui import QIcon

from .core import problem, tr

ICON = str(Path(__file__).with_name("icon.svg"))
OVERWRITE = "OVERWRITE"


class Algorithm(QgsProcessingAlgorithm):
    """Subclasses give NAME, TITLE, ABOUT, TAGS, ``parameters()`` and ``execute()``."""

    NAME = TITLE = ABOUT = ""
    TAGS = ()
    NUMBERS = {}

    def name(self):
        """Return the id."""
        return self.NAME

    def displayName(self):
        """Return the name in the toolbox."""
        return tr(self.TITLE)

    def icon(self):
        """Return the provider's mark."""
        return QIcon(ICON)

    def svgIconPath(self):
        """Return the same for the model designer."""
        return ICON

    def tags(self):
        """Return what the search of the toolbox finds it by, too."""
        return [tr(tag) for tag in self.TAGS]

    def createInstance(self):
        """Return a new one, as QGIS asks for each run."""
        return type(self)()

    def shortDescription(self):
        """Return one sentence."""
        return tr(self.ABOUT)

    def shortHelpString(self):
        """Return the help panel's text: what it does, and every parameter."""
        reason = problem()
        warning = f"<p><b>{_html(reason)}</b></p>" if reason else ""
        shown = [d for d in self.parameterDefinitions() if d.help()]
        listed = "".join(f"<h3>{_html(d.description())}</h3><p>{_html(d.help())}</p>" for d in shown)
        return f"{warning}<p>{_html(tr(self.ABOUT))}</p>{listed}"

    def canExecute(self):
        """Tell the toolbox whether the core is there."""
        reason = problem()
        return (reason is None, reason or "")

    def initAlgorithm(self, config=None):
        """Add the parameters; without the core there are none to add but the algorithm still explains why."""
        if problem() is not None:
            return
        for parameter in self.parameters():
            self.addParameter(parameter)
        replace = QgsProcessingParameterBoolean(OVERWRITE, tr("Replace output files that exist"), False)
        self.addParameter(
            with_help(replace, tr("otherwise the run stops before it reads anything"), advanced=True)
        )
        for name, title in self.NUMBERS.items():
            self.addOutput(QgsProcessingOutputNumber(name, tr(title)))

    def parameters(self):
        """Return the parameters, inputs first."""
        raise NotImplementedError

    def execute(self, job):
        """Do the work of a ``Job`` and return the results; may raise ``tin.TinError``."""
        raise NotImplementedError

    def processAlgorithm(self, parameters, context, feedback):
        """Run in a background thread; an expected failure is one message, a cancelled run has no results."""
        reason = problem()
        if reason is not None:
            raise QgsProcessingException(reason)
        from tin import Cancelled, TinError

        try:
            return self.execute(Job(self, parameters, context, feedback))
        except Cancelled:
            return _cancelled(feedback)
        except TinError as error:
            raise QgsProcessingException(f"{error} [{error.code}]") from error
        except RuntimeError as error:  # osgeo, where another plugin has turned its exceptions on
            if feedback.isCanceled():
                return _cancelled(feedback)
            raise QgsProcessingException(str(error)) from error
        except MemoryError as error:
            raise QgsProcessingException(tr("not enough memory; choose a smaller extent")) from error


class Job:
    """One run: the parameters as given, and where to report to."""

    def __init__(self, algorithm, parameters, context, feedback):
        self.algorithm = algorithm
        self.parameters = parameters
        self.context = context
        self.feedback = feedback
        self.overwrite = algorithm.parameterAsBool(parameters, OVERWRITE, context)
        self._stage = None
        self._span = (0.0, 100.0)
        self._shown = 0.0

    def given(self, name):
        """Whether a parameter or an output is set."""
        value = self.parameters.get(name)
        return value not in (None, "", NULL)

    def span(self, first, last):
        """Let the fractions that follow move the bar from ``first`` to ``last`` percent."""
        self._span = (first, last)

    def stage(self, name, text):
        """Show a stage's name when it begins."""
        if name != self._stage:
            self._stage = name
            self.feedback.setProgressText(text)

    def progress(self, fraction):
        """Move the bar, never backwards; false if the user has cancelled."""
        first, last = self._span
        self._shown = max(self._shown, first + (last - first) * fraction)
        self.feedback.setProgress(self._shown)
        return not self.feedback.isCanceled()

    def check(self, fraction=None):
        """Move the bar, and raise ``Cancelled`` if the user has asked for it."""
        from tin import Cancelled

        if self.feedback.isCanceled() or (fraction is not None and not self.progress(fraction)):
            raise Cancelled


def with_help(parameter, text, *, advanced=False):
    """Return ``parameter`` with its help, a sentence or several."""
    parameter.setHelp(text[:1].upper() + text[1:].rstrip(".") + ".")
    if advanced:
        parameter.setFlags(parameter.flags() | QgsProcessingParameterDefinition.FlagAdvanced)
    return parameter


def _cancelled(feedback):
    feedback.pushInfo(tr("Cancelled; nothing was written."))
    return {}


def _html(text):
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return escaped.replace("\n", "<br>")
