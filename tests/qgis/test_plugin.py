"""The plugin as a whole: registered, complete, and running from a fresh profile."""

import configparser
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from qgis.core import QgsProcessingParameterDefinition, QgsVectorLayer
from qgis.PyQt.QtGui import QIcon
from support import ROOT, VOIDS

PLUGIN = ROOT / "qgis_plugin" / "dem2tin"
MAKE_ZIP = ROOT / "qgis_plugin" / "make_zip.py"


def test_algorithms_are_registered_with_help(provider):
    assert [algorithm.id() for algorithm in provider.algorithms()] == [
        "dem2tin:demtotin",
        "dem2tin:tinerror",
        "dem2tin:tintoraster",
    ]
    for algorithm in provider.algorithms():
        assert algorithm.canExecute()[0]
        assert algorithm.shortHelpString().startswith("<p>")
        for parameter in algorithm.parameterDefinitions():
            assert parameter.help(), parameter.name()
    assert not provider.icon().pixmap(32, 32).isNull()
    assert not QIcon(provider.svgIconPath()).isNull()


def test_parameters_are_those_of_the_core(provider):
    from tin.options import OPTIONS

    parameters = {p.name(): p for p in provider.algorithm("demtotin").parameterDefinitions()}
    for option in OPTIONS:
        if option.name in {"allow_remote", "to_crs"}:
            continue
        parameter = parameters[option.name.upper()]
        text = option.help.replace("vector file of ", "")  # here they are layers
        assert text.lower().rstrip(".") in parameter.help().lower()
        assert option.unit in parameter.help()
        assert parameter.flags() & QgsProcessingParameterDefinition.FlagOptional
        if option.default is not None:
            plain = isinstance(option.default, (bool, int, float, str))
            assert parameter.defaultValue() == (option.default if plain else str(option.default))
        if option.advanced:
            assert parameter.flags() & QgsProcessingParameterDefinition.FlagAdvanced


def test_metadata_and_zip_keep_the_rules_of_the_plugin_repository(tmp_path):
    metadata = configparser.ConfigParser()
    metadata.read(PLUGIN / "metadata.txt", encoding="utf-8")
    general = metadata["general"]
    described = ("name", "description", "about", "version", "author", "email", "tags", "qgisMinimumVersion")
    for key in (*described, "homepage", "tracker", "repository"):
        assert general[key], key
    assert general["hasProcessingProvider"] == "yes"
    assert (PLUGIN / general["icon"]).is_file()
    assert "GNU GENERAL PUBLIC LICENSE" in (PLUGIN / "LICENSE").read_text(encoding="utf-8")
    import tin

    assert general["version"] == tin.__version__

    subprocess.run([sys.executable, MAKE_ZIP, tmp_path / "x.zip"], check=True)
    with zipfile.ZipFile(tmp_path / "x.zip") as archive:
        names = archive.namelist()
    assert all(name.startswith("dem2tin/") for name in names)
    assert {"dem2tin/__init__.py", "dem2tin/metadata.txt", "dem2tin/LICENSE", "dem2tin/tin.qml"} <= set(names)
    known = {"", ".py", ".txt", ".qml", ".svg"}
    assert {Path(name).suffix for name in names} <= known
    assert not any("__pycache__" in name for name in names)
    assert (tmp_path / "x.zip").stat().st_size < 25e6


def test_only_numpy_and_the_core_are_imported():
    """Wheels such as rasterio bring a PROJ and a GDAL of their own, which clash with those of QGIS."""
    allowed = {*sys.stdlib_module_names, "numpy", "osgeo", "qgis", "tin", ""}
    for file in PLUGIN.glob("*.py"):
        for module in re.findall(
            r"^\s*(?:from|import) ([\w.]+)", file.read_text(encoding="utf-8"), re.MULTILINE
        ):
            assert module.split(".")[0] in allowed, (file.name, module)


def test_qgis_process(process, tmp_path):
    settings = [f"--INPUT={VOIDS}", "--MAX_POINTS=2%", "--METHOD=auto"]
    made = process("run", "dem2tin:demtotin", *settings, "--OUTPUT=t.gpkg", "--MESH=t.nc")
    assert made.returncode == 0, made.stderr
    points, triangles = (
        int(re.search(rf"^{name}:\s+(\d+)", made.stdout, re.M)[1]) for name in ("POINTS", "TRIANGLES")
    )
    assert points > 100
    layer = QgsVectorLayer(str(tmp_path / "t.gpkg"), "x", "ogr")
    assert layer.featureCount() == triangles
    again = process("run", "dem2tin:demtotin", *settings, "--OUTPUT=t.gpkg")
    assert again.returncode == 1
    assert "exists already" in again.stdout + again.stderr
    wrong = process("run", "dem2tin:demtotin", f"--INPUT={VOIDS}", "--MAX_POINTS=0%", "--OUTPUT=u.gpkg")
    assert wrong.returncode == 1
    assert "max-points" in wrong.stdout + wrong.stderr
    assert not (tmp_path / "u.gpkg").exists()


def test_qgis_process_without_the_core(process):
    if (
        subprocess.run([sys.executable, "-IPsc", "import tin"], capture_output=True, check=False).returncode
        == 0
    ):
        pytest.skip("the core is installed for the whole system")
    made = process("run", "dem2tin:demtotin", f"--INPUT={VOIDS}", "--OUTPUT=t.gpkg", with_core=False)
    assert made.returncode == 1
    assert "pip install" in made.stdout + made.stderr
