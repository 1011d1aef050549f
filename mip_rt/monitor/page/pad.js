// The remote of a dry run: stick, spin levels and buttons, by pointer and by keyboard. While it is in use, a frame goes out every 50 ms; when
// the page is hidden or closed the frames stop, and the robot's own dead-man takes the command away.

const PERIOD_MS = 50;
const KEYS = { KeyW: [0, 1], ArrowUp: [0, 1], KeyS: [0, -1], ArrowDown: [0, -1], KeyA: [-1, 0], ArrowLeft: [-1, 0], KeyD: [1, 0], ArrowRight: [1, 0] };
const HANDS = { Space: "arm", KeyH: "hold", KeyG: "release" };

export class Pad {
  constructor(root) {
    this.root = root;
    this.part = (id) => root.querySelector(`#${id}`);
    this.pressed = new Set();
    this.half = false;
    this.pointer = null; // [x, y] while the stick is dragged
    this.level = { button: "none", drive_limit_m_s: 0, yaw_rate_hz: 0 };
    this.headingReset = false;
    this.timer = null;
    this.busy = false;
    this.listen();
  }

  /** A new run: with a remote, or with the reason why there is none. */
  start(run) {
    this.giveBack();
    this.drivable = run.drivable;
    this.part("pad-body").hidden = !run.drivable;
    this.part("pad-why").textContent = run.drivable ? "" : run.scenario === null
      ? "Only a dry run can be driven from here: a real robot hears its own remote and nothing else."
      : "This dry run listens to another remote (--remote), or it runs on virtual time.";
    const levels = this.part("levels");
    levels.querySelectorAll("label").forEach((label) => label.remove());
    run.levels.forEach((level, i) => levels.append(this.levelChoice(level, i)));
    if (run.levels.length) this.level = run.levels[0];
    this.update();
  }

  levelChoice(level, i) {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: "radio", name: "level", value: level.button, checked: i === 0 });
    input.addEventListener("change", () => this.choose(i, level));
    const key = document.createElement("kbd");
    key.textContent = i;
    label.append(input, ` ${Number(level.yaw_rate_hz.toFixed(2))} Hz `, key);
    return label;
  }

  choose(i, level) {
    this.level = level;
    this.part("levels").querySelectorAll("input")[i].checked = true;
    this.take();
  }

  listen() {
    this.part("arm").addEventListener("click", () => this.hand("arm"));
    this.root.querySelectorAll("[data-hand]").forEach((button) => button.addEventListener("click", () => this.hand(button.dataset.hand)));
    this.part("heading").addEventListener("click", () => this.resetHeading());
    this.part("give-back").addEventListener("click", () => this.giveBack());
    this.listenToPointer(this.part("stick"));
    document.addEventListener("keydown", (event) => this.keyDown(event));
    document.addEventListener("keyup", (event) => this.keyUp(event));
    // Keys whose release we cannot see any more count as released.
    window.addEventListener("blur", () => this.letGo());
    document.addEventListener("visibilitychange", () => document.hidden && this.giveBack());
    window.addEventListener("pagehide", () => this.giveBack());
  }

  listenToPointer(stick) {
    const follow = (event) => {
      const { left, top, width, height } = stick.getBoundingClientRect();
      const x = (event.clientX - left - width / 2) / (width * 0.34), y = (top + height / 2 - event.clientY) / (height * 0.34);
      const length = Math.max(1, Math.hypot(x, y));
      this.pointer = [x / length, y / length];
      this.take();
    };
    stick.addEventListener("pointerdown", (event) => { stick.setPointerCapture(event.pointerId); follow(event); });
    stick.addEventListener("pointermove", (event) => stick.hasPointerCapture(event.pointerId) && follow(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      stick.addEventListener(end, () => { this.pointer = null; this.update(); });
    }
  }

  keyDown(event) {
    const target = event.target;
    if (!this.drivable || event.ctrlKey || event.metaKey || event.altKey || target.matches("select, textarea, input:not([type=radio])")) return;
    this.half = event.shiftKey;
    if (event.code in KEYS) {
      event.preventDefault();
      this.pressed.add(event.code);
      this.take();
    } else if (event.repeat) {
      if (event.code === "Space" && !target.matches("button")) event.preventDefault(); // the page must not scroll
    } else if (event.code in HANDS && !(event.code === "Space" && target.matches("button, input, summary"))) {
      event.preventDefault();
      this.hand(HANDS[event.code]);
    } else if (event.code === "KeyR") {
      this.resetHeading();
    } else if (/^(Digit|Numpad)\d$/.test(event.code)) {
      const input = this.part("levels").querySelectorAll("input")[Number(event.code.at(-1))];
      if (input && !input.checked) input.click();
    }
  }

  keyUp(event) {
    this.half = event.shiftKey;
    if (this.pressed.delete(event.code)) this.update();
  }

  letGo() {
    this.pressed.clear();
    this.pointer = null;
    this.update();
  }

  resetHeading() {
    this.headingReset = true;
    this.take();
  }

  /** Stick position, right and forward, within the unit circle. */
  get stick() {
    if (this.pointer) return this.pointer;
    const sum = [0, 0];
    for (const code of this.pressed) KEYS[code].forEach((value, i) => { sum[i] += value; });
    const length = Math.max(1, Math.hypot(...sum)) / (this.half ? 0.5 : 1);
    return sum.map((value) => value / length);
  }

  take() {
    this.update();
    if (this.timer !== null) return;
    this.timer = setInterval(() => this.send(), PERIOD_MS);
    this.part("give-back").disabled = false;
    this.send();
  }

  giveBack() {
    clearInterval(this.timer);
    this.timer = null;
    this.part("give-back").disabled = true;
    this.letGo();
  }

  update() {
    const [x, y] = this.stick;
    this.part("knob").style.transform = `translate(${x * 3.4}rem, ${-y * 3.4}rem)`;
    const limit = this.level.drive_limit_m_s;
    const words = [[y, "forward", "back"], [x, "right", "left"]].filter(([value]) => Math.abs(value) > 0.005)
      .map(([value, plus, minus]) => `${value > 0 ? plus : minus} ${Math.abs(value * limit).toFixed(2)} m/s`);
    this.part("stick-text").textContent = words.join(", ") || "0.00 m/s";
  }

  async send() {
    if (this.busy) return; // the newest position counts; an old one must not queue behind it
    this.busy = true;
    const [x, y] = this.stick;
    const headingReset = this.headingReset;
    this.headingReset = false;
    const taken = await this.post("/pad", { x, y, button: this.level.button, heading_reset: headingReset });
    this.busy = false;
    if (!taken) this.giveBack();
  }

  hand(act) {
    return this.drivable ? this.post("/hand", { act }) : undefined;
  }

  /** Sends a command; whether it was taken. */
  async post(path, command) {
    const note = this.part("pad-note");
    try {
      const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command) });
      note.textContent = answer.ok ? "" : await answer.text();
      return answer.ok;
    } catch {
      note.textContent = "mip-rt monitor does not answer";
      return false;
    }
  }
}
