// How the posterior took shape as runs came in.

import { colour, draw } from "../../panels/charts.js";
import { listen, shared } from "../../panels/store.js";
import { element, figure, withSd, withUnit } from "../../panels/text.js";

function show() {
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
  choice.addEventListener("change", show);
  listen("posterior", show);
}
