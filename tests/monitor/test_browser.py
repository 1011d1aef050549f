"""The page in a real browser, in front of a dry run in real time: it loads, moves, drives, and is there again after a restart."""

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mip_rt import log

ROOT = Path(__file__).parents[2]
BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = pytest.mark.slow
if not (BROWSER and DRIVER and importlib.util.find_spec("selenium")):
    pytest.skip("needs chromium, chromium-driver and selenium, which tools/test brings on Debian 12", allow_module_level=True)
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--window-size=1500,1500",
)  # fmt: skip


def start(*arguments):
    return subprocess.Popen([sys.executable, "-m", "mip_rt", *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)


def stop(process):
    """What an orderly stopped process had printed on standard output."""
    process.send_signal(signal.SIGTERM)
    try:
        return process.communicate(timeout=20)[0]
    finally:
        process.kill()


def start_loop(folder):
    """A dry run that stands still until it is driven."""
    return start("--dry-run", "--duration", 600, "--log", folder, "--json", "--set", "estimator.shadows=[]")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('browser')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def site(browser, tmp_path_factory):
    """The page in front of a balancing dry run; everything that a test needs to handle both."""
    made = Site(browser, tmp_path_factory.mktemp("log"))
    try:
        browser.get(f"http://127.0.0.1:{made.port}/")
        made.balance()
        yield made
    finally:
        stop(made.loop)
        stop(made.web)


class Site:
    def __init__(self, browser, folder):
        self.browser, self.folder, self.port = browser, folder, 0
        self.loop = start_loop(folder)
        self.start_web()

    def start_web(self):
        """At a free port, later at the same again."""
        self.web = start("monitor", self.folder, "--web", "--port", self.port)
        line = self.web.stderr.readline()
        self.port = int(line.partition("127.0.0.1:")[2].partition("/")[0])

    def text(self, name):
        return self.browser.find_element("id", name).text

    def until(self, holds, what, limit_s=30.0):
        end = time.monotonic() + limit_s
        while not holds():
            assert time.monotonic() < end, f"{what}: {self.text('link')}, {self.text('state')}, position {self.text('position')}"
            time.sleep(0.05)

    def balance(self):
        """Waits until the robot balances; on a busy machine it may have fallen, and is then stood up as a person would."""
        for _ in range(8):
            with contextlib.suppress(AssertionError):
                self.until(lambda: self.text("state-name") == "BALANCING", "standing up", 6.0)
                return
            if self.text("state-name") in ("DISARMED", "FAULT"):
                self.browser.find_element("id", "arm").click()
        raise AssertionError(f"the robot does not stand up: {self.text('state')}, {self.text('pad-note')}")

    def forward_m(self):
        text = self.text("position").split(",")[0]
        return float(text) if text != "--" else 0.0

    def pixels(self, canvas):
        """(how many colours, the picture as a string) of a canvas."""
        return self.browser.execute_script(
            """const c = document.getElementById(arguments[0]), d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
            return [new Set(new Uint32Array(d.buffer)).size, c.toDataURL()];""", canvas
        )  # fmt: skip


def test_the_page_shows_a_robot_that_moves(site):
    """A page that has loaded but whose drawing died still answers with the right HTML."""
    colours, first = site.pixels("view")
    assert colours > 100
    site.until(lambda: site.pixels("view")[1] != first, "3-D view", 5.0)
    assert site.pixels("histogram")[0] > 3
    panels = site.browser.find_elements("css selector", "#panels canvas[role=img]")
    assert len(panels) == 3  # rad, rad/s, duties
    assert "200" in site.text("rate") and site.text("link") == "live" and "deg" in site.text("tiles")


def test_the_screenshot_is_not_blank(site, tmp_path):
    image = pytest.importorskip("matplotlib.image")
    file = tmp_path / "page.png"
    assert site.browser.save_screenshot(str(file))
    pixels = image.imread(file)[..., :3]
    # Everywhere on the page something is drawn: no third of it is one colour.
    for part in (pixels[: len(pixels) // 3], pixels[len(pixels) // 3 : -len(pixels) // 3], pixels[-len(pixels) // 3 :]):
        assert part.std() > 0.05


def test_plots_show_the_field_that_is_asked_for(site):
    field = site.browser.find_element("id", "field")
    field.send_keys("wheel_rate_rad_s[1]\n")
    site.until(lambda: "wheel_rate_rad_s[1]" in site.text("panels"), "new field")
    legend = [item.text for item in site.browser.find_elements("css selector", ".legend li") if "wheel_rate" in item.text]
    assert len(legend) == 1
    site.until(lambda: any(character.isdigit() for character in site.browser.find_element("css selector", ".legend b").text), "values")
    field.send_keys("nonsense\n")
    assert "no field" in site.text("field-note")
    site.browser.find_element("css selector", '[aria-label="remove wheel_rate_rad_s[1]"]').click()
    site.until(lambda: "wheel_rate_rad_s[1]" not in site.text("panels"), "removed field")
    field.clear()


def test_drives_half_a_metre_and_back(site):
    """Forward with the keyboard, back with the pointer; through server, pty, decoder, dead-man and controller."""
    from selenium.webdriver import ActionChains

    browser = site.browser
    for _ in range(3):
        site.balance()
        browser.find_element("id", "robot-title").click()  # not in a field that would take the keys
        # The remote commands speeds, so the robot is driven by looking at it, as by a person.
        begin = site.forward_m()
        ActionChains(browser).key_down("w").perform()
        with contextlib.suppress(AssertionError):
            site.until(lambda: site.forward_m() > begin + 0.5 or site.text("state-name") != "BALANCING", "half a metre", 15.0)
        ActionChains(browser).key_up("w").perform()
        there = site.forward_m()
        stick = browser.find_element("id", "stick")
        ActionChains(browser).click_and_hold(stick).move_by_offset(0, 60).perform()
        with contextlib.suppress(AssertionError):
            site.until(lambda: site.forward_m() < begin + 0.1 or site.text("state-name") != "BALANCING", "back", 15.0)
        ActionChains(browser).release().perform()
        time.sleep(1.5)
        back = site.forward_m()
        if site.text("state-name") == "BALANCING":
            break
    assert there - begin > 0.5 and abs(back - begin) < 0.25 and site.text("state-name") == "BALANCING"
    rows = log.open(next(site.folder.glob("*.ring"))).frames
    radius_m = 0.032
    travelled_m = radius_m * rows["estimates"][rows["state"] == 4, 0, 9]
    assert travelled_m.max() > 0.5
    commanded = rows["remote_velocity_m_s"][:, 0]
    assert commanded.max() == pytest.approx(0.25, abs=0.003) and commanded.min() < -0.2
    assert browser.find_element("id", "give-back").is_enabled()


def test_the_arm_button_and_the_hands_work_from_the_page(site):
    from selenium.webdriver import ActionChains

    site.balance()
    site.browser.find_element("id", "robot-title").click()
    ActionChains(site.browser).send_keys(" ").perform()
    site.until(lambda: site.text("state-name") == "DISARMED", "disarmed by the space bar")
    assert "arm button" in site.text("state-hint")
    site.until(lambda: float(site.text("tilt").split()[0]) > 60.0, "a robot without motors falls", 10.0)
    ActionChains(site.browser).send_keys("h").perform()
    site.until(lambda: float(site.text("tilt").split()[0]) < 10.0, "picked up by the H key")
    ActionChains(site.browser).send_keys("g").perform()
    site.until(lambda: float(site.text("tilt").split()[0]) > 60.0, "let go by the G key", 10.0)
    site.balance()


def test_every_control_has_a_name_and_a_phone_needs_no_sideways_scrolling(site):
    browser = site.browser
    nameless = [
        element.get_attribute("outerHTML")[:80]
        for element in browser.find_elements("css selector", "button, input, select, canvas[role], [tabindex]")
        if element.is_displayed() and not element.accessible_name
    ]
    assert nameless == []
    try:
        for width in (360, 390, 768):
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": width, "height": 800, "deviceScaleFactor": 2, "mobile": True})
            assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_have_contrast(site, scheme):
    """4.5 to 1, as WCAG 2 asks for, between every word and what is behind it."""
    browser = site.browser
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
    try:
        worst = browser.execute_script(CONTRAST)
        assert worst[0] >= 4.5, worst
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


CONTRAST = """
const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
const light = ([r, g, b]) => [r, g, b].map((v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
  .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const behind = (element) => {
  for (let e = element; e; e = e.parentElement) {
    const colour = numbers(getComputedStyle(e).backgroundColor);
    if (colour.length < 4 || colour[3] === 1) return colour;
  }
  return [255, 255, 255];
};
let worst = [99, ""];
for (const element of document.querySelectorAll("body *")) {
  const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  if (!own || !element.checkVisibility() || element.closest(":disabled, .stale")) continue;
  const pair = [light(numbers(getComputedStyle(element).color)), light(behind(element))].sort((a, b) => b - a);
  const ratio = (pair[0] + 0.05) / (pair[1] + 0.05);
  if (ratio < worst[0]) worst = [ratio, element.outerHTML.slice(0, 100)];
}
return worst;
"""


def test_is_there_again_after_the_loop_and_after_the_server_restart(site):
    """A person who restarts the loop looks at the page that is still open: it must not go on showing the dead run."""
    report = json.loads(stop(site.loop))
    assert report["ticks"] > 1000
    site.until(lambda: site.text("state-name") == "STOPPED", "the end of the loop")
    assert "the loop ended" in site.text("state-hint") and site.text("link") == "the loop has stopped"
    assert not site.browser.find_element("id", "give-back").is_enabled()
    site.loop = start_loop(site.folder)
    site.until(lambda: "restarted" in site.text("link"), "the new run")
    site.balance()
    before = site.pixels("view")[1]
    site.until(lambda: site.pixels("view")[1] != before, "3-D view", 5.0)
    os.kill(site.loop.pid, signal.SIGSTOP)
    try:
        site.until(lambda: "hangs or was killed" in site.text("state-hint"), "a loop that hangs")
    finally:
        os.kill(site.loop.pid, signal.SIGCONT)
    site.until(lambda: site.text("state-name") != "STOPPED", "the loop that goes on")
    site.web.kill()
    site.until(lambda: "does not answer" in site.text("link"), "the server's end")
    site.web.wait()
    site.start_web()
    site.until(lambda: site.text("link").startswith("live"), "the server that is there again")


def test_the_console_has_no_errors(site):
    """A page that complains is broken somewhere, even if it looks well. Servers and loops that were stopped on purpose are no errors."""
    site.browser.get(f"http://127.0.0.1:{site.port}/")
    site.until(lambda: site.text("link") == "live", "a fresh page")
    complaints = [entry["message"] for entry in site.browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert [message for message in complaints if " 409 " not in message and "ERR_CONNECTION" not in message and "ERR_INCOMPLETE" not in message] == []
