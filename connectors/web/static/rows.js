// Streams of a run. `Rows` has times (ms since the start of the run) and the plotted values of each column.

const KEPT = 31000; // ms
const PAUSE = 250; // ms; a longer pause is drawn as a gap

export class Rows {
  constructor(columns) {
    this.t = [];
    this.columns = Array.from({ length: columns }, () => []);
  }

  get newest() {
    return this.t.length ? this.t[this.t.length - 1] : null;
  }

  // Append the rows of a frame; skip rows that are not newer.
  push({ t, v }, sign = 1) {
    let last = this.newest ?? -Infinity;
    for (let row = 0; row < t.length; row++) {
      if (t[row] <= last) continue;
      if (t[row] - last > PAUSE && last > -Infinity) this.#append(last + 1, null, sign);
      this.#append(t[row], v[row], sign);
      last = t[row];
    }
    this.#trim(last - KEPT);
  }

  // Replace all rows by those of a recording, which include its gaps.
  replace(rows, sign = 1) {
    this.t = [];
    for (const column of this.columns) column.length = 0;
    for (let row = 0; row < rows.t.length; row++) this.#append(rows.t[row], rows.v[row], sign);
  }

  // Return [t, ...columns] between two times, plus one row on each side, so that lines reach the edges.
  between(begin, end) {
    const from = Math.max(0, lowest(this.t, begin) - 1);
    const to = lowest(this.t, end) + 1;
    return [this.t, ...this.columns].map((values) => values.slice(from, to));
  }

  // Return the newest row up to a time, one value per column, or null.
  at(time) {
    const row = lowest(this.t, time + 0.001) - 1;
    return row < 0 ? null : this.columns.map((column) => column[row]);
  }

  copy() {
    const copy = new Rows(0);
    copy.t = this.t.slice();
    copy.columns = this.columns.map((column) => column.slice());
    return copy;
  }

  #append(t, v, sign) {
    this.t.push(t);
    this.columns.forEach((column, k) => {
      const value = v === null ? null : Array.isArray(v) ? v[k] : v;
      column.push(value === null || value === 0 ? value : sign * value);
    });
  }

  #trim(before) {
    if (!this.t.length || this.t[0] > before - KEPT / 2) return; // not on each call, because it moves all rows
    const old = lowest(this.t, before);
    this.t.splice(0, old);
    for (const column of this.columns) column.splice(0, old);
  }
}

// Touch and scores by fingertip, and the speed of the arm.
export class Streams {
  constructor(sign = -1) {
    this.sign = sign; // of zeroed counts; -1: they fall with pressure
    this.touch = new Map();
    this.zeroed = new Map(); // by fingertip
    this.scores = new Map();
    this.truth = new Map(); // 1 while the simulated contact slides
    this.speed = new Rows(1);
  }

  // Add the streams of a frame; `put` is "push" or "replace".
  take({ touch, scores, truth, speed }, put = "push") {
    for (const [finger, rows] of Object.entries(touch ?? {})) {
      const before = this.touch.get(finger), cells = rows.v[0]?.length ?? before?.columns.length;
      if (!cells) continue; // no rows yet
      const changed = this.zeroed.get(finger) !== rows.zeroed || before.columns.length !== cells; // such as from raw to zeroed
      this.zeroed.set(finger, rows.zeroed);
      if (changed) this.touch.set(finger, new Rows(cells));
      this.touch.get(finger)[put](rows, rows.zeroed ? this.sign : 1);
    }
    for (const [finger, rows] of Object.entries(scores ?? {})) {
      if (!this.scores.has(finger)) this.scores.set(finger, new Rows(1));
      this.scores.get(finger)[put](rows);
    }
    for (const [finger, rows] of Object.entries(truth ?? {})) {
      if (!this.truth.has(finger)) this.truth.set(finger, new Rows(1));
      this.truth.get(finger)[put](rows);
    }
    if (speed) this.speed[put](speed);
  }

  // Return the scores of a fingertip.
  scoring(finger) {
    return this.scores.get(finger) ?? this.scores.get("every");
  }

  copy() {
    const copy = new Streams(this.sign), copied = (rows) => new Map([...rows].map(([finger, each]) => [finger, each.copy()]));
    return Object.assign(copy, { touch: copied(this.touch), zeroed: new Map(this.zeroed), scores: copied(this.scores), truth: copied(this.truth), speed: this.speed.copy() });
  }
}

// Return the first index whose value is at least `value`.
function lowest(sorted, value) {
  let low = 0, high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}
