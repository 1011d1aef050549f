// Plots of chosen fields against time: one panel for each unit, all panels with the same time axis.

import { colour, Drawing, ticks } from "./canvas.js";

const LONGEST_S = 30;
const COLOURS = 6;
const DASHES = [[], [7, 4], [2, 3]]; // beyond the sixth series of a panel
const MARGIN = { left: 58, right: 10, top: 8, bottom: 20 };

export class Plots {
  /** `container` takes the panels; `changed(labels)` is called when series come or go. */
  constructor(container, changed) {
    this.container = container;
    this.changed = changed;
    this.spanS = 10;
    this.paused = false;
    this.series = new Map(); // label -> {unit, style, values}
    this.panels = new Map(); // unit -> {element, drawing, list}
    this.times = [];
  }

  get labels() {
    return [...this.series.keys()];
  }

  /** Begins anew: another run, or other fields of the same one (the stream then sends its last seconds again). */
  clear() {
    this.times = [];
    for (const series of this.series.values()) series.values = [];
    this.request();
  }

  /** Shows these series: label -> unit. */
  choose(chosen) {
    const used = {}; // styles so far in each panel
    this.series = new Map([...chosen].map(([label, unit]) => {
      const i = used[unit] = (used[unit] ?? -1) + 1;
      return [label, { unit, values: [], style: { colour: `series-${i % COLOURS}`, dash: DASHES[Math.floor(i / COLOURS) % DASHES.length] } }];
    }));
    this.times = [];
    this.arrange();
    this.changed(this.labels);
  }

  remove(label) {
    this.choose(new Map([...this.series].filter(([other]) => other !== label).map(([other, { unit }]) => [other, unit])));
  }

  take({ time_s: times, values }) {
    if (!times || this.paused) return;
    this.times.push(...times);
    for (const [label, series] of this.series) series.values.push(...(values[label] ?? times.map(() => null)));
    const old = this.times.findIndex((t) => t >= this.times.at(-1) - LONGEST_S);
    if (old > 400) { // in large steps: cutting moves everything
      this.times.splice(0, old);
      for (const series of this.series.values()) series.values.splice(0, old);
    }
    this.request();
  }

  request() {
    for (const panel of this.panels.values()) panel.drawing.request();
  }

  arrange() {
    const units = new Set([...this.series.values()].map(({ unit }) => unit));
    this.panels = new Map();
    this.container.replaceChildren();
    for (const unit of units) {
      const element = document.createElement("figure");
      element.className = "panel";
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      const list = document.createElement("ul");
      list.className = "legend";
      element.append(canvas, list);
      this.container.append(element);
      const mine = [...this.series].filter(([, series]) => series.unit === unit);
      canvas.setAttribute("aria-label", `plot against time, ${unit}: ${mine.map(([label]) => label).join(", ")}`);
      for (const [label, series] of mine) list.append(this.legend(label, series));
      const drawing = new Drawing(canvas, (context, width, height) => this.paint(context, width, height, unit, mine));
      this.panels.set(unit, { element, drawing, list });
    }
    this.request();
  }

  legend(label, series) {
    const item = document.createElement("li");
    const swatch = document.createElement("canvas");
    swatch.className = "swatch";
    new Drawing(swatch, (context, width, height) => {
      this.line(context, series.style);
      context.beginPath();
      context.moveTo(0, height / 2);
      context.lineTo(width, height / 2);
      context.stroke();
    }).request();
    const remove = document.createElement("button");
    remove.type = "button";
    remove.textContent = "\u00d7";
    remove.setAttribute("aria-label", `remove ${label}`);
    remove.addEventListener("click", () => this.remove(label));
    series.readout = document.createElement("b");
    item.append(swatch, document.createTextNode(label), series.readout, remove);
    return item;
  }

  line(context, style) {
    context.strokeStyle = colour(style.colour);
    context.setLineDash(style.dash);
    context.lineWidth = 1.7;
    context.lineJoin = "round";
  }

  paint(context, width, height, unit, mine) {
    const end = this.times.at(-1) ?? 0, begin = end - this.spanS;
    let first = this.times.findIndex((t) => t >= begin);
    if (first < 0) first = 0;
    let low = Infinity, high = -Infinity;
    for (const [, { values }] of mine) {
      for (let i = first; i < values.length; i++) {
        const value = values[i];
        if (value === null) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (!(low <= high)) [low, high] = [-1, 1];
    const room = high - low > 1e-9 * Math.abs(high) ? (high - low) * 0.08 : Math.abs(high) * 0.1 || 1;
    [low, high] = [low - room, high + room];
    const area = { x: MARGIN.left, y: MARGIN.top, w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
    const toX = (t) => area.x + ((t - begin) / this.spanS) * area.w;
    const toY = (v) => area.y + ((high - v) / (high - low)) * area.h;
    this.paintAxes(context, area, { begin, end, low, high, toX, toY, unit });
    context.save();
    context.beginPath();
    context.rect(area.x, area.y - 1, area.w, area.h + 2);
    context.clip();
    for (const [, series] of mine) {
      this.line(context, series.style);
      this.paintSeries(context, series.values, first, toX, toY);
      const newest = series.values.at(-1);
      series.readout.textContent = newest === null || newest === undefined ? "--" : `${Number(newest.toPrecision(4))}`;
    }
    context.restore();
  }

  // Of all samples in one column of pixels only the extremes are drawn: no peak is lost, and the line stays light.
  paintSeries(context, values, first, toX, toY) {
    context.beginPath();
    let column = null, low = 0, high = 0, last = 0, pen = false;
    const flush = () => {
      if (column === null) return;
      pen ? context.lineTo(column, toY(high)) : context.moveTo(column, toY(high));
      if (low !== high) context.lineTo(column, toY(low));
      context.lineTo(column, toY(last));
      pen = true;
    };
    for (let i = first; i < values.length; i++) {
      const value = values[i];
      if (value === null) {
        flush();
        column = null;
        pen = false;
        continue;
      }
      const x = Math.round(toX(this.times[i]) * 2) / 2;
      if (x !== column) {
        flush();
        column = x;
        low = high = value;
      }
      low = Math.min(low, value);
      high = Math.max(high, value);
      last = value;
    }
    flush();
    context.stroke();
  }

  paintAxes(context, area, { begin, end, low, high, toX, toY, unit }) {
    context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    context.lineWidth = 1;
    context.setLineDash([]);
    context.strokeStyle = colour("grid");
    context.fillStyle = colour("fine");
    context.textAlign = "right";
    context.textBaseline = "middle";
    const vertical = ticks(low, high, 6);
    const digits = Math.max(0, -Math.floor(Math.log10(vertical.step) + 1e-9));
    context.beginPath();
    for (const value of vertical.found) {
      const y = Math.round(toY(value)) + 0.5;
      context.moveTo(area.x, y);
      context.lineTo(area.x + area.w, y);
      context.fillText(digits > 5 || Math.abs(value) >= 1e6 ? value.toExponential(1) : value.toFixed(digits), area.x - 6, y);
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const t of ticks(begin, end, Math.max(2, area.w / 90)).found) {
      const x = Math.round(toX(t)) + 0.5;
      context.moveTo(x, area.y);
      context.lineTo(x, area.y + area.h);
      if (t >= 0 && x < area.x + area.w - 22) context.fillText(`${Number(t.toFixed(2))}`, x, area.y + area.h + 5);
    }
    context.stroke();
    context.textAlign = "right";
    context.fillText("s", area.x + area.w, area.y + area.h + 5);
    context.textAlign = "left";
    context.fillText(unit === "1" ? "" : unit, 4, area.y);
  }
}
