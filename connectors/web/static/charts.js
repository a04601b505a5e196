// Three charts with one time axis: counts of each barometer, slip probability, TCP speed.
// A view of a time axis has `begin`, `end` and `origin` (ms), the time of label 0.

import { drawTruth } from "./truth.js";

/* global uPlot */

export const LEFT = 52, RIGHT = 10; // px, the same for all charts, so that their times align

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const STEPS = [1, 2, 5].flatMap((each) => [10, 100, 1000].map((ten) => each * ten)).sort((a, b) => a - b)
  .concat([10000, 30000, 60000, 120000, 300000, 600000, 1800000]); // ms between labelled times

const HUES = ["--left", "--middle", "--right"];

// Return the hue and dash of each cell of a layout: hues from left to right; rows above the lowest are dotted.
export function styles(layout) {
  const cells = [];
  layout.forEach((row, y) => row.forEach((cell, x) => {
    const above = layout.length - 1 - y;
    if (cell >= 0) cells[cell] = { hue: HUES[Math.floor((3 * x) / row.length)], dash: above ? [2 * above, 3] : undefined };
  }));
  return cells;
}

class Chart {
  constructor(id, series, range, { extra = () => {}, text = null } = {}) {
    this.labelled = id === "counts"; // true: label the slip bands
    this.host = document.getElementById(id);
    this.hasAxis = this.host.classList.contains("last"); // true: show the time axis of all charts
    this.series = series;
    this.range = range;
    this.extra = extra;
    this.text = text; // function of a value on the axis; null: that of uPlot
    this.data = [[], ...series.map(() => [])];
    this.view = { begin: -10000, end: 0, origin: 0, slips: [] };
    this.#build();
    new ResizeObserver(() => this.#resize()).observe(this.host);
  }

  // Show or hide the time axis in this chart.
  set last(last) {
    this.hasAxis = last;
    this.host.classList.toggle("last", last); // changes the size, which triggers a redraw
  }

  draw(data, view) {
    this.data = data;
    this.view = view;
    this.plot.setData(data);
  }

  rebuild() {
    this.plot.destroy();
    this.#build();
    this.plot.setData(this.data);
  }

  #build() {
    const ink = colour("--soft"), grid = colour("--grid");
    const font = `12px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: ink, font, grid: { stroke: grid, width: 1 }, ticks: { show: false } };
    this.plot = new uPlot(
      {
        width: this.host.clientWidth || 600,
        height: this.host.clientHeight || 120,
        legend: { show: false },
        cursor: { show: false },
        padding: [10, RIGHT, 0, 0],
        scales: {
          x: { time: false, range: () => [this.view.begin, this.view.end] },
          y: { range: (_, low, high) => this.range(low, high) },
        },
        axes: [
          { ...axis, size: () => (this.hasAxis ? 24 : 5), gap: 4, splits: () => this.#times(), values: (_, at) => at.map((t) => (this.hasAxis ? this.#label(t) : "")) },
          { ...axis, size: LEFT, gap: 6, space: 24, ...(this.text && { values: (_, at) => at.map(this.text) }) },
        ],
        series: [
          {},
          ...this.series.map(({ hue, dash }) => ({ stroke: colour(hue), width: 1.6, dash, points: { show: false }, spanGaps: false })),
        ],
        hooks: { drawAxes: [(plot) => this.#bands(plot)], draw: [(plot) => this.extra(plot)] },
      },
      this.data,
      this.host,
    );
  }

  #resize() {
    if (!this.host.clientWidth) return; // hidden
    this.plot.setSize({ width: this.host.clientWidth, height: this.host.clientHeight });
  }

  get #step() {
    const span = this.view.end - this.view.begin;
    const most = this.host.clientWidth < 480 ? 5 : 10; // labels
    return STEPS.find((each) => span / each <= most && (each >= 1000 || span < 5000)) ?? STEPS.at(-1);
  }

  // Return the labelled times: multiples of a step from the origin.
  #times() {
    const { begin, end, origin } = this.view, step = this.#step, times = [];
    for (let k = Math.ceil((begin - 1 - origin) / step); origin + k * step <= end + 1; k++) times.push(origin + k * step);
    return times;
  }

  // Label of a time: seconds from the origin.
  #label(t) {
    const seconds = (t - this.view.origin) / 1000, digits = Math.max(0, 3 - Math.floor(Math.log10(this.#step)));
    const text = Math.abs(seconds).toFixed(digits);
    return Number(text) === 0 ? "0 s" : seconds < 0 ? `−${text}` : text;
  }

  // Return the horizontal position of a time, in px from the left edge of the host.
  place(t) {
    return this.plot.over.offsetLeft + this.plot.valToPos(t, "x");
  }

  // Draw the slip bands under the curves.
  #bands(plot) {
    const { ctx, bbox } = plot, { begin, end, at, slips, selected } = this.view;
    ctx.save();
    if (selected) {
      const [left, right] = selected.map((t) => plot.valToPos(Math.min(Math.max(t, begin), end), "x", true));
      ctx.fillStyle = colour("--selected");
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
    }
    for (const [from, to] of slips) {
      if (to < begin || from > end) continue;
      const left = plot.valToPos(Math.max(from, begin), "x", true);
      const right = plot.valToPos(Math.min(to, end), "x", true);
      ctx.fillStyle = colour("--slip-band");
      ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height);
      if (from >= begin) {
        ctx.fillStyle = colour("--slip");
        ctx.fillRect(left, bbox.top, devicePixelRatio, bbox.height);
        if (this.labelled && right - left > 30 * devicePixelRatio) {
          ctx.textAlign = "left";
          ctx.textBaseline = "alphabetic";
          ctx.font = `${11 * devicePixelRatio}px ${getComputedStyle(document.body).fontFamily}`;
          ctx.fillText("slip", left + 4 * devicePixelRatio, bbox.top + 12 * devicePixelRatio);
        }
      }
    }
    if (at < end) { // the selected time
      ctx.fillStyle = colour("--soft");
      ctx.fillRect(plot.valToPos(at, "x", true), bbox.top, devicePixelRatio, bbox.height);
    }
    ctx.restore();
  }
}

// Return the range function of an axis; the range grows in steps and shrinks only below half.
export function steppedRange(least) {
  let top = least, bottom = 0;
  return (low, high) => {
    const wanted = Math.max(least, nice((high ?? 0) * 1.08));
    if (wanted > top || wanted < top / 2) top = wanted;
    const under = (low ?? 0) < -top * 0.04 ? -nice(-low * 1.1) : 0;
    if (under < bottom || under > bottom / 2) bottom = under;
    return [bottom, top];
  };
}

// Return the smallest round number that is at least a value.
export function nice(value) {
  const ten = 10 ** Math.floor(Math.log10(Math.max(value, 1e-9)));
  return [1, 1.5, 2, 3, 4, 5, 6, 8, 10].find((each) => each * ten >= value - 1e-9) * ten;
}

export class Charts {
  constructor() {
    this.threshold = null;
    this.raw = false;
    const pressure = steppedRange(60);
    this.range = [0, 1023]; // raw counts
    this.amount = String; // text of counts
    this.counts = new Chart("counts", [], (low, high) => (this.raw ? this.range : pressure(low, high)), { text: (value) => this.amount(value) });
    this.scores = new Chart("scores", [{ hue: "--probability" }], () => [0, 1], {
      extra: (plot) => {
        drawTruth(plot, this.truth, this.scores.view);
        this.#drawThreshold(plot);
      },
    });
    this.truth = null;
    this.motion = new Chart("motion", [{ hue: "--probability" }], steppedRange(10));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.rebuild());
  }

  // Set the layout of the cells, which determines their colours.
  set layout(layout) {
    if (this.shown === layout) return;
    this.shown = layout;
    this.counts.series = styles(layout);
    this.counts.data = [[], ...this.counts.series.map(() => [])];
    this.counts.rebuild();
  }

  // Show the slip probability and the TCP speed if there are any; the lowest chart shows the time axis.
  choose(hasScores, hasMotion) {
    const shown = [true, hasScores, hasMotion], lowest = shown.lastIndexOf(true);
    this.all.forEach((chart, k) => {
      chart.host.closest("figure").hidden = !shown[k];
      if (chart.hasAxis !== (k === lowest)) chart.last = k === lowest;
    });
  }

  get all() {
    return [this.counts, this.scores, this.motion];
  }

  // Width of the curves, pixels.
  get columns() {
    return Math.max(100, Math.round((this.counts.host.clientWidth - LEFT - RIGHT) * devicePixelRatio));
  }

  draw({ touch, scores, truth, speed }, view) {
    this.truth = truth;
    this.counts.draw(touch ? touch.between(view.begin, view.end) : [[], ...this.counts.series.map(() => [])], view);
    this.scores.draw(scores ? scores.between(view.begin, view.end) : [[], []], view);
    this.motion.draw(speed.between(view.begin, view.end), view);
  }

  rebuild() {
    for (const chart of this.all) chart.rebuild();
  }

  // Draw the threshold as a dashed line.
  #drawThreshold(plot) {
    if (this.threshold === null) return;
    const { ctx, bbox } = plot, y = plot.valToPos(this.threshold, "y", true);
    ctx.save();
    ctx.strokeStyle = colour("--slip");
    ctx.lineWidth = 1.4 * devicePixelRatio;
    ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.restore();
  }
}
