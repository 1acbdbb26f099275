// How many runs are done, how the others ended, and how long it may still take.

import { listen, shared } from "../../panels/store.js";
import { duration, element, figure } from "../../panels/text.js";

const WORDS = { current: "finished", outdated: "study.yaml has changed since its results", none: "" };

function headline(state) {
  const parts = [`${state.done} of ${state.active ? "at most " : ""}${state.planned} runs done`];
  if (state.failed) parts.push(`${state.failed} failed`);
  if (state.open) parts.push(`${state.open} under way`);
  if (state.seconds_left && state.results !== "current") parts.push(`at most ${duration(state.seconds_left)} left`);
  if (WORDS[state.results]) parts.push(WORDS[state.results]);
  return parts.join(", ");
}

function driver(state) {
  const found = state.driver;
  if (state.detached) return "Jobs of a SLURM array are out.";
  if (!found) return "No forward run has been started yet.";
  const where = `process ${found.pid} on ${found.host}`;
  if (found.at_work === null) return `Driver: ${where}; whether it is at work cannot be seen from here.`;
  if (!found.at_work && state.results === "current") return "";
  const again = `strandline run ${shared.facts.folder}`;
  const complete = !state.active && state.done >= state.planned;
  if (!found.at_work && complete) return `All runs are done, and their results are being made. If nothing makes them: ${again}`;
  if (!found.at_work) return `The driver (${where}) has ended. Start it again: ${again}`;
  return `Driver: ${where}, at work${state.runs_per_minute ? `, ${figure(state.runs_per_minute, 3)} runs a minute` : ""}.`;
}

function failures(state) {
  const place = document.getElementById("failures");
  const kinds = Object.entries(state.failures || {});
  const open = new Set([...place.querySelectorAll("details[open]")].map((one) => one.dataset.kind));
  place.replaceChildren(
    ...kinds.map(([kind, some]) => {
      const details = element("details", null, { "data-kind": kind });
      details.open = open.has(kind);
      details.append(element("summary", `${some.count} × ${kind.replaceAll("_", " ")}`));
      const inputs = Object.entries(some.example.inputs).map(([name, value]) => `${name} = ${figure(value)}`);
      details.append(element("p", `The first one: ${inputs.join(", ")}: ${some.example.message}`, { class: "note" }));
      if (some.example.log.length) details.append(element("pre", some.example.log.join("\n"), { tabindex: "0" }));
      return details;
    }),
  );
}

function show() {
  const { state } = shared;
  document.getElementById("status").textContent = headline(state);
  document.getElementById("progress").value = state.results === "current" ? 1 : state.done / Math.max(state.planned, 1);
  const counts = {
    ok: state.ok, failed: state.failed, "under way": state.open, "to do": state.results === "current" ? 0 : state.to_do,
    lost: state.lost || null, "median time": duration(state.median_seconds),
  };
  document.getElementById("counts").replaceChildren(
    ...Object.entries(counts).filter(([, value]) => value !== null).map(([name, value]) => {
      const row = element("div");
      row.append(element("dt", name), element("dd", String(value)));
      return row;
    }),
  );
  document.getElementById("driver").textContent = driver(state);
  document.getElementById("batch").textContent = state.last_batch || "";
  failures(state);
}

export function mountRuns() {
  listen("state", show);
}
