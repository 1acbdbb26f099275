// Messages, and changes to the marks.

const NEAR = 9;  // pixels of the screen within which a press meets a point
const TO_MM = { mm: 1, um: 1e-3, cm: 10, m: 1e3 };
const HINTS = {
  move: "Drag the picture. Anywhere else: drag with the right button, or hold the space bar.",
  scale: "Click the two ends of a line whose length you know, then enter the length.",
  origin: "Click the place of the model's point (0, 0).",
  path: "Click 5 to 12 points along the edge, from one end to the other. They need not be exact. Drag a point to move it, "
    + "a small dot between two points to insert one. Click the first point to close the path.",
  exclude: "Outline each part of the picture where the edge must not be looked for: dirt, shadows, reflections. "
    + "Click the first corner again, double-click or press Enter to finish a region.",
  fixed: "Outline what does not move between the undeformed and the deformed picture, such as a wall or a needle. "
    + "Click the first corner again, double-click or press Enter to finish a region.",
};
const radios = [...document.querySelectorAll("input[name=tool]")];
let saved = JSON.stringify(nothing()), press = null, spaceHeld = false;

const say = (text) => { element("status").textContent = text; return null; };
const warn = (list) => {
  element("alert").replaceChildren(...list.map((text) => Object.assign(document.createElement("p"), { textContent: text })));
};

// Changes to the marks; each is undone as a whole.
function change(make) {
  const before = JSON.stringify(marks);
  make();
  record(before);
  refresh();
}

function back(from, to, none, done) {
  if (!step(history[from], history[to])) return say(none);
  selected = null;
  refresh();
  return say(done);
}

const undo = () => back("done", "undone", "There is nothing to undo.", "Undone.");
const redo = () => back("undone", "done", "There is nothing to redo.", "Done again.");

function remove() {
  if (selected === null) return say("Select a point first: click it.");
  const { layer, region, index } = selected;
  change(() => {
    if (layer === "origin") marks.origin = null;
    else pointsOf(layer, region).splice(index, 1);
    if (layer === "path" && marks.path.length < FEWEST) marks.closed = false;
    if (layer in REGIONS && marks[layer][region].length === 0) removeRegion(layer, region);
  });
  const left = pointsOf(layer, region).length;
  selected = left && layer !== "origin" ? { layer, region, index: Math.max(index - 1, 0) } : null;
  say("Point deleted.");
  draw();
}

function removeRegion(layer, region) {
  if (marks.unfinished === layer && region === marks[layer].length - 1) marks.unfinished = null;
  marks[layer].splice(region, 1);
}

function finish() {
  if (marks.unfinished === null) return;
  const layer = marks.unfinished;
  if (marks[layer].at(-1).length < FEWEST) return say(`A region needs at least ${FEWEST} corners.`);
  change(() => { marks.unfinished = null; });
  selected = null;
  say("Region finished.");
  draw();
}

// Presses on the picture.
function hit(at) {
  const places = tool in REGIONS ? marks[tool].map((_, i) => i) : [undefined];
  let best = null, nearest = NEAR;
  for (const region of places) {
    pointsOf(tool, region).forEach((p, index) => {
      const distance = Math.hypot(...minus(toScreen(p), at));
      if (distance <= nearest) [best, nearest] = [{ layer: tool, region, index }, distance];
    });
  }
  if (best) return best;
  for (const region of places) {
    for (const [a, b, i] of middles(tool, pointsOf(tool, region), region)) {
      if (Math.hypot((a[0] + b[0]) / 2 - at[0], (a[1] + b[1]) / 2 - at[1]) <= NEAR - 2) {
        return { layer: tool, region, index: i + 1, insert: true };
      }
    }
  }
  return null;
}

// Adds a point where the tool says and returns it as selected, or null if there is no room for one.
function add(at) {
  const point = placed(...toPicture(at), tool);
  if (tool === "origin") {
    marks.origin = point;
    return { layer: tool, index: 0 };
  }
  if (tool === "scale" && marks.scale.length === 2) return say("The scale bar has its two ends: drag one, or delete it.");
  if (tool === "path" && marks.closed) {
    return say("The path is closed. Drag a small dot between two points to insert one, or untick “closed”.");
  }
  let region;
  if (tool in REGIONS) {
    if (marks.unfinished !== tool) {
      marks[tool].push([]);
      marks.unfinished = tool;
    }
    region = marks[tool].length - 1;
  }
  const points = pointsOf(tool, region);
  points.push(point);
  return { layer: tool, region, index: points.length - 1 };
}

// A mouse reports the corner of the screen pixel that it points at; the centre is meant.
function position(event) {
  const box = above.getBoundingClientRect(), half = 0.5 / (window.devicePixelRatio || 1);
  return [event.clientX - box.left + half, event.clientY - box.top + half];
}

above.addEventListener("pointerdown", (event) => {
  above.focus();
  above.setPointerCapture(event.pointerId);
  const at = position(event), pan = event.button !== 0 || spaceHeld || tool === "move";
  press = { at, last: at, pan, before: JSON.stringify(marks), moved: false };
  if (pan) return;
  const found = hit(at);
  if (found?.insert) pointsOf(tool, found.region).splice(found.index, 0, placed(...toPicture(at), tool));
  press.closes = found !== null && found.index === 0 && !found.insert && closable(found);
  press.fresh = found === null;
  selected = found ?? add(at);
  if (selected) {
    const { layer, region, index } = selected;
    selected = { layer, region, index };
    press.grip = press.fresh || found.insert ? [0, 0] : minus(toScreen(pointsOf(layer, region)[index]), at);
  }
  draw();
});

function closable({ layer, region }) {
  if (pointsOf(layer, region).length < FEWEST) return false;
  return layer === "path" ? !marks.closed : marks.unfinished === layer && region === marks[layer].length - 1;
}

above.addEventListener("pointermove", (event) => {
  pointer = position(event);
  element("place").textContent = placeText(toPicture(pointer));
  if (press) drag(pointer);
  draw();
});

function drag(at) {
  press.moved ||= Math.hypot(...minus(at, press.at)) > 3;
  if (press.pan) {
    view.left += at[0] - press.last[0];
    view.top += at[1] - press.last[1];
  } else if (selected && press.moved) {
    if (press.fresh && tool === "scale" && marks.scale.length === 1) selected = add(at);  // drawn in one go
    const { layer, region, index } = selected;
    const moved = placed(...toPicture([at[0] + press.grip[0], at[1] + press.grip[1]]), layer);
    if (layer === "origin") marks.origin = moved;
    else pointsOf(layer, region)[index] = moved;
  }
  press.last = at;
}

above.addEventListener("pointerup", () => {
  if (!press) return;
  const { pan, moved, closes, before } = press;
  press = null;
  if (!pan && closes && !moved) {
    if (tool === "path") marks.closed = true;
    else marks.unfinished = null;
    say(tool === "path" ? "Path closed." : "Region finished.");
  }
  if (!pan && record(before)) refresh();
  if (!pan && tool === "scale" && marks.scale.length === 2 && marks.length_mm === null) element("length").focus();
});
above.addEventListener("pointercancel", () => {
  if (press && !press.pan) marks = JSON.parse(press.before);
  press = selected = null;
  refresh();
});
above.addEventListener("pointerleave", () => {
  element("place").textContent = "";
  pointer = null;
  draw();
});
above.addEventListener("dblclick", finish);
above.addEventListener("contextmenu", (event) => event.preventDefault());
above.addEventListener("wheel", (event) => {
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 16 : 1;
  zoomTo(view.zoom * Math.exp(-Math.max(-200, Math.min(200, event.deltaY * lines)) / 300), position(event));
}, { passive: false });

function placeText([x, y]) {
  const text = `x ${x.toFixed(1)}, y ${y.toFixed(1)} px`;
  return inside([x, y]) ? text : `${text}, outside the picture`;
}

// Keyboard.
const KEYS = {
  "+": () => zoomTo(view.zoom * 1.5), "=": () => zoomTo(view.zoom * 1.5), "-": () => zoomTo(view.zoom / 1.5),
  0: fit, Delete: remove, Backspace: remove, Enter: finish,
  Escape: () => { selected = null; draw(); },
  a: addByKey, A: addByKey,
};

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey) return shortcut(event);
  const field = event.target.closest("input:not([type=radio]), select, button, summary");
  if (field && event.key === "Escape") field.blur();
  if (event.altKey || field) return;
  const chosen = radios.find((radio) => radio.dataset.key === event.key);
  if (chosen) chosen.click();
  else if (event.key === " ") spaceHeld = true;
  else if (event.key.startsWith("Arrow") && event.target.type !== "radio") arrow(event);
  else if (event.key in KEYS) KEYS[event.key]();
  else return;
  if (event.target.type !== "radio" || !event.key.startsWith("Arrow")) event.preventDefault();
});
document.addEventListener("keyup", (event) => { if (event.key === " ") spaceHeld = false; });
window.addEventListener("blur", () => { spaceHeld = false; });

function shortcut(event) {
  const key = event.key.toLowerCase();
  const typing = event.target.closest("input[type=number]");
  const again = key === "y" || (key === "z" && event.shiftKey);
  const action = key === "s" ? save : typing ? null : again ? redo : key === "z" ? undo : null;
  if (action === null) return;
  event.preventDefault();
  action();
}

// Moves the selected point by one pixel of the screen (ten with Shift), or else the picture.
function arrow(event) {
  const far = event.shiftKey ? 10 : 1;
  const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (selected === null) {
    view.left -= 40 * far * dx;
    view.top -= 40 * far * dy;
    return draw();
  }
  const { layer, region, index } = selected, [x, y] = pointsOf(layer, region)[index];
  const moved = placed(x + far * dx / view.zoom, y + far * dy / (view.zoom * RATIO), layer);
  change(() => {
    if (layer === "origin") marks.origin = moved;
    else pointsOf(layer, region)[index] = moved;
  });
  say(`Point at ${shown(moved)}.`);
}

function addByKey() {
  if (tool === "move") return say("Choose first what to mark.");
  change(() => { selected = add(pointer ?? [stage.clientWidth / 2, stage.clientHeight / 2]); });
  if (selected) say(`Point at ${shown(pointsOf(tool, selected.region)[selected.index])}. Arrow keys move it.`);
}

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
