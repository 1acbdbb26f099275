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
  const target = typeof place === "string" ? document.getElementById(place) : place;
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
  const x = Array.from(counts, (_, k) => low + (k + 0.5) * width);
  return { x, y: Array.from(counts, (count) => count / (whole * width)) };
}
