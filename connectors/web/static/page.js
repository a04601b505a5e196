// The page of a running flow (live.js) or of a recorded session (recorded.js).

import { Charts, nice } from "./charts.js";
import { Events } from "./lists.js";
import { Pads, title, write } from "./pad.js";
import { live } from "./live.js";
import { recorded } from "./recorded.js";
import { Streams } from "./rows.js";

const $ = (id) => document.getElementById(id);
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

// State and drawing of both modes.
class View {
  constructor() {
    this.charts = new Charts();
    this.events = new Events();
    this.pads = new Pads($("fingers"), (finger) => this.choose(finger));
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
    this.clear();
  }

  clear() {
    this.streams = new Streams();
    this.faults = {};
    this.slipping = new Set();
    this.events.clear();
    this.deepest = 100;
    this.hasMotion = false;
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
    this.pads.update(fingers, this.finger);
  }

  set threshold(value) {
    this.charts.threshold = value;
    write($("scores-unit"), value === null ? "" : `dashed: threshold, ${value}`);
  }

  // Time (ms) of the newest sample of the selected fingertip, else of the arm.
  get newest() {
    return this.streams.touch.get(this.finger)?.newest ?? this.streams.speed.newest;
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
  // `whole`, true if that is the whole session. Both modes override it.
  scene() {
    return { streams: this.streams, figures: this.streams, end: this.newest };
  }

  draw(now) {
    const scene = this.scene(), { streams, figures, end, at = end } = scene;
    this.showState(scene);
    this.charts.hasMotion = this.hasMotion;
    $("speed").parentElement.hidden = !this.hasMotion;
    if (end === null) return;
    const raw = streams.zeroed.get(this.finger) === false;
    if (raw !== this.charts.raw) {
      this.charts.raw = raw;
      write($("counts-title"), raw ? "Reading of each barometer" : "Pressure of each barometer");
      write($("counts-unit"), raw ? "raw counts, which fall with pressure" : "counts below the unloaded reading");
      write($("unit"), raw ? "Raw counts, which fall with pressure." : "Counts below the unloaded reading.");
    }
    const readable = this.pads.tick(now);
    if (!readable) this.redraw(100); // to write the last numbers
    for (const finger of streams.touch.keys()) {
      const values = figures.touch.get(finger)?.at(at) ?? null, zeroed = streams.zeroed.get(finger);
      const deep = zeroed ? Math.max(0, ...(values ?? [])) : 0;
      if (deep > this.deepest) this.deepest = nice(deep);
      const share = zeroed ? (v) => v / this.deepest : (v) => (1023 - v) / 1023;
      this.pads.show(finger, values, share, this.faults[finger] ?? {}, this.stateOf(finger, scene));
    }
    write($("ramp-from"), raw ? "1023" : "0");
    write($("ramp-to"), raw ? "0" : String(this.deepest));
    const [from, to] = scene.span ?? [end - this.window, end], whole = scene.whole ?? false;
    const slips = this.events.spans(this.finger, to);
    const { touch, speed } = streams;
    const shown = { touch: touch.get(this.finger), scores: streams.scoring(this.finger), speed };
    this.charts.draw(shown, { begin: from, end: to, at: end, slips, whole });
    if (readable) this.#showFigures(figures, at);
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
  }
}

async function load() {
  for (;;) {
    try {
      const answer = await fetch("about.json", { cache: "no-store" });
      if (answer.ok) return await answer.json();
    } catch { /* the server is not up yet */ }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

const view = new View();
const about = await load();
document.body.dataset.mode = about.mode;
if (about.mode === "live") live(view);
else recorded(view, about);
