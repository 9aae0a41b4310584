// Colours, vectors, small helpers. The files of this folder are put together in one function by _turning.py.
const STATES = ["keyframe", "tracked", "weak", "lost", "loop"]; // as in _space.py
const PATH = [232, 89, 12, 255], WEAK = [160, 90, 210, 255], LOST = [140, 146, 154, 255], LOOP = [20, 150, 200, 255];
const OTHERS = [[0, 145, 105, 255], [200, 90, 150, 255], [70, 150, 220, 255]]; // told apart by the colour-blind
const NOW = [40, 110, 240, 255], PLAIN = [70, 125, 205, 150], PICKED = [255, 0, 140, 255];
const TAIL = [25, 60, 150, 255], HEAD = [255, 205, 40, 255]; // of strokes, from dark to bright
const SAMPLED = 6000; // vertices or edges that decide a size or a view

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const unit = (a) => { const size = Math.hypot(...a) || 1; return a.map((x) => x / size); };
const at = (places, row) => [places[3 * row], places[3 * row + 1], places[3 * row + 2]];
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const sorted = (values) => Float64Array.from(values).sort();
const minus = (words) => String(words).replace("-", "\u2212");
const rgb = (colour) => `rgb(${colour.slice(0, 3).join(",")})`;

function element(tag, words = "", name = "") {
  const made = document.createElement(tag);
  if (words) made.textContent = words;
  if (name) made.className = name;
  return made;
}
