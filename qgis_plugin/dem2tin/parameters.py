"""Processing parameters made from the core's one table of options, so that they follow it by themselves."""

from qgis.core import (
    QgsProcessingParameterBand,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterNumber,
    QgsProcessingParameterString,
)

from .algorithm import with_help
from .constraints import LAYER_TYPES, LAYERS
from .core import tr

NOT_HERE = {"allow_remote", "to_crs"}  # the layer is open already, and QGIS reprojects by itself
FILE_OF = "vector file of "  # how the help of an option begins that is a layer here
AS_METHOD, YES, NO = "as the method", "yes", "no"


def shown(group):
    """Return the core's options of ``group`` that are parameters here."""
    from tin import options

    return [option for option in options.of_group(group) if option.name not in NOT_HERE]


def parameters_of(group, raster):
    """Return a parameter for every option of ``group``; ``raster`` is the one whose bands can be chosen."""
    return [_parameter(option, group, raster) for option in shown(group)]


def values_of(group, job):
    """Return the values given, by the option's names; raises OptionError for what the core refuses.

    Layers are left to ``read_constraints``.
    """
    values = {}
    for option in shown(group):
        value = None if option.name in LAYERS else _value(option, job)
        if value is not None:
            option.read(value)
            values[option.name] = value
    return values


def _parameter(option, group, raster):
    name, title = option.name.upper(), tr(option.name.replace("_", " ").capitalize())
    if option.name == "band":
        made = QgsProcessingParameterBand(name, title, option.default, raster, optional=True)
    elif option.name in LAYERS:
        types = [LAYER_TYPES[kind] for kind in LAYERS[option.name]]
        made = QgsProcessingParameterFeatureSource(name, title, types, optional=True)
    elif option.choices:
        made = _enum(name, title, option.choices, option.default)
    elif option.is_flag and option.default is None:
        made = _enum(name, title, (AS_METHOD, YES, NO), AS_METHOD)
    elif option.is_flag:
        made = QgsProcessingParameterBoolean(name, title, option.default, optional=True)
    elif _is_text(option):
        default = None if option.default is None else str(option.default)
        made = QgsProcessingParameterString(name, f"{title} ({option.metavar})", default, optional=True)
    else:
        kind = (
            QgsProcessingParameterNumber.Double
            if _takes(option, 0.5)
            else QgsProcessingParameterNumber.Integer
        )
        made = QgsProcessingParameterNumber(name, title, kind, option.default, optional=True)
    unit = f" [{tr(option.unit)}]" if option.unit else ""
    text = option.help[len(FILE_OF) :] if option.help.startswith(FILE_OF) else option.help
    return with_help(made, tr(text) + unit, advanced=option.advanced or group == "output")


def _enum(name, title, choices, default):
    return QgsProcessingParameterEnum(
        name, title, list(choices), defaultValue=default, optional=True, usesStaticStrings=True
    )


def _is_text(option):
    """Whether an option takes more than a plain number: 5%, median, 2px."""
    return not option.metavar or any(mark in option.metavar for mark in "|%,") or _takes(option, "1px")


def _takes(option, value):
    try:
        option.parse(value)
    except (TypeError, ValueError):
        return False
    return True


def _value(option, job):
    """Return what the user gave, as the core reads it, or None."""
    name = option.name.upper()
    if not job.given(name):
        return None
    algorithm, source = job.algorithm, (job.parameters, name, job.context)
    if option.is_flag and option.default is None:
        return {YES: True, NO: False}.get(algorithm.parameterAsEnumString(*source))
    if option.choices:
        value = algorithm.parameterAsEnumString(*source)
    elif option.is_flag:
        value = algorithm.parameterAsBool(*source)
    elif option.name == "band":
        value = algorithm.parameterAsInt(*source)
    elif _is_text(option):
        value = algorithm.parameterAsString(*source).strip() or None
    else:
        value = algorithm.parameterAsDouble(*source)
    return value
