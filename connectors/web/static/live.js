// Live page: requests each frame over a WebSocket when it has taken the previous one; reconnects by itself.

import { $, sleep, title, write } from "./dom.js";
import { showCells, showHealth } from "./health.js";

const SILENCE = 4000; // ms without a frame until the connection counts as lost; the server answers within 1 s
const RETRY = 1000; // ms between attempts

export function live(view) {
  let run = null, ended = null, paused = null, span = 10000; // ms
  const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", fractionalSecondDigits: 3, hour12: false });
  const when = (t) => clock.format(new Date(run.start + t)), pause = $("pause");
  write($("zone"), zone(new Date()));

  view.scene = () => {
    const streams = paused?.streams ?? view.streams, end = paused?.end ?? view.newest;
    return { streams, figures: streams, span: end === null ? null : [end - span, end], origin: end, until: Infinity };
  };
  $("window").addEventListener("change", ({ target }) => {
    span = 1000 * Number(target.value);
    view.dirty();
  });
  pause.addEventListener("click", () => hold(paused ? null : { streams: view.streams.copy(), end: view.newest }));

  function hold(what) {
    paused = what;
    pause.setAttribute("aria-pressed", String(paused !== null));
    write(pause, paused ? "Resume" : "Pause");
    showLink();
    view.dirty();
  }

  function showLink() {
    const lost = document.body.dataset.link === "lost", at = paused?.end ?? null;
    const text = view.over || (paused ? "Paused" : run?.recording === null ? "Live" : "Replay");
    write($("link"), text);
    $("link").className = ended || paused ? "" : lost ? "bad" : "on";
    const notice = ended ? `The run has ended${ended.error ? `: ${ended.error}` : ""}. The page waits for the next run.`
      : lost ? "No flow is connected. The page reconnects every second."
      : at !== null ? `Paused at ${when(at)} ${zone(new Date(run.start + at))}. New slips are still listed.` : "";
    $("notice").hidden = !notice;
    write($("notice"), notice);
  }

  function link(state) {
    document.body.dataset.link = state;
    view.over = ended ? "Ended" : state === "lost" ? "Not connected" : "";
    if (view.over) view.setTitle(view.over);
    showLink();
    view.dirty();
  }

  function begin(next) {
    if (run && next.version !== run.version) return location.reload();
    if (run?.session !== next.session) {
      view.clear();
      hold(null);
    }
    run = next;
    ended = null;
    view.fingertip = run.fingertip;
    view.zeroed = run.zeroed;
    view.threshold = run.threshold;
    view.name = run.flow;
    const replay = run.recording === null ? "" : ` · replay of ${run.recording}`;
    write($("session"), `Flow ${run.flow} · session ${run.session}${replay}`);
  }

  function take(frame) {
    if (frame.run) begin(frame.run);
    for (const name of ["faults", "quality"]) view[name] = frame[name];
    view.slipping = new Set(frame.slipping);
    view.take(frame.rows);
    const added = view.events.add(frame.events).at(-1);
    if (added && !frame.run) write($("announce"), `slip ${added.onset ? "onset" : "end"}: ${title(added.finger).toLowerCase()}`);
    view.events.show(when);
    if (frame.report) {
      showHealth(frame.report, run.start + frame.now);
      showCells(view.faults);
    }
    if (frame.end) {
      ended = frame.end;
      view.slipping.clear();
      $("recording").hidden = true;
    }
    link("live");
    const newest = view.newest, received = performance.timeOrigin + performance.now();
    if (newest !== null) document.dispatchEvent(new CustomEvent("frame", { detail: { newest: run.start + newest, received } }));
  }

  // Follow a run until the connection ends.
  function follow() {
    const socket = new WebSocket(new URL("live", location.href.replace(/^http/, "ws")));
    return new Promise((resolve) => {
      let silence = setTimeout(() => socket.close(), SILENCE);
      socket.onopen = () => socket.send("");
      socket.onmessage = ({ data }) => {
        clearTimeout(silence);
        silence = setTimeout(() => socket.close(), SILENCE);
        take(JSON.parse(data));
        socket.send("");
      };
      socket.onclose = () => {
        clearTimeout(silence);
        resolve();
      };
    });
  }

  (async () => {
    for (;;) {
      await follow();
      link("lost");
      await sleep(RETRY);
      const answer = await fetch("about.json").catch(() => null);
      if (answer?.status === 403) location.reload(); // it requires another token after a restart
    }
  })();
}

// Return the time zone of the times on the page.
function zone(date) {
  const minutes = -date.getTimezoneOffset(), pad = (each) => String(each).padStart(2, "0");
  if (!minutes) return "UTC";
  return `local, UTC${minutes < 0 ? "−" : "+"}${pad(Math.floor(Math.abs(minutes) / 60))}:${pad(Math.abs(minutes) % 60)}`;
}
