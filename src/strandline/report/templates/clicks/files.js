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
