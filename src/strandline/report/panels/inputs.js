// Two inputs of all runs, with failures, over the draws of the posterior.

import { colour, draw, element, listen, shared, tell, withUnit } from "./shared.js";

const MOST = 1000; // Points of one kind that are drawn.
const MANY = 500; // Points of one kind above which they are drawn small.
const KINDS = [
  { name: "ok", states: ["ok"], symbol: "circle", size: 6, colour: "ok" },
  { name: "failed", states: ["failed", "timeout", "killed", "invalid"], symbol: "x", size: 7, colour: "failed" },
  { name: "under way", states: ["open"], symbol: "circle-open", size: 8, colour: "open" },
  { name: "excluded", states: ["excluded"], symbol: "diamond-open", size: 8, colour: "excluded" },
];
let axes = null;

function some(rows) {
  if (rows.length <= MOST) return rows;
  const step = rows.length / MOST;
  return Array.from({ length: MOST }, (_, k) => rows[Math.floor(k * step)]);
}

function show() {
  const { runs, facts, posterior } = shared;
  const [x, y] = axes.map((one) => facts.inputs[Number(one.value)]);
  const alone = x === y;
  const traces = [];
  const contours = (draws, name, shade) => draws && traces.push({
    type: "histogram2dcontour", x: draws[x.name], y: draws[y.name], ncontours: 6, showscale: false, hoverinfo: "skip",
    name, colorscale: [[0, "rgba(0,0,0,0)"], [1, colour("band")]], contours: { coloring: shade === "ok" ? "fill" : "none" },
    line: { color: colour(shade), width: 0.7 },
  });
  if (document.getElementById("pair-draws").checked && !alone) {
    contours(posterior && posterior.draws, "posterior", "ok");
    contours(shared.asked && shared.asked.draws, "as asked", "asked");
  }
  let shown = 0;
  for (const kind of KINDS) {
    const name = kind.name === "under way" && !shared.state.open ? "lost" : kind.name;
    const rows = some([...runs.state.keys()].filter((k) => kind.states.includes(runs.state[k])));
    if (!rows.length) continue;
    shown += rows.length;
    traces.push({
      type: "scatter", mode: "markers", name, customdata: rows, cliponaxis: false,
      x: rows.map((k) => runs.inputs[x.name][k]), y: rows.map((k) => (alone ? runs.seconds[k] : runs.inputs[y.name][k])),
      text: rows.map((k) => `run ${runs.row[k] + 1}${runs.kind[k] ? `: ${runs.kind[k]}` : ""}`), hovertemplate: "%{text}<br>%{x:.4g}, %{y:.4g}<extra></extra>",
      marker: { symbol: kind.symbol, size: rows.length > MANY ? kind.size / 2 : kind.size, color: colour(kind.colour) },
    });
  }
  if (shared.run) {
    const at = shared.run.inputs;
    traces.push({
      type: "scatter", mode: "markers", name: "shown", hoverinfo: "skip", x: [at[x.name]], y: [alone ? shared.run.seconds : at[y.name]],
      marker: { symbol: "circle-open", size: 14, color: colour("ink"), line: { width: 2 } },
    });
  }
  const total = runs.state.length;
  document.getElementById("pair-note").textContent = shown < total ? `${shown} of ${total} runs are drawn, all over the design.` : "";
  const layout = {
    xaxis: { title: { text: withUnit(x) }, range: [x.low, x.high] },
    yaxis: alone ? { title: { text: "time [s]" }, rangemode: "tozero" } : { title: { text: withUnit(y) }, range: [y.low, y.high] },
    showlegend: true, uirevision: `${x.name} ${y.name}`,
  };
  draw("pair-plot", traces, layout, `${total} runs over ${x.label} and ${alone ? "their time" : y.label}, with failures marked by crosses`);
}

export function mountInputs() {
  axes = ["pair-x", "pair-y"].map((id) => document.getElementById(id));
  shared.facts.inputs.forEach((input, k) => axes.forEach((one) => one.append(element("option", input.label, { value: k }))));
  axes[1].value = String(Math.min(1, shared.facts.inputs.length - 1));
  axes.forEach((one) => one.addEventListener("change", show));
  document.getElementById("pair-draws").addEventListener("change", show);
  for (const name of ["state", "runs", "posterior", "asked", "run"]) listen(name, show);
  show();
  document.getElementById("pair-plot").on("plotly_click", (event) => {
    const row = event.points[0].customdata;
    if (row === undefined) return;
    shared.wanted = row;
    tell("wanted");
  });
}

