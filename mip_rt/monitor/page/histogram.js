// The latency histogram: logarithmic in time and in count, so that one late tick in two thousand is seen.

import { colour, Drawing } from "./canvas.js";

const NAMES = { wake: "edge to wake", read: "sensors read", step: "computed", write: "motors written", edge_to_write: "all: edge to motors" };
const MARGIN = { left: 40, right: 10, top: 8, bottom: 34 };

export class Histogram {
  constructor(canvas, select, body, note) {
    this.select = select;
    this.body = body;
    this.note = note;
    this.counts = null;
    this.drawing = new Drawing(canvas, (context, width, height) => this.paint(context, width, height));
    select.addEventListener("change", () => this.drawing.request());
  }

  start(run) {
    this.edges = run.histogram_us;
    this.periodUs = 1e6 / run.rate_hz;
    this.note.textContent = run.scenario === null ? "" : "In a dry run these contain the time that the simulated chips take; the run's summary leaves it out.";
    this.counts = null;
  }

  show({ stages, counts }) {
    this.counts = counts;
    const names = Object.keys(stages);
    if (this.select.options.length !== names.length) {
      this.select.replaceChildren(...names.map((name) => new Option(NAMES[name] ?? name, name)));
      this.select.value = names.at(-1);
      this.body.replaceChildren(...names.map((name) => {
        const row = document.createElement("tr");
        const head = document.createElement("th");
        head.scope = "row";
        head.textContent = NAMES[name] ?? name;
        row.append(head, ...["p50", "p99", "max"].map(() => document.createElement("td")));
        return row;
      }));
    }
    names.forEach((name, i) => ["p50", "p99", "max"].forEach((key, j) => {
      this.body.rows[i].cells[j + 1].textContent = stages[name][key] === null ? "--" : stages[name][key].toFixed(0);
    }));
    this.drawing.request();
  }

  paint(context, width, height) {
    if (!this.counts) return;
    const counts = this.counts[this.select.value];
    const area = { x: MARGIN.left, y: MARGIN.top, w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
    const bottomUs = 1, topUs = 1e5;
    const toX = (us) => area.x + (area.w * Math.log(Math.max(us, bottomUs) / bottomUs)) / Math.log(topUs / bottomUs);
    const most = Math.max(10, ...counts);
    const toY = (count) => area.y + area.h * (1 - Math.log1p(count) / Math.log1p(most));
    context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    context.fillStyle = colour("fine");
    context.strokeStyle = colour("grid");
    context.lineWidth = 1;
    context.setLineDash([]);
    context.beginPath();
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const count of [1, 10, 100, 1000]) {
      if (count > most) break;
      const y = Math.round(toY(count)) + 0.5;
      context.moveTo(area.x, y);
      context.lineTo(area.x + area.w, y);
      context.fillText(`${count}`, area.x - 5, y);
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const [us, label] of [[1, "1 \u00b5s"], [10, "10 \u00b5s"], [100, "100 \u00b5s"], [1e3, "1 ms"], [1e4, "10 ms"], [1e5, ""]]) {
      const x = Math.round(toX(us)) + 0.5;
      context.moveTo(x, area.y);
      context.lineTo(x, area.y + area.h);
      context.fillText(label, Math.max(x, area.x + 12), area.y + area.h + 4);
    }
    context.stroke();
    context.fillStyle = colour("series-0");
    for (let i = 0; i < counts.length; i++) {
      if (!counts[i]) continue;
      const left = toX(this.edges[i]), right = i + 1 < counts.length ? toX(this.edges[i + 1]) : area.x + area.w;
      const top = toY(counts[i]);
      context.fillRect(left + 0.5, top, Math.max(1, right - left - 1), area.y + area.h - top);
    }
    this.paintPeriod(context, area, toX);
  }

  paintPeriod(context, area, toX) {
    const x = Math.round(toX(this.periodUs)) + 0.5;
    context.strokeStyle = context.fillStyle = colour("bad");
    context.setLineDash([4, 3]);
    context.beginPath();
    context.moveTo(x, area.y);
    context.lineTo(x, area.y + area.h);
    context.stroke();
    context.textAlign = "center";
    context.textBaseline = "top";
    context.fillText("next tick", x, area.y + area.h + 17);
  }
}
