// How far the study has got: its runs, its posteriors, and its fit.

import { colour, draw, duration, element, figure, listen, shared, withSd, withUnit } from "../panels/shared.js";

// How many runs are done, how the others ended, and how long it may still take.

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

function showRuns() {
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
  listen("state", showRuns);
}

// How the posterior took shape as runs came in.

function showHistory() {
  const steps = (shared.posterior && shared.posterior.history) || [];
  const input = shared.facts.inputs[Number(document.getElementById("history-input").value)];
  const note = document.getElementById("history-note");
  document.getElementById("history-plot").hidden = steps.length < 2;
  if (!steps.length) return;
  if (steps.length === 1) {
    note.textContent = shared.posterior.source === "stored" ? "The study was finished when the page opened, so there are no steps to show." : "There is one posterior so far; the plot begins with the next one.";
    return;
  }
  const last = steps[steps.length - 1];
  note.textContent = last.moved === null ? "" : `The last step moved a mean by ${figure(last.moved, 2)} standard deviations.`;
  const x = steps.map((one) => one.runs);
  const mean = steps.map((one) => one.mean[input.name]);
  const sd = steps.map((one) => one.sd[input.name]);
  const edge = [...mean.map((m, k) => m + sd[k]), ...mean.map((m, k) => m - sd[k]).reverse()];
  const traces = [
    { type: "scatter", mode: "lines", x: [...x, ...[...x].reverse()], y: edge, fill: "toself", fillcolor: colour("band"), line: { width: 0 }, hoverinfo: "skip" },
    { type: "scatter", mode: "lines+markers", x, y: mean, line: { color: colour("ok") }, marker: { size: 5 }, hovertemplate: "%{x} runs: %{y:.4g}<extra></extra>" },
  ];
  const layout = { xaxis: { title: { text: "runs that succeeded" } }, yaxis: { title: { text: `${withUnit(input)}, ± 1 sd` } } };
  draw("history-plot", traces, layout, `${input.label} after ${x.length} steps: ${withSd(mean[mean.length - 1], sd[sd.length - 1])}`);
}

export function mountHistory() {
  const choice = document.getElementById("history-input");
  shared.facts.inputs.forEach((input, k) => choice.append(element("option", input.label, { value: k })));
  choice.addEventListener("change", showHistory);
  listen("posterior", showHistory);
}

// Whether the model explains the observation, and whether the surrogate was good enough.

function certificate(found) {
  const words = found.statement || found.verdict || (found.converged ? "The design has converged." : "The design has not converged.");
  const parts = [element("p", words)];
  for (const reason of found.reasons || []) parts.push(element("p", reason, { class: "note" }));
  return parts;
}

function showFit() {
  const { summary = {} } = shared.state;
  const parts = [];
  const { misfit, nearest } = summary;
  for (const warning of summary.warnings || []) parts.push(element("p", `Warning: ${warning}`, { class: "problem" }));
  if (nearest && nearest.message) parts.push(element("p", nearest.message, { class: "problem" }));
  if (misfit) {
    parts.push(element("p", misfit.verdict, misfit.flagged ? { class: "problem" } : {}));
    for (const one of misfit.conditions || []) {
      const words = `${one.condition ? `${one.condition}: ` : ""}residuals ${figure(one.sd_um, 3)} µm, expected ${figure(one.stated_sd_um, 3)} µm; p = ${figure(one.p, 2)}`;
      parts.push(element("p", words, { class: "note" }));
    }
  }
  for (const note of (misfit && misfit.notes) || []) parts.push(element("p", note, { class: "note" }));
  if (summary.certificate) parts.push(element("h3", "Certificate"), ...certificate(summary.certificate));
  if (!parts.length) parts.push(element("p", "The fit is judged when the study has ended.", { class: "note" }));
  document.getElementById("fit-text").replaceChildren(...parts);
}

export function mountFit() {
  listen("state", showFit);
}
