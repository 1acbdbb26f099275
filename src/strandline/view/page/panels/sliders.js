// The interface that the surrogate predicts at any inputs.

import { newest } from "../../panels/newest.js";
import { shared, tell } from "../../panels/store.js";
import { element, figure, percent, withUnit } from "../../panels/text.js";
import { post } from "../api.js";

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
