// The picture and the marks on the screen.

const element = (id) => document.getElementById(id);
const stage = element("stage"), below = element("picture"), above = element("marks"), loupe = element("loupe");
const RATIO = given.pixel_mm ? given.pixel_mm[1] / given.pixel_mm[0] : 1;  // height of a pixel by its width
const CLOSEST = 64;
const COLOURS = { scale: "#ffd23f", origin: "#ff6fb5", path: "#35d0ff", exclude: "#ff6b57", fixed: "#67e08a" };
const picture = new Image();
const view = { zoom: 1, left: 0, top: 0 };  // a point (x, y) is shown at (x + 0.5) · zoom + left
let tool = "path", selected = null, pointer = null;

const toScreen = ([x, y]) => [(x + 0.5) * view.zoom + view.left, (y + 0.5) * view.zoom * RATIO + view.top];
const toPicture = ([sx, sy]) => [(sx - view.left) / view.zoom - 0.5, (sy - view.top) / (view.zoom * RATIO) - 0.5];

function zoomTo(zoom, [sx, sy] = [stage.clientWidth / 2, stage.clientHeight / 2]) {
  const closer = Math.min(Math.max(zoom, smallestZoom()), CLOSEST) / view.zoom;
  view.left = sx - (sx - view.left) * closer;
  view.top = sy - (sy - view.top) * closer;
  view.zoom *= closer;
  draw();
}

const wholeZoom = () => Math.min((stage.clientWidth - 24) / WIDTH, (stage.clientHeight - 24) / (HEIGHT * RATIO));
const smallestZoom = () => Math.min(wholeZoom() / 4, 1);

function fit() {
  view.zoom = Math.min(wholeZoom(), CLOSEST);
  view.left = Math.round((stage.clientWidth - WIDTH * view.zoom) / 2);
  view.top = Math.round((stage.clientHeight - HEIGHT * RATIO * view.zoom) / 2);
  draw();
}

// One pixel of the picture on one of the screen, with their borders on each other.
function full() {
  zoomTo(1);
  [view.left, view.top] = [Math.round(view.left), Math.round(view.top)];
}

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, box.width, box.height);
  return pen;
}

let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    drawPicture(prepared(below), view);
    drawMarks(prepared(above));
    drawLoupe();
    element("zoom").textContent = `${view.zoom < 0.1 ? (100 * view.zoom).toPrecision(2) : Math.round(100 * view.zoom)} %`;
  });
}

function drawPicture(pen, { zoom, left, top }) {
  pen.save();
  pen.translate(left, top);
  pen.scale(zoom, zoom * RATIO);
  pen.beginPath();
  pen.rect(0, 0, WIDTH, HEIGHT);  // a reduced picture may reach beyond it by part of a block
  pen.clip();
  pen.imageSmoothingEnabled = zoom * given.factor < 2;
  pen.imageSmoothingQuality = "high";
  pen.drawImage(picture, 0, 0, picture.naturalWidth * given.factor, picture.naturalHeight * given.factor);
  pen.restore();
}

function drawMarks(pen) {
  for (const layer of Object.keys(REGIONS)) {
    marks[layer].forEach((corners, i) => {
      const open = marks.unfinished === layer && i === marks[layer].length - 1;
      drawLine(pen, layer, corners, { closed: !open, filled: true });
      if (tool === layer) drawPoints(pen, layer, corners, i);
    });
  }
  drawLine(pen, "path", marks.path, { closed: marks.closed });
  if (marks.path.length) drawLabel(pen, "path", marks.path[0], "start");
  if (tool === "path") drawPoints(pen, "path", marks.path);
  drawLine(pen, "scale", marks.scale, {});
  drawPoints(pen, "scale", marks.scale);
  if (marks.origin) drawOrigin(pen, toScreen(marks.origin));
}

function drawLine(pen, layer, points, { closed = false, filled = false }) {
  if (points.length === 0) return;
  const line = new Path2D();
  points.forEach((p, i) => line[i ? "lineTo" : "moveTo"](...toScreen(p)));
  if (closed) line.closePath();
  if (filled) {
    pen.fillStyle = COLOURS[layer] + "38";
    pen.fill(line);
  }
  haloed(pen, line, COLOURS[layer], tool === layer ? 2 : 1.5);
}

function haloed(pen, line, colour, width) {
  pen.lineJoin = "round";
  pen.strokeStyle = "rgb(0 0 0 / 60%)";
  pen.lineWidth = width + 2;
  pen.stroke(line);
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.stroke(line);
}

function drawPoints(pen, layer, points, region) {
  for (const [a, b] of tool === layer ? middles(layer, points, region) : []) {
    const dot = new Path2D();
    dot.arc((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 2.5, 0, 7);
    haloed(pen, dot, COLOURS[layer], 1);
  }
  points.forEach((p, i) => {
    const [x, y] = toScreen(p), chosen = isSelected(layer, region, i), dot = new Path2D();
    dot.arc(x, y, chosen ? 6.5 : 4.5, 0, 7);
    pen.fillStyle = chosen ? "#fff" : COLOURS[layer] + "90";
    pen.fill(dot);
    haloed(pen, dot, COLOURS[layer], 1.5);
    pen.fillStyle = "#000";
    pen.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
  });
}

// Ends, on the screen, of the segments long enough to be divided with the pointer.
function middles(layer, points, region) {
  if (layer === "scale" || layer === "origin") return [];
  const open = layer === "path" ? !marks.closed : marks.unfinished === layer && region === marks[layer].length - 1;
  const screen = points.map(toScreen), number = open ? points.length - 1 : points.length;
  return Array.from({ length: Math.max(number, 0) }, (_, i) => [screen[i], screen[(i + 1) % points.length], i])
    .filter(([a, b]) => Math.hypot(...minus(a, b)) > 48);
}

const isSelected = (layer, region, i) =>
  selected !== null && selected.layer === layer && selected.region === region && selected.index === i;

function drawLabel(pen, layer, point, text) {
  const [x, y] = toScreen(point);
  pen.font = "600 12px system-ui, sans-serif";
  pen.lineWidth = 3;
  pen.strokeStyle = "rgb(0 0 0 / 75%)";
  pen.strokeText(text, x + 9, y - 8);
  pen.fillStyle = COLOURS[layer];
  pen.fillText(text, x + 9, y - 8);
}

function drawOrigin(pen, [x, y]) {
  const line = new Path2D();
  for (const [dx, dy] of [[1, 0], [0, 1]]) {
    line.moveTo(x - 12 * dx, y - 12 * dy);
    line.lineTo(x + 12 * dx, y + 12 * dy);
  }
  line.moveTo(x + 7, y);
  line.arc(x, y, 7, 0, 7);
  haloed(pen, line, COLOURS.origin, tool === "origin" ? 2 : 1.5);
  drawLabel(pen, "origin", marks.origin, "(0, 0)");
}

function drawLoupe() {
  const pen = prepared(loupe), width = loupe.clientWidth, height = loupe.clientHeight;
  if (pointer === null) return;
  const [x, y] = toPicture(pointer), zoom = Math.max(8, 3 * view.zoom);
  drawPicture(pen, { zoom, left: width / 2 - (x + 0.5) * zoom, top: height / 2 - (y + 0.5) * zoom * RATIO });
  const lines = new Path2D();
  lines.rect(width / 2, 0, 0, height / 2 - 5);
  lines.rect(width / 2, height / 2 + 5, 0, height);
  lines.rect(0, height / 2, width / 2 - 5, 0);
  lines.rect(width / 2 + 5, height / 2, width, 0);
  pen.strokeStyle = COLOURS[tool] ?? "#fff";
  pen.lineWidth = 1;
  pen.stroke(lines);
}
