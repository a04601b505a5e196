// Health of a run: sources, cells and sinks.

import { $, element, line, number, title, write } from "./dom.js";

// Show a report of the server.
export function showHealth({ sources, sinks, errors, lost, waiting, declared_hz: declared, recorders }) {
  $("sources").replaceChildren(...Object.entries(sources).map(([name, source]) => {
    const wanted = declared[name] === null ? "" : ` of ${number.format(declared[name])}`;
    return line(
      element("td", "", name),
      state(source.state === "up", source.state === "up" ? up(source) : source.state === "stale" ? "no data" : errors[name] ? `down: ${errors[name]}` : "down"),
      element("td", "number", source.rate_hz === null ? "–" : `${source.rate_hz.toFixed(1)}${wanted} Hz`),
      element("td", "number", source.lag_ms === null ? "–" : `${number.format(Math.round(source.lag_ms))} ms`),
      element("td", "number", number.format(lost[name])),
    );
  }));
  $("sinks").replaceChildren(...Object.entries(sinks).map(([name, sink]) => {
    const events = waiting[name] === null ? "" : ` + ${number.format(waiting[name])} events`;
    return line(
      element("td", "", name),
      state(!sink.error, sink.error ?? "works"),
      element("td", "number", number.format(sink.rows)),
      element("td", "number", `${number.format(sink.queued)}${events}`),
      element("td", "number", number.format(sink.dropped)),
    );
  }));
  const recording = recorders.map((name) => sinks[name]), chip = $("recording");
  const [rows, dropped] = ["rows", "dropped"].map((each) => recording.reduce((sum, sink) => sum + sink[each], 0));
  const error = recording.find((sink) => sink.error)?.error;
  chip.hidden = false;
  chip.className = error || dropped ? "bad" : recording.length ? "on" : "";
  write(chip, error ? `Recording is failing: ${error}` : dropped ? `Recording, ${number.format(dropped)} rows lost`
    : recording.length ? `Recording, ${number.format(rows)} rows` : "Not recording");
}

// Show the faults by fingertip and cell.
export function showCells(faults) {
  const rows = Object.entries(faults).map(([finger, kinds]) => [title(finger), Object.entries(kinds).map(([k, kind]) => `barometer ${k} ${kind}`)]);
  $("cells").replaceChildren(...(rows.length ? rows : [["All", []]]).map(([name, found]) =>
    line(element("td", "", name), state(!found.length, found.join(", ") || "good"))));
}

function up({ gaps }) {
  return gaps ? `up, ${gaps} ${gaps === 1 ? "gap" : "gaps"}` : "up";
}

function state(good, text) {
  const td = element("td", "text");
  td.append(element("span", `verdict ${good ? "good" : "bad"}`, `${good ? "●" : "■"}\u00a0${text}`));
  return td;
}
