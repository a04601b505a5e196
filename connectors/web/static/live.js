// Live page: polls for messages, each request waits for new ones; the page reconnects by itself.

import { Health } from "./health.js";
import { title, write } from "./pad.js";

const SILENCE = 4000; // ms without an answer until the connection counts as lost; the server answers within 1 s
const RETRY = 1000; // ms between attempts
const BROWSER = crypto.getRandomValues(new Uint32Array(2)).join("-"); // the server waits for it at the end of a run
const $ = (id) => document.getElementById(id);

export function live(view) {
  const health = new Health(), announce = announcer();
  let hello = null, ended = null, paused = null, next = "";

  const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", fractionalSecondDigits: 3, hour12: false });
  const when = (t) => clock.format(new Date(hello.start + t));
  write($("zone"), zone(new Date()));
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
      : paused && at !== null ? `Paused at ${when(at)} ${zone(new Date(hello.start + at))}. New slips are still listed.` : "";
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
    view.fingertip = hello.fingertip;
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
    view.quality = document_.quality;
    const added = view.events.add(document_.events);
    if (announced) for (const each of added) announce(`${each.onset ? "slip onset" : "slip end"}: ${title(each.finger).toLowerCase()}`);
    view.events.show(when);
    view.dirty();
  }

  const takes = {
    hello: begin,
    frame(each) {
      frame(each);
      const newest = view.newest, received = performance.timeOrigin + performance.now();
      if (newest !== null) document.dispatchEvent(new CustomEvent("frame", { detail: { newest: hello.start + newest, sent: hello.start + each.now, received } }));
    },
    report(each) {
      health.show(each);
      health.showCells([...view.streams.touch.keys()].sort(), view.faults, view.silent());
      view.events.show(when);
    },
    end(each) {
      ended = each;
      view.slipping.clear();
      health.end(each);
      view.dirty();
      showLink();
    },
  };

  async function poll() {
    const query = new URLSearchParams({ browser: BROWSER, session: hello?.session ?? "", next });
    const answer = await fetch(`messages?${query}`, { signal: AbortSignal.timeout(SILENCE) });
    if (answer.status === 401) return location.reload(); // it requires another token after a restart
    if (!answer.ok) throw new Error(await answer.text());
    const found = await answer.json();
    next = found.next;
    for (const [name, document_] of found.messages) takes[name](document_);
    if (ended) await sleep(RETRY);
    else link("live");
  }

  (async () => {
    for (;;) {
      try {
        await poll();
      } catch {
        link("lost");
        await sleep(RETRY);
      }
    }
  })();
}

// Return the time zone of the times on the page.
function zone(date) {
  const minutes = -date.getTimezoneOffset(), pad = (each) => String(each).padStart(2, "0");
  if (!minutes) return "UTC";
  return `local, UTC${minutes < 0 ? "−" : "+"}${pad(Math.floor(Math.abs(minutes) / 60))}:${pad(Math.abs(minutes) % 60)}`;
}

const sleep = (time) => new Promise((resolve) => setTimeout(resolve, time));

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
