// Tables: slip events, and how sources and sinks do.

import { element, write } from "./pad.js";

const SHOWN = 100; // events
const LISTED = 1000; // of a recording
const number = new Intl.NumberFormat("en");

export class Events {
  constructor() {
    this.body = document.getElementById("events");
    this.none = document.getElementById("no-events");
    this.some = document.getElementById("some-events");
    this.all = []; // in the order of their numbers
    this.changed = false;
  }

  clear() {
    this.all = [];
    this.body.replaceChildren();
    this.none.hidden = false;
  }

  // Take events, of which some may be there already; gives those that are new.
  add(events, most = SHOWN) {
    const known = new Set(this.all.map((event) => event.id));
    const fresh = (events ?? []).filter((event) => !known.has(event.id));
    if (!fresh.length) return fresh;
    this.all.push(...fresh);
    this.all.sort((a, b) => a.id - b.id);
    if (this.all.length > most) this.all.splice(0, this.all.length - most);
    this.changed = true;
    return fresh;
  }

  // Spans [from, to] in which a fingertip slipped, as far as these events tell; `end` where one is open.
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

  // Whether a fingertip began or ceased to slip up to an instant.
  tell(finger, end) {
    return this.all.some((event) => event.t <= end && (event.finger === finger || event.finger === "every"));
  }

  // Write the table anew if there is something new, the newest first; `go`: what an event's time does.
  show(when, go = null) {
    if (!this.changed) return;
    this.changed = false;
    this.none.hidden = this.all.length > 0;
    const shown = go ? this.all.slice(0, LISTED) : this.all.slice().reverse();
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
  tr.append(
    first,
    cell(event.finger),
    cell(event.onset ? "slip begins" : "slip ends", event.onset ? "onset" : ""),
    cell(event.p === null ? "–" : event.p.toFixed(2), "number sure"),
    cell(event.latency === null ? "–" : `${event.latency.toFixed(1)} ms`, "number latency"),
  );
  return tr;
}

export class Health {
  constructor() {
    this.sources = document.getElementById("sources");
    this.sinks = document.getElementById("sinks");
    this.recording = document.getElementById("recording");
  }

  show({ sources, sinks, errors, recorders }) {
    this.sources.replaceChildren(
      ...Object.entries(sources).map(([name, source]) => line(
        cell(name),
        source.state === "up" ? cell("up") : cell(state(source, errors[name]), "bad text"),
        cell(source.rate_hz === null ? "–" : `${source.rate_hz.toFixed(1)} Hz`, "number"),
        cell(source.lag_ms === null ? "–" : `${source.lag_ms.toFixed(0)} ms`, "number"),
        cell(number.format(source.late), "number"),
        cell(number.format(source.gaps), source.gaps ? "number bad" : "number"),
      )),
    );
    this.#showSinks(sinks);
    this.#record(recorders, sinks);
  }

  #showSinks(sinks) {
    this.sinks.replaceChildren(
      ...Object.entries(sinks).map(([name, sink]) => line(
        cell(name),
        sink.error ? cell(sink.error, "bad text") : cell("works"),
        cell(number.format(sink.rows), "number"),
        cell(number.format(sink.queued), "number"),
        cell(number.format(sink.dropped), sink.dropped ? "number bad" : "number"),
      )),
    );
  }

  // The run is over: what its sinks have is final.
  end({ sinks, recorders }) {
    this.#showSinks(sinks);
    this.#record(recorders, sinks, true);
  }

  #record(names, sinks, ended = false) {
    const recorders = names.map((name) => sinks[name]).filter(Boolean);
    const rows = recorders.reduce((sum, sink) => sum + sink.rows, 0);
    const dropped = recorders.reduce((sum, sink) => sum + sink.dropped, 0);
    const failed = recorders.find((sink) => sink.error);
    this.recording.hidden = false;
    this.recording.className = failed || dropped ? "bad" : recorders.length && !ended ? "on" : "";
    const does = ended ? "Recorded" : "Recording";
    const text = failed ? `${ended ? "Recording failed" : "Recording fails"}: ${failed.error}` : dropped
      ? `${does}, ${number.format(dropped)} rows lost`
      : recorders.length ? `${does}, ${number.format(rows)} rows` : ended ? "Not recorded" : "Not recording";
    write(this.recording, text);
  }
}

function state(source, error) {
  return source.state === "stale" ? "gives nothing" : error ? `down: ${error}` : "down";
}

function line(...cells) {
  const tr = element("tr");
  tr.append(...cells);
  return tr;
}

function cell(text, kind = "") {
  const td = element("td", kind);
  td.textContent = text;
  return td;
}
