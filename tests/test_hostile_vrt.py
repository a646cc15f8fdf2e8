"""VRTs that name what they should not, and the network."""

import gzip
import http.server
import threading

import pytest
import rasterio
import rasterio.shutil
from hostile import HEIGHTS, refused, vrt, write

from tin.reader import open as open_dem


@pytest.mark.parametrize("kind", ["SimpleSource", "ComplexSource"])
def test_vrt_that_names_a_missing_file(tmp_path, kind):
    refused(vrt(tmp_path / "dem.vrt", "missing.tif", kind=kind), "unreadable", says="missing.tif")


def test_vrt_that_names_itself(tmp_path):
    refused(vrt(tmp_path / "dem.vrt", "dem.vrt"), "unreadable")


@pytest.mark.parametrize("text", ["<VRTDataset rasterXSize=", "<VRTDataset></VRTDataset>", "<VRTDataset>\0"])
def test_broken_vrt(tmp_path, text):
    (tmp_path / "dem.vrt").write_text(text)
    refused(tmp_path / "dem.vrt", "unreadable")


def test_vrt_may_mention_an_address_in_its_metadata(tmp_path):
    write(tmp_path / "dem.tif")
    extra = '<Metadata><MDI key="source">https://example.org/dem</MDI></Metadata>'
    assert open_dem(vrt(tmp_path / "dem.vrt", extra=extra)).n_valid == HEIGHTS.size


def test_a_geotiff_may_hold_xml_in_its_tags(tmp_path):
    path = write(tmp_path / "dem.tif")
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(note="<VRTDataset> https://example.org")
    assert b"<GDALMetadata" in path.read_bytes()
    assert open_dem(path).n_valid == HEIGHTS.size


@pytest.mark.parametrize(
    "name",
    [
        "http://example.org/dem.tif",
        "HTTPS://example.org/dem.tif",
        "s3://bucket/dem.tif",
        "zip+https://example.org/a.zip!dem.tif",
        "/vsicurl/https://example.org/dem.tif",
        "/vsis3/bucket/dem.tif",
        "/vsigzip//vsicurl/ftp://example.org/dem.gz",
        "/vsicurl_streaming/https://example.org/dem.tif",
        "WMS:https://example.org/wms?",
        "EEDAI:image",
        'NETCDF:"https://example.org/a.nc":z',
    ],
)
def test_remote_names_are_refused(name):
    refused(name, "remote", says="allow_remote")


@pytest.fixture
def server(tmp_path):
    requests = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(tmp_path))

        def parse_request(self):
            requests.append(self.raw_requestline)
            return super().parse_request()

        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as httpd:
        thread = threading.Thread(target=httpd.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{httpd.server_port}", requests
        httpd.shutdown()
        thread.join()


def test_vrt_that_names_remote_files_is_refused_unless_asked_for(tmp_path, server):
    address, requests = server
    write(tmp_path / "dem.tif")
    remote = vrt(tmp_path / "remote.vrt", f"/vsicurl/{address}/dem.tif")
    nested = vrt(tmp_path / "nested.vrt", "remote.vrt")
    (tmp_path / "wms.xml").write_text(
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{address}/${{z}}.png</ServerUrl></Service></GDAL_WMS>'
    )
    by_wms = vrt(tmp_path / "by_wms.vrt", "wms.xml")
    for path in (remote, nested, tmp_path / "wms.xml", by_wms):
        refused(path, "remote", says="names the remote source")
    assert requests == []
    assert open_dem(remote, allow_remote=True).n_valid == HEIGHTS.size
    assert requests


def test_the_second_lock_holds_where_the_check_sees_nothing(tmp_path, server):
    address, requests = server
    write(tmp_path / "dem.tif")
    hidden = f"&#47;vsicurl&#47;{address}/dem.tif"
    packed = tmp_path / "remote.vrt.gz"
    plain = vrt(tmp_path / "remote.vrt", hidden)
    refused(plain, "remote")
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    refused(packed, "unreadable")
    assert requests == []
