// The page of a running flow (live.js) or of a recorded session (recorded.js).

import { Charts, nice } from "./charts.js";
import { compare } from "./compare.js";
import { ALONE, BASE } from "./link.js";
import { Events } from "./lists.js";
import { Pads, title, write } from "./pad.js";
import { live } from "./live.js";
import { recorded } from "./recorded.js";
import { Streams } from "./rows.js";

const $ = (id) => document.getElementById(id);
const TAKKTILE = { layout: [[5, 4, 3], [0, 1, 2]], range: [1023, 0], unit: "count", resolution: 1 }; // sensor frame: x right, y up
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

// State and drawing of both modes.
class View {
  constructor() {
    this.charts = new Charts();
    this.events = new Events();
    this.pads = new Pads($("fingers"), (finger) => this.choose(finger), (value) => this.amount(value));
    this.window = 10000; // ms
    this.finger = null;
    this.deepest = 100; // counts, the end of the colour ramp
    this.drawn = 0;
    this.onchange = () => this.dirty();
    $("window").addEventListener("change", ({ target }) => {
      this.window = 1000 * Number(target.value);
      this.onchange();
    });
    this.name = ""; // flow or recorded session
    this.hasScores = true;
    this.fingertip = null;
    this.clear();
  }

  clear() {
    this.streams = new Streams(this.sign);
    this.faults = {};
    this.slipping = new Set();
    this.quality = {}; // of the newest score: word and reason, by fingertip
    this.events.clear();
    this.deepest = 100;
    this.hasMotion = false;
  }

  // Set the description of the fingertips; null: unknown, as a TakkTile.
  set fingertip(found) {
    const { layout, range, unit, resolution } = found ?? TAKKTILE;
    this.given = found ? layout : null;
    this.range = range ?? TAKKTILE.range;
    this.unit = unit === "count" ? "counts" : unit;
    this.resolution = resolution; // units per count
    this.digits = Math.min(Math.max(0, Math.ceil(-Math.log10(resolution) - 1e-9)), 6); // of an amount
    this.charts.range = [Math.min(...this.range), Math.max(...this.range)];
    this.charts.amount = (value) => this.amount(value);
    this.charts.raw = null; // the captions are written with the next draw
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

  // Return the layout of the selected fingertip's cells: the given one, or a square for an unknown fingertip.
  layout() {
    const cells = this.streams.touch.get(this.finger)?.columns.length ?? 6;
    const { given } = this;
    if (given?.flat().filter((cell) => cell >= 0).length === cells) return given;
    if (this.made?.cells !== cells) {
      const wide = Math.ceil(Math.sqrt(cells)), rows = Math.ceil(cells / wide);
      const square = Array.from({ length: rows }, (_, y) => Array.from({ length: wide }, (__, x) => (y * wide + x < cells ? y * wide + x : -1)));
      this.made = { cells, layout: cells === 6 ? TAKKTILE.layout : square };
    }
    return this.made.layout;
  }

  choose(finger) {
    this.finger = finger;
    this.onchange();
  }

  // Add the streams of a frame; `put` is "push" or "replace".
  take(frame, put = "push") {
    this.streams.take(frame, put);
    if (frame.speed) this.hasMotion ||= frame.speed.t.length > 0 || put === "replace";
    const fingers = [...this.streams.touch.keys()].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
    if (!this.streams.touch.has(this.finger)) this.finger = fingers[0] ?? null;
    this.pads.update(fingers, this.finger, this.layout());
  }

  set threshold(value) {
    this.charts.threshold = value;
    write($("scores-unit"), value === null ? "" : `dashed: threshold, ${value}`);
  }

  // Time (ms) of the newest sample of the selected fingertip, else of the arm.
  get newest() {
    return this.streams.touch.get(this.finger)?.newest ?? this.streams.speed.newest;
  }

  // Return the cells without a reading, by fingertip.
  silent() {
    const cells = [...this.streams.touch].map(([finger, rows]) => {
      const values = rows.at(Infinity) ?? [];
      return [finger, values.flatMap((value, k) => (value === null ? [k] : []))];
    });
    return new Map(cells);
  }

  slips(finger) {
    return this.slipping.has(finger) || this.slipping.has("every");
  }

  // Return true if the slip state is known from a score or an event, in a recording up to the selected time.
  knows(finger, { figures, end, at = end, span }) {
    const score = figures.scoring(finger)?.at(at ?? -Infinity)?.[0] ?? null;
    return score !== null || this.slips(finger) || this.events.any(finger, span ? end : Infinity);
  }

  // Request a redraw on the next animation frame.
  dirty() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame((now) => {
      this.requested = false;
      const wait = STILL.matches ? 500 : 30; // ms
      if (now - this.drawn < wait) {
        this.redraw(wait - (now - this.drawn));
        return;
      }
      this.drawn = now;
      this.draw(now);
    });
  }

  redraw(wait) {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.dirty(), wait);
  }

  // Return the `streams` of the curves, their `end` (ms), and the full streams of the numbers, `figures`. Optional:
  // `at`, time of the numbers (default `end`); `span`, [begin, end] of the curves (default the window before `end`);
  // `origin`, time of label 0 on the time axis, and `last`, end of the recording (default the end of the span);
  // `selected`, [begin, end] that is highlighted. Both modes override it.
  scene() {
    return { streams: this.streams, figures: this.streams, end: this.newest };
  }

  draw(now) {
    const scene = this.scene(), { streams, figures, end, at = end } = scene;
    this.showState(scene);
    this.charts.choose(this.hasScores, this.hasMotion);
    $("probability").parentElement.hidden = !this.hasScores;
    $("speed").parentElement.hidden = !this.hasMotion;
    if (end === null) return;
    const raw = streams.zeroed.get(this.finger) === false;
    this.charts.layout = this.layout();
    if (raw !== this.charts.raw) {
      this.charts.raw = raw;
      write($("counts-title"), raw ? "Reading of each barometer" : "Pressure of each barometer");
      const [turn, side] = this.sign < 0 ? ["fall", "below"] : ["rise", "above"];
      write($("counts-unit"), raw ? `raw ${this.unit}, which ${turn} with pressure` : `${this.unit} ${side} the unloaded reading`);
      const unit = this.unit === "counts" ? "Counts" : this.unit;
      write($("unit"), raw ? `Raw ${this.unit}, which ${turn} with pressure.` : `${unit} ${side} the unloaded reading.`);
    }
    const readable = this.pads.tick(now);
    if (!readable) this.redraw(100); // to write the last numbers
    for (const finger of streams.touch.keys()) {
      const values = figures.touch.get(finger)?.at(at) ?? null, zeroed = streams.zeroed.get(finger);
      const deep = zeroed ? Math.max(0, ...(values ?? [])) : 0;
      if (deep > this.deepest) this.deepest = nice(deep);
      const share = zeroed ? (v) => v / this.deepest : (v) => this.pressure(v, false) / this.most;
      this.pads.show(finger, values, share, this.faults[finger] ?? {}, this.stateOf(finger, scene));
    }
    write($("ramp-from"), raw ? this.amount(this.range[0]) : "0");
    write($("ramp-to"), this.amount(raw ? this.range[1] : this.deepest));
    const [from, to] = scene.span ?? [end - this.window, end], { origin = to, last = to, selected } = scene;
    const slips = this.events.spans(this.finger, Math.min(to, last));
    const { touch, speed } = streams, truth = streams.truth.get(this.finger);
    $("truth-key").hidden = !truth;
    const shown = { touch: touch.get(this.finger), scores: streams.scoring(this.finger), truth, speed };
    this.charts.draw(shown, { begin: from, end: to, at: end, slips, origin, selected });
    if (readable) this.#showFigures(figures, at);
  }

  // Return a reading as counts above no pressure; `most` is that of the highest pressure.
  pressure(value, zeroed) {
    return this.sign * (zeroed ? value : value - this.range[0]);
  }

  get most() {
    return Math.abs(this.range[1] - this.range[0]);
  }

  stateOf(finger, scene) {
    return this.slips(finger) ? "slip" : this.knows(finger, scene) ? "no slip" : "unknown";
  }

  showState(scene) {
    if (this.finger === null) {
      this.setTitle();
      return;
    }
    const state = this.stateOf(this.finger, scene), heading = $("heading");
    $("state").dataset.slip = state === "slip";
    const text = state[0].toUpperCase() + state.slice(1);
    if (heading.dataset.shown !== text + this.finger) {
      heading.dataset.shown = text + this.finger;
      const small = document.createElement("small");
      small.textContent = title(this.finger);
      heading.replaceChildren(small, text);
      this.setTitle(text, title(this.finger));
    }
  }

  // Set the title of the tab: state, fingertip, flow or session, and slipflow.
  setTitle(...parts) {
    const text = [...parts, this.name, "slipflow"].filter(Boolean).join(" · ");
    if (document.title !== text) document.title = text;
  }

  #showFigures(figures, time) {
    const near = (rows, digits) => {
      const at = rows?.at(time)?.[0] ?? null;
      return at === null ? "–" : at.toFixed(digits);
    };
    write($("probability"), near(figures.scoring(this.finger), 2));
    write($("speed"), near(figures.speed, 1));
    this.#showQuality();
  }

  #showQuality() {
    const [word, reason] = this.quality[this.finger] ?? this.quality.every ?? [];
    $("quality").hidden = !word;
    $("quality").classList.toggle("bad", word !== "good");
    write($("quality"), reason ? `${word[0].toUpperCase()}${word.slice(1)}: ${reason}` : `Quality: ${word}`);
  }
}

async function load() {
  for (;;) {
    try {
      const answer = await fetch(`${BASE}about.json`, { cache: "no-store" });
      if (answer.ok) return await answer.json();
    } catch { /* the server is not up yet */ }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

const about = await load(), compared = ALONE && about.panes?.length > 1;
document.body.classList.toggle("pane", !ALONE);
document.body.dataset.mode = compared ? "compare" : about.mode;
if (compared) compare(about.panes);
else if (about.mode === "live") live(new View());
else recorded(new View(), about);
