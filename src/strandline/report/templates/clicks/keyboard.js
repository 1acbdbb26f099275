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
