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

const say = (text) => { element("status").textContent = text; };
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

function undo() {
  if (!step(history.done, history.undone)) return say("There is nothing to undo.");
  selected = null;
  refresh();
  say("Undone.");
}

function redo() {
  if (!step(history.undone, history.done)) return say("There is nothing to redo.");
  selected = null;
  refresh();
  say("Done again.");
}

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
