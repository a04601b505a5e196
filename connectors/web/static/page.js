// The page: what a flow feels, as it runs, or a recorded session. Each way has a module of its own.

import { Charts, nice } from "./charts.js";
import { Events } from "./lists.js";
import { Pads, title, write } from "./pad.js";
import { live } from "./live.js";
import { recorded } from "./recorded.js";
import { Streams } from "./rows.js";

const $ = (id) => document.getElementById(id);
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

// What both ways share: streams, what is chosen, and drawing them.
class View {
  constructor() {
    this.charts = new Charts();
    this.events = new Events();
    this.pads = new Pads($("fingers"), (finger) => this.choose(finger));
    this.window = 10000; // ms
    this.finger = null;
    this.deepest = 100; // counts, the end of the ramp
    this.drawn = 0;
    this.onchange = () => this.dirty();
    $("window").addEventListener("change", ({ target }) => {
      this.window = 1000 * Number(target.value);
      this.onchange();
    });
    this.name = ""; // of the flow, or of the recorded session
    this.clear();
  }

  clear() {
    this.streams = new Streams();
    this.faults = {};
    this.slipping = new Set();
    this.events.clear();
    this.deepest = 100;
    this.moves = false; // whether there was motion
  }

  choose(finger) {
    this.finger = finger;
    this.onchange();
  }

  // Take the streams of a frame; `put` is "push" or "replace".
  take(frame, put = "push") {
    this.streams.take(frame, put);
    if (frame.speed) this.moves ||= frame.speed.t.length > 0 || put === "replace";
    const fingers = [...this.streams.touch.keys()].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
    if (!this.streams.touch.has(this.finger)) this.finger = fingers[0] ?? null;
    this.pads.have(fingers, this.finger);
  }

  set threshold(value) {
    this.charts.threshold = value;
    write($("scores-unit"), value === null ? "" : `dashed: the threshold of a slip, ${value}`);
  }

  // The newest instant of the chosen fingertip, ms; of the arm where there is none.
  get newest() {
    return this.streams.touch.get(this.finger)?.newest ?? this.streams.speed.newest;
  }

  slips(finger) {
    return this.slipping.has(finger) || this.slipping.has("every");
  }

  // Whether anything tells if a fingertip slips: a score, or an event; in a recording, up to its instant.
  knows(finger, { figures, end, at = end, span }) {
    const score = figures.scoring(finger)?.at(at ?? -Infinity)?.[0] ?? null;
    return score !== null || this.slips(finger) || this.events.tell(finger, span ? end : Infinity);
  }

  // Draw before the next frame of the screen, unless that is asked for already.
  dirty() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
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

  // Override: what is drawn, and up to when; what has the figures, as curves may be thinned, and `at` which
  // instant, unless that is the end; `span`: [begin, end] of the curves, unless it is the window before the end,
  // and whether that is the `whole` session.
  scene() {
    return { streams: this.streams, figures: this.streams, end: this.newest };
  }

  draw(now) {
    const scene = this.scene(), { streams, figures, end, at = end } = scene;
    this.showState(scene);
    this.charts.moves = this.moves;
    $("speed").parentElement.hidden = !this.moves;
    if (end === null) return;
    const raw = streams.zeroed.get(this.finger) === false;
    if (raw !== this.charts.raw) {
      this.charts.raw = raw;
      write($("counts-title"), raw ? "Reading of each barometer" : "Pressure of each barometer");
      write($("counts-unit"), raw ? "raw counts, which fall as pressure rises" : "counts below unloaded");
      write($("unit"), raw ? "Raw counts: they fall as pressure rises." : "Counts below the unloaded fingertip.");
    }
    const readable = this.pads.tick(now);
    if (!readable) this.redraw(100); // so that the last figures are written too
    for (const finger of streams.touch.keys()) {
      const values = figures.touch.get(finger)?.at(at) ?? null, zeroed = streams.zeroed.get(finger);
      const deep = zeroed ? Math.max(0, ...(values ?? [])) : 0;
      if (deep > this.deepest) this.deepest = nice(deep);
      const share = zeroed ? (v) => v / this.deepest : (v) => (1023 - v) / 1023;
      this.pads.show(finger, values, share, this.faults[finger] ?? {}, this.said(finger, scene));
    }
    write($("ramp-from"), raw ? "1023" : "0");
    write($("ramp-to"), raw ? "0" : String(this.deepest));
    const [from, to] = scene.span ?? [end - this.window, end], whole = scene.whole ?? false;
    const slips = this.events.spans(this.finger, to);
    const { touch, speed } = streams;
    const shown = { touch: touch.get(this.finger), scores: streams.scoring(this.finger), speed };
    this.charts.draw(shown, { begin: from, end: to, at: end, slips, whole });
    if (readable) this.#tell(figures, at);
  }

  said(finger, scene) {
    return this.slips(finger) ? "slip" : this.knows(finger, scene) ? "no slip" : "not known";
  }

  showState(scene) {
    if (this.finger === null) {
      this.entitle();
      return;
    }
    const said = this.said(this.finger, scene), heading = $("felt");
    $("state").dataset.slip = said === "slip";
    const state = said[0].toUpperCase() + said.slice(1);
    if (heading.dataset.said !== state + this.finger) {
      heading.dataset.said = state + this.finger;
      const small = document.createElement("small");
      small.textContent = title(this.finger);
      heading.replaceChildren(small, state);
      this.entitle(state, title(this.finger));
    }
  }

  // Name the page: what is felt first, then `name`, of what it shows, the program last.
  entitle(...felt) {
    const text = [...felt, this.name, "slipflow"].filter(Boolean).join(" · ");
    if (document.title !== text) document.title = text;
  }

  #tell(figures, instant) {
    const near = (rows, digits) => {
      const at = rows?.at(instant)?.[0] ?? null;
      return at === null ? "–" : at.toFixed(digits);
    };
    write($("probability"), near(figures.scoring(this.finger), 2));
    write($("speed"), near(figures.speed, 1));
  }
}

async function contents() {
  for (;;) {
    try {
      const answer = await fetch("about.json", { cache: "no-store" });
      if (answer.ok) return await answer.json();
    } catch { /* it is not there yet */ }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

const view = new View();
const about = await contents();
document.body.dataset.mode = about.mode;
if (about.mode === "live") live(view);
else recorded(view, about);
