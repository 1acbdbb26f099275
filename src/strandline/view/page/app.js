// The page of a study: it asks the server what is new whenever the server says that there is something. The panels in
// `../panels` are those of the report too.

import { mountInputs } from "../panels/inputs.js";
import { mountPosterior } from "../panels/posterior.js";
import { mountRun } from "../panels/run.js";
import { mountShapes } from "../panels/shapes.js";
import { listen, shared, tell } from "../panels/shared.js";
import { get } from "./api.js";
import { mountAssumptions } from "./assumptions.js";
import { mountFit, mountHistory, mountRuns } from "./progress.js";
import { mountFlow, mountSliders } from "./sliders.js";

const EDITED = "study.yaml has changed since this page was opened. Start `strandline view` again to see the study as it is now.";
const status = document.getElementById("status");
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
  const problem = document.getElementById("problem");
  const words = state.problem || (state.edited ? EDITED : "");
  problem.hidden = !words;
  problem.textContent = words;
  if (state.version !== undefined && state.version !== version) await readRuns();
  if (state.planned === undefined) {
    if (words) status.textContent = "Not shown, because of this:";
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
  status.textContent = `Not up to date: ${error.message}`;
}

function connect() {
  const events = new EventSource("events");
  events.onmessage = (event) => {
    const state = JSON.parse(event.data);
    asking = asking.then(() => follow(state)).catch(complain);
  };
  events.onerror = () => {
    status.textContent = "The server does not answer: is `strandline view` still running? Trying again …";
  };
}

async function start() {
  shared.facts = await get("study");
  const { facts } = shared;
  document.title = `${facts.name} – strandline`;
  document.getElementById("name").textContent = facts.name;
  for (const one of document.querySelectorAll(".with-flow")) one.hidden = !facts.flow;
  for (const input of facts.inputs) shared.chosen[input.name] = input.middle;
  for (const mount of [mountRuns, mountInputs, mountShapes, mountSliders, mountPosterior, mountHistory, mountAssumptions, mountFit, mountFlow]) mount();
  mountRun((row) => get("run", { row }));
  connect();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => tell("colours"));
}

listen("colours", () => ["runs", "posterior", "run", "prediction"].forEach(tell));
start().catch(complain);
