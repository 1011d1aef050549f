// The page: connects the stream to the parts that show it.

import { Histogram } from "./histogram.js";
import { Pad } from "./pad.js";
import { Plots } from "./plots.js";
import { RobotView } from "./robot3d.js";
import { Stream } from "./stream.js";

const KEPT = "mip-rt-fields";
// Sets of fields by name; what a run does not have is left out.
const PRESETS = {
  "tilt and rates": ["attitude_rad[0]", "attitude_rad[1]", "gyro_rad_s[0]", "gyro_rad_s[1]"],
  "lean, wanted and estimated": ["reference_lean_rad", "reference_lean_rad[0]", "reference_lean_rad[1]", "estimates[0].roll_rad", "estimates[0].pitch_rad"],
  "estimators against each other": [0, 1, 2, 3, 4, 5, 6, 7].map((slot) => `estimates[${slot}].pitch_rad`),
  "motor commands": ["duty[0]", "duty[1]", "duty[2]"],
  "body commands by stage": ["command_feedback[0]", "command_friction[0]", "command_applied[0]"],
  "remote": ["remote_velocity_m_s[0]", "remote_velocity_m_s[1]", "remote_yaw_rate_rad_s", "remote_age_s"],
  "wheel rates": ["wheel_rate_rad_s[0]", "wheel_rate_rad_s[1]", "wheel_rate_rad_s[2]"],
  "battery": ["battery_v"],
};
const FIRST = ["attitude_rad[0]", "attitude_rad[1]", "gyro_rad_s[0]", "gyro_rad_s[1]", "gyro_rad_s[2]", "duty[0]", "duty[1]", "duty[2]"];

const part = (id) => document.getElementById(id);
const degrees = (angle) => (angle * 180) / Math.PI;
const fixed = (value, digits) => (value === null || value === undefined ? "--" : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));
const put = (id, text) => { if (part(id).textContent !== text) part(id).textContent = text; };

const robot = new RobotView(part("view"));
const histogram = new Histogram(part("histogram"), part("stage"), part("stages").tBodies[0], part("latency-note"));
const pad = new Pad(part("pad"));
let known = null; // label -> unit, of the present run
let present = null; // the present run
let live = "live"; // what is said of a connection that works
const plots = new Plots(part("panels"), (labels) => {
  localStorage.setItem(KEPT, JSON.stringify(labels));
  stream.ask(labels);
});
const stream = new Stream({ run: onRun, waiting: onWaiting, view: onView, latency: (data) => histogram.show(data), link: onLink });

function onLink(kind, sentence) {
  part("link").dataset.kind = kind;
  put("link", sentence);
}

function onWaiting({ sentence }) {
  onLink("wait", "waiting");
  showState("WAITING", sentence);
}

function onRun(run) {
  plots.clear();
  histogram.start(run);
  const where = run.scenario === null ? "on the robot" : `dry run of "${run.scenario}", seed ${run.seed}`;
  put("run", `${run.robot}, ${where} \u00b7 estimator ${run.estimators[0] ?? "?"} \u00b7 ${run.log}`);
  if (JSON.stringify(present?.started) === JSON.stringify(run.started)) return; // the stream was only opened anew, for other fields
  const restarted = present !== null;
  present = run;
  robot.start(run);
  pad.start(run);
  known = new Map(run.series.map(([label, unit]) => [label, unit]));
  part("fields").replaceChildren(...run.series.map(([label, unit, meaning]) => {
    const option = document.createElement("option");
    option.value = label;
    option.label = `${unit} \u2013 ${meaning}`;
    return option;
  }));
  part("preset").replaceChildren(new Option("choose", ""), ...Object.keys(PRESETS).filter((name) => PRESETS[name].some((label) => known.has(label)))
    .map((name) => new Option(name, name)));
  live = restarted ? `live, the loop was restarted at ${new Date().toLocaleTimeString()}` : "live";
  const wanted = plots.labels.length ? plots.labels : kept();
  if (wanted.join() !== plots.labels.join() || wanted.some((label) => !known.has(label))) choose(wanted);
}

function kept() {
  try {
    const labels = JSON.parse(localStorage.getItem(KEPT));
    if (Array.isArray(labels) && labels.some((label) => known.has(label))) return labels;
  } catch { /* nothing usable was kept */ }
  return FIRST;
}

function choose(labels) {
  plots.choose(new Map(labels.filter((label) => known.has(label)).map((label) => [label, known.get(label)])));
}

function showState(name, hint) {
  part("state").dataset.state = name;
  put("state-name", name);
  put("state-hint", hint);
}

function onView(view) {
  document.querySelectorAll("#tiles, #view").forEach((element) => element.classList.toggle("stale", view.silence !== ""));
  if (view.silence) {
    onLink("lost", "the loop has stopped");
    pad.giveBack();
    showState("STOPPED", `${view.silence}. Its last state was ${view.state}. A new run is shown as soon as it starts.`);
  } else {
    onLink("live", live);
    const since = view.state_s === null ? "for more than 10 s" : `for ${view.state_s.toFixed(0)} s`;
    showState(view.state, view.hint || since);
  }
  put("tilt", fixed(view.tilt_rad === null ? null : degrees(view.tilt_rad), 1));
  put("tilt-max", fixed(view.tilt_max_rad === null ? null : degrees(view.tilt_max_rad), 1));
  put("position", view.position_m ? view.position_m.map((x) => fixed(x, 2)).join(", ") : "--");
  put("spin", fixed(view.yaw_rate_rad_s === null ? null : view.yaw_rate_rad_s / 2 / Math.PI, 2));
  put("rate", fixed(view.rate_hz, 1));
  put("missed", `${view.missed}`);
  put("battery", fixed(view.battery_v, 2));
  put("remote-age", view.remote_age_s === null ? "never" : `${view.remote_age_s.toFixed(1)} s ago`);
  showTroubles(view);
  robot.show(view);
  plots.take(view.samples);
}

// Lists are rebuilt only when their words change, so that a screen reader is left in peace.
function list(id, entries, none) {
  const element = part(id);
  const key = JSON.stringify(entries);
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  const items = entries.length ? entries : [{ head: none, rest: "", kind: "none" }];
  element.replaceChildren(...items.map(({ head, rest, kind }) => {
    const item = document.createElement("li");
    const strong = document.createElement(kind === "none" ? "span" : "b");
    strong.textContent = head;
    const small = document.createElement("small");
    small.textContent = rest;
    item.className = kind;
    item.append(strong, " ", small);
    return item;
  }));
}

function showTroubles(view) {
  list("refusals", view.why_not_armed.map(({ sentence, cure, blocks }) => ({ head: sentence, rest: cure, kind: blocks ? "now" : "warning" })),
    "no check fails");
  list("limits", view.limits.map((limit) => ({
    head: limit.name.replaceAll("_", " "), rest: `${limit.sentence} (${limit.now ? "now" : `${limit.ago_s.toFixed(0)} s ago`})`, kind: limit.now ? "now" : "",
  })), "none in the last 10 s");
  const fault = view.fault;
  const ago = fault && fault.ago_s !== null ? ` ${fault.ago_s.toFixed(0)} s ago` : "";
  part("fault").dataset.active = String(Boolean(fault?.active));
  put("fault", fault ? `${fault.code}${ago}: ${fault.sentence}. Cure: ${fault.cure}.` : "none so far");
}

// -- what the person does ------------------------------------------------------------------------------------------------
part("add").addEventListener("submit", (event) => {
  event.preventDefault();
  const asked = part("field").value.trim();
  const found = known?.has(asked) ? [asked] : [...(known?.keys() ?? [])].filter((label) => label.startsWith(`${asked}[`)).slice(0, 6);
  put("field-note", asked && !found.length ? `this run has no field "${asked}"` : "");
  if (!found.length) return;
  part("field").value = "";
  choose([...new Set([...plots.labels, ...found])]);
});
part("preset").addEventListener("change", (event) => {
  if (event.target.value) choose(PRESETS[event.target.value]);
  event.target.value = "";
});
part("span").addEventListener("change", (event) => {
  plots.spanS = Number(event.target.value);
  plots.request();
});
part("pause").addEventListener("click", (event) => {
  plots.paused = !plots.paused;
  event.target.setAttribute("aria-pressed", String(plots.paused));
  event.target.textContent = plots.paused ? "Go on" : "Pause";
  if (!plots.paused) stream.open();
});
document.querySelectorAll("[data-camera]").forEach((button) => button.addEventListener("click", () => robot.move(button.dataset.camera)));

stream.open();
