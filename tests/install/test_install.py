"""tools/install, for real, on a copy of this machine: nothing in a dry run, everything once, nothing twice, and all of it back."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from sandbox import CHECKOUT, UENV, Sandbox, why_not

INSTALL = CHECKOUT / "tools/install"
BOARD = "beaglebone-black-cape"
QUICK = ("--board", BOARD, "--no-warm-up")
ACCOUNTS = {f"etc/{name}" for name in ("passwd", "group", "shadow", "gshadow", "passwd-", "group-", "shadow-", "gshadow-", "subuid", "subgid", ".pwd.lock")}
pytestmark = pytest.mark.robot_packages
needs_sandbox = pytest.mark.skipif(bool(why_not()), reason=f"tools/install cannot be tried on a copy of this machine: {why_not()}")


@pytest.fixture
def sandbox(tmp_path):
    found = Sandbox(tmp_path)
    yield found
    found.close()


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A machine on which mip-rt is installed; tests leave it so."""
    found = Sandbox(tmp_path_factory.mktemp("installed"))
    found.messages = found.run(INSTALL, *QUICK)
    yield found
    found.close()


def ours(changed):
    """What does not belong to the list of accounts, or to the file that the sandbox brought."""
    return {path: entry for path, entry in changed.items() if path not in ACCOUNTS}


def test_wrong_arguments_and_users_are_told_and_nothing_happens():
    """Prevents an installation that begins before it knows what is wanted."""

    def said(*arguments, code, **options):
        result = subprocess.run([INSTALL, *arguments], capture_output=True, text=True, check=False, **options)
        assert (result.returncode, result.stdout) == (code, ""), result.stderr
        return result.stderr

    assert "--frobnicate" in said("--frobnicate", code=2)
    assert "--uninstall" in said("--purge", code=2)
    assert "beaglebone-blue" in said("--board", "beagle", code=2)
    assert "edumip" in said("--robot", "segway", code=2)
    assert "needs a name" in said("--board", code=2)
    if os.geteuid() == 0:
        assert "sudo tools/install" in said(code=1, user=65534)
    if not Path("/proc/device-tree/model").exists() and not Path("/etc/mip-rt").exists():
        assert "no BeagleBone" in said("--dry-run", code=4)


@needs_sandbox
def test_a_dry_run_names_every_change_and_makes_none(sandbox):
    """Prevents a look that already touches the robot."""
    before = sandbox.changed()
    text = sandbox.run(INSTALL, "--dry-run", *QUICK)
    assert sandbox.changed() == before
    for path in ("/opt/mip-rt", "/usr/local/bin/mip-rt", "/etc/mip-rt/mbbr.yaml", "/etc/systemd/system/mip-rt.service", "/var/cache/mip-rt",
                 "/usr/local/lib/mip-rt/motors-off", f"/lib/firmware/mip-rt-{BOARD}.dtbo", "/etc/udev/rules.d/90-mip-rt.rules", "/boot/uEnv.txt",
                 "/etc/modprobe.d/mip-rt.conf"):  # fmt: skip
        assert path in text, path
    assert all(line.startswith("would ") for line in text.splitlines() if "/usr/local" in line) and "nothing is changed yet" in text


@needs_sandbox
@pytest.mark.slow
def test_everything_is_in_place_and_a_second_time_nothing_changes(installed):
    """Prevents a file too few, and an installation that is never finished."""
    assert installed.read("/etc/systemd/system/mip-rt.service") == (CHECKOUT / "systemd/mip-rt.service").read_text()
    assert "mip-rt-beaglebone-black-cape.dtbo" in installed.read("/boot/uEnv.txt")
    assert {"gpio", "i2c", "dialout"} <= set(installed.run("id", "-nG", "mip-rt").split())
    assert installed.run("stat", "-c", "%U", "/var/cache/mip-rt") == "mip-rt\n"
    # Outside of the checkout, the installed package answers, with its data files, and this board's configuration is valid.
    assert installed.run("env", "-C", "/", "/usr/local/bin/mip-rt", "config", "check") == "/etc/mip-rt/mbbr.yaml: ok\n"
    assert installed.run("env", "-C", "/", "/opt/mip-rt/bin/python", "-c", "import mip_rt; print(mip_rt.__file__)").startswith("/opt/mip-rt/lib/")
    assert "nothing to change" in installed.run("env", "-C", "/", "/usr/local/bin/mip-rt", "firmware", "diff", "--board", BOARD)
    assert installed.run("systemctl", "is-enabled", "mip-rt") == "enabled\n"
    # What root compiles is the service's: it adds to the same folder.
    compiled = "from mip_rt import compiled; from mip_rt.controllers.filters import low_pass; low_pass(1.0, 2.0, 0.5); print(compiled.CACHE_FOLDER)"
    folder = installed.run("env", "-C", "/", "/opt/mip-rt/bin/python", "-c", compiled).strip()
    assert folder.startswith("/var/cache/mip-rt/numba-")
    found = dict(line.split() for line in installed.run("find", "/var/cache/mip-rt", "-printf", "%f %u\n").splitlines())
    assert any(name.endswith(".nbi") for name in found) and set(found.values()) == {"mip-rt"}
    before = installed.changed()
    # The board is now known from the configuration: nobody names it.
    assert "nothing to change" in installed.run(INSTALL, "--no-warm-up")
    assert "nothing to change" in installed.run(INSTALL, "--dry-run")
    assert installed.changed() == before


@needs_sandbox
@pytest.mark.slow
def test_an_update_keeps_the_configuration_and_the_compiled_code(installed):
    """Prevents an update that throws away what the user set, or that compiles for minutes although no equation has changed."""
    newer = Path("/tmp/newer")
    installed.run("cp", "-a", CHECKOUT / "tools", CHECKOUT / "mip_rt", CHECKOUT / "config", CHECKOUT / "firmware", CHECKOUT / "systemd",
                  CHECKOUT / "pyproject.toml", CHECKOUT / "README.md", *["--target-directory", "/tmp", "--parents"])  # fmt: skip
    installed.run("mv", f"/tmp{CHECKOUT}", newer)
    installed.run("sed", "-i", '1s/.*/"""Newer words."""/', newer / "mip_rt/progress.py")
    installed.run("sed", "-i", "s/^WatchdogSec=1$/WatchdogSec=3/", newer / "systemd/mip-rt.service")
    mine = f"robot: mbbr\nboard: {BOARD}\nlog: {{files: 3}}  # mine\n"
    installed.write("/etc/mip-rt/mbbr.yaml", mine)
    site = "/opt/mip-rt/lib/python3.11/site-packages/mip_rt"
    stamp = installed.run("stat", "-c", "%Y", f"{site}/models/mbbr.py")
    text = installed.run(newer / "tools/install", "--dry-run")
    assert "-WatchdogSec=1\n+WatchdogSec=3\n" in text and "would install mip-rt" in text
    text = installed.run(newer / "tools/install", "--no-warm-up")
    assert "install mip-rt" in text and "mbbr.yaml" not in text
    assert installed.read("/etc/mip-rt/mbbr.yaml") == mine
    assert "WatchdogSec=3" in installed.read("/etc/systemd/system/mip-rt.service")
    assert "Newer words" in installed.run("env", "-C", "/", "/opt/mip-rt/bin/python", "-c", "import mip_rt.progress; print(mip_rt.progress.__doc__)")
    assert installed.run("stat", "-c", "%Y", f"{site}/models/mbbr.py") == stamp  # numba compares it
    # Another board is named: its line changes, the rest stays; a configuration with an error is kept, and told.
    installed.run(newer / "tools/install", "--no-warm-up", "--board", "beaglebone-blue")
    assert installed.read("/etc/mip-rt/mbbr.yaml") == mine.replace(BOARD, "beaglebone-blue")
    installed.write("/etc/mip-rt/mbbr.yaml", mine.replace("files", "fiels"))
    text = installed.run(newer / "tools/install", "--no-warm-up", code=1)
    assert "log.fiels" in text and "kept as it is" in text
    installed.write("/etc/mip-rt/mbbr.yaml", mine)
    installed.run(INSTALL, *QUICK)
    installed.run("rm", "-r", newer)


@needs_sandbox
@pytest.mark.slow
def test_the_other_robot_is_what_the_service_starts(installed):
    """Prevents an eduMIP that is balanced as a ball balancer."""
    installed.run(INSTALL, "--robot", "edumip", *QUICK)
    assert "ExecStart=\nExecStart=/usr/local/bin/mip-rt --robot edumip\n" in installed.read("/etc/systemd/system/mip-rt.service.d/robot.conf")
    assert installed.run("env", "-C", "/", "/usr/local/bin/mip-rt", "config", "check", "--robot", "edumip") == "/etc/mip-rt/edumip.yaml: ok\n"
    assert "nothing to change" in installed.run(INSTALL, "--dry-run")  # it stays the eduMIP
    installed.run(INSTALL, "--robot", "mbbr", *QUICK)
    assert not any("robot.conf" in path for path in installed.changed())


@needs_sandbox
@pytest.mark.slow
def test_uninstall_takes_all_back_but_what_is_the_users(sandbox):
    """Prevents leftovers that would start, load or hold something, and the loss of a calibration."""
    sandbox.run(INSTALL, *QUICK)
    sandbox.write("/var/lib/mip-rt/calibration.json", "{}")
    everything = sandbox.changed()
    assert "would remove /opt/mip-rt" in sandbox.run(INSTALL, "--uninstall", "--dry-run")
    assert sandbox.changed() == everything
    sandbox.run(INSTALL, "--uninstall")
    assert sandbox.read("/boot/uEnv.txt") == UENV
    left = ours(sandbox.changed())
    files = {path for path, (kind, *_) in left.items() if kind != "d"}
    assert files == {"boot/uEnv.txt", "boot/uEnv.txt.before-mip-rt", "etc/mip-rt/mbbr.yaml", "var/lib/mip-rt/calibration.json"}
    assert "nothing to change" in sandbox.run(INSTALL, "--uninstall")
    sandbox.run(INSTALL, "--uninstall", "--purge")
    assert {path for path, (kind, *_) in ours(sandbox.changed()).items() if kind != "d"} == {"boot/uEnv.txt", "boot/uEnv.txt.before-mip-rt"}
    sandbox.run("id", "mip-rt", code=1)


@needs_sandbox
@pytest.mark.slow
def test_without_network_and_packages_it_says_so_and_stops(sandbox):
    """Prevents half a robot: what the program needs comes first."""
    sandbox.run("dpkg", "--remove", "--force-depends", "python3-wheel")
    # A mirror that refuses at once, as one without network may take its time.
    sandbox.run("find", "/etc/apt/sources.list.d", "-type", "f", "-delete")
    sandbox.write("/etc/apt/sources.list", "deb http://127.0.0.1:9/debian bookworm main\n")
    sandbox.write("/etc/apt/apt.conf.d/99retries", 'Acquire::Retries "0";\n')
    sandbox.run("find", "/var/lib/apt/lists", "/var/cache/apt/archives", "-type", "f", "-delete")
    before = {path for path in sandbox.changed() if not path.startswith("var/")}
    text = sandbox.run(INSTALL, *QUICK, code=1, wrapped=("unshare", "--net"))
    assert "network" in text and "python3-wheel" in text and "cure:" in text
    assert {path for path in sandbox.changed() if not path.startswith("var/")} == before


@needs_sandbox
def test_a_system_without_uboots_file_gets_the_rest_and_is_told(sandbox):
    """Prevents a success that leaves motors and encoders without pins."""
    sandbox.run("rm", "/boot/uEnv.txt")
    text = sandbox.run(INSTALL, "--dry-run", *QUICK, code=1)
    assert "uEnv.txt" in text and "not complete" in text


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed (apt install shellcheck)")
def test_shellcheck_has_nothing_to_say():
    """Prevents the usual accidents with quotes, in scripts that run as root."""
    scripts = [path for path in (CHECKOUT / "tools").rglob("*") if path.is_file() and path.read_bytes()[:2] == b"#!" and b"sh" in path.read_bytes()[:25]]
    assert INSTALL in scripts and len(scripts) >= 5
    result = subprocess.run(
        ["shellcheck", "--severity=warning", "--external-sources", "--source-path=SCRIPTDIR", *scripts, CHECKOUT / "systemd/motors-off", CHECKOUT / ".ci/run"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.stdout + result.stderr == ""
