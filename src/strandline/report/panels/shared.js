// What the panels share: the study's data, numbers and elements, requests, and charts. `tell(name)` calls those that listen to it.

const listeners = new Map();

export const shared = {
  facts: null, // what does not change
  state: {}, // how far the study has got
  runs: { row: [], number: [], state: [], kind: [], seconds: [], inputs: {} },
  posterior: null,
  asked: null, // the posterior under other assumptions
  run: null, // the run that is shown
  condition: 0, // place of the condition that is shown
  chosen: {}, // inputs of the sliders
  prediction: null, // the interface predicted there
};

export function listen(name, task) {
  listeners.set(name, [...(listeners.get(name) || []), task]);
}

export function tell(name, given) {
  for (const task of listeners.get(name) || []) task(given);
}

// Numbers, symbols and elements as a reader expects them.

export const byId = (id) => document.getElementById(id);

export function figure(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (Math.abs(value) >= 1e6) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
}

export function withSd(mean, sd) {
  if (!(sd >= 1e-4 && sd < 1e6)) return `${figure(mean)} ± ${figure(sd, 2)}`;
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(sd)));
  const rounded = Number(mean.toFixed(decimals)) || 0; // a mean of zero has no sign
  return `${rounded.toFixed(decimals)} ± ${sd.toFixed(decimals)}`;
}

export function percent(share) {
  const value = 100 * share;
  return `${value >= 10 || value === 0 ? value.toFixed(0) : value.toPrecision(1)} %`;
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 90) return `${figure(seconds, 3)} s`;
  if (seconds < 5400) return `${(seconds / 60).toFixed(0)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

// An element with text, or with other elements.
export function element(name, content, attributes = {}) {
  const found = document.createElement(name);
  found.append(...[content ?? []].flat());
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  return found;
}

export function withUnit(input) {
  return input.unit ? `${input.label} [${input.unit}]` : input.label;
}

// Call `task` for the newest of many requests only: one is under way, and at most one waits.

export function newest(task) {
  let busy = false;
  let waiting = null;
  return async function ask(given) {
    if (busy) {
      waiting = { given };
      return;
    }
    busy = true;
    try {
      await task(given);
    } finally {
      busy = false;
      if (waiting) {
        const next = waiting;
        waiting = null;
        ask(next.given);
      }
    }
  };
}

// Charts with the colours of the page, and a sentence for people who do not see them.

const OPTIONS = { displaylogo: false, responsive: true, displayModeBar: false };

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function layoutOf(given) {
  const axis = { gridcolor: colour("line"), zerolinecolor: colour("line"), linecolor: colour("pale"), automargin: true };
  const { xaxis = {}, yaxis = {}, ...rest } = given;
  return {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colour("ink"), family: "system-ui, sans-serif", size: 12 },
    margin: { l: 50, r: 12, t: 8, b: 40 },
    showlegend: false,
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" },
    hovermode: "closest",
    xaxis: { ...axis, ...xaxis },
    yaxis: { ...axis, ...yaxis },
    ...rest,
  };
}

export function draw(place, traces, layout, words) {
  const target = typeof place === "string" ? byId(place) : place;
  target.setAttribute("role", "img");
  target.setAttribute("aria-label", words);
  return Plotly.react(target, traces, layoutOf(layout), OPTIONS);
}

// The share of the weight in each of `bins` bins, as a density.
export function histogram(values, weights, low, high, bins = 60) {
  const counts = new Float64Array(bins);
  let whole = 0;
  for (let k = 0; k < values.length; k += 1) {
    const weight = weights ? weights[k] : 1;
    const bin = Math.floor((bins * (values[k] - low)) / (high - low));
    whole += weight;
    if (bin >= 0 && bin < bins) counts[bin] += weight;
  }
  const width = (high - low) / bins;
  return { x: Array.from(counts, (_, k) => low + (k + 0.5) * width), y: Array.from(counts, (count) => count / (whole * width)) };
}
