// Streams of a run. `Rows` has times (ms since the start of the run) and the plotted values of each column.

const KEPT = 31000; // ms
const PAUSE = 250; // ms; a longer pause is drawn as a gap

export class Rows {
  constructor(columns) {
    this.t = [];
    this.columns = Array.from({ length: columns }, () => []);
  }

  get newest() {
    return this.t.at(-1) ?? null;
  }

  // The newest row, one value per column; null if there is none.
  get last() {
    return this.t.length ? this.columns.map((column) => column.at(-1)) : null;
  }

  // Append the rows of a frame; skip rows that are not newer.
  push({ t, v }, sign) {
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
  replace(rows, sign) {
    this.t = [];
    for (const column of this.columns) column.length = 0;
    for (let row = 0; row < rows.t.length; row++) this.#append(rows.t[row], rows.v[row], sign);
  }

  // Return [t, ...columns] between two times, plus one row on each side, so that lines reach the edges.
  between(begin, end) {
    const from = Math.max(0, lowest(this.t, begin) - 1), to = lowest(this.t, end) + 1;
    return [this.t, ...this.columns].map((values) => values.slice(from, to));
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
    for (const values of [this.t, ...this.columns]) values.splice(0, old);
  }
}

// Rows by stream (touch, scores, speed) and fingertip, such as "touch 0".
export class Streams {
  constructor() {
    this.all = new Map();
  }

  // Add rows by stream and fingertip; `put` is "push" or "replace", `sign` is that of the counts.
  take(rows, sign, put = "push") {
    for (const [key, each] of Object.entries(rows)) {
      const first = each.v[0], columns = Array.isArray(first) ? first.length : 1;
      if (!this.all.has(key) && first !== undefined) this.all.set(key, new Rows(columns));
      this.all.get(key)?.[put](each, key.startsWith("touch ") ? sign : 1);
    }
  }

  // Return the rows of a fingertip, or those of all fingertips together.
  of(stream, finger) {
    return this.all.get(`${stream} ${finger}`) ?? this.all.get(`${stream} every`);
  }

  get fingers() {
    const found = [...this.all.keys()].filter((key) => key.startsWith("touch ")).map((key) => key.slice("touch ".length));
    return found.sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
  }

  copy() {
    const copy = new Streams();
    copy.all = new Map([...this.all].map(([key, rows]) => [key, rows.copy()]));
    return copy;
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
