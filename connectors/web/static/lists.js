// Table of slip events, and cells of tables.

import { element, write } from "./pad.js";

const LIVE_MAX = 100; // events kept of a run
const LISTED_MAX = 1000; // events listed of a recording
const MARKS = { good: "●", warning: "▲", bad: "■" }; // by level
const QUALITIES = { doubtful: "warning", blind: "bad" }; // levels
export const number = new Intl.NumberFormat("en");

export class Events {
  constructor() {
    this.body = document.getElementById("events");
    this.none = document.getElementById("no-events");
    this.some = document.getElementById("some-events");
    this.all = []; // in the order of their ids
    this.changed = false;
  }

  clear() {
    this.all = [];
    this.body.replaceChildren();
    this.none.hidden = false;
  }

  // Add the events that are new, and return them.
  add(events, most = LIVE_MAX) {
    const known = new Set(this.all.map((event) => event.id));
    const added = (events ?? []).filter((event) => !known.has(event.id));
    if (!added.length) return added;
    this.all.push(...added);
    this.all.sort((a, b) => a.id - b.id);
    if (this.all.length > most) this.all.splice(0, this.all.length - most);
    this.changed = true;
    return added;
  }

  // Replace all events.
  replace(events) {
    this.clear();
    this.changed = true;
    this.add(events, Infinity);
  }

  // Return the spans [from, to] in which a fingertip slipped; the last one may end at `end`.
  spans(finger, end) {
    const spans = [];
    let open = null;
    for (const event of this.all) {
      if (event.finger !== finger && event.finger !== "every") continue;
      if (event.onset) open ??= event.t;
      else if (open !== null) { spans.push([open, event.t]); open = null; }
    }
    if (open !== null && open <= end) spans.push([open, end]);
    return spans;
  }

  // Return true if a fingertip has an event up to a time.
  any(finger, end) {
    return this.all.some((event) => event.t <= end && (event.finger === finger || event.finger === "every"));
  }

  // Rebuild the table if events were added: newest first, or in order if `go` handles clicks on a time.
  show(when, go = null) {
    if (!this.changed) return;
    this.changed = false;
    this.none.hidden = this.all.length > 0;
    const shown = go ? this.all.slice(0, LISTED_MAX) : this.all.slice().reverse();
    this.some.hidden = shown.length === this.all.length;
    write(this.some, `The first ${number.format(shown.length)} of ${number.format(this.all.length)} events are listed.`);
    this.body.replaceChildren(...shown.map((event) => row(event, when(event.t), go)));
  }
}

function row(event, time, go) {
  const tr = element("tr"), first = element("td");
  if (go) {
    const button = element("button");
    button.type = "button";
    button.textContent = time;
    button.setAttribute("aria-label", `Go to ${time}`);
    button.addEventListener("click", () => go(event.t));
    first.append(button);
  } else first.textContent = time;
  const late = event.verdict && event.verdict[1] !== "good" ? event.verdict : undefined;
  tr.append(
    first,
    cell(event.finger),
    happened(event),
    cell(event.p === null ? "–" : event.p.toFixed(2), "number probability"),
    judged(event.latency === null ? "–" : `${event.latency.toFixed(1)} ms`, late, "latency"),
  );
  return tr;
}

// Return the cell of an onset or end, with a quality other than good.
function happened({ onset, quality: [word, reason] }) {
  const td = cell(onset ? "slip onset" : "slip end", onset ? "onset" : "");
  if (word in QUALITIES) {
    const reservation = element("span");
    mark(reservation, `${word}: ${reason}`, QUALITIES[word]);
    td.append(reservation);
  }
  return td;
}

export function line(...cells) {
  const tr = element("tr");
  tr.append(...cells);
  return tr;
}

export function cell(text, kind = "") {
  const td = element("td", kind);
  td.textContent = text;
  return td;
}

// Return a cell with a value and its verdict, [word, level]; undefined: it has no limit or is good.
export function judged(value, verdict, kind = "") {
  const td = cell(value, `${value ? "number" : "text"} ${kind}`);
  if (verdict) {
    const word = element("span");
    mark(word, ...verdict);
    td.append(value ? " " : "", word);
  }
  return td;
}

export function mark(node, word, level) {
  node.className = `verdict ${level}`;
  write(node, `${MARKS[level]}\u00a0${word}`);
}
