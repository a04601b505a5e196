// Recorded session: a slider selects a time; the page draws the window around it, a zoom, or the whole session.

import { Bands } from "./bands.js";
import { LEFT, RIGHT } from "./charts.js";
import { exportButtons } from "./exports.js";
import { Labels } from "./labels.js";
import { Overview } from "./overview.js";
import { BASE, Link } from "./link.js";
import { title, write } from "./pad.js";
import { Readout } from "./readout.js";
import { Streams } from "./rows.js";
import { Hairline, pointer, Span } from "./span.js";
import { thresholdSlider } from "./threshold.js";

const $ = (id) => document.getElementById(id);
const STRIDES = { PageUp: 10000, PageDown: -10000 }; // ms, by key
const STEP = 100; // ms, of the arrow keys; ten times that with Shift, a tenth with Alt
const TAKES_SPACE = "button, select, textarea, a, input:not([type=range]), [tabindex]"; // these use Space

export function recorded(view, about) {
  const slider = $("instant"), play = $("play"), span = new Span(about.length);
  let loading = false, again = false, playing = null, dragged = null, events = about.events, loaded = {}, remark = about.about, hovered = null, chosen = null; // threshold; null: the first one

  document.body.dataset.link = "recorded";
  for (const id of ["scrub", "readout", "bands-figure"]) $(id).hidden = false;
  $("window").append(new Option("1 min", "60"), new Option("5 min", "300"), new Option("all", "Infinity"));
  const of = [["Flow", about.flow], ["dataset", about.dataset], ["session", about.session]].filter(([, name]) => name);
  write($("session"), of.map((each) => each.join(" ")).join(" · "));
  view.name = about.session;
  write($("link"), "Recorded");
  write($("no-events"), "None.");
  view.fingertip = about.fingertip;
  view.hasScores = about.scored;
  view.clear();
  view.deepest = about.zeroed && about.deepest < -100 ? roundUp(-about.deepest) : 100;
  slider.max = about.length;
  slider.value = Math.min(about.length, Math.max(view.window, first(events)));

  const begun = new Date(about.start);
  const clock = (t) => new Date(10 * Math.round((begun.getTime() + t) / 10)).toISOString().slice(11, 22);
  const instant = () => Number(slider.value);
  const shown = () => span.at(instant(), view.window);
  const followed = () => !span.zoomed && view.window !== Infinity; // by the window
  const bands = new Bands($("bands")), hairline = new Hairline(view.charts.all), overview = new Overview(view, about.length);
  const labels = about.labels && new Labels(about.labels, { get finger() { return view.finger; }, instant, elapsed: (t) => elapsed(t, 2), changed: () => redraw(), saved: (each) => link.sendLabels({ of: identity, ...each }) });
  const readout = new Readout($("readout"), view, bands, async (t) => (await load(t, t, t, 1)).at, (t) => `${elapsed(t, 2)} · ${clock(t)} UTC`);
  const identity = JSON.stringify([about.dataset, about.session, about.start]);
  const link = new Link(() => ({ t: instant(), zooms: span.zooms, window: $("window").value, hovered }), {
    moved(state, offset) {
      $("window").value = state.window;
      view.window = 1000 * Number(state.window);
      span.zooms = state.zooms.map((zoom) => zoom.map((t) => t + offset));
      slider.value = Math.min(Math.max(state.t + offset, 0), about.length);
      hover(state.hovered === null ? null : state.hovered + offset);
      refresh();
    },
    labelled: ({ of: other, ...each }) => { if (labels && other === identity && !labels.unsaved) labels.replace(each); },
  });
  let figures = new Streams(view.sign); // rows at the selected time; the curves are reduced to pixel columns
  view.scene = () => ({
    streams: view.streams, figures, at: Infinity, end: instant(), span: shown(), selected: dragged ?? labels?.selected,
    last: about.length, origin: followed() ? instant() : 0,
  });
  view.onchange = () => refresh();
  $("window").addEventListener("change", () => { span.zooms = []; refresh(); });

  const setThreshold = thresholdSlider(about, (threshold, found) => {
    const own = found === about.events;
    events = found;
    chosen = own ? null : threshold;
    view.threshold = threshold;
    view.events.replace(found);
    view.events.show((t) => elapsed(t), (t) => go(t + 1000));
    const slips = found.filter((event) => event.onset).length;
    write($("events-count"), slips ? `${slips.toLocaleString("en")} ${slips === 1 ? "slip" : "slips"}` : "");
    remark = own ? about.about : `Slip events: found now at threshold ${threshold}. Reset shows the original ones again.`;
    overview.draw();
    refresh();
  });

  function notice(text) {
    $("notice").hidden = !text;
    write($("notice"), text);
  }

  // Draw everything that was loaded.
  function redraw() {
    const [begin, end] = shown(), rows = {}, { finger } = view;
    const of = (name) => loaded[name]?.[finger] ?? loaded[name]?.every;
    rows.slips = view.events.spans(finger, about.length).map((each) => [...each, 1]);
    for (const name of ["arm", "truth"]) if (loaded[name]) rows[name] = of(name) ?? [];
    if (labels) rows.hand = labels.band(finger);
    bands.show(rows, { begin, end, at: instant(), selected: dragged ?? labels?.selected });
    overview.mark(begin, end);
    $("unzoom").hidden = !span.zoomed;
    view.dirty();
  }

  async function refresh() {
    const t = instant();
    write($("instant-text"), `${elapsed(t)} · ${clock(t)} UTC`);
    view.slipping = slipping(events, t);
    showTime(t);
    link.send();
    write($("axis"), followed() ? "seconds from the selected time" : "seconds since the start of the session");
    redraw();
    again = loading;
    if (loading) return;
    loading = true;
    try {
      const answer = await load(...shown(), t, view.charts.columns);
      figures = new Streams(view.sign);
      figures.take(answer.at);
      for (const name of ["faults", "quality"]) view[name] = answer.at[name];
      loaded = answer.bands;
      view.take(answer, "replace");
      showTime(instant()); // the fingertip is known now
      notice(remark);
      redraw();
      if (hovered === null) readout.show(t, figures);
    } catch {
      stop();
      notice("The server does not respond. Restart it: slipflow show SESSION");
    } finally {
      loading = false;
      if (again) refresh();
    }
  }

  function showTime(t) {
    slider.setAttribute("aria-valuetext", `${elapsed(t)}${view.slips(view.finger) ? ", slip" : ""}`);
  }

  function go(t) {
    slider.value = Math.min(Math.max(t, 0), about.length);
    span.follow(instant());
    refresh();
  }

  function stop() {
    cancelAnimationFrame(playing);
    playing = null;
    write(play, "Play");
  }

  function zoomOut() {
    span.zooms.pop();
    refresh();
  }

  // Show all values of a time; null: of the selected time.
  function hover(t) {
    hovered = t;
    hairline.show(t);
    if (t !== null) readout.at(t);
    else readout.show(instant(), figures);
  }

  const time = (x) => {
    const box = $("bands").getBoundingClientRect(), [begin, end] = shown();
    const share = (x - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return Math.round(begin + (end - begin) * Math.min(Math.max(share, 0), 1));
  };
  pointer([...view.charts.all.map((chart) => chart.host), $("bands")], new Set(labels ? [$("bands")] : []), time, {
    hover(t) {
      hover(t);
      link.send();
    },
    dragged(each) { dragged = each; redraw(); },
    click(t, marks) {
      if (playing !== null) stop();
      if (marks && labels) labels.pick(t);
      go(t);
    },
    zoom(begin, end) {
      if (playing !== null) stop();
      span.zoom(begin, end);
      if (instant() < begin || instant() > end) slider.value = (begin + end) / 2;
      refresh();
    },
    mark(begin, end) { if (labels) labels.select([begin, end]); },
    out: zoomOut,
  });

  play.addEventListener("click", () => toggle());
  $("unzoom").addEventListener("click", zoomOut);
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && span.zoomed) return zoomOut();
    if (event.key !== " " || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
    if (event.target.closest(TAKES_SPACE)) return;
    event.preventDefault(); // do not scroll
    if (!event.repeat) toggle();
  });

  function toggle() {
    if (playing !== null) return stop();
    write(play, "Stop");
    if (instant() >= about.length) go(0);
    let then = performance.now(), at = instant(); // the slider rounds to its step
    const step = (now) => {
      at += now - then;
      then = now;
      go(at);
      if (at >= about.length) stop();
      else playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  }

  slider.addEventListener("input", () => { if (playing !== null) stop(); go(instant()); });
  slider.addEventListener("keydown", (event) => {
    const arrow = { ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP }[event.key];
    const stride = arrow ? arrow * (event.shiftKey ? 10 : event.altKey ? 0.1 : 1) : STRIDES[event.key];
    if (!stride) return;
    event.preventDefault();
    if (playing !== null) stop();
    go(instant() + stride);
  });

  // The part of a link after #: what this page shows.
  function hash() {
    const state = { t: instant(), window: $("window").value, finger: view.finger };
    if (chosen !== null) state.threshold = chosen;
    if (span.zoomed) state.zoom = span.zooms.at(-1).join(" ");
    return new URLSearchParams(state);
  }

  // Show what a link names.
  function open() {
    const state = new URLSearchParams(location.hash.slice(1)), zoom = (state.get("zoom") ?? "").split(" ").map(Number);
    if (!state.has("t")) return;
    if ([...$("window").options].some((each) => each.value === state.get("window"))) $("window").value = state.get("window");
    view.window = 1000 * Number($("window").value);
    view.finger = state.get("finger");
    span.zooms = zoom.length === 2 && zoom[0] < zoom[1] ? [zoom] : [];
    slider.value = Number(state.get("t"));
    const threshold = Number(state.get("threshold"));
    if ((chosen ?? 0) !== threshold) setThreshold(threshold > 0 && threshold <= 1 ? threshold : null);
  }

  exportButtons({
    name: about.session, span: shown, charts: view.charts, layout: () => view.layout(), hash,
    describe: () => [about.session, title(view.finger).toLowerCase(), shown().map((t) => elapsed(t, 2)).join(" to "),
      ...(followed() ? [`0 s is ${elapsed(instant(), 2)}`] : [])].join(" · "),
  });
  addEventListener("hashchange", () => { open(); refresh(); });
  open();
  refresh().then(() => overview.load(load));
}

// Load the curves between two times, reduced to pixel columns, and the rows at a time.
async function load(begin, end, at, columns) {
  const answer = await fetch(`${BASE}window?${new URLSearchParams({ begin, end, at, columns })}`);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

// Return the fingertips that slip at a time.
function slipping(events, t) {
  const now = new Set();
  for (const event of events) {
    if (event.t > t) break;
    if (event.onset) now.add(event.finger);
    else now.delete(event.finger);
  }
  return now;
}

// Return the time 1 s after the first onset.
const first = (events) => (events.find((event) => event.onset)?.t ?? 0) + 1000;

// Round up to a multiple of 100 counts.
const roundUp = (value) => Math.ceil(value / 100) * 100;

// Format a time since the start of the session as m:ss.t.
function elapsed(t, digits = 1) {
  const parts = Math.round((t / 1000) * 10 ** digits), seconds = Math.floor(parts / 10 ** digits);
  const [minutes, rest] = [Math.floor(seconds / 60), String(seconds % 60).padStart(2, "0")];
  return `${minutes}:${rest}.${String(parts % 10 ** digits).padStart(digits, "0")}`;
}
