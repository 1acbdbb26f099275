// The panels: the inputs of the runs, the posterior, one run, and the interface.

import { byId, colour, draw, duration, element, figure, histogram, listen, newest, shared, tell, withSd, withUnit } from "./shared.js";

// Two inputs of all runs, with failures, over the draws of the posterior.

const MOST = 1000; // Points of one kind that are drawn.
const MANY = 500; // Points of one kind above which they are drawn small.
const KINDS = [
  { name: "ok", states: ["ok"], symbol: "circle", size: 6, colour: "ok" },
  { name: "failed", states: ["failed", "timeout", "killed", "invalid"], symbol: "x", size: 7, colour: "failed" },
  { name: "under way", states: ["open"], symbol: "circle-open", size: 8, colour: "open" },
  { name: "excluded", states: ["excluded"], symbol: "diamond-open", size: 8, colour: "excluded" },
];

function some(rows) {
  if (rows.length <= MOST) return rows;
  return Array.from({ length: MOST }, (_, k) => rows[Math.floor((k * rows.length) / MOST)]);
}

function showInputs() {
  const { runs, facts, posterior, asked, run } = shared;
  const [x, y] = ["pair-x", "pair-y"].map((id) => facts.inputs[Number(byId(id).value)]);
  const alone = x === y;
  const traces = [];
  const contours = (draws, name, shade) => draws && traces.push({
    type: "histogram2dcontour", x: draws[x.name], y: draws[y.name], ncontours: 6, showscale: false, hoverinfo: "skip",
    name, colorscale: [[0, "rgba(0,0,0,0)"], [1, colour("band")]], contours: { coloring: shade === "ok" ? "fill" : "none" },
    line: { color: colour(shade), width: 0.7 },
  });
  if (byId("pair-draws").checked && !alone) {
    contours(posterior?.draws, "posterior", "ok");
    contours(asked?.draws, "as asked", "asked");
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
  if (run) traces.push({
    type: "scatter", mode: "markers", name: "shown", hoverinfo: "skip", x: [run.inputs[x.name]], y: [alone ? run.seconds : run.inputs[y.name]],
    marker: { symbol: "circle-open", size: 14, color: colour("ink"), line: { width: 2 } },
  });
  const total = runs.state.length;
  byId("pair-note").textContent = shown < total ? `${shown} of ${total} runs are drawn, all over the design.` : "";
  const layout = {
    xaxis: { title: { text: withUnit(x) }, range: [x.low, x.high] },
    yaxis: alone ? { title: { text: "time [s]" }, rangemode: "tozero" } : { title: { text: withUnit(y) }, range: [y.low, y.high] },
    showlegend: true, uirevision: `${x.name} ${y.name}`,
  };
  draw("pair-plot", traces, layout, `${total} runs over ${x.label} and ${alone ? "their time" : y.label}, with failures marked by crosses`);
}

export function mountInputs() {
  for (const [id, first] of [["pair-x", 0], ["pair-y", 1]]) {
    byId(id).append(...shared.facts.inputs.map((input, k) => element("option", input.label, { value: k })));
    byId(id).value = String(Math.min(first, shared.facts.inputs.length - 1));
  }
  for (const id of ["pair-x", "pair-y", "pair-draws"]) byId(id).addEventListener("change", showInputs);
  for (const name of ["state", "runs", "posterior", "asked", "run"]) listen(name, showInputs);
  showInputs();
  byId("pair-plot").on("plotly_click", (event) => {
    const place = event.points[0].customdata;
    if (place !== undefined) tell("wanted", place);
  });
}

// The posterior now, beside the one under other assumptions.

const SOURCES = { stored: "The study's own result.", "so far": "From the runs so far, through the surrogate of the interface." };

function showTable() {
  const { facts, posterior, asked } = shared;
  byId("moments").replaceChildren();
  if (!posterior?.mean) return;
  const moved = (words) => element("td", words, { class: "asked" });
  const names = ["input", "prior", "posterior", ...(asked?.mean ? ["as asked", "shift, sd"] : [])];
  const head = element("thead", element("tr", names.map((name) => element("th", name, { scope: "col" }))));
  const rows = facts.inputs.map((input) => {
    const { name, prior } = input;
    const row = [element("th", withUnit(input), { scope: "row" }), element("td", prior), element("td", withSd(posterior.mean[name], posterior.sd[name]))];
    if (asked?.mean) row.push(moved(withSd(asked.mean[name], asked.sd[name])), moved(figure(asked.shift[name], 2)));
    return element("tr", row);
  });
  byId("moments").append(element("caption", "Means and standard deviations", { class: "note" }), head, element("tbody", rows));
}

function showMarginals() {
  const { facts, posterior, asked } = shared;
  const place = byId("densities");
  if (!posterior?.draws) return;
  while (place.children.length < facts.inputs.length) place.append(element("div", null, { class: "plot" }));
  facts.inputs.forEach((input, k) => {
    const { name, low, high } = input;
    const step = (draws, weights, shade) => ({ type: "scatter", mode: "lines", ...histogram(draws[name], weights, low, high), line: { color: colour(shade), shape: "hvh" }, hoverinfo: "skip" });
    const traces = [{ ...step(posterior.draws, null, "ok"), fill: "tozeroy", fillcolor: colour("band"), name: "posterior" }];
    if (asked?.draws) traces.push({ ...step(asked.draws, null, "asked"), name: "as asked" });
    else if (asked?.weights) traces.push({ ...step(posterior.draws, asked.weights, "asked"), name: "as asked" });
    const shapes = facts.truth ? [{ type: "line", x0: facts.truth[name], x1: facts.truth[name], yref: "paper", y0: 0, y1: 1, line: { color: colour("pale"), dash: "dot", width: 1 } }] : [];
    const layout = { xaxis: { title: { text: withUnit(input) }, range: [low, high] }, yaxis: { showticklabels: false, rangemode: "tozero" }, margin: { l: 8, r: 8, t: 4, b: 36 }, shapes };
    draw(place.children[k], traces, layout, `Density of ${input.label}: ${withSd(posterior.mean[name], posterior.sd[name])}`);
  });
}

function showPosterior() {
  const { posterior } = shared;
  const surrogate = posterior?.surrogate;
  const error = surrogate ? ` The surrogate's error is ${figure(surrogate.error_um, 2)} µm where the posterior lies; the local noise hides ${figure(surrogate.hidden_um, 2)} µm.` : "";
  byId("posterior-source").textContent = !posterior ? "" : posterior.why_none || `${SOURCES[posterior.source]}${error}`;
  byId("truth-note").hidden = !shared.facts.truth || !posterior?.mean;
}

export function mountPosterior() {
  listen("posterior", showPosterior);
  for (const name of ["posterior", "asked"]) {
    listen(name, showTable);
    listen(name, showMarginals);
  }
}

// One run: its inputs, how it ended, its log.

function showRun(run) {
  const inputs = Object.entries(run.inputs).map(([name, value]) => `${name} = ${figure(value, 6)}`);
  const ended = run.state === "open" ? "under way, or lost with its driver" : `${run.state}${run.kind ? ` (${run.kind.replaceAll("_", " ")})` : ""} after ${duration(run.seconds)}`;
  const figures = Object.entries(run.diagnostics).map(([name, value]) => `${name} ${figure(value)}`);
  const parts = [element("p", inputs.join(", "))];
  if (run.observes) parts.push(element("p", "This run makes the synthetic observation.", { class: "note" }));
  parts.push(element("p", run.excluded === null ? ended : `excluded by hand (${run.excluded}); it ended ${ended}`));
  if (run.note) parts.push(element("p", run.note, { class: "note" }));
  if (run.message) parts.push(element("pre", run.message, { tabindex: "0", "aria-label": "message" }));
  if (run.log && !run.message.includes(run.log)) parts.push(element("pre", run.log, { tabindex: "0", "aria-label": "log" }));
  if (figures.length) parts.push(element("details", [element("summary", "figures of the run"), element("p", figures.join(", "), { class: "note" })]));
  byId("run-text").replaceChildren(...parts);
}

// The place of the first run from this row on; some rows may be missing.
function placeOf(row) {
  const found = shared.runs.row.findIndex((one) => one >= row);
  return found < 0 ? shared.runs.row.length - 1 : found;
}

// `read` returns what is known of the run in a row.
export function mountRun(read) {
  const show = newest(async (row) => {
    try {
      shared.run = await read(row);
    } catch (error) {
      byId("run-text").replaceChildren(element("p", error.message, { class: "note" }));
      return;
    }
    byId("run-row").value = row + 1;
    showRun(shared.run);
    tell("run");
  });
  // Show the run in this place of the list, or the nearest one.
  const go = (place) => {
    const rows = shared.runs.row;
    if (rows.length && Number.isFinite(place)) show(rows[Math.min(Math.max(place, 0), rows.length - 1)]);
  };
  byId("run-row").addEventListener("change", () => {
    const row = byId("run-row").valueAsNumber - 1;
    if (Number.isFinite(row)) go(placeOf(row));
  });
  byId("run-back").addEventListener("click", () => go((shared.run ? placeOf(shared.run.row) : 1) - 1));
  byId("run-on").addEventListener("click", () => go((shared.run ? placeOf(shared.run.row) : -1) + 1));
  byId("run-last").addEventListener("click", () => go(shared.runs.row.length - 1));
  listen("wanted", go);
  listen("runs", () => {
    if (shared.run?.state === "open" && shared.runs.number[shared.run.row] !== undefined) go(shared.run.row);
  });
}

// The observed interface, what the posterior, a run and a prediction say of it, and how far apart they are.

const condition = () => shared.facts.conditions[shared.condition];

// Turn points in mm into pixels of the picture behind them.
function placed([x, y]) {
  const { picture } = condition();
  if (!picture) return [x, y];
  const [[a, b], [c, d]] = picture.matrix;
  const [u, v] = picture.origin;
  return [x.map((one, k) => a * one + b * y[k] + u), x.map((one, k) => c * one + d * y[k] + v)];
}

function line(points, name, options) {
  const [x, y] = placed(points);
  return { type: "scatter", mode: "lines", x, y, name, ...options };
}

function showShapes() {
  const one = condition();
  const traces = [];
  const add = (points, name, shade, extra = {}) => points && traces.push(line(points, name, { hoverinfo: "name", line: { color: colour(shade), width: 2, ...extra } }));
  const addBand = (points, name, fill) => points && traces.push(line(points, name, { fill: "toself", fillcolor: fill, line: { width: 0 }, hoverinfo: "skip" }));
  const bands = shared.posterior?.bands?.[one.name];
  add(one.undeformed, "undeformed", "open", { width: 1, dash: "dot" });
  addBand(bands?.band, "posterior, ± 2 sd", colour("band"));
  if (one.observed && one.picture) {
    // a dark rim: seen on bright and on dark pictures
    traces.push(line(one.observed, "observed, rim", { showlegend: false, hoverinfo: "skip", line: { color: "rgba(0,0,0,.7)", width: 4 } }));
    traces.push(line(one.observed, "observed", { line: { color: "#ffd21f", width: 2 } }));
  } else if (one.observed) {
    traces.push(line(one.observed, "observed", { mode: "lines+markers", marker: { size: 4, color: colour("ink") }, line: { color: colour("ink"), width: 1 } }));
  }
  add(bands?.line, "posterior mean", "ok");
  const run = shared.run?.interfaces[one.name];
  add(run?.line, `run ${shared.run ? shared.run.row + 1 : ""}`, "failed");
  const found = shared.prediction?.conditions[one.name];
  addBand(found?.band, "surrogate, ± 2 sd", "rgba(0,150,110,.3)");
  add(found?.line, "sliders", "asked", { dash: "dash" });
  const fixed = { automargin: false }; // with equal scales, margins that follow the labels may never settle
  const layout = { showlegend: true, uirevision: one.name, margin: { l: 64, r: 12, t: 8, b: 46 }, xaxis: { title: { text: "x [mm]" }, ...fixed }, yaxis: { title: { text: "y [mm]" }, scaleanchor: "x", ...fixed } };
  if (one.picture) {
    const { width, height, pixel, source } = one.picture;
    layout.images = [{ source, x: -0.5, y: -0.5, sizex: width, sizey: height, xref: "x", yref: "y", yanchor: "top", sizing: "stretch", layer: "below", opacity: 0.9 }];
    const bare = { ...fixed, constrain: "domain", showgrid: false, zeroline: false }; // lines of a grid would cross the picture
    layout.xaxis = { title: { text: "x [pixels]" }, range: [-0.5, width - 0.5], ...bare };
    layout.yaxis = { title: { text: "y [pixels]" }, range: [height - 0.5, -0.5], scaleanchor: "x", scaleratio: pixel[1] / pixel[0], ...bare };
  }
  draw("shape-plot", traces, layout, `Interfaces: ${traces.filter((trace) => trace.showlegend !== false).map((trace) => trace.name).join(", ")}`);
  showOffsets(run, found);
}

function showOffsets(run, found) {
  const traces = [];
  const words = [];
  const add = (values, name, shade) => {
    if (!values) return;
    traces.push({ type: "scatter", mode: "lines", x: values.map((_, k) => k + 1), y: values, name, line: { color: colour(shade), width: 1.5 } });
    const rms = Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
    words.push(`${name}: root mean square ${figure(rms, 3)} µm`);
  };
  add(run?.offsets, `run ${shared.run ? shared.run.row + 1 : ""}`, "failed");
  add(found?.offsets, "sliders", "asked");
  byId("offset-plot").hidden = !traces.length;
  const hint = run ? "How far the observed points lie from this run is not known here." : "Click on a run to see how far the observed points lie from it, in µm along the normal.";
  byId("shape-note").textContent = words.length ? `Normal offset of the observed points from ${words.join("; from ")}.` : hint;
  if (!traces.length) return;
  const layout = { xaxis: { title: { text: "observed point" } }, yaxis: { title: { text: "normal offset [µm]" } }, showlegend: true };
  draw("offset-plot", traces, layout, words.join("; "));
}

export function mountShapes() {
  byId("condition").append(...shared.facts.conditions.map((one, k) => element("option", one.name || "the only one", { value: k })));
  byId("shape-choices").hidden = shared.facts.conditions.length < 2;
  byId("condition").addEventListener("change", () => {
    shared.condition = Number(byId("condition").value);
    showShapes();
  });
  for (const name of ["facts", "posterior", "run", "prediction"]) listen(name, showShapes);
  showShapes();
}
