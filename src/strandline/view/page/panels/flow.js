// Speed, pressure and displacement of the built-in model; the value at the cursor.

import { draw } from "../../panels/charts.js";
import { listen, shared } from "../../panels/store.js";
import { figure } from "../../panels/text.js";
import { post } from "../api.js";

let found = null;

function show() {
  const name = document.getElementById("flow-field").value;
  const field = found && found.fields[name];
  if (!field) return;
  const scale = name === "pressure" ? "Cividis" : "Viridis";
  const trace = { type: "heatmap", x: found.x, y: found.y, z: field.values, colorscale: scale, hoverongaps: false, zsmooth: "best", colorbar: { title: { text: field.unit } }, hovertemplate: `x %{x:.3f} mm, y %{y:.3f} mm<br>${name} %{z:.4g} ${field.unit}<extra></extra>` };
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
    found = await post("flow", { inputs: shared.chosen, condition: shared.facts.conditions[shared.condition].name });
    note.textContent = Object.entries(shared.chosen).map(([name, value]) => `${name} = ${figure(value)}`).join(", ");
    show();
  } catch (error) {
    note.textContent = error.message;
  }
  button.disabled = false;
}

export function mountFlow() {
  if (!shared.facts.flow) return;
  document.getElementById("flow-field").addEventListener("change", show);
  document.getElementById("flow-run").addEventListener("click", compute);
  listen("colours", show);
}
