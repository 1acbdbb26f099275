// One run: its inputs, how it ended, its log.

import { duration, element, figure, listen, newest, shared, tell } from "./shared.js";

const field = () => document.getElementById("run-row");
let read = null; // returns what is known of the run in a row

const fetchRun = newest(async (row) => {
  try {
    shared.run = await read(row);
  } catch (error) {
    document.getElementById("run-text").replaceChildren(element("p", error.message, { class: "note" }));
    return;
  }
  field().value = row + 1;
  show();
  tell("run");
});

function show() {
  const { run } = shared;
  const parts = [];
  const inputs = Object.entries(run.inputs).map(([name, value]) => `${name} = ${figure(value, 6)}`);
  parts.push(element("p", inputs.join(", ")));
  if (run.observes) parts.push(element("p", "This run makes the synthetic observation.", { class: "note" }));
  const ended = run.state === "open" ? "under way, or lost with its driver" : `${run.state}${run.kind ? ` (${run.kind.replaceAll("_", " ")})` : ""} after ${duration(run.seconds)}`;
  parts.push(element("p", run.excluded === null ? ended : `excluded by hand (${run.excluded}); it ended ${ended}`));
  if (run.note) parts.push(element("p", run.note, { class: "note" }));
  if (run.message) parts.push(element("pre", run.message, { tabindex: "0", "aria-label": "message" }));
  if (run.log && !run.message.includes(run.log)) parts.push(element("pre", run.log, { tabindex: "0", "aria-label": "log" }));
  const figures = Object.entries(run.diagnostics);
  if (figures.length) {
    const details = element("details");
    details.append(element("summary", "figures of the run"));
    details.append(element("p", figures.map(([name, value]) => `${name} ${figure(value)}`).join(", "), { class: "note" }));
    parts.push(details);
  }
  document.getElementById("run-text").replaceChildren(...parts);
}

// Show the run in this place of the list, or the nearest one.
function go(place) {
  const rows = shared.runs.row;
  if (rows.length && Number.isFinite(place)) fetchRun(rows[Math.min(Math.max(place, 0), rows.length - 1)]);
}

// The place of the first run from this row on; some rows may be missing.
function placeOf(row) {
  const found = shared.runs.row.findIndex((one) => one >= row);
  return found < 0 ? shared.runs.row.length - 1 : found;
}

function type() {
  const row = field().valueAsNumber - 1;
  if (Number.isFinite(row)) go(placeOf(row));
}

export function mountRun(reading) {
  read = reading;
  field().addEventListener("change", type);
  document.getElementById("run-back").addEventListener("click", () => go((shared.run ? placeOf(shared.run.row) : 1) - 1));
  document.getElementById("run-on").addEventListener("click", () => go((shared.run ? placeOf(shared.run.row) : -1) + 1));
  document.getElementById("run-last").addEventListener("click", () => go(shared.runs.row.length - 1));
  listen("wanted", () => go(shared.wanted));
  listen("runs", () => {
    if (shared.run && shared.runs.number[shared.run.row] !== undefined && shared.run.state === "open") go(shared.run.row);
  });
}
