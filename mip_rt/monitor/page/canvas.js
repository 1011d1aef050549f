// A canvas that is as sharp as the screen and speaks the page's colours.

const scheme = matchMedia("(prefers-color-scheme: dark)");
let colours = new Map();
scheme.addEventListener("change", () => { colours = new Map(); });

/** A colour of style.css by its name without the dashes. */
export function colour(name) {
  if (!colours.has(name)) {
    colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  }
  return colours.get(name);
}

/** Calls `redraw` when the colours change. */
export function onSchemeChange(redraw) {
  scheme.addEventListener("change", redraw);
}

/** A canvas whose bitmap follows its size; `draw(context, width, height)` runs at most once a frame, after `request()`. */
export class Drawing {
  constructor(canvas, draw) {
    this.canvas = canvas;
    this.draw = draw;
    this.context = canvas.getContext("2d");
    this.pending = false;
    new ResizeObserver(() => this.request()).observe(canvas);
    onSchemeChange(() => this.request());
  }

  request() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      const { clientWidth: width, clientHeight: height } = this.canvas;
      if (!width || !height) return;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const columns = Math.round(width * ratio), lines = Math.round(height * ratio);
      if (this.canvas.width !== columns || this.canvas.height !== lines) {
        this.canvas.width = columns;
        this.canvas.height = lines;
      }
      this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
      this.context.clearRect(0, 0, width, height);
      this.draw(this.context, width, height);
    });
  }
}

/** Round numbers from low to high, about `count` of them. */
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((m) => m * power >= raw) ?? 10);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) found.push(i * step);
  return { step, found };
}
