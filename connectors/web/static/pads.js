// Pressure map of each fingertip in the layout of the sensor; a click selects the fingertip of the curves, and marks a cell.

import { styles } from "./charts.js";
import { element, title, write } from "./dom.js";

const DENSE = 12; // cells; more have smaller tiles
const BESIDE = 3; // cells of a row; wider maps lie one below the other
const STEPS = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }; // cells
const SHORT = { saturated: "max", drifting: "drift", "no reading": "none" }; // in small tiles

export class Pads {
  // `chosen(finger)` is called with the selected fingertip, `marked(cell)` with the cell under the pointer, else the one that was
  // clicked or reached by an arrow key, else null; `amount(value)` returns the text of a value.
  constructor(host, chosen, marked, amount) {
    Object.assign(this, { host, marked, amount, pads: new Map(), pinned: null, shown: null });
    host.addEventListener("change", ({ target }) => chosen(target.value));
    host.addEventListener("pointerover", ({ target }) => this.#mark(cellAt(target) ?? this.pinned));
    host.addEventListener("pointerleave", () => this.#mark(this.pinned));
    host.addEventListener("click", ({ target }) => { if (cellAt(target) !== null) this.#pin(cellAt(target)); });
    host.addEventListener("keydown", (event) => this.#key(event));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#paint());
  }

  // Rebuild the maps if the fingertips or their layout changed; check the radio button of `selected`.
  update(fingers, selected, layout) {
    const known = fingers.length === this.pads.size && fingers.every((finger) => this.pads.has(finger));
    if (known && layout === this.layout) return;
    this.layout = layout;
    this.pads.clear();
    this.host.replaceChildren(...fingers.map((finger) => this.#pad(finger, finger === selected)));
    this.host.classList.toggle("many", fingers.length > 1);
    this.host.classList.toggle("stacked", Math.max(...layout.map((row) => row.length)) > BESIDE);
    this.#paint();
    this.pinned = null;
    this.#mark(null);
  }

  // Show the state of a fingertip: slip, no slip, or neither.
  state(finger, state) {
    const pad = this.pads.get(finger);
    pad?.box.classList.toggle("slips", state === "slip");
    if (pad) write(pad.now, state === "slip" || state === "no slip" ? state : "–");
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
      write(cell.fault, pad.dense || this.pads.size > 1 ? SHORT[fault] ?? fault : fault);
      write(cell.count, value === null ? "–" : this.amount(value));
    });
  }

  #pad(finger, selected) {
    const box = element("div", "finger"), who = element("label", "who"), now = element("span", "now");
    const input = Object.assign(element("input"), { type: "radio", name: "finger", value: finger, checked: selected });
    who.append(input, element("b", "", title(finger)), now);
    const table = element("table", "pad"), cells = [], dense = this.layout.flat().length > DENSE;
    table.tabIndex = 0; // for the arrow keys
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
        td.dataset.cell = k;
        td.append(element("span", "unseen", "barometer "), element("span", "which", String(k)), count, fault, key);
        cells[k] = { td, count, fault, key };
      }
    }
    box.append(who, table);
    table.addEventListener("click", () => input.click());
    this.pads.set(finger, { box, now, cells, dense });
    return box;
  }
  // Give each cell the colour of its curve.
  #paint() {
    const looks = styles(this.layout ?? []);
    for (const { cells } of this.pads.values()) {
      cells.forEach(({ key }, k) => {
        key.style.setProperty("--curve", looks[k].stroke);
        key.classList.toggle("dotted", Boolean(looks[k].dash));
      });
    }
  }

  #mark(cell) {
    if (cell === this.shown) return;
    this.shown = cell;
    for (const { cells } of this.pads.values()) cells.forEach(({ td }, k) => td.classList.toggle("marked", k === cell));
    this.marked(cell);
  }

  // Mark a cell until the next click; a second click on it ends that.
  #pin(cell) {
    this.pinned = cell === this.pinned ? null : cell;
    this.#mark(this.pinned);
  }

  #key(event) {
    const step = STEPS[event.key], cells = this.layout.flat().filter((cell) => cell >= 0);
    if (!event.target.matches(".pad") || (!step && event.key !== "Escape")) return;
    const at = this.pinned === null ? (step > 0 ? -1 : cells.length) : cells.indexOf(this.pinned);
    this.#pin(step ? cells[Math.min(Math.max(at + step, 0), cells.length - 1)] : this.pinned);
    event.preventDefault();
  }
}

// Return the number of the cell at an element, or null.
function cellAt(target) {
  const cell = target.closest("td")?.dataset.cell;
  return cell === undefined ? null : Number(cell);
}
