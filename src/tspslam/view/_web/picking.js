// What is where the pointer is, and the words for it.
const NEAR = 14; // px: a click hits an edge or a point this near

function pick(model, camera, level, mouse, { isSolid, isOpen }) { // the element of a level at a pixel: { level, row } or null
  const ray = camera.ray(mouse), hit = isSolid ? hitFace(model, camera.eye(), ray, isOpen) : null;
  if (level === "face") return hit && { level, row: hit.face };
  if (level === "vertex" && hit) return { level, row: nearestCorner(model, hit, plus(camera.eye(), ray, hit.far)) };
  const reach = hit ? hit.far * 1.02 : Infinity; // edges of the face itself count, those behind it do not
  const off = level === "edge" ? offEdge : offPoint;
  let best = null;
  for (let row = 0; row < model.count[level]; row++) {
    const [away, depth] = off(model, camera, row, mouse, isOpen) ?? [Infinity, 0];
    if (away < NEAR && depth <= reach && (!best || away < best.away)) best = { level, row, away };
  }
  return best;
}

function hitFace(model, eye, ray, isOpen) { // the nearest face on a ray, by Moeller and Trumbore's test of each
  let found = null;
  for (let f = 0; f < model.count.face; f++) {
    if (isOpen && !model.keeps.face[f]) continue;
    const [a, b, c] = [0, 1, 2].map((k) => at(model.places, model.corners[3 * f + k]));
    const u = plus(b, a, -1), v = plus(c, a, -1), p = cross(ray, v), size = dot(u, p);
    if (Math.abs(size) < 1e-18) continue;
    const t = plus(eye, a, -1), s = dot(t, p) / size, q = cross(t, u), w = dot(ray, q) / size, far = dot(v, q) / size;
    if (s >= 0 && w >= 0 && s + w <= 1 && far > 0 && !(found?.far <= far)) found = { face: f, far };
  }
  return found;
}

function nearestCorner(model, { face }, place) {
  const away = (v) => apart(at(model.places, v), place);
  return [...model.corners.subarray(3 * face, 3 * face + 3)].reduce((best, v) => (away(v) < away(best) ? v : best));
}

function offPoint(model, camera, v, [x, y], isOpen) { // px off it, and its depth
  const p = model.hides(v, isOpen) ? null : camera.project(at(model.places, v));
  return p && [Math.hypot(p[0] - x, p[1] - y), p[2]];
}

function offEdge(model, camera, e, mouse, isOpen) {
  const ends = [model.ends[2 * e], model.ends[2 * e + 1]];
  if (ends.some((v) => model.hides(v, isOpen))) return null;
  const [a, b] = ends.map((v) => camera.project(at(model.places, v)));
  if (!a || !b) return null;
  const [x, y] = [b[0] - a[0], b[1] - a[1]], [mx, my] = [mouse[0] - a[0], mouse[1] - a[1]];
  const t = clamp((mx * x + my * y) / Math.max(x * x + y * y, 1e-9), 0, 1);
  return [Math.hypot(mx - t * x, my - t * y), a[2] + t * (b[2] - a[2])];
}

function cornersOf(model, { level, row }) { // places of its vertices
  const rows = { vertex: [row], edge: model.ends.subarray(2 * row, 2 * row + 2),
    face: model.corners.subarray(3 * row, 3 * row + 3) }[level];
  return [...rows].map((v) => at(model.places, v));
}

function sentence(model, layer, found) { // which element, where, and its value
  const { level, row } = found, corners = cornersOf(model, found);
  const place = plus(model.origin, corners.reduce((a, b) => plus(a, b)), 1 / corners.length);
  const where = ["right", "down", "forward"].map((word, k) => `${word} ${minus(place[k].toFixed(2))}`).join(", ");
  const name = `${level[0].toUpperCase()}${level.slice(1)} ${model.rows[level][row]}`;
  return `${name} at ${where} m${layer ? `: ${layer.label}: ${valueWords(model, layer, row)}` : ""}`;
}

function valueWords(model, layer, row) { // to what a step of its scale tells, with its unit
  const { unit: given, scale, steps } = layer;
  if (!layer.ok[row]) return "no value";
  if (layer.name === "direction") {
    const [x, y, z] = model.direction(layer, row).map((v) => minus(v.toFixed(1)));
    return `right ${x}, down ${y}, forward ${z}`;
  }
  if (scale === "rgb") return `red, green and blue ${at(steps, row).join(", ")} of 255`;
  const [low, high] = layer.span, value = low + steps[row] / 255 * (high - low), isCount = given === "keyframes";
  const digits = isCount ? 0 : clamp(Math.round(-Math.log10((high - low) / 255)), 0, 9);
  const words = minus(layer.log ? Number((10 ** value).toPrecision(2)) : value.toFixed(digits));
  const beyond = isCount || scale === "phase" ? "" : { 0: " or less", 255: " or more" }[steps[row]] ?? "";
  const inside = given.match(/\[(.+)\]/); // "arg r [rad]"
  return words + beyond + (inside ? ` ${inside[1]}` : isCount || given === "m" ? ` ${given}` : ` (${given})`);
}
