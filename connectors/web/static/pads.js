// Pressure map of each fingertip in the layout of the sensor; a click selects the fingertip of the curves.

import { styles } from "./charts.js";
import { element, title, write } from "./dom.js";

const DENSE = 12; // cells; more have smaller tiles
const SHORT = { saturated: "max", drifting: "drift", "no reading": "none" }; // in small tiles

export class Pads {
  // `chosen(finger)` is called with the selected fingertip; `amount(value)` returns the text of a value.
  constructor(host, chosen, amount) {
    Object.assign(this, { host, amount, pads: new Map() });
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

  // Show the state of a fingertip: slip, no slip, or unknown.
  state(finger, state) {
    const pad = this.pads.get(finger);
    pad?.box.classList.toggle("slips", state === "slip");
    if (pad) write(pad.now, state === "unknown" ? "–" : state);
  }

  // Show the value of each cell (null: invalid) and its faults; `share` maps a value to the colour ramp, 0 to 1.
  show(finger, values, share, faults) {
    const pad = this.pads.get(finger), deep = Number(getComputedStyle(document.documentElement).getPropertyValue("--deep"));
    pad?.cells.forEach((cell, k) => {
      const value = values?.[k] ?? null, silent = values !== null && value === null;
      const part = value === null ? 0 : Math.min(Math.max(share(value), 0), 1), saturated = faults[k] === "saturated";
      cell.td.style.setProperty("--share", part.toFixed(3));
      cell.td.classList.toggle("deep", part > deep);
      cell.td.classList.toggle("saturated", saturated);
      cell.td.classList.toggle("fault", (k in faults && !saturated) || silent);
      const fault = faults[k] ?? (silent ? "no reading" : "");
      write(cell.fault, pad.dense ? SHORT[fault] ?? fault : fault);
      write(cell.count, value === null ? "–" : this.amount(value));
    });
  }

  #pad(finger, selected) {
    const box = element("div", "finger"), who = element("label", "who"), now = element("span", "now");
    const input = Object.assign(element("input"), { type: "radio", name: "finger", value: finger, checked: selected });
    who.append(input, element("b", "", title(finger)), now);
    const table = element("table", "pad"), cells = [], looks = styles(this.layout), dense = looks.length > DENSE;
    table.setAttribute("aria-label", `Pressure of ${title(finger).toLowerCase()}`);
    table.classList.toggle("dense", dense);
    for (const row of this.layout) {
      const tr = table.insertRow();
      for (const k of row) {
        const td = tr.insertCell();
        if (k < 0) {
          td.className = "empty";
          continue;
        }
        const count = element("span", "count"), fault = element("span", "fault-text"), key = element("span", "key");
        key.style.setProperty("--hue", `var(${looks[k].hue})`);
        td.append(element("span", "unseen", "barometer "), element("span", "which", String(k)), count, fault, key);
        cells[k] = { td, count, fault };
      }
    }
    box.append(who, table);
    table.addEventListener("click", () => input.click());
    this.pads.set(finger, { box, now, cells, dense });
    return box;
  }
}
