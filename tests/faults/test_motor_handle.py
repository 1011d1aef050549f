"""The supervisor's handle is the only way to PWM, direction and enable lines: by who imports what, and by who touches the attribute."""

import ast
from pathlib import Path

import mip_rt

PACKAGE = Path(mip_rt.__file__).parent
# Who may know of each module: motors.py drives the channels, devices.py opens it for the supervisor, motor_bench.py for short pulses while nothing runs,
# which doctor asks for (and calibrate through doctor), always after a typed yes, and `bench board`, which only times writes of zero.
IMPORTERS = {
    "mip_rt.hardware.pwm": {"hardware/motors.py"},
    "mip_rt.hardware.motors": {"hardware/devices.py", "hardware/motor_bench.py"},
    "mip_rt.hardware.motor_bench": {"doctor/motors.py"},
    "mip_rt.doctor.motors": {"calibrate/motors.py", "lab/board.py"},
}
PULSES = {"doctor/motors.py", "calibrate/motors.py"}  # who calls MotorBench.pulse
# The class that drives lines; a board's table that gives a lamp a motor's line is refused (tests/hardware/test_boards.py).
OUTPUT_LINES = {"hardware/gpio.py", "hardware/motors.py", "hardware/leds.py", "guard.py"}
ATTRIBUTE = {"hardware/devices.py": {"close"}, "session.py": set()}  # methods called on a `.motors` there
TREES = {str(path.relative_to(PACKAGE)): ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}


def imported(tree):
    """Full names of all modules and of what is taken from them, relative imports, import_module and __import__ included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports are not used here, and this test would not see them"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("mip_rt.hardware."):
            yield node.value


def uses(tree, name):
    """Attribute accesses `x.name`, each with the attribute or method taken from it (None where the object itself is handed on)."""
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == name:
            parent = parents[node]
            yield parent.attr if isinstance(parent, ast.Attribute) else None


def test_only_the_drivers_import_the_drivers_of_the_motors():
    for module, allowed in IMPORTERS.items():
        found = {file for file, tree in TREES.items() if module in set(imported(tree))}
        assert found == allowed, (module, found)


def test_only_the_motors_drive_output_lines():
    found = {file for file, tree in TREES.items() if not file.startswith("fake/") and any(isinstance(n, ast.Name) and n.id == "OutputLines" for n in ast.walk(tree))}
    assert found <= OUTPUT_LINES, found


def test_only_the_supervisor_calls_the_motors():
    """`config.motors` is a section of the configuration and has no methods; any method of a `.motors` elsewhere is a second hand."""
    methods = {"start", "enable", "write", "off", "close"}
    for file, tree in TREES.items():
        if file.startswith("fake/"):
            continue
        called = set(uses(tree, "motors")) & methods
        assert called <= ATTRIBUTE.get(file, set()), (file, called)
        handed_on = [
            node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "motors"
            and isinstance(node.value, ast.Attribute) and node.value.attr == "devices"
        ]  # fmt: skip
        assert len(handed_on) == (1 if file == "session.py" else 0), file
        held = set(uses(tree, "_motors")) - {None}
        if held & methods:
            assert file in ("supervisor.py", "self_test.py", "hardware/motor_bench.py"), file


def test_pulses_come_from_two_places_each_behind_a_yes():
    """`bench.pulse(...)`; in both files `agrees` stands before the first of them."""
    for file, tree in TREES.items():
        pulses = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "pulse"]
        assert not pulses or file in PULSES, file
        if pulses:
            asked = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "agrees"]
            assert asked and min(asked) < min(pulses), file


def test_nobody_writes_a_pwm_file_past_the_driver():
    names = {"duty_cycle", "pwmchip*", "sys/class/pwm"}
    for file, tree in TREES.items():
        texts = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
        if not file.startswith("fake/") and texts & names:
            assert file == "hardware/pwm.py", file
