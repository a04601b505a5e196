// Labels by hand: spans marked with mouse or keys, undo, and saving as the next version.

import { CODES } from "./bands.js";
import { $, write } from "./dom.js";

const KEYS = { s: "slip", t: "static", u: "unknown", e: null }; // null: erase
const TAKES_KEYS = "input:not([type=range], [type=radio]), select, textarea";
const AUTHOR = "slipflow-author"; // in the browser's storage

export class Labels {
  // `page` has `finger`, `instant()`, `elapsed(t)` and `changed()`, which redraws.
  constructor(labels, page) {
    Object.assign(this, { page, version: labels.version, spans: labels.spans, saved: labels.spans, past: [], selected: null });
    $("label-author").value = localStorage.getItem(AUTHOR) ?? "";
    $("label-author").addEventListener("change", ({ target }) => localStorage.setItem(AUTHOR, target.value));
    for (const [key, value] of Object.entries(KEYS)) $(`label-${value ?? "erase"}`).addEventListener("click", () => this.mark(KEYS[key]));
    $("label-begin").addEventListener("click", () => this.edge(0));
    $("label-end").addEventListener("click", () => this.edge(1));
    $("label-undo").addEventListener("click", () => this.undo());
    $("label-save").addEventListener("click", () => this.save());
    document.addEventListener("keydown", (event) => this.#key(event));
    addEventListener("beforeunload", (event) => { if (this.unsaved) event.preventDefault(); });
    this.#show();
  }

  get unsaved() {
    return this.spans !== this.saved;
  }

  // Return the band of a fingertip: [begin, end, code].
  band(finger) {
    return this.spans.filter((span) => span.finger === finger).map(({ begin, end, value }) => [begin, end, CODES[value]]);
  }

  // Select a span of time; null: none.
  select(selected) {
    this.selected = selected;
    this.#show();
    this.page.changed();
  }

  // Select the marked span at a time, if there is one.
  pick(t) {
    const found = this.spans.find((span) => span.finger === this.page.finger && span.begin <= t && t < span.end);
    this.select(found ? [found.begin, found.end] : null);
    if (found) $("label-note").value = found.note;
  }

  // Move the beginning (0) or the end (1) of the selection to the selected time.
  edge(which) {
    const t = this.page.instant(), [begin, end] = this.selected ?? [t, t];
    const moved = which ? [Math.min(begin, t), t] : [t, Math.max(end, t)];
    this.select(moved);
  }

  // Mark the selection with a value, or erase its marks (null).
  mark(value) {
    const [begin, end] = this.selected ?? [0, 0], { finger } = this.page;
    if (end <= begin || finger === null) {
      this.#say("Select a span first: drag over the bands, or press [ and ] at its beginning and end.");
      return;
    }
    const cut = this.spans.flatMap((span) => (span.finger !== finger || span.end <= begin || span.begin >= end ? [span] : [
      ...(span.begin < begin ? [{ ...span, end: begin }] : []),
      ...(span.end > end ? [{ ...span, begin: end }] : []),
    ]));
    if (value) cut.push({ begin, end, finger, value, ...this.#by(), created: "" });
    this.past.push(this.spans);
    this.spans = cut;
    this.#show();
    this.page.changed();
  }

  undo() {
    if (!this.past.length) return;
    this.spans = this.past.pop();
    this.#show();
    this.page.changed();
  }

  // Save all spans as the next version.
  async save() {
    if (!this.unsaved || this.saving) return;
    const { spans } = this, { author, note } = this.#by(); // may be typed after marking
    const signed = spans.map((span) => (span.created ? span : { ...span, author: span.author || author, note: span.note || note }));
    this.saving = true;
    try {
      const answer = await fetch("labels", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify({ based_on: this.version, spans: signed }),
      });
      if (!answer.ok) throw new Error(await answer.text());
      const labels = await answer.json();
      Object.assign(this, { version: labels.version, saved: labels.spans, past: [] });
      if (this.spans === spans) this.spans = labels.spans; // else it was marked meanwhile
      this.#show();
      this.page.changed();
    } catch (error) {
      this.#say(`Not saved: ${error.message}`);
    } finally {
      this.saving = false;
    }
  }

  // Return name and note as typed.
  #by() {
    return { author: $("label-author").value.trim(), note: $("label-note").value.trim() };
  }

  #key(event) {
    const key = event.key.toLowerCase(), edges = key === "[" || key === "]"; // on some keyboards with Alt or AltGr
    const control = event.metaKey || (event.ctrlKey && !event.altKey), saves = control && key === "s";
    if ((event.target.closest(TAKES_KEYS) && !saves) || (event.altKey && !edges)) return;
    if (control) {
      if (key === "z") this.undo();
      else if (saves) this.save();
      else return;
    } else if (key in KEYS) this.mark(KEYS[key]);
    else if (key === "delete") this.mark(null);
    else if (edges) this.edge(key === "]" ? 1 : 0);
    else return;
    event.preventDefault();
  }

  #say(text) {
    write($("label-state"), text);
  }

  #show() {
    const { selected, page } = this;
    const size = selected ? ((selected[1] - selected[0]) / 1000).toFixed(2) : "";
    write($("label-selected"), selected ? `${page.elapsed(selected[0])} to ${page.elapsed(selected[1])} (${size} s)` : "No span selected");
    for (const value of ["slip", "static", "unknown", "erase"]) $(`label-${value}`).disabled = !selected;
    $("label-undo").disabled = !this.past.length;
    $("label-save").disabled = !this.unsaved;
    const count = `${this.spans.length} ${this.spans.length === 1 ? "span" : "spans"}`;
    this.#say(this.unsaved ? `${count}, not saved` : this.version ? `${count}, saved as version ${this.version}` : "No labels by hand yet");
  }
}
