// What a person asks of the server: the interface and the flow at any inputs, the posterior under other assumptions.

import { byId, draw, element, figure, listen, newest, percent, shared, tell, withUnit } from "../panels/shared.js";

async function parsed(answer) {
  const found = await answer.json().catch(() => ({ error: `the server answered ${answer.status}` }));
  if (!answer.ok) throw new Error(found.error || `the server answered ${answer.status}`);
  return found;
}

export async function get(name, query = {}) {
  const text = new URLSearchParams(query).toString();
  return parsed(await fetch(`api/${name}${text ? `?${text}` : ""}`));
}

async function post(name, body) {
  const headers = { "Content-Type": "application/json" };
  return parsed(await fetch(`api/${name}`, { method: "POST", headers, body: JSON.stringify(body) }));
}

// A slider with its value beside it; `change` is called with each new value, `release` when it stays.
function slider(words, { low, high, value, logarithmic = false, digits = 4, shown = figure, release = () => {}, ...attributes }, change) {
  const [to, from] = logarithmic ? [Math.log, Math.exp] : [Number, Number];
  const output = element("output", shown(value));
  const input = element("input", null, { type: "range", min: to(low), max: to(high), step: "any", "aria-label": words, ...attributes });
  input.value = to(value);
  input.addEventListener("input", () => {
    const read = Number(from(input.valueAsNumber).toPrecision(digits));
    output.textContent = shown(read);
    change(read);
  });
  input.addEventListener("change", release);
  return element("label", [`${words} `, output, input]);
}

// The interface that the surrogate predicts at any inputs.

const predict = newest(async () => {
  try {
    shared.prediction = await post("predict", { inputs: shared.chosen });
  } catch (error) {
    byId("predict-note").textContent = error.message;
    return;
  }
  const parts = Object.entries(shared.prediction.conditions).map(([name, one]) => `${name ? `${name}: ` : ""}error of the surrogate ${figure(one.sd_um, 2)} µm`);
  byId("predict-note").textContent = `${parts.join("; ")}; a run here succeeds with probability ${percent(shared.prediction.success)}.`;
  tell("prediction");
});

function showSliders() {
  byId("sliders").replaceChildren(...shared.facts.inputs.map((input) => {
    const { name, low, high } = input;
    const all = { low, high, value: shared.chosen[name], digits: 17, "data-input": name }; // not rounded: the server refuses what lies outside the box
    return slider(withUnit(input), all, (value) => {
      shared.chosen[name] = value;
      predict();
    });
  }));
}

function moveTo(inputs) {
  for (const { name, low, high } of shared.facts.inputs) {
    if (inputs[name] !== undefined) shared.chosen[name] = Math.min(Math.max(inputs[name], low), high);
  }
  showSliders();
  predict();
}

export function mountSliders() {
  byId("held").textContent = shared.facts.held;
  showSliders();
  byId("to-mean").addEventListener("click", () => shared.posterior?.mean && moveTo(shared.posterior.mean));
  byId("to-run").addEventListener("click", () => shared.run && moveTo(shared.run.inputs));
}

// Speed, pressure and displacement of the built-in model; the value at the cursor.

let flow = null;

function showFlow() {
  const name = byId("flow-field").value;
  const field = flow?.fields[name];
  if (!field) return;
  const scale = name === "pressure" ? "Cividis" : "Viridis";
  const trace = { type: "heatmap", x: flow.x, y: flow.y, z: field.values, colorscale: scale, hoverongaps: false, zsmooth: "best", colorbar: { title: { text: field.unit } }, hovertemplate: `x %{x:.3f} mm, y %{y:.3f} mm<br>${name} %{z:.4g} ${field.unit}<extra></extra>` };
  const layout = { xaxis: { title: { text: "x [mm]" }, constrain: "domain" }, yaxis: { title: { text: "y [mm]" }, scaleanchor: "x", constrain: "domain" } };
  const most = field.values.flat().filter((one) => one !== null).reduce((a, b) => Math.max(a, b), -Infinity);
  byId("flow-plot").hidden = false;
  draw("flow-plot", [trace], layout, `${name} in the cell, at most ${figure(most)} ${field.unit}`);
}

async function computeFlow() {
  byId("flow-run").disabled = true;
  byId("flow-note").textContent = "Computing …";
  try {
    flow = await post("flow", { inputs: shared.chosen, condition: shared.facts.conditions[shared.condition].name });
    byId("flow-note").textContent = Object.entries(shared.chosen).map(([name, value]) => `${name} = ${figure(value)}`).join(", ");
    showFlow();
  } catch (error) {
    byId("flow-note").textContent = error.message;
  }
  byId("flow-run").disabled = false;
}

export function mountFlow() {
  byId("flow-field").addEventListener("change", showFlow);
  byId("flow-run").addEventListener("click", computeFlow);
  listen("colours", showFlow);
}

// Sliders for noise, measure, priors and nuisance inputs: the posterior follows by other weights.

const HOW = { reweighting: "by other weights of the same draws", importance: "sampled again", smc: "sampled again, by tempering" };
let asked = {}; // assumptions that differ from the study's
let builtFor = null;

const ask = newest(async (again) => {
  const note = byId("asked-note");
  const begun = performance.now();
  const nothing = !Object.keys(asked).length;
  let found = null;
  try {
    if (!nothing) found = await post("ask", { assumptions: asked, again });
  } catch (error) {
    note.textContent = error.message;
    return;
  }
  const seconds = (performance.now() - begun) / 1000;
  shared.asked = found;
  if (nothing) note.textContent = "";
  else if (!found.mean) note.textContent = `No answer without new runs: ${found.why_not}.`;
  else note.textContent = `${figure(found.effective, 3)} effective draws, ${HOW[found.by]}${found.reliable ? "" : ": too few draws are effective; let go to sample again"} (${figure(seconds, 2)} s).`;
  tell("asked");
});

function set(name, value, key) {
  if (key !== undefined) {
    const { [key]: _, ...others } = asked[name] || {};
    const inner = value === null ? others : { ...others, [key]: value };
    set(name, Object.keys(inner).length ? inner : null);
  } else if (value === null) delete asked[name];
  else asked[name] = value;
}

function knob(words, id, options, change) {
  return slider(words, { ...options, "data-knob": id, release: () => ask(true) }, (value) => {
    change(value);
    ask(false);
  });
}

function choice(words, id, options, change, attributes = {}) {
  const found = element("select", options.map(([value, text]) => element("option", text, { value })), { "data-knob": id, ...attributes });
  found.addEventListener("change", () => {
    change(found.value);
    ask(true);
  });
  return element("label", [`${words} `, found]);
}

function noiseKnob({ range: [low, high], now: { sd, unit } }) {
  const points = unit === "µm";
  const shown = (factor) => (sd === null ? `× ${figure(factor, 3)}` : `× ${figure(factor, 3)} = ${figure(factor * sd, 3)} ${points ? "µm" : ""}`.trim());
  const words = points ? "noise, sd of a point" : "noise σ_N, in the unit of the measure";
  return knob(words, "noise", { low, high, value: 1, logarithmic: true, shown }, (factor) => set("noise", factor === 1 ? null : factor));
}

function priorKnobs(input) {
  const { name, label, low, high, nuisance } = input;
  const inner = element("div");
  const kinds = [["", "as stated"], ["normal", "normal"], ["uniform", "uniform in its box"], ...(nuisance ? [["fix", "known"]] : [])];
  const follow = (kind) => {
    set("priors", null, name);
    set("fixed", null, name);
    inner.replaceChildren();
    const mean = Number(shared.posterior.mean[name].toPrecision(4));
    if (kind === "uniform") set("priors", { uniform: [low, high] }, name);
    if (kind === "normal") {
      const at = [mean, Number(Math.min(2 * shared.posterior.sd[name], high - low).toPrecision(4))];
      const change = (k) => (value) => {
        at[k] = value;
        set("priors", { normal: [...at] }, name);
      };
      change(0)(mean);
      inner.append(
        knob(`mean of the prior of ${label}`, `mean ${name}`, { low, high, value: mean }, change(0)),
        knob(`sd of the prior of ${label}`, `sd ${name}`, { low: (high - low) / 200, high: high - low, value: at[1], logarithmic: true }, change(1)),
      );
    }
    if (kind === "fix") {
      set("fixed", mean, name);
      inner.append(knob(`value of ${label}`, `fix ${name}`, { low, high, value: mean }, (value) => set("fixed", value, name)));
    }
  };
  return element("div", [choice(`prior of ${withUnit(input)}`, `prior ${name}`, kinds, follow, { "aria-label": `prior of ${label}` }), inner]);
}

function build() {
  const { facts, posterior } = shared;
  const { knobs } = posterior;
  builtFor = JSON.stringify(knobs) + Boolean(posterior.mean);
  asked = {};
  const parts = [];
  if (!posterior.mean) parts.push(element("p", posterior.why_none, { class: "note" }));
  else {
    const { noise, length_um: length, measures } = knobs;
    if (noise) parts.push(noiseKnob(noise));
    if (length) parts.push(knob("correlation length [µm]", "length", { low: length.range[0], high: length.range[1], value: length.now }, (value) => set("length_um", value)));
    const names = measures.map((name, k) => [k ? name : "", name.replaceAll("_", " ")]);
    if (names.length > 1) parts.push(choice("measure", "measure", names, (name) => set("measure", name || null)));
    parts.push(...facts.inputs.map(priorKnobs));
    if (knobs.why_not) parts.push(element("p", `Noise and measure cannot be changed: ${knobs.why_not}.`, { class: "note" }));
  }
  byId("knobs").replaceChildren(...parts);
}

async function save(event) {
  event.preventDefault();
  try {
    const found = await post("save", { name: byId("save-name").value, assumptions: asked });
    byId("save-note").textContent = `Saved. It takes over the runs of this study: ${found.command}`;
  } catch (error) {
    byId("save-note").textContent = error.message;
  }
}

export function mountAssumptions() {
  listen("posterior", () => {
    if (JSON.stringify(shared.posterior.knobs) + Boolean(shared.posterior.mean) !== builtFor) build();
    else ask(false);
  });
  byId("as-stated").addEventListener("click", () => {
    build();
    ask(false);
  });
  byId("save").addEventListener("submit", save);
}
