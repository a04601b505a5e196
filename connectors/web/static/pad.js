// Pressure map of each fingertip in the layout of the sensor; a click selects the fingertip of the curves.

import { styles } from "./charts.js";

const DENSE = 12; // cells; more have smaller tiles
const SHORT = { saturated: "max", drifting: "drift", "no reading": "none" }; // in small tiles
const READABLE = 100; // ms between updates of the numbers, to keep them readable

export class Pads {
  // `chosen(finger)` is called with the selected fingertip; `amount(value)` returns the text of a value.
  constructor(host, chosen, amount) {
    this.host = host;
    this.amount = amount;
    this.pads = new Map();
    this.written = 0;
    host.addEventListener("change", ({ target }) => chosen(target.value));
  }

  // Rebuild the maps if the fingertips or their layout changed; check the radio button of `selected`.
  update(fingers, selected, layout) {
    const known = fingers.length === this.pads.size && fingers.every((finger) => this.pads.has(finger));
    if (known && layout === this.layout) return;
    this.layout = layout;
    this.pads.clear();
    this.host.replaceChildren(...fingers.map((finger) => this.#pad(finger, finger === selected)));
    this.host.classList.toggle("many", fingers.length > 1);
  }

  // Show the value of each cell (null: invalid), faults and the slip state; `share` maps a value to the colour ramp, 0 to 1.
  show(finger, values, share, faults, state) {
    const pad = this.pads.get(finger);
    if (!pad) return;
    pad.box.classList.toggle("slips", state === "slip");
    write(pad.now, state === "unknown" ? "–" : state);
    if (!pad.due) return; // update numbers and colours together
    pad.cells.forEach((cell, k) => {
      const value = values?.[k] ?? null, silent = values !== null && value === null;
      const part = value === null ? 0 : Math.min(Math.max(share(value), 0), 1);
      cell.td.style.setProperty("--share", part.toFixed(3));
      cell.td.classList.toggle("deep", part > this.deep);
      const saturated = faults[k] === "saturated";
      cell.td.classList.toggle("saturated", saturated);
      cell.td.classList.toggle("fault", (k in faults && !saturated) || silent);
      const fault = faults[k] ?? (silent ? "no reading" : "");
      write(cell.fault, pad.dense ? SHORT[fault] ?? fault : fault);
      write(cell.count, value === null ? "–" : this.amount(value));
    });
  }

  // Return true, and allow updates, if the last numbers were shown long enough.
  tick(now) {
    const due = now - this.written >= READABLE;
    if (due) {
      this.written = now;
      this.deep = Number(getComputedStyle(document.documentElement).getPropertyValue("--deep"));
    }
    for (const pad of this.pads.values()) pad.due = due;
    return due;
  }

  #pad(finger, selected) {
    const box = element("div", "finger"), who = element("label", "who"), now = element("span", "now");
    const input = Object.assign(document.createElement("input"), { type: "radio", name: "finger", value: finger, checked: selected });
    const name = element("b");
    name.textContent = title(finger);
    who.append(input, name, now);
    const table = element("table", "pad"), cells = [];
    table.setAttribute("aria-label", `Pressure of ${title(finger).toLowerCase()}`);
    const looks = styles(this.layout);
    const dense = looks.length > DENSE;
    table.classList.toggle("dense", dense);
    for (const row of this.layout) {
      const tr = table.insertRow();
      for (const k of row) {
        const td = tr.insertCell();
        if (k < 0) {
          td.className = "empty";
          continue;
        }
        const count = element("span", "count"), fault = element("span", "fault-text");
        const barometer = element("span", "unseen"), which = element("span", "which"), key = element("span", "key");
        barometer.textContent = "barometer ";
        which.textContent = k;
        key.style.setProperty("--hue", `var(${looks[k].hue})`);
        td.append(barometer, which, count, fault, key);
        cells[k] = { td, count, fault };
      }
    }
    box.append(who, table);
    table.addEventListener("click", () => input.click());
    this.pads.set(finger, { box, now, cells, dense, due: true });
    return box;
  }
}

export const title = (finger) => (finger === "every" ? "The fingertip" : `Fingertip ${finger}`);

export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function element(tag, kind = "") {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  return made;
}
