// Health of a run: sources, cells and sinks, each judged by a word and a colour.

import { cell, judged, line, mark, number } from "./lists.js";
import { title, write } from "./pad.js";

const $ = (id) => document.getElementById(id);
const BROKEN = new Set(["dead", "stuck", "no reading"]); // faults of a cell that are bad; others are warnings

export class Health {
  constructor() {
    this.report = null;
    this.cells = {}; // by fingertip: its faults, by cell
  }

  // Show a report of the server.
  show(report) {
    this.report = report;
    const { sources, errors, verdicts, declared_hz: declared, lost } = report;
    write($("limits"), verdicts.limits);
    $("sources").replaceChildren(
      ...Object.entries(sources).map(([name, source]) => {
        const found = verdicts.sources[name], wanted = declared[name];
        const rate = source.rate_hz === null ? "–" : `${source.rate_hz.toFixed(1)}${wanted === null ? "" : ` of ${number.format(wanted)}`} Hz`;
        return line(
          cell(name),
          judged("", state(source, errors[name])),
          judged(rate, found.rate),
          judged(source.lag_ms === null || wanted === null ? "–" : `${number.format(Math.round(source.lag_ms))} ms`, found.latency),
          judged(number.format(lost[name]), found.lost),
        );
      }),
    );
    this.#showSinks(report);
    this.#record(report);
    this.#sum();
  }

  // Show the cells of the fingertips: `faults` by fingertip and cell; `silent` are the cells without reading.
  showCells(fingers, faults, silent) {
    const rows = fingers.map((finger) => {
      const found = { ...Object.fromEntries((silent.get(finger) ?? []).map((k) => [k, "no reading"])), ...faults[finger] };
      return [finger, found];
    });
    this.cells = Object.fromEntries(rows);
    $("cells").replaceChildren(
      ...rows.map(([finger, found]) => {
        const names = Object.entries(found).map(([k, kind]) => `barometer ${k} ${kind}`);
        return line(cell(title(finger)), judged("", names.length ? [names.join(", "), cellLevel(found)] : ["good", "good"]));
      }),
    );
    this.#sum();
  }

  // Show the final counts at the end of the run.
  end(report) {
    this.#showSinks(report);
    this.#record(report, true);
  }

  #showSinks({ sinks, waiting, verdicts }) {
    $("sinks").replaceChildren(
      ...Object.entries(sinks).map(([name, sink]) => {
        const found = verdicts.sinks[name], events = waiting[name] ?? null;
        const queued = number.format(sink.queued), queue = events === null ? queued : `${queued} + ${number.format(events)} events`;
        return line(
          cell(name),
          judged("", sink.error ? [sink.error, "bad"] : ["works", "good"]),
          cell(number.format(sink.rows), "number"),
          judged(queue, found.queue),
          judged(number.format(sink.dropped), found.dropped),
        );
      }),
    );
  }

  // Show the sum of all verdicts next to the heading.
  #sum() {
    if (!this.report) return;
    const { sources, sinks, errors, verdicts } = this.report;
    const levels = [...Object.values(verdicts.sources), ...Object.values(verdicts.sinks)]
      .flatMap((each) => Object.values(each).map(([, level]) => level));
    levels.push(...Object.entries(sources).map(([name, each]) => state(each, errors[name])[1]));
    levels.push(...Object.values(sinks).map((each) => (each.error ? "bad" : "good")));
    levels.push(...Object.values(this.cells).map(cellLevel));
    const bad = levels.filter((level) => level === "bad").length, warned = levels.filter((level) => level === "warning").length;
    const parts = [bad ? `${bad} bad` : "", warned ? `${warned} to watch` : ""].filter(Boolean);
    mark($("verdict"), parts.join(", ") || "good", bad ? "bad" : warned ? "warning" : "good");
  }

  #record({ recorders: names, sinks }, ended = false) {
    const recorders = names.map((name) => sinks[name]).filter(Boolean), chip = $("recording");
    const rows = recorders.reduce((sum, sink) => sum + sink.rows, 0);
    const dropped = recorders.reduce((sum, sink) => sum + sink.dropped, 0);
    const failed = recorders.find((sink) => sink.error);
    chip.hidden = false;
    chip.className = failed || dropped ? "bad" : recorders.length && !ended ? "on" : "";
    const verb = ended ? "Recorded" : "Recording";
    const text = failed ? `${ended ? "Recording failed" : "Recording is failing"}: ${failed.error}` : dropped
      ? `${verb}, ${number.format(dropped)} rows lost`
      : recorders.length ? `${verb}, ${number.format(rows)} rows` : ended ? "Not recorded" : "Not recording";
    write(chip, text);
  }
}

function cellLevel(faults) {
  const kinds = Object.values(faults);
  return kinds.some((kind) => BROKEN.has(kind)) ? "bad" : kinds.length ? "warning" : "good";
}

// Return the verdict on the state of a source.
function state({ state: found, gaps }, error) {
  if (found === "up") return gaps ? [`up, ${gaps} ${gaps === 1 ? "gap" : "gaps"}`, "warning"] : ["up", "good"];
  return [found === "stale" ? "no data" : error ? `down: ${error}` : "down", "bad"];
}
