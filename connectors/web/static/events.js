// Table of slip events.

import { $, element, line, number, write } from "./dom.js";

const LIVE_MAX = 100; // events kept of a run
const LISTED_MAX = 1000; // events listed of a recording
const MARKS = { doubtful: "▲", blind: "■" };

export class Events {
  constructor() {
    this.all = []; // in the order of their ids
    this.changed = true;
  }

  clear() {
    this.all = [];
    this.changed = true;
  }

  // Add the events that are new, and return them.
  add(events, most = LIVE_MAX) {
    const newest = this.all.at(-1)?.id ?? 0, added = events.filter((event) => event.id > newest);
    this.all = [...this.all, ...added].slice(-most);
    this.changed ||= added.length > 0;
    return added;
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
    const shown = go ? this.all.slice(0, LISTED_MAX) : this.all.toReversed();
    $("no-events").hidden = shown.length > 0;
    $("some-events").hidden = shown.length === this.all.length;
    write($("some-events"), `The first ${number.format(shown.length)} of ${number.format(this.all.length)} events are listed.`);
    $("events").replaceChildren(...shown.map((event) => row(event, when(event.t), go)));
  }
}

function row(event, time, go) {
  const first = element("td", "", go ? "" : time), happened = element("td", event.onset ? "onset" : "");
  if (go) {
    const button = Object.assign(element("button", "", time), { type: "button" });
    button.setAttribute("aria-label", `Go to ${time}`);
    button.addEventListener("click", () => go(event.t));
    first.append(button);
  }
  const [word, reason] = event.quality;
  happened.append(event.onset ? "slip onset" : "slip end");
  if (reason) happened.append(element("span", `verdict ${word}`, `${MARKS[word]}\u00a0${word}: ${reason}`));
  const latency = event.latency === null ? "–" : `${event.latency.toFixed(1)} ms`;
  return line(first, element("td", "", event.finger), happened,
    element("td", "number probability", event.p === null ? "–" : event.p.toFixed(2)), element("td", "number latency", latency));
}
