// Whether the model explains the observation, and whether the surrogate was good enough.

import { listen, shared } from "../../panels/store.js";
import { element, figure } from "../../panels/text.js";

function certificate(found) {
  const words = found.statement || found.verdict || (found.converged ? "The design has converged." : "The design has not converged.");
  const parts = [element("p", words)];
  for (const reason of found.reasons || []) parts.push(element("p", reason, { class: "note" }));
  return parts;
}

function show() {
  const { summary = {} } = shared.state;
  const parts = [];
  const { misfit, nearest } = summary;
  for (const warning of summary.warnings || []) parts.push(element("p", `Warning: ${warning}`, { class: "problem" }));
  if (nearest && nearest.message) parts.push(element("p", nearest.message, { class: "problem" }));
  if (misfit) {
    parts.push(element("p", misfit.verdict, misfit.flagged ? { class: "problem" } : {}));
    for (const one of misfit.conditions || []) {
      const words = `${one.condition ? `${one.condition}: ` : ""}residuals ${figure(one.sd_um, 3)} µm, expected ${figure(one.stated_sd_um, 3)} µm; p = ${figure(one.p, 2)}`;
      parts.push(element("p", words, { class: "note" }));
    }
  }
  for (const note of (misfit && misfit.notes) || []) parts.push(element("p", note, { class: "note" }));
  if (summary.certificate) parts.push(element("h3", "Certificate"), ...certificate(summary.certificate));
  if (!parts.length) parts.push(element("p", "The fit is judged when the study has ended.", { class: "note" }));
  document.getElementById("fit-text").replaceChildren(...parts);
}

export function mountFit() {
  listen("state", show);
}
