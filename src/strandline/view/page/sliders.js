// The sliders of the inputs, and what follows them: the predicted interface, and the flow.

import { draw, element, figure, listen, newest, percent, shared, tell, withUnit } from "../panels/shared.js";
import { post } from "./api.js";

// The interface that the surrogate predicts at any inputs.

const predict = newest(async () => {
  const note = document.getElementById("predict-note");
  try {
    shared.prediction = await post("predict", { inputs: shared.chosen });
  } catch (error) {
    note.textContent = error.message;
    return;
  }
  const parts = Object.entries(shared.prediction.conditions).map(([name, one]) => `${name ? `${name}: ` : ""}error of the surrogate ${figure(one.sd_um, 2)} µm`);
  note.textContent = `${parts.join("; ")}; a run here succeeds with probability ${percent(shared.prediction.success)}.`;
  tell("prediction");
});

function slider(input) {
  const label = element("label");
  const shown = element("output", figure(shared.chosen[input.name]));
  const range = element("input", null, { type: "range", min: input.low, max: input.high, step: "any", "data-input": input.name, "aria-label": withUnit(input) });
  range.value = shared.chosen[input.name];
  range.addEventListener("input", () => {
    shared.chosen[input.name] = range.valueAsNumber;
    shown.textContent = figure(range.valueAsNumber);
    predict();
  });
  label.append(`${withUnit(input)} `, shown, range);
  return label;
}

function moveTo(inputs) {
  for (const input of shared.facts.inputs) {
    const value = inputs[input.name];
    if (value === undefined) continue;
    shared.chosen[input.name] = Math.min(Math.max(value, input.low), input.high);
    const range = document.querySelector(`#sliders input[data-input="${CSS.escape(input.name)}"]`);
    range.value = shared.chosen[input.name];
    range.parentElement.querySelector("output").textContent = figure(shared.chosen[input.name]);
  }
  predict();
}

export function mountSliders() {
  document.getElementById("sliders").append(...shared.facts.inputs.map(slider));
  document.getElementById("to-mean").addEventListener("click", () => shared.posterior && shared.posterior.mean && moveTo(shared.posterior.mean));
  document.getElementById("to-run").addEventListener("click", () => shared.run && moveTo(shared.run.inputs));
}

// Speed, pressure and displacement of the built-in model; the value at the cursor.

let flow = null;

function showFlow() {
  const name = document.getElementById("flow-field").value;
  const field = flow && flow.fields[name];
  if (!field) return;
  const scale = name === "pressure" ? "Cividis" : "Viridis";
  const trace = { type: "heatmap", x: flow.x, y: flow.y, z: field.values, colorscale: scale, hoverongaps: false, zsmooth: "best", colorbar: { title: { text: field.unit } }, hovertemplate: `x %{x:.3f} mm, y %{y:.3f} mm<br>${name} %{z:.4g} ${field.unit}<extra></extra>` };
  const layout = { xaxis: { title: { text: "x [mm]" }, constrain: "domain" }, yaxis: { title: { text: "y [mm]" }, scaleanchor: "x", constrain: "domain" } };
  const values = field.values.flat().filter((one) => one !== null);
  const most = values.reduce((a, b) => Math.max(a, b), -Infinity);
  document.getElementById("flow-plot").hidden = false;
  draw("flow-plot", [trace], layout, `${name} in the cell, at most ${figure(most)} ${field.unit}`);
}

async function compute() {
  const note = document.getElementById("flow-note");
  const button = document.getElementById("flow-run");
  button.disabled = true;
  note.textContent = "Computing …";
  try {
    flow = await post("flow", { inputs: shared.chosen, condition: shared.facts.conditions[shared.condition].name });
    note.textContent = Object.entries(shared.chosen).map(([name, value]) => `${name} = ${figure(value)}`).join(", ");
    showFlow();
  } catch (error) {
    note.textContent = error.message;
  }
  button.disabled = false;
}

export function mountFlow() {
  if (!shared.facts.flow) return;
  document.getElementById("flow-field").addEventListener("change", showFlow);
  document.getElementById("flow-run").addEventListener("click", compute);
  listen("colours", showFlow);
}
