// The observed interface, what the posterior, a run and a prediction say of it, and how far apart they are.

import { colour, draw, element, figure, listen, shared } from "./shared.js";

const condition = () => shared.facts.conditions[shared.condition];

// Turn points in mm into pixels of the picture behind them.
function placed([x, y]) {
  const picture = condition().picture;
  if (!picture) return [x, y];
  const [[a, b], [c, d]] = picture.matrix;
  const [u, v] = picture.origin;
  return [x.map((one, k) => a * one + b * y[k] + u), x.map((one, k) => c * one + d * y[k] + v)];
}

function line(points, name, shade, extra = {}) {
  const [x, y] = placed(points);
  return { type: "scatter", mode: "lines", x, y, name, hoverinfo: "name", line: { color: colour(shade), width: 2, ...extra } };
}

function band(points, name, fill) {
  const [x, y] = placed(points);
  return { type: "scatter", mode: "lines", x, y, name, fill: "toself", fillcolor: fill, line: { width: 0 }, hoverinfo: "skip" };
}

function show() {
  const one = condition();
  const traces = [];
  const bands = (shared.posterior && shared.posterior.bands && shared.posterior.bands[one.name]) || null;
  if (one.undeformed) traces.push(line(one.undeformed, "undeformed", "open", { width: 1, dash: "dot" }));
  if (bands && bands.band) traces.push(band(bands.band, "posterior, ± 2 sd", colour("band")));
  if (one.observed) {
    const [x, y] = placed(one.observed);
    if (one.picture) {
      // a dark rim: seen on bright and on dark pictures
      traces.push({ type: "scatter", mode: "lines", x, y, name: "observed, rim", showlegend: false, hoverinfo: "skip", line: { color: "rgba(0,0,0,.7)", width: 4 } });
      traces.push({ type: "scatter", mode: "lines", x, y, name: "observed", line: { color: "#ffd21f", width: 2 } });
    } else {
      traces.push({ type: "scatter", mode: "lines+markers", x, y, name: "observed", marker: { size: 4, color: colour("ink") }, line: { color: colour("ink"), width: 1 } });
    }
  }
  if (bands) traces.push(line(bands.line, "posterior mean", "ok"));
  const run = shared.run && shared.run.interfaces[one.name];
  if (run) traces.push(line(run.line, `run ${shared.run.row + 1}`, "failed"));
  const found = shared.prediction && shared.prediction.conditions[one.name];
  if (found) {
    if (found.band) traces.push(band(found.band, "surrogate, ± 2 sd", "rgba(0,150,110,.3)"));
    traces.push(line(found.line, "sliders", "asked", { dash: "dash" }));
  }
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
  add(run && run.offsets, `run ${shared.run ? shared.run.row + 1 : ""}`, "failed");
  add(found && found.offsets, "sliders", "asked");
  document.getElementById("offset-plot").hidden = !traces.length;
  const hint = run ? "How far the observed points lie from this run is not known here." : "Click on a run to see how far the observed points lie from it, in µm along the normal.";
  document.getElementById("shape-note").textContent = words.length ? `Normal offset of the observed points from ${words.join("; from ")}.` : hint;
  if (!traces.length) return;
  const layout = { xaxis: { title: { text: "observed point" } }, yaxis: { title: { text: "normal offset [µm]" } }, showlegend: true };
  draw("offset-plot", traces, layout, words.join("; "));
}

export function mountShapes() {
  const choice = document.getElementById("condition");
  shared.facts.conditions.forEach((one, k) => choice.append(element("option", one.name || "the only one", { value: k })));
  document.getElementById("shape-choices").hidden = shared.facts.conditions.length < 2;
  choice.addEventListener("change", () => {
    shared.condition = Number(choice.value);
    show();
  });
  for (const name of ["facts", "posterior", "run", "prediction"]) listen(name, show);
  show();
}
