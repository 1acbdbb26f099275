// One run: its inputs, how it ended, its log.

import { get, newest } from "../api.js";
import { listen, shared, tell } from "../store.js";
import { duration, element, figure } from "../text.js";

const field = () => document.getElementById("run-row");

const fetchRun = newest(async (row) => {
  try {
    shared.run = await get("run", { row });
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

function go(row) {
  const last = shared.runs.state.length - 1;
  if (last >= 0 && Number.isFinite(row)) fetchRun(Math.min(Math.max(Math.round(row), 0), last));
}

export function mountRun() {
  field().addEventListener("change", () => go(field().valueAsNumber - 1));
  document.getElementById("run-back").addEventListener("click", () => go((shared.run ? shared.run.row : 1) - 1));
  document.getElementById("run-on").addEventListener("click", () => go((shared.run ? shared.run.row : -1) + 1));
  document.getElementById("run-last").addEventListener("click", () => go(shared.runs.state.length - 1));
  listen("wanted", () => go(shared.wanted));
  listen("runs", () => {
    if (shared.run && shared.runs.number[shared.run.row] !== undefined && shared.run.state === "open") go(shared.run.row);
  });
}
