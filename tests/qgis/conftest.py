"""A real QGIS without a window, in a fresh profile. For the Python that QGIS uses: see the Makefile."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

if importlib.util.find_spec("qgis") is None:  # the ordinary test run, in the virtual environment
    collect_ignore_glob = ["test_*.py"]
else:
    profile = tempfile.mkdtemp(prefix="dem2tin-qgis-")
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    os.environ["GDAL_PAM_ENABLED"] = "NO"  # no .aux.xml beside the samples
    os.environ.update(HOME=profile, XDG_RUNTIME_DIR=profile, QGIS_CUSTOM_CONFIG_PATH=profile)
    sys.path += [str(ROOT / "qgis_plugin"), "/usr/share/qgis/python/plugins"]

    status = pytest.StashKey[int]()

    def pytest_sessionfinish(session, exitstatus):
        """Remember the result for the exit below."""
        session.config.stash[status] = int(exitstatus)

    @pytest.hookimpl(trylast=True)
    def pytest_unconfigure(config):
        """Leave without Python's own clearing up: GDAL's bindings crash in it once QGIS has closed GDAL."""
        shutil.rmtree(profile, ignore_errors=True)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash.get(status, 1))


@pytest.fixture(scope="session")
def app():
    """QGIS, started once."""
    from qgis.core import QgsApplication

    application = QgsApplication([], True)
    application.initQgis()
    yield application
    application.exitQgis()


@pytest.fixture(scope="session")
def provider(app):
    """The plugin's provider, registered beside QGIS's own."""
    from dem2tin.provider import Provider
    from processing.core.Processing import Processing

    Processing.initialize()
    made = Provider()
    assert app.processingRegistry().addProvider(made)
    yield made
    app.processingRegistry().removeProvider(made)


@pytest.fixture
def project(app):
    """An empty project; its layers are gone before QGIS is."""
    from qgis.core import QgsProject

    made = QgsProject.instance()
    made.clear()
    yield made
    made.clear()


@pytest.fixture
def run(provider):
    """``run(name, feedback=None, **parameters)``: results of an algorithm of the plugin."""
    import processing

    def run(name, feedback=None, **parameters):
        from support import Feedback

        parameters = {
            key: str(value) if isinstance(value, Path) else value for key, value in parameters.items()
        }
        return processing.run(f"dem2tin:{name}", parameters, feedback=feedback or Feedback())

    return run


@pytest.fixture(scope="session")
def command():
    """``command(*arguments)``: run the command line, which must succeed."""
    program = os.environ.get("DEM2TIN", str(ROOT / ".venv" / "bin" / "dem2tin"))
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def command(*arguments):
        made = subprocess.run(
            [program, *map(str, arguments)], capture_output=True, text=True, check=False, env=clean
        )
        assert made.returncode == 0, made.stderr
        return made.stdout

    return command


@pytest.fixture
def process(tmp_path):
    """``process(*arguments, core=True)``: qgis_process in a fresh profile, with the zip's folder."""
    make_zip = ROOT / "qgis_plugin" / "make_zip.py"
    subprocess.run([sys.executable, make_zip, tmp_path / "x.zip"], check=True)
    plugins = tmp_path / "plugins"
    with zipfile.ZipFile(tmp_path / "x.zip") as archive:
        archive.extractall(plugins)
    import tin

    core = str(Path(tin.__file__).parents[1])

    def process(*arguments, with_core=True):
        environment = {
            **{name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
            # QGIS takes its Python's libraries from beside the first python3 there is.
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
            "QGIS_PLUGINPATH": str(plugins),
            "HOME": str(tmp_path),
            "QGIS_CUSTOM_CONFIG_PATH": str(tmp_path / "profile"),
            "PYTHONNOUSERSITE": "1",
            **({"PYTHONPATH": core} if with_core else {}),
        }
        return subprocess.run(
            ["qgis_process.bin", *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            cwd=tmp_path,
        )

    assert process("plugins", "enable", "dem2tin").returncode == 0
    return process
