// Readout of all curves and bands at one time: under the pointer, else the selected time.

import { write } from "./pad.js";
import { Streams } from "./rows.js";

const MANY = 16; // cells; of more the readout has minimum and maximum
const SAID = { "1": "slip", "0": "static", "-1": "unknown" };

export class Readout {
  // `load(t)` returns the rows at a time, `when(t)` its text.
  constructor(host, view, bands, load, when) {
    Object.assign(this, { host, view, bands, load, when, wanted: null, busy: false });
  }

  // Load and show the values at a time; a newer call replaces one that waits.
  async at(t) {
    this.wanted = t;
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.wanted !== null) {
        const next = this.wanted;
        this.wanted = null;
        const streams = new Streams(this.view.sign);
        streams.take(await this.load(next));
        this.show(next, streams);
      }
    } catch { /* the page shows that the server does not respond */ } finally {
      this.busy = false;
    }
  }

  show(t, streams) {
    const { finger } = this.view, value = (rows) => rows?.at(t)?.[0] ?? null;
    const score = value(streams.scoring(finger)), speed = value(streams.speed);
    const parts = [this.when(t), touch(streams.touch.get(finger)?.at(t) ?? null, this.view)];
    if (score !== null) parts.push(`probability ${score.toFixed(3)}`);
    if (speed !== null) parts.push(`TCP ${speed.toFixed(1)} mm/s`);
    for (const [name, text] of [["arm", "arm label"], ["truth", "truth"], ["hand", "by hand"]]) {
      const code = this.bands.at(name, t);
      if (code !== null) parts.push(`${text} ${SAID[code]}`);
    }
    write(this.host, parts.filter(Boolean).join(" · "));
  }
}

function touch(values, view) {
  if (values === null) return "no touch";
  const known = values.filter((each) => each !== null);
  if (!known.length) return "no reading";
  if (values.length > MANY) return `${view.unit} ${view.amount(Math.min(...known))} to ${view.amount(Math.max(...known))}`;
  return `${view.unit} ${values.map((each) => (each === null ? "–" : view.amount(each))).join(" ")}`;
}
