// Shown time span of a recorded session: zoom by dragging, and the hairline that follows the pointer in all charts.

import { element } from "./pad.js";

const AFTER = 0.25; // share of the window that is after the selected time
const CLICK = 4; // px, a shorter drag is a click
const LEAST = 50; // ms, shortest zoom

// The span follows the selected time until it is zoomed. Each zoom is kept, so that zooming out goes back.
export class Span {
  constructor(length) {
    this.length = length; // ms, of the session
    this.zooms = [];
  }

  get zoomed() {
    return this.zooms.length > 0;
  }

  // Return [begin, end] within the session for a selected time and a window (ms, Infinity: all of it).
  at(instant, window) {
    if (this.zoomed) return this.zooms.at(-1);
    const end = Math.min(Math.max(instant + AFTER * window, window), this.length);
    return [Math.max(end - window, 0), end];
  }

  zoom(begin, end) {
    const missing = Math.max(0, LEAST - (end - begin)) / 2;
    this.zooms.push([begin - missing, end + missing]);
  }

  // Move a zoom so that it contains a time.
  follow(t) {
    if (!this.zoomed) return;
    const [begin, end] = this.zooms.at(-1), size = end - begin;
    if (t < begin || t > end) this.zooms[this.zooms.length - 1] = [t - (1 - AFTER) * size, t + AFTER * size];
  }
}

// Handle the pointer in the charts and the bands. `on` has `hover(t or null)`, `zoom(begin, end)`, `click(t)`, `mark(begin,
// end)` for bands or with Shift, and `dragged([begin, end] or null)` while dragging. `time(x)` converts a client x (px).
export function pointer(hosts, marking, time, on) {
  for (const host of hosts) {
    let from = null, x = 0, marks = false;
    const both = (t) => [Math.min(from, t), Math.max(from, t)];
    const end = () => { from = null; on.dragged(null); };
    host.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !event.isPrimary) return;
      host.setPointerCapture(event.pointerId);
      from = time(event.clientX);
      x = event.clientX;
      marks = marking.has(host) || event.shiftKey;
      event.preventDefault(); // do not select text
      document.activeElement.blur(); // keys are for the page again
    });
    host.addEventListener("pointermove", (event) => {
      const t = time(event.clientX);
      on.hover(t);
      if (from !== null && Math.abs(event.clientX - x) >= CLICK) on.dragged(both(t));
    });
    host.addEventListener("pointerup", (event) => {
      if (from === null) return;
      const t = time(event.clientX), span = both(t);
      end();
      if (Math.abs(event.clientX - x) < CLICK) on.click(t, marks);
      else (marks ? on.mark : on.zoom)(...span);
    });
    host.addEventListener("pointercancel", end);
    host.addEventListener("pointerleave", () => on.hover(null));
    host.addEventListener("dblclick", () => on.out());
  }
}

// A vertical line in each chart.
export class Hairline {
  constructor(charts) {
    this.lines = charts.map((chart) => {
      const line = element("i", "hair");
      line.hidden = true;
      chart.host.append(line);
      return { chart, line };
    });
  }

  // Show the line at a time, or hide it (null).
  show(t) {
    for (const { chart, line } of this.lines) {
      line.hidden = t === null || t < chart.view.begin || t > chart.view.end;
      if (!line.hidden) line.style.left = `${chart.place(t)}px`;
    }
  }
}
