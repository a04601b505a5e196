// Recorded session: a slider selects a time; the page draws the window before it, or the whole session.

import { write } from "./pad.js";
import { Streams } from "./rows.js";

const $ = (id) => document.getElementById(id);
const STRIDES = { PageUp: 10000, PageDown: -10000 }; // ms, by key
const STEP = 100; // ms, of the arrow keys; ten times that with Shift
const TAKES_SPACE = "button, select, textarea, a, input:not([type=range]), [tabindex]"; // these use Space

export function recorded(view, about) {
  const slider = $("instant"), play = $("play"), canvas = $("overview");
  let loading = false, again = false, playing = null;

  document.body.dataset.link = "recorded";
  $("scrub").hidden = false;
  $("window").append(new Option("1 min", "60"), new Option("5 min", "300"), new Option("all", "Infinity"));
  const of = [["Flow", about.flow], ["dataset", about.dataset], ["session", about.session]].filter(([, name]) => name);
  write($("session"), of.map((each) => each.join(" ")).join(" · "));
  view.name = about.session;
  write($("link"), "Recorded");
  write($("no-events"), "None.");
  $("notice").hidden = !about.about;
  write($("notice"), about.about);
  view.threshold = about.threshold;
  view.fingertip = about.fingertip;
  view.clear();
  view.deepest = about.zeroed && about.deepest < -100 ? roundUp(-about.deepest) : 100;
  view.events.add(about.events, Infinity);
  const slips = about.events.filter((event) => event.onset).length;
  write($("events-count"), slips ? `${slips.toLocaleString("en")} ${slips === 1 ? "slip" : "slips"}` : "");
  slider.max = about.length;
  slider.value = Math.min(about.length, Math.max(view.window, first(about.events)));

  const begun = new Date(about.start);
  const clock = (t) => new Date(begun.getTime() + t).toISOString().slice(11, 22);
  const instant = () => Number(slider.value);
  let figures = new Streams(view.sign); // rows at the selected time; the curves are reduced to pixel columns
  view.scene = () => ({ streams: view.streams, figures, at: Infinity, end: instant(), span: span(), whole: view.window === Infinity });
  // Return the time span of the curves: the window before the selected time, or the whole session.
  const span = () => (view.window === Infinity ? [0, about.length] : [instant() - view.window, instant()]);
  view.onchange = () => refresh();
  view.events.show((t) => elapsed(t), (t) => go(t + 1000));

  async function refresh() {
    const t = instant();
    write($("instant-text"), `${elapsed(t)} · ${clock(t)} UTC`);
    view.slipping = slipping(about.events, t);
    showTime(t);
    write($("axis"), view.window === Infinity ? "seconds since the start of the session" : "seconds before the selected time");
    view.dirty();
    again = loading;
    if (loading) return;
    loading = true;
    try {
      const answer = await load(...span(), t, view.charts.columns);
      figures = new Streams(view.sign);
      figures.take(answer.at);
      view.take(answer, "replace");
      showTime(instant()); // the fingertip is known now
      $("notice").hidden = !about.about;
      write($("notice"), about.about);
      view.dirty();
    } catch {
      stop();
      $("notice").hidden = false;
      write($("notice"), "The server does not respond. Restart it: slipflow show SESSION");
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
    refresh();
  }

  function stop() {
    cancelAnimationFrame(playing);
    playing = null;
    write(play, "Play");
  }

  play.addEventListener("click", () => toggle());
  document.addEventListener("keydown", (event) => {
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

  slider.addEventListener("input", () => { if (playing !== null) stop(); refresh(); });
  slider.addEventListener("keydown", (event) => {
    const arrow = { ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP }[event.key];
    const stride = arrow ? arrow * (event.shiftKey ? 10 : 1) : STRIDES[event.key];
    if (!stride) return;
    event.preventDefault();
    if (playing !== null) stop();
    go(instant() + stride);
  });

  // Draw the overview of the whole session above the slider: pressure and slips.
  async function draw() {
    const style = getComputedStyle(document.documentElement), ratio = devicePixelRatio;
    const width = canvas.clientWidth, height = canvas.clientHeight, edge = 8; // px, half the thumb of the slider
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d"), x = (t) => edge + ((width - 2 * edge) * t) / about.length;
    pen.scale(ratio, ratio);
    pen.fillStyle = style.getPropertyValue("--middle");
    pen.globalAlpha = 0.55;
    const touch = whole.touch[view.finger ?? Object.keys(whole.touch)[0]];
    touch?.t.forEach((t, row) => {
      const value = Math.max(0, ...touch.v[row].map((each) => view.pressure(each, touch.zeroed)));
      const tall = Math.min(height - 8, ((height - 8) * value) / (touch.zeroed ? view.deepest : view.most));
      pen.fillRect(x(t), height - tall, 1, tall);
    });
    pen.globalAlpha = 1;
    pen.fillStyle = style.getPropertyValue("--slip");
    for (const [from, to] of view.events.spans(view.finger, about.length)) pen.fillRect(x(from), 0, Math.max(1.5, x(to) - x(from)), 5);
  }

  let whole = { touch: {} };
  refresh().then(async () => {
    whole = await load(0, about.length, 0, Math.max(1, canvas.clientWidth));
    new ResizeObserver(draw).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    $("fingers").addEventListener("change", draw);
  });
}

// Load the curves between two times, reduced to pixel columns, and the rows at a time.
async function load(begin, end, at, columns) {
  const answer = await fetch(`window?${new URLSearchParams({ begin, end, at, columns })}`);
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
function elapsed(t) {
  const tenths = Math.round(t / 100);
  return `${Math.floor(tenths / 600)}:${String(Math.floor(tenths / 10) % 60).padStart(2, "0")}.${tenths % 10}`;
}
