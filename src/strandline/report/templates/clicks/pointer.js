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
  if (tool === "scale" && marks.scale.length === 2) return refuseTo("The scale bar has its two ends: drag one, or delete it.");
  if (tool === "path" && marks.closed) {
    return refuseTo("The path is closed. Drag a small dot between two points to insert one, or untick “closed”.");
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

function refuseTo(text) {
  say(text);
  return null;
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
