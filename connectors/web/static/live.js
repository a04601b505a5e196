// Live page: frames arrive as server-sent events; the page reconnects by itself.

import { Health } from "./lists.js";
import { title, write } from "./pad.js";

const SILENCE = 4000; // ms without a message until the connection counts as lost; reports arrive every second
const RETRY = 1000; // ms between attempts
const $ = (id) => document.getElementById(id);

export function live(view) {
  const health = new Health(), announce = announcer();
  let hello = null, ended = null, paused = null, heard = performance.now(), source = null;

  const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", fractionalSecondDigits: 3, hour12: false });
  const when = (t) => clock.format(new Date(hello.start + t));
  const pause = $("pause");

  view.scene = () => paused ?? { streams: view.streams, figures: view.streams, end: view.newest };
  pause.addEventListener("click", () => {
    paused = paused ? null : snapshot(view);
    pause.setAttribute("aria-pressed", String(paused !== null));
    write(pause, paused ? "Resume" : "Pause");
    showLink();
    view.dirty();
  });

  function showLink() {
    const lost = document.body.dataset.link === "lost", at = paused?.end;
    const text = ended ? "Ended" : lost ? "Not connected" : paused ? "Paused" : hello?.recording === null ? "Live" : "Replay";
    write($("link"), text);
    $("link").className = ended || paused ? "" : lost ? "bad" : "on";
    const notice = lost && !ended ? "No flow is connected. The page reconnects every second."
      : ended ? `The run has ended${ended.error ? `: ${ended.error}` : ""}. The page waits for the next run.`
      : paused && at !== null ? `Paused at ${when(at)}. New slips are still listed.` : "";
    $("notice").hidden = !notice;
    write($("notice"), notice);
  }

  function link(state) {
    if (document.body.dataset.link === state) return;
    document.body.dataset.link = state;
    if (state === "lost" && !ended) {
      $("state").dataset.slip = false;
      write($("heading"), "No flow is connected");
      $("heading").dataset.shown = "";
      view.setTitle("Not connected");
    }
    showLink();
  }

  function begin(document_) {
    if (hello && document_.version !== hello.version) return location.reload();
    const same = hello?.session === document_.session;
    hello = document_;
    ended = null;
    if (!same) {
      view.clear();
      paused = null;
      pause.setAttribute("aria-pressed", "false");
      write(pause, "Pause");
    }
    view.threshold = hello.threshold;
    view.name = hello.flow;
    $("heading").dataset.shown = ""; // the title names the flow
    const replay = hello.recording === null ? "" : ` · replay of ${hello.recording}`;
    write($("session"), `Flow ${hello.flow} · session ${hello.session}${replay}`);
    link("live");
    showLink();
    frame(hello, false);
  }

  function frame(document_, announced = true) {
    view.take(document_);
    view.slipping = new Set(document_.slipping);
    view.faults = document_.faults;
    const added = view.events.add(document_.events);
    if (announced) for (const each of added) announce(`${each.onset ? "slip onset" : "slip end"}: ${title(each.finger).toLowerCase()}`);
    view.events.show(when);
    view.dirty();
  }

  function open() {
    source?.close();
    source = new EventSource("stream");
    heard = performance.now();
    const on = (name, take) => source.addEventListener(name, ({ data }) => {
      heard = performance.now();
      take(JSON.parse(data));
    });
    on("hello", begin);
    on("frame", (each) => {
      frame(each);
      const newest = view.newest, received = performance.timeOrigin + performance.now();
      if (newest !== null) document.dispatchEvent(new CustomEvent("frame", { detail: { newest: hello.start + newest, sent: hello.start + each.now, received } }));
    });
    on("report", (each) => {
      health.show(each);
      if (each.events && view.events.add(each.events).length) view.dirty();
      view.events.show(when);
    });
    on("lost", (count) => {
      $("lost").hidden = false;
      write($("lost"), `This browser was too slow: ${count} messages were dropped.`);
    });
    on("end", (each) => {
      ended = each;
      view.slipping.clear();
      health.end(each);
      view.dirty();
      showLink();
    });
  }

  setInterval(() => {
    const dead = performance.now() - heard > SILENCE || source.readyState !== EventSource.OPEN;
    if (!dead) return;
    if (!ended || performance.now() - heard > SILENCE) link("lost");
    if (source.readyState === EventSource.CLOSED) reloadIfRefused();
    if (source.readyState === EventSource.CLOSED || performance.now() - heard > SILENCE) open();
  }, RETRY);
  open();
}

// Reload the page if the server requires another token after a restart; it then asks for the token.
async function reloadIfRefused() {
  const answer = await fetch("about.json", { cache: "no-store" }).catch(() => null);
  if (answer?.status === 401) location.reload();
}

// Return a copy of the current streams.
function snapshot({ streams, newest }) {
  const copy = streams.copy();
  return { streams: copy, figures: copy, end: newest };
}

// Return a function that announces text to screen readers, at most every 3 s.
function announcer(pause = 3000) {
  const queued = [];
  let due = 0, timer = null;
  const say = () => {
    timer = null;
    due = performance.now() + pause;
    const text = queued.length > 2 ? `${queued.at(-1)}, ${queued.length} events` : queued.join(", ");
    queued.length = 0;
    write(document.getElementById("announce"), text);
  };
  return (text) => {
    queued.push(text);
    timer ??= setTimeout(say, Math.max(0, due - performance.now()));
  };
}
