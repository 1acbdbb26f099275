// The panel.
function choose(name) {
  tool = name;
  selected = null;
  element("hint").textContent = HINTS[name];
  for (const part of document.querySelectorAll("[data-of]")) part.hidden = !part.dataset.of.split(" ").includes(name);
  above.dataset.tool = name;
  refresh();
}

function refresh() {
  const bar = marks.scale.length === 2 && marks.length_mm > 0 ? Math.hypot(...minus(...marks.scale)) : 0;
  const per = bar ? `${(1000 * marks.length_mm / bar).toPrecision(4)} µm/px` : "";
  element("of-scale").textContent = per || (marks.scale.length ? "no length" : "–");
  element("of-origin").textContent = marks.origin ? marks.origin.map((v) => v.toFixed(1)).join(", ") : "–";
  element("of-path").textContent = marks.path.length ? counted(marks.path.length, "point") : "–";
  for (const layer of Object.keys(REGIONS)) {
    element(`of-${layer}`).textContent = marks[layer].length ? counted(marks[layer].length, "region") : "–";
  }
  element("closed").checked = marks.closed;
  element("closed").disabled = marks.path.length < FEWEST;
  showLength();
  listRegions();
  element("undo").disabled = history.done.length === 0;
  element("redo").disabled = history.undone.length === 0;
  const list = problems();
  element("ready").textContent = list.length ? list[0] : "Ready to save.";
  element("ready").classList.toggle("good", list.length === 0);
  warn([]);
  draw();
}

// Shows the length as it was typed, unless undo or a file changed it.
function showLength() {
  const typed = Number(element("length").value) * TO_MM[element("unit").value];
  if (marks.length_mm === null ? typed !== 0 : Math.abs(typed - marks.length_mm) > 1e-12 * marks.length_mm) {
    const number = marks.length_mm === null ? "" : marks.length_mm / TO_MM[element("unit").value];
    element("length").value = number === "" ? "" : Number(number.toPrecision(12));
  }
}

function listRegions() {
  const rows = !(tool in REGIONS) ? [] : marks[tool].map((corners, i) => {
    const row = document.createElement("li"), button = document.createElement("button");
    row.append(`Region ${i + 1}: ${counted(corners.length, "corner")} `);
    button.type = "button";
    button.textContent = "Delete";
    button.setAttribute("aria-label", `Delete region ${i + 1}`);
    button.addEventListener("click", () => {
      selected = null;
      change(() => removeRegion(tool, i));
    });
    row.append(button);
    return row;
  });
  element("regions").replaceChildren(...rows);
}

// Takes over the length while it is typed; what is typed at one go is undone at one go.
let beforeTyping = null;
function setLength() {
  beforeTyping ??= JSON.stringify(marks);
  const number = Number(element("length").value) * TO_MM[element("unit").value];
  marks.length_mm = element("length").value === "" || !Number.isFinite(number) ? null : Number(number.toPrecision(12));
  refresh();
}

function endTyping() {
  setLength();
  record(beforeTyping);
  beforeTyping = null;
  refresh();
}

function setLight() {
  const [light, contrast] = ["brightness", "contrast"].map((id) => element(id).value / 100);
  below.style.filter = loupe.style.filter = `brightness(${light}) contrast(${contrast})`;
}
