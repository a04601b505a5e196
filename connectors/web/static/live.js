// A flow as it runs: frames come as server-sent events; when they stop, the page asks again by itself.

import { Health } from "./lists.js";
import { title, write } from "./pad.js";

const SILENCE = 4000; // ms without a message, of which there is one a second at least: the link is dead
const AGAIN = 1000; // ms between two tries
const $ = (id) => document.getElementById(id);

export function live(view) {
  const health = new Health(), announce = announcer();
  let hello = null, ended = null, paused = null, heard = performance.now(), source = null;

  const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", fractionalSecondDigits: 3, hour12: false });
  const when = (t) => clock.format(new Date(hello.start + t));
  const pause = $("pause");

  view.scene = () => paused ?? { streams: view.streams, figures: view.streams, end: view.newest };
  pause.addEventListener("click", () => {
    paused = paused ? null : still(view);
    pause.setAttribute("aria-pressed", String(paused !== null));
    write(pause, paused ? "Go on" : "Pause");
    tellLink();
    view.dirty();
  });

  function tellLink() {
    const lost = document.body.dataset.link === "lost", at = paused?.end;
    const text = ended ? "Ended" : lost ? "Not connected" : paused ? "Paused" : hello?.recording === null ? "Live" : "Replay";
    write($("link"), text);
    $("link").className = ended || paused ? "" : lost ? "bad" : "on";
    const notice = lost && !ended ? "No flow is connected. This page asks again every second and goes on by itself."
      : ended ? `The run has ended${ended.error ? `: ${ended.error}` : ""}. This page waits for the next one.`
      : paused && at !== null ? `The picture is held at ${when(at)}. Slips are still listed.` : "";
    $("notice").hidden = !notice;
    write($("notice"), notice);
  }

  function link(state) {
    if (document.body.dataset.link === state) return;
    document.body.dataset.link = state;
    if (state === "lost" && !ended) {
      $("state").dataset.slip = false;
      write($("felt"), "No flow is connected");
      $("felt").dataset.said = "";
      view.entitle("Not connected");
    }
    tellLink();
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
    $("felt").dataset.said = ""; // the title names the flow
    const replay = hello.recording === null ? "" : ` · replay of ${hello.recording}`;
    write($("session"), `Flow ${hello.flow} · session ${hello.session}${replay}`);
    link("live");
    tellLink();
    frame(hello, false);
  }

  function frame(document_, told = true) {
    view.take(document_);
    view.slipping = new Set(document_.slipping);
    view.faults = document_.faults;
    const fresh = view.events.add(document_.events);
    if (told) for (const each of fresh) announce(`${each.onset ? "slip begins" : "slip ends"}: ${title(each.finger).toLowerCase()}`);
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
      write($("lost"), `This browser was too slow for ${count} frames, which it has not been sent.`);
    });
    on("end", (each) => {
      ended = each;
      view.slipping.clear();
      health.end(each);
      view.dirty();
      tellLink();
    });
  }

  setInterval(() => {
    const dead = performance.now() - heard > SILENCE || source.readyState !== EventSource.OPEN;
    if (!dead) return;
    if (!ended || performance.now() - heard > SILENCE) link("lost");
    if (source.readyState === EventSource.CLOSED) askForToken();
    if (source.readyState === EventSource.CLOSED || performance.now() - heard > SILENCE) open();
  }, AGAIN);
  open();
}

// A server that came back with another token says so to a page that is opened anew.
async function askForToken() {
  const answer = await fetch("about.json", { cache: "no-store" }).catch(() => null);
  if (answer?.status === 401) location.reload();
}

// The picture as it is, whatever comes.
function still({ streams, newest }) {
  const copy = streams.copy();
  return { streams: copy, figures: copy, end: newest };
}

// Say something to who cannot see it: not more often than it can be heard.
function announcer(pause = 3000) {
  const waiting = [];
  let due = 0, timer = null;
  const say = () => {
    timer = null;
    due = performance.now() + pause;
    const text = waiting.length > 2 ? `${waiting.at(-1)}, ${waiting.length} events` : waiting.join(", ");
    waiting.length = 0;
    write(document.getElementById("announce"), text);
  };
  return (text) => {
    waiting.push(text);
    timer ??= setTimeout(say, Math.max(0, due - performance.now()));
  };
}
