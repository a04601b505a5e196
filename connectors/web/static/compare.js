// Two detectors or two recordings side by side: each is a page of its own in a frame.

import { element, write } from "./pad.js";

const $ = (id) => document.getElementById(id);

// `names` are the titles of the panes.
export function compare(names) {
  const name = `slipflow-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`, channel = new BroadcastChannel(name);
  document.body.dataset.link = "recorded";
  document.title = `${names.join(" and ")} · slipflow`;
  write($("session"), names.join(" and "));
  write($("link"), "Comparison");
  const label = element("label"), box = Object.assign(element("input"), { type: "checkbox", checked: true });
  box.addEventListener("change", () => channel.postMessage({ linked: box.checked }));
  label.append(box, " Link times");
  document.querySelector(".controls").replaceChildren(label);
  const main = element("main", "panes");
  main.append(...names.map((title, pane) => Object.assign(element("iframe"), { title, src: `./?${new URLSearchParams({ pane, link: name })}${location.hash}` })));
  document.querySelector("main").replaceWith(main);
}
