// Slider of the threshold: the server finds the events at another one with the debounce of the detector.

import { BASE } from "./link.js";
import { write } from "./pad.js";

const $ = (id) => document.getElementById(id);

// `changed(threshold, events)` is called with the events at a threshold, and with the first ones on a reset. Returns a
// function that sets the threshold; null: resets it.
export function thresholdSlider(about, changed) {
  const slider = $("threshold"), reset = $("threshold-reset"), say = $("threshold-text");
  let wanted = null, busy = false;

  const show = (threshold, events) => {
    const slips = events.filter((event) => event.onset).length;
    write(say, `${threshold} · ${slips.toLocaleString("en")} ${slips === 1 ? "slip" : "slips"}`);
    reset.hidden = threshold === about.threshold && events === about.events;
    changed(threshold, events);
  };

  async function load(threshold) {
    wanted = threshold;
    if (busy) return;
    busy = true;
    try {
      while (wanted !== null) {
        const next = wanted;
        wanted = null;
        const answer = await fetch(`${BASE}events?${new URLSearchParams({ threshold: next })}`);
        if (!answer.ok) throw new Error(await answer.text());
        const events = await answer.json();
        if (wanted === null) show(next, events);
      }
    } catch (error) {
      write(say, error.message);
    } finally {
      busy = false;
    }
  }

  $("tuning").hidden = !about.scored;
  slider.addEventListener("input", () => load(Number(slider.value)));
  const first = () => {
    slider.value = about.threshold;
    wanted = null;
    show(about.threshold, about.events);
  };
  reset.addEventListener("click", first);
  first();
  return (threshold) => {
    if (threshold === null || !about.scored) return first();
    slider.value = threshold;
    load(threshold);
  };
}
