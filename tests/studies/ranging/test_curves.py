"""Curves along any axis, where they cross, and what the sensors of a sweep are called."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pytest
from helpers.mistakes import mistakes, told

from lidarscene import catalog, load_sensor
from lidarscene.errors import OptionWarning
from lidarscene.studies.ranging import aperture_laws, plane
from lidarscene.studies.ranging.aperture_laws import LAWS
from lidarscene.studies.ranging.conditions import Bounds
from lidarscene.studies.ranging.curves import Question, SweepCurve, _difference, _refine, curves, is_flat, with_haze
from lidarscene.studies.ranging.plane import RangeStatus, Target
from lidarscene.studies.ranging.subjects import subjects
from lidarscene.studies.ranging.sweep_axes import condition_axis, numeric_keys, parameter_axis, require_within_law

BOTH = subjects(["table1-apd", "table1-sipm"])


def swept_over(key, among=BOTH, *, start=None, stop=None, count=50, log=None, **question):
    if key in ("distance", "illuminance_klux", "elevation", "azimuth", "reflectivity", "incidence"):
        axis = condition_axis(key, start=start, stop=stop, count=count, log=log)
    else:
        files = [(subject.where, subject.changed) for subject in among]
        axis = parameter_axis(key, files, start=start, stop=stop, count=count, log=log)
    quantity = question.pop("quantity", "snr" if key == "distance" else "range")
    return curves(among, Question(quantity=quantity, axis=axis, **question))


# --- crossings --------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 7, 200])
def test_equal_ranges_of_table_1(count):
    """docs/validation.md: 3.22191 klux. However coarse the axis is, a crossing is refined to 1e-10."""
    (crossing,) = swept_over("illuminance_klux", count=count, probability=0.5).crossings
    assert crossing.place == pytest.approx(3.22191, rel=1e-5)
    assert crossing.place == pytest.approx(
        plane.equal_range_illuminance_klux(BOTH[0].sensor(), BOTH[1].sensor(), Target()), rel=1e-9
    )
    assert (crossing.first, crossing.second) == ("table1-apd", "table1-sipm")
    assert not crossing.falls  # the APD rises over the SiPM as the light grows
    assert crossing.value == pytest.approx(722.14, rel=1e-5)


@pytest.mark.parametrize("log", [True, False])
def test_snr_falls_through_the_threshold_at_the_maximum_range(log):
    """docs/validation.md: 350.605 m and 280.871 m."""
    swept = swept_over("distance", log=log, probability=0.5)
    assert swept.crossings == ()
    first, second = swept.detection_limits
    assert (first.first, first.place) == ("table1-apd", pytest.approx(350.605, rel=1e-5))
    assert (second.first, second.place) == ("table1-sipm", pytest.approx(280.871, rel=1e-5))
    assert [first.value, second.value] == pytest.approx([5.0, 5.0], rel=1e-9)
    assert first.falls


def test_limit_along_a_parameter():
    """The power at which 350.605 m becomes the limit is Table 1's."""
    swept = swept_over("laser.peak_power_w", BOTH[:1], quantity="snr", distance_m=350.604565, probability=0.5)
    (limit,) = swept.detection_limits
    assert limit.place == pytest.approx(45.0, rel=1e-7)
    assert not limit.falls


def test_whole_numbers_cross_at_a_whole_number():
    """The first number of cells from which the SiPM outranges a shorter SiPM; bracketed by its neighbour."""
    pair = subjects(["table1-sipm", "table1-sipm"], ["detector.statistics=published"])
    stronger = pair[1].__class__(
        name="other",
        argument="other",
        where="other",
        tables=pair[1].tables,
        folder=pair[1].folder,
        overrides=("detector.pde=0.3",),
    )
    swept = swept_over("detector.cells", [pair[0], stronger], start=100, stop=4000, count=30, log=True)
    assert (swept.question.axis.values == np.rint(swept.question.axis.values)).all()
    for crossing in swept.crossings:
        assert crossing.place == int(crossing.place)


def test_no_crossing_of_a_curve_with_itself():
    twins = subjects(["table1-apd", "table1-apd"])
    assert swept_over("illuminance_klux", twins).crossings == ()
    assert swept_over("distance", twins, quantity="pd").crossings == ()


def test_a_jump_is_no_crossing():
    """A saturated SiPM's range jumps to 0 past some light, below a weak APD's: they are never equal."""
    weak_lidars = subjects(
        ["table1-sipm", "table1-apd"], ["table1-sipm:detector.cells=40", "table1-apd:laser.peak_power_w=0.001"]
    )
    with pytest.warns(OptionWarning, match="no sun has more than 140"):
        swept = swept_over("illuminance_klux", weak_lidars, start=1.0, stop=1e4, count=80)
    assert set(swept.curves[0].status) == {RangeStatus.FOUND, RangeStatus.NEVER_DETECTED, RangeStatus.SATURATED}
    for crossing in swept.crossings:
        values = [abs(np.interp(crossing.place, swept.question.axis.values, curve.values)) for curve in swept.curves]
        assert all(math.isfinite(value) for value in values)
        assert crossing.value > 0.0


# --- values -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "start", "stop"),
    [
        ("detector.gain", 20, 200),
        ("optics.aperture_radius_mm", 5, 50),
        ("laser.wavelength_nm", 850, 1064),
        ("tdc.bandwidth_mhz", 10, 500),
        ("scanner.azimuth_step_deg", 0.1, 1.0),
    ],
)
def test_parameters_are_those_of_the_file(key, start, stop):
    """Reference: a sensor loaded anew for each value."""
    (curve,) = swept_over(key, BOTH[:1], start=start, stop=stop, count=5, visibility_m=5000.0).curves
    for value, curve_value in zip(np.geomspace(start, stop, 5), curve.values, strict=True):
        sensor = load_sensor("table1-apd", overrides=[f"{key}={value!r}".replace("np.float64(", "").replace(")", "")])
        from lidarscene.physics.optics import air

        alpha = air.extinction_from_visibility_per_m(visibility_m=5000.0, wavelength_m=sensor.laser.wavelength_m)
        expected = plane.detection_range_m(sensor, Target(extinction_per_m=alpha), 0.9)[0]
        assert curve_value == pytest.approx(expected, rel=1e-9)


def test_what_does_not_matter_is_flat():
    assert is_flat(swept_over("scanner.azimuth_step_deg", BOTH[:1]).curves[0])
    assert is_flat(swept_over("elevation", BOTH[:1]).curves[0])
    assert not is_flat(swept_over("elevation", BOTH[:1], law="cosine").curves[0])


def test_incidence_and_reflectivity():
    """Far out SNR goes with cos(theta): range at 60 degrees is sqrt(1/2) of the APD's at 0."""
    (apd,) = swept_over("incidence", BOTH[:1], start=0, stop=90, count=4).curves  # 0, 30, 60, 90
    assert apd.values[2] / apd.values[0] == pytest.approx(math.sqrt(0.5), rel=1e-9)
    assert apd.status[3] in (RangeStatus.NEVER_DETECTED, RangeStatus.FOUND)
    assert apd.values[3] < 0.01 * apd.values[0]
    (apd,) = swept_over("reflectivity", BOTH[:1], start=0.0, stop=1.0, log=False, count=3).curves
    assert apd.status[0] == RangeStatus.NEVER_DETECTED
    assert apd.values[2] > apd.values[1] > apd.values[0] == 0.0


def test_aperture_laws_by_hand():
    angle = np.array([-30.0, 0.0, 30.0])
    assert LAWS["cosine"](angle) == pytest.approx([math.sqrt(0.75), 1.0, math.sqrt(0.75)])
    root_half = math.sqrt(0.5)
    assert LAWS["mirror"](angle) == pytest.approx([math.sqrt(0.75) / root_half, 1.0, 0.5 / root_half])


@dataclass(frozen=True)
class Halving:
    """A scanner whose aperture falls from 1 in the middle to 1/2 at 10 degrees of elevation, both ways."""

    pulses: int = 201 * 41
    typical_share: float = 1.0

    def angles(self, pulse):
        row, column = np.divmod(np.asarray(pulse), 201)
        return np.radians(column / 10.0 - 10.0), np.radians(row / 2.0 - 10.0)

    def aperture_share(self, pulse):
        return 1.0 - 0.05 * np.abs(np.degrees(self.angles(pulse)[1]))

    def background_share(self, pulse):
        return 0.0 * np.asarray(pulse) + 2.0


def test_prisms_leave_the_background():
    """Refraction trades aperture for field of view: in the sun the range goes with the root of the share."""
    avia = subjects(["livox-avia"])
    (found,) = swept_over("elevation", avia, start=0, stop=30, count=2).curves
    echo, background = aperture_laws.of_scanner(avia[0].sensor().scanner, "elevation", np.array([0.0, 30.0]))
    target = Target(aperture_share=echo, background_share=1.0)
    assert background == pytest.approx(np.ones(2))
    assert echo[0] > 1.3 * echo[1]
    assert found.values == pytest.approx(plane.detection_range_m(avia[0].sensor(), target, 0.9)[0], rel=1e-9)


@pytest.mark.parametrize("name", ["livox-avia", "livox-horizon", "livox-mid-360", "livox-mid-40"])
def test_ranges_are_told_for_the_mean_echo_behind_prisms(name):
    """An echo is the mean of those that `render` has of a later frame; the background is that of the lens."""
    sensor = load_sensor(name)
    lens = dataclasses.replace(sensor, scanner=load_sensor("table1-apd").scanner)
    told, whole = (plane.echoes_of_plane(each, Target(), 50.0) for each in (sensor, lens))
    pulse = np.arange(7 * sensor.scanner.pulses, 8 * sensor.scanner.pulses, dtype=np.uint32)
    share = np.mean(sensor.scanner.aperture_share(pulse))
    assert told.peak_power_w / whole.peak_power_w == pytest.approx(share, rel=5e-3)
    assert told.background_power_w == pytest.approx(whole.background_power_w, rel=1e-12)


def test_aperture_of_a_scanner():
    angle = np.array([-10.0, -5.0, 0.0, 2.5, 10.0])
    echo, background = aperture_laws.of_scanner(Halving(), "elevation", angle)
    assert echo == pytest.approx([0.5, 0.75, 1.0, 0.875, 0.5])
    assert background == pytest.approx(np.full(5, 2.0))
    assert aperture_laws.of_scanner(Halving(), "azimuth", angle)[0] == pytest.approx(np.ones(5))
    assert aperture_laws.field_of_view_deg(Halving(), "elevation") == (-10.0, 10.0)
    with told("field of view | -10 | 10"):
        aperture_laws.of_scanner(Halving(), "elevation", np.array([0.0, 10.5]))


def test_a_rasters_aperture_is_constant():
    shares = aperture_laws.of_scanner(BOTH[0].sensor().scanner, "azimuth", np.array([0.0, 170.0]))
    assert [list(share) for share in shares] == [[1.0, 1.0]] * 2


# --- axes -------------------------------------------------------------------------------------------


def test_default_axes():
    axis = condition_axis("distance", start=None, stop=None, count=11, log=None)
    assert (axis.column, axis.label, axis.log) == ("distance_m", "distance [m]", True)
    assert (axis.values[0], axis.values[-1]) == (10.0, 1000.0)
    for key, column in (
        ("illuminance_klux", "illuminance_klux"),
        ("reflectivity", "reflectivity"),
        ("incidence", "incidence_deg"),
    ):
        assert condition_axis(key, start=None, stop=None, count=3, log=None).column == column


def test_parameters_run_to_their_bounds():
    tables = [("apd", BOTH[0].changed)]

    def axis(key, **ends):
        return parameter_axis(key, tables, **({"start": None, "stop": None, "count": 5, "log": None} | ends))

    gain = axis("detector.gain")
    assert (gain.values[0], gain.values[-1], gain.column) == (16.0, 400.0, "detector.gain")
    assert axis("detector.quantum_efficiency").values[-1] == 1.0
    assert axis("optics.aperture_radius_mm").label == "optics.aperture_radius [mm]"
    assert axis("tdc.bandwidth_mhz").unit == "MHz"
    assert list(axis("tdc.stops", start=1, stop=3, log=False).values) == [1.0, 2.0, 3.0]


def test_every_number_of_a_sensor_file_is_a_key():
    keys = numeric_keys(BOTH[1].changed)
    for table, entries in BOTH[1].changed.items():
        if isinstance(entries, dict) and table not in ("sources", "uncertainty"):
            numbers = {f"{table}.{key}" for key, value in entries.items() if isinstance(value, (int, float))}
            assert numbers <= set(keys)
    assert "detector.gain" not in keys
    assert keys["detector.cells"].whole


@mistakes(
    """
    detector.gian | detector.gian | detector.gain
    name | over name | table1-apd.toml
    distanze | distanze | distance
    detector.circuit_noise_na | 0 in table1-apd.toml
    detector.ionisation_ratio | not given in table1-apd.toml
    """
)
def test_keys_that_cannot_be_swept(given: str, named: str) -> None:
    with told(named):
        swept_over(given, BOTH[:1])


# --- sensors ----------------------------------------------------------------------------------------


def test_equal_names_get_numbers(tmp_path):
    text = catalog.path_of("sensors", "table1-apd").read_text("utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("gain = 80", "gain = 40"))
    lidars = subjects(["table1-apd", str(tmp_path / "mine.toml"), "table1-sipm"])
    assert [lidar.name for lidar in lidars] == ["table1-apd", "table1-apd (2)", "table1-sipm"]
    assert lidars[1].sensor().detector.gain == 40.0


def test_assignments_for_one_and_for_all():
    lidars = subjects(
        ["table1-apd", "table1-sipm"], ["laser.peak_power_w=50", "table1-apd:detector.gain=30", "name='x'"]
    )
    assert [lidar.sensor().laser.peak_power_w for lidar in lidars] == [50.0, 50.0]
    assert lidars[0].sensor().detector.gain == 30.0
    assert [lidar.name for lidar in lidars] == ["x", "x (2)"]


@pytest.mark.parametrize(("above", "value", "refused"), [(True, 0.0, True), (False, 0.0, False), (True, 1e-9, False)])
def test_a_bound_that_is_excluded(above, value, refused):
    bounds = Bounds(unit="m", low=0.0, high=9.0, start=1.0, stop=2.0, above=above)
    if refused:
        with told("distance 0 | 9 m"):
            bounds.check("distance", value)
    else:
        bounds.check("distance", value)


@pytest.mark.parametrize(("width", "crosses"), [(1e-12, False), (1.0, True)])
def test_only_what_passes_through_zero_crosses(width, crosses):
    """A height that falls from 0.5 to -0.5 around 5: at once it is a jump, over a width of one it crosses there."""
    axis = condition_axis("illuminance_klux", start=1.0, stop=9.0, count=3, log=True)

    def height_at(x):
        return np.clip((5.0 - x) / width, -0.5, 0.5), 2.0 * x

    crossing = _refine(axis, height_at, 1.0, 9.0, falls=True)
    assert (crossing is not None) is crosses
    if crosses:
        assert crossing == pytest.approx((5.0, 10.0), rel=1e-9)


def test_haze_comes_on_top_of_what_the_air_takes():
    sensor = load_sensor("table1-apd")
    alpha = with_haze(sensor, Target(), 1000.0).extinction_per_m
    assert alpha > 1e-3
    assert with_haze(sensor, Target(extinction_per_m=0.01), 1000.0).extinction_per_m == pytest.approx(0.01 + alpha)
    assert with_haze(sensor, Target(extinction_per_m=0.01), None).extinction_per_m == 0.01


def test_of_whole_numbers_the_first_on_the_other_side_is_told():
    """A height that passes zero between 5 and 6."""
    axis = dataclasses.replace(condition_axis("illuminance_klux", start=1.0, stop=9.0, count=3, log=False), whole=True)
    assert _refine(axis, lambda x: (5.5 - x, 10.0 * x), 1.0, 9.0, falls=True) == (6.0, 60.0)


def test_angles_and_ends_that_make_no_axis():
    within, beyond = (condition_axis("elevation", start=0.0, stop=stop, count=3, log=False) for stop in (89.0, 89.5))
    require_within_law(within)
    with told("89 degrees"):
        require_within_law(beyond)
    with told("start | stop"):
        condition_axis("distance", start=5.0, stop=5.0, count=3, log=None)


def test_a_fifth_of_a_number_stops_at_its_bound():
    """A gain of three: from one, the least that there is, to fifteen."""
    (lidar,) = subjects(["table1-apd"], ["detector.gain=3"])
    axis = parameter_axis("detector.gain", [(lidar.where, lidar.changed)], start=None, stop=None, count=3, log=None)
    assert (axis.values[0], axis.values[-1]) == (1.0, 15.0)


def test_what_has_no_limit_is_ahead():
    axis = condition_axis("illuminance_klux", start=1.0, stop=9.0, count=3, log=True)
    question = Question(quantity="range", axis=axis)
    unlimited, limited = (SweepCurve(name="", values=np.array([value])) for value in (np.inf, 70.0))
    assert _difference(question, unlimited, limited)[0] > 0.0 > _difference(question, limited, unlimited)[0]
    assert _difference(question, unlimited, unlimited)[0] == 0.0
