// Numbers, symbols and elements as a reader expects them.

export function figure(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
}

export function withSd(mean, sd) {
  if (!(sd >= 1e-4 && sd < 1e6)) return `${figure(mean)} ± ${figure(sd, 2)}`;
  if (sd >= 10) return `${mean.toFixed(0)} ± ${sd.toFixed(0)}`;
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(sd)));
  return `${mean.toFixed(decimals)} ± ${sd.toFixed(decimals)}`;
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

export function element(name, text, attributes = {}) {
  const found = document.createElement(name);
  if (text !== undefined && text !== null) found.textContent = text;
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  return found;
}

export function withUnit(input) {
  return input.unit ? `${input.label} [${input.unit}]` : input.label;
}
