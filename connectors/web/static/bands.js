// Bands under the curves: slip events, recorded label and label by hand, on the time axis of the charts.

import { LEFT, RIGHT } from "./charts.js";
import { colour } from "./dom.js";

const ROW = 18; // px
const NAMES = { slips: "events", label: "label", hand: "hand" };
const SLIP = 1, UNKNOWN = -1;
export const CODES = { slip: SLIP, static: 0, unknown: UNKNOWN };

export class Bands {
  constructor(canvas) {
    this.canvas = canvas;
    this.rows = {};
    this.view = { begin: 0, end: 1, at: 0, selected: null };
    new ResizeObserver(() => this.#draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#draw());
  }

  // Draw bands: by name, a list of [begin, end, code].
  show(rows, view) {
    this.rows = rows;
    this.view = view;
    this.#draw();
  }

  // Return the code of a band at a time, or null.
  at(name, t) {
    return this.rows[name]?.find(([begin, end]) => begin <= t && t < end)?.[2] ?? null;
  }

  #draw() {
    const { canvas, rows, view } = this, names = Object.keys(NAMES).filter((name) => rows[name]), ratio = devicePixelRatio;
    const width = canvas.clientWidth, height = names.length * ROW;
    canvas.style.height = `${height}px`;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d"), wide = width - LEFT - RIGHT;
    const x = (t) => LEFT + (wide * (Math.min(Math.max(t, view.begin), view.end) - view.begin)) / (view.end - view.begin);
    pen.scale(ratio, ratio);
    pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    if (view.selected) {
      pen.fillStyle = colour("--selected");
      pen.fillRect(x(view.selected[0]), 0, x(view.selected[1]) - x(view.selected[0]), height);
    }
    names.forEach((name, row) => {
      const top = row * ROW + 3, tall = ROW - 6;
      pen.fillStyle = colour("--soft");
      pen.fillText(NAMES[name], LEFT - 6, top + tall / 2);
      for (const [begin, end, code] of rows[name]) {
        if (end < view.begin || begin > view.end) continue;
        const left = x(begin), size = Math.max(x(end) - left, 1);
        if (code === SLIP) {
          pen.fillStyle = colour("--slip");
          pen.fillRect(left, top, size, tall);
        } else if (code === UNKNOWN) {
          pen.strokeStyle = colour("--soft");
          pen.strokeRect(left + 0.5, top + 0.5, Math.max(size - 1, 0.5), tall - 1);
        } else {
          pen.fillStyle = colour("--soft");
          pen.fillRect(left, top + tall / 2 - 1.5, size, 3);
        }
      }
    });
    pen.fillStyle = colour("--soft");
    if (view.at >= view.begin && view.at <= view.end) pen.fillRect(x(view.at), 0, 1, height);
  }
}
