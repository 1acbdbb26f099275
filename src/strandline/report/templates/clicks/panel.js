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

// Saved and opened files, and what happens at the start.
function save() {
  const list = problems();
  if (list.length) {
    warn(["Not saved.", ...list]);
    return say(`Not saved. ${list[0]}`);
  }
  const link = document.createElement("a"), address = URL.createObjectURL(new Blob([fileText()], { type: "application/json" }));
  Object.assign(link, { href: address, download: given.file });
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
  saved = JSON.stringify(marks);
  warn([]);
  say(`Saved as ${given.file} where your browser keeps downloads. Move it into the folder of the study.`);
}

async function open(file) {
  try {
    const found = marksIn(JSON.parse(await file.text()));
    selected = null;
    change(() => { marks = found; });
    saved = JSON.stringify(marks);
    warn([]);
    say(`Opened ${file.name}.`);
  } catch (error) {
    const why = error instanceof SyntaxError ? "it is not JSON" : error.message;
    warn([`${file.name} was not opened: ${why}.`]);
    say(`${file.name} was not opened.`);
  }
}

const pressed = { undo, redo, delete: remove, fit, save, closer: () => zoomTo(view.zoom * 1.5),
                  farther: () => zoomTo(view.zoom / 1.5), full, browse: () => element("file").click() };
for (const [id, action] of Object.entries(pressed)) element(id).addEventListener("click", action);
element("reset").addEventListener("click", () => {
  element("brightness").value = element("contrast").value = 100;
  setLight();
});
for (const id of ["brightness", "contrast"]) element(id).addEventListener("input", setLight);
element("length").addEventListener("input", setLength);
element("length").addEventListener("change", endTyping);
element("unit").addEventListener("change", endTyping);
element("closed").addEventListener("change", () => change(() => { marks.closed = element("closed").checked; }));
for (const radio of radios) radio.addEventListener("change", () => choose(radio.value));
element("file").addEventListener("change", (event) => {
  if (event.target.files.length) open(event.target.files[0]);
  event.target.value = "";
});
window.addEventListener("beforeunload", (event) => { if (JSON.stringify(marks) !== saved) event.preventDefault(); });
new ResizeObserver(draw).observe(stage);

picture.onload = () => {
  if (given.clicks) marks = marksIn(given.clicks);
  saved = JSON.stringify(marks);
  choose("path");
  fit();
  stage.dataset.ready = "true";
};
picture.src = given.picture;
