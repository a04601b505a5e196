// Three charts with one time axis: counts of each barometer, slip probability, TCP speed.
// A view of the time axis has `begin`, `end` and `origin` (ms), the time of label 0, the `slips` as [begin, end], and
// optionally the selected time `at` and the `selected` span.

import { $, colour } from "./dom.js";

/* global uPlot */

export const LEFT = 52, RIGHT = 10; // px, the same for all charts, so that their times align
const STEPS = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 30000, 60000, 120000, 300000, 600000, 1800000]; // ms
const CHROMA = 0.13, HUES = [55, 305]; // of OKLCH: orange on the left, violet on the right, no red

// Return colour and dash of each cell's curve: hue from left to right, lightness from the lowest row up, dots for the upper of two rows.
export function styles(layout) {
  const cells = [], [low, high] = ["--curve-low", "--curve-high"].map((name) => Number(colour(name)));
  const between = (from, to, k, count) => (count > 1 ? from + ((to - from) * k) / (count - 1) : (from + to) / 2);
  layout.forEach((row, y) => row.forEach((cell, x) => {
    const above = layout.length - 1 - y, light = between(low, high, above, layout.length), hue = between(...HUES, x, row.length);
    if (cell >= 0) cells[cell] = { stroke: `oklch(${light} ${CHROMA} ${hue})`, dash: above && layout.length === 2 ? [2, 3] : undefined };
  }));
  return cells;
}

class Chart {
  // `series()` returns stroke and dash of each curve; `range(low, high)` the ends of the vertical axis; `extra(plot)` draws more;
  // `text(value)` labels a value.
  constructor(id, series, range, { extra = () => {}, text = null } = {}) {
    Object.assign(this, { host: $(id), series, range, extra, text, lowest: false, marked: null });
    this.clear();
    this.view = { begin: -10000, end: 0, origin: 0, slips: [] };
    this.#build();
    new ResizeObserver(() => this.#resize()).observe(this.host);
  }

  draw(data, view) {
    this.view = view;
    if (data) this.data = data;
    else this.clear();
    this.plot.setData(this.data);
  }

  rebuild() {
    this.plot.destroy();
    this.#build();
  }

  // Fade all curves but one; null: none.
  mark(series) {
    this.marked = series;
    this.plot.setSeries(series === null ? null : series + 1, { focus: true });
  }

  #build() {
    const font = `12px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: colour("--soft"), font, grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false } };
    const label = (_, times) => times.map((t) => (this.lowest ? this.#label(t) : ""));
    this.plot = new uPlot(
      {
        width: this.host.clientWidth || 600,
        height: this.host.clientHeight || 120,
        legend: { show: false },
        cursor: { show: false },
        focus: { alpha: 0.1 },
        padding: [10, RIGHT, 0, 0],
        scales: {
          x: { time: false, range: () => [this.view.begin, this.view.end] },
          y: { range: (_, low, high) => this.range(low, high) },
        },
        axes: [
          { ...axis, size: () => (this.lowest ? 24 : 5), gap: 4, splits: () => this.#times(), values: label },
          { ...axis, size: LEFT, gap: 6, space: 24, ...(this.text && { values: (_, at) => at.map(this.text) }) },
        ],
        series: [
          {},
          ...this.series().map(({ stroke, dash }) => ({ stroke, width: 1.6, dash, points: { show: false } })),
        ],
        hooks: { drawAxes: [(plot) => this.#mark(plot)], draw: [(plot) => this.extra(plot)] },
      },
      this.data,
      this.host,
    );
    if (this.marked !== null) this.mark(this.marked);
  }

  clear() {
    this.data = [[], ...this.series().map(() => [])];
  }

  #resize() {
    if (this.host.clientWidth) this.plot.setSize({ width: this.host.clientWidth, height: this.host.clientHeight });
  }

  get #step() {
    const span = this.view.end - this.view.begin, most = this.host.clientWidth < 480 ? 5 : 10; // labels
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

  // Draw the slips, the selected span and the selected time under the curves.
  #mark(plot) {
    const { ctx, bbox } = plot, { begin, end, at, slips, selected } = this.view;
    const place = (t) => plot.valToPos(Math.min(Math.max(t, begin), end), "x", true);
    const fill = (from, wide, name) => {
      ctx.fillStyle = colour(name);
      ctx.fillRect(from, bbox.top, wide, bbox.height);
    };
    if (selected) fill(place(selected[0]), place(selected[1]) - place(selected[0]), "--selected");
    for (const [from, to] of slips.filter(([from, to]) => to >= begin && from <= end)) {
      fill(place(from), Math.max(place(to) - place(from), 1), "--slip-band");
      if (from >= begin) fill(place(from), devicePixelRatio, "--slip");
    }
    if (at >= begin && at <= end) fill(place(at), devicePixelRatio, "--soft");
  }
}

// Return the range function of an axis; the range grows in steps and shrinks only below half.
function steppedRange(least) {
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
    this.raw = false; // true: `range` is that of the counts
    this.range = [0, 1023];
    this.amount = String; // text of counts
    const pressure = steppedRange(60), black = () => [{ stroke: colour("--ink") }];
    const ends = (low, high) => (this.raw ? this.range : pressure(low, high));
    this.counts = new Chart("counts", () => styles(this.shown ?? []), ends, { text: (value) => this.amount(value) });
    this.scores = new Chart("scores", black, () => [0, 1], { extra: (plot) => this.#drawThreshold(plot) });
    this.motion = new Chart("motion", black, steppedRange(10));
    this.all = [this.counts, this.scores, this.motion];
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.all.forEach((each) => each.rebuild()));
  }

  // Set the layout of the cells, which determines their colours.
  set layout(layout) {
    if (this.shown === layout) return;
    this.shown = layout;
    this.counts.clear();
    this.counts.rebuild();
  }

  // Show the slip probability and the TCP speed if there are any; the lowest chart shows the time axis.
  choose(hasScores, hasMotion) {
    const shown = [true, hasScores, hasMotion], lowest = shown.lastIndexOf(true);
    this.all.forEach((chart, k) => {
      chart.host.closest("figure").hidden = !shown[k];
      chart.lowest = k === lowest;
      chart.host.classList.toggle("last", chart.lowest); // changes the size, which triggers a redraw
    });
  }

  // Width of the curves, pixels.
  get columns() {
    return Math.max(100, Math.round((this.counts.host.clientWidth - LEFT - RIGHT) * devicePixelRatio));
  }

  // Draw the streams of a fingertip.
  draw(streams, finger, view) {
    const of = (stream) => streams.of(stream, finger)?.between(view.begin, view.end);
    this.counts.draw(of("touch"), view);
    this.scores.draw(of("scores"), view);
    this.motion.draw(of("speed"), view);
  }

  // Draw the threshold as a dashed line.
  #drawThreshold({ ctx, bbox, valToPos }) {
    if (this.threshold === null) return;
    const y = valToPos(this.threshold, "y", true), ratio = devicePixelRatio;
    ctx.save();
    ctx.strokeStyle = colour("--slip");
    ctx.lineWidth = 1.4 * ratio;
    ctx.setLineDash([6 * ratio, 4 * ratio]);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.restore();
  }
}
