// Health of a run: sources, cells and sinks.

import { $, element, line, number, title, write } from "./dom.js";

let before = { now: 0, sources: {} }; // the previous report

// Show the state of sources and sinks at a time, ms since 1970; rates are those since the previous report.
export function showHealth({ sources, sinks }, now) {
  $("sources").replaceChildren(...Object.entries(sources).map(([name, source]) => {
    const wanted = source.declared_rate === null ? "" : ` of ${number.format(source.declared_rate)}`;
    const rows = before.sources[name]?.rows, rate = rows && rows <= source.rows ? (1000 * (source.rows - rows)) / (now - before.now) : null;
    return line(
      element("td", "", name),
      state(source.up, source.up ? up(source) : source.stale ? "no data" : source.error ? `down: ${source.error}` : "down"),
      element("td", "number", rate === null ? "–" : `${rate.toFixed(1)}${wanted} Hz`),
      element("td", "number", source.newest ? `${number.format(Math.round(now - source.newest))} ms` : "–"),
      element("td", "number", number.format(source.lost)),
    );
  }));
  before = { now, sources };
  $("sinks").replaceChildren(...Object.entries(sinks).map(([name, sink]) => {
    const events = sink.waiting === null ? "" : ` + ${number.format(sink.waiting)} events`;
    return line(
      element("td", "", name),
      state(!sink.error, sink.error || "works"),
      element("td", "number", number.format(sink.rows)),
      element("td", "number", `${number.format(sink.queued)}${events}`),
      element("td", "number", number.format(sink.dropped)),
    );
  }));
  const recording = Object.values(sinks).filter((sink) => sink.records), chip = $("recording");
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
