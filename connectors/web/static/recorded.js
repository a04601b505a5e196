// Recorded session: the curves of a span and the values of a selected time.

import { Bands } from "./bands.js";
import { LEFT, RIGHT } from "./charts.js";
import { $, number, write } from "./dom.js";
import { Labels } from "./labels.js";
import { Streams } from "./rows.js";

const STEP = 100; // ms, of the arrow keys; ten times that with Shift, a tenth with Alt
const STRIDES = { PageUp: 10000, PageDown: -10000, ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP }; // ms
const DATED = 1e11; // ms since 1970 UTC; earlier times count from the start of an imported file
const CLICK = 4; // px, a shorter drag is a click
const LEAST = 50; // ms, shortest zoom
const MANY = 16; // cells; of more the readout has minimum and maximum
const NAMES = { "1": "slip", "0": "static", "-1": "unknown" }; // by code of a label

export function recorded(view, about) {
  const slider = $("instant"), whole = [0, Math.max(about.length, LEAST)], begun = new Date(about.start);
  const { detector } = about, found = detector === null ? "none" : `found by ${detector} now`;
  const origin = `Slip probability: ${detector === null ? "none, as there is no detector" : `computed now by detector ${detector}`}. `
    + `Slip events: ${about.recorded ? "recorded" : `${found}, as none were recorded`}.`;
  let span = whole, events = about.events, remark = origin, dragged = null;
  let figures = new Streams(); // rows at the selected time; the curves are reduced to pixel columns
  const dated = about.start >= DATED, clock = (t) => new Date(10 * Math.round((begun.getTime() + t) / 10)).toISOString().slice(11, 22);
  const when = (t) => `${elapsed(t)}${dated ? ` · ${clock(t)} UTC` : ""}`;
  const instant = () => Number(slider.value);
  const bands = new Bands($("bands"));
  const labels = new Labels(about.labels, { get finger() { return view.finger; }, instant, elapsed, changed: redraw });

  document.body.dataset.link = "recorded";
  for (const id of ["scrub", "readout", "bands-figure", "labels"]) $(id).hidden = false;
  write($("session"), `Session ${about.session}`);
  write($("link"), "Recorded");
  write($("axis"), "seconds since the start of the session");
  write($("no-events"), "None.");
  Object.assign(view, { name: about.session, fingertip: about.fingertip, hasScores: detector !== null, onchange: refresh });
  slider.max = about.length;
  slider.value = Math.min(about.length, (events.find((event) => event.onset)?.t ?? 0) + 1000);
  view.scene = () => ({ streams: view.streams, figures, span, until: instant(), origin: 0, at: instant(), selected: dragged ?? labels.selected });
  setThreshold(about.threshold, events);

  // Draw everything that was loaded.
  function redraw() {
    const rows = { slips: view.events.spans(view.finger, about.length).map((each) => [...each, 1]) };
    rows.label = about.bands[`label ${view.finger}`] ?? about.bands["label every"];
    rows.hand = labels.band(view.finger);
    bands.show(rows, { begin: span[0], end: span[1], at: instant(), selected: dragged ?? labels.selected });
    $("unzoom").hidden = span === whole;
    view.dirty();
  }

  async function load() {
    const t = instant();
    write($("instant-text"), when(t));
    view.slipping = slipping(events, t);
    redraw();
    try {
      const { rows, at } = await get("window", { begin: span[0], end: span[1], at: t, columns: view.charts.columns });
      figures = new Streams();
      figures.take(at, view.sign);
      view.take(rows, "replace"); // reduced curves keep the extremes
      for (const finger of view.streams.fingers) view.deepen(view.streams.of("touch", finger).columns.flat());
      slider.setAttribute("aria-valuetext", `${elapsed(t)}${view.slips(view.finger) ? ", slip" : ""}`);
      notice(remark);
      redraw();
      write($("readout"), [when(t), ...values(t)].join(" · "));
    } catch {
      notice("The server does not respond. Restart it: slipflow show SESSION");
    }
  }
  const reload = newest(load);
  function refresh() { return reload(null); }

  // Return the values at the selected time as text.
  function values(t) {
    const touch = figures.of("touch", view.finger)?.last?.filter((each) => each !== null) ?? [];
    const amounts = touch.length > MANY ? [`${view.amount(Math.min(...touch))} to ${view.amount(Math.max(...touch))}`] : touch.map((each) => view.amount(each));
    const found = [touch.length ? `${view.unit} ${amounts.join(" ")}` : "no reading"];
    const value = (stream) => figures.of(stream, view.finger)?.last?.[0] ?? null;
    if (value("scores") !== null) found.push(`probability ${value("scores").toFixed(3)}`);
    if (value("speed") !== null) found.push(`TCP ${value("speed").toFixed(1)} mm/s`);
    for (const [name, text] of [["label", "label"], ["hand", "by hand"]]) {
      if (bands.at(name, t) !== null) found.push(`${text} ${NAMES[bands.at(name, t)]}`);
    }
    return found;
  }

  // Select a time; a zoom moves with it.
  function go(t) {
    slider.value = Math.min(Math.max(t, 0), about.length);
    const [begin, end] = span, outside = Math.min(instant() - begin, 0) || Math.max(instant() - end, 0);
    if (outside) span = [begin + outside, end + outside];
    refresh();
  }

  function zoom(begin, end) {
    const missing = Math.max(0, LEAST - (end - begin)) / 2;
    span = [begin - missing, end + missing];
    if (instant() < begin || instant() > end) slider.value = (begin + end) / 2;
    refresh();
  }

  function zoomOut() {
    span = whole;
    refresh();
  }

  // Handle the pointer: a click selects a time; a drag zooms, but marks over the bands or with Shift.
  for (const host of [...view.charts.all.map((chart) => chart.host), $("bands")]) {
    let from = null, x = 0, marks = false;
    const time = ({ clientX }) => {
      const box = $("bands").getBoundingClientRect(), share = (clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
      return Math.round(span[0] + (span[1] - span[0]) * Math.min(Math.max(share, 0), 1));
    };
    const sorted = (event) => [Math.min(from, time(event)), Math.max(from, time(event))];
    const dragging = (event) => Math.abs(event.clientX - x) >= CLICK;
    const end = () => { from = dragged = null; redraw(); };
    host.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !event.isPrimary) return;
      host.setPointerCapture(event.pointerId);
      [from, x, marks] = [time(event), event.clientX, host === $("bands") || event.shiftKey];
      event.preventDefault(); // do not select text
      document.activeElement.blur(); // keys are for the page again
    });
    host.addEventListener("pointermove", (event) => {
      if (from === null || !dragging(event)) return;
      dragged = sorted(event);
      redraw();
    });
    host.addEventListener("pointerup", (event) => {
      if (from === null) return;
      const found = sorted(event);
      end();
      if (dragging(event)) (marks ? (...each) => labels.select(each) : zoom)(...found);
      else {
        if (marks) labels.pick(time(event));
        go(time(event));
      }
    });
    host.addEventListener("pointercancel", end);
    host.addEventListener("dblclick", zoomOut);
  }
  $("unzoom").addEventListener("click", zoomOut);
  document.addEventListener("keydown", ({ key }) => { if (key === "Escape") zoomOut(); });
  slider.addEventListener("input", () => go(instant()));
  slider.addEventListener("keydown", (event) => {
    const stride = STRIDES[event.key];
    if (!stride) return;
    event.preventDefault();
    go(instant() + stride * (event.shiftKey ? 10 : event.altKey ? 0.1 : 1));
  });

  // Show the events at a threshold.
  function setThreshold(threshold, found) {
    const slips = found.filter((event) => event.onset).length, text = `${number.format(slips)} ${slips === 1 ? "slip" : "slips"}`;
    const own = found === about.events;
    events = found;
    view.threshold = threshold;
    view.events.clear();
    view.events.add(found, Infinity);
    view.events.show((t) => elapsed(t, 1), (t) => go(t + 1000));
    $("threshold").value = threshold;
    write($("threshold-text"), String(threshold));
    write($("events-count"), text);
    $("threshold-reset").hidden = own;
    remark = own ? origin : `Slip events: found now at threshold ${threshold}. Reset shows the original ones again.`;
  }

  $("tuning").hidden = detector === null;
  const tune = newest(async (threshold) => {
    const found = threshold === null ? about.events : await get("events", { threshold });
    setThreshold(threshold ?? about.threshold, found);
    refresh();
  });
  $("threshold").addEventListener("input", ({ target }) => tune(Number(target.value)));
  $("threshold-reset").addEventListener("click", () => tune(null));
  new ResizeObserver(refresh).observe(view.charts.counts.host);
}

function notice(text) {
  $("notice").hidden = !text;
  write($("notice"), text);
}

async function get(path, query) {
  const answer = await fetch(`${path}?${new URLSearchParams(query)}`);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

// Return a function that calls `action` once at a time: while it works, only the newest call waits.
function newest(action) {
  let waiting = null, busy = false;
  return async (...given) => {
    waiting = given;
    if (busy) return;
    busy = true;
    while (waiting) {
      const next = waiting;
      waiting = null;
      await action(...next).catch((error) => notice(error.message));
    }
    busy = false;
  };
}

// Return the fingertips that slip at a time.
function slipping(events, t) {
  const now = new Set();
  for (const event of events.filter((each) => each.t <= t)) (event.onset ? now.add(event.finger) : now.delete(event.finger));
  return now;
}

// Format a time since the start of the session as m:ss.tt.
function elapsed(t, digits = 2) {
  const parts = Math.round((t / 1000) * 10 ** digits), seconds = Math.floor(parts / 10 ** digits);
  const rest = String(seconds % 60).padStart(2, "0");
  return `${Math.floor(seconds / 60)}:${rest}.${String(parts % 10 ** digits).padStart(digits, "0")}`;
}
