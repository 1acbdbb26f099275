// The posterior now, beside the one under other assumptions.

import { colour, draw, element, figure, histogram, listen, shared, withSd, withUnit } from "./shared.js";

const SOURCES = { stored: "The study's own result.", "so far": "From the runs so far, through the surrogate of the interface." };

function table() {
  const { facts, posterior, asked } = shared;
  const found = document.getElementById("moments");
  found.replaceChildren();
  if (!posterior || !posterior.mean) return;
  const head = element("tr");
  const moved = (row) => element("td", row, { class: "asked" });
  for (const name of ["input", "prior", "posterior", ...(asked && asked.mean ? ["as asked", "shift, sd"] : [])]) head.append(element("th", name, { scope: "col" }));
  const body = element("tbody");
  for (const input of facts.inputs) {
    const row = element("tr");
    row.append(element("th", withUnit(input), { scope: "row" }), element("td", input.prior), element("td", withSd(posterior.mean[input.name], posterior.sd[input.name])));
    if (asked && asked.mean) row.append(moved(withSd(asked.mean[input.name], asked.sd[input.name])), moved(figure(asked.shift[input.name], 2)));
    body.append(row);
  }
  const top = element("thead");
  top.append(head);
  found.append(element("caption", "Means and standard deviations", { class: "note" }), top, body);
}

function marginals() {
  const place = document.getElementById("densities");
  const { facts, posterior, asked } = shared;
  if (!posterior || !posterior.draws) return;
  while (place.children.length < facts.inputs.length) place.append(element("div", null, { class: "plot" }));
  facts.inputs.forEach((input, k) => {
    const plot = place.children[k];
    const now = histogram(posterior.draws[input.name], null, input.low, input.high);
    const traces = [{ type: "scatter", mode: "lines", ...now, line: { color: colour("ok"), shape: "hvh" }, fill: "tozeroy", fillcolor: colour("band"), name: "posterior", hoverinfo: "skip" }];
    if (asked && (asked.weights || asked.draws)) {
      const other = asked.draws ? histogram(asked.draws[input.name], null, input.low, input.high) : histogram(posterior.draws[input.name], asked.weights, input.low, input.high);
      traces.push({ type: "scatter", mode: "lines", ...other, line: { color: colour("asked"), shape: "hvh" }, name: "as asked", hoverinfo: "skip" });
    }
    const shapes = facts.truth ? [{ type: "line", x0: facts.truth[input.name], x1: facts.truth[input.name], yref: "paper", y0: 0, y1: 1, line: { color: colour("pale"), dash: "dot", width: 1 } }] : [];
    const layout = { xaxis: { title: { text: withUnit(input) }, range: [input.low, input.high] }, yaxis: { showticklabels: false, rangemode: "tozero" }, margin: { l: 8, r: 8, t: 4, b: 36 }, shapes };
    draw(plot, traces, layout, `Density of ${input.label}: ${withSd(posterior.mean[input.name], posterior.sd[input.name])}`);
  });
}

function show() {
  const { posterior } = shared;
  const surrogate = posterior && posterior.surrogate;
  const error = surrogate ? ` The surrogate's error is ${figure(surrogate.error_um, 2)} µm where the posterior lies; the local noise hides ${figure(surrogate.hidden_um, 2)} µm.` : "";
  document.getElementById("posterior-source").textContent = !posterior ? "" : posterior.why_none || `${SOURCES[posterior.source]}${error}`;
  document.getElementById("truth-note").hidden = !shared.facts.truth || !posterior || !posterior.mean;
  table();
  marginals();
}

export function mountPosterior() {
  listen("posterior", show);
  listen("asked", () => {
    table();
    marginals();
  });
}
