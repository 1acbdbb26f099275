// The page of a study: it asks the server what is new whenever the server says that there is something. The panels in
// `../panels` are those of the report too.

import { mountInputs, mountPosterior, mountRun, mountShapes } from "../panels/panels.js";
import { byId, colour, draw, duration, element, figure, listen, shared, tell, withSd, withUnit } from "../panels/shared.js";
import { get, mountAssumptions, mountFlow, mountSliders } from "./questions.js";

const EDITED = "study.yaml has changed since this page was opened. Start `strandline view` again to see the study as it is now.";
let version = 0;
let posteriors = -1;
let asking = Promise.resolve();

async function readRuns() {
  const new_ = await get("runs", { since: version });
  const runs = shared.runs;
  new_.row.forEach((place, k) => {
    for (const name of ["row", "number", "state", "kind", "seconds"]) runs[name][place] = new_[name][k];
    for (const name of Object.keys(new_.inputs)) (runs.inputs[name] ||= [])[place] = new_.inputs[name][k];
  });
  version = new_.version;
  if (new_.row.length) tell("runs");
}

async function readPosterior(number) {
  posteriors = number;
  shared.posterior = await get("posterior");
  shared.asked = null;
  tell("posterior");
}

async function follow(state) {
  const words = state.problem || (state.edited ? EDITED : "");
  byId("problem").hidden = !words;
  byId("problem").textContent = words;
  if (state.version !== undefined && state.version !== version) await readRuns();
  if (state.planned === undefined) {
    if (words) byId("status").textContent = "Not shown, because of this:";
    return;
  }
  const had = shared.state.ok || 0;
  shared.state = state;
  tell("state");
  if (!had && state.ok && shared.facts.conditions.some((one) => !one.observed)) {
    shared.facts = await get("study");
    tell("facts");
  }
  if (state.posterior !== posteriors) await readPosterior(state.posterior);
}

function complain(error) {
  byId("status").textContent = `Not up to date: ${error.message}`;
}

function connect() {
  const events = new EventSource("events");
  events.onmessage = (event) => {
    const state = JSON.parse(event.data);
    asking = asking.then(() => follow(state)).catch(complain);
  };
  events.onerror = () => {
    byId("status").textContent = "The server does not answer: is `strandline view` still running? Trying again …";
  };
}

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
  if (found.at_work) return `Driver: ${where}, at work${state.runs_per_minute ? `, ${figure(state.runs_per_minute, 3)} runs a minute` : ""}.`;
  if (state.results === "current") return "";
  const again = `strandline run ${shared.facts.folder}`;
  if (!state.active && state.done >= state.planned) return `All runs are done, and their results are being made. If nothing makes them: ${again}`;
  return `The driver (${where}) has ended. Start it again: ${again}`;
}

function showFailures(state) {
  const open = new Set([...byId("failures").querySelectorAll("details[open]")].map((one) => one.dataset.kind));
  const kinds = Object.entries(state.failures || {}).map(([kind, some]) => {
    const inputs = Object.entries(some.example.inputs).map(([name, value]) => `${name} = ${figure(value)}`);
    const details = element("details", [
      element("summary", `${some.count} × ${kind.replaceAll("_", " ")}`),
      element("p", `The first one: ${inputs.join(", ")}: ${some.example.message}`, { class: "note" }),
    ], { "data-kind": kind });
    details.open = open.has(kind);
    if (some.example.log.length) details.append(element("pre", some.example.log.join("\n"), { tabindex: "0" }));
    return details;
  });
  byId("failures").replaceChildren(...kinds);
}

function showState() {
  const { state } = shared;
  const finished = state.results === "current";
  byId("status").textContent = headline(state);
  byId("progress").value = finished ? 1 : state.done / Math.max(state.planned, 1);
  const counts = {
    ok: state.ok, failed: state.failed, "under way": state.open, "to do": finished ? 0 : state.to_do,
    lost: state.lost || null, "median time": duration(state.median_seconds),
  };
  const rows = Object.entries(counts).filter(([, value]) => value !== null);
  byId("counts").replaceChildren(...rows.map(([name, value]) => element("div", [element("dt", name), element("dd", value)])));
  byId("driver").textContent = driver(state);
  byId("batch").textContent = state.last_batch || "";
  showFailures(state);
}

// How the posterior took shape as runs came in.

function showHistory() {
  const steps = shared.posterior?.history || [];
  const input = shared.facts.inputs[Number(byId("history-input").value)];
  byId("history-plot").hidden = steps.length < 2;
  if (!steps.length) return;
  if (steps.length === 1) {
    byId("history-note").textContent = shared.posterior.source === "stored" ? "The study was finished when the page opened, so there are no steps to show." : "There is one posterior so far; the plot begins with the next one.";
    return;
  }
  const { moved } = steps.at(-1);
  byId("history-note").textContent = moved === null ? "" : `The last step moved a mean by ${figure(moved, 2)} standard deviations.`;
  const x = steps.map((one) => one.runs);
  const mean = steps.map((one) => one.mean[input.name]);
  const sd = steps.map((one) => one.sd[input.name]);
  const edge = [...mean.map((m, k) => m + sd[k]), ...mean.map((m, k) => m - sd[k]).reverse()];
  const traces = [
    { type: "scatter", mode: "lines", x: [...x, ...[...x].reverse()], y: edge, fill: "toself", fillcolor: colour("band"), line: { width: 0 }, hoverinfo: "skip" },
    { type: "scatter", mode: "lines+markers", x, y: mean, line: { color: colour("ok") }, marker: { size: 5 }, hovertemplate: "%{x} runs: %{y:.4g}<extra></extra>" },
  ];
  const layout = { xaxis: { title: { text: "runs that succeeded" } }, yaxis: { title: { text: `${withUnit(input)}, ± 1 sd` } } };
  draw("history-plot", traces, layout, `${input.label} after ${x.length} steps: ${withSd(mean.at(-1), sd.at(-1))}`);
}

// Whether the model explains the observation, and whether the surrogate was good enough.

function showFit() {
  const { warnings = [], misfit, nearest, certificate } = shared.state.summary || {};
  const parts = [];
  const add = (words, kind) => parts.push(element("p", words, kind ? { class: kind } : {}));
  for (const warning of warnings || []) add(`Warning: ${warning}`, "problem");
  if (nearest?.message) add(nearest.message, "problem");
  if (misfit) add(misfit.verdict, misfit.flagged && "problem");
  for (const one of misfit?.conditions || []) {
    add(`${one.condition ? `${one.condition}: ` : ""}residuals ${figure(one.sd_um, 3)} µm, expected ${figure(one.stated_sd_um, 3)} µm; p = ${figure(one.p, 2)}`, "note");
  }
  for (const note of misfit?.notes || []) add(note, "note");
  if (certificate) {
    parts.push(element("h3", "Certificate"));
    add(certificate.statement || certificate.verdict || (certificate.converged ? "The design has converged." : "The design has not converged."));
    for (const reason of certificate.reasons || []) add(reason, "note");
  }
  if (!parts.length) add("The fit is judged when the study has ended.", "note");
  byId("fit-text").replaceChildren(...parts);
}

async function start() {
  shared.facts = await get("study");
  const { facts } = shared;
  document.title = `${facts.name} – strandline`;
  byId("name").textContent = facts.name;
  for (const one of document.querySelectorAll(".with-flow")) one.hidden = !facts.flow;
  for (const input of facts.inputs) shared.chosen[input.name] = input.middle;
  listen("state", showState);
  for (const mount of [mountInputs, mountShapes, mountSliders, mountPosterior]) mount();
  byId("history-input").append(...facts.inputs.map((input, k) => element("option", input.label, { value: k })));
  byId("history-input").addEventListener("change", showHistory);
  listen("posterior", showHistory);
  mountAssumptions();
  listen("state", showFit);
  if (facts.flow) mountFlow();
  mountRun((row) => get("run", { row }));
  connect();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => tell("colours"));
}

listen("colours", () => ["runs", "posterior", "run", "prediction"].forEach((name) => tell(name)));
start().catch(complain);
