// The panels of a report: what they show lies in the page itself.

import { mountInputs, mountPosterior, mountRun, mountShapes } from "./panels.js";
import { byId, listen, shared, tell } from "./shared.js";

const UNKNOWN = { excluded: null, observes: false, message: "", log: "", diagnostics: {} };

// Run the library that draws; the page's security policy knows its digest.
async function load() {
  const packed = Uint8Array.from(atob(byId("explore-plotly").textContent), (one) => one.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(plain).text();
  document.head.append(script);
}

function reader({ facts, runs, details, interfaces }) {
  return async (row) => {
    const place = runs.row.indexOf(row);
    const found = { ...UNKNOWN, row, inputs: { ...facts.fixed }, interfaces: interfaces[row] || {}, ...details[row] };
    for (const name of ["state", "kind", "seconds"]) found[name] = runs[name][place];
    for (const [name, values] of Object.entries(runs.inputs)) found.inputs[name] = values[place];
    if (found.state === "ok" && facts.conditions.length && !interfaces[row]) found.note = "The report does not hold the interface of this run.";
    return found;
  };
}

async function start() {
  const given = JSON.parse(byId("explore-data").textContent);
  for (const name of ["facts", "state", "runs", "posterior"]) shared[name] = given[name];
  await load();
  for (const one of document.querySelectorAll(".with-script")) one.hidden = false;
  mountInputs();
  if (shared.facts.conditions.length) mountShapes();
  mountPosterior();
  mountRun(reader(given));
  tell("posterior");
  listen("colours", () => ["runs", "posterior", "run"].forEach((name) => tell(name)));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => tell("colours"));
}

if (window.DecompressionStream) start();
