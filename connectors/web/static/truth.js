// True sliding of the simulated contact: a band at the bottom of the slip probability.

import { colour } from "./charts.js";

const STICK = 150; // ms; a shorter pause is part of a slip
const TALL = 9; // px

// Return the spans [from, to] of `rows` between two times.
function spans(rows, begin, end) {
  const [times, values] = rows.between(begin - STICK, end), found = [];
  times.forEach((t, row) => {
    if (!values[row]) return;
    const last = found.at(-1);
    if (last && t - last[1] <= STICK) last[1] = t;
    else found.push([t, t]);
  });
  return found;
}

// Draw the band of true sliding, if there are `rows`.
export function drawTruth({ ctx, bbox, valToPos }, rows, { begin, end }) {
  if (!rows?.t.length) return;
  const ratio = devicePixelRatio, top = bbox.top + bbox.height - TALL * ratio;
  ctx.save();
  ctx.fillStyle = colour("--truth");
  for (const [from, to] of spans(rows, begin, end)) {
    const left = valToPos(Math.max(from, begin), "x", true), right = valToPos(Math.min(to, end), "x", true);
    if (right >= left) ctx.fillRect(left, top, Math.max(right - left, ratio), TALL * ratio);
  }
  ctx.restore();
}
