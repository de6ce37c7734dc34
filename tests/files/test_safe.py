"""Sentinel-1 products (SAFE): where points lie by the orbit in the file, their level, and what is refused."""

import warnings
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import write_image
from sarmitsuba.radar.geodesy import Anchor

rasterio = pytest.importorskip("rasterio")

PLACES = np.array([[0.0, 0.0, 0.0], [250.0, -400.0, 40.0]])  # m, east, north, up
RCS = 1000.0
SPEED_OF_LIGHT = 299792458.0


def orbit_scene(mode="tops", **changes):
    """Two points seen from orbit by the radar of IW2."""
    own = {"steering_rate_deg": 0.98, "burst": "0"} if mode == "tops" else {}
    numbers = {
        "orbit_altitude": 693e3,
        "orbit_inclination_deg": 98.18,
        "incidence_angle_deg": 39.0,
        "latitude_deg": 48.14,
        "longitude_deg": 11.58,
        "prf": 1452.0,
        "n_pulses": 1535 if mode == "tops" else 0,
        "center_frequency": 5.405e9,
        "bandwidth": 48e6,
        "pulse_width": 60e-6,
        "azimuth_resolution": 22.0,
        "pattern": "gaussian",
        "azimuth_beamwidth_deg": 0.23,
        "elevation_beamwidth_deg": 5.0,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        "epoch": "2026-05-01T05:00:00Z",
        **changes,
    }
    radar = sarmitsuba.RadarDescription(mode=mode, mode_parameters=changes.pop("own", own), **numbers)
    points = [sarmitsuba.PointTarget(f"p{i}", place, RCS) for i, place in enumerate(PLACES)]
    film = sarmitsuba.FilmDescription(image_extent_azimuth=1100.0, image_extent_range=900.0)
    return sarmitsuba.build_scene(points=points, radar=radar, film=film)


@pytest.fixture(scope="module")
def image():
    return sarmitsuba.render(orbit_scene())


@pytest.fixture(scope="module")
def product(image, tmp_path_factory):
    folder = tmp_path_factory.mktemp("safe") / "one.SAFE"
    write_image(image, folder, format="safe")
    return folder


def annotation(folder):
    (path,) = (folder / "annotation").glob("*.xml")
    return ElementTree.parse(path).getroot()


def pixels(folder):
    (path,) = (folder / "measurement").glob("*.tiff")
    with rasterio.open(path) as file:
        assert file.dtypes == ("complex_int16",)
        return file.read(1), file.gcps


def microseconds(text):
    return np.datetime64(text, "us").astype(np.int64)


class Reader:
    """A reader of the product's own annotation, as of other programs: orbit by a polynomial, zero Doppler by search."""

    def __init__(self, folder):
        self.root = root = annotation(folder)
        self.zero = microseconds(root.findtext(".//burst/azimuthTime"))
        orbits = root.findall(".//orbit")
        time = np.array([(microseconds(o.findtext("time")) - self.zero) * 1e-6 for o in orbits])
        state = np.array([[float(o.findtext(f"position/{axis}")) for axis in "xyz"] for o in orbits])
        self.path = np.polynomial.Polynomial.fit  # of each axis
        self.axes = [np.polynomial.Polynomial.fit(time, axis, 7) for axis in state.T]
        self.interval = float(root.findtext(".//azimuthTimeInterval"))
        self.near = 0.5 * SPEED_OF_LIGHT * float(root.findtext(".//imageInformation/slantRangeTime"))
        self.spacing = float(root.findtext(".//rangePixelSpacing"))

    def place(self, point):
        """Line and sample of a point, ECEF."""
        time = 0.0
        for _ in range(20):
            x = np.array([axis(time) for axis in self.axes])
            v = np.array([axis.deriv()(time) for axis in self.axes])
            time += (point - x) @ v / (v @ v) / 0.9
        return time / self.interval, (np.linalg.norm(point - x) - self.near) / self.spacing


def peak(data, line, sample, half=12, fine=32):
    """Place of a peak about a pixel, by zero padding about its own centroid."""
    rows, columns = slice(line - half, line + half), slice(sample - half, sample + half)
    chip = data[rows, columns].astype(np.complex128)
    for axis in (0, 1):
        one = np.moveaxis(chip, axis, 0)
        turn = np.angle(np.sum(one[1:] * one[:-1].conj()))
        ramp = np.exp(-1j * turn * np.arange(2 * half))
        chip = chip * (ramp[:, None] if axis == 0 else ramp)
    spectrum = np.pad(np.fft.fftshift(np.fft.fft2(chip)), (fine - 1) * half)
    found = np.abs(np.fft.ifft2(np.fft.ifftshift(spectrum)))
    at = np.unravel_index(found.argmax(), found.shape)
    return rows.start + at[0] / fine, columns.start + at[1] / fine


def test_points_lie_where_orbit_and_range_say(product):
    data, _ = pixels(product)
    reader = Reader(product)
    anchor = Anchor.of_degrees(48.14, 11.58)
    for place in PLACES:
        line, sample = reader.place(anchor.to_ecef(place))
        found = peak(data, round(line), round(sample))
        # tol: steps of 1/32 pixel, times to the microsecond
        np.testing.assert_allclose(found, (line, sample), atol=0.05)


def test_levels_are_those_of_the_points(product):
    data, _ = pixels(product)
    reader = Reader(product)
    (path,) = (product / "annotation" / "calibration").glob("calibration-*.xml")
    vectors = ElementTree.parse(path).getroot()
    scale = float(vectors.findtext(".//betaNought").split()[0])
    step = float(reader.root.findtext(".//azimuthPixelSpacing")) * reader.spacing
    line, sample = (round(v) for v in reader.place(Anchor.of_degrees(48.14, 11.58).to_ecef(PLACES[0])))
    chip = data[line - 20 : line + 20, sample - 20 : sample + 20]
    found = np.sum(np.abs(chip / scale) ** 2) * step
    assert 10.0 * np.log10(found / RCS) == pytest.approx(0.0, abs=0.1)  # tol: side lobes beyond 20 pixels
    sigma, beta = (float(vectors.findtext(f".//{name}").split()[0]) for name in ("sigmaNought", "betaNought"))
    incidence = np.radians(float(reader.root.findtext(".//antennaPattern//incidenceAngle").split()[0]))
    assert (beta / sigma) ** 2 == pytest.approx(np.sin(incidence))


def test_control_points_hold_the_scene(product):
    _, (points, system) = pixels(product)
    assert system.to_epsg() == 4326
    latitude, longitude = ([getattr(point, axis) for point in points] for axis in "yx")
    assert min(latitude) < 48.14 < max(latitude) and min(longitude) < 11.58 < max(longitude)
    reader = Reader(product)
    for point in points[:: len(points) // 4]:
        ecef = Anchor.of_degrees(point.y, point.x, point.z).origin
        # tol: 1e-6 pixels of rounding, times to the microsecond
        np.testing.assert_allclose(reader.place(ecef), (point.row, point.col), atol=2e-3)


def test_the_ramp_is_that_of_the_annotation(product):
    """A reader's deramping by steering rate and FM rate leaves the point at base band."""
    data, _ = pixels(product)
    reader, root = Reader(product), annotation(product)
    line, sample = (round(v) for v in reader.place(Anchor.of_degrees(48.14, 11.58).to_ecef(PLACES[1])))
    velocity = np.linalg.norm([float(root.findtext(f".//orbit[16]/velocity/{axis}")) for axis in "xyz"])
    frequency = float(root.findtext(".//radarFrequency"))
    k_s = (
        2.0
        * velocity
        * frequency
        / SPEED_OF_LIGHT
        * np.radians(float(root.findtext(".//azimuthSteeringRate")))
    )
    tau = 2.0 * sample * reader.spacing / SPEED_OF_LIGHT
    k_a = np.polyval([float(c) for c in root.findtext(".//azimuthFmRatePolynomial").split()][::-1], tau)
    time = (np.arange(len(data)) - len(data) / 2) * reader.interval
    chip = data[:, sample] * np.exp(-1j * np.pi * k_a * k_s / (k_a - k_s) * time**2)
    chip = chip[line - 8 : line + 9]
    left = np.angle(np.sum(chip[1:] * chip[:-1].conj())) / (2.0 * np.pi * reader.interval)
    before = k_a * k_s / (k_a - k_s) * time[line]
    assert abs(before) > 80.0 and abs(left) < 0.02 * abs(before)


def test_an_archive_holds_one_product(image, tmp_path):
    write_image(image, tmp_path / "image.zip")
    with zipfile.ZipFile(tmp_path / "image.zip") as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names} == {names[0].split("/")[0]}
    assert names[0].startswith("S1A_IW_SLC__1SSV_20260501T045")
    assert sum(name.endswith("manifest.safe") for name in names) == 1 and len(names) == 5


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grid": "ground"}, "slant range"),
        ({"mode": "spotlight"}, "no mode = spotlight"),
        ({"height": 3000.0}, "no orbit"),
    ],
)
def test_refused_in_one_line(image, tmp_path, changes, said):
    facts = {
        key: dict(value) if isinstance(value, dict) else value
        for key, value in image.metadata["focus"].items()
    }
    grid = image.grid
    if "grid" in changes:
        grid = replace(grid, kind="ground")
    if "mode" in changes:
        facts["signal"] = {**facts["signal"], "mode": changes["mode"]}
    if "height" in changes:
        flight = facts["flight"]
        facts["flight"] = {**flight, "center": [*flight["center"][:2], changes["height"]]}
    other = replace(image, grid=grid, metadata={**image.metadata, "focus": facts})
    with pytest.raises(DataError, match=said) as error:
        write_image(other, tmp_path / "x.zip")
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_other_programs_read_it(product):
    """xarray-sentinel reads bursts and orbit, its schemas hold, and sarsen's geocoding finds the points."""
    sentinel = pytest.importorskip("xarray_sentinel")
    sarsen = pytest.importorskip("sarsen")
    import xarray as xr
    from sarsen import geocoding, orbit
    from xarray_sentinel import esa_safe

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for kind, pattern in (
            ("annotation", "annotation/*.xml"),
            ("calibration", "annotation/calibration/calibration*.xml"),
            ("noise", "annotation/calibration/noise*.xml"),
        ):
            (path,) = product.glob(pattern)
            assert not list(esa_safe.cached_sentinel1_schemas(kind).iter_errors(str(path)))
        found = xr.open_dataset(str(product), engine="sentinel-1", group="IW1/VV")
        assert found.attrs["number_of_bursts"] == 1
        burst = sentinel.crop_burst_dataset(found, burst_index=0)
        assert burst.sizes["azimuth_time"] == found.attrs["lines_per_burst"]
        seen = sarsen.Sentinel1SarProduct(str(product), "IW1/VV")
        path = orbit.OrbitPolyfitInterpolator.from_position(seen.state_vectors())
        data = found.measurement.values
        for place in PLACES:
            point = Anchor.of_degrees(48.14, 11.58).to_ecef(place).reshape(1, 1, 3)
            dem = xr.DataArray(
                point, dims=("y", "x", "axis"), coords={"axis": [0, 1, 2], "y": [0.0], "x": [0.0]}
            )
            there = geocoding.backward_geocode(dem, path)
            late = (there.azimuth_time.values.item() - found.azimuth_time.values[0].astype(np.int64)) * 1e-9
            slant = float(np.linalg.norm(there.dem_distance.values))
            sample = slant - 0.5 * SPEED_OF_LIGHT * found.attrs["image_slant_range_time"]
            at = late / found.attrs["azimuth_time_interval"], sample / found.attrs["range_pixel_spacing"]
            # tol: steps of 1/32 pixel, times to the microsecond
            np.testing.assert_allclose(peak(data, round(at[0]), round(at[1])), at, atol=0.05)
