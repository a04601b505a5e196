// The page of a running flow (live.js) or of a recorded session (recorded.js).

import { Charts, nice } from "./charts.js";
import { $, element, sleep, title, write } from "./dom.js";
import { Events } from "./events.js";
import { live } from "./live.js";
import { Pads } from "./pads.js";
import { recorded } from "./recorded.js";
import { Streams } from "./rows.js";

const UNKNOWN = { layout: null, range: [1023, 0], unit: "count", resolution: 1 }; // range as of a TakkTile
const READABLE = 100; // ms between updates of the numbers
const DEEP = 100; // counts, least end of the colour ramp
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

// State and drawing of both modes.
class View {
  constructor() {
    this.charts = new Charts();
    this.events = new Events();
    this.pads = new Pads($("fingers"), (finger) => this.choose(finger), (cell) => this.mark(cell), (value) => this.amount(value));
    Object.assign(this, { finger: null, marked: null, name: "", hasScores: true, over: "", drawn: 0, written: 0, onchange: () => this.dirty() });
    this.fingertip = null;
    this.clear();
  }

  clear() {
    this.streams = new Streams();
    this.events.clear();
    // by fingertip: kind of fault by cell; word and reason of the newest score
    Object.assign(this, { faults: {}, quality: {}, slipping: new Set(), zeroed: true, deepest: DEEP, hasMotion: false });
  }

  // Set the description of the fingertips; null: unknown.
  set fingertip(found) {
    const { layout, range, unit, resolution } = found ?? UNKNOWN;
    this.given = layout;
    this.range = range ?? UNKNOWN.range;
    this.unit = unit === "count" ? "counts" : unit;
    this.resolution = resolution; // units per count
    this.digits = Math.min(Math.max(0, Math.ceil(-Math.log10(resolution) - 1e-9)), 6); // of an amount
    this.charts.range = [Math.min(...this.range), Math.max(...this.range)];
    this.charts.amount = (value) => this.amount(value);
  }

  // Return counts as text in the unit of the fingertip.
  amount(value) {
    const text = (value * this.resolution).toFixed(this.digits);
    return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
  }

  // Sign of zeroed counts under pressure.
  get sign() {
    return Math.sign(this.range[1] - this.range[0]);
  }

  // Return the layout of the selected fingertip's cells: the given one, or a grid for an unknown fingertip.
  layout() {
    const cells = this.streams.of("touch", this.finger)?.columns.length ?? 6, { given } = this;
    if (given?.flat().filter((cell) => cell >= 0).length === cells) return given;
    if (this.made?.cells !== cells) {
      const wide = Math.ceil(Math.sqrt(cells)), cell = (k) => (k < cells ? k : -1);
      const layout = Array.from({ length: Math.ceil(cells / wide) }, (_, y) => Array.from({ length: wide }, (__, x) => cell(y * wide + x)));
      this.made = { cells, layout };
    }
    return this.made.layout;
  }

  choose(finger) {
    this.finger = finger;
    this.onchange();
  }

  // Highlight the curve of a cell; null: none.
  mark(cell) {
    this.marked = cell;
    this.charts.counts.mark(cell);
    this.dirty();
  }

  // Add rows by stream and fingertip; `put` is "push" or "replace".
  take(rows, put = "push") {
    this.streams.take(rows, this.zeroed ? this.sign : 1, put);
    this.hasMotion ||= "speed every" in rows;
    const { fingers } = this.streams;
    if (!fingers.includes(this.finger)) this.finger = fingers[0] ?? null;
    this.pads.update(fingers, this.finger, this.layout());
  }

  // Extend the colour ramp to the greatest of some zeroed values.
  deepen(values) {
    const deep = this.zeroed ? values.reduce((most, value) => Math.max(most, value), 0) : 0; // null: 0
    if (deep > this.deepest) this.deepest = nice(deep);
  }

  set threshold(value) {
    this.charts.threshold = value;
    write($("scores-unit"), value === null ? "" : `dashed: threshold, ${value}`);
  }

  // Time (ms) of the newest sample of the selected fingertip, else of the arm.
  get newest() {
    return this.streams.of("touch", this.finger)?.newest ?? this.streams.of("speed", "every")?.newest ?? null;
  }

  slips(finger) {
    return this.slipping.has(finger) || this.slipping.has("every");
  }

  // Request a redraw on the next animation frame.
  dirty() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame((now) => {
      const wait = (STILL.matches ? 500 : 30) - (now - this.drawn); // ms
      this.requested = false;
      if (wait > 0) return this.redraw(wait);
      this.drawn = now;
      this.draw(now);
    });
  }

  redraw(wait) {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.dirty(), wait);
  }

  // Draw the scene of the mode, `scene()`: `streams` of the curves, `figures`, whose newest rows are the numbers, `span` of
  // the curves ([begin, end], ms; null: no data), `until`, the time up to which events are known, and `origin`, `at` and
  // `selected` of the charts.
  draw(now) {
    const { streams, figures, span, until, ...marks } = this.scene();
    this.#showState(figures, until);
    this.charts.choose(this.hasScores, this.hasMotion);
    $("probability").parentElement.hidden = !this.hasScores;
    $("speed").parentElement.hidden = !this.hasMotion;
    if (!span) return;
    this.#showUnit();
    this.charts.layout = this.layout();
    const slips = this.events.spans(this.finger, span[1]);
    this.charts.draw(streams, this.finger, { begin: span[0], end: span[1], slips, ...marks });
    if (now - this.written < READABLE) return this.redraw(READABLE);
    this.written = now;
    this.#showFigures(figures);
  }

  #showUnit() {
    const { unit, zeroed } = this, [turn, side] = this.sign < 0 ? ["fall", "below"] : ["rise", "above"];
    this.charts.raw = !zeroed;
    const text = zeroed ? `${unit} ${side} the unloaded reading` : `raw ${unit}, which ${turn} with pressure`;
    write($("counts-title"), zeroed ? "Pressure of each barometer" : "Reading of each barometer");
    write($("counts-unit"), this.marked === null ? text : `${text} · barometer ${this.marked} highlighted`);
    write($("unit"), `${unit === "counts" || !zeroed ? text[0].toUpperCase() + text.slice(1) : text}.`);
  }

  #showFigures(figures) {
    const { finger, zeroed } = this, of = (stream) => figures.of(stream, finger)?.last?.[0] ?? null;
    const least = zeroed ? 0 : this.range[0], most = Math.abs(this.range[1] - this.range[0]);
    for (const each of this.streams.fingers) {
      const values = figures.of("touch", each)?.last ?? null;
      this.deepen(values ?? []);
      const share = zeroed ? (value) => value / this.deepest : (value) => (this.sign * (value - least)) / most;
      this.pads.show(each, values, share, this.faults[each] ?? {});
    }
    write($("ramp-from"), this.amount(least));
    write($("ramp-to"), this.amount(zeroed ? this.deepest : this.range[1]));
    write($("probability"), of("scores")?.toFixed(2) ?? "–");
    write($("speed"), of("speed")?.toFixed(1) ?? "–");
    const [word, reason] = this.quality[finger] ?? this.quality.every ?? [];
    write($("quality"), reason ? `${word[0].toUpperCase()}${word.slice(1)}: ${reason}` : "");
  }

  // Show whether each fingertip slips: unknown without a score and an event; or why the run is over.
  #showState(figures, until) {
    const states = new Map(this.streams.fingers.map((finger) => {
      const known = (figures.of("scores", finger)?.last?.[0] ?? null) !== null || this.events.any(finger, until);
      return [finger, this.slips(finger) ? "slip" : known ? "no slip" : this.hasScores ? "unknown" : "no detector"];
    }));
    for (const [finger, state] of states) this.pads.state(finger, this.over ? "unknown" : state);
    const state = this.over || states.get(this.finger);
    if (!states.size) return this.setTitle(this.over);
    const text = state[0].toUpperCase() + state.slice(1);
    $("state").dataset.slip = state === "slip";
    if ($("heading").textContent !== title(this.finger) + text) $("heading").replaceChildren(element("small", "", title(this.finger)), text);
    this.setTitle(text, title(this.finger));
  }

  // Set the title of the tab: state, fingertip, flow or session, and slipflow.
  setTitle(...parts) {
    const text = [...parts, this.name, "slipflow"].filter(Boolean).join(" · ");
    if (document.title !== text) document.title = text;
  }
}

async function load() {
  for (;;) {
    try {
      const answer = await fetch("about.json", { cache: "no-store" });
      if (answer.ok) return await answer.json();
    } catch { /* the server is not up yet */ }
    await sleep(1000);
  }
}

const about = await load();
document.body.dataset.mode = about.mode;
if (about.mode === "live") live(new View());
else recorded(new View(), about);
