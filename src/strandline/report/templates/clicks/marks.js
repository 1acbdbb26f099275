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
