// Export of the visible span: files from the server, a picture of the charts, and a link to the view.

import { colour, LEFT, styles } from "./charts.js";
import { BASE } from "./link.js";
import { write } from "./pad.js";

const $ = (id) => document.getElementById(id);
const TITLE = 22, EDGE = 16; // px, of the picture
const FORMATS = ["csv", "parquet", "mcap"];

// `page` has `name`, `span()`, `describe()` (text of the picture), `layout()`, `charts` and `hash()`.
export function exportButtons(page) {
  const say = (text) => write($("export-state"), text);
  const file = (kind) => `${page.name}-${page.span().map((t) => (t / 1000).toFixed(2)).join("-")}.${kind}`;
  const attempt = (action) => async () => {
    try {
      say(await action());
    } catch (error) {
      say(`Not exported: ${error.message}`);
    }
  };
  for (const format of FORMATS) {
    $(`export-${format}`).addEventListener("click", attempt(async () => {
      const [begin, end] = page.span();
      const answer = await fetch(`${BASE}export?${new URLSearchParams({ begin, end, format })}`);
      if (!answer.ok) throw new Error(await answer.text());
      return save(await answer.blob(), file(format));
    }));
  }
  $("export-png").addEventListener("click", attempt(async () => save(await picture(page), file("png"))));
  $("export-link").addEventListener("click", attempt(async () => {
    const { history, location } = window.top; // of the comparison in a pane
    history.replaceState(null, "", `${location.pathname}${location.search}#${page.hash()}`);
    try {
      await navigator.clipboard.writeText(location.href);
      return "Link copied.";
    } catch {
      return "The link is in the address bar.";
    }
  }));
}

function save(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  return `Saved ${name}.`;
}

// Draw titles, charts and bands below each other.
function picture({ charts, describe, layout }) {
  const shown = [...charts.all.map((chart) => [chart.host.closest("figure"), chart.plot.ctx.canvas]), [$("bands-figure"), $("bands")]]
    .filter(([figure]) => !figure.hidden);
  const ratio = devicePixelRatio, width = Math.max(...shown.map(([, each]) => each.width)) + 2 * EDGE * ratio;
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  canvas.width = width;
  canvas.height = shown.reduce((sum, [, each]) => sum + each.height + TITLE * ratio, (TITLE + 2 * EDGE) * ratio);
  const text = (said, x, y, ink, weight = 400) => {
    pen.fillStyle = colour(ink);
    pen.font = `${weight} ${13 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
    pen.fillText(said, x, y + 0.7 * TITLE * ratio);
    return x + pen.measureText(said).width;
  };
  pen.fillStyle = colour("--panel");
  pen.fillRect(0, 0, canvas.width, canvas.height);
  let y = EDGE * ratio;
  text(describe(), EDGE * ratio, y, "--ink", 600);
  y += TITLE * ratio;
  shown.forEach(([figure, each], place) => {
    const [title, unit] = ["b", "span"].map((part) => figure.querySelector(`figcaption ${part}`).textContent);
    const x = text(`${title}  `, EDGE * ratio, y, "--ink", 600);
    const end = text(unit, x, y, "--soft");
    if (place === 0) legend(pen, layout(), Math.max(end + 24 * ratio, LEFT * ratio), y, ratio, text);
    pen.drawImage(each, EDGE * ratio, y + TITLE * ratio);
    y += each.height + TITLE * ratio;
  });
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

// Draw the line and the number of each cell.
function legend(pen, layout, from, y, ratio, text) {
  let x = from;
  styles(layout).forEach(({ hue, dash }, cell) => {
    if (x > pen.canvas.width - 60 * ratio) return;
    pen.strokeStyle = colour(hue);
    pen.lineWidth = 1.6 * ratio;
    pen.setLineDash((dash ?? []).map((each) => each * ratio));
    pen.beginPath();
    pen.moveTo(x, y + 0.5 * TITLE * ratio);
    pen.lineTo(x + 18 * ratio, y + 0.5 * TITLE * ratio);
    pen.stroke();
    x = text(String(cell), x + 22 * ratio, y, "--soft") + 12 * ratio;
  });
}
