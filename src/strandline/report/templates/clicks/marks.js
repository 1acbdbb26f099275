// What is marked in the picture, how it is undone, and what keeps it from being saved.
// Coordinates are pixels of the whole picture: y points down, the centre of the top left pixel is (0, 0).

const given = JSON.parse(document.getElementById("given").textContent);
const [WIDTH, HEIGHT] = given.size;
const FEWEST = 3, MOST = 20000;
const REGIONS = { exclude: "to leave out", fixed: "that is fixed" };

const nothing = () => ({ scale: [], length_mm: null, origin: null, path: [], closed: false, exclude: [], fixed: [],
                         unfinished: null });
let marks = nothing();
const history = { done: [], undone: [] };

function record(before) {
  if (before === JSON.stringify(marks)) return false;
  history.done.push(before);
  history.undone = [];
  return true;
}

function step(from, to) {
  if (from.length === 0) return false;
  to.push(JSON.stringify(marks));
  marks = JSON.parse(from.pop());
  return true;
}

// The list of points that holds a layer's points; of regions, the one with this number.
function pointsOf(layer, region) {
  if (layer === "origin") return marks.origin ? [marks.origin] : [];
  return layer in REGIONS ? marks[layer][region] ?? [] : marks[layer] ?? [];
}

function placed(x, y, layer) {
  const fine = (value) => Math.round(value * 1000) / 1000;
  if (layer === "origin") return [fine(x), fine(y)];
  return [Math.min(Math.max(fine(x), -0.5), WIDTH - 0.5), Math.min(Math.max(fine(y), -0.5), HEIGHT - 0.5)];
}

const same = (a, b) => a[0] === b[0] && a[1] === b[1];
const inside = ([x, y]) => x >= -0.5 && y >= -0.5 && x <= WIDTH - 0.5 && y <= HEIGHT - 0.5;
const cross = (a, b) => a[0] * b[1] - a[1] * b[0];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
const shown = ([x, y]) => `x ${x.toFixed(1)}, y ${y.toFixed(1)}`;

// Whether p and q lie on different sides of the line through a and b, or on it.
function straddle(a, b, p, q, slack) {
  const d = minus(b, a), length = Math.hypot(...d);
  const one = cross(d, minus(p, a)) / length, two = cross(d, minus(q, a)) / length;
  return Math.min(one, two) <= slack && Math.max(one, two) >= -slack;
}

// A place near which a polyline crosses, touches or runs back over itself, or null.
function crossing(points, closed) {
  const number = closed ? points.length : points.length - 1;
  const segment = (i) => [points[i], points[(i + 1) % points.length]];
  const extent = (k) => Math.max(...points.map((p) => p[k])) - Math.min(...points.map((p) => p[k]));
  const slack = 8 * Number.EPSILON * Math.max(extent(0), extent(1));
  for (let i = 0; i < (closed ? number : number - 1); i++) {
    const [a, b] = segment(i), c = segment((i + 1) % number)[1];
    const d = minus(b, a), e = minus(c, b), sizes = Math.hypot(...d) * Math.hypot(...e);
    if (Math.abs(cross(d, e)) <= 8 * Number.EPSILON * sizes && d[0] * e[0] + d[1] * e[1] < 0) return b;
  }
  for (let i = 0; i < number; i++) {
    const [a, b] = segment(i);
    for (let j = i + 2; j < number; j++) {
      if (closed && i === 0 && j === number - 1) continue;
      const [p, q] = segment(j);
      const apart = [0, 1].some((k) => Math.max(a[k], b[k]) < Math.min(p[k], q[k]) - slack
                                    || Math.max(p[k], q[k]) < Math.min(a[k], b[k]) - slack);
      if (!apart && straddle(a, b, p, q, slack) && straddle(p, q, a, b, slack)) return meeting(a, b, p, q);
    }
  }
  return null;
}

function meeting(a, b, p, q) {
  const d = minus(b, a), e = minus(q, p), share = cross(minus(p, a), e) / cross(d, e);
  return Number.isFinite(share) ? [a[0] + share * d[0], a[1] + share * d[1]] : p;
}

// Why the marks cannot be saved: one sentence each. strandline refuses the same when it reads the file.
const problems = () => [...problemsOfPath(), ...problemsOfScale(), ...problemsOfRegions()];

function problemsOfPath() {
  const { path, closed } = marks;
  if (path.length === 0 && marks.fixed.length > 0) return [];  // another picture is registered to this one, no more
  if (path.length < FEWEST) return [`The path has ${counted(path.length, "point")}; it needs at least ${FEWEST}.`];
  if (path.length > MOST) return [`The path has ${path.length} points; at most ${MOST} are possible.`];
  const outside = path.findIndex((p) => !inside(p));
  if (outside >= 0) return [`Point ${outside + 1} of the path is outside the picture.`];
  const repeated = path.findIndex((p, i) => (closed || i + 1 < path.length) && same(p, path[(i + 1) % path.length]));
  if (repeated >= 0) return [`Points ${repeated + 1} and ${(repeated + 1) % path.length + 1} of the path coincide.`];
  const place = crossing(path, closed);
  return place ? [`The path crosses or touches itself near ${shown(place)}.`] : [];
}

function problemsOfScale() {
  const { scale, length_mm } = marks;
  if (scale.length === 0) return [];
  if (scale.length === 1) return ["The scale bar has one end; click the other one, or delete it."];
  if (!scale.every(inside)) return ["The scale bar reaches outside the picture."];
  if (same(...scale)) return ["The two ends of the scale bar coincide."];
  return length_mm > 0 && Number.isFinite(length_mm) ? [] : ["The scale bar has no length; enter a number above 0."];
}

function problemsOfRegions() {
  const found = [];
  for (const [layer, words] of Object.entries(REGIONS)) {
    marks[layer].forEach((corners, i) => {
      const name = `Region ${i + 1} ${words}`;
      if (corners.length < FEWEST) {
        found.push(`${name} has ${counted(corners.length, "corner")}; it needs at least ${FEWEST}, or delete it.`);
      } else if (corners.length > MOST) found.push(`${name} has more than ${MOST} corners.`);
      else if (!corners.every(inside)) found.push(`${name} reaches outside the picture.`);
    });
  }
  return found;
}

const counted = (number, word) => `${number === 0 ? "no" : number} ${word}${number === 1 ? "" : "s"}`;

// The file, and the marks in a file.
function fileText() {
  const { scale, length_mm, origin, path, closed, exclude, fixed } = marks;
  const bar = scale.length === 2 ? { from: scale[0], to: scale[1], length_mm } : null;
  const file = { version: 1, image: given.name, sha256: given.sha256, size: given.size, scale: bar, origin, path, closed,
                 exclude, fixed };
  const rows = Object.entries(file).map(([key, value]) => `  ${JSON.stringify(key)}: ${JSON.stringify(value)}`);
  return `{\n${rows.join(",\n")}\n}\n`;
}

const isPoint = (p) => Array.isArray(p) && p.length === 2 && p.every(Number.isFinite);
const isPoints = (list) => Array.isArray(list) && list.every(isPoint);

// The marks in the contents of a file; an error says why there are none.
function marksIn(file) {
  const refuse = (why) => { throw new Error(why); };
  if (typeof file !== "object" || file === null || Array.isArray(file)) refuse("it is no file of clicks");
  if (file.version !== 1) refuse(`its version is ${file.version}; this page reads version 1`);
  if (file.sha256 !== given.sha256 || String(file.size) !== String(given.size)) {
    refuse("it belongs to another picture than this one");
  }
  const { scale = null, origin = null, path, closed = false } = file;
  const exclude = file.exclude ?? [], fixed = file.fixed ?? [];
  if (!isPoints(path)) refuse("its path is no list of points");
  if (typeof closed !== "boolean") refuse("closed is neither true nor false");
  if (origin !== null && !isPoint(origin)) refuse("its origin is no point");
  if (scale !== null && !(isPoint(scale.from) && isPoint(scale.to))) refuse("its scale bar has no two ends");
  for (const regions of [exclude, fixed]) {
    if (!(Array.isArray(regions) && regions.every(isPoints))) refuse("its regions are no lists of corners");
  }
  const length_mm = scale && Number.isFinite(scale.length_mm) ? scale.length_mm : null;
  return { ...nothing(), scale: scale ? [scale.from, scale.to] : [], length_mm, origin, path, closed, exclude, fixed };
}

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
