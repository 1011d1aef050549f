"""The configuration: what is accepted, and what every refusal says."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt import config as configuration
from mip_rt.config import commands, documentation, scenario
from mip_rt.config.loading import Section
from mip_rt.config.robots import ROBOTS
from mip_rt.errors import ConfigError


def refused(text, **overrides):
    with pytest.raises(ConfigError) as caught:
        configuration.loads(text, "robot.yaml", overrides or None)
    return str(caught.value)


@pytest.mark.parametrize("robot", ROBOTS)
def test_shipped_file_is_the_template_and_loads_to_the_defaults(robot):
    text = documentation.template(robot)
    path = configuration.default_path(robot)
    assert path.read_text() == text, f"run: mip-rt config template --robot {robot} > config/{robot}.yaml"
    assert configuration.load(path).to_yaml() == configuration.loads("", expected=robot).to_yaml()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("realtime: {rate_hz: 150}", ("realtime.rate_hz", "200 or 100")),
        ("control: {filter_set: publik}", ("control.filter_set", "did you mean 'public'")),
        ("control: {lqr: {yaw_rates_rad_s: [0, 5, 5]}}", ("yaw_rates_rad_s", "ascend")),
        ("control: {filters: {mine: {inner_denominator: [0, 1, 1]}}}", ("control.filters", "must not be zero")),
        ("motors: {channels: [2, 2]}", ("motors.channels", "different")),
        ("wheels: {}", ("wheels", "no such key")),
        ("robot: mbbr", ("configuration of 'mbbr'", "asked for was 'edumip'")),
    ],
)
def test_refusals_of_the_edumip(text, parts):
    with pytest.raises(ConfigError) as caught:
        configuration.loads(text, "robot.yaml", expected="edumip")
    for part in parts:
        assert part in str(caught.value)


def test_an_unknown_robot_is_refused_by_name():
    assert "one of mbbr, edumip" in refused("robot: edumib") and "did you mean 'edumip'" in refused("robot: edumib")


def test_a_yaw_rate_may_be_written_in_radians():
    level = configuration.loads("robot: edumip\nremote: {levels: [{button: none}, {button: cross, yaw_rate_hz: -7 rad/s}]}").remote.levels[1]
    assert level.yaw_rate_hz == pytest.approx(-7.0 / 2.0 / math.pi)


def test_effective_configuration_loads_again_to_the_same():
    text = configuration.loads("limits: {tip_rad: 40 deg}").to_yaml()
    assert configuration.loads(text).to_yaml() == text


@pytest.mark.parametrize(
    ("text", "path", "wanted"),
    [
        ("limits: {tip_rad: 40 deg}", "limits.tip_rad", math.radians(40)),
        ("motor: {pwm_frequency_hz: 10 kHz}", "motor.pwm_frequency_hz", 10000.0),
        ("model: {ball_radius_m: 3.2 cm}", "model.ball_radius_m", 0.032),
        ("estimator: {initial_covariance: 1e-5}", "estimator.initial_covariance", 1e-5),
        ("imu: {address: 0x69}", "imu.address", 0x69),
    ],
)
def test_units_and_number_forms(text, path, wanted):
    value = configuration.loads(text)
    for name in path.split("."):
        value = getattr(value, name)
    assert value == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("limits:\n  tip_rda: 1\n", ("robot.yaml:2", "limits.tip_rda", "did you mean 'tip_rad'")),
        ("limts: {}\n", ("robot.yaml:1", "limts", "did you mean 'limits'")),
        ("limits:\n  duty: 3\n", ("robot.yaml:2", "limits.duty", "at most 1", "found 3")),
        ("limits:\n  tip_rad: 1 kg\n", ("robot.yaml:2", "rad or deg", "'kg'")),
        ("limits: {tip_rad: yes}\n", ("limits.tip_rad", "expected a number", "True")),
        ("limits: {tip_rad: .nan}\n", ("limits.tip_rad", "finite")),
        ("limits: {tip_rad: .inf}\n", ("limits.tip_rad", "finite")),
        ("limits: {tip_rad: [1]}\n", ("limits.tip_rad", "expected a number")),
        ("limits: 5\n", ("robot.yaml:1", "limits", "expected keys")),
        ("estimator: {control: efk}\n", ("estimator.control", "one of ekf", "did you mean 'ekf'")),
        ("encoders: {signs: [1, 1]}\n", ("encoders.signs", "2 items")),
        ("encoders: {signs: [1, 0, 1]}\n", ("encoders.signs", "1 or -1")),
        ("motor: {drive: coast}\nmotor: {drive: brake}\n", ("robot.yaml:2", "second time", "line 1")),
        ("a: [1\n", ("not valid YAML",)),
        ("- 1\n- 2\n", ("expected keys and values",)),
        ("wheels: {body_from_wheel: [[1, 0, 0], [0, 1, 0], [0, 0.5, 1]]}\n", ("wheels.body_from_wheel", "perpendicular")),
        ("imu: {mounting: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}\n", ("imu.mounting", "mirror")),
        ("remote: {timeout_s: 0.4}\n", ("remote.timeout_s", "at most 0.5 s")),
        ("control:\n  schedule:\n    - {yaw_rate_hz: 0, set: rek}\n", ("robot.yaml:2", "no gain set 'rek'", "did you mean 'rec'")),
        ("control: {schedule: [{yaw_rate_hz: 1, set: rec}, {yaw_rate_hz: 0, set: rec}]}\n", ("ascend",)),
        ("estimator: {control: ekf, shadows: [ekf]}\n", ("estimator.shadows", "twice")),
        ("imu: {gyro_range_dps: 500}\n", ("only at 2000",)),
        ("control: {gain_sets: {mine: {c9: 1}}}\n", ("control.gain_sets.mine.c9", "no such key")),
    ],
)
def test_refusals_name_file_line_key_and_expectation(text, parts):
    message = refused(text)
    for part in parts:
        assert part in message, message


def test_all_errors_are_reported_together():
    message = refused("limits:\n  duty: 3\n  tip_rda: 1\nmotor:\n  drive: fast\n")
    assert message.count("robot.yaml:") == 3 and "3 errors" in message


def test_overrides():
    assert configuration.loads("", overrides={"estimator.shadows": "[kf]", "control.gain_sets.table_6.2_0.50.c1": "13"}).estimator.shadows == ("kf",)
    assert "--set" in refused("", **{"limits.duty": "7"})
    assert configuration.parse_override("a.b=c=d") == ("a.b", "c=d")
    with pytest.raises(ConfigError, match="key=value"):
        configuration.parse_override("nonsense")


def test_a_user_gain_set_can_be_scheduled():
    text = "control:\n  gain_sets:\n    mine: {c1: 21, c2: 0.4}\n  schedule:\n    - {yaw_rate_hz: 0, set: mine}\n"
    assert configuration.loads(text).control.gain_sets.mine.c1 == 21.0


def test_configuration_does_not_change():
    with pytest.raises(AttributeError):
        configuration.loads("").limits.duty = 2


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_key_is_documented_and_reachable(robot):
    config = configuration.loads("", expected=robot)
    table = documentation.documentation(robot)
    listed = documentation.keys(robot)
    assert len(listed) > 120
    for key, doc in listed:
        assert len(doc) > 3 or key.endswith(".set"), key
        assert f"`{key}`" in table

    def leaves(section, prefix=""):
        for name, value in vars(section).items():
            yield from leaves(value, f"{prefix}{name}.") if isinstance(value, Section) else [f"{prefix}{name}"]

    known = {key for key, _ in listed}
    assert {leaf for leaf in leaves(config) if "gain_sets" not in leaf and "filters" not in leaf} <= known


@given(st.text(max_size=200))
def test_any_text_is_accepted_or_refused_with_a_config_error(text):
    for load in (configuration.loads, scenario.loads):
        try:
            load(text)
        except ConfigError:
            pass


JSONISH = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["x", "c1", "set", "duty", "tip_rad"]), inner, max_size=4),
    max_leaves=8,
)


@given(st.sampled_from([key for key, _ in documentation.keys("mbbr") if "<" not in key and "[" not in key]), JSONISH)
def test_any_value_at_any_key_is_accepted_or_refused(key, value):
    import yaml

    tree = value
    for name in reversed(key.split(".")):
        tree = {name: tree}
    try:
        config = configuration.loads(yaml.safe_dump(tree))
        assert config.limits.imu_silence_s < 0.05
    except ConfigError as error:
        assert "cure" in str(error)


def test_unreadable_files():
    with pytest.raises(ConfigError, match="No such file"):
        configuration.load("/nowhere/x.yaml")
    with pytest.raises(ConfigError):
        configuration.load("/dev")


def test_shipped_scenarios_load_and_press_the_button():
    names = scenario.shipped()
    wanted = {"hold", "spin-0.5", "spin-1.0", "spin-1.5", "drive-spin-1.0", "dissertation-6.4.5"}
    assert wanted <= set(names)
    for name in names:
        found = scenario.load(name)
        assert [event.press for event in found.events].count("arm") == 1 and found.description


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("events:\n  - {at_s: 1, pres: arm}\n", (":2", "did you mean 'press'")),
        ("events:\n  - {at_s: 1, press: amr}\n", ("one of arm",)),
        ("events:\n  - {press: arm}\n", ("at_s is missing",)),
        ("events:\n  - {at_s: 1, set: {batery_v: 6}}\n", ("did you mean 'battery_v'",)),
        ("events: 5\n", ("expected a list",)),
        ("evnts: []\n", ("did you mean 'events'",)),
        ("events:\n  - {at_s: 1, speed_m_s: 0.2}\n", ("list of 2",)),
    ],
)
def test_scenario_refusals(text, parts):
    with pytest.raises(ConfigError) as caught:
        scenario.loads(text, "my.yaml")
    for part in parts:
        assert part in str(caught.value)


def test_unknown_scenario_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'spin-1.0'"):
        scenario.load("spin-1.00")


def test_commands(capsys, tmp_path):
    def call(action, config=None, **changes):
        arguments = dict(action=action, robot="mbbr", config=config, set=[])
        return commands.run(SimpleNamespace(**{**arguments, **changes}))

    assert call("check") == 0 and "ok" in capsys.readouterr().out
    assert call("show", set=["limits.duty=0.5"]) == 0 and "duty: 0.5" in capsys.readouterr().out
    assert call("docs") == 0 and "| `limits.duty` |" in capsys.readouterr().out
    bad = tmp_path / "bad.yaml"
    bad.write_text("limits: {duty: 9}\n")
    assert call("check", config=str(bad)) == 2 and "bad.yaml:1" in capsys.readouterr().err
