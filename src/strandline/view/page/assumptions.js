// Sliders for noise, measure, priors and nuisance inputs: the posterior follows by other weights.

import { element, figure, listen, newest, shared, tell, withUnit } from "../panels/shared.js";
import { post } from "./api.js";

const HOW = { reweighting: "by other weights of the same draws", importance: "sampled again", smc: "sampled again, by tempering" };
let asked = {}; // assumptions that differ from the study's
let builtFor = null;

const nothing = () => !Object.keys(asked).length;

const ask = newest(async (again) => {
  const note = document.getElementById("asked-note");
  if (nothing()) {
    shared.asked = null;
    note.textContent = "";
    tell("asked");
    return;
  }
  const begun = performance.now();
  let found;
  try {
    found = await post("ask", { assumptions: asked, again });
  } catch (error) {
    note.textContent = error.message;
    return;
  }
  shared.asked = found;
  const seconds = (performance.now() - begun) / 1000;
  note.textContent = found.mean
    ? `${figure(found.effective, 3)} effective draws, ${HOW[found.by]}${found.reliable ? "" : ": too few draws are effective; let go to sample again"} (${figure(seconds, 2)} s).`
    : `No answer without new runs: ${found.why_not}.`;
  tell("asked");
});

function set(name, value, key) {
  if (key === undefined) {
    if (value === null) delete asked[name];
    else asked[name] = value;
    return;
  }
  const inner = { ...(asked[name] || {}) };
  if (value === null) delete inner[key];
  else inner[key] = value;
  set(name, Object.keys(inner).length ? inner : null);
}

function range(words, { low, high, value, logarithmic = false, shown = figure, id }, change) {
  const [to, from] = logarithmic ? [Math.log, Math.exp] : [Number, Number];
  const label = element("label");
  const output = element("output", shown(value));
  const input = element("input", null, { type: "range", min: to(low), max: to(high), step: "any", "aria-label": words, "data-knob": id });
  input.value = to(value);
  const read = () => Number(from(input.valueAsNumber).toPrecision(4));
  input.addEventListener("input", () => {
    output.textContent = shown(read());
    change(read());
    ask(false);
  });
  input.addEventListener("change", () => ask(true));
  label.append(`${words} `, output, input);
  return label;
}

function noiseKnob(knob) {
  const shown = (factor) => (knob.now.sd === null ? `× ${figure(factor, 3)}` : `× ${figure(factor, 3)} = ${figure(factor * knob.now.sd, 3)} ${knob.now.unit === "µm" ? "µm" : ""}`.trim());
  const words = knob.now.unit === "µm" ? "noise, sd of a point" : "noise σ_N, in the unit of the measure";
  return range(words, { low: knob.range[0], high: knob.range[1], value: 1, logarithmic: true, shown, id: "noise" }, (factor) => set("noise", factor === 1 ? null : factor));
}

function priorKnob(input) {
  const box = element("div");
  const label = element("label", null);
  const choice = element("select", null, { "aria-label": `prior of ${input.label}`, "data-knob": `prior ${input.name}` });
  for (const [value, words] of [["", "as stated"], ["normal", "normal"], ["uniform", "uniform in its box"], ...(input.nuisance ? [["fix", "known"]] : [])]) choice.append(element("option", words, { value }));
  label.append(`prior of ${withUnit(input)} `, choice);
  const inner = element("div");
  const wide = input.high - input.low;
  choice.addEventListener("change", () => {
    set("priors", null, input.name);
    set("fixed", null, input.name);
    inner.replaceChildren();
    const { mean, sd } = shared.posterior;
    if (choice.value === "uniform") set("priors", { uniform: [input.low, input.high] }, input.name);
    if (choice.value === "normal") {
      const at = [mean[input.name], Math.min(2 * sd[input.name], wide)].map((one) => Number(one.toPrecision(4)));
      const change = (k) => (value) => {
        at[k] = value;
        set("priors", { normal: [...at] }, input.name);
      };
      set("priors", { normal: [...at] }, input.name);
      inner.append(range(`mean of the prior of ${input.label}`, { low: input.low, high: input.high, value: at[0], id: `mean ${input.name}` }, change(0)));
      inner.append(range(`sd of the prior of ${input.label}`, { low: wide / 200, high: wide, value: at[1], logarithmic: true, id: `sd ${input.name}` }, change(1)));
    }
    if (choice.value === "fix") {
      const value = Number(mean[input.name].toPrecision(4));
      set("fixed", value, input.name);
      inner.append(range(`value of ${input.label}`, { low: input.low, high: input.high, value, id: `fix ${input.name}` }, (at) => set("fixed", at, input.name)));
    }
    ask(true);
  });
  box.append(label, inner);
  return box;
}

function measureKnob(measures) {
  const label = element("label", null);
  const choice = element("select", null, { "data-knob": "measure" });
  measures.forEach((name, k) => choice.append(element("option", name.replaceAll("_", " "), { value: k ? name : "" })));
  choice.addEventListener("change", () => {
    set("measure", choice.value || null);
    ask(true);
  });
  label.append("measure ", choice);
  return label;
}

function build() {
  const { posterior, facts } = shared;
  const place = document.getElementById("knobs");
  const { knobs } = posterior;
  builtFor = JSON.stringify(knobs) + Boolean(posterior.mean);
  asked = {};
  place.replaceChildren();
  if (!posterior.mean) {
    place.append(element("p", posterior.why_none, { class: "note" }));
    return;
  }
  if (knobs.noise) place.append(noiseKnob(knobs.noise));
  if (knobs.length_um) place.append(range("correlation length [µm]", { low: knobs.length_um.range[0], high: knobs.length_um.range[1], value: knobs.length_um.now, id: "length" }, (value) => set("length_um", value)));
  if (knobs.measures.length > 1) place.append(measureKnob(knobs.measures));
  place.append(...facts.inputs.map(priorKnob));
  if (knobs.why_not) place.append(element("p", `Noise and measure cannot be changed: ${knobs.why_not}.`, { class: "note" }));
}

function follow() {
  const { posterior } = shared;
  if (JSON.stringify(posterior.knobs) + Boolean(posterior.mean) !== builtFor) build();
  else ask(false);
}

async function save(event) {
  event.preventDefault();
  const note = document.getElementById("save-note");
  try {
    const found = await post("save", { name: document.getElementById("save-name").value, assumptions: asked });
    note.textContent = `Saved. It takes over the runs of this study: ${found.command}`;
  } catch (error) {
    note.textContent = error.message;
  }
}

export function mountAssumptions() {
  listen("posterior", follow);
  document.getElementById("as-stated").addEventListener("click", () => {
    build();
    ask(false);
  });
  document.getElementById("save").addEventListener("submit", save);
}
